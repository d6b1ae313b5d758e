//! `eval`: processes key frames, holds out the frames in between, and measures the PSNR of the scene and of simple
//! baselines.
//!
//! Every `gap`-th frame is a key frame, or those that `--gap auto` chooses. The scene is drawn at every frame's time
//! and compared with the true frame twice. The first comparison is at the source's own size, sample by sample in 8
//! bits, as in `run`. The second follows the protocol of the paper: drawn at `--size`, and both resized to 256×256
//! bilinearly.
//!
//! *Key* frames are inputs. *Middle* frames are inputs only with `--seen`. There are three baselines for the middle
//! frames: the cross-fade of the surrounding key frames, the nearer one, and the key frames blended along the optical
//! flow between them. Frames after the last whole interval are left out. The output also has the image's jump at key
//! frames, and its change from frame to frame.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use serde::Serialize;
use streamsplat::folder;
use streamsplat::gap::interpolation::Small;
use streamsplat::gap::{Gap, predicted};
use streamsplat::lpips::Lpips;
use streamsplat::picture::Picture;
use streamsplat::recognise::{self, Kind, Media};
use streamsplat::source::{self, Source};
use streamsplat::stream::{Interval, Reconstructor, Reuse, Settings};
use streamsplat::{Engine, Image, Size};

use crate::console::failure::Failure;
use crate::console::progress::Progress;
use crate::console::{Console, count, say};
use crate::options::args::EvalArgs;
use streamsplat::run::ahead::Ahead;
use streamsplat::run::closeness::{Closeness, psnr_of_samples};
use streamsplat::run::drawing::Drawing;
use streamsplat::run::keydepth::KeyDepth;
use streamsplat::run::keyframes::{Keep, KeyFrames};
use streamsplat::run::options::{DepthFrom, NamedMatrix, ViewOptions};
use streamsplat::run::record::NetworkRecord;
use streamsplat::run::views::Views;

mod baselines;
mod figures;

use baselines::{FlowBlend, Placed, mix};
use figures::{ClipFigures, Group, HEADING, IntervalFigures, MOVING, Sums, line};

/// Side of the pictures that are compared.
const SIDE: usize = 256;

#[derive(Serialize)]
struct Figures {
    fusion: String,
    fit: String,
    precision: String,
    renderer: &'static str,
    /// True if the middle frames were inputs of the engine, too.
    seen: bool,
    /// Requested quality; the other fields override its preset.
    #[serde(skip_serializing_if = "Option::is_none")]
    quality: Option<String>,
    motion: &'static str,
    fade: &'static str,
    refine: u32,
    resolution: String,
    /// Network that measured LPIPS.
    #[serde(skip_serializing_if = "Option::is_none")]
    lpips: Option<NetworkRecord>,
    clips: Vec<ClipFigures>,
    mean: ClipFigures,
}

