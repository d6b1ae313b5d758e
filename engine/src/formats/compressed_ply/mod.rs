//! Compressed PLY: Gaussians in chunks of 256, four words each.
//!
//! | word of a vertex | bits | value |
//! |---|---|---|
//! | `packed_position` | 11, 10, 11 | x, y, z between the chunk's `min_x` and `max_x`, … |
//! | `packed_rotation` | 2, 10, 10, 10 | index of the largest of w, x, y, z, and the others in that order: `(b / 1023 − ½)·√2` |
//! | `packed_scale` | 11, 10, 11 | logarithms between `min_scale_x` and `max_scale_x`, … |
//! | `packed_color` | 8, 8, 8, 8 | red, green and blue, between `min_r` and `max_r`, … if the chunks have them, and opacity |
//!
//! Fields are listed from the high bits down; a value is `min + (max − min)·b / (2ⁿ − 1)`. An optional element `sh` has
//! 9, 24 or 45 bytes per vertex, in the order of `f_rest`: `8·((b + ½) / 256 − ½)`, where 0 means −4 and 255 means 4.
//!
//! Source: the layout that PlayCanvas's SuperSplat and splat-transform write.

mod write;

use streamsplat_kernels::harmonics::Y0;
use streamsplat_kernels::math::f64::ln;

use super::ply::{Element, Encoding, Header, Scalar, read_comments};
use super::{FormatError, Limits};
use crate::still::{LEAST, Still};
pub use write::write;

/// Vertices per chunk.
const CHUNK: usize = 256;
/// Least and greatest values in a chunk, by axis: of positions, of scales, of colours.
const BOUNDS: [[[&str; 3]; 2]; 3] = [
    [["min_x", "min_y", "min_z"], ["max_x", "max_y", "max_z"]],
    [["min_scale_x", "min_scale_y", "min_scale_z"], ["max_scale_x", "max_scale_y", "max_scale_z"]],
    [["min_r", "min_g", "min_b"], ["max_r", "max_g", "max_b"]],
];
/// The words of a vertex.
const WORDS: [&str; 4] = ["packed_position", "packed_rotation", "packed_scale", "packed_color"];

/// Returns true for files of this kind.
pub(super) fn is_packed(header: &Header) -> bool {
    header.element("chunk").is_some() && header.vertices().is_ok_and(|v| v.property(WORDS[0]).is_some())
}

/// Returns the offset in the record of a property of a given type.
fn start(element: &Element, name: &str, scalar: Scalar) -> Result<usize, FormatError> {
    match element.property(name) {
        Some((_, property)) if property.scalar == scalar => Ok(property.start),
        found => {
            let found = found.map_or("none".to_owned(), |(_, property)| format!("{:?}", property.scalar));
            let part = format!("property {name} of {}", element.name);
            Err(FormatError::new(part, format!("it as {scalar:?}"), found))
        }
    }
}

