//! Where a triangle stands against the rule: its priority, and how its pixel is to be found.

use crate::candidate::Pick;
use crate::facet::Facet;
use crate::facets::Facets;
use crate::grid::Height;
use crate::image::View;
use crate::lanes::{Kernel, Lanes, Part, Vectors, LANES};
use crate::list::List;
use crate::patch::Patch;
use crate::rule::{quantile_index, Rule};
use crate::scanned::{Found, Scan};
use crate::select::{of_eight, Selector};

/// An error found in single precision says which pixel is the worst if it is this many
/// times the rounding.
const CLEAR: f64 = 16.0;

/// About so many pixels stand for those of a large triangle where the worst of them is inserted,
const WORST_OF: usize = 128;
/// and where another quantile is, of which fewer tell as much.
const QUANTILE_OF: usize = 64;

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
    /// About so many pixels stand for those of large triangles, if samples do.
    sampled: Option<usize>,
    memory: Memory,
}

/// Scratch of the scans.
#[derive(Default)]
pub struct Memory {
    errors: List,
    selector: Selector,
}

impl Ranker {
    pub fn new(vectors: Vectors) -> Self {
        Ranker { vectors, sampled: None, memory: Memory::default() }
    }

    /// Lets samples stand for the pixels of large triangles,
    pub fn start_sampling(&mut self) {
        self.sampled = Some(WORST_OF);
    }

    /// or no longer.
    pub fn stop_sampling(&mut self) {
        self.sampled = None;
    }

    /// Samples, if there are some, are to be what this rule needs.
    pub fn sample_for(&mut self, rule: &Rule) {
        if let Some(pixels) = &mut self.sampled {
            *pixels = if rule.candidate == 1.0 { WORST_OF } else { QUANTILE_OF };
        }
    }

    pub fn is_sampling(&self) -> bool {
        self.sampled.is_some()
    }

    /// Whether a sample may stand for a triangle of so many pixels.
    pub fn is_large(&self, pixels: usize) -> bool {
        self.sampled.is_some_and(|sampled| pixels >= 2 * sampled)
    }

    /// Works in the other memory.
    pub fn swap(&mut self, memory: &mut Memory) {
        std::mem::swap(&mut self.memory, memory);
    }

    /// The sample that stands for the triangle.
    #[inline(always)]
    pub fn sample(&self, facet: &Facet) -> Option<Facet> {
        facet.sampled(self.sampled?)
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
        let (vectors, ranker) = (self.vectors, self);
        let looked = match (rule.is_max(), rule.is_by_groups()) {
            (true, _) => vectors.run(Look::<_, WORST> { ranker, patch, rule, facets, each: &mut each }),
            (_, true) => vectors.run(Look::<_, GROUPS> { ranker, patch, rule, facets, each: &mut each }),
            _ => vectors.run(Look::<_, QUANTILES> { ranker, patch, rule, facets, each: &mut each }),
        };
        for i in (0..facets.count()).filter(|i| looked.unclear >> i & 1 != 0) {
            if let Some(ranked) = exactly(&facets.facet(patch, i), patch, view, rule) {
                each(i, ranked);
            }
        }
        looked.work
    }

    /// The pixel where the scan found this error.
    pub fn find(&self, patch: &Patch, facet: &Facet, error: f32) -> usize {
        let sample = self.sample(facet).map(|sample| sample.worst_up_to(error, patch, self.vectors));
        let found = sample.filter(|found| found.error == error);
        found.unwrap_or_else(|| facet.worst_up_to(error, patch, self.vectors)).place
    }

    #[inline(always)]
    fn rank_by<L: Lanes, const RULE: u8>(
        &mut self,
        patch: &Patch,
        rule: &Rule,
        facet: &impl Scan,
    ) -> Standing {
        match RULE {
            WORST => Ranker::rank_by_worst::<L>(patch, rule, facet),
            GROUPS => Ranker::rank_by_groups::<L>(patch, rule, facet),
            _ => self.rank_by_quantiles::<L>(patch, rule, facet),
        }
    }

