//! Choice of the input frames that become key frames.
//!
//! [`Gap::Every`] takes every n-th. [`Gap::Auto`] takes as few key frames as each interval requires for a target PSNR.
//! As each frame arrives, the frames between the last key frame and it are predicted from these two
//! ([`interpolation`]). From that and from the PSNR of earlier intervals, the PSNR of the interval's images is
//! predicted ([`control`]). Where it is below the target, the frame before becomes a key frame. A cut has a key frame
//! on both sides. A gap never leaves its range.
//!
//! It works online: no frame waits for more than `most − 1` later ones before its key frame is known, as with a fixed
//! gap of `most`. The choice is a function of the frames and of the calls to [`Chooser::learn`].

pub mod control;
pub mod interpolation;
mod keyframes;
#[cfg(test)]
mod tests;

use std::collections::VecDeque;
use std::fmt;
use std::str::FromStr;

use streamsplat_kernels::math::f64::{exp, ln};

use crate::picture::Picture;
pub use control::{ControlState, Found};
pub use keyframes::{Group, KeyFrames, grouped};

use control::Control;
use interpolation::Small;

/// The largest gap.
pub const MOST: usize = 100_000;
/// The largest gap that is chosen automatically: every frame is compared with all since the key frame.
pub const MOST_AUTO: usize = 64;

/// PSNR in dB of a frame predicted from the one before, under which there is a cut.
const CUT: f64 = 18.0;
/// PSNR in dB of a prediction that is indistinguishable from its frame.
pub const LIKE: f64 = 60.0;

/// Distances between key frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Gap {
    /// This many input frames.
    Every(usize),
    /// As long as images stay close to the frames.
    Auto(Auto),
}

/// The range of an automatic gap, and the target PSNR.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Auto {
    /// The smallest gap: it bounds the cost.
    pub least: usize,
    /// The largest gap: it bounds the latency.
    pub most: usize,
    /// Peak signal-to-noise ratio required of each interval's images, the mean over its frames, in dB.
    pub decibels: f64,
}

impl Default for Auto {
    fn default() -> Self {
        Auto { least: 3, most: 12, decibels: 38.0 }
    }
}

impl Gap {
    /// Returns true if the choice of key frames depends on the PSNR of the images.
    pub fn depends_on_images(&self) -> bool {
        matches!(self, Gap::Auto(auto) if auto.least < auto.most)
    }
}

impl fmt::Display for Gap {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Gap::Every(n) => write!(f, "{n}"),
            Gap::Auto(Auto { least, most, decibels }) => write!(f, "auto:{least}-{most}:{decibels}"),
        }
    }
}

/// A text that is not a gap.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "expected a whole number from 1 to {MOST}, or auto[:[LEAST-]MOST[:DB]] with gaps from 1 to {MOST_AUTO} and 10 to 60 dB; found {0:?}"
)]
pub struct UnknownGap(pub String);

impl FromStr for Gap {
    type Err = UnknownGap;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let wrong = || UnknownGap(text.to_owned());
        let mut parts = text.split(':');
        if parts.next() != Some("auto") {
            return text.parse().ok().filter(|n| (1..=MOST).contains(n)).map(Gap::Every).ok_or_else(wrong);
        }
        let mut auto = Auto::default();
        if let Some(range) = parts.next() {
            let number = |text: &str| text.parse().ok().filter(|n| (1..=MOST_AUTO).contains(n)).ok_or_else(wrong);
            (auto.least, auto.most) = match range.split_once('-') {
                Some((least, most)) => (number(least)?, number(most)?),
                None => (auto.least.min(number(range)?), number(range)?),
            };
        }
        if let Some(decibels) = parts.next() {
            auto.decibels = decibels.parse().ok().filter(|db| (10.0..=60.0).contains(db)).ok_or_else(wrong)?;
        }
        match parts.next() {
            None if auto.least <= auto.most => Ok(Gap::Auto(auto)),
            _ => Err(wrong()),
        }
    }
}

/// Decision when a frame arrives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Choice {
    /// No key frame yet.
    Wait,
    /// This frame is a key frame.
    This,
    /// The frame before is a key frame; this one is the first after it.
    Before,
}

/// Chooses key frames as frames arrive.
#[derive(Clone, Debug)]
pub struct Chooser {
    gap: Gap,
    /// Frames since the last key frame; `None` before the first.
    since: Option<usize>,
    /// The last key frame and the frames since.
    seen: Vec<Small>,
    /// True if there is a cut among these frames.
    cut: bool,
    /// Mean PSNR, in dB, at which the frames between the last key frame and the latest frame are predicted from those
    /// two.
    predicted: Option<f64>,
    control: Control,
    replay: Option<Replay>,
}

