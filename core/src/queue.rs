//! The queue of candidates: a lazy max-heap with a total order.

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

/// Entries whose triangle has changed are not removed but skipped when popped:
/// cheaper than keeping an index into the heap up to date.
#[derive(Default)]
pub struct Queue {
    heap: BinaryHeap<Candidate>,
}

impl Queue {
    pub fn clear(&mut self) {
        self.heap.clear();
    }

    pub fn push(&mut self, candidate: Candidate) {
        self.heap.push(candidate);
    }

    /// The greatest candidate that `is_current` accepts; stale ones are dropped.
    pub fn pop(&mut self, is_current: impl Fn(&Candidate) -> bool) -> Option<Candidate> {
        while let Some(candidate) = self.heap.pop() {
            if is_current(&candidate) {
                return Some(candidate);
            }
        }
        None
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
