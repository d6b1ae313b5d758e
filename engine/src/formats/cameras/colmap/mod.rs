//! The cameras and images of a COLMAP model, as text or binary.
//!
//! An image has the rotation (quaternion w, x, y, z) and the translation from the world to the camera (x right, y down,
//! z forward); its centre is −Rᵀt. Cameras are `SIMPLE_PINHOLE` (f, cx, cy) or `PINHOLE` (fx, fy, cx, cy), in pixels
//! from the corner of the first one. For any other model, the error of the view names it; other views are not affected.
//! Images are ordered by name, with numbers in names compared by value.
//!
//! COLMAP 4 also stores poses of *frames*, one pose for all cameras of a *rig*, in `rigs` and `frames`. If both files
//! have content, they decide, as in COLMAP itself, and the poses in `images` are ignored:
//!
//! ```text
//! camera_from_world = sensor_from_rig · rig_from_world
//! ```
//!
//! without the first factor for the sensor that is the rig's reference.

mod binary;
mod rigs;
#[cfg(test)]
mod tests;
mod text;

use std::collections::BTreeMap;

use super::{CameraSet, NamedCamera, SizedCamera, pinhole};
use crate::camera::{Pose, Rotation};
use crate::folder::natural;
use crate::formats::FormatError;
use rigs::Rigs;

const FORMAT: &str = "COLMAP model";

/// The files of a model that are read, all text or all binary.
#[derive(Clone, Copy, Debug)]
pub struct Files<'a> {
    /// `cameras`.
    pub cameras: &'a [u8],
    /// `images`.
    pub images: &'a [u8],
    /// `rigs` and `frames`, which COLMAP 3.12 and 4 added.
    pub rigs: Option<[&'a [u8]; 2]>,
}

/// A camera of `cameras`.
struct Intrinsics {
    model: String,
    size: [f64; 2],
    parameters: Vec<f64>,
}

/// An image of `images`.
struct Extrinsics {
    id: u32,
    name: String,
    pose: Rigid,
    camera: u32,
}

/// A change of coordinates: a quaternion (w, x, y, z), then a translation.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Rigid {
    quaternion: [f64; 4],
    translation: [f64; 3],
}

impl Rigid {
    fn new([w, x, y, z, tx, ty, tz]: [f64; 7]) -> Self {
        Self { quaternion: [w, x, y, z], translation: [tx, ty, tz] }
    }

    /// Returns the pose of the camera to whose coordinates this transforms; `None` for a quaternion of zeros.
    fn camera(&self) -> Option<Pose> {
        let rotation = Rotation::from_quaternion(self.quaternion)?.inverse();
        let [x, y, z] = self.translation;
        let position = rotation.matrix().map(|row| -(row[0] * x + row[1] * y + row[2] * z));
        Some(Pose { position, rotation })
    }
}

/// Reads a model whose files are text.
///
/// # Errors
/// Invalid lines. The error of a view that cannot be drawn is in the set.
pub fn text(files: &Files<'_>) -> Result<CameraSet, FormatError> {
    let rigs = files.rigs.map(text::rigs).transpose()?;
    join(&text::cameras(files.cameras)?, text::images(files.images)?, rigs)
}

/// Reads a model whose files are binary.
///
/// # Errors
/// Truncated files and camera models of unknown length. The error of a view that cannot be drawn is in the set.
pub fn binary(files: &Files<'_>) -> Result<CameraSet, FormatError> {
    let rigs = files.rigs.map(binary::rigs).transpose()?;
    join(&binary::cameras(files.cameras)?, binary::images(files.images)?, rigs)
}

fn join(
    intrinsics: &BTreeMap<u32, Intrinsics>,
    mut images: Vec<Extrinsics>,
    rigs: Option<Rigs>,
) -> Result<CameraSet, FormatError> {
    images.sort_by(|a, b| natural::compare(a.name.as_bytes(), b.name.as_bytes()).then_with(|| a.name.cmp(&b.name)));
    // Empty files mean a model without rigs.
    let rigs = rigs.filter(|rigs| !rigs.is_empty());
    let cameras = images.into_iter().map(|image| {
        let camera = camera(intrinsics, &image, rigs.as_ref());
        NamedCamera { name: image.name, camera }
    });
    CameraSet::new(FORMAT, cameras.collect())
}

fn camera(
    intrinsics: &BTreeMap<u32, Intrinsics>,
    image: &Extrinsics,
    rigs: Option<&Rigs>,
) -> Result<SizedCamera, FormatError> {
    let Extrinsics { id, name, pose, camera } = image;
    let part = format!("camera {camera}");
    let Some(Intrinsics { model, size, parameters }) = intrinsics.get(camera) else {
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
    let composed = rigs.map(|rigs| rigs.pose(*id, *camera)).transpose();
    let pose = composed.map_err(|[expected, found]| FormatError::new(name, expected, found))?.unwrap_or(*pose);
    let Some(pose) = pose.camera() else {
        let found = format!("{:?}", pose.quaternion);
        return Err(FormatError::new(name, "a quaternion other than zero", found));
    };
    pinhole(name, pose, *size, focal, centre)
}
