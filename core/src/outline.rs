//! The outline of the data: the border between valid pixels and void.
//!
//! The data region is a cell complex: every 2 x 2 block with at least three valid
//! pixels is a square or a half-square. Its border runs through valid pixel
//! centres, is planar by construction, and becomes constrained edges of the mesh;
//! triangles beyond it are void.

use crate::error::{Error, Result};
use crate::grid::{Grid, Height};
use crate::memory;
use crate::predicate::{Point, UNIT};
use crate::progress::Progress;
use crate::sieve::sieve;
use crate::simplify::{simplify, Chain};
use crate::threads::spread;

/// What counts as data, and how closely its border is followed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shape {
    /// Distance in pixels by which the outline may take in void.
    pub tolerance: f64,
    /// Whether valid pixels that span no area (single ones and lines of one pixel's
    /// width) get a small area of their own.
    pub keep_isolated: bool,
    /// Islands and holes of fewer pixels are left out.
    pub sieve: usize,
}

impl Default for Shape {
    fn default() -> Self {
        Shape { tolerance: 1.0, keep_isolated: false, sieve: 0 }
    }
}

/// Pixels that one thread looks at in a row.
const AT_ONCE: usize = 1 << 18;

/// The border of the data as directed polylines, data on their positive side.
///
/// Errors: `no-area` if no three neighbouring valid pixels span an area.
pub fn outline<T: Height>(grid: &Grid<T>, shape: &Shape, progress: &mut Progress) -> Result<Vec<Vec<Point>>> {
    if shape.sieve > 1 {
        let mask = sieve(grid, shape.sieve, progress)?;
        let mask = Grid::new(&mask, grid.rows(), grid.cols())?;
        let plain = Shape { sieve: 0, ..*shape };
        return outline(&mask, &plain, progress);
    }
    let is_full = |part: &[T]| part.iter().fold(true, |all, z| all & !z.to_f64().is_nan());
    if spread(progress, grid.z().chunks(AT_ONCE), |part, _| Ok(is_full(part)))?.into_iter().all(|full| full) {
        // Without voids it is the border of the raster: nothing to trace.
        let (right, bottom) = (grid.cols() - 1, grid.rows() - 1);
        let corners = [(0, 0), (right, 0), (right, bottom), (0, bottom), (0, 0)];
        return Ok(vec![corners.map(|(col, row)| Point::pixel(col, row)).to_vec()]);
    }
    let centre = |&(col, row): &(i32, i32)| Point::pixel(col as usize, row as usize);
    let mut borders: Vec<Vec<Point>> = Vec::new();
    for chain in trace(grid, progress)? {
        borders.push(simplify(&chain, shape.tolerance, progress)?.iter().map(centre).collect());
    }
    if shape.keep_isolated {
        borders.extend(isolated(grid, progress)?.into_iter().map(|(col, row)| around(grid, col, row)));
    }
    if borders.is_empty() {
        return Err(Error::input(
            "no-area",
            "the valid pixels span no area: a TIN needs three neighbouring ones that are not on a line",
        ));
    }
    Ok(borders)
}

/// The valid pixels that belong to no cell.
fn isolated<T: Height>(grid: &Grid<T>, progress: &mut Progress) -> Result<Vec<(usize, usize)>> {
    let cells = grid.cols() - 1;
    let (mut above, mut below) = (vec![0u8; cells], Vec::new());
    let mut found = Vec::new();
    for row in 0..grid.rows() {
        progress.poll(cells, || row as f64 / grid.rows() as f64)?;
        if row + 1 < grid.rows() {
            cell_row(grid, row, &mut below);
        } else {
            below.fill(0);
        }
        for col in (0..grid.cols()).filter(|&col| grid.is_valid(col, row)) {
            let around = col.saturating_sub(1)..(col + 1).min(cells);
            if above[around.clone()].iter().chain(&below[around]).all(|&cell| cell == 0) {
                found.push((col, row));
            }
        }
        std::mem::swap(&mut above, &mut below);
    }
    Ok(found)
}

/// A ring half a pixel around the centre, as far as the raster reaches.
fn around<T: Height>(grid: &Grid<T>, col: usize, row: usize) -> Vec<Point> {
    let Point { x, y } = Point::pixel(col, row);
    let corner = Point::pixel(grid.cols() - 1, grid.rows() - 1);
    let half = UNIT / 2;
    let mut ring: Vec<Point> = [(-half, 0), (0, -half), (half, 0), (0, half), (-half, 0)]
        .map(|(dx, dy)| Point { x: (x + dx).clamp(0, corner.x), y: (y + dy).clamp(0, corner.y) })
        .to_vec();
    ring.dedup();
    ring
}

/// Corners of a cell in positive order.
const CORNERS: [(usize, usize); 4] = [(0, 0), (1, 0), (1, 1), (0, 1)];

