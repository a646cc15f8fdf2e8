//! The mesh that refinement starts from: outline, breaklines and areas are edges of
//! it, and every triangle is data, level or void.

use crate::constrain::Constrainer;
use crate::crop::{crop_ring, crop_segment, signed_area, Vertex};
use crate::curve::insertion_order;
use crate::error::{Error, Result};
use crate::grid::{Grid, Height};
use crate::label::{Label, Labels, OUTLINE};
use crate::memory;
use crate::mesh::{half_edge, triangle_of, Class, Mesh, NONE};
use crate::outline::{outline, Shape};
use crate::predicate::{Metric, Point, UNIT};
use crate::progress::Progress;
use crate::scan::for_each_pixel;
use crate::surface::Surface;
use crate::tiling::Tiling;
use std::collections::HashMap;

/// Rings of vertices, the first one around all others.
pub type Polygon = Vec<Vec<Vertex>>;

/// What the TIN has to follow besides the data.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Constraints {
    /// Pixels (column, row) that are vertices from the start (P_I of Algorithm 1).
    pub pixels: Vec<(usize, usize)>,
    /// Points that keep their place and height.
    pub points: Vec<Vertex>,
    /// Breaklines. A vertex that has a height keeps it, and between two such the
    /// surface runs straight.
    pub lines: Vec<Vec<Vertex>>,
    /// If given, what lies outside is no data.
    pub clip: Option<Vec<Polygon>>,
    /// Areas to be kept level, at this height or (NaN) at the median of the data there.
    pub flat: Vec<(Polygon, f64)>,
}

/// The region inside the clip polygons.
const CLIP: u32 = OUTLINE + 1;
/// The first of the level areas.
const FIRST_FLAT: u32 = CLIP + 1;

/// What is to become vertices and edges, on the lattice.
struct Plan {
    right: f64,
    bottom: f64,
    points: Vec<Point>,
    /// Height that the point keeps, NaN for none.
    heights: Vec<f64>,
    numbers: HashMap<Point, u32>,
    segments: Vec<(u32, u32, Label)>,
}

impl Plan {
    /// The number of the lattice point; the first height given to it counts.
    fn point(&mut self, p: Point, z: f64) -> u32 {
        let number = *self.numbers.entry(p).or_insert_with(|| {
            self.points.push(p);
            self.heights.push(f64::NAN);
            self.points.len() as u32 - 1
        });
        let height = &mut self.heights[number as usize];
        if height.is_nan() {
            *height = z;
        }
        number
    }

    fn vertex(&mut self, [col, row, z]: Vertex) -> u32 {
        let unit = |v: f64, most: f64| (v.clamp(0.0, most) * f64::from(UNIT)).round() as i32;
        self.point(Point { x: unit(col, self.right), y: unit(row, self.bottom) }, z)
    }

    fn spot(&mut self, vertex: Vertex) {
        let vertex = rounded(vertex);
        if (0.0..=self.right).contains(&vertex[0]) && (0.0..=self.bottom).contains(&vertex[1]) {
            self.vertex(vertex);
        }
    }

    fn segment(&mut self, a: u32, b: u32, label: Label) {
        if a != b {
            self.segments.push((a, b, label));
        }
    }

    fn border(&mut self, border: &[Point]) {
        for pair in border.windows(2) {
            let [a, b] = [0, 1].map(|i| self.point(pair[i], f64::NAN));
            self.segment(a, b, Label::border(OUTLINE));
        }
    }

    fn line(&mut self, line: &[Vertex]) {
        for pair in line.windows(2) {
            let (a, b) = (rounded(pair[0]), rounded(pair[1]));
            if let Some((a, b)) = crop_segment(a, b, self.right, self.bottom) {
                let label =
                    Label { is_line: true, is_hard: !(a[2].is_nan() || b[2].is_nan()), ..Label::default() };
                let (a, b) = (self.vertex(a), self.vertex(b));
                self.segment(a, b, label);
            }
        }
    }

    fn seam(&mut self, seam: &[Point]) {
        for pair in seam.windows(2) {
            let [a, b] = [0, 1].map(|i| self.point(pair[i], f64::NAN));
            self.segment(a, b, Label { is_seam: true, ..Label::default() });
        }
    }

    fn polygon(&mut self, polygon: &[Vec<Vertex>], region: u32) {
        for (i, ring) in polygon.iter().enumerate() {
            let mut ring = crop_ring(ring, self.right, self.bottom);
            // The region lies inside the first ring and outside of the others.
            if (signed_area(&ring) > 0.0) != (i == 0) {
                ring.reverse();
            }
            let corners: Vec<u32> =
                ring.iter().map(|&[col, row, _]| self.vertex([col, row, f64::NAN])).collect();
            for (k, &to) in corners.iter().enumerate() {
                let from = corners[(k + corners.len() - 1) % corners.len()];
                self.segment(from, to, Label::border(region));
            }
        }
    }
}

