//! A whole run: video in, scene and images out, with its record.
//!
//! A [`Run`] reads a video, chooses key frames by how close the images are to the frames, finds their depth, passes
//! them through the [`Engine`](crate::Engine), draws and writes. [`Run::finish`] does all of it and returns the
//! [`Record`], which is also written as `run.json`. [`Run::start`] returns an iterator of intervals and their images,
//! for programs that use them on the way; without [`Run::out`] nothing is written.
//!
//! ```no_run
//! use streamsplat::run::{Run, RunOptions};
//!
//! let record = Run::new("clip.y4m", RunOptions::default()).out("out").finish()?;
//! println!("{} frames, {} files", record.input.count, record.outputs.len());
//! # Ok::<(), streamsplat::run::Error>(())
//! ```
//!
//! The output bytes are those of `streamsplat run clip.y4m --out out`: one function of input, model and options. A run
//! into a folder or a `.y4m` file can be resumed after any interruption ([`Run::resume`]). Nothing is printed: an
//! [`Observer`] receives notes and progress, and a [`Stop`] ends the run after the current interval.

pub mod ahead;
mod catch_up;
mod choices;
pub mod closeness;
pub mod crop;
mod delivery;
pub mod destination;
pub mod digest;
pub mod drawing;
pub mod earlier;
mod emit;
mod error;
pub mod keydepth;
pub mod keyframes;
mod ledger;
mod observer;
pub mod options;
pub mod outputs;
pub mod place;
#[cfg(test)]
mod power;
pub mod record;
pub mod report;
mod resume_state;
mod session;
mod terms;
#[cfg(test)]
mod tests;
pub mod views;

use std::path::{Path, PathBuf};

pub use destination::Destination;
pub use error::Error;
pub use observer::{Observer, Silent, Stop};
pub use options::{Machine, RunOptions};
pub use record::Record;

use crate::output::storage;
use crate::source::{self, MEMORY, Source};
use crate::stream::Interval;
use crate::{Image, Size};
use options::DepthSource;
use outputs::Emit;
use place::Place;
use record::{Build, check_name};
use resume_state::Found;
use session::{Session, Task};
use terms::Terms;

/// One interval of a run, and the images drawn from it.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Step {
    /// The Gaussians between two key frames.
    pub interval: Interval,
    /// Images at the times of its frames, or at [`ViewOptions::times`](options::ViewOptions::times), in the order in
    /// which they are written. Where depth is found by parallax, the images of the first key frame are drawn from the
    /// second interval.
    pub images: Vec<Shown>,
}

/// An image of a run.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Shown {
    /// Its number from 0.
    pub index: usize,
    /// Its time in the scene, in seconds.
    pub time: f64,
    /// The image.
    pub image: Image,
}

/// A run that has not started.
pub struct Run {
    input: PathBuf,
    frames: Option<Source>,
    options: RunOptions,
    machine: Machine,
    out: Option<PathBuf>,
    /// True if the place is named after the input.
    named: bool,
    resume: bool,
    overwrite: bool,
    json: Option<PathBuf>,
    program: Option<String>,
    observer: Box<dyn Observer>,
    stop: Stop,
}

impl Run {
    /// A run of the video `input`: a folder of images, a `.y4m` file, `-` (y4m on standard input), or any video that
    /// ffmpeg reads.
    pub fn new(input: impl Into<PathBuf>, options: RunOptions) -> Run {
        Run {
            input: input.into(),
            frames: None,
            options,
            machine: Machine::default(),
            out: None,
            named: false,
            resume: false,
            overwrite: false,
            json: None,
            program: None,
            observer: Box::new(Silent),
            stop: Stop::default(),
        }
    }

    /// A run of frames in memory ([`Source::of_frames`]); a rate in `options` does not change theirs. To resume it,
    /// pass the same frames from the first one on.
    pub fn of_frames(frames: Source, options: RunOptions) -> Run {
        Run { frames: Some(frames), ..Run::new(MEMORY, options) }
    }

    /// Writes the results to a folder, or to a video file (`.y4m`, `.mp4`, …); `-` is y4m on standard output.
    #[must_use]
    pub fn out(self, path: impl Into<PathBuf>) -> Run {
        Run { out: Some(path.into()), named: false, ..self }
    }

    /// Writes the results to the working directory, named after the input: for `clip.mp4` the video `clip-scene.mp4`
    /// with the scene `clip-scene.ssz`, for images or y4m the folder `clip-scene`.
    ///
    /// # Errors
    /// [`Error::Usage`] where the input has no name.
    pub fn out_named_after_input(self) -> Result<Run, Error> {
        let out = named_after(&self.input, self.options.emit)?;
        Ok(Run { out: Some(out), named: true, ..self })
    }

    /// Resumes an interrupted run from its last whole interval; starts a new one if none exists.
    #[must_use]
    pub fn resume(self, resume: bool) -> Run {
        Run { resume, ..self }
    }

    /// Replaces finished results of another input or other options.
    #[must_use]
    pub fn overwrite(self, overwrite: bool) -> Run {
        Run { overwrite, ..self }
    }

