//! What triangles add to the normal equations of a fit of heights, eight at a time and in single precision.

use crate::facets::{Facets, Low};
use crate::lanes::{Kernel, Lanes, Vectors, LANES};
use crate::patch::Patch;
use crate::predicate::Point;
use crate::share::Share;
use crate::strips::{for_each_strip, Visitor};
use std::ops::Range;

/// A number for each of eight triangles.
type Eight = [f32; LANES];

/// Up to eight triangles over a patch, with what they own.
#[derive(Default)]
pub struct Shares {
    facets: Facets,
    /// 1 where the pixels of an edge are another triangle's.
    borders: [[i32; LANES]; 3],
    /// Of each corner whether it is a pixel of the triangle's own, 1 or 0, and how far that lies over the corner.
    own: [Eight; 3],
    over: [Eight; 3],
}

impl Shares {
    /// Takes one more triangle, if there is room: its corners with their heights and those of the image there, and the
    /// edges that it owns.
    #[inline(always)]
    pub fn push(&mut self, p: [Point; 3], [z, stands]: [[f64; 3]; 2], owned: [bool; 3]) {
        let i = self.facets.count();
        if i >= LANES {
            return;
        }
        self.facets.push(p, z);
        for k in 0..3 {
            self.borders[k][i] = i32::from(!owned[k]);
            // A pixel that is a corner is the triangle's if both edges there are. Whether it is can not be foreseen: no branch.
            let is_own = u32::from(owned[k] & owned[(k + 2) % 3] & p[k].as_pixel().is_some());
            self.own[k][i] = is_own as f32;
            self.over[k][i] = f32::from_bits(((stands[k] - z[k]) as f32).to_bits() & is_own.wrapping_neg());
        }
    }

    /// Their shares, heights in the unit; `None` where there are voids or a triangle is too large. There is room again then.
    #[inline]
    pub fn take(&mut self, patch: &Patch, unit: f64, vectors: Vectors) -> [Option<Share<1>>; LANES] {
        let shares = vectors.run(OverPatch { shares: self, patch, unit });
        self.facets.clear();
        shares
    }
}

struct OverPatch<'a> {
    shares: &'a mut Shares,
    patch: &'a Patch,
    unit: f64,
}

