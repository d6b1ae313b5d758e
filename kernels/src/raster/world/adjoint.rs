//! Gradients by Gaussians and the camera from those by footprints, in binary64.

use super::super::Gaussians;
use super::super::project::Splat;
use super::project::{Camera, Geometry, cross};
use super::{FootprintGradient, WorldGradients};
use crate::simd::{Operation, Simd};

/// Gradients by a Gaussian and by [V | t].
struct Gradient {
    mean: [f64; 3],
    rotation: [f64; 4],
    scale: [f64; 3],
    opacity: f64,
    view: [[f64; 4]; 3],
}

/// The adjoint of a chunk of Gaussians; returns the gradient by [V | t].
pub(super) struct AdjointChunk<'a> {
    pub gaussians: &'a Gaussians<'a>,
    pub camera: &'a Camera,
    pub splats: &'a [Splat],
    pub footprints: &'a [FootprintGradient],
    pub of_depth: Option<&'a [f32]>,
    pub first: usize,
    pub to: WorldGradients<'a>,
}

impl Operation for AdjointChunk<'_> {
    type Output = [[f64; 4]; 3];
    #[inline(always)]
    fn run<S: Simd>(self, _: S) -> [[f64; 4]; 3] {
        let Self { gaussians, camera, splats, footprints, of_depth, first, to } = self;
        let mut view = [[0.0; 4]; 3];
        for i in 0..to.mean.len() {
            let at = first + i;
            let depth = of_depth.map_or(0.0, |of| f64::from(of[at]));
            if splats[at].is_hidden() {
                continue;
            }
            let quaternion = gaussians.rotation.map_or([1.0, 0.0, 0.0, 0.0], |r| r[at].map(f64::from));
            let (mean, scale) = (gaussians.mean[at].map(f64::from), gaussians.scale[at].map(f64::from));
            let seen = Geometry::new(camera, mean, quaternion, scale);
            let opacity = gaussians.opacity[at].into();
            let of = gradient(camera, &seen, mean, scale, opacity, &footprints[at], depth);
            for (to, of) in to.mean[i].iter_mut().zip(of.mean) {
                *to += of as f32;
            }
            for (to, of) in to.rotation[i].iter_mut().zip(of.rotation) {
                *to += of as f32;
            }
            for (to, of) in to.scale[i].iter_mut().zip(of.scale) {
                *to += of as f32;
            }
            to.opacity[i] += of.opacity as f32;
            for (to, of) in view.as_flattened_mut().iter_mut().zip(of.view.as_flattened()) {
                *to += of;
            }
        }
        view
    }
}

