//! The index: position and properties of each interval's chunk.

use super::{ALONE_EVERY, CONTAINER_VERSION, MAGIC, MOST};
use crate::formats::FormatError;
use crate::scene::PlacementRecord;
use crate::scene::frames::check;

/// Bytes before the first chunk.
pub(super) const HEADER: usize = 16;
/// Bytes after the index: its position, its length, its digest.
pub(super) const TRAILER: usize = 48;
/// Bytes of the index before its entries.
const BEFORE_ENTRIES: usize = 44;
/// Bytes of an entry.
const ENTRY: usize = 96;

/// The first bytes of a container.
pub(super) fn header() -> [u8; HEADER] {
    let mut out = [0; HEADER];
    out[..8].copy_from_slice(&MAGIC);
    out[8..12].copy_from_slice(&CONTAINER_VERSION.to_le_bytes());
    out
}

/// Returns an error unless `bytes` begin with the header of a container of this version.
pub(super) fn check_header(bytes: &[u8]) -> Result<(), FormatError> {
    if bytes.starts_with(&header()) {
        return Ok(());
    }
    match bytes.strip_prefix(&MAGIC).and_then(|rest| rest.first_chunk()).map(|b| u64::from_le_bytes(*b)) {
        Some(version) => {
            Err(FormatError::new("header", format!("version {CONTAINER_VERSION}"), format!("version {version}")))
        }
        None => Err(FormatError::new("header", "a container's first bytes", "others")),
    }
}

/// One interval.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Entry {
    pub(super) at: u64,
    pub(super) bytes: u64,
    pub(super) start: f64,
    pub(super) end: f64,
    pub(super) index: u64,
    pub(super) dropped: u64,
    pub(super) gaussians: usize,
    pub(super) merges: usize,
    /// Number of chunks back to the last independent one.
    pub(super) back: usize,
    pub(super) blake3: [u8; 32],
    /// Times of the source's frames in it; none if they follow from the rate.
    pub(super) frames: Vec<f64>,
}

/// The whole index.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Table {
    pub(super) fps: f64,
    pub(super) placement: PlacementRecord,
    pub(super) entries: Vec<Entry>,
}

impl Table {
    /// The index as bytes.
    pub(super) fn to_bytes(&self) -> Vec<u8> {
        let mut out = Vec::with_capacity(BEFORE_ENTRIES + ENTRY * self.entries.len());
        out.extend_from_slice(&self.fps.to_le_bytes());
        let PlacementRecord { source, model, offset, content } = self.placement;
        for side in [source, model, offset, content].as_flattened() {
            out.extend_from_slice(&(*side as u32).to_le_bytes());
        }
        out.extend_from_slice(&(self.entries.len() as u32).to_le_bytes());
        for e in &self.entries {
            let words = [e.at, e.bytes, e.start.to_bits(), e.end.to_bits(), e.index, e.dropped];
            words.iter().for_each(|word| out.extend_from_slice(&word.to_le_bytes()));
            let counts = [e.gaussians as u32, e.merges as u32, e.back as u32, e.frames.len() as u32];
            counts.iter().for_each(|count| out.extend_from_slice(&count.to_le_bytes()));
            out.extend_from_slice(&e.blake3);
        }
        let times = self.entries.iter().flat_map(|e| &e.frames);
        times.for_each(|time| out.extend_from_slice(&time.to_le_bytes()));
        out
    }

