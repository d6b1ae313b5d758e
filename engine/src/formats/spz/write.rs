//! Writing SPZ, versions 3 and 4.

use std::io::Write;

use flate2::{Compression, GzBuilder};
use ruzstd::encoding::{CompressionLevel, compress_to_vec};
use streamsplat_kernels::harmonics::rest;
use streamsplat_kernels::math::f64::exp;

use super::fixed::Fixed;
use super::records::Stated;
use super::{ANTIALIASED, COLOUR, EXTENDED, HEADER, MAGIC};
use crate::camera::Rotation;
use crate::formats::notes::Notes;
use crate::formats::{Order, SpzVersion, Written};
use crate::still::Still;

/// Bits kept of coefficients of degree 1, and of higher degrees.
const KEPT: [u32; 2] = [5, 4];
/// Range of the logarithm of a scale in a byte.
const LOGS: [f32; 2] = [-10.0, 5.9375];
/// Range of `0.15·c + ½` that rounds to a byte of colour without clamping, for a first coefficient `c`.
const COLOURS: [f64; 2] = [-0.5 / 255.0, 1.0 + 0.5 / 255.0];

/// Writes a still scene as an SPZ file; see [`spz`](super) for the precision of each value.
///
/// Values are along the scene's own axes (RDF). Version 4 stores the axes in a record, version 3 in the comment of its
/// gzip stream.
///
/// Positions have 12 fractional bits, or fewer if clamping would damage more Gaussians than rounding; the few that are
/// farther away are clamped to the range. The harmonics' coefficients are rounded to 5 bits at degree 1 and 4 above, as
/// in the format's own program. Gaussians that cannot be drawn ([`Still::defect`]) are left out. Everything is
/// compressed by pure-Rust code, so the bytes are a function of the scene alone.
///
/// # Panics
/// If the arrays differ in length ([`Still::uneven`]), or there are 2³² Gaussians.
pub fn write(still: &Still, version: SpzVersion) -> Written {
    let rest = 3 * rest(still.degree);
    let order = Order::own(still);
    let mut notes = Notes::of(still, &order);
    let sound = &order.places;
    let count = u32::try_from(sound.len()).unwrap_or_else(|_| panic!("{} Gaussians in one file", sound.len()));
    let fixed = Fixed::of(still, sound);
    fixed.notes(still, sound, &mut notes);
    moved(still, sound, &mut notes);
    let attributes: [Vec<u8>; 6] = [
        sound.iter().flat_map(|i| fixed.bytes(still.mean[*i])).collect(),
        sound.iter().map(|i| byte(255.0 / (1.0 + exp(-f64::from(still.logit[*i]).clamp(-200.0, 200.0))))).collect(),
        sound.iter().flat_map(|i| still.base[*i].map(|c| byte((COLOUR * f64::from(c) + 0.5) * 255.0))).collect(),
        sound.iter().flat_map(|i| still.log_scale[*i].map(|s| byte((f64::from(s) + 10.0) * 16.0))).collect(),
        sound.iter().flat_map(|i| rotation(still.rotation[*i])).collect(),
        sound.iter().flat_map(|&i| (0..rest).map(move |k| coefficient(still.higher[i * rest + k], k / 3))).collect(),
    ];
    let mut stated = Stated::of(&still.about);
    stated.offset = fixed.offset(still);
    notes.offset(stated.offset, "which only streamsplat reads from an SPZ file");
    if version == SpzVersion::V3 && stated.orbit.is_some() {
        notes.0.push("the limits of an orbiting camera left out, which version 4 has a record for".to_owned());
    }
    let flags = if still.about.antialiased { ANTIALIASED } else { 0 };
    let header = Head { count, degree: still.degree as u8, bits: fixed.bits as u8, flags };
    let bytes = match version {
        SpzVersion::V3 => gzipped(header, &attributes, &stated.as_comment()),
        SpzVersion::V4 => framed(header, &attributes, &stated.as_records()),
    };
    Written { bytes, notes: notes.0 }
}

/// Header fields of every version.
struct Head {
    count: u32,
    degree: u8,
    bits: u8,
    flags: u8,
}

impl Head {
    /// Returns the first 15 bytes.
    fn bytes(&self, version: u32, more_flags: u8) -> Vec<u8> {
        let mut out = MAGIC.to_vec();
        out.extend_from_slice(&version.to_le_bytes());
        out.extend_from_slice(&self.count.to_le_bytes());
        out.extend_from_slice(&[self.degree, self.bits, self.flags | more_flags]);
        out
    }
}

