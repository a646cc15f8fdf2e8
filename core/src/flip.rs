//! Edge flips that lower the squared error.

use crate::error::Result;
use crate::fit::Fit;
use crate::grid::{Grid, Height};
use crate::lanes::{Vectors, LANES};
use crate::memory;
use crate::mesh::{half_edge, triangle_of, Mesh, NONE};
use crate::patch::Patch;
use crate::predicate::orient2d;
use crate::progress::Progress;
use crate::pyramid;
use crate::quads::Quads;
use crate::surface::Surface;
use crate::threads::spread;
use std::ops::Range;

/// Whether an edge lies within the data and is not constrained.
fn is_free(mesh: &Mesh, h: u32) -> bool {
    mesh.twin(h) != NONE && !mesh.is_constrained(h) && !mesh.triangle(triangle_of(h)).is_void()
}

/// The edges of the marked triangles that may be flipped, as the higher of their half-edges, ascending; by
/// run of triangles.
fn edges(
    mesh: &Mesh,
    runs: &[Range<usize>],
    is_marked: &[bool],
    progress: &mut Progress,
) -> Result<Vec<Vec<u32>>> {
    spread(progress, runs.iter(), |run, progress| {
        progress.poll(8 * run.len(), || 0.0)?;
        let half_edges = (run.start as u32..run.end as u32).flat_map(|t| [0, 1, 2].map(|k| half_edge(t, k)));
        let is_open = |&h: &u32| {
            let (t, twin) = (triangle_of(h) as usize, mesh.twin(h));
            let beyond = is_marked.get(triangle_of(twin) as usize).copied().unwrap_or(false);
            (h > twin) & is_free(mesh, h) & (is_marked[t] | beyond)
        };
        Ok(chosen(3 * run.len(), half_edges, is_open))
    })
}

/// Those of at most `most` half-edges that are wanted. Where that can not be foreseen, a branch would mostly be mistaken.
fn chosen(most: usize, edges: impl Iterator<Item = u32>, is_wanted: impl Fn(&u32) -> bool) -> Vec<u32> {
    let (mut chosen, mut count) = (vec![0; most], 0);
    for h in edges {
        let wanted = is_wanted(&h);
        if let Some(place) = chosen.get_mut(count) {
            *place = h;
            count += usize::from(wanted);
        }
    }
    chosen.truncate(count);
    chosen
}

/// Corners of the quadrilateral around an edge, from the origin of the edge on.
#[inline(always)]
fn corners(mesh: &Mesh, h: u32) -> [u32; 4] {
    [mesh.origin(h), mesh.apex(mesh.twin(h)), mesh.dest(h), mesh.apex(h)]
}

/// Whether the quadrilateral around an edge is strictly so.
fn is_convex(mesh: &Mesh, h: u32) -> bool {
    let [a, b, c, d] = corners(mesh, h).map(|v| mesh.point(v));
    orient2d(d, a, b) > 0 && orient2d(d, b, c) > 0
}

/// The edges among these whose flip lowers the squared error, and by how much, the best first.
fn gains<T: Height>(
    surface: &Surface,
    target: &Grid<T>,
    fit: Option<&Fit>,
    edges: &[u32],
) -> Vec<(f64, u32)> {
    let mesh = &surface.mesh;
    let around = |h: u32| {
        let v = corners(mesh, h);
        (v.map(|v| mesh.point(v)), v.map(|v| surface.z[v as usize]))
    };
    let (vectors, mut quads) = (Vectors::best(), Quads::default());
    let (mut candidates, mut count) = (vec![0; edges.len() + 1], 0);
    for edges in edges.chunks(LANES) {
        quads.clear();
        for &h in edges {
            let (p, z) = around(h);
            quads.push(p, z);
            if let Some(fit) = fit {
                let (ends, squares) = fit.beside(mesh, h);
                quads.know(ends, squares);
            }
        }
        let may = quads.may_gain(vectors);
        // Which ones can not be foreseen: no branch.
        for (i, &h) in edges.iter().enumerate() {
            candidates[count] = h;
            count += (may >> i & 1) as usize;
        }
    }
    candidates.truncate(count);
    let Some(&first) = candidates.first() else { return Vec::new() };
    let patch = Patch::near(target, candidates.iter().map(|&h| around(h).0), around(first).1[0]);
    let mut gains = Vec::new();
    for candidates in candidates.chunks(LANES) {
        quads.clear();
        for &h in candidates {
            let (p, z) = around(h);
            quads.push(p, z);
        }
        let gained = pyramid::gains(&quads, target, patch.as_ref(), vectors);
        gains.extend(gained.into_iter().zip(candidates).filter_map(|(gain, &h)| Some((gain?, h))));
    }
    gains.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    gains
}

/// Looks at every edge of the triangles that are open, and flips those whose flip lowers the sum of squared errors
/// against `target`, of one run of triangles the best first; next to a flip no other one is made. `runs`: of triangles that are near
/// each other. `fit`, if there is one, tells without a look at the pixels which flips cannot gain. Returns the number of
/// flips, and marks the triangles that have changed as open, no others; the mesh is then no longer Delaunay. Errors:
/// `out-of-memory`, `cancelled`.
pub fn flip_pass<T: Height>(
    surface: &mut Surface,
    target: &Grid<T>,
    runs: &[Range<usize>],
    fit: Option<&Fit>,
    is_open: &mut [bool],
    progress: &mut Progress,
) -> Result<usize> {
    memory::ensure(24 * is_open.len())?;
    let open = edges(&surface.mesh, runs, is_open, progress)?;
    let gains = spread(progress, open.iter(), |edges, progress| {
        progress.poll(64 * edges.len(), || 0.0)?;
        Ok(gains(surface, target, fit, edges))
    })?;
    is_open.fill(false);
    let mut count = 0;
    for (_, h) in gains.into_iter().flatten() {
        let here = triangle_of(h) as usize;
        if is_open[here] {
            // It may be the number of another edge now.
            continue;
        }
        let beyond = triangle_of(surface.mesh.twin(h)) as usize;
        if !is_open[beyond] && is_convex(&surface.mesh, h) {
            surface.mesh.flip(h);
            (is_open[here], is_open[beyond]) = (true, true);
            count += 1;
        }
    }
    Ok(count)
}
