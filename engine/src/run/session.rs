//! A run under way: key frames pass through the engine, intervals become images, results go to their destination.

use std::path::PathBuf;
use std::time::Instant;

use super::ahead::Ahead;
use super::catch_up::catch_up;
use super::closeness::{Closeness, Truth, Whole};
use super::destination::Destination;
use super::drawing::Drawing;
use super::keydepth::KeyDepth;
use super::keyframes::{Keep, KeyFrames};
use super::options::{Fill, Machine, NamedMatrix, RunOptions};
use super::outputs::{Emit, Finished, Outputs};
use super::place::Place;
use super::record::{Account, Build, Invocation, NetworkRecord, PROGRAM, Record, Timing, WorkRecord};
use super::resume_state::{Found, Point};
use super::terms::{Terms, with_absolute_paths};
use super::views::Views;
use super::{Error, Observer, Shown, Step, Stop};
use crate::output::{Pace, VideoFormat, holds_sound};
use crate::picture::Picture;
use crate::source::{self, Sound, Source};
use crate::stream::{Interval, MotionFrom, ResumePoint, Reuse, Snapshot};
use crate::{Engine, Image};

/// The input, options and environment of a run.
pub(super) struct Task {
    /// The input's path.
    pub input: PathBuf,
    /// The frames, if they are in memory.
    pub frames: Option<Source>,
    /// Options, with those of presets and defaults.
    pub options: RunOptions,
    pub machine: Machine,
    pub program: Build,
    pub observer: Box<dyn Observer>,
    pub stop: Stop,
}

/// A run under way.
pub(super) struct Session {
    task: Task,
    pub keys: Ahead,
    pub engine: Engine,
    /// Destination of the results; `None` where only the caller receives them, and after a failure.
    pub outputs: Option<Outputs>,
    place: Option<Place>,
    pub drawing: Drawing,
    /// PSNR at 256×256, where key frames depend on it.
    pub closeness: Option<Closeness>,
    /// PSNR at the source's size, where the images have that size.
    whole: Option<Whole>,
    pub account: Account,
    pub emit: Emit,
    pub views: Views,
    /// Gaussians left out by the engine.
    pub dropped: u64,
    /// First and last time so far.
    pub span: Option<(f64, f64)>,
    /// The next key frame.
    pub key: u64,
    /// Number of requested times that are done.
    pub times: usize,
    terms: Terms,
    /// The first interval and the images due in it, while they wait for the second.
    first: Option<(Interval, Vec<(usize, f64)>)>,
    /// A step that is done but not returned yet.
    ready: Option<Step>,
    /// Number of frames done.
    done: usize,
    state: State,
    /// Number of the source's notes that were passed on.
    noted: usize,
    start: Instant,
}

/// State of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    /// Frames are left.
    Under,
    /// All frames are done.
    Complete,
    /// It was stopped earlier.
    Stopped,
    /// It has failed.
    Failed,
}

