//! Faults that were found, each with the smallest input that showed it.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod common;

use common::{assert_sound, hills, plain, quietly, residuals, run, AUTO, MAX};
use dem2tin_core::domain::Constraints;
use dem2tin_core::error::Error;
use dem2tin_core::grid::Grid;
use dem2tin_core::noise::spikes;
use dem2tin_core::pipeline::{Options, Scales};
use dem2tin_core::rule::{Rule, Stop};

#[test]
fn a_tolerance_holds_after_coarser_scales_without_a_fit() {
    let z = hills(50, 50, 1);
    for scales in [vec![[2.0; 2], [0.0; 2]], vec![[1.0; 2]], vec![[1.0; 2], [0.5; 2], [0.0; 2]]] {
        let rule = Rule { tolerance: 1.0, ..MAX };
        let options = Options { scales: Scales::Given(scales), ..plain(rule, usize::MAX) };
        let done = run(&z, 50, 50, &options).unwrap();
        assert_eq!(done.report.stop, Stop::Tolerance);
        assert!(residuals(&done, &z, 50).iter().all(|e| e.is_nan() || *e <= 1.0 + 1e-9));
    }
}

#[test]
fn the_border_rows_of_a_ramp_are_no_spikes() {
    let ramp: Vec<f64> = (0..2000).map(|i| -0.29 * f64::from(i % 50) + 0.70 * f64::from(i / 50)).collect();
    let grid = Grid::new(&ramp, 40, 50).unwrap();
    assert_eq!(quietly(|progress| spikes(&grid, 0.0, progress)).unwrap(), vec![]);
}

#[test]
fn a_spike_between_voids_is_found() {
    let mut z = vec![1.0; 49];
    (z[24], z[23], z[25]) = (100.0, f64::NAN, f64::NAN);
    z[0] = 2.0;
    let grid = Grid::new(&z, 7, 7).unwrap();
    let found = quietly(|progress| spikes(&grid, 0.0, progress)).unwrap();
    assert!(found.iter().any(|&(pixel, height)| pixel == 24 && height == 1.0));
}

#[test]
fn initial_points_outside_the_raster_are_refused() {
    let z = hills(40, 50, 2);
    for outside in [(50, 3), (3, 40), (usize::MAX, 0)] {
        let options = Options {
            constraints: Constraints { pixels: vec![outside], ..Constraints::default() },
            ..plain(MAX, 20)
        };
        assert!(matches!(run(&z, 40, 50, &options), Err(Error::Option { code: "bad-option", .. })));
    }
}

#[test]
fn heights_that_overflow_are_refused() {
    for height in [1e308, -1e308, f64::INFINITY] {
        let mut z = hills(10, 10, 3);
        z[33] = height;
        assert!(matches!(run(&z, 10, 10, &plain(AUTO, 20)), Err(Error::Input { code: "height-range", .. })));
    }
}

#[test]
fn what_fits_exactly_gets_no_points() {
    let done = run(&[7.5; 2500], 50, 50, &plain(MAX, 1000)).unwrap();
    assert_eq!(done.surface.mesh.triangles().len(), 2);
}

#[test]
fn isolated_corner_pixels_do_not_count_as_points() {
    let mut z = hills(30, 30, 4);
    for (i, z) in z.iter_mut().enumerate() {
        let (col, row) = (i % 30, i / 30);
        let is_corner = (col == 0 || col == 29) && (row == 0 || row == 29);
        if !is_corner && (col < 3 || row < 3 || col > 26 || row > 26) {
            *z = f64::NAN;
        }
    }
    let done = run(&z, 30, 30, &plain(MAX, 60)).unwrap();
    assert_sound(&done.surface.mesh, true);
    assert_eq!(done.surface.z.iter().filter(|z| !z.is_nan()).count(), 60);
}

#[test]
fn heights_whose_squares_underflow_are_fitted() {
    for exponent in 1480..1640 {
        let tiny = 10f64.powf(-f64::from(exponent) / 10.0);
        for pixel in 0..9 {
            let mut z = vec![0.0; 9];
            z[pixel] = tiny;
            let options = Options { fit: true, ..plain(MAX, 4) };
            let done = run(&z, 3, 3, &options).unwrap();
            assert!(done.surface.z.iter().all(|z| z.abs() <= 10.0 * tiny), "{tiny:e}: {:?}", done.surface.z);
        }
    }
}

#[test]
fn errors_beyond_single_precision_are_finite() {
    let z: Vec<f64> = hills(12, 12, 2).into_iter().map(|z| 1e90 * z).collect();
    let done = run(&z, 12, 12, &plain(MAX, 9)).unwrap();
    let grid = Grid::new(&z, 12, 12).unwrap();
    let (told, _) =
        quietly(|p| dem2tin_core::measure::errors(&done.surface.mesh, &done.surface.z, &grid, p)).unwrap();
    assert!(told.p95.is_finite() && told.p95 > 1e80 && told.p95 <= told.max);
}

#[test]
fn a_tolerance_holds_where_single_precision_overflows() {
    let z: Vec<f64> = hills(12, 12, 2).into_iter().map(|z| 1e97 * z).collect();
    for tile in [0, 4] {
        let options = Options { tile, ..plain(Rule { tolerance: 2e97, ..MAX }, usize::MAX) };
        let done = run(&z, 12, 12, &options).unwrap();
        assert!(residuals(&done, &z, 12).iter().all(|&e| e <= 2.000001e97));
    }
}

#[test]
fn a_height_beyond_single_precision_is_found_over_others() {
    let mut z = vec![4.4e99; 60];
    z[13] = 9.8e99;
    for tile in [0, 4] {
        let done = run(&z, 10, 6, &Options { tile, ..plain(Rule { tolerance: 1e98, ..MAX }, usize::MAX) });
        let done = done.unwrap();
        assert_eq!(done.report.stop, Stop::Tolerance);
        assert!(residuals(&done, &z, 6).iter().all(|error| *error <= 1e98));
    }
}
