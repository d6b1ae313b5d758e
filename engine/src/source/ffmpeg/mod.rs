//! Any video file, decoded by an installed `ffmpeg` program that writes y4m into a pipe; ffprobe is not needed.
//!
//! - **Which stream**: the moving one (`streams`); covers and stills are left out with a note.
//! - **Times**: every frame is used once, at its own time (`times`); none is duplicated or dropped.
//! - **Colour**: planes are passed unchanged, and [`super::colour`] decides the meaning of their tags.
//! - **Shape**: ffmpeg applies the file's rotation. [`super::Source`] makes pixels square. Interlaced frames are
//!   deinterlaced.
//! - **High dynamic range** (HLG, PQ) becomes BT.709 of standard range. Display light of 203 cd/m² becomes white (ITU-R
//!   BT.2408), and brighter parts are rolled off. If hardly anything in the video is brighter, 100 cd/m² becomes white.
//! - **Damage**: all decodable frames are read. An error message of ffmpeg is an error after the last frame, even with
//!   exit status 0. So is a file that is shorter than its container declares (`whole`).
//!
//! [`Ffmpeg::notes`] lists conversions of the pictures and parts of the file that are left out. Decoders differ between
//! versions of ffmpeg, so equal digests of a run require equal output of ffmpeg: compare the input digests in
//! `run.json`.
//!
//! Opening starts ffmpeg twice: to list the streams, and to decode. A third start follows if the first frame needs
//! other filters than the list implied. Packets are counted, without decoding, only in three cases: there are several
//! streams to choose from, the mean rate is unknown, or the file is Matroska, whose rate is only a declaration.

mod bright;
mod chain;
mod program;
mod running;
mod shown;
mod streams;
mod times;
mod whole;

use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::ChildStdout;

use super::SourceError;
use super::colour::{self, Matrix};
use super::y4m::{Header, Y4m};
use crate::picture::Picture;
use crate::source::Sound;
pub(crate) use chain::{ALPHA, GIF_HOLES};
use chain::{Chain, Samples};
use program::Decoding;
use running::{Complaints, First, Running};
use streams::Listing;
use times::Clock;

/// Frames per second from which a rate is that of a container's clock.
const CLOCK: f64 = 10_000.0;

/// A video file being decoded by ffmpeg.
pub struct Ffmpeg {
    running: Running,
    y4m: Y4m<BufReader<ChildStdout>>,
    path: PathBuf,
    clock: Clock,
    /// Time stamp of the first frame.
    first: Option<i64>,
    notes: Vec<String>,
    sound: Option<String>,
    /// The stream's number.
    stream: usize,
    /// Number of frames, if they were counted.
    counted: Option<usize>,
    uneven: bool,
    /// True for frames without a container.
    raw: bool,
    /// Number of frames that the file declares.
    announced: Option<usize>,
    rate: Option<(f64, f64)>,
    read: usize,
}

