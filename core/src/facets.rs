//! Triangles made ready for their scans eight at a time: what sets a scan up takes longer than the
//! scan where triangles are small.

use crate::facet::Facet;
use crate::lanes::{Lanes, LANES};
use crate::patch::Patch;
use crate::predicate::{Point, SUB_BITS, UNIT};
use crate::scanned::{is_exact, Scan};
use crate::walk::{Edge, Strips, Visitor, MAX_SIDE, NARROW};
use std::marker::PhantomData;

type Ints = [i32; LANES];
type Doubles = [f64; LANES];

const BITS: i32 = SUB_BITS as i32;

/// Up to eight triangles. Only those that are neither wide nor high are made ready.
#[derive(Default)]
pub struct Facets {
    count: usize,
    /// Corners and their heights, as they are given.
    x: [Ints; 3],
    y: [Ints; 3],
    z: [Doubles; 3],
    ready: Ready,
}

/// One number a triangle; without meaning for those that are wide or high.
#[derive(Default)]
struct Ready {
    /// First column and row of the bounds, columns and rows beyond these.
    left: Ints,
    top: Ints,
    cols: Ints,
    rows: Ints,
    /// Edge functions at the first pixel of the bounds, what they gain a column and a row.
    edges: [Ints; 3],
    across: [Ints; 3],
    down: [Ints; 3],
    /// The plane at the first pixel and eight columns on, and its slopes.
    start: [Doubles; 2],
    per_col: Doubles,
    per_row: Doubles,
    /// The height of the first corner over the reference of the patch.
    z0: Doubles,
    largest: Doubles,
    /// The pixel of the first corner, or one beside it.
    first: [Ints; 2],
}

impl Ready {
    #[inline(always)]
    fn edge(&self, k: usize, i: usize) -> Edge {
        Edge { at: self.edges[k][i], across: self.across[k][i], down: self.down[k][i] }
    }
}

impl Facets {
    pub fn clear(&mut self) {
        self.count = 0;
    }

    pub fn count(&self) -> usize {
        self.count
    }

    /// Takes one more triangle, if there is room.
    #[inline(always)]
    pub fn push(&mut self, p: [Point; 3], z: [f64; 3]) {
        let i = self.count;
        if i < LANES {
            for k in 0..3 {
                (self.x[k][i], self.y[k][i], self.z[k][i]) = (p[k].x, p[k].y, z[k]);
            }
            self.count = i + 1;
        }
    }

    /// The triangle as it was given.
    #[inline(always)]
    pub fn triangle(&self, i: usize) -> ([Point; 3], [f64; 3]) {
        ([0, 1, 2].map(|k| Point { x: self.x[k][i], y: self.y[k][i] }), [0, 1, 2].map(|k| self.z[k][i]))
    }

    #[inline(always)]
    pub fn facet(&self, patch: &Patch, i: usize) -> Facet {
        let (p, z) = self.triangle(i);
        Facet::new(patch, p, z)
    }

