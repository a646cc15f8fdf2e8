//! Heights by least squares.

use crate::error::Result;
use crate::memory;
use crate::mesh::Mesh;
use crate::moments::{dot, Moments};
use crate::normal::{Normal, Products};
use crate::predicate::Point;
use crate::progress::Progress;
use crate::sight::{chunks, Sight};
use crate::surface::Surface;
use crate::threads::spread;

/// Chunks whose results are kept at once.
const CHUNKS: usize = 1 << 4;

/// What a triangle adds to the normal equations.
struct Share<const K: usize> {
    corners: [f64; 3],
    edges: [f64; 3],
    sides: [[f64; K]; 3],
    squares: [f64; K],
}

impl<const K: usize> Share<K> {
    /// The first value counts as far as it is not yet the surface's.
    #[inline]
    fn of(moments: &Moments<K>, p: [Point; 3], z: [f64; 3]) -> Self {
        let [_, b, c] = moments.hats(p);
        // The three add up to 1, so that sums with the first follow from those with the others.
        let [n, x, y] = moments.times([1.0, 0.0, 0.0]);
        let (nb, nc) = (dot(b, [n, x, y]), dot(c, [n, x, y]));
        let times_b = moments.times(b);
        let (bb, bc, cc) = (dot(b, times_b), dot(c, times_b), dot(c, moments.times(c)));
        let (ab, ac) = (nb - bb - bc, nc - bc - cc);
        let aa = n - nb - nc - ab - ac;
        let mut sides = [[0.0; K]; 3];
        for (k, &values) in moments.values.iter().enumerate() {
            let (of_b, of_c) = (dot(b, values), dot(c, values));
            (sides[0][k], sides[1][k], sides[2][k]) = (values[0] - of_b - of_c, of_b, of_c);
        }
        // The plane is a sum of hats, too, and so is what it leaves.
        let z = z.map(|z| z - moments.base());
        let of_values = z[0] * sides[0][0] + z[1] * sides[1][0] + z[2] * sides[2][0];
        let of_plane = [[aa, ab, ac], [ab, bb, bc], [ac, bc, cc]]
            .map(|row| row[0] * z[0] + row[1] * z[1] + row[2] * z[2]);
        for (side, of_plane) in sides.iter_mut().zip(of_plane) {
            side[0] -= of_plane;
        }
        let mut squares = moments.squares;
        squares[0] = (squares[0] - 2.0 * of_values + dot(z, of_plane)).max(0.0);
        Share { corners: [aa, bb, cc], edges: [ab, bc, ac], sides, squares }
    }
}

/// The systems to solve: one matrix, and for each value of the pixels a side and its sum of squares.
pub struct Systems<const K: usize> {
    pub normal: Normal,
    pub sides: Vec<[f64; K]>,
    pub squares: [f64; K],
}

impl<const K: usize> Systems<K> {
    /// `stands`: the values where each vertex stands. `moments(t)`: over the triangle's pixels.
    pub fn assemble(
        surface: &Surface,
        stands: impl Fn(usize) -> [f64; K],
        moments: impl Fn(u32) -> Moments<K> + Sync,
        progress: &mut Progress,
    ) -> Result<Self> {
        let Surface { mesh, z, is_fixed } = surface;
        let (count, vertices) = (mesh.triangles().len(), z.len());
        memory::ensure(count * 24 + Normal::bytes(vertices, K))?;
        let mut sides = vec![[0.0; K]; vertices];
        let mut squares = [0.0; K];
        let mut products = Products { diagonal: vec![0.0; vertices], edges: Vec::with_capacity(count) };
        for (v, side) in sides.iter_mut().enumerate().filter(|(v, _)| !z[*v].is_nan()) {
            *side = stands(v);
            side[0] -= z[v];
            products.diagonal[v] = 1.0;
            squares.iter_mut().zip(*side).for_each(|(sum, value)| *sum += value * value);
        }
        let open: Vec<_> = chunks(count).collect();
        for open in open.chunks(CHUNKS) {
            let shares = spread(progress, open.iter(), |chunk, progress| {
                let share = |t: usize| share_of(surface, t as u32, &moments);
                progress.poll(64 * chunk.len(), || chunk.start as f64 / count as f64)?;
                Ok(chunk.clone().map(share).collect::<Vec<_>>())
            })?;
            for share in shares.into_iter().flatten() {
                let v = mesh.triangles()[products.edges.len()].v;
                products.edges.push(share.edges);
                for (k, v) in v.into_iter().enumerate() {
                    products.diagonal[v as usize] += share.corners[k];
                    sides[v as usize].iter_mut().zip(share.sides[k]).for_each(|(sum, side)| *sum += side);
                }
                squares.iter_mut().zip(share.squares).for_each(|(sum, square)| *sum += square);
            }
        }
        Ok(Systems { normal: Normal::new(mesh, products, is_fixed), sides, squares })
    }
}

#[inline]
fn share_of<const K: usize>(surface: &Surface, t: u32, moments: &impl Fn(u32) -> Moments<K>) -> Share<K> {
    let mesh: &Mesh = &surface.mesh;
    if mesh.triangle(t).is_void() {
        return Share { corners: [0.0; 3], edges: [0.0; 3], sides: [[0.0; K]; 3], squares: [0.0; K] };
    }
    Share::of(&moments(t), mesh.corners(t), surface.heights(t))
}

/// Moves the free vertices to the heights with the least sum of squared differences
/// between the surface and the pixels seen, where there is more than a millionth of it to gain. Errors:
/// `out-of-memory`, `cancelled`.
pub fn fit_heights(surface: &mut Surface, seen: &Sight, progress: &mut Progress) -> Result<()> {
    let Systems { normal, sides, squares } =
        Systems::assemble(surface, |v| [seen.vertices[v]], |t| seen.triangles[t as usize], progress)?;
    let changes = normal.solve(sides, squares, progress)?;
    surface.z.iter_mut().zip(changes).for_each(|(z, [change])| *z += change);
    Ok(())
}
