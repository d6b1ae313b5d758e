//! File operations for everything that is written: files, names, folders, and their durability.
//!
//! A symbolic link is never written through: [`create`] replaces anything of that name by a new file, [`reopen`] and
//! [`create_folder`] refuse links. Data survive a power loss once synced: a file's bytes by [`Output::sync`], the names
//! in a folder by [`sync_folder`].
//!
//! The crate's tests can make operations of their thread fail, or lose unsynced data.

use std::fs::{File, Metadata};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::Path;

#[cfg(test)]
pub(crate) mod faults;

/// Calls a function of `faults` before an operation, in tests alone.
macro_rules! in_tests {
    ($($call:tt)*) => {
        #[cfg(test)]
        faults::$($call)*;
    };
}

/// A file being written.
#[derive(Debug)]
pub struct Output {
    file: File,
    #[cfg(test)]
    path: std::path::PathBuf,
}

impl Output {
    /// Waits until the file's bytes would survive a power loss.
    ///
    /// # Errors
    /// The system's.
    pub fn sync(&self) -> io::Result<()> {
        in_tests!(step()?);
        self.file.sync_all()?;
        in_tests!(synced(&self.path));
        Ok(())
    }

    /// Cuts the file to `length` bytes and continues writing there.
    ///
    /// # Errors
    /// The system's.
    pub fn cut(&mut self, length: u64) -> io::Result<()> {
        in_tests!(step()?);
        self.file.set_len(length)?;
        self.file.seek(SeekFrom::Start(length)).map(drop)
    }
}

impl Write for Output {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        #[cfg(test)]
        let bytes = faults::write_step(bytes)?;
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl Read for Output {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        self.file.read(bytes)
    }
}

/// Creates a file. It replaces a file or link of that name; a folder is an error.
///
/// # Errors
/// The system's.
pub fn create(path: &Path) -> io::Result<Output> {
    if exists(path) {
        remove(path)?;
    }
    in_tests!(change(|| faults::Change::Created(path.to_owned()))?);
    let file = File::options().write(true).create_new(true).open(path)?;
    Ok(Output {
        file,
        #[cfg(test)]
        path: path.to_owned(),
    })
}

/// Opens a regular file for reading and appending.
///
/// # Errors
/// The system's; anything that is not a regular file, such as a link.
pub fn reopen(path: &Path) -> io::Result<Output> {
    regular(path)?;
    in_tests!(reopen(path)?);
    let file = File::options().read(true).write(true).open(path)?;
    Ok(Output {
        file,
        #[cfg(test)]
        path: path.to_owned(),
    })
}

/// Renames the file `from` to `to`, in the same folder.
///
/// # Errors
/// The system's.
pub fn rename(from: &Path, to: &Path) -> io::Result<()> {
    in_tests!(change(|| faults::Change::renamed(from, to))?);
    std::fs::rename(from, to)
}

/// Removes a file, or a link itself.
///
/// # Errors
/// The system's.
pub fn remove(path: &Path) -> io::Result<()> {
    std::fs::symlink_metadata(path)?;
    in_tests!(change(|| faults::Change::removed(path))?);
    std::fs::remove_file(path)
}

/// Creates a folder in an existing one; an existing folder of that name is kept.
///
/// # Errors
/// The system's; anything that is not a folder, such as a link to one.
pub fn create_folder(path: &Path) -> io::Result<()> {
    match std::fs::symlink_metadata(path) {
        Ok(found) if found.is_dir() => Ok(()),
        Ok(found) => Err(io::Error::other(format!("expected a folder, found {}", kind(&found)))),
        Err(_) => {
            in_tests!(change(|| faults::Change::FolderCreated(path.to_owned()))?);
            std::fs::create_dir(path)
        }
    }
}

/// Removes an empty folder.
///
/// # Errors
/// The system's.
pub fn remove_folder(path: &Path) -> io::Result<()> {
    in_tests!(change(|| faults::Change::FolderRemoved(path.to_owned()))?);
    std::fs::remove_dir(path)
}

/// Waits until the names in a folder would survive a power loss. Does nothing on systems without such an operation.
///
/// # Errors
/// The system's.
pub fn sync_folder(path: &Path) -> io::Result<()> {
    in_tests!(step()?);
    let path = if path.as_os_str().is_empty() { Path::new(".") } else { path };
    if cfg!(unix) {
        match File::open(path)?.sync_all() {
            Err(e) if !matches!(e.kind(), io::ErrorKind::InvalidInput | io::ErrorKind::Unsupported) => return Err(e),
            _ => {}
        }
    }
    in_tests!(synced_folder(path));
    Ok(())
}

/// Returns true if anything of that name exists, even a dangling link.
pub fn exists(path: &Path) -> bool {
    std::fs::symlink_metadata(path).is_ok()
}

/// Metadata of `path`, which must be a regular file.
///
/// # Errors
/// The system's; anything else, such as a link.
pub fn regular(path: &Path) -> io::Result<Metadata> {
    let found = std::fs::symlink_metadata(path)?;
    if found.is_file() {
        return Ok(found);
    }
    Err(io::Error::other(format!("expected a regular file, found {}", kind(&found))))
}

fn kind(found: &Metadata) -> &'static str {
    if found.is_symlink() {
        "a symbolic link"
    } else if found.is_dir() {
        "a folder"
    } else if found.is_file() {
        "a file"
    } else {
        "something else"
    }
}
