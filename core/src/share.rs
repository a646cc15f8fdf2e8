//! What a triangle adds to the normal equations of a fit.

use crate::grid::{Grid, Height};
use crate::lanes::{Kernel, Lanes, Vectors, LANES};
use crate::mesh::half_edge;
use crate::owned::{for_each_span, owns_edge};
use crate::patch::Patch;
use crate::predicate::{orient2d, Point, SUB_BITS, UNIT};
use crate::scan::Plane;
use crate::strips::{bounds, for_each_strip, Visitor};
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
struct Residual<'a, T> {
    target: &'a Grid<'a, T>,
    plane: Plane,
    /// Inverse of the unit.
    scale: f64,
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
fn owned(surface: &Surface, t: u32) -> [bool; 3] {
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
    fn of_sums([n, b, c, bb, bc, cc]: [f64; 6], values: [[f64; 4]; K]) -> Self {
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
    fn by_rows(p: [Point; 3], owned: [bool; 3], image: &impl Image<K>) -> Self {
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

    /// The same of the heights over the surface, in some unit; `patch`: the heights around it, if there are some.
    #[inline]
    pub fn of_heights<T: Height>(
        surface: &Surface,
        t: u32,
        (target, unit): (&Grid<T>, f64),
        patch: Option<&Patch>,
    ) -> Self {
        let (p, z, owned) = (surface.mesh.corners(t), surface.heights(t), owned(surface, t));
        let seen = patch.and_then(|patch| Share::by_strips(p, z, owned, (patch, unit), Vectors::best()));
        let over = || Residual { target, plane: Plane::through(p, z), scale: 1.0 / unit };
        seen.unwrap_or_else(|| Share::by_rows(p, owned, &over()))
    }

    /// The same, eight pixels at a time and in single precision, of what a patch holds; `None` if there are voids
    /// or the triangle is too large.
    #[inline]
    pub fn by_strips(
        p: [Point; 3],
        z: [f64; 3],
        owned: [bool; 3],
        (patch, unit): (&Patch, f64),
        vectors: Vectors,
    ) -> Option<Self> {
        let p = p.map(|p| patch.local(p));
        let [left, top, right, bottom] = bounds(p);
        if right - left >= MAX_SIDE || bottom - top >= MAX_SIDE {
            return None;
        }
        let z = z.map(|z| z - patch.reference());
        let base = z[0] as f32;
        let plane = Plane::through(p, z.map(|z| z - f64::from(base)));
        let triangle = OverPatch { p, plane, base, owned, patch };
        let [n, b, c, bb, bc, cc, all, of_b, of_c, squares, ..] = vectors.run(triangle).map(f64::from);
        let [p0, p1, p2] = lattice(p).0;
        let (scale, per_unit) = (1.0 / orient2d(p0, p1, p2) as f64, 1.0 / unit);
        let hats = [n, b * scale, c * scale, bb * scale * scale, bc * scale * scale, cc * scale * scale];
        let values = [all, of_b * scale, of_c * scale, squares * per_unit].map(|sum| sum * per_unit);
        let mut share = Share::of_sums(hats, [values]);
        for k in 0..3 {
            // A pixel that is a corner is the triangle's if both edges there are. Whether it is can not be foreseen: no branch.
            let is_own = owned[k] & owned[(k + 2) % 3];
            if let Some((col, row)) = p[k].as_pixel() {
                let height = f64::from(patch.z(row * patch.stride() + col));
                let value = if is_own { ((height - z[k]) * per_unit) as f32 } else { 0.0 };
                share.corners[k] -= f32::from(u8::from(is_own));
                share.sides[k][0] -= value;
                share.squares[0] = (share.squares[0] - value * value).max(0.0);
            }
        }
        (!squares.is_nan()).then_some(share)
    }
}

/// With sides in pixels up to this the edge functions fit 32 bits, those of the pixels of a strip beside the
/// triangle included, and sums of single precision are good enough.
const MAX_SIDE: i32 = 110;

/// A triangle over a patch: its pixels are where no edge function is negative (Pineda 1988), and
/// these are the hats but for a factor.
struct OverPatch<'a> {
    /// Corners in the patch.
    p: [Point; 3],
    /// The surface over the height of the first corner, and that in the patch.
    plane: Plane,
    base: f32,
    owned: [bool; 3],
    patch: &'a Patch,
}

impl Kernel for OverPatch<'_> {
    type Output = [f32; 12];

    #[inline(always)]
    fn run<L: Lanes>(self) -> [f32; 12] {
        let (patch, p) = (self.patch, self.p);
        let none = L::splat(0.0);
        let (corners, bits) = lattice(p);
        let sums = Sums::<L> { triangle: &self, corners, bits, sums: [none; 10] };
        let [s0, s1, s2, s3, s4, s5, s6, s7, s8, s9] = for_each_strip(p, patch, sums).sums;
        let (first, second) = (L::sums([s0, s1, s2, s3]), L::sums([s4, s5, s6, s7]));
        let third = L::sums([s8, s9, none, none]);
        let mut sums = [0.0; 12];
        for k in 0..4 {
            (sums[k], sums[4 + k], sums[8 + k]) = (first[k], second[k], third[k]);
        }
        sums
    }
}

