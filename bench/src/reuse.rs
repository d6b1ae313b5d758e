//! `reuse`: what leaving out work costs and saves on given clips.
//!
//! Every variant (a choice of reuse and of gap) takes the same frames through an engine of its own, in turn, key frame by key frame:
//! what disturbs the machine disturbs all of them alike. Times are those of the processor where the system tells (Linux), else of the
//! clock; with `--threads 1` the former do not depend on what else runs.

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Args;
use serde::Serialize;
use streamsplat::Settings;
use streamsplat::fit::Fit;
use streamsplat::gap::Gap;
use streamsplat::picture::Picture;
use streamsplat::source::TimedPicture;
use streamsplat::stream::{ModelSource, Reuse};
use streamsplat_model::Precision;

use crate::Common;
use crate::passage::{Models, Runner, Variant, against, clips, mean_square_error, read, truths};
use crate::timing::Spent;

/// Options of `reuse`.
#[derive(Args)]
pub(crate) struct Options {
    #[command(flatten)]
    common: Common,
    /// Clips: folders of images or videos; or folders of such folders.
    #[arg(required = true)]
    inputs: Vec<PathBuf>,
    /// Choices of reuse, beside off.
    #[arg(long, value_delimiter = ',', default_value = "exact,0.02,0.05,0.1")]
    reuse: Vec<Reuse>,
    /// Gaps between key frames.
    #[arg(long, value_delimiter = ',', default_value = "1,auto")]
    gap: Vec<Gap>,
    /// Input frames of each clip that are used.
    #[arg(long, value_name = "N")]
    frames: Option<usize>,
    /// f32, bf16 or int8.
    #[arg(long, default_value = "f32")]
    precision: Precision,
    /// Checkpoint [default: the embedded one].
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// DINOv2's weights, for models conditioned on them.
    #[arg(long, value_name = "FILE")]
    dinov2: Option<PathBuf>,
}

/// What a variant took and gave on a clip.
#[derive(Clone, Debug, Serialize)]
struct Row {
    clip: String,
    reuse: String,
    gap: String,
    frames: usize,
    keys: usize,
    /// Of [`streamsplat::Engine::push`] per key frame.
    key_frame: Spent,
    /// Of everything but reading and writing, per input frame.
    frame: Spent,
    /// Time of key frames relative to the variant without reuse.
    cost: f64,
    /// Time of the network alone, relative to the same.
    network_cost: f64,
    /// Of all frames' images against those without reuse; none where all are equal.
    psnr_vs_off: Option<f64>,
    /// Of key frames and of those between, against the true frames at 256×256.
    psnr_key: f64,
    psnr_middle: Option<f64>,
    /// Of all frames against the true ones, above that of the variant without reuse.
    gain: f64,
    /// Work of the network's parts: done and avoided.
    tokens: Vec<(String, u64, u64)>,
}

/// Takes a clip through every variant. Each is compared with the first of its gap.
fn measure(name: &str, clip: &[TimedPicture], variants: &[Variant], settings: &Settings) -> Result<Vec<Row>> {
    let runners = Models::new(settings.clone()).pass(clip, variants)?;
    let truths = truths(clip);
    let mut rows: Vec<Row> = Vec::new();
    for runner in &runners {
        let base =
            runners.iter().find(|base| base.variant.gap == runner.variant.gap).context("a variant without a first")?;
        rows.push(row(runner, name, &truths, base)?);
    }
    Ok(rows)
}

fn row(runner: &Runner, name: &str, truths: &[Picture], base: &Runner) -> Result<Row> {
    let frames = runner.images.len();
    let own = against(&runner.images, truths)?;
    let others = against(&base.images, truths)?;
    let mean = |values: &mut dyn Iterator<Item = f64>| {
        let (sum, count) = values.fold((0.0, 0), |(sum, count), x| (sum + x, count + 1));
        (count > 0).then(|| sum / f64::from(count))
    };
    let is_key = |i: &usize| runner.keys.contains(i);
    let error = mean_square_error(&runner.images, &base.images)?;
    let tokens = runner.engine.work().stages().iter().filter(|stage| stage.stage.ends_with(".tokens"));
    Ok(Row {
        clip: name.to_owned(),
        reuse: runner.variant.reuse.to_string(),
        gap: runner.variant.gap.to_string(),
        frames,
        keys: runner.keys.len(),
        key_frame: runner.pushed / runner.keys.len() as f64,
        frame: runner.frame(),
        cost: runner.pushed.seconds() / base.pushed.seconds(),
        network_cost: runner.network / base.network,
        psnr_vs_off: (error > 0.0).then(|| -10.0 * error.log10()),
        psnr_key: mean(&mut (0..frames).filter(is_key).map(|i| own[i])).unwrap_or(f64::NAN),
        psnr_middle: mean(&mut (0..frames).filter(|i| !is_key(i)).map(|i| own[i])),
        gain: own.iter().zip(&others).map(|(a, b)| a - b).sum::<f64>() / frames as f64,
        tokens: tokens.map(|stage| (stage.stage.to_owned(), stage.done, stage.avoided)).collect(),
    })
}

pub(crate) fn run(options: &Options) -> Result<()> {
    let model = match &options.model {
        None => ModelSource::Embedded,
        Some(checkpoint) => ModelSource::File { checkpoint: checkpoint.clone(), dinov2: options.dinov2.clone() },
    };
    let mut settings = Settings::with_model(model);
    settings.level = Some(options.common.isa);
    settings.threads = options.common.threads;
    settings.fit = Fit::Stretch;
    let choices = [&[Reuse::Off], options.reuse.as_slice()].concat();
    let variants: Vec<Variant> = options
        .gap
        .iter()
        .flat_map(|gap| choices.iter().map(|reuse| Variant { precision: options.precision, reuse: *reuse, gap: *gap }))
        .collect();
    let mut rows = Vec::new();
    println!(
        "{:<24} {:>6} {:>4} {:>8} {:>8} {:>6} {:>6} {:>7} {:>7} {:>7} {:>7}",
        "clip", "reuse", "gap", "ms/key", "ms/frame", "cost", "net", "vs off", "key", "middle", "gain"
    );
    for path in clips(&options.inputs)? {
        let clip = read(&path, options.frames)?;
        let name = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
        for row in measure(&name, &clip, &variants, &settings)? {
            let show = |x: Option<f64>| x.map_or_else(|| "-".to_owned(), |x| format!("{x:.2}"));
            println!(
                "{:<24} {:>6} {:>4} {:>8.1} {:>8.1} {:>6.3} {:>6.3} {:>7} {:>7.2} {:>7} {:>7.3}",
                row.clip,
                row.reuse,
                row.gap,
                row.key_frame.seconds() * 1e3,
                row.frame.seconds() * 1e3,
                row.cost,
                row.network_cost,
                show(row.psnr_vs_off),
                row.psnr_key,
                show(row.psnr_middle),
                row.gain
            );
            let shares: Vec<String> = row
                .tokens
                .iter()
                .map(|(part, done, avoided)| format!("{part} {:.2}", *done as f64 / (done + avoided).max(1) as f64))
                .collect();
            if !shares.is_empty() {
                println!("{:<24} {}", "", shares.join("  "));
            }
            rows.push(row);
        }
    }
    options.common.write(&rows)
}
