//! What the flips of edges do to the surface, eight at a time.

use crate::grid::{Grid, Height};
use crate::lanes::{Kernel, Lanes, Vectors, LANES};
use crate::owned::for_each_span;
use crate::patch::Patch;
use crate::predicate::{SUB_BITS, UNIT};
use crate::quads::{Doubles, Ints, Quads, Shape, PIXEL};
use crate::strips::{for_each_strip, Visitor};
use std::ops::Range;

/// What single precision may be off, as a part of the heights involved.
const ROUNDING: f64 = 1.0 / (1 << 20) as f64;

const EXACT_ROUNDING: f64 = 1e-12;

/// A face is up to so many times as high over the quadrilateral as the pyramid.
const THINNEST: f64 = 64.0;

/// By how much the flips lower the sums of squared errors, if that is more than rounding can make of it.
#[inline]
pub fn gains<T: Height>(
    quads: &Quads,
    target: &Grid<T>,
    patch: Option<&Patch>,
    vectors: Vectors,
) -> [Option<f64>; LANES] {
    let mut pyramids = Pyramids::default();
    let reference = patch.map_or(0.0, Patch::reference);
    let seen = vectors.run(OverPatch { quads, pyramids: &mut pyramids, reference, patch });
    let mut gains = [None; LANES];
    for i in 0..quads.count.min(LANES) {
        let (height, over) = (pyramids.height[i], quads.z[0][i] - reference);
        let (gain, rounding) = if seen[i].is_finite() {
            let largest = patch.map_or(0.0, Patch::largest);
            (f64::from(seen[i]), ROUNDING * (largest + over.abs() + height))
        } else {
            (
                pyramids.gain_by_rows(quads, i, target, reference),
                EXACT_ROUNDING * (quads.z[0][i].abs() + height),
            )
        };
        gains[i] = (height > 0.0 && gain > rounding * pyramids.volume[i]).then_some(gain);
    }
    gains
}

/// Over a quadrilateral the surfaces that bend along the one diagonal and along the other are the two sides of a
/// tetrahedron, so that a flip adds or takes off a pyramid: nothing on the border, and most where the diagonals cross.
#[derive(Default)]
struct Pyramids {
    /// First column and row of the pixels in the bounds, last column and row.
    bounds: [Ints; 4],
    /// Functions of the pixels: at the first one of the bounds, what they gain a column and a row. The least of the first four is
    /// the pyramid: within the quadrilateral, outside it is negative. The larger of the last two is twice the surface as it
    /// is over the reference, or the negative of that where the flip lowers it.
    at: [Doubles; 6],
    across: [Doubles; 6],
    down: [Doubles; 6],
    /// 2 if the flip lifts the surface, -2 if it lowers it.
    twice: Doubles,
    /// Its height, not negative, and its volume.
    height: Doubles,
    volume: Doubles,
    /// Whether some face is so steep that single precision does not tell where it ends.
    is_thin: [bool; LANES],
}

impl Pyramids {
    #[inline(always)]
    fn raise(&mut self, quads: &Quads, reference: f64) {
        for i in 0..LANES {
            let low = |v: &[Ints; 4]| (v[0][i].min(v[1][i]).min(v[2][i].min(v[3][i])) + UNIT - 1) >> SUB_BITS;
            let high = |v: &[Ints; 4]| v[0][i].max(v[1][i]).max(v[2][i].max(v[3][i])) >> SUB_BITS;
            self.bounds[0][i] = low(&quads.x);
            self.bounds[1][i] = low(&quads.y);
            self.bounds[2][i] = high(&quads.x);
            self.bounds[3][i] = high(&quads.y);
        }
        for i in 0..LANES {
            let Shape { x, y, right, left, near, far, lift } = quads.shape(i);
            // From the first corner to the first pixel.
            let to_x = f64::from(self.bounds[0][i]) - f64::from(quads.x[0][i]) * PIXEL;
            let to_y = f64::from(self.bounds[1][i]) - f64::from(quads.y[0][i]) * PIXEL;
            let sign = if lift < 0.0 { -1.0 } else { 1.0 };
            let (height, area) = (lift.abs(), near + far);
            let scale = height * area;
            for (k, product) in [near * right, far * right, far * left, near * left].into_iter().enumerate() {
                let (factor, next) = (scale / product, (k + 1) % 4);
                let (dx, dy) = ((x[next] - x[k]) * factor, (y[next] - y[k]) * factor);
                self.at[k][i] = dy * (x[k] - to_x) - dx * (y[k] - to_y);
                self.across[k][i] = -dy;
                self.down[k][i] = dx;
            }
            let twice = 2.0 * sign;
            let z = |k: usize| twice * (quads.z[k][i] - quads.z[0][i]);
            for (f, a, b, area) in [(4, 1, 2, right), (5, 2, 3, left)] {
                let across = (z(a) * y[b] - z(b) * y[a]) / area;
                let down = (z(b) * x[a] - z(a) * x[b]) / area;
                self.at[f][i] = twice * (quads.z[0][i] - reference) + across * to_x + down * to_y;
                self.across[f][i] = across;
                self.down[f][i] = down;
            }
            self.twice[i] = twice;
            self.height[i] = height;
            self.volume[i] = scale / 6.0;
            self.is_thin[i] = near.min(far).min(right.min(left)) * THINNEST < area;
        }
    }

