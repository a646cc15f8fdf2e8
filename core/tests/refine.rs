//! The greedy is Algorithm 1, to the letter and within its bounds.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod common;

use common::{
    assert_sound, contains, fingerprint, hills, interpolate, outlined, plain, quietly, residuals, run,
    sorted, triangle_set, Random, AUTO, MAX, PAPER,
};
use dem2tin_core::grid::Grid;
use dem2tin_core::image::Image;
use dem2tin_core::lanes::Vectors;
use dem2tin_core::pipeline::{Options, Scales};
use dem2tin_core::predicate::{orient2d, Metric, Point};
use dem2tin_core::refine::Refiner;
use dem2tin_core::rule::Stop;
use dem2tin_core::rule::{quantile_index, Rule};
use proptest::prelude::*;
use std::collections::BTreeSet;

/// A form under which few lattice points are concyclic: the Delaunay triangulation
/// of a handful of pixels is unique.
const SKEW: Metric = Metric { e: 1009, f: 307, g: 1511 };

/// Whether `d` is strictly inside the circle through a, b, c: the distance to the
/// circumcentre, which is the solution of two linear equations, in fractions.
fn in_circle(m: Metric, [a, b, c]: [Point; 3], d: Point) -> bool {
    let pixels = |p: Point| (i128::from(p.x >> 8), i128::from(p.y >> 8));
    let (e, f, g) = (i128::from(m.e), i128::from(m.f), i128::from(m.g));
    let from_a = |p: Point| (pixels(p).0 - pixels(a).0, pixels(p).1 - pixels(a).1);
    let norm = |(x, y): (i128, i128)| e * x * x + 2 * f * x * y + g * y * y;
    let (b, c, d) = (from_a(b), from_a(c), from_a(d));
    // The centre u satisfies 2 <p, u> = |p|^2 for b and c; w = 2 (e u_x + f u_y, f u_x + g u_y).
    let det = b.0 * c.1 - b.1 * c.0;
    let w = (norm(b) * c.1 - norm(c) * b.1, norm(c) * b.0 - norm(b) * c.0);
    (norm(d) * det - (w.0 * d.0 + w.1 * d.1)) * det.signum() < 0
}

/// All triangles of `points` whose circle is empty.
fn delaunay(points: &[Point], metric: Metric) -> Vec<[Point; 3]> {
    let mut found = Vec::new();
    let n = points.len();
    for (i, j, k) in (0..n).flat_map(|i| (i + 1..n).flat_map(move |j| (j + 1..n).map(move |k| (i, j, k)))) {
        let mut corners = [points[i], points[j], points[k]];
        let side = orient2d(corners[0], corners[1], corners[2]);
        if side < 0 {
            corners.swap(1, 2);
        }
        if side != 0 && points.iter().all(|&d| !in_circle(metric, corners, d)) {
            found.push(corners);
        }
    }
    found
}

/// What single precision does not tell apart.
const ROUNDING: f64 = 1e-5;

/// Priority and candidate of every triangle of `points` that the rule does not leave
/// alone: the step of Algorithm 1 as it stands in the paper. Where errors are the same but for rounding
/// there are several candidates.
fn choices(z: &[f64], cols: usize, points: &[Point], rule: &Rule) -> Vec<(f64, Point)> {
    let height = |p: Point| p.as_pixel().map(|(col, row)| z[row * cols + col]).unwrap();
    let mut found = Vec::new();
    for corners in delaunay(points, SKEW) {
        let mut errors: Vec<(f64, Point)> = (0..z.len())
            .map(|i| Point::pixel(i % cols, i / cols))
            .filter(|q| contains(corners, *q) && !corners.contains(q))
            .map(|q| ((height(q) - interpolate(corners, corners.map(height), q)).abs(), q))
            .collect();
        errors.sort_by(|a, b| a.0.total_cmp(&b.0));
        let at = |q: f64| errors[((errors.len() - 1) as f64 * q) as usize];
        if !errors.is_empty() && at(rule.bound).0 > rule.tolerance {
            let is_worst = rule.candidate == 1.0 && rule.priority < 1.0;
            let ranked = if is_worst {
                // The largest error of every eighth column, and the largest of all.
                let of_column = |q: Point| (q.x >> 8) % 8;
                let largest = |k: i32| errors.iter().rev().find(|e| of_column(e.1) == k).map(|e| e.0);
                let mut groups: Vec<f64> = (0..8).filter_map(largest).collect();
                groups.sort_by(f64::total_cmp);
                groups[((groups.len() - 1) as f64 * rule.priority) as usize] + at(1.0).0
            } else {
                at(rule.priority).0
            };
            let priority = ranked * (errors.len() as f64).powf(rule.weight);
            let alike = errors.iter().filter(|e| (e.0 - at(rule.candidate).0).abs() <= ROUNDING);
            found.extend(alike.map(|e| (priority, e.1)));
        }
    }
    found
}