    /// Makes ready what is narrow and low: the same numbers, to the bit, as [`Facet`] and its walk have.
    #[inline(always)]
    pub fn make_ready<L: Lanes>(&mut self, patch: &Patch) {
        let Facets { x, y, z, ready, .. } = self;
        let first = patch.first();
        let x = relative::<L>(x, first.x);
        let y = relative::<L>(y, first.y);
        let ((left, cols), (top, rows)) = (bounds::<L>(x), bounds::<L>(y));
        L::store_i(left, &mut ready.left);
        L::store_i(top, &mut ready.top);
        L::store_i(cols, &mut ready.cols);
        L::store_i(rows, &mut ready.rows);
        L::store_i(L::shift_down::<BITS>(x[0]), &mut ready.first[0]);
        L::store_i(L::shift_down::<BITS>(y[0]), &mut ready.first[1]);
        let (at_x, at_y) = (L::shift_up::<BITS>(left), L::shift_up::<BITS>(top));
        for (k, next) in [(0, 1), (1, 2), (2, 0)] {
            let (dx, dy) = (L::sub_i(x[next], x[k]), L::sub_i(y[next], y[k]));
            let (right, down) = (L::sub_i(at_x, x[k]), L::sub_i(at_y, y[k]));
            L::store_i(L::sub_i(L::mul_i(dx, down), L::mul_i(dy, right)), &mut ready.edges[k]);
            L::store_i(L::shift_up::<BITS>(L::sub_i(L::splat_i(0), dy)), &mut ready.across[k]);
            L::store_i(L::shift_up::<BITS>(dx), &mut ready.down[k]);
        }
        let reference = L::splat_d(patch.reference());
        let z0 = L::sub_d(L::load_d(&z[0]), reference);
        let z1 = L::sub_d(L::load_d(&z[1]), reference);
        let z2 = L::sub_d(L::load_d(&z[2]), reference);
        let (dz1, dz2) = (L::sub_d(z1, z0), L::sub_d(z2, z0));
        let (x1, x2) = (L::to_d(L::sub_i(x[1], x[0])), L::to_d(L::sub_i(x[2], x[0])));
        let (y1, y2) = (L::to_d(L::sub_i(y[1], y[0])), L::to_d(L::sub_i(y[2], y[0])));
        // Exact, as it is in integers.
        let scale = L::div_d(L::splat_d(f64::from(UNIT)), cross::<L>(x1, y2, y1, x2));
        let per_col = L::mul_d(cross::<L>(dz1, y2, dz2, y1), scale);
        let per_row = L::mul_d(cross::<L>(dz2, x1, dz1, x2), scale);
        L::store_d(per_col, &mut ready.per_col);
        L::store_d(per_row, &mut ready.per_row);
        L::store_d(z0, &mut ready.z0);
        let on_row = L::add_d(z0, L::mul_d(per_row, steps::<L>(y[0], top)));
        for (start, beyond) in ready.start.iter_mut().zip([0, LANES as i32]) {
            let col = L::add_i(left, L::splat_i(beyond));
            L::store_d(L::add_d(on_row, L::mul_d(per_col, steps::<L>(x[0], col))), start);
        }
        let corners = L::max_d(L::max_d(L::abs_d(z0), L::abs_d(z1)), L::abs_d(z2));
        let beside = L::mul_d(L::splat_d(LANES as f64), L::abs_d(per_col));
        L::store_d(L::add_d(corners, beside), &mut ready.largest);
    }

    /// The triangle, if it is neither wide nor high.
    #[inline(always)]
    pub fn narrow(&self, i: usize) -> Option<Narrow<'_>> {
        (self.ready.cols[i] < NARROW && self.ready.rows[i] < MAX_SIDE).then_some(Narrow { facets: self, i })
    }

    /// Corners in the patch.
    #[inline(always)]
    pub fn local(&self, patch: &Patch, i: usize) -> [Point; 3] {
        let (p, _) = self.triangle(i);
        p.map(|p| patch.local(p))
    }

    /// The triangle, if neither its columns nor its rows are too many.
    #[inline(always)]
    pub fn low(&self, i: usize) -> Option<Low> {
        let Ready { left, top, cols, rows, start, per_col, per_row, z0, .. } = &self.ready;
        (cols[i] < MAX_SIDE && rows[i] < MAX_SIDE).then(|| Low {
            edges: [self.ready.edge(0, i), self.ready.edge(1, i), self.ready.edge(2, i)],
            bounds: [left[i], top[i], left[i] + cols[i], top[i] + rows[i]],
            start: start[0][i],
            per_col: per_col[i],
            per_row: per_row[i],
            z0: z0[i],
        })
    }
}

