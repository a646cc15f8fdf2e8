//! Segments as edges of the mesh: recovered by flips (Sloan 1993), then kept. Where
//! two of them cross, they meet in a vertex.

use crate::label::{Label, Labels};
use crate::mesh::{half_edge, next, prev, triangle_of, Mesh, NONE};
use crate::predicate::{orient2d, Point};
use crate::surface::lerp;
use crate::triangle::Location;
use std::collections::VecDeque;

/// Inserts segments between vertices of a mesh.
pub struct Constrainer<'m> {
    mesh: &'m mut Mesh,
    /// A half-edge leaving each vertex.
    leaving: Vec<u32>,
    labels: Labels,
    /// Height that each vertex has to keep; NaN where it is free.
    fixed: Vec<f64>,
}

/// What lies ahead of a vertex in the direction of another.
enum Ahead {
    /// A half-edge along the segment.
    Along(u32),
    /// The half-edge (right to left) that the segment crosses first.
    Through(u32),
}

/// How a segment goes on from its start.
enum Step {
    /// To this vertex by an edge.
    To(u32),
    /// By way of this vertex, which is as good as on it.
    Via(u32),
    /// Across the constrained half-edge (right to left).
    Across(u32),
}

struct Segment {
    a: u32,
    b: u32,
    label: Label,
}

impl<'m> Constrainer<'m> {
    /// `fixed`: the height that each vertex has to keep, NaN where it is free.
    pub fn new(mesh: &'m mut Mesh, fixed: Vec<f64>) -> Self {
        let leaving = vec![NONE; mesh.points().len()];
        let mut made = Constrainer { mesh, leaving, labels: Labels::default(), fixed };
        for t in 0..made.mesh.triangles().len() as u32 {
            made.note_leaving(t);
        }
        made
    }

    /// The labels of the edges, and the heights that the vertices have to keep.
    pub fn finish(self) -> (Labels, Vec<f64>) {
        (self.labels, self.fixed)
    }

    fn note_leaving(&mut self, t: u32) {
        for h in (0..3).map(|k| half_edge(t, k)) {
            self.leaving[self.mesh.origin(h) as usize] = h;
        }
    }

