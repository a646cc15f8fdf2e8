//! The outline mesh covers the data, all of it and nothing else.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod common;

use common::{assert_sound, form, outlined, quietly, Random, FORMS};
use dem2tin_core::error::Error;
use dem2tin_core::grid::Grid;
use dem2tin_core::measure::rasterise;
use dem2tin_core::predicate::{orient2d, Metric, Point, UNIT};
use dem2tin_core::triangle::Location;
use proptest::prelude::*;

/// A mask by characters: '#' valid, anything else void.
fn drawn(rows: &[&str]) -> (Vec<f32>, usize, usize) {
    let valid = |c: char| if c == '#' { 0.0 } else { f32::NAN };
    (rows.iter().flat_map(|row| row.chars().map(valid)).collect(), rows.len(), rows[0].len())
}

type Mask = Box<dyn Fn(usize, usize) -> bool>;

fn masked(rows: usize, cols: usize, mut valid: impl FnMut(usize, usize) -> bool) -> Vec<f32> {
    let height = |i| if valid(i % cols, i / cols) { 0.0 } else { f32::NAN };
    (0..rows * cols).map(height).collect()
}

/// The pixels of the cell complex and a few places inside each of its cells.
fn complex(z: &[f32], rows: usize, cols: usize) -> (Vec<bool>, Vec<Point>) {
    let (mut covered, mut inside) = (vec![false; z.len()], Vec::new());
    for (row, col) in (0..rows - 1).flat_map(|row| (0..cols - 1).map(move |col| (row, col))) {
        let corners = [(0, 0), (1, 0), (1, 1), (0, 1)];
        let index = |(dx, dy): (usize, usize)| (row + dy) * cols + col + dx;
        let void: Vec<_> = corners.into_iter().filter(|&c| z[index(c)].is_nan()).collect();
        let at = |x, y| Point { x: col as i32 * UNIT + x, y: row as i32 * UNIT + y };
        match void[..] {
            [] => inside.extend([at(128, 51), at(205, 128), at(128, 205), at(51, 128)]),
            [(x, y)] => inside.push(at(192 - 128 * x as i32, 192 - 128 * y as i32)),
            _ => continue,
        }
        corners.into_iter().filter(|c| !void.contains(c)).for_each(|c| covered[index(c)] = true);
    }
    (covered, inside)
}

/// Sound, without a void pixel, with the whole cell complex, and no data
/// triangle that hangs on a pixel outside it.
fn assert_outlined(z: &[f32], rows: usize, cols: usize, metric: Metric) {
    let (expected, inside) = complex(z, rows, cols);
    let grid = Grid::new(z, rows, cols).unwrap();
    let mesh = match outlined(&grid, metric) {
        Ok(surface) => surface.mesh,
        Err(error) => {
            assert!(matches!(error, Error::Input { code: "no-area", .. }), "{error:?}");
            return assert!(inside.is_empty());
        }
    };
    assert_sound(&mesh, true);
    let zeros = vec![0.0; mesh.points().len()];
    let surface: Vec<f32> = quietly(|progress| rasterise(&mesh, &zeros, rows, cols, progress)).unwrap();
    for (i, height) in surface.iter().enumerate() {
        let is_covered = !height.is_nan();
        assert!(is_covered || !expected[i], "data lost at {i} of {z:?}");
        assert!(!is_covered || !z[i].is_nan(), "void covered at {i} of {z:?}");
    }
    let mut twice = 0;
    for t in (0..mesh.triangles().len() as u32).filter(|&t| !mesh.triangle(t).is_void()) {
        let [a, b, c] = mesh.corners(t);
        twice += orient2d(a, b, c);
        for v in [a, b, c] {
            let (col, row) = v.as_pixel().unwrap();
            assert!(expected[row * cols + col], "a corner outside the data: {z:?}");
        }
    }
    let is_data = |t: u32| !mesh.triangle(t).is_void();
    for p in &inside {
        let found = match mesh.locate(*p, 0) {
            Location::Face(t) => is_data(t),
            Location::Edge(h) => is_data(h >> 2) && is_data(mesh.twin(h) >> 2),
            Location::Vertex(_) => false,
        };
        assert!(found, "a cell is lost at {p:?} of {z:?}");
    }
    assert!(twice >= complex_area(z, rows, cols) * i64::from(UNIT) * i64::from(UNIT));
}

/// Twice the area of the cell complex in pixels.
fn complex_area(z: &[f32], rows: usize, cols: usize) -> i64 {
    let valid = |i: usize| i64::from(!z[i].is_nan());
    let cell = |i: usize| (valid(i) + valid(i + 1) + valid(i + cols) + valid(i + cols + 1) - 2).max(0);
    (0..rows - 1).flat_map(|row| (0..cols - 1).map(move |col| row * cols + col)).map(cell).sum()
}

#[test]
fn all_masks_of_4_by_4() {
    for bits in 0u32..1 << 16 {
        let z = masked(4, 4, |col, row| bits >> (4 * row + col) & 1 != 0);
        assert_outlined(&z, 4, 4, Metric::SQUARE);
    }
}