#[inline(always)]
fn gradient(
    camera: &Camera,
    seen: &Geometry,
    mean: [f64; 3],
    scale: [f64; 3],
    opacity: f64,
    of: &FootprintGradient,
    of_depth: f64,
) -> Gradient {
    let [_, bb, cc, nn] = seen.products;
    let (det, low) = (seen.det, camera.low_pass);
    let c = cc + low;
    let [of_u, of_v] = of.centre.map(f64::from);
    let [of_p, of_k, of_q] = of.shape.map(f64::from);
    let of_drawn = f64::from(of.opacity);
    // ln p = ½ ln(c/det), ln q = −½ ln c, k·p/q = b/√det.
    let root = 1.0 / det.sqrt();
    let of_bb = of_k * root;
    let of_cc = 0.5 * (of_p - of_q) / c - of_k * (bb * root / c);
    let mut of_det = -0.5 * of_p / det;
    let (mut of_nn, mut of_opacity) = (0.0, of_drawn);
    if camera.antialias {
        let share = seen.share();
        of_opacity = of_drawn * share;
        if nn > 0.0 {
            let half = 0.5 * of_drawn * opacity;
            of_nn = half * share / nn;
            of_det -= half * share / det;
        }
    }
    let of_nn = of_nn + of_det;
    let (of_a, of_c) = (low * of_det, low * of_det + of_cc);
    let [m1, m2] = seen.rows;
    // ∂|m₁ × m₂|²/∂m₁ = 2·m₂ × (m₁ × m₂), which does not cancel for needles.
    let (n1, n2) = (cross(m2, seen.normal), cross(seen.normal, m1));
    let of_m1: [f64; 3] = std::array::from_fn(|i| 2.0 * (of_nn * n1[i] + of_a * m1[i]) + of_bb * m2[i]);
    let of_m2: [f64; 3] = std::array::from_fn(|i| 2.0 * (of_nn * n2[i] + of_c * m2[i]) + of_bb * m1[i]);

    let [fx, fy] = camera.focal;
    let [x, y, z] = seen.place;
    let (mut of_place, mut of_axes) = ([0.0, 0.0, of_depth], [[0.0; 3]; 3]);
    if camera.pinhole {
        let inverse = 1.0 / z;
        let (tx, ty, jx, jy) = (x * inverse, y * inverse, fx * inverse, fy * inverse);
        let [hx, hy] = seen.held;
        for i in 0..3 {
            of_axes[0][i] = jx * of_m1[i];
            of_axes[1][i] = jy * of_m2[i];
            of_axes[2][i] = -(hx * of_axes[0][i] + hy * of_axes[1][i]);
        }
        let third = seen.axes[2];
        let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        // Clamped tangents do not depend on x/z and y/z.
        let of_tx = of_u * fx - if hx == tx { dot(of_axes[0], third) } else { 0.0 };
        let of_ty = of_v * fy - if hy == ty { dot(of_axes[1], third) } else { 0.0 };
        of_place[0] = of_tx * inverse;
        of_place[1] = of_ty * inverse;
        of_place[2] -= (of_tx * tx + of_ty * ty + (dot(of_m1, m1) + dot(of_m2, m2))) * inverse;
    } else {
        of_place[0] = of_u * fx;
        of_place[1] = of_v * fy;
        of_axes[0] = of_m1.map(|m| m * fx);
        of_axes[1] = of_m2.map(|m| m * fy);
    }

    let (view, turn) = (&camera.view, &seen.turn);
    let (mut of_view, mut of_mean, mut of_turned) = ([[0.0; 4]; 3], [0.0; 3], [[0.0; 3]; 3]);
    for row in 0..3 {
        for k in 0..3 {
            of_mean[k] += view[row][k] * of_place[row];
            of_view[row][k] = of_place[row] * mean[k];
            for j in 0..3 {
                of_turned[k][j] += view[row][k] * of_axes[row][j];
                of_view[row][k] += of_axes[row][j] * (turn[k][j] * scale[j]);
            }
        }
        of_view[row][3] = of_place[row];
    }
    let (mut of_scale, mut of_turn) = ([0.0; 3], [[0.0; 3]; 3]);
    for k in 0..3 {
        for j in 0..3 {
            of_scale[j] += of_turned[k][j] * turn[k][j];
            of_turn[k][j] = of_turned[k][j] * scale[j];
        }
    }
    Gradient {
        mean: of_mean,
        rotation: of_quaternion(seen, &of_turn),
        scale: of_scale,
        opacity: of_opacity,
        view: of_view,
    }
}

/// The gradient by a quaternion from that by its rotation matrix.
#[inline(always)]
fn of_quaternion(seen: &Geometry, g: &[[f64; 3]; 3]) -> [f64; 4] {
    let [w, x, y, z] = seen.unit;
    let (a, b, c) = (g[2][1] - g[1][2], g[0][2] - g[2][0], g[1][0] - g[0][1]);
    let (d, e, f) = (g[0][1] + g[1][0], g[0][2] + g[2][0], g[1][2] + g[2][1]);
    let of = [
        2.0 * (x * a + y * b + z * c),
        2.0 * (w * a - 2.0 * x * (g[1][1] + g[2][2]) + y * d + z * e),
        2.0 * (w * b + x * d - 2.0 * y * (g[0][0] + g[2][2]) + z * f),
        2.0 * (w * c + x * e + y * f - 2.0 * z * (g[0][0] + g[1][1])),
    ];
    let along = w * of[0] + x * of[1] + y * of[2] + z * of[3];
    let length = w * w + x * x + y * y + z * z;
    // Shorter quaternions are not normalised.
    if length < 0.5 {
        return [0.0; 4];
    }
    std::array::from_fn(|i| (of[i] - seen.unit[i] * along) / seen.norm)
}
