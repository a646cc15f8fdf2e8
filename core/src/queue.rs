//! The queue of candidates: lazy, in buckets of like priority.

use crate::candidate::{Candidate, Pick};
use crate::curve::curve_position;
use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};

/// Bits of a priority that name its bucket: exponent and four of the mantissa.
const BUCKET_SHIFT: u32 = 52 - 4;
/// And its part of that, where priorities are to be known better.
const BINS: usize = 4;
const BIN_SHIFT: u32 = BUCKET_SHIFT - BINS.ilog2();
/// Buckets kept apart, 40 octaves on either side of the first priority; what lies
/// beyond shares the outermost ones.
const BUCKETS: usize = 2 * 40 * 16;

/// Entries whose triangle has changed are not removed but dropped when met. Only
/// the bucket of the largest priorities is open; entries of the others wait unsorted,
/// and most are stale by the time their bucket is opened.
pub struct Queue {
    order: Order,
    /// The open bucket where the order is exact,
    heap: BinaryHeap<Candidate>,
    /// and where it is not, the next entry last.
    batch: Vec<Candidate>,
    is_heap: bool,
    /// The buckets; none before the first entry comes to wait.
    waiting: Vec<Vec<Candidate>>,
    /// More that wait, by rising buckets.
    parked: Vec<Candidate>,
    /// Number of the lowest bucket, known from the first priority on.
    lowest: Option<usize>,
    /// The open bucket; entries at or above it do not wait.
    level: usize,
    /// Buckets to be filled.
    memory: Memory,
}

/// Buckets that one queue after the other fills.
#[derive(Default)]
pub struct Memory(Vec<Vec<Candidate>>);

/// In which order the candidates of a bucket are popped, together with what their insertions bring up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// By priority: the open bucket is a heap, and all goes as in one big heap.
    Exact,
    /// The last to come first, which is the fastest. As in the next, priorities are in order only to a sixteenth.
    Latest,
    /// Along a space-filling curve, so that the working set stays in the cache. Has the difference of
    /// pixel numbers from one row to the next.
    Curve(u32),
}

impl Queue {
    pub fn new(order: Order) -> Self {
        Queue {
            order,
            heap: BinaryHeap::new(),
            batch: Vec::new(),
            is_heap: order == Order::Exact,
            waiting: Vec::new(),
            parked: Vec::new(),
            lowest: None,
            level: BUCKETS,
            memory: Memory::default(),
        }
    }

    /// How many candidates wait at about which priority, once they are parked.
    pub fn waiting(&self) -> Vec<(f64, usize)> {
        let bucket = |c: &Candidate| c.priority.to_bits() >> BUCKET_SHIFT;
        let buckets = self.parked.chunk_by(|a, b| bucket(a) == bucket(b));
        pooled(buckets.flat_map(|bucket| {
            let mut bins = [(0.0, 0); BINS];
            for candidate in bucket {
                let bin = &mut bins[(candidate.priority.to_bits() >> BIN_SHIFT) as usize % BINS];
                *bin = (bin.0 + candidate.priority, bin.1 + 1);
            }
            bins.into_iter().filter(|bin| bin.1 > 0).map(|(sum, count)| (sum / count as f64, count))
        }))
    }

    /// Works in the other memory; what waits must be parked.
    pub fn swap(&mut self, memory: &mut Memory) {
        std::mem::swap(&mut self.memory, memory);
    }

    /// Becomes a new one, in the memory there is.
    pub fn clear(&mut self, order: Order) {
        *self = Queue { memory: std::mem::take(&mut self.memory), ..Queue::new(order) };
    }

    /// Drops the entries that are not wanted, and has the others wait in no more memory than they need.
    pub fn park(&mut self, is_wanted: impl Fn(&Candidate) -> bool) {
        self.level = BUCKETS;
        let open = [std::mem::take(&mut self.heap).into_vec(), std::mem::take(&mut self.batch)];
        open.iter().flatten().for_each(|candidate| self.push(*candidate));
        let count = self.parked.len() + self.waiting.iter().map(Vec::len).sum::<usize>();
        let mut parked = std::mem::take(&mut self.parked).into_iter().filter(&is_wanted).peekable();
        let mut all = Vec::with_capacity(count);
        let mut waiting = std::mem::take(&mut self.waiting);
        for (number, bucket) in waiting.iter_mut().enumerate() {
            while let Some(candidate) = parked.next_if(|c| self.bucket(c.priority) <= number) {
                all.push(candidate);
            }
            all.extend(bucket.drain(..).filter(&is_wanted));
        }
        if !waiting.is_empty() {
            self.memory = Memory(waiting);
        }
        all.extend(parked);
        all.shrink_to_fit();
        self.parked = all;
    }

    /// Has all parked entries scanned again when it is their turn; gives `each` of them.
    pub fn rescan(&mut self, mut each: impl FnMut(&Candidate)) {
        for candidate in &mut self.parked {
            each(candidate);
            candidate.pick = Pick::RESCAN;
        }
    }

