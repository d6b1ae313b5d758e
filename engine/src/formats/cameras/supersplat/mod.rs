//! `settings.json` of SuperSplat's viewer, in its two versions.
//!
//! | version | first camera | animations |
//! |---|---|---|
//! | none | `camera`: `position`, `target`, `fov` (default 75) | `animTracks` (`fov` is the camera's, or 60) |
//! | 2 | `cameras`, each with `initial`: `position`, `target`, `fov` | `animTracks` |
//!
//! The viewer shows a file's scene after a half turn about z and has y up. So the point (x, y, z) of the settings is
//! (−x, −y, z) of the file, and up is −y. `fov` is in degrees, across the longer side of the image: horizontal unless
//! the image is upright. The settings have no image size. The caller sets it; the default is 1280×720.
//!
//! The first animation, if there is one, is the path: `duration` seconds of `frameRate` images a second along the
//! viewer's own spline (`spline.rs`). In that case the first camera can be selected as `initial`, and the cameras of
//! `annotations` by their titles.

mod spline;

use serde::Deserialize;
use serde_json::Value;

use super::{CameraSet, NamedCamera, SizedCamera, pinhole};
use crate::camera::{Pose, half_angle_tangent};
use crate::formats::FormatError;
use spline::Spline;

const FORMAT: &str = "settings of SuperSplat";
/// Default image size, width and height.
const SIZE: [usize; 2] = [1280, 720];
/// Maximum number of images of an animation.
const MOST: f64 = 100_000.0;
/// Default images per second, for animations without `frameRate`. Their keyframe times are in seconds.
const RATE: f64 = 30.0;

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Settings {
    version: Option<f64>,
    camera: Option<View>,
    #[serde(default)]
    cameras: Vec<Start>,
    #[serde(default)]
    anim_tracks: Vec<Track>,
    #[serde(default)]
    annotations: Vec<Annotation>,
}

#[derive(Deserialize)]
struct Start {
    initial: View,
}

#[derive(Deserialize)]
struct Annotation {
    #[serde(default)]
    title: String,
    camera: Option<Start>,
}

