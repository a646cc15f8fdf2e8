//! What a mesh sees of an image: sums over the pixels of each triangle.

use crate::error::Result;
use crate::grid::{Grid, Height};
use crate::lanes::{Kernel, Lanes, Vectors};
use crate::memory;
use crate::mesh::half_edge;
use crate::moments::Moments;
use crate::owned::{for_each_span, owns_edge, Visitor};
use crate::predicate::Point;
use crate::progress::Progress;
use crate::surface::Surface;
use crate::threads::spread;

/// Triangles, or vertices, that are worked on together.
const CHUNK: usize = 1 << 10;

/// An image as a mesh sees it.
pub struct Sight {
    /// Over the pixels that each triangle owns; of none for those without data.
    pub triangles: Vec<Moments<1>>,
    /// What each vertex stands on: its pixel or, lest it is seen by hardly any pixel and flies
    /// off, the image's height there. NaN for scaffolding.
    pub vertices: Vec<f64>,
}

impl Sight {
    /// Errors: `out-of-memory`, `cancelled`.
    pub fn of<T: Height>(surface: &Surface, target: &Grid<T>, progress: &mut Progress) -> Result<Self> {
        let count = surface.mesh.triangles().len();
        memory::ensure(count * size_of::<Moments<1>>() + surface.z.len() * 16)?;
        let nothing = Moments::about(Point::pixel(0, 0), 0.0);
        let mut triangles = vec![nothing; count];
        let vectors = Vectors::best();
        spread(progress, triangles.chunks_mut(CHUNK).enumerate(), |(chunk, triangles), progress| {
            for (t, moments) in (chunk * CHUNK..).zip(triangles) {
                *moments = moments_of(surface, t as u32, target, vectors);
            }
            progress.poll(64 * CHUNK, || (chunk * CHUNK) as f64 / count as f64)
        })?;
        Ok(Sight { triangles, vertices: stands(surface, target, progress)? })
    }
}

/// Of so many triangles or vertices.
pub fn chunks(count: usize) -> impl ExactSizeIterator<Item = std::ops::Range<usize>> + Send {
    let starts = 0..count.div_ceil(CHUNK);
    starts.map(move |i| i * CHUNK..count.min((i + 1) * CHUNK))
}

/// The height of the image where each vertex stands, NaN for scaffolding.
pub fn stands<T: Height>(surface: &Surface, target: &Grid<T>, progress: &mut Progress) -> Result<Vec<f64>> {
    let Surface { mesh, z, .. } = surface;
    let heights = spread(progress, chunks(z.len()), |chunk, progress| {
        progress.poll(4 * chunk.len(), || 0.0)?;
        let height = |v: usize| {
            let p = mesh.point(v as u32);
            let here = p.as_pixel().map_or(f64::NAN, |(col, row)| target.at(col, row));
            let is_known = !here.is_nan() || z[v].is_nan();
            if is_known {
                here + 0.0 * z[v]
            } else {
                target.interpolate(p)
            }
        };
        Ok(chunk.map(height).collect::<Vec<_>>())
    })?;
    Ok(heights.concat())
}

/// An image with `K` values a pixel, the first of which is a height.
pub trait Image<const K: usize> {
    /// Columns `first..end` of a row. Must be `#[inline(always)]`.
    fn pixels(&self, row: usize, first: usize, end: usize) -> impl ExactSizeIterator<Item = [f64; K]>;
}

impl<T: Height> Image<1> for Grid<'_, T> {
    #[inline(always)]
    fn pixels(&self, row: usize, first: usize, end: usize) -> impl ExactSizeIterator<Item = [f64; 1]> {
        self.row(row)[first..end].iter().map(|z| [z.to_f64()])
    }
}

/// Over the pixels that triangle `t` owns.
#[inline(always)]
pub fn moments_of<const K: usize>(
    surface: &Surface,
    t: u32,
    image: &impl Image<K>,
    vectors: Vectors,
) -> Moments<K> {
    let mesh = &surface.mesh;
    let v = mesh.triangle(t).v[0];
    let empty = Moments::about(mesh.point(v), surface.z[v as usize]);
    if mesh.triangle(t).is_void() {
        return empty;
    }
    let owned = [0, 1, 2].map(|k| owns_edge(mesh, half_edge(t, k)));
    sum_over(empty, mesh.corners(t), owned, image, vectors)
}

/// Fills empty moments with a triangle `p` and its owned edges, valid pixels only.
#[inline(always)]
pub fn sum_over<const K: usize>(
    empty: Moments<K>,
    p: [Point; 3],
    owned: [bool; 3],
    image: &impl Image<K>,
    vectors: Vectors,
) -> Moments<K> {
    let mut moments = vectors.run(Sum { moments: empty, p, owned, image });
    if moments.has_nan() {
        moments = empty;
        for_each_span(p, owned, |row, first, end| {
            moments.add_valid(row, first, image.pixels(row, first, end));
        });
    }
    moments
}

/// Adds a triangle to the moments, all values of a pixel at once.
struct Sum<'a, const K: usize, I> {
    moments: Moments<K>,
    p: [Point; 3],
    owned: [bool; 3],
    image: &'a I,
}

impl<const K: usize, I: Image<K>> Kernel for Sum<'_, K, I> {
    type Output = Moments<K>;

    #[inline(always)]
    fn run<L: Lanes>(self) -> Moments<K> {
        let mut rows = Rows { moments: self.moments, image: self.image };
        for_each_span(self.p, self.owned, &mut rows);
        rows.moments
    }
}

struct Rows<'a, const K: usize, I> {
    moments: Moments<K>,
    image: &'a I,
}

impl<const K: usize, I: Image<K>> Visitor for &mut Rows<'_, K, I> {
    #[inline(always)]
    fn visit(&mut self, row: usize, first: usize, end: usize) {
        self.moments.add_row(row, first, self.image.pixels(row, first, end));
    }
}
