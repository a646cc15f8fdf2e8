//! Where a triangle stands against the rule: its priority, and how its pixel is to be found.

use crate::facet::Facet;
use crate::grid::Height;
use crate::image::View;
use crate::lanes::{Kernel, Lanes, Part, Vectors};
use crate::list::List;
use crate::patch::Patch;
use crate::predicate::Point;
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
    errors: List,
    selector: Selector,
}

/// Whether a sample may stand for a triangle of so many pixels.
pub fn is_large(pixels: usize) -> bool {
    pixels >= 2 * SAMPLE
}

impl Ranker {
    pub fn new(vectors: Vectors) -> Self {
        Ranker { vectors, is_sampling: false, errors: List::default(), selector: Selector::default() }
    }

    /// Gives back memory that is not in use.
    pub fn compact(&mut self) {
        self.errors = List::default();
        self.selector = Selector::default();
    }

    /// The sample that stands for the triangle.
    #[inline(always)]
    pub fn sample(&self, facet: &Facet) -> Option<Facet> {
        if self.is_sampling {
            facet.sampled(SAMPLE)
        } else {
            None
        }
    }

    /// Where the triangle with corners `p` and heights `z` stands; `None` if it is within the tolerance.
    /// What a sample does not show to be beyond it is scanned in full. And the work done in pixels.
    #[inline]
    pub fn rank<T: Height>(
        &mut self,
        view: &View<T>,
        patch: &Patch,
        rule: &Rule,
        (p, z): ([Point; 3], [f64; 3]),
    ) -> (Option<Ranked>, usize) {
        let (standing, work) = self.vectors.run(Look { ranker: self, patch, rule, p, z });
        let ranked = match standing {
            Standing::Within => None,
            Standing::Beyond(ranked) => Some(ranked),
            Standing::Unclear => exactly(&Facet::new(patch, p, z), patch, view, rule),
        };
        (ranked, work)
    }

    /// The pixel where the scan found this error.
    pub fn find(&self, patch: &Patch, facet: &Facet, error: f32) -> usize {
        let sample = self.sample(facet).map(|sample| sample.worst_up_to(error, patch, self.vectors));
        let found = sample.filter(|found| found.error == error);
        found.unwrap_or_else(|| facet.worst_up_to(error, patch, self.vectors)).place
    }

    /// Garland and Heckbert's rule: the worst pixel, nothing else.
    #[inline(always)]
    fn rank_by_worst<L: Lanes>(patch: &Patch, rule: &Rule, facet: &Facet) -> Standing {
        let worst = facet.largest::<L>(patch);
        match verdict(patch, facet, worst, rule.tolerance) {
            Verdict::Within => Standing::Within,
            Verdict::Unclear => Standing::Unclear,
            Verdict::Beyond => {
                let (place, pick) = (facet.first(patch), Pick::by_error(worst));
                Standing::Beyond(Ranked { priority: worst.into(), place, pick })
            }
        }
    }

    #[inline(always)]
    fn rank_by_quantiles<L: Lanes>(&mut self, patch: &Patch, rule: &Rule, facet: &Facet) -> Standing {
        let worst = facet.collect::<L>(patch, &mut self.errors);
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
                known = (q, self.selector.nth::<L>(&self.errors, quantile_index(count, q)));
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
        Standing::Beyond(Ranked { priority, place: facet.first(patch), pick: Pick::by_error(at) })
    }
}

/// Looks at one triangle.
struct Look<'a> {
    ranker: &'a mut Ranker,
    patch: &'a Patch,
    rule: &'a Rule,
    p: [Point; 3],
    z: [f64; 3],
}

impl Kernel for Look<'_> {
    type Output = (Standing, usize);

    #[inline(always)]
    fn run<L: Lanes>(self) -> (Standing, usize) {
        let Look { ranker, patch, rule, p, z } = self;
        let facet = Facet::new(patch, p, z);
        if let Some(sample) = ranker.sample(&facet) {
            let standing = L::apart(Stand { ranker, patch, rule, facet: &sample });
            if matches!(standing, Standing::Beyond(_)) {
                return (standing, SAMPLE);
            }
        }
        let standing = if rule.is_max() {
            Ranker::rank_by_worst::<L>(patch, rule, &facet)
        } else {
            L::apart(Stand { ranker, patch, rule, facet: &facet })
        };
        (standing, facet.pixels)
    }
}

/// Where a triangle or a sample of it stands.
struct Stand<'a> {
    ranker: &'a mut Ranker,
    patch: &'a Patch,
    rule: &'a Rule,
    facet: &'a Facet,
}

impl<L: Lanes> Part<L> for Stand<'_> {
    type Output = Standing;

    #[inline(always)]
    fn run(self) -> Standing {
        let Stand { ranker, patch, rule, facet } = self;
        if rule.is_max() {
            Ranker::rank_by_worst::<L>(patch, rule, facet)
        } else {
            ranker.rank_by_quantiles::<L>(patch, rule, facet)
        }
    }
}

/// What an error in single precision says about the tolerance.
enum Verdict {
    Within,
    Beyond,
    Unclear,
}

#[inline(always)]
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
fn exactly<T: Height>(facet: &Facet, patch: &Patch, view: &View<T>, rule: &Rule) -> Option<Ranked> {
    let ranked = rule.rank(facet.exact(patch, view));
    ranked.map(|(priority, place)| Ranked { priority, place, pick: Pick::KNOWN })
}
