//! The heights of a part of the raster as the scan wants them: close together, in single
//! precision, and NaN where no candidate can be.

use crate::error::{Error, Result};
use crate::grid::{Grid, Height};
use crate::lanes::LANES;
use crate::memory;
use crate::predicate::{Point, SUB_BITS};

/// A rectangle of pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    pub col: usize,
    pub row: usize,
    pub cols: usize,
    pub rows: usize,
}

pub struct Patch {
    z: Vec<f32>,
    stride: usize,
    window: Window,
    /// What was taken off the heights.
    reference: f64,
    /// Whether nothing was rounded: so it is where the raster is in single precision.
    is_exact: bool,
    /// The largest |height| over the reference.
    largest: f64,
}

impl Patch {
    /// A copy of the pixels in the window. Errors: `out-of-memory`, `too-large`.
    pub fn new<T: Height>(grid: &Grid<T>, window: Window) -> Result<Self> {
        let Window { col, row, cols, rows } = window;
        // An odd number of cache lines: rows do not compete for the same places of the cache.
        const LINE: usize = 16;
        let stride = ((cols + LANES).div_ceil(LINE) | 1) * LINE;
        let count = stride * (rows + 1);
        if count > i32::MAX as usize {
            let message = format!("{cols} x {rows} pixels are more than can be refined as one tile");
            return Err(Error::input("too-large", message));
        }
        memory::ensure(size_of::<f32>() * count)?;
        let heights = |r: usize| &grid.row(r)[col..col + cols];
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for r in row..row + rows {
            let (mut least, mut most) = (f64::INFINITY, f64::NEG_INFINITY);
            for z in heights(r) {
                let z = z.to_f64();
                least = if z < least { z } else { least };
                most = if z > most { z } else { most };
            }
            (low, high) = (low.min(least), high.max(most));
        }
        // Over the lowest one, so that it does not matter how high all of it lies; if that
        // rounds, as they are or over a height that takes nothing from single precision.
        let middle = 0.5 * (low + high);
        let is_far = middle.abs() > high - low;
        let coarse = if is_far && middle.is_finite() { f64::from(middle as f32) } else { 0.0 };
        let lowest = if low.is_finite() { low } else { 0.0 };
        let mut z = vec![f32::NAN; stride * rows + LANES];
        let mut fill = |reference: f64, may_round: bool| {
            let mut is_exact = true;
            for (into, r) in z.chunks_exact_mut(stride).zip(row..row + rows) {
                for (into, height) in into.iter_mut().zip(heights(r)) {
                    let shifted = height.to_f64() - reference;
                    *into = shifted as f32;
                    is_exact &= f64::from(*into) + reference == height.to_f64() || shifted.is_nan();
                }
                if !(is_exact || may_round) {
                    return false;
                }
            }
            is_exact
        };
        let (reference, is_exact) = if fill(lowest, false) {
            (lowest, true)
        } else if fill(coarse, false) {
            (coarse, true)
        } else {
            fill(lowest, true);
            (lowest, false)
        };
        let largest = if low <= high { (low - reference).abs().max((high - reference).abs()) } else { 0.0 };
        Ok(Patch { z, stride, window, reference, is_exact, largest })
    }

    pub fn reference(&self) -> f64 {
        self.reference
    }

    pub fn is_exact(&self) -> bool {
        self.is_exact
    }

    pub fn largest(&self) -> f64 {
        self.largest
    }

    /// Height of a candidate.
    #[inline]
    pub fn height<T: Height>(&self, place: usize, grid: &Grid<T>) -> f64 {
        if self.is_exact {
            return f64::from(self.z[place]) + self.reference;
        }
        let (col, row) = self.pixel(place);
        grid.at(col, row)
    }

    pub fn stride(&self) -> usize {
        self.stride
    }

    /// All heights, row after row; eight can be read from any pixel on.
    #[inline(always)]
    pub fn z(&self) -> &[f32] {
        &self.z
    }

    /// A lattice point relative to the first pixel.
    #[inline(always)]
    pub fn local(&self, p: Point) -> Point {
        let first = Point::pixel(self.window.col, self.window.row);
        Point { x: p.x - first.x, y: p.y - first.y }
    }

    /// (column, row) relative to the first pixel of a place in `z`.
    #[inline(always)]
    pub fn split(&self, place: usize) -> (usize, usize) {
        // Division is faster in 32 bits, which hold all places.
        let (place, stride) = (place as u32, self.stride as u32);
        ((place % stride) as usize, (place / stride) as usize)
    }

    /// (column, row) in the raster.
    #[inline(always)]
    pub fn pixel(&self, place: usize) -> (usize, usize) {
        let (col, row) = self.split(place);
        (self.window.col + col, self.window.row + row)
    }

    /// The pixel is no candidate from now on; nothing if it lies outside.
    pub fn exclude(&mut self, p: Point) {
        let local = self.local(p);
        let (col, row) = ((local.x >> SUB_BITS) as usize, (local.y >> SUB_BITS) as usize);
        if p.as_pixel().is_some()
            && local.x >= 0
            && local.y >= 0
            && col < self.window.cols
            && row < self.window.rows
        {
            self.z[row * self.stride + col] = f32::NAN;
        }
    }
}
