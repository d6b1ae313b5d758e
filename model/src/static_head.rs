//! From upsampled tokens to the Gaussians of a frame.
//!
//! The grid has `H2 × W2` cells; `x_map` are the cell centres of [−1, 1] left to right and `z_map` those of [1, −1] top
//! to bottom:
//!
//! ```text
//! o = tanh(layer(token))   or, for a truncated normal, its mean tanh(layer(token))·(1 − ε) or a sample
//! position = (x_map + o₀/W2,  0.5 + 0.5·o₁,  z_map + o₂/H2)
//! scale = 0.1·softplus,  opacity = 0.05 + 0.95·σ,  rgb = σ
//! ```
//!
//! Scales are fractions of a frame's sides. For frames smaller than in training they are multiplied by the ratio of the
//! sides, so that they span as many cells as in training.

use std::sync::Arc;

use streamsplat_kernels::gemm::Activation;
use streamsplat_kernels::memory::Scratch;
use streamsplat_kernels::philox::Stream;
use streamsplat_kernels::pointwise::{self, Layer, TOKENS};
use streamsplat_kernels::{Level, activation, truncated_normal};

use crate::checkpoint::Weights;
use crate::layers::{Bias, load_pointwise};
use crate::{Config, ModelError, Sampling, StaticGaussians, StaticPosition};

#[derive(Clone)]
pub(crate) struct StaticHead {
    /// All heads joined into one layer: position (3), its log scale (3, only of a truncated normal), scale (2), opacity
    /// (1), rgb (3).
    layers: Arc<Layer>,
    kind: StaticPosition,
    x_map: Vec<f32>,
    z_map: Vec<f32>,
    /// The sides of a frame in training over this one's: of x and of z.
    ratio: [f32; 2],
}

impl StaticHead {
    pub(crate) fn load(weights: &Weights<'_>, config: &Config) -> Result<StaticHead, ModelError> {
        let yes = Bias::Yes;
        let position: &[(&str, usize, Bias)] = match config.static_position {
            StaticPosition::Tanh => &[("gs_layer.xyz_static", 3, yes)],
            StaticPosition::TruncatedNormal => {
                &[("mix_layer.xyz_static_mean", 3, yes), ("mix_layer.xyz_static_scale", 3, yes)]
            }
        };
        let rest = [("gs_layer.scale", 2, yes), ("gs_layer.opacity", 1, yes), ("gs_layer.rgb", 3, yes)];
        let layers = [position, &rest].concat();
        let layers = load_pointwise(weights, &layers, Activation::Identity, config.gaussian_dim())?;
        let [rows, columns] = config.gaussian_grid();
        let map = |name: &str, cell: &dyn Fn(usize) -> f64| {
            if weights.shape(name).is_some() {
                return weights.vector(name, &[rows * columns]);
            }
            Ok((0..rows * columns).map(|i| cell(i) as f32).collect())
        };
        Ok(StaticHead {
            layers: Arc::new(layers),
            kind: config.static_position,
            x_map: map("x_map", &|i| centre(i % columns, columns))?,
            z_map: map("z_map", &|i| -centre(i / columns, rows))?,
            ratio: [1.0; 2],
        })
    }

    /// Adapts to frames of `config`: the cells have its centres, and scales are multiplied by `ratio`.
    pub(crate) fn fit_to(&mut self, config: &Config, ratio: [f32; 2]) {
        self.ratio = ratio;
        let [rows, columns] = config.gaussian_grid();
        self.x_map = (0..rows * columns).map(|i| centre(i % columns, columns) as f32).collect();
        self.z_map = (0..rows * columns).map(|i| -centre(i / columns, rows) as f32).collect();
    }

    /// The Gaussians of the cells `at` (`None`: all), whose tokens these are.
    pub(crate) fn apply(
        &self,
        level: Level,
        config: &Config,
        tokens: &[f32],
        at: Option<&[u32]>,
        sampling: Sampling,
    ) -> StaticGaussians {
        let d = config.gaussian_dim();
        let n = tokens.len() / d;
        let mut position = vec![[0.0; 3]; n];
        let mut log_scale = match self.kind {
            StaticPosition::Tanh => Vec::new(),
            StaticPosition::TruncatedNormal => vec![[0.0; 3]; n],
        };
        let mut scale = vec![[0.0; 2]; n];
        let mut opacity = vec![0.0; n];
        let mut rgb = vec![[0.0; 3]; n];
        let width = self.layers.n();
        let mut values = vec![0.0; n * width];
        pointwise::for_each_block(&mut values, width, |first, rows| {
            let mut memory = Scratch::take((d + width) * TOKENS);
            let (x, out) = memory.split_at_mut(d * TOKENS);
            pointwise::load(&tokens[first * d..][..rows.len() / width * d], d, x);
            self.layers.apply(level, x, out);
            pointwise::store(out, width, rows);
        });
        for (i, mut row) in values.chunks_exact(width).enumerate() {
            take(&mut row, &mut position[i]);
            if let Some(log_scale) = log_scale.get_mut(i) {
                take(&mut row, log_scale);
            }
            take(&mut row, &mut scale[i]);
            opacity[i] = row[0];
            row = &row[1..];
            take(&mut row, &mut rgb[i]);
        }

        match self.kind {
            StaticPosition::Tanh => activation::tanh(level, position.as_flattened_mut()),
            StaticPosition::TruncatedNormal => {
                let layer = position.clone();
                truncated_normal::mean(level, layer.as_flattened(), position.as_flattened_mut());
                if let Sampling::Sample { seed, frame } = sampling {
                    let mean = position.clone();
                    let (mean, log_scale) = (mean.as_flattened(), log_scale.as_flattened());
                    truncated_normal::draw(Stream { seed, frame }, mean, log_scale, position.as_flattened_mut());
                }
            }
        }
        let [rows, columns] = config.gaussian_grid().map(|side| side as f32);
        for (i, o) in position.iter_mut().enumerate() {
            let cell = at.map_or(i, |at| at[i] as usize);
            let (x, z) = (self.x_map[cell], self.z_map[cell]);
            *o = [x + o[0] / columns, 0.5 + 0.5 * o[1], z + o[2] / rows];
        }
        activation::softplus(level, scale.as_flattened_mut());
        scale.as_flattened_mut().iter_mut().for_each(|s| *s *= 0.1);
        if self.ratio != [1.0; 2] {
            scale.iter_mut().for_each(|[x, z]| (*x, *z) = (*x * self.ratio[0], *z * self.ratio[1]));
        }
        activation::sigmoid(level, &mut opacity);
        opacity.iter_mut().for_each(|o| *o = 0.05 + 0.95 * *o);
        activation::sigmoid(level, rgb.as_flattened_mut());
        StaticGaussians { thickness: vec![1.0; opacity.len()], position, scale, opacity, rgb }
    }

    pub(crate) fn bytes(&self) -> usize {
        self.layers.bytes() + 4 * (self.x_map.len() + self.z_map.len())
    }
}

/// The centre of cell `i` of as many across [−1, 1].
fn centre(i: usize, cells: usize) -> f64 {
    (2 * i + 1) as f64 / cells as f64 - 1.0
}

/// Moves the first values of `row` to `to`.
fn take<const N: usize>(row: &mut &[f32], to: &mut [f32; N]) {
    let (first, rest) = row.split_at(N);
    to.copy_from_slice(first);
    *row = rest;
}
