//! Greedy refinement: Algorithm 1 of the paper by any rule.

use crate::error::Result;
use crate::facet::{Errors, Facet};
use crate::grid::{Grid, Height};
use crate::lanes::Vectors;
use crate::memory;
use crate::mesh::{triangle_of, Class};
use crate::patch::{Frame, Patch, Window};
use crate::predicate::Point;
use crate::progress::Progress;
use crate::queue::{Candidate, Queue};
use crate::rule::{quantile_index, Rule};
use crate::select::{position, Selector};
use crate::surface::Surface;
use crate::triangle::Location;

/// Why refinement ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stop {
    /// The number of points was reached.
    Points,
    /// Every triangle is within the tolerance.
    Tolerance,
    /// What is left is noise.
    Noise,
    /// Every pixel lies on the mesh: more points would change nothing.
    Exact,
    /// The outline of the data and the initial points are more than was asked for.
    Outline,
}

/// Patches up to this size are refined in the exact order of the priorities; larger
/// ones no longer fit the cache and use a local queue.
const EXACT_PIXELS: usize = 1 << 20;

/// An error found in single precision says which pixel is the worst if it is this many
/// times the rounding.
const CLEAR: f64 = 16.0;

/// What a vertex takes with its share of the mesh and the queue while they grow.
const VERTEX_BYTES: usize = 200;

/// Where a refinement is to stop, besides the tolerance.
#[derive(Clone, Copy, Debug)]
pub struct Goal {
    /// Number of vertices.
    pub points: usize,
    /// Candidates of this priority or a lower one are left in the queue.
    pub level: f64,
}

/// What a refinement has come to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reached {
    Points,
    /// Nothing over the level is left.
    Level,
}

/// A surface being refined over changing images.
pub struct Refiner {
    pub surface: Surface,
    vectors: Vectors,
    queue: Queue,
    /// Scratch of the scans.
    errors: Errors,
    selector: Selector,
    around: Vec<u32>,
    scaffolding: usize,
}

/// Where a triangle stands against the rule.
struct Ranked {
    priority: f64,
    /// Of the pixel to insert, in the patch.
    place: usize,
}

impl Refiner {
    pub fn new(surface: Surface) -> Self {
        Refiner::with_vectors(surface, Vectors::best())
    }

    /// The same result, whatever the vectors.
    pub fn with_vectors(surface: Surface, vectors: Vectors) -> Self {
        let scaffolding = surface.count_scaffolding();
        Refiner {
            surface,
            vectors,
            queue: Queue::new(None),
            errors: Errors::default(),
            selector: Selector::default(),
            around: Vec::new(),
            scaffolding,
        }
    }

    /// Number of vertices that carry a height.
    pub fn count(&self) -> usize {
        self.surface.z.len() - self.scaffolding
    }

    /// Algorithm 1 on `grid`, starting from the mesh as it stands, until there are
    /// `max_points` vertices or every triangle satisfies the rule's tolerance.
    pub fn run<T: Height>(
        &mut self,
        grid: &Grid<T>,
        rule: &Rule,
        max_points: usize,
        progress: &mut Progress,
    ) -> Result<Stop> {
        let window = Window { col: 0, row: 0, cols: grid.cols(), rows: grid.rows() };
        let mut patch = self.patch(grid, window, Frame::of(grid, window))?;
        self.start(grid, &patch, rule, progress)?;
        let goal = Goal { points: max_points, level: f64::NEG_INFINITY };
        let reached = self.refine(grid, &mut patch, rule, goal, progress)?;
        Ok(if reached == Reached::Points { Stop::Points } else { Stop::Tolerance })
    }

    /// The heights in the window without those that are vertices.
    pub fn patch<T: Height>(&self, grid: &Grid<T>, window: Window, frame: Frame) -> Result<Patch> {
        let mut patch = Patch::new(grid, window, frame)?;
        self.surface.mesh.points().iter().for_each(|&p| patch.exclude(p));
        Ok(patch)
    }

    /// Queues all triangles, which lie in the patch.
    pub fn start<T: Height>(
        &mut self,
        grid: &Grid<T>,
        patch: &Patch,
        rule: &Rule,
        progress: &mut Progress,
    ) -> Result<()> {
        let is_large = patch.z().len() > EXACT_PIXELS;
        if !rule.is_max() {
            // For the errors of a triangle that covers all of it, while their lists grow.
            memory::ensure(32 * patch.z().len())?;
        }
        self.queue = Queue::new(is_large.then_some(patch.stride() as u32));
        for t in 0..self.surface.mesh.triangles().len() as u32 {
            let work = self.enqueue(grid, patch, rule, t);
            progress.poll(work, || 0.0)?;
        }
        Ok(())
    }

    /// Inserts what is queued, most urgent first, up to the goal.
    pub fn refine<T: Height>(
        &mut self,
        grid: &Grid<T>,
        patch: &mut Patch,
        rule: &Rule,
        goal: Goal,
        progress: &mut Progress,
    ) -> Result<Reached> {
        let (start, mut first_priority) = (self.count(), None);
        // Vertices there is memory for, with their triangles and candidates.
        let mut room = 0;
        while self.count() < goal.points {
            if self.surface.z.len() >= room {
                room = 2 * self.surface.z.len().max(1 << 10);
                memory::ensure(VERTEX_BYTES * room)?;
            }
            let mesh = &self.surface.mesh;
            let is_current = |c: &Candidate| mesh.triangle(c.triangle).version == c.version;
            let Some(best) = self.queue.pop_over(goal.level, goal.points - self.count(), is_current) else {
                return Ok(Reached::Level);
            };
            let work = self.insert_candidate(grid, patch, rule, &best);
            let first = *first_priority.get_or_insert(best.priority);
            let (count, last) = (self.count(), rule.tolerance.max(goal.level));
            progress.poll(work, || {
                let by_points = (count - start) as f64 / (goal.points - start) as f64;
                let by_error = (first / best.priority).ln() / (first / last).ln();
                by_points.max(if by_error.is_finite() { by_error } else { 0.0 })
            })?;
        }
        Ok(Reached::Points)
    }

