//! Where results go: a folder, a video file, or standard output.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Component, Path, PathBuf};

use streamsplat::Image;
use streamsplat::export;
use streamsplat::output::{
    OutputError, Video, VideoFormat, Written, depth_exr, picture_png, plane_png, prepare_folder, write_file,
};
use streamsplat::picture::Picture;
use streamsplat::render::Snapshot;
use streamsplat::scene::SceneWriter;
use streamsplat::stream::Interval;

use super::failure::Failure;
use super::record::{OutputRecord, Record};

/// Kinds of output that exist.
const KINDS: [&str; 5] = ["rgb", "depth", "alpha", "scene", "ply"];

/// What `--emit` asks for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Emit {
    /// Colour images or video.
    pub rgb: bool,
    /// Depth images.
    pub depth: bool,
    /// Alpha images.
    pub alpha: bool,
    /// The scene.
    pub scene: bool,
    /// The Gaussians at each time as PLY files.
    pub ply: bool,
}

impl Emit {
    /// Reads a list; `allowed` are the kinds the command knows.
    pub fn parse(list: &str, allowed: &[&str]) -> Result<Emit, Failure> {
        let kinds: BTreeSet<&str> = list.split(',').map(str::trim).collect();
        for kind in &kinds {
            if *kind == "tracks" {
                return Err(Failure::usage(format!("--emit {kind} is not available in this build")));
            }
            if !allowed.contains(kind) || !KINDS.contains(kind) {
                return Err(Failure::usage(format!(
                    "--emit {list}: expected a list of {}, found {kind:?}",
                    allowed.join(", ")
                )));
            }
        }
        let has = |kind| kinds.contains(kind);
        let [rgb, depth, alpha, scene, ply] = KINDS.map(has);
        Ok(Emit { rgb, depth, alpha, scene, ply })
    }

    /// Whether anything is drawn.
    pub fn draws(&self) -> bool {
        self.rgb || self.depth || self.alpha
    }
}

/// Where `--out` points.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Destination {
    /// A folder.
    Folder(PathBuf),
    /// A video file, or `-`.
    Video(PathBuf, VideoFormat),
}

impl Destination {
    /// A path with a video's name is a video, `-` is y4m on standard output, anything else a folder.
    pub fn of(out: &Path) -> Destination {
        if out == Path::new("-") {
            return Destination::Video(out.to_owned(), VideoFormat::Y4m);
        }
        match VideoFormat::of(out) {
            Some(format) if !out.is_dir() => Destination::Video(out.to_owned(), format),
            _ => Destination::Folder(out.to_owned()),
        }
    }

    /// Where the record of the run goes; `None` for standard output.
    pub fn record(&self) -> Option<PathBuf> {
        match self {
            Destination::Folder(folder) => Some(folder.join("run.json")),
            Destination::Video(path, _) if path == Path::new("-") => None,
            Destination::Video(path, _) => {
                let mut name = path.file_name().unwrap_or_default().to_owned();
                name.push(".run.json");
                Some(path.with_file_name(name))
            }
        }
    }
}

/// Writes results and remembers their digests.
pub struct Outputs {
    destination: Destination,
    emit: Emit,
    fps: f64,
    video: Option<Video>,
    scene: Option<SceneWriter>,
    written: BTreeMap<String, OutputRecord>,
}

impl Outputs {
    /// Prepares the place: what an earlier run wrote there is removed, and an unwritable place is an error before any work.
    pub fn create(destination: Destination, emit: Emit) -> Result<Outputs, Failure> {
        match &destination {
            Destination::Folder(folder) => {
                prepare_folder(folder)?;
                remove_earlier(folder)?;
                let kinds = [(emit.rgb, "frames"), (emit.depth, "depth"), (emit.alpha, "alpha"), (emit.ply, "ply")];
                for (_, name) in kinds.into_iter().filter(|(wanted, _)| *wanted) {
                    prepare_folder(&folder.join(name))?;
                }
            }
            Destination::Video(path, format) => {
                if emit.depth || emit.alpha || emit.scene || emit.ply {
                    return Err(Failure::usage("--emit: a video holds rgb alone; give --out a folder for the rest"));
                }
                drop(Video::create(path, *format, 1.0)?);
            }
        }
        Ok(Outputs { destination, emit, fps: 0.0, video: None, scene: None, written: BTreeMap::new() })
    }

