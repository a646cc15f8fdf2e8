//! Breaklines, clip polygons and level areas shape the mesh as they should.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod common;

use common::{
    assert_sound, form, full, hills, one_tile, plain, quietly, residuals, run, Random, AUTO, FORMS, MAX,
    PAPER,
};
use dem2tin_core::crop::Vertex;
use dem2tin_core::domain::{domain, Constraints, Polygon};
use dem2tin_core::error::Error;
use dem2tin_core::grid::Grid;
use dem2tin_core::measure::{errors, rasterise};
use dem2tin_core::mesh::{half_edge, Class};
use dem2tin_core::outline::Shape;
use dem2tin_core::pipeline::{Options, Triangulation};
use dem2tin_core::predicate::{orient2d, Point, UNIT};
use dem2tin_core::rule::Rule;
use dem2tin_core::surface::Surface;
use proptest::prelude::*;

const FREE: f64 = f64::NAN;

fn vertex(random: &mut Random, side: usize, height: bool) -> Vertex {
    let reach = side as f64 + 4.0;
    let mut along = || random.unit() * reach - 2.0;
    let [mut col, mut row] = [along(), along()];
    // Half of them on pixel centres, where they meet the outline and each other.
    if random.below(2) == 0 {
        (col, row) = (col.round(), row.round());
    }
    [col, row, if height { 10.0 * random.unit() } else { FREE }]
}

fn chain(random: &mut Random, side: usize, height: bool) -> Vec<Vertex> {
    (0..2 + random.below(4)).map(|_| vertex(random, side, height)).collect()
}

/// A triangle or quadrangle, sometimes with crossing sides or a hole.
fn polygon(random: &mut Random, side: usize) -> Polygon {
    (0..1 + random.below(2))
        .map(|_| (0..3 + random.below(2)).map(|_| vertex(random, side, false)).collect())
        .collect()
}

fn constraints(random: &mut Random, side: usize) -> Constraints {
    Constraints {
        pixels: (0..random.below(4)).map(|_| (random.below(side), random.below(side))).collect(),
        points: (0..random.below(4)).map(|_| vertex(random, side, true)).collect(),
        lines: (0..random.below(4)).map(|i| chain(random, side, i % 2 == 0)).collect(),
        clip: (random.below(3) == 0)
            .then(|| (0..1 + random.below(2)).map(|_| polygon(random, side)).collect()),
        flat: (0..random.below(3))
            .map(|i| (polygon(random, side), if i == 0 { FREE } else { 3.0 }))
            .collect(),
    }
}

fn height_at(surface: &Surface, p: Point) -> Option<f64> {
    let v = surface.mesh.points().iter().position(|&q| q == p)?;
    Some(surface.z[v])
}

