//! The heads: rows whose tokens did not change keep their results, bit for bit.

use streamsplat_kernels::Level;
use streamsplat_kernels::change::Tolerance;

use super::Tokens;
use super::part::PartCache;
use super::rows::{Gate, gather, places};
use crate::{Config, StaticGaussian, StaticGaussians};

/// Velocity and γ of every token.
type Motion = (Vec<[f32; 3]>, Vec<[f32; 2]>);

/// The rows `at` of `x`, which has `n`.
fn some(at: &[u32], x: &[f32], n: usize) -> Vec<f32> {
    let d = x.len() / n;
    let mut rows = vec![0.0; at.len() * d];
    gather(at, x, d, &mut rows);
    rows
}

/// Cache of the static head.
#[derive(Debug, Default)]
pub(crate) struct StaticHeadCache {
    /// Calls of the upsampler at the last update.
    calls: u64,
    gaussians: StaticGaussians,
    pub(super) tokens: Tokens,
}

impl StaticHeadCache {
    pub(super) fn bytes(&self) -> usize {
        self.gaussians.len() * size_of::<StaticGaussian>()
    }

    /// Returns the Gaussians of the `n` rows of `tokens`, the result of the last call of `upsampler`. `head` computes
    /// those of all cells, or of some.
    pub(crate) fn renew(
        &mut self,
        n: usize,
        tokens: &[f32],
        upsampler: &PartCache,
        head: impl Fn(&[f32], Option<&[u32]>) -> StaticGaussians,
    ) -> StaticGaussians {
        let follows = self.calls > 0 && self.calls + 1 == upsampler.calls;
        self.calls = upsampler.calls;
        match &upsampler.latest {
            Some(changed) if follows => {
                let some = head(&some(changed, tokens, n), Some(changed));
                changed.iter().zip(some.iter()).for_each(|(row, renewed)| self.gaussians.set(*row as usize, renewed));
                self.tokens.count(changed.len(), n);
            }
            _ => {
                self.gaussians = head(tokens, None);
                self.tokens.count(n, n);
            }
        }
        self.gaussians.clone()
    }
}

/// Cache of the deformation head for one frame of the pair.
#[derive(Debug)]
pub(crate) struct DeformationHeadCache {
    calls: u64,
    /// The static tokens; empty where nothing is kept.
    still: Gate,
    kept: bool,
    motion: Motion,
    pub(super) tokens: Tokens,
}

impl DeformationHeadCache {
    pub(super) fn new(config: &Config) -> DeformationHeadCache {
        let still = Gate::new(config.gaussians(), config.gaussian_dim());
        DeformationHeadCache { calls: 0, still, kept: false, motion: Motion::default(), tokens: Tokens::default() }
    }

    pub(super) fn bytes(&self) -> usize {
        self.still.bytes() + 4 * (3 * self.motion.0.len() + 2 * self.motion.1.len())
    }

    /// Returns the motion of `tokens`, the result of the last call of `upsampler`. `head` computes that of some rows
    /// from both kinds of tokens.
    pub(crate) fn renew(
        &mut self,
        level: Level,
        static_tokens: &[f32],
        tokens: &[f32],
        upsampler: &PartCache,
        head: impl Fn(&[f32], &[f32]) -> Motion,
    ) -> Motion {
        let n = self.still.rows();
        let follows = self.kept && self.calls + 1 == upsampler.calls;
        self.calls = upsampler.calls;
        match &upsampler.latest {
            Some(changed) if follows => {
                let mut marks = self.still.moved(level, Tolerance::Bits, static_tokens);
                changed.iter().for_each(|row| marks[*row as usize] = true);
                let at = places(&marks);
                self.still.replace(&at, static_tokens);
                let (velocity, gamma) = head(&some(&at, static_tokens, n), &some(&at, tokens, n));
                for (i, row) in at.iter().map(|row| *row as usize).enumerate() {
                    self.motion.0[row] = velocity[i];
                    self.motion.1[row] = gamma[i];
                }
                self.tokens.count(at.len(), n);
            }
            latest => {
                // Static tokens are kept once the upsampler begins to skip tokens.
                self.kept = latest.is_some();
                if self.kept {
                    self.still.keep(static_tokens);
                }
                self.motion = head(static_tokens, tokens);
                self.tokens.count(n, n);
            }
        }
        self.motion.clone()
    }
}
