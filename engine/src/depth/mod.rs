//! Inverse depth of frames: from files ([`DepthMaps`]) or from a network (`DepthNetwork`, with the feature `onnx`).
//!
//! In both cases a map has one value per pixel of its frame, larger is nearer, in any scale: the engine normalises it.

mod exr;
mod maps;
#[cfg(feature = "onnx")]
mod network;
mod npy;
mod options;
#[cfg(feature = "onnx")]
mod prepare;

use std::path::PathBuf;

pub use maps::{DepthMaps, EXTENSIONS, Map, Range, Values, decode_map, read_map};
#[cfg(feature = "onnx")]
pub use network::DepthNetwork;
pub use options::{NetworkOptions, NetworkSize, WrongOption};

#[cfg(feature = "onnx")]
use crate::onnx::OnnxError;
use crate::source::SourceError;

/// Errors of a map, its folder, or its network.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DepthError {
    /// The depth network cannot be loaded or run.
    #[cfg(feature = "onnx")]
    #[error(transparent)]
    Onnx(#[from] OnnxError),
    /// The depth network's input would exceed this program's limit.
    #[error("{}: a frame of {}×{} would make the network's input {}×{}, larger than this program makes it; give its size",
        path.display(), frame[1], frame[0], input[1], input[0])]
    Input {
        /// The network's file.
        path: PathBuf,
        /// Height and width of the frame.
        frame: [usize; 2],
        /// Height and width of the network's input.
        input: [usize; 2],
    },
    /// The folder or a file cannot be read.
    #[error(transparent)]
    Read(#[from] SourceError),
    /// A folder without maps.
    #[error("{}: the folder holds no depth map (expected files ending in {})", .0.display(), EXTENSIONS.join(", "))]
    Empty(PathBuf),
    /// A number of maps other than that of the frames.
    #[error("{}: expected {expected} depth maps, one for each frame, found {found}", folder.display())]
    Count {
        /// The folder of maps.
        folder: PathBuf,
        /// Number of frames.
        expected: usize,
        /// Number of maps.
        found: usize,
    },
    /// Files of several kinds with the same names; no kind has every name.
    #[error("{}: expected depth maps of one kind for all {names} names, found {found}", folder.display())]
    Kinds {
        /// The folder of maps.
        folder: PathBuf,
        /// Number of different names.
        names: usize,
        /// Files of each kind.
        found: String,
    },
    /// A frame without a map.
    #[error("{}: no depth map for frame {frame}, found {found} maps", folder.display())]
    Missing {
        /// The folder of maps.
        folder: PathBuf,
        /// The frame's index.
        frame: usize,
        /// Number of maps.
        found: usize,
    },
    /// A file that is not a depth map.
    #[error("{}: {cause}", path.display())]
    Map {
        /// The file.
        path: PathBuf,
        /// Expected and found values.
        cause: String,
    },
}
