//! Point location by walking (Devillers, Pion and Teillaud 2002).

use crate::mesh::{half_edge, triangle_of, Class, Mesh, NONE};
use crate::predicate::{orient2d, Point};
use crate::triangle::Location;

impl Mesh {
    /// Walks from triangle `start` to the place of `p`, which lies in the rectangle.
    pub fn locate(&self, p: Point, start: u32) -> Location {
        let mut t = start;
        // Changing the first edge looked at keeps the walk from cycling in a
        // constrained (not Delaunay) triangulation.
        let mut turn: u32 = 0;
        'walk: loop {
            let corner = self.corners(t);
            turn = turn.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let first = (turn >> 16) % 3;
            let mut on_edge = [false; 3];
            for i in 0..3 {
                let k = ((first + i) % 3) as usize;
                let side = orient2d(corner[k], corner[(k + 1) % 3], p);
                let twin = self.triangle(t).twin[k];
                if side < 0 && twin != NONE {
                    t = triangle_of(twin);
                    continue 'walk;
                }
                on_edge[k] = side == 0;
            }
            return self.place(t, on_edge);
        }
    }

    /// The place of `p` in triangle `t`, which holds it.
    pub(crate) fn place_in(&self, p: Point, t: u32) -> Location {
        let c = self.corners(t);
        self.place(t, [0, 1, 2].map(|k| orient2d(c[k], c[(k + 1) % 3], p) == 0))
    }

    fn place(&self, t: u32, on_edge: [bool; 3]) -> Location {
        match on_edge {
            [true, true, _] => Location::Vertex(self.triangle(t).v[1]),
            [_, true, true] => Location::Vertex(self.triangle(t).v[2]),
            [true, _, true] => Location::Vertex(self.triangle(t).v[0]),
            [true, _, _] => Location::Edge(half_edge(t, 0)),
            [_, true, _] => Location::Edge(half_edge(t, 1)),
            [_, _, true] => Location::Edge(half_edge(t, 2)),
            _ => Location::Face(t),
        }
    }

    /// Whether a vertex at `place` would belong to a triangle of terrain.
    pub fn is_in_data(&self, place: Location) -> bool {
        let is_data = |h: u32| h != NONE && self.triangle(triangle_of(h)).class() == Class::Data;
        match place {
            Location::Face(t) => is_data(half_edge(t, 0)),
            Location::Edge(h) => is_data(h) || is_data(self.twin(h)),
            Location::Vertex(_) => true,
        }
    }
}
