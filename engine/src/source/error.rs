//! Errors of reading frames.

use std::io;
use std::path::{Path, PathBuf};

use crate::picture::{MAX_PIXELS, MAX_SIDE};

/// A source that cannot be opened, or a frame that cannot be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SourceError {
    /// The file or folder cannot be read.
    #[error("{}: {cause}", path.display())]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// The system's error.
        cause: io::Error,
    },
    /// An address (URL) where a file was expected.
    #[error(
        "{address}: expected a file or a folder, found an address: download it, or run ffmpeg -i {address} -f yuv4mpegpipe - | streamsplat run - --out OUT"
    )]
    Address {
        /// The address.
        address: String,
    },
    /// A folder without images.
    #[error("{}: the folder holds no image (expected files ending in {})", path.display(), crate::folder::EXTENSIONS.join(", "))]
    EmptyFolder {
        /// The folder.
        path: PathBuf,
    },
    /// An empty file.
    #[error("{}: the file is empty (0 bytes), expected an image", path.display())]
    EmptyFile {
        /// The file.
        path: PathBuf,
    },
    /// A file that is not an image of a supported kind, or a broken one.
    #[error("{}: {cause}", path.display())]
    Decode {
        /// The file.
        path: PathBuf,
        /// The decoder's message.
        cause: String,
    },
    /// A frame above the size limit of this program.
    #[error(
        "{}: the picture is {width}×{height}, expected at most {MAX_SIDE} pixels a side and {MAX_PIXELS} in all",
        path.display()
    )]
    TooLarge {
        /// The file or stream.
        path: PathBuf,
        /// Width found.
        width: usize,
        /// Height found.
        height: usize,
    },
    /// A sample that is not a finite number.
    #[error("{}: the sample at x={x}, y={y} is {value}, expected a finite number", path.display())]
    NotFinite {
        /// The file.
        path: PathBuf,
        /// Column of the first such sample.
        x: usize,
        /// Row of the first such sample.
        y: usize,
        /// The sample.
        value: f32,
    },
    /// Frames of different sizes in one video.
    #[error(
        "{}: the frame is {}×{}, expected {}×{} as in {}",
        path.display(), found.0, found.1, expected.0, expected.1, first.display()
    )]
    MixedSizes {
        /// The frame that differs.
        path: PathBuf,
        /// Its width and height.
        found: (usize, usize),
        /// Width and height of the first frame.
        expected: (usize, usize),
        /// The first frame.
        first: PathBuf,
    },
    /// A y4m stream that does not follow the format.
    #[error("{}: {cause}", path.display())]
    Y4m {
        /// The file, or `-`.
        path: PathBuf,
        /// Expected and found values.
        cause: String,
    },
    /// The `ffmpeg` program is not installed.
    #[error(
        "{}: reading this file needs the ffmpeg program, which is not installed (Debian: apt install ffmpeg); \
         without it, give a folder of images or a .y4m file",
        path.display()
    )]
    NoFfmpeg {
        /// The video file.
        path: PathBuf,
    },
    /// `ffmpeg` cannot read the file.
    #[error("{}: ffmpeg cannot read it: {cause}", path.display())]
    Ffmpeg {
        /// The video file.
        path: PathBuf,
        /// The message of ffmpeg.
        cause: String,
    },
    /// Frames of a video were read, but fewer than the file should have, or with errors.
    #[error("{}", damage(path, *announced, *read, *complaints, cause))]
    Damaged {
        /// The video file or stream.
        path: PathBuf,
        /// Approximate number of frames that the file declares.
        announced: Option<usize>,
        /// Frames read.
        read: usize,
        /// Number of errors that its decoder reported.
        complaints: usize,
        /// The first of these errors.
        cause: String,
    },
    /// A frame rate that is not a positive number.
    #[error("frame rate {0}: expected a positive, finite number of frames per second")]
    FrameRate(f64),
}

/// Formats the message on a damaged file.
fn damage(path: &Path, announced: Option<usize>, read: usize, complaints: usize, cause: &str) -> String {
    let announced = announced.map_or_else(String::new, |frames| format!(" of about {frames} announced"));
    let more = if complaints > 1 { format!(" (first of {complaints} complaints)") } else { String::new() };
    format!("{}: damaged: {read} frames{announced} were read: {cause}{more}", path.display())
}

impl SourceError {
    pub(crate) fn read(path: impl Into<PathBuf>) -> impl FnOnce(io::Error) -> SourceError {
        let path = path.into();
        move |cause| SourceError::Read { path, cause }
    }
}
