//! Pictures between two frames.

use tracing::debug_span;

use super::Field;
use super::field::{Work, colours, planes};
use super::sample::{Sampler, column};
use crate::Level;
use crate::simd::Simd;

/// Distance in pixels from the requested position, or from the picture, at which a source has half its weight.
const OFF: f32 = 4.0;
/// Difference of the two frames' colours at which a source has lost half its weight.
const UNLIKE: f32 = 0.3;
/// Half the side of the window in which the motion is compared with standing still.
const NEAR: usize = 7;

/// Two frames to be blended along the flow between them, at any time.
///
/// Frames are `a` (time 0) and `b` (time 1), both `[3, h, w]`; F is the flow from `a` to `b` and B from `b` to `a`. At
/// time t two motions pass through a pixel x: one starts in `a` at p, the other in `b` at q. A third explanation is
/// that nothing moves. It weighs the more, the worse the other two explain the frames around x:
///
/// ```text
/// p = x − t·F(x − t·F(x))                      sources a(p) and b(p + F(p)), error e = |p + t·F(p) − x|
/// q = x − (1 − t)·B(x − (1 − t)·B(x))          sources b(q) and a(q + B(q)), e likewise
/// weight of a motion   w = 1 / (1 + (e/4)² + (d/0.3)²)        d: mean absolute difference of its two colours
/// weight of a source   o = 1 / (1 + (r/4)²)                   r: pixels outside the picture
/// weight of no motion  n = M² / (M² + S² + 10⁻¹²)             M: Σ ½(|a(x) − b(x + F(x))| + |b(x) − a(x + B(x))|), S: Σ |a(x) − b(x)|,
///                                                             means of three channels summed over 15×15 pixels, the border repeated
/// picture = (1 − t)²·w·o·a(p) + t(1 − t)·w·o·b(p + F(p)) + t(1 − t)·w'·o·a(q + B(q)) + t²·w'·o·b(q) + (1 − t)·n·a(x) + t·n·b(x),
///           by the sum of the weights
/// ```
///
/// The sums are formed in this order by fused steps; those over the window add rows from the first, then columns from
/// the first. At t = 0 and 1 the result is the frame.
pub struct Blend<'a> {
    level: Level,
    motions: [Motion<'a>; 2],
    /// n of every pixel.
    still: Vec<f32>,
}

impl<'a> Blend<'a> {
    /// Of two frames and the flow `[F, B]` between them.
    ///
    /// # Panics
    /// When a length does not fit the fields' size, the fields' sizes differ, or a [`Pyramid`](super::Pyramid) has no
    /// such size.
    pub fn new(level: Level, [a, b]: [&'a [f32]; 2], [forward, backward]: [&'a Field; 2]) -> Self {
        let size @ [h, w] = forward.size;
        for field in [forward, backward] {
            field.check();
            assert_eq!(field.size, size, "a field of another size");
        }
        for image in [a, b] {
            assert_eq!(image.len(), 3 * h * w, "an image of shape [3, {h}, {w}]");
        }
        let _span = debug_span!("flow", step = "compare", h, w).entered();
        let motions = [Motion { own: a, other: b, field: forward }, Motion { own: b, other: a, field: backward }];
        let mut unlike = vec![0.0; 2 * h * w];
        planes(level, size, &mut unlike, &Unlike { motions });
        let mut sums = vec![0.0; 2 * h * w];
        planes(level, size, &mut sums, &Rows { size, planes: &unlike });
        let padded: Vec<f32> = sums
            .chunks_exact(w)
            .flat_map(|row| {
                let (first, last) = (row[0], row[w - 1]);
                [first; NEAR].into_iter().chain(row.iter().copied()).chain([last; NEAR])
            })
            .collect();
        let mut still = vec![0.0; h * w];
        planes(level, size, &mut still, &Columns { size, planes: &padded });
        Self { level, motions, still }
    }

    /// The picture at time `t`, `[3, h, w]`.
    ///
    /// # Panics
    /// When `t` is not between 0 and 1.
    pub fn at(&self, t: f32) -> Vec<f32> {
        assert!((0.0..=1.0).contains(&t), "a time of {t} between 0 and 1");
        let [first, _] = &self.motions;
        if t == 0.0 || t == 1.0 {
            return if t == 0.0 { first.own.to_vec() } else { first.other.to_vec() };
        }
        let size @ [h, w] = first.field.size;
        let _span = debug_span!("flow", step = "blend", h, w).entered();
        let mut out = vec![0.0; 3 * h * w];
        planes(self.level, size, &mut out, &Between { blend: self, t });
        out
    }
}

struct Between<'a> {
    blend: &'a Blend<'a>,
    t: f32,
}

