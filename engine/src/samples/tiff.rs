//! TIFF: every page, in the type its samples are stored in.

use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use ::tiff::decoder::{Decoder, DecodingResult, Limits};
use ::tiff::tags::Tag;
use ::tiff::{ColorType, TiffError};
use image::metadata::Orientation;

use super::orientation::oriented;
use super::{Channel, Part, Parts, Samples};
use crate::picture::MAX_PIXELS;
use crate::source::SourceError;
use crate::source::decode::{check_size, decode_error, eight_bits_at, tiff_palette_as_grey};

pub(super) fn read(bytes: Vec<u8>, path: &Path) -> Result<Parts, SourceError> {
    let bytes: Arc<[u8]> = bytes.into();
    let decoder = open(bytes.clone(), path)?;
    Ok(Box::new(Pages { bytes, decoder, path: path.to_owned(), next: 0, ended: false }))
}

fn open(bytes: Arc<[u8]>, path: &Path) -> Result<Decoder<Cursor<Arc<[u8]>>>, SourceError> {
    let mut limits = Limits::default();
    limits.decoding_buffer_size = 16 * MAX_PIXELS;
    limits.intermediate_buffer_size = 16 * MAX_PIXELS;
    Ok(Decoder::new(Cursor::new(bytes)).map_err(|e| broken(path, &e))?.with_limits(limits))
}

fn broken(path: &Path, e: &TiffError) -> SourceError {
    decode_error(path, format!("broken or unsupported TIFF image: {e}"))
}

struct Pages {
    bytes: Arc<[u8]>,
    decoder: Decoder<Cursor<Arc<[u8]>>>,
    path: PathBuf,
    next: usize,
    ended: bool,
}

impl Iterator for Pages {
    type Item = Result<Part, SourceError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.ended || (self.next > 0 && !self.decoder.more_images()) {
            return None;
        }
        let page = self.page();
        self.ended = page.is_err();
        self.next += 1;
        Some(page)
    }
}

/// The photometric interpretation of indices into a palette.
const PALETTE: u16 = 3;

impl Pages {
    fn page(&mut self) -> Result<Part, SourceError> {
        let path = self.path.clone();
        let wrong = |e: TiffError| broken(&path, &e);
        if self.next > 0 {
            self.decoder.next_image().map_err(wrong)?;
        }
        let (width, height) = self.decoder.dimensions().map_err(wrong)?;
        let (width, height) = (width as usize, height as usize);
        check_size(&path, width, height)?;
        let mut tag = |tag| self.decoder.find_tag_unsigned_vec::<u16>(tag).map_err(wrong);
        // 1: associated alpha, by which colours are multiplied; 2: unassociated; 0: unspecified.
        let extra = tag(Tag::ExtraSamples)?.unwrap_or_default();
        let orientation = tag(Tag::Orientation)?.and_then(|v| v.first().copied());
        let map = tag(Tag::ColorMap)?;
        let palette = tag(Tag::PhotometricInterpretation)?.and_then(|v| v.first().copied()) == Some(PALETTE);
        let mut result = DecodingResult::U8(Vec::new());
        let grey = palette
            .then(|| self.decoder.ifd_pointer().and_then(|at| usize::try_from(at.0).ok()))
            .flatten()
            .and_then(|at| tiff_palette_as_grey(&self.bytes, at));
        let (colour, layout) = match grey {
            // The decoder refuses palettes; their indices are read as grey levels.
            Some(grey) => {
                let mut decoder = open(grey.into(), &path)?;
                decoder.seek_to_image(self.next).map_err(wrong)?;
                let colour = match decoder.colortype().map_err(wrong)? {
                    ColorType::Gray(bits) => ColorType::Palette(bits),
                    other => other,
                };
                (colour, decoder.read_image_to_buffer(&mut result))
            }
            None => (self.decoder.colortype().map_err(wrong)?, self.decoder.read_image_to_buffer(&mut result)),
        };
        let layout = layout.map_err(wrong)?;
        let names = names(colour);
        let samples = unpacked(samples(result, &path)?, colour, width, height, names.len());
        let planar = layout.planes > 1;
        if samples.len() != names.len() * width * height {
            let (expected, found) = (names.len() * width * height, samples.len());
            return Err(decode_error(&path, format!("expected {expected} samples, found {found}")));
        }
        let mut part =
            if planar { planes(width, height, &names, &samples) } else { Part::named(width, height, &names, &samples) };
        if let ColorType::Palette(bits) = colour {
            let map = map.ok_or_else(|| decode_error(&path, "expected a TIFF palette, found none"))?;
            part = expanded(&part, &map, bits)
                .ok_or_else(|| decode_error(&path, "a sample lies outside of the TIFF palette"))?;
        }
        part.premultiplied = part.channel("A").is_some() && extra.first() == Some(&1);
        part.name =
            if self.next == 0 && !self.decoder.more_images() { String::new() } else { format!("page {}", self.next) };
        let orientation = orientation.and_then(|value| Orientation::from_exif(value as u8));
        Ok(oriented(part, orientation.unwrap_or(Orientation::NoTransforms)))
    }
}

