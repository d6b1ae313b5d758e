//! SPZ, version 4 (a plain header and one zstd frame per attribute) and versions 1 to 3 (everything in one gzip
//! stream).
//!
//! | attribute | bytes per Gaussian | value |
//! |---|---|---|
//! | positions | 9 (in version 1 also 6) | 24-bit fixed point, little-endian, `fractionalBits` after the point |
//! | alphas | 1 | 255 times the opacity |
//! | colours | 3 | `255·(0.15·c + ½)` of the harmonics' first coefficients |
//! | scales | 3 | `16·(ln s + 10)` |
//! | rotations | 4 (3 before version 3) | the three smallest components in ten bits each, and the index of the largest (x, y and z in eight bits each) |
//! | harmonics | 9, 24, 45 or 72 | `128·(c + 1)`, coefficients outermost; of degree 4 those up to degree 3 are kept |
//!
//! Opacities of 0 and 255 stay within 10⁻¹² of 0 and 1. Version 1 has the rotations of version 2. Its positions are
//! three binary16, or fixed point, as written by @adobe/spz; the length of the file decides between them.
//!
//! Records (`records.rs`) declare the axes of the numbers. The default is RUB (x right, y up, z back), as in the
//! format's description; programs that store PLY's numbers unchanged write RDF. [`Still::taken_along`] overrides the
//! axes.
//!
//! These are errors: harmonics above degree 4, flags other than those of anti-aliasing and of extensions, and
//! inconsistent lengths.
//!
//! Source: the format's description and its reference implementation, nianticlabs/spz.

mod fixed;
mod inflate;
mod records;
mod unpack;
mod write;

#[cfg(test)]
mod tests;

use std::io::Read;
use std::path::Path;

use flate2::bufread::GzDecoder;
use streamsplat_kernels::harmonics::MAX_DEGREE;

use super::{FormatError, Limits};
use crate::still::{Axes, Still};
use inflate::{gunzip, zstd};
use records::Stated;
pub use write::write;

/// "NGSP"
const MAGIC: [u8; 4] = *b"NGSP";
/// Bytes of the header before version 4, and in version 4.
const OLD_HEADER: usize = 16;
const HEADER: usize = 32;
/// The flag of scenes trained with anti-aliasing.
const ANTIALIASED: u8 = 1;
/// The flag of files with extension records.
const EXTENDED: u8 = 2;
/// Factor from coefficients to colours, which are stored times 255.
const COLOUR: f64 = 0.15;
/// Maximum bytes of extension records that are read from a gzip stream.
const MAX_RECORDS: usize = 1 << 20;
/// The highest degree of harmonics that a file may have.
const MOST_DEGREE: u32 = 4;
/// Bytes of a position in binary16 and in fixed point.
const HALVES: usize = 6;
const FIXED: usize = 9;

/// Header of an SPZ file.
#[derive(Clone, Copy, Debug)]
struct Header {
    version: u32,
    count: usize,
    degree: usize,
    fractional_bits: u32,
    flags: u8,
    /// Bytes per position.
    position: usize,
}

/// The attributes of a file, as bytes.
struct Packed {
    header: Header,
    stated: Stated,
    positions: Vec<u8>,
    alphas: Vec<u8>,
    colours: Vec<u8>,
    scales: Vec<u8>,
    rotations: Vec<u8>,
    harmonics: Vec<u8>,
}