/// The vertex moved to the lattice: a hair beyond the border must not count as outside.
fn rounded([col, row, z]: Vertex) -> Vertex {
    let unit = f64::from(UNIT);
    [(col * unit).round() / unit, (row * unit).round() / unit, z]
}

/// The mesh of all constraints over `grid`, with the heights that vertices keep.
///
/// Errors: `no-area` if the data span no area, `clip-outside` if nothing of them is
/// left inside the clip polygons.
pub fn domain<T: Height>(
    grid: &Grid<T>,
    metric: Metric,
    shape: &Shape,
    constraints: &Constraints,
    tiling: &Tiling,
    progress: &mut Progress,
) -> Result<Surface> {
    let mut plan = Plan {
        right: (grid.cols() - 1) as f64,
        bottom: (grid.rows() - 1) as f64,
        points: Vec::new(),
        heights: Vec::new(),
        numbers: HashMap::new(),
        segments: Vec::new(),
    };
    for border in outline(grid, shape, progress)? {
        plan.border(&border);
    }
    for polygon in constraints.clip.iter().flatten() {
        plan.polygon(polygon, CLIP);
    }
    for (region, (polygon, _)) in (FIRST_FLAT..).zip(&constraints.flat) {
        plan.polygon(polygon, region);
    }
    for &point in &constraints.points {
        plan.spot(point);
    }
    for line in &constraints.lines {
        plan.line(line);
        progress.poll(8 * line.len(), || 1.0)?;
    }
    // Last, so that it is the seams that bend where they pass close to a vertex.
    for seam in tiling.seams() {
        plan.seam(&seam);
    }
    let (mut mesh, labels, mut fixed) = build(grid, metric, plan, progress)?;
    let regions = regions(&mesh, &labels);
    let level_area = classify(&mut mesh, &regions, constraints.clip.is_some())?;
    settle(&mut mesh, &labels, &level_area);
    level(&mut mesh, grid, constraints, &level_area, &mut fixed);
    mesh.make_delaunay();
    Ok(Surface::new(mesh, fixed, grid))
}

fn build<T: Height>(
    grid: &Grid<T>,
    metric: Metric,
    plan: Plan,
    progress: &mut Progress,
) -> Result<(Mesh, Labels, Vec<f64>)> {
    memory::ensure(512 * plan.points.len() + 256 * plan.segments.len())?;
    let mut mesh = Mesh::rectangle(grid.cols(), grid.rows(), metric);
    let mut number = vec![NONE; plan.points.len()];
    for i in insertion_order(&plan.points) {
        let start = mesh.triangles().len() as u32 - 1;
        number[i] = mesh.insert(plan.points[i], start);
        progress.poll(256, || 0.0)?;
    }
    let mut fixed = vec![f64::NAN; mesh.points().len()];
    for (&v, z) in number.iter().zip(plan.heights) {
        fixed[v as usize] = z;
    }
    let mut constrainer = Constrainer::new(&mut mesh, fixed);
    let count = plan.segments.len();
    for (i, (a, b, label)) in plan.segments.into_iter().enumerate() {
        constrainer.insert(number[a as usize], number[b as usize], label);
        progress.poll(256, || i as f64 / count as f64)?;
    }
    let (labels, fixed) = constrainer.finish();
    Ok((mesh, labels, fixed))
}

/// How often the border of each region winds around a triangle, zeros left out.
type Winding = Vec<(u32, i32)>;

/// The distinct windings, and which of them each triangle has.
struct Regions {
    windings: Vec<Winding>,
    of: Vec<usize>,
}

/// Walks from the border of the raster, beyond which no region reaches, across all edges.
fn regions(mesh: &Mesh, labels: &Labels) -> Regions {
    let count = mesh.triangles().len() as u32;
    let mut made = Regions { windings: vec![Vec::new()], of: vec![usize::MAX; count as usize] };
    let mut numbers: HashMap<Winding, usize> = HashMap::from([(Vec::new(), 0)]);
    let mut across = |made: &mut Regions, from: usize, h: u32, sign: i32| {
        let label = if mesh.is_constrained(h) { labels.get(mesh.origin(h), mesh.dest(h)) } else { None };
        let Some(label) = label.filter(|label| !label.winding.is_empty()) else { return from };
        let mut winding = made.windings[from].clone();
        for (region, along) in label.winding {
            match winding.iter_mut().find(|w| w.0 == region) {
                Some(w) => w.1 += sign * along,
                None => winding.push((region, sign * along)),
            }
        }
        winding.retain(|w| w.1 != 0);
        winding.sort_unstable();
        *numbers.entry(winding.clone()).or_insert_with(|| {
            made.windings.push(winding);
            made.windings.len() - 1
        })
    };
    let mut stack = Vec::new();
    for h in (0..count).flat_map(|t| [0, 1, 2].map(|k| half_edge(t, k))) {
        let t = triangle_of(h) as usize;
        if mesh.twin(h) == NONE && made.of[t] == usize::MAX {
            made.of[t] = across(&mut made, 0, h, 1);
            stack.push(t as u32);
        }
    }
    while let Some(t) = stack.pop() {
        for h in (0..3).map(|k| half_edge(t, k)) {
            let beyond = mesh.twin(h);
            if beyond != NONE && made.of[triangle_of(beyond) as usize] == usize::MAX {
                let here = made.of[t as usize];
                made.of[triangle_of(beyond) as usize] = across(&mut made, here, h, -1);
                stack.push(triangle_of(beyond));
            }
        }
    }
    made
}

