//! Refinement in tiles: all of them down the same ladder of priorities.
//!
//! A stop by count has one level for the whole raster, not a density for each tile. What waits
//! in the tiles says about how many points each will take down to a level; every rung goes to
//! the level where they add up, and the next makes up for what the forecast was off. Scouts go
//! ahead on the way to tell that beforehand. The last points go in one at a time, by the priorities of all tiles.

use crate::crew::{Aim, Crew, Party, Rung};
use crate::error::Result;
use crate::grid::Height;
use crate::image::{Image, View};
use crate::outlook::{share_out, Outlook, Waiting};
use crate::patch::Patch;
use crate::predicate::Point;
use crate::progress::Progress;
use crate::rule::{Rule, Stop};
use crate::seams::Seams;
use crate::surface::Surface;
use crate::threads::spread;
use crate::tiles::{cut, merge, Part, Queued, Shared, Tile};
use crate::tiling::Tiling;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Up to these shares of the points all tiles go down to one level; what is left then goes in one
/// at a time.
const NEARLY: [f64; 2] = [0.75, 0.98];
/// Where other scales follow, this share of a scale's points will do.
const ROUGHLY: f64 = 0.8;

/// Whether the tiles have to end on one level, or roughly so, because other scales follow.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    Level,
    Rough,
}

impl End {
    /// How many points there are to be after the next rung for all, if one is worth it.
    fn target(self, before: f64, most: f64) -> Option<f64> {
        match self {
            End::Level => {
                NEARLY.map(|share| share * most).into_iter().find(|t| t - before > WORTH * (most - before))
            }
            End::Rough => Some(most),
        }
    }
}

/// A rung that would take less than this share of what is left does not pay.
const WORTH: f64 = 0.5;

/// How much a rung may multiply the points, of all tiles and where scouts go ahead.
const GROWTH: f64 = 20.0;
const GROWTH_AHEAD: f64 = 8.0;

/// Before the last rung a tile that takes more than expected must leave something for
/// errors that turn up elsewhere: all of them take at most this share of what is left.
const MOST_LEFT: f64 = 0.9;

/// How many times the points it is expected to need a tile may take on a rung.
const ROOM: f64 = 2.0;

/// Scouts go this share of the way to a rung's target before all tiles do, or nearly so far:
const AHEAD: f64 = 0.8;
const CLOSE: f64 = 0.9;
/// but where other scales follow only if there are more than so many times the points at the target.
const FAR: f64 = 3.0;

/// What the worst pixel rules keeps this share of the number of seam edges back for `repair`:
/// flips across released seams raise the largest error.
const REPAIR: f64 = 0.08;

pub struct Ladder<'t> {
    shared: Shared,
    crew: Crew,
    seams: Seams,
    tiling: &'t Tiling,
    /// From the first image on.
    outlook: Option<Outlook>,
}

impl<'t> Ladder<'t> {
    /// Errors: `out-of-memory`.
    pub fn new(surface: Surface, tiling: &'t Tiling) -> Result<Self> {
        let seams = Seams::new(&surface, tiling);
        let (shared, tiles) = cut(surface, tiling)?;
        Ok(Ladder { shared, crew: Crew::new(tiles), seams, tiling, outlook: None })
    }

    /// Number of vertices that carry a height.
    pub fn count(&self) -> usize {
        self.shared.count() + self.crew.inserted(|_| true)
    }

    /// Inserts pixels of another image until there are `max_points` vertices with a height or all
    /// is within the rule's tolerance. A few of the vertices are left for the repair of seams if the rule is
    /// the maximum. Errors: `out-of-memory`, `cancelled`.
    pub fn refine<T: Height>(
        &mut self,
        image: &Image<T>,
        rule: &Rule,
        (max_points, end): (usize, End),
        progress: &mut Progress,
    ) -> Result<Stop> {
        for tile in &mut self.crew.tiles {
            if let Queued::Now(frame) = tile.queued {
                tile.queued = Queued::Before(frame);
            }
        }
        self.seams.start_again();
        let aim = Aim { image, rule, tiling: self.tiling };
        if max_points < image.rows() * image.cols() {
            let stop = self.count_down(aim, (max_points, end), progress)?;
            // What a seam has got is missing in no tile.
            let late = self.crew.coming.iter().map(|points| (!points.is_empty()).then_some(0));
            let rooms: Vec<_> = late.collect();
            self.crew.descend(
                aim,
                Rung { level: f64::INFINITY, rooms: &rooms, is_exact: false },
                progress,
            )?;
            return Ok(stop);
        }
        let rooms = vec![Some(usize::MAX); self.crew.tiles.len()];
        self.refine_seams(aim, f64::NEG_INFINITY, usize::MAX, progress)?;
        let down = Rung { level: f64::NEG_INFINITY, rooms: &rooms, is_exact: false };
        self.crew.descend(aim, down, progress)?;
        Ok(Stop::Tolerance)
    }

