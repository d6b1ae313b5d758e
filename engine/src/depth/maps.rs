//! Depth maps from files, one for each frame.
//!
//! A map holds *inverse* depth (larger is nearer) in any scale, or depth itself ([`Values::Depth`]), which is inverted.
//! Depth values that are not above zero, not finite or NaN were not measured and become NaN. Files are EXR (the depth
//! channel, by name), PNG of 8 or 16 bits grey, TIFF of one integer or float sample per pixel, or NPY (any plain
//! number; `[H,W]` with any axes of length 1; either order). Samples are read as they are stored. A map whose size
//! differs from its frame's is resized bilinearly (half-pixel centres).
//!
//! If files of several kinds share names, such as maps and their previews, one kind is read: the first of NPY, EXR,
//! TIFF and PNG that exists for every name. Maps are matched to frames by name if every frame is a file with a map of
//! the same name (extensions aside), else by natural order. [`Range::Clip`] normalises all maps by the smallest and
//! largest value of the whole folder, [`Range::Every`] by those of the key frames' maps. With [`Range::Frame`], the
//! engine normalises each map by its own range.

use std::path::{Path, PathBuf};

use image::DynamicImage;

use super::{DepthError, exr, npy};
use crate::folder;
use crate::picture::resize_planes;
use crate::source::{SourceError, decode};

/// File name endings taken as depth maps.
pub const EXTENSIONS: [&str; 5] = ["exr", "png", "npy", "tif", "tiff"];
/// Kinds of files in order of preference if several share names.
const KINDS: [&[&str]; 4] = [&["npy"], &["exr"], &["tif", "tiff"], &["png"]];

/// Range used to normalise the values of a map.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Range {
    /// Each map's own smallest and largest value (done by the engine).
    #[default]
    Frame,
    /// The smallest and largest value of the whole folder, for all maps.
    Clip,
    /// The smallest and largest value of the maps of every n-th frame and of the last one, for all maps. These are the
    /// key frames with a gap of n. 0 is 1.
    Every(usize),
}

/// Kind of the values in the files.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Values {
    /// Inverse depth.
    #[default]
    Inverse,
    /// Depth in any unit; values that are not above zero, or not finite, were not measured.
    Depth,
}

