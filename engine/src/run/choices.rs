//! Key frames chosen by how close images are to frames, in the form that a stopped run keeps.

use std::collections::VecDeque;

use crate::gap::{ControlState, Found};
use crate::run::closeness::Total;
use serde::{Deserialize, Serialize};

/// Key frames chosen so far, and the state on which the next choices depend.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Choices {
    /// Frames from each key frame to the next.
    pub gaps: Vec<usize>,
    /// State of the controller when the last of them was chosen.
    pub state: ControlState,
    /// Results since then: PSNR of the key frame and of the frames in between, as bits.
    recent: VecDeque<(u64, Option<u64>)>,
    /// PSNR of all frames compared ([`Total::stored`]).
    compared: (u64, usize, u64),
}

impl Default for Choices {
    fn default() -> Choices {
        let (gaps, state, recent) = Default::default();
        Choices { gaps, state, recent, compared: Total::default().stored() }
    }
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
    /// `total` is that of all frames compared so far.
    pub fn found(&mut self, found: &Found, total: Total) {
        self.recent.push_back((found.key.to_bits(), found.between.map(f64::to_bits)));
        if self.recent.len() > 2 {
            self.recent.pop_front();
        }
        self.compared = total.stored();
    }

    /// Results since the last choice.
    pub fn recent(&self) -> impl Iterator<Item = Found> {
        let found = |&(key, between): &(u64, Option<u64>)| Found {
            key: f64::from_bits(key),
            between: between.map(f64::from_bits),
        };
        self.recent.iter().map(found)
    }

    /// PSNR of all frames compared.
    pub fn compared(&self) -> Total {
        Total::resume(self.compared)
    }
}
