//! What a triangle adds to the normal equations of a fit.

use crate::grid::{Grid, Height};
use crate::mesh::half_edge;
use crate::owned::{for_each_span, owns_edge};
use crate::predicate::Point;
use crate::scan::Plane;
use crate::surface::Surface;

/// Sums over the pixels that a triangle owns, those of its corners left out. A hat is the function that is 1
/// at one corner and 0 at the others; `K` values of each pixel are to be fitted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Share<const K: usize> {
    /// Of each hat squared.
    pub corners: [f32; 3],
    /// Of the products of the hats at the two ends of each edge.
    pub edges: [f32; 3],
    /// Of the products of each hat and the values.
    pub sides: [[f32; K]; 3],
    /// Of each value squared.
    pub squares: [f32; K],
}

/// An image with `K` values a pixel.
pub trait Image<const K: usize> {
    /// The values on `row` from column `first` on, those in voids NaN. Must be `#[inline(always)]`.
    fn pixels(&self, row: usize, first: usize, end: usize) -> impl Iterator<Item = [f64; K]>;
}

/// How far the heights of a raster lie over a plane.
pub struct Residual<'a, T> {
    pub target: &'a Grid<'a, T>,
    pub plane: Plane,
    /// Inverse of the unit.
    pub scale: f64,
}

impl<T: Height> Image<1> for Residual<'_, T> {
    #[inline(always)]
    fn pixels(&self, row: usize, first: usize, end: usize) -> impl Iterator<Item = [f64; 1]> {
        let on_row = self.plane.on_row(row);
        let heights = self.target.row(row)[first..end].iter();
        (first..end)
            .zip(heights)
            .map(move |(col, z)| [(z.to_f64() - self.plane.at(on_row, col)) * self.scale])
    }
}

/// The edges of a triangle whose pixels are its own.
#[inline(always)]
pub fn owned(surface: &Surface, t: u32) -> [bool; 3] {
    let owns = |k: u32| owns_edge(&surface.mesh, half_edge(t, k));
    [owns(0), owns(1), owns(2)]
}

impl<const K: usize> Share<K> {
    /// Of a triangle without pixels.
    pub const NONE: Self =
        Share { corners: [0.0; 3], edges: [0.0; 3], sides: [[0.0; K]; 3], squares: [0.0; K] };

    /// From the sums of 1, of the hats of the second and third corner and of their products (b b, b c, c c), and
    /// those of each value times 1, both hats and itself.
    #[inline(always)]
    pub fn of_sums([n, b, c, bb, bc, cc]: [f64; 6], values: [[f64; 4]; K]) -> Self {
        // The three hats add up to 1.
        let (ab, ac) = (b - bb - bc, c - bc - cc);
        let aa = n - b - c - ab - ac;
        let mut share = Share::NONE;
        share.corners = [aa, bb, cc].map(|sum| sum as f32);
        share.edges = [ab, bc, ac].map(|sum| sum as f32);
        for (k, [all, of_b, of_c, squares]) in values.into_iter().enumerate() {
            let sides = [all - of_b - of_c, of_b, of_c];
            share.sides.iter_mut().zip(sides).for_each(|(side, sum)| side[k] = sum as f32);
            share.squares[k] = squares as f32;
        }
        share
    }

    /// Of triangle `t`, and void ones nothing.
    pub fn of(surface: &Surface, t: u32, image: &impl Image<K>) -> Self {
        if surface.mesh.triangle(t).is_void() {
            return Share::NONE;
        }
        Share::by_rows(surface.mesh.corners(t), owned(surface, t), image)
    }

    /// Row by row and in double precision, pixels with NaN left out; for triangles of any size.
    pub fn by_rows(p: [Point; 3], owned: [bool; 3], image: &impl Image<K>) -> Self {
        let (b, c) = (Plane::through(p, [0.0, 1.0, 0.0]), Plane::through(p, [0.0, 0.0, 1.0]));
        let (mut hats, mut sums) = ([0.0; 6], [[0.0; 4]; K]);
        for_each_span(p, owned, |row, first, end| {
            let (b_on_row, c_on_row) = (b.on_row(row), c.on_row(row));
            for (col, values) in (first..end).zip(image.pixels(row, first, end)) {
                if values.iter().any(|value| value.is_nan()) {
                    continue;
                }
                let (b, c) = (b.at(b_on_row, col), c.at(c_on_row, col));
                let products = [1.0, b, c, b * b, b * c, c * c];
                hats.iter_mut().zip(products).for_each(|(sum, product)| *sum += product);
                for (sums, value) in sums.iter_mut().zip(values) {
                    let products = [value, value * b, value * c, value * value];
                    sums.iter_mut().zip(products).for_each(|(sum, product)| *sum += product);
                }
            }
        });
        Share::of_sums(hats, sums)
    }
}

