//! A convex polygon over a patch, in strips of eight columns.

use crate::lanes::{Lanes, Part, LANES};
use crate::patch::Patch;
use crate::predicate::{Point, SUB_BITS};
use crate::scan::{rows_between, Side};
use std::ops::Range;

/// In wider polygons it pays to find the rows that a strip of columns meets.
const NARROW: i32 = 2 * LANES as i32;

/// Who looks at strips. All of it must be `#[inline(always)]`, like all that a kernel runs.
pub trait Visitor<L: Lanes> {
    /// Eight heights from column `col` on, of each of the rows.
    fn strip<'h>(&mut self, col: i32, rows: Range<i32>, heights: impl Iterator<Item = &'h [f32; LANES]>);
}

/// Shows the visitor strips that hold all pixels of the polygon, its corners relative to the patch and within
/// the bounds (first column and row, last column and row), and more beside it; gives it back.
#[inline(always)]
pub fn for_each_strip<L: Lanes, V: Visitor<L>, const N: usize>(
    p: [Point; N],
    bounds: [i32; 4],
    patch: &Patch,
    mut visitor: V,
) -> V {
    let [left, top, right, bottom] = bounds;
    if right - left >= NARROW {
        return L::apart(Wide { p, bounds, patch, visitor });
    }
    let mut col = left;
    while col <= right {
        let at = top as usize * patch.stride() + col as usize;
        visitor.strip(col, top..bottom + 1, patch.rows(at, (bottom + 1 - top) as usize));
        col += LANES as i32;
    }
    visitor
}

/// A polygon that is wide.
struct Wide<'a, V, const N: usize> {
    p: [Point; N],
    bounds: [i32; 4],
    patch: &'a Patch,
    visitor: V,
}

impl<L: Lanes, V: Visitor<L>, const N: usize> Part<L> for Wide<'_, V, N> {
    type Output = V;

    #[inline(always)]
    fn run(mut self) -> V {
        let [left, top, right, bottom] = self.bounds;
        // Relative to where single precision is exact.
        let corner = |k: usize| {
            let p = self.p[k % N];
            [p.x - (left << SUB_BITS), p.y - (top << SUB_BITS)]
        };
        let sides: [Side; N] = std::array::from_fn(|k| Side::new(corner(k), corner(k + 1)));
        let mut col = left;
        while col <= right {
            let from = (col - left) as f32;
            let (first, last) = rows_between(&sides, from, from + (LANES - 1) as f32);
            let first = top + first.max(0);
            let rows = first..(top + last).min(bottom).max(first - 1) + 1;
            let at = first as usize * self.patch.stride() + col as usize;
            let heights = self.patch.rows(at, rows.len());
            self.visitor.strip(col, rows, heights);
            col += LANES as i32;
        }
        self.visitor
    }
}
