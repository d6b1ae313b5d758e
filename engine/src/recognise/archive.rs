//! Archives and compressed files.

use std::fs::File;
use std::io::Read;

use flate2::read::GzDecoder;
use zip::ZipArchive;

use super::{Head, Kind};

/// First bytes, the format's name, and the program that unpacks it.
const MAGIC: [(&[u8], &str, &str); 6] = [
    (b"7z\xbc\xaf\x27\x1c", "a 7z archive", "7z x"),
    (b"Rar!\x1a\x07", "a RAR archive", "unrar x"),
    (b"\xfd7zXZ\0", "a file compressed by xz", "unxz"),
    (b"BZh", "a file compressed by bzip2", "bunzip2"),
    (b"\x28\xb5\x2f\xfd", "a file compressed by Zstandard", "unzstd"),
    (b"\x04\x22\x4d\x18", "a file compressed by LZ4", "unlz4"),
];
/// Offset of the mark of a tar archive.
const TAR: usize = 257;

pub(super) fn kind(head: &Head<'_>) -> Option<Kind> {
    let other = |found: String, advice: String| Some(Kind::Other(found, advice));
    if let Some((_, found, tool)) = MAGIC.iter().find(|(magic, ..)| head.starts(magic)) {
        return other((*found).to_owned(), format!("unpack it first ({tool})"));
    }
    if head.holds(TAR, b"ustar") {
        return other("a tar archive".to_owned(), "unpack it first (tar xf)".to_owned());
    }
    if head.starts(b"\x93NUMPY") {
        return other("an array of NumPy (.npy)".to_owned(), array().to_owned());
    }
    if head.starts(b"PK\x03\x04") || head.starts(b"PK\x05\x06") {
        return zip(head);
    }
    if head.starts(&[0x1f, 0x8b]) {
        return gzip(head);
    }
    None
}

fn array() -> &'static str {
    "numbers without names are no scene; save the Gaussians as PLY"
}

/// Recognises a gzip file that is no SPZ file.
fn gzip(head: &Head<'_>) -> Option<Kind> {
    let mut inner = Vec::new();
    // The part that can be decompressed is enough.
    let _ = GzDecoder::new(head.bytes).take(512).read_to_end(&mut inner);
    if inner.starts_with(b"NGSP") {
        return Some(Kind::Scene("SPZ"));
    }
    let (of, tool) = match () {
        () if inner.starts_with(b"ply\n") || inner.starts_with(b"ply\r") => (" of a PLY file", "gunzip"),
        () if inner.get(TAR..).is_some_and(|rest| rest.starts_with(b"ustar")) => (" of a tar archive", "tar xf"),
        () if inner.is_empty() => return None,
        () => ("", "gunzip"),
    };
    Some(Kind::Other(format!("a gzip file{of}"), format!("unpack it first ({tool})")))
}

/// Longest zip file whose names are read, in bytes.
const MAX_ZIP: u64 = 16 << 30;

/// Recognises a zip file that is no SOG file.
fn zip(head: &Head<'_>) -> Option<Kind> {
    let other = |found: &str, advice: String| Some(Kind::Other(found.to_owned(), advice));
    if head.length > MAX_ZIP {
        return None;
    }
    // A broken archive is left to the reader, whose error is more specific.
    let archive = ZipArchive::new(File::open(head.path).ok()?).ok()?;
    let names: Vec<String> = archive.file_names().filter_map(Result::ok).map(|name| name.into_owned()).collect();
    let ends = |ending: &str| names.iter().find(|name| name.to_lowercase().ends_with(ending));
    if names.iter().any(|name| name == "meta.json") {
        return Some(Kind::Scene("SOG"));
    }
    if names.is_empty() {
        return other("a zip file with nothing in it", "it holds no scene".to_owned());
    }
    if ends(".npy").is_some() {
        return other("arrays of NumPy (.npz)", array().to_owned());
    }
    if ends("data.pkl").is_some() {
        return Some(Kind::Checkpoint);
    }
    if ends(".usdc").or(ends(".usda")).is_some() {
        return other("a USDZ file", "save its Gaussians as PLY, SPZ or glTF".to_owned());
    }
    let inside = [".ply", ".spz", ".sog", ".splat", ".ksplat", ".glb", "lod-meta.json", "meta.json", ".ssz", ".mp4"];
    match inside.into_iter().find_map(ends) {
        Some(name) => {
            let name: String = name.chars().take(100).collect();
            other("a zip file", format!("unpack it first (unzip); {name} is in it"))
        }
        None => other("a zip file", "unpack it first (unzip); no scene is named in it".to_owned()),
    }
}