/// Evaluates one clip or a folder of clips.
pub fn command(args: &EvalArgs, console: &Console) -> Result<(), Failure> {
    let stream = args.stream.resolved();
    let gap = stream.gap();
    if gap == Gap::Every(1) && args.stream.gap.is_none() {
        return Err(Failure::usage(
            "--gap: expected how many frames apart key frames are, as frames between them are measured; found none, and this model takes every \
             frame as one (--gap 1 measures key frames alone)",
        ));
    }
    let depth = stream.depth_from()?;
    let settings = stream.settings(args.fit, &args.machine)?;
    let of_size = |size| ViewOptions { size: Some(size), renderer: args.renderer, ..ViewOptions::default() }.resolve();
    let views = Sizes { compared: of_size(args.size)?, own: of_size(Size::Source)? };
    let clips = clips(&args.input, console)?;
    let mut lpips = args.lpips_model.as_deref().map(Lpips::open).transpose()?;
    if clips.len() > 1 && matches!(depth, DepthFrom::Folder(..)) {
        return Err(Failure::usage("--depth: one folder of maps cannot serve several clips"));
    }
    let mut total = Sums::default();
    let (mut rows, mut model) = (Vec::new(), None);
    if !console.quiet {
        say(HEADING)?;
    }
    let matrix = args.matrix.map(NamedMatrix::matrix);
    for clip in &clips {
        if console.stop.asked() {
            break;
        }
        let source = Source::open(clip, &source::Options { fps: args.fps, matrix })?;
        let depth = KeyDepth::open(&depth, &source, args.machine.level(), settings.reuse != Reuse::Off, None)?;
        let keys = KeyFrames::new(source, depth, gap, Keep::Everything, None, &console.stop);
        let sums = evaluate(keys, gap, &settings, &mut model, &views, args.seen, lpips.as_mut(), console)?;
        let name = clip.file_name().unwrap_or(clip.as_os_str()).to_string_lossy().into_owned();
        if sums.key.frames < 2 {
            let least = if let Gap::Every(n) = gap { n + 1 } else { 2 };
            let message = format!("{}: expected at least {least} frames for a gap of {gap}", clip.display());
            return Err(Failure::work(message));
        }
        total.join(&sums);
        let row = sums.row(Some(name), gap, settings.fusion);
        if !console.quiet {
            say(line(&row))?;
        }
        rows.push(row);
    }
    let mut mean = total.row(None, gap, settings.fusion);
    (mean.moving, mean.still) = (Some(Group::of(&rows, true)), Some(Group::of(&rows, false)));
    if !console.quiet {
        say(line(&mean))?;
        for (rule, group) in [("under", &mean.moving), ("of at least", &mean.still)] {
            if let Some(Group { clips: clips @ 1.., middle, over_crossfade, worst_over_crossfade }) = group {
                let [psnr, over, worst] =
                    [middle.psnr, *over_crossfade, *worst_over_crossfade].map(Option::unwrap_or_default);
                say(format!(
                    "{} with a cross-fade {rule} {MOVING} dB: middle {psnr:.2} dB at 256×256, {over:+.2} over the cross-fade, least {worst:+.2}",
                    count(*clips, "clip")
                ))?;
            }
        }
    }
    if let Some(path) = &args.json {
        let (fusion, precision) = (settings.fusion.to_string(), settings.precision().to_string());
        let (motion, fade, refine) = (settings.motion().name(), settings.fade().name(), settings.refine());
        let quality = stream.quality.map(|quality| quality.to_string());
        let (seen, resolution) = (args.seen, settings.resolution().to_string());
        let fit = args.fit.to_string();
        let measured = args.lpips_model.as_deref().zip(lpips.as_ref());
        let lpips = measured.map(|(file, lpips)| NetworkRecord::of(file, lpips.runtime_version())).transpose()?;
        let renderer = views.own.backend.name();
        let figures = Figures {
            fusion,
            fit,
            precision,
            renderer,
            seen,
            quality,
            motion,
            fade,
            refine,
            resolution,
            lpips,
            clips: rows,
            mean,
        };
        let text = serde_json::to_string_pretty(&figures).map_err(Failure::work)?;
        streamsplat::output::write_file(path, (text + "\n").as_bytes())?;
    }
    Ok(())
}

/// Returns the clip itself, or the videos and folders of images in a folder, in natural order, and notes other files.
fn clips(input: &Path, console: &Console) -> Result<Vec<PathBuf>, Failure> {
    if !input.is_dir() || folder::has_images(input) {
        return Ok(vec![input.to_owned()]);
    }
    let unreadable = |e: std::io::Error| Failure::work(format!("{}: {e}", input.display()));
    let (mut clips, mut others) = (Vec::new(), Vec::new());
    for entry in std::fs::read_dir(input).map_err(unreadable)? {
        let entry = entry.map_err(unreadable)?;
        let path = entry.path();
        let hidden = entry.file_name().as_encoded_bytes().starts_with(b".");
        let video = matches!(recognise::kind(&path), Some(Kind::Media(Media::Video, _)))
            || path.extension().is_some_and(|ending| ending == "y4m");
        if !hidden && (video || (path.is_dir() && folder::has_images(&path))) {
            clips.push(path);
        } else if !hidden {
            others.push(path);
        }
    }
    let name = |path: &PathBuf| path.file_name().map(|n| n.as_encoded_bytes().to_vec()).unwrap_or_default();
    clips.sort_by(|a, b| folder::natural::compare(&name(a), &name(b)));
    if clips.is_empty() {
        return Err(Failure::work(format!("{}: the folder holds neither images nor clips", input.display())));
    }
    if let Some(first) = others.iter().min() {
        let first = first.file_name().unwrap_or_default().to_string_lossy();
        console.note(&[format!(
            "{}: {} besides the clips, such as {first}",
            input.display(),
            count(others.len(), "name")
        )]);
    }
    Ok(clips)
}

/// Views of the source's own camera, at both sizes.
struct Sizes {
    /// For the images that are compared at 256×256.
    compared: Views,
    /// At the source's size.
    own: Views,
}