#[derive(Clone, Deserialize)]
struct View {
    position: Option<[f64; 3]>,
    target: Option<[f64; 3]>,
    fov: Option<f64>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Track {
    duration: f64,
    frame_rate: Option<f64>,
    loop_mode: Option<String>,
    smoothness: Option<f64>,
    keyframes: Keyframes,
}

#[derive(Deserialize)]
struct Keyframes {
    times: Vec<f64>,
    values: Values,
}

#[derive(Deserialize)]
struct Values {
    position: Vec<f64>,
    target: Vec<f64>,
    fov: Option<Vec<f64>>,
}

/// Reads the object. `size` is the image size.
///
/// # Errors
/// An object of another form or version, one without cameras, animations with invalid values.
pub(super) fn read(value: &Value, size: Option<[usize; 2]>) -> Result<CameraSet, FormatError> {
    let Settings { version, camera, cameras, anim_tracks, annotations } = Settings::deserialize(value)
        .map_err(|e| FormatError::new(FORMAT, "camera or cameras with position, target, fov", e.to_string()))?;
    if let Some(other) = version.filter(|version| *version != 2.0) {
        return Err(FormatError::new(format!("{FORMAT}: version"), "none or 2", other.to_string()));
    }
    let size = size.unwrap_or(SIZE).map(|side| side as f64);
    let field = camera.as_ref().and_then(|camera| camera.fov);
    // A camera without a position is placed by the viewer.
    let old = camera.filter(|view| view.position.is_some() && view.target.is_some());
    let views: Vec<View> = old.into_iter().chain(cameras.into_iter().map(|start| start.initial)).collect();
    let named = |name: String, view: &View| NamedCamera { camera: sized(&name, view, 75.0, size), name };
    let several = views.len() > 1;
    let starts: Vec<NamedCamera> = views
        .iter()
        .enumerate()
        .map(|(i, view)| named(if several { format!("initial {i}") } else { "initial".to_owned() }, view))
        .collect();
    let noted = annotations.into_iter().filter_map(|note| Some((note.title, note.camera?.initial)));
    let noted: Vec<NamedCamera> = noted.map(|(title, view)| named(title, &view)).collect();
    let Some(track) = anim_tracks.first() else {
        return Ok(CameraSet { aside: noted, ..CameraSet::new(FORMAT, starts)? });
    };
    let rate = track.frame_rate.filter(|rate| *rate != 0.0).unwrap_or(RATE);
    let views = track.views(rate, field.unwrap_or(60.0))?;
    let frames = views.iter().enumerate().map(|(i, view)| {
        let name = i.to_string();
        NamedCamera { camera: sized(&format!("image {i}"), view, 60.0, size), name }
    });
    let set = CameraSet::new(FORMAT, frames.collect())?;
    Ok(CameraSet { aside: [starts, noted].concat(), rate: Some(rate), ..set })
}

/// Converts a view of the viewer's world to a camera, for images of `size`.
fn sized(name: &str, view: &View, field: f64, size: [f64; 2]) -> Result<SizedCamera, FormatError> {
    let fail = |expected: &str, found: String| FormatError::new(name, expected, found);
    let (Some(position), Some(target)) = (view.position, view.target) else {
        return Err(fail("position and target", "one of them or neither".to_owned()));
    };
    // The viewer uses its default field if `fov` is 0.
    let field = view.fov.filter(|fov| *fov != 0.0).unwrap_or(field);
    if !(field > 0.0 && field < 180.0) {
        return Err(fail("a fov between 0 and 180 degrees", field.to_string()));
    }
    let turned = |[x, y, z]: [f64; 3]| [-x, -y, z];
    let pose = Pose::look_at(turned(position), turned(target), [0.0, -1.0, 0.0]);
    let Some(pose) = pose else {
        return Err(fail("a target away from position and not straight above or below it", format!("{target:?}")));
    };
    let longer = size[0].max(size[1]);
    pinhole(name, pose, size, [0.5 * longer / half_angle_tangent(field); 2], size.map(|side| 0.5 * side))
}

impl Track {
    /// Returns the view of every image.
    fn views(&self, rate: f64, field: f64) -> Result<Vec<View>, FormatError> {
        let fail = |part: &str, expected: String, found: String| {
            FormatError::new(format!("animation: {part}"), expected, found)
        };
        let Keyframes { times, values: Values { position, target, fov } } = &self.keyframes;
        let count = times.len();
        let fields = fov.clone().unwrap_or_else(|| vec![field; count]);
        for (part, found, each) in
            [("position", position.len(), 3), ("target", target.len(), 3), ("fov", fields.len(), 1)]
        {
            if found != each * count {
                return Err(fail(part, format!("{} numbers for {count} times", each * count), found.to_string()));
            }
        }
        let images = self.duration * rate;
        if count == 0 || !(rate > 0.0 && (0.0..=MOST).contains(&images)) {
            let found = format!("{count} times, {} s, {rate} images a second", self.duration);
            return Err(fail("length", format!("times, and at most {MOST} images"), found));
        }
        // Without a rate, times are in seconds.
        let scale = if self.frame_rate.is_none_or(|rate| rate == 0.0) { rate } else { 1.0 };
        let times: Vec<f64> = times.iter().map(|time| time * scale).collect();
        if times.iter().any(|time| !time.is_finite()) || !times.is_sorted_by(|a, b| a < b) {
            return Err(fail("times", "finite ones that ascend".to_owned(), "others".to_owned()));
        }
        let points = (0..count).map(|i| {
            let (p, t) = (&position[3 * i..], &target[3 * i..]);
            [p[0], p[1], p[2], t[0], t[1], t[2], fields[i]]
        });
        let extra = if times.last().is_some_and(|last| self.duration == last / rate) { 1.0 } else { 0.0 };
        let spline = Spline::looping(
            (self.duration + extra) * rate,
            &times,
            &points.collect::<Vec<_>>(),
            self.smoothness.unwrap_or(0.0),
        );
        // The last image of an animation that repeats equals its first one.
        let repeats = self.loop_mode.as_deref() == Some("repeat") && images >= 1.0;
        let last = if repeats { images.ceil() as usize - 1 } else { images as usize };
        Ok((0..=last)
            .map(|i| {
                let [x, y, z, tx, ty, tz, fov] = spline.at(i as f64);
                View { position: Some([x, y, z]), target: Some([tx, ty, tz]), fov: Some(fov) }
            })
            .collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{Camera, Lens};
    use crate::formats::cameras;

    fn read(text: &str, size: Option<[usize; 2]>) -> Result<CameraSet, FormatError> {
        cameras::parse(text, size).expect("settings of SuperSplat")
    }

    fn seen(named: &NamedCamera) -> (Pose, [f64; 2], [usize; 2]) {
        let SizedCamera { camera, size } = named.camera.clone().expect("a camera");
        let Camera::Posed { pose, lens: Lens::Pinhole { focal, .. } } = camera else { panic!("a pinhole") };
        (pose, focal, size)
    }

    #[test]
    fn the_viewers_world_is_turned_and_its_field_is_across_the_longer_side() {
        let old = r#"{"camera": {"fov": 90, "position": [1, 2, -5], "target": [1, 2, 0], "startAnim": "none"}, "background": {"color": [0,0,0]}}"#;
        let new = r#"{"version": 2, "cameras": [{"initial": {"fov": 90, "position": [1, 2, -5], "target": [1, 2, 0]}}], "animTracks": [], "annotations": []}"#;
        assert_eq!(read(old, None), read(new, None));
        let (pose, focal, size) = seen(&read(old, None).expect("settings").cameras[0]);
        assert_eq!((pose.position, size), ([-1.0, -2.0, -5.0], [1280, 720]));
        assert!(pose.rotation.quaternion()[0].abs() > 1.0 - 1e-12, "{pose:?}");
        assert!((focal[0] - 0.5).abs() < 1e-12 && (focal[1] * 720.0 - 640.0).abs() < 1e-9);
        let (_, focal, _) = seen(&read(old, Some([100, 400])).expect("settings").cameras[0]);
        assert!((focal[1] - 0.5).abs() < 1e-12 && (focal[0] * 100.0 - 200.0).abs() < 1e-9);
    }

    #[test]
    fn an_animation_goes_through_its_keyframes() {
        let track = |more: &str| {
            format!(
                r#"{{"version": 2, "cameras": [{{"initial": {{"position": [0,0,-9], "target": [0,0,0], "fov": 50}}}}],
                "annotations": [{{"position": [0,0,0], "title": "door", "text": "", "camera": {{"initial": {{"position": [0,0,-2], "target": [0,0,0], "fov": 50}}}}}}],
                "animTracks": [{{"name": "a", "duration": 2, "frameRate": 10, {more} "interpolation": "spline", "smoothness": 1,
                "keyframes": {{"times": [0, 10, 20], "values": {{"position": [0,0,-4, 2,0,-4, 2,2,-4], "target": [0,0,0, 0,0,0, 0,0,0], "fov": [60, 60, 30]}}}}}}]}}"#
            )
        };
        let set = read(&track(r#""loopMode": "none","#), None).expect("settings");
        assert_eq!((set.cameras.len(), set.rate), (21, Some(10.0)));
        for (at, place) in [(0, [0.0, 0.0, -4.0]), (10, [-2.0, 0.0, -4.0]), (20, [-2.0, -2.0, -4.0])] {
            assert_eq!(seen(&set.cameras[at]).0.position, place, "{at}");
        }
        assert_eq!(read(&track(r#""loopMode": "repeat","#), None).expect("settings").cameras.len(), 20);
        assert_eq!(set.find("initial").map(|named| seen(named).0.position), Ok([0.0, 0.0, -9.0]));
        assert_eq!(set.find("door").map(|named| seen(named).0.position), Ok([0.0, 0.0, -2.0]));
        let short = track("").replace("2,2,-4", "2,2");
        assert!(read(&short, None).expect_err("uneven").to_string().contains("expected 9 numbers for 3 times"));
        let long = track("").replace(r#""duration": 2"#, r#""duration": 1e9"#);
        assert!(read(&long, None).expect_err("too long").to_string().contains("at most 100000 images"));
    }

    #[test]
    fn settings_without_cameras_are_refused() {
        let error = read(r#"{"version": 2, "cameras": [], "animTracks": []}"#, None).expect_err("none").to_string();
        assert_eq!(error, "settings of SuperSplat: expected at least one camera, found none");
        let error = read(r#"{"version": 3, "animTracks": []}"#, None).expect_err("newer").to_string();
        assert!(error.contains("version: expected none or 2, found 3"), "{error}");
        let above = r#"{"camera": {"position": [0, 5, 0], "target": [0, 0, 0]}}"#;
        assert!(read(above, None).expect("settings").usable().is_err());
    }
}
