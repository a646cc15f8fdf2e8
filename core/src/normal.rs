//! Normal equations of the surfaces over a mesh, and their solution.

use crate::error::Result;
use crate::memory;
use crate::mesh::{half_edge, triangle_of, Mesh, Triangle, NONE};
use crate::progress::Progress;
use crate::share::Share;
use crate::surface::Surface;
use crate::threads::spread;
use std::ops::Add;

/// A solution is good enough once what is left to gain falls below this part of the sum of
/// squares that it leaves.
const NEGLIGIBLE: f64 = 1e-4;
/// Beyond this fall of the residual there is nothing but rounding.
const REDUCTION: f64 = 1e-12;
const MAX_ITERATIONS: usize = 60;
/// Vertices that are worked on together.
const CHUNK: usize = 1 << 13;

/// An entry of the matrix beside the diagonal, for two vertices of a block.
#[derive(Clone, Copy)]
struct Inner {
    ends: [u16; 2],
    value: f32,
}

/// One for a vertex of a block and one of another block.
struct Outer {
    of: u16,
    to: u32,
    value: f32,
}

/// The part of the matrix for some vertices; entries of vertices that stay as they are count for nothing.
#[derive(Default)]
struct Block {
    diagonal: Vec<f32>,
    /// Inverse diagonal, 0 for vertices that stay as they are: fixed or in no data triangle.
    inverse: Vec<f32>,
    /// As many as are counted.
    inner: Vec<Inner>,
    count: usize,
    outer: Vec<Outer>,
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
        let count = vertices.div_ceil(CHUNK);
        let members = members(mesh, count, progress)?;
        self.sides.clear();
        self.sides.resize(vertices, [0.0; K]);
        self.blocks.resize_with(count, Block::default);
        // On this thread: an arena of another one takes more than is asked for.
        self.blocks.iter_mut().for_each(|block| block.clear(CHUNK.min(vertices)));
        let chunks = self.sides.chunks_mut(CHUNK).zip(is_fixed.chunks(CHUNK)).zip(&mut self.blocks);
        let of_stands = spread(
            progress,
            chunks.zip(&members).enumerate(),
            |(chunk, (((sides, is_fixed), block), members)), progress| {
                progress.poll(64 * sides.len(), || (chunk * CHUNK) as f64 / vertices as f64)?;
                let (mut squares, mut diagonal) = ([0.0; K], vec![0.0; sides.len()]);
                for (v, (side, diagonal)) in (chunk * CHUNK..).zip(sides.iter_mut().zip(&mut diagonal)) {
                    let stand = stands(v);
                    if !stand[0].is_nan() {
                        (*side, *diagonal) = (stand, 1.0);
                        squares = plus(squares, stand.map(|value| value * value));
                    }
                }
                let first = (chunk * CHUNK) as u32;
                for &t in members.iter().flatten() {
                    block.add(mesh.triangles(), shares, t, (first, &mut diagonal, sides));
                }
                block.set_diagonal(&diagonal, is_fixed);
                Ok(squares)
            },
        )?;
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

/// The triangles with a corner in each of `count` blocks, ascending: some lists for each.
fn members(mesh: &Mesh, count: usize, progress: &mut Progress) -> Result<Vec<Vec<Vec<u32>>>> {
    let chunks = mesh.triangles().chunks(CHUNK).enumerate();
    let parts = spread(progress, chunks, |(chunk, triangles), progress| {
        progress.poll(4 * triangles.len(), || 0.0)?;
        let mut lists: Vec<(usize, Vec<u32>)> = Vec::new();
        for (t, triangle) in ((chunk * CHUNK) as u32..).zip(triangles) {
            let [a, b, c] = triangle.v.map(|v| v as usize / CHUNK);
            for block in [Some(a), Some(b).filter(|&b| b != a), Some(c).filter(|&c| c != a && c != b)] {
                let Some(block) = block else { continue };
                // What lies together is in few blocks.
                match lists.iter_mut().find(|list| list.0 == block) {
                    Some((_, list)) => list.push(t),
                    None => lists.push((block, vec![t])),
                }
            }
        }
        Ok(lists)
    })?;
    let mut members = vec![Vec::new(); count];
    parts.into_iter().flatten().for_each(|(block, list)| members[block].push(list));
    Ok(members)
}

impl Block {
    /// Nothing, but room for what so many vertices need.
    fn clear(&mut self, vertices: usize) {
        self.diagonal.clear();
        self.diagonal.reserve(vertices);
        self.inverse.clear();
        self.inverse.reserve(vertices);
        // There are fewer than three edges to a vertex, and one more place is written to.
        self.inner.resize(3 * vertices + 1, Inner { ends: [0; 2], value: 0.0 });
        self.count = 0;
        self.outer.clear();
    }

