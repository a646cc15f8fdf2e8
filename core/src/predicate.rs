//! Exact geometric predicates on the pixel lattice.
//!
//! Coordinates are integers in units of 1/256 pixel, so `orient2d` is exact in
//! `i64` and `in_circle` in `i128`. The map enters as a quadratic form
//! `e dx^2 + 2 f dx dy + g dy^2` (the squared length of a lattice step on the
//! ground), which makes square, anisotropic, rotated, sheared and geographic
//! grids one and the same case.

/// Bits of the sub-pixel part of a coordinate.
pub const SUB_BITS: u32 = 8;
/// Lattice units per pixel.
pub const UNIT: i32 = 1 << SUB_BITS;
/// Longest side of a raster in pixels for which the predicates stay exact.
pub const MAX_SIDE: usize = 1 << 20;

/// A lattice point: column and row of a pixel centre times [`UNIT`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Point {
    pub x: i32,
    pub y: i32,
}

impl Point {
    /// The centre of pixel (`col`, `row`).
    pub fn pixel(col: usize, row: usize) -> Self {
        Point { x: (col as i32) << SUB_BITS, y: (row as i32) << SUB_BITS }
    }

    /// (column, row) if the point is a pixel centre.
    pub fn as_pixel(self) -> Option<(usize, usize)> {
        let on_centre = (self.x | self.y) & (UNIT - 1) == 0;
        on_centre.then_some(((self.x >> SUB_BITS) as usize, (self.y >> SUB_BITS) as usize))
    }
}

/// Twice the signed area of triangle `abc`; positive when `c` lies on the side
/// of `ab` towards which +x turns into +y.
#[inline]
pub fn orient2d(a: Point, b: Point, c: Point) -> i64 {
    let (bx, by) = ((b.x - a.x) as i64, (b.y - a.y) as i64);
    let (cx, cy) = ((c.x - a.x) as i64, (c.y - a.y) as i64);
    bx * cy - by * cx
}

/// The area in pixels of a positively oriented triangle, which is about their number.
#[inline(always)]
pub fn pixels_of([a, b, c]: [Point; 3]) -> usize {
    (orient2d(a, b, c) >> (2 * SUB_BITS + 1)) as usize
}

/// The squared ground length of a lattice step as an integer quadratic form.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Metric {
    pub e: i64,
    pub f: i64,
    pub g: i64,
}

impl Metric {
    /// Square pixels.
    pub const SQUARE: Metric = Metric { e: 1, f: 0, g: 1 };

    /// The nearest integer form to the positive definite form (`e`, `f`, `g`)
    /// that keeps [`Metric::in_circle`] free of overflow on a raster whose
    /// longest side is `side` pixels. `None` if the form is not positive definite.
    pub fn from_form(e: f64, f: f64, g: f64, side: usize) -> Option<Metric> {
        let det = e * g - f * f;
        if !(e > 0.0 && g > 0.0 && det > 0.0 && (e + g).is_finite()) {
            return None;
        }
        // With S bits a coordinate difference and K bits a coefficient, a lift needs
        // K + 2 + 2S bits (i64) and the determinant K + 5 + 4S (i128).
        let s = (usize::BITS - ((side.max(2) << SUB_BITS) - 1).leading_zeros()).min(28);
        let k = 20.min(60 - 2 * s).min(121 - 4 * s);
        let scale = ((1i64 << k) as f64) / e.max(g);
        let quantise = |v: f64| (v * scale).round() as i64;
        let (ei, gi) = (quantise(e).max(1), quantise(g).max(1));
        let mut fi = quantise(f);
        while ei * gi <= fi * fi {
            fi -= fi.signum();
        }
        let d = gcd(gcd(ei, gi), fi.abs());
        Some(Metric { e: ei / d, f: fi / d, g: gi / d })
    }

    #[inline]
    fn lift(self, dx: i64, dy: i64) -> i64 {
        // The common case, at two of seven multiplications.
        if self == Metric::SQUARE {
            return dx * dx + dy * dy;
        }
        self.e * dx * dx + 2 * self.f * dx * dy + self.g * dy * dy
    }