/// A triangle that is not too large for its edge functions.
pub struct Low {
    /// At the first pixel of the bounds; they add up to twice the area.
    pub edges: [Edge; 3],
    /// First column and row, last column and row in the patch.
    pub bounds: [i32; 4],
    /// The plane at the first pixel, over the reference of the patch, and its slopes.
    pub start: f64,
    pub per_col: f64,
    pub per_row: f64,
    /// The height of the first corner likewise.
    pub z0: f64,
}

impl Low {
    /// The hats of the second and the third corner, each as c + x dx + y dy of the columns x from the first one of the
    /// bounds on and the rows y from the last one up, that being 1.
    #[inline(always)]
    pub fn hats(&self) -> [f64; 6] {
        let [a, b, c] = &self.edges;
        let scale = 1.0 / (f64::from(a.at) + f64::from(b.at) + f64::from(c.at));
        let [_, top, _, bottom] = self.bounds;
        let rows = f64::from(bottom + 1 - top);
        let hat = |edge: &Edge| {
            let [at, across, down] = [edge.at, edge.across, edge.down].map(|v| f64::from(v) * scale);
            [at + rows * down, across, -down]
        };
        let ([b0, bx, by], [c0, cx, cy]) = (hat(c), hat(a));
        [b0, bx, by, c0, cx, cy]
    }
}

#[inline(always)]
fn relative<L: Lanes>(v: &[Ints; 3], to: i32) -> [L::I; 3] {
    let to = L::splat_i(to);
    [L::sub_i(L::load_i(&v[0]), to), L::sub_i(L::load_i(&v[1]), to), L::sub_i(L::load_i(&v[2]), to)]
}

/// First pixels, and how many there are beyond them.
#[inline(always)]
fn bounds<L: Lanes>(v: [L::I; 3]) -> (L::I, L::I) {
    let low = L::add_i(L::min_i(L::min_i(v[0], v[1]), v[2]), L::splat_i(UNIT - 1));
    let high = L::max_i(L::max_i(v[0], v[1]), v[2]);
    let (low, high) = (L::shift_down::<BITS>(low), L::shift_down::<BITS>(high));
    (low, L::sub_i(high, low))
}

#[inline(always)]
fn cross<L: Lanes>(a: L::D, b: L::D, c: L::D, d: L::D) -> L::D {
    L::sub_d(L::mul_d(a, b), L::mul_d(c, d))
}

/// In pixels, from lattice coordinates to pixels.
#[inline(always)]
fn steps<L: Lanes>(from: L::I, to: L::I) -> L::D {
    let pixels = L::splat_d(1.0 / f64::from(UNIT));
    L::sub_d(L::to_d(to), L::mul_d(L::to_d(from), pixels))
}

/// A triangle that has been made ready.
#[derive(Clone, Copy)]
pub struct Narrow<'a> {
    facets: &'a Facets,
    i: usize,
}

