//! Scenes of any kind, in time or still, recognised by content.
//!
//! | input | begins with | becomes |
//! |---|---|---|
//! | the folder of a scene or of a run, a `scene.json` | `{` | a [`Scene`] |
//! | a container (`.ssz`) | `ssplat` | a [`Scene`] |
//! | a still scene in one of the [`formats`] | see [`FORMATS`](formats::FORMATS) | a [`StillFile`] |
//!
//! For any other file, [`crate::recognise`] names its kind in the error.

use std::borrow::Cow;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use crate::formats::ply::MAX_HEADER;
use crate::formats::spacetime::{self, Spacetime};
use crate::formats::{
    self, Beside, Blocks, FormatError, HEAD, Limits, MAX_FILE, Progress, ReadError, format, read_file,
};
use crate::recognise;
use crate::scene::{self, Scene, SceneError};
use crate::still::{Axes, Still};

/// An opened scene.
#[derive(Debug)]
#[expect(clippy::large_enum_variant, reason = "one value for a file, taken apart where it is made")]
pub enum Opened {
    /// A moving scene, whose intervals are read on demand.
    Moving(Scene),
    /// A still scene, read as a whole.
    Still(StillFile),
}

/// A still scene and its file.
#[derive(Debug)]
pub struct StillFile {
    /// The file.
    pub path: PathBuf,
    /// Its format's name.
    pub format: &'static str,
    /// Total length of the file and of the files that it names.
    pub bytes: u64,
    /// BLAKE3 digest, in hexadecimal, of the bytes of the file and of the files that it names, in reading order.
    pub blake3: String,
    /// Its Gaussians; those at time 0 if they change over time.
    pub still: Still,
    /// Its Gaussians at every time, if they change over time.
    pub in_time: Option<Spacetime>,
    /// Notes on content that is left out or assumed.
    pub notes: Vec<String>,
}

impl StillFile {
    /// Returns the Gaussians at a time.
    pub fn at(&self, time: f64) -> Cow<'_, Still> {
        self.in_time.as_ref().map_or(Cow::Borrowed(&self.still), |scene| Cow::Owned(scene.at(time)))
    }
}

/// Returns true if a file begins as one of the formats that store a scene in one file.
pub fn is_scene(path: &Path) -> bool {
    let mut head = Vec::new();
    let read = File::open(path).and_then(|file| file.take(HEAD).read_to_end(&mut head));
    read.is_ok() && (format(path, &head).is_some() || head.starts_with(&scene::MAGIC))
}

/// Opens a moving scene.
///
/// # Errors
/// Those of [`scene()`]; a still scene.
pub fn scene_in_time(path: &Path, limits: &Limits) -> Result<Scene, SceneError> {
    match scene(path, limits)? {
        Opened::Moving(scene) => Ok(scene),
        Opened::Still(file) => {
            let cause = format!(
                "expected a scene in time, found a still one ({}), in which nothing moves and nothing has an identity",
                file.format
            );
            Err(SceneError::Broken { path: file.path, cause })
        }
    }
}

/// Opens a scene of any kind.
///
/// # Errors
/// A file or a folder that cannot be read, is not a scene, is broken, or exceeds the limits.
pub fn scene(path: &Path, limits: &Limits) -> Result<Opened, SceneError> {
    scene_with(path, limits, &mut |_, _| {})
}

/// Opens a scene as [`scene_along`] does, along the axes stored in the file or, without them, those of its format.
///
/// # Errors
/// As [`scene()`].
pub fn scene_with(path: &Path, limits: &Limits, progress: Progress<'_>) -> Result<Opened, SceneError> {
    scene_along(path, limits, None, progress)
}