impl Kernel for OverPatch<'_> {
    type Output = [Option<Share<1>>; LANES];

    #[inline(always)]
    fn run<L: Lanes>(self) -> Self::Output {
        let OverPatch { shares: Shares { facets, borders, own, over }, patch, unit } = self;
        facets.make_ready::<L>(patch);
        let none = L::splat(0.0);
        let mut sums = [[0.0; LANES]; 10];
        let mut hats = [[0.0; LANES]; 6];
        let mut is_seen = [false; LANES];
        for i in 0..facets.count().min(LANES) {
            let Some(low) = facets.low(i) else { continue };
            let of_hats = low.hats();
            is_seen[i] = of_hats.iter().all(|c| c.abs() < STEEPEST);
            if !is_seen[i] {
                continue;
            }
            for k in 0..6 {
                hats[k][i] = of_hats[k];
            }
            let borders = [borders[0][i], borders[1][i], borders[2][i]];
            let visitor = Sums::<L> { low: &low, borders, sums: [none; 10] };
            let [s0, s1, s2, s3, s4, s5, s6, s7, s8, s9] =
                for_each_strip(facets.local(patch, i), low.bounds, patch, visitor).sums;
            let (first, second) = (L::sums([s0, s1, s2, s3]), L::sums([s4, s5, s6, s7]));
            let third = L::sums([s8, s9, none, none]);
            for k in 0..4 {
                (sums[k][i], sums[4 + k][i]) = (first[k], second[k]);
            }
            (sums[8][i], sums[9][i]) = (third[0], third[1]);
        }
        let mut shares = [[0.0f32; LANES]; 10];
        for i in 0..LANES {
            let of = |k: usize| f64::from(sums[k][i]);
            let (n, x, xx, y, xy, yy) = (of(0), of(1), of(2), of(3), of(4), of(5));
            let per_unit = 1.0 / unit;
            let (values, of_x, of_y, squares) = (of(6) * per_unit, of(7) * per_unit, of(8) * per_unit, of(9));
            let [b0, bx, by, c0, cx, cy] = [0, 1, 2, 3, 4, 5].map(|k| hats[k][i]);
            // The sums of a hat times 1, the column and the row.
            let of_b = [b0 * n + bx * x + by * y, b0 * x + bx * xx + by * xy, b0 * y + bx * xy + by * yy];
            let of_c = [c0 * n + cx * x + cy * y, c0 * x + cx * xx + cy * xy, c0 * y + cx * xy + cy * yy];
            let bb = b0 * of_b[0] + bx * of_b[1] + by * of_b[2];
            let bc = c0 * of_b[0] + cx * of_b[1] + cy * of_b[2];
            let cc = c0 * of_c[0] + cx * of_c[1] + cy * of_c[2];
            let sums = [
                values,
                b0 * values + bx * of_x + by * of_y,
                c0 * values + cx * of_x + cy * of_y,
                squares * per_unit * per_unit,
            ];
            let share = Share::of_sums([n, of_b[0], of_c[0], bb, bc, cc], [sums]);
            let mut squares = share.squares[0];
            for k in 0..3 {
                let value = over[k][i] * per_unit as f32;
                squares -= value * value;
                shares[k][i] = share.corners[k] - own[k][i];
                shares[3 + k][i] = share.edges[k];
                shares[6 + k][i] = share.sides[k][0] - value;
            }
            // NaN stays what it is.
            shares[9][i] = if squares < 0.0 { 0.0 } else { squares };
        }
        std::array::from_fn(|i| {
            let share = Share {
                corners: [shares[0][i], shares[1][i], shares[2][i]],
                edges: [shares[3][i], shares[4][i], shares[5][i]],
                sides: [[shares[6][i]], [shares[7][i]], [shares[8][i]]],
                squares: [shares[9][i]],
            };
            (is_seen[i] & !shares[9][i].is_nan()).then_some(share)
        })
    }
}

/// A hat that is steeper, or would be as high at the first pixel, is not told from its values times column and row in single precision.
const STEEPEST: f64 = 64.0;

/// Sums over the pixels of a triangle, of columns x from the first one of the bounds on and rows y from the last one up, that being 1:
/// of 1, x, x x, y, x y, y y, and of the values times 1, x, y and themselves.
struct Sums<'a, L: Lanes> {
    low: &'a Low,
    borders: [i32; 3],
    sums: [L::F; 10],
}

