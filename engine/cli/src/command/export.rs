//! `export`: writes a scene in a format that viewers read, one file per time, or as one compressed file.

use std::path::{Path, PathBuf};

use serde_json::json;
use streamsplat::fit::Placement;
use streamsplat::formats::{self, FORMATS, Options, SpzVersion};
use streamsplat::open::{self, Opened};
use streamsplat::output::{prepare_folder, write_file};
use streamsplat::scene::{ContainerWriter, Join, Scene};
use streamsplat::stream::{Interval, Snapshot, Workers};

use crate::command::still;
use crate::console::failure::Failure;
use crate::console::opening::{open_along, say_of};
use crate::console::progress::Progress;
use crate::console::{Console, count, say, stop};
use crate::options::args::ExportArgs;
use crate::options::times;
use streamsplat::run::options::Times;

/// A file format of exports.
#[derive(Clone, Copy)]
pub enum Format {
    /// One file per time.
    Still(&'static formats::Format),
    /// One file for a whole scene in time.
    Container,
}

impl Format {
    /// Returns the format of this name; without a name, the format by the output's ending.
    fn asked(name: Option<&str>, out: &Path) -> Result<Format, Failure> {
        let found = match name {
            Some("ssz") => Some(Format::Container),
            Some(name) => FORMATS.iter().find(|format| format.option == name).map(Format::Still),
            None if Format::Container.is_file(out) => Some(Format::Container),
            None => formats::Format::of_name(out).map(Format::Still),
        };
        found.ok_or_else(|| {
            let names: Vec<&str> = FORMATS.iter().map(|format| format.option).collect();
            let expected = format!("expected {} or ssz", names.join(", "));
            Failure::usage(match name {
                Some(name) => format!("--format {name}: {expected}"),
                None => format!("--format: {expected}, or --out as a file of one of them, found {}", out.display()),
            })
        })
    }

    /// Returns the ending of its files' names.
    fn ending(self) -> &'static str {
        match self {
            Format::Still(format) => format.ending,
            Format::Container => "ssz",
        }
    }

    /// Returns the name of the file with the number `index`.
    pub fn file(self, index: usize) -> String {
        format!("{index:06}.{}", self.ending())
    }

    /// Returns true if `path` means one file of this format, not a folder.
    pub fn is_file(self, path: &Path) -> bool {
        let named = match self {
            Format::Still(format) => format.names(path),
            Format::Container => path.extension().is_some_and(|end| end.eq_ignore_ascii_case("ssz")),
        };
        named && !path.is_dir()
    }

    /// Returns the number of a file that an export into a folder has written.
    fn index(self, name: &Path) -> Option<usize> {
        let name = name.to_str()?;
        let index = name.split('.').next()?.parse().ok()?;
        (name == self.file(index)).then_some(index)
    }
}

/// Returns the options of the format's writer.
fn options(args: &ExportArgs, format: Format) -> Result<Options, Failure> {
    let Some(version) = args.spz_version else { return Ok(Options::default()) };
    if !matches!(format, Format::Still(formats::Format { option: "spz", .. })) {
        return Err(Failure::usage(format!("--spz-version {version}: expected --format spz")));
    }
    let spz = match version {
        3 => SpzVersion::V3,
        4 => SpzVersion::V4,
        found => return Err(Failure::usage(format!("--spz-version: expected 3 or 4, found {found}"))),
    };
    Ok(Options { spz })
}

/// Writes one file per time, or one for the whole scene.
pub fn command(args: &ExportArgs, console: &Console) -> Result<(), Failure> {
    console.listen();
    let format = Format::asked(args.format.as_deref(), &args.out)?;
    let asked = args.times.as_ref().map(Times::list);
    times::check_rate(args.fps)?;
    let options = options(args, format)?;
    let workers = args.machine.workers()?;
    let axes = args.reading.axes()?;
    let scene = match open_along(&args.scene, &args.limit.limits(), axes, Some(&workers), console)? {
        Opened::Moving(scene) => scene,
        Opened::Still(file) => {
            refuse_more(args, &format!("{} is a still scene ({})", file.path.display(), file.format))?;
            return still::export(file, format, args, &options, &workers, console);
        }
    };
    let Format::Still(of_time) = format else {
        let limits = args.limit.limits();
        let more = args.more.iter().map(|path| Ok(open::scene_in_time(path, &limits)?));
        let scenes = [Ok(scene)].into_iter().chain(more).collect::<Result<Vec<Scene>, Failure>>()?;
        return container(&scenes, args, &workers, console);
    };
    refuse_more(args, "other formats hold one time")?;
    let due = times::of_scene(&scene, asked.as_deref(), args.fps)?;
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

    let mut progress = Progress::new("files", Some(paths.len()), console);
    let mut current: Option<(usize, Interval)> = None;
    let (mut files, mut bytes, mut dropped, mut noted) = (0, 0, 0, 0);
    for (&(time, place), path) in due.iter().zip(&paths) {
        if console.stop.asked() {
            break;
        }
        let interval = match current.take().filter(|(at, _)| *at == place) {
            Some((_, interval)) => interval,
            None => scene.interval(place)?,
        };
        let snapshot = Snapshot::square(&interval, time, &workers)?;
        let written = (of_time.snapshot)(&snapshot, &options);
        bytes += write_file(path, &written.bytes)?.bytes;
        if !written.notes.is_empty() {
            // Only the first file's notes are printed.
            if noted == 0 {
                say_of(path, &written.notes, console);
            }
            noted += 1;
        }
        files += 1;
        dropped += snapshot.dropped;
        current = Some((place, interval));
        progress.step();
    }
    progress.finish();
    let camera = match &paths[..] {
        [file] if *file == args.out => beside(file),
        _ => args.out.join(CAMERA),
    };
    write_file(&camera, sources_view(&scene.placement())?.as_bytes())?;
    if noted > 1 {
        console.note(&[format!("{}: the like of {}", args.out.display(), count(noted - 1, "more file"))]);
    }
    if !console.quiet {
        let left_out = match dropped {
            0 => String::new(),
            n => format!(", {n} Gaussians left out with numbers that are not finite"),
        };
        say(format!("{}: {}, {bytes} bytes{left_out}", args.out.display(), count(files, "file")))?;
    }
    if files < due.len() { Err(stop::stopped(false)) } else { Ok(()) }
}

