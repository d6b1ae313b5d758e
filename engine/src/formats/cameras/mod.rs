//! Camera files of other programs, recognised by content.
//!
//! | input | format | axes of a camera | content read |
//! |---|---|---|---|
//! | a JSON array | `cameras.json` of 3D Gaussian splatting ([`inria`]) | x right, y down, z forward | position, rotation, focal lengths, principal point |
//! | a JSON object with `frames` | `transforms.json` of nerfstudio and instant-ngp ([`transforms`]) | OpenGL: x right, y up, z backward | poses, focal lengths or angles, principal point |
//! | a JSON object with `camera_path` | the camera path of nerfstudio's viewer ([`camera_path`]) | OpenGL | poses, fields of view, images per second |
//! | a JSON object with `cameras`, `animTracks`, or `camera` | `settings.json` of SuperSplat ([`supersplat`]) | a target point | the first camera, or the animation |
//! | a folder, or a file in it, with `cameras` and `images` as `.bin` or `.txt` | a COLMAP model ([`colmap`]) | x right, y down, z forward | poses, rigs, cameras `SIMPLE_PINHOLE` and `PINHOLE` |
//! | a JSON object with `type` or `views` | this program's own ([`mod@file`]) | x right, y down, z forward | a camera or a path |
//!
//! World axes and units are those of the file, which are those of a scene that was trained with it. Nothing is turned
//! or scaled, except for SuperSplat, which shows scenes turned. For a view through a lens with distortion, the error
//! names the distortion, and the other views are drawn. Other programs count pixels from the corner of the first pixel,
//! and so does [`Lens::Pinhole`]: the middle of the first pixel is at half a pixel.

pub mod camera_path;
pub mod colmap;
pub mod inria;
pub mod supersplat;
pub mod transforms;

use std::path::{Path, PathBuf};

use serde_json::Value;

use super::{FormatError, read_file};
use crate::camera::{Camera, CameraError, CameraPath, Lens, Pose, Rotation, file, json};
use crate::picture::MAX_SIDE;

/// Longest JSON file that is read, in bytes.
const MAX_JSON: u64 = 1 << 26;
/// Longest file of a COLMAP model that is read, in bytes: `images.bin` also holds the matches of the images.
const MAX_COLMAP: u64 = 1 << 30;
/// The supported files, for messages.
const READ: &str = "a camera of this program (an object with type or views), cameras.json of 3D Gaussian splatting (an array), \
    transforms.json (frames), nerfstudio's camera_path.json (camera_path), SuperSplat's settings.json (cameras or animTracks), \
    or a COLMAP model (a folder)";

/// A camera with the size of its image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SizedCamera {
    /// The camera.
    pub camera: Camera,
    /// Width and height of its image, in pixels.
    pub size: [usize; 2],
}

/// A camera of a set.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedCamera {
    /// Its image's name.
    pub name: String,
    /// The camera, or the reason why it cannot be used.
    pub camera: Result<SizedCamera, FormatError>,
}

/// The cameras in a file of another program.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraSet {
    /// The format's name.
    pub format: &'static str,
    /// The cameras in the file's order; those of a COLMAP model by name.
    pub cameras: Vec<NamedCamera>,
    /// Cameras that can be selected by name but are not part of the path.
    pub aside: Vec<NamedCamera>,
    /// Cameras per second, if they are images of a video.
    pub rate: Option<f64>,
}

impl CameraSet {
    fn new(format: &'static str, cameras: Vec<NamedCamera>) -> Result<Self, FormatError> {
        if cameras.is_empty() {
            return Err(FormatError::new(format, "at least one camera", "none"));
        }
        Ok(Self { format, cameras, aside: Vec::new(), rate: None })
    }

    /// Returns the camera that `text` selects: by its index from 0, its image's name, or that name without folders or
    /// ending.
    ///
    /// # Errors
    /// No camera of that name, or several.
    pub fn find(&self, text: &str) -> Result<&NamedCamera, FormatError> {
        let count = self.cameras.len();
        let number = text.parse::<usize>().ok();
        if let Some(camera) = number.filter(|n| n.to_string() == text).and_then(|n| self.cameras.get(n)) {
            return Ok(camera);
        }
        let tests: [fn(&str) -> &str; 3] = [
            |name| name,
            |name| name.rsplit(['/', '\\']).next().unwrap_or(name),
            |name| {
                let file = name.rsplit(['/', '\\']).next().unwrap_or(name);
                file.rsplit_once('.').map_or(file, |(stem, _)| stem)
            },
        ];
        for test in tests {
            let all = self.cameras.iter().chain(&self.aside);
            let mut found = all.filter(|camera| test(&camera.name) == text);
            match (found.next(), found.next()) {
                (Some(camera), None) => return Ok(camera),
                (Some(_), Some(_)) => {
                    return Err(FormatError::new(
                        "view",
                        "the name of one camera",
                        format!("{text}, which several have"),
                    ));
                }
                (None, _) => {}
            }
        }
        let first = &self.cameras[0].name;
        Err(FormatError::new("view", format!("a number from 0 to {} or a name such as {first}", count - 1), text))
    }

