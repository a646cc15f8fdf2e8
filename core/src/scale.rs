//! Noise, spikes and the Gaussian scale space; voids neither darken nor leak.

use crate::error::Result;
use crate::grid::{Grid, Height};
use crate::memory;
use crate::progress::Progress;
use std::borrow::Cow;
use std::ops::Range;

/// Gaussian kernels are cut off at this many standard deviations.
const TRUNCATE: f64 = 4.0;
/// The largest number of samples a robust statistic looks at.
pub const MAX_SAMPLES: usize = 1 << 20;
/// sigma = 1.4826 MAD for normally distributed errors.
const MAD_TO_SIGMA: f64 = 1.4826;

/// Standard deviation of the noise: 1.4826 times the median of
/// |[1 -2 1] x [1 -2 1]| / 6 over pixels with a complete neighbourhood
/// (Immerkaer 1996, made robust). 0 where there is no such pixel.
pub fn noise<T: Height>(grid: &Grid<T>) -> f64 {
    let step = grid.z().len().div_ceil(MAX_SAMPLES);
    let mut residuals = Vec::new();
    for row in (1..grid.rows() - 1).step_by(step) {
        let [a, b, c] = [grid.row(row - 1), grid.row(row), grid.row(row + 1)];
        for col in 1..grid.cols() - 1 {
            let second = |r: &[T]| r[col - 1].to_f64() - 2.0 * r[col].to_f64() + r[col + 1].to_f64();
            let residual = second(a) - 2.0 * second(b) + second(c);
            if !residual.is_nan() {
                residuals.push(residual.abs());
            }
        }
    }
    MAD_TO_SIGMA / 6.0 * median(&mut residuals).unwrap_or(0.0)
}

fn median(values: &mut [f64]) -> Option<f64> {
    quantile(values, 0.5)
}

fn quantile(values: &mut [f64], q: f64) -> Option<f64> {
    if values.is_empty() {
        return None;
    }
    let index = ((values.len() - 1) as f64 * q) as usize;
    Some(*values.select_nth_unstable_by(index, f64::total_cmp).1)
}

/// Differences below this share of the range of the heights are never spikes.
const SPIKE_FLOOR: f64 = 2e-3;
/// A spike needs this many valid neighbours to be recognised.
const MIN_NEIGHBOURS: usize = 5;
/// With this many of the eight neighbours two opposite pairs are complete.
const MIN_PAIRED: usize = 6;

/// Pixels that stand out of their neighbourhood, with the height they get.
///
/// A pixel is a spike if it lies outside the second smallest and second largest of
/// its neighbours by more than half their spread plus max(4 `noise`, a floor); it
/// takes the neighbours' median.
pub fn spikes<T: Height>(grid: &Grid<T>, noise: f64, progress: &mut Progress) -> Result<Vec<(usize, T)>> {
    let step = grid.z().len().div_ceil(MAX_SAMPLES);
    let mut sample: Vec<f64> =
        grid.z().iter().step_by(step).map(|z| z.to_f64()).filter(|z| !z.is_nan()).collect();
    let high = quantile(&mut sample, 0.99).unwrap_or(0.0);
    let low = quantile(&mut sample, 0.01).unwrap_or(0.0);
    let margin = (4.0 * noise).max(SPIKE_FLOOR * (high - low));
    let mut found = Vec::new();
    let mut around = Vec::with_capacity(8);
    for row in 0..grid.rows() {
        progress.poll(4 * grid.cols(), || row as f64 / grid.rows() as f64)?;
        for col in 0..grid.cols() {
            let z = grid.at(col, row);
            if z.is_nan() || !stands_out(grid, col, row, z, margin) {
                continue;
            }
            neighbours(grid, col, row, &mut around);
            if around.len() < MIN_NEIGHBOURS {
                continue;
            }
            around.sort_unstable_by(f64::total_cmp);
            // On the border the second smallest may still be on the near side of a ramp.
            let rank = usize::from(around.len() >= MIN_PAIRED);
            let (low, high) = (around[rank], around[around.len() - 1 - rank]);
            if (z - high).max(low - z) > 0.5 * (high - low) + margin {
                let n = around.len();
                let middle = 0.5 * (around[(n - 1) / 2] + around[n / 2]);
                found.push((row * grid.cols() + col, T::from_f64(middle)));
            }
        }
    }
    Ok(found)
}

