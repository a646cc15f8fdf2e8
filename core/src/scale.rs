//! The Gaussian scale space; voids neither darken nor leak.

use crate::error::Result;
use crate::grid::{Grid, Height};
use crate::memory;
use crate::noise::{stride, MAX_SAMPLES};
use crate::progress::Progress;
use crate::threads::spread;
use std::borrow::Cow;
use std::ops::Range;

/// Gaussian kernels are cut off at this many standard deviations.
const TRUNCATE: f64 = 4.0;
/// Sampled Gaussian of standard deviation `sigma` pixels, sum 1.
fn kernel(sigma: f64) -> Vec<f64> {
    let radius = (TRUNCATE * sigma + 0.5) as i64;
    let weight = |k: i64| if k == 0 { 1.0 } else { (-0.5 * (k as f64 / sigma).powi(2)).exp() };
    let total: f64 = (-radius..=radius).map(weight).sum();
    (-radius..=radius).map(|k| weight(k) / total).collect()
}

/// Weight of a pixel in its own smoothed value.
fn centre_weight(sigma: [f64; 2]) -> f64 {
    sigma
        .iter()
        .map(|&s| {
            let k = kernel(s);
            k[k.len() / 2]
        })
        .product()
}

/// Standard deviation of white noise after smoothing, relative to that before.
pub fn noise_left(sigma: [f64; 2]) -> f64 {
    sigma.iter().map(|&s| kernel(s).iter().map(|w| w * w).sum::<f64>().sqrt()).product()
}

/// The image at scale t = sigma^2: convolution with a Gaussian of `sigma` = [along
/// columns' direction (x), along rows' direction (y)] pixels. Void stays void and has
/// no weight, nor has what lies beyond the border; there the kernel fits a plane.
pub fn gaussian<'a, T: Height>(
    grid: &Grid<'a, T>,
    sigma: [f64; 2],
    progress: &mut Progress,
) -> Result<Cow<'a, [T]>> {
    if sigma == [0.0, 0.0] {
        return Ok(Cow::Borrowed(grid.z()));
    }
    memory::ensure(size_of_val(grid.z()))?;
    let kernels = sigma.map(kernel);
    let mut smooth = grid.z().to_vec();
    let bands = smooth.chunks_mut(BAND * grid.cols()).enumerate();
    spread(progress, bands, |(band, into), progress| {
        Smoother::new(grid, &kernels).rows(band * BAND, into, progress)
    })?;
    Ok(Cow::Owned(smooth))
}

/// Rows that one thread smooths at a time.
const BAND: usize = 32;
/// Columns smoothed together: few enough for all their sums to stay in the fastest memory,
/// and many times the radius of the kernel, because the sums over rows reach beyond by that.
const STRIP: usize = 256;
const RADII_A_STRIP: usize = 16;

struct Smoother<'g, T> {
    grid: &'g Grid<'g, T>,
    kx: &'g [f64],
    ky: &'g [f64],
    /// Of w, w z, w dy, w dy^2, w dy z over the rows around, for the columns of a strip and
    /// a radius on either side.
    moments: [Vec<f64>; 5],
    /// Of w and w z over the kernel, for the columns of a strip.
    mass: Vec<f64>,
    sum: Vec<f64>,
    /// Columns where the kernel is cut off by a void or the border.
    cut_off: Vec<usize>,
    /// Smallest determinant of the moments for which a plane is fitted.
    least_spread: f64,
}

impl<'g, T: Height> Smoother<'g, T> {
    fn new(grid: &'g Grid<'g, T>, [kx, ky]: &'g [Vec<f64>; 2]) -> Self {
        let strip = STRIP.max(RADII_A_STRIP * (kx.len() / 2)).min(grid.cols());
        let moments = [(); 5].map(|()| vec![0.0; strip + kx.len() - 1]);
        let (mass, sum) = (vec![0.0; strip], vec![0.0; strip]);
        let spread = |k: &[f64]| k.iter().zip(offsets(k)).map(|(w, d)| w * d * d).sum::<f64>();
        let least_spread = LEAST_SPREAD * spread(kx) * spread(ky);
        Smoother { grid, kx, ky, moments, mass, sum, cut_off: Vec::new(), least_spread }
    }

