//! A surface taken apart into tiles, and put together again.

use crate::error::Result;
use crate::memory;
use crate::mesh::{half_edge, triangle_of, Mesh, NONE};
use crate::order::by_place;
use crate::patch::Frame;
use crate::predicate::{orient2d, Metric, Point};
use crate::progress::Progress;
use crate::refine::Refiner;
use crate::seams::SeamPoint;
use crate::surface::Surface;
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
        });
    }
    let metric = mesh.metric();
    let (points, _) = surface.mesh.into_parts();
    Ok((Shared { points, z: surface.z, is_fixed: surface.is_fixed, metric }, tiles))
}

/// Puts the parts together, each given back as soon as it is copied.
/// Errors: `out-of-memory`.
pub fn merge(shared: Shared, parts: Vec<Part>) -> Result<Surface> {
    let Shared { mut points, mut z, mut is_fixed, metric } = shared;
    let vertices = points.len() + parts.iter().map(Part::own).sum::<usize>();
    let count = parts.iter().map(|part| part.surface.mesh.triangles().len()).sum::<usize>();
    memory::ensure(TRIANGLE_BYTES * count)?;
    points.reserve_exact(vertices - points.len());
    z.reserve_exact(vertices - z.len());
    is_fixed.reserve_exact(vertices - is_fixed.len());
    let mut triangles: Vec<Triangle> = Vec::with_capacity(count);
    let mut borders: HashMap<(u32, u32), u32> = HashMap::new();
    for Part { surface: part, shared } in parts {
        let mut numbers = vec![NONE; part.z.len()];
        shared.iter().for_each(|&(v, whole)| numbers[v as usize] = whole);
        for (v, number) in numbers.iter_mut().enumerate().filter(|(_, number)| **number == NONE) {
            *number = points.len() as u32;
            points.push(part.mesh.point(v as u32));
            z.push(part.z[v]);
            is_fixed.push(part.is_fixed[v]);
        }
        let first = triangles.len() as u32;
        let twin = |h: u32| if h == NONE { NONE } else { h + (first << 2) };
        let start = triangles.len();
        let renumbered = part.mesh.triangles().iter().map(|t| t.renumbered(|v| numbers[v as usize], twin));
        triangles.extend(renumbered);
        for t in start..triangles.len() {
            for k in 0..3 {
                if triangles[t].twin[k] != NONE {
                    continue;
                }
                let (a, b) = (triangles[t].v[k], triangles[t].v[(k + 1) % 3]);
                let h = half_edge(t as u32, k as u32);
                match borders.remove(&(b, a)) {
                    Some(g) => {
                        triangles[t].twin[k] = g;
                        triangles[triangle_of(g) as usize].twin[(g & 3) as usize] = h;
                    }
                    None => {
                        borders.insert((a, b), h);
                    }
                }
            }
        }
    }
    Ok(Surface { mesh: Mesh::of_parts(points, triangles, metric), z, is_fixed })
}

/// Makes ordinary edges of the seams, and the mesh Delaunay again; returns the triangles
/// that touch a former seam or have changed.
pub fn release_seams(mesh: &mut Mesh) -> Vec<u32> {
    let is_seam = |h: &u32| mesh.triangle(triangle_of(*h)).is_seam((*h & 3) as usize);
    let seams: Vec<u32> = mesh.half_edges().filter(is_seam).collect();
    seams.iter().for_each(|&h| mesh.release(h));
    let mut touched: Vec<u32> = seams.iter().map(|&h| triangle_of(h)).collect();
    touched.extend(mesh.make_delaunay_from(seams));
    touched
}
