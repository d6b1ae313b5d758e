//! Decompression of data of known length.

use std::io::Read;

use flate2::bufread::GzDecoder;
use ruzstd::decoding::FrameDecoder;

use super::records::Stated;
use crate::formats::FormatError;

/// Maximum window of a zstd frame with less content than that.
const WINDOW: u64 = 1 << 23;

/// Decompresses a gzip stream. `read` parses the first `head` bytes and returns the header, the number of bytes that
/// must follow, and the number of optional bytes after those. Returns the header and the bytes after it; the stream's
/// comment is parsed into `stated`.
pub(super) fn gunzip<H>(
    bytes: &[u8],
    head: usize,
    stated: &mut Stated,
    read: impl FnOnce(&[u8]) -> Result<(H, usize, usize), FormatError>,
) -> Result<(H, Vec<u8>), FormatError> {
    let broken = |e: std::io::Error| FormatError::new("gzip stream", "a whole one", e.to_string());
    let mut decoder = GzDecoder::new(bytes);
    let mut first = vec![0; head];
    decoder.read_exact(&mut first).map_err(broken)?;
    if let Some(comment) = decoder.header().and_then(|header| header.comment()) {
        stated.comment(comment);
    }
    let (header, size, more) = read(&first)?;
    let mut rest = Vec::new();
    // The buffer grows with the data, so that a false length in the header allocates no memory.
    decoder.by_ref().take((size + more) as u64 + 1).read_to_end(&mut rest).map_err(broken)?;
    if rest.len() < size || rest.len() > size + more {
        let found = if rest.len() > size { "more".to_owned() } else { rest.len().to_string() };
        return Err(FormatError::new("attributes", format!("{size} bytes"), found));
    }
    match decoder.into_inner() {
        [] => Ok((header, rest)),
        more => Err(FormatError::new("file", "its end after the gzip stream", format!("{} more bytes", more.len()))),
    }
}

/// Decompresses a zstd frame whose content is exactly `size` bytes.
pub(super) fn zstd(name: &str, frame: &[u8], size: usize) -> Result<Vec<u8>, FormatError> {
    let broken = |found: String| FormatError::new(name, format!("a zstd frame of {size} bytes"), found);
    let mut decoder = FrameDecoder::new();
    decoder.set_max_window_size(WINDOW.max(size as u64));
    let mut out = vec![0; size];
    let written = decoder.decode_all(frame, &mut out).map_err(|e| broken(e.to_string()))?;
    if written == size { Ok(out) } else { Err(broken(format!("{written} bytes"))) }
}
