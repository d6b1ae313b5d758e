//! Cameras around one point: turns over time, and the two views of a pair of eyes.
//!
//! This point, the *pivot*, does not move in the image. For a scene in time it is the middle of the source's picture at
//! the median depth of the Gaussians visible at one time ([`pivot`]). The source's own view is turned with parallel
//! rays, so that at an angle of 0 it is [`Camera::Canonical`] itself.

use streamsplat_kernels::math::f64::sin_cos;

use super::RenderError;
use crate::camera::{Camera, Lens, Pose, Rotation};
use crate::fit::Placement;
use crate::stream::{Interval, Snapshot, Workers};
use crate::world::to_scene;

/// Distance of a turned camera from the pivot in half widths of the model's input: depths end at 5, so everything is in
/// front of it.
const DISTANCE: f64 = 12.0;

/// Position of a camera around the pivot, in degrees.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Angles {
    /// To the right of the source's own camera.
    pub right: f64,
    /// Above it.
    pub up: f64,
}

/// Motion of a camera around the pivot over time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Turn {
    /// From half of `degrees` on the left to half on the right in `seconds`, then back in the same time, repeatedly.
    Orbit {
        /// The whole angle.
        degrees: f64,
        /// Time from one end to the other.
        seconds: f64,
    },
    /// A circle around the source's own view, `degrees` away from it, once in `seconds`. It starts at the top.
    Sway {
        /// Angle between the circle and the middle.
        degrees: f64,
        /// Time of one circle.
        seconds: f64,
    },
    /// One full turn in `seconds`, starting at the source's own view.
    Around {
        /// Time of one turn.
        seconds: f64,
    },
}

impl Turn {
    /// Returns the position of the camera after `time` seconds.
    pub fn at(self, time: f64) -> Angles {
        // From 0 to 1, repeatedly.
        let phase = |seconds: f64| (time / seconds).rem_euclid(1.0);
        match self {
            Turn::Orbit { degrees, seconds } => {
                let there_and_back = 2.0 * phase(2.0 * seconds);
                Angles { right: degrees * (there_and_back.min(2.0 - there_and_back) - 0.5), up: 0.0 }
            }
            Turn::Sway { degrees, seconds } => {
                let (sin, cos) = sin_cos(2.0 * std::f64::consts::PI * phase(seconds));
                Angles { right: degrees * sin, up: degrees * cos }
            }
            Turn::Around { seconds } => Angles { right: 360.0 * phase(seconds), up: 0.0 },
        }
    }
}

/// Returns the middle of the source's picture in square units, at the median depth of the Gaussians visible at `time`.
/// For an even number it is the farther of the two middle ones; if none is visible, the depth is that of inverse depth
/// ½.
///
/// # Errors
/// As [`Interval::render`].
pub fn pivot(interval: &Interval, time: f64, workers: &Workers) -> Result<[f64; 3], RenderError> {
    let mut depths: Vec<f32> = Snapshot::square(interval, time, workers)?.mean.iter().map(|mean| mean[2]).collect();
    depths.sort_unstable_by(f32::total_cmp);
    let middle = || to_scene([0.0, 0.5, 0.0]).map_or(1.0, |[_, _, z]| f64::from(z)) * interval.placement.aspect();
    let depth = depths.get(depths.len() / 2).map_or_else(middle, |depth| f64::from(*depth));
    let [x, y] = extent(&interval.placement).0;
    Ok([x, y, depth])
}

/// Returns the source's own view, turned around `pivot` (in square units).
pub fn turned(placement: &Placement, pivot: [f64; 3], angles: Angles) -> Camera {
    if angles == Angles::default() {
        return Camera::Canonical;
    }
    let Angles { right, up } = angles;
    let radians = std::f64::consts::PI / 180.0;
    let ((sin, cos), (sin_up, cos_up)) = (sin_cos(right * radians), sin_cos(up * radians));
    let axes = [[cos, 0.0, sin], [sin * sin_up, cos_up, -cos * sin_up], [-sin * cos_up, sin_up, cos * cos_up]];
    let Some(rotation) = Rotation::from_columns(axes) else { return Camera::Canonical };
    let distance = DISTANCE * placement.aspect();
    let position = std::array::from_fn(|i| pivot[i] - distance * axes[2][i]);
    let lens = Lens::Orthographic { half_extent: Some(extent(placement).1) };
    Camera::Posed { pose: Pose { position, rotation }, lens }
}

