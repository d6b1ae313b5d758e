//! The cameras and images of a COLMAP model, as text or binary.
//!
//! An image has the rotation (quaternion w, x, y, z) and the translation that take the world into the camera (x right, y down, z
//! forward); its centre is −Rᵀt. Cameras are `SIMPLE_PINHOLE` (f, cx, cy) or `PINHOLE` (fx, fy, cx, cy), in pixels counted from the corner
//! of the first one. Images are ordered by their names, numbers in them by value.

use std::collections::BTreeMap;

use super::{CameraSet, NamedCamera, pinhole};
use crate::camera::{Pose, Rotation};
use crate::import::FormatError;
use crate::source::natural;

const FORMAT: &str = "COLMAP model";

/// Names and numbers of parameters of the camera models, by their number in binary files.
const MODELS: [(&str, usize); 12] = [
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 5),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
];

/// A camera of `cameras.txt` or `cameras.bin`.
struct Intrinsics {
    model: String,
    size: [f64; 2],
    parameters: Vec<f64>,
}

/// An image of `images.txt` or `images.bin`.
struct Extrinsics {
    name: String,
    quaternion: [f64; 4],
    translation: [f64; 3],
    camera: u32,
}

/// Reads `cameras.txt` and `images.txt`.
///
/// # Errors
/// Lines of another form, cameras with distortion, images whose camera is missing.
pub fn text(cameras: &[u8], images: &[u8]) -> Result<CameraSet, FormatError> {
    let utf8 = |part: &str, bytes| {
        std::str::from_utf8(bytes).map_err(|_| FormatError::new(part.to_owned(), "text in UTF-8", "other bytes"))
    };
    let (cameras, images) = (utf8("cameras.txt", cameras)?, utf8("images.txt", images)?);
    let mut intrinsics = BTreeMap::new();
    for (at, line) in cameras.lines().enumerate().filter(|(_, line)| holds_something(line)) {
        let fail = || {
            FormatError::new(
                format!("cameras.txt, line {}", at + 1),
                "CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]",
                "another",
            )
        };
        let mut words = line.split_whitespace();
        let id: u32 = number(words.next()).ok_or_else(fail)?;
        let model = words.next().ok_or_else(fail)?.to_owned();
        let size = [number(words.next()).ok_or_else(fail)?, number(words.next()).ok_or_else(fail)?];
        let parameters: Option<Vec<f64>> = words.map(|word| number(Some(word))).collect();
        intrinsics.insert(id, Intrinsics { model, size, parameters: parameters.ok_or_else(fail)? });
    }
    let mut extrinsics = Vec::new();
    let mut lines = images.lines().enumerate();
    while let Some((at, line)) = lines.next() {
        if !holds_something(line) {
            continue;
        }
        let expected = "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME";
        let fail = || FormatError::new(format!("images.txt, line {}", at + 1), expected, "another");
        let mut rest = line.trim();
        let mut word = || {
            let (word, after) = rest.split_once(char::is_whitespace)?;
            rest = after.trim_start();
            Some(word)
        };
        let _id: u32 = number(word()).ok_or_else(fail)?;
        let mut numbers = [0.0; 7];
        for value in &mut numbers {
            *value = number(word()).ok_or_else(fail)?;
        }
        let camera = number(word()).ok_or_else(fail)?;
        let [w, x, y, z, tx, ty, tz] = numbers;
        let name = rest.to_owned();
        extrinsics.push(Extrinsics { name, quaternion: [w, x, y, z], translation: [tx, ty, tz], camera });
        // The points seen in the image; the line may be empty.
        lines.next();
    }
    join(&intrinsics, extrinsics)
}

fn holds_something(line: &str) -> bool {
    let line = line.trim();
    !line.is_empty() && !line.starts_with('#')
}

fn number<T: std::str::FromStr>(word: Option<&str>) -> Option<T> {
    word?.parse().ok()
}

/// The bytes of a binary file that are not read yet.
struct Bytes<'a> {
    part: &'static str,
    rest: &'a [u8],
}

impl<'a> Bytes<'a> {
    fn end(&self) -> FormatError {
        FormatError::new(self.part, "more bytes", "its end")
    }

