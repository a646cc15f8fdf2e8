//! The scan of one triangle, eight pixels at a time and in single precision.
//!
//! Which pixel is the worst is found here; how far it is off is for `refine` to say, in
//! double precision.

use crate::grid::{Grid, Height};
use crate::lanes::{Kernel, Lanes, Vectors, LANES};
use crate::patch::Patch;
use crate::predicate::{orient2d, Point, SUB_BITS, UNIT};
use crate::scan::{rows_between, Plane, Side, Spans};

/// A triangle over a patch.
pub struct Facet {
    /// Corners relative to the patch.
    p: [Point; 3],
    /// Relative to the reference of the patch.
    plane: Plane,
    /// A bound of all |heights| of the plane that are met on the way.
    largest: f64,
}

/// The worst pixel of a facet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Found {
    /// |z - plane|; -1 if there is no candidate.
    pub error: f32,
    /// In the heights of the patch.
    pub place: usize,
}

/// The errors of a facet's candidates, and their places.
#[derive(Default)]
pub struct Errors {
    values: Vec<f32>,
    places: Vec<i32>,
    count: usize,
}

impl Errors {
    pub fn values(&self) -> &[f32] {
        &self.values[..self.count]
    }

    pub fn places(&self) -> &[i32] {
        &self.places[..self.count]
    }
}

/// In wider triangles it pays to find the rows that a strip of columns meets.
const NARROW: i32 = 2 * LANES as i32;

/// With sides in pixels up to this the edge functions fit 32 bits, those of the pixels of a
/// strip beside the triangle included.
const MAX_SIDE: i32 = 110;

/// The same where the corners are pixels; larger triangles are walked by spans.
const MAX_WHOLE_SIDE: i32 = 1 << 14;

/// What single precision may be off, as a part of the heights involved (sixteen times
/// half a unit in the last place, of less than eight roundings).
const ROUNDING: f64 = 1.0 / (1 << 20) as f64;

/// Heights up to which nothing overflows.
const RANGE: f64 = 1e37;

/// And where they are tiny.
const TINY: f64 = 1e-36;

impl Facet {
    #[inline]
    pub fn new(patch: &Patch, p: [Point; 3], z: [f64; 3]) -> Self {
        let p = p.map(|p| patch.local(p));
        let z = z.map(|z| z - patch.reference());
        let plane = Plane::through(p, z);
        // A row may start up to `LANES` pixels beside the triangle.
        let beside = LANES as f64 * plane.per_col.abs();
        let largest = z[0].abs().max(z[1].abs()).max(z[2].abs()) + beside;
        Facet { p, plane, largest }
    }

    /// How far an error in single precision can be off.
    pub fn rounding(&self, error: f32) -> f64 {
        ROUNDING * (self.largest + f64::from(error)) + TINY
    }

    /// Whether single precision overflows nowhere on the way.
    pub fn is_in_range(&self, patch: &Patch) -> bool {
        self.largest + patch.largest() < RANGE
    }

    /// Whether single precision holds its plane as it is: one that is level and not too finely
    /// so.
    pub fn is_exact(&self) -> bool {
        let Plane { per_col, per_row, z0, .. } = self.plane;
        per_col == 0.0 && per_row == 0.0 && f64::from(z0 as f32) == z0
    }

    /// Its area in pixels, which is about their number.
    pub fn pixels(&self) -> usize {
        let [a, b, c] = self.p;
        (orient2d(a, b, c) >> (2 * SUB_BITS + 1)) as usize
    }

    /// The error of a candidate, in double precision.
    #[inline]
    pub fn error<T: Height>(&self, patch: &Patch, grid: &Grid<T>, place: usize) -> f64 {
        let (col, row) = patch.split(place);
        let plane = self.plane.at(self.plane.on_row(row), col);
        (patch.height(place, grid) - patch.reference() - plane).abs()
    }

    /// The errors of all candidates in double precision and their places, in raster
    /// order.
    pub fn exact<T: Height>(&self, patch: &Patch, grid: &Grid<T>) -> Vec<(f64, usize)> {
        let mut errors = Vec::new();
        for (row, first, end) in Spans::new(self.p) {
            let places = row * patch.stride() + first..row * patch.stride() + end;
            let candidates = places.filter(|&place| !patch.z()[place].is_nan());
            errors.extend(candidates.map(|place| (self.error(patch, grid, place), place)));
        }
        errors
    }

