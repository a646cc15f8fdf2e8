//! An image to refine: heights that are there, or smoothed ones, made where they are looked at.

use crate::error::Result;
use crate::grid::{Grid, Height};
use crate::lanes::Vectors;
use crate::memory;
use crate::predicate::Point;
use crate::progress::Progress;
use crate::scale::{kernel, reach};
use crate::smoother::Smoother;
use crate::threads::spread;
use crate::tiling::Tiling;
use crate::window::Window;
use std::ops::Range;

/// Smoothed time and again an image takes a tenth more time for a refinement than held: up to this size
/// in bytes its memory is not worth that,
const SMALL: usize = 1 << 26;
/// and a kernel that reaches farther takes more.
const FARTHEST: usize = 4;

pub enum Image<'a, T: Height> {
    Held(Grid<'a, T>),
    Smoothed(Smoothed<'a, T>),
}

/// What smoothed images are made from that a raster is refined by in tiles.
#[derive(Clone, Copy)]
pub struct Source<'a, T> {
    pub grid: Grid<'a, T>,
    /// Pixels that are void in the image, ascending, as `row * cols + col`.
    pub left_out: &'a [usize],
    pub tiling: &'a Tiling,
}

/// A Gaussian image that is nowhere as a whole.
pub struct Smoothed<'a, T: Height> {
    source: Source<'a, T>,
    kernels: [Vec<f64>; 2],
    /// The seams along rows and along columns: where each lies, and its heights.
    rows: Vec<(usize, Vec<T>)>,
    columns: Vec<(usize, Vec<T>)>,
}

/// Whether it pays to smooth by tile, by each of these standard deviations, rather than to hold an image.
pub fn is_by_tile<T>(z: &[T], sigmas: &[[f64; 2]]) -> bool {
    size_of_val(z) > SMALL && sigmas.iter().flatten().all(|&sigma| reach(sigma) <= FARTHEST)
}

impl<'a, T: Height> Smoothed<'a, T> {
    /// By `sigma` = [x, y] pixels. Errors: `out-of-memory`, `cancelled`.
    fn new(source: Source<'a, T>, sigma: [f64; 2], progress: &mut Progress) -> Result<Self> {
        let kernels = sigma.map(kernel);
        let mut smoothed = Smoothed { source, kernels, rows: Vec::new(), columns: Vec::new() };
        let ((columns, rows), grid) = (source.tiling.seam_lines(), source.grid);
        let across = rows.iter().map(|&row| Window { col: 0, row, cols: grid.cols(), rows: 1 });
        let down = columns.iter().map(|&col| Window { col, row: 0, cols: 1, rows: grid.rows() });
        let windows: Vec<Window> = across.chain(down).collect();
        let mut lines = spread(progress, windows.into_iter(), |window, progress| {
            let mut view = smoothed.view()?;
            view.show(window, progress)?;
            Ok(view.into_heights())
        })?;
        let of_columns = lines.split_off(rows.len());
        smoothed.rows = rows.iter().copied().zip(lines).collect();
        smoothed.columns = columns.iter().copied().zip(of_columns).collect();
        Ok(smoothed)
    }

    fn view(&self) -> Result<View<'_, T>> {
        let smoother = Smoother::new(&self.source.grid, &self.kernels, Vectors::best())?;
        let window = Window { col: 0, row: 0, cols: 0, rows: 0 };
        let shown = Shown { smoother, left_out: self.source.left_out, window, z: Vec::new() };
        Ok(View { grid: self.source.grid, shown: Some(shown) })
    }
}

impl<'a, T: Height> Image<'a, T> {
    /// Of a scale: smoothed by tile where there is a source for that, otherwise what is held. Errors:
    /// `out-of-memory`, `cancelled`.
    pub fn of(
        held: Grid<'a, T>,
        by_tile: Option<Source<'a, T>>,
        sigma: [f64; 2],
        progress: &mut Progress,
    ) -> Result<Self> {
        match by_tile {
            Some(source) if sigma != [0.0; 2] => Ok(Image::Smoothed(Smoothed::new(source, sigma, progress)?)),
            _ => Ok(Image::Held(held)),
        }
    }

    pub fn rows(&self) -> usize {
        self.grid().rows()
    }

    pub fn cols(&self) -> usize {
        self.grid().cols()
    }

    fn grid(&self) -> &Grid<'_, T> {
        match self {
            Image::Held(grid) => grid,
            Image::Smoothed(smoothed) => &smoothed.source.grid,
        }
    }

    /// Errors: `out-of-memory`.
    pub fn view(&self) -> Result<View<'_, T>> {
        match self {
            Image::Held(grid) => Ok(View::of(grid)),
            Image::Smoothed(smoothed) => smoothed.view(),
        }
    }

    /// Height of a pixel on a seam.
    pub fn on_seam(&self, col: usize, row: usize) -> f64 {
        let Smoothed { rows, columns, .. } = match self {
            Image::Held(grid) => return grid.at(col, row),
            Image::Smoothed(smoothed) => smoothed,
        };
        let line = |lines: &[(usize, Vec<T>)], at: usize, along: usize| {
            let i = lines.binary_search_by_key(&at, |line| line.0).ok()?;
            lines[i].1.get(along).map(|z| z.to_f64())
        };
        line(rows, row, col).or_else(|| line(columns, col, row)).unwrap_or(f64::NAN)
    }
}

/// What is looked at of an image: all of heights that are there, one window of smoothed ones.
pub struct View<'i, T: Height> {
    grid: Grid<'i, T>,
    shown: Option<Shown<'i, T>>,
}

struct Shown<'i, T: Height> {
    smoother: Smoother<'i, T>,
    left_out: &'i [usize],
    window: Window,
    z: Vec<T>,
}

