//! A surface taken apart into tiles, and put together again.

use crate::error::Result;
use crate::memory;
use crate::mesh::{half_edge, triangle_of, Mesh, NONE};
use crate::order::by_place;
use crate::outlook::Waiting;
use crate::patch::Frame;
use crate::predicate::{orient2d, Metric, Point};
use crate::progress::Progress;
use crate::refine::Refiner;
use crate::seams::SeamPoint;
use crate::surface::Surface;
use crate::threads::spread;
use crate::tiling::Tiling;
use crate::triangle::{Location, Triangle};
use std::collections::HashMap;

/// What a triangle takes with its share of the vertices.
const TRIANGLE_BYTES: usize = 64;

/// One tile's part of the surface; edges towards other tiles are borders of its mesh.
pub struct Tile {
    pub number: usize,
    pub refiner: Refiner,
    /// Vertices that it had from the start or shares with others, ascending, and their
    /// numbers in the whole.
    shared: Vec<(u32, u32)>,
    pub queued: Queued,
    /// How many candidates waited at about which priority when it was last worked on.
    pub waiting: Waiting,
}

/// The image whose errors a tile's queue has.
#[derive(Clone, Copy)]
pub enum Queued {
    /// There was none yet.
    Nothing,
    /// One that was refined before, and how its heights were held.
    Before(Frame),
    /// The one that is being refined.
    Now(Frame),
}

/// What is left of a tile once it is refined.
pub struct Part {
    surface: Surface,
    shared: Vec<(u32, u32)>,
}

/// What belongs to no tile alone.
pub struct Shared {
    points: Vec<Point>,
    z: Vec<f64>,
    is_fixed: Vec<bool>,
    metric: Metric,
}

impl Tile {
    /// Vertices inside the tile that refinement has added.
    pub fn inserted(&self) -> usize {
        self.refiner.surface.z.len() - self.shared.len()
    }

    /// Where a pixel on a seam lies: an edge on the border of the tile's mesh.
    pub fn border(&self, (col, row): (usize, usize)) -> Option<Location> {
        let mesh = &self.refiner.surface.mesh;
        let p = Point::pixel(col, row);
        let place = mesh.locate(p, mesh.triangles().len() as u32 - 1);
        if matches!(place, Location::Edge(h) if mesh.twin(h) == NONE) {
            return Some(place);
        }
        // A seam that bends around a vertex can lead the walk astray.
        let is_on = |h: u32| {
            let (a, b) = (mesh.point(mesh.origin(h)), mesh.point(mesh.dest(h)));
            let between =
                (a.x.min(b.x)..=a.x.max(b.x)).contains(&p.x) && (a.y.min(b.y)..=a.y.max(b.y)).contains(&p.y);
            mesh.twin(h) == NONE && between && p != a && p != b && orient2d(a, b, p) == 0
        };
        mesh.half_edges().find(|&h| is_on(h)).map(Location::Edge)
    }

    /// Notes that vertex `v` is number `whole` of the whole.
    pub fn share(&mut self, v: u32, whole: u32) {
        self.shared.push((v, whole));
    }
}

impl From<Tile> for Part {
    fn from(tile: Tile) -> Self {
        Part { surface: tile.refiner.surface, shared: tile.shared }
    }
}

impl Part {
    /// Numbers triangles and vertices by their place. Errors: `out-of-memory`, `cancelled`.
    pub fn order(&mut self, progress: &mut Progress) -> Result<()> {
        let number = by_place(&mut self.surface, progress)?;
        self.shared.iter_mut().for_each(|(v, _)| *v = number[*v as usize]);
        Ok(())
    }

    /// Vertices that are shared with no other.
    fn own(&self) -> usize {
        self.surface.z.len() - self.shared.len()
    }
}

impl Shared {
    /// Number of vertices that carry a height.
    pub fn count(&self) -> usize {
        self.z.iter().filter(|z| !z.is_nan()).count()
    }

    /// The number of a new vertex on a seam.
    pub fn add(&mut self, point: &SeamPoint) -> u32 {
        self.points.push(Point::pixel(point.pixel.0, point.pixel.1));
        self.z.push(point.z);
        self.is_fixed.push(false);
        self.points.len() as u32 - 1
    }
}

/// Takes the surface apart; tiles without a triangle are left out.
/// Errors: `out-of-memory`.
pub fn cut(surface: Surface, tiling: &Tiling) -> Result<(Shared, Vec<Tile>)> {
    let mesh = &surface.mesh;
    let count = mesh.triangles().len();
    memory::ensure(TRIANGLE_BYTES * count)?;
    let tile_of: Vec<usize> = (0..count as u32).map(|t| tiling.tile_of(mesh.corners(t))).collect();
    let mut members: Vec<Vec<u32>> = vec![Vec::new(); tiling.count()];
    let mut number = vec![NONE; count];
    for (t, &tile) in tile_of.iter().enumerate() {
        number[t] = members[tile].len() as u32;
        members[tile].push(t as u32);
    }
    let mut tiles = Vec::new();
    for (tile, members) in members.into_iter().enumerate().filter(|(_, members)| !members.is_empty()) {
        let within = |t: u32| (tile_of[t as usize] == tile).then(|| number[t as usize]);
        let (part, old) = surface.part(&members, within);
        let shared = (0..).zip(old).collect();
        tiles.push(Tile {
            number: tile,
            refiner: Refiner::new(part).sampling(),
            shared,
            queued: Queued::Nothing,
            waiting: Waiting::new(),
        });
    }
    let metric = mesh.metric();
    let (points, _) = surface.mesh.into_parts();
    Ok((Shared { points, z: surface.z, is_fixed: surface.is_fixed, metric }, tiles))
}

