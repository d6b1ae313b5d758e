//! Linear layers.

use std::sync::Arc;

use streamsplat_kernels::Level;
use streamsplat_kernels::gemm::{self, Epilogue, Input, Precision};
use streamsplat_kernels::norm::Norm;

use super::HEAD;
use crate::ModelError;
use crate::checkpoint::Weights;

/// Presence of a layer's bias.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Bias {
    Yes,
    No,
}

/// `x · wᵀ (+ bias)` for `x [m,k]`, `w [n,k]`. Clones share the weights.
#[derive(Clone)]
pub(crate) struct Linear {
    weights: Arc<gemm::Weights>,
    bias: Option<Vec<f32>>,
}

impl Linear {
    /// The layer of the tensors `name.weight [n, k]` and `name.bias [n]`.
    pub(crate) fn load(
        weights: &Weights<'_>,
        name: &str,
        n: usize,
        k: usize,
        bias: Bias,
    ) -> Result<Linear, ModelError> {
        let key = format!("{name}.weight");
        let weight = weights.read(&key, &[n, k])?;
        let bias = match bias {
            Bias::Yes => Some(weights.vector(&format!("{name}.bias"), &[n])?),
            Bias::No => None,
        };
        let layer = Linear::new(weights.level(), weights.precision(), &weight, bias, n, k);
        drop(weight);
        weights.release(&key);
        Ok(layer)
    }

    /// Loads several layers with the same input as one, `names[i].weight [n, k]` and `names[i].bias [n]`. Their outputs
    /// follow one another.
    pub(crate) fn load_joined(weights: &Weights<'_>, names: &[&str], n: usize, k: usize) -> Result<Linear, ModelError> {
        let mut weight = Vec::with_capacity(names.len() * n * k);
        let mut bias = Vec::with_capacity(names.len() * n);
        for name in names {
            let key = format!("{name}.weight");
            weight.extend_from_slice(&weights.read(&key, &[n, k])?);
            weights.release(&key);
            bias.extend(weights.vector(&format!("{name}.bias"), &[n])?);
        }
        Ok(Linear::new(weights.level(), weights.precision(), &weight, Some(bias), names.len() * n, k))
    }

    /// The layer of the tensors `name.weight [4·width, k]` and `name.bias [4·width]` that widens a token to 2×2
    /// sub-tokens. In files the sub-tokens' values of a channel are adjacent. Here all channels of the first sub-token
    /// come first, then those of the second, and so on, as [`Linear::shuffled`] writes them.
    pub(crate) fn load_sub_tokens(
        weights: &Weights<'_>,
        name: &str,
        width: usize,
        k: usize,
    ) -> Result<Linear, ModelError> {
        let (key, n) = (format!("{name}.weight"), 4 * width);
        let weight = sub_tokens(&weights.read(&key, &[n, k])?, k);
        let bias = sub_tokens(&weights.vector(&format!("{name}.bias"), &[n])?, 1);
        let layer = Linear::new(weights.level(), weights.precision(), &weight, Some(bias), n, k);
        weights.release(&key);
        Ok(layer)
    }

    /// The layer of a weight in memory.
    pub(crate) fn new(
        level: Level,
        precision: Precision,
        weight: &[f32],
        bias: Option<Vec<f32>>,
        n: usize,
        k: usize,
    ) -> Linear {
        Linear { weights: Arc::new(gemm::Weights::pack_as(level, precision, weight, n, k)), bias }
    }

    /// Output columns.
    pub(crate) fn n(&self) -> usize {
        self.weights.n()
    }

    /// Input columns.
    pub(crate) fn k(&self) -> usize {
        self.weights.k()
    }

    /// The format of the product's operands.
    pub(crate) fn precision(&self) -> Precision {
        self.weights.precision()
    }

    /// Bytes held.
    pub(crate) fn bytes(&self) -> usize {
        self.weights.bytes() + self.bias.as_ref().map_or(0, |b| 4 * b.len())
    }

    /// The packed weight.
    pub(crate) fn weights(&self) -> &gemm::Weights {
        &self.weights
    }

    /// The bias as the product's epilogue.
    pub(crate) fn epilogue(&self) -> Epilogue<'_> {
        Epilogue::new().maybe_bias(self.bias.as_deref())
    }

    fn run(&self, level: Level, x: Input<'_>, epilogue: Epilogue<'_>, out: &mut [f32]) {
        gemm::linear(level, x, out.len() / self.n(), &self.weights, &epilogue, out);
    }

    /// `out = layer(x)`
    pub(crate) fn apply(&self, level: Level, x: &[f32], out: &mut [f32]) {
        self.run(level, Input::Rows(x), self.epilogue(), out);
    }

    /// `out = layer(x)` as attention reads it, head after head: `[n/64][m][64]`.
    pub(crate) fn heads(&self, level: Level, x: &[f32], out: &mut [f32]) {
        self.run(level, Input::Rows(x), self.epilogue().in_groups_of(HEAD), out);
    }

    /// [`Linear::heads`] of `norm(x)`.
    pub(crate) fn heads_of_normed(&self, level: Level, norm: Norm<'_>, x: &[f32], out: &mut [f32]) {
        self.run(level, Input::Normed(x, norm), self.epilogue().in_groups_of(HEAD), out);
    }

    /// `out = layer(x)` for the tokens of a grid, as the tokens of a grid twice as fine. See [`Epilogue::shuffled`].
    pub(crate) fn shuffled(&self, level: Level, columns: usize, x: &[f32], out: &mut [f32]) {
        self.run(level, Input::Rows(x), self.epilogue().shuffled(columns), out);
    }

    /// `out += layer(x)`
    pub(crate) fn accumulate(&self, level: Level, x: &[f32], out: &mut [f32]) {
        self.run(level, Input::Rows(x), self.epilogue().residual(), out);
    }

    /// `out += γ · layer(x)`
    pub(crate) fn accumulate_scaled(&self, level: Level, x: &[f32], gamma: &[f32], out: &mut [f32]) {
        self.run(level, Input::Rows(x), self.epilogue().gamma(gamma).residual(), out);
    }
}

/// Rows of `k` values, `4c + part` of them at `part·n/4 + c`.
fn sub_tokens(rows: &[f32], k: usize) -> Vec<f32> {
    (0..4).flat_map(|part| rows.chunks_exact(k).skip(part).step_by(4)).flatten().copied().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_channels_of_a_sub_token_come_together() {
        let rows: Vec<f32> = (0..12).flat_map(|row| [row as f32, 100.0 + row as f32]).collect();
        let together: Vec<f32> = sub_tokens(&rows, 2).into_iter().step_by(2).collect();
        assert_eq!(together, [0.0, 4.0, 8.0, 1.0, 5.0, 9.0, 2.0, 6.0, 10.0, 3.0, 7.0, 11.0]);
    }
}
