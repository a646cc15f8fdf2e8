//! The heights of a part of the raster as the scan wants them: close together, in single
//! precision, and NaN where no candidate can be.

use crate::error::{Error, Result};
use crate::grid::{extent, Grid, Height};
use crate::image::View;
use crate::lanes::{prefetch, LANES};
use crate::memory;
use crate::predicate::{pixels_of, Point, SUB_BITS};
use crate::window::{Window, WIDTH};

/// How heights become single precision.
#[derive(Clone, Copy, Debug)]
pub struct Frame {
    /// What is taken off the heights, of their type.
    reference: f64,
    /// Whether nothing is rounded: so it is where the raster is in single precision.
    is_exact: bool,
    /// The largest |height| over the reference.
    largest: f32,
}

/// Places are numbers of pixels, row after row of the window.
pub struct Patch {
    z: Vec<f32>,
    /// The first place in `z`.
    base: usize,
    stride: usize,
    window: Window,
    frame: Frame,
}

/// The heights of a window, row by row.
fn rows<'a, T: Height>(window: Window, view: &'a View<T>) -> impl Iterator<Item = &'a [T]> {
    let Window { col, row, cols, rows } = window;
    (row..row + rows).map(move |row| view.row(row, col..col + cols))
}

/// A copy of some polygons' surroundings pays up to so many times their own pixels,
const SPARSE: usize = 32;
/// and a few more,
const ENOUGH: usize = 1 << 10;
/// but takes no more than 16 MB.
const MOST: usize = 1 << 22;

/// The largest |height| in single precision so that sums of squares do not overflow and those that count do not underflow.
const SAFE: std::ops::Range<f32> = 1e-15..1e16;

/// Takes the reference off the heights; returns the largest |height| left, and whether nothing
/// was rounded, of which nothing is said unless `CHECK`.
#[inline]
fn shift<T: Height, const CHECK: bool>(heights: &[T], reference: f64, into: &mut [f32]) -> (f32, bool) {
    let (mut largest, mut rounded) = ([0.0f32; WIDTH], [false; WIDTH]);
    let base = T::from_f64(reference);
    let mut over = |height: T, lane: usize| {
        // Both are of one type, so that this is as good as in double precision.
        let z = (height - base).to_f32();
        largest[lane] = if z.abs() > largest[lane] { z.abs() } else { largest[lane] };
        if CHECK {
            let back = f64::from(z) + reference;
            rounded[lane] |= back < height.to_f64() || back > height.to_f64();
        }
        z
    };
    let (heights, rest) = heights.as_chunks::<WIDTH>();
    let (into, into_rest) = into.split_at_mut(WIDTH * heights.len());
    for (into, heights) in into.as_chunks_mut::<WIDTH>().0.iter_mut().zip(heights) {
        for lane in 0..WIDTH {
            into[lane] = over(heights[lane], lane);
        }
    }
    for (into, &height) in into_rest.iter_mut().zip(rest) {
        *into = over(height, 0);
    }
    (largest.into_iter().fold(0.0, f32::max), !rounded.contains(&true))
}

/// So many rows ahead memory is asked for what is copied.
const AHEAD: usize = 8;

/// Bytes that it sends together.
const LINE: usize = 64;

/// The first `N` of every so many heights, as long as there are so many. (By `chunks_exact` it would
/// begin with a division.)
#[inline(always)]
fn heads<const N: usize>(mut heights: &[f32], apart: usize) -> impl Iterator<Item = &[f32; N]> {
    std::iter::from_fn(move || {
        let (row, rest) = heights.split_at_checked(apart)?;
        heights = rest;
        row.first_chunk()
    })
}

/// Places from one row to the next. Errors: `too-large`.
fn stride(Window { cols, rows, .. }: Window) -> Result<usize> {
    // An odd number of cache lines: rows do not compete for the same places of the cache.
    let line = LINE / size_of::<f32>();
    let stride = ((cols + LANES).div_ceil(line) | 1) * line;
    if stride * (rows + 1) > i32::MAX as usize {
        let message = format!("{cols} x {rows} pixels are more than can be refined as one tile");
        return Err(Error::input("too-large", message));
    }
    Ok(stride)
}

impl Patch {
    /// A copy of the pixels in the window: over the lowest one, so that it does not matter how
    /// high all of it lies; if that rounds, as they are or over a height that takes nothing from
    /// single precision. Errors: `out-of-memory`, `too-large`.
    pub fn new<T: Height>(view: &View<T>, window: Window) -> Result<Self> {
        let (low, high) = rows(window, view).fold((f64::INFINITY, f64::NEG_INFINITY), |all, row| {
            let (least, most) = extent(row);
            (all.0.min(least), all.1.max(most))
        });
        let middle = 0.5 * (low + high);
        let is_far = middle.abs() > high - low;
        let coarse = f64::from(middle as f32);
        let coarse = if is_far && coarse.is_finite() { coarse } else { 0.0 };
        let lowest = if low.is_finite() { low } else { 0.0 };
        let mut patch = Patch::empty(window, lowest)?;
        patch.fill::<T, true>(view);
        if !patch.frame.is_exact {
            patch.frame.reference = coarse;
            patch.fill::<T, true>(view);
        }
        if !patch.frame.is_exact {
            patch.frame.reference = lowest;
            patch.fill::<T, true>(view);
        }
        Ok(patch)
    }