impl Values {
    /// Converts a value to inverse depth.
    fn inverse(self, value: f32) -> f32 {
        match self {
            Values::Inverse => value,
            Values::Depth if value > 0.0 && value.is_finite() => 1.0 / value,
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
    /// Smallest and largest value of the maps that determine the range; `None` with [`Range::Frame`].
    range: Option<(f32, f32)>,
    /// Note on the files that are left out.
    notes: Vec<String>,
}

impl DepthMaps {
    /// Lists the maps of `folder` and pairs them with `frames` if the frames are files. With [`Range::Clip`] and
    /// [`Range::Every`], the maps that determine the range are read once.
    ///
    /// # Errors
    /// An unreadable or empty folder; files of several kinds with none that has every name; a number of maps other than
    /// that of the frames; an unreadable map among those that determine the range.
    pub fn open(folder: &Path, frames: Option<&[PathBuf]>, range: Range) -> Result<DepthMaps, DepthError> {
        Self::open_as(folder, frames, range, Values::Inverse)
    }

    /// Opens a folder as [`DepthMaps::open`] does, for files with this kind of values.
    ///
    /// # Errors
    /// As there.
    pub fn open_as(
        folder: &Path,
        frames: Option<&[PathBuf]>,
        range: Range,
        kind: Values,
    ) -> Result<DepthMaps, DepthError> {
        let listed = folder::list(folder, &EXTENSIONS).map_err(SourceError::read(folder))?;
        if listed.is_empty() {
            return Err(DepthError::Empty(folder.to_owned()));
        }
        let (mut files, mut notes) = of_one_kind(folder, listed)?;
        if let Some(frames) = frames {
            let by_name: Option<Vec<PathBuf>> = frames
                .iter()
                .map(|frame| files.iter().find(|map| map.file_stem() == frame.file_stem()).cloned())
                .collect();
            match by_name {
                Some(paired) => {
                    let (used, found) = (paired.len(), files.len());
                    if found > used {
                        let of = if used == 1 { "frame" } else { "frames" };
                        notes.push(format!(
                            "{} of {found} depth maps have the names of no {of} and are left out",
                            found - used
                        ));
                    }
                    files = paired;
                }
                None if files.len() == frames.len() => {}
                None => {
                    let (expected, found) = (frames.len(), files.len());
                    return Err(DepthError::Count { folder: folder.to_owned(), expected, found });
                }
            }
        }
        let mut maps = DepthMaps { folder: folder.to_owned(), files, kind, range: None, notes };
        let step = match range {
            Range::Frame => None,
            Range::Clip => Some(1),
            Range::Every(n) => Some(n.max(1)),
        };
        if let Some(step) = step {
            let mut limits = (f32::INFINITY, f32::NEG_INFINITY);
            let last = maps.files.len().saturating_sub(1);
            let deciding = maps.files.iter().enumerate().filter(|(i, _)| i % step == 0 || *i == last);
            for (_, file) in deciding {
                let inverse = measured(file, kind)?.values.into_iter().map(|value| kind.inverse(value));
                for value in inverse.filter(|value| value.is_finite()) {
                    limits = (limits.0.min(value), limits.1.max(value));
                }
            }
            maps.range = Some(limits);
        }
        Ok(maps)
    }

    /// Returns a note on the files that are left out.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Checks that the number of maps is that of the frames, or of the first `limit` of them.
    ///
    /// # Errors
    /// Another number of maps.
    pub fn check(&self, frames: usize, limit: Option<usize>) -> Result<(), DepthError> {
        let expected = limit.map_or(frames, |limit| limit.min(frames));
        let found = self.files.len();
        if found == frames || found == expected {
            return Ok(());
        }
        Err(DepthError::Count { folder: self.folder.clone(), expected, found })
    }

    /// Checks as [`DepthMaps::check`] does if the number of frames is an estimate: a few more or fewer maps are
    /// accepted.
    ///
    /// # Errors
    /// A number of maps that cannot be that of the frames.
    pub fn check_about(&self, frames: usize, limit: Option<usize>) -> Result<(), DepthError> {
        match self.files.len().abs_diff(frames) > (frames / 50).max(2) {
            true => self.check(frames, limit),
            false => Ok(()),
        }
    }

    /// Returns the inverse depth of frame `index` at the frame's size, NaN where it was not measured. With
    /// [`Range::Clip`] it is normalised to `[0, 1]`. With [`Range::Every`] only the maps that determine the range are
    /// certain to be within it.
    ///
    /// # Errors
    /// A missing or unreadable map.
    pub fn map(&self, index: usize, width: usize, height: usize) -> Result<Vec<f32>, DepthError> {
        let missing = || DepthError::Missing { folder: self.folder.clone(), frame: index, found: self.files.len() };
        let mut map = measured(self.files.get(index).ok_or_else(missing)?, self.kind)?;
        map.values.iter_mut().for_each(|v| *v = self.kind.inverse(*v));
        if let Some((least, most)) = self.range {
            let span = most - least;
            // A constant clip becomes 0, like a constant map.
            map.values.iter_mut().for_each(|v| *v = if span > 0.0 { (*v - least) / span } else { 0.0 });
        }
        if (map.width, map.height) == (width, height) {
            return Ok(map.values);
        }
        if is_turned([map.width, map.height], [width, height]) {
            let path = self.files.get(index).cloned().unwrap_or_default();
            let cause = format!(
                "expected the shape of frames of {width}×{height}, found {}×{}: a map that is turned by a quarter",
                map.width, map.height
            );
            return Err(DepthError::Map { path, cause });
        }
        Ok(resize_planes(&map.values, [map.height, map.width], [height, width]))
    }
}

impl DepthMaps {
    /// Returns true for a map of [`DepthMaps::map`] without depth to use: nothing was measured, or everything has one
    /// value, unless that is a part of a larger range.
    pub(crate) fn is_flat(&self, map: &[f32]) -> bool {
        let mut measured = map.iter().filter(|value| value.is_finite());
        let ranges = self.range.is_some_and(|(least, most)| most > least);
        measured.next().is_none_or(|first| !ranges && measured.all(|value| value == first))
    }
}

/// Returns true if a map has the proportions of its frame with width and height interchanged.
fn is_turned([wide, high]: [usize; 2], [width, height]: [usize; 2]) -> bool {
    let (map, frame) = (wide as f64 / high as f64, width as f64 / height as f64);
    let clear = frame.max(1.0 / frame) > 1.2;
    clear && (map * frame - 1.0).abs() < 0.05
}

/// Selects the files of one kind if files of several share names; also returns the files left out.
fn of_one_kind(folder: &Path, files: Vec<PathBuf>) -> Result<(Vec<PathBuf>, Vec<String>), DepthError> {
    let mut names: Vec<_> = files.iter().map(|file| file.file_stem()).collect();
    names.sort_unstable();
    names.dedup();
    if names.len() == files.len() {
        return Ok((files, Vec::new()));
    }
    let count = |kind: &&[&str]| files.iter().filter(|file| folder::ends_in(file, kind)).count();
    let Some(kind) = KINDS.into_iter().find(|kind| count(kind) == names.len()) else {
        let counts: Vec<String> =
            KINDS.iter().filter(|kind| count(kind) > 0).map(|kind| format!("{} .{}", count(kind), kind[0])).collect();
        return Err(DepthError::Kinds { folder: folder.to_owned(), names: names.len(), found: counts.join(", ") });
    };
    let (taken, left): (Vec<PathBuf>, Vec<PathBuf>) = files.into_iter().partition(|file| folder::ends_in(file, kind));
    let line = format!(
        "depth is taken from {} .{} files, {} other files of the same names are left out",
        taken.len(),
        kind[0],
        left.len()
    );
    Ok((taken, vec![line]))
}

/// Reads one map; values may be NaN where they were not measured.
///
/// # Errors
/// Unreadable, broken, oversized or many-channelled files.
pub fn read_map(path: &Path) -> Result<Map, DepthError> {
    decode_map(&decode::read_file(path)?, path)
}

/// Reads a map held in memory; `path` marks an NPY file and is used in messages.
///
/// # Errors
/// Those of [`read_map`], except errors of reading the file.
pub fn decode_map(bytes: &[u8], path: &Path) -> Result<Map, DepthError> {
    let wrong = |cause: String| DepthError::Map { path: path.to_owned(), cause };
    if folder::ends_in(path, &["npy"]) {
        return npy::read(bytes).map_err(wrong);
    }
    if bytes.starts_with(&[0x76, 0x2f, 0x31, 0x01]) {
        return exr::read(bytes).map_err(wrong);
    }
    if decode::is_tiff(bytes) {
        let (width, height, values) = decode::tiff_grey(bytes, path)?;
        return Ok(Map { width, height, values });
    }
    match decode::decode_dynamic(bytes, path)? {
        DynamicImage::ImageLuma8(i) => Ok(Map {
            width: i.width() as usize,
            height: i.height() as usize,
            values: i.as_raw().iter().map(|&v| f32::from(v)).collect(),
        }),
        DynamicImage::ImageLuma16(i) => Ok(Map {
            width: i.width() as usize,
            height: i.height() as usize,
            values: i.as_raw().iter().map(|&v| f32::from(v)).collect(),
        }),
        other => Err(wrong(format!("expected a grey PNG of 8 or 16 bits, found {:?}", other.color()))),
    }
}

/// Reads one map. In depth, NaN or infinity marks a value that was not measured. In inverse depth, which has no such
/// convention, it is an error.
fn measured(path: &Path, kind: Values) -> Result<Map, DepthError> {
    let map = read_map(path)?;
    if kind == Values::Inverse
        && let Some(position) = map.values.iter().position(|v| !v.is_finite())
    {
        let (x, y, value) = (position % map.width, position / map.width, map.values[position]);
        let cause = format!(
            "the inverse depth at x={x}, y={y} is {value}, expected a finite number (with --depth-model metric, which takes files as depth, it would be one that was not measured)"
        );
        return Err(DepthError::Map { path: path.to_owned(), cause });
    }
    Ok(map)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::openexr;

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
        assert_eq!(maps.notes(), ["1 of 3 depth maps have the names of no frames and are left out"]);
        let error =
            DepthMaps::open(folder.path(), Some(&[PathBuf::from("c.jpg")]), Range::Frame).expect_err("three maps");
        assert!(error.to_string().ends_with("expected 1 depth maps, one for each frame, found 3"), "{error}");
    }

    #[test]
    fn a_map_that_is_turned_is_refused() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        png16(&folder.path().join("1.png"), 2, vec![1, 2, 3, 4, 5, 6]);
        let maps = DepthMaps::open(folder.path(), None, Range::Frame).expect("a map");
        for (width, height) in [(3, 2), (30, 20)] {
            let error = maps.map(0, width, height).expect_err("turned").to_string();
            assert!(error.contains(&format!("frames of {width}×{height}, found 2×3: a map that is turned")), "{error}");
        }
        for (width, height) in [(2, 3), (20, 30), (8, 8), (4, 3)] {
            assert_eq!(maps.map(0, width, height).expect("of its shape, or near").len(), width * height);
        }
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
    fn key_frames_are_normalised_by_their_own_maps_alone() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        for (name, values) in [("1", [10, 20]), ("2", [0, 90]), ("3", [20, 50]), ("4", [90, 0]), ("5", [30, 60])] {
            png16(&folder.path().join(format!("{name}.png")), 2, values.to_vec());
        }
        // Frames 0, 2 and 4, and frames 0, 3 and the last one.
        let maps = DepthMaps::open(folder.path(), None, Range::Every(2)).expect("five maps");
        assert_eq!(maps.map(2, 2, 1).expect("readable"), [0.2, 0.8]);
        assert_eq!(maps.map(4, 2, 1).expect("readable"), [0.4, 1.0]);
        let maps = DepthMaps::open(folder.path(), None, Range::Every(3)).expect("five maps");
        assert_eq!(maps.map(3, 2, 1).expect("readable"), [1.0, 0.0]);
        assert_eq!(maps.map(4, 2, 1).expect("readable"), [1.0 / 3.0, 2.0 / 3.0]);
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
    fn maps_without_depth_to_use_are_flat() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        for (name, values) in [("1", [0, 0]), ("2", [7, 7]), ("3", [0, 7]), ("4", [8, 9])] {
            png16(&folder.path().join(format!("{name}.png")), 2, values.to_vec());
        }
        for (range, flat) in [(Range::Frame, [true, true, true, false]), (Range::Clip, [true, false, false, false])] {
            let maps = DepthMaps::open_as(folder.path(), None, range, Values::Depth).expect("four maps");
            assert_eq!([0, 1, 2, 3].map(|i| maps.is_flat(&maps.map(i, 2, 1).expect("readable"))), flat);
        }
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

    #[test]
    fn depth_that_was_not_measured_is_no_number() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let values = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 0.0, -1.0, 4.0];
        std::fs::write(folder.path().join("1.npy"), npy::tests::encode("<f4", "(2, 3)", &values)).expect("writable");
        let maps = DepthMaps::open_as(folder.path(), None, Range::Frame, Values::Depth).expect("a map");
        let map = maps.map(0, 3, 2).expect("readable");
        assert!(map[..5].iter().all(|v| v.is_nan()) && map[5] == 0.25, "{map:?}");
        let maps = DepthMaps::open(folder.path(), None, Range::Frame).expect("a map");
        let error = maps.map(0, 3, 2).expect_err("inverse depth").to_string();
        assert!(error.contains("the inverse depth at x=0, y=0 is NaN, expected a finite number"), "{error}");
    }

    #[test]
    fn maps_beside_their_previews_are_told_apart() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        for name in ["1", "2"] {
            png16(&folder.path().join(format!("{name}.png")), 2, vec![7, 7]);
            let bytes = npy::tests::encode("<f4", "(1, 2)", &[1.0, 2.0]);
            std::fs::write(folder.path().join(format!("{name}.npy")), bytes).expect("writable");
        }
        let maps = DepthMaps::open(folder.path(), None, Range::Frame).expect("two maps");
        assert_eq!(maps.map(1, 2, 1).expect("readable"), [1.0, 2.0]);
        assert_eq!(maps.notes(), ["depth is taken from 2 .npy files, 2 other files of the same names are left out"]);
        assert!(maps.check(2, None).is_ok() && maps.check(5, Some(2)).is_ok() && maps.check(2, Some(1)).is_ok());
        for (frames, limit) in [(1, None), (3, None), (9, Some(3)), (9, Some(1))] {
            let error = maps.check(frames, limit).expect_err("another number").to_string();
            assert!(error.contains("one for each frame, found 2"), "{error}");
        }
        // Matched by name, too.
        let frames = [PathBuf::from("x/2.jpg")];
        let maps = DepthMaps::open(folder.path(), Some(&frames), Range::Frame).expect("one map");
        assert_eq!(maps.map(0, 2, 1).expect("readable"), [1.0, 2.0]);
        std::fs::remove_file(folder.path().join("1.npy")).expect("there");
        std::fs::rename(folder.path().join("2.png"), folder.path().join("2.tif")).expect("there");
        let error = DepthMaps::open(folder.path(), None, Range::Frame).expect_err("mixed").to_string();
        assert!(error.contains("2 names, found 1 .npy, 1 .tif, 1 .png"), "{error}");
    }

    #[test]
    fn tiff_maps_are_taken_as_they_are_stored() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        type Encoder<'a> = tiff::encoder::TiffEncoder<&'a mut std::io::Cursor<Vec<u8>>>;
        let write = |name: &str, write: &dyn Fn(&mut Encoder<'_>)| {
            let mut bytes = std::io::Cursor::new(Vec::new());
            write(&mut tiff::encoder::TiffEncoder::new(&mut bytes).expect("memory"));
            std::fs::write(folder.path().join(name), bytes.into_inner()).expect("writable");
            read_map(&folder.path().join(name))
        };
        use tiff::encoder::colortype::{Gray16, Gray32Float, RGB8};
        let whole = write("1.tif", &|e| e.write_image::<Gray16>(2, 1, &[7, 40_000]).expect("memory"));
        assert_eq!(whole.expect("grey").values, [7.0, 40_000.0]);
        let float = write("2.tiff", &|e| e.write_image::<Gray32Float>(2, 1, &[0.5, f32::NAN]).expect("memory"));
        let float = float.expect("grey").values;
        assert!(float[0] == 0.5 && float[1].is_nan());
        let colour = write("3.tif", &|e| e.write_image::<RGB8>(1, 1, &[1, 2, 3]).expect("memory"));
        assert!(colour.expect_err("colour").to_string().contains("expected a grey TIFF of one sample a pixel"));
    }
}
