//! Frames from image files: those of a folder, or the one file's.

use std::path::{Path, PathBuf};

use super::decode::{self, Sequence, Several, Still};
use super::{SourceError, folder};
use crate::picture::Picture;

/// Image files being read, a frame at a time.
pub(super) struct Images {
    /// A frame each, or the one file of all frames.
    files: Vec<PathBuf>,
    /// The frames of the one file, where it has several.
    sequence: Option<Sequence>,
    /// The first frame, read ahead for its notes.
    ahead: Option<Result<Option<Still>, SourceError>>,
    next: usize,
    notes: Vec<String>,
}

impl Images {
    /// The images of a folder in natural order, a frame each.
    ///
    /// # Errors
    /// A folder that cannot be read or holds no image.
    pub fn folder(path: &Path) -> Result<Images, SourceError> {
        Ok(Images::new(folder::images(path)?, None))
    }

    /// The frames of one file.
    ///
    /// # Errors
    /// A file that cannot be read, or of several frames that are broken from their start.
    pub fn file(path: &Path) -> Result<Images, SourceError> {
        let bytes = decode::read_file(path)?;
        let sequence = match Several::of(&bytes, path)? {
            Some(several) => Some(Sequence::open(bytes, path, several)?),
            None => None,
        };
        Ok(Images::new(vec![path.to_owned()], sequence))
    }

    fn new(files: Vec<PathBuf>, sequence: Option<Sequence>) -> Images {
        let mut images = Images { files, sequence, ahead: None, next: 0, notes: Vec::new() };
        // A broken first image is the error of the first frame.
        images.ahead = Some(images.read());
        images
    }

    /// The files, where each is a frame.
    pub fn files(&self) -> Option<&[PathBuf]> {
        self.sequence.is_none().then_some(&self.files)
    }

    /// How many frames there are.
    pub fn frames(&self) -> usize {
        self.sequence.as_ref().map_or(self.files.len(), Sequence::len)
    }

    /// Frames per second as a fraction, if the file has a constant rate.
    pub fn rate(&self) -> Option<(u64, u64)> {
        self.sequence.as_ref().and_then(Sequence::rate)
    }

    /// Seconds from the first frame to the last and the number of frames, where they are not shown equally long.
    pub fn uneven(&self) -> Option<(f64, usize)> {
        self.sequence.as_ref().and_then(|sequence| Some((*sequence.times()?.last()?, sequence.len())))
    }

    /// When frame `index` is shown, in seconds since the first, where frames are not shown equally long.
    pub fn time(&self, index: usize) -> Option<f64> {
        self.sequence.as_ref()?.times()?.get(index).copied()
    }

    /// Conversions of the frames read so far, and of the next one if already read; each line once.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// The next frame and its file; `None` at the end.
    ///
    /// # Errors
    /// A frame that cannot be read.
    pub fn next(&mut self) -> Result<Option<(PathBuf, Picture)>, SourceError> {
        let still = match self.ahead.take() {
            Some(read) => read?,
            None => self.read()?,
        };
        Ok(still.map(|still| {
            self.next += 1;
            let file = if self.sequence.is_some() { 0 } else { self.next - 1 };
            (self.files[file].clone(), still.picture)
        }))
    }

    fn read(&mut self) -> Result<Option<Still>, SourceError> {
        let still = match &mut self.sequence {
            Some(sequence) => sequence.next()?,
            None => match self.files.get(self.next) {
                Some(file) => Some(decode::still(&decode::read_file(file)?, file)?),
                None => None,
            },
        };
        for note in still.iter().flat_map(|still| &still.notes) {
            if !self.notes.contains(note) {
                self.notes.push(note.clone());
            }
        }
        Ok(still)
    }
}
