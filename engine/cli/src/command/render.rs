//! `render`: draws a scene to images at chosen times and cameras.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::time::{Duration, Instant};

use streamsplat::open::Opened;
use streamsplat::output::{Pace, WEBP_SIDE, folder_of, storage, write_file};
use streamsplat::run::options::{Fill, Machine};
use streamsplat::scene::Scene;
use streamsplat::stream::{Interval, Workers};
use streamsplat::{Image, Size, run};

use crate::command::still;
use crate::console::failure::Failure;
use crate::console::opening::open_along;
use crate::console::progress::Progress;
use crate::console::{Console, say, stop, version};
use crate::options::antialias::Antialias;
use crate::options::args::{RenderArgs, RenderOptions};
use crate::options::times;
use streamsplat::run::drawing::Drawing;
use streamsplat::run::options::motion::Course;
use streamsplat::run::outputs::{Destination, Emit, Finished, Outputs};
use streamsplat::run::place::Place;
use streamsplat::run::record::{
    Build, InputRecord, Invocation, OutputRecord, PROGRAM, Record, Timing, absolute, check_name,
};
use streamsplat::run::views::Views;
use streamsplat::run::{crop, digest, report};

/// Renders, then writes the record and the report.
pub fn command(args: &RenderArgs, console: &Console) -> Result<(), Failure> {
    console.listen();
    for path in [&args.out, &args.scene].into_iter().chain(&args.options.view.camera) {
        check_name(path)?;
    }
    match Single::of(&args.out) {
        // For several images, a WebP file is a video.
        Some(Single::WebP) if several(args, console)? => {}
        Some(kind) => return single(args, kind, console),
        None => {}
    }
    // Held until everything is written.
    let mut place = Place::new(Destination::asked(&args.out)?);
    let mut options = args.options.clone();
    options.view.size.get_or_insert(Size::Model);
    let record = render(&args.scene, &mut place, &options, &args.machine, console)?;
    report::finish(&record, Some(place.destination()), args.json.as_deref())?;
    if !console.quiet && args.out != Path::new("-") {
        say(report::summary(&record, &args.out))?;
    }
    if record.complete { Ok(()) } else { Err(stop::stopped(false)) }
}

/// Default size of a panorama.
const PANORAMA: [usize; 2] = [2048, 1024];

/// The kinds of single-image files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Single {
    Png,
    Exr,
    WebP,
}

impl Single {
    fn of(out: &Path) -> Option<Single> {
        let ending = out.extension().and_then(|ending| ending.to_str())?.to_ascii_lowercase();
        match ending.as_str() {
            _ if out.is_dir() => None,
            "png" => Some(Single::Png),
            "exr" => Some(Single::Exr),
            "webp" => Some(Single::WebP),
            _ => None,
        }
    }
}

/// Returns true if there is more than one image to render.
fn several(args: &RenderArgs, console: &Console) -> Result<bool, Failure> {
    let options = &args.options;
    let mut views = options.views()?;
    times::check_rate(options.fps)?;
    let workers = args.machine.workers()?;
    // Quiet, because the scene is opened again for drawing, which prints the notes.
    let quiet = Console { quiet: true, ..console.clone() };
    let axes = options.reading.axes()?;
    Ok(match open_along(&args.scene, &options.limit.limits(), axes, Some(&workers), &quiet)? {
        Opened::Moving(scene) => {
            let fps = options.fps.unwrap_or(scene.index().fps);
            options.due(&scene, &mut views, fps)?.len() != 1
        }
        Opened::Still(file) => still::Plan::new(&file, options, &views)?.count() != 1,
    })
}

/// Renders one image into a temporary folder and renames it to the requested name.
fn single(args: &RenderArgs, kind: Single, console: &Console) -> Result<(), Failure> {
    let (name, emit) = match kind {
        Single::Png => ("frames/000000.png", Emit { rgb: true, ..Emit::default() }),
        Single::Exr => ("exr/000000.exr", Emit { exr: true, ..Emit::default() }),
        Single::WebP => ("frames/000000.webp", Emit { webp: true, ..Emit::default() }),
    };
    let mut options = args.options.clone();
    if let Some(list) = options.emit.replace(emit)
        && list != emit
    {
        return Err(Failure::usage(format!("--emit {list}: expected {emit} or nothing, as --out is a single file")));
    }
    Destination::of(&args.out).check_crf(options.crf)?;
    options.single = true;
    let unwritable = |e| Failure::work(format!("{}: cannot write: {e}", args.out.display()));
    let scratch =
        tempfile::Builder::new().prefix(".streamsplat-").tempdir_in(folder_of(&args.out)).map_err(unwritable)?;
    let mut place = Place::new(Destination::of(&scratch.path().join("out")));
    let record = render(&args.scene, &mut place, &options, &args.machine, console)?;
    if !record.complete {
        return Err(stop::stopped(false));
    }
    storage::rename(&place.destination().path().join(name), &args.out).map_err(unwritable)?;
    storage::sync_folder(folder_of(&args.out)).map_err(unwritable)?;
    if let Some(path) = &args.json {
        write_file(path, record.to_json()?.as_bytes())?;
    }
    if console.quiet { Ok(()) } else { say(report::summary(&record, &args.out)) }
}

