//! Readers of scene formats, recognised by content.
//!
//! | input | begins with | becomes |
//! |---|---|---|
//! | the folder of a scene or of a run, a `scene.json` | `{` | a [`Scene`] |
//! | a container (`.ssz`) | `ssplat` | a [`Scene`] |
//! | a still scene in one of the [`FORMATS`], or one that is [`READ_ONLY`] | see these constants | a [`Still`] |
//! | a PLY file of SpacetimeGaussians | `ply`, and its columns | a [`Spacetime`], which is a [`Still`] at any time |
//!
//! `.splat` and `.ksplat` have no magic bytes and are recognised by their file names. For any other file,
//! [`crate::recognise`] names its kind in the error.
//!
//! Before allocating memory for a count in a header, readers check that the file is long enough for it. They also check
//! the [`Limits`] on the number of Gaussians and on the bytes in memory per byte of the file.

mod beside;
mod blocks;
mod formats;
pub(crate) mod gltf;
mod ksplat;
mod limits;
mod lod;
pub(crate) mod ply;
pub(crate) mod sog;
mod spacetime;
mod splat;
pub(crate) mod spz;

use std::borrow::Cow;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

pub(crate) use beside::Beside;
pub use blocks::Progress;
use blocks::{Blocks, ReadError};
use formats::Reader;
pub use formats::{FORMATS, Format, READ_ONLY, ReadOnly};
pub use gltf::glb;
pub use ksplat::ksplat;
pub(crate) use limits::read_file;
pub use limits::{GAUSSIANS, Limits, RATIO, SMALL, read_text};
pub use lod::{Plan as LevelPlan, plan as level_plan};
use ply::MAX_HEADER;
pub(crate) use ply::packed;
pub use ply::ply;
pub use sog::sog;
pub use spacetime::{Spacetime, spacetime};
pub use splat::splat;
pub use spz::spz;

use crate::recognise;
use crate::scene::{self, Scene, SceneError};
use crate::still::{Axes, Still};

/// Error in the content of a file.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{part}: expected {expected}, found {found}")]
pub struct FormatError {
    /// The property or the part of the file.
    pub part: String,
    /// Expected value.
    pub expected: String,
    /// Value found.
    pub found: String,
}

impl FormatError {
    pub(crate) fn new(part: impl Into<String>, expected: impl Into<String>, found: impl Into<String>) -> Self {
        Self { part: part.into(), expected: expected.into(), found: found.into() }
    }
}

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

/// Maximum size of a still scene's file, in bytes.
pub(crate) const MAX_FILE: u64 = 16 << 30;

/// Number of first bytes by which formats are recognised.
const HEAD: u64 = 8;