/// Difference of the frames along their motion, and without any motion.
struct Unlike<'a> {
    motions: [Motion<'a>; 2],
}

impl Work<2> for Unlike<'_> {
    #[inline(always)]
    fn pixels<S: Simd>(&self, s: S, y: usize, x: usize, n: usize) -> [S::F32; 2] {
        let sampler = self.motions[0].field.sampler();
        let zero = [s.splat(0.0); 2];
        let [a, b] = [0, 1].map(|side| colours(s, sampler, self.motions[side].own, y, x, zero));
        let along = |side: usize, own: &[S::F32; 3]| {
            let Motion { other, field, .. } = self.motions[side];
            apart(s, own, &colours(s, sampler, other, y, x, field.load(s, y, x, n)))
        };
        let moved = s.add(along(0, &a), along(1, &b));
        [s.mul(moved, s.splat(1.0 / 6.0)), s.mul(apart(s, &a, &b), s.splat(1.0 / 3.0))]
    }
}

/// Sums of rows in the window, of two planes.
struct Rows<'a> {
    size: [usize; 2],
    planes: &'a [f32],
}

impl Work<2> for Rows<'_> {
    #[inline(always)]
    fn pixels<S: Simd>(&self, s: S, y: usize, x: usize, n: usize) -> [S::F32; 2] {
        let [h, w] = self.size;
        let mut sums = [s.splat(0.0); 2];
        for k in 0..=2 * NEAR {
            let row = (y + k).saturating_sub(NEAR).min(h - 1);
            for (plane, sum) in sums.iter_mut().enumerate() {
                *sum = s.add(*sum, s.load_partial(&self.planes[(plane * h + row) * w + x..][..n], 0.0));
            }
        }
        sums
    }
}

/// Sums of columns in the window, of two planes padded by [`NEAR`] on either side, and the weight of no motion from
/// them.
struct Columns<'a> {
    size: [usize; 2],
    planes: &'a [f32],
}

impl Work<1> for Columns<'_> {
    #[inline(always)]
    fn pixels<S: Simd>(&self, s: S, y: usize, x: usize, n: usize) -> [S::F32; 1] {
        let [h, w] = self.size;
        let mut sums = [s.splat(0.0); 2];
        for k in 0..=2 * NEAR {
            for (plane, sum) in sums.iter_mut().enumerate() {
                let row = (plane * h + y) * (w + 2 * NEAR);
                *sum = s.add(*sum, s.load_partial(&self.planes[row + x + k..][..n], 0.0));
            }
        }
        let [moved, still] = sums.map(|sum| s.mul(sum, sum));
        let both = s.add(s.add(moved, still), s.splat(1e-12));
        [s.div(moved, both)]
    }
}

/// The sum of absolute differences of three channels.
#[inline(always)]
fn apart<S: Simd>(s: S, a: &[S::F32; 3], b: &[S::F32; 3]) -> S::F32 {
    let mut sum = s.splat(0.0);
    for k in 0..3 {
        sum = s.add(sum, s.abs(s.sub(a[k], b[k])));
    }
    sum
}

/// Motion from a frame to the other.
#[derive(Clone, Copy)]
struct Motion<'a> {
    own: &'a [f32],
    other: &'a [f32],
    field: &'a Field,
}

impl Motion<'_> {
    /// Sums of weight times colour over the motion's two sources at time `t`, and of their weights.
    #[inline(always)]
    fn sources<S: Simd>(&self, s: S, t: f32, y: usize, x: usize, n: usize) -> [S::F32; 4] {
        let Motion { own, other, field } = *self;
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
        let unlike = s.mul(apart(s, &near, &far), s.splat(1.0 / (3.0 * UNLIKE)));
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
        let Between { blend: Blend { motions, still, .. }, t } = *self;
        let first = motions[0].sources(s, t, y, x, n);
        let second = motions[1].sources(s, 1.0 - t, y, x, n);
        let [h, w] = motions[0].field.size;
        let at = y * w + x;
        let still = s.load_partial(&still[at..at + n], 0.0);
        let (still_a, still_b) = (s.mul(s.splat(1.0 - t), still), s.mul(s.splat(t), still));
        let weight = s.add(s.add(first[3], second[3]), still);
        let mut mixed = [weight; 3];
        for k in 0..3 {
            let own = |side: usize| s.load_partial(&motions[side].own[k * h * w + at..][..n], 0.0);
            let moved = s.add(first[k], second[k]);
            let all = s.mul_add(still_b, own(1), s.mul_add(still_a, own(0), moved));
            mixed[k] = s.div(all, weight);
        }
        mixed
    }
}
