//! Faults for the crate's tests: operations that fail, and power losses.
//!
//! Nothing happens outside of [`inject`], which affects only the calling thread. A power loss is simulated as the worst
//! case of a file system: from one operation on everything fails, and then all unsynced data are lost. File systems
//! differ in what they lose first, so there are two kinds. In [`Fault::LosesBytes`] names persist and bytes do not:
//! files exist, cut to their synced length. In [`Fault::LosesNames`] names do not persist either: files created,
//! renamed or removed since their folder was synced are restored to their former state.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

/// A fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Fault {
    /// One operation fails: there is no room (ENOSPC).
    NoSpace,
    /// One operation fails: a device error (EIO).
    Device,
    /// One write accepts half of the bytes, and the next operation fails because the disk is full.
    ShortWrite,
    /// The power fails; unsynced bytes are lost.
    LosesBytes,
    /// The power fails; unsynced bytes and names are lost.
    LosesNames,
}

/// Room for a write: all of its bytes, or half of them.
enum Room {
    Enough,
    Half,
}

/// A change of names.
#[derive(Debug)]
pub(super) enum Change {
    Created(PathBuf),
    Renamed { from: PathBuf, to: PathBuf, replaced: Option<Vec<u8>> },
    Removed { path: PathBuf, bytes: Vec<u8> },
    FolderCreated(PathBuf),
    FolderRemoved(PathBuf),
}

impl Change {
    pub(super) fn renamed(from: &Path, to: &Path) -> Change {
        Change::Renamed { from: from.to_owned(), to: to.to_owned(), replaced: std::fs::read(to).ok() }
    }

    pub(super) fn removed(path: &Path) -> Change {
        Change::Removed { path: path.to_owned(), bytes: std::fs::read(path).unwrap_or_default() }
    }

    fn folder(&self) -> Option<&Path> {
        let (Change::Created(path)
        | Change::Renamed { to: path, .. }
        | Change::Removed { path, .. }
        | Change::FolderCreated(path)
        | Change::FolderRemoved(path)) = self;
        path.parent()
    }

    fn undo(self) {
        // A change that cannot be undone was undone already with its folder.
        let _ = match self {
            Change::Created(path) => std::fs::remove_file(path),
            Change::Renamed { from, to, replaced } => {
                std::fs::rename(&to, from).and_then(|()| replaced.map_or(Ok(()), |bytes| std::fs::write(to, bytes)))
            }
            Change::Removed { path, bytes } => std::fs::write(path, bytes),
            Change::FolderCreated(path) => std::fs::remove_dir_all(path),
            Change::FolderRemoved(path) => std::fs::create_dir(path),
        };
    }
}

#[derive(Debug)]
struct Plan {
    fault: Option<(Fault, u64)>,
    /// The program that is run instead of ffmpeg.
    ffmpeg: Option<PathBuf>,
    operations: u64,
    /// Operations fail from now on.
    dead: bool,
    short: bool,
    /// Files with unsynced bytes, and their synced lengths.
    files: BTreeMap<PathBuf, u64>,
    /// Unsynced changes of names.
    changes: Vec<Change>,
}

thread_local! {
    static PLAN: RefCell<Option<Plan>> = const { RefCell::new(None) };
}

fn with<T>(f: impl FnOnce(&mut Plan) -> T) -> Option<T> {
    PLAN.with_borrow_mut(|plan| plan.as_mut().map(f))
}

/// Runs `work` with `fault` at this operation of the thread, counted from 1; returns its result and the number of
/// operations. Data lost by a power loss are removed before it returns.
pub(crate) fn inject<T>(fault: Option<(Fault, u64)>, work: impl FnOnce() -> T) -> (T, u64) {
    inject_with(fault, None, work)
}

/// As [`inject`], with another program instead of ffmpeg.
pub(crate) fn inject_with<T>(
    fault: Option<(Fault, u64)>,
    ffmpeg: Option<PathBuf>,
    work: impl FnOnce() -> T,
) -> (T, u64) {
    let plan =
        Plan { fault, ffmpeg, operations: 0, dead: false, short: false, files: BTreeMap::new(), changes: Vec::new() };
    PLAN.set(Some(plan));
    let result = work();
    let Some(plan) = PLAN.take() else { return (result, 0) };
    let operations = plan.operations;
    if plan.dead {
        plan.lose();
    }
    (result, operations)
}

