//! Surfaces and errors on rasters of several bands.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod common;

use common::{contains, full, hills, interpolate, quietly, Random, AUTO};
use dem2tin_core::grid::Grid;
use dem2tin_core::measure::{count_covered, errors, rasterise, Errors};
use dem2tin_core::pipeline::{triangulate, Triangulation};
use dem2tin_core::predicate::{Metric, Point};
use dem2tin_core::progress::Progress;
use proptest::prelude::*;

/// Hills with lakes.
fn lakes(rows: usize, cols: usize, seed: u64) -> Vec<f32> {
    let mut z: Vec<f32> = hills(rows, cols, seed).iter().map(|&z| z as f32).collect();
    let mut random = Random(seed);
    for _ in 0..4 {
        let (row, col) = (random.below(rows), random.below(cols));
        for (r, c) in
            (row..(row + 9).min(rows)).flat_map(|r| (col..(col + 15).min(cols)).map(move |c| (r, c)))
        {
            z[r * cols + c] = f32::NAN;
        }
    }
    z
}

fn with_threads<R>(threads: usize, work: impl FnOnce(&mut Progress) -> R) -> R {
    work(&mut Progress::new(&mut |_, _| true).with_threads(threads))
}

fn made(grid: &Grid<f32>, points: usize, threads: usize) -> Triangulation {
    with_threads(threads, |p| triangulate(grid, Metric::SQUARE, &full(AUTO, points), p)).unwrap()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(30))]

    #[test]
    fn every_pixel_and_triangle_is_what_a_plain_search_finds(
        rows in 30usize..110, cols in 5usize..60, points in 4usize..120, seed: u64,
    ) {
        let z = lakes(rows, cols, seed);
        let grid = Grid::new(&z, rows, cols).unwrap();
        let Ok(done) = quietly(|p| triangulate(&grid, Metric::SQUARE, &full(AUTO, points), p)) else { return Ok(()) };
        let (mesh, heights) = (&done.surface.mesh, &done.surface.z);
        let mut surface = vec![f64::NAN; rows * cols];
        let mut worst = vec![0.0f64; mesh.triangles().len()];
        for t in (0..worst.len() as u32).filter(|&t| !mesh.triangle(t).is_void()) {
            let (p, z) = (mesh.corners(t), mesh.triangle(t).v.map(|v| heights[v as usize]));
            for (row, col) in (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col))) {
                let q = Point::pixel(col, row);
                if contains(p, q) {
                    let height = interpolate(p, z, q);
                    let pixel = &mut surface[row * cols + col];
                    *pixel = if pixel.is_nan() { height } else { *pixel };
                    worst[t as usize] = worst[t as usize].max((height - grid.at(col, row)).abs());
                }
            }
        }
        let found: Vec<f64> = quietly(|p| rasterise(mesh, heights, rows, cols, p)).unwrap();
        for (found, want) in found.iter().zip(&surface) {
            prop_assert!(found.is_nan() == want.is_nan());
            prop_assert!(found.is_nan() || (found - want).abs() < 1e-9);
        }
        let (told, largest) = quietly(|p| errors(mesh, heights, &grid, p)).unwrap();
        for (found, want) in largest.iter().zip(&worst) {
            prop_assert!((found - want).abs() < 1e-9);
        }
        let differences: Vec<f64> =
            surface.iter().zip(&z).map(|(a, &b)| a - f64::from(b)).filter(|d| !d.is_nan()).collect();
        let mean = |f: fn(&f64) -> f64| differences.iter().map(f).sum::<f64>() / differences.len() as f64;
        let mut sorted: Vec<f64> = differences.iter().map(|d| d.abs()).collect();
        sorted.sort_by(f64::total_cmp);
        let p95 = sorted[(sorted.len() as f64 * 0.95).ceil() as usize - 1];
        let covered = surface.iter().filter(|z| !z.is_nan()).count();
        for (found, want) in [
            (told.rmse, mean(|d| d * d).sqrt()), (told.mae, mean(|d| d.abs())), (told.mean, mean(|d| *d)),
            (told.max, sorted[sorted.len() - 1]), (told.p95, p95),
        ] {
            prop_assert!((found - want).abs() < 1e-5, "{} {}", found, want);
        }
        prop_assert_eq!(told.covered, differences.len());
        prop_assert_eq!(told.uncovered, grid.count_valid() - differences.len());
        prop_assert_eq!(told.void_covered, covered - differences.len());
        prop_assert_eq!(quietly(|p| count_covered(mesh, &grid, p)).unwrap(), told.covered);
    }
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let (rows, cols) = (170, 210);
    let z = lakes(rows, cols, 3);
    let grid = Grid::new(&z, rows, cols).unwrap();
    let run = |threads: usize| {
        let done = made(&grid, rows * cols / 20, threads);
        let (mesh, heights) = (&done.surface.mesh, &done.surface.z);
        with_threads(threads, |p| {
            let (Errors { rmse, mae, p95, max, mean, .. }, largest) =
                errors(mesh, heights, &grid, p).unwrap();
            let surface: Vec<f64> = rasterise(mesh, heights, rows, cols, p).unwrap();
            let numbers = [vec![rmse, mae, p95, max, mean], largest, surface].concat();
            (common::fingerprint(&done), numbers.iter().map(|z| z.to_bits()).collect::<Vec<_>>())
        })
    };
    let alone = run(1);
    for threads in [2, 3, 8] {
        assert!(run(threads) == alone, "{threads} threads");
    }
}

#[test]
fn a_mesh_without_data_has_no_errors() {
    let z = lakes(40, 40, 1);
    let done = made(&Grid::new(&z, 40, 40).unwrap(), 50, 1);
    let nothing = [f32::NAN; 1600];
    let grid = Grid::new(&nothing, 40, 40).unwrap();
    let (told, _) = quietly(|p| errors(&done.surface.mesh, &done.surface.z, &grid, p)).unwrap();
    assert_eq!(Errors { void_covered: told.void_covered, ..Errors::default() }, told);
    assert!(told.void_covered > 0);
}