impl Header {
    /// Parses the fields that all versions have, of a file of `size` bytes.
    fn read(bytes: &[u8], versions: [u32; 2], size: usize, limits: &Limits) -> Result<Header, FormatError> {
        let word = |at: usize| bytes[at..].first_chunk().map_or(0, |b| u32::from_le_bytes(*b));
        let wrong = |part: &str, expected: &str, found: u32| {
            Err(FormatError::new(format!("header: {part}"), expected, found.to_string()))
        };
        if bytes[..4] != MAGIC {
            return wrong("first word", "NGSP", word(0));
        }
        let (version, count) = (word(4), word(8));
        let [degree, fractional_bits] = [bytes[12], bytes[13]].map(u32::from);
        let flags = bytes[14];
        if !(versions[0]..=versions[1]).contains(&version) {
            let expected = format!("{} to {} in a file of this kind", versions[0], versions[1]);
            return wrong("version", &expected, version);
        }
        if degree > MOST_DEGREE {
            return wrong("degree of the harmonics", "0 to 4", degree);
        }
        if fractional_bits > 23 {
            return wrong("fractional bits", "0 to 23", fractional_bits);
        }
        if flags & !(ANTIALIASED | EXTENDED) != 0 {
            return wrong("flags", "none but those of anti-aliasing (1) and of extensions (2)", flags.into());
        }
        let position = if version == 1 { HALVES } else { FIXED };
        let header =
            Header { version, count: count as usize, degree: degree as usize, fractional_bits, flags, position };
        // The coefficients of degree 4 are left out.
        limits.check_still("header: points", header.count, header.degree.min(MAX_DEGREE), size as u64)?;
        Ok(header)
    }

    /// Returns the bytes of all attributes.
    fn size(&self) -> usize {
        self.sizes().iter().map(|(_, size)| size).sum()
    }