#[test]
fn all_masks_of_2_by_2_to_3_by_5_in_every_metric() {
    for (a, b, c) in FORMS {
        for (rows, cols) in [(2, 2), (2, 3), (3, 2), (3, 3), (2, 7), (7, 2)] {
            for bits in 0u32..1 << (rows * cols) {
                let z = masked(rows, cols, |col, row| bits >> (cols * row + col) & 1 != 0);
                assert_outlined(&z, rows, cols, form(a, b, c));
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2500))]

    #[test]
    fn random_masks_of_any_density(
        rows in 2usize..=40, cols in 2usize..=40, share in 0.02f64..1.0, which in 0..FORMS.len(), seed: u64,
    ) {
        let mut random = Random(seed);
        let (a, b, c) = FORMS[which];
        assert_outlined(&masked(rows, cols, |_, _| random.unit() < share), rows, cols, form(a, b, c));
    }

    #[test]
    fn random_unions_and_differences_of_discs(rows in 5usize..=40, cols in 5usize..=40, seed: u64) {
        let mut random = Random(seed);
        let discs: Vec<_> = (0..8)
            .map(|_| (random.below(cols) as f64, random.below(rows) as f64, 10.0 * random.unit(), random.below(3) > 0))
            .collect();
        let within = |col: usize, row: usize| {
            let inside = |d: &&(f64, f64, f64, bool)| (col as f64 - d.0).hypot(row as f64 - d.1) <= d.2;
            discs.iter().rfind(inside).is_some_and(|d| d.3)
        };
        assert_outlined(&masked(rows, cols, within), rows, cols, Metric::SQUARE);
    }
}

#[test]
fn patterns_that_broke_other_outlines() {
    let n = 33;
    let centre = |col: usize, row: usize| (col as f64 - 16.0).hypot(row as f64 - 16.0);
    let masks: [(&str, Mask); 10] = [
        ("checkerboard", Box::new(|c, r| (c + r) % 2 == 0)),
        ("coarse checkerboard", Box::new(|c, r| (c / 2 + r / 2) % 2 == 0)),
        ("checkerboard of 3", Box::new(|c, r| (c / 3 + r / 3) % 2 == 0)),
        ("ring", Box::new(move |c, r| (9.0..13.0).contains(&centre(c, r)))),
        ("thin rings", Box::new(move |c, r| !(centre(c, r) as usize).is_multiple_of(3))),
        ("voids at all corners", Box::new(move |c, r| centre(c, r) < 17.0)),
        ("holes that touch", Box::new(|c, r| c % 2 == 0 || (c / 2 + r) % 2 == 0)),
        ("comb", Box::new(|c, r| r < 3 || c % 3 != 2)),
        ("diagonal stripes", Box::new(|c, r| (c + r) % 4 < 2)),
        ("one hole a cell", Box::new(|c, r| c % 2 == 1 || r % 2 == 1)),
    ];
    for (name, mask) in &masks {
        println!("{name}");
        for (a, b, c) in FORMS {
            assert_outlined(&masked(n, n, mask), n, n, form(a, b, c));
        }
    }
}

#[test]
fn diagonal_contact_islands_and_lines() {
    let masks: [&[&str]; 6] = [
        &["##...", "##...", "..##.", "..##.", "....#"],
        &["###..", "###..", "###..", "..###", "..###", "..###"],
        &["#####", "#.#.#", "#####", "#.#.#", "#####"],
        &["#####", "#...#", "#.#.#", "#...#", "#####"],
        &["....#", "....#", "##..#", "##..#", "....#"],
        &["######", "##..##", "#.##.#", "#.##.#", "##..##", "######"],
    ];
    for mask in masks {
        let (z, rows, cols) = drawn(mask);
        for (a, b, c) in FORMS {
            assert_outlined(&z, rows, cols, form(a, b, c));
        }
    }
}

#[test]
fn straight_borders_need_no_points_between_their_ends() {
    let z = masked(30, 50, |col, row| (10..40).contains(&col) && (5..=20).contains(&row));
    let grid = Grid::new(&z, 30, 50).unwrap();
    assert_eq!(outlined(&grid, Metric::SQUARE).unwrap().mesh.points().len(), 4 + 4);
    let z = masked(20, 20, |col, row| col >= row);
    let grid = Grid::new(&z, 20, 20).unwrap();
    assert_eq!(outlined(&grid, Metric::SQUARE).unwrap().mesh.points().len(), 4);
}

#[test]
fn a_raster_without_voids_is_a_rectangle() {
    for (rows, cols) in [(2, 2), (2, 1000), (1000, 2), (300, 200)] {
        let z = vec![0.0f32; rows * cols];
        let mesh = outlined(&Grid::new(&z, rows, cols).unwrap(), Metric::SQUARE).unwrap().mesh;
        assert_eq!((mesh.points().len(), mesh.triangles().len()), (4, 2));
    }
}
