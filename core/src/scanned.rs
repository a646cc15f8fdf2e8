//! What is asked of a triangle's errors while it is ranked.

use crate::lanes::{Lanes, Pair, LANES};
use crate::list::List;
use crate::patch::Patch;
use crate::walk::Visitor;

/// What single precision may be off, as a part of the heights involved (sixteen times
/// half a unit in the last place, of less than eight roundings).
const ROUNDING: f64 = 1.0 / (1 << 20) as f64;

/// Heights up to which nothing overflows.
const RANGE: f64 = 1e37;

/// And where they are tiny.
const TINY: f64 = 1e-36;

/// A triangle that can be scanned.
pub trait Scan {
    /// Shows its pixels to the visitor, and gives it back.
    fn run<L: Lanes, V: Visitor<L>>(&self, patch: &Patch, visitor: V) -> V;

    /// How many pixels and others beside them are visited at most.
    fn room(&self) -> usize;

    /// A bound of all |heights| of the plane that are met on the way.
    fn highest(&self) -> f64;

    /// Whether single precision holds its plane as it is.
    fn is_exact(&self) -> bool;

    /// Pixels that each candidate stands for: 1 but for a sample.
    fn thinning(&self) -> usize;

    /// The place of its first corner, or of a pixel beside it: corners between pixels may lie outside the patch.
    fn first(&self, patch: &Patch) -> usize;

    /// How far an error in single precision can be off.
    #[inline(always)]
    fn rounding(&self, error: f32) -> f64 {
        ROUNDING * (self.highest() + f64::from(error)) + TINY
    }

    /// Whether single precision overflows nowhere on the way.
    #[inline(always)]
    fn is_in_range(&self, patch: &Patch) -> bool {
        self.highest() + patch.largest() < RANGE
    }

    /// The pixel with the largest error, of several always the same one.
    #[inline(always)]
    fn worst<L: Lanes>(&self, patch: &Patch) -> Found {
        self.run(patch, Worst::<L, true>::default()).found()
    }

    /// The same, the largest error of each of eight groups of pixels, every eighth column being one (-1 where there is no
    /// candidate), and the number of candidates.
    #[inline(always)]
    fn groups<L: Lanes>(&self, patch: &Patch) -> (Found, L::F, usize) {
        let groups = Groups::<L> { worst: Worst::default(), counts: L::splat_i(0) };
        let Groups { worst, counts } = self.run(patch, groups);
        let none = L::splat(0.0);
        let [count, ..] = L::sums([L::to_f(counts), none, none, none]);
        (worst.found(), worst.error, count as usize)
    }

    /// Collects all errors; returns the largest.
    #[inline(always)]
    fn collect<L: Lanes>(&self, patch: &Patch, errors: &mut List) -> f32 {
        let values = errors.start(self.room());
        let collector = Collector::<L> { worst: Worst::default(), values, count: 0 };
        let Collector { worst, count, .. } = self.run(patch, collector);
        errors.end(count);
        worst.found().error
    }
}

/// Whether single precision holds a plane of these slopes and this height: one that is level and not too finely so.
#[inline(always)]
pub fn is_exact(per_col: f64, per_row: f64, z0: f64) -> bool {
    per_col == 0.0 && per_row == 0.0 && f64::from(z0 as f32) == z0
}

/// A pixel of a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Found {
    /// |z - plane|; -1 if there is no candidate.
    pub error: f32,
    /// In the heights of the patch; without meaning if there is none.
    pub place: usize,
}

/// Lane by lane the largest error so far, and if it is to be `PLACED` where it lies.
pub struct Worst<L: Lanes, const PLACED: bool> {
    error: L::F,
    place: L::I,
    /// Where the next errors lie, and those after them from there.
    next: L::I,
    further: L::I,
}

impl<L: Lanes, const PLACED: bool> Default for Worst<L, PLACED> {
    #[inline(always)]
    fn default() -> Self {
        let first = L::splat_i(0);
        Worst { error: L::splat(-1.0), place: first, next: first, further: first }
    }
}

impl<L: Lanes, const PLACED: bool> Worst<L, PLACED> {
    #[inline(always)]
    pub fn found(&self) -> Found {
        if PLACED {
            let (error, place) = L::first_largest(self.error, self.place);
            Found { error, place: place as usize }
        } else {
            Found { error: L::largest(self.error), place: 0 }
        }
    }
}

