//! The one exact pixel walk of a triangle, and what is measured along it.

use crate::grid::{Grid, Height};
use crate::predicate::{orient2d, Point, SUB_BITS, UNIT};

/// The plane through three points with heights, in pixel steps.
#[derive(Clone, Copy, Debug)]
pub struct Plane {
    col0: f64,
    row0: f64,
    z0: f64,
    per_col: f64,
    per_row: f64,
}

impl Plane {
    #[inline]
    pub fn through(p: [Point; 3], z: [f64; 3]) -> Self {
        let area = orient2d(p[0], p[1], p[2]) as f64;
        let (dz1, dz2) = (z[1] - z[0], z[2] - z[0]);
        let (x1, y1) = (f64::from(p[1].x - p[0].x), f64::from(p[1].y - p[0].y));
        let (x2, y2) = (f64::from(p[2].x - p[0].x), f64::from(p[2].y - p[0].y));
        let unit = f64::from(UNIT);
        Plane {
            col0: f64::from(p[0].x) / unit,
            row0: f64::from(p[0].y) / unit,
            z0: z[0],
            per_col: (dz1 * y2 - dz2 * y1) / area * unit,
            per_row: (dz2 * x1 - dz1 * x2) / area * unit,
        }
    }

    /// Height at column 0 of `row` relative to `col0`, to which [`Plane::at`] adds.
    #[inline(always)]
    fn on_row(&self, row: usize) -> f64 {
        self.z0 + self.per_row * (row as f64 - self.row0)
    }

    #[inline(always)]
    fn at(&self, on_row: f64, col: usize) -> f64 {
        on_row + self.per_col * (col as f64 - self.col0)
    }
}

/// Which pixels of the closed triangle a walk visits.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Corners {
    Included,
    Excluded,
}

/// Calls `visit(row, first, end)` for every row of pixel centres in the closed
/// triangle `p` (positively oriented), columns `first..end`, rows ascending.
#[inline]
pub fn for_each_span(p: [Point; 3], corners: Corners, mut visit: impl FnMut(usize, usize, usize)) {
    let mut v = p;
    v.sort_unstable_by_key(|q| (q.y, q.x));
    let [top, mid, bottom] = v;
    let first_row = (top.y + UNIT - 1) >> SUB_BITS;
    let last_row = bottom.y >> SUB_BITS;
    let mid_is_right = orient2d(top, bottom, mid) < 0;
    for row in first_row..=last_row {
        let y = row << SUB_BITS;
        let long = Crossing::of(top, bottom, y);
        let short = if y <= mid.y && mid.y > top.y {
            Crossing::of(top, mid, y)
        } else {
            Crossing::of(mid, bottom, y)
        };
        let (left, right) = if mid_is_right { (long, short) } else { (short, long) };
        let (mut first, mut last) = (left.ceil(), right.floor());
        if corners == Corners::Excluded {
            // A corner can only stand at an end of its row.
            let is_corner = |col: i32| p.iter().any(|q| q.y == y && q.x == col << SUB_BITS);
            if first <= last && is_corner(first) {
                first += 1;
            }
            if first <= last && is_corner(last) {
                last -= 1;
            }
        }
        if first <= last {
            visit(row as usize, first as usize, last as usize + 1);
        }
    }
}

/// Where an edge crosses a row of pixel centres: `num / den` pixels.
#[derive(Clone, Copy)]
struct Crossing {
    num: i64,
    den: i64,
}

impl Crossing {
    /// Edge from `a` down to `b` (`a.y < b.y`) at height `y`.
    #[inline]
    fn of(a: Point, b: Point, y: i32) -> Self {
        let dy = i64::from(b.y - a.y);
        let dx = i64::from(b.x - a.x);
        Crossing { num: i64::from(a.x) * dy + i64::from(y - a.y) * dx, den: dy << SUB_BITS }
    }

    #[inline]
    fn floor(self) -> i32 {
        self.num.div_euclid(self.den) as i32
    }

    #[inline]
    fn ceil(self) -> i32 {
        (self.num + self.den - 1).div_euclid(self.den) as i32
    }
}

/// The largest vertical error of a walk.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Worst {
    /// Pixels visited.
    pub count: usize,
    pub error: f64,
    pub col: usize,
    pub row: usize,
}

