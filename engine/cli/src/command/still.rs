//! Still scenes, for example PLY files, in `render`, `export` and `inspect`.

use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::time::Instant;

use serde_json::{Value, json};
use streamsplat::camera::{Camera, CameraPath, Lens, Pose};
use streamsplat::formats::Options;
use streamsplat::open::StillFile;
use streamsplat::output::{Pace, prepare_folder, write_file};
use streamsplat::still::{Drawable, Spread};
use streamsplat::stream::Workers;
use streamsplat::{Image, Size, run};

use crate::command::export::{Format, camera_of, refuse_others};
use crate::command::render::{Rendered, record};
use crate::console::failure::Failure;
use crate::console::opening::say_of;
use crate::console::progress::Progress;
use crate::console::{Console, count, say};
use crate::options::args::{ExportArgs, RenderOptions};
use crate::options::times;
use streamsplat::run::drawing::Drawing;
use streamsplat::run::options::Times;
use streamsplat::run::outputs::{Destination, Emit, Finished, Outputs};
use streamsplat::run::place::Place;
use streamsplat::run::record::{InputRecord, Record, absolute};
use streamsplat::run::views::Views;

/// Frames per second of a video of a scene that has no time.
const FPS: f64 = 24.0;
/// Number of images from which the scene's Gaussians are grouped. Grouping takes about as long as an image, and saves
/// more than half of each image that shows a tenth of the scene (`streamsplat bench raster --only part`).
const MANY: usize = 8;

/// Image size if neither options nor cameras set one.
const SIZE: [usize; 2] = [1280, 720];

/// The images of a still scene: cameras, times, and sizes.
pub struct Plan {
    views: Views,
    times: Vec<f64>,
    fps: f64,
    /// True if `times` comes from `--times`. A scene that changes over time is then drawn at these times.
    of_scene: bool,
}

/// A scene prepared for drawing.
#[expect(clippy::large_enum_variant, reason = "one value for a command")]
pub enum Prepared {
    /// A scene that is the same at all times.
    Still(Drawable),
    /// A scene that changes.
    InTime(Box<StillFile>),
}

impl Prepared {
    /// Returns the Gaussians of an image.
    fn at(&self, time: f64, workers: &Workers) -> Result<Cow<'_, Drawable>, run::Error> {
        Ok(match self {
            Prepared::Still(scene) => Cow::Borrowed(scene),
            Prepared::InTime(file) => Cow::Owned(Drawable::new(file.at(time).into_owned(), workers)?),
        })
    }
}

