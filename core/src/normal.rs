//! Normal equations of the surfaces over a mesh, and their solution.

use crate::error::Result;
use crate::mesh::{half_edge, triangle_of, Mesh, NONE};
use crate::progress::Progress;
use crate::threads::spread;

/// A solution is good enough once what is left to gain falls below this part of the sum of
/// squares that it leaves.
const NEGLIGIBLE: f64 = 1e-6;
/// Beyond this fall of the residual there is nothing but rounding.
const REDUCTION: f64 = 1e-12;
const MAX_ITERATIONS: usize = 60;
/// Vertices that are worked on together.
const CHUNK: usize = 1 << 13;

/// Products of the hat functions, summed over the pixels, before they become a matrix.
pub struct Products {
    /// Of each vertex with itself.
    pub diagonal: Vec<f64>,
    /// Of the two ends of each triangle's three edges, over that triangle.
    pub edges: Vec<[f64; 3]>,
}

/// The matrix, by rows; those of vertices that stay as they are count for nothing.
pub struct Normal {
    diagonal: Vec<f64>,
    /// Inverse diagonal, 0 for vertices that stay as they are: fixed or in no data triangle.
    inverse: Vec<f64>,
    /// Where the entries of each vertex begin, and where the last ones end.
    starts: Vec<u32>,
    /// Columns and values beside the diagonal.
    entries: Vec<(u32, f32)>,
}

impl Normal {
    /// Bytes that a mesh with so many vertices takes, the solution of `k` systems included.
    pub fn bytes(vertices: usize, k: usize) -> usize {
        vertices * (16 + 4 + 6 * 8 + 7 * 8 * k)
    }

    pub fn new(mesh: &Mesh, products: Products, is_fixed: &[bool]) -> Self {
        let Products { diagonal, edges } = products;
        let inverse = diagonal
            .iter()
            .zip(is_fixed)
            .map(|(&d, &is_fixed)| if d > 0.0 && !is_fixed { 1.0 / d } else { 0.0 });
        let inverse: Vec<f64> = inverse.collect();
        let mut starts = vec![0; diagonal.len() + 1];
        for_each_edge(mesh, |[a, b], _| [a, b].iter().for_each(|&v| starts[v as usize + 1] += 1));
        let mut end = 0;
        for start in &mut starts {
            end += *start;
            *start = end;
        }
        let mut entries = vec![(0, 0.0); end as usize];
        let mut next = starts.clone();
        for_each_edge(mesh, |[a, b], h| {
            let product = |h: u32| edges[triangle_of(h) as usize][(h & 3) as usize];
            let twin = mesh.twin(h);
            let sum = (product(h) + if twin == NONE { 0.0 } else { product(twin) }) as f32;
            for (from, to) in [(a, b), (b, a)] {
                let place = &mut next[from as usize];
                entries[*place as usize] = (to, sum);
                *place += 1;
            }
        });
        Normal { diagonal, inverse, starts, entries }
    }

