//! Points anywhere, also on edges, into a mesh some of whose edges are constrained.
#![no_main]

use arbitrary::{Arbitrary, Result, Unstructured};
use dem2tin_core::mesh::{half_edge, Mesh};
use dem2tin_core::predicate::{Metric, Point};
use dem2tin_core_fuzz::{assert_sound, metric, point};
use libfuzzer_sys::fuzz_target;

#[derive(Debug)]
enum Step {
    /// A point, and where to start to look for its place.
    Insert(Point, u16),
    /// The middle of an edge, where that is a lattice point.
    Split(u16),
    Constrain(u16),
}

#[derive(Debug)]
struct Input {
    cols: usize,
    rows: usize,
    metric: Metric,
    steps: Vec<Step>,
}

impl<'a> Arbitrary<'a> for Input {
    fn arbitrary(u: &mut Unstructured<'a>) -> Result<Self> {
        let (cols, rows, metric) = (u.int_in_range(2..=40)?, u.int_in_range(2..=40)?, metric(u)?);
        let mut steps = Vec::new();
        while !u.is_empty() {
            steps.push(match u.int_in_range(0..=3)? {
                0 => Step::Split(u.arbitrary()?),
                1 => Step::Constrain(u.arbitrary()?),
                _ => Step::Insert(point(u, cols, rows)?, u.arbitrary()?),
            });
        }
        Ok(Input { cols, rows, metric, steps })
    }
}

fuzz_target!(|input: Input| {
    let mut mesh = Mesh::rectangle(input.cols, input.rows, input.metric);
    for step in &input.steps {
        let edge = |i: u16| {
            let i = u32::from(i) % (3 * mesh.triangles().len() as u32);
            half_edge(i / 3, i % 3)
        };
        let (p, start) = match *step {
            Step::Insert(p, start) => (p, u32::from(start) % mesh.triangles().len() as u32),
            Step::Split(i) => {
                let h = edge(i);
                let (a, b) = (mesh.point(mesh.origin(h)), mesh.point(mesh.dest(h)));
                if (a.x + b.x) % 2 != 0 || (a.y + b.y) % 2 != 0 {
                    continue;
                }
                (Point { x: (a.x + b.x) / 2, y: (a.y + b.y) / 2 }, 0)
            }
            Step::Constrain(i) => {
                mesh.constrain(edge(i));
                continue;
            }
        };
        let there = mesh.points().iter().position(|&q| q == p);
        let vertex = mesh.insert(p, start) as usize;
        assert_eq!(mesh.points()[vertex], p);
        assert_eq!(vertex, there.unwrap_or(mesh.points().len() - 1));
    }
    assert_sound(&mesh, true);
});
