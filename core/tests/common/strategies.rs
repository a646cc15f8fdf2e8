//! Small rasters, metrics and options at random.

use super::{form, full, plain, AUTO, FORMS, MAX, PAPER};
use dem2tin_core::domain::Constraints;
use dem2tin_core::outline::Shape;
use dem2tin_core::pipeline::{Options, Scales};
use dem2tin_core::predicate::Metric;
use dem2tin_core::rule::Rule;
use proptest::prelude::*;

#[derive(Clone, Debug)]
pub struct Raster {
    pub rows: usize,
    pub cols: usize,
    pub z: Vec<f64>,
}

/// Up to half void; few different heights, so that ties abound; blocks of some pixels
/// alike, so that errors have one sign over many of them.
pub fn raster() -> impl Strategy<Value = Raster> {
    let block = prop::sample::select(vec![1, 1, 2, 3]);
    (2usize..=9, 2usize..=9, 0u32..6, block).prop_flat_map(|(rows, cols, voids, block)| {
        let height = (0u32..10, 0usize..9).prop_map(move |(die, i)| {
            let heights = [0.0, 1.0, 2.0, 3.0, 4.0, 1.0, 2.0, -7.25, 1000.5];
            if die < voids {
                f64::NAN
            } else {
                heights[i]
            }
        });
        prop::collection::vec(height, rows * cols).prop_map(move |z| {
            let first = |i: usize| i / block * block;
            let z = (0..rows * cols).map(|i| z[first(i / cols) * cols + first(i % cols)]).collect();
            Raster { rows, cols, z }
        })
    })
}

pub fn metric() -> impl Strategy<Value = Metric> {
    prop_oneof![
        (0..FORMS.len()).prop_map(|i| form(FORMS[i].0, FORMS[i].1, FORMS[i].2)),
        (1i64..50, -50i64..50, 1i64..50).prop_map(|(a, b, c)| form(a, b, c)),
    ]
}

pub fn rule() -> impl Strategy<Value = Rule> {
    prop::sample::select(vec![MAX, PAPER, AUTO])
}

/// Plain or with all stages, with a tolerance or without, few points or any number.
pub fn options() -> impl Strategy<Value = Options> {
    let tolerance = prop::sample::select(vec![0.0, 0.0, 0.25, 0.7, 2.0]);
    let most = prop_oneof![Just(usize::MAX), 0usize..60];
    let stages = any::<[bool; 2]>();
    (rule(), tolerance, most, stages, tile()).prop_map(|(rule, tolerance, most, [all, at_noise], tile)| {
        let rule = Rule { tolerance, ..rule };
        Options {
            stop_at_noise: all && at_noise,
            tile,
            ..if all { full(rule, most) } else { plain(rule, most) }
        }
    })
}

/// Mostly within the bounds of a quantile.
fn quantile() -> impl Strategy<Value = f64> {
    prop_oneof![8 => 0.01f64..=1.0, 8 => Just(1.0), 1 => prop::sample::select(vec![0.0, -0.1, 1.1, f64::NAN])]
}

/// Tiles that even small rasters have several of, or none.
pub fn tile() -> impl Strategy<Value = usize> {
    prop_oneof![1 => Just(0), 1 => 1usize..6]
}

pub fn any_options() -> impl Strategy<Value = Options> {
    let odd = prop::sample::select(vec![-1.0, f64::NAN, f64::INFINITY]);
    let tolerance = prop_oneof![8 => 0.0f64..5.0, 4 => Just(0.0), 1 => odd.clone()];
    let sigma = prop_oneof![12 => 0.0f64..4.0, 6 => Just(0.0), 2 => 4.0f64..101.0, 1 => odd.clone()];
    let scales = prop_oneof![
        Just(Scales::Auto),
        prop::collection::vec([sigma.clone(), sigma], 0..4).prop_map(Scales::Given),
    ];
    let size = || prop_oneof![2 => 0usize..100, 1 => Just(usize::MAX)];
    let rule = (quantile(), prop_oneof![12 => -2.0f64..4.0, 1 => odd], quantile(), tolerance, quantile());
    let initial = prop::collection::vec((0usize..10, 0usize..10), 0..3);
    (size(), size(), rule, scales, any::<[bool; 4]>(), 0u32..4, initial, tile()).prop_map(
        |(
            max_points,
            points_per_scale,
            rule,
            scales,
            [has_tolerance, stop_at_noise, despike, fit],
            flips,
            initial,
            tile,
        )| {
            let (priority, weight, candidate, tolerance, bound) = rule;
            let rule = Rule { priority, weight, candidate, tolerance, bound };
            Options {
                max_points,
                is_share: false,
                points_per_scale: Some(points_per_scale),
                rule,
                has_tolerance,
                stop_at_noise,
                scales,
                despike,
                fit,
                flips,
                shape: Shape::default(),
                constraints: Constraints { pixels: initial, ..Constraints::default() },
                tile,
            }
        },
    )
}
