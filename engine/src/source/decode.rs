//! One image file to one [`Picture`].
//!
//! The kind is told by the file's first bytes, not by its name.
//!
//! - Integer samples of b bits become `value / (2^b − 1)`. Float samples (TIFF, EXR) are taken as display-referred and clamped
//!   to `[0, 1]`; a NaN or infinite one is an error that names the pixel.
//! - Grey is copied to the three channels. Alpha is composited over mid grey (0.5), the default background of the renderer:
//!   `c·a + 0.5·(1 − a)`; EXR colours are premultiplied as that format has it: `c + 0.5·(1 − a)`.
//! - JPEG is decoded by integer arithmetic without vector instructions, so that every CPU gives the same bytes (the decoder is
//!   built without its SIMD features); its EXIF orientation is applied. ICC profiles are ignored.
//! - Sizes are checked against [`crate::picture::size_is_allowed`] before memory for samples is taken.

use std::fs::File;
use std::io::{Cursor, Read};
use std::path::Path;

use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits, RgbImage};
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

use super::SourceError;
use crate::openexr;
use crate::picture::{MAX_SIDE, Picture, size_is_allowed};

/// Largest image file read, in bytes.
const MAX_FILE: u64 = 1 << 30;
/// Largest decoder allocation, in bytes: [`crate::picture::MAX_PIXELS`] of four f32 samples.
const MAX_ALLOC: u64 = 1 << 30;
/// Grey level behind transparent pixels.
const BEHIND: f32 = 0.5;

/// Reads a whole image file, refusing empty and huge ones.
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

/// Decodes the image file at `path`.
///
/// # Errors
/// Unreadable, empty, broken, oversized or non-finite images; each names the file.
pub fn decode_file(path: &Path) -> Result<Picture, SourceError> {
    decode(&read_file(path)?, path)
}

/// Decodes an image held in memory; `path` is for the messages.
///
/// # Errors
/// As [`decode_file`].
pub fn decode(bytes: &[u8], path: &Path) -> Result<Picture, SourceError> {
    match bytes {
        [0xff, 0xd8, ..] => decode_jpeg(bytes, path),
        [0x76, 0x2f, 0x31, 0x01, ..] => decode_exr(bytes, path),
        [b'I', b'I', 42, 0, ..] | [b'M', b'M', 0, 42, ..] => super::tiff::decode(bytes, path),
        _ if is_animated_webp(bytes) => Err(decode_error(
            path,
            "expected one picture, found an animated WebP; give its frames as a folder of images or as a video (ffmpeg does not read it either)",
        )),
        _ => from_dynamic(&decode_dynamic(bytes, path)?, path),
    }
}

/// Returns true if a WebP file says of itself that it is animated.
fn is_animated_webp(bytes: &[u8]) -> bool {
    let flags = bytes.get(20).copied().unwrap_or_default();
    bytes.starts_with(b"RIFF") && bytes.get(8..16) == Some(b"WEBPVP8X") && flags & 2 != 0
}

pub(super) fn decode_error(path: &Path, cause: impl Into<String>) -> SourceError {
    SourceError::Decode { path: path.to_owned(), cause: cause.into() }
}

/// Returns true if an image says in its header that it has alpha. Of TIFF and OpenEXR nothing is known before they are decoded.
pub(crate) fn has_alpha(path: &Path) -> bool {
    let reader = ImageReader::open(path).and_then(ImageReader::with_guessed_format);
    let decoder = reader.map(|mut reader| {
        let mut limits = Limits::default();
        limits.max_alloc = Some(MAX_ALLOC);
        reader.limits(limits);
        reader.into_decoder()
    });
    matches!(decoder, Ok(Ok(decoder)) if decoder.color_type().has_alpha())
}

/// PNG, BMP, WebP, PNM, QOI by their content; TGA, which has no signature, by its name.
pub(crate) fn decode_dynamic(bytes: &[u8], path: &Path) -> Result<DynamicImage, SourceError> {
    let format = image::guess_format(bytes)
        .ok()
        .or_else(|| ImageFormat::from_path(path).ok().filter(|format| *format == ImageFormat::Tga));
    let Some(format) = format else {
        return Err(decode_error(path, "not an image of a known kind (png, jpg, bmp, tiff, webp, exr, pnm, tga, qoi)"));
    };
    let limits = || {
        let mut limits = Limits::default();
        limits.max_image_width = Some(MAX_SIDE as u32);
        limits.max_image_height = Some(MAX_SIDE as u32);
        limits.max_alloc = Some(MAX_ALLOC);
        limits
    };
    let reader = || {
        let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
        reader.limits(limits());
        reader
    };
    let explain = |e: image::ImageError| decode_error(path, format!("broken or unsupported {format:?} image: {e}"));
    let (width, height) = reader().into_dimensions().map_err(explain)?;
    check_size(path, width as usize, height as usize)?;
    if format == ImageFormat::Png && !png_can_hold(bytes, u64::from(width), u64::from(height)) {
        let found = bytes.len();
        return Err(decode_error(
            path,
            format!("{found} bytes of PNG cannot hold the {width}×{height} pixels they promise"),
        ));
    }
    reader().decode().map_err(explain)
}

