//! Triangles and the numbers of their edges.
//!
//! Half-edge `h = 4 t + k` (k = 0, 1, 2) runs from corner k of triangle t to
//! corner k + 1; its twin is the same edge seen from the neighbour. Triangles
//! are positively oriented in (x, y).

/// "No half-edge": the twin of an edge of the rectangle's border.
pub const NONE: u32 = u32::MAX;

// Bits of a triangle's flags: for edge k, constrained at k, hard at k + 3, a seam at k + 6.
pub(crate) const CONSTRAINED: u32 = 1;
pub(crate) const HARD: u32 = 1 << 3;
pub(crate) const SEAM: u32 = 1 << 6;
pub(crate) const EDGE: u32 = CONSTRAINED | HARD | SEAM;
const VOID: u32 = 1 << 9;
const FLAT: u32 = 1 << 10;
pub(crate) const CLASS: u32 = VOID | FLAT;

/// What a triangle covers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Class {
    /// Terrain, to be refined.
    Data,
    /// A part of the data that is kept level.
    Flat,
    /// No data: in no output.
    Void,
}

/// One triangle and its three half-edges.
#[derive(Clone, Copy, Debug)]
pub struct Triangle {
    pub v: [u32; 3],
    pub twin: [u32; 3],
    pub(crate) flags: u32,
    /// Counts the changes of the triangle, so that queue entries can grow stale.
    pub version: u32,
}

impl Triangle {
    pub(crate) fn new(v: [u32; 3], class: u32) -> Self {
        Triangle { v, twin: [NONE; 3], flags: class, version: 0 }
    }

    pub fn is_void(&self) -> bool {
        self.flags & VOID != 0
    }

    pub fn class(&self) -> Class {
        match self.flags & CLASS {
            0 => Class::Data,
            FLAT => Class::Flat,
            _ => Class::Void,
        }
    }

    pub(crate) fn set_class(&mut self, class: Class) {
        let bits = match class {
            Class::Data => 0,
            Class::Flat => FLAT,
            Class::Void => VOID,
        };
        self.flags = self.flags & !CLASS | bits;
    }

    pub fn is_constrained(&self, k: usize) -> bool {
        self.flags >> k & CONSTRAINED != 0
    }

    /// Whether the surface along edge k is fixed: it runs straight between vertices of
    /// fixed height, whatever the data are there.
    pub fn is_hard(&self, k: usize) -> bool {
        self.flags >> k & HARD != 0
    }

    /// Whether edge k is constrained only for the time of refinement, to part two tiles.
    pub fn is_seam(&self, k: usize) -> bool {
        self.flags >> k & SEAM != 0
    }

    /// Corners, each with the twin and the marks of the edge that leaves it, from corner `k` on.
    #[inline(always)]
    pub(crate) fn from(&self, k: u32) -> [(u32, (u32, u32)); 3] {
        const TURNS: [[usize; 3]; 4] = [[0, 1, 2], [1, 2, 0], [2, 0, 1], [0; 3]];
        TURNS[(k & 3) as usize].map(|k| (self.v[k], (self.twin[k], self.flags >> k & EDGE)))
    }

    /// What becomes of it with other corners and, for each edge, a twin and marks.
    #[inline(always)]
    pub(crate) fn changed(&self, v: [u32; 3], edges: [(u32, u32); 3]) -> Self {
        let [(x, on_x), (y, on_y), (z, on_z)] = edges;
        let flags = self.flags & CLASS | on_x | on_y << 1 | on_z << 2;
        Triangle { v, twin: [x, y, z], flags, version: self.version.wrapping_add(1) }
    }

    /// The same triangle in a mesh with other numbers.
    pub(crate) fn renumbered(&self, vertex: impl FnMut(u32) -> u32, twin: impl FnMut(u32) -> u32) -> Self {
        Triangle { v: self.v.map(vertex), twin: self.twin.map(twin), ..*self }
    }
}

/// Where a point fell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Location {
    Face(u32),
    Edge(u32),
    Vertex(u32),
}

impl Location {
    /// A triangle that holds the point; [`NONE`] at a vertex.
    pub fn triangle(self) -> u32 {
        match self {
            Location::Face(t) => t,
            Location::Edge(h) => triangle_of(h),
            Location::Vertex(_) => NONE,
        }
    }
}

#[inline]
pub fn next(h: u32) -> u32 {
    if h & 3 == 2 {
        h - 2
    } else {
        h + 1
    }
}

#[inline]
pub fn prev(h: u32) -> u32 {
    if h & 3 == 0 {
        h + 2
    } else {
        h - 1
    }
}

#[inline]
pub fn half_edge(t: u32, k: u32) -> u32 {
    t << 2 | k
}

#[inline]
pub fn triangle_of(h: u32) -> u32 {
    h >> 2
}
