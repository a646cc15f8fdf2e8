//! The walk that shares out the pixels: each one that is no vertex to exactly one triangle.

use crate::mesh::{triangle_of, Mesh, NONE};
use crate::predicate::{orient2d, Point, SUB_BITS, UNIT};

/// Whether the triangle on this side of a directed edge, rather than its neighbour, owns the
/// pixels on it: those on the left and the upper border of a triangle are its own.
#[inline(always)]
pub fn is_first(from: Point, to: Point) -> bool {
    (to.y < from.y) | ((to.y == from.y) & (from.x < to.x))
}

/// Whether the triangle of `h` owns the pixels within that edge: a neighbour without data owns none.
#[inline(always)]
pub fn owns_edge(mesh: &Mesh, h: u32) -> bool {
    let twin = mesh.twin(h);
    let is_alone = twin == NONE || mesh.triangle(triangle_of(twin)).is_void();
    // Which of both is first is never learnt: no branch.
    is_first(mesh.point(mesh.origin(h)), mesh.point(mesh.dest(h))) | is_alone
}

/// Calls `visit(row, first, end)` for every row of pixel centres within the triangle `p`
/// (positively oriented) and its owned edges, corners left out: columns `first..end`, rows
/// ascending. Edge k runs from corner k to the next.
#[inline(always)]
pub fn for_each_span(p: [Point; 3], owned: [bool; 3], mut visit: impl FnMut(usize, usize, usize)) {
    let ([top, mid, bottom], [upper, lower, long]) = downwards(p, owned);
    if top.y == mid.y && upper {
        visit_level(top, mid, &mut visit);
    }
    // A corner alone in its row is no pixel.
    let first_row = (top.y >> SUB_BITS) + 1;
    let end_row = (bottom.y + UNIT - 1) >> SUB_BITS;
    if first_row < end_row {
        let turn_row = ((mid.y + UNIT - 1) >> SUB_BITS).max(first_row);
        let mid_is_right = orient2d(top, bottom, mid) < 0;
        let mut long = Border::new(top, bottom, first_row, long == mid_is_right);
        let mut short =
            if first_row < turn_row { Border::new(top, mid, first_row, upper != mid_is_right) } else { long };
        for row in first_row..end_row {
            let mut skip = 0;
            if row == turn_row {
                short = Border::new(mid, bottom, row, lower != mid_is_right);
                // The middle corner stands at the end of its row.
                skip = i32::from(lower && mid.y == row << SUB_BITS && mid.x & (UNIT - 1) == 0);
            }
            let (short_beyond, long_beyond) = (short.beyond(), long.beyond());
            let first = if mid_is_right { long_beyond } else { short_beyond + skip };
            let end = if mid_is_right { short_beyond - skip } else { long_beyond };
            if first < end {
                visit(row as usize, first as usize, end as usize);
            }
            long.step();
            short.step();
        }
    }
    if mid.y == bottom.y && lower {
        visit_level(mid, bottom, &mut visit);
    }
}

/// The pixels between two points on one height, the left one first.
#[inline(always)]
fn visit_level(a: Point, b: Point, visit: &mut impl FnMut(usize, usize, usize)) {
    let (first, end) = ((a.x >> SUB_BITS) + 1, (b.x + UNIT - 1) >> SUB_BITS);
    if a.y & (UNIT - 1) == 0 && first < end {
        visit((a.y >> SUB_BITS) as usize, first as usize, end as usize);
    }
}

/// The corners by rising (y, x), and whether the edges first-second, second-third and
/// first-third of them are owned.
#[inline]
fn downwards(p: [Point; 3], owned: [bool; 3]) -> ([Point; 3], [bool; 3]) {
    // Each corner with the edge opposite to it.
    let corner = |k: usize| (p[k], owned[(k + 1) % 3]);
    let order = |a: (Point, bool), b: (Point, bool)| {
        if (b.0.y < a.0.y) | ((b.0.y == a.0.y) & (b.0.x < a.0.x)) {
            (b, a)
        } else {
            (a, b)
        }
    };
    let (a, b) = order(corner(0), corner(1));
    let (b, c) = order(b, corner(2));
    let (a, b) = order(a, b);
    ([a.0, b.0, c.0], [c.1, a.1, b.1])
}

