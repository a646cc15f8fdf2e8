//! The pixels of a triangle, eight at a time and in single precision.

use crate::lanes::{Lanes, Pair, Part, LANES};
use crate::patch::Patch;
use crate::predicate::{Point, SUB_BITS, UNIT};
use crate::scan::{rows_between, Plane, Side, Spans};
use std::marker::PhantomData;

/// Columns of two strips side by side. In wider triangles it pays to find the rows that these meet.
pub const NARROW: i32 = 2 * LANES as i32;

/// With sides in pixels up to this the edge functions fit 32 bits, those of the pixels of a
/// strip beside the triangle included.
pub const MAX_SIDE: i32 = 110;

/// The same where the corners are pixels; larger triangles are walked by spans.
const MAX_WHOLE_SIDE: i32 = 1 << 14;

/// A sample is from at least so many rows and strips of a triangle's bounds, parts of its pixels.
const FEWEST_ROWS: i32 = 8;
const FEWEST_STRIPS: i32 = 32;

/// A triangle whose pixels are walked.
#[derive(Clone, Copy)]
pub struct Walk {
    /// Corners relative to the patch.
    pub p: [Point; 3],
    /// Relative to the reference of the patch.
    pub plane: Plane,
    /// One of so many strips of eight columns is walked,
    strips: i32,
    /// and in it one of so many rows.
    rows: i32,
}

/// What is to be done on the way. All of it must be `#[inline(always)]`, like all that a kernel runs.
pub trait Visitor<L: Lanes> {
    /// The next eight errors are those from this place on; with each look it moves on by `further`.
    fn move_to(&mut self, _place: usize, _further: usize) {}

    /// Eight errors; one is -1 beside the triangle and NaN where there is no candidate.
    /// Returns whether that was all there is to look for.
    fn see(&mut self, error: L::F) -> bool;

    /// What has been seen of two strips side by side.
    type Both;

    /// Before any.
    fn both(&self) -> Self::Both;

    /// Twice eight errors likewise.
    fn see_both(&mut self, both: &mut Self::Both, errors: L::Pair) -> bool;

    /// Takes in what has been seen.
    fn end_both(&mut self, both: Self::Both);
}

impl Walk {
    #[inline(always)]
    pub fn new(p: [Point; 3], plane: Plane) -> Self {
        Walk { p, plane, strips: 1, rows: 1 }
    }

    /// Pixels that each of those walked stands for.
    #[inline(always)]
    pub fn thinning(&self) -> usize {
        (self.strips * self.rows) as usize
    }

    /// Over about so many pixels `of` all of them, evenly spread, if these are twice as many at least and
    /// the triangle is not too large or narrow for that.
    #[inline(always)]
    pub fn sampled(&self, pixels: usize, of: usize) -> Option<Self> {
        let (pixels, ratio) = (pixels as i32, (of / pixels) as i32);
        let [cols, height] = self.size();
        if ratio < 2 || !self.is_whole() || cols < NARROW || cols.max(height) >= MAX_WHOLE_SIDE {
            return None;
        }
        // As far from row to row as from strip to strip, but with some of either.
        let lanes = LANES as i32;
        let (fewest_rows, fewest_strips) = ((pixels / FEWEST_ROWS).max(1), (pixels / FEWEST_STRIPS).max(1));
        let most_rows = (height / fewest_rows).max(1);
        let rows = ((lanes * ratio) as f32).sqrt() as i32;
        let strips = (ratio / rows.clamp(1, most_rows)).clamp(1, (cols / (lanes * fewest_strips)).max(1));
        let rows = (ratio / strips).clamp(1, most_rows);
        (strips * rows > 1).then_some(Walk { strips, rows, ..*self })
    }

    /// Whether all corners are pixels.
    #[inline(always)]
    fn is_whole(&self) -> bool {
        let [a, b, c] = self.p;
        (a.x | a.y | b.x | b.y | c.x | c.y) & (UNIT - 1) == 0
    }

    /// First column and row of pixels, last column and row.
    #[inline(always)]
    fn bounds(&self) -> [i32; 4] {
        let [a, b, c] = self.p;
        let ceil = |v: i32| (v + UNIT - 1) >> SUB_BITS;
        let (left, right) = (ceil(a.x.min(b.x).min(c.x)), a.x.max(b.x).max(c.x) >> SUB_BITS);
        let (top, bottom) = (ceil(a.y.min(b.y).min(c.y)), a.y.max(b.y).max(c.y) >> SUB_BITS);
        [left, top, right, bottom]
    }

    /// Columns and rows beyond the first.
    #[inline(always)]
    fn size(&self) -> [i32; 2] {
        let [left, top, right, bottom] = self.bounds();
        [right - left, bottom - top]
    }