impl<L: Lanes> Visitor<L> for Sums<'_, L> {
    #[inline(always)]
    fn strip<'h>(&mut self, col: i32, rows: Range<i32>, heights: impl Iterator<Item = &'h [f32; LANES]>) {
        let Low { edges, bounds: [left, top, _, bottom], start, per_col, per_row, z0 } = self.low;
        let (cols, down) = (col - left, rows.start - top);
        // A pixel on a border that is another's is outside.
        let at = |k: usize| edges[k].at + cols * edges[k].across + down * edges[k].down - self.borders[k];
        let edge = |k: usize| (L::ramp(at(k), edges[k].across), L::splat_i(edges[k].down));
        let [(mut e0, down0), (mut e1, down1), (mut e2, down2)] = [edge(0), edge(1), edge(2)];
        let base = *z0 as f32;
        let start = start - f64::from(base) + per_col * f64::from(cols) + per_row * f64::from(down);
        let across = L::mul(L::splat(*per_col as f32), L::to_f(L::ramp(0, 1)));
        let (mut level, slope) = (L::add(L::splat(start as f32), across), L::splat(*per_row as f32));
        let (base, none, zero) = (L::splat(base), L::splat(0.0), L::splat_i(0));
        // What is added up row after row counts as often as there are rows from it on: so often as y says. Of pixels
        // outside -1, the sums of that, and the sums of these.
        let (mut out, mut of_out, mut of_of_out) = (zero, zero, zero);
        let (mut values, mut of_values, mut squares) = (none, none, none);
        for heights in heights {
            let outside = L::or_i(L::or_i(e0, e1), e2);
            let value = L::unless_negative(outside, L::sub(L::sub(L::load(heights), base), level));
            out = L::add_i(out, L::shift_down::<31>(outside));
            of_out = L::add_i(of_out, out);
            of_of_out = L::add_i(of_of_out, of_out);
            values = L::add(values, value);
            of_values = L::add(of_values, values);
            squares = L::add(squares, L::mul(value, value));
            (e0, e1, e2) = (L::add_i(e0, down0), L::add_i(e1, down1), L::add_i(e2, down2));
            level = L::add(level, slope);
        }
        // With all pixels added, and from sums of sums of sums to those of squares.
        let count = rows.len() as i32;
        let n = L::add_i(out, L::splat_i(count));
        let mut y = L::add_i(of_out, L::splat_i(count * (count + 1) / 2));
        let of_y = L::add_i(of_of_out, L::splat_i(count * (count + 1) * (count + 2) / 6));
        let mut yy = L::sub_i(L::add_i(of_y, of_y), y);
        let below = bottom + 1 - rows.end;
        if below > 0 {
            // Rows count from the last one of the bounds.
            let below = L::splat_i(below);
            let shift = L::mul_i(below, n);
            yy = L::add_i(yy, L::mul_i(below, L::add_i(L::add_i(y, y), shift)));
            y = L::add_i(y, shift);
            of_values = L::add(of_values, L::mul(L::to_f(below), values));
        }
        let x = L::to_f(L::ramp(cols, 1));
        let (n, y, yy) = (L::to_f(n), L::to_f(y), L::to_f(yy));
        let (nx, of_x) = (L::mul(n, x), L::mul(values, x));
        let sums = [n, nx, L::mul(nx, x), y, L::mul(y, x), yy, values, of_x, of_values, squares];
        for (sum, of_strip) in self.sums.iter_mut().zip(sums) {
            *sum = L::add(*sum, of_strip);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Grid;
    use crate::predicate::{orient2d, SUB_BITS, UNIT};
    use crate::scan::Plane;
    use crate::share::tests::{by_pixels, numbers, triangle, SIDE};
    use crate::share::Residual;
    use proptest::prelude::*;

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
            let stands = p.map(|p| p.as_pixel().map_or(0.0, |(col, row)| f64::from(z[row * SIDE + col])));
            let over = |vectors| {
                let mut shares = Shares::default();
                // Beside another one.
                shares.push([Point::pixel(1, 2), Point::pixel(9, 4), Point::pixel(3, 11)], [[0.0; 3], [1.0; 3]], [true; 3]);
                shares.push(p, [heights, stands], owned);
                shares.take(&patch, unit, vectors)
            };
            let [_, strips, others @ ..] = over(Vectors::best());
            prop_assert_eq!(others, [None; LANES - 2]);
            for vectors in Vectors::all() {
                prop_assert_eq!(strips, over(vectors)[1]);
            }
            let is_thin = {
                let [a, b, c] = p;
                let long = [(a, b), (b, c), (c, a)].map(|(a, b)| f64::from((a.x - b.x).abs().max((a.y - b.y).abs())));
                let area = orient2d(a, b, c) as f64;
                let longest = long.into_iter().fold(0.0, f64::max);
                longest * f64::from(UNIT) > 32.0 / (SIDE as f64) * area
            };
            prop_assert!(strips.is_some() || void.is_some() || is_thin);
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
    }
}