fn lattice([col, row, _]: Vertex) -> Point {
    Point { x: (col * f64::from(UNIT)).round() as i32, y: (row * f64::from(UNIT)).round() as i32 }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(10_000))]

    #[test]
    fn any_constraints_on_any_mask_give_a_sound_mesh(side in 2usize..9, share in 0.5f64..1.2, which in 0..FORMS.len(), tolerance in 0usize..4, seed: u64) {
        let random = &mut Random(seed);
        let z: Vec<f64> = (0..side * side).map(|_| if random.unit() < share { random.unit() } else { f64::NAN }).collect();
        let grid = Grid::new(&z, side, side).unwrap();
        let given = constraints(random, side);
        let shape = Shape { tolerance: [0.0, 0.5, 1.0, 2.5][tolerance], keep_isolated: random.below(2) == 0, sieve: random.below(4) };
        let (a, b, c) = FORMS[which];
        match quietly(|progress| domain(&grid, form(a, b, c), &shape, &given, &one_tile(&grid), progress)) {
            Ok(surface) => {
                assert_sound(&surface.mesh, true);
                let used = surface.mesh.triangles().iter().filter(|t| !t.is_void()).flat_map(|t| t.v);
                for v in used { prop_assert!(surface.z[v as usize].is_finite()); }
                for (t, triangle) in surface.mesh.triangles().iter().enumerate() {
                    for k in (0..3).filter(|&k| triangle.is_hard(k)) {
                        let h = half_edge(t as u32, k as u32);
                        prop_assert!(triangle.is_constrained(k));
                        for v in [surface.mesh.origin(h), surface.mesh.dest(h)] { prop_assert!(surface.is_fixed[v as usize]); }
                    }
                    if triangle.class() == Class::Flat {
                        let [a, b, c] = surface.heights(t as u32);
                        prop_assert!(a == b && b == c || given.flat.len() > 1);
                    }
                }
            }
            Err(Error::Input { code, .. }) => prop_assert!(code == "no-area" || code == "clip-outside" && given.clip.is_some()),
            Err(error) => prop_assert!(false, "{:?}", error),
        }
    }

    #[test]
    fn all_stages_keep_what_is_fixed(seed: u64, which in 0usize..3) {
        let random = &mut Random(seed);
        let side = 6 + random.below(6);
        let mut z = hills(side, side, seed);
        (0..random.below(6)).for_each(|_| z[random.below(side * side)] = f64::NAN);
        let given = constraints(random, side);
        // Despiking may move the median that a level area takes.
        let options = Options { constraints: given.clone(), despike: false, ..[plain(MAX, 30), plain(PAPER, 30), full(AUTO, 30)][which].clone() };
        let Ok(done) = run(&z, side, side, &options) else { return Ok(()) };
        assert_sound(&done.surface.mesh, done.report.delaunay);
        let grid = Grid::new(&z, side, side).unwrap();
        let start = quietly(|p| domain(&grid, form(1, 0, 1), &options.shape, &given, &one_tile(&grid), p)).unwrap();
        for (v, &p) in start.mesh.points().iter().enumerate().filter(|(v, _)| start.is_fixed[*v] && !start.z[*v].is_nan()) {
            prop_assert_eq!(height_at(&done.surface, p), Some(start.z[v]));
        }
    }

    #[test]
    fn pixels_outside_the_clip_polygon_are_out_and_those_inside_are_in(seed: u64) {
        let random = &mut Random(seed);
        let side = 4 + random.below(8);
        let ring: Vec<Vertex> = (0..3).map(|_| vertex(random, side, false)).collect();
        let given = Constraints { clip: Some(vec![vec![ring.clone()]]), ..Constraints::default() };
        let z = vec![1.0; side * side];
        let Ok(done) = run(&z, side, side, &Options { constraints: given, ..plain(MAX, 9) }) else { return Ok(()) };
        let surface: Vec<f64> = quietly(|p| rasterise(&done.surface.mesh, &done.surface.z, side, side, p)).unwrap();
        let corner: Vec<Point> = ring.iter().map(|&v| lattice(v)).collect();
        let turn = orient2d(corner[0], corner[1], corner[2]).signum();
        for (i, height) in surface.iter().enumerate() {
            let q = Point::pixel(i % side, i / side);
            // Rounding to the lattice moves the border by less than a unit.
            let depths = (0..3).map(|k| {
                let (a, b) = (corner[k], corner[(k + 1) % 3]);
                (turn * orient2d(a, b, q)) as f64 / f64::from(b.x - a.x).hypot(f64::from(b.y - a.y)).max(1.0)
            });
            let depth = depths.fold(f64::INFINITY, f64::min);
            if depth.abs() > 2.0 { prop_assert_eq!(!height.is_nan(), depth > 0.0, "{} {}", i, depth); }
        }
    }
}

fn with(given: Constraints, options: Options) -> Options {
    Options { constraints: given, ..options }
}

/// Largest error where the DEM is neither under a hard line nor in a level area.
fn worst(done: &Triangulation, z: &[f64], cols: usize, is_free: impl Fn(usize, usize) -> bool) -> f64 {
    let residuals = residuals(done, z, cols);
    let of = |(i, error): (usize, &f64)| if is_free(i % cols, i / cols) { *error } else { 0.0 };
    residuals.iter().enumerate().map(of).fold(0.0, f64::max)
}

