//! Opening scenes, with progress where that takes long.

use std::path::Path;

use streamsplat::import::{self, Limits, Opened};
use streamsplat::stream::Workers;

use crate::console::Console;
use crate::console::failure::Failure;
use crate::console::progress::Progress;

/// Bytes of a file whose reading is shown.
const LONG: u64 = 1 << 26;
/// Bytes of what is counted.
const MEGABYTE: u64 = 1_000_000;

/// A scene of any kind, read by `workers`; without them, by a thread per processor.
pub fn open(path: &Path, limits: &Limits, workers: Option<&Workers>, console: &Console) -> Result<Opened, Failure> {
    let mut progress = None;
    let mut show = |done: u64, total: u64| {
        if total >= LONG {
            let megabytes = total.div_ceil(MEGABYTE) as usize;
            let progress = progress.get_or_insert_with(|| Progress::shown("MB read", Some(megabytes), console));
            progress.reach(done.div_ceil(MEGABYTE) as usize);
        }
    };
    let opened = match workers {
        Some(workers) => workers.install(|| import::open_with(path, limits, &mut show)),
        None => import::open_with(path, limits, &mut show),
    }?;
    if let Opened::Still(file) = &opened {
        let lines: Vec<String> = file.notes.iter().map(|line| format!("{}: {line}", path.display())).collect();
        console.note(&lines);
    }
    Ok(opened)
}
