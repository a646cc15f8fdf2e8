//! Segments as edges of the mesh: recovered by flips (Sloan 1993), then kept.

use crate::mesh::{half_edge, next, prev, triangle_of, Mesh, NONE};
use crate::predicate::orient2d;
use std::collections::VecDeque;

/// A segment cannot be recovered: it crosses the constrained edge `a`-`b`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Crossing {
    pub a: u32,
    pub b: u32,
}

/// Inserts segments between vertices of a mesh whose vertex set stays as it is.
pub struct Constrainer<'m> {
    mesh: &'m mut Mesh,
    /// A half-edge leaving each vertex.
    leaving: Vec<u32>,
}

/// What lies ahead of a vertex in the direction of another.
enum Ahead {
    /// A half-edge along the segment.
    Along(u32),
    /// The half-edge (right to left) that the segment crosses first.
    Through(u32),
}

impl<'m> Constrainer<'m> {
    pub fn new(mesh: &'m mut Mesh) -> Self {
        let mut leaving = vec![NONE; mesh.points().len()];
        for (t, triangle) in mesh.triangles().iter().enumerate() {
            for (k, &v) in triangle.v.iter().enumerate() {
                leaving[v as usize] = half_edge(t as u32, k as u32);
            }
        }
        Constrainer { mesh, leaving }
    }

    /// The half-edge from `a` to `b`, if the mesh has that edge.
    pub fn find_edge(&self, a: u32, b: u32) -> Option<u32> {
        let from_a = self.fan(a).find_map(|h| {
            let along_last = prev(h);
            if self.mesh.dest(h) == b {
                Some(h)
            } else if self.mesh.origin(along_last) == b {
                // On the border the last edge of the fan exists only as b-a.
                Some(along_last)
            } else {
                None
            }
        })?;
        if self.mesh.origin(from_a) == a {
            return Some(from_a);
        }
        let twin = self.mesh.twin(from_a);
        Some(if twin == NONE { from_a } else { twin })
    }

    /// Half-edges leaving `v`, one a triangle around it.
    fn fan(&self, v: u32) -> impl Iterator<Item = u32> + '_ {
        let start = self.leaving[v as usize];
        // Turn back to the border, if there is one, then forth.
        let mut first = start;
        loop {
            let twin = self.mesh.twin(first);
            if twin == NONE {
                break;
            }
            first = next(twin);
            if first == start {
                break;
            }
        }
        let mut at = Some(first);
        std::iter::from_fn(move || {
            let h = at?;
            let turned = self.mesh.twin(prev(h));
            at = (turned != NONE && turned != first).then_some(turned);
            Some(h)
        })
    }

    fn ahead(&self, a: u32, b: u32) -> Option<Ahead> {
        let (pa, pb) = (self.mesh.point(a), self.mesh.point(b));
        let forward = |v: u32| {
            let p = self.mesh.point(v);
            i64::from(p.x - pa.x) * i64::from(pb.x - pa.x) + i64::from(p.y - pa.y) * i64::from(pb.y - pa.y)
                > 0
        };
        self.fan(a).find_map(|h| {
            let (r, l) = (self.mesh.dest(h), self.mesh.apex(h));
            let (right, left) = (orient2d(pa, pb, self.mesh.point(r)), orient2d(pa, pb, self.mesh.point(l)));
            if right == 0 && forward(r) {
                Some(Ahead::Along(h))
            } else if left == 0 && forward(l) {
                Some(Ahead::Along(prev(h)))
            } else {
                (right < 0 && left > 0).then_some(Ahead::Through(next(h)))
            }
        })
    }

    /// Makes the segment from vertex `a` to vertex `b` an edge, or a chain of edges
    /// through the vertices that lie on it; every part is constrained and reported
    /// to `part(from, to)`.
    pub fn insert(&mut self, a: u32, b: u32, mut part: impl FnMut(u32, u32)) -> Result<(), Crossing> {
        let mut from = a;
        while from != b {
            let to = match self.ahead(from, b) {
                Some(Ahead::Along(h)) => {
                    self.mesh.set_constrained(h, true);
                    if self.mesh.origin(h) == from {
                        self.mesh.dest(h)
                    } else {
                        self.mesh.origin(h)
                    }
                }
                Some(Ahead::Through(h)) => self.recover(from, b, h)?,
                None => return Ok(()),
            };
            part(from, to);
            from = to;
        }
        Ok(())
    }

    /// Flips the edges between `a` and the next vertex on the way to `b`, which it returns.
    fn recover(&mut self, a: u32, b: u32, first: u32) -> Result<u32, Crossing> {
        let (pa, pb) = (self.mesh.point(a), self.mesh.point(b));
        let mut crossed = VecDeque::new();
        let mut h = first;
        let to = loop {
            let (r, l) = (self.mesh.origin(h), self.mesh.dest(h));
            if self.mesh.is_constrained(h) {
                return Err(Crossing { a: r, b: l });
            }
            crossed.push_back((r, l));
            let g = self.mesh.twin(h);
            let d = self.mesh.apex(g);
            match orient2d(pa, pb, self.mesh.point(d)) {
                0 => break d,
                side if side > 0 => h = next(g),
                _ => h = prev(g),
            }
        };
        let pb = self.mesh.point(to);
        let mut made = Vec::new();
        while let Some((r, l)) = crossed.pop_front() {
            let Some(h) = self.find_edge(r, l) else { continue };
            if !self.mesh.is_convex(h) {
                crossed.push_back((r, l));
                continue;
            }
            let (c, d) = self.flip(h);
            let (side_c, side_d) =
                (orient2d(pa, pb, self.mesh.point(c)), orient2d(pa, pb, self.mesh.point(d)));
            if side_c.signum() * side_d.signum() < 0 {
                crossed.push_back((c, d));
            } else {
                made.push((c, d));
            }
        }
        if let Some(h) = self.find_edge(a, to) {
            self.mesh.set_constrained(h, true);
        }
        self.legalise(made);
        Ok(to)
    }

    /// Flips edge `h` and returns the ends of the new edge.
    fn flip(&mut self, h: u32) -> (u32, u32) {
        let (t, u) = (triangle_of(h), triangle_of(self.mesh.twin(h)));
        let ends = (self.mesh.apex(h), self.mesh.apex(self.mesh.twin(h)));
        self.mesh.flip(h);
        for t in [t, u] {
            for k in 0..3 {
                let h = half_edge(t, k);
                self.leaving[self.mesh.origin(h) as usize] = h;
            }
        }
        ends
    }

    fn legalise(&mut self, mut edges: Vec<(u32, u32)>) {
        while let Some((a, b)) = edges.pop() {
            let Some(h) = self.find_edge(a, b) else { continue };
            if self.mesh.is_illegal(h) {
                let (c, d) = self.flip(h);
                edges.extend([(a, c), (c, b), (b, d), (d, a)]);
            }
        }
    }
}