/// Encodes version 3.
fn gzipped(header: Head, attributes: &[Vec<u8>; 6], comment: &str) -> Vec<u8> {
    let mut encoder = GzBuilder::new().comment(comment).write(Vec::new(), Compression::default());
    let plain = [header.bytes(3, 0), vec![0]];
    let written = plain.iter().chain(attributes).try_for_each(|part| encoder.write_all(part));
    written.and_then(|()| encoder.finish()).unwrap_or_else(|e| panic!("a gzip stream in memory: {e}"))
}

/// Encodes version 4.
fn framed(header: Head, attributes: &[Vec<u8>; 6], records: &[u8]) -> Vec<u8> {
    let filled = || attributes.iter().filter(|attribute| !attribute.is_empty());
    let frames: Vec<Vec<u8>> =
        filled().map(|attribute| compress_to_vec(attribute.as_slice(), CompressionLevel::Fastest)).collect();
    let mut out = header.bytes(4, EXTENDED);
    out.push(frames.len() as u8);
    out.extend_from_slice(&((HEADER + records.len()) as u32).to_le_bytes());
    out.extend_from_slice(&[0; 12]);
    out.extend_from_slice(records);
    for (attribute, frame) in filled().zip(&frames) {
        out.extend_from_slice(&(frame.len() as u64).to_le_bytes());
        out.extend_from_slice(&(attribute.len() as u64).to_le_bytes());
    }
    out.extend_from_slice(&frames.concat());
    out
}

/// Adds notes on values that are clamped to the ranges of the format's bytes.
fn moved(still: &Still, sound: &[usize], notes: &mut Notes) {
    let half = 0.5 / 16.0;
    let count = |beyond: &dyn Fn(usize) -> bool| sound.iter().filter(|i| beyond(**i)).count();
    let large = count(&|i| still.log_scale[i].iter().any(|s| *s > LOGS[1] + half));
    notes.changed(large, sound.len(), "made smaller: SPZ has no standard deviations above e^5.94, 379 units");
    let longest = |i: usize| still.log_scale[i].into_iter().fold(f32::NEG_INFINITY, f32::max);
    let small = count(&|i| longest(i) < LOGS[0] - half);
    notes.changed(small, sound.len(), "made larger: SPZ has no standard deviations under e^−10, 0.000045 units");
    let seen = |c: f32| COLOUR * f64::from(c) + 0.5;
    let bright = count(&|i| still.base[i].iter().any(|c| seen(*c) < COLOURS[0] || seen(*c) > COLOURS[1]));
    notes.changed(bright, sound.len(), "with a first coefficient beyond ±3.33, moved there");
    let width = 3 * still.rest();
    let beyond = |i: usize| still.higher[i * width..(i + 1) * width].iter().any(|c| !(-1.07..=1.07).contains(c));
    notes.changed(count(&beyond), sound.len(), "with a further coefficient of the harmonics beyond ±1, moved there");
}

/// Returns the nearest byte, rounding halves away from zero.
fn byte(x: f64) -> u8 {
    x.round().clamp(0.0, 255.0) as u8
}

/// Packs the three smallest of x, y, z, w, and the index of the largest, which is made positive.
fn rotation(q: [f32; 4]) -> [u8; 4] {
    let [w, x, y, z] = Rotation::from_quaternion(q.map(f64::from)).unwrap_or_default().quaternion();
    let q = [x, y, z, w];
    let largest = (1..4).fold(0, |best: usize, i| if q[i].abs() > q[best].abs() { i } else { best });
    let mut bits = largest as u32;
    for i in (0..4).filter(|i| *i != largest) {
        let negative = (q[i] < 0.0) != (q[largest] < 0.0);
        let magnitude = (511.0 * q[i].abs() / std::f64::consts::FRAC_1_SQRT_2 + 0.5) as u32;
        bits = bits << 10 | u32::from(negative) << 9 | magnitude.min(511);
    }
    bits.to_le_bytes()
}

/// Quantises a coefficient to the middle of a bucket of bytes; 0 is one of the middles.
fn coefficient(value: f32, k: usize) -> u8 {
    let bucket = 1 << (8 - KEPT[usize::from(k >= 3)]);
    let whole = (f64::from(value) * 128.0).round().clamp(-1e6, 1e6) as i32 + 128;
    (((whole + bucket / 2).div_euclid(bucket)) * bucket).clamp(0, 255) as u8
}
