//! Intervals, one per key frame: the Gaussians between the key frame before and this one.

use super::DynamicGaussians;
use crate::fit::Placement;

/// An identity that ended at an interval's end because another Gaussian shows the same place.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Merge {
    /// The identity that ended.
    pub identity: u64,
    /// The identity that continues.
    pub into: u64,
}

/// The scene from one key frame to the next. It stays valid, independent of the engine that made it.
#[derive(Clone, Debug)]
pub struct Interval {
    /// The key frame at its end.
    pub index: u64,
    /// Time of the key frame at its start, in seconds.
    pub start: f64,
    /// Time of the key frame at its end, in seconds; equal to `start` for the first frame's static scene.
    pub end: f64,
    /// Gaussians that can be seen.
    pub gaussians: DynamicGaussians,
    /// Placement of the source's frame in the model's input.
    pub placement: Placement,
    /// Identities that ended in others.
    pub merges: Vec<Merge>,
    /// Gaussians left out because one of their numbers was not finite.
    pub dropped: u64,
}

impl Interval {
    /// The relative place of `time` in the interval: 0 at its start, 1 at its end; 0 throughout an interval of length
    /// 0. `None` outside.
    pub fn relative(&self, time: f64) -> Option<f32> {
        if !(self.start <= time && time <= self.end) {
            return None;
        }
        if self.end == self.start {
            return Some(0.0);
        }
        // Halves, so that no difference of finite times overflows; half of the smallest difference rounds to 0.
        let half = 0.5 * self.end - 0.5 * self.start;
        let t = match half > 0.0 {
            true => (0.5 * time - 0.5 * self.start) / half,
            false => (time - self.start) / (self.end - self.start),
        };
        Some(t as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_time_of_an_interval_lies_between_its_ends_however_small_or_large_they_are() {
        let tiny = f64::from_bits(1);
        for (start, end) in [(0.0, tiny), (tiny, 2.0 * tiny), (-tiny, 7.0 * tiny), (f64::MIN, f64::MAX), (0.0, 0.2)] {
            let interval = Interval {
                index: 1,
                start,
                end,
                gaussians: DynamicGaussians::default(),
                placement: Placement { source: [1; 2], model: [1; 2], offset: [0; 2], content: [1; 2] },
                merges: Vec::new(),
                dropped: 0,
            };
            assert_eq!([start, end].map(|time| interval.relative(time)), [Some(0.0), Some(1.0)], "{start} to {end}");
            let middle = interval.relative(0.5 * start + 0.5 * end);
            assert!(middle.is_none_or(|t| (0.0..=1.0).contains(&t)), "{start} to {end}: {middle:?}");
        }
    }
}
