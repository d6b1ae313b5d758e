//! Files that an earlier run left in the same folder.

use std::path::{Path, PathBuf};

use crate::output::{OutputError, partial_name, storage};

use crate::run::outputs::is_inside;
use crate::run::record::Record;
use crate::run::{Error, digest, ledger, resume_state};

/// Finds the files listed by an earlier run in `folder`, complete or stopped, in the order in which
/// [`remove_earlier`] removes them. A listed file counts only if its length and digest are unchanged, and nothing is
/// reached through a link.
pub fn find_earlier(folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let mut found = Vec::new();
    let record = folder.join("run.json");
    // A record that is empty, after a power loss or by hand, lists nothing.
    let emptied = std::fs::symlink_metadata(&record).is_ok_and(|found| found.is_file() && found.len() == 0);
    if storage::exists(&record) && !emptied {
        let earlier = Record::read(&record)
            .map_err(|e| Error::work(format!("{}; the folder holds something else, give another --out", e)))?;
        for (name, output) in &earlier.outputs {
            if is_as_written(folder, name, output.bytes, &output.blake3)? {
                found.push(folder.join(name));
            }
        }
    }
    let lines = ledger::all(&folder.join("resume"));
    for line in &lines {
        if is_as_written(folder, &line.file, line.bytes, &line.blake3)? {
            found.push(folder.join(&line.file));
        }
    }
    if !lines.is_empty() {
        // The index and the file that was being written when the run stopped are not listed.
        let index = Path::new("scene").join(crate::scene::INDEX);
        let names = lines.iter().map(|line| PathBuf::from(&line.file)).chain([index.clone()]);
        let mut files: Vec<PathBuf> = names.map(|name| partial_name(&name)).collect();
        files.push(index);
        found.extend(files.iter().filter(|file| is_file_inside(folder, file)).map(|file| folder.join(file)));
    }
    Ok(found)
}

/// Removes what an earlier run left in `folder`: the files `found`, and then its lists, so that old and new results
/// never mix.
pub fn remove_earlier(folder: &Path, found: &[PathBuf]) -> Result<(), Error> {
    found.iter().try_for_each(|file| remove_file(file))?;
    resume_state::remove(&folder.join("resume"))?;
    // The record goes last, so that an interrupted removal can be completed later.
    [folder.join("report.md"), folder.join("run.json")].iter().try_for_each(|file| remove_file(file))?;
    storage::sync_folder(folder).map_err(|cause| OutputError::Write { path: folder.to_owned(), cause })?;
    Ok(())
}

/// Returns true if the file `name` in `folder` has this length and this digest.
pub fn is_as_written(folder: &Path, name: &str, bytes: u64, blake3: &str) -> Result<bool, Error> {
    if !is_file_inside(folder, Path::new(name)) {
        return Ok(false);
    }
    let path = folder.join(name);
    let length = storage::regular(&path).map_err(|e| Error::work(format!("{}: {e}", path.display())))?.len();
    Ok(length == bytes && digest::file(&path)? == blake3)
}

/// Returns true if `name` is a regular file in `folder` and no part of its path is a symbolic link.
fn is_file_inside(folder: &Path, name: &Path) -> bool {
    let Some(parts) = name.to_str().filter(|name| is_inside(name)).map(|_| name.iter()) else { return false };
    let mut path = folder.to_owned();
    let mut parts = parts.peekable();
    while let Some(part) = parts.next() {
        path.push(part);
        let Ok(found) = std::fs::symlink_metadata(&path) else { return false };
        let fits = if parts.peek().is_some() { found.is_dir() } else { found.is_file() };
        if !fits {
            return false;
        }
    }
    true
}

/// Removes a file, if it exists.
pub fn remove_file(file: &Path) -> Result<(), Error> {
    match storage::remove(file) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => {
            Err(Error::work(format!("{}: cannot remove: {e}", file.display())))
        }
        _ => Ok(()),
    }
}
