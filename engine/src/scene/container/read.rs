//! Reading a container, one interval at a time.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use super::chunk::decode;
use super::index::{Entry, HEADER, TRAILER, Table, check_header};
use super::quantise::Quantised;
use super::{CONTAINER_VERSION, MAGIC};
use crate::fit::Placement;
use crate::formats::{FormatError, Limits};
use crate::scene::read::{MERGE, RECORD};
use crate::scene::{FORMAT, Index, IntervalEntry, SceneError};
use crate::stream::{DynamicGaussians, Interval, Merge};

/// Times the limit's ratio that all intervals together may take, where they are read one at a time.
pub(super) const TOGETHER: u64 = 4;
/// Largest index read, in bytes.
const MAX_INDEX: u64 = 1 << 26;

/// A container on disk, with its index in memory. Chunks are read on demand.
#[derive(Clone, Debug)]
pub(in crate::scene) struct Container {
    path: PathBuf,
    entries: Vec<Entry>,
    /// The interval that was read last, required by the one after it.
    last: Arc<Mutex<Option<(usize, Vec<Quantised>)>>>,
}

impl Container {
    /// Returns true if a file with these first bytes is a container.
    pub(in crate::scene) fn begins(head: &[u8]) -> bool {
        head.starts_with(&MAGIC)
    }

    /// Opens a container and converts its index to that of a scene.
    pub(in crate::scene) fn open(path: &Path, limits: &Limits) -> Result<(Container, Index), SceneError> {
        let read = |cause| SceneError::Read { path: path.to_owned(), cause };
        let broken = |e: FormatError| SceneError::Broken { path: path.to_owned(), cause: e.to_string() };
        let mut file = File::open(path).map_err(read)?;
        let size = file.metadata().map_err(read)?.len();
        if size < (HEADER + TRAILER) as u64 {
            let expected = format!("at least {} bytes", HEADER + TRAILER);
            return Err(broken(FormatError::new("container", expected, size.to_string())));
        }
        let mut header = [0; HEADER];
        file.read_exact(&mut header).map_err(read)?;
        check_header(&header).map_err(broken)?;
        let trailer_at = size - TRAILER as u64;
        let mut trailer = [0; TRAILER];
        file.seek(SeekFrom::Start(trailer_at)).and_then(|_| file.read_exact(&mut trailer)).map_err(read)?;
        let (at, length) = locate(&trailer, size).map_err(broken)?;
        let mut index = vec![0; length as usize];
        file.seek(SeekFrom::Start(at)).and_then(|_| file.read_exact(&mut index)).map_err(read)?;
        if blake3::hash(&[&header[..], &index].concat()).as_bytes()[..] != trailer[16..] {
            return Err(broken(FormatError::new("index", "the digest that the trailer says", "another")));
        }
        let table = Table::from_bytes(&index, at).map_err(broken)?;
        table.check(size, limits, TOGETHER).map_err(broken)?;
        let intervals = table.entries.iter().enumerate().map(|(i, e)| IntervalEntry {
            file: i.to_string(),
            start: e.start,
            end: e.end,
            gaussians: e.gaussians,
            bytes: e.bytes,
            blake3: blake3::Hash::from_bytes(e.blake3).to_hex().to_string(),
            frames: e.frames.clone(),
        });
        let index = Index {
            format: format!("{FORMAT}-container"),
            version: CONTAINER_VERSION,
            fps: table.fps,
            placement: table.placement,
            intervals: intervals.collect(),
        };
        Ok((Container { path: path.to_owned(), entries: table.entries, last: Arc::default() }, index))
    }

    /// Reads interval `i`, and the ones before it that its coding requires, starting from the last one read if
    /// possible.
    pub(in crate::scene) fn interval(&self, i: usize, placement: Placement) -> Result<Interval, SceneError> {
        let alone = i - self.entries[i].back;
        // The value is only ever replaced, so it is valid even after a panic of a thread that held the lock.
        let kept = self.last.lock().unwrap_or_else(std::sync::PoisonError::into_inner).take();
        let (from, mut records) = match kept {
            Some((at, records)) if (alone..i).contains(&at) => (at + 1, records),
            _ => (alone, Vec::new()),
        };
        let mut merges = Vec::new();
        for j in from..=i {
            (records, merges) = self.chunk(j, if j == alone { &[] } else { &records })?;
        }
        let interval = self.entries[i].interval(&records, merges, placement);
        *self.last.lock().unwrap_or_else(std::sync::PoisonError::into_inner) = Some((i, records));
        Ok(interval)
    }

