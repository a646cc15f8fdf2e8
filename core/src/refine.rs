//! Greedy refinement: Algorithm 1 of the paper with two free quantiles.
//!
//! In every triangle the errors |z - plane| of its pixels (closed triangle,
//! corners excluded) are taken. Their quantile `priority` times count^`weight`
//! tells how urgent the triangle is; the pixel at the quantile `candidate` is
//! what is inserted (if that is the worst one, a share of its error counts, too). The paper's metric is (0.5, 0, 0.5), Garland and Heckbert's
//! is (1, 0, 1).

use crate::error::Result;
use crate::grid::{Grid, Height};
use crate::memory;
use crate::mesh::Class;
use crate::order::insertion_order;
use crate::predicate::Point;
use crate::progress::Progress;
use crate::queue::{Candidate, Queue};
use crate::scan::{collect, for_each_pixel, warm, worst, Corners};
use crate::surface::Surface;

/// How triangles are ranked, what is inserted and when to stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rule {
    /// Quantile of a triangle's errors that ranks it, in (0, 1].
    pub priority: f64,
    /// The rank is multiplied by (number of pixels)^weight.
    pub weight: f64,
    /// Quantile at which the pixel to insert stands, in (0, 1].
    pub candidate: f64,
    /// A triangle is left alone when the quantile `bound` of its errors is at or
    /// under `tolerance`.
    pub tolerance: f64,
    pub bound: f64,
}

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

/// Rasters up to this size are refined in the exact order of the priorities; larger
/// ones no longer fit the cache and use a local queue.
const EXACT_PIXELS: usize = 1 << 20;

/// Where the worst pixel is what gets inserted, this share of its error counts beside
/// the quantile: a triangle that fits but for one pixel does not wait forever, and
/// those whose median error is zero are told apart.
const WORST_SHARE: f64 = 0.3;

/// What a vertex takes with its share of the mesh and the queue while they grow.
const VERTEX_BYTES: usize = 200;

/// Index of the quantile `q` among `n` sorted errors; 0.5 gives the lower median.
pub fn quantile_index(n: usize, q: f64) -> usize {
    ((n - 1) as f64 * q).floor() as usize
}

/// A surface being refined over changing images.
pub struct Refiner {
    pub surface: Surface,
    queue: Queue,
    /// Scratch: the bits of a triangle's errors.
    errors: Vec<u64>,
    touched: Vec<u32>,
    scaffolding: usize,
}

impl Refiner {
    pub fn new(surface: Surface) -> Self {
        let scaffolding = surface.count_scaffolding();
        Refiner { surface, queue: Queue::new(None), errors: Vec::new(), touched: Vec::new(), scaffolding }
    }

    /// Number of vertices that carry a height.
    pub fn count(&self) -> usize {
        self.surface.z.len() - self.scaffolding
    }

