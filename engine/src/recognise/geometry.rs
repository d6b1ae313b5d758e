//! Points and meshes that are not Gaussians, numeric files of other programs, and scenes by their headers.

use std::fs::File;
use std::io::Read;

use serde_json::Value;

use super::{CONTAINER_MAGIC, Head, Kind};

/// Longest JSON of a glTF file that is read, in bytes.
const MAX_GLTF: u64 = 1 << 26;
/// First bytes, the format's name, and advice.
const MAGIC: [(&[u8], &str, &str); 9] = [
    (b"LASF", "a point cloud (LAS)", POINTS),
    (b"# .PCD", "a point cloud (PCD)", POINTS),
    (b"ASTM-E57", "a point cloud (E57)", POINTS),
    (b"Kaydara FBX Binary", "a mesh (FBX)", MESH),
    (b"PXR-USDC", "a USD file", "save its Gaussians as PLY, SPZ or glTF"),
    (b"BLENDER", "a file of Blender", MESH),
    (b"\x89HDF\r\n\x1a\n", "an HDF5 file", "save the Gaussians as PLY"),
    (b"%PDF", "a PDF document", "there is no scene in it"),
    (b"\x4b\x67\0\0", "a .splatv file of splaTV", "give the PLY file of SpacetimeGaussians that it was made of"),
];
const POINTS: &str = "points have no size and no opacity; training makes Gaussians of them (3D Gaussian splatting starts from such a file)";
const MESH: &str = "surfaces are no Gaussians; a program for meshes opens it";

pub(super) fn kind(head: &Head<'_>) -> Option<Kind> {
    let other = |found: String, advice: &str| Some(Kind::Other(found, advice.to_owned()));
    if let Some((_, found, advice)) = MAGIC.iter().find(|(magic, ..)| head.starts(magic)) {
        return other((*found).to_owned(), advice);
    }
    if head.starts(b"ply\n") || head.starts(b"ply\r") {
        return ply(head);
    }
    if head.starts(b"glTF") {
        return gltf(head);
    }
    if head.starts(&CONTAINER_MAGIC) {
        return Some(Kind::Scene("container"));
    }
    if head.starts(b"NGSP") {
        return Some(Kind::Scene("SPZ"));
    }
    let text = head.bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(head.bytes).trim_ascii_start();
    if text.starts_with(b"{") && head.named(&["gltf"]) {
        return gltf(head);
    }
    if head.named(&["obj"]) && text.starts_with(b"#") | text.starts_with(b"v ") | text.starts_with(b"mtllib") {
        return other("a mesh (OBJ)".to_owned(), MESH);
    }
    None
}

/// Recognises a PLY file as Gaussians, points or a mesh, by its header's lines.
fn ply(head: &Head<'_>) -> Option<Kind> {
    let (mut vertex, mut faces, mut points, mut ended) = (false, 0_u64, 0_u64, false);
    let mut names: Vec<&[u8]> = Vec::new();
    for line in head.bytes.split(|byte| *byte == b'\n') {
        let mut words = line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty());
        let number = |word: Option<&[u8]>| std::str::from_utf8(word?).ok()?.parse::<u64>().ok();
        match words.next() {
            Some(b"end_header") => {
                ended = true;
                break;
            }
            Some(b"element") => {
                let name = words.next();
                vertex = name == Some(b"vertex");
                let count = number(words.next()).unwrap_or(0);
                match name {
                    Some(b"vertex") => points = count,
                    Some(b"face") => faces = count,
                    _ => {}
                }
            }
            Some(b"property") if vertex => names.extend(words.next_back()),
            _ => {}
        }
    }
    let has = |name: &[u8]| names.contains(&name);
    // One property of a Gaussian suffices for a scene; the reader reports missing ones.
    let gaussian = |name: &&[u8]| {
        let starts = |start: &[u8]| name.starts_with(start);
        **name == *b"opacity" || starts(b"scale") || starts(b"rot_") || starts(b"f_") || starts(b"packed_")
    };
    if !ended || !has(b"x") || names.iter().any(gaussian) {
        return Some(Kind::Scene("PLY"));
    }
    Some(if faces > 0 {
        Kind::Other(format!("a mesh (PLY of {points} vertices and {faces} faces)"), MESH.to_owned())
    } else {
        Kind::Other(format!("a point cloud (PLY of {points} points without opacities and scales)"), POINTS.to_owned())
    })
}

/// Recognises a glTF document, binary or text, with or without Gaussians.
fn gltf(head: &Head<'_>) -> Option<Kind> {
    let json = if head.starts(b"glTF") {
        let length = head.bytes.get(12..16)?.first_chunk().map(|b| u64::from(u32::from_le_bytes(*b)))?;
        part(head, 20, length)?
    } else {
        part(head, 0, head.length)?
    };
    let Ok(document) = serde_json::from_slice::<Value>(json.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&json)) else {
        return Some(Kind::Scene("glTF"));
    };
    let primitives = document.get("meshes").and_then(Value::as_array).into_iter().flatten();
    let mut primitives = primitives.filter_map(|mesh| mesh.get("primitives")?.as_array()).flatten();
    let extensions = document.get("extensionsUsed").and_then(Value::as_array).into_iter().flatten();
    let mut extensions = extensions.filter_map(Value::as_str);
    let splats = |name: &str| name.contains("gaussian_splatting");
    let has = extensions.any(splats)
        || primitives.any(|one| {
            one.get("extensions").and_then(Value::as_object).is_some_and(|map| map.keys().any(|key| splats(key)))
        });
    let meshes = document.get("meshes").and_then(Value::as_array).is_some_and(|meshes| !meshes.is_empty());
    if has || !meshes {
        return Some(Kind::Scene("glTF"));
    }
    Some(Kind::Other("a mesh (glTF without KHR_gaussian_splatting)".to_owned(), MESH.to_owned()))
}

/// Reads `length` bytes of the file from offset `at`; `None` above the limit.
fn part(head: &Head<'_>, at: u64, length: u64) -> Option<Vec<u8>> {
    if length > MAX_GLTF || at + length > head.length {
        return None;
    }
    let mut bytes = Vec::new();
    File::open(head.path).ok()?.take(at + length).read_to_end(&mut bytes).ok()?;
    bytes.drain(..(at as usize).min(bytes.len()));
    Some(bytes)
}
