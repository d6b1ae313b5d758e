//! `inspect`: what a model, a scene or an interval holds.

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::{Value, json};
use streamsplat::output::write_file;
use streamsplat::scene::{INDEX, Scene};
use streamsplat_model::checkpoint::Checkpoint;
use streamsplat_model::{Config, LoadOptions, Network};

use super::cli::InspectArgs;
use super::failure::Failure;
use super::{digest, say};

/// Tells what it is.
pub fn command(args: &InspectArgs) -> Result<(), Failure> {
    let found = if args.file.is_dir() || args.file.file_name().is_some_and(|name| name == INDEX) {
        scene(&args.file)?
    } else {
        tensors(&args.file)?
    };
    show(&found, 0);
    if let Some(path) = &args.json {
        let text = serde_json::to_string_pretty(&found).map_err(Failure::work)?;
        write_file(path, (text + "\n").as_bytes())?;
    }
    Ok(())
}

fn scene(path: &Path) -> Result<Value, Failure> {
    let scene = Scene::open(path)?;
    let index = scene.index();
    let (start, end) = scene.span();
    let placement = &index.placement;
    let gaussians: Vec<usize> = index.intervals.iter().map(|entry| entry.gaussians).collect();
    Ok(json!({
        "kind": "scene",
        "blake3": digest::scene(&scene)?,
        "intervals": index.intervals.len(),
        "seconds": [start, end],
        "frames_per_second": index.fps,
        "gaussians": {
            "least": gaussians.iter().min(),
            "most": gaussians.iter().max(),
            "sum": gaussians.iter().sum::<usize>(),
        },
        "bytes": index.intervals.iter().map(|entry| entry.bytes).sum::<u64>(),
        "source": placement.source,
        "model_input": placement.model,
        "content": placement.content,
    }))
}

fn tensors(path: &Path) -> Result<Value, Failure> {
    let checkpoint = Checkpoint::open(path)?;
    let mut parts: BTreeMap<String, (usize, usize)> = BTreeMap::new();
    let mut kinds: BTreeMap<String, usize> = BTreeMap::new();
    let mut parameters = 0;
    for (name, info) in checkpoint.tensors() {
        let part = parts.entry(part_of(name)).or_default();
        part.0 += 1;
        part.1 += info.elements();
        parameters += info.elements();
        *kinds.entry(info.dtype.name().to_owned()).or_default() += info.elements();
    }
    let parts: serde_json::Map<String, Value> = parts
        .into_iter()
        .map(|(part, (tensors, parameters))| (part, json!({ "tensors": tensors, "parameters": parameters })))
        .collect();
    let is = |suffix: &str| checkpoint.tensors().keys().any(|name| name.ends_with(suffix));
    let network = is("gs_predictor.encoder.transformer_encoder.conv.weight");
    let kind = if network {
        "model"
    } else if is("patch_embed.proj.weight") {
        "DINOv2"
    } else if is("identity") && is("velocity") {
        "interval"
    } else {
        "tensors"
    };
    let mut found = json!({
        "kind": kind,
        "file": path.display().to_string(),
        "bytes": checkpoint.size(),
        "blake3": digest::file(path)?,
        "tensors": checkpoint.tensors().len(),
        "values": parameters,
        "stored_as": kinds,
        "parts": parts,
    });
    drop(checkpoint);
    if network {
        let network = Network::open(path, &LoadOptions::default())?;
        let config = network.config();
        found["configuration"] = configuration(config);
        found["memory_bytes"] = json!({ "f32": network.bytes() });
        found["gflop"] = cost(config);
    }
    Ok(found)
}

/// The part of the network that a tensor belongs to.
fn part_of(name: &str) -> String {
    let name = name.strip_prefix("model.").unwrap_or(name);
    let name = name.strip_prefix("_orig_mod.").unwrap_or(name);
    for (prefix, part) in [
        ("gs_predictor.encoder.", "encoder"),
        ("gs_predictor.gaussian_upsampler.", "static upsampler"),
        ("gs_predictor.predictor.", "static head"),
        ("decoder.transformer_decoder.", "decoder"),
        ("gaussian_upsampler.", "deformation upsampler"),
        ("gs_dynamic_predictor.", "deformation head"),
        ("encoder_proj.", "deformation head"),
        ("blocks.", "blocks"),
    ] {
        if name.starts_with(prefix) {
            return part.to_owned();
        }
    }
    name.split('.').next().unwrap_or(name).to_owned()
}

fn configuration(config: &Config) -> Value {
    json!({
        "hidden_dim": config.hidden_dim,
        "encoder_layers": config.encoder_layers,
        "decoder_layers": config.decoder_layers,
        "resolution": config.resolution,
        "patch_size": config.patch_size,
        "upsampler_window": config.upsampler_window,
        "upsampler_widths": config.upsampler_widths,
        "encoder_window": config.encoder_window,
        "use_dino": config.use_dino,
        "gaussians_per_frame": config.gaussians(),
    })
}

/// Multiplications and additions of the matrix products and the attention, in 10⁹, per call.
fn cost(config: &Config) -> Value {
    let (n, d) = (config.tokens() as f64, config.hidden_dim as f64);
    let block = |tokens: f64, width: f64, keys: f64| 2.0 * tokens * (12.0 * width * width + 2.0 * keys * width);
    let keys = |tokens: f64| config.encoder_window.map_or(tokens, |window| (window as f64).min(tokens));
    let embedding = 2.0 * n * d * (4 * config.patch_size * config.patch_size) as f64;
    let encoder = embedding + config.encoder_layers as f64 * block(n, d, keys(n));
    let mut upsampler = 0.0;
    let (mut tokens, mut width) = (n, d);
    for next in config.upsampler_widths.map(|w| w as f64) {
        upsampler += 2.0 * tokens * width * 4.0 * next;
        (tokens, width) = (4.0 * tokens, next);
        upsampler += 2.0 * block(tokens, width, (config.upsampler_window as f64).min(tokens));
    }
    // Self-attention over both frames, then each frame's cross-attention (queries and output of the frame, keys and values
    // of the condition), then the feed-forward layers. The condition's length is that of the frame, or of DINOv2's grid.
    let m = if config.use_dino { 576.0 } else { n };
    let cross = 2.0 * 2.0 * (2.0 * n * d * d + 2.0 * m * d * d + 2.0 * n * m * d);
    let projection = 2.0 * 2.0 * m * config.condition_dim as f64 * d;
    let decoder = projection + config.decoder_layers as f64 * (block(2.0 * n, d, keys(2.0 * n)) + cross);
    let per_frame = encoder + 3.0 * upsampler + decoder;
    let giga = |flop: f64| (flop / 1e6).round() / 1e3;
    json!({
        "encoder": giga(encoder),
        "upsampler": giga(upsampler),
        "decoder": giga(decoder),
        "per_key_frame": giga(per_frame),
        "note": "matrix products and attention; per key frame: one encoder, three upsampler and one decoder call, without DINOv2",
    })
}

/// Prints a JSON object as indented lines.
fn show(value: &Value, depth: usize) {
    let Value::Object(map) = value else { return };
    for (key, value) in map {
        let indent = "  ".repeat(depth);
        match value {
            Value::Object(_) => {
                say(format!("{indent}{key}:"));
                show(value, depth + 1);
            }
            Value::String(text) => say(format!("{indent}{key}: {text}")),
            other => say(format!("{indent}{key}: {other}")),
        }
    }
}
