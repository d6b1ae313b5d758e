//! `eval`: key frames in, the frames between held out; how close the scene comes to them, and simple baselines beside it.
//!
//! Every `gap`-th frame is a key frame, or what `--gap auto` chooses. The scene is drawn at every frame's time (at the model's own size unless told otherwise) and compared with the
//! true frame, both brought to 256×256 bilinearly. *Key* frames were given, *middle* frames were not. Baselines for the middle
//! frames: the cross-fade of the key frames around, and the nearer one. Frames after the last whole interval are left out.
//! Said beside it is how the image jumps at key frames, and how far it goes from frame to frame.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use serde::Serialize;
use streamsplat::Engine;
use streamsplat::fit::Placement;
use streamsplat::gap::Gap;
use streamsplat::lpips::Lpips;
use streamsplat::metrics::{psnr, ssim};
use streamsplat::picture::Picture;
use streamsplat::source::{self, Source, folder};
use streamsplat::stream::{Fusion, Interval, Reconstructor, Reuse, Settings, Workers};

use streamsplat_kernels::flow::{self, Field, Pyramid};

use super::ahead::Ahead;
use super::cli::{Console, EvalArgs, View};
use super::drawing::Drawing;
use super::failure::Failure;
use super::keydepth::KeyDepth;
use super::keyframes::{Keep, KeyFrames};
use super::progress::Progress;
use super::record::NetworkRecord;
use super::settings::{DepthFrom, Views};
use super::{say, stop};

/// Side of the pictures that are compared.
const SIDE: usize = 256;

/// Means over frames, and how many there were.
#[derive(Clone, Copy, Debug, Default, Serialize)]
struct Score {
    psnr: Option<f64>,
    ssim: Option<f64>,
    /// With `--lpips-model`.
    #[serde(skip_serializing_if = "Option::is_none")]
    lpips: Option<f64>,
    frames: usize,
}

#[derive(Clone, Debug, Default)]
struct Sum {
    psnr: f64,
    ssim: f64,
    lpips: Option<f64>,
    frames: usize,
}

impl Sum {
    fn add(&mut self, a: &Picture, b: &Picture, lpips: Option<&mut Lpips>) -> Result<(), Failure> {
        self.psnr += psnr(a, b)?;
        self.ssim += ssim(a, b)?;
        if let Some(lpips) = lpips {
            *self.lpips.get_or_insert(0.0) += lpips.distance(a, b)?;
        }
        self.frames += 1;
        Ok(())
    }

    fn join(&mut self, other: &Sum) {
        self.psnr += other.psnr;
        self.ssim += other.ssim;
        if let Some(lpips) = other.lpips {
            *self.lpips.get_or_insert(0.0) += lpips;
        }
        self.frames += other.frames;
    }

    fn score(&self) -> Score {
        let mean = |sum: f64| (self.frames > 0).then(|| sum / self.frames as f64);
        Score { psnr: mean(self.psnr), ssim: mean(self.ssim), lpips: self.lpips.and_then(mean), frames: self.frames }
    }
}

/// How far images lie apart, as mean absolute differences of colour.
#[derive(Clone, Debug, Default)]
struct Pops {
    /// At key frames, seen from the interval before and from the one after.
    jump: f64,
    jumps: usize,
    /// From one frame to the next inside an interval.
    step: f64,
    steps: usize,
}

impl Pops {
    fn join(&mut self, other: &Pops) {
        self.jump += other.jump;
        self.jumps += other.jumps;
        self.step += other.step;
        self.steps += other.steps;
    }

    fn pop(&self) -> Pop {
        let mean = |sum: f64, count: usize| (count > 0).then(|| sum / count as f64);
        let (jump, step) = (mean(self.jump, self.jumps), mean(self.step, self.steps));
        let ratio = jump.zip(step).filter(|(_, step)| *step > 0.0).map(|(jump, step)| jump / step);
        Pop { jump, step, ratio }
    }
}

