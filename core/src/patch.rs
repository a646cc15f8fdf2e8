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
}

pub struct Patch {
    z: Vec<f32>,
    stride: usize,
    window: Window,
    frame: Frame,
    /// The largest |height| over the reference.
    largest: f32,
}

impl Window {
    fn rows<'a, T: Height>(self, grid: &'a Grid<T>) -> impl Iterator<Item = &'a [T]> {
        let Window { col, row, cols, rows } = self;
        (row..row + rows).map(move |row| &grid.row(row)[col..col + cols])
    }
}

/// Takes the reference off the heights; returns the largest |height| left, and whether nothing
/// was rounded, of which nothing is said unless `CHECK`.
#[inline]
fn shift<T: Height, const CHECK: bool>(heights: &[T], reference: f64, into: &mut [f32]) -> (f32, bool) {
    const WIDTH: usize = 16;
    let (mut largest, mut rounded) = ([0.0f32; WIDTH], [false; WIDTH]);
    let mut over = |height: T, lane: usize| {
        let shifted = height.to_f64() - reference;
        let z = shifted as f32;
        largest[lane] = if z.abs() > largest[lane] { z.abs() } else { largest[lane] };
        if CHECK {
            let back = f64::from(z) + reference;
            rounded[lane] |= back < height.to_f64() || back > height.to_f64();
        }
        z
    };
    let (heights, rest) = heights.as_chunks::<WIDTH>();
    let (into, into_rest) = into.split_at_mut(WIDTH * heights.len());
    for (into, heights) in into.as_chunks_mut::<WIDTH>().0.iter_mut().zip(heights) {
        for lane in 0..WIDTH {
            into[lane] = over(heights[lane], lane);
        }
    }
    for (into, &height) in into_rest.iter_mut().zip(rest) {
        *into = over(height, 0);
    }
    (largest.into_iter().fold(0.0, f32::max), !rounded.contains(&true))
}

impl Patch {
    /// A copy of the pixels in the window: over the lowest one, so that it does not matter how
    /// high all of it lies; if that rounds, as they are or over a height that takes nothing from
    /// single precision. Errors: `out-of-memory`, `too-large`.
    pub fn new<T: Height>(grid: &Grid<T>, window: Window) -> Result<Self> {
        let (low, high) = window.rows(grid).fold((f64::INFINITY, f64::NEG_INFINITY), |all, row| {
            let (least, most) = extent(row);
            (all.0.min(least), all.1.max(most))
        });
        let middle = 0.5 * (low + high);
        let is_far = middle.abs() > high - low;
        let coarse = if is_far && middle.is_finite() { f64::from(middle as f32) } else { 0.0 };
        let lowest = if low.is_finite() { low } else { 0.0 };
        let mut patch = Patch::empty(window, lowest)?;
        patch.fill::<T, true>(grid);
        if !patch.frame.is_exact {
            patch.frame.reference = coarse;
            patch.fill::<T, true>(grid);
        }
        if !patch.frame.is_exact {
            patch.frame.reference = lowest;
            patch.fill::<T, true>(grid);
        }
        Ok(patch)
    }

    /// The same of another image of the terrain, over the same height.
    pub fn again<T: Height>(grid: &Grid<T>, window: Window, frame: Frame) -> Result<Self> {
        let mut patch = Patch::empty(window, frame.reference)?;
        patch.fill::<T, true>(grid);
        Ok(patch)
    }

    /// The same as one before.
    pub fn framed<T: Height>(grid: &Grid<T>, window: Window, frame: Frame) -> Result<Self> {
        let mut patch = Patch::empty(window, frame.reference)?;
        patch.fill::<T, false>(grid);
        patch.frame.is_exact = frame.is_exact;
        Ok(patch)
    }

    fn empty(window: Window, reference: f64) -> Result<Self> {
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
        let z = vec![f32::NAN; stride * rows + LANES];
        Ok(Patch { z, stride, window, frame: Frame { reference, is_exact: false }, largest: 0.0 })
    }

    /// Copies the heights over the reference; `is_exact` is looked into if `CHECK`.
    fn fill<T: Height, const CHECK: bool>(&mut self, grid: &Grid<T>) {
        let (mut largest, mut is_exact) = (0.0f32, true);
        for (into, heights) in self.z.chunks_mut(self.stride).zip(self.window.rows(grid)) {
            let shift = if CHECK && is_exact { shift::<T, true> } else { shift::<T, false> };
            let row = shift(heights, self.frame.reference, into);
            (largest, is_exact) = (largest.max(row.0), is_exact & row.1);
        }
        self.largest = largest;
        self.frame.is_exact = is_exact;
    }

    pub fn frame(&self) -> Frame {
        self.frame
    }

    pub fn reference(&self) -> f64 {
        self.frame.reference
    }

    pub fn is_exact(&self) -> bool {
        self.frame.is_exact
    }

    pub fn largest(&self) -> f64 {
        f64::from(self.largest)
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
