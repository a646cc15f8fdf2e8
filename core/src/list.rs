//! Single numbers, close together, that vectors write and read.

use crate::lanes::LANES;

/// Numbers that are read together.
const PAIR: usize = 2 * LANES;

/// Whole pairs of vectors can be read of it: its end is filled up with what no selection finds.
#[derive(Default)]
pub struct List {
    values: Vec<f32>,
    count: usize,
}

impl List {
    /// Room for so many numbers to be written anew; [`List::end`] says how many there were.
    #[inline]
    pub fn start(&mut self, room: usize) -> &mut [f32] {
        if self.values.len() < room + PAIR {
            self.values.resize(2 * room + PAIR, 0.0);
        }
        &mut self.values
    }

    #[inline]
    pub fn end(&mut self, count: usize) {
        self.count = count.min(self.values.len().saturating_sub(PAIR));
        if let Some(rest) = self.values.get_mut(self.count..).and_then(|rest| rest.first_chunk_mut::<PAIR>())
        {
            *rest = [f32::INFINITY; PAIR];
        }
    }

    #[inline]
    pub fn values(&self) -> &[f32] {
        &self.values[..self.count]
    }

    #[inline]
    pub fn pairs(&self) -> &[[f32; PAIR]] {
        self.values[..self.count.next_multiple_of(PAIR)].as_chunks().0
    }
}

impl FromIterator<f32> for List {
    fn from_iter<I: IntoIterator<Item = f32>>(values: I) -> Self {
        let mut values: Vec<f32> = values.into_iter().collect();
        let count = values.len();
        values.resize(count + PAIR, f32::INFINITY);
        List { values, count }
    }
}
