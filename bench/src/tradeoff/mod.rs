//! `tradeoff`: error against run time on one clip, over precision, reuse and gap; and each stage's error and time per
//! precision. On a folder of clips ([`clips`]): over resolution, motion, colours, gap and quality.
//!
//! One run writes CSV, JSON, Markdown and plots. All configurations take the clip in turn, key frame by key frame,
//! several times, so that other load on the machine disturbs all of them equally. Before anything is timed, f32 must
//! compute the same bits on another number of threads, and exact reuse the same as no reuse. In every later round every
//! configuration must repeat its bits.
//!
//! A checkpoint runs at one number of tokens, because its decoder stores a row per token of two frames. So the
//! resolution is the model's own; other resolutions need other checkpoints (`--model`).

mod clips;
mod front;
mod grid;
mod plot;
mod stages;
mod standing;
mod table;

use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use clap::{Args, ValueEnum};
use serde::Serialize;
use streamsplat::Settings;
use streamsplat::fit::Fit;
use streamsplat::gap::Gap;
use streamsplat::stream::{ModelSource, Reuse};
use streamsplat_bench::Common;
use streamsplat_bench::machine::cpu;
use streamsplat_bench::passage::{once_each, read};
use streamsplat_model::Precision;

use crate::model::Which;

/// Options of `tradeoff`.
#[derive(Args)]
pub(crate) struct Options {
    #[command(flatten)]
    common: Common,
    /// A folder of images or a video [default: fixtures/clips/moving.y4m]; or a folder of clips: time and error of
    /// resolution, motion, colours and `--quality` on them, with the options' defaults.
    input: Option<PathBuf>,
    /// For a folder of clips: put the table into this page, and the plot next to it as tradeoff.svg.
    #[arg(long, value_name = "FILE")]
    page: Option<PathBuf>,
    /// For a folder of clips: take the figures from this record instead of measuring.
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
    /// Folder for tradeoff.{csv,json,md,svg} and tradeoff-stages.{csv,svg}.
    #[arg(long, value_name = "DIR", default_value = "tradeoff")]
    out: PathBuf,
    /// `small`: the embedded model, or `--model`. `paper`: the published sizes with weights from a seed. As its
    /// pictures are meaningless, only the stages are measured, and key frames of a standing camera with and without
    /// reuse.
    #[arg(long, value_enum, default_value_t = Size::Small)]
    size: Size,
    /// Checkpoint [default: the embedded one].
    #[arg(long, value_name = "FILE", conflicts_with = "size")]
    model: Option<PathBuf>,
    /// DINOv2's weights, for models conditioned on them.
    #[arg(long, value_name = "FILE")]
    dinov2: Option<PathBuf>,
    /// Precisions.
    #[arg(long, value_delimiter = ',', default_value = "f32,bf16,int8")]
    precision: Vec<Precision>,
    /// Choices of reuse, in addition to off.
    #[arg(long, value_delimiter = ',', default_value = "exact,0.003,0.02")]
    reuse: Vec<Reuse>,
    /// Gaps between key frames.
    #[arg(long, value_delimiter = ',', default_value = "1,4,auto")]
    gap: Vec<Gap>,
    /// Input frames that are used.
    #[arg(long, value_name = "N")]
    frames: Option<usize>,
    /// Times every configuration takes the clip.
    #[arg(long, default_value_t = 3)]
    rounds: usize,
    /// Reference of the stages' errors: f64 (plain loops in binary64, seconds for the embedded model, some minutes for
    /// the paper's size), or f32 (the f32 network).
    #[arg(long, value_enum, default_value_t = Yardstick::F64)]
    against: Yardstick,
    /// The clock of the plot and of the Pareto front.
    #[arg(long, value_enum, default_value_t = Clock::Wall)]
    clock: Clock,
    /// A sentence for the record on the conditions of the run.
    #[arg(long, value_name = "TEXT", default_value = "")]
    note: String,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Size {
    Paper,
    Small,
}

/// Reference of errors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
enum Yardstick {
    F64,
    F32,
}

/// A time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
enum Clock {
    /// Wall-clock time.
    Wall,
    /// Time of the processor, on all threads.
    Processor,
}

impl Clock {
    fn name(self) -> &'static str {
        match self {
            Clock::Wall => "wall clock",
            Clock::Processor => "processor time",
        }
    }
}

/// Machine and input of the measurement.
#[derive(Serialize)]
struct About {
    model: String,
    clip: String,
    frames: usize,
    resolution: String,
    cpu: String,
    isa: &'static str,
    threads: usize,
    rounds: usize,
    /// Times each stage was run.
    repeat: usize,
    /// Clock of `seconds_per_frame`.
    clock: Clock,
    /// Reference of the stages' errors.
    against: Yardstick,
    note: String,
}

