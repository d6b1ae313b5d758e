//! Files named by another file: the images of a SOG scene, the buffers of a glTF document.

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::rc::Rc;

use super::{FormatError, read_file};
use crate::still::Axes;

/// The folder of a file, from which the files that it names are read, and the digest of all bytes read.
pub(crate) struct Beside {
    folder: Option<PathBuf>,
    /// Axes of the numbers, where the user sets them.
    pub(crate) axes: Option<Axes>,
    read: Rc<RefCell<(blake3::Hasher, u64)>>,
}

impl Beside {
    /// Returns a value for bytes in memory, without other files.
    pub(crate) fn none() -> Beside {
        Beside { folder: None, axes: None, read: Rc::default() }
    }

    /// Returns a value for the file at `path` with the content `bytes`.
    pub(crate) fn of(path: &Path, bytes: &[u8], axes: Option<Axes>) -> Beside {
        let beside = Beside { folder: path.parent().map(Path::to_owned), axes, ..Beside::none() };
        beside.read.borrow_mut().0.update(bytes);
        beside
    }

    /// Returns the path of a file in the same folder or in a folder below it. Other paths are errors.
    fn path(&self, name: &str) -> Result<PathBuf, FormatError> {
        let Some(folder) = &self.folder else { return Err(wrong(name, "none, as this one is in memory".into())) };
        let own = name.strip_prefix("./").unwrap_or(name);
        let below = own.split('/').all(plain);
        if below { Ok(folder.join(own)) } else { Err(wrong(name, "the name of another place".into())) }
    }

    /// Returns the total size of a file of `own` bytes and of the files that it names, each once. Files that cannot be
    /// read count as 0 here; [`Self::read`] returns their error.
    pub(crate) fn size<'n>(&self, own: u64, names: impl Iterator<Item = &'n str>) -> u64 {
        let length = |name| std::fs::metadata(self.path(name).ok()?).ok().map(|about| about.len());
        names.collect::<BTreeSet<_>>().into_iter().filter_map(length).fold(own, u64::saturating_add)
    }

    /// Reads a file in the same folder; more than `most` bytes are an error.
    pub(crate) fn read(&self, name: &str, most: u64) -> Result<Vec<u8>, FormatError> {
        let bytes = read_file(&self.path(name)?, most).map_err(|e| wrong(name, e.to_string()))?;
        let (hasher, length) = &mut *self.read.borrow_mut();
        hasher.update(&bytes);
        *length += bytes.len() as u64;
        Ok(bytes)
    }

    /// Reads a file in a subfolder as [`Beside::read`] does. Also returns the [`Beside`] for the files that it names.
    pub(crate) fn inner(&self, name: &str, most: u64) -> Result<(Vec<u8>, Beside), FormatError> {
        let mut parts: Vec<&str> = name.split('/').collect();
        let own = parts.pop().unwrap_or_default();
        let folder = self.folder.as_ref().filter(|_| parts.iter().all(|part| plain(part)));
        let folder = folder.map(|folder| parts.iter().fold(folder.clone(), |folder, part| folder.join(part)));
        if folder.is_none() && self.folder.is_some() {
            let expected = "a file in a folder beside this one";
            return Err(FormatError::new(format!("file {name:?}"), expected, "the name of another place"));
        }
        let inner = Beside { folder, axes: self.axes, read: self.read.clone() };
        Ok((inner.read(own, most)?, inner))
    }

    /// Returns the total length of a file of `own` bytes and of all files read through it, and their digest.
    pub(crate) fn finish(self, own: usize) -> (u64, String) {
        let (hasher, length) = &*self.read.borrow();
        (own as u64 + length, hasher.finalize().to_hex().to_string())
    }
}

fn wrong(name: &str, found: String) -> FormatError {
    FormatError::new(format!("file {name:?}"), "a file beside this one", found)
}

/// Returns true for a plain name of a file or folder, one that leads to no other folder.
fn plain(name: &str) -> bool {
    !name.is_empty() && !name.starts_with('.') && !name.contains(['/', '\\', ':', '\0'])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_files_of_the_same_folder_and_below_are_read() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let own = folder.path().join("in");
        std::fs::create_dir(&own).expect("writable");
        std::fs::write(folder.path().join("secret"), "no").expect("writable");
        std::fs::create_dir(own.join("parts")).expect("writable");
        std::fs::write(own.join("a"), "yes").expect("writable");
        std::fs::write(own.join("parts/a b%"), "also").expect("writable");
        let beside = Beside::of(&own.join("scene"), b"scene", None);
        assert_eq!(beside.read("a", 3).expect("beside"), b"yes");
        assert_eq!(beside.size(5, ["a", "b", "a", "../secret"].into_iter()), 8);
        for name in ["../secret", "..", "", "/etc/passwd", "in\\a", "parts/../../secret", "parts//a", "./", "b"] {
            assert!(beside.read(name, 100).is_err(), "{name}");
        }
        assert!(beside.read("a", 2).is_err());
        let outer = Beside::of(&folder.path().join("scene"), b"scene", None);
        let (bytes, inner) = outer.inner("in/a", 3).expect("in a folder");
        assert_eq!((bytes, inner.read("a", 3).expect("beside")), (b"yes".to_vec(), b"yes".to_vec()));
        for name in ["../in/a", "/in/a", "in/../in/a", "in//a", "in/", "in\\a", "in/b"] {
            assert!(outer.inner(name, 100).is_err(), "{name}");
        }
        assert_eq!(outer.finish(5), (11, blake3::hash(b"sceneyesyes").to_hex().to_string()));
        assert_eq!(beside.read("parts/a b%", 9).expect("below"), b"also");
        assert_eq!(beside.read("./a", 9).expect("beside"), b"yes");
        assert_eq!(beside.finish(5), (15, blake3::hash(b"sceneyesalsoyes").to_hex().to_string()));
        assert!(Beside::none().read("a", 100).is_err());
    }
}
