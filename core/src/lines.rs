//! Rows of a raster in double precision, for sums over them.

use crate::error::Result;
use crate::grid::{Grid, Height};
use crate::memory;
use std::ops::Range;

/// The rows that a kernel covers, for the columns of a strip. Each is read once.
pub struct Lines {
    z: Vec<f64>,
    width: usize,
    has_void: Vec<bool>,
    /// The row after the last one read.
    end: usize,
}

impl Lines {
    /// So many rows of so many columns at most. Errors: `out-of-memory`.
    pub fn new<T: Height>(grid: &Grid<T>, count: usize, width: usize) -> Result<Self> {
        // A kernel higher than the raster is cut off everywhere.
        let count = if count <= grid.rows() { count } else { 0 };
        memory::ensure(size_of::<f64>() * count * width)?;
        Ok(Lines { z: vec![0.0; count * width], width, has_void: vec![false; count], end: 0 })
    }

    /// Other columns follow.
    pub fn clear(&mut self) {
        self.end = 0;
    }

    /// Reads the columns of those of the rows, as many as there are lines, that lie after the
    /// last one read, a void as 0; whether no pixel of them all is void.
    #[inline(always)]
    pub fn hold<T: Height>(&mut self, grid: &Grid<T>, rows: Range<usize>, columns: Range<usize>) -> bool {
        for row in rows.start.max(self.end)..rows.end {
            let at = row % self.has_void.len();
            let mut has_void = false;
            for (into, z) in self.z[at * self.width..].iter_mut().zip(&grid.row(row)[columns.clone()]) {
                let z = z.to_f64();
                *into = if z.is_nan() { 0.0 } else { z };
                has_void |= z.is_nan();
            }
            self.has_void[at] = has_void;
        }
        self.end = rows.end;
        !self.has_void.contains(&true)
    }

    /// The lines at a distance from the one of `row`, the middle one.
    #[inline(always)]
    pub fn around<'l>(&'l self, row: usize) -> impl Fn(usize) -> [&'l [f64]; 2] {
        let count = self.has_void.len();
        let middle = row % count;
        move |distance| {
            [middle + count - distance, middle + distance].map(|at| {
                let at = if at >= count { at - count } else { at };
                &self.z[at * self.width..][..self.width]
            })
        }
    }
}
