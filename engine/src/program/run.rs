//! `run`: video → scene, frames, report.

use std::path::{Path, PathBuf};
use std::time::Instant;

use streamsplat::Engine;
use streamsplat::output::{Sound, holds_sound, storage};
use streamsplat::render::Snapshot;
use streamsplat::source::{self, Source};
use streamsplat::stream::{Interval, Memory, MotionFrom, Reuse};

use super::ahead::Ahead;
use super::cli::{Console, Machine, RunArgs, RunOptions};
use super::closeness::Closeness;
use super::drawing::Drawing;
use super::failure::Failure;
use super::keydepth::KeyDepth;
use super::keyframes::{Keep, KeyFrames};
use super::outputs::{Destination, Emit, Outputs};
use super::place::Place;
use super::progress::Progress;
use super::record::{Account, ModelRecord, NetworkRecord, PROGRAM, Record, Task, Timing, WorkRecord};
use super::resume::{self, Found, Point, Terms, with_absolute_paths};
use super::serving::Serving;
use super::settings::Views;
use super::{digest, report, say, stop};

/// Runs, then writes the record and the report.
pub fn command(args: &RunArgs, console: &Console) -> Result<(), Failure> {
    stop::listen();
    let out = args.out.clone().map_or_else(|| named_after(&args.input), Ok)?;
    // Held until everything is written.
    let mut place = Place::new(Destination::asked(&out)?);
    let record = match resume_or_run(args, &out, &mut place, console)? {
        Some(record) => record,
        None => return Ok(()),
    };
    let destination = place.destination();
    report::finish(&record, destination, args.json.as_deref())?;
    if record.complete
        && let Some(folder) = destination.resume()
    {
        resume::remove(&folder)?;
    }
    if !console.quiet && out != Path::new("-") {
        say(report::summary(&record, &out))?;
        if record.complete && record.outputs.keys().any(|name| name.starts_with("scene/")) {
            say(format!("Next: streamsplat view {}", out.display()))?;
        }
    }
    let resumable = destination.resume().is_some();
    if record.complete { Ok(()) } else { Err(stop::stopped(resumable)) }
}

/// The run, from where it was stopped with `--resume`; `None` when it is complete already, which is said.
fn resume_or_run(args: &RunArgs, out: &Path, place: &mut Place, console: &Console) -> Result<Option<Record>, Failure> {
    if args.resume {
        place.hold_existing()?;
    }
    let found = if args.resume { resume::find(place.destination())? } else { Found::Nothing };
    let RunArgs { input, machine, .. } = args;
    let options = &RunOptions { stream: args.options.stream.resolved()?, ..args.options.clone() };
    if let Found::Complete(record) = &found {
        resume::check_complete(record, input, &Terms::given(options, &model_record(options)?)?)?;
        if let Some(folder) = place.destination().resume() {
            resume::remove(&folder)?;
        }
        if let Some(path) = &args.json {
            streamsplat::output::write_file(path, record.to_json()?.as_bytes())?;
        }
        if !console.quiet {
            say(format!("{}: complete already, nothing to resume", out.display()))?;
        }
        return Ok(None);
    }
    if !args.resume && !args.overwrite {
        refuse_others(input, out, place.destination(), options)?;
    }
    run_from(found, input, place, options, machine, args.serve, console).map(Some)
}

/// An error where the place holds the finished results of another input or of other options.
fn refuse_others(input: &Path, out: &Path, destination: &Destination, options: &RunOptions) -> Result<(), Failure> {
    let record = destination.record().filter(|path| storage::regular(path).is_ok());
    // What is no record of a whole run is no result that anybody has.
    let record = record.and_then(|path| Record::read(&path).ok()).filter(|record| record.complete);
    let Some(record) = record else { return Ok(()) };
    let given = Terms::given(options, &model_record(options)?)?;
    resume::check_complete(&record, input, &given).map_err(|_| {
        let (out, of) = (out.display(), record.input.path.display());
        Failure::usage(format!(
            "--out {out}: expected a free place, found the results of another run (of {of}); --overwrite replaces them"
        ))
    })
}

/// Everything of a run but its record's files.
pub fn run(
    input: &Path,
    place: &mut Place,
    options: &RunOptions,
    machine: &Machine,
    console: &Console,
) -> Result<Record, Failure> {
    run_from(Found::Nothing, input, place, options, machine, None, console)
}

