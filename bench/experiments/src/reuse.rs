//! `reuse`: cost and saving of skipped work on a set of clips.
//!
//! Every variant (a choice of reuse and of gap) takes the same frames through an engine of its own, in turn, key frame
//! by key frame. So other load on the machine disturbs all of them equally. Times are processor times where available
//! (Linux), otherwise by the clock. Processor times still vary by some per cent with other load. `--rounds` takes the
//! clips several times and keeps the least time of every key frame, whose images must have the same bits each time.

mod table;

use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use clap::Args;
use serde::Serialize;
use streamsplat::Settings;
use streamsplat::fit::Fit;
use streamsplat::folder;
use streamsplat::gap::Gap;
use streamsplat::picture::Picture;
use streamsplat::source::TimedPicture;
use streamsplat::stream::{ModelSource, Reuse};
use streamsplat_bench::Common;
use streamsplat_bench::machine::cpu;
use streamsplat_bench::passage::{
    Models, Runner, Variant, against, gap_name, mean_square_error, once_each, read, truths,
};
use streamsplat_bench::timing::Spent;
use streamsplat_model::Precision;

/// Options of `reuse`.
#[derive(Args)]
pub(crate) struct Options {
    #[command(flatten)]
    common: Common,
    /// Clips: folders of images or videos; or folders of such folders.
    #[arg(required = true)]
    inputs: Vec<PathBuf>,
    /// Choices of reuse, in addition to off.
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
    /// Times every clip is taken.
    #[arg(long, default_value_t = 1)]
    rounds: usize,
    /// A table (tab-separated) with columns `clip` and `static_camera` (yes or no), by which clips are summed up.
    #[arg(long, value_name = "FILE")]
    manifest: Option<PathBuf>,
    /// Write the tables here as Markdown.
    #[arg(long, value_name = "FILE")]
    markdown: Option<PathBuf>,
    /// A sentence for the record on the conditions of the run.
    #[arg(long, value_name = "TEXT", default_value = "")]
    note: String,
}

/// Machine and settings of the measurement.
#[derive(Serialize)]
struct About {
    command: String,
    cpu: String,
    isa: &'static str,
    note: String,
}

#[derive(Serialize)]
struct Results {
    about: About,
    rows: Vec<VariantResult>,
}

/// Cost and result of a variant on a clip.
#[derive(Clone, Debug, Serialize)]
struct VariantResult {
    clip: String,
    /// True if the camera is still, if in the manifest.
    still: Option<bool>,
    reuse: String,
    gap: String,
    frames: usize,
    keys: usize,
    /// Time of [`streamsplat::Engine::push`] per key frame.
    key_frame: Spent,
    /// Time of everything but reading and writing, per input frame.
    frame: Spent,
    /// Time of key frames relative to the variant without reuse.
    cost: f64,
    /// PSNR of all frames' images against those without reuse; `None` where all are equal.
    psnr_vs_off: Option<f64>,
    /// PSNR of all frames, of key frames and of those between, against the true frames at 256×256.
    psnr: f64,
    psnr_key: f64,
    psnr_middle: Option<f64>,
    /// PSNR of all frames against the true ones, minus that of the variant without reuse.
    gain: f64,
    /// Work, done and avoided: the network's stages, and their parts in tokens.
    work: Vec<(String, u64, u64)>,
}

/// Takes a clip through every variant. Each is compared with the first of its gap.
fn measure(
    name: &str,
    clip: &[TimedPicture],
    variants: &[Variant],
    settings: &Settings,
    rounds: usize,
) -> Result<Vec<VariantResult>> {
    let mut models = Models::new(settings.clone());
    let mut runners = models.pass(clip, variants)?;
    for _ in 1..rounds {
        for (runner, again) in runners.iter_mut().zip(models.pass(clip, variants)?) {
            ensure!(runner.images == again.images, "{name}, {:?}: other images again", runner.variant);
            runner.quicken(&again);
        }
    }
    let truths = truths(clip);
    let mut rows: Vec<VariantResult> = Vec::new();
    for runner in &runners {
        let base =
            runners.iter().find(|base| base.variant.gap == runner.variant.gap).context("a variant without a first")?;
        rows.push(row(runner, name, &truths, base)?);
    }
    Ok(rows)
}

