//! The vertices along the seams between tiles, from the pixels on the seams alone.

use crate::error::Result;
use crate::grid::Height;
use crate::image::Image;
use crate::mesh::{half_edge, triangle_of, Class, NONE};
use crate::predicate::Point;
use crate::progress::Progress;
use crate::rule::{quantile_index, Rule};
use crate::surface::Surface;
use crate::threads::spread;
use crate::tiling::Tiling;

/// An edge on a seam: along a row or a column of pixels from its first end to its second.
#[derive(Clone, Copy)]
struct Edge {
    ends: [(usize, usize); 2],
    z: [f64; 2],
    split: Split,
}

/// What the image says about splitting an edge.
#[derive(Clone, Copy)]
enum Split {
    /// It has not been looked at.
    Unknown,
    /// It is within its share of the tolerance.
    Within,
    /// By this priority, and at this pixel.
    At(f64, (usize, usize)),
}

/// A pixel on a seam that has become a vertex.
#[derive(Clone, Copy, Debug)]
pub struct SeamPoint {
    pub pixel: (usize, usize),
    pub z: f64,
    pub tiles: [usize; 2],
}

/// The edges that may still be split.
pub struct Seams {
    edges: Vec<Edge>,
}

/// Seams are held to this share of the tolerance: at the full one they would bound slivers,
/// at less they would take more points than they save.
const SHARE: f64 = 0.7;

/// Edges that one thread splits in a row.
const AT_ONCE: usize = 16;

/// Pixels of a triangle for one pixel of its side, squared: those of an equilateral one.
const AREA: f64 = 0.43;

impl Seams {
    /// The edges between tiles beside terrain. Where the surface is fixed there is nothing to
    /// refine, and only an edge along pixels has any on it.
    pub fn new(surface: &Surface, tiling: &Tiling) -> Self {
        let mesh = &surface.mesh;
        let is_data = |h: u32| mesh.triangle(triangle_of(h)).class() == Class::Data;
        let mut edges = Vec::new();
        for h in (0..mesh.triangles().len() as u32).flat_map(|t| [0, 1, 2].map(|k| half_edge(t, k))) {
            let twin = mesh.twin(h);
            if twin == NONE || twin < h || mesh.is_hard(h) || !(is_data(h) || is_data(twin)) {
                continue;
            }
            let tile = |h: u32| tiling.tile_of(mesh.corners(triangle_of(h)));
            if tile(h) == tile(twin) {
                continue;
            }
            let ends = [mesh.origin(h), mesh.dest(h)];
            if let Some(edge) = Edge::new(ends.map(|v| mesh.point(v)), ends.map(|v| surface.z[v as usize])) {
                edges.push(edge);
            }
        }
        Seams { edges }
    }

    /// How many edges there are.
    pub fn count(&self) -> usize {
        self.edges.len()
    }

    /// Another image or another rule follows.
    pub fn start_again(&mut self) {
        self.edges.iter_mut().for_each(|edge| edge.split = Split::Unknown);
    }

    /// Splits edges whose priority is over its share of `level` and that are beyond theirs of
    /// the tolerance, until none is left or there are `most` new vertices; these in the order
    /// they were found.
    pub fn refine<T: Height>(
        &mut self,
        image: &Image<T>,
        rule: &Rule,
        level: f64,
        tiling: &Tiling,
        most: usize,
        progress: &mut Progress,
    ) -> Result<Vec<SeamPoint>> {
        let split =
            |edges: &[Edge], most: usize| split_up(edges, (image, rule), (SHARE * level, most), tiling);
        let chunks = || self.edges.chunks(AT_ONCE);
        let parts = spread(progress, chunks(), |edges, progress| {
            progress.poll(edges.iter().map(Edge::length).sum::<usize>(), || 0.0)?;
            Ok(split(edges, most))
        })?;
        let (mut edges, mut found) = (Vec::new(), Vec::new());
        for (before, part) in chunks().zip(parts) {
            let left = most - found.len();
            let part = if part.1.len() > left { split(before, left) } else { part };
            edges.extend(part.0);
            found.extend(part.1);
        }
        self.edges = edges;
        Ok(found)
    }
}