    /// Also writes the record to this file.
    #[must_use]
    pub fn json(self, path: Option<PathBuf>) -> Run {
        Run { json: path, ..self }
    }

    /// Threads and instruction set, which change no output bit.
    #[must_use]
    pub fn machine(self, machine: Machine) -> Run {
        Run { machine, ..self }
    }

    /// The build of the program, such as its commit: a run is resumed only by the same build. The default is the digest
    /// of the program's file.
    #[must_use]
    pub fn program<'a>(self, build: impl Into<Option<&'a str>>) -> Run {
        Run { program: build.into().map(str::to_owned), ..self }
    }

    /// Reports notes and progress.
    #[must_use]
    pub fn observe(self, observer: impl Observer + 'static) -> Run {
        Run { observer: Box::new(observer), ..self }
    }

    /// Ends the run after the current interval when `stop` is requested.
    #[must_use]
    pub fn stop(self, stop: Stop) -> Run {
        Run { stop, ..self }
    }

    /// Where results go, if anywhere.
    pub fn destination(&self) -> Option<&Path> {
        self.out.as_deref()
    }

    /// Runs to the end. The record has `complete` false where the run was stopped, and `input.damage` where the input
    /// ended early or was damaged.
    ///
    /// # Errors
    /// [`Error::Usage`] for wrong options and places, before anything is written; any other for failed work. Files
    /// written until then are valid.
    pub fn finish(self) -> Result<Record, Error> {
        self.start()?.finish()
    }

    /// Checks options and input, locks the place and loads the model.
    ///
    /// # Errors
    /// As [`Run::finish`].
    pub fn start(mut self) -> Result<Running, Error> {
        let model = &self.options.stream.model.model;
        for path in self.out.iter().chain([&self.input]).chain(&self.options.view.camera).chain(model) {
            check_name(path)?;
        }
        // Locked until everything is written.
        let mut place = self.out.as_deref().map(|out| Destination::asked(out).map(Place::new)).transpose()?;
        let unused = self.options.without_effect();
        self.observer.notes(&unused);
        self.fill(place.as_ref().map(Place::destination));
        let found = match &mut place {
            Some(place) if self.resume => {
                place.hold_existing()?;
                resume_state::find(place.destination())?
            }
            None if self.resume => return Err(Error::usage("--resume: expected --out as well")),
            _ => Found::Nothing,
        };
        let program = Build::of(self.program.as_deref());
        let Run { input, frames, machine, resume, overwrite, json, observer, stop, .. } = self;
        let options = self.options.resolved()?;
        let given = || Terms::given(&options, &options.stream.model.record()?, &program);
        if let Found::Complete(record) = found {
            resume_state::check_complete(&record, &input, &given()?)?;
            if let Some(folder) = place.as_ref().and_then(|place| place.destination().resume()) {
                resume_state::remove(&folder)?;
            }
            if let Some(path) = &json {
                crate::output::write_file(path, record.to_json()?.as_bytes())?;
            }
            return Ok(Running(State::Before(record)));
        }
        if let Some(place) = &place {
            refuse_inputs(&input, place.destination(), &options)?;
        }
        if let Some(place) = place.as_ref().filter(|_| !resume && !overwrite) {
            refuse_others(&input, place.destination(), &options, given)?;
        }
        let task = Task { input, frames, options, machine, program, observer, stop };
        Ok(Running(State::Now(Box::new(Session::begin(task, place, found)?), json)))
    }

    /// Sets options that depend on where results go.
    fn fill(&mut self, destination: Option<&Destination>) {
        let scene = destination.zip(destination.and_then(Destination::container));
        if let Some((destination, scene)) = scene.filter(|_| self.options.emit.is_none()) {
            // Videos of several formats under one name share one scene, that of the first.
            let chosen = !self.named && !self.overwrite && !self.resume;
            let taken = chosen && is_anothers(&scene, destination);
            if taken {
                let scene = scene.display();
                self.observer.notes(&[format!("{scene}: of another run, left as it is; this run's scene is not written (--emit rgb,scene --overwrite replaces it)")]);
            }
            self.options.emit = Some(Emit { rgb: true, scene: !taken, ..Emit::default() });
        }
        let own = destination.is_some_and(Destination::is_video) && !self.options.stream.like_paper;
        self.options.view.size.get_or_insert(if own { Size::Source } else { Size::Model });
    }
}

/// A run under way: an iterator of its [`Step`]s, one per key frame. Dropped before [`Running::finish`], it leaves the
/// same state as a killed process, and can be resumed from it.
pub struct Running(State);

enum State {
    /// Done by this process; the path is that of a second copy of the record.
    Now(Box<Session>, Option<PathBuf>),
    /// Done before.
    Before(Box<Record>),
}

impl Running {
    /// Returns true if the run was complete already and nothing is left to do.
    pub fn was_complete(&self) -> bool {
        matches!(self.0, State::Before(_))
    }

