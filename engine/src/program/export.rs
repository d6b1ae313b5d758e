//! `export`: a scene in a format that viewers read, one file per time.

use std::path::{Path, PathBuf};

use streamsplat::export;
use streamsplat::output::{prepare_folder, write_file};
use streamsplat::render::Snapshot;
use streamsplat::scene::Scene;
use streamsplat::stream::Interval;

use super::cli::{Console, ExportArgs};
use super::failure::Failure;
use super::progress::Progress;
use super::{say, settings, stop, times};

/// A format of files.
#[derive(Clone, Copy)]
struct Format {
    /// What the option calls it, and how its files' names end.
    name: &'static str,
    write: fn(&Snapshot) -> Vec<u8>,
}

const FORMATS: [Format; 2] =
    [Format { name: "ply", write: export::ply }, Format { name: "splat", write: export::splat }];

impl Format {
    fn named(name: &str) -> Result<Format, Failure> {
        if name == "spz" {
            return Err(Failure::usage("--format spz is not available in this build; give ply or splat"));
        }
        FORMATS
            .into_iter()
            .find(|format| format.name == name)
            .ok_or_else(|| Failure::usage(format!("--format {name}: expected ply or splat")))
    }

    /// The name of the file with the number `index`.
    fn file(self, index: usize) -> String {
        format!("{index:06}.{}", self.name)
    }

    /// Whether `path` is meant as one file of this format.
    fn is_file(self, path: &Path) -> bool {
        path.extension().is_some_and(|end| end.eq_ignore_ascii_case(self.name)) && !path.is_dir()
    }

    /// The number of a file that an export into a folder has written.
    fn index(self, name: &Path) -> Option<usize> {
        let index = name.file_stem()?.to_str()?.parse().ok()?;
        (name.to_str() == Some(&self.file(index))).then_some(index)
    }
}

/// Writes one file per time.
pub fn command(args: &ExportArgs, console: &Console) -> Result<(), Failure> {
    stop::listen();
    let format = Format::named(&args.format)?;
    let asked = args.times.as_deref().map(settings::times).transpose()?;
    times::check_rate(args.fps)?;
    let workers = args.machine.workers()?;
    let scene = Scene::open(&args.scene)?;
    let due = times::of_scene(&scene, asked.as_deref(), args.fps.unwrap_or(scene.index().fps))?;
    let paths: Vec<PathBuf> = if format.is_file(&args.out) {
        if due.len() != 1 {
            let (out, found) = (args.out.display(), due.len());
            let message =
                format!("--out {out}: expected one time for one file, found {found}; give --times or a folder");
            return Err(Failure::usage(message));
        }
        vec![args.out.clone()]
    } else {
        prepare_folder(&args.out)?;
        refuse_others(&args.out, format, due.len())?;
        (0..due.len()).map(|index| args.out.join(format.file(index))).collect()
    };

    let mut progress = Progress::new("files", Some(paths.len()), console.quiet);
    let mut current: Option<(usize, Interval)> = None;
    let (mut files, mut bytes, mut dropped) = (0, 0, 0);
    for (&(time, place), path) in due.iter().zip(&paths) {
        if stop::asked() {
            break;
        }
        let interval = match current.take().filter(|(at, _)| *at == place) {
            Some((_, interval)) => interval,
            None => scene.interval(place, &workers)?,
        };
        let snapshot = Snapshot::of(&interval, time)?;
        bytes += write_file(path, &(format.write)(&snapshot))?.bytes;
        files += 1;
        dropped += snapshot.dropped;
        current = Some((place, interval));
        progress.step();
    }
    progress.finish();
    if !console.quiet {
        let stopped = if files < due.len() { ", stopped by the user" } else { "" };
        let left_out = match dropped {
            0 => String::new(),
            n => format!(", {n} Gaussians left out with numbers that are not finite"),
        };
        say(format!("{}: {files} files, {bytes} bytes{left_out}{stopped}", args.out.display()));
    }
    Ok(())
}

/// Files of a longer export in the same folder would pass for this one's.
fn refuse_others(folder: &Path, format: Format, count: usize) -> Result<(), Failure> {
    let unreadable = |e| Failure::work(format!("{}: {e}", folder.display()));
    for entry in std::fs::read_dir(folder).map_err(unreadable)? {
        let name = entry.map_err(unreadable)?.file_name();
        if format.index(Path::new(&name)).is_some_and(|index| index >= count) {
            let file = folder.join(name);
            let message = format!("{}: another export's file is in the way; give another --out", file.display());
            return Err(Failure::work(message));
        }
    }
    Ok(())
}
