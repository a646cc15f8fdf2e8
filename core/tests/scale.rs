//! Smoothing, noise and spikes.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod common;

use common::{hills, quietly, Random};
use dem2tin_core::grid::{Grid, Height};
use dem2tin_core::noise::{noise, spikes};
use dem2tin_core::progress::Progress;
use dem2tin_core::scale::{choose, gaussian};
use proptest::prelude::*;

fn smooth<T: Height>(z: &[T], rows: usize, cols: usize, sigma: [f64; 2]) -> Vec<T> {
    let grid = Grid::new(z, rows, cols).unwrap();
    quietly(|progress| gaussian(&grid, sigma, progress)).unwrap().into_owned()
}

/// Pixels of a raster that despiking replaces, found with its own noise estimate.
fn spiky(z: &[f64], rows: usize, cols: usize) -> Vec<(usize, f64)> {
    let grid = Grid::new(z, rows, cols).unwrap();
    quietly(|progress| spikes(&grid, noise(&grid), progress)).unwrap()
}

/// Convolution with the Gaussian cut off at 4 sigma, written as a double sum. Where
/// pixels are missing: the weighted least-squares plane at the pixel itself (by
/// Gaussian elimination), or their weighted mean if they hardly span one.
fn convolved(z: &[f64], rows: usize, cols: usize, sigma: [f64; 2]) -> Vec<Option<f64>> {
    let reach = sigma.map(|s| (4.0 * s + 0.5) as i64);
    let bell = |k: i64, s: f64| if k == 0 { 1.0 } else { (-((k * k) as f64) / (2.0 * s * s)).exp() };
    let spread = |s: f64, reach: i64| -> f64 {
        let total: f64 = (-reach..=reach).map(|k| bell(k, s)).sum();
        (-reach..=reach).map(|k| bell(k, s) / total * (k * k) as f64).sum()
    };
    let value = |i: usize| {
        let (col, row) = ((i % cols) as i64, (i / cols) as i64);
        let (mut normal, mut whole) = ([[0.0; 4]; 3], 0.0);
        for (r, c) in (row - reach[1]..=row + reach[1])
            .flat_map(|r| (col - reach[0]..=col + reach[0]).map(move |c| (r, c)))
        {
            let weight = bell(c - col, sigma[0]) * bell(r - row, sigma[1]);
            whole += weight;
            let inside = r >= 0 && c >= 0 && r < rows as i64 && c < cols as i64;
            if inside && !z[r as usize * cols + c as usize].is_nan() {
                let terms = [1.0, (c - col) as f64, (r - row) as f64, z[r as usize * cols + c as usize]];
                for (line, a) in normal.iter_mut().zip(terms) {
                    line.iter_mut().zip(terms).for_each(|(sum, b)| *sum += weight * a * b);
                }
            }
        }
        let (mean, mass) = (normal[0][3] / normal[0][0], normal[0][0] / whole);
        if z[i].is_nan() || mass > 1.0 - 1e-12 {
            return Some(if z[i].is_nan() { f64::NAN } else { mean });
        }
        // Eliminate the slopes, the constant last.
        let mut determinant = 1.0;
        for k in [2, 1] {
            let pivot = normal[k];
            determinant *= pivot[k] / whole;
            for line in &mut normal[..k] {
                let factor = line[k] / pivot[k];
                line.iter_mut().zip(pivot).for_each(|(x, p)| *x -= factor * p);
            }
        }
        let relative =
            determinant * normal[0][0] / whole / (spread(sigma[0], reach[0]) * spread(sigma[1], reach[1]));
        match relative {
            r if r > 1.1e-3 => Some(normal[0][3] / normal[0][0]),
            // Near the limit either answer will do.
            r if r > 0.9e-3 => None,
            _ => Some(mean),
        }
    };
    (0..z.len()).map(value).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(500))]

    #[test]
    fn gaussian_is_the_convolution_and_a_plane_where_it_is_cut_off(
        rows in 2usize..14, cols in 2usize..14, sx in 0.0f64..3.0, sy in 0.0f64..3.0, voids in 0.0f64..0.9, seed: u64,
    ) {
        let mut random = Random(seed);
        let z: Vec<f64> = (0..rows * cols)
            .map(|_| if random.unit() < voids { f64::NAN } else { random.normal() })
            .collect();
        let single: Vec<f32> = z.iter().map(|&z| z as f32).collect();
        let expected = convolved(&z, rows, cols, [sx, sy]);
        let (double, single) = (smooth(&z, rows, cols, [sx, sy]), smooth(&single, rows, cols, [sx, sy]));
        for (want, (double, single)) in expected.into_iter().zip(double.into_iter().zip(single)) {
            let Some(want) = want else { continue };
            let close = |z: f64, within| (z.is_nan() && want.is_nan()) || (z - want).abs() < within;
            prop_assert!(close(double, 1e-8), "{} {}", double, want);
            prop_assert!(close(f64::from(single), 1e-3), "{} {}", single, want);
        }
    }

    #[test]
    fn a_slope_stays_a_slope_up_to_borders_and_voids(sigma in 0.8f64..4.0, a in -9.0f64..9.0, b in -9.0f64..9.0, cut in 0usize..12) {
        let plane = |i: usize| a * (i % 20) as f64 + b * (i / 20) as f64;
        // A collar, a lake and the border.
        let is_void = |i: usize| i % 20 + i / 20 < cut || (8..12).contains(&(i % 20)) && (6..9).contains(&(i / 20));
        let z: Vec<f64> = (0..300).map(|i| if is_void(i) { f64::NAN } else { plane(i) }).collect();
        for (i, smooth) in smooth(&z, 15, 20, [sigma, sigma]).into_iter().enumerate() {
            prop_assert!(z[i].is_nan() || (smooth - plane(i)).abs() < 1e-8);
        }
    }

    #[test]
    fn a_constant_stays_constant_and_voids_stay_void(sigma in 0.0f64..6.0, height in -1e6f64..1e6, seed: u64) {
        let mut random = Random(seed);
        let z: Vec<f64> = (0..300).map(|_| if random.below(3) == 0 { f64::NAN } else { height }).collect();
        for (smooth, z) in smooth(&z, 15, 20, [sigma, 0.5 * sigma]).iter().zip(&z) {
            prop_assert!(smooth.is_nan() == z.is_nan());
            prop_assert!(z.is_nan() || (smooth - z).abs() <= 1e-13 * height.abs());
        }
    }

    #[test]
    fn spikes_inside_a_smooth_ramp_are_found_and_nothing_else(a in -1.0f64..1.0, b in -1.0f64..1.0, seed: u64) {
        let (rows, cols) = (40, 50);
        let mut random = Random(seed);
        let ramp: Vec<f64> = (0..rows * cols)
            .map(|i| a * (i % cols) as f64 + b * (i / cols) as f64)
            .collect();
        let inside = |i: usize| (1..rows - 1).contains(&(i / cols)) && (1..cols - 1).contains(&(i % cols));
        prop_assert!(!spiky(&ramp, rows, cols).iter().any(|f| inside(f.0)));
        let mut z = ramp.clone();
        let mut planted = Vec::new();
        // Never two in one neighbourhood, never at the border.
        for (row, col) in (2..rows - 2).step_by(4).flat_map(|row| (2..cols - 2).step_by(5).map(move |col| (row, col))) {
            if random.below(3) == 0 {
                z[row * cols + col] += if random.below(2) == 0 { 60.0 } else { -60.0 };
                planted.push(row * cols + col);
            }
        }
        let mut found = spiky(&z, rows, cols);
        found.retain(|f| inside(f.0));
        prop_assert_eq!(found.iter().map(|f| f.0).collect::<Vec<_>>(), planted);
        for (pixel, height) in found {
            prop_assert!((height - ramp[pixel]).abs() <= 1.0 + a.abs() + b.abs());
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(20))]

    #[test]
    fn wide_rasters_are_smoothed_like_narrow_ones(rows in 2usize..70, cols in 250usize..800, lake in 0usize..800, sigma in 0.3f64..1.4, seed: u64) {
        // A few rows are looked at: the oracle takes its time.
        let mut random = Random(seed);
        let is_void = |i: usize| (i % cols).abs_diff(lake) < 9 && i / cols > 3;
        let z: Vec<f64> = (0..rows * cols).map(|i| if is_void(i) { f64::NAN } else { random.normal() }).collect();
        let found = smooth(&z, rows, cols, [sigma, sigma]);
        for first in [0, rows / 2, rows.saturating_sub(1)] {
            let (from, to) = (first.saturating_sub(6), (first + 7).min(rows));
            let (part, at) = (&z[from * cols..to * cols], (first - from) * cols);
            let expected = convolved(part, to - from, cols, [sigma, sigma]);
            for (found, want) in found[first * cols..][..cols].iter().zip(&expected[at..at + cols]) {
                let Some(want) = want else { continue };
                prop_assert!((found.is_nan() && want.is_nan()) || (found - want).abs() < 1e-8, "{found} {want}");
            }
        }
    }
}

