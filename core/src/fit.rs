//! Heights by least squares.

use crate::error::Result;
use crate::grid::{extent, Grid, Height};
use crate::lanes::{Vectors, LANES};
use crate::memory;
use crate::mesh::{next, triangle_of, Mesh};
use crate::normal::{Scratch, Systems};
use crate::order::runs;
use crate::patch::Patch;
use crate::predicate::Point;
use crate::progress::Progress;
use crate::scan::Plane;
use crate::share::{owned, Residual, Share};
use crate::shares::Shares;
use crate::surface::Surface;
use crate::threads::{chunks, spread};
use std::ops::Range;

/// What single precision may be off, as a part of the range of heights.
const ROUNDING: f64 = 1.0 / (1 << 22) as f64;

/// Heights below have not the precision left that a fit could use.
const COARSE: f64 = 1e-290;

/// The same of heights that all lie near one, as a part of that.
const FINEST: f64 = 1.0 / (1u64 << 44) as f64;

/// A mesh and the image that its heights are to fit.
pub struct Fit {
    /// What each triangle adds to the normal equations, as long as the vertices have these heights.
    shares: Vec<Share<1>>,
    z: Vec<f64>,
    /// The image's height where each vertex stands, NaN for scaffolding.
    stands: Vec<f64>,
    /// Of the image.
    pixels: f64,
    /// Heights in shares are in this unit, so that single precision holds their squares.
    unit: f64,
    /// Triangles that are worked on together.
    runs: Vec<Range<usize>>,
    systems: Systems<1>,
    scratch: Scratch<1>,
}

impl Fit {
    /// Errors: `out-of-memory`, `cancelled`.
    pub fn of<T: Height>(surface: &Surface, target: &Grid<T>, progress: &mut Progress) -> Result<Self> {
        let count = surface.mesh.triangles().len();
        memory::ensure(count * size_of::<Share<1>>() + 2 * size_of_val(&surface.z[..]))?;
        // By themselves, so that the processor waits for many far-away pixels at once.
        let stands = spread(progress, chunks(surface.z.len()), |chunk, progress| {
            progress.poll(4 * chunk.len(), || 0.0)?;
            Ok(chunk.map(|v| stand(surface, target, v)).collect::<Vec<_>>())
        })?;
        let (stands, z, runs) = (stands.concat(), surface.z.clone(), runs(&surface.mesh));
        let shares = vec![Share::NONE; count];
        let (unit, pixels) = (unit_of(surface), (target.rows() * target.cols()) as f64);
        let mut fit = Fit {
            shares,
            z,
            stands,
            pixels,
            unit,
            runs,
            systems: Systems::default(),
            scratch: Scratch::default(),
        };
        fit.renew(surface, target, &vec![true; count], progress)?;
        Ok(fit)
    }

    /// Takes in the triangles that have changed. Errors: `cancelled`.
    pub fn renew<T: Height>(
        &mut self,
        surface: &Surface,
        target: &Grid<T>,
        is_changed: &[bool],
        progress: &mut Progress,
    ) -> Result<()> {
        let (unit, vectors, stands) = (self.unit, Vectors::best(), std::mem::take(&mut self.stands));
        self.for_each_run(progress, |run, shares| {
            let is_data = |t: u32| !surface.mesh.triangle(t).is_void();
            let range = run.start as u32..run.end as u32;
            let changed: Vec<u32> = range.filter(|&t| is_changed[t as usize] && is_data(t)).collect();
            let corners = |t: u32| (surface.mesh.corners(t), surface.heights(t));
            let by_rows = |t: u32| {
                let ((p, z), owned) = (corners(t), owned(surface, t));
                Share::by_rows(p, owned, &Residual { target, plane: Plane::through(p, z), scale: 1.0 / unit })
            };
            let patch = patch_of(surface, &changed, target);
            let mut eight = Shares::default();
            for triangles in changed.chunks(LANES) {
                let seen = match &patch {
                    Some(patch) => {
                        for &t in triangles {
                            let ((p, z), v) = (corners(t), surface.mesh.triangle(t).v);
                            let stands = v.map(|v| stands[v as usize]);
                            eight.push(p, [z, stands], owned(surface, t));
                        }
                        eight.take(patch, unit, vectors)
                    }
                    None => [None; LANES],
                };
                for (&t, seen) in triangles.iter().zip(seen) {
                    shares[t as usize - run.start] = seen.unwrap_or_else(|| by_rows(t));
                }
            }
        })?;
        self.stands = stands;
        Ok(())
    }