    fn chunk(&self, i: usize, before: &[Quantised]) -> Result<(Vec<Quantised>, Vec<Merge>), SceneError> {
        let entry = &self.entries[i];
        let read = |cause| SceneError::Read { path: self.path.clone(), cause };
        let broken =
            |cause: String| SceneError::Broken { path: self.path.clone(), cause: format!("interval {i}: {cause}") };
        let mut file = File::open(&self.path).map_err(read)?;
        // The index was checked against the file's length, but the file may have been truncated since.
        let mut bytes = Vec::new();
        file.seek(SeekFrom::Start(entry.at)).map_err(read)?;
        file.take(entry.bytes).read_to_end(&mut bytes).map_err(read)?;
        if *blake3::hash(&bytes).as_bytes() != entry.blake3 {
            return Err(broken("expected the digest that the index says, found another".into()));
        }
        decode(before, &bytes, entry.gaussians, entry.merges).map_err(|e| broken(e.to_string()))
    }
}

/// Position and length of the index in a file of `size` bytes.
fn locate(trailer: &[u8], size: u64) -> Result<(u64, u64), FormatError> {
    let [at, length] = [0, 8].map(|i| trailer[i..].first_chunk().map_or(0, |b| u64::from_le_bytes(*b)));
    if at.checked_add(length) != size.checked_sub(TRAILER as u64) || length > MAX_INDEX || at < HEADER as u64 {
        let found = format!("{length} bytes at {at} of {size}");
        return Err(FormatError::new("trailer", "an index that ends where it begins", found));
    }
    Ok((at, length))
}

/// Reads all intervals of a container in memory. Digests are not compared: they detect decay of files, and bytes in
/// memory are the caller's responsibility.
///
/// # Errors
/// Expected and found values.
pub fn intervals_from_container(bytes: &[u8]) -> Result<Vec<Interval>, FormatError> {
    let size = bytes.len();
    check_header(bytes)?;
    let (at, length) =
        locate(size.checked_sub(TRAILER).and_then(|from| bytes.get(from..)).unwrap_or(&[0; 16]), size as u64)?;
    let table = Table::from_bytes(&bytes[at as usize..(at + length) as usize], at)?;
    table.check(size as u64, &Limits::default(), 1)?;
    let placement = table.placement.placement().ok_or_else(|| FormatError::new("index", "a placement", "none"))?;
    let mut before = Vec::new();
    let mut intervals = Vec::with_capacity(table.entries.len());
    for entry in &table.entries {
        let known: &[Quantised] = if entry.back == 0 { &[] } else { &before };
        let chunk = &bytes[entry.at as usize..(entry.at + entry.bytes) as usize];
        let (records, merges) = decode(known, chunk, entry.gaussians, entry.merges)?;
        intervals.push(entry.interval(&records, merges, placement));
        before = records;
    }
    Ok(intervals)
}

impl Table {
    /// Checks the Gaussians of each interval, and the memory of the intervals of a file of `size` bytes, against the
    /// limits: one interval against the limit, all of them against `together` times its ratio.
    pub(super) fn check(&self, size: u64, limits: &Limits, together: u64) -> Result<(), FormatError> {
        let all = Limits { ratio: limits.ratio.saturating_mul(together), ..*limits };
        for (i, entry) in self.entries.iter().enumerate() {
            let part = format!("interval {i}");
            limits.check_count(&part, entry.gaussians)?;
            limits.check_memory(&part, "Gaussians", entry.gaussians as u64, RECORD, size)?;
        }
        let records: u64 = self.entries.iter().map(|entry| entry.gaussians as u64).sum();
        let merges: u64 = self.entries.iter().map(|entry| entry.merges as u64).sum();
        all.check_memory("intervals", "Gaussians", records, RECORD, size)?;
        all.check_memory("intervals", "merges", merges, MERGE, size)
    }
}

impl Entry {
    /// The interval with these records.
    fn interval(&self, records: &[Quantised], merges: Vec<Merge>, placement: Placement) -> Interval {
        let gaussians: DynamicGaussians = records.iter().map(Quantised::record).collect();
        let Entry { index, start, end, dropped, .. } = *self;
        Interval { index, start, end, gaussians, placement, merges, dropped }
    }
}
