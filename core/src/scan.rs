//! The one exact pixel walk of a triangle, and what is measured along it.

use crate::grid::{Grid, Height};
use crate::predicate::{orient2d, Point, SUB_BITS, UNIT};

/// The plane through three points with heights, in pixel steps.
#[derive(Clone, Copy, Debug)]
pub struct Plane {
    col0: f64,
    row0: f64,
    pub(crate) z0: f64,
    pub(crate) per_col: f64,
    pub(crate) per_row: f64,
}

impl Plane {
    #[inline]
    pub fn through(p: [Point; 3], z: [f64; 3]) -> Self {
        let scale = f64::from(UNIT) / orient2d(p[0], p[1], p[2]) as f64;
        let (dz1, dz2) = (z[1] - z[0], z[2] - z[0]);
        let (x1, y1) = (f64::from(p[1].x - p[0].x), f64::from(p[1].y - p[0].y));
        let (x2, y2) = (f64::from(p[2].x - p[0].x), f64::from(p[2].y - p[0].y));
        let pixels = 1.0 / f64::from(UNIT);
        Plane {
            col0: f64::from(p[0].x) * pixels,
            row0: f64::from(p[0].y) * pixels,
            z0: z[0],
            per_col: (dz1 * y2 - dz2 * y1) * scale,
            per_row: (dz2 * x1 - dz1 * x2) * scale,
        }
    }

    /// Height at column 0 of `row` relative to `col0`, to which [`Plane::at`] adds.
    #[inline(always)]
    pub(crate) fn on_row(&self, row: usize) -> f64 {
        self.z0 + self.per_row * (row as f64 - self.row0)
    }

    #[inline(always)]
    pub(crate) fn at(&self, on_row: f64, col: usize) -> f64 {
        on_row + self.per_col * (f64::from(col as i32) - self.col0)
    }
}

/// The rows of pixel centres in the closed triangle `p` (positively oriented), as (row,
/// first column, column after the last), ascending; rows without a pixel are left out.
pub struct Spans {
    row: i32,
    last_row: i32,
    /// From this row on the lower of the two short edges bounds the triangle.
    turn_row: i32,
    lower: [Point; 2],
    mid_is_right: bool,
    long: Edge,
    short: Edge,
}

impl Spans {
    #[inline(always)]
    pub fn new(p: [Point; 3]) -> Self {
        let [top, mid, bottom] = downwards(p);
        let row = (top.y + UNIT - 1) >> SUB_BITS;
        let turn_row = if bottom.y > mid.y { (mid.y + UNIT - 1) >> SUB_BITS } else { i32::MAX };
        let long = Edge::new(top, bottom, row);
        Spans {
            row,
            last_row: bottom.y >> SUB_BITS,
            turn_row,
            lower: [mid, bottom],
            mid_is_right: orient2d(top, bottom, mid) < 0,
            long,
            short: if turn_row > row { Edge::new(top, mid, row) } else { long },
        }
    }
}

impl Iterator for Spans {
    type Item = (usize, usize, usize);

    #[inline(always)]
    fn next(&mut self) -> Option<Self::Item> {
        while self.row <= self.last_row {
            let row = self.row;
            if row == self.turn_row {
                self.short = Edge::new(self.lower[0], self.lower[1], row);
            }
            let (left, right) =
                if self.mid_is_right { (&self.long, &self.short) } else { (&self.short, &self.long) };
            let (first, last) = (left.ceil(), right.floor());
            self.row += 1;
            self.long.step();
            self.short.step();
            if first <= last {
                return Some((row as usize, first as usize, last as usize + 1));
            }
        }
        None
    }
}

/// The corners by rising (y, x).
#[inline]
fn downwards([a, b, c]: [Point; 3]) -> [Point; 3] {
    let order = |p: Point, q: Point| if (q.y, q.x) < (p.y, p.x) { (q, p) } else { (p, q) };
    let (a, b) = order(a, b);
    let (b, c) = order(b, c);
    let (a, b) = order(a, b);
    [a, b, c]
}

/// Where an edge crosses the rows of pixel centres: column `whole + rest / den`,
/// moved on from row to row without a division.
#[derive(Clone, Copy)]
struct Edge {
    whole: i32,
    step_whole: i32,
    rest: i64,
    step_rest: i64,
    den: i64,
}

impl Edge {
    /// The edge from `a` down to `b` (`a.y < b.y`) at `row`.
    #[inline]
    fn new(a: Point, b: Point, row: i32) -> Self {
        let (dx, dy) = (b.x - a.x, b.y - a.y);
        let y = row << SUB_BITS;
        let (step_whole, step_rest) = (dx.div_euclid(dy), dx.rem_euclid(dy));
        if y == a.y && a.x & (UNIT - 1) == 0 {
            let (step_rest, den) = (i64::from(step_rest), i64::from(dy));
            return Edge { whole: a.x >> SUB_BITS, step_whole, rest: 0, step_rest, den };
        }
        let den = i64::from(dy) << SUB_BITS;
        let num = i64::from(a.x) * i64::from(dy) + i64::from(y - a.y) * i64::from(dx);
        Edge {
            whole: num.div_euclid(den) as i32,
            step_whole,
            rest: num.rem_euclid(den),
            step_rest: i64::from(step_rest) << SUB_BITS,
            den,
        }
    }

