//! Prediction of the PSNR of the next interval's images.
//!
//! It is based on how well the interval's frames are predicted from its key frames in low-resolution luma, and on the
//! PSNR of earlier intervals. In dB, for an interval of n frames after its first key frame,
//!
//! ```text
//! between  q = k − s·(0.90 + 0.27·max(k − p, 0))·ln(max(n, 2) / 0.65)        mean of its n − 1 frames in between
//! all      ((n − 1)·q + k) / n
//! ```
//!
//! p: mean PSNR at which the frames in between are predicted from the key frames ([`super::predicted`]); k: PSNR of the
//! latest measured key frame; s: a scale that starts at 1. After each interval s is multiplied by the 0.8th power of
//! the ratio of measured to predicted `k − q`, within [1/4, 4]. Intervals of two frames or fewer, whose ratio carries
//! little information, move s a tenth of the way towards 1 instead. The constants are a least-squares fit to 635
//! intervals of 14 clips of 512×288 (n from 3 to 10, frames in between given, `balanced`), with an error of 1.8 dB
//! (`bench/gap.py`).
//!
//! Each interval is to reach the target by itself, as a mean over its frames, the key frame included. What others
//! exceed it by does not count, since a viewer sees the worst frames. s carries over, so where motion begins, up to
//! [`LATE`] intervals may miss the target. An interval is at most three times as long as the latest one that did not
//! end at a cut.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};
use streamsplat_kernels::math::f64::{exp, ln};

use super::Auto;

/// PSNR of key frames before any is measured, in dB.
const FIRST_KEY: f64 = 47.0;
/// The largest ratio of an interval's length to that of the one before.
const GROWTH: usize = 3;
/// Part of an error that corrects the next prediction.
const RATE: f64 = 0.8;
/// Number of intervals that may be chosen before the first of them is measured.
pub const LATE: usize = 4;

/// Measured PSNR of an interval's images.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Found {
    /// PSNR of its last frame, the key frame, in dB.
    pub key: f64,
    /// Mean PSNR of the frames in between, in dB; `None` where there are none.
    pub between: Option<f64>,
}

/// An interval, and how well it was predicted.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Expected {
    frames: usize,
    /// p
    predicted: f64,
}

/// State of the prediction.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Control {
    /// Target PSNR, in dB.
    asked: f64,
    key: f64,
    scale: f64,
    /// Number of measured intervals.
    known: u64,
    /// Length of the latest interval that no cut ended.
    last: usize,
    /// Intervals chosen and not yet measured.
    waiting: VecDeque<Expected>,
}

/// The same state as bits, for storage.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ControlState {
    key: u64,
    scale: u64,
    known: u64,
    last: usize,
    waiting: Vec<(usize, u64)>,
}

impl Control {
    pub(super) fn new(Auto { least, decibels, .. }: Auto) -> Control {
        let (key, last) = (FIRST_KEY, least.max(2));
        Control { asked: decibels, key, scale: 1.0, known: 0, last, waiting: VecDeque::new() }
    }

    /// Returns true if an interval of `frames` frames would be too long, or is predicted to miss the target PSNR.
    pub(super) fn is_too_long(&self, frames: usize, predicted: Option<f64>) -> bool {
        let n = frames.max(1) as f64;
        let loss = loss(frames, predicted.unwrap_or(self.key), self.key);
        let all = self.key - (n - 1.0) / n * self.scale * loss;
        frames > GROWTH * self.last || all < self.asked
    }

    /// Records an interval that was chosen; the length of one with a `cut` does not limit the next.
    pub(super) fn choose(&mut self, frames: usize, predicted: Option<f64>, cut: bool) {
        self.waiting.push_back(Expected { frames, predicted: predicted.unwrap_or(self.key) });
        self.last = if cut { self.last } else { frames };
        if self.waiting.len() > LATE {
            self.waiting.pop_front();
        }
    }

    /// Updates the state by the measurement of the next interval.
    pub(super) fn learn(&mut self, found: &Found) {
        // The very first key frame was not predicted.
        let expected = if self.known == 0 { None } else { self.waiting.pop_front() };
        self.known += 1;
        self.key = found.key;
        match (found.between, expected) {
            (Some(between), Some(Expected { frames: frames @ 3.., predicted })) => {
                let ratio = (found.key - between).max(0.05) / (self.scale * loss(frames, predicted, found.key));
                self.scale = (self.scale * exp(RATE * ln(ratio))).clamp(0.25, 4.0);
            }
            _ => self.scale = 1.0 + 0.9 * (self.scale - 1.0),
        }
    }

    pub(super) fn state(&self) -> ControlState {
        let waiting = self.waiting.iter().map(|e| (e.frames, e.predicted.to_bits())).collect();
        let [key, scale] = [self.key, self.scale].map(f64::to_bits);
        ControlState { key, scale, known: self.known, last: self.last, waiting }
    }

    pub(super) fn set(&mut self, state: &ControlState) {
        let expected = |&(frames, predicted): &(usize, u64)| Expected { frames, predicted: f64::from_bits(predicted) };
        [self.key, self.scale] = [state.key, state.scale].map(f64::from_bits);
        (self.known, self.last) = (state.known, state.last);
        self.waiting = state.waiting.iter().map(expected).collect();
    }
}

/// `k − q` for s = 1.
fn loss(frames: usize, predicted: f64, key: f64) -> f64 {
    if frames < 2 {
        return 0.0;
    }
    (0.90 + 0.27 * (key - predicted).max(0.0)) * ln(frames as f64 / 0.65)
}
