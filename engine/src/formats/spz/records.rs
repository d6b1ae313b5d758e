//! Metadata of an SPZ file: extension records, and the comment of a gzip stream.
//!
//! A record is a type (u32), the length of the payload (u32), and the payload. Unknown types are skipped by their
//! length.
//!
//! | type | holds |
//! |---|---|
//! | `0xADBE0002` | an orbiting camera's least and greatest elevation in radians, and its least distance: three binary32 |
//! | `0xADBE0003` | the axes of all numbers, u32: 1 LDB, 2 RDB, 3 LUB, 4 RUB, 5 LDF, 6 RDF, 7 LUF, 8 RUF, 9 LFD, 10 RFD, 11 LFU, 12 RFU, 13 LBD, 14 RBD, 15 LBU, 16 RBU |
//! | `0x53530001` | the scene's offset: three binary64 (written by this program) |
//!
//! Other programs do not skip records before version 4. Files of those versions store axes and offset as text in the
//! comment of the gzip stream, which decompressors ignore: `axes RDF` and `offset X Y Z`.

use crate::formats::FormatError;
use crate::still::{About, Axes, Orbit};

const ORBIT: u32 = 0xadbe_0002;
const AXES: u32 = 0xadbe_0003;
const OFFSET: u32 = 0x5353_0001;

/// Metadata of a file.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Stated {
    pub(crate) axes: Option<Axes>,
    pub(crate) offset: [f64; 3],
    pub(crate) orbit: Option<Orbit>,
    /// Notes on records that are left out.
    pub(crate) notes: Vec<String>,
}

impl Stated {
    /// Returns the metadata for a scene of this program, whose numbers are written unchanged.
    pub(crate) fn of(about: &About) -> Stated {
        Stated { axes: Some(Axes::RDF), offset: about.offset, orbit: about.orbit, notes: Vec::new() }
    }

    /// Reads records up to the end of `bytes`.
    pub(super) fn records(&mut self, mut bytes: &[u8]) -> Result<(), FormatError> {
        while !bytes.is_empty() {
            let word = |at: usize| bytes.get(at..at + 4).and_then(|b| b.first_chunk()).map(|b| u32::from_le_bytes(*b));
            let (Some(kind), Some(length)) = (word(0), word(4)) else {
                return Err(FormatError::new(
                    "extension record",
                    "8 bytes of type and length",
                    bytes.len().to_string(),
                ));
            };
            let Some(payload) = bytes[8..].get(..length as usize) else {
                let found = format!("{} bytes", bytes.len() - 8);
                return Err(FormatError::new(
                    format!("extension record {kind:#010x}"),
                    format!("{length} bytes"),
                    found,
                ));
            };
            self.record(kind, payload)?;
            bytes = &bytes[8 + payload.len()..];
        }
        Ok(())
    }

    fn record(&mut self, kind: u32, payload: &[u8]) -> Result<(), FormatError> {
        let wrong = |expected: &str, found: String| {
            Err(FormatError::new(format!("extension record {kind:#010x}"), expected, found))
        };
        match (kind, payload.len()) {
            (AXES, 4) => {
                let code = payload.first_chunk().map_or(0, |b| u32::from_le_bytes(*b));
                match Axes::of_code(code) {
                    Some(axes) => self.axes = Some(axes),
                    // No axes are specified.
                    None if code == 0 => {}
                    None => return wrong("axes from 1 to 16", code.to_string()),
                }
            }
            (ORBIT, 12) => {
                let value = |k: usize| payload[4 * k..].first_chunk().map_or(0.0, |b| f32::from_le_bytes(*b));
                self.orbit = Some(Orbit { elevation: [value(0), value(1)], radius: value(2) });
            }
            (OFFSET, 24) => {
                let value = |k: usize| payload[8 * k..].first_chunk().map_or(0.0, |b| f64::from_le_bytes(*b));
                let offset: [f64; 3] = std::array::from_fn(value);
                if !offset.iter().all(|x| x.is_finite()) {
                    return wrong("finite numbers", format!("{offset:?}"));
                }
                self.offset = offset;
            }
            (AXES | ORBIT | OFFSET, length) => {
                let expected = match kind {
                    AXES => "4 bytes",
                    ORBIT => "12 bytes",
                    _ => "24 bytes",
                };
                return wrong(expected, length.to_string());
            }
            (kind, length) => self.notes.push(format!("extension record {kind:#010x} of {length} bytes left out")),
        }
        Ok(())
    }

    /// Parses the comment of a gzip stream. Unknown words are ignored.
    pub(super) fn comment(&mut self, text: &[u8]) {
        let text = String::from_utf8_lossy(text);
        let words: Vec<&str> = text.split_ascii_whitespace().collect();
        for at in 0..words.len() {
            match (words[at], &words[at + 1..]) {
                ("axes", [name, ..]) => self.axes = name.parse().ok().or(self.axes),
                ("offset", [x, y, z, ..]) => {
                    let numbers: Option<Vec<f64>> = [x, y, z].iter().map(|word| word.parse().ok()).collect();
                    if let Some([x, y, z]) = numbers.as_deref()
                        && [x, y, z].iter().all(|x| x.is_finite())
                    {
                        self.offset = [*x, *y, *z];
                    }
                }
                _ => {}
            }
        }
    }

    /// Formats axes and offset as the comment of a gzip stream.
    pub(crate) fn as_comment(&self) -> String {
        let axes = self.axes.map_or_else(String::new, |axes| format!("axes {axes}"));
        match self.offset {
            [0.0, 0.0, 0.0] => axes,
            [x, y, z] => format!("{axes} offset {x} {y} {z}"),
        }
    }

    /// Formats the metadata as extension records.
    pub(crate) fn as_records(&self) -> Vec<u8> {
        let mut out = Vec::new();
        let mut record = |kind: u32, payload: &[u8]| {
            out.extend_from_slice(&kind.to_le_bytes());
            out.extend_from_slice(&(payload.len() as u32).to_le_bytes());
            out.extend_from_slice(payload);
        };
        if let Some(axes) = self.axes {
            record(AXES, &axes.code().to_le_bytes());
        }
        if let Some(Orbit { elevation: [least, most], radius }) = self.orbit {
            record(ORBIT, [least, most, radius].map(f32::to_le_bytes).as_flattened());
        }
        if self.offset != [0.0; 3] {
            record(OFFSET, self.offset.map(f64::to_le_bytes).as_flattened());
        }
        out
    }
}
