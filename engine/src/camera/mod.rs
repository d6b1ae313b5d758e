//! Cameras: the canonical orthographic one, and any rigid pose with an orthographic, pinhole or equirectangular lens.
//!
//! *Scene space* is what the canonical camera sees (StreamSplat (ICLR 2026), camera and image): x right, y down, z
//! forward, with x and y in [−1, 1] over the model's input. Depth is `z = 1 / (9.8·y_w + 0.2 + 10⁻⁶)`, from 0.1 to 5,
//! for a Gaussian's normalised inverse depth `y_w` in [0, 1].
//!
//! Other cameras are rigid poses in *square units*, in which x and z are multiplied by the input's
//! [aspect](crate::fit::Placement::aspect), as in exported files: a unit is half the input's height along every axis.
//! The units of a still scene are its own. A camera at the origin with no rotation looks along +z with +x right and +y
//! down, as the canonical one does.
//!
//! Lens parameters are fractions of the image, not pixels, so that one camera serves every size:
//!
//! ```text
//! orthographic:  u = (X / (2·e_x) + ½)·W − ½                 e = half extents of the view; [W/H, 1] by default
//! pinhole:       u = (f_x·X/Z + c_x)·W − ½                   f and c in image widths (heights for v)
//! all around:    u = (λ/2π + ½)·W − ½   v = (φ/π + ½)·H − ½  longitude λ = atan2(X, Z), latitude φ = asin(Y/√(X² + Y² + Z²))
//! ```
//!
//! with pixel centres at integers. [`mod@file`] describes the JSON form, [`CameraPath`] moving cameras.
//! [`cameras`](crate::formats::cameras) reads the files of other programs, [`turn`](crate::render::turn) turns a camera
//! around one point.

pub mod file;
pub(crate) mod json;
mod path;
mod pose;

use streamsplat_kernels::math::f64::sin_cos;

pub use file::CameraError;
pub use path::CameraPath;
pub use pose::{Pose, Rotation};

/// A view of the scene.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Camera {
    /// The view of the source's own camera: orthographic, axis-aligned, cropped to the source's content.
    #[default]
    Canonical,
    /// A camera anywhere in the scene, in square units.
    Posed {
        /// Its position and orientation.
        pose: Pose,
        /// Its projection.
        lens: Lens,
    },
}

/// Projection of a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Lens {
    /// Parallel rays.
    Orthographic {
        /// Units from the centre of the view to its right and to its lower edge. `None`: 1 to the lower edge, with
        /// square pixels.
        half_extent: Option<[f64; 2]>,
    },
    /// Rays through one point.
    Pinhole {
        /// Focal lengths in image widths and image heights.
        focal: [f64; 2],
        /// The principal point in image widths and heights from the upper left corner.
        centre: [f64; 2],
    },
    /// All directions around the camera: longitudes across the image, latitudes down, the forward direction in the
    /// middle.
    Equirectangular,
}

impl Camera {
    /// Returns a pinhole camera with its principal point in the middle and a vertical field of view of `degrees`, for
    /// images of `aspect` = width / height. `None` if an argument is not positive and finite or the field is 180° or
    /// more.
    pub fn pinhole(pose: Pose, degrees: f64, aspect: f64) -> Option<Self> {
        let usable = degrees > 0.0 && degrees < 180.0 && aspect > 0.0 && aspect.is_finite();
        usable.then(|| {
            let vertical = 0.5 / half_angle_tangent(degrees);
            Camera::Posed { pose, lens: Lens::Pinhole { focal: [vertical / aspect, vertical], centre: [0.5; 2] } }
        })
    }

    /// Returns the orthographic camera that sees one unit up and down: the canonical view without its crop, at any
    /// pose.
    pub fn orthographic(pose: Pose) -> Self {
        Camera::Posed { pose, lens: Lens::Orthographic { half_extent: None } }
    }

    /// Returns true if all numbers are finite and the lens is valid: positive extents or focal lengths.
    pub fn is_usable(&self) -> bool {
        match self {
            Camera::Canonical => true,
            Camera::Posed { pose, lens } => {
                let positive = |v: &[f64; 2]| v.iter().all(|x| *x > 0.0 && x.is_finite());
                pose.position.iter().all(|x| x.is_finite())
                    && match lens {
                        Lens::Orthographic { half_extent } => half_extent.as_ref().is_none_or(positive),
                        Lens::Pinhole { focal, centre } => positive(focal) && centre.iter().all(|c| c.is_finite()),
                        Lens::Equirectangular => true,
                    }
            }
        }
    }
}

/// Returns `tan(degrees / 2)` for an angle in (0°, 180°), with the same bits on every machine.
pub(crate) fn half_angle_tangent(degrees: f64) -> f64 {
    let (sin, cos) = sin_cos(degrees * (std::f64::consts::PI / 360.0));
    sin / cos
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_field_of_view_is_what_the_lens_sees() {
        for (degrees, tangent) in [(90.0, 1.0), (60.0, 1.0 / 3f64.sqrt()), (120.0, 3f64.sqrt()), (1e-3, 8.726646e-6)] {
            let Some(Camera::Posed { lens: Lens::Pinhole { focal, centre }, .. }) =
                Camera::pinhole(Pose::default(), degrees, 2.0)
            else {
                panic!("a pinhole camera");
            };
            assert!((focal[1] * tangent - 0.5).abs() < 1e-7, "{degrees}");
            assert_eq!((focal[0] * 2.0, centre), (focal[1], [0.5; 2]));
        }
        assert!(Camera::pinhole(Pose::default(), 180.0, 1.0).is_none());
        assert!(Camera::pinhole(Pose::default(), f64::NAN, 1.0).is_none());
        assert!(Camera::pinhole(Pose::default(), 60.0, 0.0).is_none());
    }

    #[test]
    fn cameras_that_see_nothing_are_not_usable() {
        assert!(Camera::Canonical.is_usable());
        assert!(Camera::orthographic(Pose::default()).is_usable());
        let with = |lens| Camera::Posed { pose: Pose::default(), lens };
        assert!(!with(Lens::Orthographic { half_extent: Some([1.0, 0.0]) }).is_usable());
        assert!(!with(Lens::Pinhole { focal: [1.0, f64::NAN], centre: [0.5; 2] }).is_usable());
        assert!(!with(Lens::Pinhole { focal: [1.0; 2], centre: [f64::INFINITY, 0.5] }).is_usable());
        let far = Pose { position: [f64::INFINITY, 0.0, 0.0], ..Pose::default() };
        assert!(!Camera::orthographic(far).is_usable());
    }
}
