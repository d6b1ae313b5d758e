//! The JSON form of cameras.
//!
//! One view, or a path of views with times in seconds:
//!
//! ```json
//! {"type": "pinhole", "position": [0.3, 0.0, -1.0], "rotation": [1, 0, 0, 0], "focal": [1.0, 1.78], "centre": [0.5, 0.5]}
//! ```
//! ```json
//! {"views": [
//!   {"time": 0.0, "type": "orthographic"},
//!   {"time": 2.5, "type": "orthographic", "position": [0.2, 0, 0], "look_at": [0, 0, 0.5], "half_extent": [2.1, 1.2]}
//! ]}
//! ```
//!
//! | key | meaning | default |
//! |---|---|---|
//! | `type` | `canonical` (no other key except `time`), `orthographic`, `pinhole` or `equirectangular` (all directions; it has only a pose) | required |
//! | `time` | seconds of the video; required in `views`, strictly increasing | – |
//! | `units` | `square`: the unit of every number below | `square` |
//! | `position` | the camera's centre in square units (x right, y down, z forward) | `[0, 0, 0]` |
//! | `rotation` | quaternion (w, x, y, z) that turns the camera's axes (right, down, forward) into scene space | none |
//! | `look_at`, `up` | instead of `rotation`: the target point, and the image's up direction | `up` = `[0, -1, 0]` |
//! | `camera_to_world` | instead of `position` and `rotation`: a matrix of 4×4 numbers, row by row, of a rotation and the camera's centre | none |
//! | `half_extent` | orthographic: units from the centre of the view to its right and lower edge | `[width / height, 1]` of the image |
//! | `fov_y_degrees`, `aspect` | pinhole: vertical field of view, and width / height | – |
//! | `focal`, `centre` | pinhole: in image widths and heights | `centre` = `[0.5, 0.5]` |
//! | `size` | orthographic: width and height of its images, for still scenes if no other size is given | – |
//! | `size`, `fx`, `fy`, `cx`, `cy` | pinhole: in pixels of an image of `size` = [width, height], pixel centres at whole numbers | – |
//!
//! A pinhole view has exactly one of the three forms of the lens. Unknown keys are errors.
//!
//! Units are those of exported files: half the height of the picture, along every axis (for a still scene: its own
//! units).

use serde::Deserialize;

use super::{Camera, CameraPath, Lens, Pose, Rotation};

/// Error in a camera description.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CameraError {
    /// Not JSON of this form.
    #[error("camera: {0}")]
    Form(String),
    /// Invalid value in a view.
    #[error("camera view {view}: {key}: expected {expected}, found {found}")]
    View {
        /// Index of the view, from 0.
        view: usize,
        /// The key.
        key: &'static str,
        /// Expected value.
        expected: &'static str,
        /// Value found.
        found: String,
    },
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Views {
    views: Vec<View>,
}

#[derive(Deserialize, Clone, Copy, PartialEq)]
#[serde(rename_all = "lowercase")]
enum Kind {
    Canonical,
    Orthographic,
    Pinhole,
    Equirectangular,
}