impl Plan {
    /// Plans the images of `file` by the options; values that the options leave out follow from the scene.
    pub fn new(file: &StillFile, options: &RenderOptions, views: &Views) -> Result<Plan, Failure> {
        let kind = format!("{} is a still scene ({})", file.path.display(), file.format);
        let fps = options.fps.or(views.own_rate).unwrap_or(FPS);
        let of_scene = views.times.is_some();
        let mut views = views.clone();
        views.options.antialias = options.antialias.of_still(&file.still);
        let framing = file.still.framing();
        let optics = &options.optics;
        if let Some(framing) = framing {
            optics.focus_on(&mut views, framing.middle());
        }
        views.eyes = options.motion.eyes()?;
        views.pivot = framing.map(|framing| framing.middle());
        if options.motion.moves() && views.times.is_some() {
            return Err(Failure::usage(format!("--times: expected none beside a camera that moves; {kind}")));
        }
        if let Some(fill) = options.motion.fill {
            return Err(Failure::usage(format!(
                "--fill {fill}: expected a scene in time; {kind}, of which nothing was left out"
            )));
        }
        if views.options.size == Size::Source {
            return Err(Failure::usage(format!("--size source: expected WIDTHxHEIGHT; {kind}, which has no source")));
        }
        if options.view.camera.is_some() {
            if views.options.size == Size::Model && views.own_sizes.is_empty() {
                let size = views.options.size;
                return Err(Failure::usage(format!(
                    "--size {size}: expected WIDTHxHEIGHT; {kind}, and the camera file says no size either"
                )));
            }
            let rate = views.own_rate.unwrap_or(1.0);
            let times = match (&views.times, views.camera.views()) {
                (Some(times), [(first, _), .., (last, _)]) if file.in_time.is_none() => {
                    if let Some(time) = times.iter().find(|time| !(first..=last).contains(time)) {
                        return Err(Failure::usage(format!(
                            "--times: {time} s lies outside the path of --camera ({first} s to {last} s)"
                        )));
                    }
                    times.clone()
                }
                (Some(times), _) => times.clone(),
                (None, [(first, _), .., (last, _)]) if views.own_sizes.is_empty() => times::grid((*first, *last), fps)?,
                (None, _) => (0..views.own_sizes.len().max(1)).map(|i| i as f64 / rate).collect(),
            };
            views.camera = optics.around(views.camera)?;
            return Ok(Plan { views, times, fps, of_scene });
        }
        if views.options.size == Size::Model {
            let [width, height] = SIZE;
            views.options.size = Size::Exact { width, height };
        }
        let Size::Exact { width, height } = views.options.size else { return Err(Failure::work(kind)) };
        let Some(framing) = framing else {
            return Err(Failure::work(format!("{kind}: expected Gaussians at finite places, found none to look at")));
        };
        let aspect = width as f64 / height as f64;
        let Some(angles) = options.motion.held(fps)? else {
            views.camera = if optics.panorama {
                let pose = Pose { position: framing.middle(), ..Pose::default() };
                Camera::Posed { pose, lens: Lens::Equirectangular }.into()
            } else {
                framing.camera(0.0, aspect).into()
            };
            let times = views.times.clone().unwrap_or_else(|| vec![0.0]);
            return Ok(Plan { views, times, fps, of_scene });
        };
        let times: Vec<f64> = (0..angles.len()).map(|i| i as f64 / fps).collect();
        let mut path: Vec<(f64, Camera)> = times.iter().copied().zip(framing.around(&angles, aspect)).collect();
        if let (true, true, [first, .., last]) = (views.shutter.is_some(), options.motion.closes(), &path[..]) {
            let (before, after) = ((-1.0 / fps, last.1), (times.len() as f64 / fps, first.1));
            path.insert(0, before);
            path.push(after);
        }
        let path = CameraPath::new(path).ok_or_else(|| Failure::work(format!("{kind}: too large to look at")))?;
        views.camera = optics.around(path)?;
        Ok(Plan { views, times, fps, of_scene })
    }

    /// Returns an error for a shutter if nothing moves.
    pub fn check_shutter(&self, file: &StillFile) -> Result<(), Failure> {
        let changes = file.in_time.is_some() && self.of_scene;
        if self.views.shutter.is_none() || self.views.camera.views().len() > 1 || changes {
            return Ok(());
        }
        let path = file.path.display();
        Err(Failure::usage(format!(
            "--shutter: expected a camera that moves, found one place; {path} is a still scene"
        )))
    }

    /// Prepares the scene for this number of images.
    pub fn prepare(&self, file: StillFile, workers: &Workers) -> Result<Prepared, Failure> {
        if file.in_time.is_some() && self.of_scene {
            return Ok(Prepared::InTime(Box::new(file)));
        }
        let scene = Drawable::new(file.still, workers)?;
        Ok(Prepared::Still(if self.times.len() >= MANY { scene.grouped(workers) } else { scene }))
    }

    /// Draws one of the images.
    pub fn image(
        &self,
        drawing: &mut Drawing,
        scene: &Prepared,
        time: f64,
        views: &Views,
        workers: &Workers,
    ) -> Result<Image, run::Error> {
        drawing.exposed(views, |drawing, part| {
            let time = time + part / self.fps;
            let scene = scene.at(time, workers)?;
            drawing.still(&scene, time, views)
        })
    }

    /// Returns the number of images.
    pub fn count(&self) -> usize {
        self.times.len()
    }

    /// Iterates over the images, each with its time and its views.
    pub fn images(&self) -> impl ExactSizeIterator<Item = (f64, Views)> {
        self.times.iter().map(|&time| {
            let mut views = self.views.clone();
            let last = views.own_sizes.len().saturating_sub(1);
            // Negative times are before the first.
            if let (Size::Model, Some(&[width, height])) =
                (views.options.size, views.own_sizes.get((time as usize).min(last)))
            {
                views.options.size = Size::Exact { width, height };
            }
            (time, views)
        })
    }
}

