//! Where `--out` points.

use std::path::{Path, PathBuf};

use crate::output::{Pace, VIDEOS, VideoFormat, qualities};

use crate::run::Error;

/// Endings of files that are not meant as names of folders.
const FOREIGN: [&str; 31] = [
    "3gp", "asf", "avi", "flv", "m2ts", "mpeg", "mpg", "mts", "ogv", "ts", "vob", "wmv", "mp3", "wav", "bmp", "exr",
    "jpeg", "jpg", "png", "tga", "tif", "tiff", "heic", "ply", "spz", "ssz", "zip", "sog", "glb", "gltf", "splat",
];

/// Where `--out` points.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Destination {
    /// A folder.
    Folder(PathBuf),
    /// A video file, or `-`.
    Video(PathBuf, VideoFormat),
}

impl Destination {
    /// As [`Destination::of`]; an error for the name of a file of a kind that is not written.
    pub fn asked(out: &Path) -> Result<Destination, Error> {
        let destination = Destination::of(out);
        let ending = out.extension().and_then(|ending| ending.to_str()).unwrap_or_default().to_ascii_lowercase();
        match destination {
            Destination::Folder(_) if FOREIGN.contains(&ending.as_str()) && !out.is_dir() => {
                let found = out.display();
                Err(Error::usage(format!(
                    "--out: expected a folder, - or a video (.{}), for one image of render also .png or .exr, found {found}",
                    VIDEOS.join(", .")
                )))
            }
            destination => Ok(destination),
        }
    }

    /// A path with a video's name is a video, `-` is y4m on standard output, anything else a folder.
    pub fn of(out: &Path) -> Destination {
        if out == Path::new("-") {
            return Destination::Video(out.to_owned(), VideoFormat::Y4m);
        }
        match VideoFormat::of(out) {
            Some(format) if !out.is_dir() => Destination::Video(out.to_owned(), format),
            _ => Destination::Folder(out.to_owned()),
        }
    }

    /// Where a run keeps its resume state; `None` where it cannot be resumed.
    pub fn resume(&self) -> Option<PathBuf> {
        match self {
            Destination::Folder(folder) => Some(folder.join("resume")),
            Destination::Video(path, VideoFormat::Y4m) if path != Path::new("-") => {
                let mut name = path.file_name().unwrap_or_default().to_owned();
                name.push(".resume");
                Some(path.with_file_name(name))
            }
            Destination::Video(..) => None,
        }
    }

    /// Refuses a rate factor for outputs without one, and values out of range.
    pub fn check_crf(&self, crf: Option<u8>) -> Result<(), Error> {
        let Some(crf) = crf else { return Ok(()) };
        let allowed = if self.is_video() { qualities(self.path()) } else { None };
        match allowed {
            Some(range) if range.contains(&crf) => Ok(()),
            Some(range) => {
                let (least, most, out) = (range.start(), range.end(), self.path().display());
                Err(Error::usage(format!("--crf: expected {least} to {most} for {out}, found {crf}")))
            }
            None => {
                let out = self.path().display();
                Err(Error::usage(format!(
                    "--crf: expected a .mp4, .m4v, .mov, .mkv, .webm or .avif file as --out, found {out}"
                )))
            }
        }
    }

    /// Returns a note if the file cannot hold the times of images at this pace.
    pub fn without_times(&self, pace: Pace) -> Option<String> {
        let y4m = matches!(self, Destination::Video(_, VideoFormat::Y4m));
        (pace.uneven && y4m).then(|| {
            let fps = pace.fps;
            format!("y4m holds no times: images follow each other at {fps:.3} a second, unlike the frames")
        })
    }

    /// Returns true for a video, written or encoded.
    pub fn is_video(&self) -> bool {
        matches!(self, Destination::Video(..))
    }

    /// The file of the scene next to an encoded video.
    pub fn container(&self) -> Option<PathBuf> {
        match self {
            Destination::Video(path, format) if *format != VideoFormat::Y4m => Some(path.with_extension("ssz")),
            _ => None,
        }
    }

    /// The folder or the video's file.
    pub fn path(&self) -> &Path {
        let (Destination::Folder(path) | Destination::Video(path, _)) = self;
        path
    }

    /// The file that locks the place for one process; `None` for standard output.
    pub fn lock(&self) -> Option<PathBuf> {
        match self {
            Destination::Folder(folder) => Some(folder.join(".streamsplat.lock")),
            Destination::Video(path, _) if path == Path::new("-") => None,
            Destination::Video(path, _) => {
                let mut name = std::ffi::OsString::from(".");
                name.push(path.file_name().unwrap_or_default());
                name.push(".lock");
                Some(path.with_file_name(name))
            }
        }
    }

    /// The file of the run's record; `None` for standard output.
    pub fn record(&self) -> Option<PathBuf> {
        match self {
            Destination::Folder(folder) => Some(folder.join("run.json")),
            Destination::Video(path, _) if path == Path::new("-") => None,
            Destination::Video(path, _) => {
                let mut name = path.file_name().unwrap_or_default().to_owned();
                name.push(".run.json");
                Some(path.with_file_name(name))
            }
        }
    }
}
