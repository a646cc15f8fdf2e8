//! Refinement in tiles: all of them down the same ladder of priorities.
//!
//! A stop by count has one level for the whole raster, not a density for each tile: every
//! rung lowers the level for all tiles, and on the last one the histories of the tiles say
//! together where it has to end.

use crate::error::Result;
use crate::grid::{Grid, Height};
use crate::patch::Patch;
use crate::progress::Progress;
use crate::refine::{Goal, Reached, Refiner, Rule, Stop};
use crate::seams::{SeamPoint, Seams};
use crate::surface::Surface;
use crate::threads::spread;
use crate::tiles::{cut, merge, Shared, Tile};
use crate::tiling::Tiling;

/// Rungs that are taken as they come may lead up to this share of the points.
const SURE: f64 = 0.93;

/// From this share on what is left is tried.
const ENOUGH: f64 = 0.85;

/// How much a rung may multiply the points.
const GROWTH: f64 = 6.0;

/// How far a rung goes down if nothing is known yet: count ~ level^-steepness.
const STEEPNESS: f64 = 2.0;

/// The least that a rung lowers the level.
const STEP: f64 = 0.98;

/// What every tile may grow by in a rung, however few its points.
const SLACK: usize = 16;

/// Refines the surface on `grid` to `max_points` vertices with a height or the rule's
/// tolerance, as [`Refiner::run`] does, in the tiles whose seams it has. Seams stay.
pub fn refine<T: Height>(
    surface: Surface,
    tiling: &Tiling,
    grid: &Grid<T>,
    rule: &Rule,
    max_points: usize,
    progress: &mut Progress,
) -> Result<(Surface, Stop)> {
    if tiling.count() == 1 {
        let mut refiner = Refiner::new(surface);
        let stop = refiner.run(grid, rule, max_points, progress)?;
        return Ok((refiner.surface, stop));
    }
    let seams = Seams::new(&surface, tiling);
    let (shared, tiles) = cut(surface, tiling)?;
    let mut ladder = Ladder { shared, tiles, seams, tiling, grid, rule };
    let stop = if max_points >= grid.rows() * grid.cols() {
        let rooms = vec![usize::MAX; ladder.tiles.len()];
        ladder.descend(f64::NEG_INFINITY, &rooms, usize::MAX, progress)?;
        Stop::Tolerance
    } else {
        ladder.count_down(max_points, progress)?
    };
    Ok((merge(ladder.shared, ladder.tiles)?, stop))
}

struct Ladder<'a, T> {
    shared: Shared,
    tiles: Vec<Tile>,
    seams: Seams,
    tiling: &'a Tiling,
    grid: &'a Grid<'a, T>,
    rule: &'a Rule,
}

/// What a tile would insert on a rung.
struct Trial {
    /// The lowest priority so far, after each vertex.
    history: Vec<f64>,
    is_cut_short: bool,
}

