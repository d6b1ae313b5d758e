//! Attention layers: projections around the kernel.

use streamsplat_kernels::Level;
use streamsplat_kernels::attention::{Rows, Shape, Windows, attend_as, attend_some};
use streamsplat_kernels::gemm::Precision;

use super::{Bias, HEAD, Linear, RmsNorm, Workspace, sized};
use crate::ModelError;
use crate::checkpoint::Weights;
use crate::reuse::{gather, keep_heads};

fn shape(d: usize, windows: Windows) -> Shape {
    Shape { heads: d / HEAD, width: HEAD, windows }
}

/// Returns true if an attention is zero-output and left out. Its tensors are checked in any case.
fn is_left_out(weights: &Weights<'_>, d: usize) -> Result<bool, ModelError> {
    if !weights.leaves_out("out_proj") {
        return Ok(false);
    }
    weights.check("packed_proj.weight", &[3 * d, d])?;
    weights.check("packed_proj.bias", &[3 * d])?;
    weights.check("out_proj.weight", &[d, d])?;
    weights.check("out_proj.bias", &[d])?;
    Ok(true)
}

/// Attention of the tokens `at` (`None`: all) to each other, from their queries, keys and values `[3·heads][rows][64]`.
/// `kept` holds keys and values of all tokens, `[2·heads][n][64]`, and those of these tokens are replaced. Without it,
/// tokens attend only to those of `qkv`.
pub(crate) fn attend_kept(
    precision: Precision,
    level: Level,
    shape: Shape,
    at: Option<&[u32]>,
    qkv: &[f32],
    kept: Option<&mut Vec<f32>>,
    mixed: &mut [f32],
) {
    let (d, rows) = (shape.heads * HEAD, mixed.len() / (shape.heads * HEAD));
    let (q, mut keys_values) = qkv.split_at(mixed.len());
    if let Some(kept) = kept {
        keep_heads(at, keys_values, HEAD, kept);
        keys_values = kept;
    }
    let q = Rows::of_heads(q, rows, HEAD, 0);
    let n = keys_values.len() / (2 * d);
    let [k, v] = [0, 1].map(|part| Rows::of_heads(keys_values, n, HEAD, part * shape.heads));
    match at {
        None => attend_as(precision, level, shape, q, k, v, mixed),
        Some(at) => attend_some(precision, level, shape, at, q, k, v, mixed),
    }
}

/// Attention of tokens to each other, a residual branch.
#[derive(Clone)]
pub(crate) struct SelfAttention {
    norm: RmsNorm,
    packed_proj: Linear,
    out_proj: Linear,
}

impl SelfAttention {
    /// Loads the attention `name` of a block with its norm; `None` where it is zero-output.
    pub(crate) fn load(
        weights: &Weights<'_>,
        norm: &str,
        name: &str,
        d: usize,
    ) -> Result<Option<SelfAttention>, ModelError> {
        let norm = RmsNorm::load(weights, norm, d)?;
        let weights = &weights.at(name);
        if is_left_out(weights, d)? {
            return Ok(None);
        }
        Ok(Some(SelfAttention {
            norm,
            packed_proj: Linear::load(weights, "packed_proj", 3 * d, d, Bias::Yes)?,
            out_proj: Linear::load(weights, "out_proj", d, d, Bias::Yes)?,
        }))
    }

    /// `x += attention(norm(x))`, where the rows of `x` are the tokens `at` (`None`: all). `kept` holds keys and values
    /// of all tokens, `[2·heads][n][64]`, and those of these tokens are replaced. Without it, tokens attend only to
    /// those of `x`.
    pub(crate) fn accumulate(
        &self,
        level: Level,
        windows: Windows,
        at: Option<&[u32]>,
        x: &mut [f32],
        kept: Option<&mut Vec<f32>>,
        work: &mut Workspace,
    ) {
        let d = self.out_proj.k();
        let qkv = sized(&mut work.projected, 3 * x.len());
        self.packed_proj.heads_of_normed(level, self.norm.norm(), x, qkv);
        let mixed = sized(&mut work.mixed, x.len());
        attend_kept(self.out_proj.precision(), level, shape(d, windows), at, qkv, kept, mixed);
        self.out_proj.accumulate(level, mixed, x);
    }

