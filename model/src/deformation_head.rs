//! From upsampled tokens to motion and fading.
//!
//! ```text
//! input = [encoder_proj(static token), dynamic token]
//! velocity = tanh(mlp_v(input))·(1 − ε)·dynamic_scalar
//! γ₀ = relu(mlp_γ(input)₀),  γ₁ = σ(mlp_γ(input)₁)
//! ```
//!
//! Both are three linear layers, 2d → d → d → out, with SiLU between them.

use std::sync::Arc;

use streamsplat_kernels::gemm::Activation::{Identity, Silu};
use streamsplat_kernels::memory::Scratch;
use streamsplat_kernels::pointwise::{self, Layer, TOKENS};
use streamsplat_kernels::{Level, activation, truncated_normal};

use crate::checkpoint::Weights;
use crate::keys;
use crate::layers::{Bias, load_pointwise};
use crate::{Config, ModelError};

#[derive(Clone)]
pub(crate) struct DeformationHead {
    encoder_proj: Arc<Layer>,
    /// The first layers of both networks joined into one: they have the same input.
    first: Arc<Layer>,
    velocity: Rest,
    gamma: Rest,
    dynamic_scalar: [f32; 3],
}

/// The second and third layer of a network.
#[derive(Clone)]
struct Rest([Arc<Layer>; 2]);

impl DeformationHead {
    /// Loads the head. `weights` is the whole model's: the head's tensors are in two places.
    pub(crate) fn load(weights: &Weights<'_>, config: &Config) -> Result<DeformationHead, ModelError> {
        let d = config.gaussian_dim();
        let head = weights.at(keys::DEFORMATION_HEAD);
        // Only training draws velocities; the tensor is checked nevertheless.
        head.shape_like("gs_layer.xyz_dynamic_scale.weight", [Some(3), Some(2 * d)])?;
        let scalar = head.vector("dynamic_scalar", &[3])?;
        let layer = |name: &str| format!("gs_layer.{name}_dynamic.layers.1");
        let first = [layer("xyz"), layer("opacity")];
        let first = [(first[0].as_str(), d, Bias::Yes), (first[1].as_str(), d, Bias::Yes)];
        Ok(DeformationHead {
            encoder_proj: Arc::new(load_pointwise(weights, &[("encoder_proj", d, Bias::No)], Identity, d)?),
            first: Arc::new(load_pointwise(&head, &first, Silu, 2 * d)?),
            velocity: Rest::load(&head.at("gs_layer.xyz_dynamic.layers"), d, 3)?,
            gamma: Rest::load(&head.at("gs_layer.opacity_dynamic.layers"), d, 2)?,
            dynamic_scalar: [scalar[0], scalar[1], scalar[2]],
        })
    }

    /// Adapts to frames whose sides are those of training divided by `ratio`: velocities are fractions of a side.
    pub(crate) fn fit_to(&mut self, [x, z]: [f32; 2]) {
        self.dynamic_scalar = [self.dynamic_scalar[0] * x, self.dynamic_scalar[1], self.dynamic_scalar[2] * z];
    }

    /// Velocity and γ of every token.
    pub(crate) fn apply(&self, level: Level, static_tokens: &[f32], tokens: &[f32]) -> (Vec<[f32; 3]>, Vec<[f32; 2]>) {
        let d = self.encoder_proj.n();
        let n = tokens.len() / d;
        let mut rows = vec![[0.0; 5]; n];
        pointwise::for_each_block(rows.as_flattened_mut(), 5, |first, rows| {
            let part = first * d..(first + rows.len() / 5) * d;
            self.block(level, &static_tokens[part.clone()], &tokens[part], rows);
        });
        let mut velocity: Vec<[f32; 3]> = rows.iter().map(|row| [row[0], row[1], row[2]]).collect();
        let mut gamma: Vec<[f32; 2]> = rows.iter().map(|row| [row[3], row[4]]).collect();
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

    /// The last layers' outputs, five a row, of a block of tokens.
    fn block(&self, level: Level, static_tokens: &[f32], tokens: &[f32], rows: &mut [f32]) {
        let width = self.encoder_proj.n() * TOKENS;
        let mut memory = Scratch::take(6 * width);
        let (joined, hidden) = memory.split_at_mut(2 * width);
        let (hidden, second) = hidden.split_at_mut(2 * width);
        let (left, right) = joined.split_at_mut(width);
        pointwise::load(static_tokens, self.encoder_proj.k(), &mut hidden[..width]);
        self.encoder_proj.apply(level, &hidden[..width], left);
        pointwise::load(tokens, self.encoder_proj.n(), right);
        self.first.apply(level, joined, hidden);
        let mut last = [0.0; 5 * TOKENS];
        let (velocity, gamma) = last.split_at_mut(3 * TOKENS);
        self.velocity.apply(level, &hidden[..width], &mut second[..width], velocity);
        self.gamma.apply(level, &hidden[width..], &mut second[width..], gamma);
        pointwise::store(&last, 5, rows);
    }

    pub(crate) fn bytes(&self) -> usize {
        self.encoder_proj.bytes() + self.first.bytes() + self.velocity.bytes() + self.gamma.bytes()
    }
}

impl Rest {
    fn load(weights: &Weights<'_>, d: usize, out: usize) -> Result<Rest, ModelError> {
        Ok(Rest([
            Arc::new(load_pointwise(weights, &[("4", d, Bias::Yes)], Silu, d)?),
            Arc::new(load_pointwise(weights, &[("7", out, Bias::Yes)], Identity, d)?),
        ]))
    }

    fn apply(&self, level: Level, x: &[f32], hidden: &mut [f32], out: &mut [f32]) {
        let [second, last] = &self.0;
        second.apply(level, x, hidden);
        last.apply(level, hidden, out);
    }

    fn bytes(&self) -> usize {
        self.0.iter().map(|layer| layer.bytes()).sum()
    }
}