impl<L: Lanes, const PLACED: bool> Visitor<L> for Worst<L, PLACED> {
    #[inline(always)]
    fn move_to(&mut self, place: usize, further: usize) {
        if PLACED {
            (self.next, self.further) = (L::ramp(place as i32, 1), L::splat_i(further as i32));
        }
    }

    #[inline(always)]
    fn see(&mut self, error: L::F) -> bool {
        if PLACED {
            (self.error, self.place) = L::larger((self.error, self.place), (error, self.next));
            self.next = L::add_i(self.next, self.further);
        } else {
            self.error = L::max(error, self.error);
        }
        false
    }

    type Both = WorstOfBoth<L>;

    #[inline(always)]
    fn both(&self) -> WorstOfBoth<L> {
        let so_far = L::Pair::edge(self.place, L::splat_i(0));
        WorstOfBoth {
            error: L::Pair::join(self.error, self.error),
            place: L::Pair::ints(so_far),
            next: L::Pair::edge(self.next, L::splat_i(LANES as i32)),
        }
    }

    #[inline(always)]
    fn see_both(&mut self, both: &mut WorstOfBoth<L>, errors: L::Pair) -> bool {
        if PLACED {
            (both.error, both.place) = L::Pair::larger((both.error, both.place), errors, both.next);
            both.next = L::Pair::step(both.next, self.further);
        } else {
            let [left, right] = errors.halves();
            self.error = L::max(right, L::max(left, self.error));
        }
        false
    }

    #[inline(always)]
    fn end_both(&mut self, WorstOfBoth { error, place, .. }: WorstOfBoth<L>) {
        if PLACED {
            let ([left, right], [at, beside]) = (error.halves(), L::Pair::half_ints(place));
            (self.error, self.place) = L::larger((left, at), (right, beside));
        }
    }
}

/// The largest of two strips side by side.
pub struct WorstOfBoth<L: Lanes> {
    error: L::Pair,
    place: <L::Pair as Pair<L>>::Ints,
    next: <L::Pair as Pair<L>>::Edge,
}

/// The worst pixel and, lane by lane, the number of candidates.
struct Groups<L: Lanes> {
    worst: Worst<L, true>,
    counts: L::I,
}

impl<L: Lanes> Visitor<L> for Groups<L> {
    #[inline(always)]
    fn move_to(&mut self, place: usize, further: usize) {
        self.worst.move_to(place, further);
    }

    #[inline(always)]
    fn see(&mut self, error: L::F) -> bool {
        self.counts = L::tally(self.counts, L::greater(error, L::splat(-0.5)));
        self.worst.see(error)
    }

    type Both = (WorstOfBoth<L>, <L::Pair as Pair<L>>::Ints);

    #[inline(always)]
    fn both(&self) -> Self::Both {
        let none = L::splat_i(0);
        (self.worst.both(), L::Pair::ints(L::Pair::edge(none, none)))
    }

    #[inline(always)]
    fn see_both(&mut self, (both, counts): &mut Self::Both, errors: L::Pair) -> bool {
        *counts = errors.tally(*counts, -0.5);
        self.worst.see_both(both, errors)
    }

    #[inline(always)]
    fn end_both(&mut self, (both, counts): Self::Both) {
        let [left, right] = L::Pair::half_ints(counts);
        self.counts = L::add_i(self.counts, L::add_i(left, right));
        self.worst.end_both(both);
    }
}

struct Collector<'a, L: Lanes> {
    worst: Worst<L, false>,
    /// With room for all.
    values: &'a mut [f32],
    count: usize,
}

impl<L: Lanes> Visitor<L> for Collector<'_, L> {
    #[inline(always)]
    fn move_to(&mut self, place: usize, further: usize) {
        self.worst.move_to(place, further);
    }

    #[inline(always)]
    fn see(&mut self, error: L::F) -> bool {
        self.count += L::compress(L::greater(error, L::splat(-0.5)), error, self.values, self.count);
        self.worst.see(error)
    }

    type Both = WorstOfBoth<L>;

    #[inline(always)]
    fn both(&self) -> WorstOfBoth<L> {
        self.worst.both()
    }

    #[inline(always)]
    fn see_both(&mut self, both: &mut WorstOfBoth<L>, errors: L::Pair) -> bool {
        self.count += errors.compress(-0.5, self.values, self.count);
        self.worst.see_both(both, errors)
    }

    #[inline(always)]
    fn end_both(&mut self, both: WorstOfBoth<L>) {
        self.worst.end_both(both);
    }
}
