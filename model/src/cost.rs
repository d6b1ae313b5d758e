//! The cost of a network: operations per stage and per residual branch, a multiplication and an addition counted as
//! two.

use serde::Serialize;

use crate::{Config, DinoConfig, StaticPosition};

/// Tokens of the published condition: the patches of DINOv2.
pub(crate) const USUAL_CONDITION: usize = 576;

/// The cost of one call of a stage.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StageCost {
    /// The stage's name.
    pub stage: &'static str,
    /// 10⁹ operations per call.
    pub gflop: f64,
    /// Calls per new key frame.
    pub calls: usize,
}

/// Operations of a block's residual branches.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BlockCost {
    pub(crate) attention: f64,
    /// Only in the decoder.
    pub(crate) cross_attention: f64,
    pub(crate) feed_forward: f64,
}

impl BlockCost {
    /// Cost for `n` tokens of `d` channels, each of which attends to `keys` tokens of the same sequence.
    fn new(n: f64, d: f64, keys: f64) -> BlockCost {
        let attention = linear(n, d, 4.0 * d) + attention(n, keys, d);
        BlockCost { attention, cross_attention: 0.0, feed_forward: 2.0 * linear(n, d, 4.0 * d) }
    }

    /// Cost of the encoder.
    pub(crate) fn encoder(config: &Config) -> BlockCost {
        let n = config.tokens() as f64;
        BlockCost::new(n, config.hidden_dim as f64, config.encoder_window.map_or(n, |window| window as f64))
    }

    /// Cost of the decoder, for both frames.
    pub(crate) fn decoder(config: &Config) -> BlockCost {
        let (n, m, d) = (2.0 * config.tokens() as f64, condition(config), config.hidden_dim as f64);
        let cross_attention = linear(n, d, 2.0 * d) + linear(2.0 * m, d, 2.0 * d) + attention(n, m, d);
        let own = BlockCost::new(n, d, config.encoder_window.map_or(n, |window| window as f64));
        BlockCost { cross_attention, ..own }
    }

    /// Cost of the upsamplers' first (0) or second (1) stage.
    pub(crate) fn upsampler(config: &Config, stage: usize) -> BlockCost {
        let n = config.tokens() as f64 * [4.0, 16.0][stage];
        BlockCost::new(n, config.upsampler_widths[stage] as f64, config.upsampler_window as f64)
    }

    fn sum(self) -> f64 {
        self.attention + self.cross_attention + self.feed_forward
    }
}

/// Tokens of a frame's condition.
fn condition(config: &Config) -> f64 {
    (if config.use_dino { USUAL_CONDITION } else { config.tokens() }) as f64
}

/// Cost per stage of a StreamSplat network.
pub fn stages(config: &Config) -> Vec<StageCost> {
    let (n, d) = (config.tokens() as f64, config.hidden_dim as f64);
    let patch = 4.0 * (config.patch_size * config.patch_size) as f64;
    let encoder = linear(n, patch, d) + config.encoder_layers as f64 * BlockCost::encoder(config).sum();

    let [first, second] = config.upsampler_widths.map(|width| width as f64);
    let upsampler = linear(n, d, 4.0 * first)
        + 2.0 * BlockCost::upsampler(config, 0).sum()
        + linear(4.0 * n, first, 4.0 * second)
        + 2.0 * BlockCost::upsampler(config, 1).sum();

    let condition = linear(2.0 * condition(config), config.condition_dim as f64, d);
    let decoder = condition + config.decoder_layers as f64 * BlockCost::decoder(config).sum();

    let static_columns = if config.static_position == StaticPosition::Tanh { 9.0 } else { 12.0 };
    let static_head = linear(16.0 * n, second, static_columns);
    let mlp = |out: f64| linear(16.0 * n, 2.0 * second, second) + linear(16.0 * n, second, second + out);
    let deformation_head = linear(16.0 * n, second, second) + mlp(3.0) + mlp(2.0);
    let stage = |stage: &'static str, flop: f64, calls: usize| StageCost { stage, gflop: flop / 1e9, calls };
    vec![
        stage("encoder", encoder, 1),
        stage("upsampler", upsampler, 3),
        stage("decoder", decoder, 1),
        stage("heads", static_head + 2.0 * deformation_head, 1),
    ]
}

/// 10⁹ operations of DINOv2 per frame.
pub fn dino_gflop(config: &DinoConfig) -> f64 {
    let patches = config.patches() as f64;
    let n = patches + 1.0 + config.register_tokens as f64;
    let (d, hidden) = (config.embed_dim as f64, config.mlp_dim as f64);
    let embed = linear(patches, 3.0 * (config.patch_size * config.patch_size) as f64, d);
    let block = linear(n, d, 4.0 * d) + attention(n, n, d) + 2.0 * linear(n, d, hidden);
    (embed + config.depth as f64 * block) / 1e9
}

fn linear(rows: f64, from: f64, to: f64) -> f64 {
    2.0 * rows * from * to
}

/// Operations of the products of queries with keys and of weights with values.
fn attention(queries: f64, keys: f64, d: f64) -> f64 {
    4.0 * queries * keys * d
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The published model's cost is within 1 % of the sum over the paper's description.
    #[test]
    fn costs_at_the_published_size() {
        let config = Config {
            hidden_dim: 768,
            encoder_layers: 10,
            decoder_layers: 10,
            resolution: [288, 512],
            patch_size: 8,
            upsampler_window: 2304,
            upsampler_widths: [384, 192],
            encoder_window: None,
            use_dino: true,
            condition_dim: 768,
            static_position: StaticPosition::Tanh,
            ignores_depth: false,
        };
        let costs = stages(&config);
        let gflop = |name: &str| costs.iter().find(|c| c.stage == name).expect("a stage").gflop;
        for (name, expected) in [("encoder", 490.0), ("upsampler", 336.0), ("decoder", 1520.0)] {
            assert!((gflop(name) / expected - 1.0).abs() < 0.01, "{name}: {} instead of {expected}", gflop(name));
        }
        let dino = DinoConfig {
            embed_dim: 768,
            depth: 12,
            mlp_dim: 3072,
            patch_size: 14,
            register_tokens: 4,
            pos_embed_grid: 37,
            resized_to: [252, 448],
        };
        assert!((dino_gflop(&dino) / 111.7 - 1.0).abs() < 0.01, "{}", dino_gflop(&dino));
    }
}
