//! State of a run under way, from which it resumes after an interruption: by the user, by a failure, or by the system
//! at any moment.
//!
//! In the folder `resume` of the results (for a video `v.y4m`, `v.y4m.resume` next to it):
//!
//! - `written.jsonl`, the [ledger](crate::run::ledger): one line per file, appended before the file gets its name;
//! - `state.safetensors`, the [`Point`] and the stream's resume point, replaced by renaming after each whole interval;
//! - `state.before.safetensors`, the same for the interval before.
//!
//! After an interval its files, their folders, the ledger and the video are synced, and only then the state is written.
//! So everything that a state covers survives a power loss. If a state or something it covers is damaged nevertheless,
//! the previous one is used; if that is damaged too, the run starts again.
//!
//! The point is decisive: everything it covers was written before it, and everything later is written again. It holds
//! the stream's resume point *before* the last whole interval. So `--resume` reads the input from its beginning (the
//! digest of the frames read must be the same) and restores the resume point at the last key frame but one. It then
//! computes the last whole interval again, which must equal the stored one: two key frames of work. Where a resume
//! point does not suffice ([`Reuse::forgets`](crate::stream::Reuse)), the stream is computed from its start. When a run
//! is complete, the folder is removed.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

use crate::formats::read_file;
use crate::output::{OutputError, Video, VideoPoint, partial_name, storage};
use crate::scene::{resume_point_from_safetensors, resume_point_to_safetensors};
use crate::stream::ResumePoint;
use serde::{Deserialize, Serialize};

use crate::run::choices::Choices;
use crate::run::destination::Destination;
use crate::run::drawing::Anchor;
use crate::run::earlier::is_as_written;
use crate::run::record::{Counts, InputRecord, Invocation, Record, WorkRecord, absolute};
use crate::run::terms::Terms;
use crate::run::{Error, ledger};

/// The point's file.
const STATE: &str = "state.safetensors";
/// The file of the previous point.
const BEFORE: &str = "state.before.safetensors";
/// Longest file of a point that is read, in bytes.
const MAX_STATE: u64 = 1 << 32;

/// Progress of a run.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Point {
    /// Program version, options and model, which determine the output together with the input.
    pub terms: Terms,
    /// Input read so far.
    pub input: InputRecord,
    /// The last key frame whose interval is complete, with all its outputs.
    pub key: u64,
    /// First and last time of the scene so far, in seconds.
    pub span: (f64, f64),
    /// Number of requested times that are done.
    pub times: usize,
    /// The key frames chosen so far, where they depend on how close images are to frames.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub choices: Option<Choices>,
    /// PSNR at the source's size of all frames compared ([`Total::stored`](super::closeness::Total::stored)).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub whole: Option<(u64, usize, u64)>,
    /// The engine's account.
    pub work: BTreeMap<String, WorkRecord>,
    /// Gaussians left out by the engine.
    pub dropped: u64,
    /// The account of drawing.
    pub drawn: Counts,
    /// First image of a moving camera.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub anchor: Option<Anchor>,
    /// Valid length of the ledger in bytes.
    pub ledger: u64,
    /// The video, where the result is one.
    pub video: Option<VideoPoint>,
}

/// State that `--resume` finds.
#[derive(Debug)]
pub enum Found {
    /// Nothing: the run starts.
    Nothing,
    /// A complete run.
    Complete(Box<Record>),
    /// An interrupted run to resume.
    Under(Box<(Point, Option<ResumePoint>)>),
}

/// Looks for what a run to `destination` left.
pub fn find(destination: &Destination) -> Result<Found, Error> {
    let Some(folder) = destination.resume() else {
        let message = "--resume: expected a folder or a .y4m file as --out; standard output and encoded videos cannot be gone on with";
        return Err(Error::usage(message));
    };
    let record = destination.record().filter(|path| path.exists());
    // A record that cannot be read is ignored: the resume state is used alone, or the run starts again.
    let record = record.as_deref().and_then(|path| match Record::read(path) {
        Ok(record) => Some(record),
        Err(damage) => {
            tell(&damage.to_string());
            None
        }
    });
    if let Some(record) = record.as_ref().filter(|record| record.complete) {
        return Ok(match check_outputs(record, destination) {
            Ok(()) => Found::Complete(Box::new(record.clone())),
            Err(damage) => {
                tell(&format!("{}; starting again", damage));
                Found::Nothing
            }
        });
    }
    let states = [STATE, BEFORE].map(|name| folder.join(name));
    if !states.iter().any(|path| path.exists()) {
        return match record {
            None => Ok(Found::Nothing),
            Some(_) => Err(Error::work(format!(
                "{}: not found, but there is the record of a stopped run; run again without --resume",
                states[0].display()
            ))),
        };
    }
    let mut points =
        states.iter().filter(|path| path.exists()).map(|path| point(path, &folder, destination)).peekable();
    while let Some(found) = points.next() {
        match found {
            Ok(both) => return Ok(Found::Under(Box::new(both))),
            Err(damage) => {
                let next = if points.peek().is_some() { "going back one interval" } else { "starting again" };
                tell(&format!("{}; {next}", damage));
            }
        }
    }
    Ok(Found::Nothing)
}