/// Spikes as their definition reads, every pixel looked at in full.
fn spikes_by_definition<T: Height>(grid: &Grid<T>, margin: f64) -> Vec<(usize, f64)> {
    let mut found = Vec::new();
    for (row, col) in (0..grid.rows()).flat_map(|row| (0..grid.cols()).map(move |col| (row, col))) {
        let is_beside =
            |r: usize, c: usize| r.abs_diff(row) <= 1 && c.abs_diff(col) <= 1 && (r, c) != (row, col);
        let mut around: Vec<f64> = (0..grid.rows())
            .flat_map(|r| (0..grid.cols()).map(move |c| (r, c)))
            .filter(|&(r, c)| is_beside(r, c) && grid.is_valid(c, r))
            .map(|(r, c)| grid.at(c, r))
            .collect();
        around.sort_by(f64::total_cmp);
        let n = around.len();
        if n < 5 || !grid.is_valid(col, row) {
            continue;
        }
        let rank = usize::from(n >= 6);
        let (low, high, z) = (around[rank], around[n - 1 - rank], grid.at(col, row));
        if z > high + 0.5 * (high - low) + margin || z < low - 0.5 * (high - low) - margin {
            found.push((row * grid.cols() + col, 0.5 * (around[(n - 1) / 2] + around[n / 2])));
        }
    }
    found
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn spikes_are_what_their_definition_says(
        rows in 2usize..12, cols in 2usize..40, voids in 0.0f64..0.5, tail in 1i32..12, seed: u64,
    ) {
        let mut random = Random(seed);
        // Whole numbers: heights that are equal, and differences that are the margin itself.
        let z: Vec<f64> = (0..rows * cols)
            .map(|_| if random.unit() < voids { f64::NAN } else { (10.0 * random.unit().powi(tail)).round() })
            .collect();
        let single: Vec<f32> = z.iter().map(|&z| z as f32).collect();
        let (grid, single) = (Grid::new(&z, rows, cols).unwrap(), Grid::new(&single, rows, cols).unwrap());
        // A quarter of a margin of 1, which no share of the range of 10 exceeds.
        let expected = spikes_by_definition(&grid, 1.0);
        prop_assert_eq!(&quietly(|progress| spikes(&grid, 0.25, progress)).unwrap(), &expected);
        let found = quietly(|progress| spikes(&single, 0.25, progress)).unwrap();
        prop_assert_eq!(found.into_iter().map(|(i, z)| (i, f64::from(z))).collect::<Vec<_>>(), expected);
    }
}