    /// How many pixels and others beside them are visited at most.
    #[inline(always)]
    pub fn room(&self) -> usize {
        let [cols, rows] = self.size();
        // Two strips and a row more than there are on the average.
        ((cols / (LANES as i32 * self.strips) + 3) * (rows / self.rows + 2)) as usize * LANES
    }

    /// Shows the pixels to the visitor, and gives it back.
    #[inline(always)]
    pub fn run<L: Lanes, V: Visitor<L>>(&self, patch: &Patch, mut visitor: V) -> V {
        let [left, top, right, bottom] = self.bounds();
        let rows = bottom - top;
        if right - left >= NARROW || rows >= MAX_SIDE {
            return L::apart(Wide { walk: self, patch, visitor });
        }
        let at = top as usize * patch.stride() + left as usize;
        let strips = self.strips_from::<L>([left, top, 0], self.p, (SUB_BITS, 1));
        strips.show(patch, (at, (rows + 1) as usize, patch.stride()), right - left, &mut visitor);
        visitor
    }

    /// The same if the triangle is wide or high.
    #[inline(always)]
    fn wide<L: Lanes>(&self, patch: &Patch, visitor: &mut impl Visitor<L>) {
        let [left, top, right, bottom] = self.bounds();
        let (cols, rows) = (right - left, bottom - top);
        // Corners on pixels need no finer lattice.
        let (p, bits, most) = if self.is_whole() {
            (self.p.map(|p| Point { x: p.x >> SUB_BITS, y: p.y >> SUB_BITS }), 0, MAX_WHOLE_SIDE)
        } else {
            (self.p, SUB_BITS, MAX_SIDE)
        };
        if cols >= most || rows >= most {
            return self.spans(patch, visitor);
        }
        // Relative to where single precision is exact.
        let [a, b, c] = self.p.map(|p| [p.x - (left << SUB_BITS), p.y - (top << SUB_BITS)]);
        let sides = [Side::new(a, b), Side::new(b, c), Side::new(c, a)];
        // Strips of a sample are apart.
        let width = if self.strips == 1 { NARROW } else { LANES as i32 };
        let mut col = 0;
        while col <= cols {
            let beyond = width.min(cols + 1 - col) - 1;
            let (first, last) = rows_between(&sides, col as f32, (col + beyond) as f32);
            let (first, last) = (first.max(0), last.min(rows));
            let (first, last) = match self.rows {
                1 => (first, last),
                every => ((first + every - 1) / every, last / every),
            };
            let count = (last + 1 - first).max(0) as usize;
            let every = self.rows as usize * patch.stride();
            let at = top as usize * patch.stride() + first as usize * every + (left + col) as usize;
            let strips = self.strips_from::<L>([left + col, top, first], p, (bits, self.rows));
            if strips.show(patch, (at, count, every), beyond, visitor) {
                return;
            }
            col += width * self.strips;
        }
    }

    /// The strips from column `left` on. Their rows lie `every` so many from `top` on, beginning with the `first` of
    /// those. `p` are the corners with so many bits below the pixel.
    #[inline(always)]
    fn strips_from<L: Lanes>(
        &self,
        [left, top, first]: [i32; 3],
        p: [Point; 3],
        (bits, every): (u32, i32),
    ) -> Strips<L> {
        let (x, y) = (left << bits, (top + first * every) << bits);
        let edge = |k: usize| {
            let (a, b) = (p[k], p[(k + 1) % 3]);
            let (dx, dy) = (b.x - a.x, b.y - a.y);
            let at = dx * (y - a.y) - dy * (x - a.x);
            Edge { at, across: -dy << bits, down: (dx << bits) * every }
        };
        let plane = &self.plane;
        let on_row = plane.on_row(top as usize);
        Strips {
            edges: [edge(0), edge(1), edge(2)],
            starts: [0, LANES].map(|beyond| plane.at(on_row, left as usize + beyond) as f32),
            slopes: [plane.per_col, plane.per_row].map(|v| v as f32),
            // From the first row of all, so that a sample finds the errors that the whole has.
            rows: [(first * every) as f32, every as f32],
            vectors: PhantomData,
        }
    }

    #[inline(always)]
    fn spans<L: Lanes>(&self, patch: &Patch, visitor: &mut impl Visitor<L>) {
        let plane = &self.plane;
        let slope = L::splat(plane.per_col as f32);
        let (ramp, lanes) = (L::to_f(L::ramp(0, 1)), L::splat(LANES as f32));
        for (row, first, end) in Spans::new(self.p) {
            let start = L::splat(plane.at(plane.on_row(row), first) as f32);
            let mut across = ramp;
            let at = row * patch.stride() + first;
            visitor.move_to(at, LANES);
            let mut left = (end - first) as i32;
            for heights in patch.rows_apart(at, (end - first).div_ceil(LANES), LANES) {
                let error = L::abs(L::sub(L::sub(L::load(heights), start), L::mul(slope, across)));
                let inside = L::ramp(-left, 1);
                if visitor.see(L::where_negative(inside, error, L::splat(-1.0))) {
                    return;
                }
                across = L::add(across, lanes);
                left -= LANES as i32;
            }
        }
    }
}