/// What a key frame does to the image, beside what a frame's time does.
#[derive(Clone, Copy, Debug, Serialize)]
struct Pop {
    /// Mean absolute difference of the images at a key frame seen from the intervals before and after.
    jump: Option<f64>,
    /// That of neighbouring frames inside an interval.
    step: Option<f64>,
    /// jump / step; 0 where nothing pops.
    ratio: Option<f64>,
}

#[derive(Clone, Debug, Default)]
struct Sums {
    key: Sum,
    middle: Sum,
    pops: Pops,
    crossfade: Sum,
    nearest: Sum,
    flow: Sum,
    /// In the engine.
    seconds: f64,
    clips: usize,
}

/// What one fusion mode gives.
#[derive(Serialize)]
struct Mode {
    key: Score,
    middle: Score,
    pop: Pop,
}

#[derive(Serialize)]
struct Baselines {
    crossfade: Score,
    nearest: Score,
    /// The key frames blended along the optical flow between them.
    flow: Score,
}

/// Input frames from key frame to key frame.
#[derive(Clone, Copy, Serialize)]
#[serde(untagged)]
enum Spacing {
    Every(usize),
    /// On average, where they were chosen.
    Mean(f64),
}

/// One clip's figures, or the mean's.
#[derive(Serialize)]
struct Row {
    #[serde(skip_serializing_if = "Option::is_none")]
    name: Option<String>,
    gap: Spacing,
    key: Score,
    middle: Score,
    /// Time in the engine per input frame, drawing and comparison apart.
    seconds_per_frame: f64,
    baselines: Baselines,
    /// The same under the fusion mode's name, with how the image jumps at key frames.
    fusion: BTreeMap<&'static str, Mode>,
    /// Means over the clips whose cross-fade is under [`MOVING`] dB; of the mean alone.
    #[serde(skip_serializing_if = "Option::is_none")]
    moving: Option<Group>,
    /// Means over the other clips.
    #[serde(skip_serializing_if = "Option::is_none")]
    still: Option<Group>,
}

/// Means over some clips, each of which counts once.
#[derive(Debug, Serialize)]
struct Group {
    clips: usize,
    middle: GroupScore,
    /// Decibels by which middle frames are better than the cross-fade.
    over_crossfade: Option<f64>,
    /// The least of them.
    worst_over_crossfade: Option<f64>,
}

#[derive(Debug, Serialize)]
struct GroupScore {
    psnr: Option<f64>,
}

/// Cross-fade of clips that are called still, in dB, at least.
const MOVING: f64 = 26.0;

impl Group {
    /// The moving or the still ones of `clips`.
    fn of(clips: &[Row], moving: bool) -> Group {
        let figures = clips.iter().filter_map(|row| row.middle.psnr.zip(row.baselines.crossfade.psnr));
        let figures: Vec<_> = figures.filter(|(_, fade)| (*fade < MOVING) == moving).collect();
        let mean = |sum: f64| (!figures.is_empty()).then(|| sum / figures.len() as f64);
        let over = figures.iter().map(|(ours, fade)| ours - fade);
        Group {
            clips: figures.len(),
            middle: GroupScore { psnr: mean(figures.iter().map(|(ours, _)| ours).sum()) },
            over_crossfade: mean(over.clone().sum()),
            worst_over_crossfade: over.min_by(f64::total_cmp),
        }
    }
}

#[derive(Serialize)]
struct Figures {
    fusion: String,
    fit: String,
    precision: String,
    renderer: &'static str,
    /// Whether the middle frames were given, too.
    seen: bool,
    motion: &'static str,
    refine: u32,
    resolution: String,
    /// What LPIPS was measured with.
    #[serde(skip_serializing_if = "Option::is_none")]
    lpips: Option<NetworkRecord>,
    clips: Vec<Row>,
    mean: Row,
}

impl Sums {
    /// The gap, or the mean of those that were chosen.
    fn spacing(&self, gap: Gap) -> Spacing {
        match gap {
            Gap::Every(n) => Spacing::Every(n),
            Gap::Auto(_) => {
                let (keys, middles) = (self.key.frames, self.middle.frames);
                // The first key frame of a clip ends no gap.
                let ended = keys.saturating_sub(self.clips);
                Spacing::Mean((ended + middles) as f64 / ended.max(1) as f64)
            }
        }
    }

