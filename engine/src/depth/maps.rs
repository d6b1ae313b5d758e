//! Depth maps from files, one for each frame.
//!
//! A map holds *inverse* depth (larger is nearer) in any scale, or depth itself ([`Values::Depth`]), which is inverted;
//! there values that are not above zero were not measured and become NaN. Files are EXR (channel `Y`, `Z`, `depth`,
//! `R`, or the only one), PNG of 8 or 16 bits grey, or NPY (`f2`, `f4`, `f8`, `u1`, `u2`; `[H,W]`, `[1,H,W]` or
//! `[H,W,1]`; C order). A map of another size than its frame is brought to the frame's size bilinearly (half-pixel
//! centres).
//!
//! Maps belong to frames by name where every frame is a file with a map of the same name (extensions aside), else by
//! natural order. [`Range::Clip`] normalises all maps of the folder by the smallest and the largest value found in any
//! of them; with [`Range::Frame`] the maps stay as they are and the engine normalises each by its own.

use std::path::{Path, PathBuf};

use image::DynamicImage;

use super::{DepthError, npy};
use crate::openexr;
use crate::picture::{resize_planes, size_is_allowed};
use crate::source::{decode, folder};

/// File name endings taken as depth maps.
pub const EXTENSIONS: [&str; 3] = ["exr", "png", "npy"];

/// Range by which the values of a map are normalised.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Range {
    /// Each map by its own smallest and largest value (done by the engine).
    #[default]
    Frame,
    /// All by the smallest and the largest value of the whole folder.
    Clip,
}

/// Kind of the values that files hold.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Values {
    /// Inverse depth.
    #[default]
    Inverse,
    /// Depth in any unit; what is not above zero was not measured.
    Depth,
}

impl Values {
    /// Inverse depth of a value.
    fn inverse(self, value: f32) -> f32 {
        match self {
            Values::Inverse => value,
            Values::Depth if value > 0.0 => 1.0 / value,
            Values::Depth => f32::NAN,
        }
    }
}

/// A depth map: `height · width` values.
#[derive(Clone, Debug, PartialEq)]
pub struct Map {
    /// Values per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// The values, row-major.
    pub values: Vec<f32>,
}

/// The maps of a folder.
#[derive(Clone, Debug)]
pub struct DepthMaps {
    folder: PathBuf,
    files: Vec<PathBuf>,
    kind: Values,
    /// Smallest and largest value of the clip, with [`Range::Clip`].
    range: Option<(f32, f32)>,
}

impl DepthMaps {
    /// Lists the maps of `folder` and pairs them with `frames` where the frames are files. With [`Range::Clip`] every
    /// map is read once to find the range.
    ///
    /// # Errors
    /// An unreadable or empty folder, another number of maps than of frames, an unreadable map where all are read.
    pub fn open(folder: &Path, frames: Option<&[PathBuf]>, range: Range) -> Result<DepthMaps, DepthError> {
        Self::open_as(folder, frames, range, Values::Inverse)
    }

    /// [`DepthMaps::open`] where the files hold values of this kind.
    ///
    /// # Errors
    /// As there.
    pub fn open_as(
        folder: &Path,
        frames: Option<&[PathBuf]>,
        range: Range,
        kind: Values,
    ) -> Result<DepthMaps, DepthError> {
        let mut files = folder::list(folder, &EXTENSIONS)?;
        if files.is_empty() {
            return Err(DepthError::Empty(folder.to_owned()));
        }
        if let Some(frames) = frames {
            let by_name: Option<Vec<PathBuf>> = frames
                .iter()
                .map(|frame| files.iter().find(|map| map.file_stem() == frame.file_stem()).cloned())
                .collect();
            match by_name {
                Some(paired) => files = paired,
                None if files.len() == frames.len() => {}
                None => {
                    let (expected, found) = (frames.len(), files.len());
                    return Err(DepthError::Count { folder: folder.to_owned(), expected, found });
                }
            }
        }
        let mut maps = DepthMaps { folder: folder.to_owned(), files, kind, range: None };
        if range == Range::Clip {
            let mut limits = (f32::INFINITY, f32::NEG_INFINITY);
            for file in &maps.files {
                let inverse = read_map(file)?.values.into_iter().map(|value| kind.inverse(value));
                for value in inverse.filter(|value| value.is_finite()) {
                    limits = (limits.0.min(value), limits.1.max(value));
                }
            }
            maps.range = Some(limits);
        }
        Ok(maps)
    }