impl Session {
    /// Starts a run, or resumes the one `found`. Errors in options and files are reported before anything is written.
    pub(super) fn begin(mut task: Task, mut place: Option<Place>, found: Found) -> Result<Session, Error> {
        let start = Instant::now();
        let Task { input, frames, options, machine, program, observer, stop } = &mut task;
        let destination = place.as_ref().map(Place::destination);
        if let Some(destination) = destination {
            destination.check_crf(options.crf)?;
        }
        let mut views = options.view.resolve()?;
        views.refuse_still()?;
        let gap = options.stream.gap();
        let depth = options.stream.depth_from()?;
        let settings = options.stream.settings(options.fit.unwrap_or_default(), machine)?;
        let emit = match (options.emit, destination) {
            (Some(emit), _) => {
                emit.check(|kind| kind.of_run)?;
                emit
            }
            (None, Some(Destination::Folder(_))) => Emit { rgb: true, scene: true, ..Emit::default() },
            (None, _) => Emit { rgb: true, ..Emit::default() },
        };
        [views.options.depth, views.options.alpha] = emit.planes();
        if options.fps.is_some_and(|fps| !(fps.is_finite() && fps > 0.0)) || options.frames == Some(0) {
            return Err(Error::usage("--fps and --frames: expected numbers above 0"));
        }
        let source = match frames.take() {
            Some(frames) => frames,
            None => Source::open(
                input,
                &source::Options { fps: options.fps, matrix: options.matrix.map(NamedMatrix::matrix) },
            )?,
        };
        options.motion.follow(&mut views, source.fps())?;
        observer.notes(source.notes());
        let noted = source.notes().len();
        let pace = Pace { fps: source.fps(), uneven: source.is_uneven() && views.times.is_none() };
        if pace.uneven && matches!(destination, Some(Destination::Video(_, VideoFormat::Y4m))) {
            let fps = pace.fps;
            observer.notes(&[format!(
                "y4m holds no times: images follow each other at {fps:.3} a second, unlike the frames"
            )]);
        }
        let sound = destination.and_then(|destination| taken_along(&source, options, destination));
        if source.sound().is_some() && destination.is_some() {
            let found = if sound.is_some() { "sound is taken along" } else { "sound is left out" };
            observer.notes(&[found.to_owned()]);
        }
        let reuse = settings.reuse != Reuse::Off;
        let keep = if settings.motion() == MotionFrom::Between { Keep::Between } else { Keep::Nothing };
        if !views.backend.is_within_contract() {
            // Fails here if there is no adapter.
            Drawing::new(&machine.workers()?, views.backend)?;
        }
        let depth = KeyDepth::open(&depth, &source, machine.level(), reuse, options.frames)?;
        observer.notes(depth.notes());
        observer.opened(source.fps())?;
        let terms = |options: &RunOptions| Terms::given(options, &options.stream.model.record()?, program);
        let resume = destination.and_then(Destination::resume);
        let (mut outputs, before) = match (&found, resume, &mut place) {
            (Found::Under(under), Some(folder), Some(place)) => {
                let (point, _) = &**under;
                let terms = terms(options)?;
                point.terms.check(&terms)?;
                let outputs = Outputs::resume(place.destination().clone(), emit, folder, point.ledger)?;
                (Some(outputs), Some(terms))
            }
            (_, _, Some(place)) => (Some(Outputs::create(place, emit)?.with_ledger()), None),
            (_, _, None) => (None, None),
        };
        if let Some(outputs) = &mut outputs {
            outputs.drawn_by(views.backend);
            outputs.sound(sound);
            outputs.quality(options.crf);
        }
        // The place is locked before the model is loaded, which takes time.
        let loaded = Engine::new(settings).map_err(Error::from).and_then(|engine| {
            let drawing = Drawing::new(engine.workers(), views.backend)?;
            let terms = before.map_or_else(|| terms(options), Ok)?;
            Ok((engine, drawing, terms))
        });
        let (engine, drawing, terms) = match loaded {
            Ok(loaded) => loaded,
            Err(failure) => {
                if let Some((outputs, place)) = outputs.zip(place.as_mut()) {
                    outputs.withdraw(place);
                }
                return Err(failure);
            }
        };
        let mut keys = KeyFrames::new(source, depth, gap, keep, options.frames, stop);
        let whole = gap.depends_on_images() && emit.draws() && views.is_the_sources_own();
        keys.compare_whole(whole);
        let point = if let Found::Under(under) = &found { Some(&under.0) } else { None };
        let choices = point.and_then(|point| point.choices.as_ref());
        let keys = Ahead::resume(keys, engine.workers().threads(), choices);
        let mut closeness = gap.depends_on_images().then(|| Closeness::new(engine.workers())).transpose()?;
        if let Some((closeness, choices)) = closeness.as_mut().zip(choices) {
            closeness.resume(choices);
        }
        let whole = whole.then(|| point.and_then(|point| point.whole).map(Whole::resume).unwrap_or_default());
        observer.started(keys.total());
        let mut session = Session {
            task,
            keys,
            engine,
            outputs,
            place,
            drawing,
            closeness,
            whole,
            account: Account::default(),
            emit,
            views,
            dropped: 0,
            span: None,
            key: 0,
            times: 0,
            terms,
            first: None,
            ready: None,
            done: 0,
            state: State::Under,
            noted,
            start,
        };
        match &found {
            Found::Under(under) => {
                let (point, resume) = &**under;
                if let Err(failure) = catch_up(&mut session, point, resume.as_ref()) {
                    session.abandon();
                    return Err(failure);
                }
            }
            _ => {
                let fps = session.keys.fps();
                if let Some(outputs) = &mut session.outputs {
                    outputs.start(fps, pace)?;
                }
            }
        }
        Ok(session)
    }

