//! One image file to one [`Picture`].
//!
//! The format is detected by the file's first bytes, not by its name.
//!
//! - Integer samples of b bits become `value / (2^b − 1)`. Float samples of TIFF are treated as display-referred. Those
//!   of EXR are linear light unless the file declares another space, and become sRGB (`exr`). Both are clamped to `[0,
//!   1]` with a note; a NaN or infinite sample is an error with the pixel's position.
//! - Grey is copied to the three channels. Alpha is composited over mid grey (0.5), the default background of the
//!   renderer: `c·a + 0.5·(1 − a)`. Premultiplied colours (EXR, and TIFF with associated alpha) become `c + 0.5·(1 −
//!   a)`.
//! - JPEG is decoded by integer arithmetic, so that every CPU decodes the same bytes (the decoder is built without its
//!   SIMD features).
//! - Orientation is applied in JPEG, PNG, WebP and TIFF. Colour profiles and tags of a space other than sRGB are not
//!   applied; they add a note.
//! - Files that are truncated or damaged are errors, as are files of several frames where one picture is expected.
//! - Sizes are checked against [`crate::picture::size_is_allowed`] before memory for samples is taken.

mod common;
mod exr;
mod frames;
mod icc;
mod jpeg;
mod jpeg_scan;
mod orientation;
mod png;
mod tiff;
mod webp;

use std::fs::File;
use std::io::Read;
use std::path::Path;

use super::SourceError;
use crate::picture::{Picture, size_is_allowed};
pub(crate) use common::{decode_dynamic, png_can_hold};
pub(crate) use frames::{Sequence, Several};
pub(crate) use jpeg::has_end as jpeg_has_end;
pub(crate) use tiff::{as_grey as tiff_palette_as_grey, eight_bits_at, grey as tiff_grey, is as is_tiff};

/// Largest image file read, in bytes.
const MAX_FILE: u64 = 1 << 30;
/// Largest decoder allocation, in bytes: [`crate::picture::MAX_PIXELS`] of four f32 samples.
const MAX_ALLOC: u64 = 1 << 30;
/// Grey level behind transparent pixels.
const BEHIND: f32 = 0.5;

/// Reads a whole image file; empty files and files above [`MAX_FILE`] are errors.
pub(crate) fn read_file(path: &Path) -> Result<Vec<u8>, SourceError> {
    let mut file = File::open(path).map_err(SourceError::read(path))?;
    let size = file.metadata().map_err(SourceError::read(path))?.len();
    if size > MAX_FILE {
        return Err(decode_error(path, format!("the file has {size} bytes, expected at most {MAX_FILE}")));
    }
    let mut bytes = Vec::with_capacity(size as usize);
    Read::by_ref(&mut file).take(MAX_FILE).read_to_end(&mut bytes).map_err(SourceError::read(path))?;
    if bytes.is_empty() {
        return Err(SourceError::EmptyFile { path: path.to_owned() });
    }
    Ok(bytes)
}

/// Note on alpha.
pub(crate) const OVER_GREY: &str = "transparent parts are laid over mid grey";
/// Note on colours outside the display's range.
const CLAMPED: &str = "colours outside 0 to 1 are clamped";
/// Note on CMYK.
const INKS: &str = "CMYK is converted without a colour profile";

/// A decoded picture, and the notes on its conversion, a line each.
#[derive(Clone, Debug, PartialEq)]
pub struct Still {
    /// The picture.
    pub picture: Picture,
    /// Conversions, and parts or tags that were left out.
    pub notes: Vec<String>,
}

/// Decodes the image file at `path`.
///
/// # Errors
/// Unreadable, empty, broken, oversized or non-finite images, and files of several frames; each names the file.
pub fn decode_file(path: &Path) -> Result<Picture, SourceError> {
    decode(&read_file(path)?, path)
}

/// Decodes an image held in memory; `path` is for the messages.
///
/// # Errors
/// As [`decode_file`].
pub fn decode(bytes: &[u8], path: &Path) -> Result<Picture, SourceError> {
    Ok(still(bytes, path)?.picture)
}

