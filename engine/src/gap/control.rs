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
//! A surplus or deficit of earlier intervals against the target PSNR is compensated over 16 frames, by 4 dB at most. An
//! interval is at most three times as long as the latest one that did not end at a cut.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};
use streamsplat_kernels::math::f64::{exp, ln};

use super::Auto;

/// PSNR of key frames before any is measured, in dB.
const FIRST_KEY: f64 = 47.0;
/// Frames over which a surplus is compensated.
const HORIZON: f64 = 16.0;
/// Largest compensation, in dB.
const MOST_MADE_UP: f64 = 4.0;
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
    /// Frames after the interval's first key frame, including the last one; 1 for the very first key frame.
    pub frames: usize,
}

/// Predicted PSNR of an interval's images.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Expected {
    frames: usize,
    /// p
    predicted: f64,
    /// The mean over all its frames.
    all: f64,
}

/// State of the prediction.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Control {
    /// Target PSNR, in dB.
    asked: f64,
    key: f64,
    scale: f64,
    /// Sum of (PSNR − target) over measured frames.
    surplus: f64,
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
    surplus: u64,
    known: u64,
    last: usize,
    waiting: Vec<(usize, u64, u64)>,
}

impl Control {
    pub(super) fn new(Auto { least, decibels, .. }: Auto) -> Control {
        let (key, last) = (FIRST_KEY, least.max(2));
        Control { asked: decibels, key, scale: 1.0, surplus: 0.0, known: 0, last, waiting: VecDeque::new() }
    }

    fn expect(&self, frames: usize, predicted: Option<f64>) -> Expected {
        let n = frames.max(1) as f64;
        let predicted = predicted.unwrap_or(self.key);
        let all = self.key - (n - 1.0) / n * self.scale * loss(frames, predicted, self.key);
        Expected { frames, predicted, all }
    }

    /// Returns true if an interval of `frames` frames would be too long, or is predicted to miss the target PSNR.
    pub(super) fn is_too_long(&self, frames: usize, predicted: Option<f64>) -> bool {
        let waiting = self.waiting.iter().map(|e| e.frames as f64 * (e.all - self.asked)).sum::<f64>();
        let made_up = ((self.surplus + waiting) / HORIZON).clamp(-MOST_MADE_UP, MOST_MADE_UP);
        frames > GROWTH * self.last || self.expect(frames, predicted).all < self.asked - made_up
    }

    /// Records an interval that was chosen; the length of one with a `cut` does not limit the next.
    pub(super) fn choose(&mut self, frames: usize, predicted: Option<f64>, cut: bool) {
        self.waiting.push_back(self.expect(frames, predicted));
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
            (Some(between), Some(Expected { frames: frames @ 3.., predicted, .. })) => {
                let ratio = (found.key - between).max(0.05) / (self.scale * loss(frames, predicted, found.key));
                self.scale = (self.scale * exp(RATE * ln(ratio))).clamp(0.25, 4.0);
            }
            _ => self.scale = 1.0 + 0.9 * (self.scale - 1.0),
        }
        let all = found.key + (found.frames.max(1) - 1) as f64 * found.between.unwrap_or(0.0);
        let most = HORIZON * MOST_MADE_UP;
        self.surplus = (self.surplus + all - found.frames as f64 * self.asked).clamp(-most, most);
    }

    pub(super) fn state(&self) -> ControlState {
        let waiting = self.waiting.iter().map(|e| (e.frames, e.predicted.to_bits(), e.all.to_bits())).collect();
        let [key, scale, surplus] = [self.key, self.scale, self.surplus].map(f64::to_bits);
        ControlState { key, scale, surplus, known: self.known, last: self.last, waiting }
    }

    pub(super) fn set(&mut self, state: &ControlState) {
        let expected = |&(frames, predicted, all): &(usize, u64, u64)| Expected {
            frames,
            predicted: f64::from_bits(predicted),
            all: f64::from_bits(all),
        };
        [self.key, self.scale, self.surplus] = [state.key, state.scale, state.surplus].map(f64::from_bits);
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
