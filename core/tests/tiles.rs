//! Refined in tiles, a raster gets the mesh that it would have got in one piece, or nearly so.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod common;

use common::strategies::{metric, raster};
use common::{assert_sound, fingerprint, full, hills, plain, residuals, run, Random, AUTO, MAX, PAPER};
use dem2tin_core::beside::leave_out;
use dem2tin_core::domain::{domain, Constraints};
use dem2tin_core::grid::Grid;
use dem2tin_core::image::{Image, Source};
use dem2tin_core::ladder::{End, Ladder};
use dem2tin_core::outline::Shape;
use dem2tin_core::pipeline::{triangulate, Options, Scales, Triangulation};
use dem2tin_core::predicate::Metric;
use dem2tin_core::progress::Progress;
use dem2tin_core::rule::{Rule, Stop};
use dem2tin_core::scale::gaussian;
use dem2tin_core::surface::Surface;
use dem2tin_core::tiling::Tiling;
use proptest::prelude::*;

fn rmse(done: &Triangulation, z: &[f64], cols: usize) -> f64 {
    let squares: Vec<f64> = residuals(done, z, cols).iter().filter(|e| !e.is_nan()).map(|e| e * e).collect();
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}

/// Relief of all sizes: hills on hills on hills.
fn relief(side: usize, seed: u64) -> Vec<f64> {
    let mut random = Random(seed);
    let waves: Vec<[f64; 4]> = (0..40)
        .map(|i| {
            let frequency = 0.01 * 1.12f64.powi(i);
            let turn = std::f64::consts::TAU * random.unit();
            [frequency * turn.cos(), frequency * turn.sin(), random.unit() * 6.0, frequency.powf(-1.6)]
        })
        .collect();
    let height = |x: f64, y: f64| waves.iter().map(|[a, b, c, d]| d * (a * x + b * y + c).sin()).sum();
    (0..side * side).map(|i| height((i % side) as f64, (i / side) as f64)).collect()
}

#[test]
fn tiles_take_no_more_points_and_are_no_worse() {
    let side = 256;
    let z = relief(side, 5);
    for rule in [MAX, PAPER, AUTO] {
        let count = side * side / 20;
        let whole = run(&z, side, side, &plain(rule, count)).unwrap();
        let tiled = run(&z, side, side, &Options { tile: 85, ..plain(rule, count) }).unwrap();
        assert_eq!(tiled.surface.mesh.points().len(), count);
        assert_sound(&tiled.surface.mesh, true);
        let ratio = rmse(&tiled, &z, side) / rmse(&whole, &z, side);
        assert!(ratio < 1.04, "{rule:?}: {ratio}");
    }
    let bounded = Rule { tolerance: 1.0, ..MAX };
    let points =
        |tile| run(&z, side, side, &Options { tile, ..plain(bounded, usize::MAX) }).unwrap().surface.z.len();
    let (whole, tiled) = (points(0), points(85));
    assert!(tiled as f64 <= 1.02 * whole as f64, "{tiled} {whole}");
}

#[test]
fn the_last_points_go_where_the_error_is_largest() {
    // Of one DEM the very last point may uncover an error that none is left for, in tiles or in one piece.
    let side = 256;
    let ratio = |seed| {
        let z = relief(side, seed);
        let largest = |tile| {
            let done = run(&z, side, side, &Options { tile, ..plain(MAX, side * side / 20) }).unwrap();
            residuals(&done, &z, side).into_iter().fold(0.0, f64::max)
        };
        largest(85) / largest(0)
    };
    let mut ratios: Vec<f64> = (1..10).map(ratio).collect();
    ratios.sort_unstable_by(f64::total_cmp);
    assert!(ratios[4] < 1.1, "{ratios:?}");
}

#[test]
fn any_number_of_threads_gives_the_same_bytes() {
    let side = 150;
    let mut z = hills(side, side, 3);
    z.iter_mut().step_by(97).for_each(|z| *z = f64::NAN);
    let grid = Grid::new(&z, side, side).unwrap();
    let bounded = Rule { tolerance: 2.0, ..MAX };
    for options in [plain(bounded, usize::MAX), plain(PAPER, 2000), full(AUTO, 2000)] {
        let options = Options { tile: 30, ..options };
        let run = |threads| {
            let report = &mut |_: &'static str, _: f64| true;
            let progress = &mut Progress::new(report).with_threads(threads);
            fingerprint(&triangulate(&grid, Metric::SQUARE, &options, progress).unwrap())
        };
        let alone = run(1);
        for threads in [2, 3, 8] {
            assert!(run(threads) == alone, "{threads} threads");
        }
    }
}

#[test]
fn pure_noise_has_as_many_points_as_asked_for() {
    let side = 120;
    let mut random = Random(9);
    let z: Vec<f64> = (0..side * side).map(|_| random.normal()).collect();
    for rule in [MAX, PAPER, AUTO] {
        for count in [200, 1000, 5000, side * side] {
            let done = run(&z, side, side, &Options { tile: 20, ..plain(rule, count) }).unwrap();
            assert_eq!(done.surface.mesh.points().len(), count);
            assert_sound(&done.surface.mesh, true);
        }
    }
}

