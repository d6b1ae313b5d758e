//! Recognition of files of the wrong kind by their content, before a reader opens them.
//!
//! The message is one sentence: the expected kind, the kind found, and advice. All commands that take scenes, videos or
//! records of runs use this module, so that their messages agree. A kind is recognised by its first bytes. The name
//! decides only if several kinds begin alike, or if a format has no magic number.
//!
//! | found | recognised by | advice |
//! |---|---|---|
//! | a video, a sound, an image | first bytes (`media`) | `streamsplat run` makes a scene from a video |
//! | a web page, a Git LFS pointer | first words | download the file itself |
//! | an archive, a compressed file | first bytes, and the names in a zip file (`archive`) | unpack it |
//! | an array of NumPy, a checkpoint of PyTorch, a point cloud or mesh | first bytes, a PLY or glTF header (`geometry`) | use the tool that makes Gaussians from it |
//! | a folder | the names in it (`folder`) | name the file in it |
//! | text that is not JSON | no control characters | |

mod archive;
mod folder;
mod geometry;
mod media;
#[cfg(test)]
mod tests;

use std::fmt;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use crate::folder::{ends_in, has_images};
#[cfg(test)]
pub(crate) use folder::SCENES;
pub(crate) use folder::index;
pub use media::Media;

/// The name of the index of a scene in a folder.
pub const SCENE_INDEX: &str = "scene.json";
/// The first bytes of a container.
pub const CONTAINER_MAGIC: [u8; 8] = *b"ssplat\x1a\n";
/// Number of first bytes that are read.
const HEAD: u64 = 1 << 16;

/// The content of a file or a folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A picture, a video or a sound, with its format's name.
    Media(Media, &'static str),
    /// A folder of images.
    Images,
    /// A scene that this program reads, with its format's name.
    Scene(&'static str),
    /// A checkpoint of PyTorch.
    Checkpoint,
    /// Any other kind: its description, and advice.
    Other(String, String),
}

/// A path of a kind other than the expected one, as one line without the path.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Wrong {
    expected: &'static str,
    found: String,
    advice: String,
}

impl Wrong {
    /// Replaces the expected kind.
    pub fn expecting(self, expected: &'static str) -> Wrong {
        Wrong { expected, ..self }
    }

    fn checkpoint(expected: &'static str) -> Wrong {
        let advice =
            "export its Gaussians as PLY with the program that trained it (nerfstudio: ns-export gaussian-splat)";
        Wrong { expected, found: "a checkpoint of PyTorch".to_owned(), advice: advice.to_owned() }
    }
}

impl fmt::Display for Wrong {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "expected {}, found {}: {}", self.expected, self.found, self.advice)
    }
}

/// The first bytes of a file, with its path and length.
struct Head<'a> {
    path: &'a Path,
    bytes: &'a [u8],
    length: u64,
}

impl Head<'_> {
    fn starts(&self, magic: &[u8]) -> bool {
        self.bytes.starts_with(magic)
    }

    fn holds(&self, at: usize, magic: &[u8]) -> bool {
        self.bytes.get(at..).is_some_and(|rest| rest.starts_with(magic))
    }

    /// Returns true if the file's name has one of these endings.
    fn named(&self, endings: &[&str]) -> bool {
        ends_in(self.path, endings)
    }
}

/// Describes a path; `None` if it is not recognised or cannot be read.
pub fn kind(path: &Path) -> Option<Kind> {
    if path.is_dir() {
        return folder::kind(path);
    }
    let about = path.metadata().ok().filter(|about| about.is_file())?;
    // An empty file is a valid `.splat` scene without Gaussians.
    if about.len() == 0 && !ends_in(path, &["splat"]) {
        return Some(Kind::Other("an empty file (0 bytes)".into(), "it was not written or not copied".into()));
    }
    let mut bytes = Vec::new();
    File::open(path).ok()?.take(HEAD).read_to_end(&mut bytes).ok()?;
    let head = Head { path, bytes: &bytes, length: about.len() };
    // Records without a header can begin with any bytes.
    let any = head.named(&["splat", "ksplat"]);
    let other = words(&head).or_else(|| archive::kind(&head));
    if any {
        return other.or(Some(Kind::Scene("splats")));
    }
    let index = |name: &str| path.file_name().is_some_and(|found| found == name);
    if index(SCENE_INDEX) {
        return Some(Kind::Scene("folder"));
    }
    other.or_else(|| geometry::kind(&head)).or_else(|| media::kind(&head)).or_else(|| text(&head))
}

/// Description of files that [`text`] recognises.
const TEXT: &str = "a text file";

/// Recognises text that is not JSON; indexes, records and cameras are JSON.
fn text(head: &Head<'_>) -> Option<Kind> {
    let begin = head.bytes.trim_ascii_start().first()?;
    let advice = "it is another program's, or has the name of another file";
    (!b"{[".contains(begin) && is_text(head.bytes)).then(|| Kind::Other(TEXT.to_owned(), advice.to_owned()))
}

/// Returns true if bytes are the beginning of a text; its last character may be incomplete.
pub(crate) fn is_text(bytes: &[u8]) -> bool {
    let text = match std::str::from_utf8(bytes) {
        Ok(text) => text,
        Err(e) if e.error_len().is_none() => std::str::from_utf8(&bytes[..e.valid_up_to()]).unwrap_or_default(),
        Err(_) => return false,
    };
    !text.is_empty() && !text.chars().any(|c| c.is_control() && !c.is_whitespace())
}