    /// The inverse depth of frame `index` at the frame's size, NaN where it was not measured; with [`Range::Clip`]
    /// normalised to `[0, 1]`.
    ///
    /// # Errors
    /// No such map, or an unreadable one.
    pub fn map(&self, index: usize, width: usize, height: usize) -> Result<Vec<f32>, DepthError> {
        let missing = || DepthError::Missing { folder: self.folder.clone(), frame: index, found: self.files.len() };
        let mut map = read_map(self.files.get(index).ok_or_else(missing)?)?;
        map.values.iter_mut().for_each(|v| *v = self.kind.inverse(*v));
        if let Some((least, most)) = self.range {
            let span = most - least;
            // A constant clip gives 0, as a constant map does.
            map.values.iter_mut().for_each(|v| *v = if span > 0.0 { (*v - least) / span } else { 0.0 });
        }
        if (map.width, map.height) == (width, height) {
            return Ok(map.values);
        }
        Ok(resize_planes(&map.values, [map.height, map.width], [height, width]))
    }
}

/// Reads one map.
///
/// # Errors
/// Unreadable, broken, oversized or many-channelled files, and values that are not finite.
pub fn read_map(path: &Path) -> Result<Map, DepthError> {
    decode_map(&decode::read_file(path)?, path)
}

/// Reads a map held in memory; `path` tells an NPY file and is for the messages.
///
/// # Errors
/// As [`read_map`], but for the reading.
pub fn decode_map(bytes: &[u8], path: &Path) -> Result<Map, DepthError> {
    let wrong = |cause: String| DepthError::Map { path: path.to_owned(), cause };
    let map = if folder::ends_in(path, &["npy"]) {
        npy::read(bytes).map_err(wrong)?
    } else if bytes.starts_with(&[0x76, 0x2f, 0x31, 0x01]) {
        from_exr(bytes).map_err(wrong)?
    } else {
        match decode::decode_dynamic(bytes, path)? {
            DynamicImage::ImageLuma8(i) => Map {
                width: i.width() as usize,
                height: i.height() as usize,
                values: i.as_raw().iter().map(|&v| f32::from(v)).collect(),
            },
            DynamicImage::ImageLuma16(i) => Map {
                width: i.width() as usize,
                height: i.height() as usize,
                values: i.as_raw().iter().map(|&v| f32::from(v)).collect(),
            },
            other => return Err(wrong(format!("expected a grey PNG of 8 or 16 bits, found {:?}", other.color()))),
        }
    };
    if let Some(position) = map.values.iter().position(|v| !v.is_finite()) {
        let (x, y) = (position % map.width, position / map.width);
        return Err(wrong(format!("the depth at x={x}, y={y} is {}, expected a finite number", map.values[position])));
    }
    Ok(map)
}

