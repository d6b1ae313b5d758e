//! Contents of a model file, without loading it: sizes, parts, parameters, memory and cost.

use std::borrow::Cow;
use std::path::Path;

use serde::Serialize;

use crate::checkpoint::{Checkpoint, Weights};
use crate::config::{self, Settings};
use crate::cost::{self, StageCost};
use crate::zero_output::{ZeroOutput, zero_output};
use crate::{Config, DinoConfig, DinoLayout, ModelError, keys};

/// Kind and sizes of a model.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Architecture {
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
    /// Layout of the file's names, where it is DINOv2.
    pub layout: Option<DinoLayout>,
    /// Kind and sizes.
    pub kind: Architecture,
    /// Parts, in the order of the computation; tensors of no part come last, as `ignored`.
    pub parts: Vec<Part>,
    /// Number formats of the tensors, with the number of tensors of each.
    pub formats: Vec<(String, usize)>,
    /// Cost per stage if everything is computed.
    pub stages: Vec<StageCost>,
    /// Residual branches that are left out because they add zero, by part.
    pub zero_output: Vec<ZeroOutput>,
    /// Tensors that are not read.
    pub ignored: Vec<String>,
}

impl Report {
    /// Parameters of all parts that are read.
    pub fn parameters(&self) -> usize {
        self.parts.iter().filter(|p| p.name != IGNORED).map(|p| p.parameters).sum()
    }

    /// 10⁹ operations per new key frame if everything is computed.
    pub fn gflop(&self) -> f64 {
        self.stages.iter().map(|s| s.gflop * s.calls as f64).sum()
    }
}

pub(crate) const DEFORMATION_UPSAMPLER: &str = "deformation upsampler";
const IGNORED: &str = "ignored";

/// Inspects the model file at `path` and the JSON file next to it.
///
/// # Errors
/// When the file is malformed, is not a model, or contradicts its configuration.
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
    let layout = DinoLayout::of(checkpoint);
    let (prefix, kind, names): (_, _, &[(&'static str, &[&str])]) = if let Some(layout) = layout {
        let config = DinoConfig::derive(&Weights::new(checkpoint, "").laid_out(layout), settings)?;
        ("", Architecture::Dino(config), &DINO_PARTS)
    } else {
        let prefix = config::prefix(checkpoint)?;
        let config = Config::derive(&Weights::new(checkpoint, prefix), settings)?;
        (prefix, Architecture::StreamSplat(config), &PARTS)
    };
    let empty = |name: &str| Part { name: name.to_owned(), tensors: 0, parameters: 0, bytes: 0 };
    let mut parts: Vec<Part> = names.iter().map(|(name, _)| empty(name)).collect();
    parts.push(empty(IGNORED));
    let (mut ignored, mut formats) = (Vec::new(), Vec::<(String, usize)>::new());
    for (key, tensor) in checkpoint.tensors() {
        let own = match layout {
            Some(layout) => Some(layout.official(key)),
            None => key.strip_prefix(prefix).map(Cow::Borrowed),
        };
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
        Architecture::StreamSplat(config) => cost::stages(config),
        Architecture::Dino(config) => vec![StageCost { stage: "dinov2", gflop: cost::dino_gflop(config), calls: 1 }],
    };
    let zero_output = match &kind {
        Architecture::StreamSplat(config) => zero_output(&Weights::new(checkpoint, prefix), config),
        Architecture::Dino(_) => Vec::new(),
    };
    let (file, bytes) = (checkpoint.file().to_owned(), checkpoint.size());
    Ok(Report { file, bytes, prefix, layout, kind, parts, formats, stages, zero_output, ignored })
}

/// Parts of a StreamSplat checkpoint and the prefixes of their keys. The first match counts.
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
