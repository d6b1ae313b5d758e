//! A run under way: key frames pass through the engine, intervals become images, results go to their destination.

use std::path::PathBuf;
use std::time::Instant;

use super::ahead::Ahead;
use super::catch_up::catch_up;
use super::closeness::{Closeness, Whole};
use super::delivery::{Delivered, Delivery, Pending};
use super::destination::Destination;
use super::drawing::Drawing;
use super::keydepth::KeyDepth;
use super::keyframes::{Keep, KeyFrames};
use super::options::{DepthSource, Fill, Machine, NamedMatrix, RunOptions};
use super::outputs::{Emit, Finished, Outputs};
use super::place::Place;
use super::record::{Account, Build, Invocation, NetworkRecord, PROGRAM, Record, Timing, WorkRecord};
use super::resume_state::Found;
use super::terms::{Terms, with_absolute_paths};
use super::{Error, Observer, Step, Stop};
use crate::Engine;
use crate::fit::Placement;
use crate::output::{Pace, holds_sound};
use crate::source::{self, Sound, Source};
use crate::stream::{Interval, MotionFrom, Resolution, Reuse};

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
    pub engine: Engine,
    pub delivery: Delivery,
    place: Option<Place>,
    pub account: Account,
    /// True if an interval may be delivered while the next one is computed.
    overlaps: bool,
    /// The latest interval, if it is still to be delivered.
    pending: Option<Pending>,
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
        if options.matrix.is_some() && source.files().is_some() {
            observer.notes(&["--matrix changes nothing: images have their own".to_owned()]);
        }
        let noted = source.notes().len();
        let pace = Pace { fps: source.fps(), uneven: source.is_uneven() && views.times.is_none() };
        observer.notes(destination.and_then(|destination| destination.without_times(pace)).as_slice());
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
        // A live stream's frames arrive late: no image waits for them.
        let waits = source.is_stream();
        let mut keys = KeyFrames::new(source, depth, gap, keep, options.frames, stop);
        let whole = gap.depends_on_images() && emit.draws() && views.is_the_sources_own();
        keys.compare_at(Box::new(engine.content_size()), whole);
        let point = if let Found::Under(under) = &found { Some(&under.0) } else { None };
        let choices = point.and_then(|point| point.choices.as_ref());
        let keys = Ahead::resume(keys, engine.workers().threads(), choices);
        let mut closeness = gap.depends_on_images().then(|| Closeness::new(engine.workers())).transpose()?;
        if let Some((closeness, choices)) = closeness.as_mut().zip(choices) {
            closeness.resume(choices);
        }
        let whole = whole.then(|| point.and_then(|point| point.whole).map(Whole::resume).unwrap_or_default());
        observer.started(keys.total());
        let (input, overlaps) = (input.clone(), !waits && engine.workers().threads() > 1);
        let delivery = Delivery {
            keys,
            outputs,
            drawing,
            closeness,
            whole,
            emit,
            views,
            dropped: 0,
            span: None,
            key: 0,
            times: 0,
            terms,
            input,
        };
        let mut session = Session {
            task,
            engine,
            delivery,
            place,
            account: Account::default(),
            overlaps,
            pending: None,
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
                let fps = session.delivery.keys.fps();
                if let Some(outputs) = &mut session.delivery.outputs {
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
            if self.task.stop.asked() {
                self.deliver_pending()?;
                // The first interval is always completed.
                if self.first.is_none() && self.delivery.key > 0 {
                    self.state = State::Stopped;
                    return Ok(None);
                }
            }
            let mut key = match self.delivery.keys.next_key() {
                Ok(Some(key)) => key,
                end => {
                    self.deliver_pending()?;
                    end?;
                    self.delivery.keys.end();
                    break;
                }
            };
            let Some(timestamp) = key.shown.last().map(|frame| frame.timestamp) else { continue };
            let resume = self.engine.resume_point().filter(|_| self.delivery.can_resume());
            let between = key.take_between();
            let interval = match self.pending.take() {
                None => self.engine.push_with(between, key.frame, timestamp)?,
                Some(pending) => {
                    let Session { engine, delivery, .. } = self;
                    let (delivered, pushed) = std::thread::scope(|scope| {
                        let delivered = scope.spawn(|| delivery.deliver(pending, false));
                        let pushed = engine.push_with(between, key.frame, timestamp);
                        (delivered.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)), pushed)
                    });
                    self.delivered(delivered?);
                    pushed?
                }
            };
            let delivery = &mut self.delivery;
            delivery.dropped += interval.dropped;
            if delivery.span.is_none() {
                let placement = &interval.placement;
                let shape = delivery.views.squeezed(Some(placement.source)).filter(|_| delivery.emit.draws());
                let exact = matches!(self.task.options.stream.resolution, Some(Resolution::Exact(_)));
                let seen = padding(placement).filter(|_| exact);
                self.task.observer.notes(&shape.into_iter().chain(seen).collect::<Vec<_>>());
            }
            delivery.span = Some((delivery.span.map_or(interval.start, |(first, _)| first), interval.end));
            self.task.observer.interval(&interval);
            let times: Vec<f64> = key.shown.iter().map(|frame| frame.timestamp).collect();
            let frames = key.shown.iter().map(|frame| (frame.index, frame.timestamp));
            let mut due = match delivery.emit.draws() || delivery.emit.ply {
                true => delivery.due(&interval, frames),
                false => Vec::new(),
            };
            if let Some(whole) = &mut delivery.whole {
                let truths = key.shown.iter().zip(&mut key.truths);
                for (frame, truth) in truths {
                    if let Some(samples) = truth.own.take() {
                        whole.expect(frame.index, samples);
                    }
                }
            }
            let waits = interval.index == 0 && self.engine.finds_depth() && !due.is_empty();
            if let Some(outputs) = &mut delivery.outputs {
                delivery.drawing.writing(|| outputs.interval(&interval, &times, self.engine.workers()))?;
            }
            let first = self.first.take().filter(|_| !waits).map(|(first, of_first)| {
                let count = of_first.len();
                due.splice(0..0, of_first);
                (first, count)
            });
            let work = self.account.of(self.engine.work());
            let frames = key.shown.len();
            let pending = Pending { interval, due, truths: key.truths, frames, waits, first, resume, work };
            if self.overlaps && !keep && !waits {
                self.pending = Some(pending);
                continue;
            }
            let delivered = self.delivery.deliver(pending, keep)?;
            let Delivered { pending: Pending { interval, due, waits, first, .. }, mut images } =
                self.delivered(delivered);
            if waits {
                self.first = Some((interval, due));
                continue;
            }
            let Some((first, count)) = first else { return Ok(Some(Step { interval, images })) };
            let of_this = images.split_off(count.min(images.len()));
            self.ready = Some(Step { interval, images: of_this });
            return Ok(Some(Step { interval: first, images }));
        }
        self.state = State::Complete;
        // There was only one key frame.
        let Some((interval, due)) = self.first.take() else { return Ok(None) };
        let images = self.delivery.draw(&interval, &due, &[], keep)?;
        Ok(Some(Step { interval, images }))
    }

    /// Delivers the interval that is still to be delivered. Its images are not kept: intervals wait only in runs that
    /// keep none.
    fn deliver_pending(&mut self) -> Result<(), Error> {
        if let Some(pending) = self.pending.take() {
            let delivered = self.delivery.deliver(pending, false)?;
            self.delivered(delivered);
        }
        Ok(())
    }

    /// Reports the frames of a delivered interval.
    fn delivered(&mut self, delivered: Delivered) -> Delivered {
        (0..delivered.pending.frames).for_each(|_| self.progress());
        delivered
    }

    /// Counts one more finished frame.
    pub(super) fn progress(&mut self) {
        self.done += 1;
        self.task.observer.progress(self.done, self.delivery.keys.total());
    }

    /// Ends after a failure: files written so far stay valid, and the place is released.
    fn abandon(&mut self) {
        if let (Some(outputs), Some(place)) = (self.delivery.outputs.take(), &mut self.place) {
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
        let Some((first, last)) = self.delivery.span else {
            return Err(Error::work(format!("{}: the video has no frame", self.task.input.display())));
        };
        if complete
            && (self.delivery.emit.draws() || self.delivery.emit.ply)
            && let Some(time) =
                self.delivery.views.times.as_ref().and_then(|times| times.get(self.delivery.times).copied())
        {
            self.abandon();
            return Err(Error::usage(format!("--times: {time} s lies outside the video ({first} s to {last} s)")));
        }
        let Session { mut task, engine, delivery, place, account, noted, start, .. } = self;
        let Delivery { keys, outputs, views, mut drawing, closeness, whole, key, dropped, .. } = delivery;
        let filled = views.fill != Fill::None;
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
        let turned = drawing.counts.unfilmed.worst.is_some();
        let guesses = task.options.stream.depth == Some(DepthSource::Guess);
        if guesses && !engine.finds_depth() {
            let cause = "the model reads depth, or motion is the network's";
            task.observer.notes(&[format!("--depth guess changes nothing: {cause}")]);
        }
        let flat = work.get("lift").is_some_and(|lifted| lifted.done == 0);
        if turned && flat && engine.finds_depth() && !guesses && key > 1 {
            let guess = "--depth guess assumes a ground with moving bodies on it";
            task.observer.notes(&[format!("no depth was found, so the turned scene is a flat card; {guess}")]);
        }
        let read = keys.account();
        // Notes added while reading.
        task.observer.notes(read.notes.get(noted..).unwrap_or_default());
        seconds.insert("decode".into(), read.time.as_secs_f64());
        if let Some(network) = &read.network {
            let unit = "frames".to_owned();
            work.insert("depth".into(), WorkRecord { done: network.done, avoided: network.avoided, unit });
            seconds.insert("depth".into(), network.time.as_secs_f64());
        }
        let psnr_size = closeness.as_ref().and_then(Closeness::size);
        let figures = closeness.as_ref().and_then(|closeness| closeness.total().figures());
        let at_source_size = figures.filter(|_| psnr_size == Some(read.size));
        let at_source_size = whole.and_then(|whole| whole.total.figures().or(at_source_size));
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
            dropped: dropped + drawing.counts.dropped,
            image_size: drawing.counts.size,
            key_frames: Some(key),
            psnr: figures.map(|[mean, _]| mean),
            psnr_size,
            psnr_source_size: at_source_size.map(|[mean, _]| mean),
            psnr_least: at_source_size.or(figures).map(|[_, least]| least),
            timing: Timing::of(start, seconds, engine.workers()),
        };
        Ok((record, place))
    }
}

/// A line where more than a third of what the model sees is a border around the picture.
fn padding(placement: &Placement) -> Option<String> {
    let [[height, width], [rows, columns]] = [placement.model, placement.content];
    let share = 1.0 - (rows * columns) as f64 / (height * width) as f64;
    let percent = 100.0 * share;
    (share > 1.0 / 3.0).then(|| {
        format!(
            "--resolution {height}x{width} (HEIGHTxWIDTH): the picture has {rows}x{columns} of it, and {percent:.0} % is a border"
        )
    })
}

/// The sound of the input, if the output video can hold it and has the times of the input's own frames.
fn taken_along(source: &Source, options: &RunOptions, destination: &Destination) -> Option<Sound> {
    let own_times = options.view.times.is_none() && options.fps.is_none();
    let wanted = !options.no_audio && own_times && holds_sound(destination.path());
    source.sound().filter(|_| wanted)
}