    /// The surface as it is now, in one piece, and the edges where tiles meet; seams stay. `is_ordered`:
    /// with triangles and vertices numbered by their place, in each tile for itself. Errors:
    /// `out-of-memory`, `cancelled`.
    pub fn finish(self, is_ordered: bool, progress: &mut Progress) -> Result<(Surface, Vec<u32>)> {
        let mut parts: Vec<Part> = self.crew.tiles.into_iter().map(Part::from).collect();
        if is_ordered {
            spread(progress, parts.iter_mut(), |part, progress| part.order(progress))?;
        }
        merge(self.shared, parts, progress)
    }

    /// Refines down to `max_points`, or until nothing is left to do.
    fn count_down<T: Height>(
        &mut self,
        aim: Aim<T>,
        (max_points, end): (usize, End),
        progress: &mut Progress,
    ) -> Result<Stop> {
        progress.part([0.0, 0.0]);
        let has_scouts = self.crew.has_scouts();
        if has_scouts && !self.crew.tiles.iter().any(Tile::has_queue) {
            self.crew.queue(aim, Party::Scouts, false, progress)?;
        }
        // What waits from the image before tells of this one, too.
        if !self.crew.tiles.iter().any(Tile::is_waiting) {
            self.crew.queue(aim, Party::All, false, progress)?;
        }
        let mut outlook = self.outlook.take().unwrap_or_else(|| Outlook::new(aim.rule));
        let mut last: Option<(usize, Vec<Waiting>)> = None;
        // As many vertices as there would be if all tiles were where the scouts are, as long as these tell more.
        let mut ahead = has_scouts.then(|| self.count() as f64);
        let stop = loop {
            let count = self.count();
            let repair = if aim.rule.is_max() { REPAIR * self.seams.count() as f64 } else { 0.0 } as usize;
            let max_points = max_points.saturating_sub(repair);
            let (most, before) = (max_points as f64, count as f64);
            if count >= max_points || end == End::Rough && before > ROUGHLY * most {
                break Stop::Points;
            }
            let waiting = self.crew.waiting();
            // Under infinite priorities no level lets anything through.
            let is_stuck = last.take().is_some_and(|(before, waited)| before == count && waited == waiting);
            let target = end.target(before, most).filter(|_| !is_stuck);
            // Samples stand for large triangles no longer once the points are nearly there.
            let is_exact = end == End::Level && target.is_none_or(|target| target > NEARLY[0] * most);
            let Some(target) = target else {
                self.crew.queue(aim, Party::All, is_exact, progress)?;
                break self.go_singly(aim, max_points, repair / 2, progress)?;
            };
            if self.crew.is_done() {
                break Stop::Tolerance;
            }
            let near = before + AHEAD * (target - before);
            let is_far = end == End::Level || target > FAR * before;
            let (party, goal) = match ahead {
                Some(ahead) if is_far && ahead < CLOSE * near => {
                    (Party::Scouts, near.min(GROWTH_AHEAD * ahead))
                }
                _ => (Party::All, target.min(GROWTH * ahead.unwrap_or(before).max(before))),
            };
            let wanted = goal - before;
            progress.part([before / most, ((before + party.share() * wanted) / most).min(1.0)]);
            let level = self.crew.level_for(&outlook, &waiting, wanted);
            let needs = self.crew.needs(&outlook, &waiting, level);
            let on_seams = self.refine_seams(aim, level, (most - before) as usize / 8, progress)?;
            let left = max_points.saturating_sub(self.count());
            let room = match end {
                End::Level => ((ROOM * wanted) as usize).min((MOST_LEFT * left as f64) as usize) + 1,
                End::Rough => left,
            };
            let rooms = share_out(room, &needs).into_iter().enumerate();
            let rooms: Vec<_> = rooms.map(|(i, room)| party.has(i).then_some(room)).collect();
            // Those that had a queue tell how good the forecast was.
            let had_queue: Vec<bool> = self.crew.tiles.iter().map(Tile::has_queue).collect();
            let tells = |i: usize| had_queue[i] && party.has(i);
            let inserted = self.crew.inserted(tells);
            self.crew.descend(aim, Rung { level, rooms: &rooms, is_exact }, progress)?;
            let took = self.crew.inserted(tells) - inserted;
            let told: Vec<Waiting> =
                (0..).zip(&waiting).filter(|(i, _)| tells(*i)).map(|(_, w)| w.clone()).collect();
            let on_seams = on_seams as f64 * told.len() as f64 / waiting.len() as f64;
            outlook.learn(&told, level, took as f64 + on_seams);
            ahead = match party {
                Party::Scouts if took == 0 => None,
                Party::Scouts => {
                    let needs = self.crew.needs(&outlook, &self.crew.waiting(), level);
                    Some(self.count() as f64 + needs.iter().sum::<f64>())
                }
                Party::All => {
                    last = Some((count, waiting));
                    has_scouts.then(|| self.count() as f64)
                }
            };
        };
        self.outlook = Some(outlook);
        Ok(stop)
    }

