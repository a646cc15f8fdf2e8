//! What the finished mesh looks like on the grid: the surface and its errors.

use crate::error::Result;
use crate::grid::{Grid, Height};
use crate::memory;
use crate::mesh::Mesh;
use crate::predicate::{Point, SUB_BITS};
use crate::progress::Progress;
use crate::scan::{for_each_plane_row, PlaneRow};
use crate::threads::spread;
use crate::top::Top;
use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

/// Error statistics over the valid pixels that the mesh covers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Errors {
    pub rmse: f64,
    pub mae: f64,
    /// 95 % of the pixels have at most this absolute error.
    pub p95: f64,
    pub max: f64,
    /// Signed mean of mesh minus DEM.
    pub mean: f64,
    pub covered: usize,
    /// Valid pixels that no triangle covers.
    pub uncovered: usize,
    /// Void pixels that a triangle covers.
    pub void_covered: usize,
}

/// Rows that one thread looks at at a time.
const BAND: usize = 32;
/// Triangles whose rows are known together: neighbours in number are mostly neighbours in
/// place, so that a band meets few blocks.
const BLOCK: usize = 64;

/// A mesh on a raster, band by band.
struct Bands<'m> {
    mesh: &'m Mesh,
    rows: usize,
    /// What a block of triangles spans.
    blocks: Vec<Range<usize>>,
}

impl<'m> Bands<'m> {
    fn new(mesh: &'m Mesh, rows: usize) -> Self {
        let corners = |t: usize| mesh.corners(t as u32).into_iter();
        let count = mesh.triangles().len();
        let blocks = (0..count).step_by(BLOCK);
        let blocks = blocks.map(|from| span((from..count.min(from + BLOCK)).flat_map(corners))).collect();
        Bands { mesh, rows, blocks }
    }

    fn rows(&self, band: usize) -> Range<usize> {
        band * BAND..((band + 1) * BAND).min(self.rows)
    }

    /// Calls `visit(t)`, which says how much work it was, for the triangles that meet `rows`,
    /// the last first: a caller who overwrites leaves, where triangles meet, what the first
    /// one says.
    fn for_each(
        &self,
        rows: &Range<usize>,
        progress: &mut Progress,
        mut visit: impl FnMut(u32) -> usize,
    ) -> Result<()> {
        let meets = |span: &Range<usize>| span.start < rows.end && rows.start < span.end;
        let count = self.mesh.triangles().len();
        for (i, _) in self.blocks.iter().enumerate().rev().filter(|block| meets(block.1)) {
            for t in (i * BLOCK..count.min((i + 1) * BLOCK)).rev().map(|t| t as u32) {
                if !self.mesh.triangle(t).is_void() && meets(&span(self.mesh.corners(t).into_iter())) {
                    let work = 16 + visit(t);
                    progress.poll(work, || 1.0 - f64::from(t) / count as f64)?;
                }
            }
        }
        Ok(())
    }

    /// Calls `visit(row, columns, plane)` for the pixels of a triangle in `rows`; returns how
    /// many they are.
    fn walk(
        &self,
        t: u32,
        heights: [f64; 3],
        rows: &Range<usize>,
        mut visit: impl FnMut(usize, Range<usize>, PlaneRow),
    ) -> usize {
        let mut work = 0;
        for_each_plane_row(self.mesh.corners(t), heights, |row, first, end, plane| {
            if rows.contains(&row) {
                visit(row, first..end, plane);
                work += end - first;
            }
        });
        work
    }

    fn heights(&self, t: u32, z: &[f64]) -> [f64; 3] {
        self.mesh.triangle(t).v.map(|v| z[v as usize])
    }
}

/// The rows of pixels that some points span.
fn span(points: impl Iterator<Item = Point>) -> Range<usize> {
    let (low, high) = points.fold((i32::MAX, 0), |(low, high), p| (low.min(p.y), high.max(p.y)));
    (low >> SUB_BITS) as usize..(high >> SUB_BITS) as usize + 1
}

/// Number of valid pixels that the mesh covers.
pub fn count_covered<T: Height>(mesh: &Mesh, grid: &Grid<T>, progress: &mut Progress) -> Result<usize> {
    let (bands, cols) = (Bands::new(mesh, grid.rows()), grid.cols());
    let counts = spread(progress, grid.z().chunks(BAND * cols).enumerate(), |(band, heights), progress| {
        let rows = bands.rows(band);
        let mut is_covered = vec![false; heights.len()];
        bands.for_each(&rows, progress, |t| {
            bands.walk(t, [0.0; 3], &rows, |row, columns, _| {
                is_covered[(row - rows.start) * cols..][columns].fill(true);
            })
        })?;
        Ok(is_covered.iter().zip(heights).filter(|(&covered, z)| covered & !z.to_f64().is_nan()).count())
    })?;
    Ok(counts.iter().sum())
}