fn row(runner: &Runner, name: &str, truths: &[Picture], base: &Runner) -> Result<VariantResult> {
    let frames = runner.images.len();
    let own = against(&runner.images, truths)?;
    let others = against(&base.images, truths)?;
    let mean = |values: &mut dyn Iterator<Item = f64>| {
        let (sum, count) = values.fold((0.0, 0), |(sum, count), x| (sum + x, count + 1));
        (count > 0).then(|| sum / f64::from(count))
    };
    let is_key = |i: &usize| runner.keys.contains(i);
    let error = mean_square_error(&runner.images, &base.images)?;
    Ok(VariantResult {
        clip: name.to_owned(),
        still: None,
        reuse: runner.variant.reuse.to_string(),
        gap: gap_name(runner.variant.gap),
        frames,
        keys: runner.keys.len(),
        key_frame: runner.pushed() / runner.keys.len() as f64,
        frame: runner.frame(),
        cost: runner.pushed().seconds() / base.pushed().seconds(),
        psnr_vs_off: (error > 0.0).then(|| -10.0 * error.log10()),
        psnr: own.iter().sum::<f64>() / frames as f64,
        psnr_key: mean(&mut (0..frames).filter(is_key).map(|i| own[i])).unwrap_or(f64::NAN),
        psnr_middle: mean(&mut (0..frames).filter(|i| !is_key(i)).map(|i| own[i])),
        gain: own.iter().zip(&others).map(|(a, b)| a - b).sum::<f64>() / frames as f64,
        work: runner.engine.work().stages().iter().map(|w| (w.stage.to_owned(), w.done, w.avoided)).collect(),
    })
}

/// The clips of the inputs, in natural order.
fn clips(inputs: &[PathBuf]) -> Result<Vec<PathBuf>> {
    let mut clips = Vec::new();
    for input in inputs {
        if !input.is_dir() || folder::has_images(input) {
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

/// For each clip of a manifest, whether its camera is still.
fn still(manifest: &str) -> Option<Vec<(&str, bool)>> {
    let mut lines = manifest.lines();
    let head: Vec<&str> = lines.next()?.split('\t').collect();
    let [clip, camera] = ["clip", "static_camera"].map(|name| head.iter().position(|column| *column == name));
    let (clip, camera) = (clip?, camera?);
    let cells = lines.map(|line| line.split('\t').collect::<Vec<_>>());
    cells.map(|cells| Some((*cells.get(clip)?, *cells.get(camera)? == "yes"))).collect()
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
    let manifest = match &options.manifest {
        Some(path) => std::fs::read_to_string(path).with_context(|| format!("{}", path.display()))?,
        None => "clip\tstatic_camera".to_owned(),
    };
    let cameras = still(&manifest).context("--manifest: expected columns `clip` and `static_camera` in every line")?;
    let choices = once_each(Reuse::Off, &options.reuse);
    let variants: Vec<Variant> = options
        .gap
        .iter()
        .flat_map(|gap| choices.iter().map(|reuse| Variant { precision: options.precision, reuse: *reuse, gap: *gap }))
        .collect();
    let mut rows = Vec::new();
    println!("{}", table::TABLE.heads());
    for path in clips(&options.inputs)? {
        let clip = read(&path, options.frames)?;
        let name = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
        let still = cameras.iter().find(|(clip, _)| *clip == name).map(|(_, still)| *still);
        for row in measure(&name, &clip, &variants, &settings, options.rounds.max(1))? {
            let row = VariantResult { still, ..row };
            print!("{}", table::line(&row));
            rows.push(row);
        }
    }
    let about =
        About { command: options.command(), cpu: cpu(), isa: options.common.isa.name(), note: options.note.clone() };
    let results = Results { about, rows };
    if let Some(path) = &options.markdown {
        std::fs::write(path, table::markdown(&results)).with_context(|| format!("writing {}", path.display()))?;
    }
    options.common.write(&results)
}

impl Options {
    /// The command that repeats the measurement, except for the clips' path.
    fn command(&self) -> String {
        fn list<T: ToString>(values: &[T]) -> String {
            values.iter().map(T::to_string).collect::<Vec<_>>().join(",")
        }
        let mut command = format!(
            "streamsplat-experiments reuse CLIPS --threads {} --rounds {} --precision {} --reuse {} --gap {}",
            self.common.threads,
            self.rounds,
            self.precision.name(),
            list(&self.reuse),
            list(&self.gap.iter().map(|gap| gap_name(*gap)).collect::<Vec<_>>())
        );
        if let Some(frames) = self.frames {
            command += &format!(" --frames {frames}");
        }
        if let Some(model) = &self.model {
            command += &format!(" --model {}", model.file_name().unwrap_or_default().to_string_lossy());
        }
        command
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_manifest_tells_by_its_head_which_cameras_stand_still() {
        let manifest = "static_camera\tframes\tclip\nyes\t41\ta\nno\t41\tb\n";
        assert_eq!(still(manifest), Some(vec![("a", true), ("b", false)]));
        assert_eq!(still("clip\tframes\na\t41"), None);
        assert_eq!(still("clip\tstatic_camera\na"), None);
    }
}
