//! The largest of many numbers, in no more memory than they need.

/// Takes any number of values and keeps the largest.
pub struct Top {
    most: usize,
    kept: Vec<f64>,
    least: f64,
}

impl Top {
    /// For the `most` largest values, which is at least one.
    pub fn new(most: usize) -> Self {
        Top { most: most.max(1), kept: Vec::new(), least: f64::NEG_INFINITY }
    }

    /// Values below this are not among the largest.
    pub fn least(&self) -> f64 {
        self.least
    }

    pub fn extend(&mut self, values: &[f64]) {
        self.kept.extend(values.iter().filter(|&&value| value >= self.least));
        // Half as many again: then what is to be selected has paid for it.
        if self.kept.len() > self.most + self.most / 2 {
            let below = self.kept.len() - self.most;
            self.least = *self.kept.select_nth_unstable_by(below, f64::total_cmp).1;
            self.kept.drain(..below);
        }
    }

    /// The value that `larger` others precede, if there are so many.
    pub fn nth(mut self, larger: usize) -> Option<f64> {
        let index = self.kept.len().checked_sub(larger + 1)?;
        Some(*self.kept.select_nth_unstable_by(index, f64::total_cmp).1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_largest_are_those_of_a_sorted_list(
            parts in prop::collection::vec(prop::collection::vec(0u8..40, 0..30), 0..20), most in 1usize..50,
        ) {
            let (mut top, mut sorted) = (Top::new(most), Vec::new());
            for part in parts {
                let part: Vec<f64> = part.into_iter().map(f64::from).collect();
                // As a caller does who leaves out what is below.
                let least = top.least();
                top.extend(&part.iter().copied().filter(|&value| value >= least).collect::<Vec<_>>());
                sorted.extend(part);
            }
            sorted.sort_by(|a, b| b.total_cmp(a));
            for larger in 0..most {
                let top = Top { kept: top.kept.clone(), ..top };
                prop_assert_eq!(top.nth(larger), sorted.get(larger).copied());
            }
        }
    }
}
