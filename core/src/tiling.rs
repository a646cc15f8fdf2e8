//! The fixed tiles that a raster is refined in: parts small enough for the cache, which do
//! not know of each other but for the seams between them.

use crate::predicate::{Point, SUB_BITS};
use crate::window::Window;

/// The grid of tiles. Neighbours share the row or column of pixels between them.
#[derive(Clone, Debug)]
pub struct Tiling {
    /// Columns and rows of the seams and of the raster's border, ascending.
    columns: Vec<usize>,
    rows: Vec<usize>,
}

/// Seams every `step` pixels from the first on; the last part is between half a step and
/// one and a half.
fn cuts(pixels: usize, step: usize) -> Vec<usize> {
    let last = pixels - 1;
    let count = (last + step / 2).checked_div(step).unwrap_or(1).max(1);
    (0..count).map(|i| i * step).chain([last]).collect()
}

impl Tiling {
    /// `step`: side of a tile in pixels, 0 for a single tile.
    pub fn new(rows: usize, cols: usize, step: usize) -> Self {
        Tiling { columns: cuts(cols, step), rows: cuts(rows, step) }
    }

    pub fn count(&self) -> usize {
        (self.columns.len() - 1) * (self.rows.len() - 1)
    }

    /// The pixels of a tile, those on its seams included.
    pub fn window(&self, tile: usize) -> Window {
        let across = self.columns.len() - 1;
        let (i, j) = (tile % across, tile / across);
        let (col, row) = (self.columns[i], self.rows[j]);
        Window { col, row, cols: self.columns[i + 1] - col + 1, rows: self.rows[j + 1] - row + 1 }
    }

    /// The tile that holds the centroid of a triangle.
    pub fn tile_of(&self, [a, b, c]: [Point; 3]) -> usize {
        let pixel = |a: i32, b: i32, c: i32| ((i64::from(a) + i64::from(b) + i64::from(c)) / 3) >> SUB_BITS;
        let part = |cuts: &[usize], at: i64| cuts[1..cuts.len() - 1].partition_point(|&cut| cut as i64 <= at);
        let i = part(&self.columns, pixel(a.x, b.x, c.x));
        part(&self.rows, pixel(a.y, b.y, c.y)) * (self.columns.len() - 1) + i
    }

    /// The columns and the rows that seams lie on.
    pub fn seam_lines(&self) -> (&[usize], &[usize]) {
        let inner = |cuts: &'_ [usize]| 1..cuts.len() - 1;
        (&self.columns[inner(&self.columns)], &self.rows[inner(&self.rows)])
    }

    /// The seams, as the points where they start, meet and end.
    pub fn seams(&self) -> Vec<Vec<Point>> {
        let (columns, rows) = self.seam_lines();
        let across = rows.iter().map(|&row| line(&self.columns, |col| Point::pixel(col, row)));
        let down = columns.iter().map(|&col| line(&self.rows, |row| Point::pixel(col, row)));
        across.chain(down).collect()
    }

    /// The tiles on either side of a pixel on a seam, and whether the seam runs along a row.
    /// Nothing at the corners of tiles.
    pub fn beside(&self, col: usize, row: usize) -> Option<[usize; 2]> {
        let across = self.columns.len() - 1;
        match (self.columns.binary_search(&col), self.rows.binary_search(&row)) {
            (Ok(i), Err(j)) => Some([(j - 1) * across + i - 1, (j - 1) * across + i]),
            (Err(i), Ok(j)) => Some([(j - 1) * across + i - 1, j * across + i - 1]),
            _ => None,
        }
    }

    /// Pixels on the border of a window that lie on seams, not on the border of the raster.
    pub fn on_seams(&self, window: Window) -> impl Iterator<Item = Point> + '_ {
        let Window { col, row, cols, rows } = window;
        let (across, down) = self.seam_lines();
        let columns = [col, col + cols - 1].into_iter().filter(|c| across.binary_search(c).is_ok());
        let lines = [row, row + rows - 1].into_iter().filter(|r| down.binary_search(r).is_ok());
        let down = columns.flat_map(move |c| (row..row + rows).map(move |r| Point::pixel(c, r)));
        down.chain(lines.flat_map(move |r| (col..col + cols).map(move |c| Point::pixel(c, r))))
    }
}

fn line(cuts: &[usize], point: impl Fn(usize) -> Point) -> Vec<Point> {
    cuts.iter().map(|&at| point(at)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_tile_takes_what_is_left() {
        assert_eq!(cuts(1025, 512), [0, 512, 1024]);
        assert_eq!(cuts(1024, 512), [0, 512, 1023]);
        assert_eq!(cuts(768, 512), [0, 767]);
        assert_eq!(cuts(769, 512), [0, 512, 768]);
        assert_eq!(cuts(2, 512), [0, 1]);
        assert_eq!(cuts(9999, 0), [0, 9998]);
    }

    #[test]
    fn tiles_cover_the_raster_and_meet_on_seams() {
        let tiling = Tiling::new(23, 37, 8);
        let mut seen = vec![0; 23 * 37];
        for tile in 0..tiling.count() {
            let Window { col, row, cols, rows } = tiling.window(tile);
            for (c, r) in (row..row + rows).flat_map(|r| (col..col + cols).map(move |c| (c, r))) {
                seen[r * 37 + c] += 1;
                if seen[r * 37 + c] == 2 {
                    assert!(tiling.on_seams(tiling.window(tile)).any(|p| p == Point::pixel(c, r)));
                }
                if let Some(tiles) = tiling.beside(c, r) {
                    assert!(tiles.contains(&tile));
                }
            }
            let corner = Point::pixel(col, row);
            let towards = |dx, dy| Point { x: corner.x + dx, y: corner.y + dy };
            assert_eq!(tiling.tile_of([corner, towards(256, 0), towards(0, 256)]), tile);
        }
        assert!(seen.iter().all(|&n| n > 0));
    }
}