/// Sets the class of every triangle; returns the level area of each (`usize::MAX`: none).
fn classify(mesh: &mut Mesh, regions: &Regions, has_clip: bool) -> Result<Vec<usize>> {
    let kinds: Vec<(Class, usize)> = regions
        .windings
        .iter()
        .map(|winding| {
            let is_in = |region: u32| winding.iter().any(|w| w.0 == region && w.1 > 0);
            let flat = winding.iter().find(|w| w.0 >= FIRST_FLAT && w.1 > 0);
            match flat {
                _ if !is_in(OUTLINE) || has_clip && !is_in(CLIP) => (Class::Void, usize::MAX),
                Some(&(region, _)) => (Class::Flat, (region - FIRST_FLAT) as usize),
                None => (Class::Data, usize::MAX),
            }
        })
        .collect();
    for (t, &region) in regions.of.iter().enumerate() {
        mesh.set_class(t as u32, kinds[region].0);
    }
    if mesh.triangles().iter().all(|t| t.is_void()) {
        return Err(Error::input("clip-outside", "nothing of the DEM lies inside the clip polygons"));
    }
    Ok(regions.of.iter().map(|&region| kinds[region].1).collect())
}

/// Releases the borders of regions where both sides have become the same; what parts tiles
/// alone stays as a seam.
fn settle(mesh: &mut Mesh, labels: &Labels, level_area: &[usize]) {
    for h in (0..mesh.triangles().len() as u32).flat_map(|t| [0, 1, 2].map(|k| half_edge(t, k))) {
        let twin = mesh.twin(h);
        if twin < h || !mesh.is_constrained(h) {
            continue;
        }
        let label = labels.get(mesh.origin(h), mesh.dest(h)).unwrap_or_default();
        let kind = |h: u32| {
            let t = triangle_of(h);
            (h != NONE).then(|| (mesh.triangle(t).class(), level_area[t as usize]))
        };
        let (here, there) = (kind(h), kind(twin));
        let is_void = [here, there].iter().flatten().all(|k| k.0 == Class::Void);
        if is_void || here == there && !label.is_line {
            if label.is_seam {
                mesh.mark_seam(h);
            } else {
                mesh.release(h);
            }
        }
    }
}

/// Gives the vertices of each level area its height and makes its edges hard. Where
/// areas touch, the first counts.
fn level<T: Height>(
    mesh: &mut Mesh,
    grid: &Grid<T>,
    constraints: &Constraints,
    level_area: &[usize],
    fixed: &mut [f64],
) {
    let mut members: Vec<Vec<u32>> = vec![Vec::new(); constraints.flat.len()];
    for (t, &area) in level_area.iter().enumerate().filter(|(_, &area)| area != usize::MAX) {
        members[area].push(t as u32);
    }
    for ((_, given), members) in constraints.flat.iter().zip(members).rev() {
        let level = if given.is_nan() { median_height(mesh, grid, &members) } else { *given };
        for t in members {
            for h in (0..3).map(|k| half_edge(t, k)) {
                fixed[mesh.origin(h) as usize] = level;
                if mesh.is_constrained(h) {
                    mesh.harden(h);
                }
            }
        }
    }
}

/// Median of the pixels in the triangles, or of their corners if they hold none.
fn median_height<T: Height>(mesh: &Mesh, grid: &Grid<T>, triangles: &[u32]) -> f64 {
    let mut pixels = Vec::new();
    for &t in triangles {
        for_each_pixel(grid, mesh.corners(t), [0.0; 3], |col, row, z, _| {
            pixels.push(((row, col), z));
        });
    }
    // Those on edges are seen from both sides.
    pixels.sort_unstable_by_key(|&(pixel, _)| pixel);
    pixels.dedup_by_key(|&mut (pixel, _)| pixel);
    let mut heights: Vec<f64> = pixels.into_iter().map(|(_, z)| z).collect();
    if heights.is_empty() {
        let corners = triangles.iter().flat_map(|&t| mesh.corners(t));
        heights.extend(corners.map(|p| grid.interpolate(p)));
    }
    let middle = heights.len().saturating_sub(1) / 2;
    if heights.is_empty() {
        return f64::NAN;
    }
    *heights.select_nth_unstable_by(middle, f64::total_cmp).1
}
