//! The heights of a part of the raster as the scan wants them: close together, in single
//! precision, and NaN where no candidate can be.

use crate::error::{Error, Result};
use crate::grid::{extent, Grid, Height};
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

/// How heights become single precision.
#[derive(Clone, Copy, Debug)]
pub struct Frame {
    /// What is taken off the heights.
    reference: f64,
    /// Whether nothing is rounded: so it is where the raster is in single precision.
    is_exact: bool,
    /// The largest |height| over the reference.
    largest: f64,
}

pub struct Patch {
    z: Vec<f32>,
    stride: usize,
    window: Window,
    frame: Frame,
}

impl Frame {
    /// For the pixels in the window: over the lowest one, so that it does not matter how high
    /// all of it lies; if that rounds, as they are or over a height that takes nothing from
    /// single precision.
    pub fn of<T: Height>(grid: &Grid<T>, window: Window) -> Self {
        let (low, high) = window.rows(grid).fold((f64::INFINITY, f64::NEG_INFINITY), |all, row| {
            let (least, most) = extent(row);
            (all.0.min(least), all.1.max(most))
        });
        let middle = 0.5 * (low + high);
        let is_far = middle.abs() > high - low;
        let coarse = if is_far && middle.is_finite() { f64::from(middle as f32) } else { 0.0 };
        let lowest = if low.is_finite() { low } else { 0.0 };
        let exact = [lowest, coarse].into_iter().find(|&height| is_exact_over(grid, window, height));
        let reference = exact.unwrap_or(lowest);
        let largest = if low <= high { (low - reference).abs().max((high - reference).abs()) } else { 0.0 };
        Frame { reference, is_exact: exact.is_some(), largest }
    }
}

/// Whether single precision holds all heights over the reference.
fn is_exact_over<T: Height>(grid: &Grid<T>, window: Window, reference: f64) -> bool {
    window.rows(grid).all(|row| {
        row.iter().fold(true, |is_exact, height| {
            let shifted = height.to_f64() - reference;
            let back = f64::from(shifted as f32) + reference;
            is_exact & (back == height.to_f64() || shifted.is_nan())
        })
    })
}

impl Window {
    fn rows<'a, T: Height>(self, grid: &'a Grid<T>) -> impl Iterator<Item = &'a [T]> {
        let Window { col, row, cols, rows } = self;
        (row..row + rows).map(move |row| &grid.row(row)[col..col + cols])
    }
}

impl Patch {
    /// A copy of the pixels in the window. Errors: `out-of-memory`, `too-large`.
    pub fn new<T: Height>(grid: &Grid<T>, window: Window, frame: Frame) -> Result<Self> {
        let Window { cols, rows, .. } = window;
        // An odd number of cache lines: rows do not compete for the same places of the cache.
        const LINE: usize = 16;
        let stride = ((cols + LANES).div_ceil(LINE) | 1) * LINE;
        let count = stride * (rows + 1);
        if count > i32::MAX as usize {
            let message = format!("{cols} x {rows} pixels are more than can be refined as one tile");
            return Err(Error::input("too-large", message));
        }
        memory::ensure(size_of::<f32>() * count)?;
        let mut z = Vec::with_capacity(stride * rows + LANES);
        for (row, heights) in window.rows(grid).enumerate() {
            z.resize(row * stride, f32::NAN);
            z.extend(heights.iter().map(|height| (height.to_f64() - frame.reference) as f32));
        }
        z.resize(stride * rows + LANES, f32::NAN);
        Ok(Patch { z, stride, window, frame })
    }

    pub fn reference(&self) -> f64 {
        self.frame.reference
    }

    pub fn is_exact(&self) -> bool {
        self.frame.is_exact
    }

    pub fn largest(&self) -> f64 {
        self.frame.largest
    }

    /// Height of a candidate.
    #[inline]
    pub fn height<T: Height>(&self, place: usize, grid: &Grid<T>) -> f64 {
        if self.frame.is_exact {
            return f64::from(self.z[place]) + self.frame.reference;
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
