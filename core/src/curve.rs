//! A space-filling curve: what is near along it is near on the ground.

use crate::predicate::{Point, SUB_BITS};
use std::cmp::Reverse;

/// Position of a pixel along the Z-order curve.
pub fn curve_position(col: u64, row: u64) -> u64 {
    spread(col) | spread(row) << 1
}

/// Puts a zero between the bits of a number below 2^32.
fn spread(mut v: u64) -> u64 {
    for (shift, mask) in [
        (16, 0x0000_ffff_0000_ffff),
        (8, 0x00ff_00ff_00ff_00ff),
        (4, 0x0f0f_0f0f_0f0f_0f0f),
        (2, 0x3333_3333_3333_3333),
        (1, 0x5555_5555_5555_5555),
    ] {
        v = (v | v << shift) & mask;
    }
    v
}

/// The order in which to insert `points`: in rounds of doubling size, each along the
/// curve, so that walks stay short and no vertex is hit by too many flips (a biased
/// randomised insertion order; Amenta, Choi and Rote 2003). Positions in `points`.
pub fn insertion_order(points: &[Point]) -> Vec<usize> {
    let key = |i: usize| {
        let p = points[i];
        let round = scramble(i as u64).trailing_zeros();
        (Reverse(round), curve_position((p.x >> SUB_BITS) as u64, (p.y >> SUB_BITS) as u64))
    };
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by_cached_key(|&i| key(i));
    order
}

/// A number that looks random (the finaliser of SplitMix64).
pub fn scramble(i: u64) -> u64 {
    let mut x = i.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}
