//! Sums over the pixels that a Gaussian kernel covers, over rows first and then along them;
//! a plane where the kernel is cut off.

use crate::error::Result;
use crate::grid::{Grid, Height};
use crate::lanes::{prefetch, Kernel, Lanes, Vectors};
use crate::lines::Lines;
use crate::progress::Progress;
use crate::window::Window;
use std::ops::Range;

/// Columns smoothed together, those of a default tile: few enough for their sums to stay in the fastest memory,
/// and many times the radius of the kernel, because the sums over rows reach beyond by that.
const STRIP: usize = 400;
const RADII_A_STRIP: usize = 16;

/// Columns summed at a time, in registers.
const BLOCK: usize = 16;

/// Memory is asked for heights so many rows before they are read: rows lie in pages of their own, and the
/// machine does not foresee that.
const AHEAD: usize = 8;

pub struct Smoother<'g, T> {
    grid: &'g Grid<'g, T>,
    kx: &'g [f64],
    ky: &'g [f64],
    vectors: Vectors,
    /// The rows that the kernel covers, for the columns of a strip and a radius on either side.
    lines: Lines,
    /// Of w, w z, w dy, w dy^2, w dy z over the rows around, for the same columns.
    moments: [Vec<f64>; 5],
    /// Of w and w z over the kernel, for the columns of a strip.
    mass: Vec<f64>,
    sum: Vec<f64>,
    /// Columns where the kernel is cut off by a void or the border.
    cut_off: Vec<usize>,
    /// Smallest determinant of the moments for which a plane is fitted.
    least_spread: f64,
}

/// A row of a strip: the same sums with all vectors, only compiled for them.
struct Strip<'s, 'g, T> {
    smoother: &'s mut Smoother<'g, T>,
    row: usize,
    columns: Range<usize>,
    into: &'s mut [T],
}

impl<T: Height> Kernel for Strip<'_, '_, T> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self) {
        self.smoother.strip(self.row, self.columns, self.into);
    }
}

impl<'g, T: Height> Smoother<'g, T> {
    /// Errors: `out-of-memory`.
    pub fn new(grid: &'g Grid<'g, T>, [kx, ky]: &'g [Vec<f64>; 2], vectors: Vectors) -> Result<Self> {
        let strip = STRIP.max(RADII_A_STRIP * (kx.len() / 2)).min(grid.cols()).next_multiple_of(BLOCK);
        let reach = strip + kx.len() - 1 + BLOCK;
        let moments = [(); 5].map(|()| vec![0.0; reach]);
        let (mass, sum) = (vec![0.0; strip], vec![0.0; strip]);
        let lines = Lines::new(grid, ky.len(), reach.min(grid.cols()).next_multiple_of(BLOCK))?;
        let spread = |k: &[f64]| k.iter().zip(offsets(k)).map(|(w, d)| w * d * d).sum::<f64>();
        let least_spread = LEAST_SPREAD * spread(kx) * spread(ky);
        let cut_off = Vec::new();
        Ok(Smoother { grid, kx, ky, vectors, lines, moments, mass, sum, cut_off, least_spread })
    }

    /// Puts the smoothed pixels of a window, row after row, into `into`. A pixel is the same in all windows.
    /// Errors: `cancelled`.
    pub fn window(&mut self, window: Window, into: &mut [T], progress: &mut Progress) -> Result<()> {
        let (Window { col, row, cols, .. }, width, vectors) = (window, self.sum.len(), self.vectors);
        // Row after row in a strip, because they have most of what they read in common.
        for start in (0..cols).step_by(width) {
            let within = start..(start + width).min(cols);
            let columns = col + within.start..col + within.end;
            self.lines.clear();
            for (row, into) in (row..).zip(into.chunks_mut(cols)) {
                let into = &mut into[within.clone()];
                vectors.run(Strip { smoother: self, row, columns: columns.clone(), into });
                let work = columns.len() * self.ky.len() + self.cut_off.len() * self.kx.len();
                progress.poll(work / 2, || start as f64 / cols as f64)?;
            }
        }
        Ok(())
    }