#[derive(Serialize)]
struct Results {
    about: About,
    rows: Vec<grid::GridPoint>,
    stages: Vec<stages::StageError>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    standing: Vec<standing::StandingRow>,
}

impl Options {
    fn which(&self) -> Which<'_> {
        match (&self.model, self.size) {
            (Some(checkpoint), _) => Which::File { checkpoint, dinov2: self.dinov2.as_deref() },
            (None, Size::Small) => Which::Small,
            (None, Size::Paper) => Which::Paper,
        }
    }

    fn settings(&self) -> Settings {
        let model = match &self.model {
            None => ModelSource::Embedded,
            Some(checkpoint) => ModelSource::File { checkpoint: checkpoint.clone(), dinov2: self.dinov2.clone() },
        };
        Settings {
            level: Some(self.common.isa),
            threads: self.common.threads,
            fit: Fit::Stretch,
            ..Settings::with_model(model)
        }
    }

    fn model_name(&self) -> String {
        match (&self.model, self.size) {
            (Some(path), _) => path.file_stem().unwrap_or(path.as_os_str()).to_string_lossy().into_owned(),
            (None, Size::Small) => "the embedded model".to_owned(),
            (None, Size::Paper) => "paper's size, seeded weights".to_owned(),
        }
    }
}

pub(crate) fn run(options: &Options) -> Result<()> {
    let default = || PathBuf::from("fixtures/clips/moving.y4m");
    let input = options.input.clone().unwrap_or_else(default);
    if clips::is_folder_of_clips(&input) || options.record.is_some() {
        return clips::run(options, &input);
    }
    clips::check(options)?;
    let clip = read(&input, options.frames)?;
    ensure!(clip.len() >= 2, "{}: expected two frames or more, found {}", input.display(), clip.len());
    ensure!(options.rounds > 0, "--rounds: expected 1 or more, found 0");
    std::fs::create_dir_all(&options.out).with_context(|| format!("creating {}", options.out.display()))?;
    let pool = options.common.pool()?;
    let against = options.against;
    // The others are compared with f32.
    let precisions = once_each(Precision::F32, &options.precision);
    let paper = options.size == Size::Paper;
    let task = stages::StageRun {
        frames: &|size| match paper {
            true => standing::pair(&clip, size, options.common.isa),
            false => stages::fitted(&clip, size, options.common.isa),
        },
        which: options.which(),
        precisions: &precisions,
        level: options.common.isa,
        against,
        rounds: options.common.repeat,
    };
    let stages::Stages { resolution, rows: stages, expected } = pool.install(|| stages::measure(&task))?;
    let rows = match options.size {
        Size::Paper => Vec::new(),
        Size::Small => {
            let reuse = once_each(Reuse::Off, &options.reuse);
            let choices = grid::Choices { precisions: &precisions, reuse: &reuse, gaps: &options.gap };
            grid::measure(&choices, &clip, options.settings(), options.rounds, options.clock)?
        }
    };
    let standing = match options.size {
        Size::Small => Vec::new(),
        Size::Paper => {
            let tolerances = options.reuse.iter().filter_map(|reuse| match reuse {
                Reuse::Within(tolerance) => Some(*tolerance),
                Reuse::Off | Reuse::Exact => None,
            });
            let tolerances: Vec<f32> = tolerances.collect();
            let task = standing::StandingRun {
                which: options.which(),
                precisions: &precisions,
                level: options.common.isa,
                tolerances: &tolerances,
                rounds: options.rounds,
                expected: &expected,
            };
            pool.install(|| standing::measure(&task, &clip))?
        }
    };
    let about = About {
        model: options.model_name(),
        clip: input.file_name().unwrap_or(input.as_os_str()).to_string_lossy().into_owned(),
        frames: clip.len(),
        resolution,
        cpu: cpu(),
        isa: options.common.isa.name(),
        threads: pool.current_num_threads(),
        rounds: options.rounds,
        repeat: options.common.repeat.max(1),
        clock: options.clock,
        against,
        note: options.note.clone(),
    };
    let results = Results { about, rows, stages, standing };
    write(options, &results)
}

/// Writes all files.
fn write(options: &Options, results: &Results) -> Result<()> {
    let markdown = table::markdown(results);
    print!("{markdown}");
    let file = |name: &str, text: &str| {
        let path = options.out.join(name);
        std::fs::write(&path, text).with_context(|| format!("writing {}", path.display()))
    };
    file("tradeoff-stages.csv", &table::stages_csv(results))?;
    file("tradeoff-stages.svg", &plot::stages_svg(results)?)?;
    if !results.rows.is_empty() {
        file("tradeoff.csv", &table::csv(results))?;
        file("tradeoff.svg", &plot::svg(results)?)?;
    }
    file("tradeoff.md", &markdown)?;
    streamsplat_bench::write_json(&options.out.join("tradeoff.json"), results)?;
    options.common.write(results)
}
