//! Video out: y4m written here (to a file or to standard output), anything else by an installed `ffmpeg` program.
//!
//! y4m frames are 4:4:4, 8 bits, full range (`C444 XCOLORRANGE=FULL`), with the matrix that [`crate::source::y4m`] reads
//! pictures of their size with, each sample rounded half up. ffmpeg gets 8-bit RGB and makes BT.709 video (yuv420p) of it.

mod resume;

use std::io::{BufWriter, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread::JoinHandle;

use super::storage::{self, Output};
use super::{OutputError, Written, folder_of, partial_name};
use crate::picture::Picture;
use crate::source::y4m::convert::Matrix;
pub use resume::VideoPoint;

/// Endings of the videos that are written, the first by this library, the others by ffmpeg.
pub const VIDEOS: [&str; 9] = ["y4m", "mp4", "webm", "mkv", "mov", "m4v", "gif", "webp", "avif"];

/// Kinds of video.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VideoFormat {
    /// Uncompressed.
    Y4m,
    /// Whatever ffmpeg makes of the file's name.
    Ffmpeg,
}

impl VideoFormat {
    /// The format of a file of this name; `None` when it is no video's name.
    pub fn of(path: &Path) -> Option<VideoFormat> {
        let extension = path.extension()?.to_str()?.to_ascii_lowercase();
        match extension.as_str() {
            "y4m" => Some(VideoFormat::Y4m),
            other => VIDEOS.contains(&other).then_some(VideoFormat::Ffmpeg),
        }
    }
}

/// Sound to go with a video.
#[derive(Clone, Debug, PartialEq)]
pub struct Sound {
    /// The file that has it, of whose tracks the first is taken.
    pub file: PathBuf,
    /// Its codec, in ffmpeg's names.
    pub codec: String,
    /// Seconds of it that are taken; `None`: all.
    pub seconds: Option<f64>,
}

/// A finished video.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finished {
    /// The file, when it is one.
    pub file: Option<Written>,
    /// Digest of the 8-bit samples that went in: what two machines must agree on, whatever their ffmpeg.
    pub samples: String,
    /// Frames.
    pub frames: usize,
}

/// A video being written.
pub struct Video {
    path: PathBuf,
    fps: f64,
    format: VideoFormat,
    sound: Option<Sound>,
    sink: Option<Sink>,
    size: Option<(usize, usize)>,
    samples: blake3::Hasher,
    frames: usize,
}

enum Sink {
    File { file: BufWriter<Output>, digest: Box<blake3::Hasher>, bytes: u64 },
    Stdout(std::io::Stdout),
    Ffmpeg { child: Child, messages: JoinHandle<String> },
}

impl Video {
    /// A video of `fps` frames per second at `path`; `-` is y4m on standard output. Nothing is created before the first frame,
    /// but a folder that cannot be written is an error now.
    ///
    /// # Errors
    /// The folder cannot be written.
    pub fn create(path: &Path, format: VideoFormat, fps: f64) -> Result<Video, OutputError> {
        if path != Path::new("-") {
            let partial = partial_name(path);
            storage::create(&partial).and_then(|_| storage::remove(&partial)).map_err(OutputError::write(path))?;
        }
        Ok(Video::create_beside(path, format, fps))
    }

    fn create_beside(path: &Path, format: VideoFormat, fps: f64) -> Video {
        let samples = blake3::Hasher::new();
        Video { path: path.to_owned(), fps, format, sound: None, sink: None, size: None, samples, frames: 0 }
    }