impl<'i, T: Height> View<'i, T> {
    pub fn of(grid: &Grid<'i, T>) -> Self {
        View { grid: *grid, shown: None }
    }

    /// Moves on to other pixels. Errors: `out-of-memory`, `cancelled`.
    pub fn show(&mut self, window: Window, progress: &mut Progress) -> Result<()> {
        let Some(Shown { smoother, left_out, window: shown, z }) = &mut self.shown else { return Ok(()) };
        let count = window.cols * window.rows;
        if z.len() < count {
            memory::ensure(count * size_of::<T>())?;
        }
        z.resize(count, T::from_f64(0.0));
        smoother.window(window, z, progress)?;
        for (row, z) in (window.row..).zip(z.chunks_mut(window.cols)) {
            let first = row * self.grid.cols() + window.col;
            let from = left_out.partition_point(|&pixel| pixel < first);
            for pixel in left_out[from..].iter().take_while(|&&pixel| pixel < first + window.cols) {
                z[pixel - first] = T::from_f64(f64::NAN);
            }
        }
        *shown = window;
        Ok(())
    }

    /// Some columns of a row that is shown.
    #[inline(always)]
    pub fn row(&self, row: usize, columns: Range<usize>) -> &[T] {
        match &self.shown {
            None => &self.grid.row(row)[columns],
            Some(Shown { window, z, .. }) => {
                let start = (row - window.row) * window.cols;
                &z[start + columns.start - window.col..start + columns.end - window.col]
            }
        }
    }

    /// Height of a pixel that is shown.
    #[inline(always)]
    pub fn at(&self, col: usize, row: usize) -> f64 {
        match &self.shown {
            None => self.grid.at(col, row),
            Some(Shown { window, z, .. }) => z[(row - window.row) * window.cols + col - window.col].to_f64(),
        }
    }

    /// Height at a lattice point, as [`Grid::interpolate`] has it. Errors: as [`View::show`].
    pub fn interpolate(&mut self, p: Point, progress: &mut Progress) -> Result<f64> {
        if self.shown.is_none() {
            return Ok(self.grid.interpolate(p));
        }
        let (grid, mut stop) = (self.grid, Ok(()));
        let z = grid.interpolate_by(p, |col, row| {
            // Void stays void.
            if !grid.is_valid(col, row) || stop.is_err() {
                return f64::NAN;
            }
            stop = self.show(Window { col, row, cols: 1, rows: 1 }, progress);
            stop.as_ref().map_or(f64::NAN, |()| self.at(col, row))
        });
        stop.map(|()| z)
    }

    fn into_heights(self) -> Vec<T> {
        self.shown.map_or(Vec::new(), |shown| shown.z)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scale::gaussian;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn what_a_view_shows_is_a_part_of_the_whole_image(
            (rows, cols) in (20usize..60, 20usize..60), sigma in prop::array::uniform2(0.1f64..1.2), step in 5usize..20,
            voids in prop::collection::vec(any::<prop::sample::Index>(), 0..9), left_out in prop::collection::vec(any::<prop::sample::Index>(), 0..9),
            windows in prop::collection::vec((0usize..60, 0usize..60, 1usize..40, 1usize..40), 1..4), x in 0i32..4800, y in 0i32..4800, seed: u64,
        ) {
            let mix = |i: usize| (i as u64 ^ seed).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(29).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            let mut z: Vec<f32> = (0..rows * cols).map(|i| 1000.0 + (mix(i) >> 40) as f32 * 1e-5).collect();
            voids.iter().for_each(|i| z[i.index(rows * cols)] = f32::NAN);
            let mut left_out: Vec<usize> = left_out.iter().map(|i| i.index(rows * cols)).collect();
            left_out.sort_unstable();
            let (mut report, grid, tiling) = (|_, _| true, Grid::new(&z, rows, cols).unwrap(), Tiling::new(rows, cols, step));
            let progress = &mut Progress::new(&mut report);
            let mut whole = gaussian(&grid, sigma, progress).unwrap().into_owned();
            left_out.iter().for_each(|&i| whole[i] = f32::NAN);
            let whole = Grid::new(&whole, rows, cols).unwrap();
            let source = Source { grid, left_out: &left_out, tiling: &tiling };
            let image = Image::of(grid, Some(source), sigma, progress).unwrap();
            prop_assert!(matches!(image, Image::Smoothed(_)));
            let mut view = image.view().unwrap();
            for (col, row, width, height) in windows {
                let (col, row) = (col % cols, row % rows);
                let window = Window { col, row, cols: width.min(cols - col), rows: height.min(rows - row) };
                view.show(window, progress).unwrap();
                for row in row..row + window.rows {
                    let expected = whole.row(row)[col..col + window.cols].iter().map(|z| z.to_bits());
                    prop_assert!(view.row(row, col..col + window.cols).iter().map(|z| z.to_bits()).eq(expected));
                    prop_assert!(view.at(col, row).to_bits() == whole.at(col, row).to_bits());
                }
            }
            let (columns, lines) = tiling.seam_lines();
            let across = lines.iter().flat_map(|&row| (0..cols).map(move |col| (col, row)));
            for (col, row) in columns.iter().flat_map(|&col| (0..rows).map(move |row| (col, row))).chain(across) {
                prop_assert_eq!(image.on_seam(col, row).to_bits(), whole.at(col, row).to_bits());
            }
            let p = Point { x: x.min(Point::pixel(cols - 1, 0).x), y: y.min(Point::pixel(0, rows - 1).y) };
            prop_assert_eq!(view.interpolate(p, progress).unwrap().to_bits(), whole.interpolate(p).to_bits());
        }
    }
}