/// Names of the channels of a colour type.
fn names(colour: ColorType) -> Vec<String> {
    let names: &[&str] = match colour {
        ColorType::Gray(_) => &["Y"],
        ColorType::GrayA(_) => &["Y", "A"],
        ColorType::RGB(_) => &["R", "G", "B"],
        ColorType::RGBA(_) => &["R", "G", "B", "A"],
        ColorType::Palette(_) => &["index"],
        ColorType::CMYK(_) => &["C", "M", "Y", "K"],
        ColorType::CMYKA(_) => &["C", "M", "Y", "K", "A"],
        ColorType::YCbCr(_) => &["Y", "Cb", "Cr"],
        ColorType::Lab(_) => &["L*", "a*", "b*"],
        ColorType::Multiband { num_samples, .. } => return (0..num_samples).map(|at| format!("band {at}")).collect(),
        _ => &["Y"],
    };
    names.iter().map(|name| (*name).to_owned()).collect()
}

fn samples(result: DecodingResult, path: &Path) -> Result<Samples, SourceError> {
    let signed = |bits, values: Vec<i32>| Ok(Samples::Signed(bits, values));
    match result {
        DecodingResult::U8(v) => Ok(Samples::U8(v)),
        DecodingResult::U16(v) => Ok(Samples::U16(v)),
        DecodingResult::U32(v) => Ok(Samples::U32(v)),
        DecodingResult::F16(v) => Ok(Samples::F16(v)),
        DecodingResult::F32(v) => Ok(Samples::F32(v)),
        DecodingResult::F64(v) => Ok(Samples::F64(v)),
        DecodingResult::I8(v) => signed(8, v.into_iter().map(i32::from).collect()),
        DecodingResult::I16(v) => signed(16, v.into_iter().map(i32::from).collect()),
        DecodingResult::I32(v) => signed(32, v),
        DecodingResult::U64(_) | DecodingResult::I64(_) => Err(decode_error(
            path,
            "expected TIFF samples of at most 32 bits or floats, found whole numbers of 64 bits",
        )),
    }
}

/// Expands samples of 1, 2 or 4 bits, several to a byte, to bytes of the full range (indices of palettes: unchanged).
fn unpacked(samples: Samples, colour: ColorType, width: usize, height: usize, channels: usize) -> Samples {
    let bits = usize::from(colour.bit_depth());
    let (Samples::U8(bytes), 1 | 2 | 4) = (&samples, bits) else { return samples };
    let row = (width * channels * bits).div_ceil(8);
    if bytes.len() != row * height {
        return samples;
    }
    let most = (1_u8 << bits) - 1;
    let scale = if matches!(colour, ColorType::Palette(_)) { 1 } else { 255 / most };
    let unpack = |row: &[u8]| -> Vec<u8> {
        (0..width * channels).map(|i| ((row[i * bits / 8] >> (8 - bits - i * bits % 8)) & most) * scale).collect()
    };
    Samples::U8(bytes.chunks_exact(row).flat_map(unpack).collect())
}

/// A picture whose channels are stored one after another.
fn planes(width: usize, height: usize, names: &[String], samples: &Samples) -> Part {
    let mut part = Part::named(width, height, names, samples);
    let plane = width * height;
    let channel = |(at, name): (usize, &String)| Channel {
        name: name.clone(),
        width,
        height,
        samples: samples.taken(at * plane..(at + 1) * plane),
    };
    part.channels = names.iter().enumerate().map(channel).collect();
    part
}

/// The colours of a palette for a picture's samples: of 16 bits, or of 8. Some programs write 8 bits above a byte of
/// zeros, or alone, as frames are read.
fn expanded(part: &Part, map: &[u16], bits: u8) -> Option<Part> {
    let count = 1_usize.checked_shl(u32::from(bits))?;
    let places: Vec<usize> = match &part.channels.first()?.samples {
        Samples::U8(v) => v.iter().map(|&v| usize::from(v)).collect(),
        Samples::U16(v) => v.iter().map(|&v| usize::from(v)).collect(),
        _ => return None,
    };
    let shift = eight_bits_at(map);
    let mut channels = Vec::with_capacity(3);
    for (at, name) in ["R", "G", "B"].into_iter().enumerate() {
        let colour = |place: &usize| (*place < count).then(|| map.get(at * count + place).copied()).flatten();
        let colours: Vec<u16> = places.iter().map(colour).collect::<Option<_>>()?;
        let samples = match shift {
            Some(shift) => Samples::U8(colours.iter().map(|&v| (v >> shift) as u8).collect()),
            None => Samples::U16(colours),
        };
        channels.push(Channel { name: name.to_owned(), width: part.width, height: part.height, samples });
    }
    Some(Part { channels, ..part.clone() })
}