impl RenderOptions {
    /// Returns the views of the images, with all their options.
    pub(super) fn views(&self) -> Result<Views, Failure> {
        let mut views = self.view.resolve()?;
        if self.optics.panorama && views.options.size == Size::Model {
            let [width, height] = PANORAMA;
            views.options.size = Size::Exact { width, height };
        }
        // With `Antialias::Auto`, a mark in a still scene turns it on later.
        views.options.antialias = self.antialias == Antialias::On;
        self.optics.apply(&mut views)?;
        Ok(views)
    }

    /// Returns the times of a scene's images, each with the interval that shows it. Sets the camera's motion in
    /// `views`.
    pub(super) fn due(&self, scene: &Scene, views: &mut Views, fps: f64) -> Result<Vec<(f64, usize)>, Failure> {
        views.camera = self.optics.around(std::mem::take(&mut views.camera))?;
        self.optics.needs_focus()?;
        let mut due = times::of_scene(scene, views.times.as_deref(), self.fps)?;
        self.motion.along(views, &mut due, |(time, _)| time, fps)?;
        Ok(due)
    }

    /// Returns an error for more than one image with a single output file.
    pub(super) fn check_single(&self, images: usize) -> Result<(), Failure> {
        if self.single && images != 1 {
            let way = if self.motion.moves() {
                "the camera moves from image to image"
            } else {
                "give --times one time, or --view"
            };
            return Err(Failure::usage(format!(
                "--out: expected a folder or a video for {images} images, found a single file: {way}"
            )));
        }
        Ok(())
    }
}

/// Renders everything except the record's files.
pub fn render(
    path: &Path,
    place: &mut Place,
    options: &RenderOptions,
    machine: &Machine,
    console: &Console,
) -> Result<Record, Failure> {
    let start = Instant::now();
    let mut views = options.views()?;
    let emit = options.emit.unwrap_or(Emit { rgb: true, ..Emit::default() });
    emit.check(|kind| kind.drawn)?;
    [views.options.depth, views.options.alpha] = emit.planes();
    views.options.alpha |= views.transparent;
    if let Size::Exact { width, height } = views.options.size
        && emit.webp
        && width.max(height) > WEBP_SIDE
    {
        return Err(Failure::usage(format!("--size {width}x{height}: expected at most {WEBP_SIDE} a side for WebP")));
    }
    times::check_rate(options.fps)?;
    place.destination().check_crf(options.crf)?;
    run::refuse_run(place.destination())?;
    let workers = machine.workers()?;
    let scene = match open_along(path, &options.limit.limits(), options.reading.axes()?, Some(&workers), console)? {
        Opened::Moving(scene) => scene,
        Opened::Still(file) => {
            let options = still::seen_as_exported(options, path, &mut views, console)?;
            return still::render(file, place, &options, &views, emit, &workers, console, start);
        }
    };
    let fps = options.fps.unwrap_or(scene.index().fps);
    // The source's own frames; images at other times, or at one time, follow each other at a rate.
    let own = options.fps.is_none() && views.times.is_none();
    let due = options.due(&scene, &mut views, fps)?;
    options.check_single(due.len())?;
    crop(&scene, &due, &mut views, fps, &workers)?;
    let mut drawing = Drawing::new(&workers, views.backend)?;
    let mut outputs = Outputs::create(place, emit)?;
    outputs.drawn_by(views.backend);
    outputs.keep_alpha(views.transparent)?;
    let own = own && !matches!(views.course, Some(Course::Held(_)));
    outputs.quality(options.crf);
    let pace = Pace { fps, uneven: own && scene.index().is_uneven() };
    console.note(place.destination().without_times(pace).as_slice());
    outputs.start(fps, pace)?;

    let mut progress = Progress::new("images", Some(due.len()), console);
    let mut stretch = Stretch::of(&scene);
    let mut complete = true;
    drawing.pass(
        due.iter().enumerate(),
        |drawing, (index, &(time, place))| {
            if console.stop.asked() {
                complete = false;
                return Ok(None);
            }
            Ok(Some((index, time, stretch.image(drawing, index, (time, place), &views, fps)?)))
        },
        |(index, time, image)| {
            outputs.image(index, if own { time } else { index as f64 / fps }, image)?;
            progress.step();
            Ok(())
        },
    )?;
    progress.phase("images; finishing the files");
    let Finished { outputs, notes } = drawing.writing(|| outputs.finish())?;
    progress.finish();
    console.note(&notes);
    console.note(views.squeezed(Some(scene.placement().source)).as_slice());
    console.note(drawing.counts.unfilmed.note(views.fill != Fill::None).as_slice());

    let [height, width] = scene.placement().source;
    let input = InputRecord {
        path: absolute(path),
        blake3: digest::scene_index(&scene)?,
        count: stretch.seen.len(),
        size: [width, height],
        fps: scene.index().fps,
        damage: None,
    };
    record(options, input, &drawing, Rendered { outputs, complete, read: stretch.read, start }, &workers)
}

