//! Times of the source's frames.
//!
//! A scene's frames follow from its rate, counted from the scene's start, unless an interval lists its own. An interval
//! lists them where one differs from that in any bit, so that images drawn at them are those of the run.

use super::{Index, IntervalEntry};

/// Largest number of frames that are computed from the rate.
const MOST: f64 = 1e7;

impl Index {
    /// The times of the source's frames, in seconds, in order; `None` where rate and length imply more than ten million
    /// of them.
    pub fn frames(&self) -> Option<Vec<f64>> {
        let mut all = Vec::new();
        let start = self.intervals.first()?.start;
        for IntervalEntry { end, frames, .. } in &self.intervals {
            match frames.is_empty() {
                true => all.extend(implied(start, self.fps, all.len(), *end)?),
                false => all.extend_from_slice(frames),
            }
        }
        Some(all)
    }

    /// Returns true if frames do not have a constant rate.
    pub fn is_uneven(&self) -> bool {
        let start = self.intervals.first().map_or(0.0, |first| first.start);
        let mut count = 0;
        self.intervals.iter().any(|entry| {
            let off = |(i, time): (usize, &f64)| ((time - start) * self.fps - (count + i) as f64).abs() > 1e-3;
            let uneven = entry.frames.iter().enumerate().any(off);
            count = match entry.frames.len() {
                0 => implied(start, self.fps, count, entry.end).map_or(count, |implied| count + implied.len()),
                listed => count + listed,
            };
            uneven
        })
    }
}

/// The times of an interval that lists none, after `count` frames of a scene that begins at `start`, up to the
/// interval's `end`. A frame within a millionth of a frame's duration of `end` has the time `end`.
fn implied(start: f64, fps: f64, count: usize, end: f64) -> Option<impl ExactSizeIterator<Item = f64>> {
    let last = (end - start) * fps;
    if !(last.is_finite() && last < MOST) {
        return None;
    }
    let after = ((last + 1e-6).max(-1.0) as usize + usize::from(last > -1e-6)).max(count);
    Some((count..after).map(move |i| (start + i as f64 / fps).min(end)))
}

/// The index entry for `frames`, the frames of an interval that ends at `end`; empty where they are implied, or where
/// there are none. `count` is the number of frames before the interval, and is increased by them.
pub(super) fn listed(start: f64, fps: f64, count: &mut usize, end: f64, frames: &[f64]) -> Vec<f64> {
    let Some(times) = implied(start, fps, *count, end) else { return frames.to_vec() };
    let length = times.len();
    let same = length == frames.len() && times.zip(frames).all(|(a, b)| a.to_bits() == b.to_bits());
    *count += if frames.is_empty() { length } else { frames.len() };
    if same { Vec::new() } else { frames.to_vec() }
}

/// Returns an error unless the `frames` listed by an interval from `start` to `end` ascend, are in it and are finite.
pub(super) fn check(frames: &[f64], start: f64, end: f64) -> Result<(), String> {
    let mut before = start;
    for (i, time) in frames.iter().enumerate() {
        let after = if i == 0 { before <= *time } else { before < *time };
        if !(after && *time <= end) {
            return Err(format!(
                "expected ascending times of frames from {start} to {end}, found {time} after {before}"
            ));
        }
        before = *time;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{FORMAT, PlacementRecord, VERSION};

    fn index(fps: f64, intervals: &[&[f64]]) -> Index {
        let (mut count, mut start) = (0, intervals[0][0]);
        let first = start;
        let entries = intervals.iter().map(|frames| {
            let end = frames[frames.len() - 1];
            let listed = listed(first, fps, &mut count, end, frames);
            let entry = IntervalEntry {
                file: String::new(),
                start,
                end,
                gaussians: 0,
                bytes: 0,
                blake3: String::new(),
                frames: listed,
            };
            start = end;
            entry
        });
        let placement = PlacementRecord { source: [1; 2], model: [1; 2], offset: [0; 2], content: [1; 2] };
        Index { format: FORMAT.into(), version: VERSION, fps, placement, intervals: entries.collect() }
    }

    #[test]
    fn frames_come_back_whatever_their_times_are() {
        let thirds: Vec<f64> = (0..12).map(|i| f64::from(i) * 1001.0 / 30000.0).collect();
        let cases: [(f64, &[&[f64]]); 5] = [
            (24.0, &[&[0.0], &[1.0 / 24.0, 2.0 / 24.0], &[3.0 / 24.0]]),
            (3.0, &[&[0.0], &[0.1, 0.5], &[0.52, 2.0]]),
            (30000.0 / 1001.0, &[&thirds[..1], &thirds[1..7], &thirds[7..]]),
            (10.0, &[&[0.0], &[0.1, 0.2], &[0.4]]),
            (25.0, &[&[7.0]]),
        ];
        for (fps, intervals) in cases {
            let index = index(fps, intervals);
            assert_eq!(index.frames().expect("few"), intervals.concat(), "{fps}");
        }
    }

    #[test]
    fn what_the_rate_says_is_not_listed() {
        let even = index(24.0, &[&[0.0], &[1.0 / 24.0, 2.0 / 24.0], &[3.0 / 24.0]]);
        assert!(even.intervals.iter().all(|entry| entry.frames.is_empty()) && !even.is_uneven());
        let uneven = index(3.0, &[&[0.0], &[0.1, 0.5], &[0.52, 2.0]]);
        assert!(uneven.is_uneven());
        // A difference of an ulp is listed, but does not count as uneven.
        let thirds: Vec<f64> = (0..40).map(|i| f64::from(i) * 1001.0 / 30000.0).collect();
        assert!(!index(30000.0 / 1001.0, &[&thirds[..1], &thirds[1..]]).is_uneven());
    }

    #[test]
    fn times_that_do_not_ascend_in_their_interval_are_refused() {
        assert!(check(&[0.0, 0.5, 1.0], 0.0, 1.0).is_ok() && check(&[], 0.0, 1.0).is_ok());
        for wrong in [&[0.5, 0.5][..], &[-0.1], &[1.1], &[f64::NAN], &[0.5, 0.4]] {
            assert!(check(wrong, 0.0, 1.0).is_err(), "{wrong:?}");
        }
    }
}
