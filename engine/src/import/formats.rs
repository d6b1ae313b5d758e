//! The formats of still scenes, read and written.

use std::path::Path;

use super::{Beside, FormatError, Limits, gltf, ply, sog, splat, spz};
use crate::export;
use crate::render::Snapshot;
use crate::still::{Drawable, Still};

/// A format of still scenes.
#[non_exhaustive]
pub struct Format {
    /// Its name, as in messages.
    pub name: &'static str,
    /// What `--format` calls it.
    pub option: &'static str,
    /// How the names of its files end, without the first dot.
    pub ending: &'static str,
    /// What of a scene it keeps, and what it loses.
    pub keeps: &'static str,
    /// Of what `keeps` does not say.
    pub loses: &'static str,
    /// Whether a file of this name and first bytes is one. Of several the first in [`FORMATS`] reads it.
    pub(super) is: fn(&Path, &[u8]) -> bool,
    /// Reads the whole of a file.
    pub(super) read: fn(&[u8], &Beside, &Limits) -> Result<Still, FormatError>,
    /// The file of one time of a scene.
    pub snapshot: fn(&Snapshot) -> Vec<u8>,
    /// The file of a still scene.
    pub still: fn(&Drawable) -> Vec<u8>,
}

/// All of them.
pub const FORMATS: [Format; 6] = [
    Format {
        name: "PLY",
        option: "ply",
        ending: "ply",
        keeps: "every number bit for bit, harmonics up to degree 3",
        loses: "normals and other programs' properties and elements",
        is: |_, head| head.starts_with(b"ply\n") || head.starts_with(b"ply\r"),
        read: |bytes, _, limits| ply::within(bytes, limits),
        snapshot: export::ply,
        still: |scene| export::still::ply(scene.still()),
    },
    Format {
        name: "compressed PLY",
        option: "compressed-ply",
        ending: "compressed.ply",
        keeps: "16 bytes per Gaussian, and one per further coefficient of the harmonics",
        loses: "precision (positions and scales to 1/1023 of a group of 256 neighbours, 10 bits of rotations, 8 of colours), order",
        // A PLY file, which tells by its header.
        is: |_, _| false,
        read: |bytes, _, limits| ply::within(bytes, limits),
        snapshot: export::packed,
        still: |scene| export::still::packed(scene.still()),
    },
    Format {
        name: "SPZ",
        option: "spz",
        ending: "spz",
        keeps: "20 bytes per Gaussian before compression, and the harmonics; versions 2 to 4 are read, 4 is written",
        loses: "precision (positions to 1/4096 unit, 8 bits and fewer for the rest), harmonics above degree 3",
        is: |_, head| head.starts_with(&spz::MAGIC) || head.starts_with(&[0x1f, 0x8b]),
        read: |bytes, _, limits| spz::within(bytes, limits),
        snapshot: export::spz,
        still: |scene| export::still::spz(scene.still()),
    },
    Format {
        name: "SOG",
        option: "sog",
        ending: "sog",
        keeps: "7 images of a byte or two per value; a zip file, or `meta.json` with its images beside it",
        loses: "precision (positions to 1/65535 on a logarithmic scale, 256 values for scales and colours, rows of harmonics shared), order",
        is: |path, head| {
            let is_meta = path.file_name().is_some_and(|name| name == "meta.json");
            head.starts_with(&sog::MAGIC) || is_meta && head.starts_with(b"{")
        },
        read: sog::within,
        snapshot: export::sog,
        still: |scene| export::still::sog(scene.still()),
    },
    Format {
        name: "glTF",
        option: "glb",
        ending: "glb",
        keeps: "`KHR_gaussian_splatting` in binary32 with harmonics up to degree 3; `.gltf` and its SPZ extension are read",
        loses: "the last bits of scales and opacities, which it does not store as logarithms and logits",
        is: |path, head| {
            let is_text = path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("gltf"));
            head.starts_with(&gltf::MAGIC) || is_text && head.trim_ascii_start().starts_with(b"{")
        },
        read: gltf::within,
        snapshot: export::glb,
        still: |scene| export::still::glb(scene.still()),
    },
    Format {
        name: "splat",
        option: "splat",
        ending: "splat",
        keeps: "32 bytes per Gaussian, positions and sizes exact",
        loses: "harmonics, and precision (8 bits for colours, opacities and rotations)",
        is: |path, _| path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("splat")),
        read: |bytes, _, limits| splat::within(bytes, limits),
        snapshot: export::splat,
        still: export::still::splat,
    },
];

impl Format {
    /// Returns true if `path` is named as a file of this format.
    pub fn names(&self, path: &Path) -> bool {
        let name = path.file_name().map(|name| name.to_string_lossy().to_lowercase());
        name.is_some_and(|name| name.strip_suffix(self.ending).is_some_and(|stem| stem.ends_with('.')))
    }

    /// The format that a file's name asks for; of several the one with the longest ending.
    pub fn of_name(path: &Path) -> Option<&'static Format> {
        FORMATS.iter().filter(|format| format.names(path)).max_by_key(|format| format.ending.len())
    }
}
