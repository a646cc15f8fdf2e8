//! Chains with fewer corners, from which no data are cut off.

use crate::error::Result;
use crate::progress::Progress;

/// A directed polyline of pixel centres (column, row), data on its positive side;
/// closed if it ends where it starts.
pub type Chain = Vec<(i32, i32)>;

type Vector = (i64, i64);

fn cross(u: Vector, v: Vector) -> i64 {
    u.0 * v.1 - u.1 * v.0
}

fn minus(p: (i32, i32), q: (i32, i32)) -> Vector {
    (i64::from(p.0 - q.0), i64::from(p.1 - q.1))
}

/// The chain with the fewest corners whose chords cut off no data and keep within
/// `tolerance` pixels of it.
///
/// Up to a tolerance of 1 all void pixel centres stay strictly outside: as no pixel
/// centre lies between a chord and its chain, the chords of all chains cannot cross.
/// Beyond 1 a chord may take in void pixels that are within the tolerance of a valid
/// one, and chords may cross.
pub fn simplify(chain: &Chain, tolerance: f64, progress: &mut Progress) -> Result<Chain> {
    if tolerance == 0.0 {
        return Ok(chain.clone());
    }
    let corners = if chain.first() == chain.last() { from_extreme(chain) } else { chain.clone() };
    let n = corners.len();
    // Fewest segments from corner 0 to each corner, and the corner before it.
    let mut best = vec![(usize::MAX, 0usize); n];
    best[0].0 = 0;
    for i in 0..n - 1 {
        let count = best[i].0 + 1;
        let mut work = 16;
        reach_strictly(&corners, i, |j| {
            work += 1;
            if count < best[j].0 && (tolerance >= 1.0 || is_within(&corners[i..=j], tolerance)) {
                best[j] = (count, i);
            }
        });
        if tolerance > 1.0 {
            // A point of the chain is at most sqrt(1/2) from a pixel of it.
            let reach = (tolerance * tolerance - 0.5).sqrt();
            reach_within(&corners, i, reach, |j| {
                work += 1;
                if count < best[j].0 {
                    work += j - i;
                    if is_outer(&corners[i..=j]) && is_within(&corners[i..=j], reach) {
                        best[j] = (count, i);
                    }
                }
            });
        }
        progress.poll(work, || i as f64 / n as f64)?;
    }
    let mut kept = vec![corners[n - 1]];
    let mut at = n - 1;
    while at > 0 {
        at = best[at].1;
        kept.push(corners[at]);
    }
    kept.reverse();
    Ok(kept)
}

/// The ring starting at its first corner in (column, row) order, where it must bend.
fn from_extreme(ring: &Chain) -> Chain {
    let open = &ring[..ring.len() - 1];
    let start = (0..open.len()).min_by_key(|&i| open[i]).unwrap_or(0);
    let mut turned: Chain = open[start..].iter().chain(&open[..start]).copied().collect();
    turned.push(turned[0]);
    turned
}

/// Whether the chain has a chord and no corner beyond it.
fn is_outer(chain: &[(i32, i32)]) -> bool {
    let chord = minus(chain[chain.len() - 1], chain[0]);
    chord != (0, 0) && chain.iter().all(|&p| cross(chord, minus(p, chain[0])) >= 0)
}

/// Whether all corners of the chain are within `reach` of the chord between its ends.
fn is_within(chain: &[(i32, i32)], reach: f64) -> bool {
    let float = |v: Vector| (v.0 as f64, v.1 as f64);
    let chord = float(minus(chain[chain.len() - 1], chain[0]));
    let length2 = chord.0 * chord.0 + chord.1 * chord.1;
    chain.iter().all(|&p| {
        let p = float(minus(p, chain[0]));
        let share = ((p.0 * chord.0 + p.1 * chord.1) / length2.max(1.0)).clamp(0.0, 1.0);
        (p.0 - share * chord.0).hypot(p.1 - share * chord.1) <= reach
    })
}

/// Calls `visit(j)` for every corner j > i that a chord from corner i can reach: the
/// corners between are on or left of it, the void pixels beside the chain right of it.
fn reach_strictly(corners: &Chain, i: usize, mut visit: impl FnMut(usize)) {
    let from = |p: (i32, i32)| minus(p, corners[i]);
    // Directions between `void` (excluded) and `data` (included) remain.
    let (mut data, mut void): (Option<Vector>, Option<Vector>) = (None, None);
    for j in i + 1..corners.len() {
        for q in voids_beside(corners[j - 1], corners[j]).map(from) {
            if void.is_none_or(|v| cross(v, q) > 0) {
                void = Some(q);
            }
        }
        let p = from(corners[j]);
        let is_open =
            |v: Vector| void.is_none_or(|q| cross(q, v) > 0) && data.is_none_or(|d| cross(v, d) >= 0);
        if j == i + 1 || is_open(p) {
            visit(j);
        }
        if data.is_none_or(|d| cross(p, d) > 0) {
            data = Some(p);
        }
        if let (Some(d), Some(q)) = (data, void) {
            if cross(q, d) <= 0 {
                return;
            }
        }
    }
}

/// Calls `visit(j)` for every corner j > i up to the one from which on no line from
/// corner i passes all corners on their outer side within `reach`.
fn reach_within(corners: &Chain, i: usize, reach: f64, mut visit: impl FnMut(usize)) {
    type Direction = (f64, f64);
    let cross = |u: Direction, v: Direction| u.0 * v.1 - u.1 * v.0;
    // The directions left, from `low` turning towards `high`.
    let mut wedge: Option<(Direction, Direction)> = None;
    for (j, &corner) in corners.iter().enumerate().skip(i + 1) {
        visit(j);
        let p = minus(corner, corners[i]);
        let high = (p.0 as f64, p.1 as f64);
        let sine = reach / high.0.hypot(high.1);
        if sine >= 1.0 {
            continue;
        }
        let cosine = (1.0 - sine * sine).sqrt();
        let low = (high.0 * cosine + high.1 * sine, high.1 * cosine - high.0 * sine);
        let (low, high) = wedge.map_or((low, high), |(l, h)| {
            (if cross(l, low) > 0.0 { low } else { l }, if cross(high, h) > 0.0 { high } else { h })
        });
        if cross(low, high) < 0.0 {
            return;
        }
        wedge = Some((low, high));
    }
}

/// The pixels right of the first and the last step of the straight run from `a` to `b`.
fn voids_beside(a: (i32, i32), b: (i32, i32)) -> [(i32, i32); 2] {
    let (dx, dy) = ((b.0 - a.0).signum(), (b.1 - a.1).signum());
    let (rx, ry) = (dy, -dx);
    if dx == 0 || dy == 0 {
        [(a.0 + rx, a.1 + ry), (b.0 + rx, b.1 + ry)]
    } else {
        [(a.0 + (rx + dx) / 2, a.1 + (ry + dy) / 2), (b.0 + (rx - dx) / 2, b.1 + (ry - dy) / 2)]
    }
}
