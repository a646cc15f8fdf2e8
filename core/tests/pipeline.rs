//! All stages together: valid meshes, kept promises, same answers.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod common;

use common::{assert_sound, fingerprint, full, hills, plain, residuals, run, Random, AUTO, MAX, PAPER};
use dem2tin_core::domain::Constraints;
use dem2tin_core::error::Error;
use dem2tin_core::grid::{Grid, Height};
use dem2tin_core::measure::{errors, rasterise};
use dem2tin_core::pipeline::{triangulate, Options, Scales, Triangulation};
use dem2tin_core::predicate::{orient2d, Metric, UNIT};
use dem2tin_core::rule::{Rule, Stop};
use proptest::prelude::*;

/// Twice the area in pixels of the cell complex of the valid pixels.
fn twice_area<T: Height>(grid: &Grid<T>) -> i64 {
    let valid = |col, row| i64::from(grid.is_valid(col, row));
    let cell =
        |col, row| valid(col, row) + valid(col + 1, row) + valid(col, row + 1) + valid(col + 1, row + 1);
    let cells = (0..grid.rows() - 1).flat_map(|row| (0..grid.cols() - 1).map(move |col| (col, row)));
    cells.map(|(col, row)| (cell(col, row) - 2).max(0)).sum()
}

/// A sound mesh over all the data, with heights wherever data triangles need them.
fn assert_faithful<T: Height>(z: &[T], rows: usize, cols: usize, options: &Options) {
    let grid = Grid::new(z, rows, cols).unwrap();
    match run(z, rows, cols, options) {
        Ok(done) => {
            assert_sound(&done.surface.mesh, done.report.delaunay);
            let mut area = 0;
            for (t, triangle) in
                done.surface.mesh.triangles().iter().enumerate().filter(|(_, t)| !t.is_void())
            {
                let [a, b, c] = done.surface.mesh.corners(t as u32);
                area += orient2d(a, b, c);
                assert!(triangle.v.iter().all(|&v| done.surface.z[v as usize].is_finite()));
            }
            assert!(area >= twice_area(&grid) * i64::from(UNIT) * i64::from(UNIT));
            let (errors, _) =
                common::quietly(|p| errors(&done.surface.mesh, &done.surface.z, &grid, p)).unwrap();
            assert_eq!(errors.void_covered, 0);
        }
        Err(error) => {
            assert!(matches!(error, Error::Input { code: "no-area", .. }), "{error:?}");
            assert_eq!(twice_area(&grid), 0);
        }
    }
}

fn three_by_three(code: u32) -> [f32; 9] {
    std::array::from_fn(|i| [0.0, 1.0, 2.0, f32::NAN][(code >> (2 * i) & 3) as usize])
}

#[test]
fn all_3_by_3_rasters_by_the_paper() {
    (0..1 << 18).for_each(|code| assert_faithful(&three_by_three(code), 3, 3, &plain(PAPER, 8)));
}

#[test]
fn all_3_by_3_rasters_by_the_maximum() {
    let rule = Rule { tolerance: 0.75, ..MAX };
    (0..1 << 18).for_each(|code| assert_faithful(&three_by_three(code), 3, 3, &plain(rule, usize::MAX)));
}

#[test]
fn all_3_by_3_rasters_with_fit_and_flips() {
    let options = Options { fit: true, flips: 2, ..plain(AUTO, 7) };
    (0..1 << 18).for_each(|code| assert_faithful(&three_by_three(code), 3, 3, &options));
}

/// Hills, possibly with voids, spikes or only two rows.
fn terrain(rows: usize, cols: usize, voids: f64, seed: u64) -> Vec<f64> {
    let mut random = Random(!seed);
    let disturb = |z: f64| match random.unit() {
        u if u < voids => f64::NAN,
        u if u > 0.99 => z + 100.0,
        _ => z,
    };
    hills(rows, cols, seed).into_iter().map(disturb).collect()
}

