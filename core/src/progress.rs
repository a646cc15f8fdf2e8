//! How a run reports and is cancelled, `report(stage, fraction) -> bool` (false cancels), and
//! how many threads it may use.

use crate::error::{Error, Result};
use std::sync::atomic::{AtomicBool, Ordering};
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
    threads: usize,
    /// The part of the stage that fractions are of.
    part: [f64; 2],
}

impl<'a> Progress<'a> {
    pub fn new(report: &'a mut Callback<'a>) -> Self {
        Progress { report, stage: "", work: 0, last: Instant::now(), threads: 1, part: [0.0, 1.0] }
    }

    /// One thread unless told otherwise.
    pub fn with_threads(self, threads: usize) -> Self {
        Progress { threads, ..self }
    }

    pub fn threads(&self) -> usize {
        self.threads
    }

    /// Runs a part of a stage, on this thread alone: its fractions count as `within` says, and
    /// it is cancelled when `is_stopped`, too.
    pub fn nested<R>(
        &mut self,
        within: &dyn Fn(f64) -> f64,
        is_stopped: &AtomicBool,
        work: impl FnOnce(&mut Progress) -> R,
    ) -> R {
        let (report, stage, last) = (&mut *self.report, self.stage, self.last);
        let [from, to] = self.part;
        let mut inside = |stage, fraction| {
            report(stage, from + (to - from) * within(fraction)) && !is_stopped.load(Ordering::Relaxed)
        };
        work(&mut Progress { report: &mut inside, stage, work: 0, last, threads: 1, part: [0.0, 1.0] })
    }

    /// From here on fractions are of this part of the stage.
    pub fn part(&mut self, part: [f64; 2]) {
        self.part = part;
    }

    /// Enters a stage; cancels like [`Progress::poll`].
    pub fn stage(&mut self, name: &'static str) -> Result<()> {
        self.stage = name;
        self.part = [0.0, 1.0];
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
        let [from, to] = self.part;
        if (self.report)(self.stage, from + (to - from) * fraction.clamp(0.0, 1.0)) {
            Ok(())
        } else {
            Err(Error::Cancelled)
        }
    }
}
