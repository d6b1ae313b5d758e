//! `.ksplat`, the files of the web viewer GaussianSplats3D, versions 0.1 and later with the compression levels 0 to 2.
//! All numbers are little-endian.
//!
//! | bytes of the header (4096) | value |
//! |---|---|
//! | 0, 1 | version: 0 and 1 |
//! | 4 | u32: capacity in sections |
//! | 12 | u32: capacity in Gaussians |
//! | 20 | u16: compression level |
//! | 36, 40 | f32: least and greatest harmonic of level 2; 0 means −1.5 and 1.5 |
//!
//! | bytes of a section's header (1024) | value |
//! |---|---|
//! | 4 | u32: its Gaussians |
//! | 8, 12 | u32: Gaussians of a full bucket, number of buckets |
//! | 16 | f32: side of a bucket |
//! | 20 | u16: bytes of a bucket (12) |
//! | 24 | u32: range r of the places in a bucket; 0 means the level's default |
//! | 32, 36 | u32: number of full buckets, and of others |
//! | 40 | u16: degree of the harmonics, 0 to 2 |
//!
//! Sections follow their headers: the lengths of the buckets that are not full (u32), the buckets' middles m (three f32
//! each), and the records.
//!
//! | record | level 0 | levels 1 and 2 |
//! |---|---|---|
//! | centre | 3 f32 | 3 u16: `m + (n − r)·(side / 2) / r` |
//! | standard deviations | 3 f32 | 3 f16 |
//! | rotation, w first | 4 f32 | 4 f16 |
//! | red, green, blue, opacity | 4 bytes over 255 | the same |
//! | harmonics, each band by channel | f32 | f16; level 2: bytes between least and greatest |
//!
//! Colours become `(c − ½) / Y₀`, as in `.splat`. If another section has a higher degree, the missing harmonics are 0.
//!
//! Source: GaussianSplats3D 0.4.7, `SplatBuffer`.

use std::path::Path;

use streamsplat_kernels::harmonics::rest;

use super::splat::{colour, deviation};
use super::{FormatError, Limits};
use crate::still::Still;

/// Bytes of the header.
const HEADER: usize = 4096;
/// Bytes of a section's header.
const SECTION: usize = 1024;
/// Bytes of a bucket's middle.
const BUCKET: usize = 12;
/// Default half range of the harmonics of level 2.
const HALF_RANGE: f32 = 1.5;
/// Default range of the places of levels 1 and 2, on either side of a bucket's middle.
const PLACES: u32 = 32767;

/// Reads the Gaussians of a whole `.ksplat` file.
///
/// # Errors
/// Another version, an unknown level, a length that does not match the headers, more Gaussians than the limits allow.
pub fn read(bytes: &[u8]) -> Result<Still, FormatError> {
    within(bytes, &Limits::default())
}

/// Returns true if a file with this name and these first bytes has the format.
pub(super) fn is(path: &Path, _head: &[u8]) -> bool {
    path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("ksplat"))
}

fn wrong(part: &str, expected: impl Into<String>, found: impl ToString) -> FormatError {
    FormatError::new(part, expected, found.to_string())
}

/// Reads a little-endian number at `at`. The caller has checked the length.
fn u16_at(bytes: &[u8], at: usize) -> u16 {
    bytes[at..].first_chunk().map_or(0, |b| u16::from_le_bytes(*b))
}

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    bytes[at..].first_chunk().map_or(0, |b| u32::from_le_bytes(*b))
}

fn f32_at(bytes: &[u8], at: usize) -> f32 {
    bytes[at..].first_chunk().map_or(0.0, |b| f32::from_le_bytes(*b))
}

/// The encoding of numbers.
#[derive(Clone, Copy)]
struct Level {
    /// 0 to 2.
    number: u16,
    /// Least and greatest harmonic of level 2.
    range: [f32; 2],
}

impl Level {
    /// Returns the bytes per number of centres, of scales and rotations, and of harmonics.
    fn sizes(self) -> [usize; 3] {
        match self.number {
            0 => [4, 4, 4],
            1 => [2, 2, 2],
            _ => [2, 2, 1],
        }
    }

    /// Returns the bytes per record.
    fn record(self, degree: usize) -> usize {
        let [centre, number, harmonic] = self.sizes();
        3 * centre + 7 * number + 4 + 3 * rest(degree) * harmonic
    }