    /// Solves A x = side for each of the `K` sides by conjugate gradients with Jacobi's
    /// preconditioner, from x = 0; in the form of Chronopoulos and Gear (1989), which
    /// takes its sums in one go. `squares`: what the sum of squares is at x = 0.
    pub fn solve<const K: usize>(
        &self,
        sides: Vec<[f64; K]>,
        squares: [f64; K],
        progress: &mut Progress,
    ) -> Result<Vec<[f64; K]>> {
        let zero = [0.0; K];
        let scaled = |r: &[f64; K], d: f64| r.map(|r| r * d);
        let mut scaled_residuals: Vec<_> =
            sides.iter().zip(&self.inverse).map(|(r, &d)| scaled(r, d)).collect();
        let mut rows: Vec<Row<K>> = sides
            .into_iter()
            .map(|residual| Row { residual, x: zero, direction: zero, image: zero })
            .collect();
        let mut images = vec![zero; rows.len()];
        let mut left = squares;
        let (mut rho, mut step, mut first) = (zero, zero, zero);
        for i in 0..MAX_ITERATIONS {
            let sums = spread(
                progress,
                images.chunks_mut(CHUNK).zip(rows.chunks(CHUNK)).enumerate(),
                |(chunk, (images, rows)), progress| {
                    progress.poll(16 * K * rows.len(), || i as f64 / MAX_ITERATIONS as f64)?;
                    Ok(self.apply(chunk * CHUNK, &scaled_residuals, rows, images))
                },
            )?;
            let (new_rho, curvature) =
                sums.iter().fold((zero, zero), |a, b| (plus(a.0, b.0), plus(a.1, b.1)));
            if i == 0 {
                first = new_rho;
            }
            // Squares of the smallest heights underflow.
            let goal = |k: usize| (NEGLIGIBLE * left[k]).max(REDUCTION * first[k]).max(f64::MIN_POSITIVE);
            let is_open: [bool; K] = std::array::from_fn(|k| new_rho[k] > goal(k));
            if !is_open.contains(&true) {
                break;
            }
            let mut keep = zero;
            for k in 0..K {
                keep[k] = if i > 0 && rho[k] > 0.0 { new_rho[k] / rho[k] } else { 0.0 };
                let bend = curvature[k] - if keep[k] > 0.0 { keep[k] * new_rho[k] / step[k] } else { 0.0 };
                // What has been solved stays as it is.
                step[k] = if is_open[k] && bend > 0.0 { new_rho[k] / bend } else { 0.0 };
                rho[k] = if step[k] > 0.0 { new_rho[k] } else { 0.0 };
                left[k] -= step[k] * rho[k];
            }
            if step == zero {
                break;
            }
            spread(
                progress,
                rows.chunks_mut(CHUNK)
                    .zip(scaled_residuals.chunks_mut(CHUNK))
                    .zip(images.chunks(CHUNK))
                    .zip(self.inverse.chunks(CHUNK)),
                |(((rows, scaled_residuals), images), inverse), _| {
                    let vertices = rows.iter_mut().zip(scaled_residuals).zip(images).zip(inverse);
                    for (((row, scaled_residual), image), &d) in vertices {
                        row.advance(scaled_residual, image, &keep, &step);
                        *scaled_residual = scaled(&row.residual, d);
                    }
                    Ok(())
                },
            )?;
        }
        Ok(rows.into_iter().map(|row| row.x).collect())
    }

    /// images = A u for some vertices, and the sums of r u and of u A u over them.
    fn apply<const K: usize>(
        &self,
        first: usize,
        u: &[[f64; K]],
        rows: &[Row<K>],
        images: &mut [[f64; K]],
    ) -> ([f64; K], [f64; K]) {
        let (mut rho, mut curvature) = ([0.0; K], [0.0; K]);
        for ((v, image), row) in (first..).zip(images).zip(rows) {
            let own = u[v];
            let mut sum = own.map(|u| u * self.diagonal[v]);
            for &(to, value) in &self.entries[self.starts[v] as usize..self.starts[v + 1] as usize] {
                let value = f64::from(value);
                for (sum, u) in sum.iter_mut().zip(u[to as usize]) {
                    *sum += value * u;
                }
            }
            for k in 0..K {
                rho[k] += row.residual[k] * own[k];
                curvature[k] += own[k] * sum[k];
            }
            *image = sum;
        }
        (rho, curvature)
    }
}

/// What conjugate gradients keep for a vertex.
struct Row<const K: usize> {
    residual: [f64; K],
    x: [f64; K],
    direction: [f64; K],
    /// The matrix applied to the direction.
    image: [f64; K],
}

impl<const K: usize> Row<K> {
    #[inline(always)]
    fn advance(&mut self, scaled_residual: &[f64; K], image: &[f64; K], keep: &[f64; K], step: &[f64; K]) {
        for k in 0..K {
            self.direction[k] = scaled_residual[k] + keep[k] * self.direction[k];
            self.image[k] = image[k] + keep[k] * self.image[k];
            self.x[k] += step[k] * self.direction[k];
            self.residual[k] -= step[k] * self.image[k];
        }
    }
}

fn plus<const K: usize>(a: [f64; K], b: [f64; K]) -> [f64; K] {
    std::array::from_fn(|k| a[k] + b[k])
}

/// Calls `visit(ends, h)` for each edge, `h` being the lower of its sides.
fn for_each_edge(mesh: &Mesh, mut visit: impl FnMut([u32; 2], u32)) {
    for (t, triangle) in (0..).zip(mesh.triangles()) {
        for k in 0..3 {
            let h = half_edge(t, k as u32);
            if h < triangle.twin[k] {
                visit([triangle.v[k], triangle.v[(k + 1) % 3]], h);
            }
        }
    }
}
