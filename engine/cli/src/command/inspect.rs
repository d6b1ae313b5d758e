//! `inspect`: prints the content of a model, a scene or an interval.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use serde_json::{Map, Value, json};
use streamsplat::open::{self, Opened};
use streamsplat::output::write_file;
use streamsplat::recognise::{self, Kind};
use streamsplat::scene::{INDEX, Scene};
use streamsplat_model::checkpoint::{Checkpoint, is_torch_archive};
use streamsplat_model::inspect::{Architecture, inspect};
use streamsplat_model::zero_output::gflop;

use crate::command::still;
use crate::console::failure::Failure;
use crate::console::opening::open_along;
use crate::console::{Console, say};
use crate::options::args::InspectArgs;
use streamsplat::run::digest;

/// Detects the kind of the file and prints its content.
pub fn command(args: &InspectArgs, console: &Console) -> Result<(), Failure> {
    let path = &args.file;
    let torch = is_torch(path);
    if let Some(wrong) =
        recognise::not_a_scene(path).filter(|_| !torch && recognise::kind(path) != Some(Kind::Checkpoint))
    {
        let wrong = wrong.expecting("a model, a scene or an interval");
        return Err(Failure::work(format!("{}: {wrong}", path.display())));
    }
    let found = if torch {
        model(path)?
    } else if path.is_dir() || path.file_name().is_some_and(|name| name == INDEX) || open::is_scene(path) {
        match open_along(path, &args.limit.limits(), args.reading.axes()?, None, console)? {
            Opened::Moving(scene) => moving(&scene)?,
            Opened::Still(file) => still::inspect(&file),
        }
    } else {
        let checkpoint = Checkpoint::open(path)?;
        let has = |name: &str| checkpoint.tensors().contains_key(name);
        if ["mean", "velocity", "gamma", "identity"].into_iter().all(has) {
            interval(path, &checkpoint)?
        } else {
            drop(checkpoint);
            model(path)?
        }
    };
    show(&found, 0)?;
    if let Some(path) = &args.json {
        let text = serde_json::to_string_pretty(&found).map_err(Failure::work)?;
        write_file(path, (text + "\n").as_bytes())?;
    }
    Ok(())
}

/// Returns true if a file is an archive of `torch.save`, which begins like a scene in a zip file.
fn is_torch(path: &Path) -> bool {
    let mut head = Vec::new();
    let read = File::open(path).and_then(|file| file.take(256).read_to_end(&mut head));
    read.is_ok() && is_torch_archive(&head)
}

fn moving(scene: &Scene) -> Result<Value, Failure> {
    let index = scene.index();
    let (start, end) = scene.span();
    let placement = &index.placement;
    let gaussians: Vec<usize> = index.intervals.iter().map(|entry| entry.gaussians).collect();
    Ok(json!({
        "kind": "scene",
        "format": format!("{} version {}", index.format, index.version),
        "blake3": digest::scene(scene)?,
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

fn interval(path: &Path, checkpoint: &Checkpoint) -> Result<Value, Failure> {
    let tensors: Map<String, Value> = checkpoint
        .tensors()
        .iter()
        .map(|(name, info)| (name.clone(), json!({ "format": info.dtype.name(), "shape": info.shape })))
        .collect();
    Ok(json!({
        "kind": "interval",
        "bytes": checkpoint.size(),
        "blake3": digest::file(path)?,
        "gaussians": checkpoint.shape("mean").and_then(|shape| shape.first()),
        "tensors": tensors,
    }))
}

fn model(path: &Path) -> Result<Value, Failure> {
    let report = inspect(path)?;
    let (kind, configuration) = match &report.kind {
        Architecture::StreamSplat(config) => (
            "StreamSplat model",
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
            }),
        ),
        Architecture::Dino(config) => (
            "DINOv2 model",
            json!({
                "embed_dim": config.embed_dim,
                "depth": config.depth,
                "patch_size": config.patch_size,
                "register_tokens": config.register_tokens,
                "resized_to": config.resized_to,
            }),
        ),
        _ => ("model", Value::Null),
    };
    let formats: Map<String, Value> = report.formats.iter().map(|(name, count)| (name.clone(), json!(count))).collect();
    // Weights of a matrix take four, two or one byte each in the three modes. The few weights that always stay f32 are
    // not distinguished here. Zero-output weights take none.
    let held = report.parameters() - report.zero_output.iter().map(|part| part.parameters).sum::<usize>();
    let memory = |bytes: usize| held * bytes;
    let thousandths = |x: f64| (x * 1e3).round() / 1e3;
    let zero_output: Map<String, Value> = report
        .zero_output
        .iter()
        .map(|part| {
            let account = json!({
                "branches": part.zero_output,
                "of": part.branches,
                "parameters": part.parameters,
                "gflop": thousandths(part.gflop),
            });
            (part.part.to_owned(), account)
        })
        .collect();
    let stages: Map<String, Value> = report
        .stages
        .iter()
        .map(|stage| {
            let gflop = thousandths(stage.gflop);
            (stage.stage.to_owned(), json!({ "gflop": gflop, "calls_per_key_frame": stage.calls }))
        })
        .collect();
    let parts: Map<String, Value> = report
        .parts
        .iter()
        .map(|part| {
            let Value::Object(mut fields) = json!(part) else { return (part.name.clone(), Value::Null) };
            fields.remove("name");
            (part.name.clone(), Value::Object(fields))
        })
        .collect();
    let needs = match &report.kind {
        Architecture::StreamSplat(config) if config.use_dino => {
            json!([format!("DINOv2 of {} channels with register tokens (--dinov2 FILE)", config.condition_dim)])
        }
        Architecture::Dino(_) => json!(["a StreamSplat checkpoint (--model FILE), which it serves as --dinov2"]),
        _ => json!([]),
    };
    Ok(json!({
        "kind": kind,
        "names": report.layout.map(|layout| layout.name()),
        "needs": needs,
        "file": report.file,
        "bytes": report.bytes,
        "blake3": digest::file(path)?,
        "key_prefix": report.prefix,
        "parameters": report.parameters(),
        "tensor_formats": formats,
        "configuration": configuration,
        "parts": parts,
        "weights_bytes": { "f32": memory(4), "bf16": memory(2), "int8": memory(1) },
        "stages": stages,
        "zero_output": zero_output,
        "gflop_per_key_frame": thousandths(report.gflop() - gflop(&report.zero_output)),
        "ignored": report.ignored,
    }))
}

/// Prints a JSON object as indented lines; an object of plain values in one line.
fn show(value: &Value, depth: usize) -> Result<(), Failure> {
    let Value::Object(map) = value else { return Ok(()) };
    let indent = "  ".repeat(depth);
    for (key, value) in map {
        match value {
            Value::Object(inner) if depth > 0 && inner.values().all(|v| !v.is_object()) => {
                let fields: Vec<String> = inner.iter().map(|(key, value)| format!("{key} {}", plain(value))).collect();
                say(format!("{indent}{key}: {}", fields.join(", ")))?;
            }
            Value::Object(_) => {
                say(format!("{indent}{key}:"))?;
                show(value, depth + 1)?;
            }
            other => say(format!("{indent}{key}: {}", plain(other)))?,
        }
    }
    Ok(())
}

fn plain(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        other => other.to_string(),
    }
}
