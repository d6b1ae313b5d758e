//! Key frames chosen by how close images are to frames, in the form that a stopped run keeps.

use std::collections::VecDeque;

use crate::gap::{ControlState, Found};
use serde::{Deserialize, Serialize};

/// Key frames chosen so far, and the state on which the next choices depend.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Choices {
    /// Frames from each key frame to the next.
    pub gaps: Vec<usize>,
    /// State of the controller when the last of them was chosen.
    pub state: ControlState,
    /// Results since then: PSNR of the key frame and of the frames in between, as bits, and the number of frames.
    recent: VecDeque<(u64, Option<u64>, usize)>,
    /// The sum of PSNR over all frames compared, as bits, and their number.
    compared: (u64, usize),
}

impl Choices {
    /// The same, before its choices are repeated.
    pub fn replayed(&self) -> Choices {
        Choices { gaps: Vec::new(), ..self.clone() }
    }

    /// Adds a key frame, `gap` frames after the one before; `None` for the first.
    pub fn add(&mut self, gap: Option<usize>, state: ControlState) {
        self.gaps.extend(gap);
        self.state = state;
    }

    /// Records the result of an interval. The last two are kept, since the next choice may not have used them yet.
    /// `sum` is the sum of PSNR over all frames compared so far, `frames` their number.
    pub fn found(&mut self, found: &Found, sum: f64, frames: usize) {
        self.recent.push_back((found.key.to_bits(), found.between.map(f64::to_bits), found.frames));
        if self.recent.len() > 2 {
            self.recent.pop_front();
        }
        self.compared = (sum.to_bits(), frames);
    }

    /// Results since the last choice.
    pub fn recent(&self) -> impl Iterator<Item = Found> {
        self.recent.iter().map(|&(key, between, frames)| Found {
            key: f64::from_bits(key),
            between: between.map(f64::from_bits),
            frames,
        })
    }

    /// The sum of PSNR over all frames compared, in dB, and their number.
    pub fn compared(&self) -> (f64, usize) {
        (f64::from_bits(self.compared.0), self.compared.1)
    }
}