fn same(a: &Triangulation, b: &Triangulation) -> bool {
    let structure = |done: &Triangulation| {
        let corners: Vec<_> =
            done.surface.mesh.triangles().iter().map(|t| (t.v, t.twin, t.is_void())).collect();
        (done.surface.mesh.points().to_vec(), corners)
    };
    structure(a) == structure(b)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1000))]

    #[test]
    fn any_setting_gives_a_faithful_mesh(
        rows in 2usize..24, cols in 2usize..24, voids in 0.0f64..0.4, n in 0usize..150,
        priority in 0.01f64..=1.0, candidate in 0.01f64..=1.0, weight in -1.0f64..1.0, tolerance in 0.0f64..9.0,
        flags in 0u32..32, seed: u64,
    ) {
        let z = terrain(rows, cols, voids, seed);
        let bound = if flags & 16 > 0 { 1.0 } else { priority };
        let options = Options {
            despike: flags & 1 > 0,
            fit: flags & 2 > 0,
            flips: flags >> 2 & 1,
            scales: if flags & 8 > 0 { Scales::Auto } else { Scales::Given(vec![[1.0; 2], [0.5, 0.0]]) },
            constraints: Constraints { pixels: (0..n / 4).map(|i| (i * 7 % cols, i * 5 % rows)).collect(), ..Constraints::default() },
            ..plain(Rule { priority, weight, candidate, tolerance, bound }, n)
        };
        assert_faithful(&z, rows, cols, &options);
        let single: Vec<f32> = z.iter().map(|&z| z as f32).collect();
        assert_faithful(&single, rows, cols, &options);
    }

    #[test]
    fn a_tolerance_holds_at_every_pixel_with_all_stages(
        rows in 2usize..24, cols in 2usize..24, voids in 0.0f64..0.3, tolerance in 0.5f64..20.0, seed: u64,
    ) {
        let z = terrain(rows, cols, voids, seed);
        for rule in [MAX, AUTO, Rule { bound: 1.0, ..PAPER }] {
            let options = full(Rule { tolerance, ..rule }, usize::MAX);
            let Ok(done) = run(&z, rows, cols, &options) else { continue };
            prop_assert_eq!(done.report.stop, Stop::Tolerance);
            for (pixel, error) in residuals(&done, &z, cols).into_iter().enumerate() {
                let despiked = done.report.spikes.contains(&pixel);
                prop_assert!(despiked || error.is_nan() || error <= tolerance * (1.0 + 1e-9), "{} {}", error, tolerance);
            }
        }
    }

    #[test]
    fn the_same_input_gives_the_same_bits(rows in 2usize..30, cols in 2usize..30, n in 4usize..200, seed: u64) {
        let z = terrain(rows, cols, 0.1, seed);
        for rule in [PAPER, MAX, AUTO] {
            let (a, b) = (run(&z, rows, cols, &full(rule, n)), run(&z, rows, cols, &full(rule, n)));
            prop_assert_eq!(a.as_ref().map(fingerprint).ok(), b.as_ref().map(fingerprint).ok());
        }
    }

    #[test]
    fn single_and_double_precision_agree_on_small_integers(rows in 2usize..20, cols in 2usize..20, n in 4usize..100, seed: u64) {
        let mut random = Random(seed);
        let height = |_| if random.below(9) == 0 { f32::NAN } else { random.below(50) as f32 };
        let single: Vec<f32> = (0..rows * cols).map(height).collect();
        let double: Vec<f64> = single.iter().map(|&z| f64::from(z)).collect();
        for rule in [PAPER, MAX, AUTO] {
            let options = Options { fit: true, flips: 1, ..plain(rule, n) };
            let (a, b) = (run(&single, rows, cols, &options), run(&double, rows, cols, &options));
            prop_assert_eq!(a.as_ref().map(fingerprint).ok(), b.as_ref().map(fingerprint).ok());
        }
    }

    #[test]
    fn scaling_heights_and_tolerance_by_a_power_of_two_changes_nothing_else(
        rows in 2usize..20, cols in 2usize..20, n in 4usize..100, power in -40i32..40, seed: u64,
    ) {
        let z = terrain(rows, cols, 0.1, seed);
        let factor = 2f64.powi(power);
        let scaled: Vec<f64> = z.iter().map(|z| z * factor).collect();
        for rule in [PAPER, MAX, AUTO] {
            let options = |factor| full(Rule { tolerance: 3.0 * factor, ..rule }, n);
            let (a, b) = (run(&z, rows, cols, &options(1.0)), run(&scaled, rows, cols, &options(factor)));
            if let (Ok(a), Ok(b)) = (a, b) {
                prop_assert!(same(&a, &b));
                prop_assert!(a.surface.z.iter().zip(&b.surface.z).all(|(a, b)| a.is_nan() || a * factor == *b));
            }
        }
    }

    #[test]
    fn bits_under_voids_do_not_matter(rows in 2usize..20, cols in 2usize..20, n in 4usize..100, seed: u64) {
        let z = terrain(rows, cols, 0.3, seed);
        let mut random = Random(seed);
        let payload = |z: &f64| match z.is_nan() {
            // Any mantissa but 0, either sign: every NaN there is.
            true => f64::from_bits(0x7ff0_0000_0000_0001 | random.bits()),
            false => *z,
        };
        let other: Vec<f64> = z.iter().map(payload).collect();
        prop_assert!(other.iter().zip(&z).all(|(a, b)| a.is_nan() == b.is_nan()));
        let (a, b) = (run(&z, rows, cols, &full(AUTO, n)), run(&other, rows, cols, &full(AUTO, n)));
        if let (Ok(a), Ok(b)) = (a, b) {
            prop_assert!(same(&a, &b));
            prop_assert!(a.surface.z.iter().zip(&b.surface.z).all(|(a, b)| a == b || a.is_nan() && b.is_nan()));
        }
    }

    #[test]
    fn a_plane_is_two_triangles(rows in 2usize..60, cols in 2usize..60, a in -99i32..99, b in -99i32..99) {
        let z: Vec<f64> = (0..rows * cols).map(|i| f64::from(a) * (i % cols) as f64 + f64::from(b) * (i / cols) as f64).collect();
        for rule in [PAPER, MAX, AUTO] {
            let tolerant = Rule { tolerance: 1e-6, ..rule };
            let done = run(&z, rows, cols, &Options { fit: true, flips: 2, ..plain(tolerant, usize::MAX) }).unwrap();
            prop_assert_eq!(done.surface.mesh.triangles().len(), 2);
        }
    }

    #[test]
    fn the_error_report_is_that_of_a_plain_loop(rows in 2usize..20, cols in 2usize..20, n in 4usize..60, seed: u64) {
        let z = terrain(rows, cols, 0.1, seed);
        let grid = Grid::new(&z, rows, cols).unwrap();
        if let Ok(done) = run(&z, rows, cols, &full(AUTO, n)) {
            let (report, largest) = common::quietly(|p| errors(&done.surface.mesh, &done.surface.z, &grid, p)).unwrap();
            let plain = residuals(&done, &z, cols);
            let mut covered: Vec<f64> = plain.iter().copied().filter(|e| !e.is_nan()).collect();
            covered.sort_by(f64::total_cmp);
            let count = covered.len() as f64;
            prop_assert_eq!(report.covered, covered.len());
            prop_assert_eq!(report.uncovered, grid.count_valid() - covered.len());
            prop_assert_eq!(report.void_covered, 0);
            let rmse = (covered.iter().map(|e| e * e).sum::<f64>() / count).sqrt();
            prop_assert!((report.rmse - rmse).abs() < 1e-9 && (report.mae - covered.iter().sum::<f64>() / count).abs() < 1e-9);
            prop_assert!((report.max - covered[covered.len() - 1]).abs() < 1e-9);
            prop_assert!((report.p95 - covered[(count * 0.95).ceil() as usize - 1]).abs() < 1e-4);
            prop_assert_eq!(largest.iter().copied().fold(0.0, f64::max), report.max);
            let surface: Vec<f64> = common::quietly(|p| rasterise(&done.surface.mesh, &done.surface.z, rows, cols, p)).unwrap();
            for (i, height) in surface.iter().enumerate() {
                prop_assert_eq!(height.is_nan(), plain[i].is_nan());
                prop_assert!(height.is_nan() || ((height - z[i]).abs() - plain[i]).abs() < 1e-9);
            }
        }
    }
}