    /// Returns the cameras in order.
    ///
    /// # Errors
    /// The error of the first camera that cannot be used.
    pub fn usable(&self) -> Result<Vec<SizedCamera>, FormatError> {
        self.cameras.iter().map(|named| named.camera.clone()).collect()
    }

    /// Returns the time of camera `index` in seconds, at [`CameraSet::rate`] or one camera per second.
    pub fn time(&self, index: usize) -> f64 {
        index as f64 / self.rate.unwrap_or(1.0)
    }

    /// Returns a path through all cameras, at their times.
    ///
    /// # Errors
    /// As [`CameraSet::usable`].
    pub fn path(&self) -> Result<CameraPath, FormatError> {
        let views = self.usable()?.into_iter().enumerate().map(|(i, sized)| (self.time(i), sized.camera)).collect();
        CameraPath::new(views).ok_or_else(|| FormatError::new(self.format, "cameras at times that ascend", "others"))
    }
}

/// Cameras of any supported kind.
#[derive(Clone, Debug, PartialEq)]
pub enum CameraFile {
    /// This program's own: a camera or a path.
    Own(CameraPath),
    /// Another program's.
    Set(CameraSet),
}

/// Error of reading a camera file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CameraFileError {
    /// The file cannot be read.
    #[error("{}: {cause}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's error.
        cause: std::io::Error,
    },
    /// Error in a file in this program's own format.
    #[error("{}: {cause}", path.display())]
    Own {
        /// The file.
        path: PathBuf,
        /// The error.
        cause: CameraError,
    },
    /// Error in a file of another program.
    #[error("{}: {cause}", path.display())]
    Format {
        /// The file or folder.
        path: PathBuf,
        /// The error.
        cause: FormatError,
    },
}

/// Opens a file or a folder of cameras. `size` (width and height) is used if the file has no image size.
///
/// # Errors
/// Files that cannot be read or have other content.
pub fn open(path: &Path, size: Option<[usize; 2]>) -> Result<CameraFile, CameraFileError> {
    let format = |cause| CameraFileError::Format { path: path.to_owned(), cause };
    if path.is_dir() {
        return of_colmap(path, &["bin", "txt"]);
    }
    let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
    if let Some((stem, ending @ ("bin" | "txt"))) = name.rsplit_once('.')
        && ["cameras", "images", "rigs", "frames", "points3D"].contains(&stem)
    {
        return of_colmap(path.parent().unwrap_or(Path::new("")), &[ending]);
    }
    let read = |cause| CameraFileError::Read { path: path.to_owned(), cause };
    let bytes = read_file(path, MAX_JSON).map_err(read)?;
    let value = json::value(&bytes).map_err(|[expected, found]| {
        let cause = match expected.as_str() {
            "JSON" => FormatError::new("file", READ, found),
            _ => FormatError::new("JSON", expected, found),
        };
        format(cause)
    })?;
    match of_value(&value, size) {
        Some(set) => set.map(CameraFile::Set).map_err(format),
        None if value.get("type").is_some() || value.get("views").is_some() => file::from_value(value)
            .map(CameraFile::Own)
            .map_err(|cause| CameraFileError::Own { path: path.to_owned(), cause }),
        None => Err(format(FormatError::new("file", READ, json::keys(&value)))),
    }
}

/// Reads the cameras of another program's JSON; `None` for any other text.
pub fn parse(json: &str, size: Option<[usize; 2]>) -> Option<Result<CameraSet, FormatError>> {
    of_value(&json::value(json.as_bytes()).ok()?, size)
}

fn of_value(value: &Value, size: Option<[usize; 2]>) -> Option<Result<CameraSet, FormatError>> {
    let has = |key: &str| value.get(key).is_some();
    if value.is_array() {
        return Some(inria::read(value));
    }
    if has("type") || has("views") {
        return None;
    }
    if has("frames") {
        return Some(transforms::read(value, size));
    }
    if has("camera_path") {
        return Some(camera_path::read(value, size));
    }
    let placed = value.pointer("/camera/position").or(value.pointer("/cameras/0/initial"));
    let supersplat = has("animTracks") || placed.is_some();
    supersplat.then(|| supersplat::read(value, size))
}

