//! Edge flips that lower the squared error.

use crate::error::Result;
use crate::grid::{Grid, Height};
use crate::lanes::Vectors;
use crate::memory;
use crate::mesh::{next, prev, triangle_of, Mesh, NONE};
use crate::moments::{Moments, SquaredErrors};
use crate::owned::{for_each_span, is_first, owns_edge};
use crate::predicate::{orient2d, Point, UNIT};
use crate::progress::Progress;
use crate::sight::{chunks, sum_over, Sight};
use crate::surface::Surface;
use crate::threads::spread;

/// A flip has to gain this part of the squared error.
const LEAST_GAIN: f64 = 1e-9;
/// What rounding may make of a sum of squares, as a part of it.
const ROUNDING: f64 = 1e-13;
/// Edges that are looked at together, and of which the best are flipped first: those of one place.
const CHUNK: usize = 1 << 12;

/// The edges with two sides of the marked triangles, as the lower of their half-edges, ascending.
fn edges(mesh: &Mesh, is_marked: &[bool]) -> Vec<u32> {
    let is_edge = |&h: &u32| {
        let twin = mesh.twin(h);
        h < twin && twin != NONE && [h, twin].iter().any(|&h| is_marked[triangle_of(h) as usize])
    };
    mesh.half_edges().filter(is_edge).collect()
}

/// Looks at every edge of the triangles that are open, and flips those that are not constrained and whose
/// flip lowers the sum of squared errors against `target`, the best first; where the flip of a
/// neighbour was better, the edge is looked at once more. `seen` is what the mesh sees of `target`, and
/// stays so. Returns the number of flips, and marks the triangles that have changed as open, no others;
/// the mesh is then no longer Delaunay. Errors: `out-of-memory`, `cancelled`.
pub fn flip_pass<T: Height>(
    surface: &mut Surface,
    target: &Grid<T>,
    seen: &mut Sight,
    is_open: &mut [bool],
    progress: &mut Progress,
) -> Result<usize> {
    let count = surface.mesh.triangles().len();
    memory::ensure(32 * count)?;
    let mut open = edges(&surface.mesh, is_open);
    let errors = spread(progress, chunks(count), |chunk, progress| {
        progress.poll(16 * chunk.len(), || 0.0)?;
        Ok(chunk.map(|t| error_of(surface, t as u32, &seen.triangles[t])).collect::<Vec<_>>())
    })?;
    let mut errors = errors.concat();
    let mut is_new = vec![false; count];
    let mut changed = Vec::new();
    let all = open.len();
    while !open.is_empty() {
        let gains = spread(progress, open.chunks(CHUNK), |open, progress| {
            progress.poll(64 * open.len(), || 1.0 - open.len() as f64 / all as f64)?;
            let gain = |&h: &u32| Some((gain(surface, target, seen, &errors, h)?, h));
            let mut gains: Vec<_> = open.iter().filter_map(gain).collect();
            gains.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
            Ok(gains)
        })?;
        open.clear();
        let first = changed.len();
        for (_, h) in gains.into_iter().flatten() {
            let pair = [h, surface.mesh.twin(h)].map(triangle_of);
            if pair.iter().any(|&t| is_new[t as usize]) {
                open.push(h);
            } else if flip(surface, target, seen, &mut errors, h).is_some() {
                pair.iter().for_each(|&t| is_new[t as usize] = true);
                changed.extend(pair);
            }
        }
        changed[first..].iter().for_each(|&t| is_new[t as usize] = false);
    }
    is_open.fill(false);
    changed.iter().for_each(|&t| is_open[t as usize] = true);
    Ok(changed.len() / 2)
}

fn error_of(surface: &Surface, t: u32, moments: &Moments<1>) -> f64 {
    if surface.mesh.triangle(t).is_void() {
        return 0.0;
    }
    moments.squared_error(moments.plane(surface.mesh.corners(t), surface.heights(t)))
}

/// An edge between two triangles with data, and what its flip would make of them.
struct Candidate {
    /// The two triangles.
    pair: [usize; 2],
    /// Corners of the quadrilateral, from the origin of the edge on.
    quad: [u32; 4],
    p: [Point; 4],
    /// Twice the areas of the two new triangles, [`NEW`].
    areas: [i64; 2],
    /// The new triangle whose pixels are walked: the smaller one. The other gets what is left.
    walked: usize,
}

/// Corners of the new triangles in the quadrilateral.
const NEW: [[usize; 3]; 2] = [[3, 0, 1], [3, 1, 2]];