fn from_exr(bytes: &[u8]) -> Result<Map, String> {
    let planes = openexr::read(bytes).map_err(|e| e.to_string())?;
    let (width, height) = (planes.width, planes.height);
    let named = ["Y", "Z", "depth", "R"].iter().find_map(|name| planes.channel(name));
    let values = match (named, planes.channels.as_slice()) {
        (Some(values), _) => values.to_vec(),
        (None, [(_, only)]) => only.clone(),
        (None, several) => {
            let names: Vec<_> = several.iter().map(|(name, _)| name.as_str()).collect();
            return Err(format!("expected an EXR channel Y, Z, depth or R, found {}", names.join(", ")));
        }
    };
    if !size_is_allowed(width, height) {
        return Err(format!("the map is {width}×{height}, larger than this program reads"));
    }
    Ok(Map { width, height, values })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn png16(path: &Path, width: u32, values: Vec<u16>) {
        let height = values.len() as u32 / width;
        let image: image::ImageBuffer<image::Luma<u16>, _> =
            image::ImageBuffer::from_raw(width, height, values).expect("rows of one width");
        image.save(path).expect("writable");
    }

    #[test]
    fn maps_are_found_by_name_before_order() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        png16(&folder.path().join("b.png"), 2, vec![1, 2]);
        png16(&folder.path().join("a.png"), 2, vec![3, 4]);
        png16(&folder.path().join("other.png"), 2, vec![5, 6]);
        let frames = [PathBuf::from("x/b.jpg"), PathBuf::from("x/a.jpg")];
        let maps = DepthMaps::open(folder.path(), Some(&frames), Range::Frame).expect("both named");
        assert_eq!(maps.map(0, 2, 1).expect("readable"), [1.0, 2.0]);
        assert_eq!(maps.map(1, 2, 1).expect("readable"), [3.0, 4.0]);
        let error =
            DepthMaps::open(folder.path(), Some(&[PathBuf::from("c.jpg")]), Range::Frame).expect_err("three maps");
        assert!(error.to_string().ends_with("expected 1 depth maps, one for each frame, found 3"), "{error}");
    }

    #[test]
    fn a_clip_is_normalised_by_all_its_maps() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        png16(&folder.path().join("1.png"), 2, vec![10, 20]);
        png16(&folder.path().join("2.png"), 2, vec![20, 50]);
        let maps = DepthMaps::open(folder.path(), None, Range::Clip).expect("two maps");
        assert_eq!(maps.map(0, 2, 1).expect("readable"), [0.0, 0.25]);
        assert_eq!(maps.map(1, 2, 1).expect("readable"), [0.25, 1.0]);
        assert!(matches!(maps.map(2, 2, 1), Err(DepthError::Missing { frame: 2, found: 2, .. })));
    }

    #[test]
    fn depth_itself_is_inverted_and_what_was_not_measured_is_no_number() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        png16(&folder.path().join("1.png"), 4, vec![0, 500, 2000, 1000]);
        let maps = DepthMaps::open_as(folder.path(), None, Range::Frame, Values::Depth).expect("a map");
        let map = maps.map(0, 4, 1).expect("readable");
        assert!(map[0].is_nan());
        assert_eq!(map[1..], [0.002, 0.0005, 0.001]);
        let maps = DepthMaps::open_as(folder.path(), None, Range::Clip, Values::Depth).expect("a map");
        let map = maps.map(0, 4, 1).expect("readable");
        assert!(map[0].is_nan());
        assert_eq!((map[1], map[2]), (1.0, 0.0));
    }

    #[test]
    fn exr_npy_and_png_hold_the_same_map() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let values: Vec<u16> = (0..6).map(|v| v * 9).collect();
        png16(&folder.path().join("m.png"), 3, values.clone());
        let floats: Vec<f32> = values.iter().map(|&v| f32::from(v)).collect();
        let mut exr = Vec::new();
        let planes = openexr::Planes { width: 3, height: 2, channels: vec![("Z".into(), floats.clone())] };
        openexr::write(&planes, "", &mut exr).expect("memory");
        std::fs::write(folder.path().join("m.exr"), exr).expect("writable");
        std::fs::write(folder.path().join("m.npy"), npy::tests::encode("<f4", "(2, 3)", &floats)).expect("writable");
        let expected = Map { width: 3, height: 2, values: floats };
        for name in ["m.png", "m.exr", "m.npy"] {
            assert_eq!(read_map(&folder.path().join(name)).expect(name), expected, "{name}");
        }
    }
}
