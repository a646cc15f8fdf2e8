//! Heights by least squares, and edge flips that lower the squared error.

use crate::error::Result;
use crate::grid::{Grid, Height};
use crate::memory;
use crate::mesh::{half_edge, triangle_of, Mesh, NONE};
use crate::predicate::Point;
use crate::progress::Progress;
use crate::scan::for_each_pixel;
use crate::surface::Surface;

/// Conjugate gradients stop when the residual has fallen by this factor.
const REDUCTION: f64 = 1e-4;
const MAX_ITERATIONS: usize = 60;
/// A vertex that was placed by looking at the data costs more degrees of freedom
/// than its height (Friedman 1991 charges 2 to 4 for such a knot).
const KNOT_COST: f64 = 2.0;

/// A set of pixels, one bit each.
pub struct Visited(Vec<u64>);

impl Visited {
    pub fn new(pixels: usize) -> Self {
        Visited(vec![0; pixels.div_ceil(64)])
    }

    /// Adds the pixel; false if it was there.
    #[inline]
    pub fn insert(&mut self, pixel: usize) -> bool {
        let (word, bit) = (&mut self.0[pixel / 64], 1u64 << (pixel % 64));
        let new = *word & bit == 0;
        *word |= bit;
        new
    }
}

/// Normal equations of the hat functions, kept as one symmetric 3 x 3 block a triangle.
struct Normal<'m> {
    mesh: &'m Mesh,
    /// (00, 01, 02, 11, 12, 22) of each triangle.
    blocks: Vec<[f64; 6]>,
    /// Inverse diagonal, 0 for vertices that stay as they are: fixed or without pixels.
    inverse: Vec<f64>,
}

impl<'m> Normal<'m> {
    /// The matrix, and one right-hand side for each of the `K` values a pixel has, the
    /// first being its height less that of the surface.
    /// `value(pixel, height, plane)`: `plane` is the height of the surface.
    fn assemble<T: Height, const K: usize>(
        surface: &'m Surface,
        grid: &Grid<T>,
        progress: &mut Progress,
        value: impl Fn(usize, f64, f64) -> [f64; K],
    ) -> Result<(Self, [Vec<f64>; K])> {
        let (mesh, z) = (&surface.mesh, &surface.z);
        let (vertices, triangles) = (z.len(), mesh.triangles().len());
        memory::ensure(triangles * 48 + vertices * 8 * (K + 6) + grid.z().len() / 8)?;
        let mut seen = Visited::new(grid.z().len());
        let mut blocks = vec![[0.0; 6]; mesh.triangles().len()];
        let mut sides: [Vec<f64>; K] = std::array::from_fn(|_| vec![0.0; z.len()]);
        let mut inverse = vec![0.0; z.len()];
        let count = blocks.len();
        let mut is_seen = vec![false; vertices];
        for (t, m) in blocks.iter_mut().enumerate() {
            let triangle = mesh.triangle(t as u32);
            if triangle.is_void() {
                continue;
            }
            let v = triangle.v.map(|v| v as usize);
            let p = mesh.corners(t as u32);
            let hats = Hats::over(p);
            let mut work = 16;
            let (mut block, mut loads) = ([0.0; 6], [[0.0; 3]; K]);
            for_each_pixel(grid, p, v.map(|v| z[v]), |col, row, height, plane| {
                work += 4;
                let pixel = row * grid.cols() + col;
                if !seen.insert(pixel) {
                    return;
                }
                let hat = hats.at(col, row);
                let [a, b, c] = hat;
                for (sum, product) in block.iter_mut().zip([a * a, a * b, a * c, b * b, b * c, c * c]) {
                    *sum += product;
                }
                for (load, value) in loads.iter_mut().zip(value(pixel, height, plane)) {
                    for (load, hat) in load.iter_mut().zip(hat) {
                        *load += hat * value;
                    }
                }
            });
            // A vertex that stands on no pixel of its own gets the image's height there as
            // an observation, or it might be seen by hardly any pixel and fly off.
            for (k, &v) in v.iter().enumerate().filter(|(_, &v)| !std::mem::replace(&mut is_seen[v], true)) {
                let is_pixel = p[k].as_pixel().is_some_and(|(col, row)| grid.is_valid(col, row));
                if !is_pixel {
                    block[[0, 3, 5][k]] += 1.0;
                    loads[0][k] += grid.interpolate(p[k]) - z[v];
                }
            }
            *m = block;
            for (side, load) in sides.iter_mut().zip(loads) {
                for (v, load) in v.into_iter().zip(load) {
                    side[v] += load;
                }
            }
            for (v, diagonal) in v.into_iter().zip([m[0], m[3], m[5]]) {
                inverse[v] += diagonal;
            }
            progress.poll(work, || t as f64 / count as f64)?;
        }
        for (d, is_fixed) in inverse.iter_mut().zip(&surface.is_fixed) {
            *d = if *d > 0.0 && !is_fixed { 1.0 / *d } else { 0.0 };
        }
        Ok((Normal { mesh, blocks, inverse }, sides))
    }

