//! PLY in the layout of 3D Gaussian splatting.
//!
//! An element `vertex` with the scalar properties, in any order,
//!
//! | property | value |
//! |---|---|
//! | `x`, `y`, `z` | centre |
//! | `f_dc_0` … `f_dc_2` | first coefficients of the harmonics, by channel |
//! | `f_rest_0` … | the other coefficients: none, 9, 24, 45 or 72 of them for degrees 0 to 4, all of the first channel, then the second, then the third; those of degree 4 are left out |
//! | `opacity` | logit |
//! | `scale_0` … `scale_2` | natural logarithms of standard deviations; without `scale_2`, as of 2D Gaussian splatting, the thickness is 0 |
//! | `rot_0` … `rot_3` | quaternion, w first |
//!
//! Floats have 16, 32 or 64 bits. Centres that are doubles, and so far from zero that binary32 would not keep them to
//! 1/4096, are read relative to an integer, the scene's offset. If `f_dc` is absent, `red`, `green` and `blue` replace
//! it, as floats from 0 to 1 or as unsigned integers of 8 or 16 bits: `(c − ½) / Y₀`.
//!
//! Left out are other scalar properties (for example normals), other elements of scalar properties, lists of elements
//! without records, and up to 16 line ends or zeros after the last element. Comments may have any encoding;
//! `comments.rs` lists those that are read. The body is binary of either byte order, or text with one record per line.
//! Files with vertices packed into chunks are read by [`compressed_ply`].
//!
//! Anything else is an error that names the element, the property or the line: a list, a duplicate property, a length
//! that does not match the header. Numbers that are not finite are kept; [`Still::defect`] finds the Gaussians that
//! cannot be drawn.

mod columns;
mod comments;
mod header;
#[cfg(test)]
mod tests;
mod vertices;
mod write;

use std::path::Path;

use super::blocks::{Blocks, ReadError};
use super::{FormatError, Limits, compressed_ply};
use crate::still::Still;
pub(crate) use columns::left_out;
pub(super) use columns::{Column, columns};
pub(super) use comments::{read as read_comments, written as comments};
pub(crate) use header::MAX_HEADER;
pub(in crate::formats) use header::{Element, Encoding, Header, Scalar};
pub use write::write;

/// Number of bytes that contain the header of most files.
const USUAL_HEADER: u64 = 1 << 16;

/// Reads the Gaussians of a whole PLY file.
///
/// # Errors
/// See [`formats`](super): expected and found values, with the property's name.
pub fn read(bytes: &[u8]) -> Result<Still, FormatError> {
    within(bytes, &Limits::default())
}

/// Returns true if a file with this name and these first bytes has the format.
pub(super) fn is(_path: &Path, head: &[u8]) -> bool {
    head.starts_with(b"ply\n") || head.starts_with(b"ply\r")
}

/// Reads a binary file with at most one block of it in memory. Returns `None` for other files.
pub(super) fn blocks(file: &mut Blocks<'_>, limits: &Limits) -> Result<Option<Still>, ReadError> {
    // Longer headers are rare, and reading that many bytes of every file would cost time.
    let usual = Header::read(file.head(USUAL_HEADER)?).is_ok();
    let head = file.head(if usual { USUAL_HEADER } else { MAX_HEADER as u64 })?;
    let (header, body) = Header::read(head)?;
    let start = head.len() - body.len();
    if compressed_ply::is_packed(&header) || header.encoding == Encoding::Text {
        return Ok(None);
    }
    vertices::blocks(&header, start as u64, file, limits).map(Some)
}

/// Reads a file as [`read`] does, within other limits.
pub(super) fn within(bytes: &[u8], limits: &Limits) -> Result<Still, FormatError> {
    let (header, body) = Header::read(bytes)?;
    match header.encoding {
        _ if compressed_ply::is_packed(&header) => compressed_ply::read(&header, body, limits),
        Encoding::Text => vertices::text(&header, body, limits),
        Encoding::Little | Encoding::Big => vertices::binary(&header, body, limits),
    }
}