    /// Garland and Heckbert's rule: the worst pixel, nothing else.
    #[inline(always)]
    fn rank_by_worst<L: Lanes>(patch: &Patch, rule: &Rule, facet: &impl Scan) -> Standing {
        let Found { error, place } = facet.worst::<L>(patch);
        match verdict(patch, facet, error, rule.tolerance) {
            Verdict::Within => Standing::Within,
            Verdict::Unclear => Standing::Unclear,
            Verdict::Beyond => Standing::Beyond(Ranked { priority: error.into(), place, pick: Pick::KNOWN }),
        }
    }

    /// A quantile of the largest errors in groups of pixels says which triangle comes first, the worst pixel is inserted.
    #[inline(always)]
    fn rank_by_groups<L: Lanes>(patch: &Patch, rule: &Rule, facet: &impl Scan) -> Standing {
        let (Found { error, place }, groups, count) = facet.groups::<L>(patch);
        match verdict(patch, facet, error, rule.tolerance) {
            Verdict::Within => Standing::Within,
            Verdict::Unclear => Standing::Unclear,
            Verdict::Beyond => {
                let ranked = of_eight::<L>(groups, rule.priority);
                let pixels = (count * facet.thinning()) as f64;
                let priority = rule.priority_of(ranked.into(), error.into(), pixels);
                Standing::Beyond(Ranked { priority, place, pick: Pick::KNOWN })
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
        let pick = Pick::by_error(quantile(rule.candidate));
        let ranked = quantile(rule.priority);
        let pixels = (count * facet.thinning()) as f64;
        let priority = rule.priority_of(f64::from(ranked), f64::from(worst), pixels);
        Standing::Beyond(Ranked { priority, place: facet.first(patch), pick })
    }
}

/// Kinds of rules, each with a kernel of its own: the worst pixel, nothing else;
const WORST: u8 = 0;
/// a quantile of groups of pixels ranks, the worst pixel is inserted;
const GROUPS: u8 = 1;
/// any quantiles.
const QUANTILES: u8 = 2;

/// Looks at some triangles, and gives `each` that is beyond the tolerance.
struct Look<'a, F, const RULE: u8> {
    ranker: &'a mut Ranker,
    patch: &'a Patch,
    rule: &'a Rule,
    facets: &'a mut Facets,
    each: &'a mut F,
}

/// Which triangles rounding could decide, a bit each, and the work done in pixels.
struct Looked {
    unclear: u32,
    work: usize,
}

impl<F: FnMut(usize, Ranked), const RULE: u8> Kernel for Look<'_, F, RULE> {
    type Output = Looked;

    #[inline(always)]
    fn run<L: Lanes>(self) -> Looked {
        let Look { ranker, patch, rule, facets, each } = self;
        facets.make_ready::<L>(patch);
        let mut looked = Looked { unclear: 0, work: 0 };
        for i in 0..facets.count().min(LANES) {
            let standing = match facets.narrow(i) {
                Some(facet) => {
                    looked.work += facet.room();
                    ranker.rank_by::<L, RULE>(patch, rule, &facet)
                }
                None => {
                    let (standing, pixels) = L::apart(Large::<RULE> { ranker, patch, rule, facets, i });
                    looked.work += pixels;
                    standing
                }
            };
            match standing {
                Standing::Within => {}
                Standing::Beyond(ranked) => each(i, ranked),
                Standing::Unclear => looked.unclear |= 1 << i,
            }
        }
        looked
    }
}

/// Looks at one that is wide or high.
struct Large<'a, const RULE: u8> {
    ranker: &'a mut Ranker,
    patch: &'a Patch,
    rule: &'a Rule,
    facets: &'a Facets,
    i: usize,
}

impl<L: Lanes, const RULE: u8> Part<L> for Large<'_, RULE> {
    type Output = (Standing, usize);

    #[inline(always)]
    fn run(self) -> (Standing, usize) {
        let Large { ranker, patch, rule, facets, i } = self;
        let facet = facets.facet(patch, i);
        let sample = ranker.sample(&facet).zip(ranker.sampled);
        let (mut standing, mut work) = (Standing::Within, 0);
        for (facet, pixels) in sample.into_iter().chain([(facet, facet.pixels)]) {
            standing = ranker.rank_by::<L, RULE>(patch, rule, &facet);
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
