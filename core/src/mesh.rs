//! Half-edge triangulation of a rectangle: insertion, flips, Delaunay upkeep.
//!
//! The mesh knows points and the metric, never heights. A constrained edge is never
//! flipped, only split.

use crate::memory::compact;
use crate::predicate::{orient2d, Metric, Point};
pub use crate::triangle::{half_edge, next, prev, triangle_of, Class, Triangle, NONE};
use crate::triangle::{Location, CLASS, CONSTRAINED, EDGE, HARD, SEAM};

#[derive(Clone)]
pub struct Mesh {
    points: Vec<Point>,
    triangles: Vec<Triangle>,
    metric: Metric,
    /// Edges still to be looked at by [`Mesh::legalise`].
    pending: Vec<u32>,
}

impl Mesh {
    /// Two triangles over the rectangle from the centre of pixel (0, 0) to that of
    /// (`cols` - 1, `rows` - 1); both at least 2. Corner order: clockwise from (0, 0).
    pub fn rectangle(cols: usize, rows: usize, metric: Metric) -> Self {
        let (right, bottom) = (cols - 1, rows - 1);
        let corners = [(0, 0), (right, 0), (right, bottom), (0, bottom)];
        let mut mesh = Mesh {
            points: corners.iter().map(|&(col, row)| Point::pixel(col, row)).collect(),
            triangles: vec![Triangle::new([0, 1, 2], 0), Triangle::new([0, 2, 3], 0)],
            metric,
            pending: Vec::new(),
        };
        mesh.link(half_edge(0, 2), half_edge(1, 0));
        mesh.pending.push(half_edge(0, 2));
        mesh.legalise();
        mesh
    }

    pub fn points(&self) -> &[Point] {
        &self.points
    }

    pub fn triangles(&self) -> &[Triangle] {
        &self.triangles
    }

    pub fn metric(&self) -> Metric {
        self.metric
    }

    #[inline]
    pub fn triangle(&self, t: u32) -> &Triangle {
        &self.triangles[t as usize]
    }

    #[inline]
    pub fn corners(&self, t: u32) -> [Point; 3] {
        self.triangle(t).v.map(|v| self.points[v as usize])
    }

    #[inline]
    pub fn point(&self, v: u32) -> Point {
        self.points[v as usize]
    }

    #[inline]
    pub fn origin(&self, h: u32) -> u32 {
        self.triangle(triangle_of(h)).v[(h & 3) as usize]
    }

    #[inline]
    pub fn dest(&self, h: u32) -> u32 {
        self.origin(next(h))
    }

    /// The corner opposite to the edge.
    #[inline]
    pub fn apex(&self, h: u32) -> u32 {
        self.origin(prev(h))
    }

    #[inline]
    pub fn twin(&self, h: u32) -> u32 {
        self.triangle(triangle_of(h)).twin[(h & 3) as usize]
    }

    #[inline]
    pub fn is_constrained(&self, h: u32) -> bool {
        self.triangle(triangle_of(h)).is_constrained((h & 3) as usize)
    }

    pub fn is_hard(&self, h: u32) -> bool {
        self.triangle(triangle_of(h)).is_hard((h & 3) as usize)
    }

    /// Marks the edge as a constraint on both sides.
    pub fn constrain(&mut self, h: u32) {
        self.mark(h, CONSTRAINED);
    }

    /// As [`Mesh::constrain`], and fixes the surface along the edge.
    pub fn harden(&mut self, h: u32) {
        self.mark(h, CONSTRAINED | HARD);
    }

    /// Makes a seam of the constrained edge.
    pub fn mark_seam(&mut self, h: u32) {
        self.mark(h, SEAM);
    }

    /// Makes the edge an ordinary one.
    pub fn release(&mut self, h: u32) {
        for side in self.sides(h) {
            self.triangles[triangle_of(side) as usize].flags &= !(EDGE << (side & 3));
        }
    }

    fn mark(&mut self, h: u32, bits: u32) {
        for side in self.sides(h) {
            self.triangles[triangle_of(side) as usize].flags |= bits << (side & 3);
        }
    }

    fn sides(&self, h: u32) -> impl Iterator<Item = u32> {
        [h, self.twin(h)].into_iter().filter(|&side| side != NONE)
    }

    pub fn set_class(&mut self, t: u32, class: Class) {
        self.triangles[t as usize].set_class(class);
    }

    /// The half-edge of triangle `t` that leaves its corner `v`.
    pub fn leaving(&self, t: u32, v: u32) -> u32 {
        let corners = self.triangle(t).v;
        half_edge(t, if corners[0] == v { 0 } else { 2 - u32::from(corners[1] == v) })
    }

