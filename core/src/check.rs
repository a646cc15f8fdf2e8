//! Proof that a mesh is what it claims to be.

use crate::mesh::{half_edge, next, triangle_of, Mesh, NONE};
use crate::predicate::orient2d;

/// How many of the mesh's properties were tested, and the first that fails.
///
/// Tests: positive orientation, twins that agree in both directions, constraints
/// marked on both sides, Euler's formula for a disc, the exact sum of the areas,
/// and (if `delaunay`) that no unconstrained edge can be flipped for the better.
pub fn check(mesh: &Mesh, delaunay: bool) -> Result<(), String> {
    let triangles = mesh.triangles().len();
    let mut border = 0usize;
    let mut twice_area = 0i128;
    let mut used = vec![false; mesh.points().len()];
    let (mut min, mut max) = (mesh.point(0), mesh.point(0));
    for t in 0..triangles as u32 {
        let [a, b, c] = mesh.corners(t);
        let area = orient2d(a, b, c);
        if area <= 0 {
            return Err(format!("triangle {t} has twice the area {area}"));
        }
        twice_area += i128::from(area);
        for p in [a, b, c] {
            min = crate::predicate::Point { x: min.x.min(p.x), y: min.y.min(p.y) };
            max = crate::predicate::Point { x: max.x.max(p.x), y: max.y.max(p.y) };
        }
        for k in 0..3 {
            let h = half_edge(t, k);
            used[mesh.origin(h) as usize] = true;
            let g = mesh.twin(h);
            if g == NONE {
                border += 1;
                continue;
            }
            if mesh.twin(g) != h
                || mesh.origin(g) != mesh.origin(next(h))
                || mesh.origin(next(g)) != mesh.origin(h)
            {
                return Err(format!("edge {k} of triangle {t} and its twin disagree"));
            }
            if mesh.is_constrained(g) != mesh.is_constrained(h) {
                return Err(format!("edge {k} of triangle {t} is constrained on one side only"));
            }
            if !mesh.is_constrained(h)
                && mesh.triangle(t).is_void() != mesh.triangle(triangle_of(g)).is_void()
            {
                return Err(format!("edge {k} of triangle {t} parts void from data but is not constrained"));
            }
            if delaunay && mesh.is_illegal(h) {
                return Err(format!("edge {k} of triangle {t} is not Delaunay"));
            }
        }
    }
    if used.contains(&false) {
        return Err("a vertex belongs to no triangle".into());
    }
    // V - E + F = 1 for a disc, with 3 F = 2 E - border.
    let edges = (3 * triangles + border) / 2;
    if mesh.points().len() + triangles != edges + 1 {
        return Err("Euler's formula does not hold".into());
    }
    let box_area = i128::from(max.x - min.x) * i128::from(max.y - min.y) * 2;
    if twice_area != box_area {
        return Err(format!("the triangles cover {twice_area} of {box_area}"));
    }
    Ok(())
}
