//! Default camera of a still scene.

use super::statistics::quantiles;
use super::{Orbit, Still};
use crate::camera::{Camera, Lens, Pose};
use crate::render::turn::Angles;
use streamsplat_kernels::math::f64::sin_cos;

/// Vertical field of view in degrees.
const FIELD: f64 = 45.0;
/// Elevation of the camera above the middle, in degrees.
const ELEVATION: f64 = 12.0;
/// Largest part of the image's half that the scene fills.
const FILL: f64 = 0.8;
/// Logit of the least opacity that counts: 0.1.
const OPAQUE: f32 = -2.2;
/// Share of the centres at either end of each axis that may be floaters.
const FLOATERS: f64 = 0.05;
/// Margin added at either end of each axis, as a fraction of the width without floaters; limited by the outermost
/// centre.
const AROUND: f64 = 0.15;
/// Least ratio of depth to width at which the camera looks at the side of the box. Nearly equal sides keep the axes of
/// the file.
const DEEPER: f64 = 1.25;
/// Number of directions tried over a whole turn.
const DIRECTIONS: u32 = 24;

/// The box that holds most of a scene, and cameras that see it. Up is −y, as in scenes trained from COLMAP's cameras.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Framing {
    /// Least coordinates.
    pub least: [f64; 3],
    /// Greatest coordinates.
    pub greatest: [f64; 3],
    /// The file's limits for cameras around the scene.
    pub orbit: Option<Orbit>,
}

impl Still {
    /// The box that holds most of the scene: along each axis the range between the 5th and 95th percentiles of the
    /// centres, and 15 % of that width at either end, limited by the outermost centres. Gaussians with an opacity under
    /// 0.1 are ignored if there are others. With the scene's offset. `None` where no centre is finite.
    pub fn framing(&self) -> Option<Framing> {
        let corner = |corner: [f64; 3]| std::array::from_fn(|axis| corner[axis] + self.about.offset[axis]);
        let [least, greatest] = self.middle()?.map(corner);
        Some(Framing { least, greatest, orbit: self.about.orbit.filter(Orbit::is_set) })
    }

    /// Least and greatest coordinates of the box of [`Self::framing`], relative to the scene's offset.
    pub(crate) fn middle(&self) -> Option<[[f64; 3]; 2]> {
        let finite = |m: &[f32; 3]| m.iter().all(|x| x.is_finite());
        let solid = || self.mean.iter().zip(&self.logit).filter(|(m, logit)| finite(m) && **logit >= OPAQUE);
        let mut centres: Vec<[f32; 3]> = solid().map(|(m, _)| *m).collect();
        if centres.is_empty() {
            centres = self.mean.iter().filter(|m| finite(m)).copied().collect();
        }
        let (mut least, mut greatest) = ([0.0; 3], [0.0; 3]);
        for axis in 0..3 {
            let along = centres.iter().map(|m| m[axis]).collect();
            let [first, low, high, last] = quantiles(along, [0.0, FLOATERS, 1.0 - FLOATERS, 1.0])?.map(f64::from);
            let around = AROUND * (high - low);
            (least[axis], greatest[axis]) = (first.max(low - around), last.min(high + around));
        }
        Some([least, greatest])
    }
}

impl Framing {
    /// The camera at `degrees` around the scene that sees all of the box in images of `aspect` = width / height. Angles
    /// count to the right from the widest side: the front, looking along +z, or the right if the box is deeper than
    /// 1.25 widths.
    pub fn camera(&self, degrees: f64, aspect: f64) -> Camera {
        let angles = Angles { right: degrees, up: 0.0 };
        self.at(self.distance(angles, aspect), angles, aspect)
    }

    /// Cameras at several angles, all at one distance, from which the whole box is visible all around.
    pub fn around(&self, angles: &[Angles], aspect: f64) -> Vec<Camera> {
        let step = 360.0 / f64::from(DIRECTIONS);
        let tried = (0..DIRECTIONS).map(|i| self.distance(Angles { right: step * f64::from(i), up: 0.0 }, aspect));
        let distance = tried.fold(0.0, f64::max);
        angles.iter().map(|angles| self.at(distance, *angles, aspect)).collect()
    }