fn of_colmap(folder: &Path, endings: &[&str]) -> Result<CameraFile, CameraFileError> {
    let format = |cause| CameraFileError::Format { path: folder.to_owned(), cause };
    for folder in ["", "sparse/0", "sparse", "0"].map(|inner| folder.join(inner)) {
        for ending in endings {
            let path = |name: &str| folder.join(format!("{name}.{ending}"));
            let [cameras, images, rigs, frames] = ["cameras", "images", "rigs", "frames"].map(path);
            if !(cameras.is_file() && images.is_file()) {
                continue;
            }
            let read = |path: &PathBuf| {
                read_file(path, MAX_COLMAP).map_err(|cause| CameraFileError::Read { path: path.clone(), cause })
            };
            let (cameras, images) = (read(&cameras)?, read(&images)?);
            let rigs = if rigs.is_file() && frames.is_file() { Some([read(&rigs)?, read(&frames)?]) } else { None };
            let rigs = rigs.as_ref().map(|files| files.each_ref().map(Vec::as_slice));
            let files = colmap::Files { cameras: &cameras, images: &images, rigs };
            let set = if *ending == "bin" { colmap::binary(&files) } else { colmap::text(&files) };
            return set.map(CameraFile::Set).map_err(format);
        }
    }
    let expected = format!("cameras and images as .{} (a COLMAP model), here or in sparse/0", endings.join(" or ."));
    Err(format(FormatError::new("folder", expected, "neither")))
}

/// Returns a pinhole camera from pixels, counted from the corner of the first one.
fn pinhole(
    name: &str,
    pose: Pose,
    size: [f64; 2],
    focal: [f64; 2],
    centre: [f64; 2],
) -> Result<SizedCamera, FormatError> {
    let whole = |side: f64| side.fract() == 0.0 && (1.0..=MAX_SIDE as f64).contains(&side);
    if !size.iter().all(|side| whole(*side)) {
        let [w, h] = size;
        return Err(FormatError::new(name, format!("images of 1 to {MAX_SIDE} pixels a side"), format!("{w}×{h}")));
    }
    let lens = Lens::Pinhole {
        focal: std::array::from_fn(|i| focal[i] / size[i]),
        centre: std::array::from_fn(|i| centre[i] / size[i]),
    };
    let camera = Camera::Posed { pose, lens };
    if !camera.is_usable() {
        return Err(FormatError::new(name, "finite numbers and focal lengths above 0", "others"));
    }
    Ok(SizedCamera { camera, size: size.map(|side| side as usize) })
}

/// The rotation whose matrix has these columns; an error unless they are orthonormal and right-handed.
fn rotation(name: &str, columns: [[f64; 3]; 3]) -> Result<Rotation, FormatError> {
    Rotation::from_columns(columns)
        .ok_or_else(|| FormatError::new(name, "a rotation (orthonormal, right-handed)", "another matrix"))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a set with four names, all cameras at the origin.
    fn set() -> CameraSet {
        let sized = SizedCamera { camera: Camera::default(), size: [4, 3] };
        let camera = |name: &str| NamedCamera { name: name.into(), camera: Ok(sized) };
        CameraSet::new("test", ["images/a.png", "b.png", "b.jpg", "7"].map(camera).into()).expect("cameras")
    }

    #[test]
    fn a_camera_is_found_by_number_name_file_or_stem() {
        let set = set();
        let at = |text: &str| set.find(text).map(|camera| camera.name.clone());
        assert_eq!(at("0").as_deref(), Ok("images/a.png"));
        assert_eq!(at("images/a.png"), at("a.png"));
        assert_eq!(at("a"), at("0"));
        assert_eq!(at("b.jpg").as_deref(), Ok("b.jpg"));
        assert_eq!(at("7").as_deref(), Ok("7"));
        assert!(at("b").is_err_and(|e| e.to_string().contains("which several have")));
        let error = at("c").expect_err("none").to_string();
        assert_eq!(error, "view: expected a number from 0 to 3 or a name such as images/a.png, found c");
    }

    #[test]
    fn matrices_that_are_no_rotations_are_refused() {
        let unit = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        assert_eq!(rotation("a", unit), Ok(Rotation::IDENTITY));
        let mut mirrored = unit;
        mirrored[2][2] = -1.0;
        assert!(rotation("a", mirrored).is_err());
        assert!(rotation("a", unit.map(|row| row.map(|x| 2.0 * x))).is_err());
        assert!(rotation("a", unit.map(|row| row.map(|x| x * f64::NAN))).is_err());
    }
}