/// With `--fill crop`, sets the part of the sides that all images of a motion can show without the picture's edges.
pub(super) fn crop(
    scene: &Scene,
    due: &[(f64, usize)],
    views: &mut Views,
    fps: f64,
    workers: &Workers,
) -> Result<(), run::Error> {
    if views.fill != Fill::Crop {
        return Ok(());
    }
    let [height, width] = scene.placement().content;
    let rows = (height * crop::COLUMNS).div_ceil(width.max(1)).max(1);
    let size = Size::Exact { width: crop::COLUMNS, height: rows };
    let options = streamsplat::RenderOptions { size, alpha: true, ..views.options };
    let small = Views { options, fill: Fill::None, eyes: None, shutter: None, ..views.clone() };
    let mut drawing = Drawing::new(workers, small.backend)?;
    let mut stretch = Stretch::of(scene);
    let step = due.len().div_ceil(crop::IMAGES).max(1);
    let last = due.len().saturating_sub(1);
    let mut part = 1.0_f64;
    for (index, &at) in due.iter().enumerate().filter(|(index, _)| index % step == 0 || *index == last) {
        part = part.min(crop::shown_part(&stretch.image(&mut drawing, index, at, &small, fps)?));
    }
    views.part = part;
    Ok(())
}

/// The interval of a scene that is being drawn.
pub(super) struct Stretch<'a> {
    scene: &'a Scene,
    current: Option<(usize, Interval)>,
    /// Time spent reading.
    read: Duration,
    /// Indices of the intervals that were read.
    seen: BTreeSet<usize>,
}

impl<'a> Stretch<'a> {
    /// Starts without any interval of `scene`.
    pub(super) fn of(scene: &'a Scene) -> Self {
        Stretch { scene, current: None, read: Duration::ZERO, seen: BTreeSet::new() }
    }

    /// Draws the image with the number `index`, at a time that the interval at `place` shows, at `fps` images a second.
    pub(super) fn image(
        &mut self,
        drawing: &mut Drawing,
        index: usize,
        (time, place): (f64, usize),
        views: &Views,
        fps: f64,
    ) -> Result<Image, run::Error> {
        if views.shutter.is_some() && (views.course.is_some() || views.eyes.is_some()) {
            drawing.anchored(self.at(place)?, time)?;
        }
        drawing.exposed(views, |drawing, part| {
            if part == 0.0 {
                return drawing.draw(self.at(place)?, index, time, views);
            }
            if matches!(views.course, Some(Course::Held(_))) {
                return drawing.draw_at(self.at(place)?, index as f64 + part, time, views);
            }
            let (first, last) = self.scene.span();
            let time = (time + part / fps).clamp(first, last);
            drawing.draw(self.at(self.scene.find(time)?)?, index, time, views)
        })
    }

    /// Returns the interval at an index; the previous one is dropped.
    fn at(&mut self, place: usize) -> Result<&Interval, run::Error> {
        if self.current.as_ref().is_none_or(|(at, _)| *at != place) {
            let begun = Instant::now();
            self.current = None;
            self.current = Some((place, self.scene.interval(place)?));
            self.read += begun.elapsed();
            self.seen.insert(place);
        }
        self.current.as_ref().map(|(_, interval)| interval).ok_or_else(|| run::Error::work("an interval that was read"))
    }
}

/// Result of a rendering, without the renderer.
pub(super) struct Rendered {
    /// The files.
    pub outputs: BTreeMap<String, OutputRecord>,
    /// False if the user stopped it.
    pub complete: bool,
    /// Time spent reading.
    pub read: Duration,
    /// When it began.
    pub start: Instant,
}

/// Returns the record of a rendering of `input`.
pub(super) fn record(
    options: &RenderOptions,
    input: InputRecord,
    drawing: &Drawing,
    rendered: Rendered,
    workers: &Workers,
) -> Result<Record, Failure> {
    let Rendered { outputs, complete, read, start } = rendered;
    let mut options = options.clone();
    options.view.camera = options.view.camera.as_deref().map(absolute);
    let options = serde_json::to_value(options).map_err(Failure::work)?;
    let mut work = BTreeMap::new();
    let mut seconds = BTreeMap::from([("read".to_owned(), read.as_secs_f64())]);
    drawing.account(&mut work, &mut seconds);
    Ok(Record {
        program: PROGRAM.to_owned(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        build: Build::of(version::commit()),
        task: Invocation::Render(options),
        seed: 0,
        model: None,
        depth: None,
        input,
        renderer: drawing.renderer(),
        complete,
        outputs,
        work,
        dropped: drawing.counts.dropped,
        image_size: drawing.counts.size,
        key_frames: None,
        psnr: None,
        psnr_size: None,
        psnr_source_size: None,
        psnr_least: None,
        timing: Timing::of(start, seconds, workers),
    })
}
