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

/// Time spent: processor time of all threads of this process, where available, and time by the clock.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub(crate) struct Spent {
    processor: Option<f64>,
    clock: f64,
}

impl Spent {
    /// The processor's time, or the clock's if there is none.
    pub(crate) fn seconds(&self) -> f64 {
        self.processor.unwrap_or(self.clock)
    }

    /// The smaller of two, for each clock separately.
    pub(crate) fn least(self, other: Spent) -> Spent {
        let processor = self.processor.zip(other.processor).map(|(a, b)| a.min(b));
        Spent { processor, clock: self.clock.min(other.clock) }
    }

    /// The clock's time.
    pub(crate) fn clock(&self) -> f64 {
        self.clock
    }

    /// The processor's time, where available.
    pub(crate) fn processor(&self) -> Option<f64> {
        self.processor
    }
}

impl std::ops::Add for Spent {
    type Output = Spent;
    fn add(self, other: Spent) -> Spent {
        // If nothing is measured yet, the sum is the other value.
        let processor = match (self.processor, other.processor) {
            (None, only) if self.clock == 0.0 => only,
            (a, b) => a.zip(b).map(|(a, b)| a + b),
        };
        Spent { processor, clock: self.clock + other.clock }
    }
}

impl std::ops::AddAssign for Spent {
    fn add_assign(&mut self, other: Spent) {
        *self = *self + other;
    }
}

impl std::ops::Div<f64> for Spent {
    type Output = Spent;
    fn div(self, by: f64) -> Spent {
        Spent { processor: self.processor.map(|t| t / by), clock: self.clock / by }
    }
}

/// Measures [`Spent`] time.
pub(crate) struct Stopwatch {
    processor: Option<f64>,
    clock: Instant,
}

impl Stopwatch {
    /// Starts now.
    pub(crate) fn start() -> Stopwatch {
        Stopwatch { processor: processor_seconds(), clock: Instant::now() }
    }

    /// The time since.
    pub(crate) fn stop(self) -> Spent {
        let clock = self.clock.elapsed().as_secs_f64();
        Spent { processor: processor_seconds().zip(self.processor).map(|(now, then)| now - then), clock }
    }
}

/// Seconds that this process's threads have run, as Linux counts them to the nanosecond.
fn processor_seconds() -> Option<f64> {
    let mut nanoseconds = 0;
    for task in std::fs::read_dir("/proc/self/task").ok()?.flatten() {
        let text = std::fs::read_to_string(task.path().join("schedstat")).ok()?;
        nanoseconds += text.split_whitespace().next()?.parse::<u64>().ok()?;
    }
    Some(nanoseconds as f64 * 1e-9)
}
