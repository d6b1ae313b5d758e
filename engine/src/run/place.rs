//! The place of a command's results, locked by one process at a time.

use std::fs::{File, TryLockError};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use crate::output::{OutputError, prepare_folder, storage};

use crate::run::Error;
use crate::run::destination::Destination;

/// Longest text of a lock file that is read.
const MAX_TEXT: u64 = 64;

/// A destination and, while it is held, the lock on it.
#[derive(Debug)]
pub struct Place {
    destination: Destination,
    lock: Option<Lock>,
    /// Folders that [`Place::hold`] created, innermost first.
    made: Vec<PathBuf>,
}

impl Place {
    /// A place without a lock.
    pub fn new(destination: Destination) -> Place {
        Place { destination, lock: None, made: Vec::new() }
    }

    /// Destination of the place.
    pub fn destination(&self) -> &Destination {
        &self.destination
    }

    /// Locks the place until this value is dropped; creates the folder if it does not exist. Standard output is not
    /// locked.
    pub fn hold(&mut self) -> Result<(), Error> {
        let Some(path) = self.destination.lock().filter(|_| self.lock.is_none()) else { return Ok(()) };
        if let Destination::Folder(folder) = &self.destination {
            let missing = |path: &&Path| !path.as_os_str().is_empty() && !path.exists();
            self.made = folder.ancestors().take_while(missing).map(Path::to_owned).collect();
            prepare_folder(folder)?;
        }
        self.lock = Some(Lock::take(path, self.destination.path())?);
        Ok(())
    }

    /// Releases the place and removes the folders that were created for it and are empty.
    pub fn withdraw(&mut self) {
        self.lock = None;
        for folder in self.made.drain(..) {
            // A folder that others use by now stays.
            let _ = std::fs::remove_dir(folder);
        }
    }

    /// As [`Place::hold`], if the place exists.
    pub fn hold_existing(&mut self) -> Result<(), Error> {
        let there = match &self.destination {
            Destination::Folder(folder) => folder.is_dir(),
            Destination::Video(path, _) => {
                storage::exists(path) || self.destination.resume().is_some_and(|r| r.exists())
            }
        };
        if there { self.hold() } else { Ok(()) }
    }
}

/// A locked file with the holder's process id in it. The lock ends with the process, however that ends; the file is
/// removed when this value is dropped.
#[derive(Debug)]
struct Lock {
    path: PathBuf,
    _file: File,
}

impl Lock {
    fn take(path: PathBuf, out: &Path) -> Result<Lock, Error> {
        static COUNT: AtomicU64 = AtomicU64::new(0);
        let write = |cause| Error::from(OutputError::Write { path: path.clone(), cause });
        loop {
            if storage::exists(&path) {
                storage::regular(&path).map_err(write)?;
            }
            // A killed process leaves its file, but no lock.
            let opened = File::options().read(true).write(true).create(true).truncate(false).open(&path);
            let mut file = opened.map_err(write)?;
            match file.try_lock() {
                Ok(()) => {}
                Err(TryLockError::WouldBlock) => return Err(held(out, &path)),
                // Some network file systems have no locks.
                Err(TryLockError::Error(e)) if e.kind() == std::io::ErrorKind::Unsupported => {}
                Err(TryLockError::Error(e)) => return Err(write(e)),
            }
            let text = format!("{} {}\n", std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed));
            let written = file.set_len(0).and_then(|()| file.seek(SeekFrom::Start(0)));
            written.and_then(|_| file.write_all(text.as_bytes())).map_err(write)?;
            // The previous holder may have deleted the file between open and lock; then retry.
            if read(&path).is_some_and(|found| found == text) {
                return Ok(Lock { path, _file: file });
            }
        }
    }
}

impl Drop for Lock {
    fn drop(&mut self) {
        // While it is still locked, so that no other process's file is removed.
        let _ = std::fs::remove_file(&self.path);
    }
}

fn read(path: &Path) -> Option<String> {
    let mut text = String::new();
    File::open(path).ok()?.take(MAX_TEXT).read_to_string(&mut text).ok()?;
    Some(text)
}

fn held(out: &Path, lock: &Path) -> Error {
    let text = read(lock).unwrap_or_default();
    let process = match text.split(' ').next().and_then(|id| id.parse::<u32>().ok()) {
        Some(id) => format!("process {id}"),
        None => "another process".to_owned(),
    };
    Error::usage(format!(
        "--out {}: {process} is writing there; wait until it ends, or give another --out",
        out.display()
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_at_a_time_holds_a_place() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let out = folder.path().join("out");
        let mut first = Place::new(Destination::of(&out));
        let mut second = Place::new(Destination::of(&out));
        first.hold().expect("free");
        first.hold().expect("its own");
        let refused = second.hold().expect_err("held");
        assert!(refused.is_usage());
        assert!(refused.to_string().contains(&format!("process {}", std::process::id())), "{}", refused.to_string());
        drop(first);
        second.hold().expect("free again");
        drop(second);
        assert_eq!(std::fs::read_dir(&out).expect("there").count(), 0, "a lock goes with its holder");
    }

    #[test]
    fn a_place_that_is_given_up_leaves_no_folder_of_its_own() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let (outer, inner) = (folder.path().join("a"), folder.path().join("a/b/c"));
        let mut place = Place::new(Destination::of(&inner));
        place.hold().expect("free");
        place.withdraw();
        assert!(!outer.exists());
        std::fs::create_dir(&outer).expect("writable");
        place.hold().expect("free");
        std::fs::write(folder.path().join("a/b/other"), "text").expect("writable");
        place.withdraw();
        assert!(!inner.exists() && folder.path().join("a/b/other").exists());
    }

    #[test]
    fn what_a_killed_process_left_is_no_obstacle() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let mut place = Place::new(Destination::of(&folder.path().join("v.y4m")));
        std::fs::write(folder.path().join(".v.y4m.lock"), "4194304 0\n").expect("writable");
        place.hold().expect("nobody's");
    }

    #[cfg(unix)]
    #[test]
    fn a_lock_is_not_written_through_a_link() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let (out, precious) = (folder.path().join("out"), folder.path().join("precious"));
        std::fs::create_dir(&out).expect("writable");
        std::fs::write(&precious, "text").expect("writable");
        std::os::unix::fs::symlink(&precious, out.join(".streamsplat.lock")).expect("writable");
        assert!(Place::new(Destination::of(&out)).hold().is_err_and(|e| e.to_string().contains("a symbolic link")));
        assert_eq!(std::fs::read(&precious).expect("there"), b"text");
    }
}