/// Name of the camera file in a folder of files of one scene.
const CAMERA: &str = "source.camera.json";
/// Distance of an orthographic camera, in half widths of the picture: all depths are beyond it.
const DISTANCE: f64 = 12.0;

/// Returns the path of the camera file of a single file.
fn beside(file: &Path) -> PathBuf {
    let mut name = file.file_name().unwrap_or_default().to_owned();
    name.push(".camera.json");
    file.with_file_name(name)
}

/// Returns the camera that was exported with a file: its own, else that of its folder.
pub fn camera_of(file: &Path) -> Option<PathBuf> {
    [beside(file), file.with_file_name(CAMERA)].into_iter().find(|path| path.is_file())
}

/// Returns the source's own view in the coordinates of exported files, with the size of its frames.
fn sources_view(placement: &Placement) -> Result<String, Failure> {
    let Placement { source: [height, width], model, offset, content } = *placement;
    let aspect = placement.aspect();
    // Along columns and rows: the content's middle and half its extent.
    let [x, y] = [1, 0].map(|axis| (2 * offset[axis] + content[axis]) as f64 / model[axis] as f64 - 1.0);
    let [right, down] = [1, 0].map(|axis| content[axis] as f64 / model[axis] as f64);
    let camera = json!({
        "type": "orthographic",
        "units": "square",
        "size": [width, height],
        "position": [aspect * x, y, -DISTANCE * aspect],
        "half_extent": [aspect * right, down],
    });
    Ok(serde_json::to_string_pretty(&camera).map_err(Failure::work)? + "\n")
}

/// Relative tolerance for equal frame rates that are computed from frame times.
const ALIKE: f64 = 1e-3;

fn refuse_more(args: &ExportArgs, cause: &str) -> Result<(), Failure> {
    args.more.first().map_or(Ok(()), |more| {
        Err(Failure::usage(format!(
            "{}: expected one scene, or --format ssz for several in time; {cause}",
            more.display()
        )))
    })
}

/// Writes scenes in time, one after another, as one compressed file.
fn container(scenes: &[Scene], args: &ExportArgs, workers: &Workers, console: &Console) -> Result<(), Failure> {
    if args.times.is_some() || args.fps.is_some() {
        return Err(Failure::usage("--times, --fps: expected neither, as --format ssz holds the whole scene"));
    }
    if args.out.is_dir() {
        let message = format!("--out {}: expected a file's name, as --format ssz is one file", args.out.display());
        return Err(Failure::usage(message));
    }
    let fps = scenes.first().map_or(0.0, |scene| scene.index().fps);
    let paths = [&args.scene].into_iter().chain(&args.more);
    if let Some((path, scene)) = paths.zip(scenes).find(|(_, scene)| (scene.index().fps / fps - 1.0).abs() > ALIKE) {
        let found = scene.index().fps;
        return Err(Failure::usage(format!(
            "{}: expected {fps} frames a second as before, found {found}",
            path.display()
        )));
    }
    let entries = || scenes.iter().flat_map(|scene| &scene.index().intervals);
    let mut writer = ContainerWriter::create(&args.out, fps)?;
    let mut progress = Progress::new("intervals", Some(entries().count()), console);
    let mut join = Join::default();
    for scene in scenes {
        for (joined, entry) in join.follow(scene, fps).zip(&scene.index().intervals) {
            if console.stop.asked() {
                let out = args.out.display();
                return Err(Failure::Stopped(format!("{out}: stopped; nothing was written")));
            }
            let (interval, frames) = joined?;
            // An interval lists its frames if its own scene's rate does not imply them; after a join they are at other
            // times.
            let listed = if scenes.len() == 1 { &entry.frames } else { &frames };
            writer.push_with(&interval, listed, workers)?;
            progress.step();
        }
    }
    progress.finish();
    let bytes = writer.finish()?.map_or(0, |written| written.bytes);
    if !console.quiet {
        let of: u64 = entries().map(|entry| entry.bytes).sum();
        let intervals = count(entries().count(), "interval");
        say(format!("{}: {intervals}, {bytes} bytes of {of}", args.out.display()))?;
    }
    Ok(())
}

/// Fails if a longer export has left files in the same folder, because they would be taken for this export's.
pub fn refuse_others(folder: &Path, format: Format, count: usize) -> Result<(), Failure> {
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