    /// The pixels between and beside some polygons, over a height that is near theirs and with no look at what that
    /// rounds; `None` if it would take much more than the polygons hold, or heights are extreme.
    pub fn near<T: Height, const N: usize>(
        grid: &Grid<T>,
        polygons: impl Iterator<Item = [Point; N]>,
        reference: f64,
    ) -> Option<Self> {
        let (mut low, mut high) = (Point { x: i32::MAX, y: i32::MAX }, Point { x: i32::MIN, y: i32::MIN });
        let mut size = 0;
        for p in polygons {
            size += (2..N).map(|k| pixels_of([p[0], p[k - 1], p[k]])).sum::<usize>();
            for p in p {
                low = Point { x: low.x.min(p.x), y: low.y.min(p.y) };
                high = Point { x: high.x.max(p.x), y: high.y.max(p.y) };
            }
        }
        let whole = Window { col: 0, row: 0, cols: grid.cols(), rows: grid.rows() };
        let window = whole.around(&[low, high]);
        if window.cols * window.rows > (SPARSE * size + ENOUGH).min(MOST) {
            return None;
        }
        // The same for rasters of all types.
        let reference = f64::from(reference as f32);
        let stride = stride(window).ok()?;
        let frame = Frame { reference, is_exact: false, largest: 0.0 };
        // 16 MB at most are not asked for.
        let mut patch = Patch { z: vec![0.0; stride * (window.rows + 1)], base: 0, stride, window, frame };
        patch.fill::<T, false>(&View::of(grid));
        let is_safe = patch.frame.largest == 0.0 || SAFE.contains(&patch.frame.largest);
        is_safe.then_some(patch)
    }

    /// The same of another image of the terrain, over the same height.
    pub fn again<T: Height>(view: &View<T>, window: Window, frame: Frame) -> Result<Self> {
        let mut patch = Patch::empty(window, frame.reference)?;
        patch.fill::<T, true>(view);
        Ok(patch)
    }

    /// The same as one before.
    pub fn framed<T: Height>(view: &View<T>, window: Window, frame: Frame) -> Result<Self> {
        let mut patch = Patch::empty(window, frame.reference)?;
        patch.fill::<T, false>(view);
        patch.frame = frame;
        Ok(patch)
    }

    /// One that holds nothing yet.
    pub fn nothing() -> Self {
        let window = Window { col: 0, row: 0, cols: 0, rows: 0 };
        let frame = Frame { reference: 0.0, is_exact: false, largest: 0.0 };
        Patch { z: Vec::new(), base: 0, stride: 0, window, frame }
    }

    /// Becomes what [`Patch::framed`] makes, but of `part` of the window alone; what else there is in
    /// the rows of the part is undefined. Errors: `out-of-memory`, `too-large`.
    pub fn cut<T: Height>(
        &mut self,
        view: &View<T>,
        (window, frame): (Window, Frame),
        part: Window,
    ) -> Result<()> {
        let stride = stride(window)?;
        let count = (part.rows + 1) * stride;
        if self.z.len() < count {
            memory::ensure(size_of::<f32>() * count)?;
            self.z.resize(count, f32::NAN);
        }
        for (into, heights) in self.z.chunks_mut(stride).zip(rows(part, view)) {
            shift::<T, false>(heights, frame.reference, &mut into[part.col - window.col..]);
        }
        (self.base, self.stride) = ((part.row - window.row) * stride, stride);
        (self.window, self.frame) = (window, frame);
        Ok(())
    }

    fn empty(window: Window, reference: f64) -> Result<Self> {
        let stride = stride(window)?;
        let count = stride * (window.rows + 1);
        memory::ensure(size_of::<f32>() * count)?;
        let frame = Frame { reference, is_exact: false, largest: 0.0 };
        Ok(Patch { z: vec![f32::NAN; count], base: 0, stride, window, frame })
    }

    /// Copies the heights over the reference; `is_exact` is looked into if `CHECK`.
    fn fill<T: Height, const CHECK: bool>(&mut self, view: &View<T>) {
        let (mut largest, mut is_exact) = (0.0f32, true);
        let mut ahead = rows(self.window, view).skip(AHEAD);
        for (into, heights) in self.z.chunks_mut(self.stride).zip(rows(self.window, view)) {
            // Rows are too short for the processor to guess which memory comes next.
            ahead
                .next()
                .into_iter()
                .flat_map(|row| row.iter().step_by(LINE / size_of::<T>()))
                .for_each(prefetch);
            let shift = if CHECK && is_exact { shift::<T, true> } else { shift::<T, false> };
            let row = shift(heights, self.frame.reference, into);
            (largest, is_exact) = (largest.max(row.0), is_exact & row.1);
        }
        self.frame = Frame { largest, is_exact, ..self.frame };
    }