    /// The half-edge from `a` to `b`, if the mesh has that edge.
    pub fn find_edge(&self, a: u32, b: u32) -> Option<u32> {
        let from_a = self.mesh.fan(self.leaving[a as usize]).find_map(|h| {
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

    fn ahead(&self, a: u32, b: u32) -> Option<Ahead> {
        let (pa, pb) = (self.mesh.point(a), self.mesh.point(b));
        let forward = |v: u32| {
            let p = self.mesh.point(v);
            i64::from(p.x - pa.x) * i64::from(pb.x - pa.x) + i64::from(p.y - pa.y) * i64::from(pb.y - pa.y)
                > 0
        };
        self.mesh.fan(self.leaving[a as usize]).find_map(|h| {
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
    /// through the vertices that lie on it and new ones where it crosses other
    /// constraints. A crossing is rounded to the lattice, which bends both; all but the
    /// outline of the data also take in the vertices that they pass very closely, or
    /// lines that are nearly the same would cross again and again.
    pub fn insert(&mut self, a: u32, b: u32, label: Label) {
        // This ends: a bend replaces two segments by pieces of which none is longer and
        // those of at least one are shorter, and lengths on a lattice cannot fall forever.
        let mut open = vec![Segment { a, b, label }];
        while let Some(Segment { a, b, label }) = open.pop() {
            if a == b {
                continue;
            }
            let step = match self.ahead(a, b) {
                Some(Ahead::Along(h)) if self.mesh.origin(h) == a => Step::To(self.mesh.dest(h)),
                Some(Ahead::Along(h)) => Step::To(self.mesh.origin(h)),
                Some(Ahead::Through(h)) => self.recover(a, b, h, label.along_outline() == 0),
                None => continue,
            };
            match step {
                Step::To(to) => {
                    if to != b {
                        if label.is_hard {
                            self.fix(to, [Some(self.height_along(a, b, to))]);
                        }
                        open.push(Segment { a: to, b, label: label.clone() });
                    }
                    self.mark(a, to, label);
                }
                Step::Via(v) => {
                    if label.is_hard {
                        self.fix(v, [Some(self.height_along(a, b, v))]);
                    }
                    open.push(Segment { a: v, b, label: label.clone() });
                    open.push(Segment { a, b: v, label });
                }
                Step::Across(h) => self.cross(Segment { a, b, label }, h, &mut open),
            }
        }
    }

    /// Constrains edge `a`-`b`, which the mesh has.
    fn mark(&mut self, a: u32, b: u32, label: Label) {
        if let Some(h) = self.find_edge(a, b) {
            if label.is_hard {
                self.mesh.harden(h);
            } else {
                self.mesh.constrain(h);
            }
            self.labels.merge(a, b, label);
        }
    }

    fn height_along(&self, a: u32, b: u32, v: u32) -> f64 {
        let end = |v: u32| (self.mesh.point(v), self.fixed[v as usize]);
        lerp(end(a), end(b), self.mesh.point(v))
    }

    /// Gives vertex `v`, if it is free, the mean of the heights.
    fn fix<const N: usize>(&mut self, v: u32, heights: [Option<f64>; N]) {
        let known = heights.iter().flatten().count();
        if known > 0 && self.fixed[v as usize].is_nan() {
            self.fixed[v as usize] = heights.iter().flatten().sum::<f64>() / known as f64;
        }
    }

    /// Whether the segment passes vertex `v` closely enough to take it in: within 1.5
    /// units, as far off as a rounded crossing may be.
    fn is_beside(&self, a: u32, b: u32, v: u32) -> bool {
        let [a, b, v] = [a, b, v].map(|v| self.mesh.point(v));
        let square = |p: Point, q: Point| {
            let (dx, dy) = (i64::from(q.x - p.x), i64::from(q.y - p.y));
            i128::from(dx * dx + dy * dy)
        };
        let (off, whole) = (i128::from(orient2d(a, b, v)), square(a, b));
        4 * off * off <= 9 * whole && square(a, v) < whole && square(v, b) < whole
    }

    /// Flips the edges between `a` and the next vertex on the way to `b`, unless a
    /// constraint or (if `may_bend`) a vertex beside the segment is in the way.
    fn recover(&mut self, a: u32, b: u32, first: u32, may_bend: bool) -> Step {
        let (pa, pb) = (self.mesh.point(a), self.mesh.point(b));
        let mut crossed = VecDeque::new();
        let mut h = first;
        let to = loop {
            let ends = [self.mesh.origin(h), self.mesh.dest(h)];
            if let Some(v) = ends.into_iter().find(|&v| may_bend && self.is_beside(a, b, v)) {
                return Step::Via(v);
            }
            if self.mesh.is_constrained(h) {
                return Step::Across(h);
            }
            crossed.push_back((ends[0], ends[1]));
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
            self.mesh.constrain(h);
        }
        self.legalise(made);
        Step::To(to)
    }

    /// Lets the segment and the constrained half-edge `h` (right to left) meet in a
    /// vertex; what is left to do of both goes to `open`.
    fn cross(&mut self, segment: Segment, h: u32, open: &mut Vec<Segment>) {
        let Segment { a, b, label } = segment;
        let (r, l) = (self.mesh.origin(h), self.mesh.dest(h));
        let other = self.labels.get(r, l).unwrap_or_default();
        let p = self.meeting_point([a, b], &label, [r, l], &other);
        let heights = [
            label.is_hard.then(|| lerp(self.end(a), self.end(b), p)),
            other.is_hard.then(|| lerp(self.end(r), self.end(l), p)),
        ];
        let v = self.insert_vertex(p, triangle_of(h), heights);
        if v != r && v != l {
            // Unless the vertex has split the edge exactly, the edge bends.
            if let Some(other) = self.labels.remove(r, l) {
                if let Some(h) = self.find_edge(r, l) {
                    self.mesh.release(h);
                }
                open.push(Segment { a: v, b: l, label: other.clone() });
                open.push(Segment { a: r, b: v, label: other });
            }
        }
        open.push(Segment { a: v, b, label: label.clone() });
        open.push(Segment { a, b: v, label });
    }

    fn end(&self, v: u32) -> (Point, f64) {
        (self.mesh.point(v), self.fixed[v as usize])
    }

    /// The corner of the lattice cell around the exact crossing that is nearest to it,
    /// but where the outline of the data is concerned not on its inner side: bent
    /// inwards it would lose the pixels that lie on it.
    fn meeting_point(&self, ab: [u32; 2], label: &Label, rl: [u32; 2], other: &Label) -> Point {
        let [a, b] = ab.map(|v| self.mesh.point(v));
        let [r, l] = rl.map(|v| self.mesh.point(v));
        let (right, left) = (orient2d(a, b, r), orient2d(a, b, l));
        let (share, whole) = (i128::from(-right), i128::from(left - right));
        let along = |r: i32, l: i32| i128::from(r) * whole + i128::from(l - r) * share;
        let (x, y) = (along(r.x, l.x), along(r.y, l.y));
        let both = |v: i128| [v.div_euclid(whole), v.div_euclid(whole) + i128::from(v.rem_euclid(whole) > 0)];
        let inner = |p: Point, a: Point, b: Point, label: &Label| {
            i32::from(label.along_outline() * orient2d(a, b, p).signum() > 0)
        };
        let rank = |p: Point| {
            let (dx, dy) = (i128::from(p.x) * whole - x, i128::from(p.y) * whole - y);
            (inner(p, a, b, label) + inner(p, r, l, other), dx * dx + dy * dy, p)
        };
        let [x0, x1] = both(x);
        let [y0, y1] = both(y);
        [(x0, y0), (x1, y0), (x0, y1), (x1, y1)]
            .map(|(x, y)| Point { x: x as i32, y: y as i32 })
            .into_iter()
            .min_by_key(|&p| rank(p))
            .unwrap_or(r)
    }

    /// The vertex at `p`, a new one if there is none; a constrained edge that it falls
    /// on is split with its label. If it is free it gets the mean of the `heights`.
    fn insert_vertex(&mut self, p: Point, start: u32, heights: [Option<f64>; 2]) -> u32 {
        let place = self.mesh.locate(p, start);
        let split = match place {
            Location::Vertex(v) => {
                self.fix(v, heights);
                return v;
            }
            Location::Edge(h) => Some((self.mesh.origin(h), self.mesh.dest(h))),
            Location::Face(_) => None,
        };
        let v = self.mesh.insert_at(p, place);
        self.leaving.push(NONE);
        self.fixed.push(f64::NAN);
        let around: Vec<u32> =
            self.mesh.fan(self.mesh.leaving(place.triangle(), v)).map(triangle_of).collect();
        around.into_iter().for_each(|t| self.note_leaving(t));
        self.fix(v, heights);
        if let Some((a, b)) = split {
            if let Some(label) = self.labels.remove(a, b) {
                if label.is_hard {
                    self.fix(v, [Some(self.height_along(a, b, v))]);
                }
                self.labels.merge(a, v, label.clone());
                self.labels.merge(v, b, label);
            }
        }
        v
    }

    /// Flips edge `h` and returns the ends of the new edge.
    fn flip(&mut self, h: u32) -> (u32, u32) {
        let (t, u) = (triangle_of(h), triangle_of(self.mesh.twin(h)));
        let ends = (self.mesh.apex(h), self.mesh.apex(self.mesh.twin(h)));
        self.mesh.flip(h);
        self.note_leaving(t);
        self.note_leaving(u);
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
