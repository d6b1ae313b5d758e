//! `transforms.json` of nerfstudio, instant-ngp, and the Blender scenes of NeRF.
//!
//! Each of `frames` has a `file_path` and a `transform_matrix` (camera to world, row by row; OpenGL's axes: x right, y
//! up, z backward). The lens keys are in the frame or at the top level: `w`, `h`, `fl_x`, `fl_y`, `cx`, `cy` in pixels,
//! or the angles `camera_angle_x` and `camera_angle_y` in radians. Defaults: `fl_y` is `fl_x`, `cx` and `cy` are the
//! middle of the image, `w` and `h` are the caller's size.
//!
//! Distortion is an error that names the key, whether as `k1` … `k4`, `p1`, `p2` or as `distortion_params`. So are
//! `is_fisheye` and instant-ngp's keys for other lenses. Values of 0 or false are accepted.
//!
//! Poses are used unchanged. They already include nerfstudio's `applied_transform`; instant-ngp's `scale` and `offset`
//! map to its own unit cube, which no file of Gaussians uses.

use serde::Deserialize;
use serde_json::Value;
use streamsplat_kernels::math::f64::sin_cos;

use super::{CameraSet, NamedCamera, SizedCamera, pinhole, rotation};
use crate::camera::Pose;
use crate::formats::FormatError;

const FORMAT: &str = "transforms.json";

#[derive(Deserialize)]
struct Transforms {
    frames: Vec<Value>,
    #[serde(flatten)]
    lens: Lens,
}

#[derive(Deserialize)]
struct Frame {
    transform_matrix: Vec<Vec<f64>>,
    #[serde(flatten)]
    lens: Lens,
}

#[derive(Clone, Default, Deserialize)]
struct Lens {
    camera_model: Option<String>,
    w: Option<f64>,
    h: Option<f64>,
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    camera_angle_x: Option<f64>,
    camera_angle_y: Option<f64>,
    k1: Option<f64>,
    k2: Option<f64>,
    k3: Option<f64>,
    k4: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
    distortion_params: Option<Vec<f64>>,
    is_fisheye: Option<Value>,
    latlong: Option<Value>,
    equirectangular: Option<Value>,
    orthographic: Option<Value>,
    ftheta_p0: Option<Value>,
}

impl Lens {
    /// Returns the first key, with its value, that marks a lens other than a pinhole.
    fn other_than_pinhole(&self) -> Option<(&'static str, String)> {
        let is_set = |value: &Value| match value {
            Value::Null | Value::Bool(false) => false,
            Value::Number(number) => number.as_f64() != Some(0.0),
            _ => true,
        };
        let coefficients =
            [("k1", self.k1), ("k2", self.k2), ("k3", self.k3), ("k4", self.k4), ("p1", self.p1), ("p2", self.p2)];
        let marks = [
            ("is_fisheye", &self.is_fisheye),
            ("latlong", &self.latlong),
            ("equirectangular", &self.equirectangular),
            ("orthographic", &self.orthographic),
            ("ftheta_p0", &self.ftheta_p0),
        ];
        let numbers = coefficients
            .iter()
            .find_map(|(key, value)| value.filter(|value| *value != 0.0).map(|value| (*key, value.to_string())));
        let list = self.distortion_params.as_ref().filter(|list| list.iter().any(|value| *value != 0.0));
        let list = list.map(|list| ("distortion_params", format!("{list:?}")));
        let mark = marks.into_iter().find_map(|(key, value)| {
            value.as_ref().filter(|value| is_set(value)).map(|value| (key, value.to_string()))
        });
        numbers.or(list).or(mark)
    }

    /// Fills in absent distortion and lens type keys from `beside`, the file's top-level lens.
    fn or(self, beside: &Lens) -> Lens {
        Lens {
            k1: self.k1.or(beside.k1),
            k2: self.k2.or(beside.k2),
            k3: self.k3.or(beside.k3),
            k4: self.k4.or(beside.k4),
            p1: self.p1.or(beside.p1),
            p2: self.p2.or(beside.p2),
            distortion_params: self.distortion_params.or(beside.distortion_params.clone()),
            is_fisheye: self.is_fisheye.or(beside.is_fisheye.clone()),
            latlong: self.latlong.or(beside.latlong.clone()),
            equirectangular: self.equirectangular.or(beside.equirectangular.clone()),
            orthographic: self.orthographic.or(beside.orthographic.clone()),
            ftheta_p0: self.ftheta_p0.or(beside.ftheta_p0.clone()),
            ..self
        }
    }
}

/// Camera models that are a pinhole if their coefficients are 0.
const MODELS: [&str; 6] = ["PERSPECTIVE", "PINHOLE", "SIMPLE_PINHOLE", "OPENCV", "SIMPLE_RADIAL", "RADIAL"];

/// Reads the object. `size` is used if `w` or `h` is absent.
///
/// # Errors
/// An invalid object. The error of a frame that cannot be drawn is in the set.
pub(super) fn read(value: &Value, size: Option<[usize; 2]>) -> Result<CameraSet, FormatError> {
    let Transforms { frames, lens } = Transforms::deserialize(value)
        .map_err(|e| FormatError::new(FORMAT, "frames with file_path and transform_matrix", e.to_string()))?;
    let cameras = frames.iter().enumerate().map(|(index, frame)| {
        let name = match frame.get("file_path") {
            Some(Value::String(name)) if !name.is_empty() => name.clone(),
            _ => index.to_string(),
        };
        NamedCamera { camera: camera(&name, frame, &lens, size), name }
    });
    CameraSet::new(FORMAT, cameras.collect())
}

