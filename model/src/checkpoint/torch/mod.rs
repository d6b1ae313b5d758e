//! Files of `torch.save`: a zip archive with a pickle and the bytes of each storage.
//!
//! ```text
//! NAME/data.pkl      a pickle: tensors by name, each a view of a storage (offset, size, stride)
//! NAME/data/0 …      a storage's elements, stored without compression
//! NAME/byteorder     "little" or "big"; little where it is missing
//! ```
//!
//! [`pickle`] reads only tensors: it imports nothing and calls nothing. Tensors must be dense and row-major; they are
//! read from the mapped file in place.
//!
//! Source: PyTorch, `torch/serialization.py`, "Serialization semantics".

mod pickle;

use std::collections::BTreeMap;
use std::io::Cursor;
use std::ops::Range;

use zip::read::{ArchiveOffset, Config};
use zip::{CompressionMethod, ZipArchive};

use super::header::{Dtype, TensorInfo};
use pickle::{Pickle, Stored};

/// First bytes of a zip archive.
const ZIP: &[u8] = b"PK\x03\x04";
/// First bytes of files of `torch.save` before version 1.6 of PyTorch: a pickle of a magic number.
const LEGACY: &[u8] = b"\x80\x02\x8a\x0al\xfc\x9c\x46\xf9\x20\x6a\xa8\x50\x19\x2e";
/// Longest pickle that is read, in bytes: names and shapes of some hundred thousand tensors.
const LONGEST: usize = 16 << 20;
/// Largest number of files of an archive.
const MOST_ENTRIES: usize = 1 << 17;

/// Returns true if the bytes begin like a file of any version of `torch.save`.
pub(super) fn is_torch(bytes: &[u8]) -> bool {
    bytes.starts_with(ZIP)
        || bytes.starts_with(LEGACY)
        || bytes.starts_with(b"\x80\x02")
        || bytes.starts_with(b"\x80\x04")
}

/// Returns true if the first bytes of a file are those of a zip archive whose first entry is the pickle of
/// `torch.save`.
pub fn is_archive(head: &[u8]) -> bool {
    // Local header: 26 bytes, lengths of the name and of the extra field, the name.
    let name = head.get(26..28).map(|length| usize::from(u16::from_le_bytes([length[0], length[1]])));
    head.starts_with(ZIP)
        && name.and_then(|length| head.get(30..30 + length)).is_some_and(|name| name.ends_with(b"data.pkl"))
}

/// Returns all tensors, with ranges counted from the file's start, or an error message.
pub(super) fn parse(bytes: &[u8]) -> Result<BTreeMap<String, TensorInfo>, String> {
    if bytes.starts_with(LEGACY) {
        return Err("written by torch.save in the form of PyTorch before 1.6: expected a zip archive; load it in PyTorch and save it again".to_owned());
    }
    if !bytes.starts_with(ZIP) {
        return Err("a plain pickle: expected a zip archive, as torch.save writes, or safetensors".to_owned());
    }
    // The archive begins at the start of the file. If the crate searched for the start, it would skip a first entry
    // with a name of 30 bytes: such an entry of the directory takes 76 bytes, as many as the two records of 64 bits
    // behind the directory.
    let config = Config { archive_offset: ArchiveOffset::Known(0) };
    let mut archive = ZipArchive::with_config(config, Cursor::new(bytes))
        .map_err(|e| format!("not a whole zip archive, as torch.save writes: {e}"))?;
    if archive.len() > MOST_ENTRIES {
        return Err(format!("expected at most {MOST_ENTRIES} files in the archive, found {}", archive.len()));
    }
    let mut entries = BTreeMap::new();
    let mut folder = None;
    for i in 0..archive.len() {
        let entry = archive.by_index_raw(i).map_err(|e| format!("file {i} of the archive: {e}"))?;
        let name = entry.name().map_err(|e| format!("file {i} of the archive: {e}"))?.into_owned();
        // torch.save compresses no storage: a reference to a compressed entry is reported as missing.
        if entry.compression() != CompressionMethod::Stored {
            continue;
        }
        let start = entry.data_start().ok_or_else(|| format!("{name}: the archive does not tell where it begins"))?;
        let range = range(start, entry.size(), bytes.len())
            .ok_or_else(|| format!("{name}: its {} bytes from {start} on end beyond the file", entry.size()))?;
        if let Some(parent) = name.strip_suffix("data.pkl")
            && (parent.is_empty() || parent.ends_with('/'))
            && folder.replace(parent.to_owned()).is_some()
        {
            return Err("expected one data.pkl in the archive, found several".to_owned());
        }
        entries.insert(name, range);
    }
    let folder = folder.ok_or("a zip archive without data.pkl: expected one that torch.save wrote")?;
    if entries.contains_key(&format!("{folder}constants.pkl")) {
        return Err("a TorchScript archive: expected the weights alone, as torch.save writes them".to_owned());
    }
    if let Some(order) = entries.get(&format!("{folder}byteorder"))
        && &bytes[order.clone()] != b"little"
    {
        return Err(format!(
            "byteorder: expected little, found {}",
            String::from_utf8_lossy(&bytes[order.clone()]).escape_debug()
        ));
    }
    let text = &bytes[entries[&format!("{folder}data.pkl")].clone()];
    if text.len() > LONGEST {
        return Err(format!("data.pkl: expected at most {LONGEST} bytes, found {}", text.len()));
    }
    let stored = Pickle::read(text).map_err(|e| format!("data.pkl: {e}"))?;
    let mut tensors = BTreeMap::new();
    for (name, tensor) in stored {
        let info = info(&tensor, &format!("{folder}data/{}", tensor.storage), &entries)
            .map_err(|e| format!("tensor {name}: {e}"))?;
        tensors.insert(name, info);
    }
    Ok(tensors)
}