    /// A pixel with the largest error, always the same one.
    #[inline]
    pub fn worst(&self, patch: &Patch, vectors: Vectors) -> Found {
        vectors.run(Worst { facet: self, patch })
    }

    /// As [`Facet::worst`], and collects all errors.
    #[inline]
    pub fn collect(&self, patch: &Patch, vectors: Vectors, errors: &mut Errors) -> Found {
        vectors.run(Collect { facet: self, patch, errors })
    }

    /// Shows the pixels of the triangle to the visitor.
    #[inline(always)]
    fn walk<L: Lanes>(&self, patch: &Patch, visitor: &mut impl Visitor<L>) {
        let [a, b, c] = self.p;
        let ceil = |v: i32| (v + UNIT - 1) >> SUB_BITS;
        let (left, right) = (ceil(a.x.min(b.x).min(c.x)), a.x.max(b.x).max(c.x) >> SUB_BITS);
        let (top, bottom) = (ceil(a.y.min(b.y).min(c.y)), a.y.max(b.y).max(c.y) >> SUB_BITS);
        let (cols, rows) = (right - left, bottom - top);
        if cols < NARROW && rows < MAX_SIDE {
            let mut left = left;
            while left <= right {
                self.walk_strip(patch, [left, top, bottom], self.p, SUB_BITS, visitor);
                left += LANES as i32;
            }
            return;
        }
        // Corners on pixels need no finer lattice.
        let is_whole = (a.x | a.y | b.x | b.y | c.x | c.y) & (UNIT - 1) == 0;
        let (p, bits, most) = if is_whole {
            (self.p.map(|p| Point { x: p.x >> SUB_BITS, y: p.y >> SUB_BITS }), 0, MAX_WHOLE_SIDE)
        } else {
            (self.p, SUB_BITS, MAX_SIDE)
        };
        if cols < most && rows < most {
            // Relative to where single precision is exact.
            let [a, b, c] = self.p.map(|p| [p.x - (left << SUB_BITS), p.y - (top << SUB_BITS)]);
            let sides = [Side::new(a, b), Side::new(b, c), Side::new(c, a)];
            let mut col = 0;
            while col <= cols {
                let (first, last) = rows_between(&sides, col as f32, (col + LANES as i32 - 1) as f32);
                let [first, last] = [first.max(0), last.min(rows)].map(|row| top + row);
                self.walk_strip(patch, [left + col, first, last], p, bits, visitor);
                col += LANES as i32;
            }
        } else {
            self.walk_spans(patch, visitor);
        }
    }

    /// A strip of columns that fit one vector: inside is where no edge function is negative
    /// (Pineda 1988). `p` are the corners with so many bits below the pixel.
    #[inline(always)]
    fn walk_strip<L: Lanes>(
        &self,
        patch: &Patch,
        [left, top, bottom]: [i32; 3],
        p: [Point; 3],
        bits: u32,
        visitor: &mut impl Visitor<L>,
    ) {
        let (x, y) = (left << bits, top << bits);
        let edge = |k: usize| {
            let (a, b) = (p[k], p[(k + 1) % 3]);
            let (dx, dy) = (b.x - a.x, b.y - a.y);
            (L::ramp(dx * (y - a.y) - dy * (x - a.x), -dy << bits), L::splat_i(dx << bits))
        };
        let [(mut e0, down0), (mut e1, down1), (mut e2, down2)] = [edge(0), edge(1), edge(2)];
        let plane = &self.plane;
        let start = L::splat(plane.at(plane.on_row(top as usize), left as usize) as f32);
        let across = L::mul(L::splat(plane.per_col as f32), L::to_f(L::ramp(0, 1)));
        let start = L::add(start, across);
        let (slope, one) = (L::splat(plane.per_row as f32), L::splat(1.0));
        let mut down = L::splat(0.0);
        let at = top as usize * patch.stride() + left as usize;
        let mut place = L::ramp(at as i32, 1);
        let stride = L::splat_i(patch.stride() as i32);
        let end = bottom as usize * patch.stride() + left as usize + LANES;
        for row in patch.z().get(at..end).unwrap_or_default().chunks(patch.stride()) {
            let Some(heights) = row.first_chunk() else { return };
            let level = L::add(start, L::mul(slope, down));
            let error = L::abs(L::sub(L::load(heights), level));
            let outside = L::or_i(L::or_i(e0, e1), e2);
            visitor.see(L::where_negative(outside, L::splat(-1.0), error), place);
            (e0, e1, e2) = (L::add_i(e0, down0), L::add_i(e1, down1), L::add_i(e2, down2));
            down = L::add(down, one);
            place = L::add_i(place, stride);
        }
    }