    /// Passes the next key frame through the engine, then draws and writes the images that are due. Returns `None` at
    /// the end and when the run is stopped. Where depth is found by parallax, the first key frame's results are drawn
    /// from the interval after it, as `render` draws them from the scene. Until then there is nothing to resume from,
    /// and the run does not stop. With `keep` the step has its images.
    pub(super) fn step(&mut self, keep: bool) -> Result<Option<Step>, Error> {
        if self.state != State::Under {
            return Ok(self.ready.take());
        }
        let step = self.advance(keep);
        if step.is_err() {
            self.state = State::Failed;
            self.abandon();
        }
        step
    }

    fn advance(&mut self, keep: bool) -> Result<Option<Step>, Error> {
        if let Some(step) = self.ready.take() {
            return Ok(Some(step));
        }
        loop {
            // The first interval is always completed.
            if self.task.stop.asked() && self.first.is_none() && self.key > 0 {
                self.state = State::Stopped;
                return Ok(None);
            }
            let Some(mut key) = self.keys.next_key()? else { break };
            let Some(timestamp) = key.shown.last().map(|frame| frame.timestamp) else { continue };
            let resume = self.engine.resume_point().filter(|_| self.can_resume());
            let interval = self.engine.push_with(key.take_between(), key.frame, timestamp)?;
            self.dropped += interval.dropped;
            self.span = Some((self.span.map_or(interval.start, |(first, _)| first), interval.end));
            self.task.observer.interval(&interval);
            let times: Vec<f64> = key.shown.iter().map(|frame| frame.timestamp).collect();
            let frames = key.shown.iter().map(|frame| (frame.index, frame.timestamp));
            let mut due = if self.emit.draws() || self.emit.ply { self.due(&interval, frames) } else { Vec::new() };
            if let Some(whole) = &mut self.whole {
                let truths = key.shown.iter().zip(&mut key.truths);
                truths.for_each(|(frame, truth)| whole.expect(frame.index, truth.samples.take().unwrap_or_default()));
            }
            let waits = interval.index == 0 && self.engine.finds_depth() && !due.is_empty();
            if let Some(outputs) = &mut self.outputs {
                self.drawing.writing(|| outputs.interval(&interval, &times, self.engine.workers()))?;
            }
            let mut images = Vec::new();
            let before = self.first.take().filter(|_| !waits).map(|(first, of_first)| {
                let count = of_first.len();
                due.splice(0..0, of_first);
                (first, count)
            });
            if !waits {
                images = self.draw(&interval, &due, &key.truths, keep)?;
            }
            if let Some(closeness) = &mut self.closeness
                && let Some(found) = closeness.of(&interval, &key.truths)?
            {
                self.keys.tell(&found, closeness);
            }
            if !waits {
                self.commit(resume.as_ref())?;
            }
            self.key += 1;
            key.shown.iter().for_each(|_| self.progress());
            if waits {
                self.first = Some((interval, due));
                continue;
            }
            let Some((first, count)) = before else { return Ok(Some(Step { interval, images })) };
            let of_this = images.split_off(count.min(images.len()));
            self.ready = Some(Step { interval, images: of_this });
            return Ok(Some(Step { interval: first, images }));
        }
        self.state = State::Complete;
        // There was only one key frame.
        let Some((interval, due)) = self.first.take() else { return Ok(None) };
        let images = self.draw(&interval, &due, &[], keep)?;
        Ok(Some(Step { interval, images }))
    }

