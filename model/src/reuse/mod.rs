//! Leaving out what did not change since the key frame before.
//!
//! A [`Session`](crate::Session) may keep, for every part of a network, the part's last input and output: its
//! [`Cache`]. With it the part computes only rows (tokens) whose input changed, and takes the rest from there:
//!
//! - [`Saving::Exact`]: no output bit changes. A block whose attention runs in windows computes the windows with a
//!   token whose bits changed. Without windows every token depends on all others, and nothing can be
//!   kept: this is for models with `encoder_window`.
//! - [`Saving::Within`]: a token is computed anew when its input moved by more than the tolerance (relative to its
//!   length, see [`streamsplat_kernels::change`]) since it was last computed, block by block. Only such tokens are
//!   queried and only their keys and values are replaced; every other keeps its last output. The decoder and the
//!   deformation upsampler tolerate [`Cache::MOTION`] times as much: motion shows less of an error than colour does. A
//!   token that a block drops is dropped by all that follow. Errors do not build up without bound: a part computes
//!   everything anew after [`Cache::REFRESH`] steps, or once [`Cache::REPLACED`] times all its tokens have been
//!   computed one by one.
//!
//! If more than [`Cache::MOST`] of a part's tokens changed, it is computed without a cache, and keeps only
//! its input: a moving camera costs the comparison alone. It is computed and kept when that share falls again.
//! The first frame is kept whole; the first pair's parts for motion only if the encoder's tokens did not
//! change as much.
//!
//! The decoder's input is a pair of frames, and its cache belongs to the pair's places, not to the frames: `h` of frame
//! k is compared in the place of the later frame with that of frame k−1, and a step later, in the place of the earlier
//! frame, with it again. A new thing changes one place only, but the motion in both: a token is computed in both
//! places when it changed in either.
//!
//! DINOv2 has a session of its own ([`DinoSession`](crate::DinoSession)), with the same gates and the decoder's
//! tolerance, and nothing to keep exactly: each of its features depends on all others. They are compared once more as
//! the decoder's condition. The class token and the registers enter it the same in every frame, and so are computed
//! when everything is.
//!
//! # Order
//! Which rows are computed follows from the comparison alone, whose order of operations is fixed; rows are gathered in
//! ascending order of tokens (in the upsamplers: each token's four sub-tokens one after the other), and no row's bits
//! depend on which others there are. So the results are the same on every level and for any number of threads.
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

/// Work that may be left out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Saving {
    /// Results of the same input bits as before.
    Exact,
    /// Also what would be computed from inputs that moved by no more than this fraction of their length.
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

/// Work of a part in tokens: one for every token a block computes, or does not need to.
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
    /// Steps after which a part computes everything anew.
    pub const REFRESH: u32 = 48;
    /// How many times over a part's tokens are computed one by one before it computes all of them anew.
    pub const REPLACED: usize = 6;
    /// By how much the tolerance is larger in the decoder and the deformation upsampler.
    pub const MOTION: f32 = 4.0;
    /// The largest share of a part's tokens that are computed one by one.
    pub const MOST: f64 = 0.6;

    /// An empty one; `None` when a network of this size has nothing to keep: where every token sees all others, no part
    /// of a frame is exactly as it was.
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

    /// Bytes it holds: at most those of a first key frame and a pair, for any length of the stream.
    pub fn bytes(&self) -> usize {
        let pair: usize = self.deformation.iter().map(|(up, head)| up.bytes() + head.bytes()).sum();
        self.encoder.bytes() + self.static_upsampler.bytes() + self.static_head.bytes() + self.decoder.bytes() + pair
    }

    /// An empty one with the same counters.
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
