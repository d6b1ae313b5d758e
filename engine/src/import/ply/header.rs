//! What a PLY file says of itself.

use crate::import::FormatError;

/// Longest header read, in bytes.
const MAX_HEADER: usize = 1 << 16;

/// How numbers are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Encoding {
    Text,
    Little,
    Big,
}

/// A scalar type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Float,
    Double,
    /// An integer of so many bytes: skipped.
    Whole(usize),
}

impl Kind {
    fn named(name: &str) -> Option<Kind> {
        Some(match name {
            "float" | "float32" => Kind::Float,
            "double" | "float64" => Kind::Double,
            "char" | "uchar" | "int8" | "uint8" => Kind::Whole(1),
            "short" | "ushort" | "int16" | "uint16" => Kind::Whole(2),
            "int" | "uint" | "int32" | "uint32" => Kind::Whole(4),
            _ => return None,
        })
    }

    /// Bytes of one value.
    pub(super) fn bytes(self) -> usize {
        match self {
            Kind::Float => 4,
            Kind::Double => 8,
            Kind::Whole(bytes) => bytes,
        }
    }
}

/// A property of a vertex.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Property {
    pub(super) name: String,
    pub(super) kind: Kind,
}

/// The header of a file of Gaussians.
#[derive(Debug)]
pub(super) struct Header {
    pub(super) encoding: Encoding,
    pub(super) count: usize,
    pub(super) properties: Vec<Property>,
    /// Degree of the harmonics.
    pub(super) degree: usize,
    /// Of each wanted value its place among the properties: x y z, f_dc, opacity, scale, rot, f_rest.
    pub(super) places: Vec<usize>,
}

/// What every file has.
const WANTED: [&str; 14] = [
    "x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2",
    "rot_3",
];

impl Header {
    /// The header of a file, and what comes after it.
    pub(super) fn read(bytes: &[u8]) -> Result<(Header, &[u8]), FormatError> {
        let mut lines = Lines { rest: &bytes[..bytes.len().min(MAX_HEADER)], read: 0 };
        let first = lines.next()?;
        if first != "ply" {
            return Err(FormatError::new("first line", "ply", quoted(first)));
        }
        let mut encoding = None;
        let mut element = None;
        let mut properties: Vec<Property> = Vec::new();
        loop {
            let line = lines.next()?;
            let words: Vec<&str> = line.split_ascii_whitespace().collect();
            match words[..] {
                ["end_header"] => break,
                ["comment" | "obj_info", ..] => {}
                ["format", name, version] if encoding.is_none() => encoding = Some(format(name, version)?),
                ["element", "vertex", count] if element.is_none() => {
                    let read = count
                        .parse::<usize>()
                        .map_err(|_| FormatError::new("element vertex", "a number of vertices", quoted(count)))?;
                    element = Some(read);
                }
                ["element", name, ..] => {
                    return Err(FormatError::new(format!("element {name}"), "one element, vertex", "another"));
                }
                ["property", "list", .., name] => {
                    return Err(FormatError::new(format!("property {name}"), "a number", "a list"));
                }
                ["property", kind, name] if element.is_some() => {
                    let kind = Kind::named(kind)
                        .ok_or_else(|| FormatError::new(format!("property {name}"), "a scalar type", quoted(kind)))?;
                    properties.push(Property { name: name.to_owned(), kind });
                }
                _ => {
                    let expected = "format, then element vertex, then its properties, then end_header";
                    return Err(FormatError::new("header", expected, quoted(line)));
                }
            }
        }
        let encoding = encoding.ok_or_else(|| FormatError::new("format", "a line before end_header", "none"))?;
        let count = element.ok_or_else(|| FormatError::new("element vertex", "a line before end_header", "none"))?;
        let (degree, places) = places(&properties)?;
        Ok((Header { encoding, count, properties, degree, places }, &bytes[lines.read..]))
    }
}

fn format(name: &str, version: &str) -> Result<Encoding, FormatError> {
    let encoding = match name {
        "ascii" => Encoding::Text,
        "binary_little_endian" => Encoding::Little,
        "binary_big_endian" => Encoding::Big,
        other => {
            let expected = "ascii, binary_little_endian or binary_big_endian";
            return Err(FormatError::new("format", expected, quoted(other)));
        }
    };
    if version != "1.0" {
        return Err(FormatError::new("format", "version 1.0", quoted(version)));
    }
    Ok(encoding)
}

/// Degree of the harmonics, and where the wanted values are.
fn places(properties: &[Property]) -> Result<(usize, Vec<usize>), FormatError> {
    for (i, property) in properties.iter().enumerate() {
        if properties[..i].iter().any(|before| before.name == property.name) {
            return Err(FormatError::new(format!("property {}", property.name), "it once", "it twice"));
        }
    }
    let rest = properties.iter().filter(|p| p.name.starts_with("f_rest_")).count();
    let degree = [0, 9, 24, 45]
        .iter()
        .position(|n| *n == rest)
        .ok_or_else(|| FormatError::new("properties f_rest_*", "none, 9, 24 or 45 of them", rest.to_string()))?;
    let others = (0..rest).map(|i| format!("f_rest_{i}"));
    let places = WANTED.iter().map(|name| (*name).to_owned()).chain(others).map(|name| {
        let wrong = |found: &str| FormatError::new(format!("property {name}"), "it as float or double", found);
        let place = properties.iter().position(|p| p.name == name).ok_or_else(|| wrong("none"))?;
        match properties[place].kind {
            Kind::Whole(_) => Err(wrong("whole numbers")),
            Kind::Float | Kind::Double => Ok(place),
        }
    });
    Ok((degree, places.collect::<Result<_, _>>()?))
}

/// Lines of a header; they end with a line feed, before which a carriage return may stand.
struct Lines<'a> {
    rest: &'a [u8],
    read: usize,
}

impl<'a> Lines<'a> {
    fn next(&mut self) -> Result<&'a str, FormatError> {
        let end = self.rest.iter().position(|b| *b == b'\n').ok_or_else(|| {
            let expected = format!("end_header within the first {MAX_HEADER} bytes");
            FormatError::new("header", expected, "none")
        })?;
        let (line, rest) = (&self.rest[..end], &self.rest[end + 1..]);
        (self.rest, self.read) = (rest, self.read + end + 1);
        let line = line.strip_suffix(b"\r").unwrap_or(line);
        std::str::from_utf8(line).map_err(|_| FormatError::new("header", "text", "bytes that are none"))
    }
}

/// Text as it can be shown in a message of one line.
pub(super) fn quoted(text: &str) -> String {
    let short: String = text.chars().take(40).collect();
    format!("{short:?}")
}