    /// Row by row and in double precision.
    fn gain_by_rows<T: Height>(&self, quads: &Quads, i: usize, target: &Grid<T>, reference: f64) -> f64 {
        let p = quads.corners(i);
        let (col0, row0) = (f64::from(self.bounds[0][i]), f64::from(self.bounds[1][i]));
        let mut gain = 0.0;
        // The diagonal's pixels are those of one triangle; there is nothing to see on the border.
        let triangles = [([p[0], p[1], p[2]], [false; 3]), ([p[2], p[3], p[0]], [false, false, true])];
        for (p, owned) in triangles {
            for_each_span(p, owned, |row, first, end| {
                for (col, height) in (first..end).zip(&target.row(row)[first..end]) {
                    let [x, y] = [col as f64 - col0, row as f64 - row0];
                    let at = |k: usize| self.at[k][i] + self.across[k][i] * x + self.down[k][i] * y;
                    let change = at(0).min(at(1)).min(at(2).min(at(3))).max(0.0);
                    let error = self.twice[i] * (height.to_f64() - reference) - at(4).max(at(5));
                    if !error.is_nan() {
                        gain += change * (error - change);
                    }
                }
            });
        }
        gain
    }
}

/// Pyramids over a patch, if there is one.
struct OverPatch<'a> {
    quads: &'a Quads,
    pyramids: &'a mut Pyramids,
    reference: f64,
    patch: Option<&'a Patch>,
}

impl Kernel for OverPatch<'_> {
    /// The gains, NaN with a void or where single precision does not do.
    type Output = [f32; LANES];

    #[inline(always)]
    fn run<L: Lanes>(self) -> [f32; LANES] {
        let OverPatch { quads, pyramids, reference, patch } = self;
        pyramids.raise(quads, reference);
        let mut gains = [f32::NAN; LANES];
        let Some(patch) = patch else { return gains };
        let first = patch.first();
        let (first_col, first_row) = (first.x >> SUB_BITS, first.y >> SUB_BITS);
        let none = L::splat(0.0);
        for (i, gain) in gains.iter_mut().enumerate().take(quads.count) {
            if pyramids.is_thin[i] {
                continue;
            }
            let [left, top, right, bottom] = [0, 1, 2, 3].map(|k| pyramids.bounds[k][i]);
            let bounds = [left - first_col, top - first_row, right - first_col, bottom - first_row];
            let p = quads.corners(i).map(|p| patch.local(p));
            let sum = Sum::<L> { pyramids, i, bounds, gain: none };
            [*gain, ..] = L::sums([for_each_strip(p, bounds, patch, sum).gain, none, none, none]);
        }
        gains
    }
}

struct Sum<'a, L: Lanes> {
    pyramids: &'a Pyramids,
    i: usize,
    /// In the patch.
    bounds: [i32; 4],
    gain: L::F,
}

