//! What waits in the queue.

use std::cmp::Ordering;

/// A triangle's candidate. Ordered by priority, then by pixel (first in raster
/// order wins), then by triangle, so that equal errors never leave a choice.
#[derive(Clone, Copy, Debug)]
pub struct Candidate {
    pub priority: f64,
    /// Number of the pixel to insert, in raster order, or of one near it.
    pub pixel: u32,
    pub triangle: u32,
    /// Version of the triangle the candidate was found for.
    pub version: u32,
    pub pick: Pick,
}

/// How the pixel to insert is to be found. (A number: an enumeration would take twice the memory.)
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pick(f32);

impl Pick {
    /// It is known.
    pub const KNOWN: Pick = Pick(-1.0);
    /// By a new scan of the triangle: its priority may have changed.
    pub const RESCAN: Pick = Pick(-2.0);

    /// It is the one with this error, 0 or more.
    pub fn by_error(error: f32) -> Self {
        Pick(error)
    }

    /// The error by which to find it, if that is the way.
    pub fn error(self) -> Option<f32> {
        (self.0 >= 0.0).then_some(self.0)
    }
}

impl Ord for Candidate {
    fn cmp(&self, other: &Self) -> Ordering {
        self.priority
            .total_cmp(&other.priority)
            .then_with(|| other.pixel.cmp(&self.pixel))
            .then_with(|| other.triangle.cmp(&self.triangle))
            .then_with(|| self.version.cmp(&other.version))
    }
}

impl PartialOrd for Candidate {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Candidate {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Candidate {}
