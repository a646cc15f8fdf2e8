//! How far a fit should follow the smoothed image rather than the data.

use crate::curve::scramble;
use crate::error::Result;
use crate::fit::{stand, unit_of};
use crate::grid::{Grid, Height};
use crate::memory;
use crate::normal::{Scratch, Systems};
use crate::predicate::Point;
use crate::progress::Progress;
use crate::scale::{gaussian, reach};
use crate::share::{Image, Share};
use crate::surface::Surface;
use crate::threads::{chunks, spread};
use crate::window::Window;

/// A vertex that was placed by looking at the data costs more degrees of freedom
/// than its height (Friedman 1991 charges 2 to 4 for such a knot).
const KNOT_COST: f64 = 2.0;

/// Of a raster of more pixels blocks are looked at, about this share of it: one number is sought, and they tell it to
/// a few hundredths,
const ENOUGH_PIXELS: usize = 1 << 18;
const SHARE: usize = 32;
/// if they are from all over it, by turns from the left half and the right,
const FEWEST: usize = 2;
/// many times as high as a triangle, and so many rows at least,
const TRIANGLES: f64 = 28.0;
const ROWS: usize = 64;
/// and hold so many triangles.
const ENOUGH_TRIANGLES: usize = 1 << 12;

/// An image that is going to be fitted.
pub struct Blend<'a, T> {
    pub data: Grid<'a, T>,
    /// The same smoothed by `sigma` = [x, y] pixels.
    pub smooth: &'a [T],
    pub sigma: [f64; 2],
    /// Standard deviation of the noise in `data`.
    pub noise: f64,
}

impl<T: Height> Blend<'_, T> {
    /// The share s in [0, 1] of the smoothed image at which the unbiased estimate of the risk
    /// (Stein 1981) is least. With P the projection onto the surfaces over the mesh, G the
    /// smoothing and y the data, the fit is P (y - s (y - G y)), and the risk is least
    /// at s = noise^2 tr(P (I - G)) / |P (I - G) y|^2, the trace estimated as
    /// p' P (I - G) p with a random p of independent signs (Hutchinson 1989) and charged at the
    /// cost of knots. Errors: `out-of-memory`, `cancelled`.
    pub fn share(&self, surface: &Surface, progress: &mut Progress) -> Result<f64> {
        let (rows, cols) = (self.data.rows(), self.data.cols());
        let blocks = blocks(rows, cols, surface.z.len());
        let parts = spread(progress, blocks.into_iter(), |block, _| Ok((between(surface, block), block)))?;
        let triangles: usize = parts.iter().map(|(part, _)| part.mesh.triangles().len()).sum();
        let (mut energy, mut trace) = (0.0, 0.0);
        if triangles < ENOUGH_TRIANGLES {
            let whole = Window { col: 0, row: 0, cols, rows };
            (energy, trace) = self.look_at(whole, surface, progress)?;
        } else {
            for (part, block) in parts {
                let (of_part, traced) = self.look_at(block, &part, progress)?;
                (energy, trace) = (energy + of_part, trace + traced);
            }
        }
        let share = KNOT_COST * self.noise * self.noise * trace / energy;
        Ok(if share.is_nan() { 0.0 } else { share.clamp(0.0, 1.0) })
    }

    /// |P (I - G) y|^2 and p' P (I - G) p over a surface within a window.
    fn look_at(&self, window: Window, surface: &Surface, progress: &mut Progress) -> Result<(f64, f64)> {
        let unit = unit_of(surface);
        let image = Probed::new(self, window, 1.0 / unit, progress)?;
        let shares = spread(progress, chunks(surface.mesh.triangles().len()), |chunk, progress| {
            progress.poll(64 * chunk.len(), || 0.0)?;
            Ok(chunk.map(|t| Share::of(surface, t as u32, &image)).collect::<Vec<_>>())
        })?;
        let at = |v: usize| match surface.mesh.point(v as u32).as_pixel() {
            Some((col, row)) if self.data.is_valid(col, row) => {
                image.pixels(row, col, col + 1).next().unwrap_or_default()
            }
            _ => [0.0 * stand(surface, &self.data, v), 0.0, 0.0],
        };
        let (mut systems, mut scratch) = (Systems::default(), Scratch::<2>::default());
        systems.assemble(surface, at, &shares.concat(), progress)?;
        // The projections of what is smoothed away, and of that of the probe.
        let changes = systems.solve(0.0, &mut scratch, progress)?;
        let products = changes.zip(&systems.sides).map(|(x, side)| [x[0] * side[0], x[1] * side[2]]);
        let [energy, trace] =
            products.fold([0.0; 2], |sum, [energy, trace]| [sum[0] + energy, sum[1] + trace]);
        Ok((energy * (unit * unit), trace))
    }
}

