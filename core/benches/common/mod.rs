//! What the benchmarks share with `examples/fixed_case.rs`: terrain that is the same on
//! every machine, and the methods as the Python package sets them.
#![allow(dead_code)]

use dem2tin_core::domain::Constraints;
use dem2tin_core::outline::Shape;
use dem2tin_core::pipeline::{Options, Scales};
use dem2tin_core::rule::Rule;

/// Splitmix64's mixing function.
pub fn hash(i: u64) -> u64 {
    let z = i.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// In [0, 1).
pub fn unit(i: u64) -> f64 {
    (hash(i) >> 11) as f64 / (1u64 << 53) as f64
}

/// `size` x `size` heights from octaves of value noise, each of 0.55 times the amplitude of
/// the one before: nothing but sums and products, which no platform rounds otherwise.
pub fn terrain(size: usize) -> Vec<f32> {
    let mut z = vec![0.0; size * size];
    let (mut cell, mut amplitude) = (size.next_power_of_two() / 2, 400.0);
    while cell > 0 {
        let knot = |col: usize, row: usize| unit(((cell as u64) << 40) + ((row as u64) << 20) + col as u64);
        let ease = |v: usize| {
            let t = (v % cell) as f64 / cell as f64;
            t * t * (3.0 - 2.0 * t)
        };
        for (i, z) in z.iter_mut().enumerate() {
            let (col, row) = (i % size, i / size);
            let (x, y, c, r) = (ease(col), ease(row), col / cell, row / cell);
            let upper = knot(c, r) * (1.0 - x) + knot(c + 1, r) * x;
            let lower = knot(c, r + 1) * (1.0 - x) + knot(c + 1, r + 1) * x;
            *z += amplitude * (upper * (1.0 - y) + lower * y);
        }
        cell /= 2;
        amplitude *= 0.55;
    }
    z.into_iter().map(|z: f64| z as f32).collect()
}

pub const METHODS: [&str; 3] = ["max", "median", "auto"];

/// What `tin.options` makes of a method of [`METHODS`] and a number of points.
pub fn method(name: &str, max_points: usize) -> Option<Options> {
    let rule =
        |priority, weight, candidate, bound| Rule { priority, weight, candidate, tolerance: 0.0, bound };
    let plain = Options {
        max_points,
        is_share: false,
        points_per_scale: None,
        rule: rule(1.0, 0.0, 1.0, 1.0),
        has_tolerance: false,
        stop_at_noise: false,
        scales: Scales::Given(vec![[0.0; 2]]),
        despike: false,
        fit: false,
        flips: 0,
        shape: Shape::default(),
        constraints: Constraints::default(),
        tile: 384,
    };
    let scales = [0.8, 0.7, 0.55, 0.45];
    match name {
        "max" => Some(plain),
        "median" => Some(Options {
            points_per_scale: None,
            rule: rule(0.5, 0.0, 0.5, 0.5),
            scales: Scales::Given(scales.map(|sigma| [sigma; 2]).to_vec()),
            ..plain
        }),
        "auto" => Some(Options {
            rule: rule(0.5, 0.25, 1.0, 1.0),
            scales: Scales::Auto,
            despike: true,
            fit: true,
            flips: 2,
            ..plain
        }),
        _ => None,
    }
}