#[test]
fn a_few_points_come_to_an_end() {
    let side = 60;
    let z = hills(side, side, 7);
    for rule in [MAX, PAPER, AUTO] {
        for count in 1..40 {
            let mut options = Options { tile: 20, ..plain(rule, count) };
            options.scales = Scales::Given(vec![[1.0; 2], [0.5; 2]]);
            run(&z, side, side, &options).unwrap();
        }
    }
}

#[test]
fn rules_beyond_all_reason_come_to_an_end() {
    let side = 40;
    let z: Vec<f64> = hills(side, side, 7).iter().map(|z| 1e97 * z).collect();
    let tiny = 1e-300;
    for rule in [
        Rule { candidate: tiny, ..MAX },
        Rule { priority: tiny, candidate: tiny, bound: tiny, ..PAPER },
        Rule { weight: 1e3, ..MAX },
        Rule { weight: 1e3, ..PAPER },
        Rule { weight: -1e3, ..AUTO },
    ] {
        for count in [30, 200, 900] {
            let options = Options { tile: 13, ..plain(rule, count) };
            run(&z, side, side, &options).unwrap();
            let scales = Scales::Given(vec![[1.0; 2], [0.0; 2]]);
            run(&z, side, side, &Options { scales, ..options }).unwrap();
        }
    }
}

#[test]
fn no_sample_hides_an_island_in_a_lake() {
    let (side, tile) = (256, 128);
    let mut z = relief(side, 6);
    // Two of the four tiles are a lake.
    z[..side * tile].fill(0.0);
    for (col, row) in [(31, 77), (32, 77), (31, 78), (200, 53)] {
        z[row * side + col] = 20.0;
    }
    for rule in [MAX, AUTO] {
        let done = run(&z, side, side, &Options { tile, ..plain(rule, 1500) }).unwrap();
        let lake = &residuals(&done, &z, side)[..side * (tile - 10)];
        assert!(lake.iter().all(|&e| e < 19.0), "{rule:?}");
    }
}

#[test]
fn scales_in_tiles_are_no_worse_than_in_one_piece() {
    let side = 256;
    let z = relief(side, 8);
    let mut options = plain(PAPER, side * side / 20);
    options.scales = Scales::Given(vec![[1.5; 2], [1.0; 2], [0.5; 2]]);
    let whole = run(&z, side, side, &options).unwrap();
    let tiled = run(&z, side, side, &Options { tile: 85, ..options }).unwrap();
    assert_eq!(tiled.surface.mesh.points().len(), side * side / 20);
    let ratio = rmse(&tiled, &z, side) / rmse(&whole, &z, side);
    assert!(ratio < 1.03, "{ratio}");
}

/// Refined scale by scale, each image held or smoothed by tile.
fn refined_by_scales(z: &[f32], side: usize, left_out: &[usize], is_by_tile: bool) -> Surface {
    let (grid, tiling) = (Grid::new(z, side, side).unwrap(), Tiling::new(side, side, 40));
    let mut report = |_: &'static str, _: f64| true;
    let progress = &mut Progress::new(&mut report);
    let (shape, constraints) = (Shape::default(), Constraints::default());
    let mut surface = domain(&grid, Metric::SQUARE, &shape, &constraints, &tiling, progress).unwrap();
    let sigmas = [[0.9, 0.8], [0.6, 0.7], [0.0; 2]];
    let mut refinement = None;
    for (i, sigma) in sigmas.into_iter().enumerate() {
        let mut held = gaussian(&grid, sigma, progress).unwrap();
        leave_out(&mut held, left_out);
        let held = Grid::new(&held, side, side).unwrap();
        let by_tile = is_by_tile.then_some(Source { grid, left_out, tiling: &tiling });
        let image = Image::of(held, by_tile, sigma, progress).unwrap();
        if i == 0 {
            surface.sample(&image, progress).unwrap();
            surface.insert_pixels(&[(3, 5), (70, 80)], &image, progress).unwrap();
        }
        let ladder = refinement.get_or_insert_with(|| Ladder::new(surface.clone(), &tiling).unwrap());
        let end = if i == 2 { End::Level } else { End::Rough };
        ladder.refine(&image, &PAPER, (1000 * (i + 1), end), progress).unwrap();
    }
    let (surface, _) = refinement.unwrap().finish(false, progress).unwrap();
    assert_eq!(surface.count(), 3000);
    surface
}

#[test]
fn an_image_smoothed_by_tile_is_refined_like_one_that_is_held() {
    let side = 150;
    let mut z: Vec<f32> = relief(side, 9).iter().map(|&z| z as f32).collect();
    (0..40).for_each(|i| z[(side / 2 + i % 9) * side + 7 * i % side] = f32::NAN);
    let left_out: Vec<usize> = (0..side).map(|i| i * side + i).collect();
    let [a, b] = [true, false].map(|is_by_tile| refined_by_scales(&z, side, &left_out, is_by_tile));
    let corners = |surface: &Surface| surface.mesh.triangles().iter().map(|t| t.v).collect::<Vec<_>>();
    assert_eq!((a.mesh.points(), corners(&a)), (b.mesh.points(), corners(&b)));
    assert!(a.z.iter().map(|z| z.to_bits()).eq(b.z.iter().map(|z| z.to_bits())));
}

