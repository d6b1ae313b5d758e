//! Error against run time on a folder of clips: time and error of each option, the qualities, and a grid of options
//! around them.
//!
//! Every row is one run of `streamsplat eval` on all clips, with the options that it names. *Seen* rows have the frames
//! between key frames as input, the others do not; the two kinds are never compared. The record yields the table of a
//! page and a plot, which `--record` writes again without measuring.

mod page;
mod plot;
mod rows;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail, ensure};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use streamsplat::folder;
use streamsplat_bench::machine::cpu;

use super::Options;
use super::front::front;

/// Loss in dB that is allowed for a higher quality on a clip.
const TOLERANCE: f64 = 0.05;

/// Measurements of a folder of clips.
#[derive(Serialize, Deserialize)]
struct Record {
    cpu: String,
    isa: String,
    threads: usize,
    clips: usize,
    note: String,
    baselines: Baselines,
    rows: Vec<Configuration>,
}

/// Frames between key frames, in dB, at the gap of the steps.
#[derive(Serialize, Deserialize)]
struct Baselines {
    crossfade: f64,
    flow: f64,
}

/// Reason for a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Reason {
    /// One option after the other, each in addition to those before.
    Step,
    /// The default with one of its parts off.
    Part,
    Quality,
    Grid,
}

#[derive(Serialize, Deserialize)]
struct Configuration {
    row: String,
    kind: Reason,
    seen: bool,
    arguments: Vec<String>,
    /// PSNR in dB at key frames, between them, and of all frames; means over frames.
    key: f64,
    between: f64,
    all: f64,
    /// Decibels over the cross-fade between key frames, means over moving and over still clips.
    moving: Option<f64>,
    still: Option<f64>,
    /// Time in the engine, per input frame.
    seconds_per_frame: f64,
    /// True if no row with the same input is at least as close to all frames in less time.
    pareto: bool,
    by_clip: BTreeMap<String, Clip>,
}

#[derive(Clone, Copy, Serialize, Deserialize)]
struct Clip {
    all: f64,
    over_crossfade: f64,
    seconds_per_frame: f64,
}

/// Returns true if this is a folder of clips.
pub(super) fn is_folder_of_clips(input: &Path) -> bool {
    input.is_dir() && !folder::has_images(input)
}

/// Measures, or reads `--record`; writes record, page and plot.
pub(super) fn run(options: &Options, clips: &Path) -> Result<()> {
    let record = match &options.record {
        Some(file) => {
            let text = std::fs::read_to_string(file).with_context(|| file.display().to_string())?;
            serde_json::from_str(&text).with_context(|| file.display().to_string())?
        }
        None => measure(options, clips)?,
    };
    let table = page::table(&record);
    print!("{table}");
    std::fs::create_dir_all(&options.out).with_context(|| format!("creating {}", options.out.display()))?;
    let write =
        |path: PathBuf, text: &str| std::fs::write(&path, text).with_context(|| format!("writing {}", path.display()));
    if options.record.is_none() {
        streamsplat_bench::write_json(&options.out.join("tradeoff-clips.json"), &record)?;
    }
    options.common.write(&record)?;
    let svg = plot::svg(&record)?;
    match &options.page {
        Some(file) => {
            let text = std::fs::read_to_string(file).with_context(|| file.display().to_string())?;
            write(file.clone(), &page::with_table(&text, &table)?)?;
            write(file.with_file_name("tradeoff.svg"), &svg)
        }
        None => write(options.out.join("tradeoff-clips.svg"), &svg),
    }
}