impl<T: Height> Ladder<'_, T> {
    fn count(&self) -> usize {
        self.shared.count() + self.tiles.iter().map(Tile::inserted).sum::<usize>()
    }

    /// How many vertices each tile may get: its share of `all`, by those it has, and `slack`.
    fn rooms(&self, all: f64, slack: usize) -> Vec<usize> {
        let counts: Vec<usize> = self.tiles.iter().map(|tile| tile.refiner.count()).collect();
        let share = all / counts.iter().sum::<usize>().max(1) as f64;
        counts.into_iter().map(|count| (share * count as f64) as usize + slack).collect()
    }

    fn largest_priority(&self) -> f64 {
        self.tiles.iter().fold(0.0, |most, tile| most.max(tile.refiner.largest_priority()))
    }

    /// Refines down to `max_points`, or until nothing is left to do.
    fn count_down(&mut self, max_points: usize, progress: &mut Progress) -> Result<Stop> {
        progress.part([0.0, 0.0]);
        // Nothing is inserted yet: all triangles are queued.
        self.descend(f64::INFINITY, &vec![0; self.tiles.len()], 0, progress)?;
        let (mut level, mut steepness) = (self.largest_priority(), STEEPNESS);
        let most = max_points as f64;
        loop {
            let count = self.count();
            if count >= max_points {
                return Ok(Stop::Points);
            }
            let waiting = self.largest_priority();
            if waiting == 0.0 {
                return Ok(Stop::Tolerance);
            }
            let before = count as f64;
            let room = SURE * most - before;
            let is_sure = before < ENOUGH * most && room > (self.tiles.len() * SLACK) as f64;
            let wanted = if is_sure { (SURE * most).min(GROWTH * before) } else { 1.02 * most };
            let lower = waiting * STEP.min((wanted / before).powf(-1.0 / steepness));
            // A tile that was held up on the last rung goes on first.
            let next = if waiting > level { level } else { lower };
            progress.part([before / most, (wanted / most).min(1.0)]);
            if is_sure {
                // All tiles and seams together must not take more than there is room for.
                let share = (2.0 * (wanted / before - 1.0)).min(0.7 * room / before);
                let slack = SLACK.min((0.15 * room / self.tiles.len() as f64) as usize);
                let rooms = self.rooms(share * before, slack);
                self.descend(next, &rooms, (0.15 * room) as usize, progress)?;
            } else {
                self.try_out(next, max_points - count, progress)?;
            }
            let grown = (self.count() as f64 / before).ln();
            // Where nothing came of it the next rung goes further.
            let observed = if grown > 0.0 { grown / (level / next).ln() } else { 0.5 * steepness };
            if next < level {
                steepness = observed.clamp(0.25, 100.0);
            }
            level = next;
        }
    }

    /// One rung: new seam vertices, at most `on_seams`, and in each tile what is over the
    /// level, but no more vertices than its room.
    fn descend(
        &mut self,
        level: f64,
        rooms: &[usize],
        on_seams: usize,
        progress: &mut Progress,
    ) -> Result<()> {
        let points = self.refine_seams(level, on_seams);
        let (grid, rule, tiling) = (self.grid, self.rule, self.tiling);
        spread(
            progress,
            self.tiles.iter_mut().zip(points).zip(rooms),
            |((tile, points), &room), progress| {
                let mut patch = tile.prepare(grid, rule, tiling, &points, progress)?;
                let goal = Goal { points: tile.refiner.count().saturating_add(room), level };
                tile.refiner.refine(grid, &mut patch, rule, goal, progress, |_| ())?;
                tile.refiner.compact();
                Ok(())
            },
        )?;
        Ok(())
    }

    /// The last rung: goes down to the level in copies of the tiles, and then in the tiles
    /// themselves as far as the `left` vertices reach that come first in all of them.
    fn try_out(&mut self, level: f64, left: usize, progress: &mut Progress) -> Result<()> {
        let rooms = self.rooms(4.0 * left as f64, SLACK);
        let points = self.refine_seams(level, left / 8);
        let left = left.saturating_sub(points.iter().map(Vec::len).sum::<usize>() / 2);
        let (grid, rule, tiling) = (self.grid, self.rule, self.tiling);
        let trials = spread(
            progress,
            self.tiles.iter_mut().zip(points).zip(rooms),
            |((tile, points), room), progress| {
                let mut patch = tile.prepare(grid, rule, tiling, &points, progress)?;
                let mut copy = tile.refiner.clone();
                let goal = Goal { points: copy.count() + room, level };
                let (mut history, mut lowest) = (Vec::new(), f64::INFINITY);
                let reached = copy.refine(grid, &mut patch, rule, goal, progress, |priority| {
                    lowest = lowest.min(priority);
                    history.push(lowest);
                })?;
                Ok(Trial { history, is_cut_short: reached == Reached::Points })
            },
        )?;
        let taken = first_of_all(&trials, left);
        spread(progress, self.tiles.iter_mut().zip(taken), |(tile, taken), progress| {
            let mut patch = tile.prepare(grid, rule, tiling, &[], progress)?;
            let goal = Goal { points: tile.refiner.count() + taken, level: f64::NEG_INFINITY };
            tile.refiner.refine(grid, &mut patch, rule, goal, progress, |_| ())?;
            tile.refiner.compact();
            Ok(())
        })?;
        Ok(())
    }

    /// At most `most` new vertices on seams, numbered, for each of the tiles.
    fn refine_seams(&mut self, level: f64, most: usize) -> Vec<Vec<(SeamPoint, u32)>> {
        let mut place = vec![usize::MAX; self.tiling.count()];
        self.tiles.iter().enumerate().for_each(|(i, tile)| place[tile.number] = i);
        let mut points = vec![Vec::new(); self.tiles.len()];
        for point in self.seams.refine(self.grid, self.rule, level, self.tiling, most) {
            let number = self.shared.add(&point);
            for tile in point.tiles {
                if let Some(points) = points.get_mut(place[tile]) {
                    points.push((point, number));
                }
            }
        }
        points
    }
}

/// How many vertices of each trial are among the first `left` of all, by priority; of equal
/// ones those of the first tile. What follows the end of one cut short is not known.
fn first_of_all(trials: &[Trial], left: usize) -> Vec<usize> {
    let ends = trials.iter().filter(|trial| trial.is_cut_short).filter_map(|trial| trial.history.last());
    let floor = ends.fold(0.0f64, |most, &end| most.max(end));
    let mut all: Vec<(f64, usize)> = (0..)
        .zip(trials)
        .flat_map(|(tile, trial)| trial.history.iter().map(move |&priority| (priority, tile)))
        .filter(|entry| entry.0 >= floor)
        .collect();
    all.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let mut taken = vec![0; trials.len()];
    all.iter().take(left).for_each(|&(_, tile)| taken[tile] += 1);
    taken
}

impl Tile {
    /// The heights of the tile, after its new seam vertices have been inserted.
    fn prepare<T: Height>(
        &mut self,
        grid: &Grid<T>,
        rule: &Rule,
        tiling: &Tiling,
        points: &[(SeamPoint, u32)],
        progress: &mut Progress,
    ) -> Result<Patch> {
        let window = tiling.window(self.number);
        let mut patch = self.refiner.patch(grid, window)?;
        tiling.on_seams(window).for_each(|p| patch.exclude(p));
        for &(SeamPoint { pixel, z, .. }, number) in points {
            let Some(place) = self.border(pixel) else { continue };
            let v = if self.is_started {
                self.refiner.insert_at(grid, &mut patch, rule, (pixel, z, place)).0
            } else {
                self.refiner.surface.insert_pixel(pixel, place, z)
            };
            self.share(v, number);
        }
        if !self.is_started {
            self.refiner.start(grid, &patch, rule, progress)?;
            self.is_started = true;
        }
        Ok(patch)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_of_all_trials_are_taken() {
        let trial = |history: &[f64], is_cut_short| Trial { history: history.to_vec(), is_cut_short };
        let trials = [trial(&[9.0, 4.0, 4.0, 1.0], false), trial(&[8.0, 4.0, 2.0], false)];
        assert_eq!(first_of_all(&trials, 3), [2, 1]);
        assert_eq!(first_of_all(&trials, 5), [3, 2]);
        assert_eq!(first_of_all(&trials, 100), [4, 3]);
        let short = [trial(&[9.0, 4.0, 4.0, 1.0], false), trial(&[8.0, 5.0], true)];
        assert_eq!(first_of_all(&short, 100), [1, 2]);
        assert!(first_of_all(&[], 4).is_empty());
    }
}