#[test]
fn a_tolerance_lowered_after_a_first_run_loses_no_triangle() {
    let side = 100;
    let z = hills(side, side, 4);
    for tile in [0, 25] {
        let mut options = Options { tile, ..plain(Rule { tolerance: 4.0, ..MAX }, usize::MAX) };
        options.scales = Scales::Given(vec![[3.0; 2], [0.0; 2]]);
        let coarse = run(&z, side, side, &options).unwrap();
        options.rule.tolerance = 0.5;
        let fine = run(&z, side, side, &options).unwrap();
        for (done, tolerance) in [(coarse, 4.0), (fine, 0.5)] {
            assert!(residuals(&done, &z, side).iter().all(|&e| e <= tolerance * (1.0 + 1e-9)));
        }
    }
}

/// The centroid of a thin triangle beside a seam that bends around a vertex lies in the other tile.
#[test]
fn a_seam_with_a_triangle_on_the_wrong_side_is_released_too() {
    let side = 40;
    let line = vec![
        [29.750695435206772, 38.05384222948127, f64::NAN],
        [38.7288247925153, 1.4438315456757733, f64::NAN],
    ];
    let ring = vec![
        [24.38290289902225, 15.630995087529158, f64::NAN],
        [36.71783859307955, 12.37122970326361, f64::NAN],
        [16.67186313912639, 18.783879877989108, f64::NAN],
    ];
    let flat = vec![(vec![ring], f64::NAN)];
    let constraints = Constraints { lines: vec![line], flat, ..Constraints::default() };
    for rule in [Rule { tolerance: 3.0, ..MAX }, AUTO] {
        let options = Options { tile: 3, constraints: constraints.clone(), ..plain(rule, 700) };
        let done = run(&hills(side, side, 0), side, side, &options).unwrap();
        let mesh = &done.surface.mesh;
        assert_sound(mesh, true);
        assert!(mesh.half_edges().all(|h| !mesh.triangle(h >> 2).is_seam((h & 3) as usize)));
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn a_tolerance_holds_at_every_pixel_of_every_tile(rows in 2usize..40, cols in 2usize..40, tile in 1usize..20, tolerance in 0.3f64..10.0, voids in 0usize..4, seed: u64) {
        let mut z = hills(rows, cols, seed);
        let mut random = Random(seed);
        for _ in 0..voids * rows * cols / 20 { z[random.below(rows * cols)] = f64::NAN; }
        let options = Options { tile, ..plain(Rule { tolerance, ..MAX }, usize::MAX) };
        let Ok(done) = run(&z, rows, cols, &options) else { return Ok(()) };
        prop_assert_eq!(done.report.stop, Stop::Tolerance);
        assert_sound(&done.surface.mesh, true);
        for error in residuals(&done, &z, cols) {
            prop_assert!(error.is_nan() || error <= tolerance * (1.0 + 1e-9), "{} {}", error, tolerance);
        }
    }

    #[test]
    fn tiles_hold_any_mask_and_metric(at in raster(), metric in metric(), tile in 1usize..6, most in 0usize..90) {
        let grid = Grid::new(&at.z, at.rows, at.cols).unwrap();
        for rule in [MAX, PAPER, AUTO] {
            let options = Options { tile, ..plain(rule, most) };
            let Ok(done) = triangulate(&grid, metric, &options, &mut Progress::new(&mut |_, _| true)) else { continue };
            assert_sound(&done.surface.mesh, true);
            prop_assert!(done.surface.count() <= most || done.report.stop == Stop::Outline);
        }
    }

    #[test]
    fn breaklines_and_areas_cross_the_seams(
        line in prop::collection::vec([0.0f64..39.0, 0.0f64..39.0, 0.0f64..9.0], 2..9), ring in prop::collection::vec([0.0f64..39.0, 0.0f64..39.0], 3..6),
        tile in 3usize..20, flat: bool, hard: bool, seed: u64,
    ) {
        let side = 40;
        let z = hills(side, side, seed);
        let line = line.into_iter().map(|[x, y, z]| [x, y, if hard { z } else { f64::NAN }]).collect();
        let ring: Vec<[f64; 3]> = ring.into_iter().map(|[x, y]| [x, y, f64::NAN]).collect();
        let constraints = Constraints { lines: vec![line], flat: if flat { vec![(vec![ring], f64::NAN)] } else { vec![] }, ..Constraints::default() };
        for rule in [Rule { tolerance: 3.0, ..MAX }, AUTO] {
            let options = Options { tile, constraints: constraints.clone(), ..plain(rule, 700) };
            let done = run(&z, side, side, &options).unwrap();
            assert_sound(&done.surface.mesh, true);
            prop_assert!(done.surface.mesh.half_edges().all(|h| !done.surface.mesh.triangle(h >> 2).is_seam((h & 3) as usize)));
        }
    }
}
