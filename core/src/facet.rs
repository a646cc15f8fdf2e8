//! The scan of one triangle, in single precision.
//!
//! Which pixel is the worst is found here; how far it is off is for `refine` to say, in
//! double precision.

use crate::grid::{Grid, Height};
use crate::lanes::{Kernel, Lanes, Vectors, LANES};
use crate::patch::Patch;
use crate::predicate::{Point, SUB_BITS};
use crate::scan::{Plane, Spans};
use crate::walk::{pixels_of, Visitor, Walk};

/// A triangle over a patch.
pub struct Facet {
    walk: Walk,
    /// A bound of all |heights| of the plane that are met on the way.
    largest: f64,
}

/// A pixel of a facet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Found {
    /// |z - plane|; -1 if there is no candidate.
    pub error: f32,
    /// In the heights of the patch.
    pub place: usize,
}

/// The errors of a facet's candidates.
#[derive(Default)]
pub struct Errors {
    values: Vec<f32>,
    count: usize,
}

impl Errors {
    pub fn values(&self) -> &[f32] {
        &self.values[..self.count]
    }
}

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
        Facet { walk: Walk::new(p, plane), largest }
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
        let Plane { per_col, per_row, z0, .. } = self.walk.plane;
        per_col == 0.0 && per_row == 0.0 && f64::from(z0 as f32) == z0
    }

    /// Its area in pixels, which is about their number.
    #[inline]
    pub fn pixels(&self) -> usize {
        pixels_of(self.walk.p)
    }

    /// Pixels that each candidate stands for: 1 but for a sample.
    #[inline]
    pub fn thinning(&self) -> usize {
        self.walk.thinning()
    }

    /// About so many of its pixels, evenly spread, if it has at least twice as many.
    #[inline]
    pub fn sampled(&self, pixels: usize) -> Option<Self> {
        Some(Facet { walk: self.walk.sampled(pixels)?, ..*self })
    }

    /// The error of a candidate, in double precision.
    #[inline]
    pub fn error<T: Height>(&self, patch: &Patch, grid: &Grid<T>, place: usize) -> f64 {
        let (col, row) = patch.split(place);
        let plane = self.walk.plane.at(self.walk.plane.on_row(row), col);
        (patch.height(place, grid) - patch.reference() - plane).abs()
    }

    /// A pixel of it or beside it, in the heights of the patch.
    #[inline]
    pub fn middle(&self, patch: &Patch) -> usize {
        let [a, b, c] = self.walk.p;
        let [col, row] = [a.x + b.x + c.x, a.y + b.y + c.y].map(|v| ((v / 3) >> SUB_BITS) as usize);
        row * patch.stride() + col
    }

    /// The errors of all candidates in double precision and their places, in raster
    /// order.
    pub fn exact<T: Height>(&self, patch: &Patch, grid: &Grid<T>) -> Vec<(f64, usize)> {
        let mut errors = Vec::new();
        for (row, first, end) in Spans::new(self.walk.p) {
            let places = row * patch.stride() + first..row * patch.stride() + end;
            let candidates = places.filter(|&place| !patch.z(place).is_nan());
            errors.extend(candidates.map(|place| (self.error(patch, grid, place), place)));
        }
        errors
    }

    /// A pixel with the largest error, always the same one.
    #[inline]
    pub fn worst(&self, patch: &Patch, vectors: Vectors) -> Found {
        vectors.run(Worst { facet: self, patch })
    }

    /// A pixel with the largest error up to `limit`, always the same one.
    #[inline]
    pub fn worst_up_to(&self, limit: f32, patch: &Patch, vectors: Vectors) -> Found {
        vectors.run(WorstUpTo { facet: self, patch, limit })
    }

    /// Collects all errors and returns the largest, -1 if there is no candidate.
    #[inline]
    pub fn collect(&self, patch: &Patch, vectors: Vectors, errors: &mut Errors) -> f32 {
        vectors.run(Collect { facet: self, patch, errors })
    }
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

/// The same among errors up to a limit.
struct Limited<L: Lanes> {
    largest: Largest<L>,
    limit: L::F,
}

impl<L: Lanes> Visitor<L> for Limited<L> {
    #[inline(always)]
    fn see(&mut self, error: L::F, place: L::I) {
        let is_beyond = L::greater(error, self.limit);
        self.largest.see(L::choose(is_beyond, L::splat(-1.0), error), place);
    }
}

struct Collector<'a, L: Lanes> {
    largest: L::F,
    /// With room for all.
    values: &'a mut [f32],
    count: usize,
}

impl<L: Lanes> Visitor<L> for Collector<'_, L> {
    #[inline(always)]
    fn see(&mut self, error: L::F, _: L::I) {
        self.largest = L::max(error, self.largest);
        if let Some(values) = self.values.get_mut(self.count..).and_then(|values| values.first_chunk_mut()) {
            self.count += L::compress(L::greater(error, L::splat(-0.5)), error, values);
        }
    }
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
        self.facet.walk.run(self.patch, &mut largest);
        largest.found()
    }
}

struct WorstUpTo<'a> {
    facet: &'a Facet,
    patch: &'a Patch,
    limit: f32,
}

