//! A scene as one compressed file (`.ssz`).
//!
//! Every number is rounded to a whole number ([`quantise`]) and predicted from data that a reader already has. The
//! differences are deflated column by column, one chunk per interval. An index at the end holds the chunks' positions.
//! So an interval can be read without most others: only those back to the nearest independent chunk (every eighth) are
//! required. `docs/container.md` describes every byte.
//!
//! Identities, births, merges, times and the source's placement are stored exactly; positions and velocities to 2⁻¹⁴
//! world units, and the rest as precisely as [`quantise`] states. The bytes are a function of the intervals and the
//! frame rate alone.

mod chunk;
mod columns;
use crate::recognise::CONTAINER_MAGIC as MAGIC;
#[cfg(feature = "viewer")]
mod images;
mod index;
mod quantise;
mod read;
#[cfg(test)]
mod tests;
mod write;

#[cfg(feature = "viewer")]
pub(crate) use images::{COARSENESS, ImageChunks};
pub(super) use read::Container;
pub use read::intervals_from_container;
pub use write::ContainerWriter;

/// The latest version. This program writes it where a scene lists times of frames, otherwise version 3, which is the
/// same without them. It also reads version 2, in which every record's thickness is 1, and version 1, in which colours
/// do not change either.
pub const CONTAINER_VERSION: u32 = 4;
/// The version of a container without times of frames.
const WITHOUT_FRAMES: u32 = 3;

/// Every chunk whose number is a multiple of this is independent.
const ALONE_EVERY: usize = 8;
/// Most Gaussians, and most merges, of an interval.
const MOST: usize = 1 << 24;