/// Cheap necessary condition: a spike differs by more than `margin` from at least
/// one of its neighbours along the row and one along the column.
fn stands_out<T: Height>(grid: &Grid<T>, col: usize, row: usize, z: f64, margin: f64) -> bool {
    // A void on one side does not hide a spike.
    let differs = |c: usize, r: usize| grid.at(c, r).is_nan() || (grid.at(c, r) - z).abs() > margin;
    (col == 0 || differs(col - 1, row) || col + 1 == grid.cols() || differs(col + 1, row))
        && (row == 0 || differs(col, row - 1) || row + 1 == grid.rows() || differs(col, row + 1))
}

fn neighbours<T: Height>(grid: &Grid<T>, col: usize, row: usize, into: &mut Vec<f64>) {
    into.clear();
    for r in row.saturating_sub(1)..=(row + 1).min(grid.rows() - 1) {
        for c in col.saturating_sub(1)..=(col + 1).min(grid.cols() - 1) {
            let z = grid.at(c, r);
            if (c, r) != (col, row) && !z.is_nan() {
                into.push(z);
            }
        }
    }
}

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
    let [kx, ky] = sigma.map(kernel);
    let (rx, ry) = (kx.len() / 2, ky.len() / 2);
    let (rows, cols) = (grid.rows(), grid.cols());
    // Moments over the rows around, with `rx` columns of nothing on either side.
    let mut moments = [(); 5].map(|()| vec![0.0; cols + 2 * rx]);
    let mut line = vec![(0.0, 0.0); cols];
    let mut cut_off = Vec::new();
    let mut smooth = Vec::with_capacity(grid.z().len());
    for row in 0..rows {
        let fraction = row as f64 / rows as f64;
        let near = row.saturating_sub(ry)..(row + ry + 1).min(rows);
        let [mass, sum, ..] = &mut moments;
        mass[rx..rx + cols].fill(0.0);
        sum[rx..rx + cols].fill(0.0);
        for r in near.clone() {
            progress.poll(cols / 2, || fraction)?;
            let w = ky[r + ry - row];
            let into = mass[rx..rx + cols].iter_mut().zip(&mut sum[rx..rx + cols]);
            for ((mass, sum), z) in into.zip(grid.row(r)) {
                let z = z.to_f64();
                let known = !z.is_nan();
                *mass += if known { w } else { 0.0 };
                *sum += if known { w * z } else { 0.0 };
            }
        }
        line.fill((0.0, 0.0));
        for (shift, &w) in kx.iter().enumerate() {
            let from = mass[shift..shift + cols].iter().zip(&sum[shift..shift + cols]);
            for (into, (mass, sum)) in line.iter_mut().zip(from) {
                into.0 += w * mass;
                into.1 += w * sum;
            }
        }
        progress.poll(cols * kx.len() / 2, || fraction)?;
        let start = smooth.len();
        cut_off.clear();
        for (col, (&z, &(mass, sum))) in grid.row(row).iter().zip(&line).enumerate() {
            let is_void = z.to_f64().is_nan();
            smooth.push(if is_void { z } else { T::from_f64(sum / mass) });
            if mass <= COMPLETE && !is_void {
                cut_off.push(col);
            }
        }
        if let (Some(&first), Some(&last)) = (cut_off.first(), cut_off.last()) {
            let columns = first.saturating_sub(rx)..(last + rx + 1).min(cols);
            progress.poll((columns.len() * ky.len() + cut_off.len() * kx.len()) / 2, || fraction)?;
            slope_moments(grid, row, near, columns, &ky, &mut moments);
            for &col in &cut_off {
                if let Some(z) = local_plane(&moments, col, &kx, &ky) {
                    smooth[start + col] = T::from_f64(z);
                }
            }
        }
    }
    Ok(Cow::Owned(smooth))
}

/// A kernel that finds more than this share of its weight is not cut off by a void
/// or the border.
const COMPLETE: f64 = 1.0 - 1e-9;
/// Smallest determinant of the moments, relative to those of a complete kernel, for
/// which a plane is fitted.
const LEAST_SPREAD: f64 = 1e-3;