impl Candidate {
    /// None if the edge may not be flipped.
    #[inline(always)]
    fn of(mesh: &Mesh, h: u32) -> Option<Self> {
        let twin = mesh.twin(h);
        if twin == NONE || mesh.is_constrained(h) || mesh.triangle(triangle_of(h)).is_void() {
            return None;
        }
        let quad = [mesh.origin(h), mesh.apex(twin), mesh.dest(h), mesh.apex(h)];
        let p = quad.map(|v| mesh.point(v));
        let areas = NEW.map(|corners| orient2d(p[corners[0]], p[corners[1]], p[corners[2]]));
        let pair = [triangle_of(h), triangle_of(twin)].map(|t| t as usize);
        let walked = usize::from(areas[1] < areas[0]);
        (areas[0] > 0 && areas[1] > 0).then_some(Candidate { pair, quad, p, areas, walked })
    }

    /// A new triangle and the heights of its corners.
    #[inline(always)]
    fn corners(&self, k: usize, z: &[f64]) -> ([Point; 3], [f64; 3]) {
        (NEW[k].map(|corner| self.p[corner]), NEW[k].map(|corner| z[self.quad[corner] as usize]))
    }

    /// The edges whose pixels the walked triangle owns; `h` is still the edge to flip.
    #[inline(always)]
    fn owned(&self, mesh: &Mesh, h: u32) -> [bool; 3] {
        let twin = mesh.twin(h);
        match self.walked {
            0 => [owns_edge(mesh, prev(h)), owns_edge(mesh, next(twin)), is_first(self.p[1], self.p[3])],
            _ => [is_first(self.p[3], self.p[1]), owns_edge(mesh, prev(twin)), owns_edge(mesh, next(h))],
        }
    }
}

/// By how much flipping edge `h` lowers the squared error, if it does and is allowed.
#[inline]
fn gain<T: Height>(surface: &Surface, target: &Grid<T>, seen: &Sight, errors: &[f64], h: u32) -> Option<f64> {
    let Surface { mesh, z, .. } = surface;
    let candidate = Candidate::of(mesh, h)?;
    let now: f64 = candidate.pair.map(|t| errors[t]).iter().sum();
    if is_hopeless(candidate.p, candidate.quad.map(|v| z[v as usize]), candidate.areas, now) {
        return None;
    }
    let pair = candidate.pair.map(|t| &seen.triangles[t]);
    let (p, heights) = candidate.corners(candidate.walked, z);
    let (rest, rest_heights) = candidate.corners(1 - candidate.walked, z);
    let rest_plane = pair[0].plane(rest, rest_heights);
    let mut part = SquaredErrors::of(pair[0], [pair[0].plane(p, heights), rest_plane]);
    for_each_span(p, candidate.owned(mesh, h), |row, first, end| {
        part.add_row(row, first, target.row(row)[first..end].iter().map(|z| z.to_f64()));
    });
    // The plane of the other one over all pixels, less those walked.
    let whole = pair[0].squared_error(rest_plane) + pair[1].squared_error(pair[1].plane(rest, rest_heights));
    let gain = now - part.sums[0] - (whole - part.sums[1]).max(0.0);
    let rounding = ROUNDING * (whole + pair[0].squares[0] + pair[1].squares[0]);
    (gain > LEAST_GAIN * now + rounding).then_some(gain)
}

/// Flips edge `h`, and shares out its pixels anew.
fn flip<T: Height>(
    surface: &mut Surface,
    target: &Grid<T>,
    seen: &mut Sight,
    errors: &mut [f64],
    h: u32,
) -> Option<()> {
    let Surface { mesh, z, .. } = surface;
    let candidate = Candidate::of(mesh, h)?;
    let pair = candidate.pair;
    let both = seen.triangles[pair[0]].plus(&seen.triangles[pair[1]]);
    let (p, _) = candidate.corners(candidate.walked, z);
    let part = sum_over(both.emptied(), p, candidate.owned(mesh, h), target, Vectors::best());
    mesh.flip(h);
    let mut moments = [part, both - part];
    if candidate.walked == 1 {
        moments.swap(0, 1);
    }
    for (k, t) in pair.into_iter().enumerate() {
        let (p, heights) = candidate.corners(k, z);
        seen.triangles[t] = moments[k];
        errors[t] = moments[k].squared_error(moments[k].plane(p, heights));
    }
    Some(())
}

/// Whether no flip of the first diagonal of the quadrilateral can gain. It adds to the surface a
/// pyramid over the four corners, as high as the diagonals are apart where they cross. That gains
/// twice the products of residuals and pyramid, at most the root of the product of both sums
/// of squares, less the pyramid's squares: a third of its height's times its area, halved.
#[inline(always)]
fn is_hopeless(p: [Point; 4], z: [f64; 4], areas: [i64; 2], now: f64) -> bool {
    let [left, right] = areas.map(|area| area as f64);
    let before = [orient2d(p[0], p[1], p[2]), orient2d(p[2], p[3], p[0])].map(|area| area as f64);
    let twice = left + right;
    let apart = (z[0] * right + z[2] * left - z[1] * before[1] - z[3] * before[0]) / twice;
    let area = 0.5 * twice / f64::from(UNIT * UNIT);
    apart * apart * area / 6.0 >= 4.0 * now
}
