//! Reading a scene.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use super::container::Container;
use super::{FORMAT, INDEX, Index, IntervalEntry, SceneError, VERSION, from_safetensors};
use crate::fit::Placement;
use crate::formats::{Limits, read_file};
use crate::stream::Interval;

/// Largest index read, in bytes.
const MAX_INDEX: u64 = 1 << 26;
/// Bytes of an interval's file in addition to its records, at most.
const MAX_OVERHEAD: u64 = 1 << 20;
/// Bytes of one Gaussian's record.
pub(super) const RECORD: u64 = 110;
/// Bytes of one merge.
pub(super) const MERGE: u64 = 16;

/// A scene on disk: its index in memory, its intervals read on demand.
#[derive(Clone, Debug)]
pub struct Scene {
    place: Place,
    index: Index,
    placement: Placement,
}

/// Where the intervals are.
#[derive(Clone, Debug)]
enum Place {
    Folder(PathBuf),
    Container(Container),
}

impl Scene {
    /// Opens the scene in the folder `path` (or that of the `scene.json` at `path`, or in `path/scene`), or the
    /// container `path`.
    ///
    /// # Errors
    /// An index that cannot be read, is of another format or version, or has impossible values.
    pub fn open(path: &Path) -> Result<Scene, SceneError> {
        Scene::open_within(path, &Limits::default())
    }

    /// As [`Scene::open`], within other limits.
    ///
    /// # Errors
    /// As [`Scene::open`], and intervals of more Gaussians than allowed.
    pub fn open_within(path: &Path, limits: &Limits) -> Result<Scene, SceneError> {
        let file = if path.is_file() {
            path.to_owned()
        } else if !path.join(INDEX).exists() && path.join("scene").join(INDEX).exists() {
            path.join("scene").join(INDEX)
        } else {
            path.join(INDEX)
        };
        let broken = |cause: String| SceneError::Broken { path: file.clone(), cause };
        if begins_as_container(&file)? {
            let (container, index) = Container::open(&file, limits)?;
            let placement = index.placement.placement().ok_or_else(|| broken("placement".into()))?;
            return Ok(Scene { place: Place::Container(container), index, placement });
        }
        let text = read_file(&file, MAX_INDEX).map_err(unreadable(&file))?;
        let index = Index::from_json(&text).map_err(broken)?;
        index.check_counts(limits).map_err(broken)?;
        // `Index::from_json` has checked it.
        let placement = index.placement.placement().ok_or_else(|| broken("no placement".into()))?;
        let folder = file.parent().unwrap_or(Path::new("")).to_owned();
        Ok(Scene { place: Place::Folder(folder), index, placement })
    }

    /// Contents of `scene.json`.
    pub fn index(&self) -> &Index {
        &self.index
    }

    /// Placement of the source's frame in the model's input.
    pub fn placement(&self) -> Placement {
        self.placement
    }

    /// The scene's first and last time in seconds.
    pub fn span(&self) -> (f64, f64) {
        let intervals = &self.index.intervals;
        (intervals[0].start, intervals[intervals.len() - 1].end)
    }

    /// The interval that shows `time`: at a common end of two, the earlier one that has a length (the image is the
    /// same).
    ///
    /// # Errors
    /// Times outside the scene.
    pub fn find(&self, time: f64) -> Result<usize, SceneError> {
        let (start, end) = self.span();
        let intervals = &self.index.intervals;
        let holds = |i: &usize| intervals[*i].start <= time && time <= intervals[*i].end;
        let first = intervals.partition_point(|entry| entry.end < time);
        let candidates = || (first..intervals.len()).take(3).filter(holds);
        let found = candidates().find(|&i| intervals[i].end > intervals[i].start).or_else(|| candidates().next());
        found.ok_or(SceneError::Time { time, start, end })
    }

