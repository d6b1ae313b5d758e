//! The state of a key frame that has kept something.

use std::sync::Arc;

use streamsplat_model::StaticGaussians;

use super::{Lattice, Past};
use crate::stream::canonical::still;
use crate::stream::keyframe::KeyView;
use crate::stream::lift::Added;

/// State of a key frame that keeps parts of the one before, as far as it is not a function of its frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct KeptState {
    /// Its picture, with the mean in kept blocks: `[3, H, W]`.
    pub rgb: Vec<f32>,
    /// The past of its blocks.
    pub past: Past,
    /// Its Gaussians.
    pub gaussians: StaticGaussians,
    /// How many of them, at the end, are details (docs/choosing.md).
    pub details: usize,
}

impl KeptState {
    /// The state of a key frame; `None` where it has kept nothing.
    pub(in crate::stream) fn of(view: &KeyView) -> Option<Self> {
        let past = view.past.clone()?;
        let details = view.added.details;
        Some(Self { rgb: view.rgb.clone(), past, gaussians: StaticGaussians::clone(&view.gaussians), details })
    }

    /// Restores the state of a frame; there must be no [contradiction](Self::contradiction).
    pub(in crate::stream) fn restore(&self, view: &mut KeyView) {
        view.rgb.clone_from(&self.rgb);
        view.past = Some(self.past.clone());
        view.gaussians = Arc::new(self.gaussians.clone());
        let cells = self.gaussians.len() - self.details;
        view.added =
            Added { details: self.details, moving: self.gaussians.position[cells..].to_vec(), ..Added::default() };
    }

    /// Returns true if all numbers of a Gaussian can be drawn.
    pub(in crate::stream) fn is_sound(&self, cell: usize) -> bool {
        still(&self.gaussians, cell, 0).is_sound()
    }

    /// Returns why this cannot be the state of a key frame of this size.
    pub(in crate::stream) fn contradiction(&self, size: [usize; 2]) -> Option<String> {
        let Self { rgb, past, gaussians: g, details } = self;
        if rgb.len() != 3 * size[0] * size[1] || !rgb.iter().all(|x| (0.0..=1.0).contains(x)) {
            return Some(format!("expected a picture of {}x{} with values from 0 to 1", size[1], size[0]));
        }
        let cells = g.len().checked_sub(*details).and_then(|cells| Lattice::of(cells, size));
        if g.uneven().is_some() || cells.is_none() {
            return Some(format!("expected kept Gaussians on a lattice, found {} with {details} details", g.len()));
        }
        past.contradiction(size)
    }
}
