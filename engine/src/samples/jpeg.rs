//! JPEG: one picture, grey, RGB or CMYK, decoded like frames of a video.

use std::path::Path;

use image::metadata::Orientation;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

use super::orientation::oriented;
use super::{Part, Parts, Samples, one};
use crate::picture::MAX_SIDE;
use crate::source::SourceError;
use crate::source::decode::{check_size, decode_error, jpeg_has_end};

pub(super) fn read(bytes: Vec<u8>, path: &Path) -> Result<Parts, SourceError> {
    let broken = |e: &dyn std::fmt::Debug| decode_error(path, format!("broken or unsupported JPEG image: {e:?}"));
    if !jpeg_has_end(&bytes) {
        return Err(decode_error(path, "the JPEG image ends before its end marker: expected the whole file"));
    }
    // Strict: missing data are an error, not grey.
    let options = DecoderOptions::default().set_strict_mode(true).set_max_width(MAX_SIDE).set_max_height(MAX_SIDE);
    let mut decoder = zune_jpeg::JpegDecoder::new_with_options(ZCursor::new(&bytes), options);
    decoder.decode_headers().map_err(|e| broken(&e))?;
    let (width, height) = decoder.dimensions().ok_or_else(|| decode_error(path, "JPEG image without a size"))?;
    check_size(path, width, height)?;
    let (space, names): (ColorSpace, &[&str]) = match decoder.input_colorspace() {
        Some(ColorSpace::Luma) => (ColorSpace::Luma, &["Y"]),
        Some(ColorSpace::CMYK) => (ColorSpace::CMYK, &["C", "M", "Y", "K"]),
        Some(ColorSpace::YCCK) => (ColorSpace::YCCK, &["Y", "Cb", "Cr", "K"]),
        _ => (ColorSpace::RGB, &["R", "G", "B"]),
    };
    decoder.set_options(options.jpeg_set_out_colorspace(space));
    let pixels = decoder.decode().map_err(|e| broken(&e))?;
    if pixels.len() != names.len() * width * height {
        let (expected, found) = (names.len() * width * height, pixels.len());
        return Err(decode_error(path, format!("expected {expected} samples, found {found}")));
    }
    let orientation = decoder.exif().and_then(|chunk| Orientation::from_exif_chunk(chunk));
    let part = Part::named(width, height, names, &Samples::U8(pixels));
    Ok(one(oriented(part, orientation.unwrap_or(Orientation::NoTransforms))))
}
