//! PLY in the layout of 3D Gaussian splatting.
//!
//! One element, `vertex`, with the scalar properties (of type `float` or `double`, in any order)
//!
//! | property | what |
//! |---|---|
//! | `x`, `y`, `z` | centre |
//! | `f_dc_0` … `f_dc_2` | first coefficients of the harmonics, by channel |
//! | `f_rest_0` … | the other coefficients: none, 9, 24 or 45 of them for degrees 0 to 3, all of the first channel, then the second, then the third |
//! | `opacity` | logit |
//! | `scale_0` … `scale_2` | natural logarithms of standard deviations |
//! | `rot_0` … `rot_3` | quaternion, w first |
//!
//! Other scalar properties, normals among them, are left out. Binary of either byte order, or text with one vertex per line. Anything
//! else is an error that names the property or the line: another element, a list, a property twice, a file that is shorter or longer
//! than its header says. Numbers that are not finite are kept; what has one is left out where it is drawn.

mod body;
mod header;
#[cfg(test)]
mod tests;

use super::{FormatError, Limits};
use crate::still::Still;
use header::{Encoding, Header};

/// The Gaussians of a whole PLY file.
///
/// # Errors
/// See [`import`](super): what was expected and what was found, with the property's name.
pub fn ply(bytes: &[u8]) -> Result<Still, FormatError> {
    within(bytes, &Limits::default())
}

/// As [`ply`], within other limits.
pub(super) fn within(bytes: &[u8], limits: &Limits) -> Result<Still, FormatError> {
    let (header, body) = Header::read(bytes)?;
    match header.encoding {
        Encoding::Text => body::text(&header, body, limits),
        Encoding::Little => body::binary(&header, body, limits, f32::from_le_bytes, f64::from_le_bytes),
        Encoding::Big => body::binary(&header, body, limits, f32::from_be_bytes, f64::from_be_bytes),
    }
}
