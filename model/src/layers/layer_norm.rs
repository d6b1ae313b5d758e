//! Layer normalisation, as DINOv2 uses it.

use streamsplat_kernels::Level;
use streamsplat_kernels::norm::{self, Norm};

use crate::ModelError;
use crate::checkpoint::Weights;

/// `(x − mean) / √(variance + 10⁻⁶) · w + b` for every row.
pub(crate) struct LayerNorm {
    weight: Vec<f32>,
    bias: Vec<f32>,
}

impl LayerNorm {
    const EPSILON: f32 = 1e-6;

    /// The norm of the tensors `name.weight [d]` and `name.bias [d]`.
    pub(crate) fn load(weights: &Weights<'_>, name: &str, d: usize) -> Result<LayerNorm, ModelError> {
        Ok(LayerNorm {
            weight: weights.vector(&format!("{name}.weight"), &[d])?,
            bias: weights.vector(&format!("{name}.bias"), &[d])?,
        })
    }

    /// The norm for products that normalise their rows.
    pub(crate) fn norm(&self) -> Norm<'_> {
        Norm::layer(&self.weight, &self.bias, Self::EPSILON)
    }

    pub(crate) fn apply(&self, level: Level, x: &[f32], out: &mut [f32]) {
        norm::layer_norm(level, x, &self.weight, &self.bias, Self::EPSILON, out);
    }

    pub(crate) fn bytes(&self) -> usize {
        4 * (self.weight.len() + self.bias.len())
    }
}
