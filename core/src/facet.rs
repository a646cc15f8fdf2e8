//! The scan of one triangle, in single precision.
//!
//! How far the worst pixel is off is found for every triangle, which one it is only when it is to be
//! inserted.

use crate::grid::Height;
use crate::image::View;
use crate::lanes::{Kernel, Lanes, Pair, Part, Vectors, LANES};
use crate::patch::Patch;
use crate::predicate::{pixels_of, Point, SUB_BITS};
use crate::scan::{Plane, Spans};
use crate::scanned::{is_exact, Found, Scan, Worst, WorstOfBoth};
use crate::walk::{Visitor, Walk};

/// A triangle over a patch.
#[derive(Clone, Copy)]
pub struct Facet {
    walk: Walk,
    /// A bound of all |heights| of the plane that are met on the way.
    largest: f64,
    /// Its area in pixels, which is about their number.
    pub pixels: usize,
}

impl Scan for Facet {
    #[inline(always)]
    fn run<L: Lanes, V: Visitor<L>>(&self, patch: &Patch, visitor: V) -> V {
        self.walk.run(patch, visitor)
    }

    #[inline(always)]
    fn room(&self) -> usize {
        self.walk.room()
    }

    #[inline(always)]
    fn highest(&self) -> f64 {
        self.largest
    }

    #[inline(always)]
    fn is_exact(&self) -> bool {
        let Plane { per_col, per_row, z0, .. } = self.walk.plane;
        is_exact(per_col, per_row, z0)
    }

    #[inline(always)]
    fn thinning(&self) -> usize {
        self.walk.thinning()
    }

    #[inline(always)]
    fn first(&self, patch: &Patch) -> usize {
        let [col, row] = [self.walk.p[0].x, self.walk.p[0].y].map(|v| (v >> SUB_BITS).max(0) as usize);
        row * patch.stride() + col
    }
}

impl Facet {
    #[inline(always)]
    pub fn new(patch: &Patch, p: [Point; 3], z: [f64; 3]) -> Self {
        let p = p.map(|p| patch.local(p));
        let z = z.map(|z| z - patch.reference());
        let plane = Plane::through(p, z);
        // A row may start up to `LANES` pixels beside the triangle.
        let beside = LANES as f64 * plane.per_col.abs();
        let largest = z[0].abs().max(z[1].abs()).max(z[2].abs()) + beside;
        Facet { walk: Walk::new(p, plane), largest, pixels: pixels_of(p) }
    }

    /// About so many of its pixels, evenly spread, if it has at least twice as many.
    #[inline(always)]
    pub fn sampled(&self, pixels: usize) -> Option<Self> {
        Some(Facet { walk: self.walk.sampled(pixels, self.pixels)?, ..*self })
    }

    /// The error of a candidate, in double precision.
    #[inline(always)]
    pub fn error<T: Height>(&self, patch: &Patch, view: &View<T>, place: usize) -> f64 {
        let (col, row) = patch.split(place);
        let plane = self.walk.plane.at(self.walk.plane.on_row(row), col);
        (patch.height(place, view) - patch.reference() - plane).abs()
    }

    /// The errors of all candidates in double precision and their places, in raster
    /// order.
    pub fn exact<T: Height>(&self, patch: &Patch, view: &View<T>) -> Vec<(f64, usize)> {
        let mut errors = Vec::new();
        for (row, first, end) in Spans::new(self.walk.p) {
            let places = row * patch.stride() + first..row * patch.stride() + end;
            let candidates = places.filter(|&place| !patch.z(place).is_nan());
            errors.extend(candidates.map(|place| (self.error(patch, view, place), place)));
        }
        errors
    }

    /// A pixel with the largest error up to `limit`, always the same one.
    #[inline]
    pub fn worst_up_to(&self, limit: f32, patch: &Patch, vectors: Vectors) -> Found {
        vectors.run(WorstUpTo { facet: self, patch, limit })
    }
}

/// The first row with an error that is sought.
struct Sought<L: Lanes> {
    error: L::F,
    /// Where the errors lie that have been seen last, and how far on the next do.
    place: usize,
    further: usize,
    is_there: L::F,
}

impl<L: Lanes> Visitor<L> for Sought<L> {
    #[inline(always)]
    fn move_to(&mut self, place: usize, further: usize) {
        (self.place, self.further) = (place.wrapping_sub(further), further);
    }

    #[inline(always)]
    fn see(&mut self, error: L::F) -> bool {
        self.place = self.place.wrapping_add(self.further);
        self.is_there = L::equal(error, self.error);
        L::is_any(self.is_there)
    }