/// Crops a turned view to `part` of the sides of the source's picture, around its middle.
pub fn cropped(camera: &Camera, placement: &Placement, pivot: [f64; 3], part: f64) -> Camera {
    let half_extent = Some(extent(placement).1.map(|half| part * half));
    let pose = match *camera {
        Camera::Canonical => own_pose(placement, pivot),
        Camera::Posed { pose, .. } => pose,
    };
    Camera::Posed { pose, lens: Lens::Orthographic { half_extent } }
}

/// Returns the pose of the source's own view, in front of `pivot`.
fn own_pose(placement: &Placement, [x, y, z]: [f64; 3]) -> Pose {
    Pose { position: [x, y, z - DISTANCE * placement.aspect()], rotation: Rotation::IDENTITY }
}

/// Returns the views of a left and a right eye that replace `camera`. The distance between the eyes is `apart` times
/// their distance from the plane through `pivot` that the camera faces. Points in that plane have the same position in
/// both images.
///
/// Parallel rays are turned by half the angle between the eyes. A pinhole moves sideways together with its principal
/// point, so that there is no vertical shift. `None` if `pivot` is not in front of the camera, for equirectangular
/// images, and for [`Camera::Canonical`] without a `placement`.
pub fn eyes(camera: &Camera, placement: Option<&Placement>, pivot: [f64; 3], apart: f64) -> Option<[Camera; 2]> {
    let (pose, lens) = match *camera {
        Camera::Canonical => {
            let placement = placement?;
            (own_pose(placement, pivot), Lens::Orthographic { half_extent: Some(extent(placement).1) })
        }
        Camera::Posed { pose, lens } => (pose, lens),
    };
    let rows = pose.rotation.matrix();
    let [right, down, forward] = [0, 1, 2].map(|axis| rows.map(|row| row[axis]));
    let distance: f64 = (0..3).map(|i| forward[i] * (pivot[i] - pose.position[i])).sum();
    if !(distance > 0.0 && distance.is_finite()) {
        return None;
    }
    let half = 0.5 * apart;
    let eye = |side: f64| {
        Some(match lens {
            Lens::Orthographic { .. } => {
                let cos = 1.0 / (1.0 + half * half).sqrt();
                let sin = -side * half * cos;
                let across: [f64; 3] = std::array::from_fn(|i| cos * right[i] - sin * forward[i]);
                let along: [f64; 3] = std::array::from_fn(|i| cos * forward[i] + sin * right[i]);
                let position = std::array::from_fn(|i| pose.position[i] + distance * (forward[i] - along[i]));
                let rotation = Rotation::from_columns([across, down, along])?;
                Camera::Posed { pose: Pose { position, rotation }, lens }
            }
            // Two fixed positions do not fit all directions.
            Lens::Equirectangular => return None,
            Lens::Pinhole { focal, centre } => {
                let position = std::array::from_fn(|i| pose.position[i] + side * half * distance * right[i]);
                let centre = [centre[0] + side * half * focal[0], centre[1]];
                Camera::Posed { pose: Pose { position, ..pose }, lens: Lens::Pinhole { focal, centre } }
            }
        })
    };
    Some([eye(-1.0)?, eye(1.0)?])
}