/// The edges that some become when all over `level` are split, and the vertices between them, `most` of
/// them.
fn split_up<T: Height>(
    edges: &[Edge],
    (image, rule): (&Image<T>, &Rule),
    (level, most): (f64, usize),
    tiling: &Tiling,
) -> (Vec<Edge>, Vec<SeamPoint>) {
    let (mut done, mut found) = (Vec::new(), Vec::new());
    let (mut open, mut errors) = (edges.to_vec(), Vec::new());
    while let Some(mut edge) = open.pop() {
        if found.len() == most {
            done.push(edge);
            continue;
        }
        if let Split::Unknown = edge.split {
            edge.split = edge.candidate(image, rule, &mut errors);
        }
        let pixel = match edge.split {
            Split::At(priority, pixel) if priority > level => Some(pixel),
            _ => None,
        };
        match pixel.and_then(|pixel| Some((pixel, tiling.beside(pixel.0, pixel.1)?))) {
            None => done.push(edge),
            Some((pixel, tiles)) => {
                let z = image.on_seam(pixel.0, pixel.1);
                found.push(SeamPoint { pixel, z, tiles });
                let ([a, b], [za, zb]) = (edge.ends, edge.z);
                open.push(Edge::between([a, pixel], [za, z]));
                open.push(Edge::between([pixel, b], [z, zb]));
            }
        }
    }
    (done, found)
}

impl Edge {
    fn between(ends: [(usize, usize); 2], z: [f64; 2]) -> Self {
        Edge { ends, z, split: Split::Unknown }
    }

    /// The part of an edge of the mesh between its first and last pixel, if these are apart.
    fn new(p: [Point; 2], z: [f64; 2]) -> Option<Self> {
        let ends = [p[0].as_pixel(), p[1].as_pixel()];
        let [Some(a), Some(b)] = ends else { return None };
        let is_along = a.0 == b.0 || a.1 == b.1;
        let ascending = if a < b { Edge::between([a, b], z) } else { Edge::between([b, a], [z[1], z[0]]) };
        is_along.then_some(ascending)
    }

    /// How many pixels it takes from end to end.
    fn length(&self) -> usize {
        let [a, b] = self.ends;
        (b.0 - a.0).max(b.1 - a.1)
    }

    /// The pixel to split the edge at, if it is beyond its share of the tolerance.
    fn candidate<T: Height>(
        &self,
        image: &Image<T>,
        rule: &Rule,
        errors: &mut Vec<(f64, (usize, usize))>,
    ) -> Split {
        let ([a, b], length) = (self.ends, self.length());
        let (right, down) = (usize::from(b.0 > a.0), usize::from(b.1 > a.1));
        let slope = (self.z[1] - self.z[0]) / length as f64;
        errors.clear();
        for i in 1..length {
            let pixel = (a.0 + i * right, a.1 + i * down);
            let error = (image.on_seam(pixel.0, pixel.1) - self.z[0] - slope * i as f64).abs();
            if !error.is_nan() {
                errors.push((error, pixel));
            }
        }
        if errors.is_empty() {
            return Split::Within;
        }
        // The first of equal errors, as in a stable order.
        let order =
            |a: &(f64, (usize, usize)), b: &(f64, (usize, usize))| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
        let mut quantile = |q: f64| {
            let k = quantile_index(errors.len(), q);
            *errors.select_nth_unstable_by(k, order).1
        };
        let worst = quantile(1.0).0;
        let pixels = (AREA * (length * length) as f64).max(1.0);
        let priority = rule.priority_of(quantile(rule.priority).0, worst, pixels);
        if quantile(rule.bound).0 > SHARE * rule.tolerance {
            Split::At(priority, quantile(rule.candidate).1)
        } else {
            Split::Within
        }
    }
}