    fn number(self, bytes: &[u8], index: usize) -> f32 {
        match self.number {
            0 => f32_at(bytes, 4 * index),
            _ => half::f16::from_bits(u16_at(bytes, 2 * index)).to_f32(),
        }
    }

    fn harmonic(self, bytes: &[u8], index: usize) -> f32 {
        match self.number {
            2 => {
                let [least, greatest] = self.range.map(f64::from);
                (f64::from(bytes[index]) / 255.0 * (greatest - least) + least) as f32
            }
            _ => self.number(bytes, index),
        }
    }
}

/// A section whose bytes are all present.
struct Section<'a> {
    count: usize,
    degree: usize,
    /// Gaussians of each bucket.
    lengths: Vec<usize>,
    middles: &'a [u8],
    /// Half of a bucket's side.
    half: f32,
    places: u32,
    records: &'a [u8],
}

pub(super) fn within(bytes: &[u8], limits: &Limits) -> Result<Still, FormatError> {
    let (header, body) =
        bytes.split_at_checked(HEADER).ok_or_else(|| wrong("header", format!("{HEADER} bytes"), bytes.len()))?;
    if header[0] != 0 || header[1] < 1 {
        let found = format!("{}.{}", header[0], header[1]);
        return Err(wrong("header: version", "0.1", found));
    }
    let number = u16_at(header, 20);
    if number > 2 {
        return Err(wrong("header: compression level", "0 to 2", number));
    }
    let bound = |at: usize, own: f32| Some(f32_at(header, at)).filter(|x| *x != 0.0 && !x.is_nan()).unwrap_or(own);
    let level = Level { number, range: [bound(36, -HALF_RANGE), bound(40, HALF_RANGE)] };
    let (count, of_sections) = (u32_at(header, 12) as usize, u32_at(header, 4) as usize);
    limits.check_count("header: splats", count)?;
    let length = of_sections.checked_mul(SECTION);
    let Some((headers, mut body)) = length.and_then(|length| body.split_at_checked(length)) else {
        return Err(wrong("header: sections", format!("{of_sections} headers of {SECTION} bytes"), body.len()));
    };
    let mut sections = Vec::new();
    for (index, header) in headers.chunks_exact(SECTION).enumerate() {
        let (section, after) = section(index, header, body, level)?;
        sections.push(section);
        body = after;
    }
    if !body.is_empty() {
        return Err(wrong("file", "its end after the last section", format!("{} more bytes", body.len())));
    }
    let found: usize = sections.iter().map(|section| section.count).sum();
    if found != count {
        return Err(wrong("sections", format!("{count} splats as the header says"), found));
    }
    let degree = sections.iter().map(|section| section.degree).max().unwrap_or(0);
    let mut still = Still::with_room(count, degree);
    for section in &sections {
        section.read(level, &mut still)?;
    }
    Ok(still)
}

/// Reads the section of a header; returns it and the bytes after it.
fn section<'a>(
    index: usize,
    header: &[u8],
    body: &'a [u8],
    level: Level,
) -> Result<(Section<'a>, &'a [u8]), FormatError> {
    let part = |name: &str| format!("section {index}: {name}");
    let [count, size, buckets, full, partial] = [4, 8, 12, 32, 36].map(|at| u32_at(header, at) as usize);
    let degree = usize::from(u16_at(header, 40));
    if degree > 2 {
        return Err(wrong(&part("degree of the harmonics"), "0 to 2", degree));
    }
    let storage = usize::from(u16_at(header, 20));
    if buckets > 0 && storage != BUCKET {
        return Err(wrong(&part("bytes of a bucket"), BUCKET.to_string(), storage));
    }
    // Products of two 32-bit numbers, one of them times a record's length, and their sum fit in 64 bits.
    let sizes = [partial * 4, buckets * BUCKET, count * level.record(degree)];
    let mut rest = body;
    let mut take = |length: usize, name: &str| -> Result<&'a [u8], FormatError> {
        let (own, after) =
            rest.split_at_checked(length).ok_or_else(|| wrong(&part(name), format!("{length} bytes"), rest.len()))?;
        rest = after;
        Ok(own)
    };
    let lengths = take(sizes[0], "lengths of buckets")?;
    let (middles, records) = (take(sizes[1], "buckets")?, take(sizes[2], "splats")?);
    let lengths = if level.number == 0 {
        Vec::new()
    } else {
        let shorter = lengths.chunks_exact(4).map(|b| u32_at(b, 0) as usize);
        if full > buckets || full.checked_mul(size).is_none_or(|filled| filled > count) {
            return Err(wrong(&part("full buckets"), format!("{buckets} at most, for {count} splats"), full));
        }
        let lengths: Vec<usize> = std::iter::repeat_n(size, full).chain(shorter).collect();
        let held = lengths.iter().try_fold(0_usize, |sum, length| sum.checked_add(*length)).unwrap_or(usize::MAX);
        if held != count || lengths.len() != buckets {
            let found = format!("{held} in {}", lengths.len());
            return Err(wrong(&part("buckets"), format!("{count} splats in {buckets} buckets"), found));
        }
        lengths
    };
    let half = f32_at(header, 16) / 2.0;
    if level.number > 0 && !half.is_finite() {
        return Err(wrong(&part("side of a bucket"), "a finite number", half));
    }
    let places = Some(u32_at(header, 24)).filter(|places| *places != 0).unwrap_or(PLACES);
    Ok((Section { count, degree, lengths, middles, half, places, records }, rest))
}