    #[inline(always)]
    fn strip(&mut self, row: usize, columns: Range<usize>, into: &mut [T]) {
        let Smoother { grid, kx, ky, lines, moments, mass, sum, cut_off, .. } = self;
        let (rx, ry) = (kx.len() / 2, ky.len() / 2);
        let seen = columns.start.saturating_sub(rx)..(columns.end + rx).min(grid.cols());
        // Where the moments of `seen` stand; those of what is beyond the border are 0.
        let first = seen.start + rx - columns.start;
        let within = first..first + seen.len();
        let blocks = columns.len().next_multiple_of(BLOCK);
        let used = blocks + kx.len() - 1 + BLOCK;
        for moment in moments.iter_mut() {
            moment[..within.start].fill(0.0);
            moment[within.end..used].fill(0.0);
        }
        let (mass, sum) = (&mut mass[..blocks], &mut sum[..blocks]);
        let [row_mass, row_sum, ..] = moments;
        let is_inside = row >= ry && row + ry < grid.rows();
        let known = &mut row_mass[within.clone()];
        let is_whole = is_inside && lines.hold(grid, row - ry..row + ry + 1, seen.clone());
        if is_inside {
            let whole_blocks = seen.len().next_multiple_of(BLOCK);
            let ahead = grid.row((row + ry + AHEAD).min(grid.rows() - 1));
            let ask = |i: usize| prefetch(&ahead[seen.start + i * BLOCK]);
            weigh(&ky[ry..], lines.around(row), ask, &mut row_sum[first..first + whole_blocks]);
            row_sum[within.end..used].fill(0.0);
        } else {
            sum_heights(grid, row, seen.clone(), ky, &mut row_sum[within.clone()]);
        }
        convolve(row_sum, kx, sum);
        for (into, &sum) in into.iter_mut().zip(&*sum) {
            *into = T::from_f64(sum);
        }
        cut_off.clear();
        if is_whole {
            cut_off.extend(columns.start..columns.end.min(rx));
            cut_off.extend(columns.start.max(rx).max(grid.cols().saturating_sub(rx))..columns.end);
            if !cut_off.is_empty() {
                known.fill(1.0);
            }
        } else {
            sum_weights(grid, row, seen, ky, known);
            convolve(row_mass, kx, mass);
            let heights = &grid.row(row)[columns.clone()];
            for (((col, z), into), &mass) in columns.clone().zip(heights).zip(&mut *into).zip(&*mass) {
                if z.to_f64().is_nan() {
                    *into = *z;
                } else if !is_inside || mass <= COMPLETE || col < rx || col + rx >= grid.cols() {
                    cut_off.push(col);
                }
            }
        }
        self.refit(row, columns.start, into);
    }

    /// Puts planes where the kernel is cut off into a strip that begins at column `start`.
    #[inline(always)]
    fn refit(&mut self, row: usize, start: usize, into: &mut [T]) {
        let (Some(&first), Some(&last)) = (self.cut_off.first(), self.cut_off.last()) else { return };
        let (rx, cols) = (self.kx.len() / 2, self.grid.cols());
        let seen = first.saturating_sub(rx)..(last + rx + 1).min(cols);
        let within = seen.start + rx - start..seen.end + rx - start;
        let [_, _, dy1, dy2, dyz] = &mut self.moments;
        sum_slopes(self.grid, row, seen, self.ky, [dy1, dy2, dyz].map(|moment| &mut moment[within.clone()]));
        for &col in &self.cut_off {
            into[col - start] = T::from_f64(self.local_plane(col - start));
        }
    }

    /// Height of the plane fitted with the kernel's weights to the valid pixels around the
    /// `i`th of the strip: unlike their weighted mean it is not drawn to one side where the
    /// kernel is cut off, so that a slope stays a slope up to its edge. The mean where the
    /// pixels do not span a plane.
    #[inline(always)]
    fn local_plane(&self, i: usize) -> f64 {
        let [mass, sum, dy1, dy2, dyz] = self.moments.each_ref().map(|m| &m[i..i + self.kx.len()]);
        let (mut m, mut mx, mut my, mut mxx, mut mxy, mut myy) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        let (mut mz, mut mxz, mut myz) = (0.0, 0.0, 0.0);
        for (i, (&w, dx)) in self.kx.iter().zip(offsets(self.kx)).enumerate() {
            let wx = w * dx;
            (m, mx, my) = (m + w * mass[i], mx + wx * mass[i], my + w * dy1[i]);
            (mxx, mxy, myy) = (mxx + wx * dx * mass[i], mxy + wx * dy1[i], myy + w * dy2[i]);
            (mz, mxz, myz) = (mz + w * sum[i], mxz + wx * sum[i], myz + w * dyz[i]);
        }
        // Cramer's rule for the constant term of z = a + b dx + c dy.
        let (cxx, cxy, cyy) = (mxx * myy - mxy * mxy, mx * myy - my * mxy, mx * mxy - my * mxx);
        let det = m * cxx - mx * cxy + my * cyy;
        if det > self.least_spread {
            (mz * cxx - mxz * cxy + myz * cyy) / det
        } else {
            mz / m
        }
    }
}