    /// Inserts one candidate at a time, the most urgent of all tiles, until there are `max_points`;
    /// up to so many `more` where the last ones have uncovered what is more urgent than they were.
    fn go_singly<T: Height>(
        &mut self,
        Aim { image, rule, tiling }: Aim<T>,
        max_points: usize,
        more: usize,
        progress: &mut Progress,
    ) -> Result<Stop> {
        let first = self.count();
        let mut count = first;
        // Priorities that are not negative sort as their bits do.
        let tops = self.crew.tiles.iter_mut().enumerate();
        let mut tops: BinaryHeap<(u64, Reverse<usize>)> =
            tops.filter_map(|(i, tile)| Some((tile.refiner.top()?.to_bits(), Reverse(i)))).collect();
        let (mut view, mut patch) = (image.view()?, Patch::nothing());
        let mut level = u64::MAX;
        while let Some((top, Reverse(i))) = tops.pop() {
            if count >= max_points + more || count >= max_points && top <= level {
                return Ok(Stop::Points);
            }
            level = level.min(top);
            let tile = &mut self.crew.tiles[i];
            let window = tiling.window(tile.number);
            let Queued::Now(frame) = tile.queued else { continue };
            let show = |view: &mut View<T>, patch: &mut Patch, corners: &[Point]| {
                let part = window.around(corners);
                view.show(part, progress)?;
                patch.cut(view, (window, frame), part)?;
                tiling.on_seams(part).chain(corners.iter().copied()).for_each(|p| patch.exclude(p));
                Ok(())
            };
            let before = tile.inserted();
            let work = tile.refiner.step(&mut view, &mut patch, rule, show)?;
            count += tile.inserted() - before;
            tops.extend(tile.refiner.top().map(|top| (top.to_bits(), Reverse(i))));
            progress.poll(work, || (count - first) as f64 / (max_points + more - first) as f64)?;
        }
        Ok(Stop::Tolerance)
    }

    /// At most `most` new vertices on seams, for tiles to take in; returns how many.
    fn refine_seams<T: Height>(
        &mut self,
        Aim { image, rule, tiling }: Aim<T>,
        level: f64,
        most: usize,
        progress: &mut Progress,
    ) -> Result<usize> {
        let mut place = vec![usize::MAX; tiling.count()];
        self.crew.tiles.iter().enumerate().for_each(|(i, tile)| place[tile.number] = i);
        let points = self.seams.refine(image, rule, level, tiling, most, progress)?;
        for point in &points {
            let number = self.shared.add(point);
            for tile in point.tiles {
                if let Some(coming) = self.crew.coming.get_mut(place[tile]) {
                    coming.push((*point, number));
                }
            }
        }
        Ok(points.len())
    }
}