impl Ffmpeg {
    /// Starts ffmpeg on the file and reads the stream's header. `matrix` replaces the file's own.
    ///
    /// # Errors
    /// ffmpeg is not installed or cannot read the file, or the file has no moving stream.
    pub fn open(path: &Path, matrix: Option<Matrix>) -> Result<Self, SourceError> {
        let listing = Listing::of(path).map_err(|e| not_started(e, path))?;
        if let Some(cause) = listing.refusal() {
            return Err(SourceError::Decode { path: path.to_owned(), cause: cause.to_owned() });
        }
        let count = |streams: &[usize]| program::count(path, streams);
        let all: Vec<usize> = listing.videos.iter().map(|stream| stream.index).collect();
        let (stream, mut notes) = match listing.choose(|| count(&all)) {
            Some((stream, lines)) => (stream.clone(), lines),
            // Decoding then fails with ffmpeg's own message.
            None => Default::default(),
        };
        let map = if listing.videos.is_empty() { "0:v:0".to_owned() } else { format!("0:{}", stream.index) };
        let chain = |first: &First| Chain::of(&first.look, first.size, matrix, stream.codec == "gif", path, &map);
        let mut listed = chain(&First { look: stream.look.clone(), size: stream.size, ..First::default() });
        let mut decoding =
            Decoding { stream: map.clone(), filters: listed.filters.clone(), parts: listing.joined, old: false };
        let start = |decoding: &Decoding| Running::start(decoding, path).map_err(|e| not_started(e, path));
        let (mut running, mut stdout, mut first) = start(&decoding)?;
        if first.is_none() {
            let (_, complaints) = running.end().map_err(SourceError::read(path))?;
            decoding.old = complaints.first.iter().any(|text| text.contains("fps_mode"));
            if !decoding.old {
                return Err(unreadable(path, &complaints));
            }
            (running, stdout, first) = start(&decoding)?;
        }
        if let Some(found) = &first
            && found.look != stream.look
        {
            // The first frame decides; the list is only a guess.
            let shown = chain(found);
            if shown.filters != listed.filters {
                decoding.filters.clone_from(&shown.filters);
                drop(running);
                (running, stdout, first) = start(&decoding)?;
            }
            listed = shown;
        }
        let Some(First { tick: Some(tick), rate, time, look, .. }) = first else {
            running.kill();
            let (_, complaints) = running.end().map_err(SourceError::read(path))?;
            return Err(unreadable(path, &complaints));
        };
        let mut y4m = match Y4m::new(BufReader::with_capacity(1 << 16, stdout), path) {
            Ok(y4m) => y4m,
            Err(e) => {
                running.kill();
                let (_, complaints) = running.end().map_err(SourceError::read(path))?;
                return Err(if complaints.count > 0 { unreadable(path, &complaints) } else { e });
            }
        };
        notes.append(&mut listed.notes);
        if matrix.is_some() {
            running.told.push(shown::MATRIX);
        }
        y4m.set_aspect(look.aspect);
        match listed.samples {
            Samples::Rgb => y4m.set_matrix(None),
            Samples::Matrix(matrix) => y4m.set_matrix(Some(matrix)),
            Samples::Guessed => notes.extend(y4m.header().matrix.map(colour::guessed)),
        }
        let open = stream.rate_is_open();
        let counted =
            (open || listing.declared).then(|| count(&[stream.index])).and_then(|counts| counts.first().copied());
        let counted = counted.map(|(_, count)| count).filter(|count| count.frames > 1 && count.seconds > 0.0);
        let uneven = counted.is_some_and(|count| open || count.uneven);
        let mean = counted.filter(|_| uneven).map(|count| ((count.frames - 1) as f64, count.seconds));
        let nominal = rate.map(|(numerator, denominator)| (f64::from(numerator), f64::from(denominator)));
        let clock = Clock::new(tick, rate);
        let starts = time.map(|time| clock.seconds(time));
        Ok(Ffmpeg {
            running,
            y4m,
            path: path.to_owned(),
            clock,
            first: time,
            notes,
            // The packets of a truncated file are fewer than its header declares.
            announced: match counted {
                Some(count) if open => Some(count.frames),
                _ => listing.frames(&stream, starts),
            },
            stream: stream.index,
            counted: counted.map(|count| count.frames),
            uneven,
            raw: listing.raw,
            sound: listing.sound,
            // A still picture has the rate of a clock.
            rate: mean.or(nominal.filter(|(frames, seconds)| *frames < CLOCK * *seconds)),
            read: 0,
        })
    }

    /// Returns the parameters of the picture stream.
    pub fn header(&self) -> &Header {
        self.y4m.header()
    }

    /// Returns the file's first sound track, if it has one.
    pub fn sound(&self) -> Option<Sound> {
        let codec = self.sound.clone()?;
        Some(Sound { file: self.path.clone(), codec, start: self.start().max(0.0) })
    }

    /// Returns the number of frames by the file's metadata.
    pub fn expected_frames(&self) -> Option<usize> {
        self.announced
    }

    /// Returns the number of frames counted without decoding.
    pub(super) fn counted_frames(&self) -> Option<usize> {
        let counts = || program::count(&self.path, &[self.stream]);
        self.counted.or_else(|| counts().first().map(|(_, count)| count.frames)).filter(|frames| *frames > 0)
    }

    /// Returns the frames per second as a fraction: the stream's nominal rate, or the mean rate where it differs.
    pub fn rate(&self) -> Option<(f64, f64)> {
        self.rate
    }

    /// Returns true if the frames do not follow the file's nominal rate.
    pub fn is_uneven(&self) -> bool {
        self.uneven
    }

    /// Returns the seconds from the beginning of the file, which may be the start of its sound, to the first frame.
    pub fn start(&self) -> f64 {
        self.first.map_or(0.0, |time| self.clock.seconds(time))
    }

    /// Returns true for frames without a container, at the rate that ffmpeg assumes.
    pub(super) fn is_raw(&self) -> bool {
        self.raw && self.rate.is_some_and(|(frames, seconds)| (frames / seconds - 25.0).abs() < 1e-9)
    }

    /// Adds a note.
    pub(super) fn note(&mut self, line: Option<String>) {
        self.notes.extend(line);
    }

