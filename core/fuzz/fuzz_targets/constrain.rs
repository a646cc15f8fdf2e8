//! Segments between any vertices.
#![no_main]

use arbitrary::{Arbitrary, Result, Unstructured};
use dem2tin_core::constrain::Constrainer;
use dem2tin_core::mesh::Mesh;
use dem2tin_core::predicate::{Metric, Point};
use dem2tin_core_fuzz::{assert_sound, metric, point};
use libfuzzer_sys::fuzz_target;

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
    let mut parts = Vec::new();
    let mut constrainer = Constrainer::new(&mut mesh);
    for &(a, b) in &input.segments {
        let (a, b) = (u32::from(a) % vertices, u32::from(b) % vertices);
        // A segment that crosses another one is refused half-way; what it left is still sound.
        let _ = constrainer.insert(a, b, |from, to| parts.push((from, to)));
    }
    assert_sound(&mesh, true);
    let constrainer = Constrainer::new(&mut mesh);
    let edges: Vec<_> = parts.iter().map(|&(from, to)| constrainer.find_edge(from, to)).collect();
    assert!(edges.into_iter().all(|h| h.is_some_and(|h| mesh.is_constrained(h))), "a part is no edge");
});