    /// Adds what a triangle says of the block's vertices, from `first` on: to their diagonal, their sides, and the edges
    /// between them, which have their entry from the triangle on both sides.
    #[inline]
    fn add<const K: usize>(
        &mut self,
        triangles: &[Triangle],
        shares: &[Share<K>],
        t: u32,
        (first, diagonal, sides): (u32, &mut [f64], &mut [[f64; K]]),
    ) {
        let (Triangle { v, twin, .. }, share) = (&triangles[t as usize], &shares[t as usize]);
        let here = v.map(|v| v.wrapping_sub(first) as usize);
        let is_inside = here.map(|at| at < diagonal.len());
        for k in 0..3 {
            if is_inside[k] {
                let at = here[k];
                diagonal[at] += f64::from(share.corners[k]);
                sides[at] = plus(sides[at], share.sides[k].map(f64::from));
            }
        }
        for k in 0..3 {
            let (h, next) = (half_edge(t, k as u32), (k + 1) % 3);
            // Of the two triangles the one that memory has given before. Which it is can not be foreseen: no branch.
            let is_last = twin[k] < h;
            let other = if is_last { twin[k] } else { h };
            let beyond = shares[triangle_of(other) as usize].edges[(other & 3) as usize];
            let value = share.edges[k] + f32::from(u8::from(is_last)) * beyond;
            let counts = is_last | (twin[k] == NONE);
            if is_inside[k] & is_inside[next] {
                if let Some(entry) = self.inner.get_mut(self.count) {
                    *entry = Inner { ends: [here[k] as u16, here[next] as u16], value };
                    self.count += usize::from(counts);
                }
            } else if counts & is_inside[k] {
                self.outer.push(Outer { of: here[k] as u16, to: v[next], value });
            } else if counts & is_inside[next] {
                self.outer.push(Outer { of: here[next] as u16, to: v[k], value });
            }
        }
    }

    fn set_diagonal(&mut self, diagonal: &[f64], is_fixed: &[bool]) {
        for (&diagonal, &is_fixed) in diagonal.iter().zip(is_fixed) {
            self.diagonal.push(diagonal as f32);
            self.inverse.push(if diagonal > 0.0 && !is_fixed { (1.0 / diagonal) as f32 } else { 0.0 });
        }
    }

    /// images = A u for its vertices, from `first` on, and the sums of r u and of u A u over them.
    fn apply<const K: usize>(
        &self,
        first: usize,
        u: &[[f32; K]],
        rows: &[Row<K>],
        images: &mut [[f32; K]],
    ) -> ([f64; K], [f64; K]) {
        let own = &u[first..first + images.len()];
        for ((image, own), diagonal) in images.iter_mut().zip(own).zip(&self.diagonal) {
            *image = own.map(|u| u * diagonal);
        }
        let times = |u: &[f32; K], value: f32| u.map(|u| u * value);
        for &Inner { ends: [a, b], value } in &self.inner[..self.count] {
            let (a, b) = (a as usize, b as usize);
            images[a] = plus(images[a], times(&own[b], value));
            images[b] = plus(images[b], times(&own[a], value));
        }
        for &Outer { of, to, value } in &self.outer {
            images[of as usize] = plus(images[of as usize], times(&u[to as usize], value));
        }
        let (mut rho, mut curvature) = ([0.0; K], [0.0; K]);
        for ((image, own), row) in images.iter().zip(own).zip(rows) {
            for k in 0..K {
                rho[k] += f64::from(row.residual[k]) * f64::from(own[k]);
                curvature[k] += f64::from(own[k]) * f64::from(image[k]);
            }
        }
        (rho, curvature)
    }
}

/// Bytes that a mesh with so many vertices takes, the solution of `k` systems included.
fn bytes(vertices: usize, k: usize) -> usize {
    vertices * (8 + 4 + 4 + 3 * size_of::<Inner>() + 3 * 4 + (8 + 6 * 4) * k)
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

fn plus<T: Copy + Add<Output = T>, const K: usize>(a: [T; K], b: [T; K]) -> [T; K] {
    std::array::from_fn(|k| a[k] + b[k])
}