    /// The half-edges that leave the origin of `start`, one a triangle around it.
    pub fn fan(&self, start: u32) -> impl Iterator<Item = u32> + '_ {
        let (mut at, mut is_back) = (Some(start), false);
        std::iter::from_fn(move || {
            let h = at?;
            let mut turned = if is_back { self.back(h) } else { self.twin(prev(h)) };
            if turned == NONE && !is_back {
                // The border: what is left lies on the other side of the start.
                (turned, is_back) = (self.back(start), true);
            }
            at = (turned != NONE && turned != start).then_some(turned);
            Some(h)
        })
    }

    /// The half-edge before `h` around its origin.
    fn back(&self, h: u32) -> u32 {
        let twin = self.twin(h);
        if twin == NONE {
            NONE
        } else {
            next(twin)
        }
    }

    /// Inserts `p` anywhere in the rectangle, walking from triangle `start`, and restores
    /// the Delaunay property. Returns the vertex: a new one, or the one that stands there.
    pub fn insert(&mut self, p: Point, start: u32) -> u32 {
        let place = self.locate(p, start);
        self.insert_at(p, place)
    }

    /// Inserts `p`, whose place has been found. All triangles that change are those around
    /// the vertex, among them the one that `place` names.
    pub fn insert_at(&mut self, p: Point, place: Location) -> u32 {
        let vertex = self.points.len() as u32;
        match place {
            Location::Vertex(v) => return v,
            Location::Face(t) => self.split_face(t, vertex),
            Location::Edge(h) => self.split_edge(h, vertex),
        }
        self.points.push(p);
        self.legalise();
        vertex
    }

    /// Moves to the memory of another one, which is lost.
    pub(crate) fn move_to(&mut self, mut room: Mesh) {
        room.points.clone_from(&self.points);
        room.triangles.clone_from(&self.triangles);
        *self = Mesh { metric: self.metric, ..room };
    }

    /// A copy with little room to grow.
    pub(crate) fn compact(&self) -> Self {
        let (points, triangles) = (compact(&self.points), compact(&self.triangles));
        Mesh { points, triangles, metric: self.metric, pending: Vec::new() }
    }

    /// Takes over a renumbered form of itself.
    pub(crate) fn replace(&mut self, points: Vec<Point>, triangles: Vec<Triangle>) {
        self.points = points;
        self.triangles = triangles;
    }

    fn link(&mut self, a: u32, b: u32) {
        self.triangles[triangle_of(a) as usize].twin[(a & 3) as usize] = b;
        if b != NONE {
            self.triangles[triangle_of(b) as usize].twin[(b & 3) as usize] = a;
        }
    }

    /// Gives edge `h` the outer neighbour and the marks it has to take over.
    fn attach(&mut self, h: u32, (twin, marks): (u32, u32)) {
        self.link(h, twin);
        self.triangles[triangle_of(h) as usize].flags |= marks << (h & 3);
    }

    fn outer(&self, h: u32) -> (u32, u32) {
        (self.twin(h), self.marks(h))
    }

    fn marks(&self, h: u32) -> u32 {
        self.triangle(triangle_of(h)).flags >> (h & 3) & EDGE
    }

    fn push_triangle(&mut self, v: [u32; 3], class: u32) -> u32 {
        self.triangles.push(Triangle::new(v, class));
        self.triangles.len() as u32 - 1
    }

    fn reset_triangle(&mut self, t: u32, v: [u32; 3]) {
        let triangle = &mut self.triangles[t as usize];
        triangle.v = v;
        triangle.flags &= CLASS;
        triangle.version = triangle.version.wrapping_add(1);
    }

    /// Triangle (a, b, c) becomes (a, b, p), (b, c, p), (c, a, p).
    fn split_face(&mut self, t: u32, p: u32) {
        let [a, b, c] = self.triangle(t).v;
        let outer = [0, 1, 2].map(|k| self.outer(half_edge(t, k)));
        let class = self.triangle(t).flags & CLASS;
        self.reset_triangle(t, [a, b, p]);
        let t1 = self.push_triangle([b, c, p], class);
        let t2 = self.push_triangle([c, a, p], class);
        for (new, outer) in [t, t1, t2].into_iter().zip(outer) {
            self.attach(half_edge(new, 0), outer);
            self.pending.push(half_edge(new, 0));
        }
        self.link(half_edge(t, 1), half_edge(t1, 2));
        self.link(half_edge(t1, 1), half_edge(t2, 2));
        self.link(half_edge(t2, 1), half_edge(t, 2));
    }

    /// Cuts the triangle on one side of edge a-b at `p` into (c, a, p) and (b, c, p);
    /// returns the half-edges a-p and p-b.
    fn split_side(&mut self, h: u32, p: u32) -> (u32, u32) {
        let t = triangle_of(h);
        let (a, b, c) = (self.origin(h), self.dest(h), self.apex(h));
        let (bc, ca) = (self.outer(next(h)), self.outer(prev(h)));
        let marks = self.marks(h);
        let class = self.triangle(t).flags & CLASS;
        self.reset_triangle(t, [c, a, p]);
        let t1 = self.push_triangle([b, c, p], class);
        for (new, outer) in [(t, ca), (t1, bc)] {
            self.attach(half_edge(new, 0), outer);
            self.pending.push(half_edge(new, 0));
        }
        self.link(half_edge(t, 2), half_edge(t1, 1));
        let halves = (half_edge(t, 1), half_edge(t1, 2));
        self.attach(halves.0, (NONE, marks));
        self.attach(halves.1, (NONE, marks));
        halves
    }

    fn split_edge(&mut self, h: u32, p: u32) {
        let twin = self.twin(h);
        let (ap, pb) = self.split_side(h, p);
        if twin != NONE {
            let (bp, pa) = self.split_side(twin, p);
            self.link(ap, pa);
            self.link(pb, bp);
        }
    }

    /// Whether edge `h` may be flipped and is not Delaunay.
    pub fn is_illegal(&self, h: u32) -> bool {
        let twin = self.twin(h);
        if twin == NONE || self.is_constrained(h) {
            return false;
        }
        let [a, b, c] = self.corners(triangle_of(h));
        self.metric.in_circle(a, b, c, self.point(self.apex(twin)))
    }

    /// All half-edges.
    pub fn half_edges(&self) -> impl Iterator<Item = u32> {
        (0..self.triangles.len() as u32).flat_map(|t| [0, 1, 2].map(|k| half_edge(t, k)))
    }

    /// Flips until every edge that is not constrained is Delaunay.
    pub fn make_delaunay(&mut self) {
        self.make_delaunay_from(self.half_edges().collect());
    }

    /// The same where only these edges may be none; returns the triangles changed, ascending.
    pub fn make_delaunay_from(&mut self, mut open: Vec<u32>) -> Vec<u32> {
        let mut changed = Vec::new();
        while let Some(h) = open.pop() {
            if self.is_illegal(h) {
                let pair = [triangle_of(h), triangle_of(self.twin(h))];
                self.flip(h);
                changed.extend(pair);
                open.extend(pair.into_iter().flat_map(|t| [0, 1, 2].map(|k| half_edge(t, k))));
            }
        }
        changed.sort_unstable();
        changed.dedup();
        changed
    }

    /// A mesh of triangles whose twins are right.
    pub(crate) fn of_parts(points: Vec<Point>, triangles: Vec<Triangle>, metric: Metric) -> Self {
        Mesh { points, triangles, metric, pending: Vec::new() }
    }

    pub(crate) fn into_parts(self) -> (Vec<Point>, Vec<Triangle>) {
        (self.points, self.triangles)
    }

    /// Restores the Delaunay property around a vertex just inserted.
    fn legalise(&mut self) {
        while let Some(h) = self.pending.pop() {
            if self.is_illegal(h) {
                self.flip(h);
                // After a flip the far edges of both triangles stand at position 1.
                self.pending.push(half_edge(triangle_of(h), 1));
                let other = triangle_of(self.twin(half_edge(triangle_of(h), 2)));
                self.pending.push(half_edge(other, 1));
            }
        }
    }

    /// Replaces interior edge a-b of the quadrilateral a, d, b, c by d-c. Triangle
    /// `t` of `h` becomes (c, a, d), that of the twin (c, d, b). The quadrilateral
    /// must be strictly convex and both triangles of one class.
    pub fn flip(&mut self, h: u32) {
        let g = self.twin(h);
        let (t, u) = (triangle_of(h), triangle_of(g));
        let (of_t, of_u) = (*self.triangle(t), *self.triangle(u));
        let [(a, _), (b, bc), (c, ca)] = of_t.from(h & 3);
        let [_, (_, ad), (d, db)] = of_u.from(g & 3);
        self.triangles[t as usize] = of_t.changed([c, a, d], [ca, ad, (half_edge(u, 0), 0)]);
        self.triangles[u as usize] = of_u.changed([c, d, b], [(half_edge(t, 2), 0), db, bc]);
        for (new, (twin, _)) in
            [(half_edge(t, 0), ca), (half_edge(t, 1), ad), (half_edge(u, 1), db), (half_edge(u, 2), bc)]
        {
            if twin != NONE {
                self.triangles[triangle_of(twin) as usize].twin[(twin & 3) as usize] = new;
            }
        }
    }

    /// Whether the quadrilateral around interior edge `h` is strictly convex.
    pub fn is_convex(&self, h: u32) -> bool {
        let (a, b) = (self.point(self.origin(h)), self.point(self.dest(h)));
        let (c, d) = (self.point(self.apex(h)), self.point(self.apex(self.twin(h))));
        orient2d(c, a, d) > 0 && orient2d(c, d, b) > 0
    }
}
