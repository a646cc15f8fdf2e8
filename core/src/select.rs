//! The k-th smallest of some errors, without sorting them.

use crate::lanes::{Lanes, Pair, Part, LANES};
use crate::list::List;
use crate::rule::quantile_index;

/// Scratch memory of a selection.
#[derive(Default)]
pub struct Selector {
    rest: List,
    next: List,
}

/// Values of two vectors side by side.
const PAIR: usize = 2 * LANES;

/// Pairs few enough for comparing all their values with each other.
const FEW: usize = 2;

/// Values of a sample, which tells about where one of a long list lies.
const SAMPLE: usize = PAIR;

/// Ranks in the sample on either side between which that is thought to be.
const REACH: usize = 3;

/// Which part of a list to keep.
#[derive(Clone, Copy, PartialEq)]
enum Guess {
    /// What lies between two values of a sample.
    Sample,
    /// The lower half of the range, by bits: no distribution of the values makes that slow.
    Half,
    /// All of the range.
    Range,
}

impl Selector {
    /// The value that `k` others precede when all are sorted; none is negative, infinite or NaN.
    #[inline(always)]
    pub fn nth<L: Lanes>(&mut self, list: &List, k: usize) -> f32 {
        L::apart(Nth { list, k, selector: self })
    }
}

/// A quantile of eight values, those that are negative left out; negative if all are.
#[inline(always)]
pub fn of_eight<L: Lanes>(values: L::F, q: f64) -> f32 {
    let mut eight = [0.0; LANES];
    L::store(values, &mut eight);
    let mut smaller = L::splat_i(0);
    for value in eight {
        smaller = L::tally(smaller, L::greater(values, L::splat(value)));
    }
    let count = L::count(L::greater(values, L::splat(-0.5)));
    let k = LANES - count + quantile_index(count.max(1), q);
    L::largest(L::where_negative(L::sub_i(L::splat_i(k as i32), smaller), L::splat(-1.0), values))
}

struct Nth<'a> {
    list: &'a List,
    k: usize,
    selector: &'a mut Selector,
}

impl<L: Lanes> Part<L> for Nth<'_> {
    type Output = f32;

    /// Narrows the range of the value (Floyd and Rivest 1975) until few are left in it.
    #[inline(always)]
    fn run(self) -> f32 {
        let Nth { list: all, mut k, selector: Selector { rest, next } } = self;
        let (mut low, mut high) = (0.0, f32::MAX);
        let (mut guess, mut is_all) = (Guess::Sample, true);
        loop {
            let list = if is_all { all } else { &*rest };
            let count = list.values().len();
            if count <= FEW * PAIR {
                return nth_of_few::<L>(list, k);
            }
            let (from, to) = match guess {
                Guess::Sample => bracket::<L>(list.values(), k, low, high),
                Guess::Half => (low, f32::from_bits(low.to_bits().midpoint(high.to_bits()))),
                Guess::Range => (low, high),
            };
            let under = keep::<L>(list, from, to, next);
            let within = next.values().len();
            if k < under {
                (high, guess) = (from.next_down(), Guess::Range);
            } else if k >= under + within {
                (low, guess) = (to.next_up(), Guess::Range);
            } else {
                (low, high) = (from, to);
                if low == high {
                    return low;
                }
                guess = if 4 * within < 3 * count { Guess::Sample } else { Guess::Half };
                std::mem::swap(rest, next);
                (k, is_all) = (k - under, false);
            }
        }
    }
}

#[inline(always)]
fn nth_of_few<L: Lanes>(list: &List, k: usize) -> f32 {
    match list.pairs().len() {
        0 | 1 => nth_of::<L, 1>(list, k),
        _ => nth_of::<L, FEW>(list, k),
    }
}

#[inline(always)]
fn nth_of<L: Lanes, const N: usize>(list: &List, k: usize) -> f32 {
    let mut pairs = [splat::<L>(f32::INFINITY); N];
    for (pair, chunk) in pairs.iter_mut().zip(list.pairs()) {
        *pair = L::Pair::load(chunk);
    }
    let (values, _) = list.pairs().split_at(N.min(list.pairs().len()));
    of_rank::<L, N>(pairs, ranks::<L, N>(pairs, values), k)
}