    pub fn frame(&self) -> Frame {
        self.frame
    }

    pub fn reference(&self) -> f64 {
        self.frame.reference
    }

    pub fn is_exact(&self) -> bool {
        self.frame.is_exact
    }

    pub fn largest(&self) -> f64 {
        f64::from(self.frame.largest)
    }

    /// Height of a candidate.
    #[inline]
    pub fn height<T: Height>(&self, place: usize, view: &View<T>) -> f64 {
        if self.frame.is_exact {
            return f64::from(self.z(place)) + self.frame.reference;
        }
        let (col, row) = self.pixel(place);
        view.at(col, row)
    }

    pub fn stride(&self) -> usize {
        self.stride
    }

    /// Number of places.
    pub fn size(&self) -> usize {
        self.stride * self.window.rows
    }

    #[inline(always)]
    pub fn z(&self, place: usize) -> f32 {
        self.z[place - self.base]
    }

    /// Up to sixteen heights from a place on, and from those below it: so many rows that the patch holds.
    #[inline(always)]
    pub fn rows<const N: usize>(&self, place: usize, count: usize) -> impl Iterator<Item = &[f32; N]> {
        let start = place.wrapping_sub(self.base);
        let rows = self.z.get(start..start.wrapping_add(count * self.stride)).unwrap_or_default();
        heads(rows, self.stride)
    }

    /// The same where each time there are so many places to the next.
    #[inline(always)]
    pub fn rows_apart<const N: usize>(
        &self,
        place: usize,
        count: usize,
        apart: usize,
    ) -> impl Iterator<Item = &[f32; N]> {
        let start = place.wrapping_sub(self.base);
        let rows = |count: usize| self.z.get(start..start.wrapping_add(count * apart));
        // The last of a sample is left out where it is among the last rows of all.
        let rows = rows(count).or_else(|| rows(count.saturating_sub(1))).unwrap_or_default();
        heads(rows, apart)
    }

    /// A lattice point relative to the first pixel.
    #[inline(always)]
    pub fn local(&self, p: Point) -> Point {
        let first = self.first();
        Point { x: p.x - first.x, y: p.y - first.y }
    }

    /// The first pixel.
    #[inline(always)]
    pub fn first(&self) -> Point {
        Point::pixel(self.window.col, self.window.row)
    }

    /// (column, row) of a place relative to the first pixel of the window.
    #[inline(always)]
    pub fn split(&self, place: usize) -> (usize, usize) {
        // Division is faster in 32 bits, which hold all places.
        let (place, stride) = (place as u32, self.stride as u32);
        ((place % stride) as usize, (place / stride) as usize)
    }

    /// (column, row) in the raster.
    #[inline(always)]
    pub fn pixel(&self, place: usize) -> (usize, usize) {
        let (col, row) = self.split(place);
        (self.window.col + col, self.window.row + row)
    }

    /// The pixel is no candidate from now on; nothing if it lies outside.
    pub fn exclude(&mut self, p: Point) {
        let local = self.local(p);
        let (col, row) = ((local.x >> SUB_BITS) as usize, (local.y >> SUB_BITS) as usize);
        if p.as_pixel().is_some()
            && local.x >= 0
            && local.y >= 0
            && col < self.window.cols
            && row < self.window.rows
        {
            let place = (row * self.stride + col).wrapping_sub(self.base);
            self.z.get_mut(place).into_iter().for_each(|z| *z = f32::NAN);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_part_holds_what_the_whole_does(
            z in prop::collection::vec(-9.0f32..9.0, 1600),
            window in prop::array::uniform4(0usize..19), c in prop::array::uniform6(0usize..20),
        ) {
            let [col, row, more_cols, more_rows] = window;
            let window = Window { col, row, cols: 2 + more_cols, rows: 2 + more_rows };
            let view = View::of(&Grid::new(&z, 40, 40).unwrap());
            let whole = Patch::new(&view, window).unwrap();
            let points = [0, 1, 2].map(|i| Point::pixel(col + c[2 * i] % window.cols, row + c[2 * i + 1] % window.rows));
            let part = window.around(&points);
            let mut cut = Patch::nothing();
            let elsewhere = Window { col: 0, row: 0, cols: 40, rows: 40 };
            cut.cut(&view, (elsewhere, whole.frame()), elsewhere).unwrap();
            cut.cut(&view, (window, whole.frame()), part).unwrap();
            prop_assert_eq!((whole.stride(), whole.size(), whole.largest()), (cut.stride(), cut.size(), cut.largest()));
            for p in points {
                let (c, r) = p.as_pixel().unwrap();
                prop_assert!((part.col..part.col + part.cols).contains(&c) && (part.row..part.row + part.rows).contains(&r));
            }
            for (c, r) in (0..part.rows).flat_map(|r| (0..part.cols).map(move |c| (c, r))) {
                let place = (part.row - row + r) * whole.stride() + part.col - col + c;
                prop_assert_eq!(whole.z(place), cut.z(place));
                prop_assert_eq!(cut.pixel(place), (part.col + c, part.row + r));
            }
        }
    }
}
