//! What an earlier run left in the same folder.

use std::path::{Path, PathBuf};

use streamsplat::output::partial_name;

use super::failure::Failure;
use super::outputs::is_inside;
use super::record::Record;
use super::resume::{self, ledger};

/// Removes the files that an earlier run in `folder` tells of, whole or stopped, and what tells of them, so that old and new results
/// never mix.
pub fn remove_earlier(folder: &Path) -> Result<(), Failure> {
    let record = folder.join("run.json");
    if record.exists() {
        let earlier = Record::read(&record).map_err(|e| {
            Failure::work(format!("{}; the folder holds something else, give another --out", e.message()))
        })?;
        let names = earlier.outputs.keys().filter(|name| is_inside(name));
        names.map(|name| folder.join(name)).try_for_each(|file| remove_file(&file))?;
    }
    let resume = folder.join("resume");
    let names = ledger::names(&resume);
    if !names.is_empty() {
        // The index and whatever was being written when the run was stopped have no line.
        let index = Path::new("scene").join(streamsplat::scene::INDEX);
        for file in names.iter().map(PathBuf::from).chain([index]).map(|name| folder.join(name)) {
            remove_file(&partial_name(&file))?;
            remove_file(&file)?;
        }
    }
    resume::remove(&resume)?;
    // The record goes last: what is stopped halfway can be cleared later.
    [folder.join("report.md"), record].iter().try_for_each(|file| remove_file(file))
}

/// Removes a file, if it is there.
pub fn remove_file(file: &Path) -> Result<(), Failure> {
    match std::fs::remove_file(file) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => {
            Err(Failure::work(format!("{}: cannot remove: {e}", file.display())))
        }
        _ => Ok(()),
    }
}
