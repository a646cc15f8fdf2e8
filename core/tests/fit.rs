//! Least-squares heights and error-lowering flips.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod common;

use common::{assert_sound, contains, fingerprint, full, hills, plain, quietly, run, Random, MAX};
use dem2tin_core::blend::Blend;
use dem2tin_core::fit::Fit;
use dem2tin_core::flip::flip_pass;
use dem2tin_core::grid::Grid;
use dem2tin_core::mesh::{Mesh, NONE};
use dem2tin_core::order::runs;
use dem2tin_core::pipeline::Triangulation;
use dem2tin_core::predicate::{orient2d, Point};
use dem2tin_core::progress::Progress;
use dem2tin_core::scale::gaussian;
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

fn fit(surface: &mut Surface, grid: &Grid<f64>) {
    quietly(|progress| Fit::of(surface, grid, progress)?.solve(surface, progress)).unwrap();
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
        fit(&mut fitted, &grid);
        let mesh = &done.surface.mesh;
        let best = solved(mesh, &done.surface.z, &z, cols);
        // As far above the least as is negligible, and the heights no farther off than that allows.
        let (least, found) = (squares(mesh, &best, &z, cols), squares(mesh, &fitted.z, &z, cols));
        prop_assert!(found <= least * (1.0 + 1e-3) + 1e-9, "{} {}", found, least);
        let off: f64 = fitted.z.iter().zip(&best).filter(|(z, _)| !z.is_nan()).map(|(z, best)| (z - best).powi(2)).sum();
        prop_assert!(off <= 1e-3 * least + 1e-9, "{} {}", off, least);
    }

    #[test]
    fn flips_lower_the_squared_error_and_leave_a_valid_mesh(points in 4usize..60, voids: bool, seed: u64) {
        let (rows, cols) = (18, 15);
        let (z, mut done) = refined(rows, cols, points, voids, seed);
        let grid = Grid::new(&z, rows, cols).unwrap();
        let total = |surface: &Surface| squares(&surface.mesh, &surface.z, &z, cols);
        let mut fit = quietly(|progress| Fit::of(&done.surface, &grid, progress)).unwrap();
        let mut open = vec![true; done.surface.mesh.triangles().len()];
        let runs = runs(&done.surface.mesh);
        for _ in 0..3 {
            let before = total(&done.surface);
            let flips = quietly(|progress| flip_pass(&mut done.surface, &grid, &runs, Some(&fit), &mut open, progress)).unwrap();
            let after = total(&done.surface);
            prop_assert!(if flips == 0 { after == before } else { after < before }, "{} {} {}", flips, before, after);
            prop_assert_eq!(flips == 0, !open.contains(&true));
            quietly(|progress| fit.renew(&done.surface, &grid, &open, progress)).unwrap();
        }
        assert_sound(&done.surface.mesh, false);
        // What was kept up with the mesh fits as what is seen anew does.
        let (mut kept, mut anew) = (done.surface.clone(), done.surface.clone());
        quietly(|progress| fit.solve(&mut kept, progress)).unwrap();
        quietly(|progress| Fit::of(&done.surface, &grid, progress)?.solve(&mut anew, progress)).unwrap();
        let is_near = |kept: &Surface| kept.z.iter().zip(&anew.z).all(|(a, b)| a.is_nan() || (a - b).abs() < 1e-3);
        prop_assert!(is_near(&kept), "{:?} {:?}", kept.z, anew.z);
        quietly(|progress| fit.follow(&kept, progress)).unwrap();
        quietly(|progress| fit.solve(&mut kept, progress)).unwrap();
        prop_assert!(is_near(&kept), "{:?} {:?}", kept.z, anew.z);
    }

    #[test]
    fn without_a_fit_all_flips_that_gain_are_found(points in 4usize..60, seed: u64) {
        let (rows, cols) = (18, 15);
        let (z, done) = refined(rows, cols, points, false, seed);
        let grid = Grid::new(&z, rows, cols).unwrap();
        let runs = runs(&done.surface.mesh);
        let mut flipped = done.surface.clone();
        let mut open = vec![true; flipped.mesh.triangles().len()];
        while quietly(|progress| flip_pass(&mut flipped, &grid, &runs, None, &mut open, progress)).unwrap() > 0 {}
        let best = squares(&flipped.mesh, &flipped.z, &z, cols);
        for h in flipped.mesh.half_edges() {
            let twin = flipped.mesh.twin(h);
            if h < twin && twin != NONE && !flipped.mesh.is_constrained(h) && flipped.mesh.is_convex(h) {
                let mut other = flipped.mesh.clone();
                other.flip(h);
                let squares = squares(&other, &flipped.z, &z, cols);
                prop_assert!(squares >= best * (1.0 - 1e-4) - 1e-3, "{} {}", squares, best);
            }
        }
    }
}

fn bits(surface: &Surface) -> Vec<u64> {
    surface.z.iter().map(|z| z.to_bits()).collect()
}

/// All that the stages after refinement leave behind, with so many threads.
fn after_refinement(threads: usize) -> (f64, Vec<usize>, Vec<[u32; 3]>, Vec<u64>) {
    let (rows, cols) = (200, 230);
    let (z, done) = refined(rows, cols, 9000, true, 3);
    let data = Grid::new(&z, rows, cols).unwrap();
    let mut surface = done.surface;
    let mut quiet = |_: &'static str, _: f64| true;
    let progress = &mut Progress::new(&mut quiet).with_threads(threads);
    let sigma = [0.8; 2];
    let smooth = gaussian(&data, sigma, progress).unwrap();
    let share = Blend { data, smooth: &smooth, sigma, noise: 0.1 }.share(&surface, progress).unwrap();
    let mut fit = Fit::of(&surface, &data, progress).unwrap();
    fit.solve(&mut surface, progress).unwrap();
    let (runs, mut open) = (runs(&surface.mesh), vec![true; surface.mesh.triangles().len()]);
    let flips = (0..3).map(|_| {
        fit.follow(&surface, progress).unwrap();
        let flips = flip_pass(&mut surface, &data, &runs, Some(&fit), &mut open, progress).unwrap();
        fit.renew(&surface, &data, &open, progress).unwrap();
        fit.solve(&mut surface, progress).unwrap();
        flips
    });
    let flips = flips.collect();
    let corners = surface.mesh.triangles().iter().map(|t| t.v).collect();
    (share, flips, corners, bits(&surface))
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let one = after_refinement(1);
    assert!(one.0 > 0.0 && one.1[0] > 100, "{} {:?}", one.0, one.1);
    for threads in [2, 3, 8] {
        assert!(after_refinement(threads) == one, "{threads} threads");
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
    fit(&mut done.surface, &grid);
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
        fit(&mut done.surface, &grid);
    }
    let before = done.surface.z.clone();
    fit(&mut done.surface, &grid);
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