    /// Makes the pixels (column, row) of `grid` vertices, unless they lie outside the data.
    pub fn insert<T: Height>(&mut self, pixels: &[(usize, usize)], grid: &Grid<T>) {
        let points: Vec<Point> = pixels.iter().map(|&(col, row)| Point::pixel(col, row)).collect();
        for i in insertion_order(&points) {
            let mesh = &self.surface.mesh;
            let place = mesh.locate(points[i], mesh.triangles().len() as u32 - 1);
            if mesh.is_in_data(place) {
                self.surface.insert_pixel(pixels[i], place, grid);
            }
        }
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
        let is_large = grid.rows() * grid.cols() > EXACT_PIXELS;
        self.queue = Queue::new(is_large.then_some(grid.cols() as u64));
        self.surface.mesh.take_touched(&mut self.touched);
        for t in 0..self.surface.mesh.triangles().len() as u32 {
            let work = self.enqueue(grid, rule, t);
            progress.poll(work, || 0.0)?;
        }
        let (start, mut first_priority) = (self.count(), None);
        // Vertices there is memory for, with their triangles and candidates.
        let mut room = 0;
        while self.count() < max_points {
            if self.surface.z.len() >= room {
                room = 2 * self.surface.z.len().max(1 << 15);
                memory::ensure(VERTEX_BYTES * room)?;
            }
            let mesh = &self.surface.mesh;
            let is_current = |c: &Candidate| mesh.triangle(c.triangle).version == c.version;
            let Some(best) = self.queue.pop(max_points - self.count(), is_current) else {
                return Ok(Stop::Tolerance);
            };
            let cols = grid.cols() as u64;
            let (col, row) = ((best.pixel % cols) as usize, (best.pixel / cols) as usize);
            let place = mesh.place_in(Point::pixel(col, row), best.triangle);
            self.surface.insert_pixel((col, row), place, grid);
            self.surface.mesh.take_touched(&mut self.touched);
            warm(grid, self.touched.iter().flat_map(|&t| self.surface.mesh.corners(t)));
            let mut work = 64;
            for i in 0..self.touched.len() {
                work += self.enqueue(grid, rule, self.touched[i]);
            }
            let first = *first_priority.get_or_insert(best.priority);
            let (count, tolerance) = (self.count(), rule.tolerance);
            progress.poll(work, || {
                let by_points = (count - start) as f64 / (max_points - start) as f64;
                let by_error = (first / best.priority).ln() / (first / tolerance).ln();
                by_points.max(if by_error.is_finite() { by_error } else { 0.0 })
            })?;
        }
        Ok(Stop::Points)
    }

    /// Scans triangle `t` and queues its candidate unless it is within the
    /// tolerance. Returns the work done in pixels.
    fn enqueue<T: Height>(&mut self, grid: &Grid<T>, rule: &Rule, t: u32) -> usize {
        let triangle = self.surface.mesh.triangle(t);
        if triangle.class() != Class::Data {
            return 0;
        }
        let version = triangle.version;
        let (p, z) = (self.surface.mesh.corners(t), self.surface.heights(t));
        let is_max = rule.priority == 1.0 && rule.candidate == 1.0 && rule.bound == 1.0;
        let worst = if is_max {
            worst(grid, p, z, Corners::Excluded)
        } else {
            collect(grid, p, z, Corners::Excluded, &mut self.errors)
        };
        let work = worst.count * if is_max { 1 } else { 4 };
        // The maximum bounds every quantile; what fits exactly needs no point.
        if worst.error <= rule.tolerance {
            return work;
        }
        let (mut priority, mut col, mut row) = (worst.error, worst.col, worst.row);
        if !is_max {
            if rule.tolerance > 0.0 && select(&mut self.errors, rule.bound) <= rule.tolerance {
                return work;
            }
            if rule.candidate < 1.0 {
                let at = select(&mut self.errors, rule.candidate);
                let mut found = false;
                for_each_pixel(grid, p, z, Corners::Excluded, |c, r, z, plane| {
                    if !found && (z - plane).abs() == at {
                        (col, row, found) = (c, r, true);
                    }
                });
            }
            priority = select(&mut self.errors, rule.priority);
        }
        if rule.candidate == 1.0 && rule.priority < 1.0 {
            priority += WORST_SHARE * worst.error;
        }
        priority *= match rule.weight {
            0.0 => 1.0,
            0.5 => (worst.count as f64).sqrt(),
            weight => (worst.count as f64).powf(weight),
        };
        let pixel = row as u64 * grid.cols() as u64 + col as u64;
        self.queue.push(Candidate { priority, pixel, triangle: t, version });
        work
    }
}

/// The quantile `q` of the errors whose bits these are; reorders them.
fn select(errors: &mut [u64], q: f64) -> f64 {
    let index = quantile_index(errors.len(), q);
    if index + 1 == errors.len() {
        return f64::from_bits(errors.iter().fold(0, |a, &b| a.max(b)));
    }
    f64::from_bits(*errors.select_nth_unstable(index).1)
}
