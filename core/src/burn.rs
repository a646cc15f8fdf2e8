//! Hard edges in the images: the pixels beside them take the height of the edge, or
//! they would become vertices that stand off it like a wall.

use crate::grid::Height;
use crate::mesh::{half_edge, NONE};
use crate::predicate::{Point, UNIT};
use crate::surface::Surface;
use std::borrow::Cow;

/// Pixels within this distance (in pixels) of a hard edge count as lying on it.
const REACH: f64 = 0.25;

/// The pixels, as `row * cols + col`, within a quarter of a pixel of the hard edges,
/// and the heights of these there.
pub fn hard_pixels(surface: &Surface, rows: usize, cols: usize) -> Vec<(usize, f64)> {
    let mesh = &surface.mesh;
    let mut found = Vec::new();
    for h in (0..mesh.triangles().len() as u32).flat_map(|t| [0, 1, 2].map(|k| half_edge(t, k))) {
        let twin = mesh.twin(h);
        if mesh.is_hard(h) && (twin == NONE || h < twin) {
            let ends = [mesh.origin(h), mesh.dest(h)].map(|v| (mesh.point(v), surface.z[v as usize]));
            beside(ends, [cols, rows], |col, row, z| found.push((row * cols + col, z)));
        }
    }
    found
}

/// Calls `visit(col, row, height)` for the pixels of the raster beside the edge.
fn beside(ends: [(Point, f64); 2], size: [usize; 2], mut visit: impl FnMut(usize, usize, f64)) {
    let pixels = |p: Point| [p.x, p.y].map(|v| f64::from(v) / f64::from(UNIT));
    let [a, b] = ends.map(|(p, _)| pixels(p));
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
            let height = ends[0].1 + nearest * (ends[1].1 - ends[0].1);
            visit(q[0] as usize, q[1] as usize, height);
        }
        at += 1.0;
    }
}

/// Puts the heights into the pixels of the image that are not void.
pub fn burn<T: Height>(image: &mut Cow<[T]>, pixels: &[(usize, f64)]) {
    for &(pixel, z) in pixels {
        let z = T::from_f64(z);
        // A copy is made only for a change.
        if !image[pixel].to_f64().is_nan() && image[pixel].to_f64() != z.to_f64() {
            image.to_mut()[pixel] = z;
        }
    }
}