/// Returns middle and half extents of the source's picture in square units.
fn extent(placement: &Placement) -> ([f64; 2], [f64; 2]) {
    let [rows, columns] = placement.content.map(|side| side as f64);
    let [height, width] = placement.model.map(|side| side.max(1) as f64);
    let [top, left] = placement.offset.map(|side| side as f64);
    let aspect = placement.aspect();
    let middle = [aspect * ((2.0 * left + columns) / width - 1.0), (2.0 * top + rows) / height - 1.0];
    (middle, [aspect * (columns / width), rows / height])
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLACEMENT: Placement = Placement { source: [9, 16], model: [20, 32], offset: [1, 0], content: [18, 32] };
    const PIVOT: [f64; 3] = [0.0, 0.0, 0.6];

    /// Returns the image position of a point, relative to the middle of the image, in image widths and heights.
    fn seen(camera: &Camera, point: [f64; 3]) -> [f64; 2] {
        let Camera::Posed { pose, lens } = *camera else { panic!("posed") };
        let d: [f64; 3] = std::array::from_fn(|i| point[i] - pose.position[i]);
        let [x, y, z] = pose.rotation.inverse().matrix().map(|row| row[0] * d[0] + row[1] * d[1] + row[2] * d[2]);
        assert!(z > 0.0);
        match lens {
            Lens::Orthographic { half_extent } => {
                let [w, h] = half_extent.unwrap_or([16.0 / 9.0, 1.0]);
                [0.5 * x / w, 0.5 * y / h]
            }
            Lens::Equirectangular => panic!("a view ahead"),
            Lens::Pinhole { focal, centre } => [focal[0] * x / z + centre[0] - 0.5, focal[1] * y / z + centre[1] - 0.5],
        }
    }

    #[test]
    fn an_orbit_goes_from_left_to_right_and_back() {
        let orbit = Turn::Orbit { degrees: 30.0, seconds: 2.0 };
        for (time, right) in [(0.0, -15.0), (1.0, 0.0), (2.0, 15.0), (3.0, 0.0), (4.0, -15.0), (5.5, 7.5)] {
            assert_eq!(orbit.at(time), Angles { right, up: 0.0 }, "{time}");
        }
        assert_eq!(Turn::Around { seconds: 4.0 }.at(5.0), Angles { right: 90.0, up: 0.0 });
    }

    #[test]
    fn a_sway_is_a_circle_that_closes() {
        let sway = Turn::Sway { degrees: 3.0, seconds: 4.0 };
        let at = |time| {
            let Angles { right, up } = sway.at(time);
            [right, up]
        };
        assert_eq!(at(0.0), [0.0, 3.0]);
        assert_eq!(at(0.0), at(4.0));
        for i in 0..8 {
            let [right, up] = at(0.5 * f64::from(i));
            assert!((right.hypot(up) - 3.0).abs() < 1e-12);
        }
        assert!(at(1.0)[0] > 2.9, "then to the right");
    }

    #[test]
    fn the_pivot_stays_and_what_is_behind_it_moves_with_the_camera() {
        assert_eq!(turned(&PLACEMENT, PIVOT, Angles::default()), Camera::Canonical);
        let right = turned(&PLACEMENT, PIVOT, Angles { right: 10.0, up: 0.0 });
        assert!(seen(&right, PIVOT).iter().all(|x| x.abs() < 1e-12));
        let behind = seen(&right, [0.0, 0.0, 1.6]);
        let moved = 0.5 * 10f64.to_radians().sin();
        // The image is as wide as the model's input, 1.6 times its height.
        assert!((behind[0] - moved / 1.6).abs() < 1e-9 && behind[1].abs() < 1e-12, "{behind:?}");
        let above = turned(&PLACEMENT, PIVOT, Angles { right: 0.0, up: 10.0 });
        let behind = seen(&above, [0.0, 0.0, 1.6]);
        // From above, farther points are higher in the image, whose content is 18 of the model's 20 rows high.
        assert!((behind[1] + moved / 0.9).abs() < 1e-9 && behind[0].abs() < 1e-12, "{behind:?}");
    }

    #[test]
    fn eyes_see_the_plane_of_the_pivot_alike_and_the_rest_shifted() {
        let pose = Pose::look_at([0.4, -0.2, -2.0], PIVOT, [0.0, -1.0, 0.0]).unwrap();
        let pinhole = Camera::pinhole(pose, 45.0, 16.0 / 9.0).unwrap();
        let turned = turned(&PLACEMENT, PIVOT, Angles { right: 7.0, up: -3.0 });
        for camera in [Camera::Canonical, turned, pinhole, Camera::orthographic(pose)] {
            let [left, right] = eyes(&camera, Some(&PLACEMENT), PIVOT, 0.1).expect("in front");
            let apart = |point| {
                let (a, b) = (seen(&left, point), seen(&right, point));
                assert!((a[1] - b[1]).abs() < 1e-9, "nothing is shifted up or down");
                a[0] - b[0]
            };
            assert!(apart(PIVOT).abs() < 1e-9);
            let Camera::Posed { pose, .. } = left else { panic!("posed") };
            let forward = pose.rotation.matrix().map(|row| row[2]);
            let at = |along: f64| std::array::from_fn(|i| PIVOT[i] + along * forward[i]);
            assert!(apart(at(-0.3)) > 0.005, "near things are farther right for the left eye");
            assert!(apart(at(0.3)) < -0.005, "and far things farther left");
        }
        let away = Pose { position: [0.0, 0.0, 3.0], ..Pose::default() };
        assert!(eyes(&Camera::orthographic(away), None, PIVOT, 0.1).is_none());
        assert!(eyes(&Camera::Canonical, None, PIVOT, 0.1).is_none());
    }
}