/// Returns true if a PNG file of this length can hold its pixels, by the bits of one in its header: a byte of deflate's gives 1032 bytes at most.
fn png_can_hold(bytes: &[u8], width: u64, height: u64) -> bool {
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

pub(super) fn check_size(path: &Path, width: usize, height: usize) -> Result<(), SourceError> {
    if size_is_allowed(width, height) {
        Ok(())
    } else {
        Err(SourceError::TooLarge { path: path.to_owned(), width, height })
    }
}

fn from_dynamic(image: &DynamicImage, path: &Path) -> Result<Picture, SourceError> {
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

/// Samples as a decoder gives them: 1 grey, 2 grey and alpha, 3 colour, 4 colour and alpha.
pub(super) struct Interleaved {
    pub width: usize,
    pub height: usize,
    pub channels: usize,
    pub samples: Vec<f32>,
    pub premultiplied: bool,
}

/// To planes: grey copied, alpha composited, clamped to [0,1].
pub(super) fn compose(image: &Interleaved, path: &Path) -> Result<Picture, SourceError> {
    let Interleaved { width, height, channels, ref samples, premultiplied } = *image;
    check_size(path, width, height)?;
    let plane = width * height;
    if !(1..=4).contains(&channels) || samples.len() != plane * channels {
        return Err(decode_error(path, format!("expected {plane} pixels, found {} samples", samples.len())));
    }
    let mut rgb = vec![0.0; 3 * plane];
    for (pixel, values) in samples.chunks_exact(channels).enumerate() {
        if let Some(&value) = values.iter().find(|v| !v.is_finite()) {
            return Err(SourceError::NotFinite { path: path.to_owned(), x: pixel % width, y: pixel / width, value });
        }
        let alpha = if channels % 2 == 0 { values[channels - 1].clamp(0.0, 1.0) } else { 1.0 };
        for channel in 0..3 {
            let colour = values[if channels < 3 { 0 } else { channel }];
            let colour = if alpha == 1.0 {
                colour
            } else if premultiplied {
                colour + BEHIND * (1.0 - alpha)
            } else {
                colour * alpha + BEHIND * (1.0 - alpha)
            };
            rgb[channel * plane + pixel] = colour.clamp(0.0, 1.0);
        }
    }
    Ok(Picture { width, height, rgb })
}

fn decode_jpeg(bytes: &[u8], path: &Path) -> Result<Picture, SourceError> {
    let explain = |e: &dyn std::fmt::Debug| decode_error(path, format!("broken or unsupported JPEG image: {e:?}"));
    let options = DecoderOptions::default()
        .set_strict_mode(false)
        .set_max_width(MAX_SIDE)
        .set_max_height(MAX_SIDE)
        .jpeg_set_out_colorspace(ColorSpace::RGB);
    let mut decoder = zune_jpeg::JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    decoder.decode_headers().map_err(|e| explain(&e))?;
    let (width, height) = decoder.dimensions().ok_or_else(|| decode_error(path, "JPEG image without a size"))?;
    check_size(path, width, height)?;
    let pixels = decoder.decode().map_err(|e| explain(&e))?;
    let orientation = decoder.exif().and_then(|chunk| Orientation::from_exif_chunk(chunk));
    let found = pixels.len();
    let Some(image) = RgbImage::from_raw(width as u32, height as u32, pixels) else {
        return Err(decode_error(path, format!("expected {width}×{height} RGB pixels, found {found} bytes")));
    };
    let mut image = DynamicImage::ImageRgb8(image);
    image.apply_orientation(orientation.unwrap_or(Orientation::NoTransforms));
    from_dynamic(&image, path)
}

fn decode_exr(bytes: &[u8], path: &Path) -> Result<Picture, SourceError> {
    let planes = openexr::read(bytes).map_err(|e| decode_error(path, e.to_string()))?;
    let colour: Vec<&[f32]> = match (planes.channel("R"), planes.channel("G"), planes.channel("B"), planes.channel("Y"))
    {
        (Some(r), Some(g), Some(b), _) => vec![r, g, b],
        (.., Some(y)) => vec![y],
        _ => {
            let names: Vec<_> = planes.channels.iter().map(|(name, _)| name.as_str()).collect();
            return Err(decode_error(path, format!("expected EXR channels R, G, B or Y, found {}", names.join(", "))));
        }
    };
    let alpha = planes.channel("A");
    let channels = colour.len() + usize::from(alpha.is_some());
    let mut samples = Vec::with_capacity(channels * planes.width * planes.height);
    for pixel in 0..planes.width * planes.height {
        samples.extend(colour.iter().chain(alpha.iter()).map(|plane| plane[pixel]));
    }
    compose(&Interleaved { width: planes.width, height: planes.height, channels, samples, premultiplied: true }, path)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn png(image: &DynamicImage) -> Vec<u8> {
        let mut bytes = Cursor::new(Vec::new());
        image.write_to(&mut bytes, ImageFormat::Png).expect("memory");
        bytes.into_inner()
    }

    #[test]
    fn eight_and_sixteen_bit_samples_keep_their_precision() {
        let eight = DynamicImage::ImageRgb8(RgbImage::from_raw(1, 1, vec![0, 128, 255]).expect("one pixel"));
        assert_eq!(decode(&png(&eight), Path::new("a.png")).expect("valid").rgb, [0.0, 128.0 / 255.0, 1.0]);
        let sixteen = image::ImageBuffer::from_raw(1, 1, vec![1u16, 32768, 65535]).expect("one pixel");
        let picture = decode(&png(&DynamicImage::ImageRgb16(sixteen)), Path::new("a.png")).expect("valid");
        assert_eq!(picture.rgb, [1.0 / 65535.0, 32768.0 / 65535.0, 1.0]);
    }

    #[test]
    fn alpha_is_composited_over_mid_grey() {
        let image = image::ImageBuffer::from_raw(2, 1, vec![255u8, 0, 0, 0, 255, 0, 0, 255]).expect("two pixels");
        let picture = decode(&png(&DynamicImage::ImageRgba8(image)), Path::new("a.png")).expect("valid");
        assert_eq!(picture.rgb, [0.5, 1.0, 0.5, 0.0, 0.5, 0.0]);
    }

    #[test]
    fn a_non_finite_exr_sample_names_its_pixel_and_bright_ones_are_clamped() {
        let mut planes =
            openexr::Planes { width: 2, height: 2, channels: vec![("Y".into(), vec![0.25, 7.0, -1.0, 0.5])] };
        let encode = |planes: &openexr::Planes| {
            let mut bytes = Vec::new();
            openexr::write(planes, "", &mut bytes).expect("memory");
            bytes
        };
        let picture = decode(&encode(&planes), Path::new("a.exr")).expect("valid");
        assert_eq!(picture.rgb[..4], [0.25, 1.0, 0.0, 0.5]);
        planes.channels[0].1[3] = f32::NAN;
        let error = decode(&encode(&planes), Path::new("a.exr")).expect_err("NaN");
        assert!(matches!(error, SourceError::NotFinite { x: 1, y: 1, .. }), "{error}");
    }

    #[test]
    fn truncated_images_and_foreign_bytes_are_errors() {
        let image = DynamicImage::ImageRgb8(RgbImage::from_fn(40, 30, |x, y| image::Rgb([x as u8, y as u8, 7])));
        let bytes = png(&image);
        for end in [1, 8, 20, bytes.len() / 2] {
            assert!(decode(&bytes[..end], Path::new("a.png")).is_err(), "{end} bytes");
        }
        for foreign in
            [&b"hello, this is text"[..], &[0xff, 0xd8, 0xff, 0xe0, 0, 16], &[0x76, 0x2f, 0x31, 0x01], b"II*\0"]
        {
            assert!(decode(foreign, Path::new("a.png")).is_err());
        }
    }

    #[test]
    fn a_header_that_promises_a_huge_image_is_refused() {
        let mut bytes = png(&DynamicImage::ImageRgb8(RgbImage::new(3, 3)));
        // Width and height of the IHDR chunk; its checksum is at 29.
        bytes[16..24].copy_from_slice(&[0, 0, 0x7f, 0xff, 0, 0, 0x7f, 0xff]);
        let crc = {
            let mut table = [0u32; 256];
            for (n, entry) in table.iter_mut().enumerate() {
                *entry = (0..8).fold(n as u32, |c, _| if c & 1 == 1 { 0xedb8_8320 ^ (c >> 1) } else { c >> 1 });
            }
            !bytes[12..29].iter().fold(!0u32, |c, &b| table[((c ^ u32::from(b)) & 255) as usize] ^ (c >> 8))
        };
        bytes[29..33].copy_from_slice(&crc.to_be_bytes());
        let error = decode(&bytes, Path::new("a.png")).expect_err("32767×32767");
        assert!(matches!(error, SourceError::TooLarge { width: 32767, height: 32767, .. }), "{error}");
    }
}
