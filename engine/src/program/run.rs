//! `run`: video → scene, frames, report.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Instant;

use streamsplat::Engine;
use streamsplat::render::Snapshot;
use streamsplat::source::{self, Source};
use streamsplat::stream::Interval;

use super::cli::{Console, Machine, RunArgs, RunOptions};
use super::drawing::Drawing;
use super::failure::Failure;
use super::keyframes::KeyFrames;
use super::outputs::{Destination, Emit, Outputs};
use super::progress::Progress;
use super::record::{InputRecord, ModelRecord, PROGRAM, Record, Task, Timing, WorkRecord, absolute};
use super::settings::Views;
use super::{digest, machine, report, say, stop};

/// Runs, then writes the record and the report.
pub fn command(args: &RunArgs, console: &Console) -> Result<(), Failure> {
    stop::listen();
    let destination = Destination::of(&args.out);
    let record = run(&args.input, destination.clone(), &args.options, &args.machine, console)?;
    report::finish(&record, &destination, args.json.as_deref())?;
    if !console.quiet && args.out != Path::new("-") {
        say(report::summary(&record, &args.out));
    }
    Ok(())
}

/// Everything of a run but its record's files.
pub fn run(
    input: &Path,
    destination: Destination,
    options: &RunOptions,
    machine: &Machine,
    console: &Console,
) -> Result<Record, Failure> {
    let start = Instant::now();
    // What is wrong with the options is said before anything is touched.
    let mut views = options.view.resolve()?;
    let gap = options.stream.gap()?;
    let depth = options.stream.depth_from()?;
    let settings = options.stream.settings(&options.fit, machine)?;
    let emit = match (&options.emit, &destination) {
        (Some(list), _) => Emit::parse(list, &["rgb", "depth", "alpha", "scene", "ply"])?,
        (None, Destination::Folder(_)) => Emit { rgb: true, scene: true, ..Emit::default() },
        (None, Destination::Video(..)) => Emit { rgb: true, ..Emit::default() },
    };
    views.options.depth = emit.depth;
    views.options.alpha = emit.alpha || emit.depth;
    if options.fps.is_some_and(|fps| !(fps.is_finite() && fps > 0.0)) || options.frames == Some(0) {
        return Err(Failure::usage("--fps and --frames: expected numbers above 0"));
    }
    let source = Source::open(input, &source::Options { fps: options.fps })?;
    let mut outputs = Outputs::create(destination, emit)?;
    let keys = KeyFrames::new(source, &depth, gap, false, options.frames)?;
    let engine = Engine::new(settings)?;
    outputs.start(keys.fps())?;

    let mut drawing = Drawing::new(engine.workers());
    let mut times = Times { asked: views.times.as_deref(), next: 0 };
    let progress = Progress::new("frames", keys.total(), console.quiet);
    let mut stream = Stream { keys, engine, outputs, drawing: &mut drawing, progress, dropped: 0, span: None };
    let complete = match stream.pass(&mut times, &views, emit) {
        Ok(complete) => complete,
        Err(failure) => {
            stream.outputs.abandon();
            return Err(failure);
        }
    };
    let Stream { keys, engine, outputs, progress, dropped, span, .. } = stream;
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
    let written = drawing.writing(|| outputs.finish())?;

    let mut work = BTreeMap::new();
    let mut seconds = BTreeMap::new();
    for stage in engine.work().stages() {
        let unit = stage.unit.to_owned();
        work.insert(stage.stage.to_owned(), WorkRecord { done: stage.done, avoided: stage.avoided, unit });
        seconds.insert(stage.stage.to_owned(), stage.time.as_secs_f64());
    }
    drawing.account(&mut work, &mut seconds);
    seconds.insert("decode".into(), keys.time().as_secs_f64());
    let mut options = options.clone();
    for path in [&mut options.stream.model.model, &mut options.stream.model.dinov2, &mut options.view.camera] {
        *path = path.as_deref().map(absolute);
    }
    if options.stream.depth != "none" {
        options.stream.depth = absolute(Path::new(&options.stream.depth)).display().to_string();
    }
    Ok(Record {
        program: PROGRAM.to_owned(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        seed: options.stream.seed,
        model: Some(model_record(&options)?),
        input: InputRecord {
            path: absolute(input),
            blake3: keys.digest().finish(),
            count: keys.digest().frames(),
            size: keys.size(),
            fps: keys.fps(),
        },
        task: Task::Run(Box::new(options)),
        complete,
        outputs: written,
        work,
        dropped: dropped + drawing.dropped,
        timing: Timing {
            total: start.elapsed().as_secs_f64(),
            seconds,
            peak_resident_bytes: machine::peak_resident_bytes(),
            threads: engine.workers().threads(),
            isa: engine.workers().level().name().to_owned(),
        },
    })
}

/// A run under way.
struct Stream<'a> {
    keys: KeyFrames,
    engine: Engine,
    outputs: Outputs,
    drawing: &'a mut Drawing,
    progress: Progress,
    /// Gaussians left out by the engine.
    dropped: u64,
    /// First and last time seen.
    span: Option<(f64, f64)>,
}

impl Stream<'_> {
    /// Takes the whole video through the engine; false when the user stopped it.
    fn pass(&mut self, times: &mut Times<'_>, views: &Views, emit: Emit) -> Result<bool, Failure> {
        while let Some(key) = self.keys.next()? {
            let Some(timestamp) = key.shown.last().map(|frame| frame.timestamp) else { continue };
            let interval = self.engine.push(key.frame, timestamp)?;
            self.dropped += interval.dropped;
            self.span = Some((self.span.map_or(interval.start, |(first, _)| first), interval.end));
            let Stream { outputs, drawing, progress, .. } = self;
            drawing.writing(|| outputs.interval(&interval))?;
            if emit.draws() || emit.ply {
                let frames = key.shown.iter().map(|frame| (frame.index, frame.timestamp));
                for (index, time) in times.of(&interval, frames) {
                    if emit.draws() {
                        drawing.image(outputs, index, &interval, time, views)?;
                    }
                    if emit.ply {
                        let snapshot = Snapshot::of(&interval, time)?;
                        // Where an image is drawn as well, they are counted with it.
                        drawing.dropped += if emit.draws() { 0 } else { snapshot.dropped };
                        drawing.writing(|| outputs.snapshot(index, &snapshot))?;
                    }
                }
            }
            key.shown.iter().for_each(|_| progress.step());
            if stop::asked() {
                return Ok(false);
            }
        }
        Ok(true)
    }
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
struct Times<'a> {
    asked: Option<&'a [f64]>,
    next: usize,
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
