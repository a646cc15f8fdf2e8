//! What holds for every small raster, whatever its voids, ties, metric and method.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod common;

use common::strategies::{any_options, metric, options, raster, rule, Raster};
use common::{assert_sound, fingerprint, full, plain, quietly, residuals, triangle_set, Random, AUTO, MAX};
use dem2tin_core::domain::Constraints;
use dem2tin_core::error::Error;
use dem2tin_core::grid::{Grid, Height};
use dem2tin_core::measure::{errors, rasterise};
use dem2tin_core::noise::{noise, spikes};
use dem2tin_core::outline::trace;
use dem2tin_core::pipeline::{triangulate, Options, Scales, Triangulation};
use dem2tin_core::predicate::{orient2d, Metric, Point, UNIT};
use dem2tin_core::progress::Progress;
use dem2tin_core::rule::{Rule, Stop};
use dem2tin_core::simplify::{simplify, Chain};
use proptest::prelude::*;
use std::collections::BTreeSet;

/// `None` where the raster has no area.
fn meshed<T: Height>(z: &[T], at: &Raster, metric: Metric, options: &Options) -> Option<Triangulation> {
    let grid = Grid::new(z, at.rows, at.cols).unwrap();
    match quietly(|progress| triangulate(&grid, metric, options, progress)) {
        Err(Error::Input { code: "no-area", .. }) => None,
        result => Some(result.unwrap()),
    }
}

fn twice_area(chain: &Chain) -> i64 {
    let step =
        |s: &[(i32, i32)]| i64::from(s[0].0) * i64::from(s[1].1) - i64::from(s[1].0) * i64::from(s[0].1);
    chain.windows(2).map(step).sum()
}

fn twice_data_area(done: &Triangulation) -> i64 {
    let data =
        (0..done.surface.mesh.triangles().len() as u32).filter(|&t| !done.surface.mesh.triangle(t).is_void());
    data.map(|t| done.surface.mesh.corners(t)).map(|[a, b, c]| orient2d(a, b, c)).sum()
}

/// The valid corners of each 2 x 2 block that has at least three, as raster indices.
fn cells(at: &Raster) -> Vec<Vec<usize>> {
    let starts = (0..at.rows - 1).flat_map(|row| (0..at.cols - 1).map(move |col| row * at.cols + col));
    let corners = starts.map(|i| [i, i + 1, i + at.cols, i + at.cols + 1]);
    let valid = corners.map(|c| c.into_iter().filter(|&i| !at.z[i].is_nan()).collect::<Vec<_>>());
    valid.filter(|c| c.len() >= 3).collect()
}

fn places(done: &Triangulation) -> BTreeSet<Point> {
    done.surface.mesh.points().iter().copied().collect()
}