impl Scan for Narrow<'_> {
    #[inline(always)]
    fn run<L: Lanes, V: Visitor<L>>(&self, patch: &Patch, mut visitor: V) -> V {
        let Narrow { facets: Facets { ready, .. }, i } = *self;
        let at = ready.top[i] as usize * patch.stride() + ready.left[i] as usize;
        let rows = (ready.rows[i] + 1) as usize;
        let strips = Strips::<L> {
            edges: [ready.edge(0, i), ready.edge(1, i), ready.edge(2, i)],
            starts: [ready.start[0][i] as f32, ready.start[1][i] as f32],
            slopes: [ready.per_col[i] as f32, ready.per_row[i] as f32],
            rows: [0.0, 1.0],
            vectors: PhantomData,
        };
        strips.show(patch, (at, rows, patch.stride()), ready.cols[i], &mut visitor);
        visitor
    }

    #[inline(always)]
    fn room(&self) -> usize {
        2 * LANES * (self.facets.ready.rows[self.i] + 1) as usize
    }

    #[inline(always)]
    fn highest(&self) -> f64 {
        self.facets.ready.largest[self.i]
    }

    #[inline(always)]
    fn is_exact(&self) -> bool {
        let Ready { per_col, per_row, z0, .. } = &self.facets.ready;
        is_exact(per_col[self.i], per_row[self.i], z0[self.i])
    }

    #[inline(always)]
    fn thinning(&self) -> usize {
        1
    }

    #[inline(always)]
    fn first(&self, patch: &Patch) -> usize {
        let [col, row] = [0, 1].map(|k| self.facets.ready.first[k][self.i].max(0) as usize);
        row * patch.stride() + col
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Grid;
    use crate::image::View;
    use crate::lanes::{Kernel, Vectors};
    use crate::list::List;
    use crate::predicate::orient2d;
    use crate::scanned::Found;
    use crate::window::Window;
    use proptest::prelude::*;

    fn sorted(list: &List) -> Vec<f32> {
        let mut values = list.values().to_vec();
        values.sort_unstable_by(f32::total_cmp);
        values
    }

    /// All that is known of the triangles, as they are and made ready.
    struct Both<'a>(&'a mut Facets, &'a Patch);

    impl Kernel for Both<'_> {
        type Output = Vec<[(Vec<f32>, Option<Found>, f64, bool, usize); 2]>;

        #[inline(always)]
        fn run<L: Lanes>(self) -> Self::Output {
            let Both(facets, patch) = self;
            facets.make_ready::<L>(patch);
            let all = (0..facets.count()).filter_map(|i| {
                let (facet, narrow) = (facets.facet(patch, i), facets.narrow(i)?);
                let (mut a, mut b) = (List::default(), List::default());
                let if_any = |found: Found| (found.error >= 0.0).then_some(found);
                let largest = [facet.collect::<L>(patch, &mut a), narrow.collect::<L>(patch, &mut b)];
                let worst = [facet.worst::<L>(patch), narrow.worst::<L>(patch)];
                assert_eq!(largest, worst.map(|found| found.error));
                let worst = worst.map(if_any);
                Some([
                    (sorted(&a), worst[0], facet.highest(), facet.is_exact(), facet.first(patch)),
                    (sorted(&b), worst[1], narrow.highest(), narrow.is_exact(), narrow.first(patch)),
                ])
            });
            all.collect()
        }
    }

    proptest! {
        #[test]
        fn what_is_made_ready_is_scanned_as_it_is_one_by_one(
            z in prop::collection::vec(prop_oneof![9 => -9.0f32..9.0, 1 => Just(f32::NAN)], 1600),
            corners in prop::collection::vec((prop::array::uniform6(0i32..20 << SUB_BITS), prop::array::uniform3(-9.0f64..9.0)), 1..11),
            window in prop::array::uniform2(0usize..4), on_pixels: bool, is_level: bool,
        ) {
            let grid = Grid::new(&z, 40, 40).unwrap();
            let [col, row] = window;
            let patch = Patch::new(&View::of(&grid), Window { col, row, cols: 40 - col, rows: 40 - row }).unwrap();
            let snap = |v: i32| if on_pixels { v >> SUB_BITS << SUB_BITS } else { v };
            let mut facets = Facets::default();
            for (c, heights) in corners {
                let mut p = [0, 1, 2].map(|k| Point {
                    x: snap(c[2 * k]) + ((col as i32) << SUB_BITS), y: snap(c[2 * k + 1]) + ((row as i32) << SUB_BITS),
                });
                if orient2d(p[0], p[1], p[2]) < 0 { p.swap(1, 2); }
                if orient2d(p[0], p[1], p[2]) > 0 {
                    facets.push(p, if is_level { [heights[0]; 3] } else { heights });
                }
            }
            prop_assert!(facets.count() <= LANES);
            let plain = Vectors::Plain.run(Both(&mut facets, &patch));
            for [alone, ready] in &plain {
                prop_assert_eq!(alone, ready);
            }
            for vectors in Vectors::all() {
                prop_assert_eq!(&vectors.run(Both(&mut facets, &patch)), &plain);
            }
        }
    }
}