    /// Puts the smoothed rows from `first` on into `into`, which holds the rows themselves.
    fn rows(&mut self, first: usize, into: &mut [T], progress: &mut Progress) -> Result<()> {
        let (cols, width) = (self.grid.cols(), self.sum.len());
        // Row after row in a strip, because they have most of what they read in common.
        for start in (0..cols).step_by(width) {
            let columns = start..(start + width).min(cols);
            for (row, into) in (first..).zip(into.chunks_mut(cols)) {
                self.strip(row, columns.clone(), &mut into[columns.clone()]);
                let work = columns.len() * self.ky.len() + self.cut_off.len() * self.kx.len();
                progress.poll(work / 2, || start as f64 / cols as f64)?;
            }
        }
        Ok(())
    }

    fn strip(&mut self, row: usize, columns: Range<usize>, into: &mut [T]) {
        let Smoother { grid, kx, ky, moments, mass, sum, cut_off, .. } = self;
        let (rx, ry) = (kx.len() / 2, ky.len() / 2);
        let seen = columns.start.saturating_sub(rx)..(columns.end + rx).min(grid.cols());
        // Where the moments of `seen` stand; those of what is beyond the border are 0.
        let first = seen.start + rx - columns.start;
        let within = first..first + seen.len();
        for moment in moments.iter_mut() {
            moment[..within.start].fill(0.0);
            moment[within.end..].fill(0.0);
        }
        let (mass, sum) = (&mut mass[..columns.len()], &mut sum[..columns.len()]);
        let [row_mass, row_sum, ..] = moments;
        let is_inside = row >= ry && row + ry < grid.rows();
        cut_off.clear();
        if is_inside && sum_rows(grid, row, seen.clone(), ky, &mut row_sum[within.clone()]) {
            convolve(row_sum, kx, sum);
            for (into, &sum) in into.iter_mut().zip(&*sum) {
                *into = T::from_f64(sum);
            }
            row_mass[within].fill(1.0);
            cut_off.extend(columns.clone().filter(|&col| col < rx || col + rx >= grid.cols()));
        } else {
            sum_known(grid, row, seen, ky, [&mut row_mass[within.clone()], &mut row_sum[within]]);
            convolve(row_mass, kx, mass);
            convolve(row_sum, kx, sum);
            for (((col, into), &mass), &sum) in columns.clone().zip(&mut *into).zip(&*mass).zip(&*sum) {
                if !into.to_f64().is_nan() {
                    *into = T::from_f64(sum / mass);
                    if mass <= COMPLETE {
                        cut_off.push(col);
                    }
                }
            }
        }
        self.refit(row, columns.start, into);
    }

    /// Puts planes where the kernel is cut off into a strip that begins at column `start`.
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
fn offsets(kernel: &[f64]) -> impl Iterator<Item = f64> {
    let radius = (kernel.len() / 2) as i64;
    (-radius..=radius).map(|d| d as f64)
}

/// The rows that a kernel over rows reaches, each with its weight and distance from `row`.
fn rows_around(kernel: &[f64], row: usize, rows: usize) -> impl Iterator<Item = (usize, f64, f64)> + '_ {
    let first = row as i64 - (kernel.len() / 2) as i64;
    let around = (first..).zip(kernel).zip(offsets(kernel)).map(|((r, &w), dy)| (r, w, dy));
    around.filter(move |&(r, ..)| (0..rows as i64).contains(&r)).map(|(r, w, dy)| (r as usize, w, dy))
}

/// The sums of w z over rows that all exist; whether no pixel was void.
fn sum_rows<T: Height>(
    grid: &Grid<T>,
    row: usize,
    columns: Range<usize>,
    kernel: &[f64],
    sum: &mut [f64],
) -> bool {
    let radius = kernel.len() / 2;
    let line = |row: usize| &grid.row(row)[columns.clone()];
    weigh(sum, kernel[radius], line(row));
    for distance in 1..=radius {
        add_pair(sum, kernel[radius + distance], line(row - distance), line(row + distance));
    }
    // A void makes its sum NaN.
    !sum.iter().fold(false, |has_void, sum| has_void | sum.is_nan())
}

