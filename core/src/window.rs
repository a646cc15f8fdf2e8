//! Rectangles of pixels.

use crate::predicate::{Point, SUB_BITS};

/// A rectangle of pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    pub col: usize,
    pub row: usize,
    pub cols: usize,
    pub rows: usize,
}

/// Heights of a row that are worked on together.
pub const WIDTH: usize = 16;

impl Window {
    /// The pixels of this one between and beside the points, and others that make it no slower.
    pub fn around(self, points: &[Point]) -> Self {
        let reach = |first: usize, count: usize, of: fn(&Point) -> i32| {
            let (low, high) =
                points.iter().map(of).fold((i32::MAX, i32::MIN), |all, v| (all.0.min(v), all.1.max(v)));
            let first_seen = first.max((low >> SUB_BITS).max(0) as usize);
            let end = (first + count).min((high >> SUB_BITS).max(0) as usize + 2);
            (first_seen, end.saturating_sub(first_seen))
        };
        let ((col, cols), (row, rows)) =
            (reach(self.col, self.cols, |p| p.x), reach(self.row, self.rows, |p| p.y));
        Window { col, row, cols: cols.next_multiple_of(WIDTH).min(self.col + self.cols - col), rows }
    }
}
