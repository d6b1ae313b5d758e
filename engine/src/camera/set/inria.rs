//! `cameras.json` of the original 3D Gaussian splatting.
//!
//! An array of `{"id", "img_name", "width", "height", "position": [3], "rotation": [3][3], "fx", "fy"}`: the camera's centre, and the
//! matrix (row by row) that turns its axes (x right, y down, z forward) into the world's. Focal lengths are in pixels; the principal
//! point is in the middle of the image, as the original draws it. Other keys are ignored.

use serde::Deserialize;
use serde_json::Value;

use super::{CameraSet, NamedCamera, pinhole, rotation};
use crate::camera::Pose;
use crate::import::FormatError;

const FORMAT: &str = "cameras.json of 3D Gaussian splatting";

#[derive(Deserialize)]
struct Entry {
    img_name: String,
    width: f64,
    height: f64,
    position: [f64; 3],
    rotation: [[f64; 3]; 3],
    fx: f64,
    fy: f64,
}

/// Reads the array.
///
/// # Errors
/// Entries of another form, rotations that are none, images without pixels.
pub(super) fn read(value: Value) -> Result<CameraSet, FormatError> {
    let entries: Vec<Entry> = serde_json::from_value(value)
        .map_err(|e| FormatError::new(FORMAT, "img_name, width, height, position, rotation, fx, fy", e.to_string()))?;
    let cameras: Result<Vec<NamedCamera>, FormatError> = entries
        .into_iter()
        .map(|entry| {
            let Entry { img_name, width, height, position, rotation: rows, fx, fy } = entry;
            let columns = std::array::from_fn(|c| std::array::from_fn(|r| rows[r][c]));
            let pose = Pose { position, rotation: rotation(&img_name, columns)? };
            pinhole(img_name, pose, [width, height], [fx, fy], [0.5 * width, 0.5 * height])
        })
        .collect();
    CameraSet::new(FORMAT, cameras?)
}