    /// Reads interval `i` of the index.
    ///
    /// # Errors
    /// A file that cannot be read, has another digest than in the index, or is not an interval.
    ///
    /// # Panics
    /// When `i` is out of range.
    pub fn interval(&self, i: usize) -> Result<Interval, SceneError> {
        let entry = &self.index.intervals[i];
        let path = match &self.place {
            Place::Container(container) => return container.interval(i, self.placement),
            Place::Folder(folder) => folder.join(&entry.file),
        };
        let broken = |cause: String| SceneError::Broken { path: path.clone(), cause };
        let size = std::fs::metadata(&path).map_err(|cause| SceneError::Read { path: path.clone(), cause })?.len();
        // Merges end identities: at most one per record of the interval before.
        let most = entry.gaussians as u64 * (RECORD + MERGE) + (1 << 28) + MAX_OVERHEAD;
        if size != entry.bytes || size > most {
            return Err(broken(format!("expected {} bytes as {INDEX} says, found {size}", entry.bytes)));
        }
        let bytes = read_file(&path, size).map_err(unreadable(&path))?;
        let found = blake3::hash(&bytes).to_hex();
        if found.as_str() != entry.blake3 {
            return Err(broken(format!("expected the digest {} as {INDEX} says, found {found}", entry.blake3)));
        }
        let interval = from_safetensors(&bytes, self.placement).map_err(broken)?;
        if interval.gaussians.len() != entry.gaussians || (interval.start, interval.end) != (entry.start, entry.end) {
            return Err(broken(format!("the file does not hold the interval that {INDEX} names")));
        }
        Ok(interval)
    }
}

impl Index {
    /// Reads the text of a `scene.json`. Lengths, times, names and the placement are checked; the listed files are not
    /// read.
    ///
    /// # Errors
    /// Text that is not an index, is of another format or version, or has impossible values: expected and found values.
    pub fn from_json(text: &[u8]) -> Result<Index, String> {
        let index: Index = serde_json::from_slice(text).map_err(|e| format!("not a scene's index: {e}"))?;
        if index.format != FORMAT || index.version != VERSION {
            return Err(format!(
                "expected {FORMAT} version {VERSION}, found {} version {}",
                index.format, index.version
            ));
        }
        if index.placement.placement().is_none() {
            return Err(format!(
                "placement: expected the content inside the model's input, found {:?}",
                index.placement
            ));
        }
        if !(index.fps.is_finite() && index.fps > 0.0) {
            return Err(format!("fps: expected a number above 0, found {}", index.fps));
        }
        if index.intervals.is_empty() {
            return Err("the scene has no interval".into());
        }
        let mut before = f64::NEG_INFINITY;
        let mut files = BTreeMap::new();
        for (i, entry) in index.intervals.iter().enumerate() {
            entry.check(before).map_err(|cause| format!("interval {i}: {cause}"))?;
            before = entry.end;
            if let Some(first) = files.insert(entry.file.as_str(), i) {
                return Err(format!(
                    "interval {i}: expected a file of its own, found {:?} of interval {first}",
                    entry.file
                ));
            }
        }
        Ok(index)
    }
}

impl Index {
    /// Returns an error where an interval has more Gaussians than allowed.
    fn check_counts(&self, limits: &Limits) -> Result<(), String> {
        let check = |(i, entry): (usize, &IntervalEntry)| limits.check_count(&format!("interval {i}"), entry.gaussians);
        self.intervals.iter().enumerate().try_for_each(check).map_err(|e| e.to_string())
    }
}

impl IntervalEntry {
    /// Returns an error unless the interval follows the time `before`, its file is in the scene's folder, and its
    /// counts are within the limits of reading.
    fn check(&self, before: f64) -> Result<(), String> {
        let Self { file, start, end, gaussians, frames, .. } = self;
        if !(start.is_finite() && end.is_finite() && before <= *start && start <= end) {
            return Err(format!("expected ascending times, found {start} to {end} after {before}"));
        }
        super::frames::check(frames, *start, *end)?;
        if file.contains(['/', '\\']) || file.starts_with('.') {
            return Err(format!("expected a file name without a folder, found {file:?}"));
        }
        if *gaussians as u64 > (1 << 40) / RECORD {
            return Err(format!("{gaussians} Gaussians are more than this program reads"));
        }
        Ok(())
    }
}

fn begins_as_container(path: &Path) -> Result<bool, SceneError> {
    let read = |cause| SceneError::Read { path: path.to_owned(), cause };
    let mut head = Vec::new();
    File::open(path).map_err(read)?.take(8).read_to_end(&mut head).map_err(read)?;
    Ok(Container::begins(&head))
}

fn unreadable(path: &Path) -> impl Fn(std::io::Error) -> SceneError {
    let path = path.to_owned();
    move |cause| SceneError::Read { path: path.clone(), cause }
}
