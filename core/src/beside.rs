//! The pixels beside hard edges, which are left out of the images: the edge says how
//! high the surface is there, and a vertex a hair off would stand beside it like a wall.

use crate::grid::Height;
use crate::mesh::{half_edge, Mesh, NONE};
use crate::predicate::{Point, UNIT};
use std::borrow::Cow;

/// Pixels within this distance (in pixels) of a hard edge count as lying on it.
const REACH: f64 = 0.25;

/// The pixels, ascending as `row * cols + col`, within a quarter of a pixel of the hard edges.
pub fn beside_hard_edges(mesh: &Mesh, rows: usize, cols: usize) -> Vec<usize> {
    let mut found = Vec::new();
    for h in (0..mesh.triangles().len() as u32).flat_map(|t| [0, 1, 2].map(|k| half_edge(t, k))) {
        let twin = mesh.twin(h);
        if mesh.is_hard(h) && (twin == NONE || h < twin) {
            let ends = [mesh.origin(h), mesh.dest(h)].map(|v| mesh.point(v));
            beside(ends, [cols, rows], |col, row| found.push(row * cols + col));
        }
    }
    found.sort_unstable();
    found.dedup();
    found
}

/// Calls `visit(col, row)` for the pixels of the raster beside the edge.
fn beside(ends: [Point; 2], size: [usize; 2], mut visit: impl FnMut(usize, usize)) {
    let [a, b] = ends.map(|p| [p.x, p.y].map(|v| f64::from(v) / f64::from(UNIT)));
    let step = [b[0] - a[0], b[1] - a[1]];
    // Along the longer axis at most one pixel of each line is near enough.
    let (along, across) = if step[0].abs() > step[1].abs() { (0, 1) } else { (1, 0) };
    let (low, high) = (a[along].min(b[along]), a[along].max(b[along]));
    let last = (size[along] - 1) as f64;
    let mut at = (low - REACH).ceil().max(0.0);
    while at <= (high + REACH).floor().min(last) {
        let share = ((at - a[along]) / step[along]).clamp(0.0, 1.0);
        let mut q = [at; 2];
        q[across] = (a[across] + share * step[across]).round();
        let length2 = step[0] * step[0] + step[1] * step[1];
        let nearest = (((q[0] - a[0]) * step[0] + (q[1] - a[1]) * step[1]) / length2).clamp(0.0, 1.0);
        let apart = (q[0] - a[0] - nearest * step[0]).hypot(q[1] - a[1] - nearest * step[1]);
        if apart <= REACH {
            visit(q[0] as usize, q[1] as usize);
        }
        at += 1.0;
    }
}

/// Makes void of the pixels.
pub fn leave_out<T: Height>(image: &mut Cow<[T]>, pixels: &[usize]) {
    for &pixel in pixels {
        // A copy is made only for a change.
        if !image[pixel].to_f64().is_nan() {
            image.to_mut()[pixel] = T::from_f64(f64::NAN);
        }
    }
}
