//! TIFF and BigTIFF: grey, RGB, palette and CMYK of unsigned or float samples, in strips or tiles, planes interleaved
//! or separate.
//!
//! Uncompressed, LZW, deflate and PackBits. JPEG inside TIFF is not supported: its decoder would bring vector
//! instructions back into the JPEG path. Tags that are applied: `Orientation`, `ExtraSamples` (whether colours are
//! premultiplied by alpha), `NewSubfileType` (reduced copies and masks are not pages). Other extra samples are left out
//! with a note.

use std::io::Cursor;
use std::path::Path;

use image::metadata::Orientation;
use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::tags::Tag;

use super::{INKS, Interleaved, Still, check_size, compose, decode_error, icc, orientation};
use crate::picture::MAX_PIXELS;
use crate::source::SourceError;

/// Maximum number of pages in a file.
const MAX_PAGES: usize = 1 << 20;

/// Returns true if the bytes begin as TIFF or BigTIFF.
pub(crate) fn is(bytes: &[u8]) -> bool {
    matches!(bytes, [b'I', b'I', 42 | 43, 0, ..] | [b'M', b'M', 0, 42 | 43, ..])
}

type TiffDecoder<'a> = Decoder<Cursor<&'a [u8]>>;

fn explain(path: &Path) -> impl Fn(tiff::TiffError) -> SourceError {
    move |e| decode_error(path, format!("broken or unsupported TIFF image: {e}"))
}

fn open<'a>(bytes: &'a [u8], path: &Path) -> Result<TiffDecoder<'a>, SourceError> {
    let mut limits = Limits::default();
    limits.decoding_buffer_size = 16 * MAX_PIXELS;
    limits.intermediate_buffer_size = 16 * MAX_PIXELS;
    Ok(Decoder::new(Cursor::new(bytes)).map_err(explain(path))?.with_limits(limits))
}

/// Returns the indices of the pages without reduced copies and masks; the first page always counts.
pub(super) fn pages(bytes: &[u8], path: &Path) -> Result<Vec<usize>, SourceError> {
    /// Bits of `NewSubfileType`: a reduced copy of another page, a mask of another page.
    const NOT_A_PAGE: u32 = 1 | 4;
    let mut decoder = open(bytes, path)?;
    let mut pages = Vec::new();
    for place in 0..MAX_PAGES {
        let kind = decoder.find_tag_unsigned::<u32>(Tag::NewSubfileType).map_err(explain(path))?.unwrap_or(0);
        if place == 0 || kind & NOT_A_PAGE == 0 {
            pages.push(place);
        }
        if !decoder.more_images() {
            break;
        }
        decoder.next_image().map_err(explain(path))?;
    }
    Ok(pages)
}

