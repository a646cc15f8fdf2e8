//! Quadrilaterals around edges, eight at a time, and which of these edges flips may be worth.

use crate::lanes::{Kernel, Lanes, Vectors, LANES};
use crate::predicate::{Point, UNIT};

/// Of a step of the lattice.
pub const PIXEL: f64 = 1.0 / UNIT as f64;

pub type Ints = [i32; LANES];
pub type Doubles = [f64; LANES];

/// Up to eight quadrilaterals with a height at each corner, from an end of the edge on that is the diagonal.
#[derive(Default)]
pub struct Quads {
    pub count: usize,
    pub x: [Ints; 4],
    pub y: [Ints; 4],
    pub z: [Doubles; 4],
    /// What is known of the errors of the triangles on both sides of the edge: sums of the errors times the hat of its
    /// origin and of its destination,
    ends: [Doubles; 2],
    /// and of their squares, right and left of it.
    squares: [Doubles; 2],
}

/// The shape of a quadrilateral.
#[derive(Clone, Copy)]
pub struct Shape {
    /// Steps in pixels from the first corner.
    pub x: [f64; 4],
    pub y: [f64; 4],
    /// Areas in pixels, doubled: of the two triangles right and left of the edge,
    pub right: f64,
    pub left: f64,
    /// and of those after its flip, at the first corner and at the other end.
    pub near: f64,
    pub far: f64,
    /// By how much the flip lifts the surface where the diagonals cross.
    pub lift: f64,
}

impl Quads {
    pub fn clear(&mut self) {
        self.count = 0;
    }

    /// Takes one more, if there is room.
    #[inline(always)]
    pub fn push(&mut self, p: [Point; 4], z: [f64; 4]) {
        let i = self.count;
        if i < LANES {
            for k in 0..4 {
                (self.x[k][i], self.y[k][i], self.z[k][i]) = (p[k].x, p[k].y, z[k]);
            }
            // Of errors without a bound nothing is known.
            (self.ends[0][i], self.ends[1][i]) = (0.0, 0.0);
            (self.squares[0][i], self.squares[1][i]) = (f64::INFINITY, f64::INFINITY);
            self.count = i + 1;
        }
    }

    /// Says of the last one what is known of the errors.
    #[inline(always)]
    pub fn know(&mut self, ends: [f64; 2], squares: [f64; 2]) {
        let i = self.count.wrapping_sub(1);
        if i < LANES {
            for k in 0..2 {
                (self.ends[k][i], self.squares[k][i]) = (ends[k], squares[k]);
            }
        }
    }

    #[inline(always)]
    pub fn shape(&self, i: usize) -> Shape {
        let step = |v: &[Ints; 4], k: usize| f64::from(v[k][i] - v[0][i]) * PIXEL;
        let x = [0.0, step(&self.x, 1), step(&self.x, 2), step(&self.x, 3)];
        let y = [0.0, step(&self.y, 1), step(&self.y, 2), step(&self.y, 3)];
        let area = |j: usize, k: usize| x[j] * y[k] - y[j] * x[k];
        let (right, left, near) = (area(1, 2), area(2, 3), area(1, 3));
        let far = right + left - near;
        let new = self.z[1][i] * left + self.z[3][i] * right;
        let lift = (new - self.z[0][i] * far - self.z[2][i] * near) / (near + far);
        Shape { x, y, right, left, near, far, lift }
    }

    /// Of which ones, a bit each, a flip may lower the sum of squared errors; they look convex. (Corners farther apart than
    /// 2^17 pixels may look so by rounding.) The flip changes the surface by a pyramid p, and gains 2 sum(r p) - sum(p^2) if
    /// r are the errors. With l the linear functions over both triangles that come closest to p, sum(r l) is known,
    /// and sum(r (p - l)) is at most the root of sum(r^2) sum((p - l)^2). Sums over p are taken for integrals, so this is an estimate.
    #[inline]
    pub fn may_gain(&self, vectors: Vectors) -> u32 {
        vectors.run(MayGain { quads: self })
    }

    #[inline(always)]
    pub fn corners(&self, i: usize) -> [Point; 4] {
        [0, 1, 2, 3].map(|k| Point { x: self.x[k][i], y: self.y[k][i] })
    }
}

struct MayGain<'a> {
    quads: &'a Quads,
}

impl Kernel for MayGain<'_> {
    type Output = u32;

    #[inline(always)]
    fn run<L: Lanes>(self) -> u32 {
        let quads = self.quads;
        let mut may = [0; LANES];
        for (i, may) in may.iter_mut().enumerate() {
            let Shape { right, left, near, far, lift, .. } = quads.shape(i);
            // Of the diagonal, up to where the other one crosses it: there l is so high at its ends.
            let (before, after) = (near / (near + far), far / (near + far));
            let linear = lift * (after * quads.ends[0][i] + before * quads.ends[1][i]);
            // The integral of p^2 is a sixth of its height squared, times the area.
            let square = lift * lift * (1.0 / 12.0);
            let rest = before * after * square;
            let (right, left) = (rest * right * quads.squares[0][i], rest * left * quads.squares[1][i]);
            let bound = right.sqrt() + left.sqrt();
            let gains = 2.0 * (linear + bound) > square * (near + far);
            *may = u32::from((near > 0.0) & (far > 0.0) & gains) << i;
        }
        may.iter().fold(0, |all, bit| all | bit) & ((1u32 << quads.count) - 1)
    }
}
