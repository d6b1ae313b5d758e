//! `enlarging`: images of the source's size compared with the enlarged model-size image, on a set of clips.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use clap::Args;
use serde::Serialize;
use streamsplat::picture::Picture;
use streamsplat::stream::{Interval, Resolution};
use streamsplat::{Engine, Frame, Settings, source};
use streamsplat_bench::Common;
use streamsplat_bench::table::{Column, Table};
use streamsplat_tests::enlarging::{Enlarging, enlarging};

/// Options of `enlarging`.
#[derive(Args)]
pub(crate) struct Options {
    #[command(flatten)]
    common: Common,
    /// Clips: folders of images or videos.
    #[arg(required = true)]
    inputs: Vec<PathBuf>,
    /// Heights and widths of the model's input.
    #[arg(long, value_delimiter = ',', default_value = "192x344,144x256,96x168")]
    resolutions: Vec<Resolution>,
    /// Input frames of each clip.
    #[arg(long, default_value_t = 9)]
    frames: usize,
    /// Frames from one key frame to the next.
    #[arg(long, default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=64))]
    gap: u32,
}

const TABLE: Table<'_> = Table(&[
    Column::Text("clip", 24),
    Column::Text("model", 8),
    Column::Number("drawn, dB", 0),
    Column::Number("enlarged, dB", 0),
    Column::Number("difference", 0),
]);

/// Mean PSNR over the frames of a clip.
#[derive(Serialize)]
struct Row {
    clip: String,
    model: [usize; 2],
    drawn: f64,
    enlarged: f64,
}

pub(crate) fn run(options: &Options) -> Result<()> {
    println!("{}", TABLE.heads());
    let mut rows = Vec::new();
    for path in &options.inputs {
        for &resolution in &options.resolutions {
            let row = clip(options, path, resolution).with_context(|| path.display().to_string())?;
            let [height, width] = row.model;
            let difference = row.drawn - row.enlarged;
            let numbers = [format!("{:.2}", row.drawn), format!("{:.2}", row.enlarged), format!("{difference:+.2}")];
            println!("{}", TABLE.line(&[&[row.clip.clone(), format!("{height}x{width}")], &numbers[..]].concat()));
            rows.push(row);
        }
    }
    options.common.write(&rows)
}

fn clip(options: &Options, path: &Path, resolution: Resolution) -> Result<Row> {
    let Common { isa, threads, .. } = options.common;
    let settings = Settings { level: Some(isa), threads, resolution: Some(resolution), ..Settings::default() };
    let mut engine = Engine::new(settings)?;
    let mut source = source::Source::open(path, &source::Options::default())?;
    let mut waiting: Vec<(Picture, f64)> = Vec::new();
    let (mut model, mut found) = ([0; 2], Vec::new());
    let gap = options.gap as usize;
    for index in 0..options.frames {
        let Some(next) = source.next_frame()? else { break };
        waiting.push((next.picture, next.timestamp));
        if index % gap > 0 {
            continue;
        }
        // The first key frame is scored in the interval that ends with the second, and was pushed before.
        let new = waiting.iter().skip(usize::from(index == gap));
        let mut frames: Vec<(Frame, f64)> = new.map(|(picture, time)| (frame(picture), *time)).collect();
        let (last, time) = frames.pop().context("no frame")?;
        let interval = engine.push_with(frames, last, time)?;
        model = interval.placement.model;
        if index > 0 {
            found.extend(scores(&interval, &std::mem::take(&mut waiting))?);
        }
    }
    ensure!(!found.is_empty(), "expected more than {gap} frames, found fewer");
    let mean = |of: fn(&Enlarging) -> f64| found.iter().map(of).sum::<f64>() / found.len() as f64;
    let clip = path.file_stem().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
    Ok(Row { clip, model, drawn: mean(|found| found.drawn), enlarged: mean(|found| found.enlarged) })
}

fn frame(picture: &Picture) -> Frame {
    Frame { width: picture.width, height: picture.height, rgb: picture.rgb.clone(), depth: None }
}

fn scores(interval: &Interval, frames: &[(Picture, f64)]) -> Result<Vec<Enlarging>> {
    frames.iter().map(|(picture, time)| Ok(enlarging(interval, *time, picture)?)).collect()
}