    /// Returns the notes: conversions of the pictures and parts of the file that are left out, a line each. Notes from
    /// decoding are appended at the end.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Returns the next frame with its time in seconds since the first; `None` at the end of the video.
    ///
    /// # Errors
    /// A frame that cannot be read; at the end, [`SourceError::Damaged`] if ffmpeg reported errors.
    pub fn next_frame(&mut self) -> Result<Option<(Picture, f64)>, SourceError> {
        let picture = match self.y4m.next_picture() {
            Ok(Some(picture)) => picture,
            Ok(None) => return self.end(None).map(|()| None),
            Err(SourceError::Y4m { cause, .. }) => {
                // The stream ended inside a frame, or its content is not reliable any more.
                self.running.kill();
                return self.end(Some(cause)).map(|()| None);
            }
            Err(e) => return Err(e),
        };
        let time = match self.read {
            0 => self.first,
            // A frame without a message gets no time stamp.
            _ => self.running.frame(self.read).flatten(),
        };
        self.notes.append(&mut self.running.notes);
        self.read += 1;
        Ok(Some((picture, self.clock.next(time))))
    }

    /// Checks ffmpeg's messages; `broke` is the error that ended the stream of pictures.
    fn end(&mut self, broke: Option<String>) -> Result<(), SourceError> {
        let moved = self.clock.moved;
        if moved > 0 {
            self.notes.push(format!(
                "frames whose time is not after that of the frame before: {moved}; each was put right after it"
            ));
        }
        let (succeeded, mut complaints) = self.running.end().map_err(SourceError::read(&self.path))?;
        self.notes.append(&mut self.running.notes);
        self.clock.moved = 0;
        if let Some(cause) = broke {
            complaints.first.push(cause);
            complaints.count += 1;
        } else if succeeded && complaints.count == 0 {
            match whole::missing(&self.path) {
                None => return Ok(()),
                Some(cause) => complaints = Complaints { first: vec![cause], count: 1 },
            }
        }
        let cause = one_line(&complaints, &self.path);
        Err(SourceError::Damaged {
            path: self.path.clone(),
            announced: self.announced,
            read: self.read,
            complaints: complaints.count,
            cause,
        })
    }
}

fn not_started(e: std::io::Error, path: &Path) -> SourceError {
    match e.kind() {
        std::io::ErrorKind::NotFound => SourceError::NoFfmpeg { path: path.to_owned() },
        _ => SourceError::Ffmpeg { path: path.to_owned(), cause: e.to_string() },
    }
}

/// Returns the error for a file without any readable frame.
fn unreadable(path: &Path, complaints: &Complaints) -> SourceError {
    let path = path.to_owned();
    if is_text(&path) {
        return SourceError::Decode { path, cause: "expected a video, found a text file".to_owned() };
    }
    let missing = complaints.first.iter().find_map(|text| text.split_once("No such filter: ")).map(|(_, name)| name);
    let cause = match missing.map(|name| name.trim_matches('\'')) {
        Some(name) => format!("its colours or shape need the filter {name}, which this ffmpeg was built without"),
        None => one_line(complaints, &path),
    };
    SourceError::Ffmpeg { path, cause }
}

/// Returns the first error message, without the file's name in front.
fn one_line(complaints: &Complaints, path: &Path) -> String {
    let name = format!("file:{}: ", path.display());
    let line = complaints.first.first().map_or("no reason given", String::as_str);
    line.strip_prefix(&name).unwrap_or(line).to_owned()
}

/// Returns true if a file begins as text.
fn is_text(path: &Path) -> bool {
    let mut start = Vec::new();
    let read = std::fs::File::open(path).and_then(|file| file.take(4096).read_to_end(&mut start));
    read.is_ok() && crate::recognise::is_text(&start)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_told_from_other_bytes() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("a.mp4");
        for (bytes, expected) in [
            (&b"Dear diary,\n\t\xc3\xa9\xc3"[..], true),
            (b"\0\0\0\x18ftypmp42", false),
            (b"", false),
            (b"\xff\xfe", false),
        ] {
            std::fs::write(&path, bytes).expect("writable");
            assert_eq!(is_text(&path), expected, "{bytes:?}");
        }
    }

    #[test]
    fn a_filter_that_is_missing_is_named() {
        let complaints = |first: &str| Complaints { first: vec![first.to_owned()], count: 1 };
        let of = |first| unreadable(Path::new("a.mp4"), &complaints(first)).to_string();
        assert_eq!(
            of("No such filter: 'zscale'"),
            "a.mp4: ffmpeg cannot read it: its colours or shape need the filter zscale, which this ffmpeg was built without"
        );
        assert_eq!(of("file:a.mp4: Invalid data found"), "a.mp4: ffmpeg cannot read it: Invalid data found");
    }
}