    fn take(&mut self, count: usize) -> Result<&'a [u8], FormatError> {
        let (taken, rest) = self.rest.split_at_checked(count).ok_or_else(|| self.end())?;
        self.rest = rest;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], FormatError> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(N)?);
        Ok(array)
    }

    fn u32(&mut self) -> Result<u32, FormatError> {
        Ok(u32::from_le_bytes(self.array()?))
    }

    fn u64(&mut self) -> Result<u64, FormatError> {
        Ok(u64::from_le_bytes(self.array()?))
    }

    fn f64(&mut self) -> Result<f64, FormatError> {
        Ok(f64::from_le_bytes(self.array()?))
    }
}

/// Reads `cameras.bin` and `images.bin`.
///
/// # Errors
/// Files that end early, cameras with distortion, images whose camera is missing.
pub fn binary(cameras: &[u8], images: &[u8]) -> Result<CameraSet, FormatError> {
    let mut bytes = Bytes { part: "cameras.bin", rest: cameras };
    let mut intrinsics = BTreeMap::new();
    // Counts are not believed: every entry takes bytes that must be there.
    for _ in 0..bytes.u64()? {
        let (id, model) = (bytes.u32()?, bytes.u32()?);
        let known = usize::try_from(model).ok().and_then(|model| MODELS.get(model));
        let Some(&(model, count)) = known else {
            return Err(FormatError::new("cameras.bin", "camera models 0 to 11", model.to_string()));
        };
        let size = [bytes.u64()? as f64, bytes.u64()? as f64];
        let parameters: Result<Vec<f64>, FormatError> = (0..count).map(|_| bytes.f64()).collect();
        intrinsics.insert(id, Intrinsics { model: model.to_owned(), size, parameters: parameters? });
    }
    let mut bytes = Bytes { part: "images.bin", rest: images };
    let mut extrinsics = Vec::new();
    for _ in 0..bytes.u64()? {
        let _id = bytes.u32()?;
        let mut numbers = [0.0; 7];
        for value in &mut numbers {
            *value = bytes.f64()?;
        }
        let camera = bytes.u32()?;
        let length = bytes.rest.iter().position(|byte| *byte == 0).ok_or_else(|| bytes.end())?;
        let name = String::from_utf8_lossy(bytes.take(length)?).into_owned();
        bytes.take(1)?;
        let points = bytes.u64()?;
        // Two coordinates and a number each.
        let skipped =
            usize::try_from(points).ok().and_then(|points| points.checked_mul(24)).ok_or_else(|| bytes.end())?;
        bytes.take(skipped)?;
        let [w, x, y, z, tx, ty, tz] = numbers;
        extrinsics.push(Extrinsics { name, quaternion: [w, x, y, z], translation: [tx, ty, tz], camera });
    }
    join(&intrinsics, extrinsics)
}

fn join(intrinsics: &BTreeMap<u32, Intrinsics>, mut images: Vec<Extrinsics>) -> Result<CameraSet, FormatError> {
    images.sort_by(|a, b| natural::compare(a.name.as_bytes(), b.name.as_bytes()).then_with(|| a.name.cmp(&b.name)));
    let cameras: Result<Vec<NamedCamera>, FormatError> =
        images.into_iter().map(|image| camera(intrinsics, image)).collect();
    CameraSet::new(FORMAT, cameras?)
}

