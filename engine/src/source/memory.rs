//! Frames from memory.

use std::collections::VecDeque;

use super::SourceError;
use crate::picture::{Picture, size_is_allowed};

/// Path of frames in memory, in messages and records.
pub const MEMORY: &str = "<memory>";

/// A frame with its time in seconds, if it has one, or the reason why there is none.
pub type FrameInMemory = Result<(Picture, Option<f64>), String>;

/// Frames in order of arrival, the first two read ahead for their times.
pub(super) struct Memory {
    frames: Box<dyn Iterator<Item = FrameInMemory> + Send>,
    ahead: VecDeque<FrameInMemory>,
    count: Option<usize>,
    /// Time of the previous frame.
    last: Option<f64>,
}

impl Memory {
    pub(super) fn new(frames: Box<dyn Iterator<Item = FrameInMemory> + Send>, count: Option<usize>) -> Memory {
        Memory { frames, ahead: VecDeque::new(), count, last: None }
    }

    pub(super) fn count(&self) -> Option<usize> {
        self.count
    }

    /// Returns the seconds between the first two frames, if both have times.
    pub(super) fn step(&mut self) -> Result<Option<f64>, SourceError> {
        self.ahead.extend(self.frames.by_ref().take(2));
        let time = |i: usize| self.ahead.get(i).and_then(|frame| frame.as_ref().ok()).and_then(|(_, time)| *time);
        let Some((first, second)) = time(0).zip(time(1)) else { return Ok(None) };
        check(Some(first), second)?;
        Ok(Some(second - first))
    }

    /// Returns the next frame; `None` at the end.
    pub(super) fn next_frame(&mut self) -> Result<Option<(Picture, Option<f64>)>, SourceError> {
        let Some(frame) = self.ahead.pop_front().or_else(|| self.frames.next()) else { return Ok(None) };
        let (picture, time) = frame.map_err(wrong)?;
        let Picture { width, height, ref rgb } = picture;
        if !size_is_allowed(width, height) {
            return Err(SourceError::TooLarge { path: MEMORY.into(), width, height });
        }
        if rgb.len() != 3 * width * height {
            let (expected, found) = (3 * width * height, rgb.len());
            return Err(wrong(format!("expected {expected} samples for {width}×{height} pixels, found {found}")));
        }
        if let Some(i) = rgb.iter().position(|x| !x.is_finite()) {
            let (pixel, value) = (i % (width * height), rgb[i]);
            return Err(SourceError::NotFinite { path: MEMORY.into(), x: pixel % width, y: pixel / width, value });
        }
        if let Some(time) = time {
            check(self.last, time)?;
            self.last = Some(time);
        }
        Ok(Some((picture, time)))
    }
}

/// Returns an error unless `time` is finite and after the previous one.
fn check(before: Option<f64>, time: f64) -> Result<(), SourceError> {
    if time.is_finite() && before.is_none_or(|before| before < time) {
        return Ok(());
    }
    let after = before.map(|before| format!(", after {before}")).unwrap_or_default();
    Err(wrong(format!("expected finite times that ascend, found {time}{after}")))
}

fn wrong(cause: String) -> SourceError {
    SourceError::Decode { path: MEMORY.into(), cause }
}

#[cfg(test)]
mod tests {
    use super::super::Source;
    use super::*;

    fn picture(value: f32) -> Picture {
        Picture { width: 2, height: 1, rgb: vec![value; 6] }
    }

    fn source(times: &[Option<f64>], fps: Option<f64>) -> Result<Source, SourceError> {
        let frames: Vec<FrameInMemory> = times.iter().map(|time| Ok((picture(0.5), *time))).collect();
        Source::of_frames(frames.into_iter(), fps, Some(times.len()))
    }

    fn times(mut source: Source) -> Vec<f64> {
        std::iter::from_fn(|| source.next_frame().expect("a frame")).map(|frame| frame.timestamp).collect()
    }

    #[test]
    fn times_are_the_frames_own_unless_a_rate_replaces_them() {
        let own = source(&[Some(0.0), Some(0.5), Some(2.0)], None).expect("frames");
        assert_eq!((own.fps(), own.is_uneven(), own.frames()), (2.0, true, Some(3)));
        assert_eq!(times(own), [0.0, 0.5, 2.0]);
        let even = source(&[Some(0.0), Some(0.5), Some(2.0)], Some(4.0)).expect("frames");
        assert_eq!((even.fps(), even.is_uneven()), (4.0, false));
        assert_eq!(times(even), [0.0, 0.25, 0.5]);
        assert_eq!(times(source(&[None; 2], None).expect("frames")), [0.0, 1.0 / 24.0]);
        assert_eq!(times(source(&[Some(3.0)], None).expect("a frame")), [0.0]);
        assert!(times(source(&[], None).expect("none")).is_empty());
    }

    #[test]
    fn what_is_wrong_with_a_frame_is_named() {
        let error = |result: Result<Source, SourceError>| {
            let mut source = match result {
                Ok(source) => source,
                Err(error) => return error.to_string(),
            };
            loop {
                match source.next_frame() {
                    Ok(Some(_)) => {}
                    Ok(None) => return "none".to_owned(),
                    Err(error) => return error.to_string(),
                }
            }
        };
        let of = |frames: Vec<FrameInMemory>| Source::of_frames(frames.into_iter(), None, None);
        let ascending = "<memory>: expected finite times that ascend, found 0.5, after 0.5";
        assert_eq!(error(source(&[Some(0.5), Some(0.5)], None)), ascending);
        assert_eq!(error(source(&[Some(0.0), Some(0.5), Some(0.5)], None)), ascending);
        let infinite = "<memory>: expected finite times that ascend, found NaN, after 0";
        assert_eq!(error(source(&[Some(0.0), Some(f64::NAN)], None)), infinite);
        assert!(error(source(&[None], Some(0.0))).contains('0'));
        assert_eq!(error(of(vec![Err("broken".into())])), "<memory>: broken");
        let nan = error(of(vec![Ok((picture(f32::NAN), None))]));
        assert_eq!(nan, "<memory>: the sample at x=0, y=0 is NaN, expected a finite number");
        let short = Picture { rgb: vec![0.0; 5], ..picture(0.0) };
        assert_eq!(error(of(vec![Ok((short, None))])), "<memory>: expected 6 samples for 2×1 pixels, found 5");
        let wide = Picture { width: 3, height: 1, rgb: vec![0.0; 9] };
        assert!(error(of(vec![Ok((picture(0.0), None)), Ok((wide, None))])).contains("expected 2×1"));
        assert!(error(of(vec![Ok((Picture { width: 0, height: 1, rgb: vec![] }, None))])).contains("0×1"));
    }
}
