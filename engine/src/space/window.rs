//! Test whether a pinhole's image can show any Gaussian of a group, from the bounds of their centres and their reach.

use streamsplat_kernels::raster::Projection;

use crate::render::View;

/// Upper bound of the standard deviations at which α ≥ 1/255 for an opacity of at most 1, √(2·ln 255) = 3.329,
/// including the rasteriser's allowance for the rounding of its own bound.
const DEVIATIONS: f64 = 3.36;
/// In pixels: more than `DEVIATIONS` times the standard deviation that every footprint gets for the pixel grid, √0.3
/// px, and a tenth of a pixel.
const BLUR: f64 = 2.1;
/// Upper bound of the relative errors of the projection's binary32 together.
const ROUNDING: f64 = 1e-4;
/// Upper bound of the error of a coordinate in view space, relative to the largest number it is computed from.
const TINY: f64 = 1e-9;
/// Larger numbers are never culled: binary32 could overflow in the projection.
pub(super) const LARGEST: f64 = 1e15;

/// The image of a pinhole camera, in scene space.
///
/// A Gaussian with its centre at (x, y, z) in view space and a reach ρ along its longest axis has a footprint of
///
/// ```text
/// |u − f·x/z − c| ≤ f·(ρ/z)·√(1 + (x/z)²) + blur
/// ```
///
/// pixels, and likewise for v (see [`streamsplat_kernels::raster`]). The affine approximation stretches a footprint
/// more the farther it is from the axis, so that it can reach into the image although the ellipsoid is outside the
/// frustum. With E the tangent of the image's edge, blur included, the footprint is outside the image where
///
/// ```text
/// x − E·z > ρ·√(1 + (x/z)²)
/// ```
///
/// For a box of centres the left side is linear and least in a corner; the right side is bounded by the largest |x|
/// over the least z. A box entirely behind the eye is not drawn either. Everything else may be visible, in particular a
/// Gaussian nearer to the plane of the eye than its reach.
///
/// There is no window for orthographic cameras: whether their image is separable depends on all Gaussians of the scene.
pub(crate) struct Window {
    eye: [f64; 3],
    /// Right, down and forward.
    rows: [[f64; 3]; 3],
    focal: [f64; 2],
    /// Tangents of the image's extent to the right and left, down and up.
    edges: [[f64; 2]; 2],
}

impl Window {
    /// Returns the window of an image of `[height, width]` pixels of a view through a pinhole; `None` for other views.
    pub(crate) fn new(view: &View, [height, width]: [usize; 2]) -> Option<Self> {
        let Projection::Pinhole { focal, centre } = *view.projection() else { return None };
        let (focal, centre) = (focal.map(f64::from), centre.map(f64::from));
        let last = [width as f64 - 1.0, height as f64 - 1.0];
        let edges = std::array::from_fn(|axis| {
            let slack = BLUR + ROUNDING * centre[axis].abs();
            [last[axis] - centre[axis], centre[axis]].map(|edge| (edge + slack) / focal[axis])
        });
        let pose = view.pose();
        Some(Self { eye: pose.position, rows: pose.rotation.inverse().matrix(), focal, edges })
    }

    /// Returns true if the image certainly shows no Gaussian with its centre in a box and a reach of at most `reach`.
    /// `half` is the distance from the box's `middle` to its sides. False if a number is not finite.
    pub(super) fn misses(&self, middle: [f64; 3], half: [f64; 3], reach: f64) -> bool {
        let largest: f64 = (0..3).map(|i| middle[i].abs() + half[i] + self.eye[i].abs()).sum();
        let small = largest <= LARGEST && reach <= LARGEST;
        if !small {
            return false;
        }
        let away: [f64; 3] = std::array::from_fn(|i| middle[i] - self.eye[i]);
        let [x, y, z] = self.rows.map(|row| dot(row, away));
        let [wide, high, deep] = self.rows.map(|row| dot(row.map(f64::abs), half));
        let error = TINY * largest;
        if z + deep < -error {
            return true;
        }
        let nearest = z - deep;
        if nearest <= 1e3 * error {
            return false;
        }
        [(x, wide), (y, high)].into_iter().enumerate().any(|(axis, (across, extent))| {
            let outermost = across.abs() + extent;
            let slope = outermost / nearest;
            if self.focal[axis] * (outermost + reach) / nearest * (1.0 + slope) > LARGEST {
                return false;
            }
            let needed =
                (1.0 + ROUNDING) * reach * (1.0 + slope * slope).sqrt() + ROUNDING * outermost + error * (1.0 + slope);
            [1.0, -1.0].into_iter().zip(self.edges[axis]).any(|(side, edge)| {
                let normal: [f64; 3] = std::array::from_fn(|i| side * self.rows[axis][i] - edge * self.rows[2][i]);
                side * across - edge * z - dot(normal.map(f64::abs), half) > needed
            })
        })
    }
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Returns an upper bound of the distance at which a Gaussian's α reaches 1/255; infinite for opacities above 1, which
/// have no bound.
pub(super) fn reach(scale: [f32; 3], opacity: f32) -> f64 {
    let longest = scale.iter().fold(0.0_f64, |longest, s| longest.max(f64::from(*s).abs()));
    if opacity <= 1.0 && scale.iter().all(|s| !s.is_nan()) { DEVIATIONS * longest } else { f64::INFINITY }
}
