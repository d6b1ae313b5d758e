//! Moving cameras: views at given times, interpolated in between.

use super::{Camera, Lens};

/// Views at increasing times, in seconds of the video.
///
/// Between two views of the same kind, position, lens and orientation (on the shorter way) are interpolated linearly.
/// Between views of different kinds (also with and without half extents), the earlier one is used. Before the first
/// view the first is used, after the last view the last.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraPath {
    views: Vec<(f64, Camera)>,
}

impl Default for CameraPath {
    fn default() -> Self {
        Self::from(Camera::Canonical)
    }
}

impl From<Camera> for CameraPath {
    /// Returns the path of a camera at rest.
    fn from(camera: Camera) -> Self {
        Self { views: vec![(0.0, camera)] }
    }
}

impl CameraPath {
    /// Returns a path through `views`. `None` if there are no views, times are not finite and increasing, or a camera
    /// is not usable.
    pub fn new(views: Vec<(f64, Camera)>) -> Option<Self> {
        let usable = !views.is_empty()
            && views.iter().all(|(time, camera)| time.is_finite() && camera.is_usable())
            && views.windows(2).all(|pair| pair[0].0 < pair[1].0);
        usable.then_some(Self { views })
    }

    /// Returns its views.
    pub fn views(&self) -> &[(f64, Camera)] {
        &self.views
    }

    /// Returns the camera at `time`.
    pub fn at(&self, time: f64) -> Camera {
        let after = self.views.partition_point(|(t, _)| *t <= time);
        let Some(&(start, before)) = after.checked_sub(1).and_then(|i| self.views.get(i)) else {
            return self.views[0].1;
        };
        let Some(&(end, next)) = self.views.get(after) else { return before };
        // Halved, so that the difference of any two finite times is finite.
        let t = (0.5 * time - 0.5 * start) / (0.5 * end - 0.5 * start);
        between(before, next, t)
    }
}

fn between(a: Camera, b: Camera, t: f64) -> Camera {
    let mix = |a: [f64; 2], b: [f64; 2]| std::array::from_fn(|i| a[i] * (1.0 - t) + b[i] * t);
    let (Camera::Posed { pose: pose_a, lens: lens_a }, Camera::Posed { pose: pose_b, lens: lens_b }) = (a, b) else {
        return a;
    };
    let lens = match (lens_a, lens_b) {
        (Lens::Orthographic { half_extent: None }, Lens::Orthographic { half_extent: None }) => lens_a,
        (Lens::Orthographic { half_extent: Some(a) }, Lens::Orthographic { half_extent: Some(b) }) => {
            Lens::Orthographic { half_extent: Some(mix(a, b)) }
        }
        (Lens::Pinhole { focal: fa, centre: ca }, Lens::Pinhole { focal: fb, centre: cb }) => {
            Lens::Pinhole { focal: mix(fa, fb), centre: mix(ca, cb) }
        }
        (Lens::Equirectangular, Lens::Equirectangular) => lens_a,
        _ => return a,
    };
    Camera::Posed { pose: pose_a.towards(&pose_b, t), lens }
}

#[cfg(test)]
mod tests {
    use super::super::Pose;
    use super::*;

    fn at_x(x: f64) -> Camera {
        Camera::orthographic(Pose { position: [x, 0.0, 0.0], ..Pose::default() })
    }

    #[test]
    fn a_path_moves_between_its_views_and_holds_outside() {
        let path = CameraPath::new(vec![(1.0, at_x(0.0)), (3.0, at_x(4.0)), (4.0, Camera::Canonical)]).unwrap();
        assert_eq!(path.at(-5.0), at_x(0.0));
        assert_eq!(path.at(1.0), at_x(0.0));
        assert_eq!(path.at(1.5), at_x(1.0));
        assert_eq!(path.at(3.0), at_x(4.0));
        assert_eq!(path.at(3.5), at_x(4.0));
        assert_eq!(path.at(4.0), Camera::Canonical);
        assert_eq!(path.at(1e300), Camera::Canonical);
    }

    #[test]
    fn unordered_or_unusable_paths_are_refused() {
        assert!(CameraPath::new(vec![]).is_none());
        assert!(CameraPath::new(vec![(1.0, at_x(0.0)), (1.0, at_x(1.0))]).is_none());
        assert!(CameraPath::new(vec![(f64::NAN, at_x(0.0))]).is_none());
        assert!(CameraPath::new(vec![(0.0, at_x(f64::NAN))]).is_none());
    }

    #[test]
    fn the_widest_span_of_times_does_not_overflow() {
        let path = CameraPath::new(vec![(f64::MIN, at_x(0.0)), (f64::MAX, at_x(2.0))]).unwrap();
        assert_eq!(path.at(0.0), at_x(1.0));
    }
}
