//! The raster of heights the core works on: row-major, NaN where void.

use crate::error::{Error, Result};
use crate::predicate::{Point, MAX_SIDE, SUB_BITS, UNIT};
use crate::progress::Progress;
use crate::threads::spread;
use std::ops::Sub;

/// A sample type of the raster; arithmetic whose rounding matters is done in `f64`.
pub trait Height: Copy + PartialOrd + Sub<Output = Self> + Send + Sync + 'static {
    fn to_f64(self) -> f64;
    fn to_f32(self) -> f32;
    fn from_f64(value: f64) -> Self;
}

impl Height for f32 {
    #[inline(always)]
    fn to_f64(self) -> f64 {
        f64::from(self)
    }
    #[inline(always)]
    fn to_f32(self) -> f32 {
        self
    }
    #[inline(always)]
    fn from_f64(value: f64) -> Self {
        value as f32
    }
}

impl Height for f64 {
    #[inline(always)]
    fn to_f64(self) -> f64 {
        self
    }
    #[inline(always)]
    fn to_f32(self) -> f32 {
        self as f32
    }
    #[inline(always)]
    fn from_f64(value: f64) -> Self {
        value
    }
}

/// The lowest and the highest, voids aside; an infinite interval the wrong way round if there are no others.
pub fn extent<T: Height>(heights: &[T]) -> (f64, f64) {
    // Twice through what the cache holds is faster than both at once.
    const BLOCK: usize = 1 << 12;
    heights.chunks(BLOCK).fold((f64::INFINITY, f64::NEG_INFINITY), |all, block| {
        let low = foremost(block, T::from_f64(f64::INFINITY), |a, b| a < b);
        let high = foremost(block, T::from_f64(f64::NEG_INFINITY), |a, b| a > b);
        (all.0.min(low.to_f64()), all.1.max(high.to_f64()))
    })
}

/// The height that comes before all others and `none`; voids come before nothing.
#[inline(always)]
fn foremost<T: Height>(heights: &[T], none: T, is_before: impl Fn(T, T) -> bool) -> T {
    const WIDTH: usize = 32;
    let before = |a: T, b: T| if is_before(a, b) { a } else { b };
    let mut first = [none; WIDTH];
    let (chunks, rest) = heights.as_chunks::<WIDTH>();
    for chunk in chunks {
        for (first, &height) in first.iter_mut().zip(chunk) {
            *first = before(height, *first);
        }
    }
    rest.iter().chain(&first).fold(none, |all, &height| before(height, all))
}

/// The largest |height|, 0 if all are void. Errors: `cancelled`.
pub fn largest<T: Height>(heights: &[T], progress: &mut Progress) -> Result<f64> {
    const CHUNK: usize = 1 << 18;
    let extents = spread(progress, heights.chunks(CHUNK), |chunk, _| Ok(extent(chunk)))?;
    let known = extents.into_iter().filter(|(low, high)| low <= high);
    Ok(known.fold(0.0, |largest, (low, high)| low.abs().max(high.abs()).max(largest)))
}

/// Borrowed heights of a `rows` x `cols` raster; a NaN is a void pixel.
#[derive(Clone, Copy)]
pub struct Grid<'a, T> {
    z: &'a [T],
    rows: usize,
    cols: usize,
}

impl<'a, T: Height> Grid<'a, T> {
    /// Errors: `too-small` below 2 x 2, `too-large` beyond the exact lattice, `not-2d`
    /// if `z` has another length.
    pub fn new(z: &'a [T], rows: usize, cols: usize) -> Result<Self> {
        if rows < 2 || cols < 2 {
            let message = format!("a TIN needs at least 2 x 2 pixels, the DEM has {cols} x {rows}");
            return Err(Error::input("too-small", message));
        }
        if rows > MAX_SIDE || cols > MAX_SIDE {
            let message = format!("{cols} x {rows} pixels exceed {MAX_SIDE} on a side");
            return Err(Error::input("too-large", message));
        }
        if rows * cols != z.len() {
            let message = format!("{} heights do not fill {cols} x {rows} pixels", z.len());
            return Err(Error::input("not-2d", message));
        }
        Ok(Grid { z, rows, cols })
    }

    pub fn rows(&self) -> usize {
        self.rows
    }

    pub fn cols(&self) -> usize {
        self.cols
    }

    pub fn z(&self) -> &'a [T] {
        self.z
    }

    #[inline(always)]
    pub fn row(&self, row: usize) -> &'a [T] {
        &self.z[row * self.cols..(row + 1) * self.cols]
    }

    #[inline(always)]
    pub fn at(&self, col: usize, row: usize) -> f64 {
        self.z[row * self.cols + col].to_f64()
    }

    /// Height at a lattice point: bilinear between the valid ones of the pixels around
    /// it, or that of the nearest valid pixel where these are all void.
    pub fn interpolate(&self, p: Point) -> f64 {
        self.interpolate_by(p, |col, row| self.at(col, row))
    }

    /// The same of other heights of the pixels, NaN for a void.
    pub fn interpolate_by(&self, p: Point, mut at: impl FnMut(usize, usize) -> f64) -> f64 {
        let (col, row) = ((p.x >> SUB_BITS) as usize, (p.y >> SUB_BITS) as usize);
        let fraction = |v: i32| f64::from(v & (UNIT - 1)) / f64::from(UNIT);
        let (x, y) = (fraction(p.x), fraction(p.y));
        let (mut sum, mut weights) = (0.0, 0.0);
        for (dx, dy, weight) in
            [(0, 0, (1.0 - x) * (1.0 - y)), (1, 0, x * (1.0 - y)), (0, 1, (1.0 - x) * y), (1, 1, x * y)]
        {
            let z = if weight > 0.0 { at(col + dx, row + dy) } else { f64::NAN };
            if !z.is_nan() {
                sum += weight * z;
                weights += weight;
            }
        }
        if weights > 0.0 {
            sum / weights
        } else {
            self.nearest(col, row, at)
        }
    }

    /// Height of the valid pixel nearest to a void one, searched in growing squares;
    /// NaN if there is none.
    fn nearest(&self, col: usize, row: usize, mut at: impl FnMut(usize, usize) -> f64) -> f64 {
        for reach in 1..self.cols.max(self.rows) {
            let (left, right) = (col.saturating_sub(reach), (col + reach).min(self.cols - 1));
            let (top, bottom) = (row.saturating_sub(reach), (row + reach).min(self.rows - 1));
            let found = (top..=bottom)
                .flat_map(|r| {
                    // Inner rows of the square: its two ends only.
                    let step = if r == top || r == bottom { 1 } else { (right - left).max(1) };
                    (left..=right).step_by(step).map(move |c| (c, r))
                })
                .filter(|&(c, r)| !at(c, r).is_nan())
                .min_by_key(|&(c, r)| (c.abs_diff(col).pow(2) + r.abs_diff(row).pow(2), r, c));
            if let Some((c, r)) = found {
                return at(c, r);
            }
        }
        f64::NAN
    }

    pub fn is_valid(&self, col: usize, row: usize) -> bool {
        !self.at(col, row).is_nan()
    }

    pub fn count_valid(&self) -> usize {
        self.z.iter().filter(|z| !z.to_f64().is_nan()).count()
    }
}
