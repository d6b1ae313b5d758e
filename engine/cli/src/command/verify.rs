//! `verify`: repeats the work that a `run.json` describes and compares the results.

use std::path::{Path, PathBuf};

use streamsplat::recognise;
use streamsplat::run::{Run, digest, report};

use crate::command::render;
use crate::console::failure::Failure;
use crate::console::{Console, say, version};
use crate::options::args::VerifyArgs;
use streamsplat::run::outputs::{Destination, Emit, is_inside};
use streamsplat::run::place::Place;
use streamsplat::run::record::{Invocation, Record};
use streamsplat::source::MEMORY;

/// Compares the existing files with their digests, then repeats the work and compares again. Fails if one differs.
pub fn command(args: &VerifyArgs, console: &Console) -> Result<(), Failure> {
    let (record_path, folder) = if !args.dir.is_file() {
        (args.dir.join("run.json"), args.dir.clone())
    } else {
        (record_of(&args.dir)?, args.dir.parent().map(Path::to_owned).unwrap_or_default())
    };
    let record = Record::read(&record_path)?;
    if record.input.path == Path::new("-") {
        let message = format!("{}: the input was standard input, which cannot be read again", record_path.display());
        return Err(Failure::work(message));
    }
    if record.input.path == Path::new(MEMORY) {
        let message = format!(
            "{}: the input was frames in a program's memory, which cannot be read again",
            record_path.display()
        );
        return Err(Failure::work(message));
    }

    let mut differing: Vec<PathBuf> = Vec::new();
    for (name, expected) in &record.outputs {
        if !is_inside(name) {
            let message = format!("{}: expected outputs inside its folder, found {name:?}", record_path.display());
            return Err(Failure::work(message));
        }
        let path = folder.join(name);
        // Standard output leaves nothing on disk.
        let found = if path.exists() { digest::file(&path)? } else { "none: the file is missing".to_owned() };
        if found != expected.blake3 {
            differ(console, &path.display().to_string(), &expected.blake3, &found)?;
            differing.push(path);
        }
    }

    if args.dir.is_dir() {
        for (name, cause) in beside(&folder, &record)? {
            differ(console, &folder.join(&name).display().to_string(), "what the record names", &cause)?;
            differing.push(folder.join(name));
        }
    }

    let outside = record.outputs.values().filter(|output| output.outside_contract).count();
    if outside > 0 && outside == record.outputs.len() {
        let message = format!(
            "{}: its images were drawn by {}, outside of the bit contract, and there is nothing else: a repetition gives other bytes",
            record_path.display(),
            record.renderer
        );
        return Err(Failure::work(message));
    }
    let scratch = tempfile::tempdir().map_err(|e| Failure::work(format!("cannot make a temporary folder: {e}")))?;
    let video = record.outputs.iter().find(|(_, output)| output.samples.is_some() && !output.outside_contract);
    let out = scratch.path().join(video.map_or("out", |(name, _)| name));
    let input = &record.input.path;
    let again = match &record.task {
        Invocation::Run(options) => {
            let mut options = options.clone();
            if !record.complete {
                options.frames = Some(record.input.count);
            }
            if outside > 0 {
                // Images drawn by a graphics card are not compared.
                let has = |folder: &str| record.outputs.keys().any(|name| name.starts_with(folder));
                let (scene, ply, tracks) = (has("scene/"), has("ply/"), has("tracks/"));
                options.emit = Some(Emit { scene, ply, tracks, ..Emit::default() });
                options.view.renderer = None;
            }
            let run = Run::new(input, *options).machine(args.machine.clone()).program(version::commit());
            run.out(&out).finish()?
        }
        Invocation::Render(_) if !record.complete => {
            return Err(Failure::work(format!("{}: the rendering was stopped; run it again", record_path.display())));
        }
        Invocation::Render(options) => {
            let wrong = |e| Failure::work(format!("{}: not the record of a rendering: {e}", record_path.display()));
            let options = serde_json::from_value(options.clone()).map_err(wrong)?;
            // The repetition prints nothing.
            let quiet = Console { quiet: true, ..Console::default() };
            render::render(input, &mut Place::new(Destination::of(&out)), &options, &args.machine, &quiet)?
        }
    };

    let model = |record: &Record| record.model.as_ref().map_or_else(|| "none".to_owned(), |model| model.blake3.clone());
    let network =
        |record: &Record| record.depth.as_ref().map_or_else(|| "none".to_owned(), |network| network.blake3.clone());
    for (what, expected, found) in [
        ("the model", model(&record), model(&again)),
        ("the depth network", network(&record), network(&again)),
        ("the input", record.input.blake3.clone(), again.input.blake3.clone()),
    ] {
        if expected != found {
            differ(console, what, &expected, &found)?;
            differing.push(what.into());
        }
    }
    let within = |record: &'_ Record| -> Vec<String> {
        record.outputs.iter().filter(|(_, output)| !output.outside_contract).map(|(name, _)| name.clone()).collect()
    };
    let mut names = [within(&record), within(&again)].concat();
    names.sort();
    names.dedup();
    for name in names {
        // Videos are compared by their encoded frames: the bytes of a video depend on the version of ffmpeg.
        let digest = |record: &Record| match record.outputs.get(&name) {
            Some(output) => output.samples.clone().unwrap_or_else(|| output.blake3.clone()),
            None => "none: the file is missing".to_owned(),
        };
        let (expected, found) = (digest(&record), digest(&again));
        if expected != found {
            let name = format!("{name}, repeated");
            differ(console, &name, &expected, &found)?;
            differing.push(name.into());
        }
    }
    let runtime = |record: &Record| record.depth.as_ref().map_or_else(String::new, |network| network.runtime.clone());
    if !differing.is_empty() && runtime(&record) != runtime(&again) {
        // Another runtime is no difference in itself, but its arithmetic may differ.
        differ(console, "what runs the depth network", &runtime(&record), &runtime(&again))?;
    }
    if let Some(first) = differing.first() {
        let (count, of) = (differing.len(), record.outputs.len());
        return Err(Failure::work(format!(
            "{}: the digest differs ({count} differences, {of} files)",
            first.display()
        )));
    }
    if !console.quiet {
        let (threads, isa) = (again.timing.threads, &again.timing.isa);
        let files = record.outputs.len() - outside;
        let images = match outside {
            0 => String::new(),
            n => format!(
                "; {n} images drawn by {} are outside of the bit contract and were not repeated",
                record.renderer
            ),
        };
        say(format!("{}: {files} files, all digests equal ({threads} threads, {isa}){images}", record_path.display()))?;
    }
    Ok(())
}

