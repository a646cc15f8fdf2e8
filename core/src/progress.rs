//! One progress protocol: `report(stage, fraction) -> bool`, false cancels.

use crate::error::{Error, Result};
use std::time::{Duration, Instant};

/// Work units (about one pixel visit each) between two looks at the clock.
const WORK_PER_LOOK: usize = 1 << 16;
/// How long the callback is left alone at least.
const INTERVAL: Duration = Duration::from_millis(40);

pub type Callback<'a> = dyn FnMut(&'static str, f64) -> bool + 'a;

/// Counts work and calls back at most every 40 ms.
pub struct Progress<'a> {
    report: &'a mut Callback<'a>,
    stage: &'static str,
    work: usize,
    last: Instant,
}

impl<'a> Progress<'a> {
    pub fn new(report: &'a mut Callback<'a>) -> Self {
        Progress { report, stage: "", work: 0, last: Instant::now() }
    }

    /// Enters a stage; cancels like [`Progress::poll`].
    pub fn stage(&mut self, name: &'static str) -> Result<()> {
        self.stage = name;
        self.call(0.0)
    }

    /// Adds `work` units; `fraction` of the stage is evaluated only when due.
    #[inline]
    pub fn poll(&mut self, work: usize, fraction: impl FnOnce() -> f64) -> Result<()> {
        self.work += work;
        if self.work < WORK_PER_LOOK {
            return Ok(());
        }
        self.work = 0;
        if self.last.elapsed() < INTERVAL {
            return Ok(());
        }
        self.call(fraction())
    }

    /// Reports at once, between two long steps that cannot poll.
    pub fn check(&mut self, fraction: f64) -> Result<()> {
        self.call(fraction)
    }

    fn call(&mut self, fraction: f64) -> Result<()> {
        self.last = Instant::now();
        if (self.report)(self.stage, fraction.clamp(0.0, 1.0)) {
            Ok(())
        } else {
            Err(Error::Cancelled)
        }
    }
}