    fn row(&self, name: Option<String>, gap: Gap, chosen: Fusion) -> Row {
        let baselines =
            Baselines { crossfade: self.crossfade.score(), nearest: self.nearest.score(), flow: self.flow.score() };
        let (key, middle) = (self.key.score(), self.middle.score());
        let fusion = BTreeMap::from([(chosen.name(), Mode { key, middle, pop: self.pops.pop() })]);
        let seconds_per_frame = self.seconds / (self.key.frames + self.middle.frames).max(1) as f64;
        let gap = self.spacing(gap);
        Row { name, gap, key, middle, seconds_per_frame, baselines, fusion, moving: None, still: None }
    }

    fn join(&mut self, other: &Sums) {
        self.clips += other.clips;
        self.key.join(&other.key);
        self.middle.join(&other.middle);
        self.crossfade.join(&other.crossfade);
        self.nearest.join(&other.nearest);
        self.flow.join(&other.flow);
        self.seconds += other.seconds;
        self.pops.join(&other.pops);
    }
}

/// Evaluates one clip or a folder of clips.
pub fn command(args: &EvalArgs, console: &Console) -> Result<(), Failure> {
    let gap = args.stream.gap()?;
    let depth = args.stream.depth_from()?;
    let settings = args.stream.settings(&args.fit, &args.machine)?;
    let views =
        View { size: args.size.clone(), background: "0.5".into(), renderer: args.renderer.clone(), ..View::default() }
            .resolve()?;
    let clips = clips(&args.input)?;
    let mut lpips = args.lpips_model.as_deref().map(Lpips::open).transpose()?;
    if clips.len() > 1 && matches!(depth, DepthFrom::Folder(..)) {
        return Err(Failure::usage("--depth: one folder of maps cannot serve several clips"));
    }
    let mut total = Sums::default();
    let (mut rows, mut model) = (Vec::new(), None);
    if !console.quiet {
        say(
            "clip                          key dB / SSIM   middle dB / SSIM   cross-fade         nearest           flow",
        );
    }
    for clip in &clips {
        if stop::asked() {
            break;
        }
        let source = Source::open(clip, &source::Options { fps: args.fps })?;
        let depth = KeyDepth::open(&depth, &source, args.machine.level()?, settings.reuse != Reuse::Off)?;
        let keys = KeyFrames::new(source, depth, gap, Keep::Everything, None);
        let sums = evaluate(keys, &settings, &mut model, &views, args.seen, lpips.as_mut(), console)?;
        let name = clip.file_name().unwrap_or(clip.as_os_str()).to_string_lossy().into_owned();
        if sums.key.frames < 2 {
            let least = if let Gap::Every(n) = gap { n + 1 } else { 2 };
            let message = format!("{}: expected at least {least} frames for a gap of {gap}", clip.display());
            return Err(Failure::work(message));
        }
        total.join(&sums);
        let row = sums.row(Some(name), gap, settings.fusion);
        if !console.quiet {
            say(line(&row));
        }
        rows.push(row);
    }
    let mut mean = total.row(None, gap, settings.fusion);
    (mean.moving, mean.still) = (Some(Group::of(&rows, true)), Some(Group::of(&rows, false)));
    if !console.quiet {
        say(line(&mean));
        for (name, group) in [("moving", &mean.moving), ("still", &mean.still)] {
            if let Some(Group { clips: clips @ 1.., middle, over_crossfade, worst_over_crossfade }) = group {
                let [psnr, over, worst] =
                    [middle.psnr, *over_crossfade, *worst_over_crossfade].map(Option::unwrap_or_default);
                say(format!(
                    "{name} clips ({clips}): middle {psnr:.2} dB, {over:+.2} over the cross-fade, least {worst:+.2}"
                ));
            }
        }
    }
    if let Some(path) = &args.json {
        let (fusion, precision) = (settings.fusion.to_string(), settings.precision.to_string());
        let (motion, refine) = (settings.motion().name(), settings.refine());
        let (seen, resolution) = (args.seen, settings.resolution().to_string());
        let fit = args.fit.clone();
        let measured = args.lpips_model.as_deref().zip(lpips.as_ref());
        let lpips = measured.map(|(file, lpips)| NetworkRecord::of(file, lpips.runtime_version())).transpose()?;
        let renderer = views.backend.name();
        let figures =
            Figures { fusion, fit, precision, renderer, seen, motion, refine, resolution, lpips, clips: rows, mean };
        let text = serde_json::to_string_pretty(&figures).map_err(Failure::work)?;
        streamsplat::output::write_file(path, (text + "\n").as_bytes())?;
    }
    Ok(())
}