/// The corners with so many bits below the pixel as they need: on pixels none.
#[inline(always)]
fn lattice(p: [Point; 3]) -> ([Point; 3], u32) {
    let [a, b, c] = p;
    if (a.x | a.y | b.x | b.y | c.x | c.y) & (UNIT - 1) == 0 {
        (p.map(|p| Point { x: p.x >> SUB_BITS, y: p.y >> SUB_BITS }), 0)
    } else {
        (p, SUB_BITS)
    }
}

struct Sums<'a, L: Lanes> {
    triangle: &'a OverPatch<'a>,
    corners: [Point; 3],
    bits: u32,
    sums: [L::F; 10],
}

impl<L: Lanes> Visitor<L> for Sums<'_, L> {
    #[inline(always)]
    fn strip<'h>(&mut self, col: i32, row: i32, rows: impl Iterator<Item = &'h [f32; LANES]>) {
        let OverPatch { plane, base, owned, .. } = self.triangle;
        let (x, y) = (col << self.bits, row << self.bits);
        // A pixel on a border that is another's is outside.
        let borders = owned.map(|is_owned| i32::from(!is_owned));
        let edge = |k: usize| {
            let (a, b) = (self.corners[k], self.corners[(k + 1) % 3]);
            let (dx, dy) = (b.x - a.x, b.y - a.y);
            let start = dx * (y - a.y) - dy * (x - a.x) - borders[k];
            (L::ramp(start, -dy << self.bits), L::splat_i(dx << self.bits))
        };
        let [(mut e0, down0), (mut e1, down1), (mut e2, down2)] = [edge(0), edge(1), edge(2)];
        let (border0, border2) = (L::splat_i(borders[0]), L::splat_i(borders[2]));
        let start = L::splat(plane.at(plane.on_row(row as usize), col as usize) as f32);
        let across = L::mul(L::splat(plane.per_col as f32), L::to_f(L::ramp(0, 1)));
        let (mut level, slope) = (L::add(start, across), L::splat(plane.per_row as f32));
        let (base, none, one) = (L::splat(*base), L::splat(0.0), L::splat(1.0));
        let [mut n, mut n_b, mut n_c, mut bb, mut bc, mut cc, mut all, mut of_b, mut of_c, mut squares] =
            self.sums;
        for heights in rows {
            let outside = L::or_i(L::or_i(e0, e1), e2);
            let value = L::where_negative(outside, none, L::sub(L::sub(L::load(heights), base), level));
            let b = L::where_negative(outside, none, L::to_f(L::add_i(e2, border2)));
            let c = L::where_negative(outside, none, L::to_f(L::add_i(e0, border0)));
            n = L::add(n, L::where_negative(outside, none, one));
            (n_b, n_c) = (L::add(n_b, b), L::add(n_c, c));
            (bb, bc, cc) = (L::add(bb, L::mul(b, b)), L::add(bc, L::mul(b, c)), L::add(cc, L::mul(c, c)));
            all = L::add(all, value);
            (of_b, of_c) = (L::add(of_b, L::mul(value, b)), L::add(of_c, L::mul(value, c)));
            squares = L::add(squares, L::mul(value, value));
            (e0, e1, e2) = (L::add_i(e0, down0), L::add_i(e1, down1), L::add_i(e2, down2));
            level = L::add(level, slope);
        }
        self.sums = [n, n_b, n_c, bb, bc, cc, all, of_b, of_c, squares];
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SIDE: usize = 40;

    /// A positively oriented triangle in the raster, on pixels or between them.
    fn triangle(c: [i32; 6], on_pixels: bool) -> Option<[Point; 3]> {
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
    fn by_pixels(z: &[f32], p: [Point; 3], heights: [f64; 3], owned: [bool; 3]) -> [f64; 10] {
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

    fn numbers(share: &Share<1>) -> [f64; 10] {
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
        fn strips_and_rows_sum_up_the_pixels_owned(
            c in prop::array::uniform6(0i32..((SIDE as i32 - 1) << SUB_BITS)), on_pixels: bool, owned: [bool; 3],
            mut z in prop::collection::vec(-50.0f32..50.0, SIDE * SIDE), heights in prop::array::uniform3(-50.0..50.0),
            void in prop::option::of(0..SIDE * SIDE), level in prop_oneof![Just(0.0f32), Just(4000.0)], unit in prop_oneof![Just(1.0), Just(64.0)],
        ) {
            let Some(p) = triangle(c, on_pixels) else { return Ok(()) };
            z.iter_mut().for_each(|z| *z += level);
            if let Some(pixel) = void { z[pixel] = f32::NAN; }
            let heights = heights.map(|z: f64| z + f64::from(level));
            let grid = Grid::new(&z, SIDE, SIDE).unwrap();
            let mut expected = by_pixels(&z, p, heights, owned);
            expected[6..9].iter_mut().for_each(|side| *side /= unit);
            expected[9] /= unit * unit;
            let residual = Residual { target: &grid, plane: Plane::through(p, heights), scale: 1.0 / unit };
            let rows = Share::by_rows(p, owned, &residual);
            let patch = Patch::near(&grid, std::iter::once([Point::pixel(0, 0), Point::pixel(39, 0), Point::pixel(39, 39), Point::pixel(0, 39)]), heights[0]).unwrap();
            let strips = Share::by_strips(p, heights, owned, (&patch, unit), Vectors::best());
            for vectors in Vectors::all() {
                prop_assert_eq!(strips, Share::by_strips(p, heights, owned, (&patch, unit), vectors));
            }
            prop_assert!(strips.is_some() || void.is_some());
            // Single precision steps across a steep sliver with errors of the size of its slope, and what it takes
            // off for the corners it has added before.
            let Plane { per_col, per_row, .. } = residual.plane;
            let slip = 2e-5 * (1.0 + (per_col.abs() + per_row.abs()) / unit);
            let at_corner = |k: usize| p[k].as_pixel().map_or(0.0, |(col, row)| {
                let over = f64::from(z[row * SIDE + col]) - heights[k];
                if over.is_nan() { 0.0 } else { (over / unit).powi(2) }
            });
            let n = 3.0 + expected[..6].iter().sum::<f64>();
            let squares = expected[9] + at_corner(0) + at_corner(1) + at_corner(2);
            let slips = |k: usize| if k < 9 { n * slip } else { slip * (n * slip + 2.0 * (n * squares).sqrt()) };
            for share in [Some(rows), strips].into_iter().flatten() {
                for (k, (found, expected)) in numbers(&share).into_iter().zip(expected).enumerate() {
                    let of_values = if k < 6 { 0.0 } else { slips(k) };
                    prop_assert!((found - expected).abs() <= 2e-5 * (1.0 + expected.abs()) + of_values, "{} {} {}", k, found, expected);
                }
            }
        }

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
