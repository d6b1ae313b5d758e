//! Contents of a model file, without loading it: sizes, parts, parameters, memory and cost.

use std::path::Path;

use serde::Serialize;

use crate::checkpoint::{Checkpoint, Weights};
use crate::config::{self, Settings};
use crate::silent::{Silent, silent};
use crate::{Config, DinoConfig, ModelError, StaticPosition, keys};

/// Kind and sizes of a model.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Kind {
    /// StreamSplat.
    StreamSplat(Config),
    /// DINOv2 with registers.
    Dino(DinoConfig),
}

/// A part of a model: the tensors under one key.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Part {
    /// Its name.
    pub name: String,
    /// Tensors in it.
    pub tensors: usize,
    /// Values in them.
    pub parameters: usize,
    /// Bytes in the file.
    pub bytes: usize,
}

/// The cost of one call of a stage, a multiplication and an addition counted as two operations.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StageCost {
    /// The stage's name.
    pub stage: &'static str,
    /// 10⁹ operations per call.
    pub gflop: f64,
    /// Calls per new key frame.
    pub calls: usize,
}

/// Contents of a model file.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Report {
    /// The file.
    pub file: String,
    /// Bytes of the file.
    pub bytes: usize,
    /// Prefix of its keys.
    pub prefix: &'static str,
    /// Kind and sizes.
    pub kind: Kind,
    /// Parts, in the order of the computation; what belongs to none of them comes last, as `ignored`.
    pub parts: Vec<Part>,
    /// Number formats of the tensors and how many have each.
    pub formats: Vec<(String, usize)>,
    /// Cost per stage, were all of it computed.
    pub stages: Vec<StageCost>,
    /// Residual branches that are left out because they add zero, by part.
    pub silent: Vec<Silent>,
    /// Tensors that are not read.
    pub ignored: Vec<String>,
}

impl Report {
    /// Parameters of all parts that are read.
    pub fn parameters(&self) -> usize {
        self.parts.iter().filter(|p| p.name != IGNORED).map(|p| p.parameters).sum()
    }

    /// 10⁹ operations per new key frame, were all of it computed.
    pub fn gflop(&self) -> f64 {
        self.stages.iter().map(|s| s.gflop * s.calls as f64).sum()
    }
}

pub(crate) const DEFORMATION_UPSAMPLER: &str = "deformation upsampler";
const IGNORED: &str = "ignored";

/// Looks at the model file at `path`, and at the JSON file beside it.
///
/// # Errors
/// When the file is malformed, is no model, or contradicts its configuration.
pub fn inspect(path: impl AsRef<Path>) -> Result<Report, ModelError> {
    let checkpoint = Checkpoint::open(path.as_ref())?;
    inspect_checkpoint(&checkpoint, &Settings::beside(path.as_ref())?)
}

/// [`inspect`] for a checkpoint in memory with the text of its JSON file.
///
/// # Errors
/// As [`inspect`].
pub fn inspect_parts(checkpoint: &Checkpoint, config_json: &str) -> Result<Report, ModelError> {
    inspect_checkpoint(checkpoint, &Settings::parse(config_json, "the configuration in memory")?)
}