fn camera(name: &str, frame: &Value, beside: &Lens, asked: Option<[usize; 2]>) -> Result<SizedCamera, FormatError> {
    let fail = |expected: &str, found: String| FormatError::new(name, expected, found);
    let Frame { transform_matrix: rows, lens } = Frame::deserialize(frame)
        .map_err(|e| fail("a frame with a transform_matrix and, in numbers, its lens", e.to_string()))?;
    if !(3..=4).contains(&rows.len()) || rows.iter().any(|row| row.len() != 4) {
        return Err(fail("a transform_matrix of 4×4 or 3×4 numbers", "another".to_owned()));
    }
    let model = lens.camera_model.as_ref().or(beside.camera_model.as_ref());
    if let Some(model) = model.filter(|model| !MODELS.contains(&model.as_str())) {
        return Err(fail("the camera model PINHOLE or OPENCV without distortion", model.clone()));
    }
    let lens = lens.or(beside);
    if let Some((key, value)) = lens.other_than_pinhole() {
        return Err(fail("a lens without distortion (undistort the images first)", format!("{key} = {value}")));
    }
    let asked = asked.map(|[w, h]| [w as f64, h as f64]);
    let sides = [lens.w.or(beside.w).or(asked.map(|s| s[0])), lens.h.or(beside.h).or(asked.map(|s| s[1]))];
    let [Some(w), Some(h)] = sides else {
        return Err(fail("w and h, or a size that is asked for (--size)", "neither".to_owned()));
    };
    // Half the side over the tangent of half the angle.
    let from_angle = |angle: f64, side: f64| {
        let (sin, cos) = sin_cos(0.5 * angle.clamp(0.0, 3.2));
        0.5 * side * cos / sin
    };
    let own = |focal: Option<f64>, angle: Option<f64>, side: f64| focal.or(angle.map(|angle| from_angle(angle, side)));
    let across = own(lens.fl_x, lens.camera_angle_x, w).or(own(beside.fl_x, beside.camera_angle_x, w));
    let along = own(lens.fl_y, lens.camera_angle_y, h).or(own(beside.fl_y, beside.camera_angle_y, h));
    let Some((fx, fy)) = across.or(along).map(|one| (across.unwrap_or(one), along.unwrap_or(one))) else {
        return Err(fail("fl_x or camera_angle_x", "neither".to_owned()));
    };
    let centre = [lens.cx.or(beside.cx).unwrap_or(0.5 * w), lens.cy.or(beside.cy).unwrap_or(0.5 * h)];
    let column = |c: usize, sign: f64| -> [f64; 3] { std::array::from_fn(|r| sign * rows[r][c]) };
    // OpenGL's up and backward axes are our −down and −forward.
    let columns = [column(0, 1.0), column(1, -1.0), column(2, -1.0)];
    let pose = Pose { position: column(3, 1.0), rotation: rotation(name, columns)? };
    pinhole(name, pose, [w, h], [fx, fy], centre)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{Camera, Lens};
    use crate::formats::cameras;

    fn one(lens: &str, size: Option<[usize; 2]>) -> Result<SizedCamera, FormatError> {
        let frame = r#"{"file_path": "a.png", "transform_matrix": [[1,0,0,0],[0,-1,0,0],[0,0,-1,-2],[0,0,0,1]]}"#;
        let text = format!(r#"{{{lens} "frames": [{frame}]}}"#);
        cameras::parse(&text, size).expect("theirs")?.cameras[0].camera.clone()
    }

    #[test]
    fn a_lens_may_be_given_by_angles_or_pixels() {
        let angle = one(r#""camera_angle_x": 1.5707963267948966,"#, Some([400, 200])).expect("a camera");
        let pixels = one(r#""w": 400, "h": 200, "fl_x": 200,"#, None).expect("a camera");
        assert_eq!(angle.size, [400, 200]);
        let focal = |sized: &SizedCamera| match sized.camera {
            Camera::Posed { lens: Lens::Pinhole { focal, centre }, pose } => {
                assert_eq!((centre, pose.position), ([0.5; 2], [0.0, 0.0, -2.0]));
                assert!(pose.rotation.is_identity());
                focal
            }
            _ => panic!("a pinhole"),
        };
        for (a, b) in focal(&angle).iter().zip(focal(&pixels)) {
            assert!((a - b).abs() < 1e-9, "{a} {b}");
        }
        assert_eq!(focal(&pixels), [0.5, 1.0]);
    }

    #[test]
    fn distortion_is_refused_by_name() {
        let pinhole = r#""w": 400, "h": 200, "fl_x": 200,"#;
        assert!(one(&format!(r#"{pinhole} "camera_model": "OPENCV", "k1": 0.0, "p2": 0,"#), None).is_ok());
        for (more, expected) in [
            (r#""k1": 0.1,"#, "a.png: expected a lens without distortion (undistort the images first), found k1 = 0.1"),
            (r#""camera_model": "OPENCV_FISHEYE","#, "found OPENCV_FISHEYE"),
            (r#""is_fisheye": true,"#, "found is_fisheye = true"),
            (r#""distortion_params": [0, 0.1, 0, 0, 0, 0],"#, "found distortion_params = [0.0, 0.1"),
            (r#""ftheta_p0": 0.1,"#, "found ftheta_p0 = 0.1"),
        ] {
            let error = one(&format!("{pinhole} {more}"), None).expect_err("distorted").to_string();
            assert!(error.contains(expected), "{error}");
        }
        let nothing = r#""is_fisheye": false, "distortion_params": [0, 0, 0, 0, 0, 0], "latlong": null,"#;
        assert_eq!(one(&format!("{pinhole} {nothing}"), None), one(pinhole, None));
        assert!(one(r#""fl_x": 200,"#, None).expect_err("no size").to_string().contains("--size"));
        assert!(one("", Some([4, 3])).expect_err("no lens").to_string().contains("expected fl_x or camera_angle_x"));
    }
}
