//! The raster of heights the core works on: row-major, NaN where void.

use crate::error::{Error, Result};
use crate::predicate::MAX_SIDE;

/// A sample type of the raster; arithmetic is always done in `f64`.
pub trait Height: Copy + Send + Sync + 'static {
    fn to_f64(self) -> f64;
    fn from_f64(value: f64) -> Self;
}

impl Height for f32 {
    #[inline(always)]
    fn to_f64(self) -> f64 {
        f64::from(self)
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
    fn from_f64(value: f64) -> Self {
        value
    }
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

    pub fn is_valid(&self, col: usize, row: usize) -> bool {
        !self.at(col, row).is_nan()
    }

    pub fn count_valid(&self) -> usize {
        self.z.iter().filter(|z| !z.to_f64().is_nan()).count()
    }
}
