//! BMP, TGA, PNM and QOI, whose files hold one picture of whole numbers.

use std::path::Path;

use image::{DynamicImage, ImageFormat};

use super::{Part, Parts, Samples, one};
use crate::source::SourceError;
use crate::source::decode::{decode_dynamic, decode_error};

/// Returns true if a file with these first bytes is one of these, or is named as TGA, which has no fixed first bytes.
pub(super) fn is(head: &[u8], path: &Path) -> bool {
    match image::guess_format(head) {
        Ok(format) => matches!(format, ImageFormat::Bmp | ImageFormat::Pnm | ImageFormat::Qoi | ImageFormat::Tga),
        Err(_) => ImageFormat::from_path(path).is_ok_and(|format| format == ImageFormat::Tga),
    }
}

pub(super) fn read(bytes: Vec<u8>, path: &Path) -> Result<Parts, SourceError> {
    of(decode_dynamic(&bytes, path)?, path).map(one)
}

/// The samples of a decoded picture.
pub(super) fn of(image: DynamicImage, path: &Path) -> Result<Part, SourceError> {
    let (width, height) = (image.width() as usize, image.height() as usize);
    let (channels, samples) = match image {
        DynamicImage::ImageLuma8(i) => (1, Samples::U8(i.into_raw())),
        DynamicImage::ImageLumaA8(i) => (2, Samples::U8(i.into_raw())),
        DynamicImage::ImageRgb8(i) => (3, Samples::U8(i.into_raw())),
        DynamicImage::ImageRgba8(i) => (4, Samples::U8(i.into_raw())),
        DynamicImage::ImageLuma16(i) => (1, Samples::U16(i.into_raw())),
        DynamicImage::ImageLumaA16(i) => (2, Samples::U16(i.into_raw())),
        DynamicImage::ImageRgb16(i) => (3, Samples::U16(i.into_raw())),
        DynamicImage::ImageRgba16(i) => (4, Samples::U16(i.into_raw())),
        DynamicImage::ImageRgb32F(i) => (3, Samples::F32(i.into_raw())),
        DynamicImage::ImageRgba32F(i) => (4, Samples::F32(i.into_raw())),
        other => return Err(decode_error(path, format!("unsupported sample kind {:?}", other.color()))),
    };
    Ok(Part::interleaved(width, height, channels, &samples))
}