/// Decodes the page at an index.
pub(super) fn page(bytes: &[u8], place: usize, path: &Path) -> Result<Still, SourceError> {
    let page = Page::read(bytes, place, path)?;
    let mut notes = Vec::new();
    let Page { width, height, photometric, channels, read, ref extra, .. } = page;
    let colours = photometric.channels();
    if matches!(page.samples, Samples::Float(_)) {
        notes.push("float samples of TIFF are taken as display-referred".to_owned());
    }
    if photometric != Photometric::Inks {
        notes.extend(page.profile.as_deref().and_then(icc::note));
    } else {
        notes.push(INKS.to_owned());
    }
    let alpha = matches!(extra.first(), Some(1 | 2)) && read > colours;
    let left_out = channels - colours - usize::from(alpha);
    if left_out > 0 {
        notes
            .push(format!("samples of TIFF that are neither colour nor alpha are left out ({left_out} of {channels})"));
    }
    let shown = orientation_of(page.orientation);
    let premultiplied = extra.first() == Some(&1);
    let samples: Vec<f32> = match page.samples {
        // Palettes need the integer samples.
        Samples::Whole(samples, _) if photometric == Photometric::Palette => {
            samples.iter().map(|&v| v as f32).collect()
        }
        Samples::Whole(samples, most) => samples.iter().map(|&v| (f64::from(v) / f64::from(most)) as f32).collect(),
        Samples::Float(_) if photometric == Photometric::Palette => {
            return Err(decode_error(path, "expected whole numbers as samples of a TIFF with a palette, found float"));
        }
        Samples::Float(samples) => samples,
    };
    let mut kept = Vec::with_capacity(width * height * (photometric.shown() + usize::from(alpha)));
    for pixel in samples.chunks_exact(read) {
        match photometric {
            Photometric::Grey | Photometric::Rgb => kept.extend_from_slice(&pixel[..colours]),
            // The palette has a colour for every value of that many bits.
            Photometric::Palette => kept.extend(page.palette[pixel[0] as usize]),
            Photometric::Inks => kept.extend(pixel[..3].iter().map(|ink| (1.0 - ink) * (1.0 - pixel[3]))),
        }
        if alpha {
            kept.push(pixel[colours]);
        }
    }
    let channels = photometric.shown() + usize::from(alpha);
    let mut still = compose(&Interleaved { width, height, channels, samples: kept, premultiplied }, path)?;
    still.notes.extend(notes);
    still.picture = orientation::apply(still.picture, shown);
    Ok(still)
}

/// Decodes the samples of a grey page in their stored unit, with width and height.
///
/// # Errors
/// Those of a picture, and pages that are not grey.
pub(crate) fn grey(bytes: &[u8], path: &Path) -> Result<(usize, usize, Vec<f32>), SourceError> {
    let found = pages(bytes, path)?.len();
    if found > 1 {
        return Err(decode_error(path, format!("expected one page of TIFF, found {found}")));
    }
    let page = Page::read(bytes, 0, path)?;
    if !(page.photometric == Photometric::Grey && page.channels == 1) {
        let found = format!("{} samples a pixel, photometric {:?}", page.channels, page.photometric);
        return Err(decode_error(path, format!("expected a grey TIFF of one sample a pixel, found {found}")));
    }
    let samples = match page.samples {
        Samples::Whole(samples, _) => samples.iter().map(|&v| v as f32).collect(),
        Samples::Float(samples) => samples,
    };
    Ok((page.width, page.height, samples))
}

fn orientation_of(tag: Option<u32>) -> Orientation {
    tag.and_then(|tag| Orientation::from_exif(u8::try_from(tag).ok()?)).unwrap_or(Orientation::NoTransforms)
}

/// Interpretation of a page's samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Photometric {
    Grey,
    Rgb,
    Palette,
    /// Cyan, magenta, yellow and black.
    Inks,
}

impl Photometric {
    /// Number of samples of a stored colour.
    fn channels(self) -> usize {
        match self {
            Photometric::Rgb => 3,
            Photometric::Inks => 4,
            _ => 1,
        }
    }

    /// Number of samples of a shown colour.
    fn shown(self) -> usize {
        match self {
            Photometric::Grey => 1,
            _ => 3,
        }
    }
}

enum Samples {
    /// Integers, and the largest possible value.
    Whole(Vec<u32>, u32),
    Float(Vec<f32>),
}

/// A page as it is stored.
struct Page {
    width: usize,
    height: usize,
    photometric: Photometric,
    /// Samples per pixel in the file.
    channels: usize,
    /// Samples per pixel that were read; they are interleaved.
    read: usize,
    /// Kinds of the samples after the colour.
    extra: Vec<u16>,
    palette: Vec<[f32; 3]>,
    orientation: Option<u32>,
    profile: Option<Vec<u8>>,
    samples: Samples,
}

