//! Where a triangle stands against the rule: its priority, and how its pixel is to be found.

use crate::facet::{Errors, Facet, Found};
use crate::grid::{Grid, Height};
use crate::lanes::Vectors;
use crate::patch::Patch;
use crate::queue::Pick;
use crate::rule::{quantile_index, Rule};
use crate::select::Selector;

/// An error found in single precision says which pixel is the worst if it is this many
/// times the rounding.
const CLEAR: f64 = 16.0;

/// About so many pixels stand for those of a large triangle.
const SAMPLE: usize = 128;

/// A triangle beyond the tolerance.
pub struct Ranked {
    pub priority: f64,
    /// Of the pixel to insert, in the patch, or of one near it.
    pub place: usize,
    pub pick: Pick,
}

enum Standing {
    /// Within the tolerance.
    Within,
    Beyond(Ranked),
    /// Rounding could decide.
    Unclear,
}

/// Ranks one triangle after the other.
pub struct Ranker {
    vectors: Vectors,
    /// Whether samples stand for the pixels of large triangles.
    pub is_sampling: bool,
    /// Scratch of the scans.
    errors: Errors,
    selector: Selector,
}

/// Whether a sample may stand for a triangle of so many pixels.
pub fn is_large(pixels: usize) -> bool {
    pixels >= 2 * SAMPLE
}

impl Ranker {
    pub fn new(vectors: Vectors) -> Self {
        Ranker { vectors, is_sampling: false, errors: Errors::default(), selector: Selector::default() }
    }

    /// Gives back memory that is not in use.
    pub fn compact(&mut self) {
        self.errors = Errors::default();
        self.selector = Selector::default();
    }

    /// The sample that stands for the triangle.
    #[inline]
    pub fn sample(&self, facet: &Facet) -> Option<Facet> {
        if self.is_sampling {
            facet.sampled(SAMPLE)
        } else {
            None
        }
    }

    /// Pixels that a look at the triangle takes, by their cost for the worst one.
    pub fn work(&self, rule: &Rule, facet: &Facet) -> usize {
        let pixels = if self.is_sampling { facet.pixels().min(2 * SAMPLE) } else { facet.pixels() };
        if rule.is_max() {
            pixels
        } else {
            4 * pixels
        }
    }

    /// `None` if the triangle is within the tolerance; what a sample does not show to be beyond
    /// it is scanned in full.
    #[inline]
    pub fn rank<T: Height>(
        &mut self,
        grid: &Grid<T>,
        patch: &Patch,
        rule: &Rule,
        facet: &Facet,
    ) -> Option<Ranked> {
        if let Some(sample) = self.sample(facet) {
            if let Standing::Beyond(ranked) = self.stand(grid, patch, rule, &sample) {
                return Some(ranked);
            }
        }
        match self.stand(grid, patch, rule, facet) {
            Standing::Within => None,
            Standing::Beyond(ranked) => Some(ranked),
            Standing::Unclear => exactly(facet, patch, grid, rule),
        }
    }

    /// The pixel where the scan found this error.
    pub fn find(&self, patch: &Patch, facet: &Facet, error: f32) -> usize {
        let sample = self.sample(facet).map(|sample| sample.worst_up_to(error, patch, self.vectors));
        let found = sample.filter(|found| found.error == error);
        found.unwrap_or_else(|| facet.worst_up_to(error, patch, self.vectors)).place
    }

    #[inline]
    fn stand<T: Height>(&mut self, grid: &Grid<T>, patch: &Patch, rule: &Rule, facet: &Facet) -> Standing {
        if rule.is_max() {
            self.rank_by_worst(grid, patch, rule, facet)
        } else {
            self.rank_by_quantiles(patch, rule, facet)
        }
    }

    /// Garland and Heckbert's rule: the worst pixel, nothing else.
    #[inline]
    fn rank_by_worst<T: Height>(
        &self,
        grid: &Grid<T>,
        patch: &Patch,
        rule: &Rule,
        facet: &Facet,
    ) -> Standing {
        let Found { error, place } = facet.worst(patch, self.vectors);
        match verdict(patch, facet, error, rule.tolerance) {
            Verdict::Within => Standing::Within,
            Verdict::Unclear => Standing::Unclear,
            Verdict::Beyond => {
                let priority = facet.error(patch, grid, place);
                Standing::Beyond(Ranked { priority, place, pick: Pick::KNOWN })
            }
        }
    }

    fn rank_by_quantiles(&mut self, patch: &Patch, rule: &Rule, facet: &Facet) -> Standing {
        let worst = facet.collect(patch, self.vectors, &mut self.errors);
        // The maximum bounds every quantile; what fits exactly needs no point.
        match verdict(patch, facet, worst, rule.tolerance) {
            Verdict::Within => return Standing::Within,
            Verdict::Beyond => {}
            Verdict::Unclear => return Standing::Unclear,
        }
        let count = self.errors.values().len();
        let mut known = (1.0, worst);
        let mut quantile = |q: f64| {
            if q != known.0 {
                known = (q, self.selector.nth(self.errors.values(), quantile_index(count, q), self.vectors));
            }
            known.1
        };
        if rule.tolerance > 0.0 {
            let bounded = quantile(rule.bound);
            match verdict(patch, facet, bounded, rule.tolerance) {
                Verdict::Within => return Standing::Within,
                Verdict::Beyond => {}
                Verdict::Unclear => return Standing::Unclear,
            }
        }
        let at = quantile(rule.candidate);
        let ranked = quantile(rule.priority);
        let pixels = (count * facet.thinning()) as f64;
        let priority = rule.priority_of(f64::from(ranked), f64::from(worst), pixels);
        Standing::Beyond(Ranked { priority, place: facet.middle(patch), pick: Pick::by_error(at) })
    }
}

/// What an error in single precision says about the tolerance.
enum Verdict {
    Within,
    Beyond,
    Unclear,
}

#[inline]
fn verdict(patch: &Patch, facet: &Facet, error: f32, tolerance: f64) -> Verdict {
    if !facet.is_in_range(patch) {
        return Verdict::Unclear;
    }
    let rounding = facet.rounding(error);
    let error = f64::from(error);
    if error + rounding <= tolerance || error < 0.0 || (error == 0.0 && patch.is_exact() && facet.is_exact())
    {
        Verdict::Within
    } else if error > tolerance + rounding && error > CLEAR * rounding {
        Verdict::Beyond
    } else {
        Verdict::Unclear
    }
}

/// The rule on errors in double precision.
fn exactly<T: Height>(facet: &Facet, patch: &Patch, grid: &Grid<T>, rule: &Rule) -> Option<Ranked> {
    let ranked = rule.rank(facet.exact(patch, grid));
    ranked.map(|(priority, place)| Ranked { priority, place, pick: Pick::KNOWN })
}
