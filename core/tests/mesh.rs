//! Insertion into the mesh keeps it a Delaunay triangulation.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod common;

use common::{assert_sound, contains, form, sorted, triangle_set, Random, FORMS};
use dem2tin_core::mesh::Mesh;
use dem2tin_core::predicate::{Metric, Point, UNIT};
use dem2tin_core::triangle::Location;
use proptest::prelude::*;
use spade::{DelaunayTriangulation, Point2, Triangulation};
use std::collections::{BTreeSet, HashMap};

fn insert(mesh: &mut Mesh, p: Point) -> u32 {
    mesh.insert(p, mesh.triangles().len() as u32 - 1)
}

/// Inserts all, expecting one vertex a place whatever the repetitions.
fn insert_all(mesh: &mut Mesh, points: &[Point]) {
    let mut places: HashMap<Point, u32> = mesh.points().iter().copied().zip(0..).collect();
    for &p in points {
        let new = mesh.points().len() as u32;
        let v = insert(mesh, p);
        assert_eq!(v, *places.entry(p).or_insert(new));
        assert_eq!(mesh.point(v), p);
    }
    assert_eq!(mesh.points().len(), places.len());
}

/// Points of a `cols` x `rows` raster; `unit` 1 uses sub-pixel places, `UNIT` pixels only.
fn points_in(cols: usize, rows: usize, unit: i32, n: usize, seed: u64) -> Vec<Point> {
    let mut random = Random(seed);
    let mut along = |side: usize| {
        let last = (side as i32 - 1) * UNIT;
        // Every sixth coordinate is on the border.
        match random.below(12) {
            0 => 0,
            1 => last,
            _ => random.below((last / unit + 1) as usize) as i32 * unit,
        }
    };
    (0..n).map(|_| Point { x: along(cols), y: along(rows) }).collect()
}

fn spade_triangles(points: &[Point], (a, b, c): (i64, i64, i64)) -> BTreeSet<[Point; 3]> {
    let ground = |p: Point| {
        let (x, y) = (i64::from(p.x), i64::from(p.y));
        ((a * x + b * y) as f64, (c * y) as f64)
    };
    let lattice: HashMap<(u64, u64), Point> = points
        .iter()
        .map(|&p| {
            let (x, y) = ground(p);
            ((x.to_bits(), y.to_bits()), p)
        })
        .collect();
    let mut oracle = DelaunayTriangulation::<Point2<f64>>::new();
    for &p in points {
        let (x, y) = ground(p);
        oracle.insert(Point2::new(x, y)).unwrap();
    }
    let place = |p: Point2<f64>| lattice[&(p.x.to_bits(), p.y.to_bits())];
    oracle.inner_faces().map(|face| sorted(face.vertices().map(|v| place(v.position())))).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(10_000))]

    #[test]
    fn random_insertions_leave_a_sound_delaunay_mesh(
        cols in 2usize..30, rows in 2usize..30, n in 0usize..80, on_pixels: bool, which in 0..FORMS.len(), seed: u64,
    ) {
        let (a, b, c) = FORMS[which];
        let mut mesh = Mesh::rectangle(cols, rows, form(a, b, c));
        insert_all(&mut mesh, &points_in(cols, rows, if on_pixels { UNIT } else { 1 }, n, seed));
        assert_sound(&mesh, true);
    }

    #[test]
    fn general_position_gives_the_triangles_of_spade(n in 1usize..80, which in 0..FORMS.len(), seed: u64) {
        let (a, b, c) = FORMS[which];
        let mut mesh = Mesh::rectangle(700, 500, form(a, b, c));
        insert_all(&mut mesh, &points_in(700, 500, 1, n, seed));
        prop_assert_eq!(triangle_set(&mesh), spade_triangles(mesh.points(), FORMS[which]));
    }

    #[test]
    fn the_order_of_insertion_does_not_matter_in_general_position(n in 1usize..60, seed: u64) {
        let mut points = points_in(900, 900, 1, n, seed);
        let mut forth = Mesh::rectangle(900, 900, Metric::SQUARE);
        insert_all(&mut forth, &points);
        points.reverse();
        let mut back = Mesh::rectangle(900, 900, Metric::SQUARE);
        insert_all(&mut back, &points);
        prop_assert_eq!(triangle_set(&forth), triangle_set(&back));
    }

    #[test]
    fn locate_finds_the_face_edge_or_vertex_from_any_start(n in 0usize..40, on_pixels: bool, seed: u64) {
        let mut mesh = Mesh::rectangle(12, 9, Metric::SQUARE);
        insert_all(&mut mesh, &points_in(12, 9, UNIT, n, seed));
        let mut random = Random(seed);
        for p in points_in(12, 9, if on_pixels { UNIT } else { 1 }, 10, !seed) {
            let start = random.below(mesh.triangles().len()) as u32;
            let around = (0..mesh.triangles().len() as u32).filter(|&t| contains(mesh.corners(t), p)).count();
            match mesh.locate(p, start) {
                Location::Vertex(v) => prop_assert_eq!(mesh.point(v), p),
                Location::Edge(h) => {
                    prop_assert!(contains(mesh.corners(h >> 2), p));
                    prop_assert!(!mesh.points().contains(&p));
                    let inside = mesh.twin(h) != dem2tin_core::mesh::NONE;
                    prop_assert_eq!(around, 1 + usize::from(inside));
                }
                Location::Face(t) => {
                    prop_assert!(contains(mesh.corners(t), p));
                    prop_assert_eq!(around, 1);
                }
            }
        }
    }

    #[test]
    fn what_an_insertion_changes_lies_around_the_vertex(n in 1usize..30, seed: u64) {
        let mut mesh = Mesh::rectangle(9, 9, Metric::SQUARE);
        for p in points_in(9, 9, UNIT, n, seed) {
            let before: Vec<_> = mesh.triangles().iter().map(|t| (t.v, t.version)).collect();
            let place = mesh.locate(p, 0);
            let v = mesh.insert_at(p, place);
            if v as usize + 1 < mesh.points().len() || before.len() == mesh.triangles().len() { continue; }
            let start = mesh.leaving(place.triangle(), v);
            prop_assert_eq!(mesh.origin(start), v);
            let mut around: Vec<_> = mesh.fan(start).map(dem2tin_core::mesh::triangle_of).collect();
            around.sort_unstable();
            let changed: Vec<_> = (0u32..).zip(mesh.triangles()).filter(|&(t, triangle)| before.get(t as usize).is_none_or(|b| b.0 != triangle.v)).collect();
            prop_assert_eq!(&around, &changed.iter().map(|c| c.0).collect::<Vec<_>>());
            for (t, triangle) in changed {
                prop_assert!(before.get(t as usize).is_none_or(|b| b.1 != triangle.version));
            }
        }
    }
}

