//! Bringing single triangles of a finished mesh back within the tolerance.

use crate::error::Result;
use crate::grid::{Grid, Height};
use crate::mesh::{triangle_of, Class};
use crate::predicate::Point;
use crate::progress::Progress;
use crate::rule::Stop;
use crate::scan::for_each_pixel;
use crate::surface::Surface;
use crate::threads::spread;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// A triangle beyond the tolerance, ordered by its worst error (whose bits these are: of
/// numbers that are not negative they sort like the values), then by pixel.
type Entry = (u64, Reverse<(usize, usize)>, u32, u32);

/// Triangles that one thread looks at in a row.
const AT_ONCE: usize = 1024;

/// Inserts the worst pixels of the triangles `suspect`, and of those that this changes, until
/// they are within the tolerance or there are `max_points` vertices with a height.
pub fn repair<T: Height>(
    surface: &mut Surface,
    grid: &Grid<T>,
    tolerance: f64,
    suspect: &[u32],
    max_points: usize,
    progress: &mut Progress,
) -> Result<Stop> {
    let mut queue: BinaryHeap<Entry> = BinaryHeap::new();
    let whole = &*surface;
    let found = spread(progress, suspect.chunks(AT_ONCE), |part, progress| {
        progress.poll(256 * part.len(), || 1.0)?;
        Ok(part.iter().filter_map(|&t| entry(whole, grid, tolerance, t)).collect::<Vec<_>>())
    })?;
    queue.extend(found.into_iter().flatten());
    let mut left = max_points.saturating_sub(surface.count());
    while let Some((_, Reverse((row, col)), t, version)) = queue.pop() {
        if surface.mesh.triangle(t).version != version {
            continue;
        }
        if left == 0 {
            return Ok(Stop::Points);
        }
        let place = surface.mesh.place_in(Point::pixel(col, row), t);
        let v = surface.insert_pixel((col, row), place, grid.at(col, row));
        let around: Vec<u32> =
            surface.mesh.fan(surface.mesh.leaving(place.triangle(), v)).map(triangle_of).collect();
        queue.extend(around.into_iter().filter_map(|t| entry(surface, grid, tolerance, t)));
        left -= 1;
        progress.poll(1024, || 1.0)?;
    }
    Ok(Stop::Tolerance)
}

/// The worst pixel of triangle `t` that is no corner of it, if it is beyond the tolerance.
fn entry<T: Height>(surface: &Surface, grid: &Grid<T>, tolerance: f64, t: u32) -> Option<Entry> {
    let triangle = surface.mesh.triangle(t);
    if triangle.class() != Class::Data {
        return None;
    }
    let p = surface.mesh.corners(t);
    let mut worst = (tolerance, None);
    for_each_pixel(grid, p, surface.heights(t), |col, row, z, plane| {
        let error = (z - plane).abs();
        if error > worst.0 && !p.contains(&Point::pixel(col, row)) {
            worst = (error, Some((row, col)));
        }
    });
    worst.1.map(|pixel| (worst.0.to_bits(), Reverse(pixel), t, triangle.version))
}