/// Reads the Gaussians of a file.
pub(super) fn read(header: &Header, body: &[u8], limits: &Limits) -> Result<Still, FormatError> {
    let vertices = header.vertices()?;
    let Some(chunks) = header.element("chunk") else { return Err(vertices.wrong("chunks before it", "none")) };
    if header.encoding == Encoding::Text {
        return Err(FormatError::new("format", "a binary one, for a compressed file", "ascii"));
    }
    let big = header.encoding == Encoding::Big;
    if chunks.count != vertices.count.div_ceil(CHUNK) {
        let expected = format!("{} of them for {} vertices", vertices.count.div_ceil(CHUNK), vertices.count);
        return Err(chunks.wrong(expected, chunks.count.to_string()));
    }
    let coloured = chunks.property(BOUNDS[2][0][0]).is_some();
    let mut bounds = Vec::new();
    for name in BOUNDS[..if coloured { 3 } else { 2 }].as_flattened().as_flattened() {
        bounds.push(start(chunks, name, Scalar::F32)?);
    }
    let words = WORDS.map(|name| start(vertices, name, Scalar::U32));
    let [position, rotation, scale, colour] = words;
    let words = [position?, rotation?, scale?, colour?];
    let (degree, harmonics) = harmonics(header, body)?;
    let (chunk_bytes, bytes) = (header.bytes("chunk", body)?, header.bytes("vertex", body)?);
    limits.check_still("element vertex", vertices.count, degree, body.len() as u64)?;

    let mut still = Still::with_room(vertices.count, degree);
    read_comments(&header.comments, &mut still.about);
    let (width, rest) = (chunks.stride(), still.rest());
    for (i, record) in bytes.chunks_exact(vertices.stride()).enumerate() {
        let chunk = &chunk_bytes[i / CHUNK * width..][..width];
        let bound = |k: usize| bounds.get(k).map_or(0.0, |&at| Scalar::F32.read(&chunk[at..], big));
        let between = |group: usize, axis: usize, share: f64| {
            let (least, greatest) = (bound(6 * group + axis), bound(6 * group + 3 + axis));
            least + (greatest - least) * share
        };
        let [position, rotation, scale, colour] = words.map(|at| Scalar::U32.read(&record[at..], big) as u32);
        let triple = |group: usize, word: u32| {
            let shares = [share(word >> 21, 11), share(word >> 11, 10), share(word, 11)];
            std::array::from_fn(|axis| between(group, axis, shares[axis]) as f32)
        };
        still.mean.push(triple(0, position));
        still.log_scale.push(triple(1, scale));
        still.rotation.push(smallest_three(rotation));
        still.base.push(std::array::from_fn(|axis| {
            let byte = share(colour >> (24 - 8 * axis), 8);
            let seen = if coloured { between(2, axis, byte) } else { byte };
            ((seen - 0.5) / Y0) as f32
        }));
        let opacity = share(colour, 8).clamp(LEAST, 1.0 - LEAST);
        still.logit.push((ln(opacity) - ln(1.0 - opacity)) as f32);
        let own = &harmonics[i * 3 * rest..][..3 * rest];
        still.higher.extend((0..3 * rest).map(|k| coefficient(own[k % 3 * rest + k / 3])));
    }
    Ok(still)
}

/// Returns the degree of the harmonics and their bytes.
fn harmonics<'a>(header: &Header, body: &'a [u8]) -> Result<(usize, &'a [u8]), FormatError> {
    let Some(sh) = header.element("sh") else { return Ok((0, &[])) };
    let Some(degree) = [0, 9, 24, 45].iter().position(|n| *n == sh.properties.len()) else {
        return Err(sh.wrong("none, 9, 24 or 45 properties", sh.properties.len().to_string()));
    };
    for (i, property) in sh.properties.iter().enumerate() {
        if property.scalar != Scalar::U8 || property.name != format!("f_rest_{i}") {
            return Err(sh.wrong(format!("f_rest_{i} as U8"), format!("{} as {:?}", property.name, property.scalar)));
        }
    }
    let vertices = header.vertices()?.count;
    if sh.count != vertices {
        return Err(sh.wrong(format!("{vertices}, as of vertices"), sh.count.to_string()));
    }
    Ok((degree, header.bytes("sh", body)?))
}

/// Returns the low `bits` bits divided by their maximum.
fn share(word: u32, bits: u32) -> f64 {
    let most = (1 << bits) - 1;
    f64::from(word & most) / f64::from(most)
}

fn smallest_three(word: u32) -> [f32; 4] {
    let largest = (word >> 30) as usize;
    let (mut q, mut squares, mut shift) = ([0.0; 4], 0.0, 20_u32);
    for (_, component) in q.iter_mut().enumerate().filter(|(i, _)| *i != largest) {
        *component = (share(word >> shift, 10) - 0.5) * std::f64::consts::SQRT_2;
        squares += *component * *component;
        shift = shift.saturating_sub(10);
    }
    q[largest] = (1.0_f64 - squares).max(0.0).sqrt();
    q.map(|c| c as f32)
}

fn coefficient(byte: u8) -> f32 {
    match byte {
        0 => -4.0,
        255 => 4.0,
        byte => 8.0 * ((f32::from(byte) + 0.5) / 256.0 - 0.5),
    }
}
