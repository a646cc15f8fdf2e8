//! The signs of the predicates against unbounded integers, for any metric and raster.
#![no_main]

use arbitrary::{Arbitrary, Result, Unstructured};
use dem2tin_core::predicate::{orient2d, Metric, Point, MAX_SIDE, SUB_BITS};
use libfuzzer_sys::fuzz_target;
use num_bigint::BigInt;

#[derive(Debug)]
struct Input {
    form: [f64; 3],
    side: usize,
    points: [Point; 4],
}

impl<'a> Arbitrary<'a> for Input {
    fn arbitrary(u: &mut Unstructured<'a>) -> Result<Self> {
        let form = if u.arbitrary()? {
            [f64::arbitrary(u)?, f64::arbitrary(u)?, f64::arbitrary(u)?]
        } else {
            let (a, b, c) =
                (f64::from(i16::arbitrary(u)?), f64::from(i16::arbitrary(u)?), f64::from(i16::arbitrary(u)?));
            [a * a, a * b, b * b + c * c]
        };
        let side = 2usize.max(MAX_SIDE >> u.int_in_range(0..=19)?);
        let last = ((side - 1) << SUB_BITS) as i32;
        let mut points = [Point { x: 0, y: 0 }; 4];
        for p in &mut points {
            *p = match u.int_in_range(0..=2)? {
                // Corners of the raster: the largest determinants.
                0 => Point {
                    x: if u.arbitrary()? { last } else { 0 },
                    y: if u.arbitrary()? { last } else { 0 },
                },
                1 => Point { x: u.int_in_range(0..=last)?, y: u.int_in_range(0..=last)? },
                _ => Point { x: u.int_in_range(0..=last.min(15))?, y: u.int_in_range(0..=last.min(15))? },
            };
        }
        // The fourth corner of a parallelogram, or nearly: on the circle in many metrics.
        let [a, b, c, _] = points;
        if u.arbitrary()? {
            let near = |v: i32, u: &mut Unstructured| Ok((v + u.int_in_range(-1..=1)?).clamp(0, last));
            points[3] = Point { x: near(a.x - b.x + c.x, u)?, y: near(a.y - b.y + c.y, u)? };
        }
        Ok(Input { form, side, points })
    }
}

fn orientation(a: Point, b: Point, c: Point) -> BigInt {
    let big = |v: i32| BigInt::from(v);
    // The 3 x 3 determinant with a column of ones, expanded: no differences are taken first.
    big(a.x) * (big(b.y) - big(c.y)) + big(b.x) * (big(c.y) - big(a.y)) + big(c.x) * (big(a.y) - big(b.y))
}

/// Positive if `d` is inside the circle: the 4 x 4 determinant of the lifted points.
fn in_circle(m: Metric, [a, b, c, d]: [Point; 4]) -> BigInt {
    let lift = |p: Point| {
        let (x, y) = (BigInt::from(p.x), BigInt::from(p.y));
        m.e * &x * &x + 2 * m.f * &x * &y + m.g * &y * &y
    };
    lift(a) * orientation(b, c, d) - lift(b) * orientation(a, c, d) + lift(c) * orientation(a, b, d)
        - lift(d) * orientation(a, b, c)
}

fuzz_target!(|input: Input| {
    let Input { form: [e, f, g], side, points: [a, mut b, mut c, d] } = input;
    for (p, q, r) in [(a, b, c), (b, c, d), (d, b, a)] {
        assert_eq!(BigInt::from(orient2d(p, q, r)), orientation(p, q, r));
    }
    let Some(metric) = Metric::from_form(e, f, g, side) else { return };
    let Metric { e, f, g } = metric;
    assert!(e > 0 && g > 0 && BigInt::from(e) * g > BigInt::from(f) * f, "not positive definite: {metric:?}");
    if orient2d(a, b, c) < 0 {
        (b, c) = (c, b);
    }
    if orient2d(a, b, c) != 0 {
        let expected = in_circle(metric, [a, b, c, d]) > BigInt::from(0);
        for (p, q, r) in [(a, b, c), (b, c, a), (c, a, b)] {
            assert_eq!(metric.in_circle(p, q, r, d), expected);
        }
    }
});
