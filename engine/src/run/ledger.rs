//! `written.jsonl`: one line per file of a run under way, in the order of writing.
//!
//! A line is appended before its file gets its name, so that every file has a line. Only the part covered by the last
//! [`Point`](crate::run::resume_state::Point) counts.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

use crate::output::storage::{self, Output};
use crate::output::{OutputError, Written, prepare_subfolder};
use crate::scene::IntervalEntry;
use serde::{Deserialize, Serialize};

use crate::run::Error;
use crate::run::earlier::is_as_written;
use crate::run::outputs::is_inside;
use crate::run::record::OutputRecord;

/// The ledger's name.
const NAME: &str = "written.jsonl";

/// One file.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Line {
    /// Its path inside the run's folder.
    pub file: String,
    pub bytes: u64,
    pub blake3: String,
    /// Its entry in the scene's index, where it is an interval.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub interval: Option<IntervalEntry>,
}

/// A ledger being written.
pub struct Ledger {
    folder: PathBuf,
    file: Option<Output>,
    length: u64,
}

impl Ledger {
    /// A new ledger in `folder`, created with the first line.
    pub fn new(folder: PathBuf) -> Ledger {
        Ledger { folder, file: None, length: 0 }
    }

    /// Reopens a ledger, truncated to `length` bytes.
    pub fn resume(folder: PathBuf, length: u64) -> Result<Ledger, OutputError> {
        let path = folder.join(NAME);
        let write = |cause| OutputError::Write { path: path.clone(), cause };
        let mut file = storage::reopen(&path).map_err(write)?;
        file.cut(length).map_err(write)?;
        Ok(Ledger { folder, file: Some(file), length })
    }

    /// Folder of the ledger.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Its length in bytes.
    pub fn length(&self) -> u64 {
        self.length
    }

    /// Adds a file.
    pub fn add(&mut self, file: &str, written: &Written, interval: Option<&IntervalEntry>) -> Result<(), OutputError> {
        let Written { bytes, blake3 } = written.clone();
        let line = Line { file: file.to_owned(), bytes, blake3, interval: interval.cloned() };
        let write = |cause| OutputError::Write { path: self.folder.join(NAME), cause };
        let mut text = serde_json::to_string(&line).map_err(|e| write(e.into()))?;
        text.push('\n');
        let ledger = match &mut self.file {
            Some(ledger) => ledger,
            none => {
                prepare_subfolder(&self.folder)?;
                none.insert(storage::create(&self.folder.join(NAME)).map_err(write)?)
            }
        };
        ledger.write_all(text.as_bytes()).map_err(write)?;
        self.length += text.len() as u64;
        Ok(())
    }
}

impl Ledger {
    /// Waits until the added lines would survive a power loss.
    pub fn sync(&self) -> Result<(), OutputError> {
        let synced = self.file.as_ref().map_or(Ok(()), Output::sync);
        synced.map_err(|cause| OutputError::Write { path: self.folder.join(NAME), cause })
    }
}

/// The lines in the first `length` bytes of the ledger in `folder`.
pub fn read(folder: &Path, length: u64) -> Result<Vec<Line>, Error> {
    let path = folder.join(NAME);
    let wrong = |e: &dyn std::fmt::Display| Error::work(format!("{}: {e}", path.display()));
    let mut text = String::new();
    if length > 0 {
        let file = File::open(&path).map_err(|e| wrong(&e))?;
        file.take(length).read_to_string(&mut text).map_err(|e| wrong(&e))?;
    }
    if text.len() as u64 != length {
        return Err(wrong(&format!("expected {length} bytes, found {}", text.len())));
    }
    let line = |line| serde_json::from_str::<Line>(line).map_err(|e| wrong(&format!("not a list of files: {e}")));
    let lines = text.lines().map(line).collect::<Result<Vec<_>, _>>()?;
    match lines.iter().find(|line| !is_inside(&line.file)) {
        Some(line) => Err(wrong(&format!("expected files inside the run's folder, found {:?}", line.file))),
        None => Ok(lines),
    }
}

/// Longest ledger read where the valid length is unknown, in bytes.
const MAX_LEDGER: u64 = 1 << 28;

/// All files that the ledger in `folder` may list, in whatever state it is.
pub fn all(folder: &Path) -> Vec<Line> {
    let (path, mut text) = (folder.join(NAME), Vec::new());
    if storage::regular(&path).is_err() {
        return Vec::new();
    }
    // An unreadable ledger lists nothing.
    let _ = File::open(path).and_then(|file| file.take(MAX_LEDGER).read_to_end(&mut text));
    let lines = text.split(|byte| *byte == b'\n').filter_map(|line| serde_json::from_slice::<Line>(line).ok());
    lines.filter(|line| is_inside(&line.file)).collect()
}

/// Removes the ledger in `folder`.
pub fn remove(folder: &Path) -> std::io::Result<()> {
    match storage::remove(&folder.join(NAME)) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(e),
        _ => Ok(()),
    }
}

/// The records of the files of `lines`; each file must be in `folder` unchanged.
pub fn verified(folder: &Path, lines: &[Line]) -> Result<BTreeMap<String, OutputRecord>, Error> {
    let mut records = BTreeMap::new();
    for Line { file, bytes, blake3, .. } in lines {
        if !is_as_written(folder, file, *bytes, blake3)? {
            let path = folder.join(file);
            return Err(Error::work(format!(
                "{}: expected the file as it was written, {bytes} bytes with the digest {blake3}",
                path.display()
            )));
        }
        records.insert(
            file.clone(),
            OutputRecord { bytes: *bytes, blake3: blake3.clone(), samples: None, outside_contract: false },
        );
    }
    Ok(records)
}
