//! The formats of still scenes, for reading and writing.

use std::path::Path;

use super::blocks::{Blocks, ReadError};
use super::{Beside, FormatError, Limits, Options, Written, compressed_ply, gltf, ksplat, lod, ply, sog, splat, spz};
use crate::still::{Drawable, Still};
use crate::stream::Snapshot;

/// A reader of files of one format.
#[derive(Clone, Copy)]
pub(crate) struct Reader {
    /// Returns true if a file with this name and these first bytes has the format.
    pub(super) is: fn(&Path, &[u8]) -> bool,
    /// Reads a whole file.
    pub(crate) whole: fn(&[u8], &Beside, &Limits) -> Result<Still, FormatError>,
    /// Reads a file with at most one block of it in memory. Returns `None`, with nothing consumed, if this file has to
    /// be read as a whole.
    pub(crate) blocks: fn(&mut Blocks<'_>, &Limits) -> Result<Option<Still>, ReadError>,
}

impl Reader {
    const fn whole(
        is: fn(&Path, &[u8]) -> bool,
        whole: fn(&[u8], &Beside, &Limits) -> Result<Still, FormatError>,
    ) -> Reader {
        Reader { is, whole, blocks: |_, _| Ok(None) }
    }
}

/// A format of still scenes.
#[non_exhaustive]
pub struct Format {
    /// Its name in messages.
    pub name: &'static str,
    /// Its name in `--format`.
    pub option: &'static str,
    /// Ending of its files' names, without the first dot.
    pub ending: &'static str,
    /// Properties of a scene that it keeps.
    pub keeps: &'static str,
    /// Properties and precision that it loses.
    pub loses: &'static str,
    /// If several readers recognise a file, the first in [`FORMATS`] reads it.
    pub(super) reader: Reader,
    /// Writes one time of a scene.
    pub snapshot: fn(&Snapshot, &Options) -> Written,
    /// Writes a still scene.
    pub still: fn(&Drawable, &Options) -> Written,
}

/// All formats that are read and written.
pub const FORMATS: [Format; 6] = [
    Format {
        name: "PLY",
        option: "ply",
        ending: "ply",
        keeps: "every number bit for bit, harmonics up to degree 3, the mark of anti-aliased training, an offset (in doubles)",
        loses: "normals and other programs' properties and elements, harmonics of degree 4",
        reader: Reader { is: ply::is, whole: |bytes, _, limits| ply::within(bytes, limits), blocks: ply::blocks },
        snapshot: |snapshot, _| ply::write(&Still::of(snapshot)),
        still: |scene, _| ply::write(scene.still()),
    },
    Format {
        name: "compressed PLY",
        option: "compressed-ply",
        ending: "compressed.ply",
        keeps: "16 bytes per Gaussian, and one per further coefficient of the harmonics; the mark of anti-aliased training",
        loses: "precision (positions and scales to 1/1023 of a group of 256 neighbours, 10 bits of rotations, 8 of colours), order",
        // The reader of PLY recognises it by its header.
        reader: Reader::whole(|_, _| false, |bytes, _, limits| ply::within(bytes, limits)),
        snapshot: |snapshot, _| compressed_ply::write(&Still::of(snapshot)),
        still: |scene, _| compressed_ply::write(scene.still()),
    },
    Format {
        name: "SPZ",
        option: "spz",
        ending: "spz",
        keeps: "20 bytes per Gaussian before compression, and the harmonics; the mark of anti-aliased training; versions 1 to 4 are read, 3 or 4 is written",
        loses: "precision (positions to 1/4096 unit, finer in tiny scenes, coarser in wide ones, with a line; 8 bits and fewer for the rest), harmonics above degree 3",
        reader: Reader::whole(spz::is, |bytes, _, limits| spz::within(bytes, limits)),
        snapshot: |snapshot, options| spz::write(&Still::of(snapshot), options.spz),
        still: |scene, options| spz::write(scene.still(), options.spz),
    },
    Format {
        name: "SOG",
        option: "sog",
        ending: "sog",
        keeps: "7 images of a byte or two per value; a zip file, or `meta.json` and its images in one folder; the mark of anti-aliased training; versions 1 and 2 are read, 2 is written",
        loses: "precision (positions to 1/65535 on a logarithmic scale, 256 values for scales and colours, rows of harmonics shared), order",
        reader: Reader::whole(sog::is, sog::within),
        snapshot: |snapshot, _| sog::write(&Still::of(snapshot)),
        still: |scene, _| sog::write(scene.still()),
    },
    Format {
        name: "glTF",
        option: "glb",
        ending: "glb",
        keeps: "`KHR_gaussian_splatting` in binary32 with harmonics up to degree 3; an offset (a node's translation); `.gltf` and its SPZ extension are read",
        loses: "the last bits of scales and opacities, which it does not store as logarithms and logits; the mark of anti-aliased training",
        reader: Reader::whole(gltf::is, gltf::within),
        snapshot: |snapshot, _| gltf::write(&Still::of(snapshot)),
        still: |scene, _| gltf::write(scene.still()),
    },
    Format {
        name: "splat",
        option: "splat",
        ending: "splat",
        keeps: "32 bytes per Gaussian, positions and sizes exact",
        loses: "harmonics, the mark of anti-aliased training, and precision (8 bits for colours, opacities and rotations)",
        reader: Reader::whole(splat::is, |bytes, _, limits| splat::within(bytes, limits)),
        snapshot: |snapshot, _| Written { bytes: splat::of_snapshot(snapshot), notes: Vec::new() },
        still: |scene, _| splat::write(scene),
    },
];

/// A format of still scenes that is read and not written.
#[non_exhaustive]
pub struct ReadOnly {
    /// Its name in messages.
    pub name: &'static str,
    /// Ending of its files' names.
    pub ending: &'static str,
    /// Content that is read and content that is left out.
    pub reads: &'static str,
    /// Its reader, which is tried before those of [`FORMATS`].
    pub(super) reader: Reader,
}

/// All formats that are only read.
pub const READ_ONLY: [ReadOnly; 2] = [
    ReadOnly {
        name: "ksplat",
        ending: ".ksplat",
        reads: "GaussianSplats3D's files, version 0.1, compression levels 0 to 2 with harmonics up to degree 2",
        reader: Reader::whole(ksplat::is, |bytes, _, limits| ksplat::within(bytes, limits)),
    },
    ReadOnly {
        name: lod::NAME,
        ending: "lod-meta.json",
        reads: "the union of a level of detail (`--lod N`, the finest without), and the environment",
        reader: Reader::whole(lod::is, |bytes, beside, limits| lod::level(bytes, beside, limits, limits.level)),
    },
];

impl Format {
    /// Returns true if the name of `path` is one of this format.
    pub fn names(&self, path: &Path) -> bool {
        let name = path.file_name().map(|name| name.to_string_lossy().to_lowercase());
        name.is_some_and(|name| name.strip_suffix(self.ending).is_some_and(|stem| stem.ends_with('.')))
    }

    /// Returns the format of a file's name; the one with the longest ending if several match.
    pub fn of_name(path: &Path) -> Option<&'static Format> {
        FORMATS.iter().filter(|format| format.names(path)).max_by_key(|format| format.ending.len())
    }
}