/// Heights with noise, spikes, a collar and lakes, more rows than several bands.
fn spotted(rows: usize, cols: usize) -> Vec<f32> {
    let mut random = Random(5);
    let relief = hills(rows, cols, 3);
    let is_void = |i: usize| i % cols + i / cols < 40 || (i % cols / 40 + i / cols / 25) % 5 == 4;
    (0..rows * cols)
        .map(|i| {
            let spike = if random.below(300) == 0 { 500.0 } else { 0.0 };
            if is_void(i) {
                f32::NAN
            } else {
                (relief[i] + 9.0 * random.normal() + spike) as f32
            }
        })
        .collect()
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let (rows, cols) = (150, 330);
    let z = spotted(rows, cols);
    let grid = Grid::new(&z, rows, cols).unwrap();
    let bits = |z: &[f32]| z.iter().map(|z| z.to_bits()).collect::<Vec<_>>();
    let run = |threads: usize| {
        let mut quiet = |_: &'static str, _: f64| true;
        let mut progress = Progress::new(&mut quiet).with_threads(threads);
        let chosen = choose(&grid, noise(&grid), &mut progress).unwrap();
        let wide = gaussian(&grid, [6.0, 2.0], &mut progress).unwrap();
        assert!(chosen.sigma > 0.0);
        (spikes(&grid, 1.0, &mut progress).unwrap(), chosen.sigma, bits(&chosen.z), bits(&wide))
    };
    let alone = run(1);
    assert!(alone.0.len() > 50);
    for threads in [2, 3, 8] {
        assert!(run(threads) == alone, "{threads} threads");
    }
}

