//! DINOv2 on the frames of one stream.

use std::borrow::Borrow;

use crate::reuse::{PartCache, Saving, Tokens};
use crate::{Dino, DinoFeatures, ModelError};

/// A session of DINOv2 for the frames of one stream, in order. With [`Saving::Within`] it keeps results for the next
/// frame: see [`crate::reuse`].
#[derive(Debug)]
pub struct DinoSession<D> {
    dino: D,
    cache: Option<PartCache>,
}

impl<D: Borrow<Dino>> DinoSession<D> {
    /// A session without kept results. It only keeps any with [`Saving::Within`].
    pub fn new(dino: D, saving: Option<Saving>) -> DinoSession<D> {
        let config = dino.borrow().config();
        let n = 1 + config.register_tokens + config.grid().iter().product::<usize>();
        let cache = saving.and_then(|saving| PartCache::features(saving, n, config.embed_dim, config.depth));
        DinoSession { dino, cache }
    }

    /// [`Dino::features`], except for tokens that hardly moved: these keep their features.
    ///
    /// # Errors
    /// As [`Dino::features`].
    pub fn features(&mut self, rgb: &[f32], size: [usize; 2]) -> Result<DinoFeatures, ModelError> {
        self.dino.borrow().compute(rgb, size, self.cache.as_mut())
    }

    /// Tokens computed and kept, one for every token and block; `None` where nothing is kept.
    pub fn tokens(&self) -> Option<Tokens> {
        self.cache.as_ref().map(PartCache::tokens)
    }

    /// Bytes kept: at most those of one frame, for any length of the stream.
    pub fn bytes(&self) -> usize {
        self.cache.as_ref().map_or(0, PartCache::bytes)
    }

    /// The network.
    pub fn dino(&self) -> &Dino {
        self.dino.borrow()
    }

    /// Forgets everything but the counts: the next call is computed in full.
    pub fn forget(&mut self) {
        self.cache = self.cache.as_ref().map(PartCache::emptied);
    }
}