    #[inline(always)]
    fn step(&mut self) {
        self.whole += self.step_whole;
        self.rest += self.step_rest;
        if self.rest >= self.den {
            self.rest -= self.den;
            self.whole += 1;
        }
    }

    #[inline(always)]
    fn floor(&self) -> i32 {
        self.whole
    }

    #[inline(always)]
    fn ceil(&self) -> i32 {
        self.whole + i32::from(self.rest > 0)
    }
}

/// A side of a polygon, in pixels, from left to right.
pub struct Side {
    x: [f32; 2],
    y: f32,
    slope: f32,
}

impl Side {
    #[inline(always)]
    pub fn new(a: [i32; 2], b: [i32; 2]) -> Self {
        let ([ax, ay], [bx, by]) = if a[0] <= b[0] { (a, b) } else { (b, a) };
        let pixels = |v: i32| v as f32 * (1.0 / UNIT as f32);
        // An upright side is met by the other two where it ends.
        let slope = if ax < bx { (by - ay) as f32 / (bx - ax) as f32 } else { 0.0 };
        Side { x: [pixels(ax), pixels(bx)], y: pixels(ay), slope }
    }
}

/// The rows that a convex polygon has between two columns, and perhaps one more on either side.
#[inline(always)]
pub fn rows_between<const N: usize>(sides: &[Side; N], left: f32, right: f32) -> (i32, i32) {
    // There is no NaN to look out for.
    let lower = |a: f32, b: f32| if a < b { a } else { b };
    let higher = |a: f32, b: f32| if a > b { a } else { b };
    let (mut top, mut bottom) = (f32::INFINITY, f32::NEG_INFINITY);
    for side in sides {
        let (from, to) = (higher(left, side.x[0]), lower(right, side.x[1]));
        if from <= to {
            let [a, b] = [from, to].map(|x| side.y + (x - side.x[0]) * side.slope);
            (top, bottom) = (lower(top, lower(a, b)), higher(bottom, higher(a, b)));
        }
    }
    // A row more than what rounding can take.
    ((top - 0.5).floor() as i32, (bottom + 0.5).ceil() as i32)
}

/// Calls `visit(col, row, z, plane)` for every valid pixel of the walk.
#[inline]
pub fn for_each_pixel<T: Height>(
    grid: &Grid<T>,
    p: [Point; 3],
    z: [f64; 3],
    mut visit: impl FnMut(usize, usize, f64, f64),
) {
    let plane = Plane::through(p, z);
    for (row, first, end) in Spans::new(p) {
        let on_row = plane.on_row(row);
        for (col, height) in (first..end).zip(&grid.row(row)[first..end]) {
            let height = height.to_f64();
            if !height.is_nan() {
                visit(col, row, height, plane.at(on_row, col));
            }
        }
    }
}

/// A plane on one row of pixels.
#[derive(Clone, Copy)]
pub struct PlaneRow {
    plane: Plane,
    on_row: f64,
}

impl PlaneRow {
    #[inline(always)]
    pub fn at(&self, col: usize) -> f64 {
        self.plane.at(self.on_row, col)
    }
}

/// Calls `visit(row, first, end, plane)` for every span of the closed triangle.
#[inline]
pub fn for_each_plane_row(p: [Point; 3], z: [f64; 3], mut visit: impl FnMut(usize, usize, usize, PlaneRow)) {
    let plane = Plane::through(p, z);
    for (row, first, end) in Spans::new(p) {
        visit(row, first, end, PlaneRow { plane, on_row: plane.on_row(row) });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_walk_visits_exactly_the_closed_triangle(c in prop::array::uniform6(0i32..(12 << SUB_BITS)), on_pixels: bool) {
            let snap = |v: i32| if on_pixels { v >> SUB_BITS << SUB_BITS } else { v };
            let mut p = [0, 1, 2].map(|i| Point { x: snap(c[2 * i]), y: snap(c[2 * i + 1]) });
            prop_assume!(orient2d(p[0], p[1], p[2]) != 0);
            if orient2d(p[0], p[1], p[2]) < 0 { p.swap(1, 2); }
            let seen: Vec<_> = Spans::new(p).flat_map(|(row, first, end)| (first..end).map(move |col| (row, col))).collect();
            let mut expected = Vec::new();
            for row in 0..12 { for col in 0..12 {
                let q = Point::pixel(col, row);
                if (0..3).all(|k| orient2d(p[k], p[(k + 1) % 3], q) >= 0) { expected.push((row, col)); }
            } }
            prop_assert_eq!(seen, expected);
        }
    }
}