impl Section<'_> {
    fn read(&self, level: Level, still: &mut Still) -> Result<(), FormatError> {
        let record = level.record(self.degree);
        let [centre, number, _] = level.sizes();
        let (at_scale, at_colour) = (3 * centre, 3 * centre + 7 * number);
        let step = f64::from(self.half) / f64::from(self.places);
        let middles = self.lengths.iter().enumerate().flat_map(|(bucket, length)| std::iter::repeat_n(bucket, *length));
        let mut middles = middles.map(|bucket| &self.middles[bucket * BUCKET..]);
        let own = rest(self.degree);
        for (i, bytes) in self.records.chunks_exact(record).enumerate() {
            still.mean.push(match middles.next() {
                None => std::array::from_fn(|axis| f32_at(bytes, 4 * axis)),
                Some(middle) => std::array::from_fn(|axis| {
                    let place = f64::from(u16_at(bytes, 2 * axis)) - f64::from(self.places);
                    (f64::from(f32_at(middle, 4 * axis)) + place * step) as f32
                }),
            });
            let values = &bytes[at_scale..];
            let scale: [f32; 3] = std::array::from_fn(|axis| level.number(values, axis));
            if scale.iter().any(|s| *s < 0.0) {
                let found = format!("{scale:?}");
                return Err(wrong(&format!("splat {i}"), "standard deviations of 0 or more", found));
            }
            still.log_scale.push(scale.map(deviation));
            still.rotation.push(std::array::from_fn(|k| level.number(values, 3 + k)));
            let (base, logit) = colour(std::array::from_fn(|k| bytes[at_colour + k]));
            still.base.push(base);
            still.logit.push(logit);
            let harmonics = &bytes[at_colour + 4..];
            for k in 0..still.rest() {
                // The first band has 3 of each channel, the second 5.
                let (start, width) = if k < 3 { (0, 3) } else { (9, 5) };
                let place = |channel: usize| start + channel * width + (if k < 3 { k } else { k - 3 });
                let value = |channel| if k < own { level.harmonic(harmonics, place(channel)) } else { 0.0 };
                still.higher.extend([0, 1, 2].map(value));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use streamsplat_kernels::math::f64::ln;

    use super::*;

    /// Builds a file of one section; `buckets` are its full and its shorter ones, with their middles.
    fn file(level: u16, degree: u16, records: &[Vec<u8>], full: u32, shorter: &[u32], middles: &[[f32; 3]]) -> Vec<u8> {
        let mut bytes = vec![0; HEADER + SECTION];
        let mut put = |at: usize, value: &[u8]| bytes[at..at + value.len()].copy_from_slice(value);
        let count = records.len() as u32;
        put(1, &[1]);
        [4, 8].iter().for_each(|at| put(*at, &1_u32.to_le_bytes()));
        [12, 16].iter().for_each(|at| put(*at, &count.to_le_bytes()));
        put(20, &level.to_le_bytes());
        put(36, &(-2.0_f32).to_le_bytes());
        put(40, &2.0_f32.to_le_bytes());
        let section =
            [(0, count), (4, count), (8, 2), (12, middles.len() as u32), (32, full), (36, shorter.len() as u32)];
        section.iter().for_each(|(at, value)| put(HEADER + at, &value.to_le_bytes()));
        put(HEADER + 16, &5.0_f32.to_le_bytes());
        put(HEADER + 20, &12_u16.to_le_bytes());
        put(HEADER + 40, &degree.to_le_bytes());
        shorter.iter().for_each(|n| bytes.extend(n.to_le_bytes()));
        middles.as_flattened().iter().for_each(|x| bytes.extend(x.to_le_bytes()));
        records.iter().for_each(|record| bytes.extend(record));
        bytes
    }

    fn floats(values: &[f32]) -> Vec<u8> {
        values.iter().flat_map(|x| x.to_le_bytes()).collect()
    }

    fn halves(values: &[f32]) -> Vec<u8> {
        values.iter().flat_map(|x| half::f16::from_f32(*x).to_le_bytes()).collect()
    }

    #[test]
    fn records_of_floats_are_taken_as_they_are() {
        let harmonics: Vec<f32> = (0..24).map(|i| i as f32 / 8.0).collect();
        let mut record = floats(&[1.0, -2.0, 3.0, 0.5, 1.0, 2.0, 0.5, 0.25, -0.25, 0.125]);
        record.extend([255, 0, 51, 128]);
        record.extend(floats(&harmonics));
        let found = read(&file(0, 2, &[record], 0, &[], &[])).expect("a file");
        assert_eq!((found.mean[0], found.rotation[0]), ([1.0, -2.0, 3.0], [0.5, 0.25, -0.25, 0.125]));
        assert!((found.log_scale[0][0] + ln(2.0) as f32).abs() < 1e-7 && found.log_scale[0][1] == 0.0);
        assert_eq!(colour([255, 0, 51, 128]), (found.base[0], found.logit[0]));
        // Coefficient k of a channel: the first band has three of each channel, the second five.
        for k in 0..8 {
            for channel in 0..3 {
                let place = if k < 3 { 3 * channel + k } else { 9 + 5 * channel + k - 3 };
                assert_eq!(found.higher[3 * k + channel], harmonics[place]);
            }
        }
    }

    #[test]
    fn places_are_measured_from_the_middle_of_their_bucket() {
        let record = |places: [u16; 3]| {
            let mut bytes: Vec<u8> = places.iter().flat_map(|n| n.to_le_bytes()).collect();
            bytes.extend(halves(&[0.5, 1.0, 2.0, 1.0, 0.0, 0.0, 0.5]));
            bytes.extend([1, 2, 3, 4]);
            bytes.extend([0, 255, 51, 0, 0, 0, 0, 0, 0]);
            bytes
        };
        let places = [[32767, 0, 65534], [32767; 3], [0, 32767, 32767]];
        let middles = [[10.0, 20.0, 30.0], [-1.0, -2.0, -3.0]];
        let bytes = file(2, 1, &places.map(record), 1, &[1], &middles);
        let found = read(&bytes).expect("a file");
        assert_eq!(found.mean, [[10.0, 17.5, 32.5], [10.0, 20.0, 30.0], [-3.5, -2.0, -3.0]]);
        assert_eq!((found.rotation[0], found.degree), ([1.0, 0.0, 0.0, 0.5], 1));
        assert_eq!([0, 3, 6].map(|i| found.higher[i]), [-2.0, 2.0, -1.2]);
        for length in 0..bytes.len() {
            assert!(read(&bytes[..length]).is_err(), "{length}");
        }
        assert!(read(&[&bytes[..], &[0]].concat()).is_err());
    }

    #[test]
    fn impossible_headers_are_refused_before_memory_is_taken() {
        let record = floats(&[0.0; 11]);
        let good = file(0, 0, &[record], 0, &[], &[]);
        assert!(read(&good).is_ok());
        let with = |at: usize, value: u32| {
            let mut bytes = good.clone();
            bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
            read(&bytes).expect_err("impossible").to_string()
        };
        for (at, value, expected) in [
            (0, 1, "header: version: expected 0.1, found 1.0"),
            (20, 3, "header: compression level: expected 0 to 2, found 3"),
            (12, u32::MAX, "header: splats: expected at most 16777216 Gaussians"),
            (12, 2, "sections: expected 2 splats as the header says, found 1"),
            (4, u32::MAX, "header: sections: expected 4294967295 headers"),
            (HEADER + 4, u32::MAX, "section 0: splats: expected 188978560980 bytes, found 44"),
            (HEADER + 12, u32::MAX, "section 0: buckets: expected"),
            (HEADER + 36, u32::MAX, "section 0: lengths of buckets: expected"),
            (HEADER + 40, 3, "section 0: degree of the harmonics: expected 0 to 2, found 3"),
        ] {
            let error = with(at, value);
            assert!(error.starts_with(expected), "{error}");
        }
    }
}
