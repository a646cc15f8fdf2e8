//! The k-th smallest of some errors, without sorting them.

use crate::lanes::{Kernel, Lanes, Vectors, LANES};

/// Scratch memory of a selection.
#[derive(Clone, Default)]
pub struct Selector {
    rest: Vec<f32>,
}

impl Selector {
    /// The value that `k` others precede when all are sorted; none is negative or NaN.
    #[inline]
    pub fn nth(&mut self, values: &[f32], k: usize, vectors: Vectors) -> f32 {
        vectors.run(Nth { values, k, rest: &mut self.rest })
    }
}

/// Lists up to this length are not worth being closed up.
const SHORT: usize = 64;

struct Nth<'a> {
    values: &'a [f32],
    k: usize,
    rest: &'a mut Vec<f32>,
}

impl Kernel for Nth<'_> {
    type Output = f32;

    /// Halves the interval that holds the value: at the rank's place in it and (so that no
    /// distribution of the values makes it slow) at the middle of its bits in turn. Each
    /// pass pulls its ends in to values that are there.
    #[inline(always)]
    fn run<L: Lanes>(self) -> f32 {
        let Nth { values, mut k, rest } = self;
        rest.clear();
        rest.extend_from_slice(values);
        pad(rest, values.len());
        let (mut low, mut high) = extremes::<L>(rest);
        // Values under `low`, and up to `high`.
        let (mut under, mut until) = (0, values.len());
        let mut by_rank = true;
        while low < high {
            let guess = if by_rank {
                low + (high - low) * (((k - under) as f32 + 0.5) / (until - under) as f32)
            } else {
                f32::from_bits(low.to_bits().midpoint(high.to_bits()))
            };
            by_rank = !by_rank;
            let pivot = if guess < high && guess >= low { guess } else { low };
            let (up_to, below, above) = divide::<L>(rest, pivot);
            if k < up_to {
                (high, until) = (below, up_to);
            } else {
                (low, under) = (above, up_to);
            }
            if k + 1 == until {
                return high;
            }
            if k == under {
                return low;
            }
            if rest.len() > SHORT && until - under < rest.len() / 2 {
                close_up::<L>(rest, low, high);
                pad(rest, until - under);
                (k, until, under) = (k - under, until - under, 0);
            }
        }
        low
    }
}

/// Fills up the last vector with what no selection finds.
#[inline(always)]
fn pad(rest: &mut Vec<f32>, count: usize) {
    rest.truncate(count);
    rest.resize(count.next_multiple_of(LANES), f32::INFINITY);
}

#[inline(always)]
fn extremes<L: Lanes>(rest: &[f32]) -> (f32, f32) {
    let all = L::splat(f32::INFINITY);
    let (mut low, mut high) = (all, L::splat(0.0));
    for chunk in rest.as_chunks().0 {
        let values = L::load(chunk);
        low = L::min(values, low);
        high = L::max(L::choose(L::greater(all, values), values, high), high);
    }
    (smallest(L::store(low)), largest(L::store(high)))
}

fn smallest(values: [f32; LANES]) -> f32 {
    values.into_iter().fold(f32::INFINITY, |a, b| if b < a { b } else { a })
}

fn largest(values: [f32; LANES]) -> f32 {
    values.into_iter().fold(0.0, |a, b| if b > a { b } else { a })
}

/// How many values are at or under the pivot, the largest of these, the smallest of the
/// others.
#[inline(always)]
fn divide<L: Lanes>(rest: &[f32], pivot: f32) -> (usize, f32, f32) {
    let at = L::splat(pivot);
    let (none, all) = (L::splat(0.0), L::splat(f32::INFINITY));
    let (mut below, mut above) = (none, all);
    let mut over = 0;
    for chunk in rest.as_chunks().0 {
        let values = L::load(chunk);
        let is_over = L::greater(values, at);
        over += L::count(is_over);
        below = L::max(L::choose(is_over, none, values), below);
        above = L::min(L::choose(is_over, values, all), above);
    }
    (rest.len() - over, largest(L::store(below)), smallest(L::store(above)))
}

/// Moves the values from `low` to `high` to the front.
#[inline(always)]
fn close_up<L: Lanes>(rest: &mut [f32], low: f32, high: f32) {
    let (low, high, no) = (L::splat(low), L::splat(high), L::splat(0.0));
    let yes = L::greater(L::splat(1.0), no);
    let mut count = 0;
    for i in (0..rest.len()).step_by(LANES) {
        let Some(chunk) = rest[i..].first_chunk() else { return };
        let values = L::load(chunk);
        let is_in = L::choose(L::greater(low, values), no, L::choose(L::greater(values, high), no, yes));
        if let Some(into) = rest[count..].first_chunk_mut() {
            count += L::compress(is_in, values, into);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn agrees_with_sorting(values in prop::collection::vec(prop_oneof![0.0f32..1.0, (0u8..4).prop_map(f32::from), any::<u32>().prop_map(|b| f32::from_bits(b % 0x7f80_0000))], 1..700)) {
            let mut sorted = values.clone();
            sorted.sort_unstable_by(f32::total_cmp);
            let mut selector = Selector::default();
            for k in (0..values.len()).step_by(7).chain([values.len() - 1]) {
                for vectors in [Vectors::Plain, Vectors::best()] {
                    prop_assert_eq!(selector.nth(&values, k, vectors).to_bits(), sorted[k].to_bits());
                }
            }
        }
    }
}
