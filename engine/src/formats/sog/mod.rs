//! SOG, versions 1 and 2: images with a value per Gaussian, and a `meta.json` with their ranges and codebooks. The
//! files are in one zip file (`.sog`) or in one folder.
//!
//! The value of Gaussian i is in pixel i, row by row. N is a byte, n = N/255, and cb is a codebook of 256 values.
//!
//! | image | pixel | value |
//! |---|---|---|
//! | `means`: low bytes, high bytes | red, green, blue | `m = min + (max − min)·(256·high + low) / 65535`, the centre `sign(m)·(e^|m| − 1)` |
//! | `scales` | red, green, blue | `cb[N]`, logarithms |
//! | `quats` | red, green, blue | the three smallest of w, x, y, z in that order: `(n − ½)·√2` |
//! | | alpha | 252 and which of them is the largest |
//! | `sh0` | red, green, blue | `cb[N]`, the harmonics' first coefficients |
//! | | alpha | n, the opacity |
//! | `shN`: centroids, labels | labels: red, green | `256·green + red`, a row of coefficients |
//! | | centroids: red, green, blue | `cb[N]`; coefficient k of row r in column `(r mod 64)·K + k` of line `⌊r / 64⌋`, for the K of the degree |
//!
//! `"model": "antialiased"` in `meta.json` marks scenes trained with anti-aliasing; this program adds the scene's
//! `offset`. Version 1 has no version number. Instead of codebooks it has a least and a greatest value per channel,
//! between which bytes are spaced evenly; its opacities are logits.
//!
//! Source: PlayCanvas, the SOG format's description.

mod codebook;
mod files;
mod meta;
mod palette;
#[cfg(test)]
mod tests;
mod write;

use std::io::Cursor;
use std::path::Path;

use image::codecs::webp::WebPDecoder;
use image::{DynamicImage, ImageDecoder, RgbaImage};
use streamsplat_kernels::harmonics::rest;
use streamsplat_kernels::math::f64::{exp, ln};

use super::{Beside, FormatError, Limits};
use crate::still::{LEAST, Still};
use files::Files;
use meta::Meta;
pub use write::write;

/// First bytes of a zip file.
pub(super) const MAGIC: [u8; 4] = *b"PK\x03\x04";
/// Rows of coefficients per line of the centroids' image.
const ROWS: usize = 64;
/// The alpha of a rotation whose first component is the largest.
const LARGEST: u8 = 252;

/// The model of scenes trained with anti-aliasing.
const MODEL: &str = "antialiased";

/// Reads the Gaussians of a whole `.sog` file.
///
/// # Errors
/// Returns a [`FormatError`] with the name of the part and the expected and found values.
pub fn read(bytes: &[u8]) -> Result<Still, FormatError> {
    within(bytes, &Beside::none(), &Limits::default())
}

/// Returns true if a file with this name and these first bytes has the format.
pub(super) fn is(path: &Path, head: &[u8]) -> bool {
    let is_meta = path.file_name().is_some_and(|name| name == "meta.json");
    head.starts_with(&MAGIC) || is_meta && head.starts_with(b"{")
}

