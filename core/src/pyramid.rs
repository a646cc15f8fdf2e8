//! What the flip of an edge does to the surface.

use crate::grid::{Grid, Height};
use crate::lanes::{Kernel, Lanes, Vectors, LANES};
use crate::owned::for_each_span;
use crate::patch::Patch;
use crate::predicate::{orient2d, Point, UNIT};
use crate::strips::{for_each_strip, Visitor};

/// Of a step of the lattice.
const PIXEL: f64 = 1.0 / UNIT as f64;

/// A function c + x dx + y dy of the steps in pixels from the first corner.
type Affine = [f64; 3];

/// What single precision may be off, as a part of the heights involved.
const ROUNDING: f64 = 1.0 / (1 << 20) as f64;

const EXACT_ROUNDING: f64 = 1e-12;

/// A face is up to so many times as high over the quadrilateral as the pyramid.
const THINNEST: f64 = 64.0;

/// A quadrilateral with a height at each corner, from an end of the edge on that is its diagonal.
pub struct Quad {
    pub p: [Point; 4],
    pub z: [f64; 4],
    /// Areas in pixels, doubled: of the two triangles right and left of the edge,
    right: f64,
    left: f64,
    /// and of those after its flip, at the first corner and at the other end.
    near: f64,
    far: f64,
    /// By how much the flip lifts the surface where the diagonals cross.
    lift: f64,
}

/// What is known of the errors of the triangles on both sides of an edge.
pub struct Beside {
    /// Sums of the errors times the hat of the origin and of the destination.
    pub ends: [f64; 2],
    /// Sums of the squared errors, right and left of the edge.
    pub squares: [f64; 2],
}

impl Quad {
    #[inline(always)]
    pub fn new(p: [Point; 4], z: [f64; 4]) -> Self {
        let pixels = |a, b, c| orient2d(a, b, c) as f64 * PIXEL * PIXEL;
        let (near, far) = (pixels(p[3], p[0], p[1]), pixels(p[3], p[1], p[2]));
        let (right, left) = (pixels(p[0], p[1], p[2]), pixels(p[2], p[3], p[0]));
        let new = z[1] * left + z[3] * right;
        let lift = (new - z[0] * far - z[2] * near) / (near + far);
        Quad { p, z, right, left, near, far, lift }
    }

    /// Whether it is strictly so. Nothing else is known of one that is not.
    #[inline(always)]
    pub fn is_convex(&self) -> bool {
        (self.near > 0.0) & (self.far > 0.0)
    }

    /// Whether a flip may lower the sum of squared errors. It changes the surface by a pyramid p, and gains 2 sum(r p) - sum(p^2) if
    /// r are the errors. With l the linear functions over both triangles that come closest to p, sum(r l) is known,
    /// and sum(r (p - l)) is at most the root of sum(r^2) sum((p - l)^2). Sums over p are taken for integrals, so this is an estimate.
    #[inline(always)]
    pub fn may_gain(&self, errors: Beside) -> bool {
        let Quad { right, left, near, far, lift, .. } = *self;
        // Of the diagonal, up to where the other one crosses it: there l is so high at its ends.
        let (before, after) = (near / (near + far), far / (near + far));
        let linear = lift * (after * errors.ends[0] + before * errors.ends[1]);
        // The integral of p^2 is a sixth of its height squared, times the area.
        let square = lift * lift * (1.0 / 12.0);
        let rest = [right, left].map(|area| before * after * square * area);
        let bound = (rest[0] * errors.squares[0]).sqrt() + (rest[1] * errors.squares[1]).sqrt();
        2.0 * (linear + bound) > square * (near + far)
    }
}

/// Over a quadrilateral the surfaces that bend along the one diagonal and along the other are the two sides of a
/// tetrahedron, so that a flip adds or takes off a pyramid: nothing on the border, and most where the diagonals cross.
pub struct Pyramid {
    p: [Point; 4],
    /// The height of the first corner.
    base: f64,
    /// 1 if the flip lifts the surface, -1 if it lowers it.
    sign: f64,
    /// Its height, not negative, and its volume.
    height: f64,
    volume: f64,
    /// Whether some face is so steep that single precision does not tell where it ends.
    is_thin: bool,
    /// The least of these is the pyramid: within the quadrilateral, outside it is negative.
    faces: [Affine; 4],
    /// The larger of these is the surface as it is over the base, times the sign.
    surface: [Affine; 2],
}

