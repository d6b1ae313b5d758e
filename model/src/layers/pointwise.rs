//! Narrow layers, whose tokens are in lanes.

use streamsplat_kernels::gemm::Activation;
use streamsplat_kernels::pointwise::Layer;

use super::Bias;
use crate::ModelError;
use crate::checkpoint::Weights;

/// Loads layers with the same input as one; their outputs follow one another. Each is a name, its output channels and
/// whether it has a bias.
pub(crate) fn load_pointwise(
    weights: &Weights<'_>,
    layers: &[(&str, usize, Bias)],
    activation: Activation,
    k: usize,
) -> Result<Layer, ModelError> {
    let (mut weight, mut biases) = (Vec::new(), Vec::new());
    for &(name, n, bias) in layers {
        weight.extend_from_slice(&weights.read(&format!("{name}.weight"), &[n, k])?);
        match bias {
            Bias::Yes => biases.extend_from_slice(&weights.vector(&format!("{name}.bias"), &[n])?),
            // Adding −0 changes no bit of a number.
            Bias::No => biases.resize(biases.len() + n, -0.0),
        }
    }
    Ok(Layer::pack(&weight, Some(&biases), activation, biases.len(), k))
}