/// Returns the range `start` to `start + length`, if a file of `end` bytes holds it.
fn range(start: u64, length: u64, end: usize) -> Option<Range<usize>> {
    let start = usize::try_from(start).ok()?;
    let stop = start.checked_add(usize::try_from(length).ok()?)?;
    (stop <= end).then_some(start..stop)
}

/// A tensor's place in the file.
fn info(tensor: &Stored, storage: &str, entries: &BTreeMap<String, Range<usize>>) -> Result<TensorInfo, String> {
    let Stored { dtype, offset, shape, stride, .. } = tensor;
    let bytes = entries
        .get(storage)
        .ok_or_else(|| format!("expected its elements in {storage}, which the archive does not hold (uncompressed)"))?;
    let mut dense = 1usize;
    for (axis, (&side, &step)) in shape.iter().zip(stride).enumerate().rev() {
        if side > 1 && step != dense {
            return Err(format!(
                "expected dense rows, found a step of {step} in place of {dense} along axis {axis} (a transposed view?)"
            ));
        }
        dense = dense.checked_mul(side.max(1)).ok_or_else(|| format!("shape {shape:?} is too large"))?;
    }
    let elements = if shape.contains(&0) { 0 } else { dense };
    let size = dtype
        .bits()
        .map(|bits| bits.div_ceil(8))
        .ok_or_else(|| format!("number format {} is not read", dtype.name()))?;
    let place = |count: usize| count.checked_mul(size).filter(|bytes| *bytes <= isize::MAX as usize);
    let (begin, length) = place(*offset).zip(place(elements)).ok_or_else(|| format!("shape {shape:?} is too large"))?;
    match begin.checked_add(length) {
        Some(end) if end <= bytes.len() => {
            let start = bytes.start + begin;
            Ok(TensorInfo { dtype: dtype.clone(), shape: shape.clone(), range: start..start + length })
        }
        _ => Err(format!(
            "shape {shape:?} of {} takes {length} bytes from {begin} on, {storage} holds {}",
            dtype.name(),
            bytes.len()
        )),
    }
}

/// The number format of a storage class of PyTorch.
fn dtype(class: &str) -> Option<Dtype> {
    Some(match class {
        "FloatStorage" => Dtype::F32,
        "HalfStorage" => Dtype::F16,
        "BFloat16Storage" => Dtype::Bf16,
        "DoubleStorage" => Dtype::Other("F64".to_owned()),
        "LongStorage" => Dtype::Other("I64".to_owned()),
        "IntStorage" => Dtype::Other("I32".to_owned()),
        "ShortStorage" => Dtype::Other("I16".to_owned()),
        "CharStorage" => Dtype::Other("I8".to_owned()),
        "ByteStorage" => Dtype::Other("U8".to_owned()),
        "BoolStorage" => Dtype::Other("BOOL".to_owned()),
        "ComplexFloatStorage" => Dtype::Other("C64".to_owned()),
        _ => return None,
    })
}

#[cfg(test)]
mod tests;
