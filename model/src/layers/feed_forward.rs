//! The feed-forward layer of a block.

use streamsplat_kernels::Level;

use super::{Bias, Linear, ROWS, RmsNorm, Workspace, sized};
use crate::ModelError;
use crate::checkpoint::Weights;

/// `W₂ · silu(W₁ · x)` without biases, hidden width 4d.
pub(crate) struct FeedForward {
    expand: Linear,
    contract: Linear,
}

impl FeedForward {
    pub(crate) fn load(weights: &Weights<'_>, d: usize) -> Result<FeedForward, ModelError> {
        Ok(FeedForward {
            expand: Linear::load(weights, "c_fc", 4 * d, d, Bias::No)?,
            contract: Linear::load(weights, "c_proj", d, 4 * d, Bias::No)?,
        })
    }

    /// `x += feed_forward(norm(x))`
    pub(crate) fn accumulate(&self, level: Level, norm: &RmsNorm, x: &mut [f32], work: &mut Workspace) {
        let d = self.expand.k();
        for x in x.chunks_mut(ROWS * d) {
            let normed = sized(&mut work.normed, x.len());
            norm.apply(level, x, normed);
            let hidden = sized(&mut work.hidden, 4 * x.len());
            self.expand.apply_silu(level, normed, hidden);
            self.contract.accumulate(level, hidden, x);
        }
    }

    pub(crate) fn bytes(&self) -> usize {
        self.expand.bytes() + self.contract.bytes()
    }
}