impl Plan {
    fn lose(self) {
        for (path, length) in &self.files {
            // A file that was removed since has no bytes to lose.
            let _ = File::options().write(true).open(path).and_then(|file| {
                let shorter = file.metadata()?.len() > *length;
                if shorter { file.set_len(*length) } else { Ok(()) }
            });
        }
        if self.fault.is_some_and(|(fault, _)| fault == Fault::LosesNames) {
            self.changes.into_iter().rev().for_each(Change::undo);
        }
    }

    fn step(&mut self, writes: bool) -> io::Result<Room> {
        self.operations += 1;
        if self.dead {
            return Err(io::Error::other("the power failed"));
        }
        if std::mem::take(&mut self.short) {
            return Err(io::ErrorKind::StorageFull.into());
        }
        let Some((fault, _)) = self.fault.filter(|(_, at)| *at == self.operations) else { return Ok(Room::Enough) };
        match fault {
            Fault::ShortWrite if writes => {
                self.short = true;
                Ok(Room::Half)
            }
            Fault::NoSpace | Fault::ShortWrite => Err(io::ErrorKind::StorageFull.into()),
            Fault::Device => Err(io::Error::other("input/output error")),
            Fault::LosesBytes | Fault::LosesNames => {
                self.dead = true;
                Err(io::Error::other("the power failed"))
            }
        }
    }
}

/// Counts an operation; returns an error if it is the one to fail.
pub(super) fn step() -> io::Result<()> {
    with(|plan| plan.step(false)).unwrap_or(Ok(Room::Enough)).map(drop)
}

/// As [`step`], for a write: the bytes for which there is room.
pub(super) fn write_step(bytes: &[u8]) -> io::Result<&[u8]> {
    Ok(match with(|plan| plan.step(true)).unwrap_or(Ok(Room::Enough))? {
        Room::Enough => bytes,
        Room::Half => &bytes[..bytes.len().div_ceil(2)],
    })
}

/// Registers a file that another program has written since it was [created](super::create). A fault truncates it to
/// half, as a program leaves it that misses the error.
pub(crate) fn foreign(path: &Path) -> io::Result<()> {
    let room = with(|plan| match plan.step(true) {
        Err(_) if !plan.dead => Ok(Room::Half),
        // A short write truncates the file as well; the next operation does not fail.
        room => {
            plan.short = false;
            room
        }
    });
    if let Room::Half = room.unwrap_or(Ok(Room::Enough))? {
        let file = File::options().write(true).open(path)?;
        file.set_len(file.metadata()?.len() / 2)?;
    }
    Ok(())
}

/// The program that encodes videos.
pub(crate) fn ffmpeg() -> PathBuf {
    with(|plan| plan.ffmpeg.clone()).flatten().unwrap_or_else(|| PathBuf::from("ffmpeg"))
}

/// As [`step`], for a change of names, which is recorded before it is made.
pub(super) fn change(change: impl FnOnce() -> Change) -> io::Result<()> {
    with(|plan| {
        plan.step(false)?;
        let change = change();
        match &change {
            Change::Created(path) => {
                plan.files.insert(path.clone(), 0);
            }
            Change::Renamed { from, to, .. } => {
                let unsynced = plan.files.remove(from);
                plan.files.remove(to);
                if let Some(length) = unsynced {
                    plan.files.insert(to.clone(), length);
                }
            }
            Change::Removed { path, .. } => {
                plan.files.remove(path);
            }
            Change::FolderCreated(_) | Change::FolderRemoved(_) => {}
        }
        plan.changes.push(change);
        Ok(())
    })
    .unwrap_or(Ok(()))
}

/// Marks a file's bytes as synced; later writes are not.
pub(super) fn synced(path: &Path) {
    with(|plan| plan.files.insert(path.to_owned(), std::fs::metadata(path).map_or(0, |found| found.len())));
}

/// As [`step`], for a file that is appended to.
pub(super) fn reopen(path: &Path) -> io::Result<()> {
    step()?;
    let length = std::fs::metadata(path)?.len();
    with(|plan| {
        plan.files.entry(path.to_owned()).or_insert(length);
    });
    Ok(())
}

/// Marks a folder's names as synced.
pub(super) fn synced_folder(path: &Path) {
    with(|plan| plan.changes.retain(|change| change.folder() != Some(path)));
}