/// The core's vertices and triangles under the same metric.
fn refined(z: &[f64], rows: usize, cols: usize, rule: &Rule, n: usize) -> (Refiner, Stop) {
    let grid = Grid::new(z, rows, cols).unwrap();
    let mut refiner = Refiner::new(outlined(&grid, SKEW).unwrap());
    let stop = quietly(|progress| refiner.run(&Image::Held(grid), rule, n, progress)).unwrap();
    (refiner, stop)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(250))]

    #[test]
    fn the_choices_are_those_of_a_brute_force_algorithm_1(
        rows in 3usize..13, cols in 3usize..13, priority in 0.01f64..1.0, candidate in 0.01f64..1.0, weight in 0.0f64..1.0, seed: u64,
    ) {
        let mut random = Random(seed);
        let z: Vec<f64> = (0..rows * cols).map(|_| random.normal()).collect();
        let free = Rule { priority, weight, candidate, tolerance: 0.0, bound: 1.0 };
        let tight = Rule { tolerance: 0.4, ..PAPER };
        for rule in [PAPER, MAX, tight, AUTO, free] {
            let (refiner, stop) = refined(&z, rows, cols, &rule, 14);
            let points = refiner.surface.mesh.points();
            for n in 4..points.len() {
                let choices = choices(&z, cols, &points[..n], &rule);
                let best = choices.iter().fold(0.0f64, |best, c| best.max(c.0));
                // A pixel on an edge can give both triangles the same priority.
                prop_assert!(choices.iter().any(|c| c.1 == points[n] && c.0 >= best * (1.0 - ROUNDING)), "{:?}", rule);
            }
            prop_assert!(stop == Stop::Points || choices(&z, cols, points, &rule).is_empty());
            let triangles: BTreeSet<_> = delaunay(points, SKEW).into_iter().map(sorted).collect();
            prop_assert_eq!(triangle_set(&refiner.surface.mesh), triangles);
        }
    }

    #[test]
    fn a_bound_of_all_pixels_holds_at_every_pixel(
        rows in 2usize..24, cols in 2usize..24, tolerance in 0.5f64..20.0, voids: bool, seed: u64,
    ) {
        let mut z = hills(rows, cols, seed);
        let mut random = Random(seed);
        if voids { (0..rows * cols / 5).for_each(|_| z[random.below(rows * cols)] = f64::NAN); }
        for rule in [MAX, Rule { bound: 1.0, ..PAPER }, AUTO] {
            let rule = Rule { tolerance, ..rule };
            let Ok(done) = run(&z, rows, cols, &plain(rule, usize::MAX)) else { continue };
            prop_assert_eq!(done.report.stop, Stop::Tolerance);
            for error in residuals(&done, &z, cols) {
                prop_assert!(error.is_nan() || error <= tolerance * (1.0 + 1e-9), "{} {}", error, tolerance);
            }
        }
    }

    #[test]
    fn a_bound_of_the_median_holds_in_every_triangle(rows in 2usize..24, cols in 2usize..24, tolerance in 0.5f64..20.0, seed: u64) {
        let z = hills(rows, cols, seed);
        let done = run(&z, rows, cols, &plain(Rule { tolerance, ..PAPER }, usize::MAX)).unwrap();
        for (t, triangle) in done.surface.mesh.triangles().iter().enumerate() {
            let p = done.surface.mesh.corners(t as u32);
            let heights = triangle.v.map(|v| done.surface.z[v as usize]);
            let mut errors: Vec<f64> = (0..z.len())
                .map(|i| (Point::pixel(i % cols, i / cols), z[i]))
                .filter(|(q, _)| contains(p, *q) && !p.contains(q))
                .map(|(q, z)| (z - interpolate(p, heights, q)).abs())
                .collect();
            errors.sort_by(f64::total_cmp);
            if !errors.is_empty() {
                prop_assert!(errors[(errors.len() - 1) / 2] <= tolerance * (1.0 + 1e-9));
            }
        }
    }

    #[test]
    fn the_number_of_points_is_honoured(rows in 2usize..20, cols in 2usize..20, n in 4usize..100, seed: u64) {
        let mut random = Random(seed);
        let z: Vec<f64> = (0..rows * cols).map(|_| random.normal()).collect();
        for rule in [PAPER, MAX, AUTO] {
            let done = run(&z, rows, cols, &plain(rule, n)).unwrap();
            prop_assert_eq!(done.surface.mesh.points().len(), n.min(rows * cols));
            prop_assert_eq!(done.report.stop, if n <= rows * cols { Stop::Points } else { Stop::Exact });
            assert_sound(&done.surface.mesh, true);
        }
    }

    #[test]
    fn vertices_keep_the_heights_of_their_pixels(rows in 2usize..20, cols in 2usize..20, n in 4usize..100, seed: u64) {
        let z = hills(rows, cols, seed);
        let done = run(&z, rows, cols, &plain(PAPER, n)).unwrap();
        for (p, height) in done.surface.mesh.points().iter().zip(&done.surface.z) {
            let (col, row) = p.as_pixel().unwrap();
            prop_assert_eq!(*height, z[row * cols + col]);
        }
    }
}