/// How far the weights of a kernel are from its centre.
#[inline(always)]
fn offsets(kernel: &[f64]) -> impl Iterator<Item = f64> {
    let radius = (kernel.len() / 2) as i64;
    (-radius..=radius).map(|d| d as f64)
}

/// The rows that a kernel over rows reaches, each with its weight and distance from `row`.
#[inline(always)]
fn rows_around(kernel: &[f64], row: usize, rows: usize) -> impl Iterator<Item = (usize, f64, f64)> + '_ {
    let first = row as i64 - (kernel.len() / 2) as i64;
    let around = (first..).zip(kernel).zip(offsets(kernel)).map(|((r, &w), dy)| (r, w, dy));
    around.filter(move |&(r, ..)| (0..rows as i64).contains(&r)).map(|(r, w, dy)| (r as usize, w, dy))
}

/// The sums of w over the rows that exist and their valid pixels.
#[inline(always)]
fn sum_weights<T: Height>(
    grid: &Grid<T>,
    row: usize,
    columns: Range<usize>,
    kernel: &[f64],
    mass: &mut [f64],
) {
    mass.fill(0.0);
    for (r, w, _) in rows_around(kernel, row, grid.rows()) {
        for (mass, z) in mass.iter_mut().zip(&grid.row(r)[columns.clone()]) {
            *mass += if z.to_f64().is_nan() { 0.0 } else { w };
        }
    }
}

/// The same of w z.
#[inline(always)]
fn sum_heights<T: Height>(
    grid: &Grid<T>,
    row: usize,
    columns: Range<usize>,
    kernel: &[f64],
    sum: &mut [f64],
) {
    sum.fill(0.0);
    for (r, w, _) in rows_around(kernel, row, grid.rows()) {
        for (sum, z) in sum.iter_mut().zip(&grid.row(r)[columns.clone()]) {
            let z = z.to_f64();
            *sum += if z.is_nan() { 0.0 } else { w * z };
        }
    }
}

/// The sums of w dy, w dy^2 and w dy z over the rows that exist and their valid pixels.
#[inline(always)]
fn sum_slopes<T: Height>(
    grid: &Grid<T>,
    row: usize,
    columns: Range<usize>,
    kernel: &[f64],
    [dy1, dy2, dyz]: [&mut [f64]; 3],
) {
    for moment in [&mut *dy1, &mut *dy2, &mut *dyz] {
        moment.fill(0.0);
    }
    for (r, w, dy) in rows_around(kernel, row, grid.rows()) {
        let w = w * dy;
        let into = dy1.iter_mut().zip(&mut *dy2).zip(&mut *dyz);
        for (((dy1, dy2), dyz), z) in into.zip(&grid.row(r)[columns.clone()]) {
            let z = z.to_f64();
            let known = !z.is_nan();
            *dy1 += if known { w } else { 0.0 };
            *dy2 += if known { w * dy } else { 0.0 };
            *dyz += if known { w * z } else { 0.0 };
        }
    }
}

/// Convolution of `line` with a symmetric kernel, where it covers all of that.
#[inline(always)]
fn convolve(line: &[f64], kernel: &[f64], into: &mut [f64]) {
    let radius = kernel.len() / 2;
    weigh(
        &kernel[radius..],
        |distance| [&line[radius - distance..], &line[radius + distance..]],
        |_| {},
        into,
    );
}

/// Weighted sums of the pairs of lines at every distance, which have a weight in common, and
/// of the one at distance 0. `at_block` is told which block of columns is next.
#[inline(always)]
fn weigh<'l>(
    weights: &[f64],
    pair: impl Fn(usize) -> [&'l [f64]; 2],
    at_block: impl Fn(usize),
    into: &mut [f64],
) {
    // The radii of the default scales get code of their own, without an inner loop.
    match weights.len() {
        3 => weigh_all(&weights[..3], pair, at_block, into),
        4 => weigh_all(&weights[..4], pair, at_block, into),
        _ => weigh_all(weights, pair, at_block, into),
    }
}

#[inline(always)]
fn weigh_all<'l>(
    weights: &[f64],
    pair: impl Fn(usize) -> [&'l [f64]; 2],
    at_block: impl Fn(usize),
    into: &mut [f64],
) {
    for (i, into) in into.as_chunks_mut::<BLOCK>().0.iter_mut().enumerate() {
        at_block(i);
        let block = |line: &[f64]| -> [f64; BLOCK] {
            let line = &line[i * BLOCK..(i + 1) * BLOCK];
            std::array::from_fn(|i| line[i])
        };
        let mut sum = block(pair(0)[0]).map(|z| weights[0] * z);
        for (distance, weight) in weights.iter().enumerate().skip(1) {
            let [a, b] = pair(distance).map(block);
            for i in 0..BLOCK {
                sum[i] += weight * (a[i] + b[i]);
            }
        }
        *into = sum;
    }
}

