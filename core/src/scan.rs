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
/// triangle `p` (positively oriented): columns `first..end`, rows ascending.
#[inline]
pub fn for_each_span(p: [Point; 3], corners: Corners, mut visit: impl FnMut(usize, usize, usize)) {
    let [top, mid, bottom] = downwards(p);
    let first_row = (top.y + UNIT - 1) >> SUB_BITS;
    let last_row = bottom.y >> SUB_BITS;
    let mid_is_right = orient2d(top, bottom, mid) < 0;
    // From this row on the lower of the two short edges bounds the triangle.
    let turn_row = if bottom.y > mid.y { (mid.y + UNIT - 1) >> SUB_BITS } else { i32::MAX };
    let skip = match corners {
        Corners::Excluded => [top, mid, bottom].map(pixel_or_none),
        Corners::Included => [NO_PIXEL; 3],
    };
    let mut long = Edge::new(top, bottom, first_row);
    let mut short = if turn_row > first_row { Edge::new(top, mid, first_row) } else { long };
    for row in first_row..=last_row {
        if row == turn_row {
            short = Edge::new(mid, bottom, row);
        }
        let (left, right) = if mid_is_right { (&long, &short) } else { (&short, &long) };
        let (mut first, mut last) = (left.ceil(), right.floor());
        // A corner can only stand at an end of its row.
        for (corner_row, corner_col) in skip {
            if corner_row == row {
                first += i32::from(corner_col == first);
                last -= i32::from(corner_col == last);
            }
        }
        if first <= last {
            visit(row as usize, first as usize, last as usize + 1);
        }
        long.step();
        short.step();
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

const NO_PIXEL: (i32, i32) = (-1, -1);

/// (row, column) of a pixel centre.
#[inline]
fn pixel_or_none(p: Point) -> (i32, i32) {
    p.as_pixel().map_or(NO_PIXEL, |(col, row)| (row as i32, col as i32))
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

/// Pixels looked at together in long rows.
const LANES: usize = 8;

/// The largest vertical error of a walk.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Worst {
    /// Pixels visited.
    pub count: usize,
    pub error: f64,
    pub col: usize,
    pub row: usize,
}

/// The first pixel (in row, column order) with the largest |z - plane|; a NaN
/// never wins.
#[inline]
pub fn worst<T: Height>(grid: &Grid<T>, p: [Point; 3], z: [f64; 3], corners: Corners) -> Worst {
    let plane = Plane::through(p, z);
    let mut worst = Worst { count: 0, error: -1.0, col: 0, row: 0 };
    for_each_span(p, corners, |row, first, end| {
        let on_row = plane.on_row(row);
        let heights = &grid.row(row)[first..end];
        worst.count += heights.len();
        let whole = heights.len() / LANES * LANES;
        let mut start = 0;
        // Long rows: look for the place only if their maximum beats the best.
        if whole > LANES && row_maximum(&heights[..whole], plane, on_row, first) <= worst.error {
            start = whole;
        }
        for (col, height) in (first + start..end).zip(&heights[start..]) {
            let error = (height.to_f64() - plane.at(on_row, col)).abs();
            if error > worst.error {
                worst = Worst { error, col, row, ..worst };
            }
        }
    });
    worst
}

/// Reads a pixel of every cache line that the box around `points` touches, if it is
/// small: these loads overlap, while those of the walks to come wait for each other.
#[inline]
pub fn warm<T: Height>(grid: &Grid<T>, points: impl Iterator<Item = Point>) {
    const LINE: usize = 16;
    const FEW: i32 = 48;
    let (mut low, mut high) = (Point { x: i32::MAX, y: i32::MAX }, Point { x: 0, y: 0 });
    for p in points {
        low = Point { x: low.x.min(p.x), y: low.y.min(p.y) };
        high = Point { x: high.x.max(p.x), y: high.y.max(p.y) };
    }
    let (width, height) = ((high.x - low.x) >> SUB_BITS, (high.y - low.y) >> SUB_BITS);
    if width > FEW || height > FEW {
        return;
    }
    let (first, last) = ((low.x >> SUB_BITS) as usize, (high.x >> SUB_BITS) as usize);
    let mut sum = 0.0;
    for row in low.y >> SUB_BITS..=high.y >> SUB_BITS {
        let heights = grid.row(row as usize);
        sum += heights[last].to_f64();
        for height in heights[first..last].iter().step_by(LINE) {
            sum += height.to_f64();
        }
    }
    std::hint::black_box(sum);
}

/// As [`worst`], and collects the bits of all errors, voids left out: of numbers that
/// are not negative they sort like the values.
#[inline]
pub fn collect<T: Height>(
    grid: &Grid<T>,
    p: [Point; 3],
    z: [f64; 3],
    corners: Corners,
    errors: &mut Vec<u64>,
) -> Worst {
    let plane = Plane::through(p, z);
    let mut worst = Worst { count: 0, error: -1.0, col: 0, row: 0 };
    let mut has_void = false;
    errors.clear();
    for_each_span(p, corners, |row, first, end| {
        let on_row = plane.on_row(row);
        let from = errors.len();
        errors.extend(
            (first..end)
                .zip(&grid.row(row)[first..end])
                .map(|(col, height)| (height.to_f64() - plane.at(on_row, col)).abs().to_bits()),
        );
        for (col, &bits) in (first..end).zip(&errors[from..]) {
            let error = f64::from_bits(bits);
            if error > worst.error {
                worst = Worst { error, col, row, ..worst };
            }
            has_void |= error.is_nan();
        }
    });
    if has_void {
        errors.retain(|&bits| !f64::from_bits(bits).is_nan());
    }
    worst.count = errors.len();
    worst
}

/// Largest |z - plane| of whole lanes, written so that it vectorises.
#[inline]
fn row_maximum<T: Height>(heights: &[T], plane: Plane, on_row: f64, first: usize) -> f64 {
    let mut best = [-1.0f64; LANES];
    let mut offset: [f64; LANES] = std::array::from_fn(|lane| (first + lane) as f64 - plane.col0);
    for chunk in heights.chunks_exact(LANES) {
        for lane in 0..LANES {
            let error = (chunk[lane].to_f64() - (on_row + plane.per_col * offset[lane])).abs();
            best[lane] = if error > best[lane] { error } else { best[lane] };
            offset[lane] += LANES as f64;
        }
    }
    best.iter().fold(-1.0, |a, &b| if b > a { b } else { a })
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
