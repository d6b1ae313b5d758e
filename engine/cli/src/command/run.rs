//! `run`: video → scene, frames, report.

use std::path::{Path, PathBuf};
use std::time::Instant;

use streamsplat::Engine;
use streamsplat::output::{Pace, Sound, VideoFormat, holds_sound, storage};
use streamsplat::source::{self, Source};
use streamsplat::stream::{MotionFrom, Reuse};

use crate::console::failure::Failure;
use crate::console::progress::Progress;
use crate::console::{Console, say, stop};
use crate::options::args::{Machine, RunArgs, RunOptions};
use crate::options::settings::choice_or_default;
use crate::output::outputs::{Destination, Emit, Finished, Outputs};
use crate::output::place::Place;
use crate::output::record::{
    Account, Build, Invocation, ModelRecord, NetworkRecord, PROGRAM, Record, Timing, WorkRecord, check_name,
};
use crate::output::resume_state::Found;
use crate::output::terms::{Terms, with_absolute_paths};
use crate::output::{digest, report, resume_state};
use crate::session::ahead::Ahead;
use crate::session::catch_up::catch_up;
use crate::session::closeness::{Closeness, Whole};
use crate::session::drawing::Drawing;
use crate::session::keydepth::KeyDepth;
use crate::session::keyframes::{Keep, KeyFrames};
use crate::session::serving::Serving;
use crate::session::stream::{RunOrigin, Stream, Times};

/// Runs, then writes the record and the report.
pub fn command(args: &RunArgs, console: &Console) -> Result<(), Failure> {
    finished(args, console).map(|_| ())
}

/// Does the same and gives the record.
pub fn finished(args: &RunArgs, console: &Console) -> Result<Record, Failure> {
    console.listen();
    for path in
        args.out.iter().chain([&args.input]).chain(&args.options.view.camera).chain(&args.options.stream.model.model)
    {
        check_name(path)?;
    }
    let out = args.out.clone().map_or_else(|| named_after(&args.input, args.options.emit.as_deref()), Ok)?;
    // Held until everything is written.
    let mut place = Place::new(Destination::asked(&out)?);
    let mut args = args.clone();
    if let Some(scene) = place.destination().container().filter(|_| args.options.emit.is_none()) {
        // Videos of several formats under one name have one scene, the first one's.
        let taken = args.out.is_some() && !args.overwrite && !args.resume && is_anothers(&scene, place.destination());
        if taken {
            let scene = scene.display();
            console.note(&[format!("{scene}: of another run, left as it is; this run's scene is not written (--emit rgb,scene --overwrite replaces it)")]);
        }
        args.options.emit = Some(if taken { "rgb" } else { "rgb,scene" }.to_owned());
    }
    let own = place.destination().is_video() && !args.options.stream.like_paper;
    let size = if own { "source" } else { "model" };
    args.options.view.size.get_or_insert_with(|| size.to_owned());
    let args = &args;
    let (record, page) = match resume_or_run(args, &out, &mut place, console)? {
        Done::Now(record, page) => (*record, page),
        Done::Before(record) => {
            whole(&record)?;
            return Ok(*record);
        }
    };
    let destination = place.destination();
    report::finish(&record, destination, args.json.as_deref())?;
    if record.complete
        && let Some(folder) = destination.resume()
    {
        resume_state::remove(&folder)?;
    }
    if !console.quiet && out != Path::new("-") {
        say(report::summary(&record, &out))?;
        // The scene in the folder, or beside the video.
        let scene = destination.container().unwrap_or_else(|| out.clone());
        let name = scene.file_name().unwrap_or_default().to_string_lossy();
        let written = |file: &String| file.starts_with("scene/") || **file == *name;
        if record.complete && record.outputs.keys().any(written) {
            say(format!("Next: streamsplat view {}", scene.display()))?;
        }
    }
    let resumable = destination.resume().is_some();
    if !record.complete {
        return Err(stop::stopped(resumable));
    }
    whole(&record)?;
    // Everything is written; the place is free again.
    drop(place);
    // Inside another program nobody presses Ctrl-C here.
    if let Some(page) = page.filter(|_| console.observer.is_none()) {
        page.linger(console);
    }
    Ok(record)
}

/// A failure where the input was damaged: everything of what came before is written.
fn whole(record: &Record) -> Result<(), Failure> {
    record.input.damage.clone().map_or(Ok(()), |damage| Err(Failure::work(damage)))
}

/// A whole run.
enum Done {
    /// Done by this process, with its page.
    Now(Box<Record>, Option<Serving>),
    /// Done before.
    Before(Box<Record>),
}

