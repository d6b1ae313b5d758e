//! Cameras that other programs write, told apart by what the files hold.
//!
//! | input | is | axes of a camera | what is read |
//! |---|---|---|---|
//! | a JSON array | `cameras.json` of 3D Gaussian splatting ([`inria`]) | x right, y down, z forward | position, rotation, focal lengths; the principal point is in the middle |
//! | a JSON object with `frames` | `transforms.json` of nerfstudio and instant-ngp ([`transforms`]) | OpenGL: x right, y up, z backward | poses, focal lengths or angles, principal point |
//! | a folder, or a file in it, with `cameras` and `images` as `.bin` or `.txt` | a COLMAP model ([`colmap`]) | x right, y down, z forward | poses, cameras `SIMPLE_PINHOLE` and `PINHOLE` |
//! | any other JSON object | this program's own ([`super::file`]) | x right, y down, z forward | a camera or a path |
//!
//! World axes and units are those of the file, which are those of a scene that was trained with it: nothing is turned or scaled.
//! Lenses with distortion are refused by name. Where other programs count pixels from the corner of the first pixel, so does
//! [`Lens::Pinhole`]: the middle of the first pixel is at half a pixel.

pub mod colmap;
pub mod inria;
pub mod transforms;

use std::path::{Path, PathBuf};

use serde_json::Value;

use super::{Camera, CameraError, CameraPath, Lens, Pose, Rotation, file};
use crate::import::{FormatError, read_file, read_text};
use crate::picture::MAX_SIDE;

/// Longest JSON file that is read, in bytes.
const MAX_JSON: u64 = 1 << 26;
/// Longest file of a COLMAP model that is read, in bytes: `images.bin` also holds what was matched in the images.
const MAX_COLMAP: u64 = 1 << 30;

/// A camera of a set.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedCamera {
    /// Its image's name.
    pub name: String,
    /// The camera.
    pub camera: Camera,
    /// Width and height of its image, in pixels.
    pub size: [usize; 2],
}

/// The cameras of a file of another program.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraSet {
    /// The format's name.
    pub format: &'static str,
    /// The cameras in the file's order; those of a COLMAP model by their names.
    pub cameras: Vec<NamedCamera>,
}

impl CameraSet {
    fn new(format: &'static str, cameras: Vec<NamedCamera>) -> Result<Self, FormatError> {
        if cameras.is_empty() {
            return Err(FormatError::new(format, "at least one camera", "none"));
        }
        Ok(Self { format, cameras })
    }

    /// The camera that `text` means: its number from 0, its image's name, or that without folders or ending.
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
            let mut found = self.cameras.iter().filter(|camera| test(&camera.name) == text);
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

    /// A path through all cameras, one a second from 0.
    pub fn path(&self) -> Option<CameraPath> {
        CameraPath::new(self.cameras.iter().enumerate().map(|(i, named)| (i as f64, named.camera)).collect())
    }
}

/// Cameras of any kind that is read.
#[derive(Clone, Debug, PartialEq)]
pub enum CameraFile {
    /// This program's own: a camera or a path.
    Own(CameraPath),
    /// Another program's.
    Set(CameraSet),
}

/// Why cameras cannot be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CameraFileError {
    /// The system's answer.
    #[error("{}: {cause}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's answer.
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
        /// The file or the folder.
        path: PathBuf,
        /// The error.
        cause: FormatError,
    },
}

/// Opens a file or a folder of cameras. `size` (width and height) is that of images of which the file does not say it.
///
/// # Errors
/// Files that cannot be read, hold something else, or cameras with distortion.
pub fn open(path: &Path, size: Option<[usize; 2]>) -> Result<CameraFile, CameraFileError> {
    let format = |cause| CameraFileError::Format { path: path.to_owned(), cause };
    if path.is_dir() {
        return of_colmap(path);
    }
    let part = |name: &str| path.file_name().is_some_and(|found| found == name);
    if ["cameras.txt", "images.txt", "cameras.bin", "images.bin"].into_iter().any(part) {
        return of_colmap(path.parent().unwrap_or(Path::new("")));
    }
    let read = |cause| CameraFileError::Read { path: path.to_owned(), cause };
    let text = read_text(path, MAX_JSON).map_err(read)?;
    match parse(&text, size) {
        Some(set) => set.map(CameraFile::Set).map_err(format),
        None => file::parse(&text)
            .map(CameraFile::Own)
            .map_err(|cause| CameraFileError::Own { path: path.to_owned(), cause }),
    }
}

/// The cameras of another program's JSON; `None` where the text is none of theirs.
pub fn parse(json: &str, size: Option<[usize; 2]>) -> Option<Result<CameraSet, FormatError>> {
    let value: Value = serde_json::from_str(json).ok()?;
    if value.is_array() {
        return Some(inria::read(value));
    }
    value.get("frames").is_some().then(|| transforms::read(value, size))
}

fn of_colmap(folder: &Path) -> Result<CameraFile, CameraFileError> {
    let format = |cause| CameraFileError::Format { path: folder.to_owned(), cause };
    for folder in [folder.to_owned(), folder.join("sparse/0"), folder.join("sparse"), folder.join("0")] {
        for (ending, reader) in [("bin", colmap::binary as fn(&[u8], &[u8]) -> _), ("txt", colmap::text)] {
            let paths = ["cameras", "images"].map(|name| folder.join(format!("{name}.{ending}")));
            if paths.iter().all(|path| path.is_file()) {
                let read = |path: &PathBuf| {
                    read_file(path, MAX_COLMAP).map_err(|cause| CameraFileError::Read { path: path.clone(), cause })
                };
                return reader(&read(&paths[0])?, &read(&paths[1])?).map(CameraFile::Set).map_err(format);
            }
        }
    }
    let expected = "cameras and images as .bin or .txt (a COLMAP model), here or in sparse/0";
    Err(format(FormatError::new("folder", expected, "neither")))
}

/// A pinhole camera from pixels, counted from the corner of the first one.
fn pinhole(
    name: String,
    pose: Pose,
    size: [f64; 2],
    focal: [f64; 2],
    centre: [f64; 2],
) -> Result<NamedCamera, FormatError> {
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
    Ok(NamedCamera { name, camera, size: size.map(|side| side as usize) })
}

/// The rotation whose matrix has these columns; an error unless they are orthonormal and right-handed.
fn rotation(name: &str, columns: [[f64; 3]; 3]) -> Result<Rotation, FormatError> {
    Rotation::from_columns(columns)
        .ok_or_else(|| FormatError::new(name, "a rotation (orthonormal, right-handed)", "another matrix"))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Four names, all at the origin.
    fn set() -> CameraSet {
        let camera = |name: &str| NamedCamera { name: name.into(), camera: Camera::default(), size: [4, 3] };
        CameraSet { format: "test", cameras: ["images/a.png", "b.png", "b.jpg", "7"].map(camera).into() }
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
