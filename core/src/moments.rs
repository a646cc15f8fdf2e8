//! Sums over a set of pixels, from which the squared error of any plane and its normal
//! equations follow without another look at the pixels.

use crate::predicate::{orient2d, Point, SUB_BITS, UNIT};
use std::ops::Sub;

/// A function c + x dx + y dy of the steps in pixels from an origin: [c, dx, dy].
pub type Affine = [f64; 3];

#[inline(always)]
pub fn dot(a: Affine, b: Affine) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Sums over pixels at (x, y) steps in columns and rows from an origin, each with `K` values, the
/// first of them a height above a base: near both, little is lost by rounding.
#[derive(Clone, Copy, Debug)]
pub struct Moments<const K: usize> {
    col: i32,
    row: i32,
    base: f64,
    n: f64,
    x: f64,
    y: f64,
    xx: f64,
    xy: f64,
    yy: f64,
    /// Sums of each value times 1, x and y.
    pub values: [Affine; K],
    /// Sums of each value squared.
    pub squares: [f64; K],
}

impl<const K: usize> Moments<K> {
    /// Of no pixels, with the origin at `p` and its height.
    #[inline]
    pub fn about(p: Point, base: f64) -> Self {
        let (values, squares) = ([[0.0; 3]; K], [0.0; K]);
        let [n, x, y, xx, xy, yy] = [0.0; 6];
        Moments { col: p.x >> SUB_BITS, row: p.y >> SUB_BITS, base, n, x, y, xx, xy, yy, values, squares }
    }

    /// Of no pixels, about the same origin.
    #[inline]
    pub fn emptied(&self) -> Self {
        let (values, squares) = ([[0.0; 3]; K], [0.0; K]);
        let [n, x, y, xx, xy, yy] = [0.0; 6];
        Moments { n, x, y, xx, xy, yy, values, squares, ..*self }
    }

    /// Adds the pixels of `row` from column `first` on; a NaN spoils the sums for good.
    #[inline(always)]
    pub fn add_row(&mut self, row: usize, first: usize, pixels: impl ExactSizeIterator<Item = [f64; K]>) {
        let (start, y) = (f64::from(first as i32 - self.col), f64::from(row as i32 - self.row));
        let n = pixels.len() as f64;
        let last = n - 1.0;
        let i = 0.5 * last * n;
        let along = start * n + i;
        self.n += n;
        self.x += along;
        self.y += y * n;
        self.xx += start * (along + i) + i * (2.0 * last + 1.0) * (1.0 / 3.0);
        self.xy += y * along;
        self.yy += y * (y * n);
        // In registers for the length of the row.
        let (mut sums, mut products, mut squares, mut x) = ([0.0; K], [0.0; K], [0.0; K], start);
        for values in pixels {
            let values = self.lowered(values);
            for k in 0..K {
                sums[k] += values[k];
                products[k] += x * values[k];
                squares[k] += values[k] * values[k];
            }
            x += 1.0;
        }
        for k in 0..K {
            self.values[k][0] += sums[k];
            self.values[k][1] += products[k];
            self.values[k][2] += y * sums[k];
            self.squares[k] += squares[k];
        }
    }

    /// As [`Moments::add_row`], leaving out pixels whose first value is NaN.
    #[inline]
    pub fn add_valid(&mut self, row: usize, first: usize, pixels: impl Iterator<Item = [f64; K]>) {
        for (col, values) in (first..).zip(pixels).filter(|(_, values)| !values[0].is_nan()) {
            self.add_row(row, col, std::iter::once(values));
        }
    }

    /// What the first values are heights above.
    pub fn base(&self) -> f64 {
        self.base
    }

    pub fn has_nan(&self) -> bool {
        self.squares[0].is_nan()
    }

    #[inline(always)]
    fn lowered(&self, mut values: [f64; K]) -> [f64; K] {
        values[0] -= self.base;
        values
    }

    /// Number of pixels.
    pub fn count(&self) -> f64 {
        self.n
    }

    /// Sums over the pixels of the function times 1, x and y.
    #[inline(always)]
    pub fn times(&self, f: Affine) -> Affine {
        [
            f[0] * self.n + f[1] * self.x + f[2] * self.y,
            f[0] * self.x + f[1] * self.xx + f[2] * self.xy,
            f[0] * self.y + f[1] * self.xy + f[2] * self.yy,
        ]
    }

    /// The plane through three points with heights, about this origin and base.
    #[inline]
    pub fn plane(&self, p: [Point; 3], z: [f64; 3]) -> Affine {
        let [_, b, c] = self.hats(p);
        let (dz1, dz2) = (z[1] - z[0], z[2] - z[0]);
        [z[0] - self.base + dz1 * b[0] + dz2 * c[0], dz1 * b[1] + dz2 * c[1], dz1 * b[2] + dz2 * c[2]]
    }

