//! How many points the tiles are going to take, told from what waits in their queues.

use crate::queue::pooled;
use crate::rule::Rule;

/// How many candidates of a tile wait at about which priority.
pub type Waiting = Vec<(f64, usize)>;

/// Points that are forecast for one triangle at most: what a few cliffs need says nothing of others.
const FARTHEST: f64 = 64.0;

/// Nearly every triangle over the level takes a point; and what forecasts are multiplied by stays
/// finite, whatever the rule.
const LEAST_SHARE: f64 = 0.5;
const LARGEST_SHARE: f64 = 64.0;

/// Where this many points go into a triangle over the level it is the steepness that they tell of.
const MANY: f64 = 2.0;
const STEEPNESS: [f64; 2] = [0.5, 4.0];

/// Levels are told apart by less than a thousandth, over 128 octaves.
const STEPS_AN_OCTAVE: f64 = 1024.0;
const MOST_STEPS: u32 = 128 << 10;

/// How many points a triangle is going to need until its priority is down at a level:
/// share (priority / level)^steepness.
#[derive(Clone, Copy)]
pub struct Outlook {
    steepness: f64,
    share: f64,
}

impl Outlook {
    pub fn new(rule: &Rule) -> Self {
        // Errors fall with this power of the area; the weight adds its own.
        const ROUGHNESS: f64 = 0.6;
        Outlook {
            steepness: (1.0 / (ROUGHNESS + rule.weight)).clamp(STEEPNESS[0], STEEPNESS[1]),
            share: (1.0 / rule.candidate).min(LARGEST_SHARE),
        }
    }

    /// Points for each tile.
    pub fn needs(&self, waiting: &[Waiting], level: f64) -> Vec<f64> {
        let needs = |&(priority, count): &(f64, usize)| {
            let is_over = priority > level;
            if is_over {
                count as f64 * (priority / level).powf(self.steepness).min(FARTHEST)
            } else {
                0.0
            }
        };
        waiting.iter().map(|tile| self.share * tile.iter().map(needs).sum::<f64>()).collect()
    }

    /// The level that takes so many points, under the highest priority.
    pub fn level_for(&self, wanted: f64, waiting: &[Waiting]) -> f64 {
        let all = [pooled(waiting.iter().flatten().copied())];
        let top = all[0].iter().fold(0.0, |top: f64, &(priority, _)| top.max(priority));
        // By steps that go with the heights: in other units the mesh is the same.
        let level = |step: u32| top * (-f64::from(step) / STEPS_AN_OCTAVE).exp2();
        let (mut first, mut last) = (1, MOST_STEPS);
        while first < last {
            let middle = first.midpoint(last);
            if self.needs(&all, level(middle))[0] > wanted {
                last = middle;
            } else {
                first = middle + 1;
            }
        }
        level(first)
    }

    /// Takes in how many points it `took` from what was waiting down to the level.
    pub fn learn(&mut self, waiting: &[Waiting], level: f64, took: f64) {
        let all = [pooled(waiting.iter().flatten().copied())];
        let expected = |steepness| Outlook { steepness, ..*self }.needs(&all, level)[0];
        if took > MANY * expected(0.0) {
            let [mut low, mut high] = STEEPNESS;
            for _ in 0..20 {
                let middle = low.midpoint(high);
                *(if expected(middle) < took { &mut low } else { &mut high }) = middle;
            }
            self.steepness = high;
        } else if expected(0.0) > 0.0 {
            let ratio = took / expected(self.steepness);
            self.share = (self.share * ratio.clamp(0.25, 4.0)).clamp(LEAST_SHARE, LARGEST_SHARE);
        }
    }
}

/// Parts of `all` in the proportion of the needs, by the largest remainder.
pub fn share_out(all: usize, needs: &[f64]) -> Vec<usize> {
    let scale = all as f64 / needs.iter().sum::<f64>();
    let exact: Vec<f64> = needs.iter().map(|need| need * scale).collect();
    let mut shares: Vec<usize> = exact.iter().map(|&share| share as usize).collect();
    let rest = all.saturating_sub(shares.iter().sum());
    let mut order: Vec<usize> = (0..needs.len()).collect();
    order.sort_by(|&a, &b| exact[b].fract().total_cmp(&exact[a].fract()).then(a.cmp(&b)));
    order.iter().take(rest).for_each(|&i| shares[i] += 1);
    shares
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_learnt_is_what_it_took() {
        let waiting = [vec![(9.0, 50), (3.0, 20)], vec![(5.0, 30)]];
        let rule = Rule { priority: 1.0, weight: 0.0, candidate: 1.0, tolerance: 0.0, bound: 1.0 };
        for (level, took) in [(1.0, 900.0), (1.0, 4000.0), (4.0, 150.0), (4.0, 250.0), (8.0, 90.0)] {
            let mut outlook = Outlook::new(&rule);
            outlook.learn(&waiting, level, took);
            let again: f64 = outlook.needs(&waiting, level).iter().sum();
            assert!((again - took).abs() < 1e-3 * took, "{level}: {again} for {took}");
        }
        // Where nothing is over the level nothing is learnt.
        let mut outlook = Outlook::new(&rule);
        outlook.learn(&waiting, 9.0, 0.0);
        assert_eq!(outlook.needs(&waiting, 1.0), Outlook::new(&rule).needs(&waiting, 1.0));
    }

    #[test]
    fn shares_add_up() {
        assert_eq!(share_out(7, &[1.0, 2.0, 0.0, 4.0]), [1, 2, 0, 4]);
        assert_eq!(share_out(8, &[1.0, 1.0, 1.0]), [3, 3, 2]);
        assert_eq!(share_out(0, &[1.0]), [0]);
        assert!(share_out(4, &[]).is_empty());
    }
}