#[test]
fn noise_is_estimated_within_a_tenth() {
    let (rows, cols) = (200, 220);
    for (seed, sigma) in [(1, 0.01), (2, 1.0), (3, 25.5), (4, 1e6)] {
        let mut random = Random(seed);
        let relief = hills(rows, cols, 1);
        let clean = |i: usize| {
            3.0 * (i % cols) as f64 - 2.0 * (i / cols) as f64 + if sigma > 20.0 { relief[i] } else { 0.0 }
        };
        let mut z: Vec<f64> = (0..rows * cols).map(|i| clean(i) + sigma * random.normal()).collect();
        let estimate = noise(&Grid::new(&z, rows, cols).unwrap());
        assert!((estimate / sigma - 1.0).abs() < 0.1, "{estimate} for {sigma}");
        // One percent of spikes and a void do not disturb it.
        for i in 0..rows * cols / 100 {
            z[(i * 7919) % (rows * cols)] = if i % 2 == 0 { 1e9 } else { f64::NAN };
        }
        let estimate = noise(&Grid::new(&z, rows, cols).unwrap());
        assert!((estimate / sigma - 1.0).abs() < 0.15, "{estimate} for {sigma} with spikes");
    }
}

#[test]
fn rasters_without_a_complete_neighbourhood_have_no_noise() {
    assert_eq!(noise(&Grid::new(&[1.0, 5.0, 2.0, 8.0], 2, 2).unwrap()), 0.0);
    assert_eq!(noise(&Grid::new(&[1.0f32; 2000], 2, 1000).unwrap()), 0.0);
    assert_eq!(noise(&Grid::new(&[f64::NAN; 25], 5, 5).unwrap()), 0.0);
    assert_eq!(noise(&Grid::new(&[7.0; 25], 5, 5).unwrap()), 0.0);
}

#[test]
fn smoothing_is_chosen_only_where_it_lowers_the_error() {
    let (rows, cols) = (120, 120);
    let clean: Vec<f64> = (0..rows * cols)
        .map(|i| 60.0 * (0.12 * (i % cols) as f64).sin() * (0.1 * (i / cols) as f64).cos())
        .collect();
    let grid = Grid::new(&clean, rows, cols).unwrap();
    let kept = quietly(|progress| choose(&grid, 0.0, progress)).unwrap();
    assert_eq!(kept.sigma, 0.0);
    assert_eq!(kept.z, clean);

    let mut random = Random(2);
    let noisy: Vec<f64> = clean.iter().map(|z| z + 20.0 * random.normal()).collect();
    let grid = Grid::new(&noisy, rows, cols).unwrap();
    let smooth = quietly(|progress| choose(&grid, noise(&grid), progress)).unwrap();
    assert!(smooth.sigma >= 1.0);
    let squares = |z: &[f64]| -> f64 { z.iter().zip(&clean).map(|(a, b)| (a - b).powi(2)).sum() };
    assert!(squares(&smooth.z) < 0.1 * squares(&noisy));
}

#[test]
fn despiking_leaves_a_constant_and_its_voids_alone() {
    let z: Vec<f64> = (0..400).map(|i| if i % 7 == 0 { f64::NAN } else { 3.0 }).collect();
    assert_eq!(spiky(&z, 20, 20), vec![]);
    assert_eq!(spiky(&[0.0, 9.0, 0.0, 0.0], 2, 2), vec![]);
}
