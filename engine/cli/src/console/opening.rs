//! Opening of scenes, with progress for large files.

use std::path::Path;

use streamsplat::formats::Limits;
use streamsplat::open::{self, Opened};
use streamsplat::still::Axes;
use streamsplat::stream::Workers;

use crate::console::Console;
use crate::console::failure::Failure;
use crate::console::progress::Progress;

/// File size from which progress is shown, in bytes.
const LONG: u64 = 1 << 26;
/// Bytes per counted unit.
const MEGABYTE: u64 = 1_000_000;

/// Opens a scene of any kind with `workers`; the default is a thread per processor. `axes` overrides the axes of a
/// still scene. Prints notes on content that was left out or assumed.
pub fn open_along(
    path: &Path,
    limits: &Limits,
    axes: Option<Axes>,
    workers: Option<&Workers>,
    console: &Console,
) -> Result<Opened, Failure> {
    let mut progress = None;
    let mut show = |done: u64, total: u64| {
        if total >= LONG {
            let megabytes = total.div_ceil(MEGABYTE) as usize;
            let progress = progress.get_or_insert_with(|| Progress::new("MB read", Some(megabytes), console));
            progress.reach(done.div_ceil(MEGABYTE) as usize);
        }
    };
    let opened = match workers {
        Some(workers) => workers.install(|| open::scene_along(path, limits, axes, &mut show)),
        None => open::scene_along(path, limits, axes, &mut show),
    }?;
    match &opened {
        Opened::Still(file) => {
            let about = &file.still.about;
            say_of(path, &file.notes, console);
            say_of(path, &about.lines(), console);
            if about.offset != [0.0; 3] {
                let [x, y, z] = about.offset;
                say_of(path, &[format!("coordinates are kept relative to ({x}, {y}, {z})")], console);
            }
        }
        Opened::Moving(_) if axes.is_some() => {
            return Err(Failure::usage(format!("--axes: expected none, as {} is a scene in time", path.display())));
        }
        Opened::Moving(_) => {}
    }
    Ok(opened)
}

/// Prints notes about a file.
pub fn say_of(path: &Path, lines: &[String], console: &Console) {
    let lines: Vec<String> = lines.iter().map(|line| format!("{}: {line}", path.display())).collect();
    console.note(&lines);
}