    /// Number of the bucket of a priority; the lowest as long as none waits.
    #[inline]
    fn bucket(&self, priority: f64) -> usize {
        let number = (priority.to_bits() >> BUCKET_SHIFT) as usize;
        number.saturating_sub(self.lowest.unwrap_or(usize::MAX)).min(BUCKETS - 1)
    }

    /// The highest priority among those that `is_current` accepts. From now on, until they are parked, nothing that is
    /// pushed waits: where one at a time is popped, buckets would take more memory than they save time.
    pub fn top(&mut self, is_current: impl Fn(&Candidate) -> bool) -> Option<f64> {
        if self.level > 0 {
            self.park(&is_current);
            (self.level, self.is_heap) = (0, true);
        }
        loop {
            self.unpark();
            let first = self.heap.peek()?;
            if is_current(first) {
                return Some(first.priority);
            }
            self.heap.pop();
        }
    }

    /// The next that is open.
    #[inline]
    fn next(&mut self) -> Option<Candidate> {
        if self.level == 0 {
            self.unpark();
        }
        self.batch.pop().or_else(|| self.heap.pop())
    }

    /// Whether the open bucket is in a rough order.
    #[inline]
    pub fn is_rough(&self) -> bool {
        !self.is_heap
    }

    /// The next over the level that `is_current` accepts of an open bucket in a rough order; stale ones are dropped.
    #[inline]
    pub fn pop_rough(&mut self, level: f64, is_current: impl Fn(&Candidate) -> bool) -> Option<Candidate> {
        while let Some(candidate) = self.batch.pop() {
            if is_current(&candidate) {
                if candidate.priority > level {
                    return Some(candidate);
                }
                self.heap.push(candidate);
            }
        }
        None
    }

    /// Opens what is parked in the bucket of the first of the heap or in a higher one.
    fn unpark(&mut self) {
        let Some(last) = self.parked.last().map(|c| self.bucket(c.priority)) else { return };
        if self.heap.peek().is_none_or(|first| self.bucket(first.priority) <= last) {
            let rest = self.parked.partition_point(|c| self.bucket(c.priority) < last);
            self.heap.extend(self.parked.drain(rest..));
        }
    }

    /// The bucket of the largest priorities that wait, which becomes the open one.
    fn next_bucket(&mut self) -> Option<Vec<Candidate>> {
        let last = self.waiting.len().min(self.level);
        let waiting = self.waiting[..last].iter().rposition(|bucket| !bucket.is_empty());
        let parked = self.parked.last().map(|c| self.bucket(c.priority));
        self.level = waiting.max(parked)?;
        // Those of the bucket before have all been popped; their memory is used again.
        let spare = if self.is_heap {
            std::mem::take(&mut self.heap).into_vec()
        } else {
            std::mem::take(&mut self.batch)
        };
        let mut bucket = match self.waiting.get_mut(self.level) {
            Some(bucket) => std::mem::replace(bucket, spare),
            None => spare,
        };
        let rest = self.parked.partition_point(|c| self.bucket(c.priority) < self.level);
        bucket.extend(self.parked.drain(rest..));
        Some(bucket)
    }

    /// `candidate.priority` must be 0 or more.
    #[inline]
    pub fn push(&mut self, candidate: Candidate) {
        let bucket = self.bucket(candidate.priority);
        if bucket >= self.level {
            if self.is_heap {
                self.heap.push(candidate);
            } else {
                self.batch.push(candidate);
            }
        } else if let Some(waiting) = self.waiting.get_mut(bucket) {
            waiting.push(candidate);
        } else {
            self.push_first(candidate);
        }
    }

    /// Opens the buckets for the first that waits.
    #[cold]
    fn push_first(&mut self, candidate: Candidate) {
        let number = (candidate.priority.to_bits() >> BUCKET_SHIFT) as usize;
        self.lowest.get_or_insert(number.saturating_sub(BUCKETS / 2));
        self.waiting = std::mem::take(&mut self.memory.0);
        self.waiting.resize_with(BUCKETS, Vec::new);
        let bucket = self.bucket(candidate.priority);
        self.waiting[bucket].push(candidate);
    }

    /// The next candidate that `is_current` accepts; stale ones are dropped. No more
    /// than `remaining` are going to be asked for.
    pub fn pop(&mut self, remaining: usize, is_current: impl Fn(&Candidate) -> bool) -> Option<Candidate> {
        self.pop_over(f64::NEG_INFINITY, remaining, is_current)
    }