#[test]
fn odd_heights_and_shapes_are_no_problem() {
    let single = |f: fn(usize) -> f32| -> Vec<f32> { (0..2000).map(f).collect() };
    let rasters = [
        single(|i| if i % 3 == 0 { 3e38 } else { -3e38 }),
        single(|i| f32::from_bits(1 + i as u32 % 7)),
        single(|i| if i % 2 == 0 { -0.0 } else { 0.0 }),
        single(|_| 1234.5),
        single(|i| if i == 999 { 1e38 } else { 0.0 }),
        single(|i| if i > 700 { f32::NAN } else { i as f32 }),
    ];
    for z in &rasters {
        for (rows, cols) in [(2, 1000), (1000, 2), (40, 50), (4, 500)] {
            for rule in [PAPER, MAX, AUTO] {
                for tolerance in [0.0, 1e-3] {
                    assert_faithful(z, rows, cols, &full(Rule { tolerance, ..rule }, 100));
                    assert_faithful(z, rows, cols, &plain(Rule { tolerance, ..rule }, 100));
                }
            }
        }
        assert_faithful(&z[..4], 2, 2, &full(AUTO, usize::MAX));
    }
}

#[test]
fn bad_options_are_refused() {
    let z = hills(5, 5, 0);
    let with = |change: &dyn Fn(&mut Options)| {
        let mut options = full(AUTO, 9);
        change(&mut options);
        matches!(run(&z, 5, 5, &options), Err(Error::Option { code: "bad-option", .. }))
    };
    assert!(!with(&|_| ()));
    for q in [0.0, -0.5, 1.1, f64::NAN, f64::INFINITY] {
        assert!(
            with(&|o| o.rule.priority = q) && with(&|o| o.rule.candidate = q) && with(&|o| o.rule.bound = q)
        );
    }
    assert!([-1.0, f64::NAN, f64::INFINITY].into_iter().all(|t| with(&|o| o.rule.tolerance = t)));
    assert!([f64::NAN, f64::INFINITY].into_iter().all(|w| with(&|o| o.rule.weight = w)));
    assert!([vec![], vec![[-1.0, 1.0]], vec![[1.0, f64::NAN]], vec![[0.0; 2], [1e9, 0.0]]]
        .into_iter()
        .all(|s| with(&|o| o.scales = Scales::Given(s.clone()))));
}

