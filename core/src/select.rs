//! The k-th smallest of some errors, without sorting them.

use crate::lanes::{Kernel, Lanes, Vectors, LANES};

/// Scratch memory of a selection.
#[derive(Default)]
pub struct Selector {
    rest: Vec<f32>,
    next: Vec<f32>,
}

impl Selector {
    /// The value that `k` others precede when all are sorted; none is negative, infinite or NaN.
    #[inline]
    pub fn nth(&mut self, values: &[f32], k: usize, vectors: Vectors) -> f32 {
        vectors.run(Nth { values, k, selector: self })
    }
}

/// Vectors few enough for comparing all their values with each other.
const FEW: usize = 4;

/// Vectors of a sample, which tells about where the k-th of a long list lies.
const SAMPLE: usize = 2;

/// Ranks in the sample on either side between which that is thought to be.
const REACH: usize = 3;

struct Nth<'a> {
    values: &'a [f32],
    k: usize,
    selector: &'a mut Selector,
}

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

impl Kernel for Nth<'_> {
    type Output = f32;

    /// Narrows the range of the value (Floyd and Rivest 1975) until few are left in it.
    #[inline(always)]
    fn run<L: Lanes>(self) -> f32 {
        let Nth { values, mut k, selector: Selector { rest, next } } = self;
        let (mut low, mut high) = (0.0, f32::MAX);
        let (mut guess, mut kept) = (Guess::Sample, None);
        loop {
            let list = kept.map_or(values, |count| &rest[..count]);
            if list.len() <= FEW * LANES {
                return nth_of_few::<L>(list, k);
            }
            let (from, to) = match guess {
                Guess::Sample => bracket::<L>(list, k, low, high),
                Guess::Half => (low, f32::from_bits(low.to_bits().midpoint(high.to_bits()))),
                Guess::Range => (low, high),
            };
            let (under, within) = keep::<L>(list, from, to, next);
            if k < under {
                (high, guess) = (from.next_down(), Guess::Range);
            } else if k >= under + within {
                (low, guess) = (to.next_up(), Guess::Range);
            } else {
                (low, high) = (from, to);
                if low == high {
                    return low;
                }
                guess = if 4 * within < 3 * list.len() { Guess::Sample } else { Guess::Half };
                std::mem::swap(rest, next);
                (k, kept) = (k - under, Some(within));
            }
        }
    }
}

/// Eight values; the end of a list is filled up with what no selection finds.
#[inline(always)]
fn filled_up(end: &[f32]) -> [f32; LANES] {
    let mut chunk = [f32::INFINITY; LANES];
    for (into, &value) in chunk.iter_mut().zip(end) {
        *into = value;
    }
    chunk
}

#[inline(always)]
fn nth_of_few<L: Lanes>(list: &[f32], k: usize) -> f32 {
    match list.len().div_ceil(LANES) {
        0 | 1 => nth_of::<L, 1>(list, k),
        2 => nth_of::<L, 2>(list, k),
        3 => nth_of::<L, 3>(list, k),
        _ => nth_of::<L, FEW>(list, k),
    }
}

#[inline(always)]
fn nth_of<L: Lanes, const N: usize>(list: &[f32], k: usize) -> f32 {
    let (chunks, end) = list.as_chunks();
    let mut vectors = [L::load(&filled_up(end)); N];
    for (vector, chunk) in vectors.iter_mut().zip(chunks) {
        *vector = L::load(chunk);
    }
    of_rank::<L, N>(vectors, ranks::<L, N>(vectors, list), k)
}

/// How many values of the list are smaller than each of the vectors'.
#[inline(always)]
fn ranks<L: Lanes, const N: usize>(vectors: [L::F; N], list: &[f32]) -> [L::I; N] {
    let mut smaller = [L::splat_i(0); N];
    for &value in list {
        let value = L::splat(value);
        for (smaller, &vector) in smaller.iter_mut().zip(&vectors) {
            *smaller = L::tally(*smaller, L::greater(vector, value));
        }
    }
    smaller
}

/// The largest value that at most `k` others are smaller than.
#[inline(always)]
fn of_rank<L: Lanes, const N: usize>(vectors: [L::F; N], ranks: [L::I; N], k: usize) -> f32 {
    let (none, beyond) = (L::splat(-1.0), L::splat_i(-1 - k as i32));
    let mut largest = none;
    for (vector, rank) in vectors.into_iter().zip(ranks) {
        let value = L::where_negative(L::add_i(rank, beyond), vector, none);
        largest = L::choose(L::greater(value, largest), value, largest);
    }
    L::first_largest(largest, L::splat_i(0)).0
}

/// Between which values the k-th is thought to lie.
#[inline(always)]
fn bracket<L: Lanes>(list: &[f32], k: usize, low: f32, high: f32) -> (f32, f32) {
    const COUNT: usize = SAMPLE * LANES;
    let mut sample = [0.0; COUNT];
    for (i, value) in sample.iter_mut().enumerate() {
        *value = list[(2 * i + 1) * list.len() / (2 * COUNT)];
    }
    let mut vectors = [L::splat(0.0); SAMPLE];
    for (vector, chunk) in vectors.iter_mut().zip(sample.as_chunks().0) {
        *vector = L::load(chunk);
    }
    let ranks = ranks::<L, SAMPLE>(vectors, &sample);
    let rank = k * COUNT / list.len();
    let from = if rank < REACH { low } else { of_rank::<L, SAMPLE>(vectors, ranks, rank - REACH) };
    let to = if rank + REACH < COUNT { of_rank::<L, SAMPLE>(vectors, ranks, rank + REACH) } else { high };
    (from, to)
}

/// Moves the values in a range to the front of `into`; says how many lie under it and in it.
#[inline(always)]
fn keep<L: Lanes>(list: &[f32], from: f32, to: f32, into: &mut Vec<f32>) -> (usize, usize) {
    if into.len() < list.len() + LANES {
        into.resize(2 * list.len() + LANES, 0.0);
    }
    let (chunks, end) = list.as_chunks();
    let (mut under, mut within) = (0, 0);
    for chunk in chunks.iter().chain([&filled_up(end)]) {
        let values = L::load(chunk);
        let is_under = L::greater(L::splat(from), values);
        let is_over = L::greater(values, L::splat(to));
        under += L::count(is_under);
        if let Some(into) = into[within..].first_chunk_mut() {
            within += L::compress(L::neither(is_under, is_over), values, into);
        }
    }
    (under, within)
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
                    let found = selector.nth(&values, k, vectors);
                    prop_assert_eq!(found.to_bits(), sorted[k].to_bits());
                }
            }
        }
    }
}