    /// As [`Queue::pop`], if the next candidate's priority is over `level`; else it stays.
    pub fn pop_over(
        &mut self,
        level: f64,
        remaining: usize,
        is_current: impl Fn(&Candidate) -> bool,
    ) -> Option<Candidate> {
        loop {
            if let Some(candidate) = self.pop_rough(level, &is_current) {
                return Some(candidate);
            }
            while let Some(candidate) = self.next() {
                if is_current(&candidate) {
                    if candidate.priority > level {
                        return Some(candidate);
                    }
                    self.heap.push(candidate);
                    return None;
                }
            }
            let mut bucket = self.next_bucket()?;
            bucket.retain(&is_current);
            // Where not all of it may be inserted the most urgent come first, so that no corner is favoured.
            self.is_heap = self.order == Order::Exact || bucket.len() >= remaining;
            if self.is_heap {
                self.heap = BinaryHeap::from(bucket);
                continue;
            }
            if let Order::Curve(stride) = self.order {
                let position = |pixel| curve_position(u64::from(pixel % stride), u64::from(pixel / stride));
                bucket.sort_by_cached_key(|c| (Reverse(position(c.pixel)), c.triangle));
            }
            self.batch = bucket;
        }
    }
}

/// How many there are at each mean priority of a bin.
pub fn pooled(counts: impl Iterator<Item = (f64, usize)>) -> Vec<(f64, usize)> {
    let mut bins: BTreeMap<u64, (f64, usize)> = BTreeMap::new();
    for (priority, count) in counts {
        let bin = bins.entry(priority.to_bits() >> BIN_SHIFT).or_default();
        *bin = (bin.0 + priority * count as f64, bin.1 + count);
    }
    bins.into_values().map(|(sum, count)| (sum / count as f64, count)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn pops_in_total_order_and_skips_the_stale(errors in prop::collection::vec((0u8..5, 0u32..9, 0u32..4, 0u32..2), 0..60)) {
            let mut queue = Queue::new(Order::Exact);
            let mut expected = Vec::new();
            for (priority, pixel, triangle, version) in errors {
                let candidate = Candidate { priority: f64::from(priority), pixel, triangle, version, pick: Pick::KNOWN };
                queue.push(candidate);
                if version == 1 { expected.push(candidate); }
            }
            expected.sort_by(|a, b| b.cmp(a));
            let popped: Vec<_> = std::iter::from_fn(|| queue.pop(usize::MAX, |c| c.version == 1)).collect();
            prop_assert_eq!(popped, expected);
        }

        #[test]
        fn parking_changes_nothing(
            steps in prop::collection::vec((prop_oneof![0.0f64..9.0, Just(0.0), Just(f64::INFINITY), Just(1e-300)], 0u8..4), 0..80),
        ) {
            let (mut plain, mut parked) = (Queue::new(Order::Exact), Queue::new(Order::Exact));
            let mut memory = Memory::default();
            let is_current = |c: &Candidate| c.version == 0;
            for (i, (priority, step)) in (0..).zip(steps) {
                let candidate = Candidate { priority, pixel: i, triangle: i, version: i % 3 / 2, pick: Pick::KNOWN };
                plain.push(candidate);
                parked.push(candidate);
                match step {
                    0 => prop_assert_eq!(plain.pop(usize::MAX, is_current), parked.pop(usize::MAX, is_current)),
                    1 => {
                        parked.park(is_current);
                        parked.swap(&mut memory);
                        let waiting: Vec<_> = parked.waiting();
                        prop_assert!(waiting.windows(2).all(|pair| pair[0].0 < pair[1].0));
                        prop_assert_eq!(waiting.iter().map(|w| w.1).sum::<usize>(), parked.parked.len());
                    }
                    2 => prop_assert_eq!(plain.top(is_current), parked.top(is_current)),
                    _ => {}
                }
            }
            loop {
                let (a, b) = (plain.pop(usize::MAX, is_current), parked.pop(usize::MAX, is_current));
                prop_assert_eq!(a, b);
                if a.is_none() { break; }
            }
        }

        #[test]
        fn a_rough_order_pops_each_once_over_the_level_and_falls_by_buckets(
            priorities in prop::collection::vec(0.0f64..100.0, 0..200), level in 0.0f64..50.0, is_curve: bool,
        ) {
            let mut queue = Queue::new(if is_curve { Order::Curve(10) } else { Order::Latest });
            for (i, &priority) in (0..).zip(&priorities) {
                queue.push(Candidate { priority, pixel: i, triangle: i, version: 0, pick: Pick::KNOWN });
            }
            let mut popped: Vec<_> = std::iter::from_fn(|| queue.pop_over(level, usize::MAX, |_| true)).collect();
            let over = priorities.iter().filter(|&&priority| priority > level).count();
            prop_assert_eq!(over, popped.len());
            popped.extend(std::iter::from_fn(|| queue.pop(usize::MAX, |_| true)));
            for pair in popped.windows(2) {
                prop_assert!(pair[1].priority <= 1.0625 * pair[0].priority);
            }
            let mut seen: Vec<_> = popped.iter().map(|c| c.triangle).collect();
            seen.sort_unstable();
            prop_assert_eq!(seen, (0..priorities.len() as u32).collect::<Vec<_>>());
        }
    }
}