#[test]
fn the_lower_median_is_taken() {
    assert_eq!([1, 2, 3, 4, 5].map(|n| quantile_index(n, 0.5)), [0, 0, 1, 1, 2]);
    assert_eq!([1, 2, 3, 10].map(|n| quantile_index(n, 1.0)), [0, 1, 2, 9]);
    assert_eq!([1, 2, 100].map(|n| quantile_index(n, 1e-9)), [0, 0, 0]);
}

#[test]
fn each_scale_adds_at_most_its_points() {
    let (rows, cols) = (40, 40);
    let z = hills(rows, cols, 3);
    let mut options = plain(PAPER, usize::MAX);
    options.scales = Scales::Given(vec![[2.0; 2], [1.0; 2], [0.0; 2]]);
    options.points_per_scale = Some(50);
    let done = run(&z, rows, cols, &options).unwrap();
    assert_eq!(done.surface.mesh.points().len(), 4 + 3 * 50);
    options.max_points = 100;
    assert_eq!(run(&z, rows, cols, &options).unwrap().surface.mesh.points().len(), 100);
    assert_sound(&done.surface.mesh, true);
}

fn place_set(points: &[Point]) -> BTreeSet<Point> {
    points.iter().copied().collect()
}

#[test]
fn initial_points_are_vertices_once() {
    let (rows, cols) = (20, 20);
    let z = hills(rows, cols, 5);
    let mut options = plain(PAPER, 7);
    options.constraints.pixels = vec![(3, 4), (0, 0), (3, 4), (19, 7), (10, 10), (19, 19)];
    let done = run(&z, rows, cols, &options).unwrap();
    let expected = [(0, 0), (19, 0), (19, 19), (0, 19), (3, 4), (19, 7), (10, 10)];
    assert_eq!(done.surface.mesh.points().len(), 7);
    assert_eq!(
        place_set(done.surface.mesh.points()),
        expected.map(|(col, row)| Point::pixel(col, row)).into()
    );
    options.max_points = 60;
    let done = run(&z, rows, cols, &options).unwrap();
    assert_eq!(done.surface.mesh.points().len(), 60);
    assert_sound(&done.surface.mesh, true);
}

#[test]
fn points_beyond_what_the_outline_needs_are_not_added() {
    let mut z = hills(30, 30, 1);
    z.iter_mut().step_by(11).for_each(|z| *z = f64::NAN);
    let bare = run(&z, 30, 30, &plain(MAX, 0)).unwrap();
    let grid = Grid::new(&z, 30, 30).unwrap();
    let outline = outlined(&grid, Metric::SQUARE).unwrap();
    assert_eq!(place_set(bare.surface.mesh.points()), place_set(outline.mesh.points()));
    assert_eq!(bare.report.stop, Stop::Outline);
    assert_eq!(fingerprint(&bare), fingerprint(&run(&z, 30, 30, &plain(MAX, 4)).unwrap()));
}

#[test]
fn scales_share_the_points_evenly_unless_told_otherwise() {
    let z = hills(30, 30, 6);
    let scales = Scales::Given(vec![[2.0; 2], [1.0; 2], [0.5; 2], [0.0; 2]]);
    let even = Options { scales, ..plain(PAPER, 80) };
    let told = Options { points_per_scale: Some(20), ..even.clone() };
    let greedy = Options { points_per_scale: Some(80), ..even.clone() };
    let result = |options: &Options| fingerprint(&run(&z, 30, 30, options).unwrap());
    assert_eq!(result(&even), result(&told));
    assert_ne!(result(&even), result(&greedy));
}

#[test]
fn all_vectors_give_the_same_mesh() {
    let (rows, cols) = (90, 110);
    let z: Vec<f32> = hills(rows, cols, 8).into_iter().map(|z| z as f32).collect();
    let grid = Grid::new(&z, rows, cols).unwrap();
    for rule in [MAX, PAPER, AUTO] {
        let mesh = |vectors| {
            let mut refiner = Refiner::with_vectors(outlined(&grid, Metric::SQUARE).unwrap(), vectors);
            quietly(|progress| refiner.run(&Image::Held(grid), &rule, 900, progress)).unwrap();
            (refiner.surface.mesh.points().to_vec(), triangle_set(&refiner.surface.mesh))
        };
        let plain = mesh(Vectors::Plain);
        assert!(Vectors::all().all(|vectors| mesh(vectors) == plain));
    }
}