#[derive(Deserialize, Clone, Copy)]
#[serde(rename_all = "lowercase")]
enum Units {
    Square,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct View {
    time: Option<f64>,
    #[serde(rename = "units")]
    _units: Option<Units>,
    #[serde(rename = "type")]
    kind: Kind,
    position: Option<[f64; 3]>,
    rotation: Option<[f64; 4]>,
    look_at: Option<[f64; 3]>,
    up: Option<[f64; 3]>,
    camera_to_world: Option<[[f64; 4]; 4]>,
    half_extent: Option<[f64; 2]>,
    fov_y_degrees: Option<f64>,
    aspect: Option<f64>,
    focal: Option<[f64; 2]>,
    centre: Option<[f64; 2]>,
    size: Option<[f64; 2]>,
    fx: Option<f64>,
    fy: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
}

/// Parses a camera or a camera path.
///
/// # Errors
/// Text that is not JSON of this form, and views with invalid values; the error names the view and the key.
pub fn parse(json: &str) -> Result<CameraPath, CameraError> {
    let form = |[expected, found]: [String; 2]| CameraError::Form(format!("expected {expected}, found {found}"));
    from_value(super::json::value(json.as_bytes()).map_err(form)?)
}

/// Reads a camera file as [`parse`] does, from parsed JSON.
pub(crate) fn from_value(value: serde_json::Value) -> Result<CameraPath, CameraError> {
    let form = |e: serde_json::Error| CameraError::Form(e.to_string());
    if value.get("views").is_none() {
        let view: View = serde_json::from_value(value).map_err(form)?;
        return Ok(view.camera(0)?.into());
    }
    let Views { views } = serde_json::from_value(value).map_err(form)?;
    if views.is_empty() {
        return Err(CameraError::Form("views: expected at least one view, found none".to_owned()));
    }
    let mut path: Vec<(f64, Camera)> = Vec::with_capacity(views.len());
    for (index, view) in views.iter().enumerate() {
        let fail = |expected, found| CameraError::View { view: index, key: "time", expected, found };
        let time = view.time.ok_or_else(|| fail("seconds", "nothing".to_owned()))?;
        if !(time.is_finite() && path.last().is_none_or(|(before, _)| *before < time)) {
            return Err(fail("a time after the view before", time.to_string()));
        }
        path.push((time, view.camera(index)?));
    }
    CameraPath::new(path).ok_or_else(|| CameraError::Form("views: expected usable cameras".to_owned()))
}

/// Converts a matrix of 4×4 numbers, row by row, to a pose; `None` unless it is a rotation and a translation.
fn of_matrix(rows: &[[f64; 4]; 4]) -> Option<Pose> {
    let column = |j: usize| [rows[0][j], rows[1][j], rows[2][j]];
    let rotation = Rotation::from_columns([column(0), column(1), column(2)])?;
    (rows[3] == [0.0, 0.0, 0.0, 1.0]).then_some(Pose { position: column(3), rotation })
}

impl View {
    fn camera(&self, index: usize) -> Result<Camera, CameraError> {
        let fail = |key, expected, found: String| CameraError::View { view: index, key, expected, found };
        let extra = |keys: &[(&'static str, bool)]| match keys.iter().find(|(_, present)| *present) {
            Some((key, _)) => Err(fail(key, "nothing beside this type and the other keys", "a value".to_owned())),
            None => Ok(()),
        };
        let pinhole_keys = [
            ("fov_y_degrees", self.fov_y_degrees.is_some()),
            ("aspect", self.aspect.is_some()),
            ("focal", self.focal.is_some()),
            ("centre", self.centre.is_some()),
            ("size", self.size.is_some()),
            ("fx", self.fx.is_some()),
            ("fy", self.fy.is_some()),
            ("cx", self.cx.is_some()),
            ("cy", self.cy.is_some()),
        ];
        let pose_keys = [
            ("position", self.position.is_some()),
            ("rotation", self.rotation.is_some()),
            ("look_at", self.look_at.is_some()),
            ("up", self.up.is_some()),
            ("camera_to_world", self.camera_to_world.is_some()),
        ];
        let camera = match self.kind {
            Kind::Canonical => {
                extra(&pose_keys)?;
                extra(&pinhole_keys)?;
                extra(&[("half_extent", self.half_extent.is_some())])?;
                Camera::Canonical
            }
            Kind::Orthographic => {
                // The caller reads the image size.
                extra(&pinhole_keys.map(|(key, present)| (key, present && key != "size")))?;
                let lens = Lens::Orthographic { half_extent: self.half_extent };
                Camera::Posed { pose: self.pose(index)?, lens }
            }
            Kind::Equirectangular => {
                extra(&pinhole_keys)?;
                extra(&[("half_extent", self.half_extent.is_some())])?;
                Camera::Posed { pose: self.pose(index)?, lens: Lens::Equirectangular }
            }
            Kind::Pinhole => {
                extra(&[("half_extent", self.half_extent.is_some())])?;
                self.pinhole(index)?
            }
        };
        if camera.is_usable() {
            Ok(camera)
        } else {
            Err(fail("type", "finite numbers, positive extents and focal lengths", "others".to_owned()))
        }
    }

    fn pose(&self, index: usize) -> Result<Pose, CameraError> {
        let fail = |key, expected, found: String| CameraError::View { view: index, key, expected, found };
        if let Some(rows) = self.camera_to_world {
            if self.position.is_some() || self.rotation.is_some() || self.look_at.is_some() || self.up.is_some() {
                return Err(fail("camera_to_world", "no other pose beside it", "one".to_owned()));
            }
            let expected = "a rotation (orthonormal, right-handed), the camera's centre, and 0, 0, 0, 1 below";
            return of_matrix(&rows).ok_or_else(|| fail("camera_to_world", expected, format!("{rows:?}")));
        }
        let position = self.position.unwrap_or_default();
        match (self.rotation, self.look_at) {
            (Some(_), Some(_)) => Err(fail("look_at", "either rotation or look_at", "both".to_owned())),
            (_, None) if self.up.is_some() => Err(fail("look_at", "a point, as up is given", "nothing".to_owned())),
            (None, None) => Ok(Pose { position, rotation: Rotation::IDENTITY }),
            (Some(q), None) => Rotation::from_quaternion(q)
                .map(|rotation| Pose { position, rotation })
                .ok_or_else(|| fail("rotation", "a quaternion other than zero", format!("{q:?}"))),
            (None, Some(target)) => Pose::look_at(position, target, self.up.unwrap_or([0.0, -1.0, 0.0]))
                .ok_or_else(|| fail("look_at", "a point away from position and not along up", format!("{target:?}"))),
        }
    }

    fn pinhole(&self, index: usize) -> Result<Camera, CameraError> {
        let fail =
            |key, expected, found: &str| CameraError::View { view: index, key, expected, found: found.to_owned() };
        let pose = self.pose(index)?;
        let pixels = [self.fx, self.fy, self.cx, self.cy];
        let in_pixels = self.size.is_some() || pixels.iter().any(Option::is_some);
        let by_angle = self.fov_y_degrees.is_some() || self.aspect.is_some();
        let in_parts = self.focal.is_some() || self.centre.is_some();
        const ONE: &str = "exactly one of fov_y_degrees with aspect, focal, and size with fx, fy, cx, cy";
        match (by_angle, in_parts, in_pixels) {
            (true, false, false) => {
                let (Some(degrees), Some(aspect)) = (self.fov_y_degrees, self.aspect) else {
                    return Err(fail("fov_y_degrees", "fov_y_degrees and aspect", "one of them"));
                };
                Camera::pinhole(pose, degrees, aspect)
                    .ok_or_else(|| fail("fov_y_degrees", "an angle under 180 and a positive aspect", "others"))
            }
            (false, true, false) => {
                let focal = self.focal.ok_or_else(|| fail("focal", "two focal lengths", "nothing"))?;
                Ok(Camera::Posed { pose, lens: Lens::Pinhole { focal, centre: self.centre.unwrap_or([0.5; 2]) } })
            }
            (false, false, true) => {
                let (Some([w, h]), [Some(fx), Some(fy), Some(cx), Some(cy)]) = (self.size, pixels) else {
                    return Err(fail("size", "size, fx, fy, cx and cy", "some of them"));
                };
                let lens = Lens::Pinhole { focal: [fx / w, fy / h], centre: [(cx + 0.5) / w, (cy + 0.5) / h] };
                Ok(Camera::Posed { pose, lens })
            }
            (false, false, false) => Err(fail("focal", ONE, "none")),
            _ => Err(fail("focal", ONE, "several")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_way_to_give_a_lens_is_read() {
        let only = |json: &str| parse(json).unwrap().at(0.0);
        assert_eq!(only(r#"{"type": "canonical"}"#), Camera::Canonical);
        assert_eq!(only(r#"{"type": "orthographic"}"#), Camera::orthographic(Pose::default()));
        assert_eq!(only(r#"{"type": "orthographic", "units": "square"}"#), Camera::orthographic(Pose::default()));
        let parts = only(r#"{"type": "pinhole", "focal": [1.0, 2.0]}"#);
        let pixels = only(r#"{"type": "pinhole", "size": [200, 100], "fx": 200, "fy": 200, "cx": 99.5, "cy": 49.5}"#);
        let angle = only(r#"{"type": "pinhole", "fov_y_degrees": 28.072486935852957, "aspect": 2}"#);
        assert_eq!(parts, pixels);
        let (
            Camera::Posed { lens: Lens::Pinhole { focal: a, .. }, .. },
            Camera::Posed { lens: Lens::Pinhole { focal: b, .. }, .. },
        ) = (parts, angle)
        else {
            panic!("pinholes");
        };
        assert!((a[0] - b[0]).abs() < 1e-9 && (a[1] - b[1]).abs() < 1e-9);
    }

    #[test]
    fn a_matrix_is_a_pose() {
        let only = |json: &str| parse(json).unwrap().at(0.0);
        let turned = r#"{"type": "orthographic", "camera_to_world": [[0,0,1,2],[0,1,0,3],[-1,0,0,4],[0,0,0,1]]}"#;
        let looking = r#"{"type": "orthographic", "position": [2, 3, 4], "look_at": [3, 3, 4]}"#;
        assert_eq!(only(turned), only(looking));
        for wrong in [
            r#"{"type": "orthographic", "camera_to_world": [[0,0,2,2],[0,1,0,3],[-1,0,0,4],[0,0,0,1]]}"#,
            r#"{"type": "orthographic", "camera_to_world": [[0,0,1,2],[0,1,0,3],[-1,0,0,4],[0,0,1,1]]}"#,
            r#"{"type": "orthographic", "position": [0,0,0], "camera_to_world": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}"#,
        ] {
            assert!(matches!(parse(wrong), Err(CameraError::View { key: "camera_to_world", .. })), "{wrong}");
        }
    }

    #[test]
    fn a_path_is_read_with_its_times() {
        let path = parse(
            r#"{"views": [{"time": 1, "type": "orthographic"},
                {"time": 2, "type": "orthographic", "position": [2, 0, 0], "look_at": [2, 0, 1]}]}"#,
        )
        .unwrap();
        let expected = Camera::orthographic(Pose { position: [1.0, 0.0, 0.0], ..Pose::default() });
        assert_eq!(path.at(1.5), expected);
    }

    #[test]
    fn every_mistake_names_its_key() {
        let key = |json: &str| match parse(json) {
            Err(CameraError::View { key, .. }) => key,
            other => panic!("{json}: {other:?}"),
        };
        assert_eq!(key(r#"{"type": "canonical", "position": [0, 0, 0]}"#), "position");
        assert_eq!(key(r#"{"type": "orthographic", "fx": 1}"#), "fx");
        assert_eq!(key(r#"{"type": "orthographic", "rotation": [0, 0, 0, 0]}"#), "rotation");
        assert_eq!(key(r#"{"type": "orthographic", "up": [0, 0, 1]}"#), "look_at");
        assert_eq!(key(r#"{"type": "orthographic", "half_extent": [0, 1]}"#), "type");
        assert_eq!(key(r#"{"type": "pinhole"}"#), "focal");
        assert_eq!(key(r#"{"type": "pinhole", "focal": [1, 1], "fx": 1}"#), "focal");
        assert_eq!(key(r#"{"type": "pinhole", "size": [4, 4], "fx": 1}"#), "size");
        assert_eq!(key(r#"{"type": "pinhole", "fov_y_degrees": 180, "aspect": 1}"#), "fov_y_degrees");
        assert_eq!(key(r#"{"views": [{"type": "canonical"}]}"#), "time");
        assert_eq!(key(r#"{"views": [{"type": "canonical", "time": 1}, {"type": "canonical", "time": 1}]}"#), "time");
        for json in [
            "",
            "[]",
            "{}",
            r#"{"type": "fisheye"}"#,
            r#"{"type": "canonical", "colour": 1}"#,
            r#"{"views": []}"#,
            r#"{"type": "orthographic", "units": "pixels"}"#,
        ] {
            assert!(matches!(parse(json), Err(CameraError::Form(_))), "{json}");
        }
    }
}
