//! The block of encoder and upsamplers.

use streamsplat_kernels::Level;
use streamsplat_kernels::attention::Windows;

use super::{FeedForward, SelfAttention, Workspace, add_zero};
use crate::ModelError;
use crate::checkpoint::Weights;

/// `x += attention(norm₁(x))`, `x += feed_forward(norm₂(x))`; a branch that is silent is none.
#[derive(Clone)]
pub(crate) struct Block {
    attn: Option<SelfAttention>,
    mlp: Option<FeedForward>,
}

impl Block {
    pub(crate) fn load(weights: &Weights<'_>, d: usize) -> Result<Block, ModelError> {
        Ok(Block {
            attn: SelfAttention::load(weights, "layernorm1", "attn", d)?,
            mlp: FeedForward::load(weights, "layernorm2", "mlp", d)?,
        })
    }

    pub(crate) fn apply(&self, level: Level, windows: Windows, x: &mut [f32], work: &mut Workspace) {
        if let Some(attn) = &self.attn {
            attn.accumulate(level, windows, x, work);
        }
        self.feed_forward(level, x);
    }

    /// [`Block::apply`] of the tokens `at` alone, whose rows `x` holds; `keys_values [2·heads][n][64]` holds those of all tokens, and gets theirs. A block
    /// that does not mix tokens leaves it as it is.
    pub(crate) fn apply_some(
        &self,
        level: Level,
        windows: Windows,
        at: &[u32],
        x: &mut [f32],
        keys_values: &mut [f32],
        work: &mut Workspace,
    ) {
        if let Some(attn) = &self.attn {
            attn.accumulate_some(level, windows, at, x, keys_values, work);
        }
        self.feed_forward(level, x);
    }

    /// Feed-forward layer, which follows the attention.
    fn feed_forward(&self, level: Level, x: &mut [f32]) {
        match &self.mlp {
            Some(mlp) => mlp.accumulate(level, self.attn.is_none(), x),
            None => add_zero(x),
        }
    }

    /// Returns true if nothing is left of it but `x += 0`.
    pub(crate) fn is_silent(&self) -> bool {
        self.attn.is_none() && self.mlp.is_none()
    }

    /// Returns true if a token's result depends on other tokens.
    pub(crate) fn mixes(&self) -> bool {
        self.attn.is_some()
    }

    pub(crate) fn bytes(&self) -> usize {
        self.attn.as_ref().map_or(0, SelfAttention::bytes) + self.mlp.as_ref().map_or(0, FeedForward::bytes)
    }
}

/// The windows of block `index`: odd ones are rolled by half a window. Without a window everything sees everything.
pub(crate) fn windows(window: Option<usize>, index: usize) -> Windows {
    match window {
        None => Windows::Full,
        Some(length) => Windows::Runs { length, roll: if index % 2 == 1 { length / 2 } else { 0 } },
    }
}