/// Windows that stand for a raster; none if all of it has to be looked at.
fn blocks(rows: usize, cols: usize, vertices: usize) -> Vec<Window> {
    let triangle = ((rows * cols) as f64 / vertices.max(1) as f64).sqrt();
    let height = ROWS.max((TRIANGLES * triangle) as usize);
    let count = (2 * rows / SHARE / height).max(FEWEST);
    if rows * cols <= ENOUGH_PIXELS || count * height > rows || height > cols {
        return Vec::new();
    }
    let block = |i: usize| {
        let row = (2 * i + 1) * rows / (2 * count) - height / 2;
        let (col, end) = if i.is_multiple_of(2) { (0, cols / 2) } else { (cols / 2, cols) };
        Window { col, row, cols: end - col, rows: height }
    };
    (0..count).map(block).collect()
}

/// The triangles that lie within a window.
fn between(surface: &Surface, Window { col, row, cols, rows }: Window) -> Surface {
    let (first, last) = (Point::pixel(col, row), Point::pixel(col + cols - 1, row + rows - 1));
    let mesh = &surface.mesh;
    let is_in = |v: u32| {
        let p = mesh.point(v);
        (first.y..=last.y).contains(&p.y) & (first.x..=last.x).contains(&p.x)
    };
    let is_between = |&t: &u32| mesh.triangle(t).v.into_iter().all(is_in);
    let members: Vec<u32> = (0..mesh.triangles().len() as u32).filter(is_between).collect();
    // One more than their numbers: most are never looked at, and zeros come without being written.
    let mut numbers = vec![0u32; mesh.triangles().len()];
    (1..).zip(&members).for_each(|(number, &t)| numbers[t as usize] = number);
    let (part, _) = surface.part(&members, |t| numbers[t as usize].checked_sub(1));
    part
}

/// A window of an image with a random one beside it.
struct Probed<'a, T: Height> {
    blend: &'a Blend<'a, T>,
    /// Inverse of the unit of heights.
    scale: f64,
    /// The pixels that `probe` has.
    window: Window,
    probe: Vec<T>,
    smooth_probe: Vec<T>,
}

impl<'a, T: Height> Probed<'a, T> {
    fn new(blend: &'a Blend<'a, T>, window: Window, scale: f64, progress: &mut Progress) -> Result<Self> {
        // As far beyond as the kernel reaches.
        let within = |first: usize, count: usize, sigma: f64, most: usize| {
            let start = first.saturating_sub(reach(sigma));
            (start, (first + count + reach(sigma)).min(most) - start)
        };
        let (col, cols) = within(window.col, window.cols, blend.sigma[0], blend.data.cols());
        let (row, rows) = within(window.row, window.rows, blend.sigma[1], blend.data.rows());
        memory::ensure(size_of::<T>() * rows * cols)?;
        let sign = |i: u64| if scramble(i) & 1 == 0 { 1.0 } else { -1.0 };
        let mut probe = Vec::with_capacity(rows * cols);
        for row in row..row + rows {
            let first = row * blend.data.cols() + col;
            // Void where the data are.
            let known = (first as u64..).zip(&blend.data.z()[first..first + cols]);
            probe.extend(known.map(|(i, z)| T::from_f64(sign(i) + 0.0 * z.to_f64())));
        }
        let grid = Grid::new(&probe, rows, cols)?;
        let smooth_probe = gaussian(&grid, blend.sigma, progress)?.into_owned();
        Ok(Probed { blend, scale, window: Window { col, row, cols, rows }, probe, smooth_probe })
    }
}

impl<T: Height> Image<3> for Probed<'_, T> {
    /// What smoothing removes of each pixel and of the probe there, and the probe.
    #[inline(always)]
    fn pixels(&self, row: usize, first: usize, end: usize) -> impl Iterator<Item = [f64; 3]> {
        let start = row * self.blend.data.cols();
        let pixels = start + first..start + end;
        let start = (row - self.window.row) * self.window.cols;
        let held = start + first - self.window.col..start + end - self.window.col;
        let data = self.blend.data.z()[pixels.clone()].iter().zip(&self.blend.smooth[pixels]);
        let probe = self.probe[held.clone()].iter().zip(&self.smooth_probe[held]);
        data.zip(probe).map(|((height, smooth), (probe, smooth_probe))| {
            let [height, probe] = [height, probe].map(|value| value.to_f64());
            [(height - smooth.to_f64()) * self.scale, probe - smooth_probe.to_f64(), probe]
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_are_apart_and_within_the_raster() {
        for (rows, cols, vertices) in
            [(1025, 4096, 160_000), (4096, 4096, 40_000), (10812, 10812, 900_000), (600, 60000, 3_000_000)]
        {
            let blocks = blocks(rows, cols, vertices);
            assert!(blocks.len() >= FEWEST);
            assert!(blocks.iter().all(|b| b.row + b.rows <= rows && b.col + b.cols <= cols));
            assert!(blocks.windows(2).all(|pair| pair[0].row + pair[0].rows <= pair[1].row));
            let looked_at: usize = blocks.iter().map(|b| b.rows * b.cols).sum();
            let all = rows * cols;
            assert!(looked_at * SHARE * 2 > all && looked_at * 2 <= all, "{rows} {cols}: {looked_at}");
        }
        assert!(blocks(512, 512, 50_000).is_empty() && blocks(10812, 10812, 3000).is_empty());
    }
}