fn measure(options: &Options, clips: &Path) -> Result<Record> {
    let own = std::env::current_exe().context("finding this program")?;
    let program = own.with_file_name(format!("streamsplat{}", std::env::consts::EXE_SUFFIX));
    ensure!(program.is_file(), "{}: not found; cargo build --release builds it", program.display());
    let threads = options.common.pool()?.current_num_threads();
    let (mut rows, mut baselines, mut count) = (Vec::new(), None, 0);
    for (name, kind, arguments) in rows::all() {
        let mut command = Command::new(&program);
        let figures = std::env::temp_dir().join(format!("streamsplat-tradeoff-{}.json", std::process::id()));
        command.arg("eval").arg(clips).args(["--quiet", "--json"]).arg(&figures).args(&arguments);
        command.args(["--threads", &threads.to_string(), "--isa", options.common.isa.name()]);
        ensure!(command.status().context("starting the program")?.success(), "eval {}: failed", arguments.join(" "));
        let text = std::fs::read(&figures).context("the figures of eval")?;
        let figures: Value = serde_json::from_slice(&text).context("the figures of eval")?;
        let row = Configuration::read(name, kind, arguments, &figures).context("the figures of eval")?;
        println!("{:>7.1} ms  {:.2} dB  {}", 1e3 * row.seconds_per_frame, row.all, row.row);
        // Flow is computed on the model's input, so its blend depends on the resolution.
        if kind == Reason::Step && !row.arguments.iter().any(|word| word == "native") {
            let mean = |name: &str| figures["mean"]["baselines"][name]["psnr"].as_f64();
            baselines = mean("crossfade").zip(mean("flow")).map(|(crossfade, flow)| Baselines { crossfade, flow });
        }
        count = row.by_clip.len();
        rows.push(row);
    }
    for seen in [false, true] {
        let chosen: Vec<usize> = (0..rows.len()).filter(|&i| rows[i].seen == seen).collect();
        let points: Vec<(f64, f64)> = chosen.iter().map(|&i| (rows[i].seconds_per_frame, rows[i].all)).collect();
        for (&i, pareto) in chosen.iter().zip(front(&points)) {
            rows[i].pareto = pareto;
        }
    }
    Ok(Record {
        cpu: cpu(),
        isa: options.common.isa.name().to_owned(),
        threads,
        clips: count,
        note: options.note.clone(),
        baselines: baselines.context("no baselines")?,
        rows,
    })
}

impl Configuration {
    /// Reads the output of `eval`.
    fn read(row: String, kind: Reason, arguments: Vec<String>, figures: &Value) -> Option<Configuration> {
        let score = |value: &Value| Some((value["psnr"].as_f64()?, value["frames"].as_f64()?));
        let all = |row: &Value| {
            let ((key, keys), (between, betweens)) = (score(&row["key"])?, score(&row["middle"])?);
            Some((key * keys + between * betweens) / (keys + betweens))
        };
        let mean = &figures["mean"];
        let mut by_clip = BTreeMap::new();
        for clip in figures["clips"].as_array()? {
            let over_crossfade = score(&clip["middle"])?.0 - score(&clip["baselines"]["crossfade"])?.0;
            let seconds_per_frame = clip["seconds_per_frame"].as_f64()?;
            let figures = Clip { all: all(clip)?, over_crossfade, seconds_per_frame };
            by_clip.insert(clip["name"].as_str()?.to_owned(), figures);
        }
        Some(Configuration {
            row,
            kind,
            seen: figures["seen"].as_bool()?,
            arguments,
            key: score(&mean["key"])?.0,
            between: score(&mean["middle"])?.0,
            all: all(mean)?,
            moving: mean["moving"]["over_crossfade"].as_f64(),
            still: mean["still"]["over_crossfade"].as_f64(),
            seconds_per_frame: mean["seconds_per_frame"].as_f64()?,
            pareto: false,
            by_clip,
        })
    }
}

impl Record {
    /// The qualities that see the frames between, from the fastest on.
    fn qualities(&self) -> Vec<&Configuration> {
        self.rows.iter().filter(|row| row.kind == Reason::Quality && row.seen).collect()
    }

    /// Clips on which a higher quality is worse than the one before, with both names.
    fn against_the_dial(&self) -> Vec<String> {
        let mut found = Vec::new();
        for pair in self.qualities().windows(2) {
            for (name, lower) in &pair[0].by_clip {
                let Some(higher) = pair[1].by_clip.get(name) else { continue };
                if higher.all < lower.all - TOLERANCE {
                    found.push(format!("{name} ({:.2} dB to {:.2})", lower.all, higher.all));
                }
            }
        }
        found
    }
}

/// Checks options that need the other kind of input.
pub(super) fn check(options: &Options) -> Result<()> {
    if options.page.is_some() || options.record.is_some() {
        bail!("--page and --record: expected a folder of clips as well");
    }
    Ok(())
}