    #[inline(always)]
    fn walk_spans<L: Lanes>(&self, patch: &Patch, visitor: &mut impl Visitor<L>) {
        let plane = &self.plane;
        let slope = L::splat(plane.per_col as f32);
        let (ramp, lanes) = (L::to_f(L::ramp(0, 1)), L::splat(LANES as f32));
        for (row, first, end) in Spans::new(self.p) {
            let start = L::splat(plane.at(plane.on_row(row), first) as f32);
            let mut across = ramp;
            let mut at = row * patch.stride() + first;
            let last = row * patch.stride() + end;
            while at < last {
                let Some(heights) = patch.z().get(at..).and_then(|z| z.first_chunk()) else { return };
                let error = L::abs(L::sub(L::sub(L::load(heights), start), L::mul(slope, across)));
                let inside = L::ramp(at as i32 - last as i32, 1);
                visitor.see(L::where_negative(inside, error, L::splat(-1.0)), L::ramp(at as i32, 1));
                across = L::add(across, lanes);
                at += LANES;
            }
        }
    }
}

trait Visitor<L: Lanes> {
    /// Eight errors and their places; the error is -1 beside the triangle and NaN where there
    /// is no candidate. Must be `#[inline(always)]`, like all that a kernel runs.
    fn see(&mut self, error: L::F, place: L::I);
}

/// Lane by lane the largest error so far.
struct Largest<L: Lanes> {
    error: L::F,
    place: L::I,
}

impl<L: Lanes> Largest<L> {
    #[inline(always)]
    fn new() -> Self {
        Largest { error: L::splat(-1.0), place: L::splat_i(0) }
    }

    #[inline(always)]
    fn found(self) -> Found {
        let (error, place) = L::first_largest(self.error, self.place);
        Found { error, place: place as usize }
    }
}

impl<L: Lanes> Visitor<L> for Largest<L> {
    #[inline(always)]
    fn see(&mut self, error: L::F, place: L::I) {
        let is_larger = L::greater(error, self.error);
        self.error = L::choose(is_larger, error, self.error);
        self.place = L::choose_i(is_larger, place, self.place);
    }
}

struct Collector<'a, L: Lanes> {
    largest: Largest<L>,
    errors: &'a mut Errors,
}

impl<L: Lanes> Visitor<L> for Collector<'_, L> {
    #[inline(always)]
    fn see(&mut self, error: L::F, place: L::I) {
        self.largest.see(error, place);
        let Errors { values, places, count } = self.errors;
        if values.len() < *count + LANES {
            // Off the path of the walk.
            grow(values, places);
        }
        let (values, places) = (&mut values[*count..], &mut places[*count..]);
        if let (Some(values), Some(places)) = (values.first_chunk_mut(), places.first_chunk_mut()) {
            let is_candidate = L::greater(error, L::splat(-0.5));
            L::compress_i(is_candidate, place, places);
            *count += L::compress(is_candidate, error, values);
        }
    }
}

#[cold]
fn grow(values: &mut Vec<f32>, places: &mut Vec<i32>) {
    let room = (2 * values.len()).max(1 << 10);
    values.resize(room, 0.0);
    places.resize(room, 0);
}

struct Worst<'a> {
    facet: &'a Facet,
    patch: &'a Patch,
}

