//! A convex polygon over a patch, in strips of eight columns.

use crate::lanes::{Lanes, Part, LANES};
use crate::patch::Patch;
use crate::predicate::{Point, SUB_BITS, UNIT};
use crate::scan::{rows_between, Side};

/// In wider polygons it pays to find the rows that a strip of columns meets.
const NARROW: i32 = 2 * LANES as i32;

/// Who looks at strips. All of it must be `#[inline(always)]`, like all that a kernel runs.
pub trait Visitor<L: Lanes> {
    /// Eight heights a row, from column `col` of row `first` on.
    fn strip<'h>(&mut self, col: i32, first: i32, rows: impl Iterator<Item = &'h [f32; LANES]>);
}

/// First column and row of the pixels in the bounds of a polygon, last column and row.
#[inline(always)]
pub fn bounds<const N: usize>(p: [Point; N]) -> [i32; 4] {
    let (mut low, mut high) = (p[0], p[0]);
    for p in &p[1..] {
        low = Point { x: low.x.min(p.x), y: low.y.min(p.y) };
        high = Point { x: high.x.max(p.x), y: high.y.max(p.y) };
    }
    let ceil = |v: i32| (v + UNIT - 1) >> SUB_BITS;
    [ceil(low.x), ceil(low.y), high.x >> SUB_BITS, high.y >> SUB_BITS]
}

/// Shows the visitor strips that hold all pixels of the polygon, its corners relative to the patch, and more
/// beside it; gives it back.
#[inline(always)]
pub fn for_each_strip<L: Lanes, V: Visitor<L>, const N: usize>(
    p: [Point; N],
    patch: &Patch,
    mut visitor: V,
) -> V {
    let [left, top, right, bottom] = bounds(p);
    if right - left >= NARROW {
        return L::apart(Wide { p, patch, visitor });
    }
    let mut col = left;
    while col <= right {
        let at = top as usize * patch.stride() + col as usize;
        visitor.strip(col, top, patch.rows(at, (bottom + 1 - top) as usize));
        col += LANES as i32;
    }
    visitor
}

/// A polygon that is wide.
struct Wide<'a, V, const N: usize> {
    p: [Point; N],
    patch: &'a Patch,
    visitor: V,
}

impl<L: Lanes, V: Visitor<L>, const N: usize> Part<L> for Wide<'_, V, N> {
    type Output = V;

    #[inline(always)]
    fn run(mut self) -> V {
        let [left, top, right, bottom] = bounds(self.p);
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
            let (first, last) = (top + first.max(0), (top + last).min(bottom));
            let at = first as usize * self.patch.stride() + col as usize;
            self.visitor.strip(col, first, self.patch.rows(at, (last + 1 - first).max(0) as usize));
            col += LANES as i32;
        }
        self.visitor
    }
}