/// The point in the file `path`, if everything that it covers is intact.
fn point(path: &Path, folder: &Path, destination: &Destination) -> Result<(Point, Option<ResumePoint>), Error> {
    let wrong = |e: &dyn std::fmt::Display| Error::work(format!("{}: {e}", path.display()));
    storage::regular(path).map_err(|e| wrong(&e))?;
    let bytes = read_file(path, MAX_STATE).map_err(|e| wrong(&e))?;
    let (resume, note) = resume_point_from_safetensors(&bytes).map_err(|e| wrong(&e))?;
    let point: Point = serde_json::from_str(&note).map_err(|e| wrong(&format!("not the state of a run: {e}")))?;
    let lines = ledger::read(folder, point.ledger)?;
    match (destination, &point.video) {
        (Destination::Folder(folder), _) => drop(ledger::verified(folder, &lines)?),
        (Destination::Video(path, _), Some(video)) if !Video::can_resume(path, video) => {
            let VideoPoint { bytes, blake3, .. } = video;
            let expected = format!("expected its first {bytes} bytes to have the digest {blake3}");
            return Err(Error::work(format!("{}: {expected}", path.display())));
        }
        (Destination::Video(..), _) => {}
    }
    Ok((point, resume))
}

/// Checks that every file of a record has the recorded length and digest.
fn check_outputs(record: &Record, destination: &Destination) -> Result<(), Error> {
    let folder = match destination {
        Destination::Folder(folder) => folder,
        Destination::Video(path, _) => crate::output::folder_of(path),
    };
    for (name, output) in &record.outputs {
        if !is_as_written(folder, name, output.bytes, &output.blake3)? {
            let path = folder.join(name);
            let (bytes, blake3) = (output.bytes, &output.blake3);
            let expected = format!("expected the file as it was written, {bytes} bytes with the digest {blake3}");
            return Err(Error::work(format!("{}: {expected}", path.display())));
        }
    }
    Ok(())
}

fn tell(message: &str) {
    tracing::warn!("--resume: {message}");
}

/// Writes the point, with the stream's resume point before its interval. Everything that it covers must be synced.
pub fn commit(folder: &Path, point: &Point, resume: Option<&ResumePoint>) -> Result<(), Error> {
    let note = serde_json::to_string(point).map_err(Error::work)?;
    let bytes = resume_point_to_safetensors(resume, &note).map_err(Error::work)?;
    let (state, before) = (folder.join(STATE), folder.join(BEFORE));
    let partial = partial_name(&state);
    let write = || {
        let mut file = storage::create(&partial)?;
        file.write_all(&bytes)?;
        file.sync()?;
        if state.exists() {
            storage::rename(&state, &before)?;
            // Until the next rename is durable, the previous state is the one to resume from.
            storage::sync_folder(folder)?;
        }
        storage::rename(&partial, &state)?;
        storage::sync_folder(folder)
    };
    write().map_err(|cause| {
        let _ = storage::remove(&partial);
        Error::from(OutputError::Write { path: state.clone(), cause })
    })
}

/// Removes the files that a complete run does not need; the point goes first.
pub fn remove(folder: &Path) -> Result<(), OutputError> {
    let done = |result: std::io::Result<()>| match result {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => {
            Err(OutputError::Write { path: folder.to_owned(), cause: e })
        }
        _ => Ok(()),
    };
    // Files behind a link do not belong to the run.
    if std::fs::symlink_metadata(folder).is_ok_and(|found| !found.is_dir()) {
        return Err(OutputError::Write {
            path: folder.to_owned(),
            cause: std::io::Error::other("expected a folder, found something else, such as a symbolic link"),
        });
    }
    done(storage::remove(&folder.join(STATE)))?;
    done(storage::remove(&folder.join(BEFORE)))?;
    done(storage::remove(&partial_name(&folder.join(STATE))))?;
    done(ledger::remove(folder))?;
    if !folder.exists() {
        return Ok(());
    }
    // The folder stays if it contains anything else.
    match storage::remove_folder(folder) {
        Err(e) if e.kind() == std::io::ErrorKind::DirectoryNotEmpty => Ok(()),
        other => done(other),
    }
}

/// Returns an error unless the complete run of `record` is the requested one.
pub fn check_complete(record: &Record, input: &Path, given: &Terms) -> Result<(), Error> {
    let Invocation::Run(options) = &record.task else {
        return Err(Error::usage("--resume: --out holds the results of render, not of run"));
    };
    let recorded = Terms::recorded(record, options)?;
    recorded.check(given)?;
    let input = absolute(input);
    if record.input.path != input {
        let (expected, found) = (record.input.path.display(), input.display());
        return Err(Error::work(format!("--resume: the input: recorded {expected}, given {found}")));
    }
    Ok(())
}
