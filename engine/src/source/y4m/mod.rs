//! y4m (YUV4MPEG2): uncompressed video as a stream, read one frame at a time from any reader.
//!
//! ```text
//! YUV4MPEG2 W640 H360 F30:1 Ip A1:1 C420jpeg XCOLORRANGE=LIMITED\n
//! FRAME\n <planes Y, Cb, Cr>  FRAME\n <planes> …
//! ```
//!
//! Supported are 4:2:0 (all three sitings), 4:2:2, 4:1:1, 4:4:4 (with alpha too) and mono, 8 to 16 bits, both ranges;
//! see [`convert`] for the arithmetic. Sizes are checked before memory is allocated. A stream may end after any whole
//! frame.

pub mod convert;
pub mod header;

use std::io::{BufRead, ErrorKind, Read};
use std::path::{Path, PathBuf};

use super::SourceError;
use super::colour::Matrix;
use crate::picture::Picture;
pub use header::Header;

/// A y4m stream being read.
pub struct Y4m<R> {
    input: R,
    path: PathBuf,
    header: Header,
    header_bytes: u64,
    bytes: Vec<u8>,
    frames: usize,
}

impl<R: BufRead> Y4m<R> {
    /// Reads the header. `path` is for the messages.
    ///
    /// # Errors
    /// An unreadable stream, or one that is not y4m.
    pub fn new(mut input: R, path: &Path) -> Result<Self, SourceError> {
        let line = read_line(&mut input, path, "header")?;
        let Some(line) = line else {
            return Err(y4m_error(path, "the stream is empty, expected a YUV4MPEG2 header"));
        };
        let header = Header::parse(&line).map_err(|cause| y4m_error(path, cause))?;
        let header_bytes = line.len() as u64 + 1;
        Ok(Y4m { input, path: path.to_owned(), header, header_bytes, bytes: Vec::new(), frames: 0 })
    }

    /// Parameters of the stream.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// Sets the matrix; `None` for full-range planes of green, blue and red.
    pub(super) fn set_matrix(&mut self, matrix: Option<Matrix>) {
        self.header.matrix = matrix;
        self.header.full_range |= matrix.is_none();
    }

    /// Sets the pixel aspect.
    pub(super) fn set_aspect(&mut self, aspect: Option<(u32, u32)>) {
        self.header.aspect = aspect;
    }

    /// Applies the settings that depend on the header alone. `matrix`, if given, replaces the one chosen by size.
    /// Returns a note for each property that is converted or assumed.
    pub(super) fn take_in(&mut self, matrix: Option<Matrix>) -> Vec<String> {
        if matrix.is_some() {
            self.set_matrix(matrix);
        }
        let mut notes = Vec::new();
        if self.header.interlaced {
            notes.push(
                "the stream is interlaced, and its frames are taken as they are (ffmpeg's filter bwdif deinterlaces)"
                    .to_owned(),
            );
        }
        if self.header.chroma == header::Chroma::Mono && !self.header.range_stated {
            notes.push("the range of grey is not stated: full range was taken".to_owned());
        }
        notes.extend(self.header.aspect.map(header::made_square));
        notes
    }

    /// Returns the length of the header with its newline, in bytes.
    pub fn header_bytes(&self) -> u64 {
        self.header_bytes
    }

    /// Returns the next frame; `None` at the end of the stream.
    ///
    /// # Errors
    /// An unreadable stream, a malformed frame header, a frame that ends early.
    pub fn next_picture(&mut self) -> Result<Option<Picture>, SourceError> {
        if self.next_frame()?.is_none() {
            return Ok(None);
        }
        Ok(Some(convert::to_picture(&self.bytes, &self.header)))
    }

    /// Returns the planes of the next frame as they are stored; `None` at the end of the stream.
    ///
    /// # Errors
    /// As [`Y4m::next_picture`].
    pub(crate) fn next_frame(&mut self) -> Result<Option<&[u8]>, SourceError> {
        let Some(line) = read_line(&mut self.input, &self.path, "frame header")? else { return Ok(None) };
        if !(line == b"FRAME" || line.starts_with(b"FRAME ")) {
            let found = String::from_utf8_lossy(&line[..line.len().min(20)]).into_owned();
            return Err(y4m_error(&self.path, format!("frame {}: expected FRAME, found {found:?}", self.frames)));
        }
        let expected = self.header.frame_bytes();
        self.bytes.clear();
        Read::by_ref(&mut self.input)
            .take(expected as u64)
            .read_to_end(&mut self.bytes)
            .map_err(SourceError::read(&self.path))?;
        if self.bytes.len() != expected {
            let found = self.bytes.len();
            let cause = format!("frame {} ends early: expected {expected} bytes, found {found}", self.frames);
            return Err(y4m_error(&self.path, cause));
        }
        self.frames += 1;
        Ok(Some(&self.bytes))
    }
}

fn y4m_error(path: &Path, cause: impl Into<String>) -> SourceError {
    SourceError::Y4m { path: path.to_owned(), cause: cause.into() }
}

/// Reads a line without its newline; `None` at the end of the stream.
fn read_line(input: &mut impl BufRead, path: &Path, what: &str) -> Result<Option<Vec<u8>>, SourceError> {
    let mut line = Vec::new();
    match input.take(header::MAX_LINE as u64).read_until(b'\n', &mut line) {
        Ok(0) => return Ok(None),
        Ok(_) => {}
        Err(e) if e.kind() == ErrorKind::UnexpectedEof => return Ok(None),
        Err(e) => return Err(SourceError::read(path)(e)),
    }
    if line.pop() != Some(b'\n') {
        let cause = format!("the {what} is not a line of y4m (no newline within {} bytes)", header::MAX_LINE);
        return Err(y4m_error(path, cause));
    }
    Ok(Some(line))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stream(frames: usize) -> Vec<u8> {
        let mut bytes = b"YUV4MPEG2 W4 H2 F25:1 C420jpeg\n".to_vec();
        for frame in 0..frames {
            bytes.extend_from_slice(b"FRAME Ip\n");
            bytes.extend((0..12).map(|i| (16 + 7 * i + frame) as u8));
        }
        bytes
    }

    #[test]
    fn frames_are_read_until_the_stream_ends() {
        let bytes = stream(3);
        let mut y4m = Y4m::new(bytes.as_slice(), Path::new("-")).expect("valid");
        let mut count = 0;
        while let Some(picture) = y4m.next_picture().expect("valid") {
            assert_eq!((picture.width, picture.height), (4, 2));
            count += 1;
        }
        assert_eq!(count, 3);
    }

    #[test]
    fn a_cut_frame_and_a_wrong_marker_name_the_frame() {
        let bytes = stream(2);
        let mut y4m = Y4m::new(&bytes[..bytes.len() - 5], Path::new("x.y4m")).expect("valid");
        assert!(y4m.next_picture().expect("whole").is_some());
        let error = y4m.next_picture().expect_err("cut").to_string();
        assert_eq!(error, "x.y4m: frame 1 ends early: expected 12 bytes, found 7");
        let mut bytes = stream(1);
        bytes.extend_from_slice(b"FRAMO\n");
        let mut y4m = Y4m::new(bytes.as_slice(), Path::new("x.y4m")).expect("valid");
        assert!(y4m.next_picture().expect("whole").is_some());
        assert!(y4m.next_picture().expect_err("marker").to_string().contains("frame 1: expected FRAME"));
        assert!(Y4m::new(&b""[..], Path::new("-")).is_err());
        assert!(Y4m::new([b'Y'; 9000].as_slice(), Path::new("-")).is_err());
    }
}