    type Both = ();

    #[inline(always)]
    fn both(&self) {}

    #[inline(always)]
    fn see_both(&mut self, _: &mut (), errors: L::Pair) -> bool {
        let [left, right] = errors.halves();
        let is_left = self.see(left);
        if !is_left {
            let place = self.place;
            self.is_there = L::equal(right, self.error);
            if L::is_any(self.is_there) {
                self.place = place.wrapping_add(LANES);
                return true;
            }
        }
        is_left
    }

    #[inline(always)]
    fn end_both(&mut self, (): ()) {}
}

/// The largest error up to a limit.
struct Limited<L: Lanes> {
    limit: L::F,
    worst: Worst<L, true>,
}

impl<L: Lanes> Limited<L> {
    #[inline(always)]
    fn limited(&self, error: L::F) -> L::F {
        L::choose(L::greater(error, self.limit), L::splat(-1.0), error)
    }
}

impl<L: Lanes> Visitor<L> for Limited<L> {
    #[inline(always)]
    fn move_to(&mut self, place: usize, further: usize) {
        self.worst.move_to(place, further);
    }

    #[inline(always)]
    fn see(&mut self, error: L::F) -> bool {
        self.worst.see(self.limited(error))
    }

    type Both = WorstOfBoth<L>;

    #[inline(always)]
    fn both(&self) -> WorstOfBoth<L> {
        self.worst.both()
    }

    #[inline(always)]
    fn see_both(&mut self, both: &mut WorstOfBoth<L>, errors: L::Pair) -> bool {
        let [left, right] = errors.halves();
        self.worst.see_both(both, L::Pair::join(self.limited(left), self.limited(right)))
    }

    #[inline(always)]
    fn end_both(&mut self, both: WorstOfBoth<L>) {
        self.worst.end_both(both);
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
        let (error, none) = (L::splat(self.limit), L::splat(-1.0));
        let sought = Sought::<L> { error, place: 0, further: 0, is_there: L::greater(none, none) };
        let Sought { place, is_there, .. } = self.facet.walk.run(self.patch, sought);
        if !L::is_any(is_there) {
            return L::apart(self);
        }
        let (_, place) = L::first_largest(L::choose(is_there, error, none), L::ramp(place as i32, 1));
        Found { error: self.limit, place: place as usize }
    }
}