/// The same from what was `found`, shown in a browser on the port `serve`, if there is one.
fn run_from(
    found: Found,
    input: &Path,
    place: &mut Place,
    options: &RunOptions,
    machine: &Machine,
    serve: Option<u16>,
    console: &Console,
) -> Result<Record, Failure> {
    let start = Instant::now();
    // What is wrong with the options is said before anything is touched.
    let mut views = options.view.resolve()?;
    views.refuse_still()?;
    let gap = options.stream.gap()?;
    let depth = options.stream.depth_from()?;
    let settings = options.stream.settings(&options.fit, machine)?;
    let emit = match (&options.emit, place.destination()) {
        (Some(list), _) => Emit::parse(list, &["rgb", "depth", "alpha", "exr", "scene", "ply", "tracks"])?,
        (None, Destination::Folder(_)) => Emit { rgb: true, scene: true, ..Emit::default() },
        (None, Destination::Video(..)) => Emit { rgb: true, ..Emit::default() },
    };
    [views.options.depth, views.options.alpha] = emit.planes();
    if options.fps.is_some_and(|fps| !(fps.is_finite() && fps > 0.0)) || options.frames == Some(0) {
        return Err(Failure::usage("--fps and --frames: expected numbers above 0"));
    }
    let source = Source::open(input, &source::Options { fps: options.fps })?;
    console.note(source.notes());
    let sound = taken_along(&source, options, place.destination());
    if source.sound().is_some() {
        let found = if sound.is_some() { "sound is taken along" } else { "sound is left out" };
        console.note(&[found.to_owned()]);
    }
    let reuse = settings.reuse != Reuse::Off;
    let keep = if settings.motion() == MotionFrom::Between { Keep::Between } else { Keep::Nothing };
    if !views.backend.is_within_contract() {
        // That there is no adapter is said before anything is touched.
        Drawing::new(&machine.workers()?, views.backend)?;
    }
    let page = serve.map(|port| Serving::start(port, input, source.fps(), console)).transpose()?;
    let (mut outputs, terms) = match (&found, place.destination().resume()) {
        (Found::Under(point, _), Some(folder)) => {
            let terms = Terms::given(options, &model_record(options)?)?;
            point.terms.check(&terms)?;
            (Outputs::resume(place.destination().clone(), emit, folder, point.ledger)?, Some(terms))
        }
        _ => (Outputs::create(place, emit)?.with_ledger(), None),
    };
    outputs.drawn_by(views.backend);
    outputs.sound(sound);
    // That nothing can be written is said before the model is loaded.
    let engine = Engine::new(settings)?;
    let mut drawing = Drawing::new(engine.workers(), views.backend)?;
    let depth = KeyDepth::open(&depth, &source, machine.level()?, reuse)?;
    let keys = KeyFrames::new(source, depth, gap, keep, options.frames);
    let before = if let Found::Under(point, _) = &found { point.choices.as_ref() } else { None };
    let keys = Ahead::resume(keys, engine.workers().threads(), before);
    let mut closeness = gap.depends_on_images().then(|| Closeness::new(engine.workers())).transpose()?;
    if let Some((closeness, choices)) = closeness.as_mut().zip(before) {
        closeness.resume(choices);
    }
    let terms = terms.map_or_else(|| Terms::given(options, &model_record(options)?), Ok)?;

    let mut times = Times { asked: views.times.as_deref(), next: 0 };
    let progress = Progress::new("frames", keys.total(), console.quiet);
    let account = Account::default();
    let (drawing_ref, span) = (&mut drawing, None);
    let drawing = drawing_ref;
    let mut stream =
        Stream { keys, engine, outputs, drawing, closeness, progress, page, account, emit, dropped: 0, span, key: 0 };
    let resumed = match &found {
        Found::Under(point, memory) => {
            if let Err(failure) = resume::catch_up(&mut stream, &mut times, &views, point, memory.as_ref()) {
                stream.outputs.abandon();
                return Err(failure);
            }
            true
        }
        _ => {
            stream.outputs.start(stream.keys.fps())?;
            false
        }
    };
    let complete = match stream.pass(&mut times, &views, &Whence { terms: &terms, input, resumed }) {
        Ok(complete) => complete,
        Err(failure) => {
            stream.outputs.abandon();
            return Err(failure);
        }
    };
    let Stream { keys, engine, outputs, closeness, progress, page, account, dropped, span, .. } = stream;
    let Some((first, last)) = span else {
        return Err(Failure::work(format!("{}: the video has no frame", input.display())));
    };
    if complete
        && (emit.draws() || emit.ply)
        && let Some(time) = times.left()
    {
        outputs.abandon();
        return Err(Failure::usage(format!("--times: {time} s lies outside the video ({first} s to {last} s)")));
    }
    progress.finish();
    if let Some(page) = page {
        page.finish();
    }
    let written = drawing.writing(|| outputs.finish())?;

    let mut work = account.of(engine.work());
    // The time of a stage's part is in the stage's.
    let stages = engine.work().stages().iter().filter(|stage| !stage.stage.contains('.'));
    let mut seconds = stages.map(|stage| (stage.stage.to_owned(), stage.time.as_secs_f64())).collect();
    drawing.account(&mut work, &mut seconds);
    if let Some(closeness) = &closeness {
        closeness.account(&mut work, &mut seconds);
    }
    let read = keys.account();
    seconds.insert("decode".into(), read.time.as_secs_f64());
    if let Some(network) = &read.network {
        let unit = "frames".to_owned();
        work.insert("depth".into(), WorkRecord { done: network.done, avoided: network.avoided, unit });
        seconds.insert("depth".into(), network.time.as_secs_f64());
    }
    let options = with_absolute_paths(options);
    let network = options.stream.depth.strip_prefix("onnx:").zip(read.network.as_ref());
    let depth = network.map(|(file, network)| NetworkRecord::of(Path::new(file), &network.runtime)).transpose()?;
    Ok(Record {
        program: PROGRAM.to_owned(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        seed: options.stream.seed,
        model: Some(model_record(&options)?),
        depth,
        input: keys.input(input),
        renderer: drawing.renderer(),
        task: Task::Run(Box::new(options)),
        complete,
        outputs: written,
        work,
        dropped: dropped + drawing.counts.dropped,
        psnr: closeness.as_ref().and_then(Closeness::mean),
        timing: Timing::of(start, seconds, engine.workers()),
    })
}

/// A run under way.
pub struct Stream<'a> {
    pub keys: Ahead,
    pub engine: Engine,
    pub outputs: Outputs,
    pub drawing: &'a mut Drawing,
    /// Where key frames depend on it.
    pub closeness: Option<Closeness>,
    pub progress: Progress,
    pub page: Option<Serving>,
    pub account: Account,
    pub emit: Emit,
    /// Gaussians left out by the engine.
    pub dropped: u64,
    /// First and last time seen.
    pub span: Option<(f64, f64)>,
    /// The next key frame.
    pub key: u64,
}

