//! Video output: y4m is written here (to a file or to standard output), anything else by an installed `ffmpeg` program.
//!
//! ffmpeg reads 8-bit RGB, each frame with its own time ([`matroska`]), and encodes it as 4:2:0 video ([`encode`]). The
//! matrix is BT.601 in WebP, whose format has no other, and in AVIF; it is BT.709 elsewhere. Formats with colour tags
//! are tagged. Sound from the source is added after the last picture, so that both end together ([`sound`]). A file is
//! renamed to its final name once its trailer and all of its frames are found in it ([`check`]).

mod check;
mod encode;
mod matroska;
mod resume;
mod sound;
mod y4m;

use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use super::storage::{self, Output};
use super::{OutputError, Written, folder_of, partial_name};
use crate::picture::Picture;
use crate::source::Sound;
use encode::Encoder;
pub use encode::qualities;
pub use resume::VideoPoint;
pub use sound::holds_sound;

/// Endings of video files, the first written by this library, the others by ffmpeg.
pub const VIDEOS: [&str; 9] = ["y4m", "mp4", "webm", "mkv", "mov", "m4v", "gif", "webp", "avif"];

/// Kinds of video.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VideoFormat {
    /// Uncompressed.
    Y4m,
    /// The format that ffmpeg chooses by the file's name.
    Ffmpeg,
}

impl VideoFormat {
    /// The format of a file of this name; `None` for other names.
    pub fn of(path: &Path) -> Option<VideoFormat> {
        let extension = path.extension()?.to_str()?.to_ascii_lowercase();
        match extension.as_str() {
            "y4m" => Some(VideoFormat::Y4m),
            other => VIDEOS.contains(&other).then_some(VideoFormat::Ffmpeg),
        }
    }
}

/// A finished video.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finished {
    /// The file, unless the video went to standard output.
    pub file: Option<Written>,
    /// Digest of the 8-bit samples that were pushed: equal on every machine, with any ffmpeg.
    pub samples: String,
    /// Frames.
    pub frames: usize,
    /// Differences between the file and the pushed frames, one per line.
    pub notes: Vec<String>,
}

/// Timing of frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pace {
    /// Frames per second, on average.
    pub fps: f64,
    /// False if every frame has its time at this rate.
    pub uneven: bool,
}

impl Pace {
    /// A constant rate.
    pub fn even(fps: f64) -> Pace {
        Pace { fps, uneven: false }
    }
}

/// A video being written.
pub struct Video {
    path: PathBuf,
    pace: Pace,
    format: VideoFormat,
    sound: Option<Sound>,
    quality: Option<u8>,
    sink: Option<Sink>,
    size: Option<(usize, usize)>,
    samples: blake3::Hasher,
    frames: usize,
    /// Times of the first and the last frame.
    span: (f64, f64),
}

enum Sink {
    File { file: BufWriter<Output>, digest: Box<blake3::Hasher>, bytes: u64 },
    Stdout(std::io::Stdout),
    Ffmpeg(Encoder),
}

impl Video {
    /// A video at `path`; `-` is y4m on standard output. Nothing is created before the first frame, but a folder that
    /// cannot be written is an error at once.
    ///
    /// # Errors
    /// The folder cannot be written.
    pub fn create(path: &Path, format: VideoFormat, pace: Pace) -> Result<Video, OutputError> {
        if path != Path::new("-") {
            let partial = partial_name(path);
            storage::create(&partial).and_then(|_| storage::remove(&partial)).map_err(OutputError::write(path))?;
        }
        Ok(Video::create_beside(path, format, pace))
    }

    fn create_beside(path: &Path, format: VideoFormat, pace: Pace) -> Video {
        Video {
            path: path.to_owned(),
            pace,
            format,
            sound: None,
            quality: None,
            sink: None,
            size: None,
            samples: blake3::Hasher::new(),
            frames: 0,
            span: (0.0, 0.0),
        }
    }

    /// Encodes at this constant rate factor, one of [`qualities`], instead of the default.
    pub fn with_quality(mut self, quality: Option<u8>) -> Video {
        self.quality = quality;
        self
    }

    /// Adds sound, if files of this kind can hold it ([`holds_sound`]): copied if the kind supports its codec,
    /// otherwise encoded again.
    pub fn with_sound(mut self, sound: Option<Sound>) -> Video {
        self.sound = sound.filter(|_| holds_sound(&self.path));
        self
    }

