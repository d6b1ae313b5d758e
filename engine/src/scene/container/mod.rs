//! A scene as one compressed file (`.ssz`).
//!
//! Every number is rounded to a whole number ([`table`]) and predicted from data that a reader already has. The
//! differences are entropy-coded column by column ([`columns`]), one chunk per interval. An index at the end holds the
//! chunks' positions. So an interval can be read without most others: only those back to the nearest independent chunk
//! (every eighth) are required. `docs/container.md` describes every byte.
//!
//! Identities, births, merges, times and the source's placement are stored exactly, and the rest as precisely as
//! [`table`] states. The bytes are a function of the intervals and the frame rate alone.

mod chunk;
mod columns;
use crate::recognise::CONTAINER_MAGIC as MAGIC;
#[cfg(feature = "viewer")]
mod images;
mod index;
mod quantise;
mod rans;
mod read;
mod table;
#[cfg(test)]
mod tests;
mod write;

#[cfg(feature = "viewer")]
pub(crate) use images::{ImageChunks, coarseness};
pub(super) use read::Container;
pub use read::intervals_from_container;
pub use write::ContainerWriter;

/// The version that this program writes and reads.
pub const CONTAINER_VERSION: u32 = 1;

/// Every chunk whose number is a multiple of this is independent.
const ALONE_EVERY: usize = 8;
/// Most Gaussians, and most merges, of an interval.
const MOST: usize = 1 << 24;