#[test]
fn every_pixel_of_a_grid_gives_two_triangles_a_cell_in_any_order() {
    for (seed, &(a, b, c)) in (0..).zip(FORMS.iter().cycle().take(40)) {
        let (cols, rows) = (2 + seed as usize % 11, 2 + seed as usize % 7);
        let mut mesh = Mesh::rectangle(cols, rows, form(a, b, c));
        let mut points: Vec<_> = (0..cols * rows).map(|i| Point::pixel(i % cols, i / cols)).collect();
        let mut random = Random(seed);
        for i in (1..points.len()).rev() {
            points.swap(i, random.below(i + 1));
        }
        insert_all(&mut mesh, &points);
        assert_sound(&mesh, true);
        assert_eq!(mesh.triangles().len(), 2 * (cols - 1) * (rows - 1));
    }
}

#[test]
fn points_on_one_line_give_a_sound_mesh() {
    let n = 40;
    let lines: [fn(usize) -> (usize, usize); 5] =
        [|i| (i, i), |i| (i, 0), |i| (39, i), |i| (i, 20), |i| (i, 39 - i)];
    for (a, b, c) in FORMS {
        for line in lines {
            let mut mesh = Mesh::rectangle(n, n, form(a, b, c));
            let points: Vec<_> = (0..n).map(|i| line(i * 7 % n)).map(|(x, y)| Point::pixel(x, y)).collect();
            insert_all(&mut mesh, &points);
            assert_sound(&mesh, true);
        }
    }
}

#[test]
fn narrow_and_huge_rasters_stay_exact() {
    for (cols, rows) in [(2, 1000), (1000, 2), (1 << 20, 2), (2, 1 << 20), (1 << 20, 1 << 20)] {
        for (e, f, g) in [(1.0, 0.0, 1.0), (1.0, 0.0, 1e-6), (1.0, 0.6, 0.5)] {
            let metric = Metric::from_form(e, f, g, cols.max(rows)).unwrap();
            let mut mesh = Mesh::rectangle(cols, rows, metric);
            insert_all(&mut mesh, &points_in(cols, rows, UNIT, 300, 5));
            assert_sound(&mesh, true);
        }
    }
}
