//! The Gaussian scale space; voids neither darken nor leak.

use crate::error::Result;
use crate::grid::{Grid, Height};
use crate::lanes::Vectors;
use crate::memory;
use crate::noise::{stride, MAX_SAMPLES};
use crate::progress::Progress;
use crate::smoother::Smoother;
use crate::threads::spread;
use crate::window::Window;
use std::borrow::Cow;

/// Gaussian kernels are cut off at this many standard deviations.
const TRUNCATE: f64 = 4.0;

/// How many pixels a kernel reaches to either side.
pub fn reach(sigma: f64) -> usize {
    (TRUNCATE * sigma + 0.5) as usize
}

/// Sampled Gaussian of standard deviation `sigma` pixels, sum 1.
pub fn kernel(sigma: f64) -> Vec<f64> {
    let radius = reach(sigma) as i64;
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
    gaussian_over(grid, sigma, Cow::Borrowed(&[]), progress)
}

/// As [`gaussian`], in the memory of an image that is no longer needed: to get new memory
/// from the system takes as long as to smooth.
pub fn gaussian_over<'a, T: Height>(
    grid: &Grid<'a, T>,
    sigma: [f64; 2],
    old: Cow<'_, [T]>,
    progress: &mut Progress,
) -> Result<Cow<'a, [T]>> {
    if sigma == [0.0, 0.0] {
        return Ok(Cow::Borrowed(grid.z()));
    }
    let mut smooth = match old {
        Cow::Owned(old) if old.len() == grid.z().len() => old,
        _ => {
            memory::ensure(size_of_val(grid.z()))?;
            vec![T::from_f64(0.0); grid.z().len()]
        }
    };
    let kernels = sigma.map(kernel);
    let bands = smooth.chunks_mut(BAND * grid.cols()).enumerate();
    spread(progress, bands, |(band, into), progress| {
        let rows = into.len() / grid.cols();
        let window = Window { col: 0, row: band * BAND, cols: grid.cols(), rows };
        Smoother::new(grid, &kernels, Vectors::best())?.window(window, into, progress)
    })?;
    Ok(Cow::Owned(smooth))
}

/// Rows that one thread smooths at a time.
const BAND: usize = 32;

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
        let mut smoother = Smoother::new(grid, &kernels, Vectors::best())?;
        let mut smooth = vec![T::from_f64(0.0); grid.cols()];
        let (mut sum, mut count) = (0.0, 0);
        for &row in rows {
            smoother.window(Window { col: 0, row, cols: grid.cols(), rows: 1 }, &mut smooth, progress)?;
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