impl Page {
    fn read(bytes: &[u8], place: usize, path: &Path) -> Result<Page, SourceError> {
        let explain = explain(path);
        let wrong = |cause: String| decode_error(path, cause);
        let mut decoder = open(bytes, path)?;
        if place > 0 {
            decoder.seek_to_image(place).map_err(&explain)?;
        }
        let (width, height) = decoder.dimensions().map_err(&explain)?;
        let (width, height) = (width as usize, height as usize);
        check_size(path, width, height)?;
        let number = |decoder: &mut TiffDecoder<'_>, tag, default: u32| {
            Ok::<u32, SourceError>(decoder.find_tag_unsigned(tag).map_err(&explain)?.unwrap_or(default))
        };
        let compression = number(&mut decoder, Tag::Compression, 1)?;
        if !matches!(compression, 1 | 5 | 8 | 32946 | 32773) {
            let name = match compression {
                2..=4 => "CCITT fax",
                6 | 7 => "JPEG",
                34925 => "LZMA",
                50000 => "Zstandard",
                50001 => "WebP",
                50002 => "JPEG XL",
                34712 => "JPEG 2000",
                _ => "another kind",
            };
            return Err(wrong(format!(
                "expected a TIFF without compression or with LZW, deflate or PackBits, found {name} ({compression}); tiffcp -c zip IN OUT converts it"
            )));
        }
        let photometric = match number(&mut decoder, Tag::PhotometricInterpretation, 1)? {
            // The decoder inverts the samples where white is zero.
            0 | 1 => Photometric::Grey,
            2 => Photometric::Rgb,
            3 => Photometric::Palette,
            5 => Photometric::Inks,
            other => {
                let name = match other {
                    4 => "a mask",
                    6 => "YCbCr",
                    8..=10 => "L*a*b*",
                    32803 => "a camera's raw mosaic",
                    32844 | 32845 => "LogLuv",
                    34892 => "a camera's linear raw",
                    _ => "another kind",
                };
                return Err(wrong(format!(
                    "expected a grey, RGB, palette or CMYK TIFF, found {name} (photometric {other})"
                )));
            }
        };
        let channels = number(&mut decoder, Tag::SamplesPerPixel, 1)? as usize;
        if !(photometric.channels()..=16).contains(&channels) {
            return Err(wrong(format!("expected {photometric:?} TIFF of up to 16 samples a pixel, found {channels}")));
        }
        if channels.saturating_mul(width * height) > 4 * MAX_PIXELS {
            return Err(wrong(format!(
                "the picture has {channels} samples in each of {width}×{height} pixels, larger than this program decodes"
            )));
        }
        let bits = decoder
            .find_tag_unsigned_vec::<u16>(Tag::BitsPerSample)
            .map_err(&explain)?
            .unwrap_or_else(|| vec![1; channels]);
        let depth = bits.first().copied().unwrap_or(1);
        let format = number(&mut decoder, Tag::SampleFormat, 1);
        let planar = number(&mut decoder, Tag::PlanarConfiguration, 1)? == 2;
        let small = matches!(depth, 1 | 2 | 4);
        if bits.iter().any(|&b| b != depth) || !(small || matches!(depth, 8 | 16 | 32 | 64)) || (small && channels > 1)
        {
            return Err(wrong(format!(
                "expected TIFF samples of 8, 16, 32 or 64 bits, or grey of 1, 2 or 4, found {bits:?}"
            )));
        }
        let extra = decoder.find_tag_unsigned_vec::<u16>(Tag::ExtraSamples).map_err(&explain)?.unwrap_or_default();
        let orientation = decoder.find_tag_unsigned::<u32>(Tag::Orientation).map_err(&explain)?;
        let profile = decoder.find_tag(Tag::IccProfile).map_err(&explain)?.and_then(|value| value.into_u8_vec().ok());
        let palette = match photometric {
            Photometric::Palette => palette(&mut decoder, depth, path)?,
            _ => Vec::new(),
        };
        let mut result = DecodingResult::U8(Vec::new());
        let as_grey = (photometric == Photometric::Palette)
            .then(|| decoder.ifd_pointer().and_then(|at| as_grey(bytes, usize::try_from(at.0).ok()?)))
            .flatten();
        match as_grey {
            // The decoder does not support palettes, so the indices are read as grey levels.
            Some(grey) => {
                let mut decoder = open(&grey, path)?;
                if place > 0 {
                    decoder.seek_to_image(place).map_err(&explain)?;
                }
                decoder.read_image_to_buffer(&mut result)
            }
            None => decoder.read_image_to_buffer(&mut result),
        }
        .map_err(&explain)?;
        let mut samples = match result {
            DecodingResult::U8(v) if small => unpack(&v, width, height, depth),
            DecodingResult::U8(v) => Samples::Whole(v.into_iter().map(u32::from).collect(), 255),
            DecodingResult::U16(v) => Samples::Whole(v.into_iter().map(u32::from).collect(), 65535),
            DecodingResult::U32(v) => Samples::Whole(v, u32::MAX),
            DecodingResult::F16(v) => Samples::Float(v.iter().map(|v| v.to_f32()).collect()),
            DecodingResult::F32(v) => Samples::Float(v),
            DecodingResult::F64(v) => Samples::Float(v.iter().map(|&v| v as f32).collect()),
            _ => {
                let format = format.unwrap_or(1);
                return Err(wrong(format!(
                    "expected TIFF samples that are unsigned, of at most 32 bits, or float, found {depth} bits of sample format {format}"
                )));
            }
        };
        let found = match &samples {
            Samples::Whole(samples, _) => samples.len(),
            Samples::Float(samples) => samples.len(),
        };
        // The decoder itself drops some samples that are not colours.
        let read = found / (width * height);
        if found != read * width * height || !(photometric.channels()..=channels).contains(&read) {
            let expected = width * height * channels;
            return Err(wrong(format!("expected {expected} samples of TIFF, found {found}")));
        }
        if planar && read > 1 {
            samples = match samples {
                Samples::Whole(samples, most) => Samples::Whole(interleaved(&samples, read), most),
                Samples::Float(samples) => Samples::Float(interleaved(&samples, read)),
            };
        }
        Ok(Page { width, height, photometric, channels, read, extra, palette, orientation, profile, samples })
    }
}

