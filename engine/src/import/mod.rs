//! Scenes of any kind this program reads, told apart by what they hold.
//!
//! | input | begins with | becomes |
//! |---|---|---|
//! | the folder of a scene or of a run, a `scene.json` | `{` | a [`Scene`] |
//! | a container (`.ssz`) | `ssplat` | a [`Scene`] |
//! | a still scene in one of the [`FORMATS`] | see there | a [`Still`] |
//!
//! `.splat` alone has no first bytes of its own and is known by its name.
//!
//! Nothing is allocated for what a header promises before the file is seen to be long enough to hold it, and before it is seen to be within the
//! [`Limits`]: so many Gaussians, and so many bytes in memory for each byte of the file.

mod beside;
mod blocks;
mod formats;
pub(crate) mod gltf;
mod limits;
mod ply;
pub(crate) mod sog;
mod splat;
mod spz;

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

pub(crate) use beside::Beside;
pub use blocks::Progress;
use blocks::{Blocks, ReadError};
pub use formats::{FORMATS, Format};
pub use gltf::glb;
pub use limits::{GAUSSIANS, Limits, RATIO, SMALL, read_file, read_text};
pub(crate) use ply::packed;
pub use ply::ply;
pub use sog::sog;
pub use splat::splat;
pub use spz::spz;

use crate::scene::{self, Scene, SceneError};
use crate::still::Still;

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

/// A scene that has been opened.
#[derive(Debug)]
pub enum Opened {
    /// One made of intervals, which are read when asked for.
    Moving(Scene),
    /// One that does not move, as a whole.
    Still(StillFile),
}

/// A still scene and the file it is from.
#[derive(Debug)]
pub struct StillFile {
    /// The file.
    pub path: PathBuf,
    /// Its format's name.
    pub format: &'static str,
    /// Its length, with those of the files beside it that it names.
    pub bytes: u64,
    /// The BLAKE3 digest, in hexadecimal, of its bytes and of those of the files beside it, in the order in which they were read.
    pub blake3: String,
    /// Its Gaussians.
    pub still: Still,
}

/// Longest still scene read, in bytes.
const MAX_FILE: u64 = 16 << 30;

/// First bytes by which formats are told apart.
const HEAD: u64 = 8;

/// The format of a still scene that begins so.
fn format(path: &Path, head: &[u8]) -> Option<&'static Format> {
    FORMATS.iter().find(|format| format.reader.is(path, head))
}

/// Returns true if a file begins as one of the formats that are a scene in one file.
pub fn is_scene(path: &Path) -> bool {
    let mut head = Vec::new();
    let read = File::open(path).and_then(|file| file.take(HEAD).read_to_end(&mut head));
    read.is_ok() && (format(path, &head).is_some() || head.starts_with(&scene::MAGIC))
}

/// Opens a scene in time.
///
/// # Errors
/// As [`open`], and a still scene.
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

/// Opens a scene of any kind.
///
/// # Errors
/// A file or a folder that cannot be read, or holds something else, something broken, or more than the limits allow.
pub fn open(path: &Path, limits: &Limits) -> Result<Opened, SceneError> {
    open_with(path, limits, &mut |_, _| {})
}

/// As [`open`], on the current rayon pool. `progress` is told how much of a long file has been read.
///
/// A binary PLY file is read in blocks of some megabytes: while one is taken apart the next is read, and neither the whole file nor any
/// number of it is in memory twice.
///
/// # Errors
/// As [`open`].
pub fn open_with(path: &Path, limits: &Limits, progress: Progress<'_>) -> Result<Opened, SceneError> {
    if path.is_dir() {
        return Scene::open_within(path, limits).map(Opened::Moving);
    }
    let read = |cause| SceneError::Read { path: path.to_owned(), cause };
    let mut head = Vec::new();
    File::open(path).map_err(read)?.take(HEAD).read_to_end(&mut head).map_err(read)?;
    let Some(format) = format(path, &head) else {
        return Scene::open_within(path, limits).map(Opened::Moving);
    };
    let broken = |e: FormatError| SceneError::Broken { path: path.to_owned(), cause: e.to_string() };
    let opened = |still, (bytes, blake3)| {
        Opened::Still(StillFile { path: path.to_owned(), format: format.name, bytes, blake3, still })
    };
    let file = File::open(path).map_err(read)?;
    let about = file.metadata().map_err(read)?;
    // Devices and pipes have no length.
    if about.is_file() && about.len() <= MAX_FILE {
        let mut blocks = Blocks::new(file, about.len(), progress);
        match format.reader.read_blocks(&mut blocks, limits) {
            Ok(Some(still)) => return Ok(opened(still, blocks.finish())),
            Ok(None) => {}
            Err(ReadError::File(e)) => return Err(read(e)),
            Err(ReadError::Format(e)) => return Err(broken(e)),
        }
    }
    let bytes = read_file(path, MAX_FILE).map_err(read)?;
    let beside = Beside::of(path, &bytes);
    let still = format.reader.read(&bytes, &beside, limits).map_err(broken)?;
    Ok(opened(still, beside.finish(bytes.len())))
}
