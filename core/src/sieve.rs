//! Small islands and holes of the data, left out of its outline.

use crate::error::Result;
use crate::grid::{Grid, Height};
use crate::progress::Progress;

/// The mask of the data (0 or NaN) without its islands of fewer than `least` pixels,
/// which touch nothing along a side, and holes of fewer, which touch no other void
/// even at a corner.
pub fn sieve<T: Height>(grid: &Grid<T>, least: usize, progress: &mut Progress) -> Result<Vec<f32>> {
    let mask = |is_valid: bool| if is_valid { 0.0f32 } else { f32::NAN };
    let mut sieved: Vec<f32> = grid.z().iter().map(|z| mask(!z.to_f64().is_nan())).collect();
    let (rows, cols) = (grid.rows() as isize, grid.cols() as isize);
    // Islands first: what they leave may join the void around them.
    for is_valid in [true, false] {
        let steps: &[(isize, isize)] =
            &[(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, 1), (1, -1), (-1, -1)];
        let steps = if is_valid { &steps[..4] } else { steps };
        let mut is_seen = vec![false; sieved.len()];
        for start in 0..sieved.len() {
            if is_seen[start] || sieved[start].is_nan() == is_valid {
                continue;
            }
            is_seen[start] = true;
            let mut patch = vec![start];
            let mut touches_border = false;
            let mut next = 0;
            while next < patch.len() {
                let (col, row) = (patch[next] as isize % cols, patch[next] as isize / cols);
                touches_border |= col == 0 || row == 0 || col == cols - 1 || row == rows - 1;
                for (dx, dy) in steps {
                    let (c, r) = (col + dx, row + dy);
                    if c < 0 || r < 0 || c >= cols || r >= rows {
                        continue;
                    }
                    let i = (r * cols + c) as usize;
                    if !is_seen[i] && sieved[i].is_nan() != is_valid {
                        is_seen[i] = true;
                        patch.push(i);
                    }
                }
                next += 1;
                progress.poll(8, || start as f64 / is_seen.len() as f64)?;
            }
            // Void at the border of the raster is no hole.
            if patch.len() < least && (is_valid || !touches_border) {
                patch.iter().for_each(|&i| sieved[i] = mask(!is_valid));
            }
        }
    }
    Ok(sieved)
}
