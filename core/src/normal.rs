//! Normal equations of the surfaces over a mesh, and their solution.

use crate::error::Result;
use crate::memory;
use crate::mesh::{half_edge, triangle_of, Mesh, Triangle, NONE};
use crate::progress::Progress;
use crate::share::Share;
use crate::surface::Surface;
use crate::threads::spread;
use std::sync::atomic::{AtomicU32, Ordering};

/// A solution is good enough once what is left to gain falls below this part of the sum of
/// squares that it leaves.
const NEGLIGIBLE: f64 = 1e-6;
/// Beyond this fall of the residual there is nothing but rounding.
const REDUCTION: f64 = 1e-12;
const MAX_ITERATIONS: usize = 60;
/// Vertices that are worked on together.
const CHUNK: usize = 1 << 13;

/// The rows of the matrix for some vertices; those of vertices that stay as they are count for nothing.
#[derive(Default)]
struct Block {
    diagonal: Vec<f32>,
    /// Inverse diagonal, 0 for vertices that stay as they are: fixed or in no data triangle.
    inverse: Vec<f32>,
    /// Where the entries of each vertex end.
    ends: Vec<u32>,
    /// Columns and values beside the diagonal.
    entries: Vec<(u32, f32)>,
}

/// The systems to solve: one matrix, and for each value of the pixels a side. Their memory is used again and again.
pub struct Systems<const K: usize> {
    blocks: Vec<Block>,
    pub sides: Vec<[f64; K]>,
    /// For each value its sum of squares.
    pub squares: [f64; K],
}

/// The memory of a solution.
#[derive(Default)]
pub struct Scratch<const K: usize> {
    rows: Vec<Row<K>>,
    scaled_residuals: Vec<[f32; K]>,
    images: Vec<[f32; K]>,
}

impl<const K: usize> Default for Systems<K> {
    fn default() -> Self {
        Systems { blocks: Vec::new(), sides: Vec::new(), squares: [0.0; K] }
    }
}

impl<const K: usize> Systems<K> {
    /// `stands(v)`: the values where a vertex stands, the first of scaffolding NaN. `shares`: of each triangle.
    /// Errors: `out-of-memory`, `cancelled`.
    pub fn assemble(
        &mut self,
        surface: &Surface,
        stands: impl Fn(usize) -> [f64; K] + Sync,
        shares: &[Share<K>],
        progress: &mut Progress,
    ) -> Result<()> {
        let Surface { mesh, is_fixed, .. } = surface;
        let vertices = is_fixed.len();
        if self.sides.len() < vertices {
            memory::ensure(bytes(vertices, K))?;
        }
        let fans = Fans::of(mesh, progress)?;
        self.sides.clear();
        self.sides.resize(vertices, [0.0; K]);
        self.blocks.resize_with(vertices.div_ceil(CHUNK), Block::default);
        // On this thread: an arena of another one takes more than is asked for.
        self.blocks.iter_mut().for_each(|block| block.clear(CHUNK.min(vertices)));
        let chunks = self.sides.chunks_mut(CHUNK).zip(is_fixed.chunks(CHUNK)).zip(&mut self.blocks);
        let of_stands =
            spread(progress, chunks.enumerate(), |(chunk, ((sides, is_fixed), block)), progress| {
                progress.poll(64 * sides.len(), || (chunk * CHUNK) as f64 / vertices as f64)?;
                let mut squares = [0.0; K];
                for (v, (side, &is_fixed)) in (chunk * CHUNK..).zip(sides.iter_mut().zip(is_fixed)) {
                    let (stand, mut diagonal) = (stands(v), 0.0);
                    if !stand[0].is_nan() {
                        (*side, diagonal) = (stand, 1.0);
                        squares = plus(squares, stand.map(|value| value * value));
                    }
                    for start in fans.starts(v as u32) {
                        let (corners, sides) = block.add_fan(mesh.triangles(), shares, start);
                        diagonal += corners;
                        *side = plus(*side, sides);
                    }
                    block.end_row(diagonal, is_fixed);
                }
                Ok(squares)
            })?;
        let of_shares = spread(progress, shares.chunks(CHUNK), |shares, _| {
            Ok(shares.iter().fold([0.0; K], |sum, share| plus(sum, share.squares.map(f64::from))))
        })?;
        self.squares = of_stands.into_iter().chain(of_shares).fold([0.0; K], plus);
        Ok(())
    }