    /// Angle of the widest side, in degrees: 0, the front, looking along +z; or 90, the right, where the box is deeper
    /// than wide.
    fn widest(&self) -> f64 {
        let [width, _, depth] = std::array::from_fn(|i| self.greatest[i] - self.least[i]);
        if depth > DEEPER * width { 90.0 } else { 0.0 }
    }

    /// The middle of the box.
    pub fn middle(&self) -> [f64; 3] {
        std::array::from_fn(|i| 0.5 * (self.least[i] + self.greatest[i]))
    }

    /// The direction from the middle to the camera.
    fn outwards(&self, Angles { right, up }: Angles) -> [f64; 3] {
        let radians = std::f64::consts::PI / 180.0;
        let mut elevation = (ELEVATION + up) * radians;
        if let Some(Orbit { elevation: [least, most], .. }) = self.orbit {
            elevation = elevation.max(least.into()).min(most.into());
        }
        let ((sin, cos), (up, along)) = (sin_cos((self.widest() + right) * radians), sin_cos(elevation));
        [sin * along, -up, -cos * along]
    }

    /// Distance of a camera from the middle at which it sees the whole box.
    fn distance(&self, angles: Angles, aspect: f64) -> f64 {
        let unit = self.at(1.0, angles, aspect);
        let Camera::Posed { pose, lens: Lens::Pinhole { focal, .. } } = unit else { return 1.0 };
        let rows = pose.rotation.inverse().matrix();
        let half: [f64; 3] = std::array::from_fn(|i| 0.5 * (self.greatest[i] - self.least[i]));
        let mut distance = 0.0_f64;
        for corner in 0..8 {
            let d: [f64; 3] = std::array::from_fn(|i| if corner >> i & 1 == 0 { half[i] } else { -half[i] });
            let [x, y, z] = rows.map(|row| row[0] * d[0] + row[1] * d[1] + row[2] * d[2]);
            distance = distance.max(2.0 * focal[0] * x.abs() / FILL - z).max(2.0 * focal[1] * y.abs() / FILL - z);
        }
        // The scene may be one point.
        let distance = if distance > 1e-6 { distance } else { 1.0 };
        self.orbit.map_or(distance, |orbit| distance.max(orbit.radius.into()))
    }