#[test]
fn the_surface_along_a_line_with_heights_is_straight_and_the_tolerance_holds_beside_it() {
    let (rows, cols) = (40, 50);
    let z = hills(rows, cols, 5);
    let line = vec![[5.0, 3.0, 100.0], [5.0, 30.0, 127.0], [44.0, 30.0, 200.0]];
    let given = Constraints { lines: vec![line], ..Constraints::default() };
    for options in [plain(MAX, usize::MAX), full(AUTO, usize::MAX)] {
        let options = with(given.clone(), Options { has_tolerance: true, ..options });
        let options = Options { rule: Rule { tolerance: 2.0, bound: 1.0, ..options.rule }, ..options };
        let done = run(&z, rows, cols, &options).unwrap();
        let surface: Vec<f64> =
            quietly(|p| rasterise(&done.surface.mesh, &done.surface.z, rows, cols, p)).unwrap();
        for row in 3..=30 {
            assert!((surface[row * cols + 5] - (97.0 + row as f64)).abs() < 1e-9);
        }
        let on_line = |col: usize, row: usize| {
            col == 5 && (3..=30).contains(&row) || row == 30 && (5..=44).contains(&col)
        };
        assert!(worst(&done, &z, cols, |col, row| !on_line(col, row)) <= 2.0 + 1e-9);
    }
}

#[test]
fn a_level_area_is_level_at_the_median_and_nothing_is_spent_inside() {
    let (rows, cols) = (40, 40);
    let z = hills(rows, cols, 8);
    let ring: Vec<Vertex> =
        [(10.3, 10.2), (29.6, 12.0), (25.0, 30.0), (9.1, 25.5)].map(|(x, y)| [x, y, FREE]).to_vec();
    let given = Constraints { flat: vec![(vec![ring], FREE)], ..Constraints::default() };
    for options in [plain(MAX, 300), full(AUTO, 300)] {
        let done = run(&z, rows, cols, &with(given.clone(), options)).unwrap();
        let mesh = &done.surface.mesh;
        let mut level = Vec::new();
        let mut corners = Vec::new();
        for (t, triangle) in mesh.triangles().iter().enumerate().filter(|(_, t)| t.class() == Class::Flat) {
            level.extend(done.surface.heights(t as u32));
            corners.extend(triangle.v);
        }
        corners.sort_unstable();
        corners.dedup();
        assert_eq!(corners.len(), 4);
        assert!(!level.is_empty() && level.iter().all(|&z| z == level[0]));
        let inside = |i: &usize| {
            let q = Point::pixel(i % cols, i / cols);
            (0..mesh.triangles().len() as u32)
                .any(|t| mesh.triangle(t).class() == Class::Flat && common::contains(mesh.corners(t), q))
        };
        let mut heights: Vec<f64> = (0..z.len()).filter(inside).map(|i| z[i]).collect();
        heights.sort_by(f64::total_cmp);
        assert!(heights.contains(&level[0]) || !done.report.spikes.is_empty());
        let below = heights.iter().filter(|&&z| z < level[0]).count();
        assert!(below.abs_diff(heights.len() / 2) <= 1 + done.report.spikes.len());
    }
}