/// The linear function with these values at steps [x, y] from where it is 0; `area`: twice that between both.
#[inline(always)]
fn slope([ax, ay]: [f64; 2], a: f64, [bx, by]: [f64; 2], b: f64, area: f64) -> Affine {
    let scale = 1.0 / area;
    [0.0, (a * by - b * ay) * scale, (b * ax - a * bx) * scale]
}

impl Pyramid {
    #[inline(always)]
    pub fn over(quad: &Quad) -> Self {
        let Quad { p, z, right, left, near, far, lift } = *quad;
        let step = |k: usize| [f64::from(p[k].x - p[0].x) * PIXEL, f64::from(p[k].y - p[0].y) * PIXEL];
        let steps = [[0.0, 0.0], step(1), step(2), step(3)];
        let sign = if lift < 0.0 { -1.0 } else { 1.0 };
        let (height, twice) = (lift.abs(), near + far);
        let scale = height * twice;
        let mut faces = [[0.0; 3]; 4];
        for (k, product) in [near * right, far * right, far * left, near * left].into_iter().enumerate() {
            let ([ax, ay], [bx, by], factor) = (steps[k], steps[(k + 1) % 4], scale / product);
            let (dx, dy) = ((bx - ax) * factor, (by - ay) * factor);
            faces[k] = [dy * ax - dx * ay, -dy, dx];
        }
        let is_thin = near.min(far).min(right.min(left)) * THINNEST < twice;
        let (z1, z2, z3) = (sign * (z[1] - z[0]), sign * (z[2] - z[0]), sign * (z[3] - z[0]));
        let surface = [slope(steps[1], z1, steps[2], z2, right), slope(steps[2], z2, steps[3], z3, left)];
        Pyramid { p, base: z[0], sign, height, volume: scale / 6.0, is_thin, faces, surface }
    }

    /// By how much the flip lowers the sum of squared errors, if that is more than rounding can make of it.
    #[inline]
    pub fn gain<T: Height>(&self, target: &Grid<T>, patch: Option<&Patch>, vectors: Vectors) -> Option<f64> {
        if self.height == 0.0 {
            return None;
        }
        let near = patch
            .filter(|_| !self.is_thin)
            .map(|patch| (vectors.run(OverPatch { pyramid: self, patch }), patch));
        let (gain, rounding) = match near {
            Some((gain, patch)) if gain.is_finite() => {
                let heights = patch.largest() + (self.base - patch.reference()).abs() + self.height;
                (gain.into(), ROUNDING * heights)
            }
            _ => (self.gain_by_rows(target), EXACT_ROUNDING * (self.base.abs() + self.height)),
        };
        (gain > rounding * self.volume).then_some(gain)
    }

    /// Row by row and in double precision.
    fn gain_by_rows<T: Height>(&self, target: &Grid<T>) -> f64 {
        let p = self.p;
        let [col0, row0] = pixel(p[0]);
        let mut gain = 0.0;
        // The diagonal's pixels are those of one triangle; there is nothing to see on the border.
        let triangles = [([p[0], p[1], p[2]], [false; 3]), ([p[2], p[3], p[0]], [false, false, true])];
        for (p, owned) in triangles {
            for_each_span(p, owned, |row, first, end| {
                for (col, height) in (first..end).zip(&target.row(row)[first..end]) {
                    let [x, y] = [col as f64 - col0, row as f64 - row0];
                    let at = |f: &Affine| f[0] + f[1] * x + f[2] * y;
                    let change = self.faces.iter().map(at).fold(f64::INFINITY, f64::min).max(0.0);
                    let surface = self.surface.iter().map(at).fold(f64::NEG_INFINITY, f64::max);
                    let error = self.sign * (height.to_f64() - self.base) - surface;
                    if !error.is_nan() {
                        gain += change * (2.0 * error - change);
                    }
                }
            });
        }
        gain
    }
}

