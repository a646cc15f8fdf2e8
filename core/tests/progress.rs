//! A callback that says no ends every stage.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod common;

use common::{full, hills, quietly, AUTO};
use dem2tin_core::error::Error;
use dem2tin_core::fit::Fit;
use dem2tin_core::flip::flip_pass;
use dem2tin_core::grid::Grid;
use dem2tin_core::measure::{errors, rasterise};
use dem2tin_core::noise::spikes;
use dem2tin_core::order::runs;
use dem2tin_core::pipeline::triangulate;
use dem2tin_core::predicate::Metric;
use dem2tin_core::progress::Progress;
use dem2tin_core::scale::gaussian;
use std::collections::BTreeSet;
use std::time::Duration;

const SIDE: usize = 300;

fn refuse_after(stage: &'static str, calls: usize, heights: &[f64]) -> (bool, BTreeSet<&'static str>) {
    let grid = Grid::new(heights, SIDE, SIDE).unwrap();
    let (mut seen, mut stages) = (0, BTreeSet::new());
    let mut report = |name: &'static str, fraction: f64| {
        assert!((0.0..=1.0).contains(&fraction));
        stages.insert(name);
        seen += usize::from(name == stage);
        seen <= calls
    };
    let options = full(AUTO, SIDE * SIDE / 20);
    let result = triangulate(&grid, Metric::SQUARE, &options, &mut Progress::new(&mut report));
    (matches!(result, Err(Error::Cancelled)), stages)
}

#[test]
fn every_stage_can_be_cancelled_when_it_begins() {
    let z = hills(SIDE, SIDE, 1);
    let (cancelled, stages) = refuse_after("never", 0, &z);
    assert!(!cancelled);
    assert!(
        stages.is_superset(&["outline", "despike", "smooth", "refine", "fit", "flip"].into_iter().collect())
    );
    for stage in stages {
        assert!(refuse_after(stage, 0, &z).0, "{stage}");
    }
}

/// The clock is looked at only once enough work is done: wait, then refuse.
fn is_cancelled_within<R>(work: impl FnOnce(&mut Progress) -> Result<R, Error>) -> bool {
    let mut report = |_: &'static str, _: f64| false;
    let mut progress = Progress::new(&mut report);
    std::thread::sleep(Duration::from_millis(50));
    matches!(work(&mut progress), Err(Error::Cancelled))
}

#[test]
fn long_work_can_be_cancelled_half_way() {
    let z = hills(SIDE, SIDE, 1);
    let grid = Grid::new(&z, SIDE, SIDE).unwrap();
    let done = quietly(|p| triangulate(&grid, Metric::SQUARE, &full(AUTO, 9000), p)).unwrap();
    assert!(is_cancelled_within(|p| gaussian(&grid, [2.0, 2.0], p)));
    assert!(is_cancelled_within(|p| spikes(&grid, 0.0, p)));
    assert!(is_cancelled_within(|p| Fit::of(&done.surface, &grid, p).map(drop)));
    let mut fit = quietly(|p| Fit::of(&done.surface, &grid, p)).unwrap();
    assert!(is_cancelled_within(|p| fit.solve(&mut done.surface.clone(), p)));
    assert!(is_cancelled_within(|p| errors(&done.surface.mesh, &done.surface.z, &grid, p)));
    assert!(is_cancelled_within(|p| rasterise::<f32>(&done.surface.mesh, &done.surface.z, SIDE, SIDE, p)));
    let open = || vec![true; done.surface.mesh.triangles().len()];
    assert!(is_cancelled_within(|p| {
        flip_pass(&mut done.surface.clone(), &grid, &runs(&done.surface.mesh), None, &mut open(), p)
    }));
}