impl Kernel for Worst<'_> {
    type Output = Found;

    #[inline(always)]
    fn run<L: Lanes>(self) -> Found {
        let mut largest = Largest::<L>::new();
        self.facet.walk(self.patch, &mut largest);
        largest.found()
    }
}

struct Collect<'a> {
    facet: &'a Facet,
    patch: &'a Patch,
    errors: &'a mut Errors,
}

impl Kernel for Collect<'_> {
    type Output = Found;

    #[inline(always)]
    fn run<L: Lanes>(self) -> Found {
        self.errors.count = 0;
        let mut collector = Collector { largest: Largest::<L>::new(), errors: self.errors };
        self.facet.walk(self.patch, &mut collector);
        collector.largest.found()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::patch::{Frame, Window};
    use proptest::prelude::*;

    fn brute(facet: &Facet, patch: &Patch, size: i32) -> Vec<(i32, f64)> {
        let p = facet.p;
        let inside = |q| (0..3).all(|k| orient2d(p[k], p[(k + 1) % 3], q) >= 0);
        (0..size * size)
            .map(|i| (i % size, i / size))
            .filter(|&(x, y)| inside(Point { x: x << SUB_BITS, y: y << SUB_BITS }))
            .map(|(x, y)| (y * patch.stride() as i32 + x, x, y))
            .map(|(at, x, y)| {
                (
                    at,
                    (f64::from(patch.z()[at as usize])
                        - facet.plane.at(facet.plane.on_row(y as usize), x as usize))
                    .abs(),
                )
            })
            .filter(|(_, error)| !error.is_nan())
            .collect()
    }

    proptest! {
        #[test]
        fn all_vectors_find_the_errors_of_a_plain_loop(
            z in prop::collection::vec(prop_oneof![9 => -9.0f32..9.0, 1 => Just(f32::NAN)], 1600),
            c in prop::array::uniform6(0i32..(39 << SUB_BITS) + 1), size in 0u32..3, heights in prop::array::uniform3(-9.0f64..9.0), on_pixels: bool,
        ) {
            let snap = |v: i32| if on_pixels { v >> SUB_BITS << SUB_BITS } else { v };
            let mut p = [0, 1, 2].map(|i| Point { x: snap(c[2 * i] >> size), y: snap(c[2 * i + 1] >> size) });
            prop_assume!(orient2d(p[0], p[1], p[2]) != 0);
            if orient2d(p[0], p[1], p[2]) < 0 { p.swap(1, 2); }
            let grid = Grid::new(&z, 40, 40).unwrap();
            let window = Window { col: 0, row: 0, cols: 40, rows: 40 };
            let patch = Patch::new(&grid, window, Frame::of(&grid, window)).unwrap();
            let facet = Facet::new(&patch, p, heights);
            let expected = brute(&facet, &patch, 40);
            let largest = expected.iter().fold(-1.0f64, |a, b| a.max(b.1));
            let bound = facet.rounding(largest as f32);
            let (mut plain, mut best) = (Errors::default(), Errors::default());
            let found = facet.collect(&patch, Vectors::Plain, &mut plain);
            prop_assert_eq!(facet.collect(&patch, Vectors::best(), &mut best), found);
            prop_assert_eq!((plain.values(), plain.places()), (best.values(), best.places()));
            prop_assert_eq!(facet.worst(&patch, Vectors::Plain), found);
            prop_assert_eq!(facet.worst(&patch, Vectors::best()), found);
            let mut pairs: Vec<_> = plain.places().iter().copied().zip(plain.values().iter().copied()).collect();
            pairs.sort_unstable_by_key(|pair| pair.0);
            prop_assert_eq!(pairs.iter().map(|pair| pair.0).collect::<Vec<_>>(), expected.iter().map(|e| e.0).collect::<Vec<_>>());
            for (pair, &(_, error)) in pairs.into_iter().zip(&expected) {
                prop_assert!((f64::from(pair.1) - error).abs() <= bound);
            }
            if !expected.is_empty() {
                prop_assert_eq!(found.error, plain.values().iter().fold(-1.0f32, |a, &b| a.max(b)));
                let at = plain.places().iter().position(|&place| place as usize == found.place).unwrap();
                prop_assert_eq!(found.error, plain.values()[at]);
            }
        }
    }
}
