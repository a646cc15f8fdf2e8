//! Refinement in tiles: all of them down the same ladder of priorities.
//!
//! A stop by count has one level for the whole raster, not a density for each tile. What waits
//! in the tiles says about how many points each will take down to a level; every rung goes to
//! the level where they add up, and the next makes up for what the forecast was off. The last
//! points go in one at a time, by the priorities of all tiles.

use crate::error::Result;
use crate::grid::Height;
use crate::image::{Image, View};
use crate::outlook::{share_out, Outlook, Waiting};
use crate::patch::Patch;
use crate::predicate::Point;
use crate::progress::Progress;
use crate::refine::{Goal, Stop};
use crate::rule::Rule;
use crate::seams::{SeamPoint, Seams};
use crate::surface::Surface;
use crate::threads::spread;
use crate::tiles::{cut, merge, Part, Queued, Shared, Tile};
use crate::tiling::Tiling;
use crate::window::Window;
use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::sync::{Mutex, PoisonError};

/// Up to these shares of the points all tiles go down to one level; what is left then goes in one
/// at a time.
const NEARLY: [f64; 2] = [0.9, 0.99];
/// Where other scales follow, this share of a scale's points will do.
const ROUGHLY: f64 = 0.8;

/// Whether the tiles have to end on one level, or roughly so, because other scales follow.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    Level,
    Rough,
}

/// With this share of the points in place samples stand for large triangles no longer.
const CLOSE: f64 = 0.85;

/// A rung that would take less than this share of what is left does not pay.
const WORTH: f64 = 0.5;

/// How much a rung may multiply the points.
const GROWTH: f64 = 20.0;

/// Before the last rung a tile that takes more than expected must leave something for
/// errors that turn up elsewhere: all of them take at most this share of what is left.
const MOST_LEFT: f64 = 0.9;

/// How many times the points it is expected to need a tile may take on a rung.
const ROOM: f64 = 2.0;

/// Where more than so many times the points are to come, one tile in a few tells the first level.
const FAR: usize = 64;
const SCOUTS: usize = 8;

/// What the worst pixel rules keeps this share of the number of seam edges back for `repair`:
/// flips across released seams raise the largest error.
const REPAIR: f64 = 0.08;

/// What is refined, and by which rule.
#[derive(Clone, Copy)]
struct Aim<'a, T: Height> {
    image: &'a Image<'a, T>,
    rule: &'a Rule,
}

/// How far the tiles go at a time.
#[derive(Clone, Copy)]
struct Rung<'a> {
    level: f64,
    /// New vertices at most, for each tile; `None` leaves it as it is.
    rooms: &'a [Option<usize>],
    /// Whether samples stand for large triangles no longer.
    is_exact: bool,
}

