//! Scenes on disk: a folder with `scene.json` and one safetensors file per interval, or one compressed file, a
//! container.
//!
//! `scene.json` holds the placement of the source's frame in the model's input, and lists the intervals in order with
//! their times in seconds, counts and BLAKE3 digests. It is replaced by renaming after the listed intervals are
//! complete, so that it never lists an incomplete file. An interrupted writer leaves a valid scene.
//!
//! | tensor | shape | what |
//! |---|---|---|
//! | `mean`, `velocity` | F32 `[N,3]` | world position at the reference time; world units per interval |
//! | `gamma` | F32 `[N,2]` | the opacity's window in time |
//! | `opacity` | F32 `[N]` | at the reference time |
//! | `scale` | F32 `[N,2]` | standard deviations along x and z |
//! | `thickness` | F32 `[N]` | that along y, in scene space, over the mean of the two; only where one is not 1 |
//! | `rgb` | F32 `[N,3]` | display-space colour at the reference time |
//! | `rgb_rate` | F32 `[N,3]` | change of colour per interval; only where one is not zero |
//! | `identity`, `birth`, `frame` | U64 `[N]` | the identity; the key frame in which it was first seen; the one that reconstructed this record |
//! | `offset` | F32 `[N,3]` | from `mean` to the identity's tracked point |
//! | `reference` | U8 `[N]` | 0: seen forward from the interval's start; 1: backward from its end |
//! | `handover` | U8 `[N]` | 0 stays; 1 fades in after the start; 2 fades out before the end |
//! | `merges` | U64 `[M,2]` | identities that ended, and the one that continues instead of each |
//! | `time` | F64 `[2]` | start and end in seconds |
//! | `index`, `dropped` | U64 `[1]` | the key frame at the end; Gaussians left out because a number was not finite |

mod container;
mod frames;
mod interval;
mod join;
mod read;
mod records;
mod resume_point;
mod write;

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use crate::fit::Placement;
use crate::output::OutputError;
pub use crate::recognise::{CONTAINER_MAGIC as MAGIC, SCENE_INDEX as INDEX};
pub use container::{CONTAINER_VERSION, ContainerWriter, intervals_from_container};
#[cfg(feature = "viewer")]
pub(crate) use container::{ImageChunks, coarseness};
pub use interval::{from_safetensors, to_safetensors};
pub use join::{Join, Joined};
pub use read::Scene;
pub use resume_point::{resume_point_from_safetensors, resume_point_to_safetensors};
pub use write::SceneWriter;

/// Value of `format` in a scene's index.
pub const FORMAT: &str = "streamsplat-scene";
/// The version this program writes and reads.
pub const VERSION: u32 = 1;

/// Errors of a scene.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SceneError {
    /// A file cannot be read.
    #[error("{}: {cause}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Cause reported by the system.
        cause: std::io::Error,
    },
    /// A file that is not part of a scene, or a broken one.
    #[error("{}: {cause}", path.display())]
    Broken {
        /// The file.
        path: PathBuf,
        /// Expected and found values.
        cause: String,
    },
    /// A file cannot be written.
    #[error(transparent)]
    Write(#[from] OutputError),
    /// The time is outside of the scene.
    #[error("time {time} s: expected one between {start} s and {end} s, the times of this scene")]
    Time {
        /// The requested time.
        time: f64,
        /// The scene's start.
        start: f64,
        /// The scene's end.
        end: f64,
    },
}

/// `scene.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Index {
    /// [`FORMAT`].
    pub format: String,
    /// [`VERSION`].
    pub version: u32,
    /// Frames per second of the source.
    pub fps: f64,
    /// Sizes as `[height, width]`.
    pub placement: PlacementRecord,
    /// The intervals in order of time.
    pub intervals: Vec<IntervalEntry>,
}

/// [`Placement`] as JSON; sizes and places are `[height, width]` and `[row, column]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PlacementRecord {
    /// The source's frames.
    pub source: [usize; 2],
    /// The model's input.
    pub model: [usize; 2],
    /// The content's corner inside the model's input.
    pub offset: [usize; 2],
    /// The content's size inside the model's input.
    pub content: [usize; 2],
}

/// One interval of the index.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct IntervalEntry {
    /// File name inside the scene's folder.
    pub file: String,
    /// Start in seconds.
    pub start: f64,
    /// End in seconds; equal to the start for a single frame's static scene.
    pub end: f64,
    /// Gaussians.
    pub gaussians: usize,
    /// Bytes of the file.
    pub bytes: u64,
    /// BLAKE3 digest of the file.
    pub blake3: String,
    /// Times of the source's frames after the interval before, in seconds, the key frame last; empty where they follow
    /// from the rate.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub frames: Vec<f64>,
}

impl From<Placement> for PlacementRecord {
    fn from(p: Placement) -> Self {
        Self { source: p.source, model: p.model, offset: p.offset, content: p.content }
    }
}

impl PlacementRecord {
    /// The placement, if the content is not empty and is inside the model's input.
    pub fn placement(&self) -> Option<Placement> {
        let inside = (0..2).all(|i| {
            self.source[i] >= 1
                && self.content[i] >= 1
                && self.model[i] <= 1 << 31
                && self.offset[i].checked_add(self.content[i]).is_some_and(|end| end <= self.model[i])
        });
        let Self { source, model, offset, content } = *self;
        inside.then_some(Placement { source, model, offset, content })
    }
}

#[cfg(test)]
mod tests;