/// Recorded choices to repeat.
#[derive(Clone, Debug)]
struct Replay {
    gaps: VecDeque<usize>,
    /// State of the controller at the last of them.
    state: ControlState,
}

impl Chooser {
    /// A chooser before its first frame.
    pub fn new(gap: Gap) -> Chooser {
        let control = Control::new(if let Gap::Auto(auto) = gap { auto } else { Auto::default() });
        Chooser { gap, since: None, seen: Vec::new(), cut: false, predicted: None, control, replay: None }
    }

    /// Repeats recorded choices, `gaps` after the first key frame, then continues from `state`, recorded at the last of
    /// them.
    pub fn replay(&mut self, gaps: impl IntoIterator<Item = usize>, state: ControlState) {
        self.replay = Some(Replay { gaps: gaps.into_iter().collect(), state });
    }

    /// Returns true if the next choice repeats a recorded one.
    pub fn is_replaying(&self) -> bool {
        self.replay.as_ref().is_some_and(|replay| !replay.gaps.is_empty())
    }

    /// Takes the next frame. The first is a key frame.
    pub fn next(&mut self, picture: &Picture) -> Choice {
        let since = self.since.map_or(0, |since| since + 1);
        let again = self.replay.as_mut().filter(|replay| replay.gaps.front().is_some_and(|gap| since >= *gap));
        let again = again.and_then(|replay| replay.gaps.pop_front());
        let choice = match self.gap {
            _ if since == 0 || again.is_some() => Choice::This,
            _ if self.is_replaying() => Choice::Wait,
            Gap::Every(n) if since == n => Choice::This,
            Gap::Every(_) => Choice::Wait,
            Gap::Auto(auto) => self.look(auto, since, picture),
        };
        if (since == 0 || again.is_some()) && !self.is_replaying() {
            self.seen = if matches!(self.gap, Gap::Auto(_)) { vec![Small::of(picture)] } else { Vec::new() };
            if let Some(replay) = self.replay.take() {
                self.control.set(&replay.state);
            }
        }
        self.since = Some(match choice {
            Choice::Wait => since,
            Choice::This => 0,
            Choice::Before => 1,
        });
        choice
    }

    /// Takes the measured PSNR of the next interval's images, in the order of intervals, the first key frame's first,
    /// and at most [`control::LATE`] intervals late. Without measurements, choices depend on predictions alone.
    pub fn learn(&mut self, found: &Found) {
        self.control.learn(found);
    }

    /// State of the controller, for [`Chooser::replay`].
    pub fn state(&self) -> ControlState {
        self.control.state()
    }

    fn look(&mut self, auto: Auto, since: usize, picture: &Picture) -> Choice {
        self.seen.push(Small::of(picture));
        let [.., before, last] = &self.seen[..] else { return Choice::Wait };
        let cut = interpolation::step(before, last) > bound(CUT);
        self.cut |= cut;
        let predicted = predicted(&self.seen);
        let mean = (!predicted.is_empty()).then(|| predicted.iter().sum::<f64>() / predicted.len() as f64);
        let shorter = std::mem::replace(&mut self.predicted, mean);
        let choice = if since > auto.least && (self.cut || self.control.is_too_long(since, mean)) {
            Choice::Before
        } else if since >= auto.most {
            Choice::This
        } else {
            Choice::Wait
        };
        let (gap, predicted) = match choice {
            Choice::Wait => return choice,
            Choice::This => (since, mean),
            Choice::Before => (since - 1, shorter),
        };
        self.control.choose(gap, predicted, self.cut);
        self.seen.drain(..gap);
        self.cut = choice == Choice::Before && cut;
        self.predicted = None;
        choice
    }
}

/// Peak signal-to-noise ratios, in dB, at which the frames in between are predicted from the first and the last of
/// `frames`; at most [`LIKE`].
pub fn predicted(frames: &[Small]) -> Vec<f64> {
    let peak = (interpolation::PEAK * interpolation::PEAK * interpolation::CELLS as u64) as f64;
    let ratio = |miss: u64| if miss > 0 { 10.0 * ln(peak / miss as f64) / std::f64::consts::LN_10 } else { LIKE };
    interpolation::misses(frames).into_iter().map(|miss| ratio(miss).min(LIKE)).collect()
}

/// The sum of squares that corresponds to a PSNR of `decibels`.
fn bound(decibels: f64) -> u64 {
    let share = exp(-decibels / 10.0 * std::f64::consts::LN_10);
    (share * (interpolation::PEAK * interpolation::PEAK) as f64 * interpolation::CELLS as f64) as u64
}