    fn open(&mut self, width: usize, height: usize) -> Result<&mut Sink, OutputError> {
        let sink = match self.sink.take() {
            Some(sink) => sink,
            None => {
                let mut sink = if self.path == Path::new("-") {
                    Sink::Stdout(std::io::stdout())
                } else if self.format == VideoFormat::Y4m {
                    let file = storage::create(&partial_name(&self.path)).map_err(OutputError::write(&self.path))?;
                    Sink::File { file: BufWriter::new(file), digest: Box::default(), bytes: 0 }
                } else {
                    Sink::Ffmpeg(Encoder::start(&self.path, (width, height), self.pace, self.quality)?)
                };
                if self.format == VideoFormat::Y4m {
                    let header = y4m::header(width, height, self.pace.fps);
                    sink.write(header.as_bytes()).map_err(OutputError::write(&self.path))?;
                }
                sink
            }
        };
        Ok(self.sink.insert(sink))
    }

    fn ffmpeg_error(&self, cause: impl Into<String>) -> OutputError {
        OutputError::Ffmpeg { path: self.path.clone(), cause: cause.into() }
    }

    /// Appends a frame that is shown at `time`, in seconds. y4m stores only a rate and ignores `time`. Elsewhere a
    /// frame is shown at least a millisecond after the one before.
    ///
    /// # Errors
    /// A frame of another size than the first; errors of the system or of ffmpeg. On standard output the earlier frames
    /// stay readable; a file is discarded.
    pub fn push(&mut self, picture: &Picture, time: f64) -> Result<(), OutputError> {
        let found = (picture.width, picture.height);
        let expected = *self.size.get_or_insert(found);
        if expected != found {
            return Err(OutputError::FrameSize { path: self.path.clone(), expected, found });
        }
        let bytes = match self.format {
            VideoFormat::Y4m => y4m::frame(picture),
            VideoFormat::Ffmpeg => picture.to_rgb8(),
        };
        self.samples.update(&bytes);
        self.span = (if self.frames == 0 { time } else { self.span.0 }, time);
        let since = time - self.span.0;
        let result = match self.open(found.0, found.1)? {
            Sink::Ffmpeg(encoder) => encoder.push(bytes, since),
            other => other.write(&bytes),
        };
        if let Err(cause) = result {
            return Err(match self.sink.take() {
                // ffmpeg's message is more specific than a closed pipe.
                Some(Sink::Ffmpeg(encoder)) => {
                    let said = encoder.finish().err().unwrap_or_else(|| cause.to_string());
                    let _ = storage::remove(&partial_name(&self.path));
                    self.ffmpeg_error(said)
                }
                other => {
                    self.sink = other;
                    OutputError::Write { path: self.path.clone(), cause }
                }
            });
        }
        self.frames += 1;
        Ok(())
    }

    /// Completes the file and renames it to its final name.
    ///
    /// # Errors
    /// Errors of the system or of ffmpeg, and an incomplete file. The new file is then discarded, and an earlier one of
    /// the same name is unchanged.
    pub fn finish(mut self) -> Result<Finished, OutputError> {
        let partial = partial_name(&self.path);
        let mut notes = Vec::new();
        let file = match self.sink.take() {
            None => None,
            Some(Sink::Stdout(mut out)) => {
                out.flush().map_err(OutputError::write(&self.path))?;
                None
            }
            Some(Sink::File { mut file, digest, bytes }) => {
                let named = file.flush().and_then(|()| file.get_ref().sync());
                let named = named.and_then(|()| storage::rename(&partial, &self.path));
                named.and_then(|()| storage::sync_folder(folder_of(&self.path))).map_err(|cause| {
                    let _ = storage::remove(&partial);
                    OutputError::Write { path: self.path.clone(), cause }
                })?;
                Some(Written { bytes, blake3: digest.finalize().to_hex().to_string() })
            }
            Some(Sink::Ffmpeg(encoder)) => {
                notes.extend(encoder.note());
                let frames = self.frames - encoder.left_out;
                let whole = encoder.finish().and_then(|()| self.complete(&partial, frames));
                notes.extend(whole.map_err(|cause| {
                    let _ = storage::remove(&partial);
                    self.ffmpeg_error(cause)
                })?);
                let written = of_file(&partial).map_err(OutputError::write(&self.path))?;
                super::keep(&partial, &self.path)?;
                Some(written)
            }
        };
        Ok(Finished { file, samples: self.samples.finalize().to_hex().to_string(), frames: self.frames, notes })
    }