impl<L: Lanes> Visitor<L> for Sum<'_, L> {
    #[inline(always)]
    fn strip<'h>(&mut self, col: i32, rows: Range<i32>, heights: impl Iterator<Item = &'h [f32; LANES]>) {
        let (Pyramids { at, across, down, twice, .. }, i) = (self.pyramids, self.i);
        let (x, y) = (f64::from(col - self.bounds[0]), f64::from(rows.start - self.bounds[1]));
        let ramp = L::to_f(L::ramp(0, 1));
        // Each in single precision: at the first pixels, and what it gains a row.
        let (mut f, mut steps) = ([ramp; 6], [ramp; 6]);
        for k in 0..6 {
            let first = (at[k][i] + across[k][i] * x + down[k][i] * y) as f32;
            f[k] = L::add(L::splat(first), L::mul(L::splat(across[k][i] as f32), ramp));
            steps[k] = L::splat(down[k][i] as f32);
        }
        let [mut f0, mut f1, mut f2, mut f3, mut s0, mut s1] = f;
        let (twice, none) = (L::splat(twice[i] as f32), L::splat(0.0));
        let mut gain = self.gain;
        for heights in heights {
            let change = L::max(L::min(L::min(f0, f1), L::min(f2, f3)), none);
            // Twice the error, which counts within the quadrilateral alone.
            let error = L::sub(L::mul(L::load(heights), twice), L::max(s0, s1));
            let gained = L::mul(change, L::sub(error, change));
            gain = L::add(gain, L::choose(L::greater(change, none), gained, none));
            (f0, f1) = (L::add(f0, steps[0]), L::add(f1, steps[1]));
            (f2, f3) = (L::add(f2, steps[2]), L::add(f3, steps[3]));
            (s0, s1) = (L::add(s0, steps[4]), L::add(s1, steps[5]));
        }
        self.gain = gain;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::predicate::{orient2d, Point};
    use proptest::prelude::*;

    const SIDE: usize = 40;

    /// The sum of squared errors of two triangles, each pixel once.
    fn squares(z: &[f32], triangles: [([Point; 3], [f64; 3]); 2]) -> f64 {
        let pixels = (0..z.len()).filter(|&i| !z[i].is_nan()).filter_map(|i| {
            let q = Point::pixel(i % SIDE, i / SIDE);
            triangles.iter().find_map(|(p, heights)| {
                let edges = [0, 1, 2].map(|k| orient2d(p[(k + 1) % 3], p[(k + 2) % 3], q));
                let area = orient2d(p[0], p[1], p[2]) as f64;
                let height: f64 = (0..3).map(|k| edges[k] as f64 / area * heights[k]).sum();
                edges.iter().all(|&e| e >= 0).then_some(height - f64::from(z[i]))
            })
        });
        pixels.map(|error| error * error).sum()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(3000))]
        #[test]
        fn a_flip_gains_the_difference_of_the_squares(
            c in prop::array::uniform8(0i32..((SIDE as i32 - 1) << SUB_BITS)), on_pixels: bool,
            mut z in prop::collection::vec(-50.0f32..50.0, SIDE * SIDE), heights in prop::array::uniform4(-50.0..50.0),
            void in prop::option::of(0..SIDE * SIDE),
        ) {
            let snap = |v: i32| if on_pixels { v >> SUB_BITS << SUB_BITS } else { v };
            let p = [0, 1, 2, 3].map(|i| Point { x: snap(c[2 * i]), y: snap(c[2 * i + 1]) });
            if orient2d(p[0], p[1], p[2]) <= 0 || orient2d(p[2], p[3], p[0]) <= 0 { return Ok(()) }
            let convex = orient2d(p[3], p[0], p[1]) > 0 && orient2d(p[3], p[1], p[2]) > 0;
            let mut quads = Quads::default();
            // Beside another one.
            quads.push([Point::pixel(3, 5), Point::pixel(30, 2), Point::pixel(33, 37), Point::pixel(1, 30)], [1.0; 4]);
            quads.push(p, heights);
            for vectors in Vectors::all() {
                prop_assert_eq!(quads.may_gain(vectors) >> 1, u32::from(convex && quads.shape(1).lift != 0.0));
            }
            if !convex { return Ok(()) }
            if let Some(pixel) = void { z[pixel] = f32::NAN; }
            let of = |k: [usize; 3]| (k.map(|k| p[k]), k.map(|k| heights[k]));
            let (now, flipped) = (squares(&z, [of([0, 1, 2]), of([2, 3, 0])]), squares(&z, [of([3, 0, 1]), of([3, 1, 2])]));
            let grid = Grid::new(&z, SIDE, SIDE).unwrap();
            let corners = [Point::pixel(0, 0), Point::pixel(39, 0), Point::pixel(39, 39), Point::pixel(0, 39)];
            let patch = Patch::near(&grid, std::iter::once(corners), heights[0]);
            let gain = |patch: Option<&Patch>, vectors| gains(&quads, &grid, patch, vectors)[1];
            let gains = [gain(patch.as_ref(), Vectors::Plain), gain(None, Vectors::best())];
            for vectors in Vectors::all() {
                let gain = gain(patch.as_ref(), vectors);
                prop_assert_eq!(gain.map(f64::to_bits), gains[0].map(f64::to_bits));
            }
            let near = 1e-4 * (now + flipped) + 0.1;
            for gain in gains {
                match gain {
                    Some(gain) => prop_assert!((gain - (now - flipped)).abs() <= near, "{} {}", gain, now - flipped),
                    None => prop_assert!(now - flipped <= near, "{} {}", now, flipped),
                }
            }
        }
    }

    #[test]
    fn a_level_or_planar_quadrilateral_gains_nothing() {
        // Planar but for the rounding of the raster itself.
        let z: Vec<f32> =
            (0..SIDE * SIDE).map(|i| 0.1 * (i % SIDE) as f32 + 9.7 * (i / SIDE) as f32).collect();
        let grid = Grid::new(&z, SIDE, SIDE).unwrap();
        let p = [Point::pixel(3, 5), Point::pixel(30, 2), Point::pixel(33, 37), Point::pixel(1, 30)];
        let height = |p: Point| f64::from(z[(p.y >> SUB_BITS) as usize * SIDE + (p.x >> SUB_BITS) as usize]);
        let patch = Patch::near(&grid, std::iter::once(p), 0.0);
        let mut quads = Quads::default();
        quads.push(p, p.map(height));
        assert_eq!(gains(&quads, &grid, patch.as_ref(), Vectors::best()), [None; LANES]);
    }
}