    /// Solves A x = side for the first `J` sides by conjugate gradients with Jacobi's preconditioner, from x = 0; in
    /// the form of Chronopoulos and Gear (1989), which takes its sums in one go. The sums of squares are those at x = 0;
    /// `rounding` is what of them may be due to rounding, and not worth a step.
    pub fn solve<'s, const J: usize>(
        &self,
        rounding: f64,
        scratch: &'s mut Scratch<J>,
        progress: &mut Progress,
    ) -> Result<impl Iterator<Item = [f64; J]> + 's> {
        let zero = [0.0; J];
        let scaled = |r: &[f32; J], d: f32| r.map(|r| r * d);
        let Scratch { rows, scaled_residuals, images } = scratch;
        let none = [0.0; J];
        let start = |residual| Row { residual, x: none, direction: none, image: none };
        rows.clear();
        rows.extend(self.sides.iter().map(|side| start(std::array::from_fn(|k| side[k] as f32))));
        let inverse = self.blocks.iter().flat_map(|block| &block.inverse);
        scaled_residuals.clear();
        scaled_residuals.extend(rows.iter().zip(inverse).map(|(row, &d)| scaled(&row.residual, d)));
        images.clear();
        images.resize(rows.len(), none);
        let mut left: [f64; J] = std::array::from_fn(|k| self.squares[k]);
        let (mut rho, mut step, mut first) = (zero, zero, zero);
        for i in 0..MAX_ITERATIONS {
            let sums = spread(
                progress,
                images.chunks_mut(CHUNK).zip(rows.chunks(CHUNK)).zip(&self.blocks).enumerate(),
                |(chunk, ((images, rows), block)), progress| {
                    progress.poll(16 * J * rows.len(), || i as f64 / MAX_ITERATIONS as f64)?;
                    Ok(block.apply(chunk * CHUNK, scaled_residuals, rows, images))
                },
            )?;
            let (new_rho, curvature) =
                sums.iter().fold((zero, zero), |a, b| (plus(a.0, b.0), plus(a.1, b.1)));
            if i == 0 {
                first = new_rho;
            }
            let goal = |k: usize| (NEGLIGIBLE * left[k]).max(REDUCTION * first[k]).max(rounding);
            let is_open: [bool; J] = std::array::from_fn(|k| new_rho[k] > goal(k));
            if !is_open.contains(&true) {
                break;
            }
            let mut keep = zero;
            for k in 0..J {
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
            let (keep, step_now) = (keep.map(|k| k as f32), step.map(|s| s as f32));
            spread(
                progress,
                rows.chunks_mut(CHUNK)
                    .zip(scaled_residuals.chunks_mut(CHUNK))
                    .zip(images.chunks(CHUNK))
                    .zip(&self.blocks),
                |(((rows, scaled_residuals), images), block), _| {
                    let vertices = rows.iter_mut().zip(scaled_residuals).zip(images).zip(&block.inverse);
                    for (((row, scaled_residual), image), &d) in vertices {
                        row.advance(scaled_residual, image, &keep, &step_now);
                        *scaled_residual = scaled(&row.residual, d);
                    }
                    Ok(())
                },
            )?;
        }
        Ok(scratch.rows.iter().map(|row| row.x.map(f64::from)))
    }
}

/// Where to begin to go around each vertex.
struct Fans {
    /// A half-edge that leaves it; along a border the one that no other triangle comes before.
    starts: Vec<u32>,
    /// More of those with their vertex, ascending: where parts of a mesh meet in a vertex alone.
    more: Vec<(u32, u32)>,
}

impl Fans {
    fn of(mesh: &Mesh, progress: &mut Progress) -> Result<Self> {
        let first = |_| AtomicU32::new(NONE);
        let starts: Vec<AtomicU32> = mesh.points().iter().map(first).collect();
        let borders =
            spread(progress, mesh.triangles().chunks(CHUNK).enumerate(), |(chunk, triangles), _| {
                let mut borders = Vec::new();
                for (t, triangle) in ((chunk * CHUNK) as u32..).zip(triangles) {
                    for k in 0..3 {
                        let (v, h) = (triangle.v[k], half_edge(t, k as u32));
                        // The lowest, whichever thread comes first.
                        let start = &starts[v as usize];
                        if h < start.load(Ordering::Relaxed) {
                            start.fetch_min(h, Ordering::Relaxed);
                        }
                        if triangle.twin[k] == NONE {
                            borders.push((v, h));
                        }
                    }
                }
                Ok(borders)
            })?;
        let mut starts: Vec<u32> = starts.into_iter().map(AtomicU32::into_inner).collect();
        let mut borders = borders.concat();
        borders.sort_unstable();
        let (mut more, mut before) = (Vec::new(), NONE);
        for (v, h) in borders {
            if v == before {
                more.push((v, h));
            } else {
                starts[v as usize] = h;
            }
            before = v;
        }
        Ok(Fans { starts, more })
    }