    /// Returns the bytes of each attribute, in the order in which they are stored.
    fn sizes(&self) -> [(&'static str, usize); 6] {
        let rotation = if self.version < 3 { 3 } else { 4 };
        let harmonics = 3 * streamsplat_kernels::harmonics::rest(self.degree);
        [
            ("positions", self.position),
            ("alphas", 1),
            ("colours", 3),
            ("scales", 3),
            ("rotations", rotation),
            ("harmonics", harmonics),
        ]
        .map(|(name, each)| (name, each * self.count))
    }
}

/// Reads the Gaussians of a whole SPZ file.
///
/// # Errors
/// Returns a [`FormatError`] with the name of the part and the expected and found values.
pub fn read(bytes: &[u8]) -> Result<Still, FormatError> {
    within(bytes, &Limits::default())
}

/// Returns true if a file with this name and these first bytes has the format.
pub(super) fn is(_path: &Path, head: &[u8]) -> bool {
    head.starts_with(&MAGIC) || head.starts_with(&[0x1f, 0x8b])
}

/// Reads a file as [`read`] does, within other limits.
pub(super) fn within(bytes: &[u8], limits: &Limits) -> Result<Still, FormatError> {
    let packed = if bytes.starts_with(&[0x1f, 0x8b]) { old(bytes, limits)? } else { current(bytes, limits)? };
    let mut still = unpack::unpack(&packed);
    still.bring_from(packed.stated.axes.unwrap_or(Axes::RUB));
    let about = &mut still.about;
    about.axes_assumed = packed.stated.axes.is_none();
    about.antialiased = packed.header.flags & ANTIALIASED != 0;
    (about.offset, about.orbit, about.notes) = (packed.stated.offset, packed.stated.orbit, packed.stated.notes);
    if packed.header.degree > streamsplat_kernels::harmonics::MAX_DEGREE {
        about.notes.push(format!("harmonics of degree {} read to degree 3", packed.header.degree));
    }
    Ok(still)
}

/// Returns the number of Gaussians in a file's header, and the degree to which their harmonics are read.
pub(super) fn gaussians(bytes: &[u8]) -> Option<(usize, usize)> {
    let mut head = [0; OLD_HEADER];
    let mut unzipped = GzDecoder::new(bytes);
    let from: &mut dyn Read = if bytes.starts_with(&[0x1f, 0x8b]) { &mut unzipped } else { &mut { bytes } };
    from.read_exact(&mut head).ok()?;
    let count = head[8..].first_chunk().map_or(0, |b| u32::from_le_bytes(*b));
    Some((count as usize, usize::from(head[12]).min(MAX_DEGREE)))
}

/// Reads versions 1 to 3.
fn old(bytes: &[u8], limits: &Limits) -> Result<Packed, FormatError> {
    let mut stated = Stated::default();
    let (mut header, rest) = gunzip(bytes, OLD_HEADER, &mut stated, |head| {
        let header = Header::read(head, [1, 3], bytes.len(), limits)?;
        if head[15] != 0 {
            return Err(FormatError::new("header: reserved byte", "0", head[15].to_string()));
        }
        let more = match header.version {
            _ if header.flags & EXTENDED != 0 => MAX_RECORDS,
            1 => (FIXED - HALVES) * header.count,
            _ => 0,
        };
        Ok((header, header.size(), more))
    })?;
    if header.version == 1 && header.flags & EXTENDED == 0 && rest.len() != header.size() {
        let halves = header.size();
        header.position = FIXED;
        if rest.len() != header.size() {
            let expected = format!("{halves} bytes, or {} with positions in fixed point", header.size());
            return Err(FormatError::new("attributes", expected, rest.len().to_string()));
        }
    }
    let mut rest = rest.as_slice();
    let attributes = header.sizes().map(|(_, size)| {
        // `size` is not more than the rest: the sum was checked.
        let (attribute, after) = rest.split_at(size);
        rest = after;
        attribute.to_vec()
    });
    stated.records(rest)?;
    Ok(Packed::of(header, stated, attributes))
}

/// Reads version 4.
fn current(bytes: &[u8], limits: &Limits) -> Result<Packed, FormatError> {
    let wrong = |part: &str, expected: String, found: String| Err(FormatError::new(part, expected, found));
    if bytes.len() < HEADER {
        return wrong("header", format!("{HEADER} bytes"), bytes.len().to_string());
    }
    let header = Header::read(bytes, [4, 4], bytes.len(), limits)?;
    let table = bytes[16..].first_chunk().map_or(0, |b| u32::from_le_bytes(*b)) as usize;
    let extended = header.flags & EXTENDED != 0;
    if bytes[20..HEADER] != [0; 12] || !extended && table != HEADER {
        return wrong("header: table", "it at byte 32, and zeros between".into(), format!("it at {table}"));
    }
    let Some(records) = bytes.get(HEADER..table) else {
        return wrong(
            "header: table",
            format!("it from byte 32 on, within {} bytes", bytes.len()),
            format!("it at {table}"),
        );
    };
    let mut stated = Stated::default();
    stated.records(records)?;
    let sizes = header.sizes();
    let streams = sizes.iter().filter(|(_, size)| *size > 0).count();
    if usize::from(bytes[15]) != streams {
        return wrong("header: streams", streams.to_string(), bytes[15].to_string());
    }
    let Some((table, mut rest)) = bytes[table..].split_at_checked(16 * streams) else {
        return wrong("table", format!("{streams} entries of 16 bytes"), format!("{} bytes", bytes.len() - table));
    };
    let mut entries = table.chunks_exact(16);
    let mut attributes: [Vec<u8>; 6] = Default::default();
    for ((name, size), attribute) in sizes.into_iter().zip(&mut attributes).filter(|((_, size), _)| *size > 0) {
        // There is an entry for each attribute that is not empty.
        let entry = entries.next().unwrap_or(&[0; 16]);
        let [compressed, whole] = [0, 8].map(|at| entry[at..].first_chunk().map_or(0, |b| u64::from_le_bytes(*b)));
        if whole != size as u64 {
            return wrong(name, format!("{size} bytes"), whole.to_string());
        }
        let compressed = usize::try_from(compressed).unwrap_or(usize::MAX);
        let Some((frame, after)) = rest.split_at_checked(compressed) else {
            return wrong(name, format!("{compressed} bytes in the file"), format!("{} bytes", rest.len()));
        };
        rest = after;
        *attribute = zstd(name, frame, size)?;
    }
    if !rest.is_empty() {
        return wrong("file", "its end after the last stream".into(), format!("{} more bytes", rest.len()));
    }
    Ok(Packed::of(header, stated, attributes))
}

impl Packed {
    fn of(header: Header, stated: Stated, attributes: [Vec<u8>; 6]) -> Packed {
        let [positions, alphas, colours, scales, rotations, harmonics] = attributes;
        Packed { header, stated, positions, alphas, colours, scales, rotations, harmonics }
    }
}