    /// Takes in the heights that the vertices have got. Errors: `cancelled`.
    pub fn follow(&mut self, surface: &Surface, progress: &mut Progress) -> Result<()> {
        let (old, scale) = (std::mem::take(&mut self.z), 1.0 / self.unit);
        self.for_each_run(progress, |run, shares| {
            let triangles = &surface.mesh.triangles()[run.clone()];
            for (share, triangle) in
                shares.iter_mut().zip(triangles).filter(|(_, triangle)| !triangle.is_void())
            {
                share.follow(triangle.v.map(|v| ((surface.z[v as usize] - old[v as usize]) * scale) as f32));
            }
        })?;
        self.z = old;
        self.z.copy_from_slice(&surface.z);
        Ok(())
    }

    /// Moves the free vertices to the heights with the least sum of squared differences
    /// between the surface and the pixels, where there is more than a ten-thousandth of it to gain. Errors:
    /// `out-of-memory`, `cancelled`.
    pub fn solve(&mut self, surface: &mut Surface, progress: &mut Progress) -> Result<()> {
        if self.unit < COARSE {
            return Ok(());
        }
        let (unit, scale) = (self.unit, 1.0 / self.unit);
        let over = |v: usize| [(self.stands[v] - surface.z[v]) * scale];
        self.systems.assemble(surface, over, &self.shares, progress)?;
        let (low, high) = extent(&surface.z);
        let rounding = (ROUNDING * (high - low).max(0.0) + FINEST * low.abs().max(high.abs())) * scale;
        let changes = self.systems.solve(self.pixels * rounding * rounding, &mut self.scratch, progress)?;
        surface.z.iter_mut().zip(changes).for_each(|(z, [change])| *z += change * unit);
        Ok(())
    }

    /// What is known of the errors on both sides of an edge, as [`Quads`](crate::quads::Quads) have it.
    #[inline(always)]
    pub fn beside(&self, mesh: &Mesh, h: u32) -> ([f64; 2], [f64; 2]) {
        let twin = mesh.twin(h);
        let (left, right) = (&self.shares[triangle_of(h) as usize], &self.shares[triangle_of(twin) as usize]);
        let side = |share: &Share<1>, h: u32| f64::from(share.sides[(h & 3) as usize][0]);
        let origin = side(left, h) + side(right, next(twin));
        let dest = side(left, next(h)) + side(right, twin);
        let squares = [right, left].map(|share| f64::from(share.squares[0]) * (self.unit * self.unit));
        ([origin * self.unit, dest * self.unit], squares)
    }

    fn for_each_run(
        &mut self,
        progress: &mut Progress,
        work: impl Fn(&Range<usize>, &mut [Share<1>]) + Sync,
    ) -> Result<()> {
        let count = self.shares.len();
        let mut rest = &mut self.shares[..];
        let mut parts = Vec::with_capacity(self.runs.len());
        for run in &self.runs {
            let (part, others) = rest.split_at_mut(run.len());
            parts.push((run, part));
            rest = others;
        }
        spread(progress, parts.into_iter(), |(run, shares), progress| {
            work(run, shares);
            progress.poll(32 * run.len(), || run.start as f64 / count as f64)
        })?;
        Ok(())
    }
}

/// The power of two next to the largest |height|.
pub fn unit_of(surface: &Surface) -> f64 {
    let (low, high) = extent(&surface.z);
    let largest = low.abs().max(high.abs());
    if largest > 0.0 && low <= high {
        largest.log2().floor().max(-1000.0).exp2()
    } else {
        1.0
    }
}

/// The heights under some triangles.
fn patch_of<T: Height>(surface: &Surface, triangles: &[u32], target: &Grid<T>) -> Option<Patch> {
    let [reference, ..] = surface.heights(*triangles.first()?);
    Patch::near(target, triangles.iter().map(|&t| surface.mesh.corners(t)), reference)
}

/// The height of the image where vertex `v` stands, NaN for scaffolding: lest it is seen by hardly any pixel and
/// flies off.
pub fn stand<T: Height>(surface: &Surface, target: &Grid<T>, v: usize) -> f64 {
    let (p, z): (Point, f64) = (surface.mesh.points()[v], surface.z[v]);
    let here = p.as_pixel().map_or(f64::NAN, |(col, row)| target.at(col, row));
    let is_known = !here.is_nan() || z.is_nan();
    if is_known {
        here + 0.0 * z
    } else {
        target.interpolate(p)
    }
}
