//! Elements and properties that a PLY file declares.

use std::ops::Range;

use crate::formats::FormatError;

/// Longest header read, in bytes.
pub(crate) const MAX_HEADER: usize = 1 << 22;
/// Maximum number of properties of an element.
const MAX_PROPERTIES: usize = 1 << 12;
/// Maximum number of bytes after the last element that are skipped: line ends and zeros.
const MAX_AFTER: u64 = 16;

/// The encoding of numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::formats) enum Encoding {
    Text,
    Little,
    Big,
}

/// A scalar type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::formats) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F16,
    F32,
    F64,
}

impl Scalar {
    fn named(name: &str) -> Option<Scalar> {
        Some(match name {
            "char" | "int8" => Scalar::I8,
            "uchar" | "uint8" => Scalar::U8,
            "short" | "int16" => Scalar::I16,
            "ushort" | "uint16" => Scalar::U16,
            "int" | "int32" => Scalar::I32,
            "uint" | "uint32" => Scalar::U32,
            "half" | "float16" => Scalar::F16,
            "float" | "float32" => Scalar::F32,
            "double" | "float64" => Scalar::F64,
            _ => return None,
        })
    }

    /// Returns the bytes per value.
    pub(in crate::formats) fn bytes(self) -> usize {
        match self {
            Scalar::I8 | Scalar::U8 => 1,
            Scalar::I16 | Scalar::U16 | Scalar::F16 => 2,
            Scalar::I32 | Scalar::U32 | Scalar::F32 => 4,
            Scalar::F64 => 8,
        }
    }

    /// Returns true for floating-point numbers.
    pub(in crate::formats) fn is_float(self) -> bool {
        matches!(self, Scalar::F16 | Scalar::F32 | Scalar::F64)
    }

    /// Returns the number that means 1 in a colour of this type.
    pub(in crate::formats) fn one(self) -> f64 {
        match self {
            Scalar::U8 => 255.0,
            Scalar::U16 => 65535.0,
            _ => 1.0,
        }
    }

    /// Reads the value at the beginning of `bytes`, which has at least [`Scalar::bytes`] bytes.
    pub(in crate::formats) fn read(self, bytes: &[u8], big: bool) -> f64 {
        macro_rules! number {
            ($kind:ty) => {{
                let bytes = bytes.first_chunk().copied().unwrap_or_default();
                f64::from(if big { <$kind>::from_be_bytes(bytes) } else { <$kind>::from_le_bytes(bytes) })
            }};
        }
        match self {
            Scalar::I8 => number!(i8),
            Scalar::U8 => number!(u8),
            Scalar::I16 => number!(i16),
            Scalar::U16 => number!(u16),
            Scalar::I32 => number!(i32),
            Scalar::U32 => number!(u32),
            Scalar::F16 => number!(half::f16),
            Scalar::F32 => number!(f32),
            Scalar::F64 => number!(f64),
        }
    }

    /// Reads a value as [`Scalar::read`] does, in binary32; the bits of a binary32 value are unchanged.
    pub(in crate::formats) fn read_single(self, bytes: &[u8], big: bool) -> f32 {
        match (self, bytes.first_chunk()) {
            (Scalar::F32, Some(bytes)) if big => f32::from_be_bytes(*bytes),
            (Scalar::F32, Some(bytes)) => f32::from_le_bytes(*bytes),
            _ => self.read(bytes, big) as f32,
        }
    }
}

/// A property of an element.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in crate::formats) struct Property {
    pub(in crate::formats) name: String,
    pub(in crate::formats) scalar: Scalar,
    /// Byte offset in the record.
    pub(in crate::formats) start: usize,
}

/// Records of equal properties.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in crate::formats) struct Element {
    pub(in crate::formats) name: String,
    pub(in crate::formats) count: usize,
    pub(in crate::formats) properties: Vec<Property>,
}

impl Element {
    /// Returns the property of this name, and its index.
    pub(in crate::formats) fn property(&self, name: &str) -> Option<(usize, &Property)> {
        self.properties.iter().enumerate().find(|(_, property)| property.name == name)
    }

    /// Returns the bytes per record.
    pub(in crate::formats) fn stride(&self) -> usize {
        self.properties.last().map_or(0, |last| last.start + last.scalar.bytes())
    }

    /// Returns an error that names the element.
    pub(in crate::formats) fn wrong(&self, expected: impl Into<String>, found: impl Into<String>) -> FormatError {
        FormatError::new(format!("element {}", self.name), expected, found)
    }
}

/// The header of a file.
#[derive(Debug)]
pub(in crate::formats) struct Header {
    pub(in crate::formats) encoding: Encoding,
    pub(in crate::formats) elements: Vec<Element>,
    /// Text after `comment` and `obj_info`.
    pub(in crate::formats) comments: Vec<String>,
}