/// The clip itself, or the clips of a folder of folders, in natural order.
fn clips(input: &Path) -> Result<Vec<PathBuf>, Failure> {
    if !input.is_dir() || folder::images(input).is_ok() {
        return Ok(vec![input.to_owned()]);
    }
    let unreadable = |e: std::io::Error| Failure::work(format!("{}: {e}", input.display()));
    let mut clips = Vec::new();
    for entry in std::fs::read_dir(input).map_err(unreadable)? {
        let entry = entry.map_err(unreadable)?;
        let path = entry.path();
        let hidden = entry.file_name().as_encoded_bytes().starts_with(b".");
        let video = path.extension().is_some_and(|e| e == "y4m");
        if !hidden && (video || (path.is_dir() && folder::images(&path).is_ok())) {
            clips.push(path);
        }
    }
    let name = |path: &PathBuf| path.file_name().map(|n| n.as_encoded_bytes().to_vec()).unwrap_or_default();
    clips.sort_by(|a, b| source::natural::compare(&name(a), &name(b)));
    if clips.is_empty() {
        return Err(Failure::work(format!("{}: the folder holds neither images nor clips", input.display())));
    }
    Ok(clips)
}

fn evaluate(
    keys: KeyFrames,
    settings: &Settings,
    model: &mut Option<Arc<dyn Reconstructor>>,
    views: &Views,
    seen: bool,
    mut lpips: Option<&mut Lpips>,
    console: &Console,
) -> Result<Sums, Failure> {
    let mut sums = Sums { clips: 1, ..Sums::default() };
    let mut engine = match model {
        Some(model) => Engine::with_model(settings.clone(), model.clone())?,
        None => Engine::new(settings.clone())?,
    };
    // Loaded once for all clips.
    *model = Some(engine.model().clone());
    let mut drawing = Drawing::new(engine.workers(), views.backend)?;
    let mut shown = Vec::new();
    let mut keys = Ahead::new(keys, engine.workers().threads());
    let hidden = console.quiet || !std::io::IsTerminal::is_terminal(&std::io::stderr());
    let mut progress = Progress::new("frames", keys.total(), hidden);
    let mut before: Option<(Picture, Placed)> = None;
    while let Some(key) = keys.next()? {
        let Some(timestamp) = key.shown.last().map(|frame| frame.timestamp) else { continue };
        let truths: Vec<Picture> = key.shown.iter().map(|frame| frame.picture.resized(SIDE, SIDE)).collect();
        let last = truths.len() - 1;
        let picture = key.shown.last().map(|frame| frame.picture.clone());
        let between = if seen { key.between() } else { Vec::new() };
        let start = Instant::now();
        let interval: Interval = engine.push_with(between, key.frame, timestamp)?;
        sums.seconds += start.elapsed().as_secs_f64();
        if interval.start < interval.end {
            let crossed = drawing.draw(&interval, interval.start, views)?.rgb;
            sums.pops.jump += apart(&shown, &crossed);
            sums.pops.jumps += 1;
            shown = crossed;
        }
        for (i, (frame, truth)) in key.shown.iter().zip(&truths).enumerate() {
            let image = drawing.draw(&interval, frame.timestamp, views)?;
            if !shown.is_empty() {
                sums.pops.step += apart(&shown, &image.rgb);
                sums.pops.steps += 1;
            }
            shown.clone_from(&image.rgb);
            let ours = Picture { width: image.width, height: image.height, rgb: image.rgb }.resized(SIDE, SIDE);
            let sum = if i == last { &mut sums.key } else { &mut sums.middle };
            sum.add(&ours, truth, lpips.as_deref_mut())?;
        }
        let Some(picture) = picture else { continue };
        let placed = Placed::new(&picture, interval.placement, engine.workers());
        if let Some((_, earlier)) = &before
            && last > 0
        {
            let flow = FlowBlend::new(engine.workers(), earlier, &placed)?;
            for (i, truth) in truths[..last].iter().enumerate() {
                let blend = flow.at((i + 1) as f32 / truths.len() as f32);
                sums.flow.add(&blend.resized(SIDE, SIDE), truth, lpips.as_deref_mut())?;
            }
        }
        if let Some((before, _)) = &before {
            for (i, truth) in truths[..last].iter().enumerate() {
                let t = (i + 1) as f32 / truths.len() as f32;
                sums.crossfade.add(&mix(before, &truths[last], t), truth, lpips.as_deref_mut())?;
                sums.nearest.add(if t <= 0.5 { before } else { &truths[last] }, truth, lpips.as_deref_mut())?;
            }
        }
        truths.iter().for_each(|_| progress.step());
        before = truths.into_iter().next_back().map(|truth| (truth, placed));
    }
    Ok(sums)
}

