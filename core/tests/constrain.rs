//! Segments become edges of the mesh and stay edges.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod common;

use common::{assert_sound, form, sorted, triangle_set, Random, FORMS};
use dem2tin_core::constrain::Constrainer;
use dem2tin_core::label::Label;
use dem2tin_core::mesh::{half_edge, Mesh};
use dem2tin_core::predicate::{orient2d, Metric, Point, UNIT};
use proptest::prelude::*;
use spade::{ConstrainedDelaunayTriangulation, Point2, Triangulation};
use std::collections::{BTreeMap, BTreeSet};

type Edge = (Point, Point);

fn edge(a: Point, b: Point) -> Edge {
    (a.min(b), a.max(b))
}

/// A mesh with up to `n` vertices at multiples of `unit`.
fn mesh_of(side: usize, unit: i32, n: usize, which: usize, random: &mut Random) -> Mesh {
    let (a, b, c) = FORMS[which];
    let mut mesh = Mesh::rectangle(side, side, form(a, b, c));
    let steps = ((side as i32 - 1) * UNIT / unit + 1) as usize;
    for _ in 0..n {
        let p = Point { x: random.below(steps) as i32 * unit, y: random.below(steps) as i32 * unit };
        mesh.insert(p, 0);
    }
    mesh
}

fn constrained_edges(mesh: &Mesh) -> BTreeSet<Edge> {
    let mut edges = BTreeSet::new();
    for t in 0..mesh.triangles().len() as u32 {
        for h in (0..3).map(|k| half_edge(t, k)).filter(|&h| mesh.is_constrained(h)) {
            edges.insert(edge(mesh.point(mesh.origin(h)), mesh.point(mesh.dest(h))));
        }
    }
    edges
}

fn crosses((a, b): Edge, (c, d): Edge) -> bool {
    let apart = |a, b, c, d| orient2d(a, b, c).signum() * orient2d(a, b, d).signum() < 0;
    apart(a, b, c, d) && apart(c, d, a, b)
}

/// Where a point at `t` in (0, 1) of the segment is, if it is on the lattice.
fn on_segment((a, b): Edge, t: f64) -> Option<Point> {
    let along = |a: i32, b: i32| a + (f64::from(b - a) * t).round() as i32;
    let p = Point { x: along(a.x, b.x), y: along(a.y, b.y) };
    (orient2d(a, b, p) == 0 && p != a && p != b).then_some(p)
}

/// Inserts one segment, which the mesh keeps.
fn constrain(mesh: &mut Mesh, a: u32, b: u32) {
    let free = vec![f64::NAN; mesh.points().len()];
    Constrainer::new(mesh, free).insert(a, b, Label::border(0));
}

/// Inserts `n` random segments; every one must have become a path of edges next
/// to it.
fn constrain_at_random(mesh: &mut Mesh, n: usize, random: &mut Random) -> BTreeSet<Edge> {
    let ends: Vec<(u32, u32)> = (0..n)
        .map(|_| (random.below(mesh.points().len()) as u32, random.below(mesh.points().len()) as u32))
        .collect();
    let free = vec![f64::NAN; mesh.points().len()];
    let mut constrainer = Constrainer::new(mesh, free);
    for (i, &(a, b)) in ends.iter().enumerate() {
        constrainer.insert(a, b, Label::border(i as u32 + 1));
    }
    let (labels, fixed) = constrainer.finish();
    assert_eq!(fixed.len(), mesh.points().len());
    mesh.make_delaunay();
    let segments: Vec<Edge> = ends.iter().map(|&(a, b)| (mesh.point(a), mesh.point(b))).collect();
    let mut balance: BTreeMap<(u32, u32), i32> = BTreeMap::new();
    for h in (0..mesh.triangles().len() as u32).flat_map(|t| [0, 1, 2].map(|k| half_edge(t, k))) {
        let (from, to, twin) = (mesh.origin(h), mesh.dest(h), mesh.twin(h));
        let label = labels.get(from, to);
        assert_eq!(label.is_some(), mesh.is_constrained(h));
        for (i, count) in label.filter(|_| h < twin).into_iter().flat_map(|label| label.winding) {
            *balance.entry((i, from)).or_default() += count;
            *balance.entry((i, to)).or_default() -= count;
            let (a, b) = segments[i as usize - 1];
            for p in [from, to].map(|v| mesh.point(v)) {
                let length = f64::from(b.x - a.x).hypot(f64::from(b.y - a.y));
                let apart = (orient2d(a, b, p) as f64 / length).abs();
                assert!(apart <= 6.0, "{apart}");
            }
        }
    }
    for (i, &(a, b)) in ends.iter().enumerate().filter(|(_, (a, b))| a != b) {
        *balance.entry((i as u32 + 1, a)).or_default() -= 1;
        *balance.entry((i as u32 + 1, b)).or_default() += 1;
    }
    assert!(balance.values().all(|&count| count == 0));
    constrained_edges(mesh)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(10_000))]

    #[test]
    fn segments_become_paths_and_meet_where_they_cross(
        side in 2usize..12, on_pixels: bool, n in 0usize..60, segments in 1usize..12, which in 0..FORMS.len(), seed: u64,
    ) {
        let random = &mut Random(seed);
        let mut mesh = mesh_of(side, if on_pixels { UNIT } else { 1 }, n, which, random);
        let kept: Vec<Edge> = constrain_at_random(&mut mesh, segments, random).into_iter().collect();
        for (i, &a) in kept.iter().enumerate() {
            prop_assert!(!kept[i + 1..].iter().any(|&b| crosses(a, b)));
        }
        assert_sound(&mesh, true);
    }

    #[test]
    fn constraints_outlive_insertions_and_split_at_points_on_them(
        side in 3usize..12, on_pixels: bool, n in 0usize..30, segments in 1usize..8, which in 0..FORMS.len(), seed: u64,
    ) {
        let random = &mut Random(seed);
        let unit = if on_pixels { UNIT } else { 1 };
        let mut mesh = mesh_of(side, unit, n, which, random);
        let kept = constrain_at_random(&mut mesh, segments, random);
        for &segment in &kept {
            if let Some(p) = on_segment(segment, [0.25, 0.5, 0.75][random.below(3)]) {
                mesh.insert(p, random.below(mesh.triangles().len()) as u32);
            }
        }
        let last = (side as i32 - 1) * UNIT / unit + 1;
        for _ in 0..20 {
            let mut along = || random.below(last as usize) as i32 * unit;
            mesh.insert(Point { x: along(), y: along() }, 0);
        }
        let mut expected = BTreeSet::new();
        for &(a, b) in &kept {
            let within = |p: &&Point| orient2d(a, b, **p) == 0 && **p >= a && **p <= b;
            let mut stops: Vec<Point> = mesh.points().iter().filter(within).copied().collect();
            stops.sort_unstable();
            expected.extend(stops.windows(2).map(|s| edge(s[0], s[1])));
        }
        prop_assert_eq!(constrained_edges(&mesh), expected);
        assert_sound(&mesh, true);
    }

    #[test]
    fn general_position_gives_the_constrained_triangles_of_spade(n in 2usize..60, segments in 1usize..10, seed: u64) {
        let random = &mut Random(seed);
        let mut mesh = mesh_of(800, 1, n, 0, random);
        let ground = |p: Point| Point2::new(f64::from(p.x), f64::from(p.y));
        let mut oracle = ConstrainedDelaunayTriangulation::<Point2<f64>>::new();
        let handles: Vec<_> = mesh.points().iter().map(|&p| oracle.insert(ground(p)).unwrap()).collect();
        for _ in 0..segments {
            let (a, b) = (random.below(handles.len()), random.below(handles.len()));
            // A segment that passes a vertex very closely would take it in.
            let passes = |&p: &Point| {
                let [pa, pb] = [mesh.point(a as u32), mesh.point(b as u32)];
                let length = f64::from(pb.x - pa.x).hypot(f64::from(pb.y - pa.y));
                p != pa && p != pb && (orient2d(pa, pb, p) as f64).abs() < 2.0 * length
            };
            if a != b && !mesh.points().iter().any(passes) && oracle.can_add_constraint(handles[a], handles[b]) {
                oracle.add_constraint(handles[a], handles[b]);
                constrain(&mut mesh, a as u32, b as u32);
            }
        }
        let lattice = |p: Point2<f64>| Point { x: p.x as i32, y: p.y as i32 };
        let theirs: BTreeSet<_> =
            oracle.inner_faces().map(|f| sorted(f.vertices().map(|v| lattice(v.position())))).collect();
        prop_assert_eq!(triangle_set(&mesh), theirs);
    }
}

