//! One small fixed case, whose instructions `benchmarks/instructions.py` counts:
//! 256 x 256 pixels, 5 % of them vertices.
//!
//!     cargo run --release --example fixed_case -- max|median|auto

#[path = "../benches/common/mod.rs"]
mod common;

use common::{method, terrain, METHODS};
use dem2tin_core::error::Result;
use dem2tin_core::grid::Grid;
use dem2tin_core::pipeline::{triangulate, Options, Triangulation};
use dem2tin_core::predicate::Metric;
use dem2tin_core::progress::Progress;
use std::process::ExitCode;

const SIZE: usize = 256;
const POINTS: usize = SIZE * SIZE / 20;

/// Callgrind counts in here and nowhere else.
#[inline(never)]
fn counted_run(z: &[f32], options: &Options) -> Result<Triangulation> {
    let grid = Grid::new(z, SIZE, SIZE)?;
    triangulate(&grid, Metric::SQUARE, options, &mut Progress::new(&mut |_, _| true))
}

fn main() -> ExitCode {
    let name = std::env::args().nth(1).unwrap_or_default();
    let Some(options) = method(&name, POINTS) else {
        eprintln!("usage: fixed_case {}", METHODS.join("|"));
        return ExitCode::from(2);
    };
    match counted_run(&terrain(SIZE), &options) {
        Ok(done) => {
            println!("{} vertices", done.surface.z.len());
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("{error:?}");
            ExitCode::FAILURE
        }
    }
}