#[test]
fn rasters_without_area_are_refused() {
    let void = f64::NAN;
    for (z, rows, cols) in [
        (vec![void; 12], 3, 4),
        (vec![1.0, 2.0, void, void], 2, 2),
        ((0..36).map(|i| if i % 7 == 0 { 1.0 } else { void }).collect(), 6, 6),
        ((0..36).map(|i| if i % 6 == 2 { 1.0 } else { void }).collect(), 6, 6),
    ] {
        assert!(matches!(run(&z, rows, cols, &plain(MAX, 9)), Err(Error::Input { code: "no-area", .. })));
    }
    for (rows, cols) in [(0, 0), (1, 9), (9, 1), (0, 5)] {
        let z = vec![1.0; rows * cols];
        assert!(matches!(Grid::new(&z, rows, cols), Err(Error::Input { code: "too-small", .. })));
    }
    assert!(matches!(Grid::new(&[1.0; 4], 2, (1 << 20) + 1), Err(Error::Input { code: "too-large", .. })));
    assert!(Grid::new(&[1.0; 4], 2, 3).is_err());
}

#[test]
fn sheared_and_anisotropic_metrics_go_through_all_stages() {
    let z = terrain(40, 30, 0.1, 6);
    let grid = Grid::new(&z, 40, 30).unwrap();
    for (e, f, g) in [(1.0, 0.0, 1e-6), (900.0, 100.0, 30.0), (1e-9, -9e-10, 1e-9)] {
        let metric = Metric::from_form(e, f, g, 40).unwrap();
        let done = common::quietly(|p| triangulate(&grid, metric, &plain(MAX, 300), p)).unwrap();
        assert_sound(&done.surface.mesh, true);
        let done = common::quietly(|p| triangulate(&grid, metric, &full(AUTO, 300), p)).unwrap();
        assert_sound(&done.surface.mesh, false);
    }
}

#[test]
fn noise_on_a_plane_is_left_alone() {
    let mut random = Random(4);
    let z: Vec<f64> = (0..10_000).map(|i| 0.3 * (i % 100) as f64 + random.normal()).collect();
    let options = Options { stop_at_noise: true, ..full(AUTO, usize::MAX) };
    let done = run(&z, 100, 100, &options).unwrap();
    assert_eq!(done.report.stop, Stop::Noise);
    assert!(done.surface.mesh.points().len() < 200, "{}", done.surface.mesh.points().len());
    let few = run(&z, 100, 100, &Options { max_points: 5, ..options }).unwrap();
    assert_eq!(few.surface.mesh.points().len(), 5);
}
