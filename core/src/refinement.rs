//! The refinement of a raster, in one piece or in tiles.

use crate::error::Result;
use crate::grid::Height;
use crate::image::Image;
use crate::ladder::{End, Ladder};
use crate::order::by_place;
use crate::progress::Progress;
use crate::refine::Refiner;
use crate::rule::{Rule, Stop};
use crate::surface::Surface;
use crate::tiling::Tiling;

/// A surface that is being refined, over one image after the other.
pub enum Refinement<'t> {
    Whole(Box<Refiner>),
    Tiled(Box<Ladder<'t>>),
}

impl<'t> Refinement<'t> {
    /// In the tiles whose seams the surface has. Errors: `out-of-memory`.
    pub fn new(surface: Surface, tiling: &'t Tiling) -> Result<Self> {
        if tiling.count() == 1 {
            return Ok(Refinement::Whole(Box::new(Refiner::new(surface))));
        }
        Ok(Refinement::Tiled(Box::new(Ladder::new(surface, tiling)?)))
    }

    /// Number of vertices that carry a height.
    pub fn count(&self) -> usize {
        match self {
            Refinement::Whole(refiner) => refiner.count(),
            Refinement::Tiled(ladder) => ladder.count(),
        }
    }

    /// [`Refiner::run`] or [`Ladder::refine`]. Errors: `out-of-memory`, `cancelled`.
    pub fn refine<T: Height>(
        &mut self,
        image: &Image<T>,
        rule: &Rule,
        (max_points, end): (usize, End),
        progress: &mut Progress,
    ) -> Result<Stop> {
        match self {
            Refinement::Whole(refiner) => refiner.run(image, rule, max_points, progress),
            Refinement::Tiled(ladder) => ladder.refine(image, rule, (max_points, end), progress),
        }
    }

    /// [`Ladder::finish`]; what is in one piece has no edges where tiles meet. Errors: `out-of-memory`, `cancelled`.
    pub fn finish(self, is_ordered: bool, progress: &mut Progress) -> Result<(Surface, Vec<u32>)> {
        match self {
            Refinement::Whole(mut refiner) => {
                if is_ordered {
                    by_place(&mut refiner.surface, progress)?;
                }
                Ok((refiner.surface, Vec::new()))
            }
            Refinement::Tiled(ladder) => ladder.finish(is_ordered, progress),
        }
    }
}
