//! How much of a file is read.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

/// Gaussians of a scene that are read where nothing else is said.
pub const GAUSSIANS: usize = 1 << 24;

/// Limits on the content of files. Compressed and sparse files can expand to many times their size.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Gaussians of an interval, or of a still scene.
    pub gaussians: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Limits { gaussians: GAUSSIANS }
    }
}

/// The bytes of a file of at most `most` bytes. Memory is taken as the file has them.
///
/// # Errors
/// The system's; a longer file, memory that is not there.
pub fn read_file(path: &Path, most: u64) -> io::Result<Vec<u8>> {
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

/// As [`read_file`], of text.
///
/// # Errors
/// As there, and bytes that are no UTF-8.
pub fn read_text(path: &Path, most: u64) -> io::Result<String> {
    let bytes = read_file(path, most)?;
    String::from_utf8(bytes).map_err(|e| io::Error::new(io::ErrorKind::InvalidData, e.utf8_error()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_more_is_read_than_allowed() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("a");
        std::fs::write(&path, "hello").expect("writable");
        assert_eq!(read_file(&path, 5).expect("short"), b"hello");
        assert_eq!(read_text(&path, 5).expect("short"), "hello");
        let error = read_file(&path, 4).expect_err("long").to_string();
        assert_eq!(error, "expected at most 4 bytes, found 5");
        // A hole of a tebibyte takes no memory.
        File::create(&path).and_then(|file| file.set_len(1 << 40)).expect("sparse files");
        assert!(read_file(&path, 1 << 20).is_err());
        if cfg!(target_os = "linux") {
            let error = read_file(Path::new("/dev/zero"), 1 << 20).expect_err("endless").to_string();
            assert_eq!(error, "expected at most 1048576 bytes, found more");
        }
    }
}