/// Returns the file with the photometric interpretation of the directory at an offset set to grey.
pub(crate) fn as_grey(bytes: &[u8], directory: usize) -> Option<Vec<u8>> {
    let (little, big) = (bytes.first()? == &b'I', bytes.get(2..4)?.contains(&43));
    let short = |at: usize| {
        let b = *bytes.get(at..)?.first_chunk()?;
        Some(if little { u16::from_le_bytes(b) } else { u16::from_be_bytes(b) })
    };
    let (first, each, value) = if big { (8, 20, 12) } else { (2, 12, 8) };
    // The number of entries: the first or last two bytes.
    let count = short(if big && !little { directory + 6 } else { directory })?;
    let entries = (0..usize::from(count)).map(|i| directory + first + each * i);
    let entry = entries.into_iter().find(|&at| short(at) == Some(262))?;
    let mut grey = bytes.to_vec();
    let one = if little { 1_u16.to_le_bytes() } else { 1_u16.to_be_bytes() };
    grey.get_mut(entry + value..entry + value + 2)?.copy_from_slice(&one);
    Some(grey)
}

/// Interleaves separate planes.
fn interleaved<T: Copy>(planes: &[T], channels: usize) -> Vec<T> {
    let area = planes.len() / channels;
    (0..area).flat_map(|pixel| (0..channels).map(move |channel| planes[channel * area + pixel])).collect()
}

