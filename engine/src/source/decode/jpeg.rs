//! JPEG, by integer arithmetic without vector instructions: every CPU decodes the same bytes.
//!
//! Headers are read leniently, picture data strictly. Invalid codes, a file without its end-of-image marker, and a
//! baseline image whose codes do not cover the whole picture are errors ([`super::jpeg_scan`]). Damage that keeps the
//! number of codes is not detected, nor is most damage of progressive images. CMYK is converted without a colour
//! profile, `(1 − ink)·(1 − black)`.

use std::path::Path;

use image::metadata::Orientation;
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

use super::{Still, check_size, decode_error, icc, jpeg_scan, orientation};
use crate::picture::{MAX_SIDE, Picture};
use crate::source::SourceError;

pub(super) fn decode(bytes: &[u8], path: &Path) -> Result<Still, SourceError> {
    let explain = |e: &dyn std::fmt::Debug| {
        // Some of the decoder's messages end with a newline.
        let text = format!("{e:?}");
        let words: Vec<&str> = text.split_whitespace().collect();
        decode_error(path, format!("broken or unsupported JPEG image: {}", words.join(" ")))
    };
    let options = DecoderOptions::default()
        .set_strict_mode(false)
        .set_max_width(MAX_SIDE)
        .set_max_height(MAX_SIDE)
        .jpeg_set_out_colorspace(ColorSpace::RGB);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    decoder.decode_headers().map_err(|e| explain(&e))?;
    let (width, height) = decoder.dimensions().ok_or_else(|| decode_error(path, "JPEG image without a size"))?;
    check_size(path, width, height)?;
    if !has_end(bytes) {
        let found = bytes.len();
        return Err(decode_error(
            path,
            format!("the JPEG image is cut off: expected an end-of-image marker, found none in {found} bytes"),
        ));
    }
    let inks = matches!(decoder.input_colorspace(), Some(ColorSpace::CMYK | ColorSpace::YCCK));
    decoder.set_options(options.set_strict_mode(true));
    let pixels = decoder.decode().map_err(|e| explain(&e))?;
    jpeg_scan::check(bytes).map_err(|cause| decode_error(path, cause))?;
    let turned = decoder.exif().and_then(|chunk| Orientation::from_exif_chunk(chunk));
    let Some(picture) = Picture::from_rgb8(width, height, &pixels) else {
        let found = pixels.len();
        return Err(decode_error(path, format!("expected {width}×{height} RGB pixels, found {found} bytes")));
    };
    let mut notes: Vec<String> = decoder.icc_profile().and_then(|profile| icc::note(&profile)).into_iter().collect();
    if inks {
        notes = vec![super::INKS.to_owned()];
    }
    Ok(Still { picture: orientation::apply(picture, turned.unwrap_or(Orientation::NoTransforms)), notes })
}

/// Returns true if a file contains the marker that ends its first image.
pub(crate) fn has_end(bytes: &[u8]) -> bool {
    let mut at = 2;
    while let Some((marker, _)) = jpeg_scan::segment(bytes, &mut at) {
        if marker == jpeg_scan::END {
            return true;
        }
    }
    false
}