/// The sums of w and w z over the rows that exist and their valid pixels.
fn sum_known<T: Height>(
    grid: &Grid<T>,
    row: usize,
    columns: Range<usize>,
    kernel: &[f64],
    [mass, sum]: [&mut [f64]; 2],
) {
    mass.fill(0.0);
    sum.fill(0.0);
    for (r, w, _) in rows_around(kernel, row, grid.rows()) {
        for ((mass, sum), z) in mass.iter_mut().zip(&mut *sum).zip(&grid.row(r)[columns.clone()]) {
            let z = z.to_f64();
            let known = !z.is_nan();
            *mass += if known { w } else { 0.0 };
            *sum += if known { w * z } else { 0.0 };
        }
    }
}

/// The sums of w dy, w dy^2 and w dy z over the rows that exist and their valid pixels.
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
fn convolve(line: &[f64], kernel: &[f64], into: &mut [f64]) {
    let (radius, count) = (kernel.len() / 2, into.len());
    weigh(into, kernel[radius], &line[radius..]);
    for distance in 1..=radius {
        let (before, after) = (&line[radius - distance..], &line[radius + distance..]);
        add_pair(into, kernel[radius + distance], &before[..count], &after[..count]);
    }
}

fn weigh<T: Height>(into: &mut [f64], weight: f64, values: &[T]) {
    for (into, value) in into.iter_mut().zip(values) {
        *into = weight * value.to_f64();
    }
}

/// Adds two lines of which each stands for the same weight.
fn add_pair<T: Height>(into: &mut [f64], weight: f64, a: &[T], b: &[T]) {
    for ((into, a), b) in into.iter_mut().zip(a).zip(b) {
        *into += weight * (a.to_f64() + b.to_f64());
    }
}

/// A kernel that finds more than this share of its weight is not cut off by a void
/// or the border.
const COMPLETE: f64 = 1.0 - 1e-9;
/// Smallest determinant of the moments, relative to those of a complete kernel, for
/// which a plane is fitted.
const LEAST_SPREAD: f64 = 1e-3;

/// The standard deviations tried by [`choose`], in pixels.
const SIGMAS: [f64; 10] = [0.4, 0.5, 0.6, 0.8, 1.0, 1.3, 1.7, 2.2, 3.0, 4.0];

/// A smoothed image and how it was made.
pub struct Smooth<'a, T: Height> {
    pub z: Cow<'a, [T]>,
    /// Standard deviation in pixels.
    pub sigma: f64,
}

/// The Gaussian image with the least unbiased estimate of the risk (Stein 1981),
/// mean(r^2) - noise^2 + 2 noise^2 h0. The risk falls and then rises with sigma, so
/// the search stops when it has risen.
pub fn choose<'a, T: Height>(
    grid: &Grid<'a, T>,
    noise: f64,
    progress: &mut Progress,
) -> Result<Smooth<'a, T>> {
    let variance = noise * noise;
    let (mut best, mut least) = (0.0, variance);
    for &sigma in &SIGMAS {
        let residual = mean_squared_residual(grid, sigma, progress)?;
        let risk = residual - variance + 2.0 * variance * centre_weight([sigma, sigma]);
        if risk.is_nan() || risk >= least {
            break;
        }
        (best, least) = (sigma, risk);
    }
    Ok(Smooth { z: gaussian(grid, [best, best], progress)?, sigma: best })
}

/// Of the pixels that smoothing moves, in rows spread over the raster; 0 without valid ones.
fn mean_squared_residual<T: Height>(grid: &Grid<T>, sigma: f64, progress: &mut Progress) -> Result<f64> {
    let kernels = [kernel(sigma), kernel(sigma)];
    let rows: Vec<usize> = (0..grid.rows()).step_by(stride(grid.z().len(), MAX_SAMPLES)).collect();
    let parts = spread(progress, rows.chunks(BAND), |rows, progress| {
        let mut smoother = Smoother::new(grid, &kernels);
        let (mut sum, mut count) = (0.0, 0);
        for &row in rows {
            let mut smooth = grid.row(row).to_vec();
            smoother.rows(row, &mut smooth, progress)?;
            for (smooth, z) in smooth.iter().zip(grid.row(row)) {
                let residual = smooth.to_f64() - z.to_f64();
                if !residual.is_nan() {
                    sum += residual * residual;
                    count += 1;
                }
            }
        }
        Ok((sum, count))
    })?;
    let (sum, count) = parts.iter().fold((0.0, 0usize), |(sum, count), part| (sum + part.0, count + part.1));
    Ok(sum / count.max(1) as f64)
}