    /// The same with sound, where files of this kind hold any ([`holds_sound`]): copied where such a file takes its codec, else encoded again.
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
                    self.start_ffmpeg(width, height)?
                };
                if self.format == VideoFormat::Y4m {
                    let (numerator, denominator) = fraction(self.fps);
                    let header = format!(
                        "YUV4MPEG2 W{width} H{height} F{numerator}:{denominator} Ip A1:1 C444 XCOLORRANGE=FULL\n"
                    );
                    sink.write(header.as_bytes()).map_err(OutputError::write(&self.path))?;
                }
                sink
            }
        };
        Ok(self.sink.insert(sink))
    }

    fn start_ffmpeg(&self, width: usize, height: usize) -> Result<Sink, OutputError> {
        let container = &container(&self.path)[..];
        // ffmpeg writes into the file that is there, which is no link then.
        storage::create(&partial_name(&self.path)).map_err(OutputError::write(&self.path))?;
        let mut url = std::ffi::OsString::from("file:");
        url.push(partial_name(&self.path));
        let size = format!("{width}x{height}");
        let rate = self.fps.to_string();
        // Halved chroma needs even sides.
        let format = if [width, height].iter().all(|side| side.is_multiple_of(2)) { "yuv420p" } else { "yuv444p" };
        let limited = "scale=out_color_matrix=bt709:out_range=limited";
        let video = ["-color_range", "tv", "-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "bt709"];
        let arguments: Vec<&str> = match container {
            // 256 colours of each frame's own.
            "gif" => vec!["-vf", "split[a][b];[a]palettegen=stats_mode=single[p];[b][p]paletteuse=new=1"],
            "webp" => {
                vec!["-vf", limited, "-c:v", "libwebp_anim", "-pix_fmt", "yuv420p", "-quality", "90", "-loop", "0"]
            }
            "avif" => [&["-vf", limited, "-pix_fmt", format, "-cpu-used", "8"][..], &video].concat(),
            _ => [&["-vf", limited, "-pix_fmt", format][..], &video].concat(),
        };
        let mut command = Command::new("ffmpeg");
        command.args([
            "-nostdin", "-v", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", &size, "-r", &rate, "-i", "-",
        ]);
        if let Some(Sound { file, codec, seconds }) = &self.sound {
            if let Some(seconds) = seconds {
                command.args(["-t", &seconds.to_string()]);
            }
            let mut input = std::ffi::OsString::from("file:");
            input.push(file);
            command.args(["-protocol_whitelist", "file", "-i"]).arg(input);
            command.args(["-map", "0:v:0", "-map", "1:a:0", "-c:a", encoder(container, codec)]);
        }
        let child = command
            .args(arguments)
            .args(["-f", container])
            .arg(url)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn();
        let mut child = match child {
            Ok(child) => child,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Err(OutputError::NoFfmpeg(self.path.clone())),
            Err(e) => return Err(self.ffmpeg_error(e.to_string())),
        };
        let Some(mut stderr) = child.stderr.take() else { return Err(self.ffmpeg_error("no pipe to it")) };
        let messages = std::thread::spawn(move || {
            let mut text = Vec::new();
            let _ = stderr.by_ref().take(1 << 16).read_to_end(&mut text);
            let _ = std::io::copy(&mut stderr, &mut std::io::sink());
            String::from_utf8_lossy(&text).into_owned()
        });
        Ok(Sink::Ffmpeg { child, messages })
    }

    fn ffmpeg_error(&self, cause: impl Into<String>) -> OutputError {
        OutputError::Ffmpeg { path: self.path.clone(), cause: cause.into() }
    }

    /// Appends a frame.
    ///
    /// # Errors
    /// A frame of another size than the first; what the system or ffmpeg says. The frames before stay readable on standard
    /// output; a file is not kept.
    pub fn push(&mut self, picture: &Picture) -> Result<(), OutputError> {
        let found = (picture.width, picture.height);
        let expected = *self.size.get_or_insert(found);
        if expected != found {
            return Err(OutputError::FrameSize { path: self.path.clone(), expected, found });
        }
        let bytes = match self.format {
            VideoFormat::Y4m => y4m_frame(picture),
            VideoFormat::Ffmpeg => picture.to_rgb8(),
        };
        self.samples.update(&bytes);
        let result = self.open(found.0, found.1)?.write(&bytes);
        if let Err(cause) = result {
            return Err(match self.sink.take() {
                // A closed pipe says less than ffmpeg does.
                Some(Sink::Ffmpeg { mut child, messages }) => {
                    drop(child.stdin.take());
                    let _ = child.wait();
                    let _ = storage::remove(&partial_name(&self.path));
                    self.ffmpeg_error(first_line(&messages.join().unwrap_or_default(), &cause.to_string()))
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

    /// Completes the file and gives it its name.
    ///
    /// # Errors
    /// Errors of the system or of ffmpeg; the file is not kept then.
    pub fn finish(mut self) -> Result<Finished, OutputError> {
        let partial = partial_name(&self.path);
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
            Some(Sink::Ffmpeg { mut child, messages }) => {
                drop(child.stdin.take());
                let status = child.wait().map_err(OutputError::write(&self.path))?;
                let text = messages.join().unwrap_or_default();
                if !status.success() {
                    let _ = storage::remove(&partial);
                    return Err(self.ffmpeg_error(first_line(&text, "it gives no reason")));
                }
                super::keep(&partial, &self.path)?;
                Some(of_file(&self.path).map_err(OutputError::write(&self.path))?)
            }
        };
        Ok(Finished { file, samples: self.samples.finalize().to_hex().to_string(), frames: self.frames })
    }
}

impl Drop for Video {
    fn drop(&mut self) {
        match self.sink.take() {
            Some(Sink::Ffmpeg { mut child, .. }) => {
                let _ = child.kill();
                let _ = child.wait();
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
            Sink::Ffmpeg { child, .. } => match child.stdin.as_mut() {
                Some(pipe) => pipe.write_all(content),
                None => Err(std::io::ErrorKind::BrokenPipe.into()),
            },
        }
    }
}

/// ffmpeg's name of the kind of file that a path names.
fn container(path: &Path) -> String {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
    match extension.as_str() {
        "mkv" => "matroska".to_owned(),
        "m4v" => "mp4".to_owned(),
        _ => extension,
    }
}

/// Returns true if video files of this name are written with the source's sound, where it has any.
pub fn holds_sound(path: &Path) -> bool {
    VideoFormat::of(path) == Some(VideoFormat::Ffmpeg) && !["gif", "webp", "avif"].contains(&&container(path)[..])
}

/// The encoder of sound for a kind of file: `copy` where the codec is one of its own.
fn encoder(container: &str, codec: &str) -> &'static str {
    match container {
        "webm" if ["opus", "vorbis"].contains(&codec) => "copy",
        "webm" => "libopus",
        "mp4" | "mov" if !["aac", "mp3", "ac3", "eac3", "alac"].contains(&codec) => "aac",
        _ => "copy",
    }
}

/// Length and digest of a file that is there.
fn of_file(path: &Path) -> std::io::Result<Written> {
    let file = std::fs::File::open(path)?;
    let bytes = file.metadata()?.len();
    let mut digest = blake3::Hasher::new();
    digest.update_reader(file)?;
    Ok(Written { bytes, blake3: digest.finalize().to_hex().to_string() })
}

fn first_line(text: &str, otherwise: &str) -> String {
    text.lines().map(str::trim).find(|line| !line.is_empty()).unwrap_or(otherwise).to_owned()
}

/// `FRAME` and the three planes.
fn y4m_frame(picture: &Picture) -> Vec<u8> {
    let plane = picture.width * picture.height;
    let matrix = Matrix::of_size(picture.width, picture.height);
    let mut bytes = b"FRAME\n".to_vec();
    let start = bytes.len();
    bytes.resize(start + 3 * plane, 0);
    let planes = &mut bytes[start..];
    for i in 0..plane {
        let [y, b, r] = matrix.ycbcr([0, 1, 2].map(|c| picture.rgb[c * plane + i].clamp(0.0, 1.0)));
        // `as` saturates.
        planes[i] = (255.0 * y + 0.5) as u8;
        planes[plane + i] = (255.0 * b + 128.5) as u8;
        planes[2 * plane + i] = (255.0 * r + 128.5) as u8;
    }
    bytes
}

/// A frame rate as a fraction: exact where it is whole or n·1000/1001, else in millionths.
fn fraction(fps: f64) -> (u64, u64) {
    for denominator in [1u64, 1001] {
        let numerator = fps * denominator as f64;
        let whole = numerator.round();
        if (1.0..4e9).contains(&whole) && (numerator - whole).abs() < 1e-6 * whole {
            return (whole as u64, denominator);
        }
    }
    ((fps.min(4000.0) * 1e6).round().max(1.0) as u64, 1_000_000)
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
        let mut video = Video::create(&path, VideoFormat::Y4m, 30000.0 / 1001.0).expect("writable");
        (0..3).for_each(|_| video.push(&picture).expect("writable"));
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
        let mut video = Video::create(&folder.path().join("v.y4m"), VideoFormat::Y4m, 24.0).expect("writable");
        video.push(&Picture { width: 2, height: 2, rgb: vec![0.5; 12] }).expect("writable");
        let other = Picture { width: 1, height: 2, rgb: vec![0.5; 6] };
        assert!(matches!(video.push(&other), Err(OutputError::FrameSize { .. })));
        drop(video);
        assert_eq!(std::fs::read_dir(folder.path()).expect("readable").count(), 0);
        assert!(Video::create(Path::new("no/such/folder/v.y4m"), VideoFormat::Y4m, 24.0).is_err());
    }

    #[test]
    fn rates_become_fractions() {
        assert_eq!(fraction(24.0), (24, 1));
        assert_eq!(fraction(30000.0 / 1001.0), (30000, 1001));
        assert_eq!(fraction(12.5), (12_500_000, 1_000_000));
    }
}