fn inspect_checkpoint(checkpoint: &Checkpoint, settings: &Settings) -> Result<Report, ModelError> {
    let (prefix, kind, names): (_, _, &[(&'static str, &[&str])]) = if config::is_dino(checkpoint) {
        let config = DinoConfig::derive(&Weights::new(checkpoint, ""), settings)?;
        ("", Kind::Dino(config), &DINO_PARTS)
    } else {
        let prefix = config::prefix(checkpoint)?;
        let config = Config::derive(&Weights::new(checkpoint, prefix), settings)?;
        (prefix, Kind::StreamSplat(config), &PARTS)
    };
    let empty = |name: &str| Part { name: name.to_owned(), tensors: 0, parameters: 0, bytes: 0 };
    let mut parts: Vec<Part> = names.iter().map(|(name, _)| empty(name)).collect();
    parts.push(empty(IGNORED));
    let (mut ignored, mut formats) = (Vec::new(), Vec::<(String, usize)>::new());
    for (key, tensor) in checkpoint.tensors() {
        let own = key.strip_prefix(prefix);
        let part = own.and_then(|own| names.iter().position(|(_, starts)| starts.iter().any(|s| own.starts_with(s))));
        if part.is_none() {
            ignored.push(key.clone());
        }
        let part = &mut parts[part.unwrap_or(names.len())];
        part.tensors += 1;
        part.parameters += tensor.elements();
        part.bytes += tensor.range.len();
        match formats.iter_mut().find(|(name, _)| name == tensor.dtype.name()) {
            Some((_, count)) => *count += 1,
            None => formats.push((tensor.dtype.name().to_owned(), 1)),
        }
    }
    if ignored.is_empty() {
        parts.pop();
    }
    let stages = match &kind {
        Kind::StreamSplat(config) => stages(config),
        Kind::Dino(config) => vec![StageCost { stage: "dinov2", gflop: dino_gflop(config), calls: 1 }],
    };
    let silent = match &kind {
        Kind::StreamSplat(config) => silent(&Weights::new(checkpoint, prefix), config),
        Kind::Dino(_) => Vec::new(),
    };
    let (file, bytes) = (checkpoint.file().to_owned(), checkpoint.size());
    Ok(Report { file, bytes, prefix, kind, parts, formats, stages, silent, ignored })
}

/// Parts of a StreamSplat checkpoint and the keys they start with. The first that fits counts.
const PARTS: [(&str, &[&str]); 6] = [
    ("encoder", &[keys::ENCODER]),
    ("static upsampler", &[keys::STATIC_UPSAMPLER]),
    ("static head", &[keys::STATIC_HEAD]),
    ("decoder", &[keys::DECODER]),
    (DEFORMATION_UPSAMPLER, &[keys::DEFORMATION_UPSAMPLER]),
    ("deformation head", &[keys::DEFORMATION_HEAD, "encoder_proj."]),
];

const DINO_PARTS: [(&str, &[&str]); 3] = [
    ("patch embedding", &["patch_embed.", "cls_token", "register_tokens", "pos_embed"]),
    ("blocks", &["blocks."]),
    ("norm", &["norm."]),
];

/// Cost per stage of a StreamSplat network.
pub fn stages(config: &Config) -> Vec<StageCost> {
    let (n, d) = (config.tokens() as f64, config.hidden_dim as f64);
    let window = |tokens: f64, window: Option<usize>| window.map_or(tokens, |w| w as f64);
    let patch = 4.0 * (config.patch_size * config.patch_size) as f64;
    let own = window(n, config.encoder_window);
    let encoder = linear(n, patch, d) + config.encoder_layers as f64 * block(n, d, own);

    let [first, second] = config.upsampler_widths.map(|width| width as f64);
    let run = config.upsampler_window as f64;
    let upsampler = linear(n, d, 4.0 * first)
        + 2.0 * block(4.0 * n, first, run)
        + linear(4.0 * n, first, 4.0 * second)
        + 2.0 * block(16.0 * n, second, run);

    let m = if config.use_dino { 576.0 } else { n };
    let pair = window(2.0 * n, config.encoder_window);
    let cross = linear(2.0 * n, d, 2.0 * d) + linear(2.0 * m, d, 2.0 * d) + attention(2.0 * n, m, d);
    let condition = linear(2.0 * m, config.condition_dim as f64, d);
    let decoder = condition + config.decoder_layers as f64 * (block(2.0 * n, d, pair) + cross);

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

pub(crate) fn linear(rows: f64, from: f64, to: f64) -> f64 {
    2.0 * rows * from * to
}

/// Queries against the keys each of them sees, and back.
pub(crate) fn attention(queries: f64, keys: f64, d: f64) -> f64 {
    4.0 * queries * keys * d
}

/// A block whose tokens see `keys` tokens.
fn block(n: f64, d: f64, keys: f64) -> f64 {
    own_attention(n, d, keys) + feed_forward(n, d)
}

/// Attention of tokens that see `keys` of their own kind, with its projections.
pub(crate) fn own_attention(n: f64, d: f64, keys: f64) -> f64 {
    linear(n, d, 4.0 * d) + attention(n, keys, d)
}

/// A feed-forward layer.
pub(crate) fn feed_forward(n: f64, d: f64) -> f64 {
    2.0 * linear(n, d, 4.0 * d)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The published model costs what the paper's description of it adds up to.
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
