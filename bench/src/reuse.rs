//! `reuse`: what leaving out work costs and saves on given clips.
//!
//! Every variant (a choice of reuse and of gap) takes the same frames through an engine of its own, in turn, key frame by key frame:
//! what disturbs the machine disturbs all of them alike. Times are those of the processor where the system tells (Linux), else of the
//! clock; with `--threads 1` the former do not depend on what else runs.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, ensure};
use clap::Args;
use serde::Serialize;
use streamsplat::fit::Fit;
use streamsplat::gap::{Choice, Chooser, Gap};
use streamsplat::metrics::psnr;
use streamsplat::picture::Picture;
use streamsplat::render::Painter;
use streamsplat::source::{self, Source, TimedPicture, folder};
use streamsplat::stream::{ModelSource, Reuse, Work};
use streamsplat::{Camera, Engine, Frame, RenderOptions, Settings};
use streamsplat_model::Precision;

use crate::Common;
use crate::timing::{Spent, Stopwatch};

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

/// A way through a clip.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Variant {
    pub(crate) reuse: Reuse,
    pub(crate) gap: Gap,
}

/// What a variant took and gave on a clip.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Row {
    pub(crate) clip: String,
    pub(crate) reuse: String,
    pub(crate) gap: String,
    pub(crate) frames: usize,
    pub(crate) keys: usize,
    /// Of [`Engine::push`] per key frame.
    pub(crate) key_frame: Spent,
    /// Of everything but reading and writing, per input frame.
    pub(crate) frame: Spent,
    /// Time of key frames relative to the variant without reuse.
    pub(crate) cost: f64,
    /// Time of the network alone, relative to the same.
    pub(crate) network_cost: f64,
    /// Of all frames' images against those without reuse; none where all are equal.
    pub(crate) psnr_vs_off: Option<f64>,
    /// Of key frames and of those between, against the true frames at 256×256.
    pub(crate) psnr_key: f64,
    pub(crate) psnr_middle: Option<f64>,
    /// Of all frames against the true ones, above that of the variant without reuse.
    pub(crate) gain: f64,
    /// Work of the network's parts: done and avoided.
    pub(crate) tokens: Vec<(String, u64, u64)>,
}

/// Frames of a clip.
pub(crate) fn read(input: &Path, frames: Option<usize>) -> Result<Vec<TimedPicture>> {
    let mut source = Source::open(input, &source::Options::default())?;
    let mut read = Vec::new();
    while read.len() < frames.unwrap_or(usize::MAX)
        && let Some(frame) = source.next_frame()?
    {
        read.push(frame);
    }
    Ok(read)
}

/// The clip's key frames; as in a run, the last frame is one.
fn keys(gap: Gap, clip: &[TimedPicture]) -> Vec<usize> {
    let mut chooser = Chooser::new(gap);
    let mut keys = Vec::new();
    for (index, frame) in clip.iter().enumerate() {
        match chooser.next(&frame.picture) {
            Choice::Wait => {}
            Choice::This => keys.push(index),
            Choice::Before => keys.push(index - 1),
        }
    }
    if let Some(last) = clip.len().checked_sub(1)
        && keys.last() != Some(&last)
    {
        keys.push(last);
    }
    keys
}

/// One variant under way.
struct Runner {
    variant: Variant,
    engine: Engine,
    painter: Painter,
    keys: Vec<usize>,
    chosen: Spent,
    pushed: Spent,
    drawn: Spent,
    network: f64,
    images: Vec<Picture>,
}

/// The stages of the network.
const NETWORK: [&str; 4] = ["encoder", "upsampler", "heads", "decoder"];

fn network_seconds(work: &Work) -> f64 {
    NETWORK.iter().filter_map(|stage| work.stage(stage)).map(|stage| stage.time.as_secs_f64()).sum()
}

/// Takes a clip through every variant. Each is compared with the first of its gap.
pub(crate) fn measure(
    name: &str,
    clip: &[TimedPicture],
    variants: &[Variant],
    settings: &Settings,
) -> Result<Vec<Row>> {
    let mut settings = settings.clone();
    let mut runners = Vec::new();
    for variant in variants {
        let engine = Engine::new(Settings { reuse: variant.reuse, ..settings.clone() })?;
        settings.model = ModelSource::Shared(Arc::clone(engine.model()));
        let watch = Stopwatch::start();
        let keys = keys(variant.gap, clip);
        let chosen = watch.stop();
        let painter = Painter::new(engine.workers());
        let (pushed, drawn) = (Spent::default(), Spent::default());
        let variant = variant.clone();
        runners.push(Runner {
            variant,
            engine,
            painter,
            keys,
            chosen,
            pushed,
            drawn,
            network: 0.0,
            images: Vec::new(),
        });
    }
    for index in 0..clip.len() {
        for runner in runners.iter_mut().filter(|runner| runner.keys.contains(&index)) {
            runner.take(clip, index)?;
        }
    }
    let mut rows: Vec<Row> = Vec::new();
    for runner in &runners {
        let base =
            runners.iter().find(|base| base.variant.gap == runner.variant.gap).context("a variant without a first")?;
        rows.push(runner.row(name, clip, base)?);
    }
    Ok(rows)
}