    /// Counts one more finished frame.
    pub(super) fn progress(&mut self) {
        self.done += 1;
        self.task.observer.progress(self.done, self.keys.total());
    }

    fn can_resume(&self) -> bool {
        self.outputs.as_ref().is_some_and(Outputs::can_resume)
    }

    /// Numbers and times of the images of `interval`: the input frames' own, or those of the requested times that are
    /// in it.
    fn due(&mut self, interval: &Interval, frames: impl Iterator<Item = (usize, f64)>) -> Vec<(usize, f64)> {
        let Some(asked) = &self.views.times else { return frames.collect() };
        let mut due = Vec::new();
        while let Some(&time) = asked.get(self.times).filter(|time| **time <= interval.end) {
            if time < interval.start {
                break;
            }
            due.push((self.times, time));
            self.times += 1;
        }
        due
    }

    /// Draws and writes the images that are due in an interval.
    fn draw(
        &mut self,
        interval: &Interval,
        due: &[(usize, f64)],
        truths: &[Truth],
        keep: bool,
    ) -> Result<Vec<Shown>, Error> {
        let Session { outputs, drawing, emit, keys, whole, closeness, views, .. } = self;
        let (emit, views, mut kept) = (*emit, &*views, Vec::new());
        // With `--times`, images have a constant rate.
        let rate = views.times.as_ref().map(|_| keys.fps());
        drawing.pass(
            due.iter(),
            |drawing, &(index, time)| {
                Ok(Some((index, time, Drawn::of(drawing, interval, (index, time), emit, views)?)))
            },
            |(index, time, Drawn { image, snapshot })| {
                if let Some(image) = image {
                    let Image { width, height, .. } = image;
                    let picture = Picture { width, height, rgb: image.rgb };
                    if let Some(whole) = whole {
                        whole.compare(index, &picture);
                    }
                    if let Some(closeness) = closeness {
                        closeness.take(interval, (time, &picture), views, truths)?;
                    }
                    let image = Image { rgb: picture.rgb, ..image };
                    kept.extend(keep.then(|| Shown { index, time, image: image.clone() }));
                    if let Some(outputs) = outputs.as_mut() {
                        outputs.image(index, rate.map_or(time, |fps| index as f64 / fps), image)?;
                    }
                }
                match (snapshot, outputs.as_mut()) {
                    (Some(snapshot), Some(outputs)) => outputs.snapshot(index, &snapshot),
                    _ => Ok(()),
                }
            },
        )?;
        Ok(kept)
    }

    /// Makes the interval just written a point to resume from.
    fn commit(&mut self, resume: Option<&ResumePoint>) -> Result<(), Error> {
        if !self.can_resume() {
            return Ok(());
        }
        let point = Point {
            terms: self.terms.clone(),
            input: self.keys.input(&self.task.input),
            key: self.key,
            span: self.span.unwrap_or_default(),
            times: self.times,
            choices: self.keys.choices().cloned(),
            whole: self.whole.as_ref().map(Whole::compared),
            work: self.account.of(self.engine.work()),
            dropped: self.dropped,
            drawn: self.drawing.counts.clone(),
            anchor: self.drawing.anchor,
            ledger: 0,
            video: None,
        };
        let Session { outputs, drawing, .. } = self;
        outputs.as_mut().map_or(Ok(()), |outputs| drawing.writing(|| outputs.commit(point, resume)))
    }

    /// Ends after a failure: files written so far stay valid, and the place is released.
    fn abandon(&mut self) {
        if let (Some(outputs), Some(place)) = (self.outputs.take(), &mut self.place) {
            outputs.abandon(place);
        }
    }