    /// Opens what needs the frame rate.
    pub fn start(&mut self, fps: f64) -> Result<(), Failure> {
        self.fps = fps;
        match &self.destination {
            Destination::Folder(folder) if self.emit.scene => {
                self.scene = Some(SceneWriter::create(&folder.join("scene"), fps)?);
            }
            Destination::Folder(_) => {}
            Destination::Video(path, format) => self.video = Some(Video::create(path, *format, fps)?),
        }
        Ok(())
    }

    fn note(&mut self, name: String, written: Written) {
        let Written { bytes, blake3 } = written;
        self.written.insert(name, OutputRecord { bytes, blake3, samples: None });
    }

    /// Writes an interval of the scene, if the scene is wanted.
    pub fn interval(&mut self, interval: &Interval) -> Result<(), Failure> {
        if let Some(scene) = &mut self.scene {
            let (name, written) = scene.push(interval)?;
            self.note(format!("scene/{name}"), written);
        }
        Ok(())
    }

    /// Writes an image under the number `index`.
    pub fn image(&mut self, index: usize, image: Image) -> Result<(), Failure> {
        let Image { width, height, rgb, depth, alpha, .. } = image;
        let picture = Picture { width, height, rgb };
        if let Some(video) = &mut self.video {
            return Ok(video.push(&picture)?);
        }
        let Destination::Folder(folder) = self.destination.clone() else { return Ok(()) };
        let emit = self.emit;
        let mut write = |name: String, bytes: &[u8]| -> Result<(), OutputError> {
            let written = write_file(&folder.join(&name), bytes)?;
            self.note(name, written);
            Ok(())
        };
        if emit.rgb {
            write(format!("frames/{index:06}.png"), &picture_png(&picture))?;
        }
        if emit.depth
            && let Some(depth) = &depth
        {
            let bytes = depth_exr(width, height, depth, alpha.as_deref()).map_err(Failure::work)?;
            write(format!("depth/{index:06}.exr"), &bytes)?;
        }
        if emit.alpha
            && let Some(alpha) = &alpha
        {
            write(format!("alpha/{index:06}.png"), &plane_png(width, height, alpha))?;
        }
        Ok(())
    }

    /// Writes the Gaussians of one time under the number `index`.
    pub fn snapshot(&mut self, index: usize, snapshot: &Snapshot) -> Result<(), Failure> {
        let Destination::Folder(folder) = &self.destination else { return Ok(()) };
        let name = format!("ply/{index:06}.ply");
        let written = write_file(&folder.join(&name), &export::ply(snapshot))?;
        self.note(name, written);
        Ok(())
    }

    /// After a failure: completes the scene of the intervals that were written. A video is not kept.
    pub fn abandon(mut self) {
        if let Some(scene) = self.scene.take() {
            // The first failure is the one to tell.
            let _ = scene.finish();
        }
    }

    /// Completes scene and video; gives every file's record.
    pub fn finish(mut self) -> Result<BTreeMap<String, OutputRecord>, Failure> {
        if let Some(scene) = self.scene.take()
            && let Some((name, written)) = scene.finish()?
        {
            self.note(format!("scene/{name}"), written);
        }
        if let Some(video) = self.video.take() {
            let finished = video.finish()?;
            let name = match &self.destination {
                Destination::Video(path, _) => {
                    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
                }
                Destination::Folder(_) => String::new(),
            };
            let Written { bytes, blake3 } =
                finished.file.unwrap_or(Written { bytes: 0, blake3: finished.samples.clone() });
            self.written.insert(name, OutputRecord { bytes, blake3, samples: Some(finished.samples) });
        }
        Ok(self.written)
    }
}

/// Whether `name` stays inside the folder it is joined to.
pub fn is_inside(name: &str) -> bool {
    !name.is_empty() && Path::new(name).components().all(|c| matches!(c, Component::Normal(_)))
}

/// Removes the files that an earlier run's record in `folder` names, and the record, so that old and new results never mix.
fn remove_earlier(folder: &Path) -> Result<(), Failure> {
    let record = folder.join("run.json");
    if !record.exists() {
        return Ok(());
    }
    let earlier = Record::read(&record)
        .map_err(|e| Failure::work(format!("{}; the folder holds something else, give another --out", e.message())))?;
    let mut names: Vec<&str> = earlier.outputs.keys().map(String::as_str).filter(|name| is_inside(name)).collect();
    names.extend(["report.md", "run.json"]);
    // The record goes last: what is stopped halfway can be cleared later.
    for name in names {
        match std::fs::remove_file(folder.join(name)) {
            Err(e) if e.kind() != std::io::ErrorKind::NotFound => {
                return Err(Failure::work(format!("{}: cannot remove: {e}", folder.join(name).display())));
            }
            _ => {}
        }
    }
    Ok(())
}
