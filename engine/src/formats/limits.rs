//! Limits on reading a file.
//!
//! A file of N bytes may hold Gaussians that take [`RATIO`]·N bytes in memory, or [`SMALL`] if that is more. The limit
//! applies to the scene after reading: an interval of a container, or all instances of a mesh together. All intervals
//! of a container may take four times as much per byte, since they are read one at a time. Readers need a few times
//! that memory while they unpack. Measured, in bytes per byte of the file:
//!
//! | file | ratio |
//! |---|---|
//! | one time of a scene from a video: SPZ, SOG | 5, 8 |
//! | a million equal Gaussians in a regular plane: SPZ, SOG | 22, 13 |
//! | 90,000 of them with harmonics of degree 3, all 0: SPZ, SOG | 94, 47 |
//! | a container of a video of a locked camera, and of a video of one colour | 46, 196 |
//! | a million equal Gaussians in one place: SPZ, SOG | 4800, 9500 |

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use super::FormatError;
use crate::still::{GAUSSIANS, Still};

/// Default limit on the bytes in memory per byte of a file.
pub const RATIO: u64 = 256;
/// Bytes in memory that are allowed for a file of any size.
pub const SMALL: u64 = 16 << 20;

/// Limits on a file's content, and the level of detail to read. Compressed and sparse files can expand to many times
/// their size.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Maximum number of Gaussians of an interval, or of a still scene.
    pub gaussians: usize,
    /// Maximum bytes in memory per byte of the file; [`SMALL`] are always allowed.
    pub ratio: u64,
    /// Level of detail of a file that has several; 0 is the finest.
    pub level: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Limits { gaussians: GAUSSIANS, ratio: RATIO, level: 0 }
    }
}

impl Limits {
    /// Returns an error if there are more Gaussians than allowed.
    pub(crate) fn check_count(&self, part: &str, count: usize) -> Result<(), FormatError> {
        if count <= self.gaussians {
            return Ok(());
        }
        let expected = format!("at most {} Gaussians (the limit can be raised)", self.gaussians);
        Err(FormatError::new(part, expected, count.to_string()))
    }

    /// Returns an error if `count` items of `each` bytes exceed the memory limit of a file of `size` bytes.
    pub(crate) fn check_memory(
        &self,
        part: &str,
        what: &str,
        count: u64,
        each: u64,
        size: u64,
    ) -> Result<(), FormatError> {
        let most = size.saturating_mul(self.ratio).max(SMALL);
        if count.saturating_mul(each) <= most {
            return Ok(());
        }
        let expected = format!("at most {} {what} in a file of {size} bytes (the ratio can be raised)", most / each);
        Err(FormatError::new(part, expected, count.to_string()))
    }

    /// Checks both limits for `count` Gaussians of a still scene with harmonics of this degree.
    pub(crate) fn check_still(&self, part: &str, count: usize, degree: usize, size: u64) -> Result<(), FormatError> {
        self.check_count(part, count)?;
        self.check_memory(part, "Gaussians", count as u64, Still::bytes_each(degree), size)
    }
}

/// Reads a file of at most `most` bytes. Memory grows with the bytes read.
///
/// # Errors
/// The system's error; a longer file; memory that cannot be allocated.
pub(crate) fn read_file(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    let file = File::open(path)?;
    let size = file.metadata()?.len();
    let longer = |found: &str| {
        let cause = format!("expected at most {most} bytes, found {found}");
        io::Error::new(io::ErrorKind::FileTooLarge, cause)
    };
    if size > most {
        return Err(longer(&size.to_string()));
    }
    let mut bytes = Vec::new();
    bytes.try_reserve_exact(usize::try_from(size).unwrap_or(usize::MAX))?;
    // Devices and pipes have no length.
    file.take(most.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most { Err(longer("more")) } else { Ok(bytes) }
}

/// Reads text of at most `most` bytes. Memory grows with the bytes read.
///
/// # Errors
/// The system's error; a longer file; memory that cannot be allocated; bytes that are not UTF-8.
pub fn read_text(path: &Path, most: u64) -> io::Result<String> {
    let bytes = read_file(path, most)?;
    String::from_utf8(bytes).map_err(|e| io::Error::new(io::ErrorKind::InvalidData, e.utf8_error()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_stands_for_so_many_times_its_length() {
        let limits = Limits::default();
        let most = 256 * 1_000_000 / 56;
        limits.check_still("a", most, 0, 1_000_000).expect("as many as fit");
        let error = limits.check_still("a", most + 1, 0, 1_000_000).expect_err("more").to_string();
        let start = format!("a: expected at most {most} Gaussians in a file of 1000000 bytes");
        assert!(error.starts_with(&start) && error.ends_with(&format!("found {}", most + 1)), "{error}");
        // Harmonics count towards the limit.
        assert!(limits.check_still("a", 256 * 1_000_000 / 236, 3, 1_000_000).is_ok());
        assert!(limits.check_still("a", 256 * 1_000_000 / 236 + 1, 3, 1_000_000).is_err());
        // Small scenes are read from any file, and no product overflows.
        assert!(limits.check_still("a", (16 << 20) / 56, 0, 1).is_ok());
        assert!(limits.check_still("a", (16 << 20) / 56 + 1, 0, 1).is_err());
        assert!(limits.check_memory("a", "bytes", u64::MAX, u64::MAX, 1).is_err());
        assert!(Limits { ratio: u64::MAX, ..limits }.check_still("a", GAUSSIANS, 3, 2).is_ok());
        assert!(Limits { ratio: u64::MAX, ..limits }.check_still("a", GAUSSIANS + 1, 3, 2).is_err());
    }

    #[test]
    fn no_more_is_read_than_allowed() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("a");
        std::fs::write(&path, "hello").expect("writable");
        assert_eq!(read_file(&path, 5).expect("short"), b"hello");
        assert_eq!(read_text(&path, 5).expect("short"), "hello");
        let error = read_file(&path, 4).expect_err("long").to_string();
        assert_eq!(error, "expected at most 4 bytes, found 5");
        // A hole of a tebibyte needs no memory.
        File::create(&path).and_then(|file| file.set_len(1 << 40)).expect("sparse files");
        assert!(read_file(&path, 1 << 20).is_err());
        if cfg!(target_os = "linux") {
            let error = read_file(Path::new("/dev/zero"), 1 << 20).expect_err("endless").to_string();
            assert_eq!(error, "expected at most 1048576 bytes, found more");
        }
    }
}
