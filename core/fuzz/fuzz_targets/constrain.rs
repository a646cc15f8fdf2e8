//! Segments between any vertices.
#![no_main]

use arbitrary::{Arbitrary, Result, Unstructured};
use dem2tin_core::constrain::Constrainer;
use dem2tin_core::label::Label;
use dem2tin_core::mesh::{half_edge, Mesh};
use dem2tin_core::predicate::{Metric, Point};
use dem2tin_core_fuzz::{assert_sound, metric, point};
use libfuzzer_sys::fuzz_target;
use std::collections::HashMap;

#[derive(Debug)]
struct Input {
    side: usize,
    metric: Metric,
    points: Vec<Point>,
    segments: Vec<(u8, u8)>,
}

impl<'a> Arbitrary<'a> for Input {
    fn arbitrary(u: &mut Unstructured<'a>) -> Result<Self> {
        let (side, metric) = (u.int_in_range(2..=20)?, metric(u)?);
        let count = u.int_in_range(0..=60)?;
        let points = (0..count).map(|_| point(u, side, side)).collect::<Result<_>>()?;
        Ok(Input { side, metric, points, segments: u.arbitrary()? })
    }
}

fuzz_target!(|input: Input| {
    let mut mesh = Mesh::rectangle(input.side, input.side, input.metric);
    for &p in &input.points {
        mesh.insert(p, 0);
    }
    let vertices = mesh.points().len() as u32;
    let free = vec![f64::NAN; vertices as usize];
    let mut constrainer = Constrainer::new(&mut mesh, free);
    let ends = input.segments.iter().map(|&(a, b)| (u32::from(a) % vertices, u32::from(b) % vertices));
    let ends: Vec<(u32, u32)> = ends.collect();
    for (region, &(a, b)) in (0..).zip(&ends) {
        constrainer.insert(a, b, Label::border(region));
    }
    let (labels, _) = constrainer.finish();
    mesh.make_delaunay();
    assert_sound(&mesh, true);
    // What leaves and enters each vertex along the path of a segment must cancel out.
    let mut balance: HashMap<(u32, u32), i32> = HashMap::new();
    for h in (0..mesh.triangles().len() as u32).flat_map(|t| [0, 1, 2].map(|k| half_edge(t, k))) {
        let (from, to) = (mesh.origin(h), mesh.dest(h));
        let label = labels.get(from, to);
        assert_eq!(label.is_some(), mesh.is_constrained(h));
        for (region, count) in label.filter(|_| h < mesh.twin(h)).into_iter().flat_map(|label| label.winding)
        {
            *balance.entry((region, from)).or_default() += count;
            *balance.entry((region, to)).or_default() -= count;
        }
    }
    for (region, &(a, b)) in (0..).zip(&ends) {
        *balance.entry((region, a)).or_default() -= 1;
        *balance.entry((region, b)).or_default() += 1;
    }
    assert!(balance.values().all(|&count| count == 0), "a segment is no path");
});
