//! Residual branches that add nothing, and are left out.
//!
//! Every block consists of residual branches, `x += project(inner(norm(x)))`: attention with the projection `out_proj`,
//! the feed-forward layer with `c_proj`. A branch is *zero-output* when its projection is all zeros in the checkpoint,
//! of either sign: the weight, and the bias where there is one. Checkpoints have many of them when training starts with
//! zero-output branches and keeps some.
//!
//! # What remains
//! A zero-output branch adds +0 to every token. In f32 and bf16 a product with zeros is a chain of fused multiply-adds
//! that starts from +0. It stays there, as `a·0 + 0` is +0 for every finite `a`. In 8-bit integers the sum is the
//! integer 0, and its scales are not negative. A bias of −0, or none, leaves +0 unchanged. So norm, projections and
//! attention of a zero-output branch are neither packed at load nor computed. Only `x += 0` remains, on all levels, for
//! any number of threads and in every precision. It turns −0 into +0, as the sum does, and changes no other bit.
//!
//! The full computation differs only when a sum *inside* the branch is not finite. `∞·0` is NaN, and the full
//! computation spreads it in f32 and bf16; here the token stays finite. Inputs and weights are finite, so this requires
//! sums beyond 3.4·10³⁸. The branch's tensors are checked at load like all others.
//!
//! [`LoadOptions::compute_zero_output`](crate::LoadOptions::compute_zero_output) computes them.

use serde::Serialize;

use crate::checkpoint::Weights;
use crate::cost::BlockCost;
use crate::inspect::DEFORMATION_UPSAMPLER;
use crate::{Config, keys};

/// The zero-output branches of a part of a network.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ZeroOutput {
    /// The part's name, as in [`crate::inspect::Report::parts`].
    pub part: &'static str,
    /// Its residual branches, all of them.
    pub branches: usize,
    /// Number of zero-output branches among them.
    pub zero_output: usize,
    /// Values of the zero-output ones' layers.
    pub parameters: usize,
    /// 10⁹ operations of the zero-output ones per call of the part.
    pub gflop: f64,
}

impl ZeroOutput {
    /// Calls of the part per new key frame: the deformation of both frames of a pair is upsampled.
    pub fn calls(&self) -> usize {
        if self.part == DEFORMATION_UPSAMPLER { 2 } else { 1 }
    }
}

/// 10⁹ operations per new key frame that the zero-output branches would take.
pub fn gflop(parts: &[ZeroOutput]) -> f64 {
    parts.iter().map(|part| part.gflop * part.calls() as f64).sum()
}

/// The zero-output branches of every part that has blocks, in the order of the computation.
pub(crate) fn zero_output(weights: &Weights<'_>, config: &Config) -> Vec<ZeroOutput> {
    // Values of a block's attention and of its feed-forward layer.
    let values = |d: usize| [4 * (d * d + d), 8 * d * d];
    let [attn, mlp] = values(config.hidden_dim);
    let (mut encoder, cost) = (Count::new("encoder"), BlockCost::encoder(config));
    for i in 0..config.encoder_layers {
        let block = weights.at(keys::ENCODER).at(format_args!("transformer.resblocks.{i}"));
        encoder.add(&block, "attn.out_proj", attn, cost.attention);
        encoder.add(&block, "mlp.c_proj", mlp, cost.feed_forward);
    }
    let (mut decoder, cost) = (Count::new("decoder"), BlockCost::decoder(config));
    for i in 0..config.decoder_layers {
        let block = weights.at(keys::DECODER).at(format_args!("transformer.resblocks.{i}"));
        decoder.add(&block, "self_attn.out_proj", attn, cost.attention);
        decoder.add(&block, "cross_attn.out_proj", attn, cost.cross_attention);
        decoder.add(&block, "mlp.c_proj", mlp, cost.feed_forward);
    }
    let upsampler = |part, key| {
        let mut upsampler = Count::new(part);
        for (stage, width) in config.upsampler_widths.into_iter().enumerate() {
            let ([attn, mlp], cost) = (values(width), BlockCost::upsampler(config, stage));
            for i in 0..2 {
                let block = weights.at(key).at(format_args!("attention_{stage}.resblocks.{i}"));
                upsampler.add(&block, "attn.out_proj", attn, cost.attention);
                upsampler.add(&block, "mlp.c_proj", mlp, cost.feed_forward);
            }
        }
        upsampler.0
    };
    let static_upsampler = upsampler("static upsampler", keys::STATIC_UPSAMPLER);
    let deformation_upsampler = upsampler(DEFORMATION_UPSAMPLER, keys::DEFORMATION_UPSAMPLER);
    vec![encoder.0, static_upsampler, decoder.0, deformation_upsampler]
}

/// Returns true if every attention of both upsamplers is zero-output.
pub(crate) fn upsamplers_are_local(weights: &Weights<'_>) -> bool {
    let blocks = [keys::STATIC_UPSAMPLER, keys::DEFORMATION_UPSAMPLER]
        .into_iter()
        .flat_map(|key| (0..4).map(move |i| (key, i / 2, i % 2)));
    blocks.into_iter().all(|(key, stage, block)| {
        weights.at(key).at(format_args!("attention_{stage}.resblocks.{block}")).is_zero_output("attn.out_proj")
    })
}

struct Count(ZeroOutput);

impl Count {
    fn new(part: &'static str) -> Count {
        Count(ZeroOutput { part, branches: 0, zero_output: 0, parameters: 0, gflop: 0.0 })
    }

    /// Counts the branch of `block` that ends with the layer `last`.
    fn add(&mut self, block: &Weights<'_>, last: &str, parameters: usize, flop: f64) {
        self.0.branches += 1;
        if block.is_zero_output(last) {
            self.0.zero_output += 1;
            self.0.parameters += parameters;
            self.0.gflop += flop / 1e9;
        }
    }
}

#[cfg(test)]
mod tests;
