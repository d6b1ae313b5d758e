//! Digests of inputs.

use std::path::Path;

use crate::picture::Picture;
use crate::scene::Scene;

use crate::run::Error;

/// BLAKE3 over the frames as they are read: for each its index, its size, the bits of its time stamp, and its samples.
#[derive(Default)]
pub struct InputDigest {
    hasher: blake3::Hasher,
    frames: usize,
}

impl InputDigest {
    /// Adds a frame and its depth map.
    pub fn add(&mut self, picture: &Picture, timestamp: f64, depth: Option<&[f32]>) {
        let sizes = [self.frames as u64, picture.width as u64, picture.height as u64, timestamp.to_bits()];
        sizes.iter().for_each(|v| self.bytes_of(&v.to_le_bytes()));
        for samples in [Some(picture.rgb.as_slice()), depth].into_iter().flatten() {
            // In blocks, without a copy of the whole frame.
            for block in samples.chunks(1 << 14) {
                let bytes: Vec<u8> = block.iter().flat_map(|v| v.to_le_bytes()).collect();
                self.bytes_of(&bytes);
            }
        }
        self.frames += 1;
    }

    fn bytes_of(&mut self, bytes: &[u8]) {
        self.hasher.update(bytes);
    }

    /// Number of frames added.
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// The digest in hexadecimal.
    pub fn finish(&self) -> String {
        self.hasher.finalize().to_hex().to_string()
    }
}

/// BLAKE3 of a file's bytes.
pub fn file(path: &Path) -> Result<String, Error> {
    let unreadable = |e| Error::work(format!("{}: {e}", path.display()));
    let file = std::fs::File::open(path).map_err(unreadable)?;
    let mut hasher = blake3::Hasher::new();
    hasher.update_reader(file).map_err(unreadable)?;
    Ok(hasher.finalize().to_hex().to_string())
}

/// BLAKE3 over parts in memory: for each its length, then its bytes.
pub fn bytes(parts: &[&[u8]]) -> String {
    let mut hasher = blake3::Hasher::new();
    for part in parts {
        hasher.update(&(part.len() as u64).to_le_bytes());
        hasher.update(part);
    }
    hasher.finalize().to_hex().to_string()
}

/// As [`bytes`], for files.
pub fn files(paths: &[std::path::PathBuf]) -> Result<String, Error> {
    let mut hasher = blake3::Hasher::new();
    for path in paths {
        let unreadable = |e| Error::work(format!("{}: {e}", path.display()));
        let file = std::fs::File::open(path).map_err(unreadable)?;
        hasher.update(&file.metadata().map_err(unreadable)?.len().to_le_bytes());
        hasher.update_reader(file).map_err(unreadable)?;
    }
    Ok(hasher.finalize().to_hex().to_string())
}

/// BLAKE3 of a scene's index. Intervals are checked against the index when they are read, and refused if they do not
/// match.
pub fn scene_index(scene: &Scene) -> Result<String, Error> {
    let text = serde_json::to_vec(scene.index()).map_err(Error::work)?;
    Ok(blake3::hash(&text).to_hex().to_string())
}

/// As [`scene_index`], after reading every interval and checking it against the index.
pub fn scene(scene: &Scene) -> Result<String, Error> {
    for place in 0..scene.index().intervals.len() {
        drop(scene.interval(place)?);
    }
    scene_index(scene)
}
