//! A mesh whose vertices have heights.

use crate::curve::insertion_order;
use crate::error::Result;
use crate::grid::{Grid, Height};
use crate::image::Image;
use crate::memory::compact;
use crate::mesh::{half_edge, triangle_of, Mesh, NONE};
use crate::predicate::Point;
use crate::progress::Progress;
use crate::triangle::Location;

#[derive(Clone)]
pub struct Surface {
    pub mesh: Mesh,
    /// Height of every vertex; NaN for scaffolding that only void triangles use.
    pub z: Vec<f64>,
    /// Vertices that keep their height whatever the data are.
    pub is_fixed: Vec<bool>,
}

impl Surface {
    /// `fixed`: the height that each vertex has to keep, NaN where it takes that of
    /// `grid`.
    pub fn new<T: Height>(mesh: Mesh, fixed: Vec<f64>, grid: &Grid<T>) -> Self {
        let is_fixed: Vec<bool> = fixed.iter().map(|z| !z.is_nan()).collect();
        let mut surface = Surface { mesh, z: fixed, is_fixed };
        let mut is_used = vec![false; surface.z.len()];
        for v in surface.mesh.triangles().iter().filter(|t| !t.is_void()).flat_map(|t| t.v) {
            is_used[v as usize] = true;
        }
        for (v, is_used) in is_used.into_iter().enumerate() {
            surface.z[v] = match (is_used, surface.is_fixed[v]) {
                (false, _) => f64::NAN,
                (true, true) => surface.z[v],
                (true, false) => grid.interpolate(surface.mesh.point(v as u32)),
            };
        }
        surface
    }

    /// Gives every vertex that is free the height of the image. Errors: `out-of-memory`, `cancelled`.
    pub fn sample<T: Height>(&mut self, image: &Image<T>, progress: &mut Progress) -> Result<()> {
        let mut view = image.view()?;
        for ((z, p), is_fixed) in self.z.iter_mut().zip(self.mesh.points()).zip(&self.is_fixed) {
            if !z.is_nan() && !is_fixed {
                *z = view.interpolate(*p, progress)?;
            }
        }
        Ok(())
    }

    /// Some of the triangles, ascending, with what they stand on; and the vertices' numbers in the
    /// whole, ascending. `number`: that of a triangle of the whole among the members, if it is one.
    pub fn part(&self, members: &[u32], number: impl Fn(u32) -> Option<u32>) -> (Self, Vec<u32>) {
        let mesh = &self.mesh;
        let mut old: Vec<u32> = members.iter().flat_map(|&t| mesh.triangle(t).v).collect();
        old.sort_unstable();
        old.dedup();
        let vertex = |v: u32| old.binary_search(&v).unwrap_or(0) as u32;
        let twin = |h: u32| {
            let inside = if h == NONE { None } else { number(triangle_of(h)) };
            inside.map_or(NONE, |t| half_edge(t, h & 3))
        };
        let triangles = members.iter().map(|&t| mesh.triangle(t).renumbered(vertex, twin)).collect();
        let points = old.iter().map(|&v| mesh.point(v)).collect();
        let part = Surface {
            mesh: Mesh::of_parts(points, triangles, mesh.metric()),
            z: old.iter().map(|&v| self.z[v as usize]).collect(),
            is_fixed: old.iter().map(|&v| self.is_fixed[v as usize]).collect(),
        };
        (part, old)
    }

    /// Moves to the memory of another one, which is lost.
    pub fn move_to(&mut self, mut room: Surface) {
        self.mesh.move_to(room.mesh);
        room.z.clone_from(&self.z);
        room.is_fixed.clone_from(&self.is_fixed);
        (self.z, self.is_fixed) = (room.z, room.is_fixed);
    }

    /// A copy with little room to grow.
    pub fn compact(&self) -> Self {
        Surface { mesh: self.mesh.compact(), z: compact(&self.z), is_fixed: compact(&self.is_fixed) }
    }

    /// Vertices without data, which are in no output.
    pub fn count_scaffolding(&self) -> usize {
        self.z.iter().filter(|z| z.is_nan()).count()
    }

    /// Number of vertices that carry a height.
    pub fn count(&self) -> usize {
        self.z.len() - self.count_scaffolding()
    }

    /// Makes the pixels (column, row) of the image vertices, unless they lie outside the data.
    /// Errors: `out-of-memory`, `cancelled`.
    pub fn insert_pixels<T: Height>(
        &mut self,
        pixels: &[(usize, usize)],
        image: &Image<T>,
        progress: &mut Progress,
    ) -> Result<()> {
        let mut view = image.view()?;
        let points: Vec<Point> = pixels.iter().map(|&(col, row)| Point::pixel(col, row)).collect();
        for i in insertion_order(&points) {
            let place = self.mesh.locate(points[i], self.mesh.triangles().len() as u32 - 1);
            if self.mesh.is_in_data(place) {
                let z = view.interpolate(points[i], progress)?;
                self.insert_pixel(pixels[i], place, z);
            }
        }
        Ok(())
    }

    /// Heights of the corners of triangle `t`.
    pub fn heights(&self, t: u32) -> [f64; 3] {
        self.mesh.triangle(t).v.map(|v| self.z[v as usize])
    }

    /// Inserts a pixel of height `z`, whose place has been found; on a hard edge the vertex
    /// gets the height of the edge instead. Returns the vertex.
    pub fn insert_pixel(&mut self, (col, row): (usize, usize), place: Location, z: f64) -> u32 {
        let p = Point::pixel(col, row);
        let along = match place {
            Location::Edge(h) if self.mesh.is_hard(h) => {
                let [a, b] = [self.mesh.origin(h), self.mesh.dest(h)];
                let (pa, pb) = (self.mesh.point(a), self.mesh.point(b));
                Some(lerp((pa, self.z[a as usize]), (pb, self.z[b as usize]), p))
            }
            _ => None,
        };
        let v = self.mesh.insert_at(p, place);
        if v as usize == self.z.len() {
            self.z.push(along.unwrap_or(z));
            self.is_fixed.push(along.is_some());
        }
        v
    }
}

/// Height at `p`, on or beside the segment, of the straight line between two points
/// with heights.
pub fn lerp((a, za): (Point, f64), (b, zb): (Point, f64), p: Point) -> f64 {
    let (dx, dy) = (f64::from(b.x - a.x), f64::from(b.y - a.y));
    let along = f64::from(p.x - a.x) * dx + f64::from(p.y - a.y) * dy;
    let share = along / (dx * dx + dy * dy);
    za + share * (zb - za)
}
