//! Resuming a y4m file that was stopped.

use std::io::{self, BufRead, BufReader, BufWriter, Read, Write};
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::{Pace, Sink, Video, VideoFormat};
use crate::output::storage::{self};
use crate::output::{OutputError, partial_name};

/// State of a y4m file: complete frames that were passed to the system.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct VideoPoint {
    /// Frames.
    pub frames: usize,
    /// Width and height of a frame.
    pub size: (usize, usize),
    /// Bytes.
    pub bytes: u64,
    /// BLAKE3 digest of these bytes.
    pub blake3: String,
}

impl Video {
    /// Resumes a y4m file at `point`, under its temporary name; a file that has its own name already is renamed back.
    /// The part beyond `point` is cut off.
    ///
    /// # Errors
    /// A file that cannot be read and written, or that differs before `point`.
    pub fn resume(path: &Path, fps: f64, point: &VideoPoint) -> Result<Video, OutputError> {
        let mut video = Video::create_beside(path, VideoFormat::Y4m, Pace::even(fps));
        let partial = partial_name(path);
        if !partial.exists() {
            storage::rename(path, &partial).map_err(OutputError::write(path))?;
        }
        let mut file = storage::reopen(&partial).map_err(OutputError::write(&partial))?;
        let mut digest = Box::<blake3::Hasher>::default();
        digests(Read::by_ref(&mut file).take(point.bytes), &mut digest, &mut video.samples)
            .map_err(OutputError::write(&partial))?;
        let found = digest.finalize().to_hex().to_string();
        if found != point.blake3 {
            let (expected, bytes) = (point.blake3.clone(), point.bytes);
            return Err(OutputError::Changed { path: partial, bytes, expected, found });
        }
        file.cut(point.bytes).map_err(OutputError::write(&partial))?;
        video.sink = Some(Sink::File { file: BufWriter::new(file), digest, bytes: point.bytes });
        (video.size, video.frames) = (Some(point.size), point.frames);
        Ok(video)
    }

    /// Returns true if the y4m file `path` can be resumed from `point`.
    pub fn can_resume(path: &Path, point: &VideoPoint) -> bool {
        let partial = partial_name(path);
        let path = if partial.exists() { &partial } else { path };
        let mut digest = blake3::Hasher::new();
        let read = storage::regular(path)
            .and_then(|_| std::fs::File::open(path))
            .and_then(|file| digests(file.take(point.bytes), &mut digest, &mut blake3::Hasher::new()));
        read.is_ok() && digest.finalize().to_hex().as_str() == point.blake3
    }

    /// Syncs the frames pushed so far and returns the point reached; `None` before the first frame, and where the video
    /// cannot be resumed (ffmpeg's, standard output).
    ///
    /// # Errors
    /// Errors of the system.
    pub fn point(&mut self) -> Result<Option<VideoPoint>, OutputError> {
        let (Some(Sink::File { file, digest, bytes }), Some(size)) = (&mut self.sink, self.size) else {
            return Ok(None);
        };
        file.flush().and_then(|()| file.get_ref().sync()).map_err(OutputError::write(&self.path))?;
        let blake3 = digest.finalize().to_hex().to_string();
        Ok(Some(VideoPoint { frames: self.frames, size, bytes: *bytes, blake3 }))
    }

    /// Leaves a y4m file under its temporary name, to be resumed.
    pub fn leave(mut self) {
        if let Some(Sink::File { file, .. }) = self.sink.take() {
            // Frames that could not be written are beyond the last point.
            drop(file);
        }
    }
}

/// Reads a y4m file: the digests of all of it, and of the part after its header.
fn digests(file: impl Read, all: &mut blake3::Hasher, samples: &mut blake3::Hasher) -> io::Result<()> {
    let mut rest = BufReader::with_capacity(1 << 16, file);
    let mut header = Vec::new();
    // The header written here is far shorter.
    Read::by_ref(&mut rest).take(1 << 16).read_until(b'\n', &mut header)?;
    all.update(&header);
    let mut block = vec![0; 1 << 16];
    loop {
        let count = rest.read(&mut block)?;
        if count == 0 {
            return Ok(());
        }
        all.update(&block[..count]);
        samples.update(&block[..count]);
    }
}
