//! The bytes of a file: mapped, owned, or part of the program.

use std::fmt;
use std::fs::File;
use std::io;
use std::ops::Range;
use std::path::Path;

use memmap2::Mmap;

/// Bytes to read a checkpoint from.
pub enum Storage {
    /// A mapped file.
    Mapped(Mmap),
    /// Bytes in memory.
    Owned(Vec<u8>),
    /// Bytes of the program itself.
    Static(&'static [u8]),
}

impl fmt::Debug for Storage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kind = match self {
            Storage::Mapped(_) => "mapped",
            Storage::Owned(_) => "owned",
            Storage::Static(_) => "static",
        };
        write!(f, "{} bytes, {kind}", self.bytes().len())
    }
}

impl From<Vec<u8>> for Storage {
    fn from(bytes: Vec<u8>) -> Self {
        Storage::Owned(bytes)
    }
}

impl From<&'static [u8]> for Storage {
    fn from(bytes: &'static [u8]) -> Self {
        Storage::Static(bytes)
    }
}

impl Storage {
    /// Maps the file at `path`.
    ///
    /// As with every mapping, shortening the file while it is loaded ends the program (SIGBUS).
    ///
    /// # Errors
    /// When the file cannot be opened, is not a regular file, or cannot be mapped.
    #[expect(unsafe_code, reason = "mapping a file is unsafe by nature")]
    pub fn map(path: &Path) -> io::Result<Storage> {
        let file = File::open(path)?;
        let metadata = file.metadata()?;
        if !metadata.is_file() {
            return Err(io::Error::new(io::ErrorKind::InvalidInput, "not a regular file"));
        }
        if metadata.len() == 0 {
            // Empty files cannot be mapped everywhere.
            return Ok(Storage::Owned(Vec::new()));
        }
        // SAFETY: the mapping is private and read-only. Its bytes are plain data, read once while loading and checked
        // after they are copied: another program's write can change values but break no invariant.
        Ok(Storage::Mapped(unsafe { Mmap::map(&file)? }))
    }

    /// All bytes.
    pub fn bytes(&self) -> &[u8] {
        match self {
            Storage::Mapped(map) => map,
            Storage::Owned(bytes) => bytes,
            Storage::Static(bytes) => bytes,
        }
    }

    /// Lets the system reclaim the memory of a range of a mapped file.
    #[cfg_attr(unix, expect(unsafe_code, reason = "advice that drops pages is unsafe in general"))]
    pub(crate) fn release(&self, range: Range<usize>) {
        #[cfg(unix)]
        if let Storage::Mapped(map) = self {
            // Only whole pages inside the range: a page at its edge may hold a tensor that is still needed.
            const PAGE: usize = 1 << 16;
            let (start, end) = (range.start.next_multiple_of(PAGE), range.end / PAGE * PAGE);
            if start < end {
                // SAFETY: the mapping is of a file and is never written to. Dropped pages are read again from the file
                // with the same content. Failure only keeps memory in use.
                let _ = unsafe { map.unchecked_advise_range(memmap2::UncheckedAdvice::DontNeed, start, end - start) };
            }
        }
        #[cfg(not(unix))]
        let _ = range;
    }
}
