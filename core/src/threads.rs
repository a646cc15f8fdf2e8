//! Work spread over threads, with results that do not depend on their number.

use crate::error::{Error, Result};
use crate::progress::Progress;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::thread;
use std::time::Duration;

/// How often a caller with nothing left to do looks whether the run is cancelled.
const PATIENCE: Duration = Duration::from_millis(20);

/// What is worked on together of so many things that are done one by one.
pub fn chunks(count: usize) -> impl ExactSizeIterator<Item = Range<usize>> + Send {
    const CHUNK: usize = 1 << 10;
    let starts = 0..count.div_ceil(CHUNK);
    starts.map(move |i| i * CHUNK..count.min((i + 1) * CHUNK))
}

/// The results of `work` for every item, in the order of the items. As many threads as
/// `progress` allows take the items one after the other; the calling one is among them and
/// the only one to report. The first error in the order of the items, or a cancelled run,
/// stops all.
pub fn spread<I: Send, R: Send>(
    progress: &mut Progress,
    items: impl ExactSizeIterator<Item = I> + Send,
    work: impl Fn(I, &mut Progress) -> Result<R> + Sync,
) -> Result<Vec<R>> {
    let count = items.len();
    let helpers = progress.threads().min(count).saturating_sub(1);
    let (open, is_stopped, done) =
        (Mutex::new(items.enumerate()), AtomicBool::new(false), AtomicUsize::new(0));
    let take = || open.lock().unwrap_or_else(PoisonError::into_inner).next();
    let drain = |progress: &mut Progress| {
        let mut results = Vec::new();
        while !is_stopped.load(Ordering::Relaxed) {
            let Some((i, item)) = take() else { break };
            let result = work(item, progress);
            // What another thread has stopped is no result.
            if is_stopped.load(Ordering::Relaxed) && matches!(result, Err(Error::Cancelled)) {
                break;
            }
            is_stopped.fetch_or(result.is_err(), Ordering::Relaxed);
            done.fetch_add(1, Ordering::Relaxed);
            results.push((i, result));
        }
        results
    };
    let caller = thread::current();
    let within = |fraction: f64| (done.load(Ordering::Relaxed) as f64 + fraction) / count as f64;
    let mut results = thread::scope(|scope| {
        let started: Vec<_> = (0..helpers)
            .map_while(|_| {
                let job = || {
                    let results = drain(&mut Progress::new(&mut |_, _| !is_stopped.load(Ordering::Relaxed)));
                    caller.unpark();
                    results
                };
                // With fewer threads than asked for it only takes longer.
                thread::Builder::new().spawn_scoped(scope, job).ok()
            })
            .collect();
        progress.nested(&within, &is_stopped, |progress| {
            let mut results = drain(progress);
            for helper in started {
                while !helper.is_finished() {
                    thread::park_timeout(PATIENCE);
                    is_stopped.fetch_or(progress.check(0.0).is_err(), Ordering::Relaxed);
                }
                match helper.join() {
                    Ok(more) => results.extend(more),
                    Err(panic) => std::panic::resume_unwind(panic),
                }
            }
            results
        })
    });
    results.sort_unstable_by_key(|&(i, _)| i);
    if is_stopped.load(Ordering::Relaxed) {
        let error = results.into_iter().find_map(|(_, result)| result.err());
        return Err(error.unwrap_or(Error::Cancelled));
    }
    progress.check(1.0)?;
    results.into_iter().map(|(_, result)| result).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(
        threads: usize,
        report: &mut crate::progress::Callback,
        fail_at: Option<usize>,
    ) -> Result<Vec<usize>> {
        spread(&mut Progress::new(report).with_threads(threads), 0..100, |i, progress| {
            progress.check(0.5)?;
            match fail_at {
                Some(at) if at == i => Err(Error::input("no-area", "nothing")),
                _ => Ok(i * i),
            }
        })
    }

    #[test]
    fn results_come_in_the_order_of_the_items() {
        let expected: Vec<usize> = (0..100).map(|i| i * i).collect();
        for threads in [1, 2, 3, 8, 1000] {
            let mut last = 0.0;
            let found = run(
                threads,
                &mut |_, fraction| {
                    assert!(fraction >= last && fraction <= 1.0);
                    last = fraction;
                    true
                },
                None,
            );
            assert_eq!(found.ok(), Some(expected.clone()));
        }
        let none = spread(&mut Progress::new(&mut |_, _| true).with_threads(2), 0..0, |i, _| Ok(i));
        assert_eq!(none.ok(), Some(Vec::new()));
    }

    #[test]
    fn an_error_and_a_cancelled_run_stop_all() {
        for threads in [1, 2, 8] {
            for fail_at in [0, 50, 99] {
                let failed = run(threads, &mut |_, _| true, Some(fail_at));
                assert!(matches!(failed, Err(Error::Input { code: "no-area", .. })), "{failed:?}");
            }
            assert!(matches!(run(threads, &mut |_, _| false, None), Err(Error::Cancelled)));
        }
    }
}
