//! `camera_path.json`, as exported by nerfstudio's viewer for `ns-render`.
//!
//! `camera_path` is an array of `{"camera_to_world": 16 numbers, "fov"}`, one per image. The matrix is written row by
//! row, for a camera with OpenGL's axes (x right, y up, z backward); `fov` is the vertical field of view in degrees.
//! Pixels are square and the principal point is in the middle. `aspect` is that of the viewer's window and ignored, as
//! in `ns-render`. The object also has `render_width` and `render_height` in pixels, and `fps` or `seconds`. Cameras
//! that are not perspective, and a crop, are errors.
//!
//! World coordinates are those of the trained scene, which `ns-export gaussian-splat` writes.

use serde::Deserialize;
use serde_json::Value;

use super::{CameraSet, NamedCamera, SizedCamera, pinhole, rotation};
use crate::camera::{Pose, half_angle_tangent};
use crate::formats::FormatError;

const FORMAT: &str = "camera path of nerfstudio";

#[derive(Deserialize)]
struct Path {
    camera_path: Vec<View>,
    camera_type: Option<String>,
    render_width: Option<f64>,
    render_height: Option<f64>,
    fps: Option<f64>,
    seconds: Option<f64>,
    crop: Option<Value>,
}

#[derive(Deserialize)]
struct View {
    camera_to_world: Vec<f64>,
    fov: f64,
}

/// Reads the object. `size` is used if `render_width` or `render_height` is absent.
///
/// # Errors
/// An invalid object, cameras that are not perspective, crops.
pub(super) fn read(value: &Value, size: Option<[usize; 2]>) -> Result<CameraSet, FormatError> {
    let Path { camera_path, camera_type, render_width, render_height, fps, seconds, crop } =
        Path::deserialize(value)
            .map_err(|e| FormatError::new(FORMAT, "camera_path, an array of camera_to_world and fov", e.to_string()))?;
    if let Some(kind) = camera_type.filter(|kind| !kind.eq_ignore_ascii_case("perspective")) {
        let found = kind.chars().take(40).collect::<String>();
        return Err(FormatError::new(format!("{FORMAT}: camera_type"), "perspective", found));
    }
    if crop.is_some() {
        return Err(FormatError::new(format!("{FORMAT}: crop"), "none (null)", "one"));
    }
    let asked = size.map(|[w, h]| [w as f64, h as f64]);
    let sides = [render_width.or(asked.map(|s| s[0])), render_height.or(asked.map(|s| s[1]))];
    let [Some(width), Some(height)] = sides else {
        let expected = "render_width and render_height, or a size that is asked for (--size)";
        return Err(FormatError::new(FORMAT, expected, "neither"));
    };
    let count = camera_path.len();
    let positive = |x: &f64| x.is_finite() && *x > 0.0;
    let rate = fps.filter(positive).or(seconds.filter(positive).map(|seconds| count as f64 / seconds));
    let cameras = camera_path.into_iter().enumerate().map(|(index, view)| {
        let name = index.to_string();
        NamedCamera { camera: camera(&name, &view, [width, height]), name }
    });
    Ok(CameraSet { rate, ..CameraSet::new(FORMAT, cameras.collect())? })
}

fn camera(name: &str, View { camera_to_world, fov }: &View, size: [f64; 2]) -> Result<SizedCamera, FormatError> {
    let fail = |expected: &str, found: String| FormatError::new(format!("view {name}"), expected, found);
    let (rows, rest) = camera_to_world.as_chunks::<4>();
    if !(3..=4).contains(&rows.len()) || !rest.is_empty() {
        return Err(fail("a camera_to_world of 16 or 12 numbers", camera_to_world.len().to_string()));
    }
    if !(*fov > 0.0 && *fov < 180.0) {
        return Err(fail("a fov between 0 and 180 degrees", fov.to_string()));
    }
    let column = |c: usize, sign: f64| -> [f64; 3] { std::array::from_fn(|r| sign * rows[r][c]) };
    // OpenGL's up and backward axes are our −down and −forward.
    let columns = [column(0, 1.0), column(1, -1.0), column(2, -1.0)];
    let pose = Pose { position: column(3, 1.0), rotation: rotation(&format!("view {name}"), columns)? };
    let focal = 0.5 * size[1] / half_angle_tangent(*fov);
    pinhole(&format!("view {name}"), pose, size, [focal; 2], size.map(|side| 0.5 * side))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{Camera, Lens};
    use crate::formats::cameras;

    const VIEW: &str = r#"{"camera_to_world": [1,0,0,5, 0,-1,0,6, 0,0,-1,7, 0,0,0,1], "fov": 90, "aspect": 9}"#;

    fn path(more: &str, size: Option<[usize; 2]>) -> Result<CameraSet, FormatError> {
        cameras::parse(&format!(r#"{{{more} "camera_path": [{VIEW}, {VIEW}]}}"#), size).expect("a camera path")
    }

    #[test]
    fn the_field_of_view_is_vertical_whatever_the_window_was() {
        let set = path(r#""render_width": 400, "render_height": 200, "fps": 30, "seconds": 4,"#, None).expect("a path");
        let SizedCamera { camera, size } = set.cameras[1].camera.clone().expect("a camera");
        let Camera::Posed { pose, lens: Lens::Pinhole { focal, centre } } = camera else { panic!("a pinhole") };
        assert!((focal[0] - 0.25).abs() < 1e-12 && (focal[1] - 0.5).abs() < 1e-12, "{focal:?}");
        assert_eq!((size, centre, pose.position), ([400, 200], [0.5; 2], [5.0, 6.0, 7.0]));
        assert!(pose.rotation.is_identity());
        assert_eq!((set.rate, set.time(15)), (Some(30.0), 0.5));
    }

    #[test]
    fn sizes_rates_and_kinds_are_read_or_refused() {
        assert!(path("", None).expect_err("no size").to_string().contains("--size"));
        assert_eq!(path(r#""seconds": 4,"#, Some([4, 3])).expect("a path").rate, Some(0.5));
        assert_eq!(path(r#""fps": 0,"#, Some([4, 3])).expect("a path").rate, None);
        for (more, expected) in [
            (r#""camera_type": "equirectangular","#, "camera_type: expected perspective, found equirectangular"),
            (r#""crop": {"crop_center": [0, 0, 0]},"#, "crop: expected none"),
        ] {
            let error = path(more, Some([4, 3])).expect_err("refused").to_string();
            assert!(error.contains(expected), "{error}");
        }
    }
}
