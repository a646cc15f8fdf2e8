//! Where a triangle stands against the rule: its priority, and how its pixel is to be found.

use crate::facet::Facet;
use crate::facets::Facets;
use crate::grid::Height;
use crate::image::View;
use crate::lanes::{Kernel, Lanes, Part, Vectors, LANES};
use crate::list::List;
use crate::patch::Patch;
use crate::queue::Pick;
use crate::rule::{quantile_index, Rule};
use crate::scanned::Scan;
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
    memory: Memory,
}

/// Scratch of the scans.
#[derive(Default)]
pub struct Memory {
    errors: List,
    selector: Selector,
}

/// Whether a sample may stand for a triangle of so many pixels.
pub fn is_large(pixels: usize) -> bool {
    pixels >= 2 * SAMPLE
}

impl Ranker {
    pub fn new(vectors: Vectors) -> Self {
        Ranker { vectors, is_sampling: false, memory: Memory::default() }
    }

    /// Works in the other memory.
    pub fn swap(&mut self, memory: &mut Memory) {
        std::mem::swap(&mut self.memory, memory);
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

    /// Gives `each` of the triangles that are beyond the tolerance, by its number among them, to the caller, and returns
    /// the work done in pixels. What a sample does not show to be beyond it is scanned in full.
    #[inline]
    pub fn rank<T: Height>(
        &mut self,
        view: &View<T>,
        patch: &Patch,
        rule: &Rule,
        facets: &mut Facets,
        mut each: impl FnMut(usize, Ranked),
    ) -> usize {
        let (standings, work) = self.vectors.run(Look { ranker: self, patch, rule, facets });
        for (i, standing) in standings.into_iter().enumerate().take(facets.count()) {
            let ranked = match standing {
                Standing::Within => None,
                Standing::Beyond(ranked) => Some(ranked),
                Standing::Unclear => exactly(&facets.facet(patch, i), patch, view, rule),
            };
            if let Some(ranked) = ranked {
                each(i, ranked);
            }
        }
        work
    }

    /// The pixel where the scan found this error.
    pub fn find(&self, patch: &Patch, facet: &Facet, error: f32) -> usize {
        let sample = self.sample(facet).map(|sample| sample.worst_up_to(error, patch, self.vectors));
        let found = sample.filter(|found| found.error == error);
        found.unwrap_or_else(|| facet.worst_up_to(error, patch, self.vectors)).place
    }

    /// Garland and Heckbert's rule: the worst pixel, nothing else.
    #[inline(always)]
    fn rank_by_worst<L: Lanes>(patch: &Patch, rule: &Rule, facet: &impl Scan) -> Standing {
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
    fn rank_by_quantiles<L: Lanes>(&mut self, patch: &Patch, rule: &Rule, facet: &impl Scan) -> Standing {
        let worst = facet.collect::<L>(patch, &mut self.memory.errors);
        // The maximum bounds every quantile; what fits exactly needs no point.
        match verdict(patch, facet, worst, rule.tolerance) {
            Verdict::Within => return Standing::Within,
            Verdict::Beyond => {}
            Verdict::Unclear => return Standing::Unclear,
        }
        let count = self.memory.errors.values().len();
        let mut known = (1.0, worst);
        let mut quantile = |q: f64| {
            if q != known.0 {
                known = (q, self.memory.selector.nth::<L>(&self.memory.errors, quantile_index(count, q)));
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

/// Looks at some triangles.
struct Look<'a> {
    ranker: &'a mut Ranker,
    patch: &'a Patch,
    rule: &'a Rule,
    facets: &'a mut Facets,
}

impl Kernel for Look<'_> {
    type Output = ([Standing; LANES], usize);

    #[inline(always)]
    fn run<L: Lanes>(self) -> ([Standing; LANES], usize) {
        let Look { ranker, patch, rule, facets } = self;
        let mut standings = [const { Standing::Within }; LANES];
        let is_max = rule.is_max();
        facets.make_ready::<L>(patch);
        let mut work = 0;
        for (i, standing) in standings.iter_mut().enumerate().take(facets.count()) {
            *standing = match facets.narrow(i) {
                Some(facet) => {
                    work += facet.room();
                    if is_max {
                        Ranker::rank_by_worst::<L>(patch, rule, &facet)
                    } else {
                        ranker.rank_by_quantiles::<L>(patch, rule, &facet)
                    }
                }
                None => {
                    let (standing, pixels) = L::apart(Large { ranker, patch, rule, facets, i });
                    work += pixels;
                    standing
                }
            };
        }
        (standings, work)
    }
}

/// Looks at one that is wide or high.
struct Large<'a> {
    ranker: &'a mut Ranker,
    patch: &'a Patch,
    rule: &'a Rule,
    facets: &'a Facets,
    i: usize,
}

impl<L: Lanes> Part<L> for Large<'_> {
    type Output = (Standing, usize);

    #[inline(always)]
    fn run(self) -> (Standing, usize) {
        let Large { ranker, patch, rule, facets, i } = self;
        let facet = facets.facet(patch, i);
        let sample = ranker.sample(&facet).map(|sample| (sample, SAMPLE));
        let (mut standing, mut work) = (Standing::Within, 0);
        for (facet, pixels) in sample.into_iter().chain([(facet, facet.pixels)]) {
            standing = if rule.is_max() {
                Ranker::rank_by_worst::<L>(patch, rule, &facet)
            } else {
                ranker.rank_by_quantiles::<L>(patch, rule, &facet)
            };
            work += pixels;
            if matches!(standing, Standing::Beyond(_)) {
                break;
            }
        }
        (standing, work)
    }
}

/// What an error in single precision says about the tolerance.
enum Verdict {
    Within,
    Beyond,
    Unclear,
}

#[inline(always)]
fn verdict(patch: &Patch, facet: &impl Scan, error: f32, tolerance: f64) -> Verdict {
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
