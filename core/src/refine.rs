//! Greedy refinement: Algorithm 1 of the paper by any rule.

use crate::candidate::{Candidate, Pick};
use crate::error::Result;
use crate::facet::Facet;
use crate::grid::Height;
use crate::image::{Image, View};
use crate::lanes::{Vectors, LANES};
use crate::memory;
use crate::mesh::triangle_of;
use crate::patch::Patch;
use crate::predicate::{pixels_of, Point};
use crate::progress::Progress;
use crate::queue::{self, Order};
use crate::rank;
use crate::rule::{Rule, Stop};
use crate::scanner::Scanner;
use crate::surface::Surface;
use crate::triangle::{Location, Triangle};
use crate::window::Window;

/// Patches up to this size are refined in the exact order of the priorities; larger
/// ones no longer fit the cache and use a local queue.
const EXACT_PIXELS: usize = 1 << 20;

/// In a rough order so many triangles may have changed before they are looked at.
const CHANGED: usize = 256;

/// The work that an insertion makes beside its scans, in pixels.
const INSERTION: usize = 64;

/// What a vertex takes with its share of the mesh and the queue while they grow.
pub(crate) const VERTEX_BYTES: usize = 200;

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
    scanner: Scanner,
    around: Vec<u32>,
    /// Triangles still to be looked at, with their versions.
    changed: Vec<(u32, u32)>,
    scaffolding: usize,
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
            scanner: Scanner::new(vectors),
            around: Vec::new(),
            changed: Vec::new(),
            scaffolding,
        }
    }

    /// Lets samples stand for the pixels of large triangles, until it has to be
    /// [`Refiner::exact`]: a tile comes to the same points but for a few of the first.
    pub fn sampling(mut self) -> Self {
        self.scanner.ranker.start_sampling();
        self
    }

    /// Whether a sample may stand for a triangle.
    pub fn is_sampling(&self) -> bool {
        self.scanner.ranker.is_sampling()
    }

    /// None does from when no triangle is large enough.
    pub fn note_samples(&mut self) {
        if !self.surface.mesh.triangles().iter().any(|t| self.is_large(t)) {
            self.scanner.ranker.stop_sampling();
        }
    }

    fn is_large(&self, triangle: &Triangle) -> bool {
        self.scanner.ranker.is_large(pixels_of(triangle.v.map(|v| self.surface.mesh.point(v))))
    }

    /// Number of vertices that carry a height.
    pub fn count(&self) -> usize {
        self.surface.z.len() - self.scaffolding
    }

    /// Algorithm 1 on the image, starting from the mesh as it stands, until there are
    /// `max_points` vertices or every triangle satisfies the rule's tolerance.
    pub fn run<T: Height>(
        &mut self,
        image: &Image<T>,
        rule: &Rule,
        max_points: usize,
        progress: &mut Progress,
    ) -> Result<Stop> {
        let window = Window { col: 0, row: 0, cols: image.cols(), rows: image.rows() };
        let mut view = image.view()?;
        view.show(window, progress)?;
        let mut patch = Patch::new(&view, window)?;
        self.exclude_vertices(&mut patch);
        self.start(&view, &patch, rule, progress)?;
        let goal = Goal { points: max_points, level: f64::NEG_INFINITY };
        let reached = self.refine(&view, &mut patch, rule, goal, progress)?;
        Ok(if reached == Reached::Points { Stop::Points } else { Stop::Tolerance })
    }

    /// No pixel that is a vertex is a candidate.
    pub fn exclude_vertices(&self, patch: &mut Patch) {
        self.surface.mesh.points().iter().for_each(|&p| patch.exclude(p));
    }

    /// Queues all triangles, which lie in the patch.
    pub fn start<T: Height>(
        &mut self,
        view: &View<T>,
        patch: &Patch,
        rule: &Rule,
        progress: &mut Progress,
    ) -> Result<()> {
        let is_large = patch.size() > EXACT_PIXELS;
        if !rule.is_max() {
            // For the errors of a triangle that covers all of it, while their lists grow.
            memory::ensure(32 * patch.size())?;
        }
        self.scanner.ranker.sample_for(rule);
        self.scanner.queue.clear(match (is_large, self.scanner.ranker.is_sampling()) {
            (true, _) => Order::Curve(patch.stride() as u32),
            (_, true) => Order::Latest,
            _ => Order::Exact,
        });
        let all = vec![true; self.surface.mesh.triangles().len()];
        self.enqueue_those(&all, view, patch, rule, progress)
    }

    /// After [`Refiner::start`] on another image, and parked: has the triangles in the queue scanned again
    /// when it is their turn, and queues the others.
    pub fn start_again<T: Height>(
        &mut self,
        view: &View<T>,
        patch: &Patch,
        rule: &Rule,
        progress: &mut Progress,
    ) -> Result<()> {
        let mut is_new = vec![true; self.surface.mesh.triangles().len()];
        self.scanner.queue.rescan(|c| is_new[c.triangle as usize] = false);
        self.enqueue_those(&is_new, view, patch, rule, progress)
    }

    /// From now on no sample stands for a triangle; those it stood for are scanned in full.
    pub fn exact<T: Height>(
        &mut self,
        view: &View<T>,
        patch: &Patch,
        rule: &Rule,
        progress: &mut Progress,
    ) -> Result<()> {
        let mesh = &self.surface.mesh;
        let is_sampled: Vec<bool> = (0..)
            .zip(mesh.triangles())
            .map(|(t, triangle)| {
                self.is_large(triangle) && self.scanner.ranker.sample(&self.facet(patch, t)).is_some()
            })
            .collect();
        self.scanner.ranker.stop_sampling();
        self.scanner
            .queue
            .park(|c| mesh.triangle(c.triangle).version == c.version && !is_sampled[c.triangle as usize]);
        self.enqueue_those(&is_sampled, view, patch, rule, progress)
    }

    /// Inserts what is queued, most urgent first, up to the goal.
    pub fn refine<T: Height>(
        &mut self,
        view: &View<T>,
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
            let (best, scanned) = self.next(view, patch, rule, goal);
            let Some(best) = best else { return Ok(Reached::Level) };
            if best.pick == Pick::RESCAN {
                let work = self.scan_again(&best, view, patch, rule);
                progress.poll(scanned + work, || 0.0)?;
                continue;
            }
            let work = scanned + self.insert_candidate(view, patch, rule, &best);
            let first = *first_priority.get_or_insert(best.priority);
            let (count, last) = (self.count(), rule.tolerance.max(goal.level));
            progress.poll(work, || {
                let by_points = (count - start) as f64 / (goal.points - start) as f64;
                let by_error = (first / best.priority).ln() / (first / last).ln();
                by_points.max(if by_error.is_finite() { by_error } else { 0.0 })
            })?;
        }
        self.enqueue_changed(view, patch, rule);
        Ok(Reached::Points)
    }

    /// The most urgent candidate over the level, and the work done in pixels. In a rough order what a bucket
    /// has changed is scanned all together, when it is worked off: some of it has changed again by then.
    #[inline]
    fn next<T: Height>(
        &mut self,
        view: &View<T>,
        patch: &Patch,
        rule: &Rule,
        goal: Goal,
    ) -> (Option<Candidate>, usize) {
        if self.changed.len() < CHANGED {
            let mesh = &self.surface.mesh;
            let is_current = |c: &Candidate| mesh.triangle(c.triangle).version == c.version;
            if let Some(best) = self.scanner.queue.pop_rough(goal.level, is_current) {
                return (Some(best), 0);
            }
        }
        let work = self.enqueue_changed(view, patch, rule);
        let mesh = &self.surface.mesh;
        let is_current = |c: &Candidate| mesh.triangle(c.triangle).version == c.version;
        (self.scanner.queue.pop_over(goal.level, goal.points - self.count(), is_current), work)
    }

    /// How many candidates wait at about which priority, once they are parked.
    pub fn waiting(&self) -> Vec<(f64, usize)> {
        self.scanner.queue.waiting()
    }

    /// Works in the other memories; what is queued must be parked.
    pub(crate) fn swap(&mut self, queue: &mut queue::Memory, ranker: &mut rank::Memory) {
        self.scanner.queue.swap(queue);
        self.scanner.ranker.swap(ranker);
    }

    /// Has what is queued wait in no more memory than it needs.
    pub(crate) fn park(&mut self) {
        let mesh = &self.surface.mesh;
        self.scanner.queue.park(|c| mesh.triangle(c.triangle).version == c.version);
    }

    /// The highest priority that waits.
    pub fn top(&mut self) -> Option<f64> {
        let mesh = &self.surface.mesh;
        self.scanner.queue.top(|c| mesh.triangle(c.triangle).version == c.version)
    }

    /// Works off the most urgent candidate alone. `show` has the view show what lies around some corners, and puts it,
    /// none of these being candidates, into the patch. Returns the work done in pixels.
    pub fn step<'i, T: Height>(
        &mut self,
        view: &mut View<'i, T>,
        patch: &mut Patch,
        rule: &Rule,
        mut show: impl FnMut(&mut View<'i, T>, &mut Patch, &[Point]) -> Result<()>,
    ) -> Result<usize> {
        let mesh = &self.surface.mesh;
        let is_current = |c: &Candidate| mesh.triangle(c.triangle).version == c.version;
        let Some(best) = self.scanner.queue.pop(1, is_current) else { return Ok(0) };
        show(view, patch, &mesh.corners(best.triangle))?;
        if best.pick == Pick::RESCAN {
            return Ok(self.scanner.scan(&self.surface, [best.triangle], view, patch, rule));
        }
        let (pixel, z, place) = self.candidate(view, patch, &best);
        self.insert((pixel, z, place));
        let mesh = &self.surface.mesh;
        let corners: Vec<Point> = self.around.iter().flat_map(|&t| mesh.corners(t)).collect();
        show(view, patch, &corners)?;
        Ok(self.enqueue_around(view, patch, rule))
    }

    /// Scans a triangle that waits for that, in a rough order later. Returns the work done in pixels.
    fn scan_again<T: Height>(
        &mut self,
        best: &Candidate,
        view: &View<T>,
        patch: &Patch,
        rule: &Rule,
    ) -> usize {
        if !self.scanner.queue.is_rough() {
            return self.scanner.scan(&self.surface, [best.triangle], view, patch, rule);
        }
        self.changed.push((best.triangle, best.version));
        1
    }

    /// Inserts the pixel and queues the triangles around it, in a rough order later. Returns the work done in pixels.
    fn insert_candidate<T: Height>(
        &mut self,
        view: &View<T>,
        patch: &mut Patch,
        rule: &Rule,
        best: &Candidate,
    ) -> usize {
        let candidate = self.candidate(view, patch, best);
        if !self.scanner.queue.is_rough() {
            return self.insert_at(view, patch, rule, candidate).1;
        }
        self.insert_into(patch, candidate);
        let mesh = &self.surface.mesh;
        self.changed.extend(self.around.iter().map(|&t| (t, mesh.triangle(t).version)));
        INSERTION
    }

    /// The pixel to insert, its height and its place in the mesh.
    fn candidate<T: Height>(
        &self,
        view: &View<T>,
        patch: &Patch,
        best: &Candidate,
    ) -> ((usize, usize), f64, Location) {
        let found = match best.pick.error() {
            Some(error) => self.scanner.ranker.find(patch, &self.facet(patch, best.triangle), error),
            None => best.pixel as usize,
        };
        let pixel = patch.pixel(found);
        let place = self.surface.mesh.place_in(Point::pixel(pixel.0, pixel.1), best.triangle);
        (pixel, patch.height(found, view), place)
    }

    #[inline]
    fn facet(&self, patch: &Patch, t: u32) -> Facet {
        Facet::new(patch, self.surface.mesh.corners(t), self.surface.heights(t))
    }

    /// Inserts a pixel of height `z`, whose place has been found, and queues the triangles
    /// around it. Returns the vertex and the work done in pixels.
    pub fn insert_at<T: Height>(
        &mut self,
        view: &View<T>,
        patch: &mut Patch,
        rule: &Rule,
        (pixel, z, place): ((usize, usize), f64, Location),
    ) -> (u32, usize) {
        let v = self.insert_into(patch, (pixel, z, place));
        (v, self.enqueue_around(view, patch, rule))
    }

    /// Inserts a pixel, which is no candidate from now on, and notes the triangles around it.
    #[inline]
    fn insert_into(&mut self, patch: &mut Patch, (pixel, z, place): ((usize, usize), f64, Location)) -> u32 {
        patch.exclude(Point::pixel(pixel.0, pixel.1));
        self.insert((pixel, z, place))
    }

    /// Inserts a pixel and notes the triangles around it.
    #[inline]
    fn insert(&mut self, (pixel, z, place): ((usize, usize), f64, Location)) -> u32 {
        let v = self.surface.insert_pixel(pixel, place, z);
        let mesh = &self.surface.mesh;
        self.around.clear();
        self.around.extend(mesh.fan(mesh.leaving(place.triangle(), v)).map(triangle_of));
        v
    }

    /// Queues the triangles around the last vertex. Returns the work done in pixels.
    #[inline]
    fn enqueue_around<T: Height>(&mut self, view: &View<T>, patch: &Patch, rule: &Rule) -> usize {
        INSERTION + self.scanner.scan(&self.surface, self.around.iter().copied(), view, patch, rule)
    }

    /// Scans and queues what has changed, as far as it is still there. Returns the work done in pixels.
    fn enqueue_changed<T: Height>(&mut self, view: &View<T>, patch: &Patch, rule: &Rule) -> usize {
        if self.changed.is_empty() {
            return 0;
        }
        let mut changed = std::mem::take(&mut self.changed);
        let mesh = &self.surface.mesh;
        let current = changed.drain(..).filter(|&(t, version)| mesh.triangle(t).version == version);
        let work = self.scanner.scan(&self.surface, current.map(|(t, _)| t), view, patch, rule);
        self.changed = changed;
        work
    }

    /// Scans and queues the triangles that are marked.
    fn enqueue_those<T: Height>(
        &mut self,
        marked: &[bool],
        view: &View<T>,
        patch: &Patch,
        rule: &Rule,
        progress: &mut Progress,
    ) -> Result<()> {
        let mut marked = (0..).zip(marked).filter(|(_, is_marked)| **is_marked).map(|(t, _)| t).peekable();
        while marked.peek().is_some() {
            let work = self.scanner.scan(&self.surface, marked.by_ref().take(LANES), view, patch, rule);
            progress.poll(work, || 0.0)?;
        }
        Ok(())
    }
}
