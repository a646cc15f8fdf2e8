//! Helpers of the integration tests. Each test crate uses its own part of them.
#![allow(dead_code)]

pub mod strategies;

use dem2tin_core::check::check;
use dem2tin_core::domain::{domain, Constraints};
use dem2tin_core::error::Result;
use dem2tin_core::grid::{Grid, Height};
use dem2tin_core::mesh::Mesh;
use dem2tin_core::outline::Shape;
use dem2tin_core::pipeline::{triangulate, Options, Scales, Triangulation};
use dem2tin_core::predicate::{orient2d, Metric, Point};
use dem2tin_core::progress::Progress;
use dem2tin_core::rule::Rule;
use dem2tin_core::surface::Surface;
use dem2tin_core::tiling::Tiling;
use std::collections::BTreeSet;

pub const PAPER: Rule = Rule { priority: 0.5, weight: 0.0, candidate: 0.5, tolerance: 0.0, bound: 0.5 };
pub const MAX: Rule = Rule { priority: 1.0, weight: 0.0, candidate: 1.0, tolerance: 0.0, bound: 1.0 };
pub const AUTO: Rule = Rule { priority: 0.5, weight: 0.25, candidate: 1.0, tolerance: 0.0, bound: 1.0 };

/// The metric (x, y) -> (a x + b y, c y), whose ground coordinates are integers.
pub fn form(a: i64, b: i64, c: i64) -> Metric {
    Metric { e: a * a, f: a * b, g: b * b + c * c }
}

/// Square, anisotropic and sheared metrics as (a, b, c) of [`form`].
pub const FORMS: [(i64, i64, i64); 5] = [(1, 0, 1), (3, 0, 1), (1, 0, 40), (5, 2, 4), (7, -9, 3)];

/// Splitmix64: the same numbers everywhere.
pub struct Random(pub u64);

impl Random {
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    pub fn below(&mut self, n: usize) -> usize {
        (self.bits() % n as u64) as usize
    }

    /// In [0, 1).
    pub fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Standard normal (Box and Muller).
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.unit()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.unit()).cos()
    }
}

pub fn quietly<R>(work: impl FnOnce(&mut Progress) -> R) -> R {
    work(&mut Progress::new(&mut |_, _| true))
}

/// The rule and nothing else: no smoothing, despiking, fit or flips.
pub fn plain(rule: Rule, max_points: usize) -> Options {
    Options {
        max_points,
        is_share: false,
        points_per_scale: None,
        rule,
        has_tolerance: rule.tolerance > 0.0,
        stop_at_noise: false,
        scales: Scales::Given(vec![[0.0; 2]]),
        despike: false,
        fit: false,
        flips: 0,
        shape: Shape::default(),
        constraints: Constraints::default(),
        tile: 0,
    }
}

/// All stages.
pub fn full(rule: Rule, max_points: usize) -> Options {
    Options { scales: Scales::Auto, despike: true, fit: true, flips: 2, ..plain(rule, max_points) }
}

pub fn run<T: Height>(z: &[T], rows: usize, cols: usize, options: &Options) -> Result<Triangulation> {
    let grid = Grid::new(z, rows, cols)?;
    quietly(|progress| triangulate(&grid, Metric::SQUARE, options, progress))
}

pub fn one_tile<T: Height>(grid: &Grid<T>) -> Tiling {
    Tiling::new(grid.rows(), grid.cols(), 0)
}

/// The surface before refinement, without constraints.
pub fn outlined<T: Height>(grid: &Grid<T>, metric: Metric) -> Result<Surface> {
    quietly(|progress| {
        domain(grid, metric, &Shape::default(), &Constraints::default(), &one_tile(grid), progress)
    })
}

/// Smooth hills with a little noise.
pub fn hills(rows: usize, cols: usize, seed: u64) -> Vec<f64> {
    let mut random = Random(seed);
    let (a, b) = (0.15 + 0.2 * random.unit(), 0.15 + 0.2 * random.unit());
    let height = |i: usize, noise: f64| {
        let (x, y) = ((i % cols) as f64, (i / cols) as f64);
        40.0 * (a * x).sin() * (b * y).cos() + 0.5 * x + noise
    };
    (0..rows * cols).map(|i| height(i, 2.0 * random.unit())).collect()
}

pub fn assert_sound(mesh: &Mesh, delaunay: bool) {
    if let Err(fault) = check(mesh, delaunay) {
        panic!("{fault}\n{:?}\n{:?}", mesh.points(), mesh.triangles());
    }
}

/// Corners in ascending order: one value for one triangle.
pub fn sorted(mut corners: [Point; 3]) -> [Point; 3] {
    corners.sort_unstable();
    corners
}

pub fn triangle_set(mesh: &Mesh) -> BTreeSet<[Point; 3]> {
    (0..mesh.triangles().len() as u32).map(|t| sorted(mesh.corners(t))).collect()
}

/// Everything that a result consists of, comparable.
pub fn fingerprint(done: &Triangulation) -> (Vec<Point>, Vec<[u32; 3]>, Vec<u64>) {
    let corners = done.surface.mesh.triangles().iter().map(|t| t.v).collect();
    (done.surface.mesh.points().to_vec(), corners, done.surface.z.iter().map(|z| z.to_bits()).collect())
}

pub fn contains([a, b, c]: [Point; 3], q: Point) -> bool {
    orient2d(a, b, q) >= 0 && orient2d(b, c, q) >= 0 && orient2d(c, a, q) >= 0
}

/// Height at `q` of the plane through three points, by barycentric coordinates.
pub fn interpolate([a, b, c]: [Point; 3], z: [f64; 3], q: Point) -> f64 {
    let weights = [orient2d(b, c, q), orient2d(c, a, q), orient2d(a, b, q)].map(|w| w as f64);
    let sum: f64 = weights.iter().sum();
    (weights[0] * z[0] + weights[1] * z[1] + weights[2] * z[2]) / sum
}

/// |mesh - data| in every valid pixel that a data triangle covers (NaN elsewhere),
/// by testing every pixel against every triangle.
pub fn residuals(done: &Triangulation, z: &[f64], cols: usize) -> Vec<f64> {
    let mut largest = vec![f64::NAN; z.len()];
    for (t, triangle) in done.surface.mesh.triangles().iter().enumerate().filter(|(_, t)| !t.is_void()) {
        let p = done.surface.mesh.corners(t as u32);
        let heights = triangle.v.map(|v| done.surface.z[v as usize]);
        for (i, &z) in z.iter().enumerate() {
            let q = Point::pixel(i % cols, i / cols);
            if contains(p, q) {
                largest[i] = largest[i].max((interpolate(p, heights, q) - z).abs());
            }
        }
    }
    largest
}
