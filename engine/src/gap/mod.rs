//! Which input frames become key frames.
//!
//! [`Gap::Every`] takes every n-th. [`Gap::Auto`] takes the next key frame when the frames in between could no longer be told from
//! the key frames around them: as each frame arrives, what lies between the last key frame and it is predicted from these two
//! ([`interpolation`]), and where the worst prediction is further from its frame than the bound allows, the frame before
//! becomes a key frame. A gap never leaves its range.
//!
//! It works online: no frame waits for more than `most − 1` later ones before its key frame is known, as with a fixed gap
//! of `most`. The choice is a function of the frames alone, in integers.

pub mod interpolation;
#[cfg(test)]
mod tests;

use std::fmt;
use std::str::FromStr;

use streamsplat_kernels::math::f64::{exp, ln};

use crate::picture::Picture;
use interpolation::Small;

/// The largest gap.
pub const MOST: usize = 100_000;
/// The largest gap that is chosen by looking: every frame is compared with all since the key frame.
pub const MOST_AUTO: usize = 64;

/// How far key frames are apart.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Gap {
    /// This many input frames.
    Every(usize),
    /// As far as the frames in between can be predicted.
    Auto(Auto),
}

/// The range of a gap that is chosen by looking, and the bound.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Auto {
    /// The smallest gap: it bounds the cost.
    pub least: usize,
    /// The largest gap: it bounds the latency.
    pub most: usize,
    /// Peak signal-to-noise ratio, in dB, that a prediction of a frame's small luma must have.
    pub decibels: f64,
}

impl Default for Auto {
    fn default() -> Self {
        Auto { least: 5, most: 12, decibels: 26.0 }
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

/// A text that is no gap.
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

/// Decision on a frame's arrival.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Choice {
    /// Nothing yet.
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
    /// The last key frame and what came since.
    seen: Vec<Small>,
}

impl Chooser {
    /// One that has seen nothing.
    pub fn new(gap: Gap) -> Chooser {
        Chooser { gap, since: None, seen: Vec::new() }
    }

    /// Takes the next frame. The first is a key frame.
    pub fn next(&mut self, picture: &Picture) -> Choice {
        let since = self.since.map_or(0, |since| since + 1);
        let choice = match self.gap {
            _ if since == 0 => Choice::This,
            Gap::Every(n) if since == n => Choice::This,
            Gap::Every(_) => Choice::Wait,
            Gap::Auto(auto) => self.look(auto, since, picture),
        };
        if since == 0 && matches!(self.gap, Gap::Auto(_)) {
            self.seen = vec![Small::of(picture)];
        }
        self.since = Some(match choice {
            Choice::Wait => since,
            Choice::This => 0,
            Choice::Before => 1,
        });
        choice
    }

    fn look(&mut self, auto: Auto, since: usize, picture: &Picture) -> Choice {
        self.seen.push(Small::of(picture));
        let choice = if since > auto.least && interpolation::worst(&self.seen) > bound(auto.decibels) {
            Choice::Before
        } else if since >= auto.most {
            Choice::This
        } else {
            Choice::Wait
        };
        let key = match choice {
            Choice::Wait => return choice,
            Choice::This => since,
            Choice::Before => since - 1,
        };
        self.seen.drain(..key);
        choice
    }
}

/// The ratio, in dB, by which the worst frame in between is predicted from the first and the last of `frames`; at most 99.
pub fn predicted(frames: &[Small]) -> f64 {
    let worst = interpolation::worst(frames) as f64 / interpolation::CELLS as f64;
    let peak = (interpolation::PEAK * interpolation::PEAK) as f64;
    if worst > 0.0 { (10.0 * ln(peak / worst) / std::f64::consts::LN_10).min(99.0) } else { 99.0 }
}

/// The sum of squares that a ratio of so many decibels allows.
fn bound(decibels: f64) -> u64 {
    let share = exp(-decibels / 10.0 * std::f64::consts::LN_10);
    (share * (interpolation::PEAK * interpolation::PEAK) as f64 * interpolation::CELLS as f64) as u64
}