/// Decodes as [`decode`] does, and returns the notes on the conversion too.
///
/// # Errors
/// As [`decode_file`].
pub fn still(bytes: &[u8], path: &Path) -> Result<Still, SourceError> {
    if let Some(several) = Several::of(bytes, path)? {
        return Err(several.refusal(path));
    }
    let mut found = match bytes {
        [0xff, 0xd8, ..] => jpeg::decode(bytes, path),
        [0x76, 0x2f, 0x31, 0x01, ..] => exr::decode(bytes, path),
        _ if tiff::is(bytes) => tiff::page(bytes, 0, path),
        _ => common::decode(bytes, path),
    }?;
    if let Some((x, y)) = density(bytes).filter(|(x, y)| x.abs_diff(*y) > x / 100 && *x > 0 && *y > 0) {
        found.notes.push(format!("pixels of {y}:{x}, by the resolution in the file, are taken as square"));
    }
    Ok(found)
}

/// Returns the pixels per unit along x and y that a PNG or a JPEG of JFIF declares.
fn density(bytes: &[u8]) -> Option<(u32, u32)> {
    if bytes.starts_with(&[0xff, 0xd8, 0xff, 0xe0]) && bytes.get(6..11) == Some(b"JFIF\0") {
        let side = |at: usize| Some(u32::from(u16::from_be_bytes(*bytes.get(at..)?.first_chunk()?)));
        return side(14).zip(side(16));
    }
    let mut rest = bytes.strip_prefix(b"\x89PNG\r\n\x1a\n")?;
    loop {
        let word = |at: usize| Some(u32::from_be_bytes(*rest.get(at..)?.first_chunk()?));
        match rest.get(4..8)? {
            b"pHYs" => return word(8).zip(word(12)),
            b"IDAT" => return None,
            _ => rest = rest.get((word(0)? as usize).checked_add(12)?..)?,
        }
    }
}

pub(crate) fn decode_error(path: &Path, cause: impl Into<String>) -> SourceError {
    SourceError::Decode { path: path.to_owned(), cause: cause.into() }
}

pub(crate) fn check_size(path: &Path, width: usize, height: usize) -> Result<(), SourceError> {
    if size_is_allowed(width, height) {
        Ok(())
    } else {
        Err(SourceError::TooLarge { path: path.to_owned(), width, height })
    }
}

/// Decoded samples, interleaved. Channels: 1 grey, 2 grey and alpha, 3 colour, 4 colour and alpha.
struct Interleaved {
    pub width: usize,
    pub height: usize,
    pub channels: usize,
    pub samples: Vec<f32>,
    pub premultiplied: bool,
}

/// Converts samples to planes: grey copied, alpha composited, clamped to [0,1].
fn compose(image: &Interleaved, path: &Path) -> Result<Still, SourceError> {
    /// Clamping by more than this adds a note: half a step of eight bits.
    const OUTSIDE: f32 = 0.5 / 255.0;
    let Interleaved { width, height, channels, ref samples, premultiplied } = *image;
    check_size(path, width, height)?;
    let plane = width * height;
    if !(1..=4).contains(&channels) || samples.len() != plane * channels {
        return Err(decode_error(path, format!("expected {plane} pixels, found {} samples", samples.len())));
    }
    let (mut over_grey, mut clamped) = (false, false);
    let mut rgb = vec![0.0; 3 * plane];
    for (pixel, values) in samples.chunks_exact(channels).enumerate() {
        if let Some(&value) = values.iter().find(|v| !v.is_finite()) {
            return Err(SourceError::NotFinite { path: path.to_owned(), x: pixel % width, y: pixel / width, value });
        }
        let alpha = if channels % 2 == 0 { values[channels - 1].clamp(0.0, 1.0) } else { 1.0 };
        over_grey |= alpha < 1.0;
        for channel in 0..3 {
            let colour = values[if channels < 3 { 0 } else { channel }];
            let colour = if alpha == 1.0 {
                colour
            } else if premultiplied {
                colour + BEHIND * (1.0 - alpha)
            } else {
                colour * alpha + BEHIND * (1.0 - alpha)
            };
            clamped |= !(-OUTSIDE..=1.0 + OUTSIDE).contains(&colour);
            rgb[channel * plane + pixel] = colour.clamp(0.0, 1.0);
        }
    }
    let notes = [(over_grey, OVER_GREY), (clamped, CLAMPED)];
    let notes = notes.into_iter().filter(|(found, _)| *found).map(|(_, note)| note.to_owned()).collect();
    Ok(Still { picture: Picture { width, height, rgb }, notes })
}

#[cfg(test)]
pub(super) mod tests;
