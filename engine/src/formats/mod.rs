//! Still scenes in the formats of other programs, and their cameras: each reader with its writer.
//!
//! A still scene is one of the [`FORMATS`], or one that is [`READ_ONLY`]; a PLY file of SpacetimeGaussians is a
//! [`Spacetime`](spacetime::Spacetime), which is a [`Still`] at any time. Formats are recognised by content. `.splat`
//! and `.ksplat` have no magic bytes and are recognised by their file names. [`crate::open`] opens files of any kind.
//!
//! There is no open format for dynamic Gaussians. Viewers read sequences of still scenes, one per time.
//!
//! Before allocating memory for a count in a header, readers check that the file is long enough for it. They also check
//! the [`Limits`] on the number of Gaussians and on the bytes in memory per byte of the file.

mod beside;
mod blocks;
pub mod cameras;
pub mod compressed_ply;
pub mod gltf;
pub mod ksplat;
mod limits;
pub mod lod;
mod notes;
mod order;
pub mod ply;
pub mod sog;
pub mod spacetime;
pub mod splat;
pub mod spz;
mod table;
#[cfg(test)]
mod tests;
pub mod tracks;

use std::path::Path;

pub(crate) use beside::Beside;
pub use blocks::Progress;
pub(crate) use blocks::{Blocks, ReadError};
pub(crate) use limits::read_file;
pub use limits::{Limits, RATIO, SMALL, read_text};
pub use notes::{Options, SpzVersion, Written};
use order::Order;
pub(crate) use table::Reader;
pub use table::{FORMATS, Format, READ_ONLY, ReadOnly};

use crate::still::Still;

/// Error in the content of a file.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{part}: expected {expected}, found {found}")]
pub struct FormatError {
    /// The property or the part of the file.
    pub part: String,
    /// Expected value.
    pub expected: String,
    /// Value found.
    pub found: String,
}

impl FormatError {
    pub(crate) fn new(part: impl Into<String>, expected: impl Into<String>, found: impl Into<String>) -> Self {
        Self { part: part.into(), expected: expected.into(), found: found.into() }
    }
}

/// Maximum size of a still scene's file, in bytes.
pub(crate) const MAX_FILE: u64 = 16 << 30;

/// Number of first bytes by which formats are recognised.
pub(crate) const HEAD: u64 = 8;

/// Returns the name and the reader of the format of a still scene with these first bytes.
pub(crate) fn format(path: &Path, head: &[u8]) -> Option<(&'static str, Reader)> {
    let only =
        READ_ONLY.iter().find(|format| (format.reader.is)(path, head)).map(|format| (format.name, format.reader));
    only.or_else(|| {
        FORMATS.iter().find(|format| (format.reader.is)(path, head)).map(|format| (format.name, format.reader))
    })
}

/// Reads a still scene from memory. The format is recognised by content; `.splat` and `.ksplat` have no magic bytes and
/// are recognised by the ending of `name`, which may be empty otherwise. Files of SpacetimeGaussians are read at time
/// 0.
///
/// # Errors
/// Bytes of an unknown format, broken content, more than the limits allow, and formats whose scene is in several files.
pub fn read(bytes: &[u8], name: &str, limits: &Limits) -> Result<Still, FormatError> {
    let head = &bytes[..bytes.len().min(HEAD as usize)];
    let Some((_, reader)) = format(Path::new(name), head) else {
        let names: Vec<&str> =
            FORMATS.iter().map(|format| format.name).chain(READ_ONLY.iter().map(|format| format.name)).collect();
        let expected = format!("a still scene ({})", names.join(", "));
        let start: Vec<String> = head.iter().map(|byte| format!("{byte:02x}")).collect();
        let found = format!("{} bytes that begin with [{}]", bytes.len(), start.join(" "));
        return Err(FormatError::new("scene in memory", expected, found));
    };
    if spacetime::is(&bytes[..bytes.len().min(ply::MAX_HEADER)]) {
        return Ok(spacetime::read(bytes, limits)?.at(0.0));
    }
    (reader.whole)(bytes, &Beside::none(), limits)
}

impl Still {
    /// Reads the still scene of a file in memory: [`read`] with the default [`Limits`] and without a name.
    ///
    /// # Errors
    /// As [`read`].
    pub fn read(bytes: &[u8]) -> Result<Still, FormatError> {
        self::read(bytes, "", &Limits::default())
    }
}
