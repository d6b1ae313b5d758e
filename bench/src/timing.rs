//! Wall-clock times of repeated work.

use std::time::Instant;

use serde::Serialize;

/// Seconds of several runs of the same work.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Seconds {
    /// The least.
    pub min: f64,
    /// The median.
    pub median: f64,
    /// The most.
    pub max: f64,
}

/// Seconds of one run.
pub fn once(work: impl FnOnce()) -> f64 {
    let start = Instant::now();
    work();
    start.elapsed().as_secs_f64()
}

impl Seconds {
    /// The summary of measured times.
    pub fn of(mut times: Vec<f64>) -> Seconds {
        times.sort_by(f64::total_cmp);
        let at = |i: usize| times.get(i).copied().unwrap_or(f64::NAN);
        Seconds { min: at(0), median: at(times.len() / 2), max: at(times.len().saturating_sub(1)) }
    }
}

/// Time spent: processor time of all threads of this process, where available, and time by the clock.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Spent {
    processor: Option<f64>,
    clock: f64,
}

impl Spent {
    /// The processor's time, or the clock's if there is none.
    pub fn seconds(&self) -> f64 {
        self.processor.unwrap_or(self.clock)
    }

    /// The smaller of two, for each clock separately.
    pub fn least(self, other: Spent) -> Spent {
        let processor = self.processor.zip(other.processor).map(|(a, b)| a.min(b));
        Spent { processor, clock: self.clock.min(other.clock) }
    }

    /// The clock's time.
    pub fn clock(&self) -> f64 {
        self.clock
    }

    /// The processor's time, where available.
    pub fn processor(&self) -> Option<f64> {
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
pub struct Stopwatch {
    processor: Option<f64>,
    clock: Instant,
}

impl Stopwatch {
    /// Starts now.
    pub fn start() -> Stopwatch {
        Stopwatch { processor: processor_seconds(), clock: Instant::now() }
    }

    /// The time since.
    pub fn stop(self) -> Spent {
        let clock = self.clock.elapsed().as_secs_f64();
        Spent { processor: processor_seconds().zip(self.processor).map(|(now, then)| now - then), clock }
    }
}

/// Seconds of processor time of this process: of all its threads, those that ended included. `None` outside Unix.
pub fn processor_seconds() -> Option<f64> {
    #[cfg(unix)]
    {
        let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
        // SAFETY: `time` is a valid `timespec`, which the call writes; it keeps no pointer.
        let failed = unsafe { libc::clock_gettime(libc::CLOCK_PROCESS_CPUTIME_ID, &raw mut time) };
        (failed == 0).then_some(time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9)
    }
    #[cfg(not(unix))]
    None
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn work_takes_time_also_in_a_thread_that_ended() {
        let time = processor_seconds().unwrap();
        std::thread::spawn(|| std::hint::black_box((0..10_000_000u64).map(std::hint::black_box).sum::<u64>()))
            .join()
            .unwrap();
        assert!(processor_seconds().unwrap() > time + 1e-4);
    }
}