/// Returns the name and the reader of the format of a still scene with these first bytes.
fn format(path: &Path, head: &[u8]) -> Option<(&'static str, &'static dyn Reader)> {
    let only = READ_ONLY.iter().find(|format| format.reader.is(path, head)).map(|format| (format.name, format.reader));
    only.or_else(|| {
        FORMATS.iter().find(|format| format.reader.is(path, head)).map(|format| (format.name, format.reader))
    })
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
/// Those of [`open`]; a still scene.
pub fn open_moving(path: &Path, limits: &Limits) -> Result<Scene, SceneError> {
    match open(path, limits)? {
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

/// Reads a still scene from memory. The format is recognised by content; `.splat` and `.ksplat` have no magic bytes and
/// are recognised by the ending of `name`, which may be empty otherwise. Files of SpacetimeGaussians are read at time
/// 0.
///
/// # Errors
/// Bytes of an unknown format, broken content, more than the limits allow, and formats whose scene is in several files.
pub fn read(bytes: &[u8], name: &str, limits: &Limits) -> Result<Still, FormatError> {
    let head = &bytes[..bytes.len().min(HEAD as usize)];
    let Some((_, reader)) = format(Path::new(name), head) else {
        let names: Vec<&str> =
            FORMATS.iter().map(|format| format.name).chain(READ_ONLY.iter().map(|format| format.name)).collect();
        let expected = format!("a still scene ({})", names.join(", "));
        let start: Vec<String> = head.iter().map(|byte| format!("{byte:02x}")).collect();
        let found = format!("{} bytes that begin with [{}]", bytes.len(), start.join(" "));
        return Err(FormatError::new("scene in memory", expected, found));
    };
    if spacetime::is(&bytes[..bytes.len().min(MAX_HEADER)]) {
        return Ok(spacetime(bytes, limits)?.at(0.0));
    }
    reader.read(bytes, &Beside::none(), limits)
}

/// Opens a scene of any kind.
///
/// # Errors
/// A file or a folder that cannot be read, is not a scene, is broken, or exceeds the limits.
pub fn open(path: &Path, limits: &Limits) -> Result<Opened, SceneError> {
    open_with(path, limits, &mut |_, _| {})
}

/// Opens a scene as [`open_as`] does, along the axes stored in the file or, without them, those of its format.
///
/// # Errors
/// As [`open`].
pub fn open_with(path: &Path, limits: &Limits, progress: Progress<'_>) -> Result<Opened, SceneError> {
    open_as(path, limits, None, progress)
}

/// Opens a scene as [`open`] does, on the current rayon pool. `progress` is called with the number of bytes read of a
/// long file. `axes` overrides the axes of a still scene's file.
///
/// A binary PLY file is read in blocks of some megabytes: the next block is read while the last one is decoded. Memory
/// never holds the whole file, nor two copies of a number.
///
/// # Errors
/// As [`open`].
pub fn open_as(path: &Path, limits: &Limits, axes: Option<Axes>, progress: Progress<'_>) -> Result<Opened, SceneError> {
    // The images of a SOG scene and the levels of a streamed one may also be opened by their folder.
    let index = recognise::index(path).filter(|_| path.is_dir() && !path.join(scene::INDEX).exists());
    let path = index.as_deref().unwrap_or(path);
    if let Some(wrong) = recognise::not_a_scene(path) {
        return Err(SceneError::Broken { path: path.to_owned(), cause: wrong.to_string() });
    }
    if path.is_dir() {
        return Scene::open_within(path, limits).map(Opened::Moving);
    }
    let read = |cause| SceneError::Read { path: path.to_owned(), cause };
    let mut head = Vec::new();
    File::open(path).map_err(read)?.take(MAX_HEADER as u64).read_to_end(&mut head).map_err(read)?;
    let Some((name, reader)) = format(path, &head[..head.len().min(HEAD as usize)]) else {
        return Scene::open_within(path, limits).map(Opened::Moving);
    };
    let broken = |e: FormatError| SceneError::Broken { path: path.to_owned(), cause: e.to_string() };
    if limits.level > 0 && name != lod::NAME {
        return Err(broken(FormatError::new("level of detail", "a streamed SOG scene, for a level above 0", name)));
    }
    let opened = |mut still: Still, (bytes, blake3)| {
        // Files inside others were already read along these axes.
        if let Some(axes) = axes.filter(|axes| still.about.axes_assumed || still.about.axes != *axes) {
            still.taken_along(axes);
        }
        let notes = ply::left_out(&head).into_iter().collect();
        StillFile { path: path.to_owned(), format: name, bytes, blake3, still, in_time: None, notes }
    };
    if spacetime::is(&head) {
        let bytes = read_file(path, MAX_FILE).map_err(read)?;
        let scene = spacetime(&bytes, limits).map_err(broken)?;
        let file = opened(scene.at(0.0), Beside::of(path, &bytes, axes).finish(bytes.len()));
        let notes = [vec![scene.about()], scene.notes().to_vec()].concat();
        return Ok(Opened::Still(StillFile { format: spacetime::NAME, in_time: Some(scene), notes, ..file }));
    }
    let file = File::open(path).map_err(read)?;
    let about = file.metadata().map_err(read)?;
    // Devices and pipes have no length.
    if about.is_file() && about.len() <= MAX_FILE {
        let mut blocks = Blocks::new(file, about.len(), progress);
        match reader.read_blocks(&mut blocks, limits) {
            Ok(Some(still)) => return Ok(Opened::Still(opened(still, blocks.finish()))),
            Ok(None) => {}
            Err(ReadError::File(e)) => return Err(read(e)),
            Err(ReadError::Format(e)) => return Err(broken(e)),
        }
    }
    let bytes = read_file(path, MAX_FILE).map_err(read)?;
    let beside = Beside::of(path, &bytes, axes);
    let still = reader.read(&bytes, &beside, limits).map_err(broken)?;
    Ok(Opened::Still(opened(still, beside.finish(bytes.len()))))
}
