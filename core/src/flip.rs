//! Edge flips that lower the squared error.

use crate::error::Result;
use crate::fit::Fit;
use crate::grid::{Grid, Height};
use crate::lanes::Vectors;
use crate::memory;
use crate::mesh::{half_edge, triangle_of, Mesh, NONE};
use crate::patch::Patch;
use crate::progress::Progress;
use crate::pyramid::{Pyramid, Quad};
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

/// Half-edges by run of triangles.
fn by_run(mut edges: Vec<u32>, runs: &[Range<usize>]) -> Vec<Vec<u32>> {
    edges.sort_unstable();
    let mut rest = &edges[..];
    let mut parts = Vec::new();
    for run in runs {
        let (part, others) = rest.split_at(rest.partition_point(|&h| (triangle_of(h) as usize) < run.end));
        parts.extend(Some(part).filter(|part| !part.is_empty()).map(<[u32]>::to_vec));
        rest = others;
    }
    parts
}

/// Corners of the quadrilateral around an edge, from the origin of the edge on.
#[inline(always)]
fn corners(mesh: &Mesh, h: u32) -> [u32; 4] {
    [mesh.origin(h), mesh.apex(mesh.twin(h)), mesh.dest(h), mesh.apex(h)]
}

/// The edges among these whose flip lowers the squared error, and by how much, the best first.
fn gains<T: Height>(
    surface: &Surface,
    target: &Grid<T>,
    fit: Option<&Fit>,
    edges: &[u32],
) -> Vec<(f64, u32)> {
    let mesh = &surface.mesh;
    let quad = |h: u32| {
        let v = corners(mesh, h);
        Quad::new(v.map(|v| mesh.point(v)), v.map(|v| surface.z[v as usize]))
    };
    let may_gain = |&h: &u32| {
        let quad = quad(h);
        quad.is_convex() & fit.is_none_or(|fit| quad.may_gain(fit.beside(mesh, h)))
    };
    let candidates = chosen(edges.len(), edges.iter().copied(), may_gain);
    let quads: Vec<(Quad, u32)> = candidates.into_iter().map(|h| (quad(h), h)).collect();
    let Some((first, _)) = quads.first() else { return Vec::new() };
    let patch = Patch::near(target, quads.iter().map(|(quad, _)| quad.p), first.z[0]);
    let vectors = Vectors::best();
    let gain = |quad: &Quad| Pyramid::over(quad).gain(target, patch.as_ref(), vectors);
    let mut gains: Vec<_> = quads.iter().filter_map(|(quad, h)| Some((gain(quad)?, *h))).collect();
    gains.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    gains
}

/// Looks at every edge of the triangles that are open, and flips those whose flip lowers the sum of squared errors
/// against `target`, the best first; where the flip of a neighbour was better, the edge is looked at once more.
/// `runs`: of triangles that are near each other. `fit`, if there is one, tells without a look at the pixels which flips
/// cannot gain. Returns the number of flips, and marks the triangles that have changed as open, no others; the mesh is
/// then no longer Delaunay. Errors: `out-of-memory`, `cancelled`.
pub fn flip_pass<T: Height>(
    surface: &mut Surface,
    target: &Grid<T>,
    runs: &[Range<usize>],
    fit: Option<&Fit>,
    is_open: &mut [bool],
    progress: &mut Progress,
) -> Result<usize> {
    memory::ensure(24 * is_open.len())?;
    let mut open = edges(&surface.mesh, runs, is_open, progress)?;
    let mut is_new = vec![false; is_open.len()];
    // What it tells is known of the mesh as it was.
    let mut fit = fit;
    let mut changed = Vec::new();
    while !open.is_empty() {
        let gains = spread(progress, open.iter(), |edges, progress| {
            progress.poll(64 * edges.len(), || 0.0)?;
            Ok(gains(surface, target, fit, edges))
        })?;
        let (first, mut again) = (changed.len(), Vec::new());
        for (_, h) in gains.into_iter().flatten() {
            let pair = [h, surface.mesh.twin(h)].map(triangle_of);
            if pair.iter().any(|&t| is_new[t as usize]) {
                again.push(h);
            } else {
                surface.mesh.flip(h);
                pair.iter().for_each(|&t| is_new[t as usize] = true);
                changed.extend(pair);
            }
        }
        // Half-edges next to a flip have become those of other edges.
        again.retain(|&h| is_free(&surface.mesh, h));
        open = by_run(again, runs);
        fit = None;
        changed[first..].iter().for_each(|&t| is_new[t as usize] = false);
    }
    is_open.fill(false);
    changed.iter().for_each(|&t| is_open[t as usize] = true);
    Ok(changed.len() / 2)
}
