//! The header of a safetensors file.
//!
//! ```text
//! u64 little-endian n │ n bytes of JSON: {name: {dtype, shape, data_offsets: [begin, end]}, …} │ data
//! ```
//!
//! Ranges are relative to the data, in bytes, and cover it without overlap or hole.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt;
use std::ops::Range;

use half::slice::HalfFloatSliceExt;
use half::{bf16, f16};
use serde::de::{self, Deserialize, Deserializer, IgnoredAny, MapAccess, Visitor};

/// Longest header that is read: the limit of the format.
const LONGEST_HEADER: u64 = 100_000_000;

/// Number format of a tensor.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Dtype {
    /// binary32
    F32,
    /// binary16
    F16,
    /// bfloat16
    Bf16,
    /// Another format, which is not read.
    Other(String),
}

impl Dtype {
    /// Its name in the file.
    pub fn name(&self) -> &str {
        match self {
            Dtype::F32 => "F32",
            Dtype::F16 => "F16",
            Dtype::Bf16 => "BF16",
            Dtype::Other(name) => name,
        }
    }

    fn named(name: &str) -> Dtype {
        match name {
            "F32" => Dtype::F32,
            "F16" => Dtype::F16,
            "BF16" => Dtype::Bf16,
            other => Dtype::Other(other.to_owned()),
        }
    }

    /// Bits per element, for supported types.
    pub(super) fn bits(&self) -> Option<usize> {
        Some(match self.name() {
            "F4" => 4,
            "F6_E2M3" | "F6_E3M2" => 6,
            "BOOL" | "U8" | "I8" | "F8_E4M3" | "F8_E5M2" | "F8_E8M0" | "F8_E4M3FNUZ" | "F8_E5M2FNUZ" => 8,
            "I16" | "U16" | "F16" | "BF16" => 16,
            "I32" | "U32" | "F32" => 32,
            "I64" | "U64" | "F64" | "C64" => 64,
            _ => return None,
        })
    }

    /// Little-endian bytes as f32; exact. `None` for formats that are not read.
    pub(crate) fn to_f32<'a>(&self, bytes: &'a [u8]) -> Option<Cow<'a, [f32]>> {
        let pairs = || bytes.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]]));
        match self {
            Dtype::F32 => {
                if cfg!(target_endian = "little")
                    && let Ok(values) = bytemuck::try_cast_slice(bytes)
                {
                    return Some(Cow::Borrowed(values));
                }
                let words = bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
                Some(Cow::Owned(words.collect()))
            }
            Dtype::F16 => {
                let halves: Vec<f16> = pairs().map(f16::from_bits).collect();
                Some(Cow::Owned(halves.to_f32_vec()))
            }
            Dtype::Bf16 => Some(Cow::Owned(pairs().map(|b| bf16::from_bits(b).to_f32()).collect())),
            Dtype::Other(_) => None,
        }
    }
}

/// One tensor of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TensorInfo {
    /// Number format.
    pub dtype: Dtype,
    /// Shape; empty for a scalar.
    pub shape: Vec<usize>,
    /// Its bytes, counted from the end of a safetensors header, or from the start of the file.
    pub range: Range<usize>,
}

impl TensorInfo {
    /// Number of elements.
    pub fn elements(&self) -> usize {
        self.shape.iter().product()
    }
}

/// Returns the offset of the data and all tensors, or an error message.
pub(super) fn parse(bytes: &[u8]) -> Result<(usize, BTreeMap<String, TensorInfo>), String> {
    let not = |what: String| format!("not a safetensors file: {what}");
    let Some((length, rest)) = bytes.split_first_chunk::<8>() else {
        return Err(not(format!("expected at least 8 bytes, found {}", bytes.len())));
    };
    let length = u64::from_le_bytes(*length);
    if length > LONGEST_HEADER {
        return Err(not(format!("expected a header of at most {LONGEST_HEADER} bytes, found {length}")));
    }
    let length = length as usize;
    let Some((header, data)) = rest.split_at_checked(length) else {
        return Err(not(format!("the header should have {length} bytes, the file ends after {}", rest.len())));
    };
    let Header(entries) = serde_json::from_slice(header).map_err(|e| not(format!("header: {e}")))?;

    let mut tensors = BTreeMap::new();
    for (name, raw) in entries {
        let wrong = |what: String| format!("tensor {name}: {what}");
        let dtype = Dtype::named(&raw.dtype);
        let bits = dtype.bits().ok_or_else(|| wrong(format!("unknown number format {}", raw.dtype)))?;
        let size = raw.shape.iter().try_fold(bits, |n, &side| n.checked_mul(side));
        let size = size.ok_or_else(|| wrong(format!("shape {:?} is too large", raw.shape)))?.div_ceil(8);
        let [begin, end] = raw.data_offsets;
        if begin > end || end - begin != size {
            return Err(wrong(format!(
                "shape {:?} of {} takes {size} bytes, found the range {begin}..{end}",
                raw.shape, raw.dtype
            )));
        }
        if end > data.len() {
            return Err(wrong(format!(
                "its bytes end at {end}, the file holds {} bytes of data: it is truncated",
                data.len()
            )));
        }
        tensors.insert(name, TensorInfo { dtype, shape: raw.shape, range: begin..end });
    }

    let mut order: Vec<_> = tensors.iter().collect();
    order.sort_by_key(|(_, t)| (t.range.start, t.range.end));
    let mut covered = 0;
    for (name, tensor) in order {
        if tensor.range.start != covered {
            let what = if tensor.range.start < covered { "overlaps another tensor" } else { "follows unused bytes" };
            return Err(format!(
                "tensor {name} {what}: expected it to start at {covered}, found {}",
                tensor.range.start
            ));
        }
        covered = tensor.range.end;
    }
    if covered != data.len() {
        return Err(format!("the tensors take {covered} bytes of data, the file holds {}", data.len()));
    }
    Ok((8 + length, tensors))
}

#[derive(serde::Deserialize)]
struct RawTensor {
    dtype: String,
    shape: Vec<usize>,
    data_offsets: [usize; 2],
}

/// The entries in file order: a map type would let the last of two equal names win.
struct Header(Vec<(String, RawTensor)>);

impl<'de> Deserialize<'de> for Header {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Entries;
        impl<'de> Visitor<'de> for Entries {
            type Value = Header;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an object of tensors")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Header, A::Error> {
                let (mut entries, mut names) = (Vec::new(), std::collections::BTreeSet::new());
                while let Some(name) = map.next_key::<String>()? {
                    if !names.insert(name.clone()) {
                        return Err(de::Error::custom(format!("{name} occurs twice")));
                    }
                    if name == "__metadata__" {
                        map.next_value::<IgnoredAny>()?;
                    } else {
                        entries.push((name, map.next_value()?));
                    }
                }
                Ok(Header(entries))
            }
        }
        deserializer.deserialize_map(Entries)
    }
}
