//! Any mask: every pixel of a cell with three valid corners is covered, and no void.
#![no_main]

use arbitrary::{Arbitrary, Result, Unstructured};
use dem2tin_core::domain::{domain, Constraints};
use dem2tin_core::error::Error;
use dem2tin_core::grid::Grid;
use dem2tin_core::measure::rasterise;
use dem2tin_core::outline::{trace, Shape};
use dem2tin_core::predicate::{orient2d, Metric, UNIT};
use dem2tin_core::progress::Progress;
use dem2tin_core::simplify::{simplify, Chain};
use dem2tin_core::tiling::Tiling;
use dem2tin_core_fuzz::{assert_sound, in_complex, metric};
use libfuzzer_sys::fuzz_target;

#[derive(Debug)]
struct Input {
    rows: usize,
    cols: usize,
    metric: Metric,
    z: Vec<f32>,
}

impl<'a> Arbitrary<'a> for Input {
    fn arbitrary(u: &mut Unstructured<'a>) -> Result<Self> {
        let (rows, cols, metric) = (u.int_in_range(2..=24)?, u.int_in_range(2..=24)?, metric(u)?);
        let mut z = vec![0.0; rows * cols];
        for eight in z.chunks_mut(8) {
            let mask = u8::arbitrary(u)?;
            for (bit, z) in eight.iter_mut().enumerate().filter(|(bit, _)| mask >> bit & 1 != 0) {
                *z = f32::from_bits(0x7fc0_0000 + bit as u32);
            }
        }
        Ok(Input { rows, cols, metric, z })
    }
}

fn twice_area(chain: &Chain) -> i64 {
    let steps = chain.windows(2);
    steps.map(|s| i64::from(s[0].0) * i64::from(s[1].1) - i64::from(s[1].0) * i64::from(s[0].1)).sum()
}

fuzz_target!(|input: Input| {
    let Input { rows, cols, metric, z } = input;
    let Ok(grid) = Grid::new(&z, rows, cols) else { unreachable!("the sides are 2 or more") };
    let mut report = |_: &'static str, _: f64| true;
    let progress = &mut Progress::new(&mut report);
    let inside = in_complex(&grid);
    let mesh = match domain(
        &grid,
        metric,
        &Shape::default(),
        &Constraints::default(),
        &Tiling::new(grid.rows(), grid.cols(), 0),
        progress,
    ) {
        Ok(surface) => surface.mesh,
        Err(error) => {
            assert!(matches!(error, Error::Input { code: "no-area", .. }), "{error:?}");
            return assert!(!inside.contains(&true));
        }
    };
    assert_sound(&mesh, true);
    let zeros = vec![0.0; mesh.points().len()];
    let Ok(surface) = rasterise::<f32>(&mesh, &zeros, rows, cols, progress) else { unreachable!() };
    for ((surface, z), inside) in surface.iter().zip(&z).zip(inside) {
        assert!(!inside || !surface.is_nan(), "data lost");
        assert!(surface.is_nan() || !z.is_nan(), "void covered");
    }
    let data = (0..mesh.triangles().len() as u32).filter(|&t| !mesh.triangle(t).is_void());
    let covered: i64 = data.map(|t| mesh.corners(t)).map(|[a, b, c]| orient2d(a, b, c)).sum();
    let Ok(chains) = trace(&grid, progress) else { unreachable!("nobody cancels") };
    let mut outlined = 0;
    for chain in chains {
        let Ok(simple) = simplify(&chain, 1.0, progress) else { unreachable!("nobody cancels") };
        outlined += twice_area(&simple);
    }
    assert_eq!(covered, outlined * i64::from(UNIT) * i64::from(UNIT));
});