    fn at(&self, distance: f64, angles: Angles, aspect: f64) -> Camera {
        let middle = self.middle();
        let outwards = self.outwards(angles);
        let eye = std::array::from_fn(|i| middle[i] + distance * outwards[i]);
        let pose = Pose::look_at(eye, middle, [0.0, -1.0, 0.0]).unwrap_or_default();
        Camera::pinhole(pose, FIELD, aspect).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A cloud between −1 and 1 with floaters far away and an invisible one.
    fn cloud(floaters: usize) -> Still {
        let value = |i: usize, k: usize| ((i * 7919 + k * 104_729) % 1009) as f32 / 504.5 - 1.0;
        let count = 1000;
        let mut mean: Vec<[f32; 3]> = (0..count).map(|i| std::array::from_fn(|k| value(i, k))).collect();
        for (i, m) in mean.iter_mut().take(floaters).enumerate() {
            *m = [500.0 + i as f32, -900.0, 300.0];
        }
        mean.push([f32::NAN; 3]);
        Still { mean, logit: vec![2.0; count + 1], ..Still::default() }
    }

    #[test]
    fn floaters_do_not_move_the_box() {
        let framing = cloud(20).framing().expect("a cloud");
        for axis in 0..3 {
            assert!((-1.3..=-0.9).contains(&framing.least[axis]), "{framing:?}");
            assert!((0.9..=1.3).contains(&framing.greatest[axis]), "{framing:?}");
        }
        assert!(Still::default().framing().is_none());
    }

    #[test]
    fn a_camera_keeps_to_the_files_limits_and_to_the_scenes_offset() {
        let mut still = cloud(0);
        still.about.offset = [431_250.0, 5_411_800.0, 312.0];
        let plain = still.framing().expect("a cloud");
        assert!((plain.middle()[1] - 5_411_800.0).abs() < 1.0, "{plain:?}");
        let height = |framing: &Framing| {
            let Camera::Posed { pose, .. } = framing.camera(30.0, 1.0) else { panic!("posed") };
            let d: [f64; 3] = std::array::from_fn(|k| pose.position[k] - framing.middle()[k]);
            let length = d.iter().map(|x| x * x).sum::<f64>().sqrt();
            ((-d[1] / length).asin(), length)
        };
        assert!((height(&plain).0.to_degrees() - ELEVATION).abs() < 1e-6);
        still.about.orbit = Some(Orbit { elevation: [0.5, 0.6], radius: 50.0 });
        let (elevation, radius) = height(&still.framing().expect("a cloud"));
        assert!((elevation - 0.5).abs() < 1e-6 && (radius - 50.0).abs() < 1e-6, "{elevation} {radius}");
        still.about.orbit = Some(Orbit { elevation: [0.0, 0.0], radius: f32::NAN });
        assert_eq!(still.framing(), Some(plain));
    }

    #[test]
    fn every_corner_of_the_box_is_seen_from_all_around() {
        let framing = Framing { least: [-3.0, 0.0, 2.0], greatest: [5.0, 1.0, 2.5], orbit: None };
        let angles: Vec<Angles> = (0..36).map(|i| Angles { right: f64::from(i) * 10.0, up: 0.0 }).collect();
        for aspect in [0.5, 16.0 / 9.0] {
            let single = angles.iter().map(|angles| framing.camera(angles.right, aspect));
            for camera in single.chain(framing.around(&angles, aspect)) {
                let Camera::Posed { pose, lens: Lens::Pinhole { focal, .. } } = camera else { panic!("a pinhole") };
                let rows = pose.rotation.inverse().matrix();
                for corner in 0..8 {
                    let d: [f64; 3] = std::array::from_fn(|i| {
                        let at = if corner >> i & 1 == 0 { framing.least[i] } else { framing.greatest[i] };
                        at - pose.position[i]
                    });
                    let [x, y, z] = rows.map(|row| row[0] * d[0] + row[1] * d[1] + row[2] * d[2]);
                    assert!(z > 0.0 && (focal[0] * x / z).abs() <= 0.5 && (focal[1] * y / z).abs() <= 0.5);
                }
            }
        }
    }

    #[test]
    fn up_is_against_y_and_the_front_looks_along_z() {
        let framing = Framing { least: [-1.0; 3], greatest: [1.0; 3], orbit: None };
        let Camera::Posed { pose, .. } = framing.camera(0.0, 1.0) else { panic!("posed") };
        assert!(pose.position[0].abs() < 1e-9 && pose.position[1] < 0.0 && pose.position[2] < -1.0, "{pose:?}");
        let Camera::Posed { pose, .. } = framing.camera(90.0, 1.0) else { panic!("posed") };
        assert!(pose.position[0] > 1.0 && pose.position[2].abs() < 1e-6, "{pose:?}");
        // A deep box is seen from its side, which is then as wide in the image as a wide box from the front.
        let of = |greatest: [f64; 3]| {
            let framing = Framing { least: greatest.map(|x| -x), greatest, orbit: None };
            let Camera::Posed { pose, .. } = framing.camera(0.0, 16.0 / 9.0) else { panic!("posed") };
            pose.position
        };
        let ([side, up, rest], wide) = (of([1.0, 1.0, 3.0]), of([3.0, 1.0, 1.0]));
        assert!(
            rest.abs() < 1e-9 && (side + wide[2]).abs() < 1e-9 && (up - wide[1]).abs() < 1e-9,
            "{side} {up} {wide:?}"
        );
        assert!(of([1.0, 1.0, 1.2])[0].abs() < 1e-9);
        let point = Framing { least: [4.0; 3], greatest: [4.0; 3], orbit: None };
        assert!(point.camera(0.0, 1.0).is_usable());
    }
}
