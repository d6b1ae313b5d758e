//! Pictures and fields between their pixels: bilinear, the border repeated.

#![expect(unsafe_code, reason = "taps are read without a check for each")]

use crate::simd::{LANES, Simd};

/// Coordinates on one axis, for every lane: the lower of two taps, the step to the upper one, the upper one's weight.
#[derive(Clone, Copy)]
pub(super) struct Axis<S: Simd> {
    low: S::I32,
    step: S::I32,
    weight: S::F32,
}

/// The geometry of the sampled picture.
#[derive(Clone, Copy)]
pub(super) struct Sampler {
    pub h: usize,
    pub w: usize,
    /// Values from one row to the next.
    pub stride: usize,
}

impl Sampler {
    /// Coordinates `at` on an axis of `n` values.
    #[inline(always)]
    pub fn axis<S: Simd>(s: S, at: S::F32, n: usize) -> Axis<S> {
        let last = s.splat((n - 1) as f32);
        // A comparison with NaN is false: it ends on the last value.
        let at = s.max(s.min(at, last), s.splat(0.0));
        let floor = s.floor(at);
        let step = s.select_i32(s.lt(floor, last), s.splat_i32(1), s.splat_i32(0));
        Axis { low: s.to_i32(floor), step, weight: s.sub(at, floor) }
    }

    /// Columns `x` … displaced by `u`.
    #[inline(always)]
    pub fn columns<S: Simd>(self, s: S, x: usize, u: S::F32) -> Axis<S> {
        Self::axis(s, s.add(column(s, x), u), self.w)
    }

    /// Row `y` displaced by `v`.
    #[inline(always)]
    pub fn row<S: Simd>(self, s: S, y: usize, v: S::F32) -> Axis<S> {
        Self::axis(s, s.add(s.splat(y as f32), v), self.h)
    }

    /// The taps of coordinates on both axes.
    #[inline(always)]
    pub fn taps<S: Simd>(self, s: S, x: Axis<S>, y: Axis<S>) -> Taps<S> {
        let (row, low) = (s.to_array_i32(y.low), s.to_array_i32(x.low));
        let (down, right) = (s.to_array_i32(y.step), s.to_array_i32(x.step));
        let mut taps = [[0; LANES]; 4];
        for i in 0..LANES {
            let upper = row[i] as usize * self.stride + low[i] as usize;
            let lower = upper + down[i] as usize * self.stride;
            let right = right[i] as usize;
            for (k, at) in [upper, upper + right, lower, lower + right].into_iter().enumerate() {
                taps[k][i] = at as u32;
            }
        }
        Taps { taps, last: (self.h - 1) * self.stride + self.w - 1, x: x.weight, y: y.weight }
    }
}

/// Four indices and two weights for every lane.
pub(super) struct Taps<S: Simd> {
    /// Each at most `last`, since coordinates end with the picture.
    taps: [[u32; LANES]; 4],
    last: usize,
    x: S::F32,
    y: S::F32,
}

impl<S: Simd> Taps<S> {
    /// The values of a plane: along the row, then between the rows, a fused step each.
    #[inline(always)]
    pub fn take(&self, s: S, plane: &[f32]) -> S::F32 {
        assert!(plane.len() > self.last, "a tap beyond the plane");
        // SAFETY: no tap is behind the last value of the picture, which the plane has.
        let [a, b, c, d] = unsafe {
            [
                gather(s, plane, &self.taps[0]),
                gather(s, plane, &self.taps[1]),
                gather(s, plane, &self.taps[2]),
                gather(s, plane, &self.taps[3]),
            ]
        };
        let upper = s.mul_add(self.x, s.sub(b, a), a);
        let lower = s.mul_add(self.x, s.sub(d, c), c);
        s.mul_add(self.y, s.sub(lower, upper), upper)
    }
}

/// # Safety
/// All taps are in the plane.
#[inline(always)]
unsafe fn gather<S: Simd>(s: S, plane: &[f32], taps: &[u32; LANES]) -> S::F32 {
    let mut lanes = [0.0; LANES];
    for i in 0..LANES {
        // SAFETY: the caller's.
        lanes[i] = unsafe { *plane.get_unchecked(taps[i] as usize) };
    }
    s.from_array(lanes)
}

/// 0, 1, 2, …
const COUNT: [f32; LANES] = {
    let mut count = [0.0; LANES];
    let mut i = 0;
    while i < LANES {
        count[i] = i as f32;
        i += 1;
    }
    count
};

/// The columns from `x` on.
#[inline(always)]
pub(super) fn column<S: Simd>(s: S, x: usize) -> S::F32 {
    s.add(s.splat(x as f32), s.from_array(COUNT))
}

/// The value of a plane `[h, w]` at column `x`, row `y`: bilinear, the border repeated.
///
/// # Panics
/// On a plane without pixels, or of another length.
pub fn sample_one(plane: &[f32], [h, w]: [usize; 2], x: f32, y: f32) -> f32 {
    let axis = |at: f32, n: usize| {
        let last = (n - 1) as f32;
        let at = if at < last { at } else { last };
        let at = if at > 0.0 { at } else { 0.0 };
        let low = at as usize;
        (low, (low + 1).min(n - 1), at - low as f32)
    };
    let ((x0, x1, fx), (y0, y1, fy)) = (axis(x, w), axis(y, h));
    let row = |y: usize| {
        let (a, b) = (plane[y * w + x0], plane[y * w + x1]);
        crate::simd::fused_mul_add(fx, b - a, a)
    };
    let (upper, lower) = (row(y0), row(y1));
    crate::simd::fused_mul_add(fy, lower - upper, upper)
}