/// The run, from where it was stopped with `--resume`. Where it was complete already, that is said.
fn resume_or_run(args: &RunArgs, out: &Path, place: &mut Place, console: &Console) -> Result<Done, Failure> {
    if args.resume {
        place.hold_existing()?;
    }
    let found = if args.resume { resume_state::find(place.destination())? } else { Found::Nothing };
    let RunArgs { input, machine, .. } = args;
    let options = &args.options.resolved()?;
    if let Found::Complete(record) = found {
        resume_state::check_complete(&record, input, &Terms::given(options, &model_record(options)?)?)?;
        if let Some(folder) = place.destination().resume() {
            resume_state::remove(&folder)?;
        }
        if let Some(path) = &args.json {
            streamsplat::output::write_file(path, record.to_json()?.as_bytes())?;
        }
        if !console.quiet {
            say(format!("{}: complete already, nothing to resume", out.display()))?;
        }
        return Ok(Done::Before(record));
    }
    if !args.resume && !args.overwrite {
        refuse_others(input, out, place.destination(), options)?;
    }
    let (record, page) = run_from(found, input, place, options, machine, args.serve, console)?;
    Ok(Done::Now(Box::new(record), page))
}

/// Returns true if there is a file in the scene's place that no run to this destination wrote.
fn is_anothers(scene: &Path, destination: &Destination) -> bool {
    let name = scene.file_name().unwrap_or_default().to_string_lossy();
    let record = destination.record().filter(|path| storage::regular(path).is_ok());
    let record = record.and_then(|path| Record::read(&path).ok());
    storage::exists(scene) && record.is_none_or(|record| !record.outputs.contains_key(&*name))
}