/// What a run under way comes from.
struct Whence<'a> {
    terms: &'a Terms,
    input: &'a Path,
    /// Whether it has intervals from before.
    resumed: bool,
}

impl Stream<'_> {
    /// Takes the rest of the video through the engine; false when the user stopped it.
    fn pass(&mut self, times: &mut Times<'_>, views: &Views, whence: &Whence<'_>) -> Result<bool, Failure> {
        if whence.resumed && stop::asked() {
            return Ok(false);
        }
        while let Some(mut key) = self.keys.next()? {
            let Some(timestamp) = key.shown.last().map(|frame| frame.timestamp) else { continue };
            let memory = self.engine.memory().filter(|_| self.outputs.can_resume());
            let interval = self.engine.push_with(key.take_between(), key.frame, timestamp)?;
            self.dropped += interval.dropped;
            self.span = Some((self.span.map_or(interval.start, |(first, _)| first), interval.end));
            if let Some(page) = &self.page {
                page.push(&interval);
            }
            let frames = key.shown.iter().map(|frame| (frame.index, frame.timestamp));
            let due = if self.emit.draws() || self.emit.ply { times.of(&interval, frames) } else { Vec::new() };
            self.write(&interval, &due, views)?;
            if let Some(closeness) = &mut self.closeness
                && let Some(found) = closeness.of(&interval, &key.truths)?
            {
                self.keys.tell(&found, closeness);
            }
            self.commit(whence, times.next, memory.as_ref())?;
            self.key += 1;
            key.shown.iter().for_each(|_| self.progress.step());
            if stop::asked() {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Writes an interval and what is due in it.
    fn write(&mut self, interval: &Interval, due: &[(usize, f64)], views: &Views) -> Result<(), Failure> {
        let Stream { outputs, drawing, emit, .. } = self;
        drawing.writing(|| outputs.interval(interval))?;
        for &(index, time) in due {
            if emit.draws() {
                drawing.image(outputs, index, interval, time, views)?;
            }
            if emit.ply {
                let snapshot = Snapshot::of(interval, time)?;
                // Where an image is drawn as well, they are counted with it.
                drawing.counts.dropped += if emit.draws() { 0 } else { snapshot.dropped };
                drawing.writing(|| outputs.snapshot(index, &snapshot))?;
            }
        }
        Ok(())
    }

    /// Makes the interval just written one to go on from.
    fn commit(&mut self, whence: &Whence<'_>, times: usize, memory: Option<&Memory>) -> Result<(), Failure> {
        if !self.outputs.can_resume() {
            return Ok(());
        }
        let point = Point {
            terms: whence.terms.clone(),
            input: self.keys.input(whence.input),
            key: self.key,
            span: self.span.unwrap_or_default(),
            times,
            choices: self.keys.choices().cloned(),
            work: self.account.of(self.engine.work()),
            dropped: self.dropped,
            drawn: self.drawing.counts.clone(),
            ledger: 0,
            video: None,
        };
        let Stream { outputs, drawing, .. } = self;
        drawing.writing(|| outputs.commit(point, memory))
    }
}

/// The sound of the input, where the video that is written takes it along: at the times of the input's own frames alone.
fn taken_along(source: &Source, options: &RunOptions, destination: &Destination) -> Option<Sound> {
    let own_times = options.view.times.is_none() && options.fps.is_none();
    let wanted = !options.no_audio && own_times && holds_sound(destination.path());
    let sound = source.sound().filter(|_| wanted)?;
    Some(Sound { seconds: options.frames.map(|frames| frames as f64 / source.fps()), ..sound })
}

/// A folder in the working directory, named after the input.
fn named_after(input: &Path) -> Result<PathBuf, Failure> {
    let stem = input.file_stem().filter(|_| input != Path::new("-"));
    let Some(stem) = stem else {
        return Err(Failure::usage("--out: expected, as the input has no name to make one of"));
    };
    let mut name = stem.to_owned();
    name.push("-scene");
    Ok(PathBuf::from(name))
}

/// Which model it was.
fn model_record(options: &RunOptions) -> Result<ModelRecord, Failure> {
    let Some(path) = &options.stream.model.model else {
        let blake3 =
            digest::bytes(&[streamsplat::stream::EMBEDDED_CHECKPOINT, streamsplat::stream::EMBEDDED_CONFIG.as_bytes()]);
        return Ok(ModelRecord { path: "embedded".into(), blake3 });
    };
    let mut files = vec![path.clone()];
    files.extend(Some(path.with_extension("json")).filter(|config| config.exists()));
    files.extend(options.stream.model.dinov2.clone());
    Ok(ModelRecord { path: path.display().to_string(), blake3: digest::files(&files)? })
}

/// The times at which images are due.
pub struct Times<'a> {
    /// Those asked for.
    pub asked: Option<&'a [f64]>,
    /// The next of them.
    pub next: usize,
}

impl Times<'_> {
    /// Numbers and times of the images of `interval`: the input frames' own, or what of the times asked for it holds.
    fn of(&mut self, interval: &Interval, frames: impl Iterator<Item = (usize, f64)>) -> Vec<(usize, f64)> {
        let Some(asked) = self.asked else { return frames.collect() };
        let mut due = Vec::new();
        while let Some(&time) = asked.get(self.next).filter(|time| **time <= interval.end) {
            if time < interval.start {
                break;
            }
            due.push((self.next, time));
            self.next += 1;
        }
        due
    }

    /// The first time asked for that no interval held.
    fn left(&self) -> Option<f64> {
        self.asked?.get(self.next).copied()
    }
}