    /// [`SelfAttention::accumulate`] without a cache for the tokens `part` alone: `x` holds all tokens, `rows` those of
    /// `part`, which are added to.
    pub(crate) fn accumulate_part(
        &self,
        level: Level,
        windows: Windows,
        part: &[u32],
        x: &[f32],
        rows: &mut [f32],
        work: &mut Workspace,
    ) {
        let d = self.out_proj.k();
        let qkv = sized(&mut work.projected, 3 * x.len());
        self.packed_proj.heads_of_normed(level, self.norm.norm(), x, qkv);
        let (all, keys_values) = qkv.split_at(x.len());
        let q = sized(&mut work.keys_values, rows.len());
        for (from, to) in all.chunks_exact(x.len() / d * HEAD).zip(q.chunks_exact_mut(part.len() * HEAD)) {
            gather(part, from, HEAD, to);
        }
        let mixed = sized(&mut work.mixed, rows.len());
        let q = Rows::of_heads(q, part.len(), HEAD, 0);
        let [k, v] = [0, 1].map(|half| Rows::of_heads(keys_values, x.len() / d, HEAD, half * d / HEAD));
        attend_some(self.out_proj.precision(), level, shape(d, windows), part, q, k, v, mixed);
        self.out_proj.accumulate(level, mixed, rows);
    }

    pub(crate) fn bytes(&self) -> usize {
        self.norm.bytes() + self.packed_proj.bytes() + self.out_proj.bytes()
    }
}

/// Attention of tokens to a condition, a residual branch. One packed tensor holds the projections of q, k and v; the
/// first is applied to the tokens, the others to the condition.
#[derive(Clone)]
pub(crate) struct CrossAttention {
    norm: RmsNorm,
    query: Linear,
    key_value: Linear,
    out_proj: Linear,
}

impl CrossAttention {
    /// Loads the attention `name` of a block with its norm; `None` where it is zero-output.
    pub(crate) fn load(
        weights: &Weights<'_>,
        norm: &str,
        name: &str,
        d: usize,
    ) -> Result<Option<CrossAttention>, ModelError> {
        let norm = RmsNorm::load(weights, norm, d)?;
        let weights = &weights.at(name);
        if is_left_out(weights, d)? {
            return Ok(None);
        }
        let weight = weights.read("packed_proj.weight", &[3 * d, d])?;
        let mut query_bias = weights.vector("packed_proj.bias", &[3 * d])?;
        let key_value_bias = query_bias.split_off(d);
        let (query, key_value) = weight.split_at(d * d);
        let layer = CrossAttention {
            norm,
            query: Linear::new(weights.level(), weights.precision(), query, Some(query_bias), d, d),
            key_value: Linear::new(weights.level(), weights.precision(), key_value, Some(key_value_bias), 2 * d, d),
            out_proj: Linear::load(weights, "out_proj", d, d, Bias::Yes)?,
        };
        drop(weight);
        weights.release("packed_proj.weight");
        Ok(Some(layer))
    }

    /// The keys and values of a condition `[m, d]`, `[2·heads][m][64]`.
    pub(crate) fn keys_values(&self, level: Level, condition: &[f32], out: &mut [f32]) {
        self.key_value.heads(level, condition, out);
    }

    /// `x += attention(norm(x), condition)`, with the keys and values of the condition.
    pub(crate) fn accumulate(&self, level: Level, keys_values: &[f32], x: &mut [f32], work: &mut Workspace) {
        let d = self.out_proj.k();
        let (n, m) = (x.len() / d, keys_values.len() / (2 * d));
        let q = sized(&mut work.projected, x.len());
        self.query.heads_of_normed(level, self.norm.norm(), x, q);
        let mixed = sized(&mut work.mixed, x.len());
        let q = Rows::of_heads(q, n, HEAD, 0);
        let [k, v] = [0, 1].map(|part| Rows::of_heads(keys_values, m, HEAD, part * d / HEAD));
        attend_as(self.out_proj.precision(), level, shape(d, Windows::Full), q, k, v, mixed);
        self.out_proj.accumulate(level, mixed, x);
    }

    pub(crate) fn bytes(&self) -> usize {
        self.norm.bytes() + self.query.bytes() + self.key_value.bytes() + self.out_proj.bytes()
    }
}