    /// y = A x.
    fn apply(&self, x: &[f64], y: &mut [f64]) {
        y.fill(0.0);
        for (triangle, m) in self.mesh.triangles().iter().zip(&self.blocks) {
            let [i, j, k] = triangle.v.map(|v| v as usize);
            let (a, b, c) = (x[i], x[j], x[k]);
            y[i] += m[0] * a + m[1] * b + m[2] * c;
            y[j] += m[1] * a + m[3] * b + m[4] * c;
            y[k] += m[2] * a + m[4] * b + m[5] * c;
        }
    }

    /// Solves A x = r by conjugate gradients with Jacobi's preconditioner, from x = 0.
    fn solve(&self, mut r: Vec<f64>, progress: &mut Progress) -> Result<Vec<f64>> {
        let mut x = vec![0.0; r.len()];
        let mut product = vec![0.0; r.len()];
        let mut direction = vec![0.0; r.len()];
        let preconditioned = |r: &[f64]| r.iter().zip(&self.inverse).map(|(r, d)| r * r * d).sum::<f64>();
        let mut rho = preconditioned(&r);
        // Squares of the smallest heights underflow.
        let goal = (rho * REDUCTION * REDUCTION).max(f64::MIN_POSITIVE);
        let mut keep = 0.0;
        for i in 0..MAX_ITERATIONS {
            if rho <= goal {
                break;
            }
            progress.poll(16 * x.len(), || i as f64 / MAX_ITERATIONS as f64)?;
            for ((direction, r), d) in direction.iter_mut().zip(&r).zip(&self.inverse) {
                *direction = r * d + keep * *direction;
            }
            self.apply(&direction, &mut product);
            let curvature = dot(&direction, &product);
            if curvature <= 0.0 {
                break;
            }
            let step = rho / curvature;
            for i in 0..x.len() {
                x[i] += step * direction[i];
                r[i] -= step * product[i];
            }
            let rho_next = preconditioned(&r);
            keep = rho_next / rho;
            rho = rho_next;
        }
        Ok(x)
    }
}

/// Moves the free vertices to the heights with the least sum of squared differences
/// between the surface and the pixels of `target`.
pub fn fit_heights<T: Height>(
    surface: &mut Surface,
    target: &Grid<T>,
    progress: &mut Progress,
) -> Result<()> {
    let (normal, [residual]) =
        Normal::assemble(surface, target, progress, |_, height, plane| [height - plane])?;
    let changes = normal.solve(residual, progress)?;
    add(&mut surface.z, &changes);
    Ok(())
}

fn add(z: &mut [f64], changes: &[f64]) {
    for (z, change) in z.iter_mut().zip(changes) {
        *z += change;
    }
}

/// Images that decide how far the fit should follow the smoothed one.
pub struct Blend<'a, T> {
    pub data: Grid<'a, T>,
    pub smooth: &'a [T],
    /// Any image of independent, zero-mean, unit-variance noise, and the same smoothed.
    pub probe: &'a [T],
    pub smooth_probe: &'a [T],
    /// Standard deviation of the noise in `data`.
    pub noise: f64,
}