    /// Completes the files after the last step. Returns the place to the caller, who writes the record before it is
    /// released.
    pub(super) fn finish(mut self) -> Result<(Record, Option<Place>), Error> {
        while self.step(false)?.is_some() {}
        if self.state == State::Failed {
            return Err(Error::work("the run has failed before; what was written is valid"));
        }
        let complete = self.state == State::Complete;
        let Some((first, last)) = self.span else {
            return Err(Error::work(format!("{}: the video has no frame", self.task.input.display())));
        };
        if complete
            && (self.emit.draws() || self.emit.ply)
            && let Some(time) = self.views.times.as_ref().and_then(|times| times.get(self.times).copied())
        {
            self.abandon();
            return Err(Error::usage(format!("--times: {time} s lies outside the video ({first} s to {last} s)")));
        }
        let filled = self.views.fill != Fill::None;
        let Session { mut task, keys, engine, outputs, place, mut drawing, closeness, whole, account, .. } = self;
        task.observer.finishing();
        let finished = outputs.map(|outputs| drawing.writing(|| outputs.finish())).transpose()?;
        let Finished { outputs, notes } = finished.unwrap_or_default();
        task.observer.finished();
        task.observer.notes(&notes);
        task.observer.notes(drawing.counts.unfilmed.note(filled).as_slice());

        let mut work = account.of(engine.work());
        // The time of a stage's part is included in the stage's.
        let stages = engine.work().stages().iter().filter(|stage| !stage.stage.contains('.'));
        let mut seconds = stages.map(|stage| (stage.stage.to_owned(), stage.time.as_secs_f64())).collect();
        drawing.account(&mut work, &mut seconds);
        if let Some(closeness) = &closeness {
            closeness.account(&mut work, &mut seconds);
        }
        let read = keys.account();
        // Notes added while reading.
        task.observer.notes(read.notes.get(self.noted..).unwrap_or_default());
        seconds.insert("decode".into(), read.time.as_secs_f64());
        if let Some(network) = &read.network {
            let unit = "frames".to_owned();
            work.insert("depth".into(), WorkRecord { done: network.done, avoided: network.avoided, unit });
            seconds.insert("depth".into(), network.time.as_secs_f64());
        }
        let options = with_absolute_paths(&task.options);
        let network = options.stream.depth_network().zip(read.network.as_ref());
        let depth = network.map(|(file, network)| NetworkRecord::of(file, &network.runtime)).transpose()?;
        let record = Record {
            program: PROGRAM.to_owned(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            build: task.program,
            seed: options.stream.seed,
            model: Some(options.stream.model.record()?),
            depth,
            input: keys.input(&task.input),
            renderer: drawing.renderer(),
            task: Invocation::Run(Box::new(options)),
            complete,
            outputs,
            work,
            dropped: self.dropped + drawing.counts.dropped,
            image_size: drawing.counts.size,
            key_frames: Some(self.key),
            psnr: closeness.as_ref().and_then(Closeness::mean),
            psnr_source_size: whole.as_ref().and_then(Whole::mean),
            timing: Timing::of(self.start, seconds, engine.workers()),
        };
        Ok((record, place))
    }
}

/// The sound of the input, if the output video can hold it and has the times of the input's own frames.
fn taken_along(source: &Source, options: &RunOptions, destination: &Destination) -> Option<Sound> {
    let own_times = options.view.times.is_none() && options.fps.is_none();
    let wanted = !options.no_audio && own_times && holds_sound(destination.path());
    source.sound().filter(|_| wanted)
}

/// Results at one time, not yet written.
struct Drawn {
    image: Option<Image>,
    snapshot: Option<Snapshot>,
}

impl Drawn {
    /// The results of `interval` at `time` that `emit` selects.
    fn of(
        drawing: &mut Drawing,
        interval: &Interval,
        (index, time): (usize, f64),
        emit: Emit,
        views: &Views,
    ) -> Result<Self, Error> {
        let image = emit.draws().then(|| drawing.draw(interval, index, time, views)).transpose()?;
        let snapshot = emit.ply.then(|| Snapshot::square(interval, time, drawing.workers())).transpose()?;
        if let Some(snapshot) = &snapshot {
            // Where an image is drawn as well, its count includes them.
            drawing.counts.dropped += if emit.draws() { 0 } else { snapshot.dropped };
        }
        Ok(Self { image, snapshot })
    }
}
