//! Projection of Gaussians in view space to records for the blend, sixteen at a time.

mod sphere;

pub(super) use sphere::{POLE, frame};

use super::falloff::{ALPHA_MIN, Cut};
use super::{Defocus, Gaussians, Projection, Request};
use crate::simd::{LANES, Simd};

/// Sides of the square blocks of pixels that the blend works on, aligned to the image's corner.
pub(super) const BLOCK: usize = 4;
/// Added to both variances of a footprint, px² (the low-pass filter of EWA splatting).
pub(super) const LOW_PASS: f64 = 0.3;

/// `½·log₂e`: the footprint is kept so that α = opacity · 2^−(t² + s²), without a factor.
pub(super) const HALF_LOG2_E: f64 = 0.721_347_520_444_481_7;
pub(super) const ROOT_HALF_LOG2_E: f32 = 0.849_321_8;
/// Centres farther out than this many pixels are moved in to it, and their footprints are scaled alike, so that
/// binary32 does not overflow. For pixels of the image, which is at most 2¹⁶ pixels wide, the distance in standard
/// deviations changes by less than one part in 10⁴, and far less where images are smaller.
pub(super) const FARTHEST: f64 = 1_073_741_824.0;

/// A projected Gaussian: one cache line.
///
/// `α(x, y) = min(0.99, opacity · 2^−(s² + t²))` with `s = q·(y − v)` and `t = p·(x − m(y))`: a triangular factor of
/// the conic. `m(y) = u + k·(y − v)` is the middle of the footprint on row y. Rows' middles are binary64, so that long
/// needles and far centres keep their place.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(64))]
pub(super) struct Splat {
    /// The centre's u as a whole number and the rest; on the sphere the first two components of its direction.
    pub x: [f32; 2],
    /// The centre's v as a whole number and the rest; on the sphere the third, and 0.
    pub y: [f32; 2],
    pub k: f64,
    pub p: f32,
    pub q: f32,
    pub opacity: f32,
    /// At least the exponent at which α falls to 1/255.
    pub reach: f32,
    pub rgb: [f32; 3],
    pub depth: f32,
    /// Blocks that the footprint can touch, first and last, by column and by row; empty when the first is past the
    /// last. On the sphere columns past the image's last continue at its first.
    pub columns: [u16; 2],
    pub rows: [u16; 2],
}

const _: () = assert!(size_of::<Splat>() == 64);

impl Splat {
    pub(super) const HIDDEN: Splat = Splat {
        x: [0.0; 2],
        y: [0.0; 2],
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

    /// Returns true if both records have the same bits.
    #[inline(always)]
    pub(super) fn same_bits(&self, other: &Splat) -> bool {
        let words = |s: &Splat| {
            let bits = |a: f32, b: f32| u64::from(a.to_bits()) << 32 | u64::from(b.to_bits());
            [
                bits(s.x[0], s.x[1]),
                bits(s.y[0], s.y[1]),
                s.k.to_bits(),
                bits(s.p, s.q),
                bits(s.opacity, s.reach),
                bits(s.rgb[0], s.rgb[1]),
                bits(s.rgb[2], s.depth),
            ]
        };
        words(self) == words(other) && self.columns == other.columns && self.rows == other.rows
    }
}

/// The image onto which Gaussians are projected.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Viewport {
    pub projection: Projection,
    pub width: usize,
    pub height: usize,
    /// How α follows from a footprint.
    pub form: Form,
    /// True if opacities are lowered by as much as the low-pass widens footprints.
    pub antialias: bool,
    /// Tangents left and right, above and below of the axis, to which those in a pinhole's Jacobian are clamped.
    pub bounds: [[f64; 2]; 2],
    /// Ends of footprints.
    pub cut: Cut,
    /// Blur of a lens with a width.
    pub blur: Option<Blur>,
}

/// How α follows from a footprint's record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Form {
    /// No Gaussian is rotated and the projection is orthographic: footprints are axis-aligned.
    Separable,
    /// Any other footprint in a plane.
    General,
    /// A footprint on the sphere around the eye.
    Spherical,
}

/// A lens with a width: σ = f·share·|1/z − nearness| pixels of blur.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Blur {
    /// A quarter of the lens's diameter: the disc of the blur has half the diameter as its radius, and half that radius
    /// as its standard deviation along an axis.
    share: f64,
    /// One over the depth in focus.
    nearness: f64,
}

