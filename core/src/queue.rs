//! The queue of candidates: lazy, bucketed by size, with a total order.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// A triangle's candidate. Ordered by priority, then by pixel (first in raster
/// order wins), then by triangle, so that equal errors never leave a choice.
#[derive(Clone, Copy, Debug)]
pub struct Candidate {
    pub priority: f64,
    /// `row * cols + col`.
    pub pixel: u64,
    pub triangle: u32,
    /// Version of the triangle the candidate was found for.
    pub version: u32,
}

impl Ord for Candidate {
    fn cmp(&self, other: &Self) -> Ordering {
        self.priority
            .total_cmp(&other.priority)
            .then_with(|| other.pixel.cmp(&self.pixel))
            .then_with(|| other.triangle.cmp(&self.triangle))
            .then_with(|| self.version.cmp(&other.version))
    }
}

impl PartialOrd for Candidate {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Candidate {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Candidate {}

/// Bits of a priority that name its bucket: sign, exponent and three of the mantissa.
const BUCKET_SHIFT: u32 = 52 - 3;
const BUCKETS: usize = 1 << (64 - BUCKET_SHIFT);

/// Entries whose triangle has changed are not removed but dropped when met. Only
/// the bucket of the largest priorities is a heap; entries of the others wait
/// unsorted, and most are stale by the time their bucket is opened. The order of
/// popping is that of one big heap.
pub struct Queue {
    open: BinaryHeap<Candidate>,
    waiting: Vec<Vec<Candidate>>,
    /// The open bucket; entries at or above it go to the heap.
    level: usize,
}

impl Default for Queue {
    fn default() -> Self {
        Queue { open: BinaryHeap::new(), waiting: vec![Vec::new(); BUCKETS / 2], level: BUCKETS / 2 }
    }
}

impl Queue {
    pub fn clear(&mut self) {
        self.open.clear();
        self.waiting.iter_mut().for_each(Vec::clear);
        self.level = self.waiting.len();
    }

    /// `candidate.priority` must be 0 or more.
    #[inline]
    pub fn push(&mut self, candidate: Candidate) {
        let bucket = (candidate.priority.to_bits() >> BUCKET_SHIFT) as usize;
        if bucket >= self.level {
            self.open.push(candidate);
        } else {
            self.waiting[bucket].push(candidate);
        }
    }

    /// The greatest candidate that `is_current` accepts; stale ones are dropped.
    pub fn pop(&mut self, is_current: impl Fn(&Candidate) -> bool) -> Option<Candidate> {
        loop {
            while let Some(candidate) = self.open.pop() {
                if is_current(&candidate) {
                    return Some(candidate);
                }
            }
            self.level = self.waiting[..self.level].iter().rposition(|bucket| !bucket.is_empty())?;
            let mut bucket = std::mem::take(&mut self.waiting[self.level]);
            bucket.retain(&is_current);
            self.open = BinaryHeap::from(bucket);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn pops_in_total_order_and_skips_the_stale(errors in prop::collection::vec((0u8..5, 0u64..9, 0u32..4, 0u32..2), 0..60)) {
            let mut queue = Queue::default();
            let mut expected = Vec::new();
            for (priority, pixel, triangle, version) in errors {
                let candidate = Candidate { priority: f64::from(priority), pixel, triangle, version };
                queue.push(candidate);
                if version == 1 { expected.push(candidate); }
            }
            expected.sort_by(|a, b| b.cmp(a));
            let popped: Vec<_> = std::iter::from_fn(|| queue.pop(|c| c.version == 1)).collect();
            prop_assert_eq!(popped, expected);
        }
    }
}
