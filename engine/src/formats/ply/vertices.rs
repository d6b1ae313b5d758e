//! Gaussians of a PLY file in the layout of 3D Gaussian splatting.

use rayon::prelude::*;
use streamsplat_kernels::harmonics::{MAX_DEGREE, Y0};

use super::header::{Element, Encoding, Header, Scalar, check_after, quoted};
use crate::formats::blocks::{Blocks, ReadError};
use crate::formats::{FormatError, Limits};
use crate::still::{Still, middle};

/// Properties that every file has, except its colours.
const WANTED: [&str; 11] =
    ["x", "y", "z", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"];
/// Colours, as the harmonics' first coefficients (`f_dc`) or as red, green and blue.
const COEFFICIENTS: [&str; 3] = ["f_dc_0", "f_dc_1", "f_dc_2"];
const COLOURS: [&str; 3] = ["red", "green", "blue"];

/// Binary32 does not keep centres of this size or more to 1/4096.
const NEAR: f64 = 4096.0;
/// Bytes of a block.
const BLOCK: usize = 8 << 20;
/// Vertices per task.
const PIECE: usize = 1 << 12;

/// Indices of the required values among the properties.
struct Layout {
    /// [`WANTED`], then the colours, then `f_rest`.
    places: Vec<usize>,
    /// Values of full intensity per channel, if the file has colours instead of coefficients.
    ones: Option<[f64; 3]>,
    /// Degree of the harmonics that are kept.
    degree: usize,
    /// Degree of those in the file.
    stored: usize,
    /// True for Gaussians without a third scale, which have no thickness.
    flat: bool,
    /// True if centres are doubles.
    doubles: bool,
}

impl Layout {
    fn of(vertices: &Element) -> Result<Layout, FormatError> {
        let rest = vertices.properties.iter().filter(|p| p.name.starts_with("f_rest_")).count();
        let stored = [0, 9, 24, 45, 72].iter().position(|n| *n == rest).ok_or_else(|| {
            FormatError::new("properties f_rest_*", "none, 9, 24, 45 or 72 of them", rest.to_string())
        })?;
        let degree = stored.min(MAX_DEGREE);
        let kept = streamsplat_kernels::harmonics::rest(degree);
        let flat = vertices.property("scale_2").is_none() && vertices.property("scale_1").is_some();
        let seen = vertices.property(COEFFICIENTS[0]).is_none() && vertices.property(COLOURS[0]).is_some();
        let colours = if seen { COLOURS } else { COEFFICIENTS };
        let names = WANTED.iter().chain(&colours).map(|name| match *name {
            // Any property: its value is not used.
            "scale_2" if flat => "scale_1".to_owned(),
            name => name.to_owned(),
        });
        let names = names.chain((0..3 * kept).map(|i| format!("f_rest_{}", i / kept * (rest / 3) + i % kept)));
        let is_colour = |name: &str| COLOURS.contains(&name);
        let place = |name: String| {
            let wrong = |found: &str| {
                let colour = if is_colour(&name) { ", or a number of 8 or 16 bits without a sign" } else { "" };
                let expected = format!("it as a float of 16, 32 or 64 bits{colour}");
                FormatError::new(format!("property {name}"), expected, found)
            };
            let (place, property) = vertices.property(&name).ok_or_else(|| wrong("none"))?;
            let whole = is_colour(&name) && matches!(property.scalar, Scalar::U8 | Scalar::U16);
            if property.scalar.is_float() || whole { Ok(place) } else { Err(wrong("whole numbers")) }
        };
        let places = names.map(place).collect::<Result<Vec<usize>, _>>()?;
        let one = |k: usize| vertices.properties[places[WANTED.len() + k]].scalar.one();
        let doubles = places[..3].iter().all(|place| vertices.properties[*place].scalar == Scalar::F64);
        Ok(Layout { ones: seen.then(|| std::array::from_fn(one)), degree, stored, flat, doubles, places })
    }

    /// Returns a scene of `count` zeroed Gaussians, with the metadata of the header.
    fn scene(&self, header: &Header, count: usize) -> Still {
        let mut still = Still::zeros(count, self.degree);
        super::comments::read(&header.comments, &mut still.about);
        still.about.offset = [0.0; 3];
        if self.stored > self.degree {
            still.about.notes.push(format!("harmonics of degree {} read to degree {}", self.stored, self.degree));
        }
        if self.flat {
            still.about.notes.push("no scale_2: Gaussians without thickness, as of 2D Gaussian splatting".to_owned());
        }
        still
    }
}

/// Returns the integers to subtract from doubles so that binary32 keeps them to 1/4096: the median of some centres.
/// Zeros if binary32 is precise enough anyway.
fn offset_of(centres: &[[f64; 3]]) -> [f64; 3] {
    let along =
        |axis: usize| centres.iter().filter(|m| m.iter().all(|x| x.is_finite())).map(|m| m[axis] as f32).collect();
    let Some(offset) = middle([along(0), along(1), along(2)]) else { return [0.0; 3] };
    if offset.iter().any(|x| x.abs() >= NEAR) { offset } else { [0.0; 3] }
}

/// Reads vertices stored as bytes.
pub(super) fn binary(header: &Header, body: &[u8], limits: &Limits) -> Result<Still, FormatError> {
    let vertices = header.vertices()?;
    let layout = Layout::of(vertices)?;
    let bytes = header.bytes(&vertices.name, body)?;
    limits.check_still("element vertex", vertices.count, layout.degree, body.len() as u64)?;
    let mut still = layout.scene(header, vertices.count);
    let records = Records::new(&layout, header, vertices, bytes);
    records.read(bytes, Rows::of(&mut still));
    still.about.offset = records.offset;
    Ok(still)
}

/// Reads a file in blocks, after its header of `start` bytes has been parsed.
pub(super) fn blocks(header: &Header, start: u64, file: &mut Blocks<'_>, limits: &Limits) -> Result<Still, ReadError> {
    let vertices = header.vertices()?;
    let layout = Layout::of(vertices)?;
    let after = file.length().saturating_sub(start);
    let (place, more) = header.place(&vertices.name, after)?;
    limits.check_still("element vertex", vertices.count, layout.degree, file.length())?;
    let mut still = layout.scene(header, vertices.count);
    file.pass(start + place.start)?;
    // Vertices per block, and vertices that are not read yet.
    let stride = vertices.stride();
    let (most, mut left) = ((BLOCK / stride).max(PIECE), vertices.count);
    let mut next = |block: &mut Vec<u8>| {
        let count = most.min(left);
        left -= count;
        block.resize(count * stride, 0);
        file.fill(block)
    };
    let (mut block, mut ahead) = (Vec::new(), Vec::new());
    next(&mut block)?;
    let records = Records::new(&layout, header, vertices, &block);
    let mut rows = Rows::of(&mut still);
    while !block.is_empty() {
        let own = rows.take(block.len() / records.stride);
        let ((), read) = rayon::join(|| records.read(&block, own), || next(&mut ahead));
        read?;
        std::mem::swap(&mut block, &mut ahead);
    }
    file.pass(after - place.end - more as u64)?;
    let mut end = vec![0; more];
    file.fill(&mut end)?;
    check_after(&end)?;
    still.about.offset = records.offset;
    Ok(still)
}

/// Layout of the records of a binary file.
struct Records<'a> {
    layout: &'a Layout,
    /// Offset in a record and type of the required values, in the order of [`Layout::places`].
    wanted: Vec<(usize, Scalar)>,
    big: bool,
    stride: usize,
    /// Subtracted from the centres.
    offset: [f64; 3],
}