#[test]
fn lines_without_heights_are_edges_and_follow_the_dem() {
    let (rows, cols) = (30, 30);
    let z: Vec<f64> = (0..rows * cols).map(|i| (i % cols) as f64 + 0.5 * (i / cols) as f64).collect();
    let line = vec![[2.25, 3.5, FREE], [20.75, 17.125, FREE]];
    let given = Constraints { lines: vec![line.clone()], ..Constraints::default() };
    let rule = Rule { tolerance: 1e-9, ..MAX };
    let done = run(&z, rows, cols, &with(given, plain(rule, 50))).unwrap();
    let [a, b] = [lattice(line[0]), lattice(line[1])];
    assert!((height_at(&done.surface, a).unwrap() - 4.0).abs() < 1e-12);
    assert!((height_at(&done.surface, b).unwrap() - (20.75 + 0.5 * 17.125)).abs() < 1e-12);
    let mesh = &done.surface.mesh;
    let is_edge =
        (0..mesh.triangles().len() as u32).flat_map(|t| [0, 1, 2].map(|k| half_edge(t, k))).any(|h| {
            mesh.is_constrained(h)
                && !mesh.is_hard(h)
                && mesh.point(mesh.origin(h)) == a
                && mesh.point(mesh.dest(h)) == b
        });
    assert!(is_edge);
    assert_eq!(mesh.points().len(), 6);
}

#[test]
fn crossing_lines_with_heights_meet_half_way() {
    let z = vec![0.0; 100];
    let lines = vec![vec![[1.0, 1.0, 4.0], [8.0, 8.0, 4.0]], vec![[1.0, 8.0, 8.0], [8.0, 1.0, 8.0]]];
    let given = Constraints { lines, ..Constraints::default() };
    let done = run(&z, 10, 10, &with(given, plain(MAX, 9))).unwrap();
    assert_eq!(height_at(&done.surface, lattice([4.5, 4.5, FREE])), Some(6.0));
}

#[test]
fn a_breakline_through_the_outline_loses_no_pixel() {
    // A slanted border, whose chord runs exactly through valid pixels.
    let side = 30;
    let mask = |i: usize| if 2 * (i % side) >= i / side { 1.0 } else { f64::NAN };
    let z: Vec<f64> = (0..side * side).map(mask).collect();
    let random = &mut Random(3);
    for _ in 0..300 {
        let given = Constraints { lines: vec![chain(random, side, false)], ..Constraints::default() };
        let done = run(&z, side, side, &with(given, plain(MAX, 40))).unwrap();
        let grid = Grid::new(&z, side, side).unwrap();
        let (errors, _) = quietly(|p| errors(&done.surface.mesh, &done.surface.z, &grid, p)).unwrap();
        assert_eq!(errors.uncovered, 0);
    }
}

#[test]
fn a_clip_polygon_beside_the_data_is_an_error() {
    let far = vec![vec![[100.0, 100.0, FREE], [120.0, 100.0, FREE], [110.0, 130.0, FREE]]];
    let given = Constraints { clip: Some(vec![far]), ..Constraints::default() };
    let failed = run(&[0.0; 100], 10, 10, &with(given, plain(MAX, 9)));
    assert!(matches!(failed, Err(Error::Input { code: "clip-outside", .. })));
}

#[test]
fn pixels_beside_a_hard_line_make_no_cliffs_along_it() {
    let (rows, cols) = (30, 20);
    let z = hills(rows, cols, 2);
    let beside = 5.0 + 1.0 / f64::from(UNIT);
    let line = vec![[beside, 3.0, 500.0], [beside, 26.0, 500.0]];
    let given = Constraints { lines: vec![line], ..Constraints::default() };
    let done = run(&z, rows, cols, &with(given, plain(MAX, 500))).unwrap();
    let near: Vec<_> = done.surface.mesh.points().iter().filter_map(|p| p.as_pixel()).collect();
    assert!(near.iter().any(|&(col, row)| col == 6 && (4..26).contains(&row)));
    assert!(!near.iter().any(|&(col, row)| col == 5 && (3..=26).contains(&row)));
}

#[test]
fn vertices_that_hardly_any_pixel_sees_are_fitted_sanely() {
    let mut z = vec![0.0; 36];
    (0..6).for_each(|i| z[7 * i] = 1.0);
    let line = vec![[0.9, 3.0, FREE], [1.0, 0.2, FREE]];
    let given = Constraints { lines: vec![line], ..Constraints::default() };
    for options in [plain(MAX, 11), full(AUTO, 11)] {
        let done = run(&z, 6, 6, &with(given.clone(), Options { fit: true, ..options })).unwrap();
        assert!(done.surface.z.iter().all(|z| z.is_nan() || z.abs() < 5.0), "{:?}", done.surface.z);
    }
}

