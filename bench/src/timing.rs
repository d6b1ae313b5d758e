//! Wall-clock times of repeated work.

use std::time::Instant;

use serde::Serialize;

/// Seconds of several runs of the same work.
#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct Seconds {
    pub(crate) min: f64,
    pub(crate) median: f64,
    pub(crate) max: f64,
}

/// Seconds of one run.
pub(crate) fn once(work: impl FnOnce()) -> f64 {
    let start = Instant::now();
    work();
    start.elapsed().as_secs_f64()
}

impl Seconds {
    /// The summary of measured times.
    pub(crate) fn of(mut times: Vec<f64>) -> Seconds {
        times.sort_by(f64::total_cmp);
        let at = |i: usize| times.get(i).copied().unwrap_or(f64::NAN);
        Seconds { min: at(0), median: at(times.len() / 2), max: at(times.len().saturating_sub(1)) }
    }
}