impl<'a> Records<'a> {
    /// Returns the layout for a file whose first vertices are those in `first`.
    fn new(layout: &'a Layout, header: &Header, vertices: &Element, first: &[u8]) -> Self {
        let wanted = layout.places.iter().map(|&place| &vertices.properties[place]).map(|p| (p.start, p.scalar));
        let (wanted, big): (Vec<_>, bool) = (wanted.collect(), header.encoding == Encoding::Big);
        let stride = vertices.stride();
        let mut offset = [0.0; 3];
        if layout.doubles {
            let place = |record: &[u8]| std::array::from_fn(|k| Scalar::F64.read(&record[wanted[k].0..], big));
            let centres: Vec<[f64; 3]> = first.chunks_exact(stride).take(PIECE).map(place).collect();
            offset = offset_of(&centres);
        }
        Self { layout, wanted, big, stride, offset }
    }

    /// Reads records into the same number of rows.
    fn read(&self, bytes: &[u8], mut rows: Rows<'_>) {
        let pieces: Vec<_> =
            bytes.chunks(PIECE * self.stride).map(|bytes| (bytes, rows.take(bytes.len() / self.stride))).collect();
        let single = !self.big && self.wanted.iter().all(|(_, scalar)| *scalar == Scalar::F32);
        pieces.into_par_iter().for_each(|(bytes, mut rows)| {
            for (i, record) in bytes.chunks_exact(self.stride).enumerate() {
                if single {
                    let value = |start: usize| record[start..].first_chunk().map_or(0.0, |b| f32::from_le_bytes(*b));
                    rows.set(i, self.layout, |k| value(self.wanted[k].0));
                } else {
                    rows.set(i, self.layout, |k| {
                        let (start, scalar) = self.wanted[k];
                        match self.offset.get(k) {
                            Some(&off) if off != 0.0 => (scalar.read(&record[start..], self.big) - off) as f32,
                            _ => scalar.read_single(&record[start..], self.big),
                        }
                    });
                }
            }
        });
    }
}

