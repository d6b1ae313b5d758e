//! Frames from image files: the images of a folder, or the frames of one file.

use std::path::{Path, PathBuf};

use super::SourceError;
use super::decode::{self, Sequence, Several, Still};
use crate::folder;
use crate::picture::Picture;

/// Image files being read, one frame at a time.
pub(super) struct Images {
    /// A file per frame, or the one file of all frames.
    files: Vec<PathBuf>,
    /// The frames of the one file, if it has several.
    sequence: Option<Sequence>,
    /// The first frame, read ahead for its notes.
    ahead: Option<Result<Option<Still>, SourceError>>,
    next: usize,
    notes: Vec<String>,
}

impl Images {
    /// Opens the images of a folder in natural order, a frame each.
    ///
    /// # Errors
    /// A folder that cannot be read or has no image.
    pub fn folder(path: &Path) -> Result<Images, SourceError> {
        let files = folder::images(path).map_err(SourceError::read(path))?;
        if files.is_empty() {
            return Err(SourceError::EmptyFolder { path: path.to_owned() });
        }
        let mut images = Images::new(files, None);
        let others = folder::others(path).map_err(SourceError::read(path))?;
        if let Some(name) = others.first().and_then(|first| first.file_name()) {
            let more = others.len() - 1;
            let more = if more > 0 { format!(", and {more} more") } else { String::new() };
            let name = name.display();
            images.notes.insert(0, format!("left out, as it is no image of a kind that is read: {name}{more}"));
        }
        Ok(images)
    }

    /// Opens the frames of one file.
    ///
    /// # Errors
    /// A file that cannot be read, or one of several frames that is broken from its start.
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
        // The error of a broken first image is returned with the first frame.
        images.ahead = Some(images.read());
        images
    }

    /// Returns the files, if each is a frame.
    pub fn files(&self) -> Option<&[PathBuf]> {
        self.sequence.is_none().then_some(&self.files)
    }

    /// Returns the number of frames.
    pub fn frames(&self) -> usize {
        self.sequence.as_ref().map_or(self.files.len(), Sequence::len)
    }

    /// Returns the frames per second as a fraction, if the file has a constant rate.
    pub fn rate(&self) -> Option<(u64, u64)> {
        self.sequence.as_ref().and_then(Sequence::rate)
    }

    /// Returns the seconds from the first frame to the last and the number of frames, if durations differ.
    pub fn uneven(&self) -> Option<(f64, usize)> {
        self.sequence.as_ref().and_then(|sequence| Some((*sequence.times()?.last()?, sequence.len())))
    }

    /// Returns the time of frame `index`, in seconds since the first, if durations differ.
    pub fn time(&self, index: usize) -> Option<f64> {
        self.sequence.as_ref()?.times()?.get(index).copied()
    }

    /// Returns notes on the conversions of the frames read so far, including one read ahead; each line once.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Returns the next frame and its file; `None` at the end.
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