/// Opens a scene as [`scene()`] does, on the current rayon pool. `progress` is called with the number of bytes read of
/// a long file. `axes` overrides the axes of a still scene's file.
///
/// A binary PLY file is read in blocks of some megabytes: the next block is read while the last one is decoded. Memory
/// never holds the whole file, nor two copies of a number.
///
/// # Errors
/// As [`scene()`].
pub fn scene_along(
    path: &Path,
    limits: &Limits,
    axes: Option<Axes>,
    progress: Progress<'_>,
) -> Result<Opened, SceneError> {
    // The images of a SOG scene and the levels of a streamed one may also be opened by their folder.
    let index = recognise::index(path).filter(|_| path.is_dir() && !path.join(scene::INDEX).exists());
    let path = index.as_deref().unwrap_or(path);
    if let Some(wrong) = recognise::not_a_scene(path) {
        return Err(SceneError::Broken { path: path.to_owned(), cause: wrong.to_string() });
    }
    let broken = |e: FormatError| SceneError::Broken { path: path.to_owned(), cause: e.to_string() };
    let levels = |found: &str| match limits.level {
        1.. if found != formats::lod::NAME => {
            Err(broken(FormatError::new("level of detail", "a streamed SOG scene, for a level above 0", found)))
        }
        _ => Ok(()),
    };
    let moving = || levels("a scene in time").and_then(|()| Scene::open_within(path, limits).map(Opened::Moving));
    if path.is_dir() {
        return moving();
    }
    let read = |cause| SceneError::Read { path: path.to_owned(), cause };
    let mut head = Vec::new();
    File::open(path).map_err(read)?.take(MAX_HEADER as u64).read_to_end(&mut head).map_err(read)?;
    let Some((name, reader)) = format(path, &head[..head.len().min(HEAD as usize)]) else {
        return moving();
    };
    levels(name)?;
    let opened = |mut still: Still, (bytes, blake3)| {
        // Files inside others were already read along these axes.
        if let Some(axes) = axes.filter(|axes| still.about.axes_assumed || still.about.axes != *axes) {
            still.taken_along(axes);
        }
        let notes = formats::ply::left_out(&head).into_iter().collect();
        StillFile { path: path.to_owned(), format: name, bytes, blake3, still, in_time: None, notes }
    };
    if spacetime::is(&head) {
        let bytes = read_file(path, MAX_FILE).map_err(read)?;
        let scene = spacetime::read(&bytes, limits).map_err(broken)?;
        let file = opened(scene.at(0.0), Beside::of(path, &bytes, axes).finish(bytes.len()));
        let notes = [vec![scene.about()], scene.notes().to_vec()].concat();
        return Ok(Opened::Still(StillFile { format: spacetime::NAME, in_time: Some(scene), notes, ..file }));
    }
    let file = File::open(path).map_err(read)?;
    let about = file.metadata().map_err(read)?;
    // Devices and pipes have no length.
    if about.is_file() && about.len() <= MAX_FILE {
        let mut blocks = Blocks::new(file, about.len(), progress);
        match (reader.blocks)(&mut blocks, limits) {
            Ok(Some(still)) => return Ok(Opened::Still(opened(still, blocks.finish()))),
            Ok(None) => {}
            Err(ReadError::File(e)) => return Err(read(e)),
            Err(ReadError::Format(e)) => return Err(broken(e)),
        }
    }
    let bytes = read_file(path, MAX_FILE).map_err(read)?;
    let beside = Beside::of(path, &bytes, axes);
    let still = (reader.whole)(&bytes, &beside, limits).map_err(broken)?;
    Ok(Opened::Still(opened(still, beside.finish(bytes.len()))))
}

impl Still {
    /// Opens a file in one of the supported [`formats`]; for Gaussians that change in time, at time 0.
    ///
    /// # Errors
    /// A file that cannot be read, has other content, is broken, or exceeds the default [`Limits`]; a scene in time.
    pub fn open(path: impl AsRef<Path>) -> Result<Still, SceneError> {
        match scene(path.as_ref(), &Limits::default())? {
            Opened::Still(file) => Ok(file.still),
            Opened::Moving(_) => Err(SceneError::Broken {
                path: path.as_ref().to_owned(),
                cause: "expected a still scene, found a scene in time (streamsplat::scene reads it)".to_owned(),
            }),
        }
    }
}
