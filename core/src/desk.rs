//! Where tiles are refined, one after the other: in memory that is in the cache and has room to grow. Between,
//! each lies in as little as it needs.

use crate::error::Result;
use crate::memory;
use crate::queue;
use crate::rank;
use crate::refine::{Refiner, VERTEX_BYTES};
use crate::surface::Surface;

#[derive(Default)]
pub struct Desk {
    queue: queue::Memory,
    ranker: rank::Memory,
    surface: Option<Surface>,
}

impl Desk {
    /// Has the refiner work here until [`Desk::clear`]. Errors: `out-of-memory`.
    pub fn lay(&mut self, refiner: &mut Refiner) -> Result<()> {
        memory::ensure(VERTEX_BYTES * refiner.surface.z.len())?;
        if let Some(room) = self.surface.take() {
            refiner.surface.move_to(room);
        }
        refiner.swap(&mut self.queue, &mut self.ranker);
        Ok(())
    }

    /// Has it lie elsewhere again. Errors: `out-of-memory`.
    pub fn clear(&mut self, refiner: &mut Refiner) -> Result<()> {
        memory::ensure(VERTEX_BYTES * refiner.surface.z.len())?;
        refiner.park();
        let compact = refiner.surface.compact();
        self.surface = Some(std::mem::replace(&mut refiner.surface, compact));
        refiner.swap(&mut self.queue, &mut self.ranker);
        Ok(())
    }
}
