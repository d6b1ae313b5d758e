//! The block of encoder and upsamplers.

use streamsplat_kernels::Level;
use streamsplat_kernels::attention::Windows;

use super::{FeedForward, RmsNorm, SelfAttention, Workspace};
use crate::ModelError;
use crate::checkpoint::Weights;

/// `x += attention(norm₁(x))`, `x += feed_forward(norm₂(x))`
pub(crate) struct Block {
    layernorm1: RmsNorm,
    attn: SelfAttention,
    layernorm2: RmsNorm,
    mlp: FeedForward,
}

impl Block {
    pub(crate) fn load(weights: &Weights<'_>, d: usize) -> Result<Block, ModelError> {
        Ok(Block {
            layernorm1: RmsNorm::load(weights, "layernorm1", d)?,
            attn: SelfAttention::load(&weights.at("attn"), d)?,
            layernorm2: RmsNorm::load(weights, "layernorm2", d)?,
            mlp: FeedForward::load(&weights.at("mlp"), d)?,
        })
    }

    pub(crate) fn apply(&self, level: Level, windows: Windows, x: &mut [f32], work: &mut Workspace) {
        self.attn.accumulate(level, &self.layernorm1, windows, x, work);
        self.mlp.accumulate(level, &self.layernorm2, x, work);
    }

    /// [`Block::apply`] of the tokens `at` alone, whose rows `x` holds; `keys_values [n, 2d]` holds those of all tokens, and gets theirs.
    pub(crate) fn apply_some(
        &self,
        level: Level,
        windows: Windows,
        at: &[u32],
        x: &mut [f32],
        keys_values: &mut [f32],
        work: &mut Workspace,
    ) {
        self.attn.accumulate_some(level, &self.layernorm1, windows, at, x, keys_values, work);
        self.mlp.accumulate(level, &self.layernorm2, x, work);
    }

    pub(crate) fn bytes(&self) -> usize {
        self.layernorm1.bytes() + self.attn.bytes() + self.layernorm2.bytes() + self.mlp.bytes()
    }
}

/// The windows of block `index`: odd ones are rolled by half a window. Without a window everything sees everything.
pub(crate) fn windows(window: Option<usize>, index: usize) -> Windows {
    match window {
        None => Windows::Full,
        Some(length) => Windows::Runs { length, roll: if index % 2 == 1 { length / 2 } else { 0 } },
    }
}
