//! Outline, breaklines, clip polygons and level areas on small rasters with voids,
//! through all stages.
#![no_main]

use arbitrary::{Arbitrary, Result, Unstructured};
use dem2tin_core::crop::Vertex;
use dem2tin_core::domain::{Constraints, Polygon};
use dem2tin_core::error::Error;
use dem2tin_core::grid::Grid;
use dem2tin_core::outline::Shape;
use dem2tin_core::pipeline::{triangulate, Options, Scales};
use dem2tin_core::predicate::Metric;
use dem2tin_core::progress::Progress;
use dem2tin_core::rule::Rule;
use dem2tin_core::surface::Surface;
use dem2tin_core_fuzz::{assert_sound, metric};
use libfuzzer_sys::fuzz_target;

#[derive(Debug)]
struct Input {
    rows: usize,
    cols: usize,
    metric: Metric,
    shape: Shape,
    constraints: Constraints,
    is_plain: bool,
    tile: usize,
    z: Vec<f64>,
}

/// Quarter pixels up to a few beyond the raster, and now and then anything.
fn coordinate(u: &mut Unstructured) -> Result<f64> {
    Ok(match u8::arbitrary(u)? {
        byte @ 0..=250 => f64::from(byte) / 4.0 - 20.0,
        _ => f64::arbitrary(u)?,
    })
}

fn vertex(u: &mut Unstructured) -> Result<Vertex> {
    let height = u8::arbitrary(u)?;
    Ok([coordinate(u)?, coordinate(u)?, if height < 99 { f64::from(height) } else { f64::NAN }])
}

fn some<'a, T>(
    u: &mut Unstructured<'a>,
    most: usize,
    make: fn(&mut Unstructured<'a>) -> Result<T>,
) -> Result<Vec<T>> {
    (0..u.int_in_range(0..=most)?).map(|_| make(u)).collect()
}

fn chain(u: &mut Unstructured) -> Result<Vec<Vertex>> {
    some(u, 6, vertex)
}

fn polygon(u: &mut Unstructured) -> Result<Polygon> {
    some(u, 2, chain)
}

impl<'a> Arbitrary<'a> for Input {
    fn arbitrary(u: &mut Unstructured<'a>) -> Result<Self> {
        let (rows, cols, metric) = (u.int_in_range(2..=12)?, u.int_in_range(2..=12)?, metric(u)?);
        let tolerance = f64::from(u8::arbitrary(u)?) / 64.0;
        let shape = Shape { tolerance, keep_isolated: u.arbitrary()?, sieve: u.int_in_range(0..=4)? };
        let constraints = Constraints {
            pixels: Vec::new(),
            points: some(u, 4, vertex)?,
            lines: some(u, 5, chain)?,
            clip: if u.arbitrary()? { Some(some(u, 2, polygon)?) } else { None },
            flat: some(u, 2, |u| Ok((polygon(u)?, vertex(u)?[2])))?,
        };
        let z = (0..rows * cols)
            .map(|i| Ok(if u8::arbitrary(u)? < 200 { (i * i % 7) as f64 } else { f64::NAN }))
            .collect::<Result<_>>()?;
        Ok(Input {
            rows,
            cols,
            metric,
            shape,
            constraints,
            is_plain: u.arbitrary()?,
            tile: u.int_in_range(0..=4)?,
            z,
        })
    }
}

/// Garland and Heckbert's method, or all stages.
fn options(is_plain: bool, shape: Shape, constraints: Constraints, tile: usize) -> Options {
    let priority = if is_plain { 1.0 } else { 0.5 };
    Options {
        max_points: 60,
        is_share: is_plain,
        points_per_scale: None,
        rule: Rule { priority, weight: 0.0, candidate: 1.0, tolerance: 0.0, bound: 1.0 },
        has_tolerance: false,
        stop_at_noise: false,
        scales: if is_plain { Scales::Given(vec![[0.0; 2]]) } else { Scales::Auto },
        despike: !is_plain,
        fit: !is_plain,
        flips: if is_plain { 0 } else { 2 },
        shape,
        constraints,
        tile,
    }
}

fuzz_target!(|input: Input| {
    let Input { rows, cols, metric, shape, constraints, is_plain, tile, z } = input;
    let Ok(grid) = Grid::new(&z, rows, cols) else { unreachable!("the sides are 2 or more") };
    let mut report = |_: &'static str, _: f64| true;
    let options = options(is_plain, shape, constraints, tile);
    match triangulate(&grid, metric, &options, &mut Progress::new(&mut report)) {
        Ok(done) => {
            let Surface { mesh, z, .. } = done.surface;
            assert_sound(&mesh, done.report.delaunay);
            for triangle in mesh.triangles().iter().filter(|t| !t.is_void()) {
                assert!(triangle.v.iter().all(|&v| z[v as usize].is_finite()), "no height");
            }
        }
        Err(error) => assert!(
            matches!(error, Error::Input { code: "no-area" | "clip-outside" | "height-range", .. }),
            "{error:?}"
        ),
    }
});