/// A part, and where its triangles and its own vertices are to lie in the whole.
struct Place<'w> {
    part: Part,
    first_triangle: u32,
    triangles: &'w mut [Triangle],
    first_vertex: u32,
    points: &'w mut [Point],
    z: &'w mut [f64],
    is_fixed: &'w mut [bool],
}

impl Place<'_> {
    /// Puts the part there, and returns its edges without a twin with their ends, and what it has of seams within: one
    /// that bends around a vertex can have a thin triangle on the wrong side.
    fn fill(self) -> (Vec<([u32; 2], u32)>, Vec<u32>) {
        let Part { surface: Surface { mesh, z, is_fixed }, shared } = self.part;
        let mut numbers = vec![NONE; z.len()];
        shared.iter().for_each(|&(v, whole)| numbers[v as usize] = whole);
        let own = (0..z.len()).filter(|&v| numbers[v] == NONE).collect::<Vec<_>>();
        for (i, v) in own.into_iter().enumerate() {
            numbers[v] = self.first_vertex + i as u32;
            self.points[i] = mesh.point(v as u32);
            (self.z[i], self.is_fixed[i]) = (z[v], is_fixed[v]);
        }
        let (mut open, mut within) = (Vec::new(), Vec::new());
        let twin = |h: u32| if h == NONE { NONE } else { h + half_edge(self.first_triangle, 0) };
        for ((t, into), triangle) in (self.first_triangle..).zip(self.triangles).zip(mesh.triangles()) {
            *into = triangle.renumbered(|v| numbers[v as usize], twin);
            for k in 0..3 {
                if into.twin[k] == NONE {
                    open.push(([into.v[k], into.v[(k + 1) % 3]], half_edge(t, k as u32)));
                } else if into.is_seam(k) {
                    within.push(half_edge(t, k as u32));
                }
            }
        }
        (open, within)
    }
}

/// Puts the parts together, each given back as soon as it is copied; and returns all edges at which
/// they meet, both sides of each. Errors: `out-of-memory`, `cancelled`.
pub fn merge(shared: Shared, parts: Vec<Part>, progress: &mut Progress) -> Result<(Surface, Vec<u32>)> {
    let Shared { mut points, mut z, mut is_fixed, metric } = shared;
    let known = points.len();
    let vertices = known + parts.iter().map(Part::own).sum::<usize>();
    let count = parts.iter().map(|part| part.surface.mesh.triangles().len()).sum::<usize>();
    memory::ensure(TRIANGLE_BYTES * count)?;
    points.resize(vertices, Point::pixel(0, 0));
    z.resize(vertices, f64::NAN);
    is_fixed.resize(vertices, false);
    let mut triangles = vec![Triangle::new([NONE; 3], 0); count];
    let mut places = Vec::with_capacity(parts.len());
    let mut rest = (&mut triangles[..], &mut points[known..], &mut z[known..], &mut is_fixed[known..]);
    for part in parts {
        let (size, own) = (part.surface.mesh.triangles().len(), part.own());
        let (first_triangle, first_vertex) = (count - rest.0.len(), vertices - rest.1.len());
        let (triangles, points) = (rest.0.split_at_mut(size), rest.1.split_at_mut(own));
        let (z, is_fixed) = (rest.2.split_at_mut(own), rest.3.split_at_mut(own));
        rest = (triangles.1, points.1, z.1, is_fixed.1);
        places.push(Place {
            part,
            first_triangle: first_triangle as u32,
            triangles: triangles.0,
            first_vertex: first_vertex as u32,
            points: points.0,
            z: z.0,
            is_fixed: is_fixed.0,
        });
    }
    let edges = spread(progress, places.into_iter(), |place, _| Ok(place.fill()))?;
    let (open, within): (Vec<_>, Vec<_>) = edges.into_iter().unzip();
    let (mut waiting, mut seams) = (HashMap::new(), within.concat());
    for ([a, b], h) in open.into_iter().flatten() {
        let Some(g) = waiting.remove(&[b, a]) else {
            waiting.insert([a, b], h);
            continue;
        };
        for (h, twin) in [(h, g), (g, h)] {
            triangles[triangle_of(h) as usize].twin[(h & 3) as usize] = twin;
        }
        seams.extend([g, h]);
    }
    Ok((Surface { mesh: Mesh::of_parts(points, triangles, metric), z, is_fixed }, seams))
}

/// Makes ordinary edges of those that are there for the seams alone, and the mesh Delaunay again; returns
/// the triangles that touch one or have changed.
pub fn release_seams(mesh: &mut Mesh, mut seams: Vec<u32>) -> Vec<u32> {
    seams.retain(|&h| mesh.triangle(triangle_of(h)).is_seam((h & 3) as usize));
    seams.iter().for_each(|&h| mesh.release(h));
    let mut touched: Vec<u32> = seams.iter().map(|&h| triangle_of(h)).collect();
    touched.extend(mesh.make_delaunay_from(seams));
    touched
}