impl<T: Height> Blend<'_, T> {
    /// Fits the heights to the data and the smoothed image, mixed so that the
    /// unbiased estimate of the risk (Stein 1981) is least; returns the share s of the
    /// smoothed image. With P the projection onto the surfaces over the mesh, G the
    /// smoothing and y the data, the fit is P (y - s (y - G y)), and the risk is least
    /// at s = noise^2 tr(P (I - G)) / |P (I - G) y|^2, the trace estimated as
    /// p' P (I - G) p with the probe p (Hutchinson 1989) and charged at the cost of
    /// knots.
    pub fn fit(&self, surface: &mut Surface, progress: &mut Progress) -> Result<f64> {
        let (normal, [mut residual, removed, probe, removed_probe]) =
            Normal::assemble(surface, &self.data, progress, |i, height, plane| {
                let probe = self.probe[i].to_f64();
                let removed = height - self.smooth[i].to_f64();
                [height - plane, removed, probe, probe - self.smooth_probe[i].to_f64()]
            })?;
        let energy = dot(&normal.solve(removed.clone(), progress)?, &removed);
        let trace = dot(&normal.solve(removed_probe, progress)?, &probe);
        let share = KNOT_COST * self.noise * self.noise * trace / energy;
        let share = if share.is_nan() { 0.0 } else { share.clamp(0.0, 1.0) };
        for (residual, removed) in residual.iter_mut().zip(removed) {
            *residual -= share * removed;
        }
        let changes = normal.solve(residual, progress)?;
        add(&mut surface.z, &changes);
        Ok(share)
    }
}

/// The three hat functions of a triangle.
struct Hats {
    origin: Point,
    d1: (f64, f64),
    d2: (f64, f64),
}

impl Hats {
    fn over(p: [Point; 3]) -> Self {
        let area = crate::predicate::orient2d(p[0], p[1], p[2]) as f64;
        let gradient =
            |from: Point, to: Point| (f64::from(from.y - to.y) / area, f64::from(to.x - from.x) / area);
        Hats { origin: p[0], d1: gradient(p[2], p[0]), d2: gradient(p[0], p[1]) }
    }

    #[inline]
    fn at(&self, col: usize, row: usize) -> [f64; 3] {
        let q = Point::pixel(col, row);
        let (dx, dy) = (f64::from(q.x - self.origin.x), f64::from(q.y - self.origin.y));
        let b = self.d1.0 * dx + self.d1.1 * dy;
        let c = self.d2.0 * dx + self.d2.1 * dy;
        [1.0 - b - c, b, c]
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Sum of squared differences between a plane and the pixels of the closed triangle.
fn squared_error<T: Height>(target: &Grid<T>, p: [Point; 3], z: [f64; 3]) -> (f64, usize) {
    let (mut sum, mut count) = (0.0, 0);
    for_each_pixel(target, p, z, |_, _, height, plane| {
        sum += (height - plane) * (height - plane);
        count += 1;
    });
    (sum, count)
}

/// One pass over the edges: flips each unconstrained edge whose flip lowers the sum
/// of squared errors against `target`. Returns the number of flips; the mesh is
/// then no longer Delaunay.
pub fn flip_pass<T: Height>(
    surface: &mut Surface,
    target: &Grid<T>,
    progress: &mut Progress,
) -> Result<usize> {
    let Surface { mesh, z, .. } = surface;
    let count = mesh.triangles().len() as u32;
    let height = |v: [u32; 3]| v.map(|v| z[v as usize]);
    memory::ensure(8 * count as usize)?;
    let mut errors = vec![f64::NAN; count as usize];
    let mut flips = 0;
    for t in 0..count {
        let mut work = 64;
        for h in (0..3).map(|k| half_edge(t, k)) {
            let twin = mesh.twin(h);
            // Each edge once: from its lower triangle.
            if twin == NONE
                || twin < h
                || mesh.is_constrained(h)
                || mesh.triangle(t).is_void()
                || !mesh.is_convex(h)
            {
                continue;
            }
            let mut now = 0.0;
            for t in [t, triangle_of(twin)] {
                if errors[t as usize].is_nan() {
                    let (error, pixels) = squared_error(target, mesh.corners(t), height(mesh.triangle(t).v));
                    errors[t as usize] = error;
                    work += pixels;
                }
                now += errors[t as usize];
            }
            let (a, b, c, d) = (mesh.origin(h), mesh.dest(h), mesh.apex(h), mesh.apex(twin));
            let mut error_of = |v: [u32; 3]| {
                let (error, pixels) = squared_error(target, v.map(|v| mesh.point(v)), height(v));
                work += pixels;
                error
            };
            let first = error_of([c, a, d]);
            if first >= now {
                continue;
            }
            let flipped = [first, error_of([c, d, b])];
            if flipped[0] + flipped[1] < now * (1.0 - 1e-9) {
                mesh.flip(h);
                errors[t as usize] = flipped[0];
                errors[triangle_of(twin) as usize] = flipped[1];
                flips += 1;
            }
        }
        progress.poll(4 * work, || f64::from(t) / f64::from(count))?;
    }
    Ok(flips)
}
