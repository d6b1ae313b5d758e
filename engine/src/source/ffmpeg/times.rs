//! Times at which frames are shown.

/// Fraction of a frame's duration within which a time counts as even, if ticks are longer than that.
const JITTER: f64 = 0.25;

/// Seconds since the first frame, for consecutive frames, from their time stamps.
///
/// Containers round times to ticks. A time within a tick of its frame's place at the stream's nominal rate is therefore
/// replaced by that place. A frame without a time stamp follows the previous frame at the nominal rate. A frame whose
/// time is not after the previous frame's follows it as closely as ticks allow. If time stamps jump back by more than a
/// frame, times continue from there with an offset.
#[derive(Clone, Debug)]
pub(super) struct Clock {
    tick: (u32, u32),
    rate: Option<(u32, u32)>,
    first: Option<i64>,
    frames: usize,
    last: f64,
    /// Offset added to time stamps that have jumped back, in seconds.
    shift: Option<f64>,
    /// Number of frames that were moved.
    pub(super) moved: usize,
}

impl Clock {
    pub(super) fn new(tick: (u32, u32), rate: Option<(u32, u32)>) -> Clock {
        Clock { tick, rate, first: None, frames: 0, last: 0.0, shift: None, moved: 0 }
    }

    /// Converts a time stamp to seconds.
    pub(super) fn seconds(&self, time: i64) -> f64 {
        time as f64 * f64::from(self.tick.0) / f64::from(self.tick.1)
    }

    /// Returns the time of the next frame.
    pub(super) fn next(&mut self, time: Option<i64>) -> f64 {
        let index = self.frames;
        self.frames += 1;
        let tick = self.seconds(1);
        // The nominal time of this frame, and the nominal duration.
        let even = self.rate.map(|(a, b)| (index as f64 * f64::from(b) / f64::from(a), f64::from(b) / f64::from(a)));
        if index == 0 {
            self.first = time;
            return 0.0;
        }
        let length = even.map_or(tick, |(_, length)| length);
        if let (None, Some(time)) = (self.first, time) {
            // The frames before had no time stamps; they were shown one after the other.
            self.first = Some(time.saturating_sub(((self.last + length) / tick).round() as i64));
        }
        let first = self.first.unwrap_or_default();
        let own = time.map(|time| self.seconds(time.saturating_sub(first)));
        let near = |own: f64| {
            let (place, length) = even.filter(|(place, _)| *place > self.last)?;
            ((own - place).abs() <= 1.001 * tick.min(JITTER * length)).then_some(place)
        };
        let after = |time: f64| (time > self.last).then(|| near(time).unwrap_or(time));
        self.last = match own {
            None => self.last + length,
            Some(own) => match after(own).or_else(|| after(own + self.shift?)) {
                Some(time) => time,
                None => {
                    self.moved += 1;
                    if own > self.last - 0.99 * length {
                        self.last + tick.min(JITTER * length)
                    } else {
                        // Time stamps restart here.
                        self.shift = Some(self.last + length - own);
                        self.last + length
                    }
                }
            },
        };
        self.last
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn times(tick: (u32, u32), rate: Option<(u32, u32)>, stamps: &[Option<i64>]) -> (Vec<f64>, usize) {
        let mut clock = Clock::new(tick, rate);
        (stamps.iter().map(|stamp| clock.next(*stamp)).collect(), clock.moved)
    }

    fn at(stamps: &[i64]) -> Vec<Option<i64>> {
        stamps.iter().copied().map(Some).collect()
    }

    #[test]
    fn even_times_are_those_of_the_rate_to_the_last_bit() {
        // Matroska: milliseconds of 24 frames a second, from 7 ms on.
        let (found, _) = times((1, 1000), Some((24, 1)), &at(&[7, 49, 90, 132, 174]));
        assert_eq!(found, [0.0, 1.0 / 24.0, 2.0 / 24.0, 3.0 / 24.0, 4.0 / 24.0]);
        let (found, _) = times((1001, 30000), Some((30000, 1001)), &at(&[5, 6, 7]));
        assert_eq!(found, [0.0, 1001.0 / 30000.0, 2.0 * 1001.0 / 30000.0]);
    }

    #[test]
    fn uneven_times_are_the_frames_own() {
        // A gap of one frame where a tick is a frame.
        assert_eq!(times((1, 25), Some((25, 1)), &at(&[0, 1, 3, 4])).0, [0.0, 1.0 / 25.0, 3.0 / 25.0, 4.0 / 25.0]);
        // A recording whose nominal rate is that of its ticks.
        assert_eq!(times((1, 1000), Some((1000, 1)), &at(&[0, 34, 100, 131])).0, [0.0, 0.034, 0.1, 0.131]);
        assert_eq!(times((1, 1000), None, &at(&[-5, 30, 90])).0, [0.0, 0.035, 0.095]);
    }

    #[test]
    fn times_ascend_whatever_the_stamps_are() {
        let (found, moved) = times((1, 1000), Some((25, 1)), &[Some(0), Some(0), Some(80), None, Some(100), Some(160)]);
        assert_eq!(found, [0.0, 0.001, 0.08, 0.12, 0.121, 0.16]);
        assert_eq!(moved, 2);
        // Time stamps that jump back for good, and for one frame.
        let (found, moved) = times((1, 1000), Some((25, 1)), &at(&[0, 40, 80, 120, 0, 40, 80, 120, 160, 200]));
        assert_eq!((found, moved), ((0..10).map(|i| f64::from(i) / 25.0).collect(), 1));
        let (found, moved) = times((1, 1000), Some((25, 1)), &at(&[0, 40, 80, 0, 160, 200]));
        assert_eq!((found, moved), ((0..6).map(|i| f64::from(i) / 25.0).collect(), 1));
        let (found, moved) = times((1, 1000), Some((25, 1)), &[None, None, Some(0), Some(41)]);
        assert_eq!((found, moved), (vec![0.0, 0.04, 0.08, 0.12], 0));
        let (found, _) = times((1, 1000), None, &[None, None, Some(i64::MIN), Some(i64::MAX)]);
        assert!(found.windows(2).all(|pair| pair[0] < pair[1]), "{found:?}");
    }
}