fn assert_within(done: &Triangulation, at: &Raster, tolerance: f64) {
    for error in residuals(done, &at.z, at.cols) {
        assert!(error.is_nan() || error <= tolerance + 1e-9, "{error} exceeds {tolerance}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(10_000))]

    #[test]
    fn every_method_leaves_a_sound_mesh_with_no_more_points_than_asked_for(at in raster(), metric in metric(), options in options()) {
        let Some(done) = meshed(&at.z, &at, metric, &options) else { return Ok(()) };
        assert_sound(&done.surface.mesh, done.report.delaunay);
        let points = done.surface.z.iter().filter(|z| !z.is_nan()).count();
        prop_assert!(points <= options.max_points || done.report.stop == Stop::Outline);
    }

    #[test]
    fn all_cells_are_covered_and_no_void_is(at in raster(), metric in metric(), options in options()) {
        let cells = cells(&at);
        let Some(done) = meshed(&at.z, &at, metric, &options) else {
            prop_assert!(cells.is_empty());
            return Ok(());
        };
        let surface: Vec<f64> = quietly(|p| rasterise(&done.surface.mesh, &done.surface.z, at.rows, at.cols, p)).unwrap();
        prop_assert!(cells.iter().flatten().all(|&i| surface[i].is_finite()), "data lost");
        prop_assert!(surface.iter().zip(&at.z).all(|(s, z)| s.is_nan() || !z.is_nan()), "void covered");
    }

    #[test]
    fn the_data_triangles_have_the_area_of_the_outline(at in raster(), metric in metric(), options in options()) {
        // A seam that crosses the outline bends it by a fraction of a lattice unit.
        let options = Options { tile: 0, ..options };
        let Some(done) = meshed(&at.z, &at, metric, &options) else { return Ok(()) };
        let chains = quietly(|p| trace(&Grid::new(&at.z, at.rows, at.cols).unwrap(), p)).unwrap();
        let traced: i64 = chains.iter().map(twice_area).sum();
        prop_assert_eq!(traced, cells(&at).iter().map(|c| c.len() as i64 - 2).sum::<i64>());
        let simplified: i64 = chains.iter().map(|chain| twice_area(&quietly(|p| simplify(chain, 1.0, p)).unwrap())).sum();
        prop_assert!(simplified >= traced);
        prop_assert_eq!(twice_data_area(&done), simplified * i64::from(UNIT * UNIT));
    }

    #[test]
    fn a_tolerance_holds_at_every_covered_pixel(at in raster(), metric in metric(), tolerance in 0.0f64..4.0, which: [bool; 3]) {
        let [is_max, all, flip] = which;
        let rule = Rule { tolerance, ..if is_max { MAX } else { AUTO } };
        let method = if all { full(rule, usize::MAX) } else { plain(rule, usize::MAX) };
        // A spike that was removed is outside of the tolerance.
        let options = Options { despike: false, has_tolerance: true, flips: u32::from(flip), ..method };
        let Some(done) = meshed(&at.z, &at, metric, &options) else { return Ok(()) };
        prop_assert_eq!(done.report.stop, Stop::Tolerance);
        assert_within(&done, &at, tolerance);
    }

    #[test]
    fn a_fit_that_pulls_hard_keeps_the_tolerance(rows in 5usize..=9, cols in 5usize..=9, metric in metric(), slopes in [0i32..5, 0i32..5], level in 0.1f64..0.9) {
        // Errors of one sign near a vertex, of the other far away, move it by more than they are.
        let place = |i: usize| f64::from(slopes[0] * (i % cols) as i32 + slopes[1] * (i / cols) as i32);
        let edge = level * place(rows * cols - 1);
        let mut z: Vec<f64> = (0..rows * cols).map(|i| if place(i) < edge { 1.0 } else { -1.0 }).collect();
        for corner in [0, cols - 1, (rows - 1) * cols, rows * cols - 1] {
            z[corner] = 0.0;
        }
        let at = Raster { rows, cols, z };
        let options = Options { fit: true, ..plain(Rule { tolerance: 1.0, ..MAX }, usize::MAX) };
        assert_within(&meshed(&at.z, &at, metric, &options).unwrap(), &at, 1.0);
    }

    #[test]
    fn a_tolerance_holds_after_coarse_scales_and_initial_points(at in raster(), sigmas in prop::collection::vec(0.0f64..3.0, 1..3), seed: u64) {
        let rule = Rule { tolerance: 0.5, ..MAX };
        let mut random = Random(seed);
        let initial: Vec<_> = (0..3).map(|_| (random.below(at.cols), random.below(at.rows))).collect();
        let scales = Scales::Given(sigmas.iter().map(|&s| [s, 0.5 * s]).collect());
        let options = Options { scales, constraints: Constraints { pixels: initial.clone(), ..Constraints::default() }, fit: true, ..plain(rule, usize::MAX) };
        let Some(done) = meshed(&at.z, &at, Metric::SQUARE, &options) else { return Ok(()) };
        assert_within(&done, &at, 0.5);
        let cells: BTreeSet<usize> = cells(&at).into_iter().flatten().collect();
        for (col, row) in initial.into_iter().filter(|(col, row)| cells.contains(&(row * at.cols + col))) {
            prop_assert!(done.surface.mesh.points().contains(&Point::pixel(col, row)), "({}, {}) is no vertex", col, row);
        }
    }

    #[test]
    fn scaling_by_a_power_of_two_scales_the_heights_and_nothing_else(at in raster(), metric in metric(), options in options(), power in -30i32..30) {
        let factor = 2f64.powi(power);
        let z: Vec<f64> = at.z.iter().map(|z| z * factor).collect();
        let rule = Rule { tolerance: options.rule.tolerance * factor, ..options.rule };
        let Some(done) = meshed(&at.z, &at, metric, &options) else { return Ok(()) };
        let scaled = meshed(&z, &at, metric, &Options { rule, ..options }).unwrap();
        let heights = done.surface.z.iter().map(|z| (z * factor).to_bits()).collect();
        let (points, triangles, _) = fingerprint(&done);
        prop_assert_eq!(fingerprint(&scaled), (points, triangles, heights));
        prop_assert_eq!(scaled.report.stop, done.report.stop);
    }

    #[test]
    fn the_bits_of_a_nan_and_who_watches_change_nothing(at in raster(), options in options(), seed: u64) {
        let mut random = Random(seed);
        let other: Vec<f64> = at.z.iter().map(|z| if z.is_nan() {
            f64::from_bits(random.bits() | 0x7ff0_0000_0000_0001)
        } else { *z }).collect();
        let Some(done) = meshed(&at.z, &at, Metric::SQUARE, &options) else { return Ok(()) };
        let mut calls = 0;
        let mut count = |_: &'static str, _: f64| { calls += 1; true };
        let grid = Grid::new(&other, at.rows, at.cols).unwrap();
        let again = triangulate(&grid, Metric::SQUARE, &options, &mut Progress::new(&mut count)).unwrap();
        prop_assert_eq!(fingerprint(&done), fingerprint(&again));
        prop_assert_eq!(done.report, again.report);
        prop_assert!(calls > 0);
    }

    #[test]
    fn single_precision_gives_the_same_mesh(at in raster(), metric in metric(), rule in rule(), most in 0usize..90) {
        // The heights of these rasters are multiples of a quarter.
        let single: Vec<f32> = at.z.iter().map(|&z| z as f32).collect();
        let options = plain(rule, most);
        let Some(done) = meshed(&at.z, &at, metric, &options) else { return Ok(()) };
        prop_assert_eq!(fingerprint(&done), fingerprint(&meshed(&single, &at, metric, &options).unwrap()));
    }

    #[test]
    fn a_plane_needs_two_triangles(rows in 2usize..=9, cols in 2usize..=9, metric in metric(), rule in rule(), slopes in [-3.0f64..3.0, -3.0..3.0], all: bool) {
        let z = (0..rows * cols).map(|i| 5.0 + slopes[0] * (i % cols) as f64 + slopes[1] * (i / cols) as f64).collect();
        let at = Raster { rows, cols, z };
        // The heights of a plane are rounded, too.
        let rule = Rule { tolerance: 1e-9, ..rule };
        let options = if all { full(rule, usize::MAX) } else { plain(rule, usize::MAX) };
        let done = meshed(&at.z, &at, metric, &options).unwrap();
        prop_assert_eq!(done.surface.mesh.triangles().len(), 2);
        assert_within(&done, &at, 1e-9);
    }

    #[test]
    fn more_points_keep_those_that_fewer_chose(at in raster(), metric in metric(), rule in rule(), n in 0usize..60, more in 0usize..30) {
        let Some(few) = meshed(&at.z, &at, metric, &plain(rule, n)) else { return Ok(()) };
        let many = meshed(&at.z, &at, metric, &plain(rule, n + more)).unwrap();
        prop_assert!(places(&many).is_superset(&places(&few)));
    }

    #[test]
    fn more_points_never_make_fewer_vertices(at in raster(), options in options(), n in 0usize..60, more in 0usize..30) {
        // What seams need depends a little on the rungs of the ladder.
        let options = Options { tile: 0, ..options };
        let count = |max_points| {
            let options = Options { max_points, ..options.clone() };
            meshed(&at.z, &at, Metric::SQUARE, &options).map(|done| done.surface.mesh.points().len())
        };
        prop_assert!(count(n) <= count(n + more));
    }

    #[test]
    fn raising_the_ground_leaves_the_triangles(rows in 2usize..=9, cols in 2usize..=9, metric in metric(), rule in rule(), n in 4usize..80, rise in -(1i64 << 48)..1 << 48, seed: u64) {
        // Heights of 40 bits: errors that are all but equal, which rounding decides, do not occur.
        let mut random = Random(seed);
        let z: Vec<i64> = (0..rows * cols).map(|_| (random.bits() >> 24) as i64).collect();
        let [low, high] = [0, rise].map(|by| {
            let z: Vec<f64> = z.iter().map(|z| (z + by) as f64).collect();
            let grid = Grid::new(&z, rows, cols).unwrap();
            quietly(|p| triangulate(&grid, metric, &plain(rule, n), p)).unwrap()
        });
        prop_assert_eq!(triangle_set(&low.surface.mesh), triangle_set(&high.surface.mesh));
    }

    #[test]
    fn plain_vertices_carry_the_heights_of_their_pixels(at in raster(), metric in metric(), rule in rule(), most in 0usize..90) {
        let Some(done) = meshed(&at.z, &at, metric, &plain(rule, most)) else { return Ok(()) };
        let data: BTreeSet<u32> =
            done.surface.mesh.triangles().iter().filter(|t| !t.is_void()).flat_map(|t| t.v).collect();
        for (v, (p, z)) in (0..).zip(done.surface.mesh.points().iter().zip(&done.surface.z)) {
            let (col, row) = p.as_pixel().unwrap();
            let expected = if data.contains(&v) { at.z[row * at.cols + col] } else { f64::NAN };
            prop_assert!(*z == expected || z.is_nan() && expected.is_nan(), "{} for {}", z, expected);
        }
    }

    #[test]
    fn the_errors_are_those_of_the_written_raster(at in raster(), metric in metric(), options in options()) {
        let Some(done) = meshed(&at.z, &at, metric, &options) else { return Ok(()) };
        let surface: Vec<f64> = quietly(|p| rasterise(&done.surface.mesh, &done.surface.z, at.rows, at.cols, p)).unwrap();
        let grid = Grid::new(&at.z, at.rows, at.cols).unwrap();
        let (told, largest) = quietly(|p| errors(&done.surface.mesh, &done.surface.z, &grid, p)).unwrap();
        let mut signed: Vec<f64> = surface.iter().zip(&at.z).map(|(s, z)| s - z).filter(|e| !e.is_nan()).collect();
        let n = signed.len() as f64;
        let mean = |f: fn(f64) -> f64| signed.iter().map(|&e| f(e)).sum::<f64>() / n;
        let close = |a: f64, b: f64| (a - b).abs() <= 1e-9;
        prop_assert!(close(told.mean, mean(|e| e)) && close(told.mae, mean(f64::abs)), "{:?}", told);
        prop_assert!(close(told.rmse, mean(|e| e * e).sqrt()), "{:?}", told);
        signed.sort_by(|a, b| a.abs().total_cmp(&b.abs()));
        let rank = (n * 0.95).ceil() as usize - 1;
        prop_assert!((told.p95 - signed[rank].abs()).abs() <= 1e-6 * told.p95, "{:?}", told);
        // A pixel on an edge counts in both triangles; rounding may differ.
        prop_assert!(close(told.max, signed[signed.len() - 1].abs()), "{:?}", told);
        prop_assert_eq!(told.max, largest.into_iter().fold(0.0, f64::max));
        prop_assert_eq!((told.covered, told.void_covered), (signed.len(), 0));
        prop_assert_eq!(told.covered + told.uncovered, grid.count_valid());
    }

    #[test]
    fn noise_and_spikes_turn_with_the_raster(at in raster(), level in 0.0f64..2.0) {
        let Raster { rows, cols, z } = at;
        let turned: Vec<f64> = (0..z.len()).map(|i| z[(i % rows) * cols + cols - 1 - i / rows]).collect();
        let (grid, other) = (Grid::new(&z, rows, cols).unwrap(), Grid::new(&turned, cols, rows).unwrap());
        prop_assert_eq!(noise(&grid), noise(&other));
        let mut found = quietly(|p| spikes(&other, level, p)).unwrap();
        for (i, _) in &mut found {
            *i = (*i % rows) * cols + cols - 1 - *i / rows;
        }
        found.sort_by_key(|&(i, _)| i);
        prop_assert_eq!(quietly(|p| spikes(&grid, level, p)).unwrap(), found);
    }

    #[test]
    fn a_refusal_at_any_moment_cancels(at in raster(), options in options(), at_call in 0usize..14) {
        let mut calls = 0;
        let mut report = |_: &'static str, fraction: f64| {
            assert!((0.0..=1.0).contains(&fraction));
            calls += 1;
            calls <= at_call
        };
        let grid = Grid::new(&at.z, at.rows, at.cols).unwrap();
        let result = triangulate(&grid, Metric::SQUARE, &options, &mut Progress::new(&mut report));
        prop_assert_eq!(matches!(result, Err(Error::Cancelled)), calls > at_call);
        prop_assert!(calls <= at_call + 1, "asked again after a refusal");
    }

    #[test]
    fn any_options_give_a_mesh_or_an_error_with_a_code(at in raster(), metric in metric(), mut options in any_options(), within in 0..4) {
        if within > 0 { options.constraints.pixels.iter_mut().for_each(|(col, row)| (*col, *row) = (*col % at.cols, *row % at.rows)); }
        let grid = Grid::new(&at.z, at.rows, at.cols).unwrap();
        match quietly(|p| triangulate(&grid, metric, &options, p)) {
            Ok(done) => {
                assert_sound(&done.surface.mesh, done.report.delaunay);
                let data = done.surface.mesh.triangles().iter().filter(|t| !t.is_void());
                prop_assert!(data.flat_map(|t| t.v).all(|v| done.surface.z[v as usize].is_finite()), "a vertex without height");
            }
            Err(Error::Input { code, .. }) => prop_assert_eq!(code, "no-area"),
            Err(Error::Option { code, .. }) => prop_assert_eq!(code, "bad-option"),
            Err(Error::Cancelled) => prop_assert!(false, "nobody cancelled"),
        }
    }
}
