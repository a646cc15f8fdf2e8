//! What is asked of a triangle's errors while it is ranked.

use crate::lanes::{Lanes, Pair};
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

    /// The largest error, -1 if there is no candidate.
    #[inline(always)]
    fn largest<L: Lanes>(&self, patch: &Patch) -> f32 {
        L::largest(self.run(patch, Largest::<L>(L::splat(-1.0))).0)
    }

    /// Collects all errors and returns the largest, -1 if there is no candidate.
    #[inline(always)]
    fn collect<L: Lanes>(&self, patch: &Patch, errors: &mut List) -> f32 {
        let values = errors.start(self.room());
        let collector = Collector::<L> { largest: L::splat(-1.0), values, count: 0 };
        let Collector { largest, count, .. } = self.run(patch, collector);
        errors.end(count);
        L::largest(largest)
    }
}

/// Whether single precision holds a plane of these slopes and this height: one that is level and not too finely so.
#[inline(always)]
pub fn is_exact(per_col: f64, per_row: f64, z0: f64) -> bool {
    per_col == 0.0 && per_row == 0.0 && f64::from(z0 as f32) == z0
}

/// Lane by lane the largest error so far.
struct Largest<L: Lanes>(L::F);

impl<L: Lanes> Visitor<L> for Largest<L> {
    #[inline(always)]
    fn see(&mut self, error: L::F) -> bool {
        self.0 = L::max(error, self.0);
        false
    }

    #[inline(always)]
    fn see_both(&mut self, errors: L::Pair) {
        let [left, right] = errors.halves();
        self.0 = L::max(right, L::max(left, self.0));
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
    fn see(&mut self, error: L::F) -> bool {
        self.largest = L::max(error, self.largest);
        self.count += L::compress(L::greater(error, L::splat(-0.5)), error, self.values, self.count);
        false
    }

    #[inline(always)]
    fn see_both(&mut self, errors: L::Pair) {
        let [left, right] = errors.halves();
        self.largest = L::max(right, L::max(left, self.largest));
        self.count += errors.compress(-0.5, self.values, self.count);
    }
}
