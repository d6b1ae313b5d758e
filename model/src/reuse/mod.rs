//! Skips the computation of tokens that did not change since the previous key frame.
//!
//! A [`Session`](crate::Session) may keep the last input and output of every part of a network, in its [`Cache`]. A
//! part then computes only rows (tokens) whose input changed, and takes the others from the cache:
//!
//! - [`Saving::Exact`]: no output bit changes. A block whose attention runs in windows computes the windows with a
//!   token whose bits changed. Without windows every token depends on all others and nothing can be kept, so this is
//!   for models with `encoder_window`.
//! - [`Saving::Within`]: block by block, a token is recomputed when its input moved by more than the tolerance since
//!   its last computation (relative to its length, see [`streamsplat_kernels::change`]). Only these tokens are queried
//!   and only their keys and values are replaced; every other keeps its last output. The decoder and the deformation
//!   upsampler tolerate [`Cache::MOTION`] times as much, as errors are less visible in motion than in colour. A token
//!   that a block drops is dropped by all following blocks. Errors do not grow without bound: a part recomputes
//!   everything after [`Cache::REFRESH`] steps, or once it has computed [`Cache::REPLACED`] times its number of tokens
//!   one by one.
//!
//! If more than [`Cache::MOST`] of a part's tokens changed, it is computed without a cache and keeps only its input: a
//! moving camera costs only the comparison. It is computed and kept when that share falls again. The first frame is
//! kept whole. The first pair's parts for motion are kept only if the encoder's tokens did not change as much.
//!
//! The decoder's input is a pair of frames. Its cache belongs to the two places of the pair (earlier and later), not to
//! the frames. `h` of frame k is first compared with that of frame k−1 in the place of the later frame; a step later,
//! in the place of the earlier frame, it is compared with that of frame k−1 again. A new object changes only one place,
//! but the motion in both, so a token is computed in both places when it changed in either.
//!
//! DINOv2 has a session of its own ([`DinoSession`](crate::DinoSession)), with the same gates and the decoder's
//! tolerance. It keeps nothing exactly, as each of its features depends on all others. They are compared once more as
//! the decoder's condition. The class token and the registers have the same input in every frame, and so are computed
//! only when everything is.
//!
//! # Order
//! The set of computed rows follows only from the comparison, whose order of operations is fixed. Rows are gathered in
//! ascending order of tokens (in the upsamplers: each token's four sub-tokens one after the other). No row's bits
//! depend on the other rows of the set. So the results are the same on every level and for any number of threads.
//!
//! Source: Dutson, Li and Gupta, "Eventful Transformers" (ICCV 2023), with one gate per block.

mod heads;
mod part;
mod rows;
mod schedule;

use streamsplat_kernels::change::Tolerance;

use heads::{DeformationHeadCache, StaticHeadCache};
pub(crate) use part::{BlockCache, PartCache, Pass};
pub(crate) use rows::{Rows, gather, keep_heads};

use crate::Config;

/// Work that may be skipped.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Saving {
    /// Results of the same input bits as before.
    Exact,
    /// Also results of inputs that moved by no more than this fraction of their length.
    Within(f32),
}

impl Saving {
    fn tolerance(self) -> Tolerance {
        match self {
            Saving::Exact => Tolerance::Bits,
            Saving::Within(tau) => Tolerance::Relative(tau),
        }
    }

    /// For the parts that compute motion: the tolerance times [`Cache::MOTION`].
    fn of_motion(self) -> Saving {
        match self {
            Saving::Exact => Saving::Exact,
            Saving::Within(tau) => Saving::Within(Cache::MOTION * tau),
        }
    }
}

/// Work of a part in tokens: one for every token that a block computes or takes from its cache.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tokens {
    /// Computed.
    pub done: u64,
    /// Kept from before.
    pub avoided: u64,
}

impl std::ops::Add for Tokens {
    type Output = Tokens;
    fn add(self, other: Tokens) -> Tokens {
        Tokens { done: self.done + other.done, avoided: self.avoided + other.avoided }
    }
}

impl Tokens {
    fn count(&mut self, done: usize, of: usize) {
        self.done += done as u64;
        self.avoided += (of - done) as u64;
    }
}

/// Caches of the parts of one network, from key frame to key frame. It is bounded: see [`Cache::bytes`].
#[derive(Debug)]
pub struct Cache {
    saving: Saving,
    pub(crate) encoder: PartCache,
    pub(crate) static_upsampler: PartCache,
    pub(crate) static_head: StaticHeadCache,
    pub(crate) decoder: PartCache,
    /// Caches of the earlier and the later frame of a pair.
    pub(crate) deformation: [(PartCache, DeformationHeadCache); 2],
}

impl Cache {
    /// Steps after which a part recomputes everything.
    pub const REFRESH: u32 = 48;
    /// Multiple of a part's tokens that are computed one by one before all of them are recomputed.
    pub const REPLACED: usize = 6;
    /// Factor of the tolerance in the decoder and the deformation upsampler.
    pub const MOTION: f32 = 4.0;
    /// The largest share of a part's tokens that are computed one by one.
    pub const MOST: f64 = 0.6;

    /// Returns an empty cache, or `None` when a network of this size has nothing to keep: where every token attends to
    /// all others, no result is exactly as before.
    pub(crate) fn new(saving: Saving, config: &Config) -> Option<Cache> {
        if saving == Saving::Exact && config.encoder_window.is_none() {
            return None;
        }
        let of_motion = saving.of_motion();
        let deformation = || (PartCache::upsampler(of_motion, config), DeformationHeadCache::new(config));
        Some(Cache {
            saving,
            encoder: PartCache::encoder(saving, config),
            static_upsampler: PartCache::upsampler(saving, config),
            static_head: StaticHeadCache::default(),
            decoder: PartCache::decoder(of_motion, config),
            deformation: [deformation(), deformation()],
        })
    }

    /// Tokens computed and kept, by part: `encoder`, `upsampler`, `decoder`, `heads`.
    pub fn tokens(&self) -> [(&'static str, Tokens); 4] {
        let [(up_a, head_a), (up_b, head_b)] = &self.deformation;
        [
            ("encoder", self.encoder.tokens),
            ("upsampler", self.static_upsampler.tokens + up_a.tokens + up_b.tokens),
            ("decoder", self.decoder.tokens),
            ("heads", self.static_head.tokens + head_a.tokens + head_b.tokens),
        ]
    }

    /// Bytes held: at most those of a first key frame and a pair, for any length of the stream.
    pub fn bytes(&self) -> usize {
        let pair: usize = self.deformation.iter().map(|(up, head)| up.bytes() + head.bytes()).sum();
        self.encoder.bytes() + self.static_upsampler.bytes() + self.static_head.bytes() + self.decoder.bytes() + pair
    }

    /// Returns an empty cache with the same counters.
    pub(crate) fn emptied(&self, config: &Config) -> Option<Cache> {
        let mut empty = Cache::new(self.saving, config)?;
        let counts = [
            &mut empty.encoder.tokens,
            &mut empty.static_upsampler.tokens,
            &mut empty.decoder.tokens,
            &mut empty.static_head.tokens,
        ];
        counts.into_iter().zip(self.tokens()).for_each(|(count, (_, before))| *count = before);
        Some(empty)
    }
}