/// The mean absolute difference.
fn apart(a: &[f32], b: &[f32]) -> f64 {
    let sum: f64 = a.iter().zip(b).map(|(a, b)| f64::from((a - b).abs())).sum();
    sum / a.len().max(1) as f64
}

/// A key frame's planes at the model's size.
struct Placed {
    rgb: Vec<f32>,
    placement: Placement,
}

/// The key frames of an interval, to be blended along the flow between them.
struct FlowBlend<'a> {
    workers: &'a Workers,
    frames: [&'a Placed; 2],
    fields: [Field; 2],
}

impl Placed {
    fn new(picture: &Picture, placement: Placement, workers: &Workers) -> Placed {
        Placed { rgb: workers.install(|| placement.fit_in(workers.level(), &picture.rgb)), placement }
    }
}

impl<'a> FlowBlend<'a> {
    fn new(workers: &'a Workers, a: &'a Placed, b: &'a Placed) -> Result<Self, Failure> {
        let (level, size, options) = (workers.level(), a.placement.model, flow::Options::default());
        workers.install(|| {
            let pyramid = |frame: &Placed| Pyramid::new(level, &flow::luma(level, &frame.rgb), size, &options);
            let [one, other] = [pyramid(a).map_err(Failure::work)?, pyramid(b).map_err(Failure::work)?];
            let fields = [
                flow::between(level, &one, &other, None, &options),
                flow::between(level, &other, &one, None, &options),
            ];
            Ok(Self { workers, frames: [a, b], fields })
        })
    }

    /// The picture at `t` in [0, 1].
    fn at(&self, t: f32) -> Picture {
        let ([a, b], [there, back]) = (self.frames, &self.fields);
        let blend = || flow::Blend::new(self.workers.level(), [&a.rgb, &b.rgb], [there, back]).at(t);
        let [height, width] = a.placement.content;
        Picture { width, height, rgb: a.placement.crop(&self.workers.install(blend)) }
    }
}

fn mix(a: &Picture, b: &Picture, t: f32) -> Picture {
    let rgb = a.rgb.iter().zip(&b.rgb).map(|(&a, &b)| a * (1.0 - t) + b * t).collect();
    Picture { rgb, ..*a }
}

fn line(row: &Row) -> String {
    let show = |score: &Score| match (score.psnr, score.ssim) {
        (Some(psnr), Some(ssim)) => {
            let lpips = score.lpips.map(|lpips| format!(" / {lpips:.4}")).unwrap_or_default();
            format!("{psnr:7.3} / {ssim:.4}{lpips}")
        }
        _ => "      – /      –".to_owned(),
    };
    format!(
        "{:28} {}   {}   {}   {}   {}",
        row.name.as_deref().unwrap_or("mean over frames"),
        show(&row.key),
        show(&row.middle),
        show(&row.baselines.crossfade),
        show(&row.baselines.nearest),
        show(&row.baselines.flow)
    )
}