    /// Reads the index of a container whose chunks end at `end`.
    pub(super) fn from_bytes(bytes: &[u8], end: u64) -> Result<Table, FormatError> {
        let wrong = |what: String, expected: &str, found: String| Err(FormatError::new(what, expected, found));
        let mut fields = Fields(bytes);
        let short = || FormatError::new("index", "44 bytes and 96 for each interval", format!("{} bytes", bytes.len()));
        let fps = f64::from_bits(fields.word().ok_or_else(short)?);
        let mut sides = [0; 8];
        for side in &mut sides {
            *side = fields.half().ok_or_else(short)? as usize;
        }
        let [a, b, c, d, e, f, g, h] = sides;
        let placement = PlacementRecord { source: [a, b], model: [c, d], offset: [e, f], content: [g, h] };
        if placement.placement().is_none() {
            return wrong("index: placement".into(), "the content inside the model's input", format!("{placement:?}"));
        }
        if !(fps.is_finite() && fps > 0.0) {
            return wrong("index: frames per second".into(), "a number above 0", fps.to_string());
        }
        let count = fields.half().ok_or_else(short)? as usize;
        let after = BEFORE_ENTRIES.saturating_add(ENTRY.saturating_mul(count));
        let Some(times) = bytes.get(after..).filter(|_| count > 0) else {
            return wrong(
                "index".into(),
                "44 bytes and 96 for each of at least one interval",
                format!("{} for {count}", bytes.len()),
            );
        };
        let (mut rest, mut listed) = (Fields(times), 0_usize);
        let mut entries: Vec<Entry> = Vec::with_capacity(count);
        let mut next = HEADER as u64;
        for i in 0..count {
            let (mut entry, frames) = fields.entry().ok_or_else(short)?;
            let name = |what: &str| format!("index: interval {i}: {what}");
            let after = entry.at.checked_add(entry.bytes).filter(|after| *after <= end);
            if entry.at != next || after.is_none() {
                return wrong(
                    name("place"),
                    "its chunk after the one before and before the index",
                    format!("{} bytes at {}", entry.bytes, entry.at),
                );
            }
            next += entry.bytes;
            let before = entries.last().map_or(f64::NEG_INFINITY, |last| last.end);
            let ordered = before <= entry.start && entry.start <= entry.end;
            if !(entry.start.is_finite() && entry.end.is_finite() && ordered) {
                return wrong(
                    name("times"),
                    "ascending ones",
                    format!("{} to {} after {before}", entry.start, entry.end),
                );
            }
            if entry.gaussians > MOST || entry.merges > MOST {
                return wrong(name("counts"), "at most 2^24", format!("{} and {}", entry.gaussians, entry.merges));
            }
            let chain = i.checked_sub(1).map_or(0, |last| entries[last].back + 1);
            if !(entry.back == 0 || (entry.back == chain && chain < ALONE_EVERY)) {
                return wrong(
                    name("chunks back"),
                    "none, or one more than of the interval before, under 8",
                    entry.back.to_string(),
                );
            }
            entry.frames = (0..frames).map_while(|_| rest.word().map(f64::from_bits)).collect();
            check(&entry.frames, entry.start, entry.end)
                .map_err(|cause| FormatError::new(format!("index: interval {i}"), "times of frames in order", cause))?;
            listed += frames;
            entries.push(entry);
        }
        if times.len() != listed.saturating_mul(8) {
            return wrong("index: times of frames".into(), "8 bytes for each", format!("{} for {listed}", times.len()));
        }
        if next != end {
            return wrong("index".into(), "chunks up to the index", format!("their end at {next} of {end}"));
        }
        Ok(Table { fps, placement, entries })
    }
}

/// Fields being read.
struct Fields<'a>(&'a [u8]);

impl Fields<'_> {
    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (first, rest) = self.0.split_first_chunk()?;
        self.0 = rest;
        Some(*first)
    }

    fn word(&mut self) -> Option<u64> {
        self.take().map(u64::from_le_bytes)
    }

    fn half(&mut self) -> Option<u32> {
        self.take().map(u32::from_le_bytes)
    }

    /// Reads an entry, and its number of times of frames.
    fn entry(&mut self) -> Option<(Entry, usize)> {
        let [at, bytes, start, end, index, dropped] =
            [self.word()?, self.word()?, self.word()?, self.word()?, self.word()?, self.word()?];
        let [gaussians, merges, back, frames] = [self.half()?, self.half()?, self.half()?, self.half()?];
        let blake3 = self.take()?;
        let entry = Entry {
            at,
            bytes,
            start: f64::from_bits(start),
            end: f64::from_bits(end),
            index,
            dropped,
            gaussians: gaussians as usize,
            merges: merges as usize,
            back: back as usize,
            blake3,
            frames: Vec::new(),
        };
        Some((entry, frames as usize))
    }
}