    /// The functions that are 1 at one corner and 0 at the others.
    #[inline]
    pub fn hats(&self, p: [Point; 3]) -> [Affine; 3] {
        let scale = 1.0 / orient2d(p[0], p[1], p[2]) as f64;
        let (x0, y0) =
            (f64::from((self.col << SUB_BITS) - p[0].x), f64::from((self.row << SUB_BITS) - p[0].y));
        let hat = |from: Point, to: Point| {
            let (dx, dy) = (f64::from(from.y - to.y) * scale, f64::from(to.x - from.x) * scale);
            [dx * x0 + dy * y0, dx * f64::from(UNIT), dy * f64::from(UNIT)]
        };
        let (b, c) = (hat(p[2], p[0]), hat(p[0], p[1]));
        [[1.0 - b[0] - c[0], -b[1] - c[1], -b[2] - c[2]], b, c]
    }

    /// Sum of the squared differences between the plane and the first values, not below 0.
    #[inline]
    pub fn squared_error(&self, plane: Affine) -> f64 {
        let error = self.squares[0] - 2.0 * dot(plane, self.values[0]) + dot(plane, self.times(plane));
        error.max(0.0)
    }
}

impl Moments<1> {
    /// Over the pixels of both, about the origin of `self`.
    #[inline]
    pub fn plus(&self, other: &Self) -> Self {
        let (dx, dy) = (f64::from(other.col - self.col), f64::from(other.row - self.row));
        let dz = other.base - self.base;
        let Moments { n, x, y, xx, xy, yy, values: [[z, zx, zy]], squares: [zz], .. } = *other;
        // The other's heights from this base, still about its own origin.
        let (zz, zx, zy, z) = (zz + dz * (2.0 * z + dz * n), zx + dz * x, zy + dz * y, z + dz * n);
        Moments {
            n: self.n + n,
            x: self.x + x + dx * n,
            y: self.y + y + dy * n,
            xx: self.xx + xx + dx * (2.0 * x + dx * n),
            xy: self.xy + xy + dx * y + dy * x + dx * dy * n,
            yy: self.yy + yy + dy * (2.0 * y + dy * n),
            values: [[
                self.values[0][0] + z,
                self.values[0][1] + zx + dx * z,
                self.values[0][2] + zy + dy * z,
            ]],
            squares: [self.squares[0] + zz],
            ..*self
        }
    }
}

/// What is left without some of the pixels, summed about the same origin.
impl Sub for Moments<1> {
    type Output = Self;

    #[inline]
    fn sub(self, part: Self) -> Self {
        if self.n == part.n {
            return self.emptied();
        }
        let ([[z, zx, zy]], [[a, ax, ay]]) = (self.values, part.values);
        Moments {
            n: self.n - part.n,
            x: self.x - part.x,
            y: self.y - part.y,
            xx: self.xx - part.xx,
            xy: self.xy - part.xy,
            yy: self.yy - part.yy,
            values: [[z - a, zx - ax, zy - ay]],
            squares: [self.squares[0] - part.squares[0]],
            ..self
        }
    }
}

/// Sums of squared differences between pixels and two planes about one origin.
pub struct SquaredErrors {
    col: i32,
    row: i32,
    base: f64,
    planes: [Affine; 2],
    pub sums: [f64; 2],
}

impl SquaredErrors {
    /// Of no pixels yet; `planes` about the origin of the moments.
    #[inline(always)]
    pub fn of(origin: &Moments<1>, planes: [Affine; 2]) -> Self {
        SquaredErrors { col: origin.col, row: origin.row, base: origin.base, planes, sums: [0.0; 2] }
    }

    /// Adds the heights of `row` from column `first` on, but for those that are NaN.
    #[inline(always)]
    pub fn add_row(&mut self, row: usize, first: usize, heights: impl Iterator<Item = f64>) {
        let (x, y) = (f64::from(first as i32 - self.col), f64::from(row as i32 - self.row));
        let mut planes = self.planes.map(|plane| plane[0] + plane[1] * x + plane[2] * y);
        let mut sums = self.sums;
        for height in heights {
            let height = height - self.base;
            for k in 0..2 {
                let squared = (height - planes[k]) * (height - planes[k]);
                // Nor is NaN.
                sums[k] += if squared > 0.0 { squared } else { 0.0 };
                planes[k] += self.planes[k][1];
            }
        }
        self.sums = sums;
    }
}