/// Where an edge crosses the rows of pixel centres: just below column `whole + 1`, moved on
/// from row to row without a division.
#[derive(Clone, Copy)]
struct Border {
    whole: i32,
    step_whole: i32,
    rest: i64,
    step_rest: i64,
    den: i64,
}

impl Border {
    /// The edge from `a` down to `b` (`a.y < b.y`) at `row`, the first or second that it may
    /// cross; a pixel on it counts as beyond it or not.
    #[inline(always)]
    fn new(a: Point, b: Point, row: i32, is_beyond: bool) -> Self {
        let (dx, dy) = (b.x - a.x, b.y - a.y);
        let (quotient, rest) = (dx / dy, dx % dy);
        let is_low = i32::from(rest < 0);
        let (step_whole, step_rest) = (quotient - is_low, i64::from(rest + is_low * dy) << SUB_BITS);
        let den = i64::from(dy) << SUB_BITS;
        if (a.x | a.y) & (UNIT - 1) == 0 {
            let back = i32::from(is_beyond);
            let (whole, rest) = ((a.x >> SUB_BITS) - back, i64::from(back) * (den - 1));
            let mut border = Border { whole, step_whole, rest, step_rest, den };
            if row > a.y >> SUB_BITS {
                border.step();
            }
            return border;
        }
        let y = row << SUB_BITS;
        let num = i64::from(a.x) * i64::from(dy) + i64::from(y - a.y) * i64::from(dx) - i64::from(is_beyond);
        let (whole, rest) = (num.div_euclid(den) as i32, num.rem_euclid(den));
        Border { whole, step_whole, rest, step_rest, den }
    }

    #[inline(always)]
    fn step(&mut self) {
        self.whole += self.step_whole;
        self.rest += self.step_rest;
        let carry = self.rest >= self.den;
        self.rest -= if carry { self.den } else { 0 };
        self.whole += i32::from(carry);
    }

    /// The first column beyond the edge.
    #[inline(always)]
    fn beyond(&self) -> i32 {
        self.whole + 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_walk_visits_the_open_triangle_and_its_owned_edges(c in prop::array::uniform6(0i32..(12 << SUB_BITS)), owned: [bool; 3], on_pixels: bool) {
            let snap = |v: i32| if on_pixels { v >> SUB_BITS << SUB_BITS } else { v };
            let mut p = [0, 1, 2].map(|i| Point { x: snap(c[2 * i]), y: snap(c[2 * i + 1]) });
            prop_assume!(orient2d(p[0], p[1], p[2]) != 0);
            if orient2d(p[0], p[1], p[2]) < 0 { p.swap(1, 2); }
            let mut seen = Vec::new();
            for_each_span(p, owned, |row, first, end| seen.extend((first..end).map(|col| (row, col))));
            let mut expected = Vec::new();
            for row in 0..12 { for col in 0..12 {
                let q = Point::pixel(col, row);
                let is_in = |k: usize| orient2d(p[k], p[(k + 1) % 3], q) >= i64::from(!owned[k]);
                if (0..3).all(is_in) && !p.contains(&q) { expected.push((row, col)); }
            } }
            prop_assert_eq!(seen, expected);
        }
    }

    #[test]
    fn one_side_of_an_edge_is_first() {
        for (x, y) in [(1, 0), (0, 1), (3, -2), (-5, -7), (-4, 0)] {
            let (p, q) = (Point { x: 10, y: 10 }, Point { x: 10 + x, y: 10 + y });
            assert!(is_first(p, q) != is_first(q, p));
        }
    }
}
