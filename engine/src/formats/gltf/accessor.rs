//! Reads numbers from a glTF document's buffers.

use std::borrow::Cow;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

use super::json::Document;
use crate::formats::{Beside, FormatError};

/// The buffers of a document, read on demand.
pub(super) struct Buffers<'a> {
    document: &'a Document,
    read: Vec<Option<Cow<'a, [u8]>>>,
    binary: Option<&'a [u8]>,
    beside: &'a Beside,
}

/// Types of an accessor's components.
#[derive(Clone, Copy)]
enum Component {
    I8,
    U8,
    I16,
    U16,
    F32,
}

impl Component {
    fn numbered(number: u32) -> Option<Component> {
        Some(match number {
            5120 => Component::I8,
            5121 => Component::U8,
            5122 => Component::I16,
            5123 => Component::U16,
            5126 => Component::F32,
            _ => return None,
        })
    }

    fn bytes(self) -> usize {
        match self {
            Component::I8 | Component::U8 => 1,
            Component::I16 | Component::U16 => 2,
            Component::F32 => 4,
        }
    }

    /// Reads the value of these bytes. A normalised value is divided by its type's largest value and is at least −1.
    fn read(self, bytes: &[u8], normalized: bool) -> f64 {
        macro_rules! number {
            ($kind:ty) => {
                f64::from(<$kind>::from_le_bytes(bytes.first_chunk().copied().unwrap_or_default()))
            };
        }
        let (value, most) = match self {
            Component::I8 => (number!(i8), 127.0),
            Component::U8 => (number!(u8), 255.0),
            Component::I16 => (number!(i16), 32767.0),
            Component::U16 => (number!(u16), 65535.0),
            Component::F32 => return number!(f32),
        };
        if normalized { (value / most).max(-1.0) } else { value }
    }
}

impl<'a> Buffers<'a> {
    pub(super) fn new(document: &'a Document, binary: Option<&'a [u8]>, beside: &'a Beside) -> Self {
        Self { document, read: document.buffers.iter().map(|_| None).collect(), binary, beside }
    }

    /// Returns the total size of a document of `own` bytes and of the files that its buffers name.
    pub(super) fn size(&self, own: u64) -> u64 {
        let names = self.document.buffers.iter().filter_map(|buffer| buffer.uri.as_deref());
        let names: Vec<Cow<'_, str>> = names.filter(|name| !name.starts_with("data:")).map(decoded).collect();
        self.beside.size(own, names.iter().map(Cow::as_ref))
    }

    /// Returns the number of elements of an accessor.
    pub(super) fn count(&self, accessor: usize) -> Result<usize, FormatError> {
        self.accessor(accessor).map(|accessor| accessor.count)
    }

