//! The block of encoder and upsamplers.

use streamsplat_kernels::Level;
use streamsplat_kernels::attention::Windows;

use super::{FeedForward, SelfAttention, Workspace, add_zero};
use crate::ModelError;
use crate::checkpoint::Weights;
use crate::reuse::{BlockCache, Rows, gather};

/// `x += attention(norm₁(x))`, `x += feed_forward(norm₂(x))`; a zero-output branch is `None`.
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

    /// Applies the block to `rows`. `kept` is the block's cache, where there is one.
    pub(crate) fn apply(
        &self,
        level: Level,
        windows: Windows,
        rows: &mut Rows,
        kept: Option<&mut BlockCache>,
        work: &mut Workspace,
    ) {
        if let Some(attn) = &self.attn {
            attn.accumulate(level, windows, rows.at.as_deref(), &mut rows.x, kept.map(|kept| &mut kept.own), work);
        }
        match &self.mlp {
            Some(mlp) => mlp.accumulate(level, self.attn.is_none(), &mut rows.x),
            None => add_zero(&mut rows.x),
        }
    }

    /// [`Block::apply`] to all tokens `x` without a cache, for the tokens `part` alone: `rows` become their values.
    pub(crate) fn apply_part(
        &self,
        level: Level,
        windows: Windows,
        part: &[u32],
        x: &[f32],
        rows: &mut [f32],
        work: &mut Workspace,
    ) {
        gather(part, x, rows.len() / part.len(), rows);
        if let Some(attn) = &self.attn {
            attn.accumulate_part(level, windows, part, x, rows, work);
        }
        match &self.mlp {
            Some(mlp) => mlp.accumulate(level, self.attn.is_none(), rows),
            None => add_zero(rows),
        }
    }

    /// Returns true if only `x += 0` remains of the block.
    pub(crate) fn is_zero_output(&self) -> bool {
        self.attn.is_none() && self.mlp.is_none()
    }

    /// The windows in which the block mixes tokens, if it does.
    pub(crate) fn mixed(&self, windows: Windows) -> Option<Windows> {
        self.attn.as_ref().map(|_| windows)
    }

    pub(crate) fn bytes(&self) -> usize {
        self.attn.as_ref().map_or(0, SelfAttention::bytes) + self.mlp.as_ref().map_or(0, FeedForward::bytes)
    }
}

/// The windows of block `index`: odd ones are rolled by half a window. Without a window every token attends to all.
pub(crate) fn windows(window: Option<usize>, index: usize) -> Windows {
    match window {
        None => Windows::Full,
        Some(length) => Windows::Runs { length, roll: if index % 2 == 1 { length / 2 } else { 0 } },
    }
}