    /// Adds the sound to the pictures in the file `partial` and checks that all `frames` are there. Returns ffmpeg's
    /// message on the sound, if any.
    fn complete(&self, partial: &Path, frames: usize) -> Result<Option<String>, String> {
        #[cfg(test)]
        storage::faults::foreign(partial).map_err(|e| e.to_string())?;
        let kind = encode::container(&self.path);
        let Some(sound) = &self.sound else { return check::whole(partial, &kind, frames).map(|()| None) };
        // Checked before the sound is added, so that faults of the pictures are not reported as faults of the sound.
        check::whole(partial, &kind, frames)?;
        let seconds = self.span.1 - self.span.0 + 1.0 / self.pace.fps;
        let note = sound.join(partial, &kind, seconds)?;
        check::whole(partial, &kind, frames)?;
        Ok(note)
    }
}

impl Drop for Video {
    fn drop(&mut self) {
        match self.sink.take() {
            Some(Sink::Ffmpeg(encoder)) => {
                drop(encoder);
                let _ = storage::remove(&partial_name(&self.path));
            }
            Some(Sink::File { .. }) => {
                let _ = storage::remove(&partial_name(&self.path));
            }
            Some(Sink::Stdout(_)) | None => {}
        }
    }
}

impl Sink {
    fn write(&mut self, content: &[u8]) -> std::io::Result<()> {
        match self {
            Sink::File { file, digest, bytes } => {
                digest.update(content);
                *bytes += content.len() as u64;
                file.write_all(content)
            }
            Sink::Stdout(out) => out.write_all(content).and_then(|()| out.flush()),
            Sink::Ffmpeg(encoder) => encoder.write(content),
        }
    }
}

/// Length and digest of an existing file.
fn of_file(path: &Path) -> std::io::Result<Written> {
    let file = std::fs::File::open(path)?;
    let bytes = file.metadata()?.len();
    let mut digest = blake3::Hasher::new();
    digest.update_reader(file)?;
    Ok(Written { bytes, blake3: digest.finalize().to_hex().to_string() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::{Options, Source};

    #[test]
    fn y4m_comes_back_within_two_levels() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("v.y4m");
        let bytes: Vec<u8> = (0..7 * 5 * 3).map(|i| (i * 41 % 256) as u8).collect();
        let picture = Picture::from_rgb8(7, 5, &bytes).expect("35 pixels");
        let mut video = Video::create(&path, VideoFormat::Y4m, Pace::even(30000.0 / 1001.0)).expect("writable");
        (0..3).for_each(|i| video.push(&picture, f64::from(i)).expect("writable"));
        assert!(!path.exists(), "named before it is whole");
        let finished = video.finish().expect("writable");
        let content = std::fs::read(&path).expect("readable");
        assert_eq!(finished.file, Some(Written::of(&content)));
        let mut source = Source::open(&path, &Options::default()).expect("valid");
        assert_eq!(source.fps(), 30000.0 / 1001.0);
        let mut frames = 0;
        while let Some(frame) = source.next_frame().expect("valid") {
            for (a, b) in frame.picture.rgb.iter().zip(&picture.rgb) {
                assert!((a - b).abs() <= 2.0 / 255.0, "{a} {b}");
            }
            frames += 1;
        }
        assert_eq!(frames, 3);
    }

    #[test]
    fn a_video_that_is_not_finished_leaves_nothing() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let mut video =
            Video::create(&folder.path().join("v.y4m"), VideoFormat::Y4m, Pace::even(24.0)).expect("writable");
        video.push(&Picture { width: 2, height: 2, rgb: vec![0.5; 12] }, 0.0).expect("writable");
        let other = Picture { width: 1, height: 2, rgb: vec![0.5; 6] };
        assert!(matches!(video.push(&other, 0.1), Err(OutputError::FrameSize { .. })));
        drop(video);
        assert_eq!(std::fs::read_dir(folder.path()).expect("readable").count(), 0);
        assert!(Video::create(Path::new("no/such/folder/v.y4m"), VideoFormat::Y4m, Pace::even(24.0)).is_err());
    }
}