/// Returns the options with the camera that was exported with the file at `path`, unless there is none or another
/// option sets the view. Updates `views`. The size of the images is the camera file's, unless a size was given.
pub fn seen_as_exported(
    options: &RenderOptions,
    path: &Path,
    views: &mut Views,
    console: &Console,
) -> Result<RenderOptions, Failure> {
    let mut options = options.clone();
    let others = options.motion.moves() || options.optics.panorama || options.optics.f_stop.is_some();
    if options.view.camera.is_none() && !others {
        options.view.camera = camera_of(path);
        if let Some(camera) = &options.view.camera {
            say_of(path, &[format!("seen from {}", camera.display())], console);
        }
    }
    let Some(camera) = &options.view.camera else { return Ok(options) };
    if views.options.size == Size::Model
        && let Ok(bytes) = std::fs::read(camera)
        && let Some([width, height]) = serde_json::from_slice(&bytes).ok().as_ref().and_then(size_of)
    {
        options.view.size = Some(Size::Exact { width, height });
    }
    let seen = options.view.resolve()?;
    (views.camera, views.options.size) = (seen.camera, seen.options.size);
    Ok(options)
}

/// Returns the image size in the file of an orthographic camera, if there is one.
fn size_of(camera: &Value) -> Option<[usize; 2]> {
    if camera["type"] != "orthographic" {
        return None;
    }
    let [width, height] = [0, 1].map(|at| camera["size"][at].as_u64().and_then(|side| usize::try_from(side).ok()));
    width.zip(height).map(|(width, height)| [width, height])
}

/// Renders everything except the record's files: one image, or one per position of the camera.
pub fn render(
    file: StillFile,
    place: &mut Place,
    options: &RenderOptions,
    views: &Views,
    emit: Emit,
    workers: &Workers,
    console: &Console,
    start: Instant,
) -> Result<Record, Failure> {
    let plan = Plan::new(&file, options, views)?;
    plan.check_shutter(&file)?;
    options.check_single(plan.count())?;
    let (path, blake3) = (absolute(&file.path), file.blake3.clone());
    let read = start.elapsed();
    let count = file.still.len();
    let scene = plan.prepare(file, workers)?;
    let mut drawing = Drawing::new(workers, views.backend)?;
    let video = matches!(place.destination(), Destination::Video(path, _) if path != Path::new("-"));
    let mut outputs = Outputs::create(place, emit)?;
    outputs.drawn_by(views.backend);
    outputs.keep_alpha(views.transparent)?;
    outputs.quality(options.crf);
    outputs.start(plan.fps, Pace::even(plan.fps))?;
    let mut progress = Progress::new("images", Some(plan.count()), console);
    let (mut complete, mut size, mut dropped) = (true, None, 0);
    drawing.pass(
        plan.images().enumerate(),
        |drawing, (index, (time, views))| {
            if console.stop.asked() {
                complete = false;
                return Ok(None);
            }
            let image = plan.image(drawing, &scene, time, &views, workers)?;
            size.get_or_insert([image.width, image.height]);
            dropped = dropped.max(image.dropped);
            Ok(Some((index, image)))
        },
        |(index, image)| {
            outputs.image(index, index as f64 / plan.fps, image)?;
            progress.step();
            Ok(())
        },
    )?;
    let shown = drawing.has_drawn();
    let mut lines = Vec::new();
    if dropped > 0 {
        lines.push(format!("{dropped} of {count} Gaussians not drawn: numbers that are not finite, or no rotation"));
    }
    if complete && !shown {
        lines.push(format!("nothing drawn: the camera sees none of {count} Gaussians"));
    }
    if video && plan.count() == 1 {
        lines.push("a video of one image: the camera moves with --turntable, --orbit or --sway, or along the path of a --camera file".to_owned());
    }
    if !video && plan.count() == 1 && options.fps.is_some() {
        lines.push("--fps changes nothing for one image".to_owned());
    }
    say_of(&path, &lines, console);
    progress.phase("images; finishing the files");
    let Finished { outputs, notes } = drawing.writing(|| outputs.finish())?;
    progress.finish();
    console.note(&notes);
    console.note(plan.views.squeezed(None).as_slice());

    let input = InputRecord { path, blake3, count: 1, size: size.unwrap_or(SIZE), fps: plan.fps, damage: None };
    record(options, input, &drawing, Rendered { outputs, complete, read, start }, workers)
}