fn camera(intrinsics: &BTreeMap<u32, Intrinsics>, image: Extrinsics) -> Result<NamedCamera, FormatError> {
    let Extrinsics { name, quaternion, translation, camera } = image;
    let part = format!("camera {camera}");
    let Some(Intrinsics { model, size, parameters }) = intrinsics.get(&camera) else {
        return Err(FormatError::new(name, format!("{part} to be listed"), "none"));
    };
    let (focal, centre) = match (model.as_str(), parameters.as_slice()) {
        ("SIMPLE_PINHOLE", &[f, cx, cy]) => ([f; 2], [cx, cy]),
        ("PINHOLE", &[fx, fy, cx, cy]) => ([fx, fy], [cx, cy]),
        ("SIMPLE_PINHOLE" | "PINHOLE", other) => {
            let expected = if model == "PINHOLE" { 4 } else { 3 };
            return Err(FormatError::new(part, format!("{expected} parameters"), other.len().to_string()));
        }
        _ => {
            let expected = "SIMPLE_PINHOLE or PINHOLE (undistort the images first: colmap image_undistorter)";
            return Err(FormatError::new(part, expected, model.clone()));
        }
    };
    let Some(rotation) = Rotation::from_quaternion(quaternion) else {
        return Err(FormatError::new(name, "a quaternion other than zero", format!("{quaternion:?}")));
    };
    let rotation = rotation.inverse();
    let [x, y, z] = translation;
    let position = rotation.matrix().map(|row| -(row[0] * x + row[1] * y + row[2] * z));
    pinhole(name, Pose { position, rotation }, *size, focal, centre)
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERAS: &str = "# a comment\n1 SIMPLE_PINHOLE 40 30 35 20 15\n7 PINHOLE 40 30 35 36 19 14.5\n";
    const IMAGES: &str = "# a comment\n1 1 0 0 0 0 0 2 1 b 10.png\n\n2 0.5 0.5 0.5 0.5 1 2 3 7 b 9.png\n1 2 3 4 5 6\n";

    fn binary_files() -> (Vec<u8>, Vec<u8>) {
        let (mut cameras, mut images) = (2_u64.to_le_bytes().to_vec(), 2_u64.to_le_bytes().to_vec());
        for (id, model, parameters) in [(1_u32, 0_u32, &[35.0, 20.0, 15.0][..]), (7, 1, &[35.0, 36.0, 19.0, 14.5])] {
            cameras.extend(id.to_le_bytes());
            cameras.extend(model.to_le_bytes());
            [40_u64, 30].iter().for_each(|side| cameras.extend(side.to_le_bytes()));
            parameters.iter().for_each(|p: &f64| cameras.extend(p.to_le_bytes()));
        }
        let second = [0.5, 0.5, 0.5, 0.5, 1.0, 2.0, 3.0];
        for (numbers, camera, name, points) in
            [([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0], 1_u32, "b 10.png", 0_u64), (second, 7, "b 9.png", 2)]
        {
            images.extend(3_u32.to_le_bytes());
            numbers.iter().for_each(|n: &f64| images.extend(n.to_le_bytes()));
            images.extend(camera.to_le_bytes());
            images.extend(name.as_bytes());
            images.push(0);
            images.extend(points.to_le_bytes());
            images.extend(vec![9; 24 * points as usize]);
        }
        (cameras, images)
    }

    #[test]
    fn text_and_binary_give_the_same_cameras_in_the_order_of_their_names() {
        let set = text(CAMERAS.as_bytes(), IMAGES.as_bytes()).expect("a model");
        let names: Vec<&str> = set.cameras.iter().map(|camera| camera.name.as_str()).collect();
        assert_eq!(names, ["b 9.png", "b 10.png"]);
        let (cameras, images) = binary_files();
        assert_eq!(binary(&cameras, &images), Ok(set));
        for length in 0..images.len() {
            assert!(binary(&cameras, &images[..length]).is_err(), "{length}");
        }
        for length in 0..cameras.len() {
            assert!(binary(&cameras[..length], &images).is_err(), "{length}");
        }
    }

    #[test]
    fn cameras_with_distortion_are_refused_by_name() {
        let radial = CAMERAS.replace("1 SIMPLE_PINHOLE 40 30 35 20 15", "1 SIMPLE_RADIAL 40 30 35 20 15 0.1");
        let error = text(radial.as_bytes(), IMAGES.as_bytes()).expect_err("distorted").to_string();
        assert!(
            error.contains("camera 1: expected SIMPLE_PINHOLE or PINHOLE") && error.ends_with("SIMPLE_RADIAL"),
            "{error}"
        );
        let error = text(b"1 PINHOLE 4 3 1 2", IMAGES.as_bytes()).expect_err("short").to_string();
        assert!(error.contains("expected camera 7 to be listed") || error.contains("expected 4 parameters"), "{error}");
    }
}