    /// Whether `d` lies strictly inside the circle (in this metric) through the
    /// positively oriented triangle `abc`.
    #[inline]
    pub fn in_circle(self, a: Point, b: Point, c: Point, d: Point) -> bool {
        let (ax, ay) = ((a.x - d.x) as i64, (a.y - d.y) as i64);
        let (bx, by) = ((b.x - d.x) as i64, (b.y - d.y) as i64);
        let (cx, cy) = ((c.x - d.x) as i64, (c.y - d.y) as i64);
        let wide = |lift: i64, minor: i64| i128::from(lift) * i128::from(minor);
        let det = wide(self.lift(ax, ay), bx * cy - by * cx)
            + wide(self.lift(bx, by), cx * ay - cy * ax)
            + wide(self.lift(cx, cy), ax * by - ay * bx);
        det > 0
    }
}

fn gcd(a: i64, b: i64) -> i64 {
    if b == 0 {
        a
    } else {
        gcd(b, a % b)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn p(x: i32, y: i32) -> Point {
        Point { x, y }
    }

    #[test]
    fn four_grid_corners_are_cocircular_in_any_axis_metric() {
        for (e, g) in [(1.0, 1.0), (900.0, 100.0), (0.6, 1.0)] {
            let m = Metric::from_form(e, 0.0, g, 4096).unwrap();
            let q = [p(0, 0), p(256, 0), p(256, 256), p(0, 256)];
            assert!(!m.in_circle(q[0], q[1], q[2], q[3]));
            assert!(m.in_circle(q[0], q[1], q[2], p(1, 255)));
        }
    }

    #[test]
    fn square_pixels_reduce_to_the_unit_form() {
        assert_eq!(Metric::from_form(900.0, 0.0, 900.0, 4096), Some(Metric::SQUARE));
        assert_eq!(Metric::from_form(1.0, 1.0, 1.0, 10), None);
        assert_eq!(Metric::from_form(f64::NAN, 0.0, 1.0, 10), None);
    }

    #[test]
    fn the_largest_raster_does_not_overflow() {
        let far = ((MAX_SIDE - 1) as i32) << SUB_BITS;
        for form in [(1.0, 0.0, 1.0), (1.0, 0.9, 1.0), (1e6, 0.0, 1.0)] {
            let m = Metric::from_form(form.0, form.1, form.2, MAX_SIDE).unwrap();
            assert!(m.in_circle(p(0, 0), p(far, 0), p(far, far), p(far - 1, far / 2)));
            assert!(!m.in_circle(p(0, 0), p(far, 0), p(0, far), p(far, far)) || m.f != 0);
        }
    }

    proptest! {
        #[test]
        fn in_circle_agrees_with_the_ground_circle(
            c in prop::array::uniform8(-2000i32..2000), e in 0.2f64..5.0, g in 0.2f64..5.0, r in -0.9f64..0.9,
        ) {
            let f = r * (e * g).sqrt();
            let m = Metric::from_form(e, f, g, 2048).unwrap();
            let [a, b, cc, d] = [p(c[0], c[1]), p(c[2], c[3]), p(c[4], c[5]), p(c[6], c[7])];
            prop_assume!(orient2d(a, b, cc) > 0);
            // Cholesky factor of the integer form maps lattice steps to the ground.
            let (e, f, g) = (m.e as f64, m.f as f64, m.g as f64);
            let (l11, l21) = (e.sqrt(), f / e.sqrt());
            let l22 = (g - l21 * l21).sqrt();
            let ground = |q: Point| (l11 * f64::from(q.x) + l21 * f64::from(q.y), l22 * f64::from(q.y));
            let coord = |q: Point| { let (x, y) = ground(q); robust::Coord { x, y } };
            let s = robust::incircle(coord(a), coord(b), coord(cc), coord(d));
            let size = 1e-9 * (l11 + l22).powi(4) * 4000f64.powi(4);
            if s.abs() > size { prop_assert_eq!(m.in_circle(a, b, cc, d), s > 0.0); }
        }
    }
}
