//! Files that are read from beginning to end, one block at a time.

use std::fs::File;
use std::io::{self, Read};

use super::FormatError;

/// Called with the number of bytes read so far and the size of the whole file.
pub type Progress<'a> = &'a mut (dyn FnMut(u64, u64) + Send);

/// Error that ends the reading of a file.
#[derive(Debug)]
pub(crate) enum ReadError {
    /// I/O error.
    File(io::Error),
    /// Invalid content.
    Format(FormatError),
}

impl From<io::Error> for ReadError {
    fn from(cause: io::Error) -> Self {
        ReadError::File(cause)
    }
}

impl From<FormatError> for ReadError {
    fn from(cause: FormatError) -> Self {
        ReadError::Format(cause)
    }
}

/// A file of known length, with at most one block of it in memory, and the digest of the bytes read.
pub(crate) struct Blocks<'a> {
    file: File,
    length: u64,
    /// First bytes, inspected and not consumed yet.
    ahead: Vec<u8>,
    taken: u64,
    hasher: blake3::Hasher,
    progress: Progress<'a>,
}

impl<'a> Blocks<'a> {
    pub(crate) fn new(file: File, length: u64, progress: Progress<'a>) -> Self {
        Self { file, length, ahead: Vec::new(), taken: 0, hasher: blake3::Hasher::new(), progress }
    }

    /// Returns the size of the file in bytes.
    pub(crate) fn length(&self) -> u64 {
        self.length
    }

    /// Returns the first bytes, at most `most` of them, before any is consumed.
    pub(crate) fn head(&mut self, most: u64) -> io::Result<&[u8]> {
        let missing = most.min(self.length).saturating_sub(self.ahead.len() as u64);
        (&mut self.file).take(missing).read_to_end(&mut self.ahead)?;
        Ok(&self.ahead)
    }

    /// Reads the next bytes into all of `block`.
    pub(crate) fn fill(&mut self, block: &mut [u8]) -> io::Result<()> {
        let before = self.ahead.len().min(block.len());
        let (first, rest) = block.split_at_mut(before);
        first.copy_from_slice(&self.ahead[..before]);
        self.ahead.drain(..before);
        self.file.read_exact(rest)?;
        self.hasher.update(block);
        self.taken += block.len() as u64;
        (self.progress)(self.taken, self.length);
        Ok(())
    }

    /// Skips the next `count` bytes.
    pub(crate) fn pass(&mut self, mut count: u64) -> io::Result<()> {
        let mut block = vec![0; count.min(1 << 16) as usize];
        while count > 0 {
            let next = count.min(block.len() as u64);
            self.fill(&mut block[..next as usize])?;
            count -= next;
        }
        Ok(())
    }

    /// Returns the file's length and digest, once all of it is read.
    pub(crate) fn finish(self) -> (u64, String) {
        (self.length, self.hasher.finalize().to_hex().to_string())
    }
}