/// Explains why a path does not contain the expected text; `None` if it may.
pub fn not_a_text(path: &Path, expected: &'static str) -> Option<Wrong> {
    let advice = || "it is no text".to_owned();
    let wrong = |found, advice| Some(Wrong { expected, found, advice });
    match kind(path)? {
        Kind::Other(found, _) if found == TEXT => None,
        Kind::Other(found, advice) => wrong(found, advice),
        Kind::Media(kind, name) => wrong(format!("{} ({name})", kind.article()), advice()),
        Kind::Scene(name) => wrong(format!("a scene ({name})"), advice()),
        Kind::Images => wrong("a folder of images".to_owned(), advice()),
        Kind::Checkpoint => wrong("a checkpoint of PyTorch".to_owned(), advice()),
    }
}

/// Explains why a path is no scene; `None` if it may be one.
pub fn not_a_scene(path: &Path) -> Option<Wrong> {
    let wrong = |found, advice| Some(Wrong { expected: "a scene", found, advice });
    match kind(path)? {
        Kind::Scene(_) => None,
        Kind::Checkpoint => Some(Wrong::checkpoint("a scene")),
        Kind::Other(found, advice) => wrong(found, advice),
        Kind::Media(Media::Video, name) => {
            let own = scene_of(path).filter(|scene| scene.is_file());
            let beside = own.map_or_else(String::new, |scene| format!("; {} is one", scene.display()));
            wrong(format!("a video ({name})"), format!("streamsplat run makes a scene of it{beside}"))
        }
        Kind::Media(Media::Image, name) => wrong(
            format!("an image ({name})"),
            "streamsplat run makes a scene of a video, or of a folder of images".to_owned(),
        ),
        Kind::Media(Media::Sound, name) => wrong(format!("sound alone ({name})"), "there is no picture in it".into()),
        Kind::Images => wrong("a folder of images".to_owned(), "streamsplat run makes a scene of it".to_owned()),
    }
}

/// Explains why a path is no video; `None` if it may be one.
pub fn not_a_video(path: &Path) -> Option<Wrong> {
    let wrong = |found, advice| Some(Wrong { expected: "a video or images", found, advice });
    // An empty file is left to the reader, whose error names the expected content.
    if path.metadata().is_ok_and(|about| about.is_file() && about.len() == 0) {
        return None;
    }
    // A folder with images is a video, even if it contains other files.
    if path.is_dir() && has_images(path) {
        return None;
    }
    match kind(path)? {
        Kind::Media(Media::Video | Media::Image, _) | Kind::Images => None,
        Kind::Media(Media::Sound, name) => wrong(format!("sound alone ({name})"), "there is no picture in it".into()),
        Kind::Scene(name) => wrong(
            format!("a scene ({name})"),
            "streamsplat view shows it, streamsplat render makes images of it".to_owned(),
        ),
        Kind::Checkpoint => Some(Wrong::checkpoint("a video or images")),
        Kind::Other(found, advice) => wrong(found, advice),
    }
}

/// Explains why a path contains no record of a run; `None` if it may.
pub fn not_a_record(path: &Path) -> Option<Wrong> {
    let expected = "the folder of a run, or its run.json";
    let wrong = |found, advice| Some(Wrong { expected, found, advice });
    let beside = || {
        let mut name = path.file_name()?.to_owned();
        name.push(".run.json");
        let record = path.with_file_name(name);
        Some(if record.is_file() {
            format!("{} is the record of the run that wrote it", record.display())
        } else {
            format!("the record of a run that wrote it would be {}", record.display())
        })
    };
    if path.is_dir() {
        return None;
    }
    match kind(path)? {
        Kind::Images => None,
        Kind::Checkpoint => Some(Wrong::checkpoint(expected)),
        Kind::Media(kind, name) => wrong(format!("{} ({name})", kind.article()), beside()?),
        Kind::Scene(name) => wrong(format!("a scene ({name})"), beside()?),
        Kind::Other(found, advice) => wrong(found, advice),
    }
}

/// Returns the default path of the scene that a run of the video at `path` writes.
pub fn scene_of(path: &Path) -> Option<PathBuf> {
    let mut name = path.file_stem()?.to_owned();
    name.push("-scene.ssz");
    Some(path.with_file_name(name))
}

/// Recognises text instead of the expected file: a Git LFS pointer, a web page or XML.
fn words(head: &Head<'_>) -> Option<Kind> {
    let other = |found: &str, advice: &str| Some(Kind::Other(found.into(), advice.into()));
    if head.starts(b"version https://git-lfs") {
        return other("a pointer of Git LFS", "git lfs pull fetches the file that it stands for");
    }
    let text = head.bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(head.bytes).trim_ascii_start();
    let begins = |word: &[u8]| text.get(..word.len()).is_some_and(|start| start.eq_ignore_ascii_case(word));
    if begins(b"<!doctype html") || begins(b"<html") || begins(b"<head") {
        return other("a web page (HTML)", "it came in place of the file; download the file itself");
    }
    if begins(b"<?xml") {
        return other("a text in XML", "it came in place of the file, or is another program's");
    }
    None
}
