//! Records of measurements as rows that can be compared: counted instructions, or times of several runs.

use std::path::Path;

use anyhow::{Context, Result, bail};
use serde_json::Value;
use streamsplat_bench::timing::Seconds;

/// Kind of measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Benchmark {
    /// `stages --instructions`.
    Instructions,
    /// `stages`.
    Stages,
    /// `kernels`.
    Kernels,
    /// `raster`.
    Raster,
}

/// One measured row.
#[derive(Clone, Debug)]
pub(super) struct Measured {
    pub(super) name: String,
    /// Instructions, with all three values equal, or seconds by the clock.
    pub(super) value: Seconds,
    /// Seconds of the processor, where they were measured.
    pub(super) processor: Option<Seconds>,
}

/// A record.
#[derive(Clone, Debug)]
pub(super) struct Record {
    pub(super) kind: Benchmark,
    pub(super) rows: Vec<Measured>,
    /// Conditions that comparable records share: the level, for times also the processor and the threads.
    pub(super) conditions: String,
    /// The compiler, where instructions were counted.
    pub(super) built: Option<String>,
    /// The command's options that measure the same again; `None` where the record has none.
    pub(super) again: Option<Vec<String>>,
}

/// Reads a record that one of the measurements wrote with `--json`.
pub(super) fn read(path: &Path) -> Result<Record> {
    let text = std::fs::read_to_string(path).with_context(|| format!("reading {}", path.display()))?;
    parse(&text).with_context(|| path.display().to_string())
}

/// Parses the text of a record.
pub(super) fn parse(text: &str) -> Result<Record> {
    let value: Value = serde_json::from_str(text).context("not JSON")?;
    let list = |key: &str| value.get(key).and_then(Value::as_array);
    if let (Some(stages), Some(built)) = (list("stages"), value.get("built").and_then(Value::as_str)) {
        let rows = stages.iter().map(|stage| {
            let count = stage.get("instructions").and_then(Value::as_u64).context("expected instructions")? as f64;
            let value = Seconds { min: count, median: count, max: count };
            Ok(Measured { name: named(stage, &["stage", "precision"])?, value, processor: None })
        });
        return Ok(Record {
            kind: Benchmark::Instructions,
            rows: rows.collect::<Result<_>>()?,
            conditions: text_at(&value, "isa")?.to_owned(),
            built: Some(built.to_owned()),
            again: Some(["stages", "--instructions"].map(String::from).to_vec()),
        });
    }
    let Some(machine) = value.get("machine") else {
        bail!("expected what stages, kernels or raster wrote with --json, found something else");
    };
    let threads = machine.get("threads").and_then(Value::as_u64).context("machine: expected threads")?;
    let (cpu, isa) = (text_at(machine, "cpu")?, text_at(machine, "isa")?);
    let conditions = format!("{threads} threads, {isa}, {cpu}");
    let with = |command: &str, more: Vec<String>| {
        let threads = threads.to_string();
        [[command, "--threads", &threads, "--isa", isa].map(String::from).to_vec(), more].concat()
    };
    let (kind, names, rows, again): (_, &[&str], _, _) = if let Some(rows) = list("stages") {
        (Benchmark::Stages, &["name", "size", "precision"], rows, stages_again(rows).map(|more| with("stages", more)))
    } else if let Some(rows) = list("kernels") {
        (Benchmark::Kernels, &["kernel", "model", "precision", "size"], rows, Some(with("kernels", Vec::new())))
    } else if let Some(rows) = list("scenes") {
        let renderer = value.get("renderer").and_then(Value::as_str).unwrap_or("cpu");
        let more = ["--largest", "0", "--renderer", renderer].map(String::from).to_vec();
        (Benchmark::Raster, &["name"], rows, Some(with("raster", more)))
    } else {
        bail!("expected stages, kernels or scenes, found neither");
    };
    let rows = rows.iter().map(|row| {
        let value = times(row, "seconds", 1.0).or_else(|_| times(row, "milliseconds", 1e-3))?;
        // A time too short for the processor's clock is missing.
        Ok(Measured { name: named(row, names)?, value, processor: times(row, "processor", 1.0).ok() })
    });
    let rows = rows.collect::<Result<_>>()?;
    Ok(Record { kind, rows, conditions, built: None, again })
}

/// Returns the options that measure stages of the same sizes and the same precision; `None` for a model from a file.
fn stages_again(rows: &[Value]) -> Option<Vec<String>> {
    let of = |key: &str| {
        let mut all: Vec<&str> = rows.iter().filter_map(|row| row.get(key)?.as_str()).collect();
        all.sort_unstable();
        all.dedup();
        all
    };
    let size = match of("size")[..] {
        [one @ ("small" | "paper")] => one,
        ["paper", "small"] => "all",
        _ => return None,
    };
    let precision = of("precision");
    let [precision] = precision[..] else { return None };
    let mut again = ["--size", size, "--precision", precision].map(String::from).to_vec();
    // A record of one stage measures only that stage.
    if let [name] = of("name")[..] {
        again.extend(["--only", name].map(String::from));
    }
    Some(again)
}

/// The times that a row has under `key`, in seconds.
fn times(row: &Value, key: &str, unit: f64) -> Result<Seconds> {
    let at = |which: &str| {
        let time = row.get(key).and_then(|times| times.get(which)?.as_f64());
        let time = time.filter(|time| *time > 0.0 && time.is_finite());
        time.map(|time| unit * time).with_context(|| format!("{key}: {which}: expected a time above 0"))
    };
    Ok(Seconds { min: at("min")?, median: at("median")?, max: at("max")? })
}

fn named(row: &Value, keys: &[&str]) -> Result<String> {
    let parts: Result<Vec<&str>> = keys.iter().map(|key| text_at(row, key)).collect();
    Ok(parts?.join(" "))
}

fn text_at<'a>(value: &'a Value, key: &str) -> Result<&'a str> {
    value.get(key).and_then(Value::as_str).with_context(|| format!("{key}: expected text"))
}