impl Header {
    /// Parses the header of a file; returns it and the bytes after it.
    pub(in crate::formats) fn read(bytes: &[u8]) -> Result<(Header, &[u8]), FormatError> {
        let mut lines = Lines { rest: &bytes[..bytes.len().min(MAX_HEADER)], read: 0 };
        let first = lines.next()?;
        if first != b"ply" {
            return Err(FormatError::new("first line", "ply", quoted(&String::from_utf8_lossy(first))));
        }
        let (mut encoding, mut comments) = (None, Vec::new());
        let mut elements: Vec<Element> = Vec::new();
        loop {
            let line = lines.next()?;
            // Comments may have any encoding.
            let comment = [&b"comment"[..], b"obj_info"].iter().find_map(|key| line.strip_prefix(*key));
            if let Some(text) = comment.filter(|text| text.first().is_none_or(u8::is_ascii_whitespace)) {
                comments.push(String::from_utf8_lossy(text).trim().to_owned());
                continue;
            }
            let line = std::str::from_utf8(line)
                .map_err(|_| FormatError::new("header", "text", quoted(&String::from_utf8_lossy(line))))?;
            let words: Vec<&str> = line.split_ascii_whitespace().collect();
            match (&words[..], elements.last_mut()) {
                (["end_header"], _) => break,
                (["format", name, version], _) if encoding.is_none() => encoding = Some(format(name, version)?),
                (["element", name, count], _) => elements.push(element(name, count, &elements)?),
                // Without records, lists take no bytes.
                (["property", "list", ..], Some(element)) if element.count == 0 => {}
                (["property", "list", .., name], Some(element)) => {
                    let part = format!("element {}: property {name}", element.name);
                    return Err(FormatError::new(part, "a number", "a list"));
                }
                (["property", kind, name], Some(element)) => {
                    let wrong = |expected, found| Err(FormatError::new(format!("property {name}"), expected, found));
                    let Some(scalar) = Scalar::named(kind) else {
                        return wrong("a scalar type", quoted(kind));
                    };
                    if element.properties.len() == MAX_PROPERTIES {
                        let expected = format!("at most {MAX_PROPERTIES} properties of an element");
                        return Err(element.wrong(expected, "more"));
                    }
                    if element.property(name).is_some() {
                        return wrong("it once", "it twice".into());
                    }
                    let start = element.stride();
                    element.properties.push(Property { name: (*name).to_owned(), scalar, start });
                }
                _ => {
                    let expected = "format, then elements with their properties, then end_header";
                    return Err(FormatError::new("header", expected, quoted(line)));
                }
            }
        }
        let encoding = encoding.ok_or_else(|| FormatError::new("format", "a line before end_header", "none"))?;
        let header = Header { encoding, elements, comments };
        header.vertices()?;
        Ok((header, &bytes[lines.read..]))
    }

    /// Returns the element that holds the Gaussians.
    pub(in crate::formats) fn vertices(&self) -> Result<&Element, FormatError> {
        let missing = || FormatError::new("element vertex", "a line before end_header", "none");
        self.element("vertex").ok_or_else(missing)
    }

    /// Returns the element of this name.
    pub(in crate::formats) fn element(&self, name: &str) -> Option<&Element> {
        self.elements.iter().find(|element| element.name == name)
    }

    /// Returns the bytes of an element in a binary file whose length agrees with the header.
    pub(in crate::formats) fn bytes<'a>(&self, name: &str, body: &'a [u8]) -> Result<&'a [u8], FormatError> {
        let (place, after) = self.place(name, body.len() as u64)?;
        check_after(&body[body.len() - after..])?;
        Ok(&body[place.start as usize..place.end as usize])
    }

    /// Returns the byte range of an element after the header, in a file with `length` bytes after it, and the number of
    /// bytes after the last element, for [`check_after`].
    pub(in crate::formats) fn place(&self, name: &str, length: u64) -> Result<(Range<u64>, usize), FormatError> {
        let (mut at, mut found) = (0_u64, 0..0);
        for element in &self.elements {
            let size = (element.count as u64).checked_mul(element.stride() as u64);
            let Some(end) = size.and_then(|size| at.checked_add(size)).filter(|end| *end <= length) else {
                let expected = format!("{} of {} bytes each", element.count, element.stride());
                return Err(element.wrong(expected, format!("{} bytes", length - at)));
            };
            if element.name == name {
                found = at..end;
            }
            at = end;
        }
        if length - at > MAX_AFTER {
            return Err(more(length - at));
        }
        Ok((found, (length - at) as usize))
    }
}

fn more(count: u64) -> FormatError {
    FormatError::new("file", "its end after the last element", format!("{count} more bytes"))
}

/// Returns an error if the bytes after the last element are not line ends or zeros, which editors and copying append.
pub(in crate::formats) fn check_after(bytes: &[u8]) -> Result<(), FormatError> {
    let blank = bytes.iter().all(|b| matches!(b, b'\n' | b'\r' | b' ' | 0));
    if blank { Ok(()) } else { Err(more(bytes.len() as u64)) }
}

fn element(name: &str, count: &str, before: &[Element]) -> Result<Element, FormatError> {
    let wrong = |expected, found| Err(FormatError::new(format!("element {name}"), expected, found));
    if before.iter().any(|element| element.name == name) {
        return wrong("it once", "it twice".into());
    }
    match count.parse() {
        Ok(count) => Ok(Element { name: name.to_owned(), count, properties: Vec::new() }),
        Err(_) => wrong("how many there are", quoted(count)),
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

/// Lines of a header; they end with a line feed or with carriage return and line feed.
struct Lines<'a> {
    rest: &'a [u8],
    read: usize,
}

impl<'a> Lines<'a> {
    fn next(&mut self) -> Result<&'a [u8], FormatError> {
        let end = self.rest.iter().position(|b| *b == b'\n').ok_or_else(|| {
            let expected = format!("end_header within the first {MAX_HEADER} bytes");
            FormatError::new("header", expected, "none")
        })?;
        let (line, rest) = (&self.rest[..end], &self.rest[end + 1..]);
        (self.rest, self.read) = (rest, self.read + end + 1);
        Ok(line.strip_suffix(b"\r").unwrap_or(line))
    }
}

/// Quotes text for a message of one line.
pub(in crate::formats) fn quoted(text: &str) -> String {
    let short: String = text.chars().take(40).collect();
    format!("{short:?}")
}
