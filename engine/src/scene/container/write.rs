//! Writing a container, interval by interval.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use super::chunk::encode;
use super::index::{Entry, TRAILER, Table, header};
use super::quantise::Quantised;
use super::read::TOGETHER;
use super::{ALONE_EVERY, MOST};
use crate::formats::Limits;
use crate::output::{OutputError, Partial, Written};
use crate::scene::frames::listed;
use crate::scene::{PlacementRecord, SceneError};
use crate::stream::{Interval, Workers};

/// A container being written. It holds two intervals at most, however long the scene.
pub struct ContainerWriter {
    path: PathBuf,
    partial: Partial,
    file: BufWriter<File>,
    hasher: blake3::Hasher,
    at: u64,
    fps: f64,
    table: Option<Table>,
    /// Frames of the intervals so far.
    frames: usize,
    /// The records of the last interval.
    before: Vec<Quantised>,
}

impl ContainerWriter {
    /// Begins a container under a temporary name. It gets its own name when it is [finished](Self::finish), and is
    /// removed otherwise.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn create(path: &Path, fps: f64) -> Result<ContainerWriter, OutputError> {
        let partial = Partial::create(path)?;
        let file = File::options().write(true).open(partial.path()).map_err(OutputError::write(path))?;
        let mut writer = ContainerWriter {
            path: path.to_owned(),
            partial,
            file: BufWriter::new(file),
            hasher: blake3::Hasher::new(),
            at: 0,
            fps,
            table: None,
            frames: 0,
            before: Vec::new(),
        };
        writer.write(&header())?;
        Ok(writer)
    }

    fn write(&mut self, bytes: &[u8]) -> Result<(), OutputError> {
        self.hasher.update(bytes);
        self.at += bytes.len() as u64;
        self.file.write_all(bytes).map_err(OutputError::write(&self.path))
    }

    /// Appends an interval, encoded by `workers`, whose frames have the scene's rate. Records with numbers that are not
    /// finite are left out and counted.
    ///
    /// # Errors
    /// Files that cannot be written; arrays of different lengths; more than 2²⁴ records or merges; another placement
    /// than before; intervals that do not follow each other in time.
    pub fn push(&mut self, interval: &Interval, workers: &Workers) -> Result<(), SceneError> {
        self.push_with(interval, &[], workers)
    }

    /// As [`push`](Self::push), with the times of the interval's `frames` after the interval before, in seconds, or
    /// with none.
    ///
    /// # Errors
    /// As [`push`](Self::push).
    pub fn push_with(&mut self, interval: &Interval, frames: &[f64], workers: &Workers) -> Result<(), SceneError> {
        let broken = |cause: String| SceneError::Broken { path: self.path.clone(), cause };
        let g = &interval.gaussians;
        if let Some((array, found)) = g.uneven() {
            return Err(broken(format!("{array}: expected {} records, found {found}", g.len())));
        }
        if g.len().max(interval.merges.len()) > MOST {
            return Err(broken(format!("expected at most {MOST} records, found {}", g.len())));
        }
        let placement = PlacementRecord::from(interval.placement);
        let (mut count, mut last) = (0, f64::NEG_INFINITY);
        if let Some(table) = &self.table {
            (count, last) = (table.entries.len(), table.entries.last().map_or(last, |e| e.end));
            if table.placement != placement {
                return Err(broken(format!("expected one placement, found {placement:?} after {:?}", table.placement)));
            }
        }
        if !(last <= interval.start && interval.start <= interval.end && interval.end.is_finite()) {
            let (start, end) = (interval.start, interval.end);
            return Err(broken(format!("expected ascending times, found {start} to {end} after {last}")));
        }
        let (records, bytes) = workers.install(|| {
            let records: Vec<Quantised> = g.iter().filter(|r| r.is_sound()).map(|r| Quantised::of(&r)).collect();
            let before = if count.is_multiple_of(ALONE_EVERY) { &[] } else { self.before.as_slice() };
            let bytes = encode(before, &records, &interval.merges);
            (records, bytes)
        });
        let first = self.table.as_ref().and_then(|table| table.entries.first()).map_or(interval.start, |e| e.start);
        let entry = Entry {
            at: self.at,
            bytes: bytes.len() as u64,
            start: interval.start,
            end: interval.end,
            index: interval.index,
            dropped: interval.dropped + (g.len() - records.len()) as u64,
            gaussians: records.len(),
            merges: interval.merges.len(),
            back: count % ALONE_EVERY,
            blake3: *blake3::hash(&bytes).as_bytes(),
            frames: listed(first, self.fps, &mut self.frames, interval.end, frames),
        };
        self.write(&bytes)?;
        let fps = self.fps;
        self.table.get_or_insert_with(|| Table { fps, placement, entries: Vec::new() }).entries.push(entry);
        self.before = records;
        Ok(())
    }

    /// Writes the index and renames the file to its name; `None`, and no file, when there was no interval.
    ///
    /// # Errors
    /// Files that cannot be written; more Gaussians or merges than [`Limits`] allow a file of its size.
    pub fn finish(mut self) -> Result<Option<Written>, OutputError> {
        let Some(table) = self.table.take() else { return Ok(None) };
        let (at, index) = (self.at, table.to_bytes());
        let size = at + index.len() as u64 + TRAILER as u64;
        // A file of equal Gaussians can be so small that readers take it for an attack.
        table.check(size, &Limits::default(), TOGETHER).map_err(|refused| OutputError::Write {
            path: self.path.clone(),
            cause: io::Error::other(format!("readers would refuse it: {refused}")),
        })?;
        let digest = blake3::hash(&[&header()[..], &index].concat());
        self.write(&index)?;
        self.write(&at.to_le_bytes())?;
        self.write(&(index.len() as u64).to_le_bytes())?;
        self.write(digest.as_bytes())?;
        self.file.flush().map_err(OutputError::write(&self.path))?;
        drop(self.file);
        self.partial.keep()?;
        Ok(Some(Written { bytes: self.at, blake3: self.hasher.finalize().to_hex().to_string() }))
    }
}