#[inline(always)]
fn splat<L: Lanes>(value: f32) -> L::Pair {
    L::Pair::join(L::splat(value), L::splat(value))
}

/// A number for each value of a pair.
type Ints<L> = <<L as Lanes>::Pair as Pair<L>>::Ints;

/// How many of the values are smaller than each of the pairs'. Whole pairs of them, because the end of a shorter loop
/// would be mistaken.
#[inline(always)]
fn ranks<L: Lanes, const N: usize>(pairs: [L::Pair; N], values: &[[f32; PAIR]]) -> [Ints<L>; N] {
    let none = L::splat_i(0);
    let mut smaller = [L::Pair::ints(L::Pair::edge(none, none)); N];
    for chunk in values {
        for &value in chunk {
            for (smaller, &pair) in smaller.iter_mut().zip(&pairs) {
                *smaller = pair.tally(*smaller, value);
            }
        }
    }
    smaller
}

/// The largest value that at most `k` others are smaller than.
#[inline(always)]
fn of_rank<L: Lanes, const N: usize>(pairs: [L::Pair; N], ranks: [Ints<L>; N], k: usize) -> f32 {
    let mut largest = L::splat(-1.0);
    for (pair, rank) in pairs.into_iter().zip(ranks) {
        let [left, right] = pair.where_negative(L::Pair::less(k as i32, rank), -1.0).halves();
        largest = L::max(L::max(left, right), largest);
    }
    L::largest(largest)
}

#[inline(always)]
fn sample(list: &[f32]) -> [f32; SAMPLE] {
    let mut sample = [0.0; SAMPLE];
    for (i, value) in sample.iter_mut().enumerate() {
        *value = list[(2 * i + 1) * list.len() / (2 * SAMPLE)];
    }
    sample
}

/// Between which values the k-th is thought to lie.
#[inline(always)]
fn bracket<L: Lanes>(list: &[f32], k: usize, low: f32, high: f32) -> (f32, f32) {
    let sample = sample(list);
    let pair = [L::Pair::load(&sample)];
    let ranks = ranks::<L, 1>(pair, &[sample]);
    let rank = k * SAMPLE / list.len();
    let from = if rank < REACH { low } else { of_rank::<L, 1>(pair, ranks, rank - REACH) };
    let to = if rank + REACH < SAMPLE { of_rank::<L, 1>(pair, ranks, rank + REACH) } else { high };
    (from, to)
}

/// Has `into` take the values in a range; says how many lie under it.
#[inline(always)]
fn keep<L: Lanes>(list: &List, from: f32, to: f32, into: &mut List) -> usize {
    let values = into.start(list.values().len() + PAIR);
    let (mut under, mut within) = (0, 0);
    for chunk in list.pairs() {
        let (fewer, more) = L::Pair::load(chunk).sift((from, to), values, within);
        (under, within) = (under + fewer, within + more);
    }
    into.end(within);
    under
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::{Kernel, Vectors};
    use proptest::prelude::*;

    struct Find<'a>(&'a List, usize);

    impl Kernel for Find<'_> {
        type Output = f32;

        #[inline(always)]
        fn run<L: Lanes>(self) -> f32 {
            Selector::default().nth::<L>(self.0, self.1)
        }
    }

    proptest! {
        #[test]
        fn agrees_with_sorting(values in prop::collection::vec(prop_oneof![0.0f32..1.0, (0u8..4).prop_map(f32::from), any::<u32>().prop_map(|b| f32::from_bits(b % 0x7f80_0000))], 1..700)) {
            let mut sorted = values.clone();
            sorted.sort_unstable_by(f32::total_cmp);
            let list: List = values.iter().copied().collect();
            for k in (0..values.len()).step_by(7).chain([values.len() - 1]) {
                for vectors in Vectors::all() {
                    let found = vectors.run(Find(&list, k));
                    prop_assert_eq!(found.to_bits(), sorted[k].to_bits());
                }
            }
        }
    }
}