    /// Does the remaining work, completes the files and writes the record and the report.
    ///
    /// # Errors
    /// As [`Run::finish`], and a run that has failed before.
    pub fn finish(self) -> Result<Record, Error> {
        let (session, json) = match self.0 {
            State::Now(session, json) => (session, json),
            State::Before(record) => return Ok(*record),
        };
        let (record, place) = session.finish()?;
        report::finish(&record, place.as_ref().map(Place::destination), json.as_deref())?;
        if let Some(folder) = place.as_ref().filter(|_| record.complete).and_then(|place| place.destination().resume())
        {
            resume_state::remove(&folder)?;
        }
        Ok(record)
    }
}

impl Iterator for Running {
    type Item = Result<Step, Error>;

    fn next(&mut self) -> Option<Result<Step, Error>> {
        match &mut self.0 {
            State::Now(session, _) => session.step(true).transpose(),
            State::Before(_) => None,
        }
    }
}

/// Returns true if there is a file in the scene's place that no run to this destination wrote.
fn is_anothers(scene: &Path, destination: &Destination) -> bool {
    let name = scene.file_name().unwrap_or_default().to_string_lossy();
    storage::exists(scene) && record_at(destination).is_none_or(|record| !record.outputs.contains_key(&*name))
}

/// The record at a destination. One that cannot be read lists no results to keep.
fn record_at(destination: &Destination) -> Option<Record> {
    let path = destination.record().filter(|path| storage::regular(path).is_ok())?;
    Record::read(&path).ok()
}

/// Returns an error where the place holds the complete results of another input or of other options, or a video
/// without a record.
fn refuse_others(
    input: &Path,
    destination: &Destination,
    options: &RunOptions,
    given: impl FnOnce() -> Result<Terms, Error>,
) -> Result<(), Error> {
    let out = destination.path().display();
    let wants_scene = options.emit.is_some_and(|emit| emit.scene);
    if let Some(scene) = destination.container().filter(|scene| wants_scene && is_anothers(scene, destination)) {
        return Err(Error::usage(format!(
            "{}: expected a free place for the scene, found a file that no run to {out} wrote; --overwrite replaces it, --emit rgb leaves it",
            scene.display(),
        )));
    }
    let is_file = destination.is_video() && storage::regular(destination.path()).is_ok();
    let Some(record) = record_at(destination) else {
        return if is_file && destination.record().is_some_and(|record| !record.exists()) {
            Err(Error::usage(format!(
                "--out {out}: expected a free place, found a file without the record of a run; --overwrite replaces it"
            )))
        } else {
            Ok(())
        };
    };
    // A stopped run has no results to keep.
    if !record.complete {
        return Ok(());
    }
    let given = given()?.built_as(&record);
    resume_state::check_complete(&record, input, &given).map_err(|_| {
        let of = record.input.path.display();
        Error::usage(format!(
            "--out {out}: expected a free place, found the results of another run (of {of}); --overwrite replaces them"
        ))
    })
}

/// Returns an error where a rendering would replace the results of a run, complete or stopped. Those of another
/// rendering are replaced.
///
/// # Errors
/// [`Error::Usage`] with the run's input.
pub fn refuse_run(destination: &Destination) -> Result<(), Error> {
    let of = match record_at(destination).map(|record| (record.task, record.input.path)) {
        Some((record::Invocation::Run(_), input)) => format!(" of {}", input.display()),
        _ if destination.resume().is_some_and(|folder| folder.exists()) => " that was stopped".to_owned(),
        _ => return Ok(()),
    };
    let out = destination.path().display();
    Err(Error::usage(format!("--out {out}: expected a free place, found a run{of}; give another --out")))
}

/// Returns an error where results would replace what they are made from: the input, or its depth maps.
fn refuse_inputs(input: &Path, destination: &Destination, options: &RunOptions) -> Result<(), Error> {
    let emit = options.emit.unwrap_or(Emit { rgb: true, scene: true, ..Emit::default() });
    let places = match destination {
        Destination::Folder(folder) => emit.folders().into_iter().map(|name| folder.join(name)).collect(),
        Destination::Video(path, _) => vec![path.clone()],
    };
    let places: Vec<PathBuf> = places.iter().filter_map(|place| place.canonicalize().ok()).collect();
    let maps = if let Some(DepthSource::Folder(maps)) = &options.stream.depth { Some(maps.as_path()) } else { None };
    let replaced = |path: &&Path| path.canonicalize().is_ok_and(|path| places.contains(&path));
    match [input].into_iter().chain(maps).find(replaced).filter(|_| destination.record().is_some()) {
        Some(path) => Err(Error::usage(format!(
            "--out {}: expected another place than the input's, found {}, which the results would replace",
            destination.path().display(),
            path.display()
        ))),
        None => Ok(()),
    }
}

/// A place in the working directory, named after the input: a video where the input is an encoded one and only images
/// and scene are requested, else a folder.
fn named_after(input: &Path, emit: Option<Emit>) -> Result<PathBuf, Error> {
    let stem = input.file_stem().filter(|_| input != Path::new("-"));
    let Some(stem) = stem else {
        return Err(Error::usage("--out: expected, as the input has no name to make one of"));
    };
    let mut name = stem.to_owned();
    name.push("-scene");
    if emit.is_none() && source::is_encoded(input) {
        name.push(".mp4");
    }
    Ok(PathBuf::from(name))
}
