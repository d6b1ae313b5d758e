//! The sound of a video.

use std::path::PathBuf;

/// Sound for a video.
#[derive(Clone, Debug, PartialEq)]
pub struct Sound {
    /// The file with the sound; its first track is used.
    pub file: PathBuf,
    /// Its codec, in ffmpeg's names.
    pub codec: String,
    /// Time in the file at which the first picture is shown, in seconds after the file's beginning.
    pub start: f64,
}
