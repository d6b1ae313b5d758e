//! From a Gaussian in view space to what the blend needs of it.

use super::{Gaussians, Projection};

/// Sides of the square blocks of pixels that the blend works on, aligned to the image's corner.
pub(super) const BLOCK: usize = 4;
/// Added to both variances of a footprint, px² (the low-pass filter of EWA splatting).
pub(super) const LOW_PASS: f64 = 0.3;
/// An alpha below this is skipped.
pub(super) const ALPHA_MIN: f32 = 1.0 / 255.0;
/// An alpha above this is lowered to it.
pub(super) const ALPHA_MAX: f32 = 0.99;
/// A pixel is finished when the next splat would take its transmittance below this.
pub(super) const TRANSMITTANCE_MIN: f32 = 1e-4;

/// `½·log₂e`: the footprint is kept so that α = opacity · 2^−(t² + s²), without a factor.
const HALF_LOG2_E: f64 = 0.721_347_520_444_481_7;
/// Added to the exponent at which a footprint ends, so that no rounding in the blend reaches beyond it.
const EXPONENT_MARGIN: f64 = 0.02;
/// Centres farther out than this many pixels are brought in to it, together with their footprints: seen from the image, which is at
/// most 2¹⁶ pixels wide, that changes the distance measured in standard deviations by less than one part in 10⁴, and far less where images
/// are smaller. It keeps binary32 from overflowing.
const FARTHEST: f64 = 1_073_741_824.0;

/// A projected Gaussian: one cache line.
///
/// `α(x, y) = min(0.99, opacity · 2^−(s² + t²))` with `s = q·(y − v)` and `t = p·(x − m(y))`, where `m(y) = u + k·(y − v)` is
/// the middle of the footprint on row y: a triangular factor of the conic. Rows' middles are binary64, so that long
/// needles and far centres keep their place.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(64))]
pub(super) struct Splat {
    pub u: f64,
    pub v: f64,
    pub k: f64,
    pub p: f32,
    pub q: f32,
    pub opacity: f32,
    /// At least the exponent at which α falls to 1/255.
    pub reach: f32,
    pub rgb: [f32; 3],
    pub depth: f32,
    /// Blocks that the footprint can touch, first and last, by column and by row; empty when the first is past the last.
    pub columns: [u16; 2],
    pub rows: [u16; 2],
}

const _: () = assert!(size_of::<Splat>() == 64);

impl Splat {
    pub(super) const HIDDEN: Splat = Splat {
        u: 0.0,
        v: 0.0,
        k: 0.0,
        p: 0.0,
        q: 0.0,
        opacity: 0.0,
        reach: 0.0,
        rgb: [0.0; 3],
        depth: 0.0,
        columns: [1, 0],
        rows: [1, 0],
    };

    #[inline(always)]
    pub(super) fn is_hidden(&self) -> bool {
        self.columns[0] > self.columns[1]
    }

    /// Whether both records have the same bits.
    #[inline(always)]
    pub(super) fn same_bits(&self, other: &Splat) -> bool {
        let centre = |s: &Splat| [s.u, s.v, s.k].map(f64::to_bits);
        let rest = |s: &Splat| [s.p, s.q, s.opacity, s.reach, s.rgb[0], s.rgb[1], s.rgb[2], s.depth].map(f32::to_bits);
        let bounds = |s: &Splat| [s.columns, s.rows];
        centre(self) == centre(other) && rest(self) == rest(other) && bounds(self) == bounds(other)
    }
}

/// The image that is projected onto.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct View {
    pub projection: Projection,
    pub width: usize,
    pub height: usize,
    /// No Gaussian is rotated and the projection is orthographic: footprints are axis-aligned.
    pub separable: bool,
}

/// What became of a Gaussian.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Outcome {
    /// It can change a pixel.
    Visible,
    /// It cannot: behind the camera, outside the image, or too transparent.
    Culled,
    /// A field of it is not finite.
    Dropped,
}

