//! What the finished mesh looks like on the grid: the surface and its errors.

use crate::error::Result;
use crate::grid::{Grid, Height};
use crate::memory;
use crate::mesh::Mesh;
use crate::progress::Progress;
use crate::scan::{for_each_pixel, for_each_plane_row, Corners};
use crate::visited::Visited;

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

/// Number of valid pixels that the mesh covers.
pub fn count_covered<T: Height>(mesh: &Mesh, grid: &Grid<T>, progress: &mut Progress) -> Result<usize> {
    memory::ensure(grid.z().len() / 8)?;
    let mut seen = Visited::new(grid.z().len());
    let mut count = 0;
    for t in (0..mesh.triangles().len() as u32).filter(|&t| !mesh.triangle(t).is_void()) {
        let mut work = 16;
        for_each_pixel(grid, mesh.corners(t), [0.0; 3], Corners::Included, |col, row, _, _| {
            count += usize::from(seen.insert(row * grid.cols() + col));
            work += 1;
        });
        progress.poll(work, || 0.0)?;
    }
    Ok(count)
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
    for t in 0..mesh.triangles().len() as u32 {
        let triangle = mesh.triangle(t);
        if triangle.is_void() {
            continue;
        }
        let mut work = 16;
        for_each_plane_row(mesh.corners(t), triangle.v.map(|v| z[v as usize]), |row, first, end, plane| {
            for (col, pixel) in (first..end).zip(&mut surface[row * cols + first..row * cols + end]) {
                if pixel.to_f64().is_nan() {
                    *pixel = T::from_f64(plane.at(col));
                }
            }
            work += end - first;
        });
        progress.poll(work, || f64::from(t) / mesh.triangles().len() as f64)?;
    }
    Ok(surface)
}

/// Compares the mesh with `grid`, each pixel once, and gives the largest absolute
/// error in every triangle (closed) as well.
pub fn errors<T: Height>(
    mesh: &Mesh,
    z: &[f64],
    grid: &Grid<T>,
    progress: &mut Progress,
) -> Result<(Errors, Vec<f64>)> {
    memory::ensure(grid.z().len() * 5 + mesh.triangles().len() * 8)?;
    let mut seen = Visited::new(grid.z().len());
    let mut largest = vec![0.0f64; mesh.triangles().len()];
    let mut absolute: Vec<f32> = Vec::with_capacity(grid.z().len());
    // How many errors share the upper half of their bits, which sorts like the values.
    let mut classes = vec![0usize; 1 << 16];
    let mut result = Errors::default();
    let (mut squares, mut sum, mut signed) = (0.0, 0.0, 0.0);
    for t in 0..mesh.triangles().len() as u32 {
        let triangle = mesh.triangle(t);
        if triangle.is_void() {
            continue;
        }
        let worst = &mut largest[t as usize];
        let (p, heights) = (mesh.corners(t), triangle.v.map(|v| z[v as usize]));
        let mut work = 16;
        for_each_pixel(grid, p, heights, Corners::Included, |col, row, height, plane| {
            let error = plane - height;
            *worst = worst.max(error.abs());
            work += 1;
            if seen.insert(row * grid.cols() + col) {
                squares += error * error;
                sum += error.abs();
                signed += error;
                let error = error.abs() as f32;
                absolute.push(error);
                classes[(error.to_bits() >> 16) as usize] += 1;
            }
        });
        for_each_plane_row(p, heights, |row, first, end, _| {
            let mut void = |col: usize| !grid.is_valid(col, row) && seen.insert(row * grid.cols() + col);
            result.void_covered += (first..end).filter(|&col| void(col)).count();
        });
        result.max = result.max.max(*worst);
        progress.poll(2 * work, || f64::from(t) / mesh.triangles().len() as f64)?;
    }
    progress.check(1.0)?;
    result.covered = absolute.len();
    result.uncovered = grid.count_valid() - result.covered;
    if result.covered > 0 {
        let n = result.covered as f64;
        (result.rmse, result.mae, result.mean) = ((squares / n).sqrt(), sum / n, signed / n);
        let mut index = (n * 0.95).ceil() as usize - 1;
        let mut class = 0;
        while index >= classes[class] {
            index -= classes[class];
            class += 1;
        }
        absolute.retain(|error| (error.to_bits() >> 16) as usize == class);
        result.p95 = f64::from(*absolute.select_nth_unstable_by(index, f32::total_cmp).1);
        progress.check(1.0)?;
    }
    Ok((result, largest))
}
