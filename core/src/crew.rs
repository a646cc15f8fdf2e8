//! The tiles of a raster at work: all of them, or scouts alone, down to a level.

use crate::desk::Desk;
use crate::error::Result;
use crate::grid::Height;
use crate::image::{Image, View};
use crate::outlook::{Outlook, Waiting};
use crate::patch::Patch;
use crate::progress::Progress;
use crate::refine::Goal;
use crate::rule::Rule;
use crate::seams::SeamPoint;
use crate::threads::spread;
use crate::tiles::{Queued, Tile};
use crate::tiling::Tiling;
use crate::window::Window;
use std::sync::{Mutex, PoisonError};

/// One tile in so many goes ahead and tells how far it is for the others: to bring all tiles into the cache
/// once more would take longer.
pub const SCOUTS: usize = 8;

/// Where there are fewer tiles none does.
const FEWEST: usize = 2 * SCOUTS;

/// What is refined, and by which rule.
#[derive(Clone, Copy)]
pub struct Aim<'a, T: Height> {
    pub image: &'a Image<'a, T>,
    pub rule: &'a Rule,
    pub tiling: &'a Tiling,
}

/// How far the tiles go at a time.
#[derive(Clone, Copy)]
pub struct Rung<'a> {
    pub level: f64,
    /// New vertices at most, for each tile; `None` leaves it as it is.
    pub rooms: &'a [Option<usize>],
    /// Whether samples stand for large triangles no longer.
    pub is_exact: bool,
}

/// Who goes down a rung.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Party {
    Scouts,
    All,
}

impl Party {
    /// The share of the tiles.
    pub fn share(self) -> f64 {
        match self {
            Party::Scouts => 1.0 / SCOUTS as f64,
            Party::All => 1.0,
        }
    }

    /// Whether this tile is one of them: multiples of the golden ratio spread over all rows and columns of tiles.
    pub fn has(self, tile: usize) -> bool {
        self == Party::All || (tile as u32).wrapping_mul(0x9e37_79b9) < u32::MAX / SCOUTS as u32
    }
}

/// All tiles.
pub struct Crew {
    pub tiles: Vec<Tile>,
    /// Vertices on seams that they have not taken in yet, and their numbers in the whole.
    pub coming: Vec<Vec<(SeamPoint, u32)>>,
    /// Those at which no tile is at work.
    desks: Mutex<Vec<Desk>>,
}

impl Crew {
    pub fn new(tiles: Vec<Tile>) -> Self {
        Crew { coming: vec![Vec::new(); tiles.len()], tiles, desks: Mutex::default() }
    }

    /// Whether there are tiles enough to send some ahead.
    pub fn has_scouts(&self) -> bool {
        self.tiles.len() >= FEWEST
    }

    /// Vertices inside some of the tiles.
    pub fn inserted(&self, is_meant: impl Fn(usize) -> bool) -> usize {
        (0..).zip(&self.tiles).filter(|(i, _)| is_meant(*i)).map(|(_, tile)| tile.inserted()).sum()
    }

    /// What waits in each of them.
    pub fn waiting(&self) -> Vec<Waiting> {
        self.tiles.iter().map(|tile| tile.waiting.clone()).collect()
    }

    /// Whether nothing is left to do, at whatever level.
    pub fn is_done(&self) -> bool {
        let is_done = |tile: &Tile| tile.is_ready(false) && !tile.is_waiting();
        self.tiles.iter().all(is_done) && self.coming.iter().all(Vec::is_empty)
    }

    /// The level down to which all tiles take so many points.
    pub fn level_for(&self, outlook: &Outlook, waiting: &[Waiting], points: f64) -> f64 {
        // What the tiles that have a queue say goes for the others, too, which have inserted nothing.
        let known = self.tiles.iter().filter(|tile| tile.has_queue()).count();
        let (share, inserted) = (known as f64 / self.tiles.len() as f64, self.inserted(|_| true) as f64);
        outlook.level_for(share * (points + inserted) - inserted, waiting)
    }

