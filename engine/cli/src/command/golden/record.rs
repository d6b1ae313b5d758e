//! Record of golden images: FILE.golden/record.json and the previews next to it.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use streamsplat::Image;
use streamsplat::formats::read_text;
use streamsplat::picture::Picture;

use crate::console::failure::Failure;
use streamsplat::run::record::PROGRAM;

/// Longest record read, in bytes.
const MAX_RECORD: u64 = 1 << 28;
/// The longer side of a preview, in pixels.
const PREVIEW: usize = 256;

/// The whole file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Golden {
    /// [`PROGRAM`].
    pub program: String,
    /// The program's version.
    pub version: String,
    /// The version of the bit contract ([`streamsplat::BIT_CONTRACT`]).
    pub bit_contract: u32,
    /// Every render, by name.
    pub renders: BTreeMap<String, GoldenRender>,
}

/// One render.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct GoldenRender {
    /// BLAKE3 of the scene's file, or of its index.
    pub scene: String,
    /// Its images, in order.
    pub images: Vec<GoldenImage>,
}

/// One image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct GoldenImage {
    /// Seconds.
    pub time: f64,
    /// Width and height.
    pub size: [usize; 2],
    /// [`digest`].
    pub blake3: String,
    /// The preview's file.
    pub preview: String,
    /// Length and digest of the preview's file. A later recording removes the file only if both match.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub preview_file: Option<PreviewFile>,
}

/// A written preview file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PreviewFile {
    /// Its length.
    pub bytes: u64,
    /// BLAKE3 of its bytes.
    pub blake3: String,
}

/// Computes the BLAKE3 digest of an image before anything is rounded to 8 bits. Its input is width and height (64 bits
/// each), then red, green and blue planes (and alpha, if it is drawn) as binary32; everything in little-endian order.
pub fn digest(image: &Image) -> String {
    let mut hasher = blake3::Hasher::new();
    for side in [image.width, image.height] {
        hasher.update(&(side as u64).to_le_bytes());
    }
    for samples in [Some(&image.rgb), image.alpha.as_ref()].into_iter().flatten() {
        // In blocks, so that the whole image is not copied.
        for block in samples.chunks(1 << 14) {
            let bytes: Vec<u8> = block.iter().flat_map(|v| v.to_le_bytes()).collect();
            hasher.update(&bytes);
        }
    }
    hasher.finalize().to_hex().to_string()
}

/// Returns the image in 8 bits, at most 256 pixels wide and high.
pub fn preview(picture: &Picture) -> Picture {
    let longest = picture.width.max(picture.height).max(1);
    let side = |side: usize| if longest <= PREVIEW { side } else { (side * PREVIEW / longest).max(1) };
    let small = picture.resized(side(picture.width), side(picture.height));
    Picture::from_rgb8(small.width, small.height, &small.to_rgb8()).unwrap_or(small)
}

/// Returns the folder of a list's record.
pub fn folder(list: &Path) -> PathBuf {
    list.with_extension("golden")
}

/// Returns the record's file in it.
pub fn path(list: &Path) -> PathBuf {
    folder(list).join("record.json")
}

impl Golden {
    /// Returns an empty record of this program.
    pub fn new() -> Golden {
        Golden {
            program: PROGRAM.to_owned(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            bit_contract: streamsplat::BIT_CONTRACT,
            renders: BTreeMap::new(),
        }
    }

    /// Reads the record of a list.
    pub fn read(list: &Path) -> Result<Golden, Failure> {
        let path = path(list);
        let wrong = |e: &dyn std::fmt::Display| Failure::work(format!("{}: {e}", path.display()));
        if !path.exists() {
            let list = list.display();
            return Err(wrong(&format!(
                "expected a record, found none; make one with: streamsplat golden record {list}"
            )));
        }
        let text = read_text(&path, MAX_RECORD).map_err(|e| wrong(&e))?;
        let golden: Golden =
            serde_json::from_str(&text).map_err(|e| wrong(&format!("not a record of renders: {e}")))?;
        if golden.program != PROGRAM {
            return Err(wrong(&format!("expected a record of {PROGRAM}, found {:?}", golden.program)));
        }
        let inside = |name: &str| !name.is_empty() && Path::new(name).file_name().is_some_and(|n| n == name);
        let mut images = golden.renders.values().flat_map(|render| &render.images);
        match images.find(|image| !inside(&image.preview)) {
            Some(image) => Err(wrong(&format!("expected previews beside it, found {:?}", image.preview))),
            None => Ok(golden),
        }
    }

    /// Formats the record as JSON.
    pub fn to_json(&self) -> Result<String, Failure> {
        serde_json::to_string_pretty(self).map(|text| text + "\n").map_err(Failure::work)
    }
}