/// Column and row.
#[inline(always)]
fn pixel(p: Point) -> [f64; 2] {
    [f64::from(p.x) * PIXEL, f64::from(p.y) * PIXEL]
}

/// A pyramid over a patch.
struct OverPatch<'a> {
    pyramid: &'a Pyramid,
    patch: &'a Patch,
}

impl Kernel for OverPatch<'_> {
    /// The gain, NaN with a void.
    type Output = f32;

    #[inline(always)]
    fn run<L: Lanes>(self) -> f32 {
        let OverPatch { pyramid, patch } = self;
        let twice = 2.0 * pyramid.sign;
        let base = twice * (pyramid.base - patch.reference());
        let p = pyramid.p.map(|p| patch.local(p));
        let none = L::splat(0.0);
        let sum = Sum::<L> { pyramid, first: pixel(p[0]), twice, base, gain: none };
        let [gain, ..] = L::sums([for_each_strip(p, patch, sum).gain, none, none, none]);
        gain
    }
}

struct Sum<'a, L: Lanes> {
    pyramid: &'a Pyramid,
    /// Column and row of the first corner in the patch.
    first: [f64; 2],
    /// Twice the sign, and that times the corner's height in the patch.
    twice: f64,
    base: f64,
    gain: L::F,
}

impl<L: Lanes> Visitor<L> for Sum<'_, L> {
    #[inline(always)]
    fn strip<'h>(&mut self, col: i32, row: i32, rows: impl Iterator<Item = &'h [f32; LANES]>) {
        let (x, y) = (f64::from(col) - self.first[0], f64::from(row) - self.first[1]);
        let Pyramid { faces: [f0, f1, f2, f3], surface: [s0, s1], .. } = self.pyramid;
        let mut functions = [*f0, *f1, *f2, *f3, *s0, *s1];
        for surface in &mut functions[4..] {
            *surface = surface.map(|c| 2.0 * c);
            surface[0] += self.base;
        }
        // Each in single precision: at the first pixel, per column and per row.
        let mut single = [[0.0; 3]; 6];
        for k in 0..6 {
            let [c, across, down] = functions[k];
            single[k] = [(c + across * x + down * y) as f32, across as f32, down as f32];
        }
        let ramp = L::to_f(L::ramp(0, 1));
        let mut at = [L::splat(0.0); 6];
        for k in 0..6 {
            at[k] = L::add(L::splat(single[k][0]), L::mul(L::splat(single[k][1]), ramp));
        }
        let [mut f0, mut f1, mut f2, mut f3, mut s0, mut s1] = at;
        let (twice, none) = (L::splat(self.twice as f32), L::splat(0.0));
        let mut gain = self.gain;
        for heights in rows {
            let change = L::max(L::min(L::min(f0, f1), L::min(f2, f3)), none);
            // Twice the error, which counts within the quadrilateral alone.
            let error = L::sub(L::mul(L::load(heights), twice), L::max(s0, s1));
            let gained = L::mul(change, L::sub(error, change));
            gain = L::add(gain, L::choose(L::greater(change, none), gained, none));
            (f0, f1) = (L::add(f0, L::splat(single[0][2])), L::add(f1, L::splat(single[1][2])));
            (f2, f3) = (L::add(f2, L::splat(single[2][2])), L::add(f3, L::splat(single[3][2])));
            (s0, s1) = (L::add(s0, L::splat(single[4][2])), L::add(s1, L::splat(single[5][2])));
        }
        self.gain = gain;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::predicate::SUB_BITS;
    use proptest::prelude::*;

    const SIDE: usize = 40;

    /// The sum of squared errors of two triangles, each pixel once.
    fn squares(z: &[f32], triangles: [([Point; 3], [f64; 3]); 2]) -> f64 {
        let pixels = (0..z.len()).filter(|&i| !z[i].is_nan()).filter_map(|i| {
            let q = Point::pixel(i % SIDE, i / SIDE);
            triangles.iter().find_map(|(p, heights)| {
                let edges = [0, 1, 2].map(|k| orient2d(p[(k + 1) % 3], p[(k + 2) % 3], q));
                let area = orient2d(p[0], p[1], p[2]) as f64;
                let height: f64 = (0..3).map(|k| edges[k] as f64 / area * heights[k]).sum();
                edges.iter().all(|&e| e >= 0).then_some(height - f64::from(z[i]))
            })
        });
        pixels.map(|error| error * error).sum()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(3000))]
        #[test]
        fn a_flip_gains_the_difference_of_the_squares(
            c in prop::array::uniform8(0i32..((SIDE as i32 - 1) << SUB_BITS)), on_pixels: bool,
            mut z in prop::collection::vec(-50.0f32..50.0, SIDE * SIDE), heights in prop::array::uniform4(-50.0..50.0),
            void in prop::option::of(0..SIDE * SIDE),
        ) {
            let snap = |v: i32| if on_pixels { v >> SUB_BITS << SUB_BITS } else { v };
            let p = [0, 1, 2, 3].map(|i| Point { x: snap(c[2 * i]), y: snap(c[2 * i + 1]) });
            if orient2d(p[0], p[1], p[2]) <= 0 || orient2d(p[2], p[3], p[0]) <= 0 { return Ok(()) }
            let convex = orient2d(p[3], p[0], p[1]) > 0 && orient2d(p[3], p[1], p[2]) > 0;
            let quad = Quad::new(p, heights);
            prop_assert_eq!(quad.is_convex(), convex);
            if !convex { return Ok(()) }
            if let Some(pixel) = void { z[pixel] = f32::NAN; }
            let of = |k: [usize; 3]| (k.map(|k| p[k]), k.map(|k| heights[k]));
            let (now, flipped) = (squares(&z, [of([0, 1, 2]), of([2, 3, 0])]), squares(&z, [of([3, 0, 1]), of([3, 1, 2])]));
            let pyramid = Pyramid::over(&quad);
            let grid = Grid::new(&z, SIDE, SIDE).unwrap();
            let corners = [Point::pixel(0, 0), Point::pixel(39, 0), Point::pixel(39, 39), Point::pixel(0, 39)];
            let patch = Patch::near(&grid, std::iter::once(corners), heights[0]);
            let gains = [
                pyramid.gain(&grid, patch.as_ref(), Vectors::best()), pyramid.gain(&grid, patch.as_ref(), Vectors::Plain),
                pyramid.gain(&grid, None, Vectors::best()),
            ];
            for vectors in Vectors::all() {
                let gain = pyramid.gain(&grid, patch.as_ref(), vectors);
                prop_assert_eq!(gain.map(f64::to_bits), gains[1].map(f64::to_bits));
            }
            let near = 1e-4 * (now + flipped) + 0.1;
            for gain in gains {
                match gain {
                    Some(gain) => prop_assert!((gain - (now - flipped)).abs() <= near, "{} {}", gain, now - flipped),
                    None => prop_assert!(now - flipped <= near, "{} {}", now, flipped),
                }
            }
        }
    }

    #[test]
    fn a_level_or_planar_quadrilateral_gains_nothing() {
        // Planar but for the rounding of the raster itself.
        let z: Vec<f32> =
            (0..SIDE * SIDE).map(|i| 0.1 * (i % SIDE) as f32 + 9.7 * (i / SIDE) as f32).collect();
        let grid = Grid::new(&z, SIDE, SIDE).unwrap();
        let p = [Point::pixel(3, 5), Point::pixel(30, 2), Point::pixel(33, 37), Point::pixel(1, 30)];
        let height = |p: Point| f64::from(z[(p.y >> SUB_BITS) as usize * SIDE + (p.x >> SUB_BITS) as usize]);
        let pyramid = Pyramid::over(&Quad::new(p, p.map(height)));
        let patch = Patch::near(&grid, std::iter::once(p), 0.0);
        assert_eq!(pyramid.gain(&grid, patch.as_ref(), Vectors::best()), None);
    }
}