/// Reads a scene as [`read`] does, also from a `meta.json`, with images read through `beside`.
pub(super) fn within(bytes: &[u8], beside: &Beside, limits: &Limits) -> Result<Still, FormatError> {
    let mut files = Files::new(bytes, beside)?;
    let meta = Meta::read(&files.meta()?)?;
    let count = meta.count;
    limits.check_still("meta.json: count", count, meta.most_degree(), files.size(meta.images()))?;
    let mut image = |name: &str, least: usize| image(&files.read(name, 8 * most(least) as u64)?, name, least);
    let [low, high] = [image(&meta.means.files[0], count)?, image(&meta.means.files[1], count)?];
    let [scales, quats] = [image(&meta.scales.files[0], count)?, image(&meta.quats.files[0], count)?];
    let sh0 = image(&meta.sh0.files[0], count)?;
    let harmonics =
        meta.harmonics.as_ref().map(|own| Ok::<_, FormatError>((own, image(&own.files[0], 0)?))).transpose()?;
    let degree = match &harmonics {
        None => 0,
        Some((own, image)) if own.bands == 0 => degree_of_width(image, &own.files[0])?,
        Some((own, _)) => own.bands,
    };

    let mut still = Still::with_room(count, degree);
    still.about = meta.about();
    let pixel = |image: &RgbaImage, i: usize| pixel(image, i % image.width() as usize, i / image.width() as usize);
    for i in 0..count {
        let (low, high) = (pixel(&low, i), pixel(&high, i));
        still.mean.push(std::array::from_fn(|axis| {
            let share = f64::from(u16::from_le_bytes([low[axis], high[axis]])) / 65535.0;
            let (least, greatest) = (meta.means.mins[axis], meta.means.maxs[axis]);
            let m = least + (greatest - least) * share;
            // Above 100, a centre would be infinite in binary32.
            let size = exp(m.abs().min(100.0)) - 1.0;
            (if m < 0.0 { -size } else { size }) as f32
        }));
        let scale = pixel(&scales, i);
        still.log_scale.push(std::array::from_fn(|axis| meta.scales.value(axis, scale[axis])));
        still.rotation.push(rotation(pixel(&quats, i), i)?);
        let [red, green, blue, alpha] = pixel(&sh0, i);
        let colour = [red, green, blue];
        still.base.push(std::array::from_fn(|channel| meta.sh0.value(channel, colour[channel])));
        let opacity = (f64::from(alpha) / 255.0).clamp(LEAST, 1.0 - LEAST);
        // Version 1 has logits in a table.
        still.logit.push(meta.sh0.alpha(alpha).unwrap_or((ln(opacity) - ln(1.0 - opacity)) as f32));
    }
    if let Some((harmonics, centroids)) = harmonics {
        let width = rest(degree);
        let rows = if harmonics.count == 0 { ROWS * centroids.height() as usize } else { harmonics.count };
        let lines = rows.div_ceil(ROWS);
        if (centroids.width() as usize) < ROWS * width || (centroids.height() as usize) < lines {
            let expected = format!("{}×{lines} pixels at least", ROWS * width);
            let found = format!("{}×{}", centroids.width(), centroids.height());
            return Err(FormatError::new(harmonics.files[0].clone(), expected, found));
        }
        let labels = image(&harmonics.files[1], count)?;
        for i in 0..count {
            let [low, high, ..] = pixel(&labels, i);
            let row = usize::from(u16::from_le_bytes([low, high]));
            if row >= rows {
                let part = format!("{}: label {i}", harmonics.files[1]);
                return Err(FormatError::new(part, format!("one of {rows} rows"), row.to_string()));
            }
            for k in 0..width {
                let [red, green, blue, _] = self::pixel(&centroids, row % ROWS * width + k, row / ROWS);
                still.higher.extend([red, green, blue].map(|c| harmonics.value(c)));
            }
        }
    }
    Ok(still)
}

/// Returns the degree of the harmonics in version 1, from the width of the centroids' image.
fn degree_of_width(image: &RgbaImage, name: &str) -> Result<usize, FormatError> {
    (1..=3).find(|degree| image.width() as usize == ROWS * rest(*degree)).ok_or_else(|| {
        FormatError::new(name.to_owned(), "an image 192, 512 or 960 pixels wide", image.width().to_string())
    })
}

fn pixel(image: &RgbaImage, column: usize, row: usize) -> [u8; 4] {
    image.get_pixel(column as u32, row as u32).0
}

/// Returns the maximum number of pixels of an image that needs `least`: twice as many, and at least 65,536. `least` is
/// 0 for centroids of unknown number: at most 65,536 rows of 15.
fn most(least: usize) -> usize {
    if least == 0 { 1 << 20 } else { least.saturating_mul(2).max(1 << 16) }
}

/// Decodes an image of at least `least` pixels, and of at most [`most`].
fn image(bytes: &[u8], name: &str, least: usize) -> Result<RgbaImage, FormatError> {
    let broken = |e: image::ImageError| FormatError::new(name.to_owned(), "a WebP image", e.to_string());
    let decoder = WebPDecoder::new(Cursor::new(bytes)).map_err(broken)?;
    let (width, height) = decoder.dimensions();
    let pixels = width as usize * height as usize;
    let most = most(least);
    if pixels < least || pixels > most {
        let expected = format!("an image of {least} to {most} pixels");
        return Err(FormatError::new(name.to_owned(), expected, format!("{width}×{height}")));
    }
    Ok(DynamicImage::from_decoder(decoder).map_err(broken)?.into_rgba8())
}

fn rotation([a, b, c, which]: [u8; 4], i: usize) -> Result<[f32; 4], FormatError> {
    let Some(largest) = which.checked_sub(LARGEST).map(usize::from) else {
        return Err(FormatError::new(format!("quats: alpha of {i}"), "252 to 255", which.to_string()));
    };
    let (mut q, mut squares) = ([0.0; 4], 0.0);
    for (place, byte) in (0..4).filter(|place| *place != largest).zip([a, b, c]) {
        q[place] = (f64::from(byte) / 255.0 - 0.5) * std::f64::consts::SQRT_2;
        squares += q[place] * q[place];
    }
    q[largest] = (1.0_f64 - squares).max(0.0).sqrt();
    Ok(q.map(|c| c as f32))
}