    /// How many candidates wait at about which priority; exact after [`Refiner::compact`].
    pub fn waiting(&self) -> Vec<(f64, usize)> {
        self.queue.waiting()
    }

    /// Gives back memory that is not in use.
    pub fn compact(&mut self) {
        let mesh = &self.surface.mesh;
        self.queue.compact(|c| mesh.triangle(c.triangle).version == c.version);
        self.errors = Errors::default();
        self.selector = Selector::default();
    }

    /// Inserts the pixel and queues the triangles around it. Returns the work done in pixels.
    fn insert_candidate<T: Height>(
        &mut self,
        grid: &Grid<T>,
        patch: &mut Patch,
        rule: &Rule,
        best: &Candidate,
    ) -> usize {
        let pixel = patch.pixel(best.pixel as usize);
        let place = self.surface.mesh.place_in(Point::pixel(pixel.0, pixel.1), best.triangle);
        let z = patch.height(best.pixel as usize, grid);
        self.insert_at(grid, patch, rule, (pixel, z, place)).1
    }

    /// Inserts a pixel of height `z`, whose place has been found, and queues the triangles
    /// around it. Returns the vertex and the work done in pixels.
    pub fn insert_at<T: Height>(
        &mut self,
        grid: &Grid<T>,
        patch: &mut Patch,
        rule: &Rule,
        (pixel, z, place): ((usize, usize), f64, Location),
    ) -> (u32, usize) {
        let v = self.surface.insert_pixel(pixel, place, z);
        patch.exclude(Point::pixel(pixel.0, pixel.1));
        let mesh = &self.surface.mesh;
        let mut around = std::mem::take(&mut self.around);
        around.clear();
        around.extend(mesh.fan(mesh.leaving(place.triangle(), v)).map(triangle_of));
        let work: usize = around.iter().map(|&t| self.enqueue(grid, patch, rule, t)).sum();
        self.around = around;
        (v, 64 + work)
    }

    /// Scans triangle `t` and queues its candidate unless it is within the
    /// tolerance. Returns the work done in pixels.
    #[inline]
    fn enqueue<T: Height>(&mut self, grid: &Grid<T>, patch: &Patch, rule: &Rule, t: u32) -> usize {
        let triangle = self.surface.mesh.triangle(t);
        if triangle.class() != Class::Data {
            return 0;
        }
        let version = triangle.version;
        let (p, z) = (self.surface.mesh.corners(t), self.surface.heights(t));
        let facet = Facet::new(patch, p, z);
        let (ranked, work) = if rule.is_max() {
            (self.rank_by_worst(grid, patch, rule, &facet), 1)
        } else {
            (self.rank(grid, patch, rule, &facet), 4)
        };
        if let Some(Ranked { priority, place }) = ranked {
            self.queue.push(Candidate { priority, pixel: place as u32, triangle: t, version });
        }
        work * facet.pixels()
    }

    /// Garland and Heckbert's rule: the worst pixel, nothing else.
    #[inline]
    fn rank_by_worst<T: Height>(
        &mut self,
        grid: &Grid<T>,
        patch: &Patch,
        rule: &Rule,
        facet: &Facet,
    ) -> Option<Ranked> {
        let found = facet.worst(patch, self.vectors);
        let (priority, place) = match verdict(patch, facet, found.error, rule.tolerance) {
            Verdict::Within => return None,
            Verdict::Beyond => (facet.error(patch, grid, found.place), found.place),
            Verdict::Unclear => {
                let found =
                    facet.exact(patch, grid).into_iter().reduce(|a, b| if b.0 > a.0 { b } else { a })?;
                if found.0 <= rule.tolerance {
                    return None;
                }
                found
            }
        };
        Some(Ranked { priority, place })
    }

    fn rank<T: Height>(
        &mut self,
        grid: &Grid<T>,
        patch: &Patch,
        rule: &Rule,
        facet: &Facet,
    ) -> Option<Ranked> {
        let worst = facet.collect(patch, self.vectors, &mut self.errors);
        // The maximum bounds every quantile; what fits exactly needs no point.
        match verdict(patch, facet, worst.error, rule.tolerance) {
            Verdict::Within => return None,
            Verdict::Beyond => {}
            Verdict::Unclear => return exactly(facet, patch, grid, rule),
        }
        let count = self.errors.values().len();
        let mut known = (1.0, worst.error);
        let mut quantile = |q: f64| {
            if q != known.0 {
                known = (q, self.selector.nth(self.errors.values(), quantile_index(count, q), self.vectors));
            }
            known.1
        };
        if rule.tolerance > 0.0 {
            let bounded = quantile(rule.bound);
            match verdict(patch, facet, bounded, rule.tolerance) {
                Verdict::Within => return None,
                Verdict::Beyond => {}
                Verdict::Unclear => return exactly(facet, patch, grid, rule),
            }
        }
        let at = quantile(rule.candidate);
        let ranked = quantile(rule.priority);
        let place = if rule.candidate == 1.0 {
            worst.place
        } else {
            let first = position(self.errors.values(), at, self.vectors);
            first.map_or(worst.place, |i| self.errors.places()[i] as usize)
        };
        let priority = rule.priority_of(f64::from(ranked), f64::from(worst.error), count as f64);
        Some(Ranked { priority, place })
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
    rule.rank(facet.exact(patch, grid)).map(|(priority, place)| Ranked { priority, place })
}