pub struct Ladder<'t> {
    shared: Shared,
    tiles: Vec<Tile>,
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
        Ok(Ladder { shared, tiles, seams, tiling, outlook: None })
    }

    /// Number of vertices that carry a height.
    pub fn count(&self) -> usize {
        self.shared.count() + self.tiles.iter().map(Tile::inserted).sum::<usize>()
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
        for tile in &mut self.tiles {
            if let Queued::Now(frame) = tile.queued {
                tile.queued = Queued::Before(frame);
            }
        }
        self.seams.start_again();
        let aim = Aim { image, rule };
        if max_points < image.rows() * image.cols() {
            return self.count_down(aim, (max_points, end), progress);
        }
        let rooms = vec![Some(usize::MAX); self.tiles.len()];
        let points = self.refine_seams(aim, f64::NEG_INFINITY, usize::MAX, progress)?;
        let down = Rung { level: f64::NEG_INFINITY, rooms: &rooms, is_exact: false };
        self.descend(aim, down, points, progress)?;
        Ok(Stop::Tolerance)
    }

    /// The surface as it is now, in one piece, and the edges where tiles meet; seams stay. `is_ordered`:
    /// with triangles and vertices numbered by their place, in each tile for itself. Errors:
    /// `out-of-memory`, `cancelled`.
    pub fn finish(self, is_ordered: bool, progress: &mut Progress) -> Result<(Surface, Vec<u32>)> {
        let mut parts: Vec<Part> = self.tiles.into_iter().map(Part::from).collect();
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
        if self.tiles.iter().any(|tile| matches!(tile.queued, Queued::Nothing)) {
            let is_far = max_points / FAR > self.count();
            if is_far {
                self.queue(aim, SCOUTS, false, progress)?;
            }
            if !is_far || !self.tiles.iter().any(Tile::is_waiting) {
                self.queue(aim, 1, false, progress)?;
            }
        }
        let mut outlook = self.outlook.take().unwrap_or_else(|| Outlook::new(aim.rule));
        let mut last: Option<(usize, Vec<Waiting>)> = None;
        let stop = loop {
            let count = self.count();
            let repair = if aim.rule.is_max() { REPAIR * self.seams.count() as f64 } else { 0.0 } as usize;
            let max_points = max_points.saturating_sub(repair);
            let (most, before) = (max_points as f64, count as f64);
            if count >= max_points || end == End::Rough && before > ROUGHLY * most {
                break Stop::Points;
            }
            let is_exact = end == End::Level && before > CLOSE * most;
            let waiting: Vec<Waiting> = self.tiles.iter().map(|tile| tile.refiner.waiting()).collect();
            // Under infinite priorities no level lets anything through.
            let is_stuck = last.is_some_and(|(before, waited)| before == count && waited == waiting);
            let left = most - before;
            let target = match end {
                End::Level => {
                    NEARLY.map(|share| share * most).into_iter().find(|target| target - before > WORTH * left)
                }
                End::Rough => Some(most),
            };
            let Some(target) = target.filter(|_| !is_stuck) else {
                if self.tiles.iter().any(|tile| !tile.is_ready(is_exact)) {
                    self.queue(aim, 1, is_exact, progress)?;
                }
                break self.go_singly(aim, max_points, repair / 2, progress)?;
            };
            if self.tiles.iter().all(|tile| tile.is_ready(false)) && !self.tiles.iter().any(Tile::is_waiting)
            {
                break Stop::Tolerance;
            }
            let wanted = target.min(GROWTH * before) - before;
            progress.part([before / most, ((before + wanted) / most).min(1.0)]);
            // What the tiles that have a queue say goes for the others, too.
            let has_queue = |tile: &Tile| !matches!(tile.queued, Queued::Nothing);
            let part =
                self.tiles.iter().filter(|tile| has_queue(tile)).count() as f64 / self.tiles.len() as f64;
            let level = outlook.level_for(part * wanted, &waiting);
            let mut needs = outlook.needs(&waiting, level);
            let mean = needs.iter().sum::<f64>() / (part * needs.len() as f64);
            let others = needs.iter_mut().zip(&self.tiles).filter(|(_, tile)| !has_queue(tile));
            others.for_each(|(need, _)| *need = mean);
            let points = self.refine_seams(aim, level, (left / 8.0) as usize, progress)?;
            let left = max_points.saturating_sub(self.count());
            let room = match end {
                End::Level => ((ROOM * wanted) as usize).min((MOST_LEFT * left as f64) as usize) + 1,
                End::Rough => left,
            };
            let rooms: Vec<_> = share_out(room, &needs).into_iter().map(Some).collect();
            self.descend(aim, Rung { level, rooms: &rooms, is_exact }, points, progress)?;
            outlook.learn(&waiting, level, part * (self.count() - count) as f64);
            last = Some((count, waiting));
        };
        self.outlook = Some(outlook);
        Ok(stop)
    }

    /// Has one in `step` tiles fill its queue, and insert nothing.
    fn queue<T: Height>(
        &mut self,
        aim: Aim<T>,
        step: usize,
        is_exact: bool,
        progress: &mut Progress,
    ) -> Result<()> {
        let rooms: Vec<_> = (0..self.tiles.len()).map(|i| i.is_multiple_of(step).then_some(0)).collect();
        let rung = Rung { level: f64::INFINITY, rooms: &rooms, is_exact };
        self.descend(aim, rung, vec![Vec::new(); rooms.len()], progress)
    }

    /// Inserts one candidate at a time, the most urgent of all tiles, until there are `max_points`;
    /// up to so many `more` where the last ones have uncovered what is more urgent than they were.
    fn go_singly<T: Height>(
        &mut self,
        Aim { image, rule }: Aim<T>,
        max_points: usize,
        more: usize,
        progress: &mut Progress,
    ) -> Result<Stop> {
        let first = self.count();
        let mut count = first;
        // Priorities that are not negative sort as their bits do.
        let tops = self.tiles.iter_mut().enumerate();
        let mut tops: BinaryHeap<(u64, Reverse<usize>)> =
            tops.filter_map(|(i, tile)| Some((tile.refiner.top()?.to_bits(), Reverse(i)))).collect();
        let (mut view, mut patch) = (image.view()?, Patch::nothing());
        let mut level = u64::MAX;
        while let Some((top, Reverse(i))) = tops.pop() {
            if count >= max_points + more || count >= max_points && top <= level {
                return Ok(Stop::Points);
            }
            level = level.min(top);
            let tile = &mut self.tiles[i];
            let window = self.tiling.window(tile.number);
            let Queued::Now(frame) = tile.queued else { continue };
            let show = |view: &mut View<T>, patch: &mut Patch, corners: &[Point]| {
                let part = window.around(corners);
                view.show(part, progress)?;
                patch.cut(view, (window, frame), part)?;
                self.tiling.on_seams(part).chain(corners.iter().copied()).for_each(|p| patch.exclude(p));
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

    /// One rung: new seam vertices, and in each tile what is over the level, but no more
    /// vertices than its room.
    fn descend<T: Height>(
        &mut self,
        aim: Aim<T>,
        Rung { level, rooms, is_exact }: Rung,
        points: Vec<Vec<(SeamPoint, u32)>>,
        progress: &mut Progress,
    ) -> Result<()> {
        let (Aim { image, rule }, tiling) = (aim, self.tiling);
        let tiles = self.tiles.iter_mut().zip(points).zip(rooms);
        let is_busy = |tile: &Tile, points: &[_], room: usize| {
            room > 0 || !points.is_empty() || !tile.is_ready(is_exact)
        };
        let busy: Vec<_> = tiles
            .filter_map(|((tile, points), &room)| Some((tile, points, room?)))
            .filter(|(tile, points, room)| is_busy(tile, points, *room))
            .collect();
        // Their memory is used again.
        let idle = Mutex::new(Vec::new());
        spread(progress, busy.into_iter(), |(tile, points, room), progress| {
            let window = tiling.window(tile.number);
            let mut view = match idle.lock().unwrap_or_else(PoisonError::into_inner).pop() {
                Some(view) => view,
                None => image.view()?,
            };
            view.show(window, progress)?;
            let mut patch = tile.prepare(&view, (window, rule), tiling, &points, progress)?;
            if is_exact && tile.refiner.is_sampling() {
                tile.refiner.exact(&view, &patch, rule, progress)?;
            }
            let goal = Goal { points: tile.refiner.count().saturating_add(room), level };
            tile.refiner.refine(&view, &mut patch, rule, goal, progress)?;
            tile.refiner.note_samples();
            tile.refiner.compact();
            idle.lock().unwrap_or_else(PoisonError::into_inner).push(view);
            Ok(())
        })?;
        Ok(())
    }

    /// At most `most` new vertices on seams, numbered, for each of the tiles.
    fn refine_seams<T: Height>(
        &mut self,
        Aim { image, rule }: Aim<T>,
        level: f64,
        most: usize,
        progress: &mut Progress,
    ) -> Result<Vec<Vec<(SeamPoint, u32)>>> {
        let mut place = vec![usize::MAX; self.tiling.count()];
        self.tiles.iter().enumerate().for_each(|(i, tile)| place[tile.number] = i);
        let mut points = vec![Vec::new(); self.tiles.len()];
        for point in self.seams.refine(image, rule, level, self.tiling, most, progress)? {
            let number = self.shared.add(&point);
            for tile in point.tiles {
                if let Some(points) = points.get_mut(place[tile]) {
                    points.push((point, number));
                }
            }
        }
        Ok(points)
    }
}

impl Tile {
    /// Whether its queue is that of the image, and without samples if it is to be exact.
    fn is_ready(&self, is_exact: bool) -> bool {
        matches!(self.queued, Queued::Now(_)) && !(is_exact && self.refiner.is_sampling())
    }

    /// Whether it could go on.
    fn is_waiting(&self) -> bool {
        self.refiner.waiting().iter().any(|&(priority, _)| priority > 0.0)
    }

    /// The heights of the tile, after its new seam vertices have been inserted.
    fn prepare<T: Height>(
        &mut self,
        view: &View<T>,
        (window, rule): (Window, &Rule),
        tiling: &Tiling,
        points: &[(SeamPoint, u32)],
        progress: &mut Progress,
    ) -> Result<Patch> {
        let mut patch = match self.queued {
            Queued::Nothing => Patch::new(view, window),
            Queued::Before(frame) => Patch::again(view, window, frame),
            Queued::Now(frame) => Patch::framed(view, window, frame),
        }?;
        self.refiner.surface.mesh.warm();
        self.refiner.exclude_vertices(&mut patch);
        tiling.on_seams(window).for_each(|p| patch.exclude(p));
        if let Queued::Before(_) = self.queued {
            self.refiner.start_again(view, &patch, rule, progress)?;
        }
        let is_first = matches!(self.queued, Queued::Nothing);
        for &(SeamPoint { pixel, z, .. }, number) in points {
            let Some(place) = self.border(pixel) else { continue };
            let v = if !is_first {
                self.refiner.insert_at(view, &mut patch, rule, (pixel, z, place)).0
            } else {
                self.refiner.surface.insert_pixel(pixel, place, z)
            };
            self.share(v, number);
        }
        if is_first {
            self.refiner.start(view, &patch, rule, progress)?;
        }
        self.queued = Queued::Now(patch.frame());
        Ok(patch)
    }
}
