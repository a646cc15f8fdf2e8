//! Least-squares heights and error-lowering flips.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod common;

use common::{assert_sound, contains, fingerprint, full, hills, plain, quietly, run, Random, MAX};
use dem2tin_core::fit::{fit_heights, flip_pass};
use dem2tin_core::grid::Grid;
use dem2tin_core::mesh::Mesh;
use dem2tin_core::pipeline::Triangulation;
use dem2tin_core::predicate::{orient2d, Point};
use dem2tin_core::surface::Surface;
use proptest::prelude::*;

/// Corners and hat-function values of the first data triangle that holds each valid pixel.
fn hats(mesh: &Mesh, z: &[f64], cols: usize) -> Vec<(usize, [usize; 3], [f64; 3])> {
    let mut rows = Vec::new();
    for (i, _) in z.iter().enumerate().filter(|(_, z)| !z.is_nan()) {
        let q = Point::pixel(i % cols, i / cols);
        let data = |t: &u32| !mesh.triangle(*t).is_void() && contains(mesh.corners(*t), q);
        if let Some(t) = (0..mesh.triangles().len() as u32).find(data) {
            let [a, b, c] = mesh.corners(t);
            let area = orient2d(a, b, c) as f64;
            let weights = [orient2d(b, c, q), orient2d(c, a, q), orient2d(a, b, q)];
            rows.push((i, mesh.triangle(t).v.map(|v| v as usize), weights.map(|w| w as f64 / area)));
        }
    }
    rows
}

fn surface(v: &[usize; 3], weights: &[f64; 3], heights: &[f64]) -> f64 {
    (0..3).map(|k| weights[k] * heights[v[k]]).sum()
}

fn squares(mesh: &Mesh, heights: &[f64], z: &[f64], cols: usize) -> f64 {
    hats(mesh, z, cols).iter().map(|(i, v, w)| (surface(v, w, heights) - z[*i]).powi(2)).sum()
}

/// Half the gradient of the sum of squared errors.
fn gradient(mesh: &Mesh, heights: &[f64], z: &[f64], cols: usize) -> Vec<f64> {
    let mut gradient = vec![0.0; heights.len()];
    for (i, v, w) in hats(mesh, z, cols) {
        let error = surface(&v, &w, heights) - z[i];
        (0..3).for_each(|k| gradient[v[k]] += w[k] * error);
    }
    gradient
}

