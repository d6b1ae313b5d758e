//! Writing a scene while it grows.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use super::frames::listed;
use super::{FORMAT, INDEX, Index, IntervalEntry, SceneError, VERSION, to_safetensors};
use crate::fit::Placement;
use crate::output::{OutputError, Written, prepare_folder, storage, write_file, write_whole};
use crate::stream::Interval;

/// The index is rewritten at most this often, so that a long stream does not spend its time on it.
const INDEX_EVERY: Duration = Duration::from_secs(1);

/// A scene's folder being written.
pub struct SceneWriter {
    folder: PathBuf,
    fps: f64,
    index: Option<Index>,
    /// Frames of the intervals so far.
    frames: usize,
    indexed: Option<Instant>,
}

impl SceneWriter {
    /// Prepares the folder and removes an earlier scene's index, which would not match the new files.
    ///
    /// # Errors
    /// A folder that cannot be written.
    pub fn create(folder: &Path, fps: f64) -> Result<SceneWriter, OutputError> {
        prepare_folder(folder)?;
        match storage::remove(&folder.join(INDEX)) {
            Err(e) if e.kind() != std::io::ErrorKind::NotFound => {
                return Err(OutputError::write(folder.join(INDEX))(e));
            }
            _ => {}
        }
        Ok(SceneWriter { folder: folder.to_owned(), fps, index: None, frames: 0, indexed: None })
    }

    /// Continues the scene in `folder` after the `intervals` that are kept.
    ///
    /// # Errors
    /// A folder that cannot be written.
    pub fn resume(
        folder: &Path,
        fps: f64,
        placement: Placement,
        intervals: Vec<IntervalEntry>,
    ) -> Result<SceneWriter, OutputError> {
        prepare_folder(folder)?;
        let placement = placement.into();
        let index = Index { format: FORMAT.to_owned(), version: VERSION, fps, placement, intervals };
        let frames = index.frames().map_or(0, |frames| frames.len());
        Ok(SceneWriter { folder: folder.to_owned(), fps, index: Some(index), frames, indexed: None })
    }

    /// Writes an interval: first its file, then (at most once a second) the index that lists it. The source's frames
    /// are assumed to have the scene's rate.
    ///
    /// # Errors
    /// Files that cannot be written.
    pub fn push(&mut self, interval: &Interval) -> Result<(String, Written), SceneError> {
        let entry = self.push_after(interval, &[], |_| Ok(()))?;
        Ok((entry.file, Written { bytes: entry.bytes, blake3: entry.blake3 }))
    }

    /// As [`SceneWriter::push`], with the times of the interval's frames. `frames` holds, in seconds, those after the
    /// end of the previous interval; it may be empty. `announce` is called with the index entry before the file is
    /// written.
    ///
    /// # Errors
    /// Files that cannot be written, and errors of `announce`; nothing is written then.
    pub fn push_after(
        &mut self,
        interval: &Interval,
        frames: &[f64],
        announce: impl FnOnce(&IntervalEntry) -> Result<(), OutputError>,
    ) -> Result<IntervalEntry, SceneError> {
        let index = self.index.get_or_insert_with(|| Index {
            format: FORMAT.to_owned(),
            version: VERSION,
            fps: self.fps,
            placement: interval.placement.into(),
            intervals: Vec::new(),
        });
        let file = format!("interval-{:06}.safetensors", interval.index);
        let path = self.folder.join(&file);
        let bytes = to_safetensors(interval).map_err(|cause| SceneError::Broken { path: path.clone(), cause })?;
        let Written { bytes: length, blake3 } = Written::of(&bytes);
        let (start, end, gaussians) = (interval.start, interval.end, interval.gaussians.len());
        let first = index.intervals.first().map_or(start, |first| first.start);
        let frames = listed(first, self.fps, &mut self.frames, end, frames);
        let entry = IntervalEntry { file, start, end, gaussians, bytes: length, blake3, frames };
        announce(&entry)?;
        write_whole(&path, &bytes)?;
        index.intervals.push(entry.clone());
        if self.indexed.is_none_or(|at| at.elapsed() >= INDEX_EVERY) {
            self.write_index()?;
        }
        Ok(entry)
    }

    fn write_index(&mut self) -> Result<Option<Written>, SceneError> {
        let Some(index) = &self.index else { return Ok(None) };
        let path = self.folder.join(INDEX);
        let mut text = serde_json::to_string_pretty(index)
            .map_err(|e| SceneError::Broken { path: path.clone(), cause: e.to_string() })?;
        text.push('\n');
        let written = write_file(&path, text.as_bytes())?;
        self.indexed = Some(Instant::now());
        Ok(Some(written))
    }

    /// Writes the index of all intervals; `None` if there was none.
    ///
    /// # Errors
    /// Files that cannot be written.
    pub fn finish(mut self) -> Result<Option<(String, Written)>, SceneError> {
        Ok(self.write_index()?.map(|written| (INDEX.to_owned(), written)))
    }
}