impl Blur {
    /// `None` where nothing is blurred.
    pub(super) fn new(projection: &Projection, defocus: Option<Defocus>) -> Option<Self> {
        let Projection::Pinhole { .. } = projection else { return None };
        let Defocus { aperture, focus } = defocus.filter(|lens| lens.is_usable() && lens.aperture > 0.0)?;
        Some(Self { share: 0.25 * f64::from(aperture), nearness: 1.0 / f64::from(focus) })
    }

    /// The standard deviation, in focal lengths, at the given inverse depth.
    #[inline(always)]
    fn deviation(&self, inverse: f64) -> f64 {
        self.share * (inverse - self.nearness)
    }
}

/// Bound of [`Request::bounded`](super::Request::bounded) beyond the image's edge, as a share of its width and height.
const BESIDE: f64 = 0.15;

/// The tangents for an image of this size.
pub(super) fn bounds(projection: &Projection, request: &Request) -> [[f64; 2]; 2] {
    match *projection {
        Projection::Pinhole { focal, centre } if request.bounded => std::array::from_fn(|axis| {
            let (focal, centre) = (f64::from(focal[axis]), f64::from(centre[axis]));
            let size = [request.width, request.height][axis] as f64;
            [(-0.5 - BESIDE * size - centre) / focal, (size - 0.5 + BESIDE * size - centre) / focal]
        }),
        _ => [[f64::NEG_INFINITY, f64::INFINITY]; 2],
    }
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

pub(super) type Lanes = [f32; LANES];

/// Up to sixteen projected Gaussians, field by field.
pub(super) struct Batch {
    /// Gaussians that can change a pixel, bit by bit.
    pub visible: u16,
    /// Gaussians with a field that is not finite.
    pub dropped: u16,
    pub u: [f64; LANES],
    pub v: [f64; LANES],
    pub k: [f64; LANES],
    pub x: [Lanes; 2],
    pub y: [Lanes; 2],
    pub p: Lanes,
    pub q: Lanes,
    pub opacity: Lanes,
    pub reach: Lanes,
    pub depth: Lanes,
    pub columns: [[i32; LANES]; 2],
    pub rows: [[i32; LANES]; 2],
}

/// The columns of an array of vectors, from `first`; lanes past the end hold zero.
#[inline(always)]
fn transposed<const N: usize>(from: &[[f32; N]], first: usize) -> [Lanes; N] {
    let mut lanes = [[0.0; LANES]; N];
    let from = &from[first..];
    for (i, vector) in from.iter().enumerate().take(LANES) {
        for (lane, &value) in lanes.iter_mut().zip(vector) {
            lane[i] = value;
        }
    }
    lanes
}

/// Zero where every value so far was finite, NaN elsewhere.
#[inline(always)]
fn poison<S: Simd, const N: usize>(s: S, mut sum: S::F32, values: &[Lanes; N]) -> S::F32 {
    for values in values {
        let v = s.from_array(*values);
        sum = s.add(sum, s.sub(v, v));
    }
    sum
}

/// Sixteen Gaussians, field by field; lanes past the last one hold zeros.
pub(super) struct Loaded<S: Simd> {
    pub mean: [Lanes; 3],
    pub scale: [Lanes; 3],
    /// Rotations as quaternions; zeros where the scene has none.
    pub turn: [Lanes; 4],
    pub opacity: S::F32,
    /// Lanes whose numbers are all finite.
    pub finite: S::Mask,
}

impl<S: Simd> Loaded<S> {
    /// Loads Gaussians `first ..`.
    #[inline(always)]
    pub(super) fn of(s: S, gaussians: &Gaussians<'_>, first: usize) -> Self {
        let mean = transposed(gaussians.mean, first);
        let scale = transposed(gaussians.scale, first);
        let rgb = transposed(gaussians.rgb, first);
        let opacity = s.load_partial(&gaussians.opacity[first..], 0.0);
        let poisoned = poison(s, poison(s, poison(s, s.sub(opacity, opacity), &mean), &scale), &rgb);
        let (turn, poisoned) = match gaussians.rotation {
            Some(rotation) => {
                let turn = transposed(rotation, first);
                (turn, poison(s, poisoned, &turn))
            }
            None => ([[0.0; LANES]; 4], poisoned),
        };
        Loaded { mean, scale, turn, opacity, finite: s.eq(poisoned, s.splat(0.0)) }
    }
}

/// First and last block of the pixels within `radius` of `centre` in an image of `size` pixels, and whether there are
/// any.
#[inline(always)]
pub(super) fn blocks<S: Simd>(s: S, centre: S::F32, radius: S::F32, size: usize) -> ([[i32; LANES]; 2], S::Mask) {
    let (zero, last) = (s.splat(0.0), s.splat(size as f32 - 1.0));
    let slack = s.mul_add(s.add(s.abs(centre), radius), s.splat(1e-6), s.splat(0.01));
    let extent = s.add(radius, slack);
    // Where the first operand is NaN, the result is the second.
    let from = s.max(s.sub(centre, extent), zero);
    let to = s.min(s.add(centre, extent), last);
    // Pixels are whole numbers: the next one from `from` up, the next one from `to` down.
    let from = s.neg(s.floor(s.neg(from)));
    let to = s.floor(to);
    let some = s.le(from, to);
    let from = s.to_i32(s.mul(s.min(s.max(from, zero), last), s.splat(0.25)));
    let to = s.to_i32(s.mul(s.min(s.max(to, zero), last), s.splat(0.25)));
    ([s.to_array_i32(from), s.to_array_i32(to)], some)
}

/// The standard deviation of a separable footprint along one axis, `√((f·s)² + 0.3)` in binary32, and the share `|f·s|`
/// of it.
#[inline(always)]
fn deviation<S: Simd>(s: S, scale: &Lanes, focal: f32) -> (S::F32, S::F32) {
    let sigma = s.mul(s.splat(focal), s.from_array(*scale));
    let root = s.sqrt(s.mul_add(sigma, sigma, s.splat(LOW_PASS as f32)));
    // The square of a very long axis may overflow.
    let long = s.lt(s.splat(1e9), s.abs(sigma));
    let share = s.select(long, s.splat(1.0), s.div(s.abs(sigma), root));
    (s.select(long, s.abs(sigma), root), share)
}

/// One axis of a separable footprint with the standard deviation `root`, in binary32. Returns the centre `f·x + (size −
/// 1)/2` in two parts by fused multiply-adds, `√(½log₂e) / root`, the blocks it can touch, and whether there are any.
#[inline(always)]
fn along<S: Simd>(
    s: S,
    mean: &Lanes,
    root: S::F32,
    focal: f32,
    radius: S::F32,
    size: usize,
) -> ([Lanes; 2], Lanes, [[i32; LANES]; 2], S::Mask) {
    let (f, middle, mean) = (s.splat(focal), s.splat((size as f32 - 1.0) * 0.5), s.from_array(*mean));
    let centre = s.mul_add(f, mean, middle);
    let whole = s.round(centre);
    let rest = s.mul_add(f, mean, s.sub(middle, whole));
    let p = s.div(s.splat(ROOT_HALF_LOG2_E), root);
    let (blocks, some) = blocks(s, centre, s.mul(radius, root), size);
    let seen = s.and(some, s.lt(s.abs(centre), s.splat(1e30)));
    ([s.to_array(whole), s.to_array(rest)], s.to_array(p), blocks, seen)
}

impl Batch {
    /// Projects Gaussians `first ..` (as many as there are, at most sixteen) separably.
    #[inline(always)]
    pub(super) fn separable<S: Simd>(
        s: S,
        gaussians: &Gaussians<'_>,
        first: usize,
        focal: [f32; 2],
        view: &Viewport,
    ) -> Self {
        // Rotations are the identity: the scene is separable.
        let Loaded { mean, scale, opacity, finite, .. } = Loaded::of(s, gaussians, first);
        let (wide, share_x) = deviation(s, &scale[0], focal[0]);
        let (high, share_y) = deviation(s, &scale[1], focal[1]);
        let opacity = if view.antialias { s.mul(opacity, s.mul(share_x, share_y)) } else { opacity };
        let (opacity, reach, opaque) = view.cut.apply(s, opacity);
        let radius = s.mul(s.sqrt(reach), s.splat(1.0 / ROOT_HALF_LOG2_E));
        let (x, p, columns, seen_x) = along(s, &mean[0], wide, focal[0], radius, view.width);
        let (y, q, rows, seen_y) = along(s, &mean[1], high, focal[1], radius, view.height);
        let ahead = s.lt(s.splat(0.0), s.from_array(mean[2]));
        let visible = s.and(s.and(finite, s.and(ahead, opaque)), s.and(seen_x, seen_y));
        Self {
            visible: s.bits(visible),
            dropped: !s.bits(finite) & Self::present(gaussians, first),
            u: [0.0; LANES],
            v: [0.0; LANES],
            k: [0.0; LANES],
            x,
            y,
            p,
            q,
            opacity: s.to_array(opacity),
            reach: s.to_array(reach),
            depth: mean[2],
            columns,
            rows,
        }
    }

    /// Projects Gaussians `first ..` (as many as there are, at most sixteen).
    ///
    /// Binary64 in the order written here. The determinant of the footprint's covariance is a sum of squares,
    /// `|m₁ × m₂|² + 0.3(|m₁|² + |m₂|²) + 0.09` with `m₁, m₂` the rows of `J·R·S`, so needles do not cancel.
    #[inline(always)]
    pub(super) fn general<S: Simd, const PINHOLE: bool, const BLURRED: bool>(
        s: S,
        gaussians: &Gaussians<'_>,
        first: usize,
        focal: [f32; 2],
        centre: [f64; 2],
        view: &Viewport,
    ) -> Self {
        let Loaded { mean, scale, turn, opacity, finite } = Loaded::of(s, gaussians, first);
        let [fx, fy] = focal.map(f64::from);
        let [[x_least, x_most], [y_least, y_most]] = view.bounds;
        let [mut u, mut v, mut k, mut own, mut widened] = [[0.0_f64; LANES]; 5];
        let [mut a, mut c, mut p, mut q, mut whole, mut middle, mut sound] = [[0.0_f32; LANES]; 7];
        for l in 0..LANES {
            let [x, y, z] = [f64::from(mean[0][l]), f64::from(mean[1][l]), f64::from(mean[2][l])];
            let r = rotation([turn[0][l].into(), turn[1][l].into(), turn[2][l].into(), turn[3][l].into()]);
            let [sx, sy, sz] = [f64::from(scale[0][l]), f64::from(scale[1][l]), f64::from(scale[2][l])];
            let m = [
                [r[0][0] * sx, r[0][1] * sy, r[0][2] * sz],
                [r[1][0] * sx, r[1][1] * sy, r[1][2] * sz],
                [r[2][0] * sx, r[2][1] * sy, r[2][2] * sz],
            ];
            let (m1, m2);
            if PINHOLE {
                let inverse = 1.0 / z;
                let (tx, ty, jx, jy) = (x * inverse, y * inverse, fx * inverse, fy * inverse);
                u[l] = fx * tx + centre[0];
                v[l] = fy * ty + centre[1];
                let [tx, ty] = [tx.max(x_least).min(x_most), ty.max(y_least).min(y_most)];
                m1 = [jx * (m[0][0] - tx * m[2][0]), jx * (m[0][1] - tx * m[2][1]), jx * (m[0][2] - tx * m[2][2])];
                m2 = [jy * (m[1][0] - ty * m[2][0]), jy * (m[1][1] - ty * m[2][1]), jy * (m[1][2] - ty * m[2][2])];
            } else {
                u[l] = fx * x + centre[0];
                v[l] = fy * y + centre[1];
                m1 = [fx * m[0][0], fx * m[0][1], fx * m[0][2]];
                m2 = [fy * m[1][0], fy * m[1][1], fy * m[1][2]];
            }
            let n = [m1[1] * m2[2] - m1[2] * m2[1], m1[2] * m2[0] - m1[0] * m2[2], m1[0] * m2[1] - m1[1] * m2[0]];
            let aa = m1[0] * m1[0] + m1[1] * m1[1] + m1[2] * m1[2];
            let bb = m1[0] * m2[0] + m1[1] * m2[1] + m1[2] * m2[2];
            let cc = m2[0] * m2[0] + m2[1] * m2[1] + m2[2] * m2[2];
            let nn = n[0] * n[0] + n[1] * n[1] + n[2] * n[2];
            let det = nn + LOW_PASS * (aa + cc) + LOW_PASS * LOW_PASS;
            (own[l], widened[l]) = (nn, det);
            let (variance, det) = if BLURRED {
                let blur = view.blur.map_or(0.0, |blur| blur.deviation(1.0 / z));
                let (blur_x, blur_y) = (fx * blur, fy * blur);
                let (x, y) = (LOW_PASS + blur_x * blur_x, LOW_PASS + blur_y * blur_y);
                if !view.antialias {
                    own[l] = det;
                }
                widened[l] = (nn + (x * cc + y * aa)) + x * y;
                ([aa + x, cc + y], widened[l])
            } else {
                ([aa + LOW_PASS, cc + LOW_PASS], det)
            };
            let inverse = 1.0 / variance[1];
            k[l] = bb * inverse;
            // Far centres are moved in, and their footprints scaled with them.
            let (far_x, far_y) = ((u[l].abs() * (1.0 / FARTHEST)).max(1.0), (v[l].abs() * (1.0 / FARTHEST)).max(1.0));
            let (slope, height) = ((HALF_LOG2_E * (variance[1] / det)).sqrt(), (HALF_LOG2_E * inverse).sqrt());
            p[l] = (slope * far_x) as f32;
            q[l] = (height * far_y) as f32;
            whole[l] = u[l] as f32;
            middle[l] = v[l] as f32;
            a[l] = variance[0] as f32;
            c[l] = variance[1] as f32;
            sound[l] = ((u[l] * 0.0 + v[l] * 0.0) + (slope * 0.0 + k[l] * 0.0) + height * 0.0) as f32;
            k[l] *= far_y / far_x;
            u[l] /= far_x;
            v[l] /= far_y;
        }
        let drawn = s.le(s.splat(ALPHA_MIN), opacity);
        let opacity = if view.antialias || BLURRED {
            // NaN where a determinant overflows; NaN is not drawn.
            let share: Lanes = std::array::from_fn(|l| (own[l] / widened[l]).sqrt() as f32);
            s.mul(opacity, s.from_array(share))
        } else {
            opacity
        };
        let (opacity, reach, opaque) = view.cut.apply(s, opacity);
        let radius = s.mul(s.sqrt(reach), s.splat(1.0 / ROOT_HALF_LOG2_E));
        let (columns, seen_x) = blocks(s, s.from_array(whole), s.mul(radius, s.sqrt(s.from_array(a))), view.width);
        let (rows, seen_y) = blocks(s, s.from_array(middle), s.mul(radius, s.sqrt(s.from_array(c))), view.height);
        let nearest = if PINHOLE { 1e-6 } else { 0.0 };
        let ahead = s.lt(s.splat(nearest), s.from_array(mean[2]));
        let sound = s.eq(s.from_array(sound), s.splat(0.0));
        // A blur spreads only Gaussians that are drawn without it.
        let opaque = if BLURRED { s.and(opaque, drawn) } else { opaque };
        let visible = s.and(s.and(finite, s.and(ahead, opaque)), s.and(sound, s.and(seen_x, seen_y)));
        Self {
            visible: s.bits(visible),
            dropped: !s.bits(finite) & Self::present(gaussians, first),
            u,
            v,
            k,
            x: [[0.0; LANES]; 2],
            y: [[0.0; LANES]; 2],
            p,
            q,
            opacity: s.to_array(opacity),
            reach: s.to_array(reach),
            depth: mean[2],
            columns,
            rows,
        }
    }

    /// The lanes that hold a Gaussian.
    #[inline(always)]
    pub(super) fn present(gaussians: &Gaussians<'_>, first: usize) -> u16 {
        ((1_u32 << (gaussians.len() - first).min(LANES)) - 1) as u16
    }

    /// The record of lane `l`, Gaussian `i`; `PARTS`: the centre is in `x` and `y` already.
    #[inline(always)]
    pub(super) fn splat<const PARTS: bool>(&self, gaussians: &Gaussians<'_>, l: usize, i: usize) -> Splat {
        self.record::<PARTS>(l, &gaussians.rgb[i])
    }

    /// The record of lane `l` with this colour.
    #[inline(always)]
    pub(super) fn record<const PARTS: bool>(&self, l: usize, rgb: &[f32; 3]) -> Splat {
        if self.visible >> l & 1 == 0 {
            return Splat::HIDDEN;
        }
        let (x, y) = if PARTS {
            ([self.x[0][l], self.x[1][l]], [self.y[0][l], self.y[1][l]])
        } else {
            let (x, y) = (split(self.u[l]), split(self.v[l]));
            ([x.0, x.1], [y.0, y.1])
        };
        Splat {
            x,
            y,
            k: self.k[l],
            p: self.p[l],
            q: self.q[l],
            opacity: self.opacity[l],
            reach: self.reach[l],
            rgb: *rgb,
            depth: self.depth[l],
            columns: [self.columns[0][l] as u16, self.columns[1][l] as u16],
            rows: [self.rows[0][l] as u16, self.rows[1][l] as u16],
        }
    }
}