impl Runner {
    fn take(&mut self, clip: &[TimedPicture], index: usize) -> Result<()> {
        let Picture { width, height, rgb } = clip[index].picture.clone();
        let watch = Stopwatch::start();
        let interval = self.engine.push(Frame { width, height, rgb, depth: None }, clip[index].timestamp)?;
        self.pushed += watch.stop();
        for frame in &clip[self.images.len()..=index] {
            let watch = Stopwatch::start();
            let image = self.painter.draw(&interval, frame.timestamp, &Camera::Canonical, &RenderOptions::default())?;
            self.drawn += watch.stop();
            self.images.push(Picture { width: image.width, height: image.height, rgb: image.rgb.clone() });
        }
        self.network = network_seconds(self.engine.work());
        Ok(())
    }

    fn row(&self, name: &str, clip: &[TimedPicture], base: &Runner) -> Result<Row> {
        ensure!(self.images.len() == base.images.len(), "variants of one gap drew other frames");
        let frames = self.images.len();
        let truths: Vec<Picture> = clip[..frames].iter().map(|frame| frame.picture.resized(256, 256)).collect();
        let against = |images: &[Picture]| -> Result<Vec<f64>> {
            images.iter().zip(&truths).map(|(image, truth)| Ok(psnr(&image.resized(256, 256), truth)?)).collect()
        };
        let own = against(&self.images)?;
        let others = against(&base.images)?;
        let mean = |values: &mut dyn Iterator<Item = f64>| {
            let (sum, count) = values.fold((0.0, 0), |(sum, count), x| (sum + x, count + 1));
            (count > 0).then(|| sum / f64::from(count))
        };
        let is_key = |i: &usize| self.keys.contains(i);
        let mut error = 0.0;
        for (a, b) in self.images.iter().zip(&base.images) {
            error += streamsplat::metrics::mean_square_error(a, b)? / frames as f64;
        }
        let tokens = self.engine.work().stages().iter().filter(|stage| stage.stage.ends_with(".tokens"));
        Ok(Row {
            clip: name.to_owned(),
            reuse: self.variant.reuse.to_string(),
            gap: self.variant.gap.to_string(),
            frames,
            keys: self.keys.len(),
            key_frame: self.pushed / self.keys.len() as f64,
            frame: (self.chosen + self.pushed + self.drawn) / frames as f64,
            cost: self.pushed.seconds() / base.pushed.seconds(),
            network_cost: self.network / base.network,
            psnr_vs_off: (error > 0.0).then(|| -10.0 * error.log10()),
            psnr_key: mean(&mut (0..frames).filter(is_key).map(|i| own[i])).unwrap_or(f64::NAN),
            psnr_middle: mean(&mut (0..frames).filter(|i| !is_key(i)).map(|i| own[i])),
            gain: own.iter().zip(&others).map(|(a, b)| a - b).sum::<f64>() / frames as f64,
            tokens: tokens.map(|stage| (stage.stage.to_owned(), stage.done, stage.avoided)).collect(),
        })
    }
}

/// The clips of the inputs, in natural order.
pub(crate) fn clips(inputs: &[PathBuf]) -> Result<Vec<PathBuf>> {
    let mut clips = Vec::new();
    for input in inputs {
        if !input.is_dir() || folder::images(input).is_ok() {
            clips.push(input.clone());
            continue;
        }
        let entries = std::fs::read_dir(input).with_context(|| format!("{}", input.display()))?;
        let mut inside: Vec<PathBuf> =
            entries.flatten().map(|entry| entry.path()).filter(|path| path.is_dir()).collect();
        inside.sort();
        ensure!(!inside.is_empty(), "{}: neither images nor clips", input.display());
        clips.extend(inside);
    }
    Ok(clips)
}

pub(crate) fn run(options: &Options) -> Result<()> {
    let model = match &options.model {
        None => ModelSource::Embedded,
        Some(checkpoint) => ModelSource::File { checkpoint: checkpoint.clone(), dinov2: options.dinov2.clone() },
    };
    let mut settings = Settings::with_model(model);
    settings.precision = options.precision;
    settings.level = Some(options.common.isa);
    settings.threads = options.common.threads;
    settings.fit = Fit::Stretch;
    let choices = [&[Reuse::Off], options.reuse.as_slice()].concat();
    let variants: Vec<Variant> =
        options.gap.iter().flat_map(|gap| choices.iter().map(|reuse| Variant { reuse: *reuse, gap: *gap })).collect();
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