/// The border of the cell complex, cut at the pixels where it touches itself.
/// Points in the middle of straight runs are left out.
pub fn trace<T: Height>(grid: &Grid<T>, progress: &mut Progress) -> Result<Vec<Chain>> {
    Ok(chain_up(border_steps(grid, progress)?, grid.cols() as u64))
}

/// Bits 0-3: the valid corners of each cell of a row of cells; 0 for a cell with
/// fewer than three.
fn cell_row<T: Height>(grid: &Grid<T>, row: usize, cells: &mut Vec<u8>) {
    let (upper, lower) = (grid.row(row), grid.row(row + 1));
    let bit = |z: T| u8::from(!z.to_f64().is_nan());
    cells.clear();
    cells.extend(upper.windows(2).zip(lower.windows(2)).map(|(u, l)| {
        let mask = bit(u[0]) | bit(u[1]) << 1 | bit(l[1]) << 2 | bit(l[0]) << 3;
        if mask.count_ones() >= 3 {
            mask
        } else {
            0
        }
    }));
}

/// Directed steps between neighbouring pixels (as raster indices) along the border.
fn border_steps<T: Height>(grid: &Grid<T>, progress: &mut Progress) -> Result<Vec<(u64, u64)>> {
    let cells = grid.cols() - 1;
    let (mut above, mut here, mut below) = (vec![0u8; cells], Vec::new(), Vec::new());
    let mut steps = Vec::new();
    cell_row(grid, 0, &mut here);
    for row in 0..grid.rows() - 1 {
        progress.poll(cells, || row as f64 / grid.rows() as f64)?;
        if row + 2 < grid.rows() {
            cell_row(grid, row + 1, &mut below);
        } else {
            below.clear();
            below.resize(cells, 0);
        }
        if steps.capacity() < steps.len() + 4 * cells {
            // Room for all that follows: the steps again, twice as long, and their chains.
            memory::ensure(128 * (steps.len() + 4 * cells))?;
        }
        for col in 0..cells {
            let mask = here[col];
            if mask == 0 {
                continue;
            }
            let left = if col > 0 { here[col - 1] } else { 0 };
            let right = if col + 1 < cells { here[col + 1] } else { 0 };
            // Neighbours across the sides that start at corners 0, 1, 2, 3.
            let across = [above[col], right, below[col], left];
            if mask == 15 && !across.contains(&0) {
                continue;
            }
            let index = |k: usize| {
                let (dx, dy) = CORNERS[k % 4];
                ((row + dy) * grid.cols() + col + dx) as u64
            };
            for (k, &beyond) in across.iter().enumerate() {
                let (from, to) = (mask >> k & 1 != 0, mask >> ((k + 1) % 4) & 1 != 0);
                if from && to && beyond == 0 {
                    steps.push((index(k), index(k + 1)));
                } else if from && !to {
                    steps.push((index(k), index(k + 2)));
                }
            }
        }
        std::mem::swap(&mut above, &mut here);
        std::mem::swap(&mut here, &mut below);
    }
    steps.sort_unstable();
    Ok(steps)
}

fn chain_up(steps: Vec<(u64, u64)>, cols: u64) -> Vec<Chain> {
    let place = |index: u64| ((index % cols) as i32, (index / cols) as i32);
    let first_from = |index: u64| steps.partition_point(|s| s.0 < index);
    let is_node = |i: usize| {
        steps.get(i + 1).is_some_and(|s| s.0 == steps[i].0) || i > 0 && steps[i - 1].0 == steps[i].0
    };
    let mut used = vec![false; steps.len()];
    let mut chains = Vec::new();
    // First the chains that leave nodes, then the rings without any.
    for rings in [false, true] {
        for start in 0..steps.len() {
            if used[start] || (!rings && !is_node(start)) {
                continue;
            }
            let mut chain = vec![place(steps[start].0)];
            let mut i = start;
            loop {
                used[i] = true;
                push_straight(&mut chain, place(steps[i].1));
                i = first_from(steps[i].1);
                if used[i] || is_node(i) {
                    break;
                }
            }
            if rings {
                straighten_start(&mut chain);
            }
            chains.push(chain);
        }
    }
    chains
}

fn is_straight(a: (i32, i32), b: (i32, i32), c: (i32, i32)) -> bool {
    let (ux, uy) = (i64::from(b.0 - a.0), i64::from(b.1 - a.1));
    let (vx, vy) = (i64::from(c.0 - b.0), i64::from(c.1 - b.1));
    ux * vy == uy * vx && ux * vx + uy * vy > 0
}

fn push_straight(chain: &mut Chain, p: (i32, i32)) {
    if let [.., a, b] = chain[..] {
        if is_straight(a, b, p) {
            chain.pop();
        }
    }
    chain.push(p);
}

/// Drops the start of a ring if the ring runs straight through it.
fn straighten_start(ring: &mut Chain) {
    if let [start, second, .., last, _] = ring[..] {
        if is_straight(last, start, second) {
            ring.pop();
            ring[0] = last;
        }
    }
}