/// Reads vertices stored as lines of numbers.
pub(super) fn text(header: &Header, body: &[u8], limits: &Limits) -> Result<Still, FormatError> {
    let wrong = |part: String, expected: &str, found: &str| FormatError::new(part, expected, quoted(found));
    let vertices = header.vertices()?;
    let layout = Layout::of(vertices)?;
    // A number and its separator are at least two bytes; the last one needs no line feed.
    let mut least = 0_usize;
    for element in &header.elements {
        let size = element.count.checked_mul(2 * element.properties.len());
        least = size.and_then(|size| least.checked_add(size)).unwrap_or(usize::MAX);
        if least > body.len() + 1 {
            let expected = format!("{} of {} numbers each", element.count, element.properties.len());
            return Err(element.wrong(expected, format!("{} bytes", body.len())));
        }
    }
    let body = std::str::from_utf8(body).map_err(|_| FormatError::new("body", "text", "bytes that are none"))?;
    let mut lines = body.lines();
    limits.check_still("element vertex", vertices.count, layout.degree, body.len() as u64)?;
    let mut still = layout.scene(header, vertices.count);
    let mut rows = Rows::of(&mut still);
    let mut centres = Vec::new();
    for element in header.elements.iter().filter(|element| !element.properties.is_empty()) {
        let mut values = vec![0.0_f32; element.properties.len()];
        for i in 0..element.count {
            let line = lines.next();
            let line = line.ok_or_else(|| element.wrong(format!("{} lines", element.count), i.to_string()))?;
            let mut words = line.split_ascii_whitespace();
            for (value, property) in values.iter_mut().zip(&element.properties) {
                let part = || format!("property {} of {} {i}", property.name, element.name);
                let word = words.next().ok_or_else(|| wrong(part(), "a number", line))?;
                *value = word.parse().map_err(|_| wrong(part(), "a number", word))?;
            }
            if layout.doubles && element.name == vertices.name {
                // The values are valid numbers; these are read as doubles.
                let double =
                    |k: usize| line.split_ascii_whitespace().nth(layout.places[k]).and_then(|word| word.parse().ok());
                centres.push(std::array::from_fn(|k| double(k).unwrap_or(f64::NAN)));
            }
            if let Some(word) = words.next() {
                return Err(wrong(format!("{} {i}", element.name), "as many numbers as properties", word));
            }
            if element.name == vertices.name {
                rows.set(i, &layout, |k| values[layout.places[k]]);
            }
        }
    }
    let offset = offset_of(&centres[..centres.len().min(PIECE)]);
    if offset != [0.0; 3] {
        for (mean, centre) in still.mean.iter_mut().zip(&centres) {
            *mean = std::array::from_fn(|k| (centre[k] - offset[k]) as f32);
        }
        still.about.offset = offset;
    }
    match lines.find(|line| !line.trim().is_empty()) {
        Some(line) => Err(wrong("file".into(), "nothing after the last element", line)),
        None => Ok(still),
    }
}

/// Gaussians of a scene that are being filled, in order.
struct Rows<'a> {
    mean: &'a mut [[f32; 3]],
    log_scale: &'a mut [[f32; 3]],
    rotation: &'a mut [[f32; 4]],
    logit: &'a mut [f32],
    base: &'a mut [[f32; 3]],
    higher: &'a mut [f32],
    /// Coefficients above the first, per channel.
    rest: usize,
}

/// Splits off the first `count` elements.
fn first<'a, T>(all: &mut &'a mut [T], count: usize) -> &'a mut [T] {
    let (first, rest) = std::mem::take(all).split_at_mut(count);
    *all = rest;
    first
}

impl<'a> Rows<'a> {
    fn of(still: &'a mut Still) -> Self {
        let rest = still.rest();
        Self {
            mean: &mut still.mean,
            log_scale: &mut still.log_scale,
            rotation: &mut still.rotation,
            logit: &mut still.logit,
            base: &mut still.base,
            higher: &mut still.higher,
            rest,
        }
    }

    /// Splits off the first `count` Gaussians.
    fn take(&mut self, count: usize) -> Rows<'a> {
        Rows {
            mean: first(&mut self.mean, count),
            log_scale: first(&mut self.log_scale, count),
            rotation: first(&mut self.rotation, count),
            logit: first(&mut self.logit, count),
            base: first(&mut self.base, count),
            higher: first(&mut self.higher, 3 * self.rest * count),
            rest: self.rest,
        }
    }

    /// Fills Gaussian `i` with values in the order of [`Layout::places`].
    #[inline(always)]
    fn set(&mut self, i: usize, layout: &Layout, value: impl Fn(usize) -> f32) {
        self.mean[i] = [value(0), value(1), value(2)];
        self.logit[i] = value(3);
        self.log_scale[i] = [value(4), value(5), if layout.flat { f32::NEG_INFINITY } else { value(6) }];
        self.rotation[i] = [value(7), value(8), value(9), value(10)];
        let colour = [value(11), value(12), value(13)];
        self.base[i] = match layout.ones {
            Some(ones) => std::array::from_fn(|c| ((f64::from(colour[c]) / ones[c] - 0.5) / Y0) as f32),
            None => colour,
        };
        let rest = self.rest;
        for (k, own) in self.higher[i * 3 * rest..][..3 * rest].chunks_exact_mut(3).enumerate() {
            for (channel, own) in own.iter_mut().enumerate() {
                *own = value(14 + channel * rest + k);
            }
        }
    }
}