/// A kernel that finds more than this share of its weight is not cut off by a void: what
/// is missing is rounding.
const COMPLETE: f64 = 1.0 - 2e-14;
/// Smallest determinant of the moments, relative to those of a complete kernel, for
/// which a plane is fitted.
const LEAST_SPREAD: f64 = 1e-3;

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Symmetric, of sum 1.
    fn kernel(radius: i32, share: f64) -> Vec<f64> {
        let weight = |k: i32| share.powi(k.abs());
        let total: f64 = (-radius..=radius).map(weight).sum();
        (-radius..=radius).map(|k| weight(k) / total).collect()
    }

    fn smooth<T: Height>(z: &[T], cols: usize, kernels: &[Vec<f64>; 2], vectors: Vectors) -> Vec<T> {
        let grid = Grid::new(z, z.len() / cols, cols).unwrap();
        let mut into = z.to_vec();
        let mut smoother = Smoother::new(&grid, kernels, vectors).unwrap();
        let window = Window { col: 0, row: 0, cols, rows: z.len() / cols };
        smoother.window(window, &mut into, &mut Progress::new(&mut |_, _| true)).unwrap();
        into
    }

    /// The sum over rows, then along them, each from the centre outwards.
    fn pixel_by_pixel(z: &[f64], cols: usize, [kx, ky]: &[Vec<f64>; 2], col: usize, row: usize) -> f64 {
        fn from_centre(kernel: &[f64], at: impl Fn(i64) -> f64) -> f64 {
            let radius = kernel.len() / 2;
            (1..=radius).fold(kernel[radius] * at(0), |sum, d| {
                sum + kernel[radius + d] * (at(-(d as i64)) + at(d as i64))
            })
        }
        let z = |dx: i64, dy: i64| z[(row as i64 + dy) as usize * cols + (col as i64 + dx) as usize];
        from_centre(kx, |dx| from_centre(ky, |dy| z(dx, dy)))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(100))]

        #[test]
        fn a_pixel_is_the_same_with_all_vectors_and_beside_any_others(
            rows in 2usize..24, cols in prop_oneof![2usize..40, 240usize..300, 500usize..560],
            rx in 0i32..6, ry in 0i32..6, share in 0.1f64..0.9, voids in 0usize..3, seed: u64,
        ) {
            let mix = |i: u64| (i ^ seed).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(29).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            let whole: Vec<f64> =
                (0..rows * cols).map(|i| f64::from((1000.0 + (mix(i as u64) >> 40) as f64 * 1e-5) as f32)).collect();
            let mut z = whole.clone();
            let voids: Vec<_> = (0..voids).map(|i| (mix(!(i as u64)) >> 20) as usize % z.len()).collect();
            voids.iter().for_each(|&i| z[i] = f64::NAN);
            let single: Vec<f32> = z.iter().map(|&z| z as f32).collect();
            let kernels = [kernel(rx, share), kernel(ry, 0.9 * share)];
            let found = smooth(&z, cols, &kernels, Vectors::Plain);
            let singles = smooth(&single, cols, &kernels, Vectors::Plain);
            let bits = |z: &[f64]| z.iter().map(|z| z.to_bits()).collect::<Vec<_>>();
            let bits_single = |z: &[f32]| z.iter().map(|z| z.to_bits()).collect::<Vec<_>>();
            for vectors in Vectors::all() {
                prop_assert_eq!(bits(&found), bits(&smooth(&z, cols, &kernels, vectors)));
                prop_assert_eq!(bits_single(&singles), bits_single(&smooth(&single, cols, &kernels, vectors)));
            }
            let (rx, ry) = (rx as usize, ry as usize);
            for (row, col) in (ry..rows.saturating_sub(ry)).flat_map(|row| (rx..cols.saturating_sub(rx)).map(move |col| (row, col))) {
                let sees = |&i: &usize| (i / cols).abs_diff(row) <= ry && (i % cols).abs_diff(col) <= rx;
                if voids.iter().any(sees) {
                    continue;
                }
                let (want, i) = (pixel_by_pixel(&whole, cols, &kernels, col, row), row * cols + col);
                prop_assert_eq!(found[i].to_bits(), want.to_bits());
                prop_assert_eq!(singles[i].to_bits(), (want as f32).to_bits());
            }
        }
    }
}
