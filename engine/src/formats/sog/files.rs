//! The files of a SOG scene, in a zip file or in one folder.

use std::borrow::Cow;
use std::io::{Cursor, Read};

use zip::ZipArchive;
use zip::result::ZipError;

use super::MAGIC;
use crate::formats::{Beside, FormatError};

/// Longest `meta.json`, in bytes.
const MAX_META: u64 = 1 << 20;

pub(super) enum Files<'a> {
    Zip(ZipArchive<Cursor<&'a [u8]>>, u64),
    Beside(&'a [u8], &'a Beside),
}

impl<'a> Files<'a> {
    pub(super) fn new(bytes: &'a [u8], beside: &'a Beside) -> Result<Self, FormatError> {
        if !bytes.starts_with(&MAGIC) {
            return Ok(Files::Beside(bytes, beside));
        }
        let broken = |e: ZipError| FormatError::new("zip file", "a whole one", e.to_string());
        ZipArchive::new(Cursor::new(bytes)).map(|archive| Files::Zip(archive, bytes.len() as u64)).map_err(broken)
    }

    pub(super) fn meta(&mut self) -> Result<Cow<'a, [u8]>, FormatError> {
        match self {
            Files::Zip(..) => self.read("meta.json", MAX_META).map(Cow::Owned),
            Files::Beside(bytes, _) => Ok(Cow::Borrowed(bytes)),
        }
    }

    /// Returns the size of the scene in bytes: of the zip file, or of `meta.json` and its images.
    pub(super) fn size<'n>(&self, images: impl Iterator<Item = &'n str>) -> u64 {
        match self {
            Files::Zip(_, size) => *size,
            Files::Beside(bytes, beside) => beside.size(bytes.len() as u64, images),
        }
    }

    /// Reads a file of at most `most` bytes.
    pub(super) fn read(&mut self, name: &str, most: u64) -> Result<Vec<u8>, FormatError> {
        match self {
            Files::Beside(_, beside) => beside.read(name, most),
            Files::Zip(archive, _) => {
                let broken = |e: String| FormatError::new(name.to_owned(), "a file in the zip file", e);
                let file = archive.by_name(name).map_err(|e| broken(e.to_string()))?;
                let mut bytes = Vec::new();
                // Memory grows with the bytes read, whatever length is declared.
                file.take(most + 1).read_to_end(&mut bytes).map_err(|e| broken(e.to_string()))?;
                if bytes.len() as u64 > most {
                    Err(broken(format!("one of more than {most} bytes")))
                } else {
                    Ok(bytes)
                }
            }
        }
    }
}