/// An edge function at the first pixel of the strips, and what it gains a column and a row.
pub struct Edge {
    pub at: i32,
    pub across: i32,
    pub down: i32,
}

/// A triangle in two strips side by side of columns that fit one vector each: inside is where no edge function is
/// negative (Pineda 1988).
pub struct Strips<L: Lanes> {
    pub edges: [Edge; 3],
    /// The plane's height on a first row of all, in the first column of each strip,
    pub starts: [f32; 2],
    /// and what it gains a column and a row.
    pub slopes: [f32; 2],
    /// The rows down to the first one looked at, and from each to the next.
    pub rows: [f32; 2],
    pub vectors: PhantomData<L>,
}

impl<L: Lanes> Strips<L> {
    /// Shows `count` rows of the patch to the visitor, the first from `at` on and each so much `further`, as far as the
    /// triangle has columns `beyond` the first; returns whether that was all there is to look for.
    #[inline(always)]
    pub fn show(
        self,
        patch: &Patch,
        (at, count, further): (usize, usize, usize),
        beyond: i32,
        visitor: &mut impl Visitor<L>,
    ) -> bool {
        visitor.move_to(at, further);
        if beyond < LANES as i32 {
            self.show_left(patch.rows_apart(at, count, further), visitor)
        } else {
            // One loop for both, so that its end is mistaken once.
            self.show_both(patch.rows_apart(at, count, further), visitor)
        }
    }

    /// The plane's heights in a strip on a first row of all.
    #[inline(always)]
    fn heights(&self, strip: usize) -> L::F {
        L::add(L::splat(self.starts[strip]), L::mul(L::splat(self.slopes[0]), L::to_f(L::ramp(0, 1))))
    }

    #[inline(always)]
    fn show_left<'h>(
        self,
        heights: impl Iterator<Item = &'h [f32; LANES]>,
        visitor: &mut impl Visitor<L>,
    ) -> bool {
        let [a, b, c] = &self.edges;
        let (mut e0, down0) = (L::ramp(a.at, a.across), L::splat_i(a.down));
        let (mut e1, down1) = (L::ramp(b.at, b.across), L::splat_i(b.down));
        let (mut e2, down2) = (L::ramp(c.at, c.across), L::splat_i(c.down));
        let (start, slope) = (self.heights(0), L::splat(self.slopes[1]));
        let (mut down, step) = (L::splat(self.rows[0]), L::splat(self.rows[1]));
        for heights in heights {
            let level = L::add(start, L::mul(slope, down));
            let error = L::abs(L::sub(L::load(heights), level));
            let outside = L::or_i(L::or_i(e0, e1), e2);
            if visitor.see(L::where_negative(outside, L::splat(-1.0), error)) {
                return true;
            }
            (e0, e1, e2) = (L::add_i(e0, down0), L::add_i(e1, down1), L::add_i(e2, down2));
            down = L::add(down, step);
        }
        false
    }

    #[inline(always)]
    fn show_both<'h>(
        self,
        heights: impl Iterator<Item = &'h [f32; 2 * LANES]>,
        visitor: &mut impl Visitor<L>,
    ) -> bool {
        let start = L::Pair::join(self.heights(0), self.heights(1));
        let edge = |edge: &Edge| (L::Pair::ramp(edge.at, edge.across), L::splat_i(edge.down));
        let [a, b, c] = &self.edges;
        let ((mut e0, down0), (mut e1, down1), (mut e2, down2)) = (edge(a), edge(b), edge(c));
        let slope = L::splat(self.slopes[1]);
        let (mut down, step) = (L::splat(self.rows[0]), L::splat(self.rows[1]));
        let mut both = visitor.both();
        let mut is_all = false;
        for heights in heights {
            let on_row = L::mul(slope, down);
            let error = L::Pair::load(heights).sub(start.add(L::Pair::join(on_row, on_row))).abs();
            is_all = visitor.see_both(&mut both, error.where_negative(L::Pair::either([e0, e1, e2]), -1.0));
            if is_all {
                break;
            }
            (e0, e1, e2) = (L::Pair::step(e0, down0), L::Pair::step(e1, down1), L::Pair::step(e2, down2));
            down = L::add(down, step);
        }
        visitor.end_both(both);
        is_all
    }
}

/// A walk that is wide or high.
struct Wide<'a, V> {
    walk: &'a Walk,
    patch: &'a Patch,
    visitor: V,
}

impl<L: Lanes, V: Visitor<L>> Part<L> for Wide<'_, V> {
    type Output = V;

    #[inline(always)]
    fn run(mut self) -> V {
        self.walk.wide(self.patch, &mut self.visitor);
        self.visitor
    }
}
