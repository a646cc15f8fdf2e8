//! What in the heights is not terrain: how strong the noise is, and which pixels are spikes.

use crate::error::Result;
use crate::grid::{Grid, Height};
use crate::progress::Progress;
use crate::threads::spread;

/// The largest number of samples a robust statistic looks at.
pub const MAX_SAMPLES: usize = 1 << 16;
/// sigma = 1.4826 MAD for normally distributed errors.
const MAD_TO_SIGMA: f64 = 1.4826;

/// Every how many of `count` things are looked at for at most `most` of them: odd, so that it
/// shares no period with powers of two, such as the width of a tile.
pub(crate) fn stride(count: usize, most: usize) -> usize {
    match count.div_ceil(most) {
        0 | 1 => 1,
        step => step | 1,
    }
}

/// Standard deviation of the noise: 1.4826 times the median of
/// |[1 -2 1] x [1 -2 1]| / 6 over pixels with a complete neighbourhood
/// (Immerkaer 1996, made robust). 0 where there is no such pixel.
pub fn noise<T: Height>(grid: &Grid<T>) -> f64 {
    // Bits, because those of numbers that are not negative sort like the values, and faster.
    let mut residuals: Vec<u64> = Vec::new();
    let mut line = vec![0.0; grid.cols()];
    for row in (1..grid.rows() - 1).step_by(stride(grid.z().len(), MAX_SAMPLES)) {
        let [a, b, c] = [grid.row(row - 1), grid.row(row), grid.row(row + 1)];
        for (((second, a), b), c) in line.iter_mut().zip(a).zip(b).zip(c) {
            *second = a.to_f64() - 2.0 * b.to_f64() + c.to_f64();
        }
        residuals.extend(line.windows(3).map(|s| (s[0] - 2.0 * s[1] + s[2]).abs().to_bits()));
    }
    residuals.retain(|&bits| !f64::from_bits(bits).is_nan());
    if residuals.is_empty() {
        return 0.0;
    }
    let middle = (residuals.len() - 1) / 2;
    MAD_TO_SIGMA / 6.0 * f64::from_bits(*residuals.select_nth_unstable(middle).1)
}

/// The largest number of heights whose range is looked at.
const RANGE_SAMPLES: usize = 1 << 14;
/// Differences below this share of the range of the heights are never spikes.
const SPIKE_FLOOR: f64 = 2e-3;
/// A spike needs this many valid neighbours to be recognised.
const MIN_NEIGHBOURS: usize = 5;
/// With this many of the eight neighbours two opposite pairs are complete.
const MIN_PAIRED: usize = 6;
/// Rows that one thread looks through at a time.
const BAND: usize = 32;
/// Pixels of which mostly none is marked.
const CHUNK: usize = 32;

/// Pixels that stand out of their neighbourhood, with the height they get.
///
/// A pixel is a spike if it lies outside the second smallest and second largest of
/// its neighbours by more than half their spread plus max(4 `noise`, a floor); it
/// takes the neighbours' median.
pub fn spikes<T: Height>(grid: &Grid<T>, noise: f64, progress: &mut Progress) -> Result<Vec<(usize, T)>> {
    let margin = (4.0 * noise).max(SPIKE_FLOOR * range(grid));
    let bands = grid.rows().div_ceil(BAND);
    let nowhere = vec![T::from_f64(f64::NAN); grid.cols()];
    let found = spread(progress, 0..bands, |band, progress| {
        let (mut found, mut marks) = (Vec::new(), vec![false; grid.cols()]);
        let rows = band * BAND..((band + 1) * BAND).min(grid.rows());
        for row in rows.clone() {
            mark_peaks(grid, row, margin, &nowhere, &mut marks);
            let marked = (0..).zip(marks.chunks(CHUNK)).filter(|(_, chunk)| chunk.contains(&true));
            for col in marked.flat_map(|(i, chunk)| (i * CHUNK..).zip(chunk).filter(|c| *c.1)).map(|c| c.0) {
                found.extend(without_spike(grid, col, row, margin).map(|z| (row * grid.cols() + col, z)));
            }
            progress.poll(grid.cols(), || (row - rows.start) as f64 / rows.len() as f64)?;
        }
        Ok(found)
    })?;
    Ok(found.concat())
}

/// From the lowest to the highest height, but for a hundredth at either end.
fn range<T: Height>(grid: &Grid<T>) -> f64 {
    let step = stride(grid.z().len(), RANGE_SAMPLES);
    let mut sample: Vec<f64> =
        grid.z().iter().step_by(step).map(|z| z.to_f64()).filter(|z| !z.is_nan()).collect();
    let mut quantile = |q: f64| match sample.len() {
        0 => 0.0,
        count => *sample.select_nth_unstable_by(((count - 1) as f64 * q) as usize, f64::total_cmp).1,
    };
    quantile(0.99) - quantile(0.01)
}

/// Marks the pixels of a row that can be spikes: all but one at most of the four neighbours
/// beside, above and below are lower by more than `margin`, or higher, or missing. Written so
/// that it vectorises.
fn mark_peaks<T: Height>(grid: &Grid<T>, row: usize, margin: f64, nowhere: &[T], marks: &mut [bool]) {
    // Less than the margin, so that rounding loses no spike.
    let margin = margin * (1.0 - 1e-6);
    let (low, high) = (T::from_f64(-margin), T::from_f64(margin));
    let is_peak = |z: T, around: [T; 4]| {
        let (mut near_or_above, mut near_or_below) = (0, 0);
        for other in around {
            near_or_above += i32::from(other - z >= low);
            near_or_below += i32::from(other - z <= high);
        }
        !z.to_f64().is_nan() & ((near_or_above <= 1) | (near_or_below <= 1))
    };
    let (last, z) = (grid.cols() - 1, grid.row(row));
    let above = if row == 0 { nowhere } else { grid.row(row - 1) };
    let below = if row + 1 == grid.rows() { nowhere } else { grid.row(row + 1) };
    let inner = marks[1..last].iter_mut().zip(&z[..last - 1]).zip(&z[1..last]).zip(&z[2..]);
    for (((((mark, &left), &z), &right), &above), &below) in inner.zip(&above[1..last]).zip(&below[1..last]) {
        *mark = is_peak(z, [left, right, above, below]);
    }
    marks[0] = is_peak(z[0], [nowhere[0], z[1], above[0], below[0]]);
    marks[last] = is_peak(z[last], [z[last - 1], nowhere[0], above[last], below[last]]);
}

/// The height that a spike gets; `None` for other pixels.
fn without_spike<T: Height>(grid: &Grid<T>, col: usize, row: usize, margin: f64) -> Option<T> {
    let mut around = [0.0; 8];
    let mut count = 0;
    for r in row.saturating_sub(1)..=(row + 1).min(grid.rows() - 1) {
        for c in col.saturating_sub(1)..=(col + 1).min(grid.cols() - 1) {
            let other = grid.at(c, r);
            if (c, r) != (col, row) && !other.is_nan() {
                around[count] = other;
                count += 1;
            }
        }
    }
    let around = &mut around[..count];
    if count < MIN_NEIGHBOURS {
        return None;
    }
    around.sort_unstable_by(f64::total_cmp);
    let z = grid.at(col, row);
    // On the border the second smallest may still be on the near side of a ramp.
    let rank = usize::from(count >= MIN_PAIRED);
    let (low, high) = (around[rank], around[count - 1 - rank]);
    let is_spike = (z - high).max(low - z) > 0.5 * (high - low) + margin;
    is_spike.then(|| T::from_f64(0.5 * (around[(count - 1) / 2] + around[count / 2])))
}