impl Share<1> {
    /// What it becomes when the heights of its corners change.
    #[inline]
    pub fn follow(&mut self, changes: [f32; 3]) {
        let [a, b, c] = changes;
        let ([aa, bb, cc], [ab, bc, ac]) = (self.corners, self.edges);
        let images = [aa * a + ab * b + ac * c, ab * a + bb * b + bc * c, ac * a + bc * b + cc * c];
        for ((side, image), change) in self.sides.iter_mut().zip(images).zip([a, b, c]) {
            self.squares[0] += change * (image - 2.0 * side[0]);
            side[0] -= image;
        }
        // Only all three together leave a sum of squares.
        self.squares[0] = self.squares[0].max(0.0);
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::predicate::{orient2d, SUB_BITS};
    use proptest::prelude::*;

    pub const SIDE: usize = 40;

    /// A positively oriented triangle in the raster, on pixels or between them.
    pub fn triangle(c: [i32; 6], on_pixels: bool) -> Option<[Point; 3]> {
        let snap = |v: i32| if on_pixels { v >> SUB_BITS << SUB_BITS } else { v };
        let mut p = [0, 1, 2].map(|i| Point { x: snap(c[2 * i]), y: snap(c[2 * i + 1]) });
        match orient2d(p[0], p[1], p[2]) {
            0 => return None,
            area if area < 0 => p.swap(1, 2),
            _ => {}
        }
        Some(p)
    }

    /// The same by the definition, pixel by pixel.
    pub fn by_pixels(z: &[f32], p: [Point; 3], heights: [f64; 3], owned: [bool; 3]) -> [f64; 10] {
        let area = orient2d(p[0], p[1], p[2]) as f64;
        let mut sums = [0.0; 10];
        for (i, &height) in z.iter().enumerate() {
            let q = Point::pixel(i % SIDE, i / SIDE);
            let edges = [0, 1, 2].map(|k| orient2d(p[k], p[(k + 1) % 3], q));
            if (0..3).any(|k| edges[k] < i64::from(!owned[k])) || p.contains(&q) || height.is_nan() {
                continue;
            }
            let [a, b, c] = [edges[1], edges[2], edges[0]].map(|e| e as f64 / area);
            let over = f64::from(height) - a * heights[0] - b * heights[1] - c * heights[2];
            let products =
                [a * a, b * b, c * c, a * b, b * c, a * c, a * over, b * over, c * over, over * over];
            sums.iter_mut().zip(products).for_each(|(sum, product)| *sum += product);
        }
        sums
    }

    pub fn numbers(share: &Share<1>) -> [f64; 10] {
        let Share { corners: [a, b, c], edges: [ab, bc, ac], sides: [[d], [e], [f]], squares: [g] } = *share;
        [a, b, c, ab, bc, ac, d, e, f, g].map(f64::from)
    }

    #[test]
    fn squares_may_fall_below_zero_between_two_corners() {
        let p = [(0, 0), (20, 0), (0, 20)].map(|(col, row)| Point::pixel(col, row));
        let grid_z = vec![0.0f32; SIDE * SIDE];
        let grid = Grid::new(&grid_z, SIDE, SIDE).unwrap();
        let over = |z: [f64; 3]| {
            Share::by_rows(p, [true; 3], &Residual { target: &grid, plane: Plane::through(p, z), scale: 1.0 })
        };
        // The first corner alone would take off more than there is, the others add it again.
        let mut share = over([1.0; 3]);
        share.follow([-1.0, 6.0, 6.0]);
        let (found, expected) = (share.squares[0], over([0.0, 7.0, 7.0]).squares[0]);
        assert!((found - expected).abs() <= 1e-4 * expected, "{found} {expected}");
    }

    proptest! {
        #[test]
        fn a_share_follows_its_heights(
            c in prop::array::uniform6(0i32..((SIDE as i32 - 1) << SUB_BITS)), z in prop::collection::vec(-5.0f32..5.0, SIDE * SIDE),
            heights in prop::array::uniform3(-5.0..5.0), changes in prop::array::uniform3(-1.0f32..1.0),
        ) {
            let Some(p) = triangle(c, false) else { return Ok(()) };
            let grid = Grid::new(&z, SIDE, SIDE).unwrap();
            let over = |z: [f64; 3]| Share::by_rows(p, [true; 3], &Residual { target: &grid, plane: Plane::through(p, z), scale: 1.0 });
            let mut share = over(heights);
            share.follow(changes);
            let after = over([0, 1, 2].map(|k| heights[k] + f64::from(changes[k])));
            for (found, expected) in numbers(&share).into_iter().zip(numbers(&after)) {
                prop_assert!((found - expected).abs() <= 1e-4 * (10.0 + expected.abs()), "{} {}", found, expected);
            }
        }
    }
}
