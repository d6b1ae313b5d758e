//! Check that a shared library in ELF form is complete.
//!
//! The system's loader maps the segments that a library's header declares. If the file ends before them, the first
//! access kills the process without an error.

use std::io::{self, Read, Seek, SeekFrom};

/// Bytes of the header of a 64-bit file; `ENTRY`: bytes of an entry of its segment table.
const HEADER: usize = 64;
const ENTRY: usize = 56;

/// Returns the number of bytes that a shared library declares, if it is a 64-bit little-endian ELF file; `None` for any
/// other form.
///
/// # Errors
/// The system's errors, and a file that ends within its header or segment table.
pub fn announced_length(file: &mut (impl Read + Seek)) -> io::Result<Option<u64>> {
    let mut start = Vec::new();
    file.by_ref().take(HEADER as u64).read_to_end(&mut start)?;
    if !start.starts_with(b"\x7fELF\x02\x01") {
        return Ok(None);
    }
    let header: [u8; HEADER] = start.try_into().map_err(|_| io::ErrorKind::UnexpectedEof)?;
    let table = number(&header, 32, 8);
    let (entry, count) = (number(&header, 54, 2), number(&header, 56, 2));
    if entry != ENTRY as u64 {
        return Err(io::Error::other(format!("segments are described in {entry} bytes each, expected {ENTRY}")));
    }
    // As many entries as present, of at most 65,535.
    let length = ENTRY as u64 * count;
    let mut entries = Vec::new();
    file.seek(SeekFrom::Start(table))?;
    file.take(length).read_to_end(&mut entries)?;
    if entries.len() as u64 != length {
        return Err(io::ErrorKind::UnexpectedEof.into());
    }
    let ends = entries.chunks_exact(ENTRY).map(|entry| number(entry, 8, 8).saturating_add(number(entry, 32, 8)));
    Ok(ends.max())
}

/// Reads the little-endian number in `bytes[at..at + length]`.
fn number(bytes: &[u8], at: usize, length: usize) -> u64 {
    bytes[at..at + length].iter().rev().fold(0, |number, &byte| number << 8 | u64::from(byte))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Builds a file with one segment of `length` bytes at `offset`, of which only the first `keep` bytes are kept.
    fn file(offset: u64, length: u64, keep: usize) -> io::Cursor<Vec<u8>> {
        let mut bytes = [0; HEADER + ENTRY];
        bytes[..6].copy_from_slice(b"\x7fELF\x02\x01");
        bytes[32..40].copy_from_slice(&(HEADER as u64).to_le_bytes());
        bytes[54..56].copy_from_slice(&(ENTRY as u16).to_le_bytes());
        bytes[56..58].copy_from_slice(&1u16.to_le_bytes());
        bytes[HEADER + 8..HEADER + 16].copy_from_slice(&offset.to_le_bytes());
        bytes[HEADER + 32..HEADER + 40].copy_from_slice(&length.to_le_bytes());
        io::Cursor::new(bytes[..keep].to_vec())
    }

    #[test]
    fn the_last_segment_says_how_long_a_library_is() {
        let whole = HEADER + ENTRY;
        assert_eq!(announced_length(&mut file(4096, 100, whole)).expect("whole"), Some(4196));
        assert_eq!(announced_length(&mut file(u64::MAX, 100, whole)).expect("whole"), Some(u64::MAX));
        assert_eq!(announced_length(&mut file(0, 0, 3)).expect("another form"), None);
        for keep in [6, HEADER - 1, HEADER, whole - 1] {
            assert!(announced_length(&mut file(4096, 100, keep)).is_err(), "{keep} bytes");
        }
    }
}