impl Kernel for WorstUpTo<'_> {
    type Output = Found;

    #[inline(always)]
    fn run<L: Lanes>(self) -> Found {
        let mut limited = Limited { largest: Largest::<L>::new(), limit: L::splat(self.limit) };
        self.facet.walk.run(self.patch, &mut limited);
        limited.largest.found()
    }
}

struct Collect<'a> {
    facet: &'a Facet,
    patch: &'a Patch,
    errors: &'a mut Errors,
}

impl Kernel for Collect<'_> {
    type Output = f32;

    #[inline(always)]
    fn run<L: Lanes>(self) -> f32 {
        let Errors { values, count } = self.errors;
        if values.len() < self.facet.walk.room() {
            values.resize(2 * self.facet.walk.room(), 0.0);
        }
        let mut collector = Collector::<L> { largest: L::splat(-1.0), values, count: 0 };
        self.facet.walk.run(self.patch, &mut collector);
        *count = collector.count;
        L::largest(collector.largest)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::patch::Window;
    use crate::predicate::orient2d;
    use proptest::prelude::*;

    fn brute(facet: &Facet, patch: &Patch, size: i32) -> Vec<(i32, f64)> {
        let Walk { p, plane, .. } = facet.walk;
        let inside = |q| (0..3).all(|k| orient2d(p[k], p[(k + 1) % 3], q) >= 0);
        (0..size * size)
            .map(|i| (i % size, i / size))
            .filter(|&(x, y)| inside(Point { x: x << SUB_BITS, y: y << SUB_BITS }))
            .map(|(x, y)| (y * patch.stride() as i32 + x, x, y))
            .map(|(at, x, y)| {
                (at, (f64::from(patch.z(at as usize)) - plane.at(plane.on_row(y as usize), x as usize)).abs())
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
            let patch = Patch::new(&grid, window).unwrap();
            let facet = Facet::new(&patch, p, heights);
            let expected = brute(&facet, &patch, 40);
            let largest = expected.iter().fold(-1.0f64, |a, b| a.max(b.1));
            let bound = facet.rounding(largest as f32);
            let (mut plain, mut best) = (Errors::default(), Errors::default());
            let found = facet.collect(&patch, Vectors::Plain, &mut plain);
            prop_assert_eq!(facet.collect(&patch, Vectors::best(), &mut best), found);
            prop_assert_eq!(plain.values(), best.values());
            let worst = facet.worst(&patch, Vectors::Plain);
            prop_assert_eq!(facet.worst(&patch, Vectors::best()), worst);
            prop_assert_eq!((worst.error, plain.values().len()), (found, expected.len()));
            let sorted = |mut errors: Vec<f64>| { errors.sort_by(f64::total_cmp); errors };
            let errors = sorted(plain.values().iter().map(|&error| error.into()).collect());
            for (error, expected) in errors.iter().zip(sorted(expected.iter().map(|e| e.1).collect())) {
                prop_assert!((error - expected).abs() <= bound);
            }
            for &error in plain.values().iter().step_by(5) {
                let found = facet.worst_up_to(error, &patch, Vectors::Plain);
                prop_assert_eq!(facet.worst_up_to(error, &patch, Vectors::best()), found);
                prop_assert_eq!(found.error, error);
                let there = expected.iter().find(|e| e.0 as usize == found.place).unwrap().1;
                prop_assert!((f64::from(error) - there).abs() <= bound);
            }
            if let Some(sample) = facet.sampled(16) {
                let found = sample.collect(&patch, Vectors::Plain, &mut plain);
                prop_assert_eq!(sample.collect(&patch, Vectors::best(), &mut best), found);
                prop_assert_eq!(plain.values(), best.values());
                let of_all = |error: f32| expected.iter().any(|e| (f64::from(error) - e.1).abs() <= bound);
                prop_assert!(plain.values().iter().all(|&error| of_all(error)));
                prop_assert_eq!(sample.worst(&patch, Vectors::best()).error, found);
            }
        }
    }

    #[test]
    fn a_sample_stands_for_all_pixels() {
        let size = 512;
        let z = vec![0.0f32; size * size];
        let grid = Grid::new(&z, size, size).unwrap();
        let patch = Patch::new(&grid, Window { col: 0, row: 0, cols: size, rows: size }).unwrap();
        for (col, row, lowest) in
            [(500, 500, 200), (30, 500, 0), (500, 30, 0), (100, 100, 200), (40, 40, 200)]
        {
            let p = [(0, 0), (col, 20), (5, row)].map(|(col, row)| Point::pixel(col, row));
            let facet = Facet::new(&patch, p, [0.0; 3]);
            let Some(sample) = facet.sampled(256) else {
                assert!(lowest == 0 || facet.pixels() < 800);
                continue;
            };
            let (mut all, mut some) = (Errors::default(), Errors::default());
            facet.collect(&patch, Vectors::best(), &mut all);
            sample.collect(&patch, Vectors::best(), &mut some);
            let (all, some) = (all.values().len(), some.values().len());
            assert!((lowest..600).contains(&some), "{some} of {all}");
            let stood_for = (some * sample.thinning()) as f64 / all as f64;
            assert!((0.8..1.25).contains(&stood_for), "{some} of {all}: {stood_for}");
        }
    }
}