fn norm(x: &[f64]) -> f64 {
    x.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// The least squares by Gaussian elimination; vertices without pixels keep their height.
fn solved(mesh: &Mesh, heights: &[f64], z: &[f64], cols: usize) -> Vec<f64> {
    let n = heights.len();
    let mut a = vec![vec![0.0; n + 1]; n];
    for (i, v, w) in hats(mesh, z, cols) {
        for j in 0..3 {
            (0..3).for_each(|k| a[v[j]][v[k]] += w[j] * w[k]);
            a[v[j]][n] += w[j] * z[i];
        }
    }
    for i in 0..n {
        if a[i][i] == 0.0 {
            (a[i][i], a[i][n]) = (1.0, heights[i]);
        }
    }
    for i in 0..n {
        let pivot = a[i].clone();
        for row in a[i + 1..].iter_mut().filter(|row| row[i] != 0.0) {
            let factor = row[i] / pivot[i];
            row.iter_mut().zip(&pivot).for_each(|(x, p)| *x -= factor * p);
        }
    }
    let mut x = vec![0.0; n];
    for i in (0..n).rev() {
        let known: f64 = (i + 1..n).filter(|&j| a[i][j] != 0.0).map(|j| a[i][j] * x[j]).sum();
        x[i] = (a[i][n] - known) / a[i][i];
    }
    x
}

/// Hills with voids where `voids`, refined to `points`.
fn refined(rows: usize, cols: usize, points: usize, voids: bool, seed: u64) -> (Vec<f64>, Triangulation) {
    let mut z = hills(rows, cols, seed);
    let mut random = Random(!seed);
    if voids {
        (0..rows * cols / 6).for_each(|_| z[random.below(rows * cols)] = f64::NAN);
    }
    let done = run(&z, rows, cols, &plain(MAX, points)).unwrap();
    (z, done)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn fitted_heights_solve_the_normal_equations(points in 4usize..60, voids: bool, seed: u64) {
        let (rows, cols) = (18, 15);
        let (z, done) = refined(rows, cols, points, voids, seed);
        let mut fitted = done.surface.clone();
        let grid = Grid::new(&z, rows, cols).unwrap();
        quietly(|progress| fit_heights(&mut fitted, &grid, progress)).unwrap();
        let heights = fitted.z;
        let (before, after) = (gradient(&done.surface.mesh, &done.surface.z, &z, cols), gradient(&done.surface.mesh, &heights, &z, cols));
        prop_assert!(norm(&after) <= 1e-3 * norm(&before) + 1e-9, "{} {}", norm(&after), norm(&before));
        for (got, want) in heights.iter().zip(solved(&done.surface.mesh, &done.surface.z, &z, cols)) {
            prop_assert!((got.is_nan() && want.is_nan()) || (got - want).abs() < 1e-2, "{} {}", got, want);
        }
        let least = squares(&done.surface.mesh, &heights, &z, cols);
        prop_assert!(least <= squares(&done.surface.mesh, &done.surface.z, &z, cols) * (1.0 + 1e-12));
    }

    #[test]
    fn flips_lower_the_squared_error_and_leave_a_valid_mesh(points in 4usize..60, voids: bool, seed: u64) {
        let (rows, cols) = (18, 15);
        let (z, mut done) = refined(rows, cols, points, voids, seed);
        let grid = Grid::new(&z, rows, cols).unwrap();
        // Each triangle with its border, as the flips count.
        let closed = |surface: &Surface| -> f64 {
            let mesh = &surface.mesh;
            let error = |t: u32| -> f64 {
                let (p, v) = (mesh.corners(t), surface.heights(t));
                let of = |i: usize| (common::interpolate(p, v, Point::pixel(i % cols, i / cols)) - z[i]).powi(2);
                let inside = |i: &usize| !z[*i].is_nan() && contains(p, Point::pixel(i % cols, i / cols));
                (0..z.len()).filter(inside).map(of).sum()
            };
            (0..mesh.triangles().len() as u32).filter(|&t| !mesh.triangle(t).is_void()).map(error).sum()
        };
        let before = closed(&done.surface);
        let flips = quietly(|progress| flip_pass(&mut done.surface, &grid, progress)).unwrap();
        let after = closed(&done.surface);
        prop_assert!(if flips == 0 { after == before } else { after < before }, "{} {} {}", flips, before, after);
        assert_sound(&done.surface.mesh, false);
    }
}

#[test]
fn a_plane_is_fitted_exactly_from_any_start() {
    let (rows, cols) = (20, 30);
    let z: Vec<f64> = (0..rows * cols).map(|i| 2.0 * (i % cols) as f64 - (i / cols) as f64).collect();
    let (_, mut done) = refined(rows, cols, 40, false, 4);
    let mut random = Random(1);
    done.surface.z.iter_mut().for_each(|z| *z += 10.0 * random.normal());
    let grid = Grid::new(&z, rows, cols).unwrap();
    quietly(|progress| fit_heights(&mut done.surface, &grid, progress)).unwrap();
    for (z, p) in done.surface.z.iter().zip(done.surface.mesh.points()) {
        let (col, row) = p.as_pixel().unwrap();
        assert!((z - (2.0 * col as f64 - row as f64)).abs() < 0.02);
    }
}

#[test]
fn fitting_a_fitted_surface_hardly_moves_it() {
    let (z, mut done) = refined(30, 30, 80, true, 9);
    let grid = Grid::new(&z, 30, 30).unwrap();
    for _ in 0..3 {
        quietly(|progress| fit_heights(&mut done.surface, &grid, progress)).unwrap();
    }
    let before = done.surface.z.clone();
    quietly(|progress| fit_heights(&mut done.surface, &grid, progress)).unwrap();
    for (after, before) in done.surface.z.iter().zip(before) {
        assert!(after.is_nan() || (after - before).abs() < 1e-6);
    }
}

#[test]
fn all_stages_lower_the_error_of_the_bare_greedy() {
    let (rows, cols) = (60, 70);
    for seed in 0..5 {
        let z = hills(rows, cols, seed);
        let bare = run(&z, rows, cols, &plain(MAX, 150)).unwrap();
        let mut options = full(MAX, 150);
        options.despike = false;
        let best = run(&z, rows, cols, &options).unwrap();
        let squares = |done: &Triangulation| squares(&done.surface.mesh, &done.surface.z, &z, cols);
        assert!(squares(&best) < 0.8 * squares(&bare));
        assert_ne!(fingerprint(&best), fingerprint(&bare));
    }
}