/// An error where the place holds the finished results of another input or of other options.
fn refuse_others(input: &Path, out: &Path, destination: &Destination, options: &RunOptions) -> Result<(), Failure> {
    let record = destination.record().filter(|path| storage::regular(path).is_ok());
    let wants_scene = options.emit.as_deref().is_some_and(|list| list.split(',').any(|kind| kind.trim() == "scene"));
    if let Some(scene) = destination.container().filter(|scene| wants_scene && is_anothers(scene, destination)) {
        return Err(Failure::usage(format!(
            "{}: expected a free place for the scene, found a file that no run to {} wrote; --overwrite replaces it, --emit rgb leaves it",
            scene.display(),
            out.display()
        )));
    }
    // What is no record of a whole run is no result that anybody has.
    let record = record.and_then(|path| Record::read(&path).ok()).filter(|record| record.complete);
    let Some(record) = record else { return Ok(()) };
    let given = Terms::given(options, &model_record(options)?)?.built_as(&record);
    resume_state::check_complete(&record, input, &given).map_err(|_| {
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
    run_from(Found::Nothing, input, place, options, machine, None, console).map(|(record, _)| record)
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
) -> Result<(Record, Option<Serving>), Failure> {
    let start = Instant::now();
    // What is wrong with the options is said before anything is touched.
    place.destination().check_crf(options.crf)?;
    let mut views = options.view.resolve()?;
    views.refuse_still()?;
    let gap = options.stream.gap()?;
    let depth = options.stream.depth_from()?;
    let fit = choice_or_default("--fit", options.fit.as_deref())?;
    let settings = options.stream.settings(fit, machine)?;
    let emit = match (&options.emit, place.destination()) {
        (Some(list), _) => Emit::parse(list, &["rgb", "depth", "alpha", "exr", "scene", "ply", "tracks"])?,
        (None, Destination::Folder(_)) => Emit { rgb: true, scene: true, ..Emit::default() },
        (None, Destination::Video(..)) => Emit { rgb: true, ..Emit::default() },
    };
    [views.options.depth, views.options.alpha] = emit.planes();
    if options.fps.is_some_and(|fps| !(fps.is_finite() && fps > 0.0)) || options.frames == Some(0) {
        return Err(Failure::usage("--fps and --frames: expected numbers above 0"));
    }
    let source = Source::open(input, &source::Options { fps: options.fps, matrix: options.matrix()? })?;
    options.motion.follow(&mut views, source.fps())?;
    console.note(source.notes());
    let said = source.notes().len();
    let pace = Pace { fps: source.fps(), uneven: source.is_uneven() && views.times.is_none() };
    if pace.uneven && matches!(place.destination(), Destination::Video(_, VideoFormat::Y4m)) {
        console.note(&[format!(
            "y4m holds no times: images follow each other at {:.3} a second, unlike the frames",
            pace.fps
        )]);
    }
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
    // Errors of maps and networks come before anything is written.
    let depth = KeyDepth::open(&depth, &source, machine.level()?, reuse, options.frames)?;
    console.note(depth.notes());
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
    outputs.quality(options.crf);
    // That nothing can be written is said before the model is loaded.
    let loaded = Engine::new(settings).map_err(Failure::from).and_then(|engine| {
        let drawing = Drawing::new(engine.workers(), views.backend)?;
        let terms = terms.map_or_else(|| Terms::given(options, &model_record(options)?), Ok)?;
        Ok((engine, drawing, terms))
    });
    let (engine, mut drawing, terms) = match loaded {
        Ok(loaded) => loaded,
        Err(failure) => {
            outputs.withdraw(place);
            return Err(failure);
        }
    };
    let mut keys = KeyFrames::new(source, depth, gap, keep, options.frames, &console.stop);
    let whole = gap.depends_on_images() && emit.draws() && views.is_the_sources_own();
    keys.compare_whole(whole);
    let before = if let Found::Under(point, _) = &found { point.choices.as_ref() } else { None };
    let keys = Ahead::resume(keys, engine.workers().threads(), before);
    let mut closeness = gap.depends_on_images().then(|| Closeness::new(engine.workers())).transpose()?;
    if let Some((closeness, choices)) = closeness.as_mut().zip(before) {
        closeness.resume(choices);
    }
    let of_before = if let Found::Under(point, _) = &found { point.whole } else { None };
    let whole = whole.then(|| of_before.map(Whole::resume).unwrap_or_default());

    let mut times = Times { asked: views.times.as_deref(), next: 0 };
    let progress = Progress::new("frames", keys.total(), console);
    let account = Account::default();
    let (drawing, span, stop) = (&mut drawing, None, console.stop.clone());
    let mut stream = Stream {
        keys,
        engine,
        outputs,
        drawing,
        closeness,
        whole,
        progress,
        stop,
        page,
        account,
        emit,
        dropped: 0,
        span,
        key: 0,
    };
    let resumed = match &found {
        Found::Under(point, resume) => {
            if let Err(failure) = catch_up(&mut stream, &mut times, &views, point, resume.as_ref()) {
                stream.outputs.abandon(place);
                return Err(failure);
            }
            true
        }
        _ => {
            stream.outputs.start(stream.keys.fps(), pace)?;
            false
        }
    };
    let complete = match stream.pass(&mut times, &views, &RunOrigin { terms: &terms, input, resumed }) {
        Ok(complete) => complete,
        Err(failure) => {
            stream.outputs.abandon(place);
            return Err(failure);
        }
    };
    let Stream {
        keys,
        engine,
        outputs,
        closeness,
        whole,
        mut progress,
        page,
        account,
        dropped,
        span,
        key: key_frames,
        ..
    } = stream;
    let Some((first, last)) = span else {
        return Err(Failure::work(format!("{}: the video has no frame", input.display())));
    };
    if complete
        && (emit.draws() || emit.ply)
        && let Some(time) = times.left()
    {
        outputs.abandon(place);
        return Err(Failure::usage(format!("--times: {time} s lies outside the video ({first} s to {last} s)")));
    }
    progress.phase("frames; finishing the files");
    let Finished { outputs: written, notes } = drawing.writing(|| outputs.finish())?;
    progress.finish();
    console.note(&notes);
    if let Some(page) = &page {
        page.complete();
    }

    let mut work = account.of(engine.work());
    // The time of a stage's part is in the stage's.
    let stages = engine.work().stages().iter().filter(|stage| !stage.stage.contains('.'));
    let mut seconds = stages.map(|stage| (stage.stage.to_owned(), stage.time.as_secs_f64())).collect();
    drawing.account(&mut work, &mut seconds);
    if let Some(closeness) = &closeness {
        closeness.account(&mut work, &mut seconds);
    }
    let read = keys.account();
    // What was found on the way.
    console.note(read.notes.get(said..).unwrap_or_default());
    seconds.insert("decode".into(), read.time.as_secs_f64());
    if let Some(network) = &read.network {
        let unit = "frames".to_owned();
        work.insert("depth".into(), WorkRecord { done: network.done, avoided: network.avoided, unit });
        seconds.insert("depth".into(), network.time.as_secs_f64());
    }
    let options = with_absolute_paths(options);
    let network = options.stream.depth_network().zip(read.network.as_ref());
    let depth = network.map(|(file, network)| NetworkRecord::of(Path::new(file), &network.runtime)).transpose()?;
    let record = Record {
        program: PROGRAM.to_owned(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        build: Build::this(),
        seed: options.stream.seed,
        model: Some(model_record(&options)?),
        depth,
        input: keys.input(input),
        renderer: drawing.renderer(),
        task: Invocation::Run(Box::new(options)),
        complete,
        outputs: written,
        work,
        dropped: dropped + drawing.counts.dropped,
        image_size: drawing.counts.size,
        key_frames: Some(key_frames),
        psnr: closeness.as_ref().and_then(Closeness::mean),
        psnr_source_size: whole.as_ref().and_then(Whole::mean),
        timing: Timing::of(start, seconds, engine.workers()),
    };
    Ok((record, page))
}

/// The sound of the input, where the video that is written takes it along: at the times of the input's own frames alone.
fn taken_along(source: &Source, options: &RunOptions, destination: &Destination) -> Option<Sound> {
    let own_times = options.view.times.is_none() && options.fps.is_none();
    let wanted = !options.no_audio && own_times && holds_sound(destination.path());
    source.sound().filter(|_| wanted)
}

/// A place in the working directory, named after the input: a video where the input is an encoded one and images and scene are wanted alone, else a folder.
fn named_after(input: &Path, emit: Option<&str>) -> Result<PathBuf, Failure> {
    let stem = input.file_stem().filter(|_| input != Path::new("-"));
    let Some(stem) = stem else {
        return Err(Failure::usage("--out: expected, as the input has no name to make one of"));
    };
    let mut name = stem.to_owned();
    name.push("-scene");
    if emit.is_none() && source::is_encoded(input) {
        name.push(".mp4");
    }
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
