//! Lenses with an aperture.

use streamsplat_kernels::raster::Defocus;

use super::RenderError;
use crate::camera::{Camera, Lens};

/// Aperture and focus of a lens. Only pinhole cameras have one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aperture {
    /// The focal length over the diameter of the entrance pupil: a photographer's f-number.
    pub f_stop: f64,
    /// Where the lens is in focus.
    pub focus: Focus,
    /// Height of the sensor, in the scene's units: the focal length follows from it and the field of view.
    pub sensor_height: f64,
}

/// Where a lens is in focus.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Focus {
    /// The plane at this distance in front of the camera, in the scene's units; infinite: distant things.
    Distance(f64),
    /// The plane through this point that faces the camera.
    Point([f64; 3]),
}

/// Height of a 35 mm film's picture, in metres.
pub const SENSOR_HEIGHT: f64 = 0.024;

impl Aperture {
    /// The defocus of `camera` with this aperture.
    ///
    /// # Errors
    /// Cameras without a pinhole, numbers that are not above 0 (an f-number or a distance may be infinite), and points
    /// that are not in front of the camera.
    pub(crate) fn of(&self, camera: &Camera) -> Result<Defocus, RenderError> {
        let Camera::Posed { pose, lens: Lens::Pinhole { focal, .. } } = camera else {
            return Err(RenderError::NoLens);
        };
        let Self { f_stop, focus, sensor_height } = *self;
        let fail = |what, found| RenderError::Aperture { what, found };
        if f_stop.is_nan() || f_stop <= 0.0 {
            return Err(fail("f-number", f_stop));
        }
        if !(sensor_height > 0.0 && sensor_height.is_finite()) {
            return Err(fail("height of the sensor", sensor_height));
        }
        let distance = match focus {
            Focus::Distance(distance) => distance,
            Focus::Point(point) => {
                let forward = pose.rotation.matrix().map(|row| row[2]);
                (0..3).map(|i| forward[i] * (point[i] - pose.position[i])).sum()
            }
        };
        // A distance that binary32 rounds to 0 is refused.
        if distance.is_nan() || distance as f32 <= 0.0 {
            return Err(fail("distance of the focus", distance));
        }
        let aperture = sensor_height * focal[1] / f_stop;
        if !(aperture as f32).is_finite() {
            return Err(fail("f-number", f_stop));
        }
        Ok(Defocus { aperture: aperture as f32, focus: distance as f32 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Pose;

    #[test]
    fn the_pupil_is_the_focal_length_over_the_f_number() {
        // A field of 60° on a sensor of 24 mm: a focal length of 20.78 mm.
        let pose = Pose { position: [0.0, 0.0, -3.0], ..Pose::default() };
        let camera = Camera::pinhole(pose, 60.0, 1.5).expect("a pinhole");
        let lens = Aperture { f_stop: 2.0, focus: Focus::Point([1.0, 1.0, 1.0]), sensor_height: 0.024 };
        let found = lens.of(&camera).expect("a lens");
        assert!((f64::from(found.aperture) - 0.012 * 3f64.sqrt() / 2.0).abs() < 1e-8, "{found:?}");
        assert_eq!(found.focus, 4.0);
    }

    #[test]
    fn what_is_no_lens_is_refused() {
        let camera = Camera::pinhole(Pose::default(), 60.0, 1.5).expect("a pinhole");
        let lens = Aperture { f_stop: 2.0, focus: Focus::Distance(3.0), sensor_height: 0.024 };
        for wrong in [
            Aperture { f_stop: 0.0, ..lens },
            Aperture { f_stop: -1.0, ..lens },
            Aperture { f_stop: f64::NAN, ..lens },
            Aperture { f_stop: 1e-300, ..lens },
            Aperture { focus: Focus::Distance(0.0), ..lens },
            Aperture { focus: Focus::Distance(-2.0), ..lens },
            Aperture { focus: Focus::Distance(f64::NAN), ..lens },
            Aperture { focus: Focus::Distance(1e-60), ..lens },
            Aperture { focus: Focus::Point([0.0, 0.0, -1.0]), ..lens },
            Aperture { sensor_height: 0.0, ..lens },
            Aperture { sensor_height: f64::INFINITY, ..lens },
        ] {
            assert!(matches!(wrong.of(&camera), Err(RenderError::Aperture { .. })), "{wrong:?}");
        }
        for right in [
            Aperture { f_stop: f64::INFINITY, ..lens },
            Aperture { focus: Focus::Distance(f64::INFINITY), ..lens },
            Aperture { focus: Focus::Distance(1e60), ..lens },
        ] {
            assert!(right.of(&camera).is_ok_and(|lens| lens.is_usable()), "{right:?}");
        }
        assert_eq!(lens.of(&Camera::Canonical), Err(RenderError::NoLens));
        assert_eq!(lens.of(&Camera::orthographic(Pose::default())), Err(RenderError::NoLens));
    }
}