/// `x` in two parts that add up to it: a whole number (where |x| < 2²⁴; otherwise `x` rounded) and the rest.
///
/// A pixel's coordinate minus the first part is exact, so the distance to `x` is as precise far from the image's corner
/// as it is near it.
#[inline(always)]
pub(super) fn split(x: f64) -> (f32, f32) {
    const MAGIC: f64 = 6_755_399_441_055_744.0;
    let whole = ((x + MAGIC) - MAGIC) as f32;
    (whole, (x - f64::from(whole)) as f32)
}

/// At least `log₂ x`, at most 0.09 above it, for positive normal `x`.
#[inline(always)]
fn log2_above(x: f64) -> f64 {
    let bits = x.to_bits();
    let exponent = ((bits >> 52) as i64 - 1023) as f64;
    let mantissa = f64::from_bits((bits & ((1 << 52) - 1)) | (1023 << 52));
    // log₂(1 + m) exceeds m by at most 0.08608.
    exponent + (mantissa - 1.0) + 0.0861
}

/// The rotation matrix of a quaternion (w, x, y, z), taken as it is: not normalised.
#[inline(always)]
pub(super) fn rotation(q: [f64; 4]) -> [[f64; 3]; 3] {
    let [w, x, y, z] = q;
    [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
}

#[inline(always)]
fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// First and last block of the pixels within `radius` of `centre` in an image of `size` pixels; `None` when there are none.
#[inline(always)]
fn blocks(centre: f64, radius: f64, size: usize) -> Option<[u16; 2]> {
    let last = size as f64 - 1.0;
    let (from, to) = (centre - radius, centre + radius);
    if !(from <= last && to >= 0.0) {
        return None;
    }
    // Pixels are whole numbers: nothing is drawn before the next one above `from` or after the next one below `to`.
    let from = if from > 0.0 { from } else { 0.0 };
    let to = if to < last { to } else { last };
    let first_pixel = from as usize + usize::from((from as usize as f64) < from);
    let last_pixel = to as usize;
    (first_pixel <= last_pixel).then_some([(first_pixel / BLOCK) as u16, (last_pixel / BLOCK) as u16])
}

/// Projects Gaussian `i`.
///
/// Everything up to the record's fields is binary64 in the order written here. The determinant of the footprint's
/// covariance is a sum of squares, `|m₁ × m₂|² + 0.3(|m₁|² + |m₂|²) + 0.09` with `m₁, m₂` the rows of `J·R·S`, so needles
/// do not cancel.
#[inline(always)]
pub(super) fn project(gaussians: &Gaussians<'_>, i: usize, view: &View) -> (Splat, Outcome) {
    let (mean, scale, rgb, opacity) = (gaussians.mean[i], gaussians.scale[i], gaussians.rgb[i], gaussians.opacity[i]);
    let turn = gaussians.rotation.map_or([1.0, 0.0, 0.0, 0.0], |r| r[i]);
    // A product with zero is zero exactly where a number is finite.
    let finite = (mean[0] * 0.0 + mean[1] * 0.0 + mean[2] * 0.0)
        + (scale[0] * 0.0 + scale[1] * 0.0 + scale[2] * 0.0)
        + (rgb[0] * 0.0 + rgb[1] * 0.0 + rgb[2] * 0.0)
        + (turn[0] * 0.0 + turn[1] * 0.0 + turn[2] * 0.0 + turn[3] * 0.0)
        + opacity * 0.0
        == 0.0;
    if !finite {
        return (Splat::HIDDEN, Outcome::Dropped);
    }
    if opacity < ALPHA_MIN {
        return (Splat::HIDDEN, Outcome::Culled);
    }
    let [x, y, z] = mean.map(f64::from);
    let scale = scale.map(f64::from);
    let reach = log2_above(255.0 * f64::from(opacity)) + EXPONENT_MARGIN;
    let (centre, a, c, p, k, q);
    match view.projection {
        Projection::Orthographic { focal } => {
            if z <= 0.0 {
                return (Splat::HIDDEN, Outcome::Culled);
            }
            let [fx, fy] = focal.map(f64::from);
            centre = [fx * x + (view.width as f64 - 1.0) / 2.0, fy * y + (view.height as f64 - 1.0) / 2.0];
            if view.separable {
                let (sx, sy) = (fx * scale[0], fy * scale[1]);
                a = sx * sx + LOW_PASS;
                c = sy * sy + LOW_PASS;
                p = (HALF_LOG2_E / a).sqrt();
                k = 0.0;
                q = (HALF_LOG2_E / c).sqrt();
            } else {
                let m = rotated(turn, scale);
                (a, c, p, k, q) = footprint(m[0].map(|v| fx * v), m[1].map(|v| fy * v));
            }
        }
        Projection::Pinhole { focal, centre: [cx, cy] } => {
            if z <= 1e-6 {
                return (Splat::HIDDEN, Outcome::Culled);
            }
            let [fx, fy] = focal.map(f64::from);
            let inverse = 1.0 / z;
            let (tx, ty) = (x * inverse, y * inverse);
            centre = [fx * tx + f64::from(cx), fy * ty + f64::from(cy)];
            let m = rotated(turn, scale);
            let (jx, jy) = (fx * inverse, fy * inverse);
            let row = |j: f64, slope: f64, own: [f64; 3]| {
                [j * (own[0] - slope * m[2][0]), j * (own[1] - slope * m[2][1]), j * (own[2] - slope * m[2][2])]
            };
            (a, c, p, k, q) = footprint(row(jx, tx, m[0]), row(jy, ty, m[1]));
        }
    }
    let [u, v] = centre;
    if (u * 0.0 + v * 0.0) + (a * 0.0 + c * 0.0) + (p * 0.0 + k * 0.0 + q * 0.0) != 0.0 {
        return (Splat::HIDDEN, Outcome::Culled);
    }
    let squared = reach / HALF_LOG2_E;
    let columns = blocks(u, (squared * a).sqrt(), view.width);
    let rows = blocks(v, (squared * c).sqrt(), view.height);
    let (Some(columns), Some(rows)) = (columns, rows) else {
        return (Splat::HIDDEN, Outcome::Culled);
    };
    let (far_x, far_y) = ((u.abs() / FARTHEST).max(1.0), (v.abs() / FARTHEST).max(1.0));
    let splat = Splat {
        u: u / far_x,
        v: v / far_y,
        k: k * (far_y / far_x),
        p: (p * far_x) as f32,
        q: (q * far_y) as f32,
        opacity,
        reach: reach as f32,
        rgb,
        depth: mean[2],
        columns,
        rows,
    };
    (splat, Outcome::Visible)
}

/// `R·S`, row major.
#[inline(always)]
fn rotated(turn: [f32; 4], scale: [f64; 3]) -> [[f64; 3]; 3] {
    rotation(turn.map(f64::from)).map(|row| [row[0] * scale[0], row[1] * scale[1], row[2] * scale[2]])
}

/// Variances `a`, `c` along x and y of the footprint with rows `m1`, `m2`, and the factor `(p, k, q)` of half its conic:
/// `½log₂e · dᵀΣ⁻¹d = (p·(dx − k·dy))² + (q·dy)²`.
#[inline(always)]
fn footprint(m1: [f64; 3], m2: [f64; 3]) -> (f64, f64, f64, f64, f64) {
    let (aa, b, cc, n) = (dot(m1, m1), dot(m1, m2), dot(m2, m2), cross(m1, m2));
    let det = dot(n, n) + LOW_PASS * (aa + cc) + LOW_PASS * LOW_PASS;
    let (a, c) = (aa + LOW_PASS, cc + LOW_PASS);
    let inverse = 1.0 / c;
    let p = (HALF_LOG2_E * (c / det)).sqrt();
    (a, c, p, b * inverse, (HALF_LOG2_E * inverse).sqrt())
}
