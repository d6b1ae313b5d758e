//! RMS normalisation.

use streamsplat_kernels::Level;
use streamsplat_kernels::norm::{self, Norm};

use crate::ModelError;
use crate::checkpoint::Weights;

/// `x / √(mean(x²) + 10⁻⁵) · w` for every row. The published code calls the class LayerNorm.
#[derive(Clone)]
pub(crate) struct RmsNorm(Vec<f32>);

impl RmsNorm {
    const EPSILON: f32 = 1e-5;

    /// The norm of the tensor `name.weight [d]`.
    pub(crate) fn load(weights: &Weights<'_>, name: &str, d: usize) -> Result<RmsNorm, ModelError> {
        Ok(RmsNorm(weights.vector(&format!("{name}.weight"), &[d])?))
    }

    /// The norm for products that normalise their rows.
    pub(crate) fn norm(&self) -> Norm<'_> {
        Norm::rms(&self.0, Self::EPSILON)
    }

    /// Returns the normalised rows.
    pub(crate) fn of(&self, level: Level, x: &[f32]) -> Vec<f32> {
        let mut out = vec![0.0; x.len()];
        norm::rms_norm(level, x, &self.0, Self::EPSILON, &mut out);
        out
    }

    pub(crate) fn bytes(&self) -> usize {
        4 * self.0.len()
    }
}