/// A full grid, where every cell is a tie, and segments across all of it.
#[test]
fn long_segments_through_a_full_grid_are_recovered() {
    let random = &mut Random(11);
    for side in 2..24 {
        let mut mesh = Mesh::rectangle(side, side, Metric::SQUARE);
        for i in 0..side * side {
            mesh.insert(Point::pixel(i % side, i / side), 0);
        }
        let kept = constrain_at_random(&mut mesh, 30, random);
        assert_eq!(constrained_edges(&mesh), kept);
        assert_sound(&mesh, true);
    }
}

/// Many crossed edges whose quadrilaterals are mostly not convex.
#[test]
fn a_segment_between_two_jagged_shores_is_recovered() {
    for n in [10i32, 300, 1000] {
        let mut mesh = Mesh::rectangle(n as usize + 1, 9, Metric::SQUARE);
        let random = &mut Random(3);
        let middle = 4 * UNIT;
        for x in 1..n {
            for side in [-1, 1] {
                let y = middle + side * (1 + random.below(UNIT as usize) as i32);
                mesh.insert(Point { x: x * UNIT, y }, 0);
            }
        }
        let a = mesh.insert(Point { x: 0, y: middle }, 0);
        let b = mesh.insert(Point { x: n * UNIT, y: middle }, 0);
        constrain(&mut mesh, a, b);
        assert_eq!(constrained_edges(&mesh), BTreeSet::from([edge(mesh.point(a), mesh.point(b))]));
        assert_sound(&mesh, true);
    }
}

#[test]
fn a_segment_from_a_vertex_to_itself_changes_nothing() {
    let mut mesh = Mesh::rectangle(5, 5, Metric::SQUARE);
    let before = triangle_set(&mesh);
    constrain(&mut mesh, 2, 2);
    assert_eq!(triangle_set(&mesh), before);
    assert!(constrained_edges(&mesh).is_empty());
}

#[test]
fn edges_are_found_in_both_directions_and_on_the_border() {
    let random = &mut Random(8);
    let mut mesh = mesh_of(9, UNIT, 30, 0, random);
    let mut edges = BTreeSet::new();
    for t in 0..mesh.triangles().len() as u32 {
        let [a, b, c] = mesh.triangle(t).v;
        edges.extend([(a, b), (b, c), (c, a), (b, a), (c, b), (a, c)]);
    }
    let n = mesh.points().len() as u32;
    let constrainer = Constrainer::new(&mut mesh, vec![f64::NAN; n as usize]);
    for (a, b) in (0..n).flat_map(|a| (0..n).map(move |b| (a, b))) {
        assert_eq!(constrainer.find_edge(a, b).is_some(), edges.contains(&(a, b)));
    }
}