/// Unpacks samples of fewer than 8 bits; each row starts at a byte.
fn unpack(bytes: &[u8], width: usize, height: usize, depth: u16) -> Samples {
    let (depth, each) = (usize::from(depth), 8 / usize::from(depth));
    let most = (1_u32 << depth) - 1;
    let row = width.div_ceil(each);
    let mut samples = Vec::with_capacity(width * height);
    for row in bytes.chunks_exact(row).take(height) {
        samples.extend((0..width).map(|x| (u32::from(row[x / each]) >> (8 - depth * (x % each + 1))) & most));
    }
    Samples::Whole(samples, most)
}

/// Returns the bit position of a palette's 8-bit colours: 0 if they are stored alone, 8 if above a zero byte; `None`
/// for colours of 16 bits.
pub(crate) fn eight_bits_at(palette: &[u16]) -> Option<u32> {
    [(0, 0xff00), (8, 0x00ff)].into_iter().find(|(_, others)| palette.iter().all(|v| v & others == 0)).map(|(at, _)| at)
}

/// Reads the colours of a palette: 16 bits each, or 8 bits, which some programs write above a zero byte or alone.
fn palette(decoder: &mut TiffDecoder<'_>, depth: u16, path: &Path) -> Result<Vec<[f32; 3]>, SourceError> {
    let numbers = decoder.find_tag_unsigned_vec::<u16>(Tag::ColorMap).map_err(explain(path))?.unwrap_or_default();
    if depth > 8 || numbers.len() != 3 << depth {
        let found = format!("{} numbers for {depth} bits", numbers.len());
        return Err(decode_error(path, format!("expected a TIFF palette of three numbers a colour, found {found}")));
    }
    let most = eight_bits_at(&numbers).map_or(65535.0, |shift| f32::from(255_u16 << shift));
    let colours = numbers.len() / 3;
    Ok((0..colours).map(|i| [0, 1, 2].map(|c| f32::from(numbers[c * colours + i]) / most)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use tiff::encoder::{TiffEncoder, colortype};

    /// Decodes a page's samples.
    fn rgb(bytes: &[u8]) -> Vec<f32> {
        page(bytes, 0, Path::new("a.tif")).expect("valid").picture.rgb
    }

    #[test]
    fn grey_sixteen_bit_and_rgb_float_are_read() {
        let mut bytes = Cursor::new(Vec::new());
        let mut encoder = TiffEncoder::new(&mut bytes).expect("memory");
        encoder.write_image::<colortype::Gray16>(2, 1, &[0, 65535]).expect("memory");
        assert_eq!(rgb(bytes.get_ref()), [0.0, 1.0, 0.0, 1.0, 0.0, 1.0]);

        let mut bytes = Cursor::new(Vec::new());
        let mut encoder = TiffEncoder::new(&mut bytes).expect("memory");
        encoder.write_image::<colortype::RGB32Float>(1, 1, &[0.25, 0.5, 3.0]).expect("memory");
        assert_eq!(rgb(bytes.get_ref()), [0.25, 0.5, 1.0]);
        let notes = page(bytes.get_ref(), 0, Path::new("a.tif")).expect("valid").notes.join("; ");
        assert!(notes.contains("clamped") && notes.contains("display-referred"), "{notes}");
        let half = bytes.get_ref().len() / 2;
        assert!(page(&bytes.get_ref()[..half], 0, Path::new("a.tif")).is_err());
    }

    /// Builds a file of one strip with these tags in addition to its size: number, type (3 for 16 bits, 4 for 32) and
    /// values.
    fn file(big: bool, [width, height]: [u32; 2], tags: &[(u16, u16, &[u32])], strips: &[&[u8]]) -> Vec<u8> {
        let lengths: Vec<u32> = strips.iter().map(|strip| strip.len() as u32).collect();
        let first = if big { 16 } else { 8 };
        let offsets: Vec<u32> = lengths
            .iter()
            .scan(first, |at, length| {
                *at += length;
                Some(*at - length)
            })
            .collect();
        let mut all: Vec<(u16, u16, Vec<u32>)> = vec![
            (256, 4, vec![width]),
            (257, 4, vec![height]),
            (273, 4, offsets),
            (278, 4, vec![height]),
            (279, 4, lengths),
        ];
        all.extend(tags.iter().map(|&(tag, kind, values)| (tag, kind, values.to_vec())));
        all.sort_by_key(|tag| tag.0);
        let data: Vec<u8> = strips.concat();
        let (word, directory) = (if big { 8 } else { 4 }, first as usize + data.len());
        let value_bytes = |kind: u16, values: &[u32]| -> Vec<u8> {
            let bytes = |v: &u32| if kind == 3 { (*v as u16).to_le_bytes().to_vec() } else { v.to_le_bytes().to_vec() };
            values.iter().flat_map(bytes).collect()
        };
        let number = |v: usize| if big { (v as u64).to_le_bytes().to_vec() } else { (v as u32).to_le_bytes().to_vec() };
        let mut bytes = if big { b"II\x2b\0\x08\0\0\0".to_vec() } else { b"II\x2a\0".to_vec() };
        bytes.extend(number(directory));
        bytes.extend(data);
        bytes.extend(if big {
            (all.len() as u64).to_le_bytes().to_vec()
        } else {
            (all.len() as u16).to_le_bytes().to_vec()
        });
        let mut elsewhere = directory + if big { 8 + 20 * all.len() + 8 } else { 2 + 12 * all.len() + 4 };
        let mut tail = Vec::new();
        for (tag, kind, values) in &all {
            bytes.extend(tag.to_le_bytes());
            bytes.extend(kind.to_le_bytes());
            bytes.extend(number(values.len()));
            let mut value = value_bytes(*kind, values);
            if value.len() > word {
                bytes.extend(number(elsewhere));
                elsewhere += value.len();
                tail.extend(value);
            } else {
                value.resize(word, 0);
                bytes.extend(value);
            }
        }
        bytes.extend(number(0));
        bytes.extend(tail);
        bytes
    }

    const RGB: [(u16, u16, &[u32]); 3] = [(258, 3, &[8, 8, 8]), (262, 3, &[2]), (277, 3, &[3])];
    const RGBA: [(u16, u16, &[u32]); 3] = [(258, 3, &[8, 8, 8, 8]), (262, 3, &[2]), (277, 3, &[4])];

    #[test]
    fn planes_one_after_the_other_and_big_files_are_read() {
        let expected = [0.0, 1.0, 0.2, 0.4, 0.6, 0.8];
        let interleaved = [0, 51, 153, 255, 102, 204];
        assert_eq!(rgb(&file(false, [2, 1], &RGB, &[&interleaved])), expected);
        assert_eq!(rgb(&file(true, [2, 1], &RGB, &[&interleaved])), expected);
        let planar = [&RGB[..], &[(284, 3, &[2])]].concat();
        assert_eq!(rgb(&file(false, [2, 1], &planar, &[&[0, 255], &[51, 102], &[153, 204]])), expected);
    }

    #[test]
    fn colours_that_are_multiplied_by_alpha_are_not_multiplied_again() {
        let with = |kind: &'static [u32]| [&RGBA[..], &[(338, 3, kind)]].concat();
        let pixel: [&[u8]; 1] = [&[102, 0, 51, 102]];
        let of = |kind| page(&file(false, [1, 1], &with(kind), &pixel), 0, Path::new("a.tif")).expect("valid");
        let near = |found: &[f32], expected: [f32; 3]| {
            assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{found:?} {expected:?}");
        };
        near(&of(&[1]).picture.rgb, [0.7, 0.3, 0.5]);
        near(&of(&[2]).picture.rgb, [0.46, 0.3, 0.38]);
        near(&of(&[0]).picture.rgb, [0.4, 0.0, 0.2]);
        assert_eq!(of(&[1]).notes, [super::super::OVER_GREY]);
        assert!(of(&[0]).notes[0].contains("left out (1 of 4)"), "{:?}", of(&[0]).notes);
    }

    #[test]
    fn palettes_inks_few_bits_and_white_at_zero_are_read() {
        let map: Vec<u32> = [[0, 65535], [13107, 26214], [65535, 0]].concat();
        let mut palette = vec![0; 3 * 16];
        for (channel, pair) in map.chunks(2).enumerate() {
            palette[channel * 16..channel * 16 + 2].copy_from_slice(pair);
        }
        let tags: [(u16, u16, &[u32]); 3] = [(258, 3, &[4]), (262, 3, &[3]), (320, 3, &palette)];
        assert_eq!(rgb(&file(false, [3, 1], &tags, &[&[0x10, 0x10]])), [1.0, 0.0, 1.0, 0.4, 0.2, 0.4, 0.0, 1.0, 0.0]);
        // Eight bits above a zero byte.
        let mut bytes = vec![0; 3 * 16];
        (bytes[1], bytes[17], bytes[33]) = (255 << 8, 51 << 8, 0);
        let tags: [(u16, u16, &[u32]); 3] = [(258, 3, &[4]), (262, 3, &[3]), (320, 3, &bytes)];
        assert_eq!(rgb(&file(false, [1, 1], &tags, &[&[0x10]])), [1.0, 0.2, 0.0]);
        let bits: [(u16, u16, &[u32]); 2] = [(258, 3, &[1]), (262, 3, &[1])];
        assert_eq!(
            rgb(&file(false, [3, 2], &bits, &[&[0b0100_0000, 0b1010_0000]]))[..6],
            [0.0, 1.0, 0.0, 1.0, 0.0, 1.0]
        );
        let turned: [(u16, u16, &[u32]); 2] = [(258, 3, &[8]), (262, 3, &[0])];
        assert_eq!(rgb(&file(false, [2, 1], &turned, &[&[0, 204]]))[..2], [1.0, 0.2]);
        let inks: [(u16, u16, &[u32]); 3] = [(258, 3, &[8, 8, 8, 8]), (262, 3, &[5]), (277, 3, &[4])];
        let found = page(&file(false, [1, 1], &inks, &[&[0, 255, 51, 0]]), 0, Path::new("a.tif")).expect("valid");
        assert_eq!(found.picture.rgb, [1.0, 0.0, 0.8]);
        assert_eq!(found.notes, [INKS]);
    }

    #[test]
    fn a_turned_page_is_shown_upright() {
        let tags = [&RGB[..], &[(274, 3, &[6])]].concat();
        let found = page(&file(false, [2, 1], &tags, &[&[0, 0, 0, 255, 255, 255]]), 0, Path::new("a.tif"));
        let picture = found.expect("valid").picture;
        assert_eq!((picture.width, picture.height), (1, 2));
        assert_eq!(picture.rgb[..2], [0.0, 1.0]);
    }

    #[test]
    fn what_is_not_read_is_named() {
        let error = |tags: &[(u16, u16, &[u32])]| {
            page(&file(false, [2, 2], tags, &[&[0; 64]]), 0, Path::new("a.tif")).expect_err("refused").to_string()
        };
        let of = |more: (u16, u16, &'static [u32])| error(&[&RGB[..1], &RGB[2..], &[(262, 3, &[2])], &[more]].concat());
        assert!(of((259, 3, &[7])).contains("found JPEG (7)"), "{}", of((259, 3, &[7])));
        assert!(error(&[RGB[0], (262, 3, &[6]), RGB[2]]).contains("found YCbCr (photometric 6)"));
        assert!(error(&[(258, 3, &[12]), (262, 3, &[1])]).contains("found [12]"));
        let signed = error(&[(258, 3, &[16]), (262, 3, &[1]), (339, 3, &[2])]);
        assert!(signed.contains("sample format 2"), "{signed}");
    }
}