fn differ(console: &Console, what: &str, expected: &str, found: &str) -> Result<(), Failure> {
    if console.quiet { Ok(()) } else { say(format!("{what}: expected {expected}, found {found}")) }
}

/// Returns the path of a record: the file itself, or `FILE.run.json` for a video.
fn record_of(file: &Path) -> Result<PathBuf, Failure> {
    let Some(wrong) = recognise::not_a_record(file) else { return Ok(file.to_owned()) };
    let mut beside = file.as_os_str().to_owned();
    beside.push(".run.json");
    let beside = PathBuf::from(beside);
    if beside.is_file() { Ok(beside) } else { Err(Failure::work(format!("{}: {wrong}", file.display()))) }
}

/// Returns the files in a folder of results that its record does not name, and a report that does not match the record;
/// each with a description.
fn beside(folder: &Path, record: &Record) -> Result<Vec<(String, String)>, Failure> {
    let mut wrong = Vec::new();
    let mut folders = vec![(folder.to_owned(), String::new())];
    while let Some((path, prefix)) = folders.pop() {
        let unreadable = |e: std::io::Error| Failure::work(format!("{}: {e}", path.display()));
        for entry in std::fs::read_dir(&path).map_err(unreadable)? {
            let entry = entry.map_err(unreadable)?;
            let name = format!("{prefix}{}", entry.file_name().to_string_lossy());
            let kind = entry.file_type().map_err(unreadable)?;
            let own = ["run.json", "resume", ".streamsplat.lock"].contains(&name.as_str());
            if name == "report.md" {
                let expected = report::markdown(record);
                if std::fs::read(entry.path()).map_err(unreadable)? != expected.as_bytes() {
                    wrong.push((name, "another report than the record's".to_owned()));
                }
            } else if kind.is_dir() && !own {
                folders.push((entry.path(), format!("{name}/")));
            } else if !own && !record.outputs.contains_key(&name) {
                wrong.push((name, "a file that the record does not name".to_owned()));
            }
        }
    }
    wrong.sort();
    Ok(wrong)
}