    /// Returns the shape of an accessor's elements.
    fn shape(&self, accessor: usize) -> Result<&'a str, FormatError> {
        self.accessor(accessor).map(|accessor| accessor.shape.as_str())
    }

    fn accessor(&self, index: usize) -> Result<&'a super::json::Accessor, FormatError> {
        let all = &self.document.accessors;
        all.get(index).ok_or_else(|| missing(&format!("accessor {index}"), "accessors", all.len()))
    }

    /// Reads an accessor of `count` elements of N components.
    pub(super) fn read<const N: usize>(&mut self, index: usize, count: usize) -> Result<Vec<[f64; N]>, FormatError> {
        let part = || format!("accessor {index}");
        let wrong = |expected: String, found: String| Err(FormatError::new(part(), expected, found));
        let accessor = self.accessor(index)?;
        let shape = ["SCALAR", "VEC2", "VEC3", "VEC4"][N - 1];
        if accessor.shape != shape || accessor.count != count {
            return wrong(format!("{count} of {shape}"), format!("{} of {}", accessor.count, accessor.shape));
        }
        let Some(component) = Component::numbered(accessor.component_type) else {
            let expected = "componentType 5120, 5121, 5122, 5123 or 5126";
            return wrong(expected.into(), accessor.component_type.to_string());
        };
        let view = accessor.buffer_view.filter(|_| accessor.sparse.is_none());
        let Some(view) = view else {
            return wrong("a bufferView, and none of its elements sparse".into(), "another".into());
        };
        let size = N * component.bytes();
        let stride = self.document.buffer_views.get(view).and_then(|view| view.byte_stride).unwrap_or(size);
        let bytes = self.view(view)?;
        // The last element has no padding up to the stride.
        let end = count.checked_sub(1).map_or(Some(0), |last| last.checked_mul(stride)?.checked_add(size));
        let end = end.and_then(|end| end.checked_add(accessor.byte_offset));
        if stride < size || end.is_none_or(|end| end > bytes.len()) {
            return wrong(
                format!("{count} elements, each {stride} bytes after the one before"),
                format!("{} bytes", bytes.len()),
            );
        }
        let value = |i: usize, k: usize| {
            component.read(&bytes[accessor.byte_offset + i * stride + k * component.bytes()..], accessor.normalized)
        };
        Ok((0..count).map(|i| std::array::from_fn(|k| value(i, k))).collect())
    }

    /// Reads colours of three or four components; a missing alpha is 1.
    pub(super) fn colours(&mut self, index: usize, count: usize) -> Result<Vec<[f64; 4]>, FormatError> {
        if self.shape(index)? == "VEC4" {
            return self.read::<4>(index, count);
        }
        Ok(self.read::<3>(index, count)?.into_iter().map(|[r, g, b]| [r, g, b, 1.0]).collect())
    }

    /// Returns the bytes of a buffer view.
    pub(super) fn view(&mut self, index: usize) -> Result<Cow<'_, [u8]>, FormatError> {
        let all = &self.document.buffer_views;
        let part = || format!("bufferView {index}");
        let view = all.get(index).ok_or_else(|| missing(&part(), "bufferViews", all.len()))?;
        if let Some((name, _)) = view.extensions.first_key_value() {
            return Err(FormatError::new(part(), "no extensions", format!("{name:?}")));
        }
        let bytes = self.buffer(view.buffer)?;
        let end = view.byte_offset.checked_add(view.byte_length);
        match end.and_then(|end| bytes.get(view.byte_offset..end)) {
            Some(bytes) => Ok(Cow::Borrowed(bytes)),
            None => {
                let expected = format!("{} bytes from byte {}", view.byte_length, view.byte_offset);
                Err(FormatError::new(part(), expected, format!("{} bytes", bytes.len())))
            }
        }
    }

    fn buffer(&mut self, index: usize) -> Result<&[u8], FormatError> {
        let all = &self.document.buffers;
        let part = || format!("buffer {index}");
        let buffer = all.get(index).ok_or_else(|| missing(&part(), "buffers", all.len()))?;
        // Buffers that name the same file share its bytes.
        let index = all.iter().position(|other| other.uri.is_some() && other.uri == buffer.uri).unwrap_or(index);
        if self.read[index].is_none() {
            let wrong = |expected: String, found: String| FormatError::new(part(), expected, found);
            let bytes = match (&buffer.uri, self.binary) {
                (None, Some(binary)) if index == 0 => Cow::Borrowed(binary),
                (None, _) => return Err(wrong("a uri, or a binary chunk".into(), "neither".into())),
                (Some(uri), _) => match uri.strip_prefix("data:").and_then(|uri| uri.split_once(";base64,")) {
                    Some((_, text)) => {
                        let bytes = STANDARD.decode(text).map_err(|e| wrong("base64".into(), e.to_string()))?;
                        Cow::Owned(bytes)
                    }
                    None => Cow::Owned(self.beside.read(&decoded(uri), buffer.byte_length as u64)?),
                },
            };
            if bytes.len() < buffer.byte_length {
                return Err(wrong(format!("{} bytes", buffer.byte_length), bytes.len().to_string()));
            }
            self.read[index] = Some(bytes);
        }
        Ok(self.read[index].as_deref().unwrap_or_default())
    }
}

/// Decodes the percent-encoded bytes of a relative reference; unchanged if the result is not UTF-8.
fn decoded(uri: &str) -> Cow<'_, str> {
    let (bytes, mut out, mut at) = (uri.as_bytes(), Vec::with_capacity(uri.len()), 0);
    while let Some(&byte) = bytes.get(at) {
        let code = uri.get(at + 1..at + 3).filter(|_| byte == b'%').and_then(|code| u8::from_str_radix(code, 16).ok());
        out.push(code.unwrap_or(byte));
        at += if code.is_some() { 3 } else { 1 };
    }
    String::from_utf8(out).map_or(Cow::Borrowed(uri), Cow::Owned)
}

fn missing(part: &str, what: &str, count: usize) -> FormatError {
    FormatError::new(part, format!("one of {count} {what}"), "none of this number")
}
