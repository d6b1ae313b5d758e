//! `render`: a scene → images at chosen times and cameras.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Duration, Instant};

use streamsplat::import::Opened;
use streamsplat::output::{folder_of, storage, write_file};
use streamsplat::stream::{Interval, Workers};

use crate::command::still;
use crate::console::failure::Failure;
use crate::console::progress::Progress;
use crate::console::{Console, say, stop};
use crate::options::args::{Machine, RenderArgs, RenderOptions};
use crate::options::times;
use crate::output::outputs::{Destination, Emit, Outputs};
use crate::output::place::Place;
use crate::output::record::{InputRecord, Invocation, OutputRecord, PROGRAM, Record, Timing, absolute};
use crate::output::{digest, report};
use crate::session::drawing::Drawing;
use crate::session::opening::open;

/// Renders, then writes the record and the report.
pub fn command(args: &RenderArgs, console: &Console) -> Result<(), Failure> {
    console.listen();
    if let Some(kind) = Single::of(&args.out) {
        return single(args, kind, console);
    }
    // Held until everything is written.
    let mut place = Place::new(Destination::asked(&args.out)?);
    let mut options = args.options.clone();
    options.view.size.get_or_insert_with(|| "model".to_owned());
    let record = render(&args.scene, &mut place, &options, &args.machine, console)?;
    report::finish(&record, place.destination(), args.json.as_deref())?;
    if !console.quiet && args.out != Path::new("-") {
        say(report::summary(&record, &args.out))?;
    }
    if record.complete { Ok(()) } else { Err(stop::stopped(false)) }
}

/// The kinds of a file that is a single image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Single {
    Png,
    Exr,
}

impl Single {
    fn of(out: &Path) -> Option<Single> {
        let ending = out.extension().and_then(|ending| ending.to_str())?.to_ascii_lowercase();
        match ending.as_str() {
            _ if out.is_dir() => None,
            "png" => Some(Single::Png),
            "exr" => Some(Single::Exr),
            _ => None,
        }
    }
}

/// Renders one image into a folder that goes away, and gives it the name that was asked for.
fn single(args: &RenderArgs, kind: Single, console: &Console) -> Result<(), Failure> {
    let (name, emit) = match kind {
        Single::Png => ("frames/000000.png", "rgb"),
        Single::Exr => ("exr/000000.exr", "exr"),
    };
    let mut options = args.options.clone();
    if let Some(list) = options.emit.replace(emit.to_owned())
        && list != emit
    {
        return Err(Failure::usage(format!("--emit {list}: expected {emit} or nothing, as --out is a single file")));
    }
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
    /// Refuses more than one image where there is a single file for it.
    pub(super) fn check_single(&self, images: usize) -> Result<(), Failure> {
        if self.single && images != 1 {
            return Err(Failure::usage(format!(
                "--out: expected a folder or a video for {images} images, found a single file: give --times one time, or --view"
            )));
        }
        Ok(())
    }
}

/// Everything of a rendering but its record's files.
pub fn render(
    path: &Path,
    place: &mut Place,
    options: &RenderOptions,
    machine: &Machine,
    console: &Console,
) -> Result<Record, Failure> {
    let start = Instant::now();
    let mut views = options.view.resolve()?;
    let emit = match &options.emit {
        Some(list) => Emit::parse(list, &["rgb", "depth", "alpha", "exr"])?,
        None => Emit { rgb: true, ..Emit::default() },
    };
    [views.options.depth, views.options.alpha] = emit.planes();
    views.options.alpha |= views.transparent;
    views.options.antialias = options.antialias;
    times::check_rate(options.fps)?;
    let workers = machine.workers()?;
    let scene = match open(path, &options.limit.limits(), Some(&workers), console)? {
        Opened::Moving(scene) => scene,
        Opened::Still(file) => {
            return still::render(file, place, options, &views, emit, &workers, console, start);
        }
    };
    let fps = options.fps.unwrap_or(scene.index().fps);
    let mut due = times::of_scene(&scene, views.times.as_deref(), fps)?;
    options.motion.along(&mut views, &mut due, |(time, _)| time, fps)?;
    options.check_single(due.len())?;
    let mut drawing = Drawing::new(&workers, views.backend)?;
    let mut outputs = Outputs::create(place, emit)?;
    outputs.drawn_by(views.backend);
    outputs.keep_alpha(views.transparent)?;
    outputs.start(fps)?;

    let mut progress = Progress::new("images", Some(due.len()), console);
    let mut current: Option<(usize, Interval)> = None;
    let mut read = Duration::ZERO;
    let mut intervals = 0;
    let mut complete = true;
    drawing.pass(
        due.iter().enumerate(),
        |drawing, (index, &(time, place))| {
            if console.stop.asked() {
                complete = false;
                return Ok(None);
            }
            let interval = match current.take().filter(|(at, _)| *at == place) {
                Some((_, interval)) => interval,
                None => {
                    let begun = Instant::now();
                    let interval = scene.interval(place)?;
                    read += begun.elapsed();
                    intervals += 1;
                    interval
                }
            };
            let image = drawing.draw(&interval, index, time, &views)?;
            current = Some((place, interval));
            Ok(Some((index, image)))
        },
        |(index, image)| {
            outputs.image(index, image)?;
            progress.step();
            Ok(())
        },
    )?;
    progress.phase("images; finishing the files");
    let written = drawing.writing(|| outputs.finish())?;
    progress.finish();

    let [height, width] = scene.placement().source;
    let input = InputRecord {
        path: absolute(path),
        blake3: digest::scene(&scene)?,
        count: intervals,
        size: [width, height],
        fps: scene.index().fps,
    };
    Ok(record(options, input, &drawing, Rendered { outputs: written, complete, read, start }, &workers))
}

/// Result of a rendering, apart from the renderer.
pub(super) struct Rendered {
    /// The files.
    pub outputs: BTreeMap<String, OutputRecord>,
    /// False when the user stopped it.
    pub complete: bool,
    /// Time spent reading.
    pub read: Duration,
    /// When it began.
    pub start: Instant,
}

/// The record of a rendering of `input`.
pub(super) fn record(
    options: &RenderOptions,
    input: InputRecord,
    drawing: &Drawing,
    rendered: Rendered,
    workers: &Workers,
) -> Record {
    let Rendered { outputs, complete, read, start } = rendered;
    let mut options = options.clone();
    options.view.camera = options.view.camera.as_deref().map(absolute);
    let mut work = BTreeMap::new();
    let mut seconds = BTreeMap::from([("read".to_owned(), read.as_secs_f64())]);
    drawing.account(&mut work, &mut seconds);
    Record {
        program: PROGRAM.to_owned(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        task: Invocation::Render(Box::new(options)),
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
        timing: Timing::of(start, seconds, workers),
    }
}
