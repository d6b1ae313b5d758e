//! Pictures between two frames.

use tracing::debug_span;

use super::Field;
use super::field::{Work, colours, planes};
use super::sample::{Sampler, column};
use crate::Level;
use crate::simd::Simd;

/// Pixels off the place that was asked for, or outside the picture, at which a source has lost half its weight.
const OFF: f32 = 4.0;
/// Difference of the two frames' colours at which a source has lost half its weight.
const UNLIKE: f32 = 0.3;

/// The picture at time `t` between `a` (0) and `b` (1), all `[3, h, w]`, from the flow F from `a` to `b` and B from `b` to `a`.
///
/// A pixel x has two motions through it. One starts in `a` at p and passes x at time t, the other starts in `b` at q:
///
/// ```text
/// p = x − t·F(x − t·F(x))                      sources a(p) and b(p + F(p)), error e = |p + t·F(p) − x|
/// q = x − (1 − t)·B(x − (1 − t)·B(x))          sources b(q) and a(q + B(q)), e likewise
/// weight of a motion   w = 1 / (1 + (e/4)² + (d/0.3)²)        d: mean absolute difference of its two colours
/// weight of a source   o = 1 / (1 + (r/4)²)                   r: pixels outside the picture
/// picture = (1 − t)²·w·o·a(p) + t(1 − t)·w·o·b(p + F(p)) + t(1 − t)·w'·o·a(q + B(q)) + t²·w'·o·b(q), by the sum of the weights
/// ```
///
/// The sums are formed in this order by fused steps. At t = 0 and 1 the result is the frame.
///
/// # Panics
/// When a length does not fit `size`, there are no pixels, or `t` is not between 0 and 1.
pub fn blend(
    level: Level,
    a: &[f32],
    b: &[f32],
    size: [usize; 2],
    forward: &Field,
    backward: &Field,
    t: f32,
) -> Vec<f32> {
    let [h, w] = size;
    assert!((0.0..=1.0).contains(&t), "a time of {t} between 0 and 1");
    for field in [forward, backward] {
        field.check();
        assert_eq!(field.size, size, "a field of another size");
    }
    for image in [a, b] {
        assert_eq!(image.len(), 3 * h * w, "an image of shape [3, {h}, {w}]");
    }
    if t == 0.0 || t == 1.0 {
        return if t == 0.0 { a.to_vec() } else { b.to_vec() };
    }
    let _span = debug_span!("flow", step = "blend", h, w).entered();
    let mut out = vec![0.0; 3 * h * w];
    let motions =
        [Motion { own: a, other: b, field: forward, t }, Motion { own: b, other: a, field: backward, t: 1.0 - t }];
    planes(level, size, &mut out, &Between { motions });
    out
}

struct Between<'a> {
    motions: [Motion<'a>; 2],
}

/// Motion from a frame to the other, at time `t` on its way.
struct Motion<'a> {
    own: &'a [f32],
    other: &'a [f32],
    field: &'a Field,
    t: f32,
}

impl Motion<'_> {
    /// The sums of weight times colour of its two sources, and of their weights.
    #[inline(always)]
    fn sources<S: Simd>(&self, s: S, y: usize, x: usize, n: usize) -> [S::F32; 4] {
        let Motion { own, other, field, t } = *self;
        let sampler = field.sampler();
        let back = s.splat(-t);
        let [u, v] = field.load(s, y, x, n);
        let [u, v] = sample(s, sampler, field, y, x, [s.mul(back, u), s.mul(back, v)]);
        let to_own = [s.mul(back, u), s.mul(back, v)];
        let motion = sample(s, sampler, field, y, x, to_own);
        let to_other = [s.add(to_own[0], motion[0]), s.add(to_own[1], motion[1])];
        let (off_x, off_y) = (s.mul_add(s.splat(t), motion[0], to_own[0]), s.mul_add(s.splat(t), motion[1], to_own[1]));
        let near = colours(s, sampler, own, y, x, to_own);
        let far = colours(s, sampler, other, y, x, to_other);
        let mut unlike = s.splat(0.0);
        for k in 0..3 {
            unlike = s.add(unlike, s.abs(s.sub(near[k], far[k])));
        }
        let unlike = s.mul(unlike, s.splat(1.0 / (3.0 * UNLIKE)));
        let off = s.mul_add(off_x, off_x, s.mul(off_y, off_y));
        let doubt = s.mul_add(off, s.splat(1.0 / (OFF * OFF)), s.mul_add(unlike, unlike, s.splat(1.0)));
        let near_weight = s.div(s.splat((1.0 - t) * (1.0 - t)), s.mul(doubt, outside(s, sampler, y, x, to_own)));
        let far_weight = s.div(s.splat(t * (1.0 - t)), s.mul(doubt, outside(s, sampler, y, x, to_other)));
        let mut sums = [s.add(near_weight, far_weight); 4];
        for k in 0..3 {
            sums[k] = s.mul_add(near_weight, near[k], s.mul(far_weight, far[k]));
        }
        sums
    }
}

/// A field at displaced pixels.
#[inline(always)]
fn sample<S: Simd>(s: S, sampler: Sampler, field: &Field, y: usize, x: usize, [u, v]: [S::F32; 2]) -> [S::F32; 2] {
    let taps = sampler.taps(s, sampler.columns(s, x, u), sampler.row(s, y, v));
    [taps.take(s, &field.u), taps.take(s, &field.v)]
}

/// 1 + (r/4)² where r is the distance from the picture.
#[inline(always)]
fn outside<S: Simd>(s: S, sampler: Sampler, y: usize, x: usize, [u, v]: [S::F32; 2]) -> S::F32 {
    let zero = s.splat(0.0);
    let (px, py) = (s.add(column(s, x), u), s.add(s.splat(y as f32), v));
    let beyond_x = s.max(s.max(s.neg(px), s.sub(px, s.splat((sampler.w - 1) as f32))), zero);
    let beyond_y = s.max(s.max(s.neg(py), s.sub(py, s.splat((sampler.h - 1) as f32))), zero);
    let square = s.mul_add(beyond_x, beyond_x, s.mul(beyond_y, beyond_y));
    s.mul_add(square, s.splat(1.0 / (OFF * OFF)), s.splat(1.0))
}

impl Work<3> for Between<'_> {
    #[inline(always)]
    fn pixels<S: Simd>(&self, s: S, y: usize, x: usize, n: usize) -> [S::F32; 3] {
        let first = self.motions[0].sources(s, y, x, n);
        let second = self.motions[1].sources(s, y, x, n);
        let weight = s.add(first[3], second[3]);
        let mut mixed = [weight; 3];
        for k in 0..3 {
            mixed[k] = s.div(s.add(first[k], second[k]), weight);
        }
        mixed
    }
}
