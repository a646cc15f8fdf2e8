//! Lines and rings cut to the rectangle of the pixel centres.

/// Column, row (in pixels) and height of a vertex; a NaN height means none of its own.
pub type Vertex = [f64; 3];

/// Beyond this, differences of coordinates could overflow.
const FAR: f64 = 1e15;

fn near(v: Vertex) -> Vertex {
    [v[0].clamp(-FAR, FAR), v[1].clamp(-FAR, FAR), v[2]]
}

fn is_finite(v: &Vertex) -> bool {
    v[0].is_finite() && v[1].is_finite()
}

fn between(a: Vertex, b: Vertex, share: f64) -> Vertex {
    [0, 1, 2].map(|i| a[i] + share * (b[i] - a[i]))
}

/// The part of the segment within [0, `right`] x [0, `bottom`], if any (Liang and
/// Barsky 1984). None for coordinates that are not finite.
pub fn crop_segment(a: Vertex, b: Vertex, right: f64, bottom: f64) -> Option<(Vertex, Vertex)> {
    if !is_finite(&a) || !is_finite(&b) {
        return None;
    }
    let (a, b) = (near(a), near(b));
    let (mut start, mut end) = (0.0f64, 1.0f64);
    for (i, most) in [(0, right), (1, bottom)] {
        let step = b[i] - a[i];
        if step == 0.0 {
            if a[i] < 0.0 || a[i] > most {
                return None;
            }
            continue;
        }
        let (low, high) = ((0.0 - a[i]) / step, (most - a[i]) / step);
        start = start.max(low.min(high));
        end = end.min(low.max(high));
    }
    let is_inside = start <= end;
    is_inside.then(|| {
        let from = if start == 0.0 { a } else { between(a, b, start) };
        (from, if end == 1.0 { b } else { between(a, b, end) })
    })
}

/// The ring cut to the rectangle (Sutherland and Hodgman 1974); parts outside become
/// runs along its sides, so that winding numbers inside stay as they are. Empty for
/// fewer than three corners; corners that are not finite are left out.
pub fn crop_ring(ring: &[Vertex], right: f64, bottom: f64) -> Vec<Vertex> {
    let mut corners: Vec<Vertex> = ring.iter().filter(|v| is_finite(v)).map(|&v| near(v)).collect();
    if corners.first() == corners.last() {
        corners.pop();
    }
    for (i, limit, sign) in [(0, 0.0, 1.0), (0, right, -1.0), (1, 0.0, 1.0), (1, bottom, -1.0)] {
        let depth = |v: Vertex| sign * (v[i] - limit);
        let mut kept = Vec::with_capacity(corners.len());
        for (k, &to) in corners.iter().enumerate() {
            let from = corners[(k + corners.len() - 1) % corners.len()];
            let (d0, d1) = (depth(from), depth(to));
            if d0 < 0.0 && d1 > 0.0 || d0 > 0.0 && d1 < 0.0 {
                let mut cut = between(from, to, d0 / (d0 - d1));
                cut[i] = limit;
                kept.push(cut);
            }
            if d1 >= 0.0 {
                kept.push(to);
            }
        }
        corners = kept;
    }
    if corners.len() < 3 {
        corners.clear();
    }
    corners
}

/// Twice the signed area of a ring.
pub fn signed_area(ring: &[Vertex]) -> f64 {
    let next = ring.iter().cycle().skip(1);
    ring.iter().zip(next).map(|(a, b)| a[0] * b[1] - a[1] * b[0]).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn vertex() -> impl Strategy<Value = Vertex> {
        (-9.0f64..19.0, -9.0f64..19.0, -5.0f64..5.0).prop_map(|(x, y, z)| [x, y, z])
    }

    proptest! {
        #[test]
        fn a_cropped_segment_is_what_samples_of_it_say(a in vertex(), b in vertex()) {
            let inside = |v: Vertex| (0.0..=10.0).contains(&v[0]) && (0.0..=8.0).contains(&v[1]);
            let samples: Vec<Vertex> =
                (0..=1000).map(|i| between(a, b, f64::from(i) / 1000.0)).filter(|&v| inside(v)).collect();
            let step = (0..3).map(|i| (b[i] - a[i]).abs()).fold(0.0, f64::max) / 1000.0;
            match (crop_segment(a, b, 10.0, 8.0), samples.first(), samples.last()) {
                (Some((from, to)), Some(first), Some(last)) => for i in 0..3 {
                    prop_assert!((from[i] - first[i]).abs() <= step + 1e-9);
                    prop_assert!((to[i] - last[i]).abs() <= step + 1e-9);
                },
                (cropped, first, _) => prop_assert!(first.is_none(), "{cropped:?}"),
            }
        }

        #[test]
        fn a_cropped_ring_winds_around_the_same_points(
            ring in prop::collection::vec(vertex(), 3..9), x in 0.01f64..9.99, y in 0.01f64..7.99,
        ) {
            let winding = |ring: &[Vertex]| {
                let next = ring.iter().cycle().skip(1);
                ring.iter().zip(next).map(|(a, b)| {
                    let side = (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0]);
                    i32::from(a[1] <= y && b[1] > y && side > 0.0) - i32::from(a[1] > y && b[1] <= y && side < 0.0)
                }).sum::<i32>()
            };
            let cropped = crop_ring(&ring, 10.0, 8.0);
            prop_assert_eq!(winding(&cropped), winding(&ring));
            prop_assert!(cropped.iter().all(|v| (0.0..=10.0).contains(&v[0]) && (0.0..=8.0).contains(&v[1])));
        }
    }

    #[test]
    fn what_is_not_finite_or_too_small_is_left_out() {
        assert_eq!(crop_segment([f64::NAN, 0.0, 0.0], [1.0, 1.0, 0.0], 9.0, 9.0), None);
        assert!(crop_segment([-1e308, -1e308, 0.0], [1e308, 1e308, 0.0], 9.0, 9.0).is_some());
        assert!(crop_ring(&[[0.0; 3], [1.0, 1.0, 0.0]], 9.0, 9.0).is_empty());
        assert!(crop_ring(&[[20.0, 0.0, 0.0], [30.0, 1.0, 0.0], [20.0, 5.0, 0.0]], 9.0, 9.0).is_empty());
    }
}
