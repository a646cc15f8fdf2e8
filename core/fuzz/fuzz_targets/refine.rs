//! All stages with any options on a small raster with voids: a sound mesh that keeps its
//! promises, or an error with a code, never a panic.
#![no_main]

use arbitrary::{Arbitrary, Result, Unstructured};
use dem2tin_core::domain::Constraints;
use dem2tin_core::error::Error;
use dem2tin_core::grid::{Grid, Height};
use dem2tin_core::measure::errors;
use dem2tin_core::outline::Shape;
use dem2tin_core::pipeline::{triangulate, Options, Scales};
use dem2tin_core::predicate::Metric;
use dem2tin_core::progress::Progress;
use dem2tin_core::rule::{Rule, Stop};
use dem2tin_core_fuzz::{assert_sound, in_complex, metric};
use libfuzzer_sys::fuzz_target;

#[derive(Debug)]
struct Input {
    rows: usize,
    cols: usize,
    metric: Metric,
    is_double: bool,
    options: Options,
    z: Vec<f64>,
}

/// Mostly within (0, 1], now and then anything.
fn quantile(u: &mut Unstructured) -> Result<f64> {
    Ok(match u.int_in_range(0..=15)? {
        0 => f64::arbitrary(u)?,
        1..=6 => 1.0,
        _ => f64::from(u8::arbitrary(u)?) / 250.0,
    })
}

fn size(u: &mut Unstructured, most: usize) -> Result<usize> {
    Ok(if u.ratio(1, 4)? { usize::MAX } else { u.int_in_range(0..=most)? })
}

fn options(u: &mut Unstructured, rows: usize, cols: usize) -> Result<Options> {
    let tolerance = match u.int_in_range(0..=7)? {
        0 => f64::arbitrary(u)?,
        n => f64::from(u8::arbitrary(u)?) / f64::from(1 << n),
    };
    let rule = Rule {
        priority: quantile(u)?,
        weight: f64::from(i8::arbitrary(u)?) / 32.0,
        candidate: quantile(u)?,
        tolerance,
        bound: quantile(u)?,
    };
    let sigma = |u: &mut Unstructured| -> Result<f64> {
        Ok(match u.int_in_range(0..=3)? {
            0 => 0.0,
            1 => f64::from(u8::arbitrary(u)?) / 2.5,
            _ => f64::from(u8::arbitrary(u)?) / 64.0,
        })
    };
    let scales = if u.arbitrary()? {
        Scales::Auto
    } else {
        let count = u.int_in_range(0..=3)?;
        Scales::Given((0..count).map(|_| Ok([sigma(u)?, sigma(u)?])).collect::<Result<_>>()?)
    };
    let initial = u.int_in_range(0..=4)?;
    Ok(Options {
        max_points: size(u, rows * cols + 5)?,
        is_share: u.arbitrary()?,
        points_per_scale: Some(size(u, 20)?),
        rule,
        has_tolerance: u.arbitrary()?,
        stop_at_noise: u.arbitrary()?,
        scales,
        despike: u.arbitrary()?,
        fit: u.arbitrary()?,
        flips: u.int_in_range(0..=3)?,
        shape: Shape::default(),
        constraints: Constraints {
            pixels: (0..initial)
                .map(|_| Ok((u.int_in_range(0..=cols)?, u.int_in_range(0..=rows - 1)?)))
                .collect::<Result<_>>()?,
            ..Constraints::default()
        },
        tile: u.int_in_range(0..=4)?,
    })
}

impl<'a> Arbitrary<'a> for Input {
    fn arbitrary(u: &mut Unstructured<'a>) -> Result<Self> {
        let (rows, cols) = (u.int_in_range(2..=12)?, u.int_in_range(2..=12)?);
        let (metric, is_double, options) = (metric(u)?, u.arbitrary()?, options(u, rows, cols)?);
        let unit = [1.0, 0.37, 1e-6, 1e30, 1e98][usize::from(u8::arbitrary(u)? % 5)];
        let height = |_| {
            Ok(match u8::arbitrary(u)? {
                byte @ 0..=219 => f64::from(byte) * unit,
                220..=254 => f64::NAN,
                255 => f64::arbitrary(u)?,
            })
        };
        let z = (0..rows * cols).map(height).collect::<Result<_>>()?;
        Ok(Input { rows, cols, metric, is_double, options, z })
    }
}

fn run<T: Height>(z: &[T], rows: usize, cols: usize, metric: Metric, options: &Options) {
    let Ok(grid) = Grid::new(z, rows, cols) else { unreachable!("the sides are 2 or more") };
    let mut report = |_: &'static str, fraction: f64| {
        assert!((0.0..=1.0).contains(&fraction));
        true
    };
    let progress = &mut Progress::new(&mut report);
    let done = match triangulate(&grid, metric, options, progress) {
        Ok(done) => done,
        Err(error) => return assert_ne!(error, Error::Cancelled),
    };
    assert_sound(&done.surface.mesh, done.report.delaunay);
    let points = done.surface.z.iter().filter(|z| !z.is_nan()).count();
    let is_bounded = options.has_tolerance && options.rule.bound == 1.0;
    assert!(points <= options.max_points || done.report.stop == Stop::Outline);
    for triangle in done.surface.mesh.triangles().iter().filter(|t| !t.is_void()) {
        assert!(
            triangle.v.iter().all(|&v| done.surface.z[v as usize].is_finite()),
            "a vertex without a height"
        );
    }
    let Ok((errors, _)) = errors(&done.surface.mesh, &done.surface.z, &grid, progress) else {
        unreachable!()
    };
    assert_eq!(errors.void_covered, 0);
    assert!(errors.covered >= in_complex(&grid).into_iter().filter(|&inside| inside).count(), "data lost");
    // Despiked pixels are no longer what the tolerance counts against.
    if is_bounded
        && done.report.stop == Stop::Tolerance
        && done.report.spikes.is_empty()
        && !options.stop_at_noise
    {
        let largest = z.iter().map(|z| z.to_f64().abs()).fold(0.0, f64::max);
        assert!(
            errors.max <= options.rule.tolerance + 1e-9 * largest,
            "{} {errors:?}",
            options.rule.tolerance
        );
    }
}

fuzz_target!(|input: Input| {
    let Input { rows, cols, metric, is_double, options, z } = input;
    if is_double {
        run(&z, rows, cols, metric, &options);
    } else {
        let z: Vec<f32> = z.iter().map(|&z| z as f32).collect();
        run(&z, rows, cols, metric, &options);
    }
});