impl<L: Lanes> Part<L> for WorstUpTo<'_> {
    type Output = Found;

    #[inline(always)]
    fn run(self) -> Found {
        let limited = Limited::<L> { limit: L::splat(self.limit), worst: Worst::default() };
        self.facet.walk.run(self.patch, limited).worst.found()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Grid;
    use crate::list::List;
    use crate::predicate::orient2d;
    use crate::rule::quantile_index;
    use crate::select::of_eight;
    use crate::window::Window;
    use proptest::prelude::*;

    struct FindWorst<'a>(&'a Facet, &'a Patch);

    impl Kernel for FindWorst<'_> {
        type Output = Found;

        #[inline(always)]
        fn run<L: Lanes>(self) -> Found {
            self.0.worst::<L>(self.1)
        }
    }

    struct Collect<'a>(&'a Facet, &'a Patch, &'a mut List);

    impl Kernel for Collect<'_> {
        type Output = f32;

        #[inline(always)]
        fn run<L: Lanes>(self) -> f32 {
            self.0.collect::<L>(self.1, self.2)
        }
    }

    struct Groups<'a>(&'a Facet, &'a Patch);

    impl Kernel for Groups<'_> {
        type Output = (Found, [f32; LANES], f32, usize);

        #[inline(always)]
        fn run<L: Lanes>(self) -> Self::Output {
            let (found, groups, count) = self.0.groups::<L>(self.1);
            let mut all = [0.0; LANES];
            L::store(groups, &mut all);
            all.sort_by(f32::total_cmp);
            (found, all, of_eight::<L>(groups, 0.5), count)
        }
    }

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
            let patch = Patch::new(&View::of(&grid), window).unwrap();
            let facet = Facet::new(&patch, p, heights);
            let expected = brute(&facet, &patch, 40);
            let largest = expected.iter().fold(-1.0f64, |a, b| a.max(b.1));
            let bound = facet.rounding(largest as f32);
            let error_at = |place: usize| expected.iter().find(|e| e.0 as usize == place).unwrap().1;
            let (mut plain, mut best) = (List::default(), List::default());
            let found = Vectors::Plain.run(FindWorst(&facet, &patch));
            let groups = Vectors::Plain.run(Groups(&facet, &patch));
            prop_assert_eq!(Vectors::Plain.run(Collect(&facet, &patch, &mut plain)), found.error);
            for vectors in Vectors::all() {
                prop_assert_eq!(vectors.run(Collect(&facet, &patch, &mut best)), found.error);
                prop_assert_eq!(plain.values(), best.values());
                prop_assert_eq!(vectors.run(FindWorst(&facet, &patch)), found);
                prop_assert_eq!(vectors.run(Groups(&facet, &patch)), groups);
            }
            prop_assert_eq!((groups.0, groups.3, plain.values().len()), (found, expected.len(), expected.len()));
            let largest_of = |group: i32| expected.iter().filter(|e| e.0 % LANES as i32 == group).fold(-1.0f64, |a, b| a.max(b.1));
            let mut of_groups: Vec<f64> = (0..LANES as i32).map(largest_of).collect();
            of_groups.sort_by(f64::total_cmp);
            let there: Vec<f64> = of_groups.iter().copied().filter(|&error| error >= 0.0).collect();
            prop_assert!(groups.1.iter().zip(&of_groups).all(|(&a, b)| (f64::from(a) - b).abs() <= bound));
            if !there.is_empty() {
                prop_assert!((f64::from(groups.2) - there[quantile_index(there.len(), 0.5)]).abs() <= bound);
            }
            if found.error >= 0.0 {
                prop_assert!((f64::from(found.error) - error_at(found.place)).abs() <= bound);
                prop_assert!((f64::from(found.error) - largest).abs() <= bound);
            }
            let sorted = |mut errors: Vec<f64>| { errors.sort_by(f64::total_cmp); errors };
            let errors = sorted(plain.values().iter().map(|&error| error.into()).collect());
            for (error, expected) in errors.iter().zip(sorted(expected.iter().map(|e| e.1).collect())) {
                prop_assert!((error - expected).abs() <= bound);
            }
            for &error in plain.values().iter().step_by(5) {
                let found = facet.worst_up_to(error, &patch, Vectors::Plain);
                prop_assert!(Vectors::all().all(|vectors| facet.worst_up_to(error, &patch, vectors) == found));
                prop_assert_eq!(found.error, error);
                prop_assert!((f64::from(error) - error_at(found.place)).abs() <= bound);
            }
            if let Some(sample) = facet.sampled(16) {
                let found = Vectors::Plain.run(FindWorst(&sample, &patch));
                prop_assert_eq!(Vectors::Plain.run(Collect(&sample, &patch, &mut plain)), found.error);
                for vectors in Vectors::all() {
                    prop_assert_eq!(vectors.run(Collect(&sample, &patch, &mut best)), found.error);
                    prop_assert_eq!(plain.values(), best.values());
                    prop_assert_eq!(vectors.run(FindWorst(&sample, &patch)), found);
                }
                let of_all = |error: f32| expected.iter().any(|e| (f64::from(error) - e.1).abs() <= bound);
                prop_assert!(plain.values().iter().all(|&error| of_all(error)));
                prop_assert_eq!(facet.worst_up_to(found.error, &patch, Vectors::best()).error, found.error);
            }
        }
    }

    #[test]
    fn a_sample_stands_for_all_pixels() {
        let size = 512;
        let z = vec![0.0f32; size * size];
        let grid = Grid::new(&z, size, size).unwrap();
        let patch = Patch::new(&View::of(&grid), Window { col: 0, row: 0, cols: size, rows: size }).unwrap();
        let shapes = [(500, 500, 200), (30, 500, 0), (500, 30, 0), (100, 100, 200), (40, 40, 200)];
        for (pixels, (col, row, lowest)) in [64, 128].into_iter().flat_map(|n| shapes.map(|shape| (n, shape)))
        {
            let p = [(0, 0), (col, 20), (5, row)].map(|(col, row)| Point::pixel(col, row));
            let facet = Facet::new(&patch, p, [0.0; 3]);
            let Some(sample) = facet.sampled(pixels) else {
                assert!(lowest == 0 || facet.pixels < 3 * pixels);
                continue;
            };
            let (mut all, mut some) = (List::default(), List::default());
            Vectors::best().run(Collect(&facet, &patch, &mut all));
            Vectors::best().run(Collect(&sample, &patch, &mut some));
            let (all, some) = (all.values().len(), some.values().len());
            assert!((lowest * pixels / 256..6 * pixels).contains(&some), "{some} of {all} for {pixels}");
            let stood_for = (some * sample.thinning()) as f64 / all as f64;
            assert!((0.8..1.25).contains(&stood_for), "{some} of {all}: {stood_for}");
        }
    }
}