/// The first pixel (in row, column order) with the largest |z - plane|.
#[inline]
pub fn worst<T: Height>(grid: &Grid<T>, p: [Point; 3], z: [f64; 3], corners: Corners) -> Worst {
    let plane = Plane::through(p, z);
    let mut worst = Worst { count: 0, error: -1.0, col: 0, row: 0 };
    for_each_span(p, corners, |row, first, end| {
        let on_row = plane.on_row(row);
        let heights = &grid.row(row)[first..end];
        let error_at = |i: usize| (heights[i].to_f64() - plane.at(on_row, first + i)).abs();
        worst.count += heights.len();
        let largest = row_maximum(heights.len(), error_at);
        if largest > worst.error {
            let i = (0..heights.len()).find(|&i| error_at(i) == largest).unwrap_or(0);
            worst = Worst { error: largest, col: first + i, row, ..worst };
        }
    });
    worst
}

/// Largest value of `error_at` over `0..len`, lane by lane so that it vectorises;
/// a NaN never wins.
#[inline(always)]
fn row_maximum(len: usize, error_at: impl Fn(usize) -> f64) -> f64 {
    const LANES: usize = 8;
    let mut best = -1.0;
    let mut i = 0;
    if len >= 2 * LANES {
        let mut lanes = [-1.0f64; LANES];
        while i + LANES <= len {
            for (lane, best) in lanes.iter_mut().enumerate() {
                let error = error_at(i + lane);
                *best = if error > *best { error } else { *best };
            }
            i += LANES;
        }
        best = lanes.iter().fold(-1.0, |a, &b| if b > a { b } else { a });
    }
    while i < len {
        let error = error_at(i);
        if error > best {
            best = error;
        }
        i += 1;
    }
    best
}

/// Calls `visit(col, row, z, plane)` for every valid pixel of the walk.
#[inline]
pub fn for_each_pixel<T: Height>(
    grid: &Grid<T>,
    p: [Point; 3],
    z: [f64; 3],
    corners: Corners,
    mut visit: impl FnMut(usize, usize, f64, f64),
) {
    let plane = Plane::through(p, z);
    for_each_span(p, corners, |row, first, end| {
        let on_row = plane.on_row(row);
        for (col, height) in (first..end).zip(&grid.row(row)[first..end]) {
            let height = height.to_f64();
            if !height.is_nan() {
                visit(col, row, height, plane.at(on_row, col));
            }
        }
    });
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
    for_each_span(p, Corners::Included, |row, first, end| {
        visit(row, first, end, PlaneRow { plane, on_row: plane.on_row(row) });
    });
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
            for corners in [Corners::Included, Corners::Excluded] {
                let mut seen = Vec::new();
                for_each_span(p, corners, |row, first, end| seen.extend((first..end).map(|col| (row, col))));
                let mut expected = Vec::new();
                for row in 0..12 { for col in 0..12 {
                    let q = Point::pixel(col, row);
                    let inside = (0..3).all(|k| orient2d(p[k], p[(k + 1) % 3], q) >= 0);
                    if inside && (corners == Corners::Included || !p.contains(&q)) { expected.push((row, col)); }
                } }
                prop_assert_eq!(seen, expected);
            }
        }

        #[test]
        fn worst_agrees_with_a_plain_loop(z in prop::collection::vec(-9.0f64..9.0, 400), c in prop::array::uniform6(0usize..20)) {
            let grid = Grid::new(&z, 20, 20).unwrap();
            let mut p = [0, 1, 2].map(|i| Point::pixel(c[2 * i], c[2 * i + 1]));
            prop_assume!(orient2d(p[0], p[1], p[2]) != 0);
            if orient2d(p[0], p[1], p[2]) < 0 { p.swap(1, 2); }
            let zs = p.map(|q| { let (col, row) = q.as_pixel().unwrap(); grid.at(col, row) });
            let mut expected = Worst { count: 0, error: -1.0, col: 0, row: 0 };
            for_each_pixel(&grid, p, zs, Corners::Excluded, |col, row, z, plane| {
                expected.count += 1;
                if (z - plane).abs() > expected.error { expected = Worst { error: (z - plane).abs(), col, row, ..expected }; }
            });
            prop_assert_eq!(worst(&grid, p, zs, Corners::Excluded), expected);
        }
    }
}
