//! Folders without a scene of this program, recognised by the names in them.

use std::path::{Path, PathBuf};

use super::{Kind, SCENE_INDEX};
use crate::folder::{ends_in, has_images, natural};

/// Endings of videos that are named in a message.
const VIDEOS: [&str; 6] = ["mp4", "mov", "mkv", "webm", "avi", "y4m"];
/// Last endings of the names of scenes.
pub(crate) const SCENES: [&str; 8] = ["ply", "spz", "sog", "glb", "splat", "ssz", "ksplat", "gltf"];

pub(super) fn kind(path: &Path) -> Option<Kind> {
    let other = |found: String, advice: String| Some(Kind::Other(found, advice));
    if path.join(SCENE_INDEX).exists() || path.join("scene").join(SCENE_INDEX).exists() {
        return Some(Kind::Scene("folder"));
    }
    if let Some(index) = index(path) {
        return Some(Kind::Scene(if index.ends_with("meta.json") { "SOG" } else { "streamed SOG" }));
    }
    let mut scenes = Vec::new();
    let mut videos = Vec::new();
    for entry in std::fs::read_dir(path).ok()?.flatten() {
        let own = entry.path();
        if !own.is_file() {
            continue;
        }
        if ends_in(&own, &SCENES) {
            scenes.push(own);
        } else if ends_in(&own, &VIDEOS) {
            videos.push(own);
        }
    }
    let name = |path: &PathBuf| path.file_name().map(|name| name.as_encoded_bytes().to_vec()).unwrap_or_default();
    for list in [&mut scenes, &mut videos] {
        list.sort_by(|a, b| natural::compare(&name(a), &name(b)).then_with(|| a.cmp(b)));
    }
    if let [first, rest @ ..] = &scenes[..] {
        let found = match rest.len() {
            0 => "a folder with one scene in it".to_owned(),
            more => format!("a folder with {} scenes in it", more + 1),
        };
        return other(found, format!("name the file, such as {}", first.display()));
    }
    if let Some(trained) = trained(path) {
        return other(
            "the output of a training by 3D Gaussian splatting".to_owned(),
            format!("name the file: {}", trained.display()),
        );
    }
    if has_images(path) {
        return Some(Kind::Images);
    }
    if let Some(first) = videos.first() {
        return other("a folder with videos in it".to_owned(), format!("name the file, such as {}", first.display()));
    }
    let model = |path: &Path| ["bin", "txt"].iter().any(|ending| path.join(format!("cameras.{ending}")).is_file());
    if model(path) || model(&path.join("sparse/0")) {
        let advice = "it holds cameras and points (--camera reads them), and no Gaussians";
        return other("a COLMAP model".to_owned(), advice.to_owned());
    }
    if std::fs::read_dir(path).is_ok_and(|mut entries| entries.next().is_none()) {
        return other("an empty folder".to_owned(), "nothing was written or copied there".to_owned());
    }
    None
}

/// Returns the index file of the scene in a folder: an unpacked SOG scene, or a streamed one.
pub(crate) fn index(path: &Path) -> Option<PathBuf> {
    ["meta.json", "lod-meta.json"].map(|name| path.join(name)).into_iter().find(|index| index.is_file())
}

/// Returns the last point cloud of a training's output.
fn trained(path: &Path) -> Option<PathBuf> {
    let steps = std::fs::read_dir(path.join("point_cloud")).ok()?.flatten().filter_map(|entry| {
        let name = entry.file_name();
        let step: u64 = name.to_str()?.strip_prefix("iteration_")?.parse().ok()?;
        let file = entry.path().join("point_cloud.ply");
        file.is_file().then_some((step, file))
    });
    steps.max().map(|(_, file)| file)
}
