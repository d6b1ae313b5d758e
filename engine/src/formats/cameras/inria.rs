//! `cameras.json` of the original 3D Gaussian splatting.
//!
//! An array of `{"id", "img_name", "width", "height", "position": [3], "rotation": [3][3], "fx", "fy"}`: the camera's
//! centre, and the matrix (row by row) from its axes (x right, y down, z forward) to the world's. Focal lengths are in
//! pixels. The principal point defaults to the middle of the image, as in the original program. Some later programs set
//! it with `cx` and `cy`, in pixels from the corner of the first pixel. The name of a camera without `img_name` is its
//! index in the array. Other keys are ignored.

use serde::Deserialize;
use serde_json::Value;

use super::{CameraSet, NamedCamera, SizedCamera, pinhole, rotation};
use crate::camera::Pose;
use crate::formats::FormatError;

const FORMAT: &str = "cameras.json of 3D Gaussian splatting";

#[derive(Deserialize)]
struct Entry {
    width: f64,
    height: f64,
    position: [f64; 3],
    rotation: [[f64; 3]; 3],
    fx: f64,
    fy: f64,
    cx: Option<f64>,
    cy: Option<f64>,
}

/// Reads the array.
///
/// # Errors
/// JSON other than an array of at least one entry. The error of an entry that cannot be drawn is in the set.
pub(super) fn read(value: &Value) -> Result<CameraSet, FormatError> {
    let Value::Array(entries) = value else { return Err(FormatError::new(FORMAT, "an array", "none")) };
    if let Some(other) = entries.iter().find(|entry| !entry.is_object()) {
        let found: String = other.to_string().chars().take(40).collect();
        return Err(FormatError::new(FORMAT, "an array of objects", found));
    }
    let cameras = entries.iter().enumerate().map(|(index, entry)| {
        let name = name(entry, index);
        NamedCamera { camera: camera(&name, entry), name }
    });
    CameraSet::new(FORMAT, cameras.collect())
}

fn name(entry: &Value, index: usize) -> String {
    match entry.get("img_name") {
        Some(Value::String(name)) if !name.is_empty() => name.clone(),
        Some(Value::Number(number)) => number.to_string(),
        _ => index.to_string(),
    }
}

fn camera(name: &str, entry: &Value) -> Result<SizedCamera, FormatError> {
    let Entry { width, height, position, rotation: rows, fx, fy, cx, cy } = Entry::deserialize(entry).map_err(|e| {
        let expected = "width, height, position, rotation, fx and fy";
        FormatError::new(format!("camera {name}"), expected, e.to_string())
    })?;
    let columns = std::array::from_fn(|c| std::array::from_fn(|r| rows[r][c]));
    let pose = Pose { position, rotation: rotation(name, columns)? };
    let centre = [cx.unwrap_or(0.5 * width), cy.unwrap_or(0.5 * height)];
    pinhole(name, pose, [width, height], [fx, fy], centre)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{Camera, Lens};

    fn set(more: &str) -> CameraSet {
        let entry = format!(
            r#"[{{{more} "width": 40, "height": 20, "position": [1, 2, 3], "rotation": [[1,0,0],[0,1,0],[0,0,1]], "fx": 20, "fy": 20}}]"#
        );
        read(&serde_json::from_str(&entry).expect("JSON")).expect("a camera")
    }

    #[test]
    fn a_camera_without_a_name_has_its_number() {
        for (more, name) in
            [("", "0"), (r#""img_name": 17,"#, "17"), (r#""img_name": null,"#, "0"), (r#""img_name": "a","#, "a")]
        {
            assert_eq!(set(more).cameras[0].name, name, "{more}");
        }
    }

    #[test]
    fn a_principal_point_is_taken_where_there_is_one() {
        for (more, expected) in
            [("", [0.5, 0.5]), (r#""cx": 10, "cy": 15,"#, [0.25, 0.75]), (r#""cx": 10,"#, [0.25, 0.5])]
        {
            let camera = set(more).cameras[0].camera.clone().expect("a camera").camera;
            let Camera::Posed { lens: Lens::Pinhole { centre, .. }, .. } = camera else { panic!("a pinhole") };
            assert_eq!(centre, expected, "{more}");
        }
    }
}