fn evaluate(
    mut keys: KeyFrames,
    gap: Gap,
    settings: &Settings,
    model: &mut Option<Arc<dyn Reconstructor>>,
    views: &Sizes,
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
    let mut drawing = Drawing::new(engine.workers(), views.own.backend)?;
    let mut shown = Vec::new();
    let mut closeness = gap.depends_on_images().then(|| Closeness::new(engine.workers())).transpose()?;
    keys.compare_at(Box::new(engine.content_size()), false);
    let mut keys = Ahead::new(keys, engine.workers().threads());
    let hidden = console.quiet || !std::io::IsTerminal::is_terminal(&std::io::stderr());
    let console = Console { quiet: hidden, ..console.clone() };
    let mut progress = Progress::new("frames", keys.total(), &console);
    let mut before: Option<(Picture, Placed)> = None;
    let mut last_small: Option<Small> = None;
    // The first key frame, if depth is estimated: the interval after it shows it, as in `run`.
    let mut first: Option<(Picture, Picture)> = None;
    while let Some(key) = keys.next_key()? {
        let Some(timestamp) = key.shown.last().map(|frame| frame.timestamp) else { continue };
        let truths: Vec<Picture> = key.shown.iter().map(|frame| frame.picture.resized(SIDE, SIDE)).collect();
        let last = truths.len() - 1;
        let picture = key.shown.last().map(|frame| frame.picture.clone());
        let between = if seen { key.between() } else { Vec::new() };
        let small: Vec<Small> =
            last_small.take().into_iter().chain(key.shown.iter().map(|f| Small::of(&f.picture))).collect();
        let start = Instant::now();
        let interval: Interval = engine.push_with(between, key.frame, timestamp)?;
        sums.seconds += start.elapsed().as_secs_f64();
        if interval.start < interval.end {
            let crossed = drawing.draw(&interval, 0, interval.start, &views.compared)?;
            if let Some((frame, truth)) = first.take() {
                let own = own_size(&mut drawing, &interval, interval.start, &views.own, &crossed, &frame)?;
                sums.key.add_source_size(own);
                sums.key.add(&compared(&crossed), &truth, lpips.as_deref_mut())?;
            } else {
                sums.pops.jump += apart(&shown, &crossed.rgb);
                sums.pops.jumps += 1;
            }
            shown = crossed.rgb;
        }
        let waits = interval.index == 0 && engine.finds_depth();
        if waits {
            first = picture.clone().zip(truths.last().cloned());
        }
        let own_sums = |sums: &Sums| [&sums.key, &sums.middle].map(|sum| sum.psnr_source_size.unwrap_or_default());
        let before_it = own_sums(&sums);
        for (i, (frame, truth)) in key.shown.iter().zip(&truths).enumerate().filter(|_| !waits) {
            let image = drawing.draw(&interval, 0, frame.timestamp, &views.compared)?;
            let own = own_size(&mut drawing, &interval, frame.timestamp, &views.own, &image, &frame.picture)?;
            if !shown.is_empty() {
                sums.pops.step += apart(&shown, &image.rgb);
                sums.pops.steps += 1;
            }
            shown.clone_from(&image.rgb);
            let sum = if i == last { &mut sums.key } else { &mut sums.middle };
            sum.add_source_size(own);
            sum.add(&compared(&image), truth, lpips.as_deref_mut())?;
        }
        let mean = |sum: f64| (last > 0).then(|| sum / last as f64);
        let after_it = own_sums(&sums);
        let (reached, between) = (after_it[0] - before_it[0], mean(after_it[1] - before_it[1]));
        if let Some(closeness) = &mut closeness
            && let Some(found) = closeness.of(&interval, &key.truths)?
        {
            keys.tell(&found, closeness);
        }
        if small.len() > truths.len() {
            let predicted = predicted(&small);
            sums.intervals.push(IntervalFigures {
                frames: truths.len(),
                key: reached,
                between,
                predicted: mean(predicted.iter().sum()),
                worst: predicted.into_iter().reduce(f64::min),
            });
        }
        last_small = small.into_iter().next_back();
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

/// Returns an image at the size of the comparison.
fn compared(image: &Image) -> Picture {
    Picture { width: image.width, height: image.height, rgb: image.rgb.clone() }.resized(SIDE, SIDE)
}

/// Returns the PSNR at the source's own size, in dB. `drawn` is the image of this time at the other size; it is used if
/// it has the frame's size.
fn own_size(
    drawing: &mut Drawing,
    interval: &Interval,
    time: f64,
    views: &Views,
    drawn: &Image,
    frame: &Picture,
) -> Result<Option<f64>, Failure> {
    let again;
    let Image { width, height, rgb, .. } = if (drawn.width, drawn.height) == (frame.width, frame.height) {
        drawn
    } else {
        again = drawing.draw(interval, 0, time, views)?;
        &again
    };
    let image = Picture { width: *width, height: *height, rgb: rgb.clone() };
    Ok(psnr_of_samples(&image.to_rgb8(), &frame.to_rgb8()))
}

/// Returns the mean absolute difference.
fn apart(a: &[f32], b: &[f32]) -> f64 {
    let sum: f64 = a.iter().zip(b).map(|(a, b)| f64::from((a - b).abs())).sum();
    sum / a.len().max(1) as f64
}
