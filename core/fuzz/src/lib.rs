//! What the fuzz targets share.

use arbitrary::{Arbitrary, Result, Unstructured};
use dem2tin_core::check::check;
use dem2tin_core::grid::{Grid, Height};
use dem2tin_core::mesh::Mesh;
use dem2tin_core::predicate::{Metric, Point, UNIT};

/// A positive definite form: that of the lattice map (x, y) -> (a x + b y, c y).
pub fn metric(u: &mut Unstructured) -> Result<Metric> {
    let (a, b, c) =
        (i64::from(u8::arbitrary(u)? % 64), i64::from(i8::arbitrary(u)?), i64::from(u8::arbitrary(u)? % 64));
    let (a, c) = (a.max(1), c.max(1));
    Ok(Metric { e: a * a, f: a * b, g: b * b + c * c })
}

/// A point of the rectangle of `cols` x `rows` pixels; half of them are pixel centres.
pub fn point(u: &mut Unstructured, cols: usize, rows: usize) -> Result<Point> {
    let (last_x, last_y) = ((cols as i32 - 1) * UNIT, (rows as i32 - 1) * UNIT);
    if u.ratio(1, 2)? {
        return Ok(Point::pixel(u.int_in_range(0..=cols - 1)?, u.int_in_range(0..=rows - 1)?));
    }
    Ok(Point { x: u.int_in_range(0..=last_x)?, y: u.int_in_range(0..=last_y)? })
}

pub fn assert_sound(mesh: &Mesh, delaunay: bool) {
    if let Err(fault) = check(mesh, delaunay) {
        panic!("{fault}\n{:?}\n{:?}", mesh.points(), mesh.triangles());
    }
}

/// Whether each pixel is a corner of a cell with at least three valid corners.
pub fn in_complex<T: Height>(grid: &Grid<T>) -> Vec<bool> {
    let (rows, cols) = (grid.rows(), grid.cols());
    let mut inside = vec![false; rows * cols];
    for (row, col) in (0..rows - 1).flat_map(|row| (0..cols - 1).map(move |col| (row, col))) {
        let corners = [(col, row), (col + 1, row), (col, row + 1), (col + 1, row + 1)];
        let valid = corners.iter().filter(|&&(col, row)| grid.is_valid(col, row));
        if valid.clone().count() >= 3 {
            valid.for_each(|&(col, row)| inside[row * cols + col] = true);
        }
    }
    inside
}
