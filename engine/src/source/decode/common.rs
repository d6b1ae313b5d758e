//! PNG, BMP, WebP, PNM and QOI, recognised by content; TGA, which has no signature, by its file name.

use std::io::Cursor;
use std::path::Path;

use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder, ImageError, ImageFormat, ImageReader, Limits};

use super::{Interleaved, MAX_ALLOC, Still, check_size, compose, decode_error, icc, orientation, png, webp};
use crate::picture::MAX_SIDE;
use crate::source::SourceError;

pub(super) fn decode(bytes: &[u8], path: &Path) -> Result<Still, SourceError> {
    let Read { image, orientation, notes } = read(bytes, path)?;
    let mut still = from_dynamic(&image, path)?;
    still.notes.extend(notes);
    still.picture = orientation::apply(still.picture, orientation);
    Ok(still)
}

/// Decodes the samples as they are stored.
pub(crate) fn decode_dynamic(bytes: &[u8], path: &Path) -> Result<DynamicImage, SourceError> {
    Ok(read(bytes, path)?.image)
}

/// Returns the limits for a decoder.
pub(super) fn limits() -> Limits {
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_SIDE as u32);
    limits.max_image_height = Some(MAX_SIDE as u32);
    limits.max_alloc = Some(MAX_ALLOC);
    limits
}

/// A decoded file and its tags.
struct Read {
    image: DynamicImage,
    orientation: Orientation,
    notes: Vec<String>,
}

fn read(bytes: &[u8], path: &Path) -> Result<Read, SourceError> {
    let format = image::guess_format(bytes)
        .ok()
        .or_else(|| ImageFormat::from_path(path).ok().filter(|format| *format == ImageFormat::Tga));
    let Some(format) = format else {
        return Err(decode_error(path, "not an image of a known kind (png, jpg, bmp, tiff, webp, exr, pnm, tga, qoi)"));
    };
    let explain = |e: ImageError| decode_error(path, format!("broken or unsupported {format:?} image: {e}"));
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    reader.limits(limits());
    let mut decoder = reader.into_decoder().map_err(explain)?;
    let (width, height) = decoder.dimensions();
    check_size(path, width as usize, height as usize)?;
    check_length(bytes, path, format, [width, height])?;
    let orientation = decoder.orientation().map_err(explain)?;
    let profile = decoder.icc_profile().map_err(explain)?.and_then(|profile| icc::note(&profile));
    let tags = if format == ImageFormat::Png { png::colour_note(bytes) } else { None };
    let image = DynamicImage::from_decoder(decoder).map_err(explain)?;
    Ok(Read { image, orientation, notes: profile.into_iter().chain(tags).collect() })
}

/// Rejects a truncated file by its header and chunks, before memory is allocated.
pub(super) fn check_length(
    bytes: &[u8],
    path: &Path,
    format: ImageFormat,
    [width, height]: [u32; 2],
) -> Result<(), SourceError> {
    let found = bytes.len();
    match format {
        ImageFormat::Png if !png_can_hold(bytes, u64::from(width), u64::from(height)) => Err(decode_error(
            path,
            format!("{found} bytes of PNG cannot hold the {width}×{height} pixels they promise"),
        )),
        ImageFormat::Png if !png::has_end(bytes) => Err(decode_error(
            path,
            format!("broken or unsupported Png image: cut off, expected its IEND chunk, found none in {found} bytes"),
        )),
        ImageFormat::WebP if webp::promised(bytes) > found as u64 => Err(decode_error(
            path,
            format!("the WebP image is cut off: expected {} bytes, found {found}", webp::promised(bytes)),
        )),
        _ => Ok(()),
    }
}

/// Returns true if a PNG file of this length can hold its pixels, with the bits per pixel of its header. A byte of
/// deflate data expands to at most 1032 bytes.
pub(crate) fn png_can_hold(bytes: &[u8], width: u64, height: u64) -> bool {
    const DEFLATE: u64 = 1032;
    let Some(&[depth, colour]) = bytes.get(24..26).and_then(|b| b.first_chunk::<2>()) else { return false };
    let channels = match colour {
        2 => 3,
        4 => 2,
        6 => 4,
        _ => 1,
    };
    width * u64::from(depth) * channels / 8 * height <= DEFLATE * bytes.len() as u64
}

/// Converts the image crate's samples to a picture.
pub(super) fn from_dynamic(image: &DynamicImage, path: &Path) -> Result<Still, SourceError> {
    let (width, height) = (image.width() as usize, image.height() as usize);
    let eight = |v: &u8| f32::from(*v) / 255.0;
    let sixteen = |v: &u16| f32::from(*v) / 65535.0;
    let (channels, samples): (usize, Vec<f32>) = match image {
        DynamicImage::ImageLuma8(i) => (1, i.as_raw().iter().map(eight).collect()),
        DynamicImage::ImageLumaA8(i) => (2, i.as_raw().iter().map(eight).collect()),
        DynamicImage::ImageRgb8(i) => (3, i.as_raw().iter().map(eight).collect()),
        DynamicImage::ImageRgba8(i) => (4, i.as_raw().iter().map(eight).collect()),
        DynamicImage::ImageLuma16(i) => (1, i.as_raw().iter().map(sixteen).collect()),
        DynamicImage::ImageLumaA16(i) => (2, i.as_raw().iter().map(sixteen).collect()),
        DynamicImage::ImageRgb16(i) => (3, i.as_raw().iter().map(sixteen).collect()),
        DynamicImage::ImageRgba16(i) => (4, i.as_raw().iter().map(sixteen).collect()),
        DynamicImage::ImageRgb32F(i) => (3, i.as_raw().clone()),
        DynamicImage::ImageRgba32F(i) => (4, i.as_raw().clone()),
        other => return Err(decode_error(path, format!("unsupported sample kind {:?}", other.color()))),
    };
    compose(&Interleaved { width, height, channels, samples, premultiplied: false }, path)
}
