//! The feed-forward layer of a block.

use streamsplat_kernels::{Level, feed_forward};

use super::{Bias, Linear, RmsNorm, add_zero};
use crate::ModelError;
use crate::checkpoint::Weights;

/// `W₂ · silu(W₁ · x)` without biases, hidden width 4d: a residual branch.
#[derive(Clone)]
pub(crate) struct FeedForward {
    norm: RmsNorm,
    expand: Linear,
    contract: Linear,
}

impl FeedForward {
    /// Loads the layer `name` of a block with its norm; `None` where it is zero-output.
    pub(crate) fn load(
        weights: &Weights<'_>,
        norm: &str,
        name: &str,
        d: usize,
    ) -> Result<Option<FeedForward>, ModelError> {
        let norm = RmsNorm::load(weights, norm, d)?;
        let weights = &weights.at(name);
        if weights.leaves_out("c_proj") {
            weights.check("c_fc.weight", &[4 * d, d])?;
            weights.check("c_proj.weight", &[d, 4 * d])?;
            return Ok(None);
        }
        Ok(Some(FeedForward {
            norm,
            expand: Linear::load(weights, "c_fc", 4 * d, d, Bias::No)?,
            contract: Linear::load(weights, "c_proj", d, 4 * d, Bias::No)?,
        }))
    }

    /// `x += feed_forward(norm(x))`. With `after_zero_output`, `x += 0` comes first: the rest of a zero-output branch
    /// before it.
    pub(crate) fn accumulate(&self, level: Level, after_zero_output: bool, x: &mut [f32]) {
        if after_zero_output {
            add_zero(x);
        }
        let layer = feed_forward::FeedForward {
            norm: self.norm.norm(),
            expand: self.expand.weights(),
            hidden: self.expand.epilogue().silu(),
            contract: self.contract.weights(),
            residual: self.contract.epilogue().residual(),
        };
        layer.accumulate(level, x);
    }

    pub(crate) fn bytes(&self) -> usize {
        self.norm.bytes() + self.expand.bytes() + self.contract.bytes()
    }
}
