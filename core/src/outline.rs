//! The outline of the data: the border between valid pixels and void.
//!
//! The data region is a cell complex: every 2 x 2 block with at least three valid
//! pixels is a square or a half-square. Its border runs through valid pixel
//! centres, is planar by construction, and becomes constrained edges of the mesh;
//! triangles beyond it are void.

use crate::constrain::Constrainer;
use crate::error::{Error, Result};
use crate::grid::{Grid, Height};
use crate::mesh::{half_edge, triangle_of, Mesh, NONE};
use crate::order::insertion_order;
use crate::predicate::{Metric, Point};
use crate::progress::Progress;
use std::collections::HashMap;

/// A directed polyline of pixel centres (column, row), data on its positive side;
/// closed if it ends where it starts.
pub type Chain = Vec<(i32, i32)>;

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

/// The chain with the fewest corners that keeps all data on its positive side and all
/// void pixel centres on the other: it takes in void area, never a void pixel, and
/// strays less than a pixel. No pixel centre lies between it and the exact chain,
/// which is why simplified chains cannot cross each other either.
pub fn simplify(chain: &Chain) -> Chain {
    let corners = if chain.first() == chain.last() { from_extreme(chain) } else { chain.clone() };
    let n = corners.len();
    // Fewest segments from corner 0 to each corner, and the corner before it.
    let mut best = vec![(usize::MAX, 0usize); n];
    best[0].0 = 0;
    for i in 0..n - 1 {
        let count = best[i].0 + 1;
        reach(&corners, i, |j| {
            if count < best[j].0 {
                best[j] = (count, i);
            }
        });
    }
    let mut kept = vec![corners[n - 1]];
    let mut at = n - 1;
    while at > 0 {
        at = best[at].1;
        kept.push(corners[at]);
    }
    kept.reverse();
    kept
}

/// The ring starting at its first corner in (column, row) order, where it must bend.
fn from_extreme(ring: &Chain) -> Chain {
    let open = &ring[..ring.len() - 1];
    let start = (0..open.len()).min_by_key(|&i| open[i]).unwrap_or(0);
    let mut turned: Chain = open[start..].iter().chain(&open[..start]).copied().collect();
    turned.push(turned[0]);
    turned
}

/// Calls `visit(j)` for every corner j > i that a chord from corner i can reach: the
/// corners between are on or left of it, the void pixels beside the chain right of it.
fn reach(corners: &Chain, i: usize, mut visit: impl FnMut(usize)) {
    type Vector = (i64, i64);
    let cross = |u: Vector, v: Vector| u.0 * v.1 - u.1 * v.0;
    let from = |p: (i32, i32)| (i64::from(p.0 - corners[i].0), i64::from(p.1 - corners[i].1));
    // Directions between `void` (excluded) and `data` (included) remain.
    let (mut data, mut void): (Option<Vector>, Option<Vector>) = (None, None);
    for j in i + 1..corners.len() {
        for q in voids_beside(corners[j - 1], corners[j]).map(from) {
            if void.is_none_or(|v| cross(v, q) > 0) {
                void = Some(q);
            }
        }
        let p = from(corners[j]);
        let is_open =
            |v: Vector| void.is_none_or(|q| cross(q, v) > 0) && data.is_none_or(|d| cross(v, d) >= 0);
        if j == i + 1 || is_open(p) {
            visit(j);
        }
        if data.is_none_or(|d| cross(p, d) > 0) {
            data = Some(p);
        }
        if let (Some(d), Some(q)) = (data, void) {
            if cross(q, d) <= 0 {
                return;
            }
        }
    }
}

/// The pixels right of the first and the last step of the straight run from `a` to `b`.
fn voids_beside(a: (i32, i32), b: (i32, i32)) -> [(i32, i32); 2] {
    let (dx, dy) = ((b.0 - a.0).signum(), (b.1 - a.1).signum());
    let (rx, ry) = (dy, -dx);
    if dx == 0 || dy == 0 {
        [(a.0 + rx, a.1 + ry), (b.0 + rx, b.1 + ry)]
    } else {
        [(a.0 + (rx + dx) / 2, a.1 + (ry + dy) / 2), (b.0 + (rx - dx) / 2, b.1 + (ry - dy) / 2)]
    }
}

/// The mesh of the outline alone: every triangle is data or void, the edges
/// between the two are constrained.
///
/// Errors: `no-area` if no three neighbouring valid pixels span an area.
pub fn outline_mesh<T: Height>(grid: &Grid<T>, metric: Metric, progress: &mut Progress) -> Result<Mesh> {
    let chains: Vec<Chain> = trace(grid, progress)?.iter().map(simplify).collect();
    if chains.is_empty() {
        return Err(Error::input(
            "no-area",
            "the valid pixels span no area: a TIN needs three neighbouring ones that are not on a line",
        ));
    }
    let mut mesh = Mesh::rectangle(grid.cols(), grid.rows(), metric);
    let corners: Vec<(i32, i32)> = chains.iter().flatten().copied().collect();
    let points: Vec<Point> = corners.iter().map(|c| Point::pixel(c.0 as usize, c.1 as usize)).collect();
    let mut vertices = HashMap::new();
    for i in insertion_order(&points) {
        let start = mesh.triangles().len() as u32 - 1;
        vertices.entry(corners[i]).or_insert_with(|| mesh.insert(points[i], start));
        progress.poll(256, || 1.0)?;
    }
    let mut signed: HashMap<(u32, u32), i32> = HashMap::new();
    let mut constrainer = Constrainer::new(&mut mesh);
    for segment in chains.iter().flat_map(|chain| chain.windows(2)) {
        let (a, b) = (vertices[&segment[0]], vertices[&segment[1]]);
        let count = |from, to| {
            *signed.entry((from, to)).or_default() += 1;
            *signed.entry((to, from)).or_default() -= 1;
        };
        constrainer.insert(a, b, count).map_err(|crossing| {
            Error::input("outline", format!("the outline of the data crosses itself at {crossing:?}"))
        })?;
    }
    classify(&mut mesh, &signed);
    Ok(mesh)
}

/// Marks the triangles around which the outline does not wind as void.
/// `signed`: how often the outline runs along each directed edge.
fn classify(mesh: &mut Mesh, signed: &HashMap<(u32, u32), i32>) {
    let along = |mesh: &Mesh, h: u32| signed.get(&(mesh.origin(h), mesh.dest(h))).copied().unwrap_or(0);
    let count = mesh.triangles().len() as u32;
    let mut winding: Vec<Option<i32>> = vec![None; count as usize];
    let mut stack = Vec::new();
    for t in 0..count {
        for h in (0..3).map(|k| half_edge(t, k)) {
            if mesh.twin(h) == NONE && winding[t as usize].is_none() {
                winding[t as usize] = Some(along(mesh, h));
                stack.push(t);
            }
        }
    }
    while let Some(t) = stack.pop() {
        for h in (0..3).map(|k| half_edge(t, k)) {
            let twin = mesh.twin(h);
            if twin != NONE && winding[triangle_of(twin) as usize].is_none() {
                winding[triangle_of(twin) as usize] = winding[t as usize].map(|w| w - along(mesh, h));
                stack.push(triangle_of(twin));
            }
        }
    }
    for t in 0..count {
        mesh.set_void(t, winding[t as usize].unwrap_or(0) <= 0);
    }
}