    /// One a fan.
    #[inline]
    fn starts(&self, v: u32) -> impl Iterator<Item = u32> + '_ {
        let start = Some(self.starts[v as usize]).filter(|&h| h != NONE);
        let from = self.more.partition_point(|&(other, _)| other < v);
        start
            .into_iter()
            .chain(self.more[from..].iter().take_while(move |more| more.0 == v).map(|more| more.1))
    }
}

/// The corners of a triangle from each of them on.
const TURNS: [[usize; 3]; 4] = [[0, 1, 2], [1, 2, 0], [2, 0, 1], [0; 3]];

impl Block {
    /// No rows, but room for those of so many vertices.
    fn clear(&mut self, vertices: usize) {
        self.diagonal.clear();
        self.diagonal.reserve(vertices);
        self.inverse.clear();
        self.inverse.reserve(vertices);
        self.ends.clear();
        self.ends.reserve(vertices);
        self.entries.clear();
        // A vertex has six neighbours on the average.
        self.entries.reserve(6 * vertices + vertices / 4);
    }

    /// Adds the entries that come from the triangles around a vertex, beginning with that of `start`; returns what they
    /// add to the diagonal and to the sides.
    #[inline]
    fn add_fan<const K: usize>(
        &mut self,
        triangles: &[Triangle],
        shares: &[Share<K>],
        start: u32,
    ) -> (f64, [f64; K]) {
        let (mut diagonal, mut sides) = (0.0, [0.0; K]);
        let (mut h, mut before, first) = (start, 0.0, self.entries.len());
        loop {
            let (triangle, share) = (&triangles[triangle_of(h) as usize], &shares[triangle_of(h) as usize]);
            let [at, to, from] = TURNS[(h & 3) as usize];
            diagonal += f64::from(share.corners[at]);
            sides = plus(sides, share.sides[at].map(f64::from));
            self.entries.push((triangle.v[to], before + share.edges[at]));
            before = share.edges[from];
            h = triangle.twin[from];
            if h == NONE {
                self.entries.push((triangle.v[from], before));
                return (diagonal, sides);
            }
            if h == start {
                self.entries[first].1 += before;
                return (diagonal, sides);
            }
        }
    }

    fn end_row(&mut self, diagonal: f64, is_fixed: bool) {
        self.diagonal.push(diagonal as f32);
        self.inverse.push(if diagonal > 0.0 && !is_fixed { (1.0 / diagonal) as f32 } else { 0.0 });
        self.ends.push(self.entries.len() as u32);
    }

    /// images = A u for its vertices, from `first` on, and the sums of r u and of u A u over them.
    fn apply<const K: usize>(
        &self,
        first: usize,
        u: &[[f32; K]],
        rows: &[Row<K>],
        images: &mut [[f32; K]],
    ) -> ([f64; K], [f64; K]) {
        let (mut rho, mut curvature) = ([0.0; K], [0.0; K]);
        let mut start = 0;
        let vertices = u[first..].iter().zip(&self.diagonal).zip(&self.ends).zip(images).zip(rows);
        for ((((own, diagonal), &end), image), row) in vertices {
            let mut sum = own.map(|u| u * diagonal);
            for &(to, value) in &self.entries[start..end as usize] {
                for (sum, u) in sum.iter_mut().zip(u[to as usize]) {
                    *sum += value * u;
                }
            }
            start = end as usize;
            for k in 0..K {
                rho[k] += f64::from(row.residual[k]) * f64::from(own[k]);
                curvature[k] += f64::from(own[k]) * f64::from(sum[k]);
            }
            *image = sum;
        }
        (rho, curvature)
    }
}

/// Bytes that a mesh with so many vertices takes, the solution of `k` systems included.
fn bytes(vertices: usize, k: usize) -> usize {
    vertices * (8 + 4 + 4 + 7 * 8 + (8 + 6 * 4) * k)
}

/// What conjugate gradients keep for a vertex.
struct Row<const K: usize> {
    residual: [f32; K],
    x: [f32; K],
    direction: [f32; K],
    /// The matrix applied to the direction.
    image: [f32; K],
}

impl<const K: usize> Row<K> {
    #[inline(always)]
    fn advance(&mut self, scaled_residual: &[f32; K], image: &[f32; K], keep: &[f32; K], step: &[f32; K]) {
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