/// Exports a still scene to one file.
pub fn export(
    file: StillFile,
    format: Format,
    args: &ExportArgs,
    options: &Options,
    workers: &Workers,
    console: &Console,
) -> Result<(), Failure> {
    let kind = format!("{} is a still scene ({})", file.path.display(), file.format);
    let asked = args.times.as_ref().map(Times::list);
    if args.fps.is_some() || asked.is_some() && file.in_time.is_none() {
        return Err(Failure::usage(format!("--times, --fps: expected neither; {kind}, which has no time")));
    }
    let Format::Still(of_scene) = format else {
        return Err(Failure::usage(format!("--format ssz: expected the format of a still scene; {kind}")));
    };
    let times = asked.unwrap_or_else(|| vec![0.0]);
    let paths: Vec<PathBuf> = if format.is_file(&args.out) {
        if times.len() != 1 {
            let (out, found) = (args.out.display(), times.len());
            return Err(Failure::usage(format!("--out {out}: expected one time for one file, found {found}")));
        }
        vec![args.out.clone()]
    } else {
        prepare_folder(&args.out)?;
        refuse_others(&args.out, format, times.len())?;
        (0..times.len()).map(|index| args.out.join(format.file(index))).collect()
    };
    let (mut bytes, StillFile { mut still, in_time, .. }) = (0, file);
    for (time, path) in times.iter().zip(&paths) {
        let still = in_time.as_ref().map_or_else(|| std::mem::take(&mut still), |scene| scene.at(*time));
        let written = (of_scene.still)(&Drawable::new(still, workers)?, options);
        bytes += write_file(path, &written.bytes)?.bytes;
        say_of(path, &written.notes, console);
    }
    if !console.quiet {
        say(format!("{}: {}, {bytes} bytes", args.out.display(), count(paths.len(), "file")))?;
    }
    Ok(())
}

/// Summarises a still scene as JSON.
pub fn inspect(file: &StillFile) -> Value {
    let still = &file.still;
    let (bounds, framing, statistics) = (still.bounds(), still.framing(), still.statistics());
    let spread = |spread: Option<Spread>| {
        spread.map(|Spread([least, p5, median, p95, greatest])| {
            json!({ "least": short(least), "p5": short(p5), "median": short(median), "p95": short(p95), "greatest": short(greatest) })
        })
    };
    let mut found = json!({
        "kind": "still scene",
        "format": file.format,
        "bytes": file.bytes,
        "blake3": file.blake3,
        "gaussians": still.len(),
        "harmonics_degree": still.degree,
        "axes": still.about.axes.to_string(),
        "axes_assumed": still.about.axes_assumed,
        "trained_with_antialiasing": still.about.antialiased,
        "offset": still.about.offset,
        "orbit": still.about.orbit.map(|orbit| json!({ "elevation_radians": orbit.elevation, "radius": orbit.radius })),
        "notes": still.about.notes,
        "least": bounds.map(|[least, _]| least),
        "greatest": bounds.map(|[_, greatest]| greatest),
        "most_of_it": framing.map(|f| {
            let placed = |ends: [f64; 3]| [0, 1, 2].map(|k| digits(ends[k], f.greatest[k] - f.least[k]));
            json!({ "least": placed(f.least), "greatest": placed(f.greatest) })
        }),
        "standard_deviation": spread(statistics.size),
        "flatness": spread(statistics.flatness),
        "opacity": spread(statistics.opacity),
        "not_drawn": {
            "not_finite": statistics.not_finite,
            "no_rotation": statistics.no_rotation,
            "opacity_under_1_255": statistics.faint,
        },
    });
    if let Some(scene) = &file.in_time {
        found["in_time"] = json!({ "span": scene.span() });
    }
    if !file.notes.is_empty() {
        found["notes"] = json!(file.notes);
    }
    found
}

/// Formats a number with five digits for the terminal.
fn short(x: f64) -> f64 {
    digits(x, x)
}

/// Formats a number with five digits, or with as many as tell five digits of `extent`.
fn digits(x: f64, extent: f64) -> f64 {
    let more = (x / extent).abs().log10().floor().clamp(0.0, 12.0) as usize;
    format!("{x:.*e}", 4 + more).parse().unwrap_or(x)
}
