//! A mesh in the order of a space-filling curve: what is near on the ground gets near in
//! memory, which the passes over all triangles repay several times.

use crate::curve::curve_position;
use crate::error::Result;
use crate::memory;
use crate::mesh::{half_edge, triangle_of, Mesh, Triangle, NONE};
use crate::predicate::{Point, SUB_BITS};
use crate::progress::Progress;
use crate::surface::Surface;
use std::ops::Range;

/// Position along the curve of the pixel that holds the centroid.
fn place_of([a, b, c]: [Point; 3]) -> u64 {
    let mean = |a: i32, b: i32, c: i32| ((i64::from(a) + i64::from(b) + i64::from(c)) / 3) as u64 >> SUB_BITS;
    curve_position(mean(a.x, b.x, c.x), mean(a.y, b.y, c.y))
}

/// Sorts by place, what has the same one staying in its order; digit by digit from the last.
fn sorted_by_place(mut order: Vec<(u64, u32)>) -> Vec<(u64, u32)> {
    const BITS: u32 = 11;
    let digit = |place: u64, shift: u32| (place >> shift) as usize & ((1 << BITS) - 1);
    let highest = order.iter().fold(0, |bits, (place, _)| bits | place);
    let mut other = vec![(0, 0); order.len()];
    for shift in (0..u64::BITS - highest.leading_zeros()).step_by(BITS as usize) {
        let mut next = [0; 1 << BITS];
        order.iter().for_each(|&(place, _)| next[digit(place, shift)] += 1);
        let mut end = 0;
        for next in &mut next {
            (*next, end) = (end, end + *next);
        }
        for &entry in &order {
            let next = &mut next[digit(entry.0, shift)];
            other[*next] = entry;
            *next += 1;
        }
        std::mem::swap(&mut order, &mut other);
    }
    order
}

/// Sorts the triangles along the curve, and the vertices by the first triangle that
/// uses them. Returns the vertices' new numbers. Errors: `out-of-memory`, `cancelled`.
pub fn by_place(surface: &mut Surface, progress: &mut Progress) -> Result<Vec<u32>> {
    let mesh = &surface.mesh;
    let count = mesh.triangles().len() as u32;
    memory::ensure(80 * mesh.triangles().len() + 48 * mesh.points().len())?;
    let order: Vec<(u64, u32)> = (0..count).map(|t| (place_of(mesh.corners(t)), t)).collect();
    progress.check(0.0)?;
    let order = sorted_by_place(order);
    progress.check(0.0)?;
    let mut new_triangle = vec![0; count as usize];
    for (new, &(_, old)) in order.iter().enumerate() {
        new_triangle[old as usize] = new as u32;
    }
    let vertices = mesh.points().len();
    let mut new_vertex = vec![NONE; vertices];
    let mut old_vertex: Vec<u32> = Vec::with_capacity(vertices);
    let mut renumber = |v: u32| {
        let number = &mut new_vertex[v as usize];
        if *number == NONE {
            *number = old_vertex.len() as u32;
            old_vertex.push(v);
        }
        *number
    };
    let move_twin = |h: u32| {
        if h == NONE {
            NONE
        } else {
            half_edge(new_triangle[triangle_of(h) as usize], h & 3)
        }
    };
    let mut triangles: Vec<Triangle> = Vec::with_capacity(order.len());
    for &(_, old) in &order {
        triangles.push(mesh.triangle(old).renumbered(&mut renumber, move_twin));
        progress.poll(16, || triangles.len() as f64 / order.len() as f64)?;
    }
    let points = old_vertex.iter().map(|&v| mesh.point(v)).collect();
    surface.z = old_vertex.iter().map(|&v| surface.z[v as usize]).collect();
    surface.is_fixed = old_vertex.iter().map(|&v| surface.is_fixed[v as usize]).collect();
    surface.mesh.replace(points, triangles);
    Ok(new_vertex)
}

/// Runs of triangles in the order of the curve, about one for each of many squares of one size: what is worked on
/// together, since its surroundings are small.
pub fn runs(mesh: &Mesh) -> Vec<Range<usize>> {
    const FEWEST: usize = 1 << 7;
    const USUAL: usize = 1 << 10;
    const MOST: usize = 1 << 12;
    /// One of so many triangles is looked at, and others where these differ.
    const STEP: usize = 1 << 4;
    let (count, points) = (mesh.triangles().len(), mesh.points());
    let end = points.iter().fold((0, 0), |end, p| (p.x.max(end.0), p.y.max(end.1)));
    let pixels = (end.0 >> SUB_BITS) as f64 * (end.1 >> SUB_BITS) as f64;
    // Two bits of the place for each doubling of the side.
    let bits = 2 * (pixels * USUAL as f64 / count.max(1) as f64).sqrt().max(1.0).log2().round() as u32;
    let square = |t: usize| place_of(mesh.corners(t as u32)) >> bits;
    let (mut runs, mut start, mut last) = (Vec::new(), 0, 0);
    for t in (0..count).step_by(STEP).chain([count - 1]) {
        let here = square(t);
        if square(last) != here && t - start >= FEWEST || t - start >= MOST {
            let end = (last + 1..t).find(|&t| square(t) == here).unwrap_or(t);
            runs.push(start..end);
            start = end;
        }
        last = t;
    }
    runs.push(start..count);
    runs
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn places_are_sorted_as_by_comparison(
            places in prop::collection::vec(prop_oneof![0u64..50, 0u64..1 << 40, any::<u64>()], 0..300),
        ) {
            let order: Vec<(u64, u32)> = places.into_iter().zip(0..).collect();
            let mut expected = order.clone();
            expected.sort();
            prop_assert_eq!(sorted_by_place(order), expected);
        }
    }
}