    /// Points that each tile needs down to the level; one without a queue as many as the others have and need.
    pub fn needs(&self, outlook: &Outlook, waiting: &[Waiting], level: f64) -> Vec<f64> {
        let mut needs = outlook.needs(waiting, level);
        let known = needs.iter().zip(&self.tiles).filter(|(_, tile)| tile.has_queue());
        let all: Vec<f64> = known.map(|(need, tile)| need + tile.inserted() as f64).collect();
        let mean = all.iter().sum::<f64>() / all.len().max(1) as f64;
        let others = needs.iter_mut().zip(&self.tiles).filter(|(_, tile)| !tile.has_queue());
        others.for_each(|(need, _)| *need = mean);
        needs
    }

    /// Has those tiles fill their queues whose are not ready, and insert no more than what is coming. Errors: as
    /// [`Crew::descend`].
    pub fn queue<T: Height>(
        &mut self,
        aim: Aim<T>,
        party: Party,
        is_exact: bool,
        progress: &mut Progress,
    ) -> Result<()> {
        let rooms: Vec<_> = (0..self.tiles.len()).map(|i| party.has(i).then_some(0)).collect();
        self.descend(aim, Rung { level: f64::INFINITY, rooms: &rooms, is_exact }, progress)
    }

    /// One rung: the vertices that are coming, and in each tile what is over the level, but no more
    /// vertices than its room. Errors: `out-of-memory`, `cancelled`.
    pub fn descend<T: Height>(
        &mut self,
        aim: Aim<T>,
        Rung { level, rooms, is_exact }: Rung,
        progress: &mut Progress,
    ) -> Result<()> {
        let Aim { image, rule, tiling } = aim;
        let tiles = self.tiles.iter_mut().zip(&mut self.coming).zip(rooms);
        let is_busy = |tile: &Tile, points: &[_], room: usize| {
            room > 0 || !points.is_empty() || !tile.is_ready(is_exact)
        };
        let busy: Vec<_> = tiles
            .filter_map(|((tile, points), &room)| Some((tile, points, room?)))
            .filter(|(tile, points, room)| is_busy(tile, points, *room))
            .map(|(tile, points, room)| (tile, std::mem::take(points), room))
            .collect();
        // Where they work, the next ones do.
        let (idle, desks) = (Mutex::new(Vec::new()), &self.desks);
        spread(progress, busy.into_iter(), |(tile, points, room), progress| {
            let window = tiling.window(tile.number);
            let mut view = match idle.lock().unwrap_or_else(PoisonError::into_inner).pop() {
                Some(view) => view,
                None => image.view()?,
            };
            let mut desk = desks.lock().unwrap_or_else(PoisonError::into_inner).pop().unwrap_or_default();
            desk.lay(&mut tile.refiner)?;
            view.show(window, progress)?;
            let mut patch = tile.prepare(&view, (window, rule), tiling, &points, progress)?;
            if is_exact && tile.refiner.is_sampling() {
                tile.refiner.exact(&view, &patch, rule, progress)?;
            }
            let goal = Goal { points: tile.refiner.count().saturating_add(room), level };
            tile.refiner.refine(&view, &mut patch, rule, goal, progress)?;
            tile.refiner.note_samples();
            desk.clear(&mut tile.refiner)?;
            tile.waiting = tile.refiner.waiting();
            desks.lock().unwrap_or_else(PoisonError::into_inner).push(desk);
            idle.lock().unwrap_or_else(PoisonError::into_inner).push(view);
            Ok(())
        })?;
        Ok(())
    }
}

impl Tile {
    /// Whether its queue is that of the image, and without samples if it is to be exact.
    pub fn is_ready(&self, is_exact: bool) -> bool {
        matches!(self.queued, Queued::Now(_)) && !(is_exact && self.refiner.is_sampling())
    }

    pub fn has_queue(&self) -> bool {
        !matches!(self.queued, Queued::Nothing)
    }

    /// Whether it could go on.
    pub fn is_waiting(&self) -> bool {
        self.waiting.iter().any(|&(priority, _)| priority > 0.0)
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