/// Puts the moments w dy, w dy^2 and w dy z of the rows `near` into the last three
/// `moments`, for `columns`.
fn slope_moments<T: Height>(
    grid: &Grid<T>,
    row: usize,
    near: Range<usize>,
    columns: Range<usize>,
    ky: &[f64],
    moments: &mut [Vec<f64>; 5],
) {
    let [mass, _, dy1, dy2, dyz] = moments;
    let margin = (mass.len() - grid.cols()) / 2;
    let within = columns.start + margin..columns.end + margin;
    let (dy1, dy2, dyz) = (&mut dy1[within.clone()], &mut dy2[within.clone()], &mut dyz[within]);
    for moment in [&mut *dy1, &mut *dy2, &mut *dyz] {
        moment.fill(0.0);
    }
    for r in near {
        let dy = r as f64 - row as f64;
        let w = ky[r + ky.len() / 2 - row] * dy;
        let into = dy1.iter_mut().zip(dy2.iter_mut()).zip(dyz.iter_mut());
        for (((dy1, dy2), dyz), z) in into.zip(&grid.row(r)[columns.clone()]) {
            let z = z.to_f64();
            let known = !z.is_nan();
            *dy1 += if known { w } else { 0.0 };
            *dy2 += if known { w * dy } else { 0.0 };
            *dyz += if known { w * z } else { 0.0 };
        }
    }
}

/// Height at `col` of the plane fitted with the kernel's weights to the valid pixels
/// around: unlike their weighted mean it is not drawn to one side where the kernel is
/// cut off, so that a slope stays a slope up to its edge. `None` where the pixels do
/// not span a plane. `moments`: of w, w z, w dy, w dy^2, w dy z over the rows.
fn local_plane(moments: &[Vec<f64>; 5], col: usize, kx: &[f64], ky: &[f64]) -> Option<f64> {
    let [mass, sum, dy1, dy2, dyz] = moments;
    let (mut m, mut mx, mut my, mut mxx, mut mxy, mut myy) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    let (mut mz, mut mxz, mut myz) = (0.0, 0.0, 0.0);
    for (i, &w) in (col..).zip(kx) {
        let dx = (i - col) as f64 - (kx.len() / 2) as f64;
        let wx = w * dx;
        (m, mx, my) = (m + w * mass[i], mx + wx * mass[i], my + w * dy1[i]);
        (mxx, mxy, myy) = (mxx + wx * dx * mass[i], mxy + wx * dy1[i], myy + w * dy2[i]);
        (mz, mxz, myz) = (mz + w * sum[i], mxz + wx * sum[i], myz + w * dyz[i]);
    }
    // Cramer's rule for the constant term of z = a + b dx + c dy.
    let (cxx, cxy, cyy) = (mxx * myy - mxy * mxy, mx * myy - my * mxy, mx * mxy - my * mxx);
    let det = m * cxx - mx * cxy + my * cyy;
    let spread = |k: &[f64]| {
        k.iter().enumerate().map(|(i, w)| w * (i as f64 - (k.len() / 2) as f64).powi(2)).sum::<f64>()
    };
    let is_plane = det > LEAST_SPREAD * spread(kx) * spread(ky);
    is_plane.then(|| (mz * cxx - mxz * cxy + myz * cyy) / det)
}

/// The standard deviations tried by [`choose`], in pixels.
const SIGMAS: [f64; 11] = [0.0, 0.4, 0.5, 0.6, 0.8, 1.0, 1.3, 1.7, 2.2, 3.0, 4.0];

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
    let mut best = Smooth { z: Cow::Borrowed(grid.z()), sigma: 0.0 };
    let mut least = variance;
    for &sigma in &SIGMAS[1..] {
        let z = gaussian(grid, [sigma, sigma], progress)?;
        let residual = mean_squared_difference(&z, grid.z());
        let risk = residual - variance + 2.0 * variance * centre_weight([sigma, sigma]);
        if risk.is_nan() || risk >= least {
            break;
        }
        least = risk;
        best = Smooth { z, sigma };
    }
    Ok(best)
}

/// Over the pixels where both are valid; 0 without any.
fn mean_squared_difference<T: Height>(a: &[T], b: &[T]) -> f64 {
    let (mut sum, mut count) = (0.0, 0usize);
    for (a, b) in a.iter().zip(b) {
        let d = a.to_f64() - b.to_f64();
        if !d.is_nan() {
            sum += d * d;
            count += 1;
        }
    }
    sum / count.max(1) as f64
}
