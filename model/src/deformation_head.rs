//! From upsampled tokens to motion and fading.
//!
//! ```text
//! input = [encoder_proj(static token), dynamic token]
//! velocity = tanh(mlp_v(input))·(1 − ε)·dynamic_scalar
//! γ₀ = relu(mlp_γ(input)₀),  γ₁ = σ(mlp_γ(input)₁)
//! ```
//!
//! Both are three linear layers, 2d → d → d → out, with SiLU between them.

use streamsplat_kernels::{Level, activation, truncated_normal};

use crate::checkpoint::Weights;
use crate::keys;
use crate::layers::{Bias, Linear, ROWS, Workspace, sized};
use crate::{Config, ModelError};

pub(crate) struct DeformationHead {
    encoder_proj: Linear,
    velocity: Mlp,
    gamma: Mlp,
    dynamic_scalar: [f32; 3],
}

struct Mlp([Linear; 3]);

impl DeformationHead {
    /// `weights` is the whole model's: the head's tensors lie in two places.
    pub(crate) fn load(weights: &Weights<'_>, config: &Config) -> Result<DeformationHead, ModelError> {
        let d = config.gaussian_dim();
        let head = weights.at(keys::DEFORMATION_HEAD);
        // Only training draws velocities; the tensor is checked all the same.
        head.shape_like("gs_layer.xyz_dynamic_scale.weight", [Some(3), Some(2 * d)])?;
        let scalar = head.vector("dynamic_scalar", &[3])?;
        Ok(DeformationHead {
            encoder_proj: Linear::load(weights, "encoder_proj", d, d, Bias::No)?,
            velocity: Mlp::load(&head.at("gs_layer.xyz_dynamic.layers"), d, 3)?,
            gamma: Mlp::load(&head.at("gs_layer.opacity_dynamic.layers"), d, 2)?,
            dynamic_scalar: [scalar[0], scalar[1], scalar[2]],
        })
    }

    /// Velocity and γ of every token.
    pub(crate) fn apply(
        &self,
        level: Level,
        static_tokens: &[f32],
        tokens: &[f32],
        work: &mut Workspace,
    ) -> (Vec<[f32; 3]>, Vec<[f32; 2]>) {
        let d = self.encoder_proj.n();
        let n = tokens.len() / d;
        let (mut velocity, mut gamma) = (vec![[0.0; 3]; n], vec![[0.0; 2]; n]);
        let Workspace { normed, projected: pairs, mixed, hidden, .. } = work;
        let chunks = static_tokens.chunks(ROWS * d).zip(tokens.chunks(ROWS * d));
        let results = velocity.chunks_mut(ROWS).zip(gamma.chunks_mut(ROWS));
        for ((static_tokens, tokens), (velocity, gamma)) in chunks.zip(results) {
            let rows = velocity.len();
            let projected = sized(normed, rows * d);
            self.encoder_proj.apply(level, static_tokens, projected);
            let joined = sized(pairs, rows * 2 * d);
            let halves = projected.chunks_exact(d).zip(tokens.chunks_exact(d));
            for (row, (left, right)) in joined.chunks_exact_mut(2 * d).zip(halves) {
                row[..d].copy_from_slice(left);
                row[d..].copy_from_slice(right);
            }
            let mut hidden = [sized(mixed, rows * d), sized(hidden, rows * d)];
            self.velocity.apply(level, joined, &mut hidden, velocity.as_flattened_mut());
            self.gamma.apply(level, joined, &mut hidden, gamma.as_flattened_mut());
        }
        let layer = velocity.clone();
        truncated_normal::mean(level, layer.as_flattened(), velocity.as_flattened_mut());
        for v in velocity.iter_mut() {
            v.iter_mut().zip(self.dynamic_scalar).for_each(|(v, scalar)| *v *= scalar);
        }
        let mut fade: Vec<f32> = gamma.iter().map(|g| g[1]).collect();
        activation::sigmoid(level, &mut fade);
        for (g, fade) in gamma.iter_mut().zip(fade) {
            *g = [if g[0] > 0.0 { g[0] } else { 0.0 }, fade];
        }
        (velocity, gamma)
    }

    pub(crate) fn bytes(&self) -> usize {
        self.encoder_proj.bytes() + self.velocity.bytes() + self.gamma.bytes()
    }
}

impl Mlp {
    fn load(weights: &Weights<'_>, d: usize, out: usize) -> Result<Mlp, ModelError> {
        Ok(Mlp([
            Linear::load(weights, "1", d, 2 * d, Bias::Yes)?,
            Linear::load(weights, "4", d, d, Bias::Yes)?,
            Linear::load(weights, "7", out, d, Bias::Yes)?,
        ]))
    }

    fn apply(&self, level: Level, x: &[f32], hidden: &mut [&mut [f32]; 2], out: &mut [f32]) {
        let [first, second, last] = &self.0;
        let [a, b] = hidden;
        first.apply_silu(level, x, a);
        second.apply_silu(level, a, b);
        last.apply(level, b, out);
    }

    fn bytes(&self) -> usize {
        self.0.iter().map(Linear::bytes).sum()
    }
}