/// Heights of the mesh on every pixel centre; NaN where no triangle is. Where
/// triangles meet, the first one's height stands.
pub fn rasterise<T: Height>(
    mesh: &Mesh,
    z: &[f64],
    rows: usize,
    cols: usize,
    progress: &mut Progress,
) -> Result<Vec<T>> {
    memory::ensure(rows * cols * size_of::<T>())?;
    let mut surface = vec![T::from_f64(f64::NAN); rows * cols];
    let bands = Bands::new(mesh, rows);
    spread(progress, surface.chunks_mut(BAND * cols).enumerate(), |(band, into), progress| {
        let rows = bands.rows(band);
        bands.for_each(&rows, progress, |t| {
            bands.walk(t, bands.heights(t, z), &rows, |row, columns, plane| {
                let into = &mut into[(row - rows.start) * cols..][columns.clone()];
                for (col, pixel) in columns.zip(into) {
                    *pixel = T::from_f64(plane.at(col));
                }
            })
        })
    })?;
    Ok(surface)
}

/// How many of `count` errors come after their P95.
fn beyond(count: usize) -> usize {
    count - (count as f64 * 0.95).ceil() as usize
}

/// Compares the mesh with `grid`, each pixel once, and gives the largest absolute
/// error in every triangle (closed) as well.
pub fn errors<T: Height>(
    mesh: &Mesh,
    z: &[f64],
    grid: &Grid<T>,
    progress: &mut Progress,
) -> Result<(Errors, Vec<f64>)> {
    let (pixels, cols) = (grid.z().len(), grid.cols());
    let kept = beyond(pixels) + 2;
    memory::ensure(mesh.triangles().len() * 8 + 12 * kept + progress.threads() * BAND * cols * 12)?;
    // Bits, which of numbers that are not negative sort like the values.
    let largest: Vec<AtomicU64> = mesh.triangles().iter().map(|_| AtomicU64::new(0)).collect();
    let top = Mutex::new(Top::new(kept));
    let bands = Bands::new(mesh, grid.rows());
    let parts = spread(progress, grid.z().chunks(BAND * cols).enumerate(), |(band, heights), progress| {
        let rows = bands.rows(band);
        let mut errors = vec![f64::INFINITY; heights.len().next_multiple_of(LANES)];
        bands.for_each(&rows, progress, |t| {
            let mut worst = 0.0;
            let work = bands.walk(t, bands.heights(t, z), &rows, |row, columns, plane| {
                let start = (row - rows.start) * cols;
                let pixels = start + columns.start..start + columns.end;
                let into = errors[pixels.clone()].iter_mut().zip(&heights[pixels]);
                for (col, (into, z)) in columns.zip(into) {
                    *into = plane.at(col) - z.to_f64();
                    worst = if into.abs() > worst { into.abs() } else { worst };
                }
            });
            largest[t as usize].fetch_max(worst.to_bits(), Ordering::Relaxed);
            work
        })?;
        let open = || top.lock().unwrap_or_else(PoisonError::into_inner);
        let least = open().least();
        let known = errors.iter().filter(|error| error.is_finite()).map(|error| error.abs());
        let large: Vec<f64> = known.filter(|&error| error >= least).collect();
        open().extend(&large);
        Ok(Sums::over(&errors, heights))
    })?;
    let largest: Vec<f64> = largest.into_iter().map(|bits| f64::from_bits(bits.into_inner())).collect();
    let mut all = Sums::default();
    parts.iter().for_each(|part| all.add(part));
    let n = all.covered.max(1) as f64;
    let p95 = top.into_inner().unwrap_or_else(PoisonError::into_inner).nth(beyond(all.covered));
    let result = Errors {
        rmse: (all.squares / n).sqrt(),
        mae: all.absolute / n,
        p95: p95.unwrap_or(0.0),
        max: largest.iter().fold(0.0, |most, &error| most.max(error)),
        mean: all.signed / n,
        covered: all.covered,
        uncovered: all.valid - all.covered,
        void_covered: all.void_covered,
    };
    Ok((result, largest))
}

/// What the statistics are made of.
#[derive(Default)]
struct Sums {
    squares: f64,
    absolute: f64,
    signed: f64,
    covered: usize,
    void_covered: usize,
    valid: usize,
}

/// Numbers summed side by side, so that it vectorises.
const LANES: usize = 4;

impl Sums {
    /// Over `errors`, a multiple of the lanes: infinite where no triangle is, NaN in voids.
    fn over<T: Height>(errors: &[f64], heights: &[T]) -> Self {
        let (mut squares, mut absolute, mut signed) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
        for chunk in errors.chunks_exact(LANES) {
            for lane in 0..LANES {
                let error = if chunk[lane].abs() < f64::INFINITY { chunk[lane] } else { 0.0 };
                squares[lane] += error * error;
                absolute[lane] += error.abs();
                signed[lane] += error;
            }
        }
        Sums {
            squares: squares.iter().sum(),
            absolute: absolute.iter().sum(),
            signed: signed.iter().sum(),
            covered: errors.iter().filter(|error| error.is_finite()).count(),
            void_covered: errors.iter().filter(|error| error.is_nan()).count(),
            valid: heights.iter().filter(|z| !z.to_f64().is_nan()).count(),
        }
    }

    fn add(&mut self, other: &Sums) {
        self.squares += other.squares;
        self.absolute += other.absolute;
        self.signed += other.signed;
        self.covered += other.covered;
        self.void_covered += other.void_covered;
        self.valid += other.valid;
    }
}