#[test]
fn a_point_on_a_covered_void_has_a_height() {
    let mut z = vec![1.0; 30];
    z[3 * 6 + 3] = f64::NAN;
    let shape = Shape { sieve: 2, ..Shape::default() };
    let constraints = Constraints { pixels: vec![(3, 3)], ..Constraints::default() };
    for options in [plain(MAX, 9), full(AUTO, 9)] {
        let done = run(&z, 5, 6, &Options { shape, constraints: constraints.clone(), ..options }).unwrap();
        assert!(done.surface.z.iter().all(|z| (z - 1.0).abs() < 1e-9));
        assert!(done.surface.mesh.points().contains(&Point::pixel(3, 3)));
    }
}

#[test]
fn what_rounds_into_the_raster_is_inside() {
    let given = Constraints {
        points: vec![[-1e-9, 4.0, 7.0], [9.0 + 1e-9, 5.0, 8.0]],
        lines: vec![vec![[2.0, -1e-9, 3.0], [6.0, 9.0 + 1e-9, 5.0]]],
        ..Constraints::default()
    };
    let done = run(&[0.0; 100], 10, 10, &with(given, plain(MAX, 9))).unwrap();
    for (vertex, z) in [([0.0, 4.0], 7.0), ([9.0, 5.0], 8.0), ([2.0, 0.0], 3.0), ([6.0, 9.0], 5.0)] {
        assert_eq!(height_at(&done.surface, lattice([vertex[0], vertex[1], FREE])), Some(z));
    }
}

#[test]
fn a_share_of_the_points_goes_with_the_share_of_the_raster_inside_the_clip_polygons() {
    let side = 41;
    let z = hills(side, side, 4);
    let quarter = vec![vec![[0.0, 0.0, FREE], [20.0, 0.0, FREE], [20.0, 20.0, FREE], [0.0, 20.0, FREE]]];
    let given = Constraints { clip: Some(vec![quarter]), ..Constraints::default() };
    let points = |is_share: bool| {
        let options = Options { is_share, ..plain(MAX, 400) };
        let done = run(&z, side, side, &with(given.clone(), options)).unwrap();
        done.surface.z.iter().filter(|z| !z.is_nan()).count()
    };
    assert_eq!(points(false), 400);
    assert_eq!(points(true), (400.0 * (21.0 * 21.0) / (41.0 * 41.0_f64)).round() as usize);
}

#[test]
fn a_raster_that_lies_on_hard_lines_as_a_whole_still_has_heights() {
    let z = [1.0, 2.0, 3.0, 4.0];
    let cross = |a: f64, b: f64| vec![[0.0, a, 7.0], [1.0, b, 7.0]];
    let given = Constraints {
        lines: vec![cross(0.0, 0.0), cross(1.0, 1.0)],
        pixels: vec![(0, 1)],
        ..Constraints::default()
    };
    let soft = vec![[0.2, 0.3, FREE], [0.8, 0.6, FREE]];
    let given = Constraints { lines: [given.lines, vec![soft]].concat(), pixels: given.pixels, ..given };
    for options in [plain(MAX, 20), full(AUTO, 20)] {
        let done = run(&z, 2, 2, &with(given.clone(), options)).unwrap();
        assert!(done.surface.z.iter().all(|z| z.is_finite()));
    }
}

#[test]
fn constraints_higher_than_any_terrain_are_refused() {
    let given = Constraints { points: vec![[1.0, 1.0, 1e200]], ..Constraints::default() };
    let failed = run(&[0.0; 16], 4, 4, &with(given, plain(MAX, 9)));
    assert!(matches!(failed, Err(Error::Input { code: "height-range", .. })));
}
