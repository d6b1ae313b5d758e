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
        let last = (self.h - 1) * self.stride + self.w - 1;
        let (mut upper, mut lower, mut most) = ([0; LANES], [0; LANES], 0);
        for i in 0..LANES {
            upper[i] = (row[i] as usize * self.stride + low[i] as usize) as u32;
            lower[i] = upper[i] + down[i] as u32 * self.stride as u32;
            most = most.max(lower[i]);
        }
        let inside = s.all(s.eq_i32(x.step, s.splat_i32(1)));
        Taps { upper, lower, right, fours: inside && most as usize + 3 <= last, last, x: x.weight, y: y.weight }
    }
}

impl Sampler {
    /// The values of a plane at points and at those one pixel to the right, to the left, below and above, bilinear with
    /// the weights of the point itself.
    #[inline(always)]
    pub fn cross<S: Simd>(self, s: S, plane: &[f32], [x, y]: [S::F32; 2]) -> [S::F32; 5] {
        assert!(plane.len() > (self.h - 1) * self.stride + self.w - 1, "a tap beyond the plane");
        let ((columns, fx), (rows, fy)) = (four(s, x, self.w), four(s, y, self.h));
        // Away from the border the four columns of every point are neighbours.
        let apart = (0..LANES).fold(0, |apart, i| apart | ((columns[3][i] - columns[0][i]) ^ 3));
        let mut values = [[s.splat(0.0); 4]; 4];
        for (values, rows) in values.iter_mut().zip(&rows) {
            let row: [u32; LANES] = std::array::from_fn(|i| rows[i] as u32 * self.stride as u32 + columns[0][i] as u32);
            if apart == 0 {
                // SAFETY: rows and columns, the last ones too, are those of the picture. The plane has its last value.
                *values = unsafe { s.gather_fours(plane.as_ptr(), &row) };
                continue;
            }
            for (value, column) in values.iter_mut().zip(&columns) {
                let taps = std::array::from_fn(|i| row[i] + (column[i] - columns[0][i]) as u32);
                // SAFETY: as above.
                *value = unsafe { gather(s, plane, &taps) };
            }
        }
        let [above, upper, lower, below] = values;
        let middle = [toward(s, fx, upper[1], upper[2]), toward(s, fx, lower[1], lower[2])];
        let right = [toward(s, fx, upper[2], upper[3]), toward(s, fx, lower[2], lower[3])];
        let left = [toward(s, fx, upper[0], upper[1]), toward(s, fx, lower[0], lower[1])];
        [
            toward(s, fy, middle[0], middle[1]),
            toward(s, fy, right[0], right[1]),
            toward(s, fy, left[0], left[1]),
            toward(s, fy, middle[1], toward(s, fx, below[1], below[2])),
            toward(s, fy, toward(s, fx, above[1], above[2]), middle[0]),
        ]
    }
}

/// `a + weight·(b − a)`, the sum fused.
#[inline(always)]
fn toward<S: Simd>(s: S, weight: S::F32, a: S::F32, b: S::F32) -> S::F32 {
    s.mul_add(weight, s.sub(b, a), a)
}

/// Four neighbouring whole coordinates around `at`, second and third its own, each ended with an axis of `n` values;
/// and the third one's weight.
#[inline(always)]
fn four<S: Simd>(s: S, at: S::F32, n: usize) -> ([[i32; LANES]; 4], S::F32) {
    let last = s.splat((n - 1) as f32);
    // Beyond these nothing changes. A comparison with NaN is false: it ends on the last value.
    let at = s.max(s.min(at, s.add(last, s.splat(2.0))), s.splat(-2.0));
    let floor = s.floor(at);
    let mut whole = [[0; LANES]; 4];
    for (i, whole) in whole.iter_mut().enumerate() {
        let place = s.max(s.min(s.add(floor, s.splat(i as f32 - 1.0)), last), s.splat(0.0));
        *whole = s.to_array_i32(s.to_i32(place));
    }
    (whole, s.sub(at, floor))
}

/// Four indices and two weights for every lane.
pub(super) struct Taps<S: Simd> {
    /// The left taps of both rows; each tap is at most `last`, since coordinates end with the picture.
    upper: [u32; LANES],
    lower: [u32; LANES],
    /// From a left tap to its right one: 1, or 0 in the last column.
    right: [i32; LANES],
    /// True if each right tap is next to the left one and two values after it are also up to `last`.
    fours: bool,
    last: usize,
    x: S::F32,
    y: S::F32,
}

impl<S: Simd> Taps<S> {
    /// The values of a plane: along the row, then between the rows, a fused step each.
    #[inline(always)]
    pub fn take(&self, s: S, plane: &[f32]) -> S::F32 {
        assert!(plane.len() > self.last, "a tap beyond the plane");
        let mut rows = [[s.splat(0.0); 2]; 2];
        for (values, row) in rows.iter_mut().zip([&self.upper, &self.lower]) {
            // SAFETY: no tap is behind the last value of the picture, which the plane has; nor are two more values,
            // where `fours` is true.
            unsafe {
                if self.fours {
                    let [left, right, ..] = s.gather_fours(plane.as_ptr(), row);
                    *values = [left, right];
                } else {
                    let right = std::array::from_fn(|i| row[i] + self.right[i] as u32);
                    *values = [gather(s, plane, row), gather(s, plane, &right)];
                }
            }
        }
        let [[a, b], [c, d]] = rows;
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

/// [`Sampler::cross`] for one point.
#[cfg(test)]
pub(super) fn cross_one(plane: &[f32], [h, w]: [usize; 2], [x, y]: [f32; 2]) -> [f32; 5] {
    let axis = |at: f32, n: usize| {
        let at = at.clamp(-2.0, n as f32 + 1.0);
        (at.floor(), at - at.floor())
    };
    let ((x, fx), (y, fy)) = (axis(x, w), axis(y, h));
    let value =
        |x: f32, y: f32| plane[y.clamp(0.0, h as f32 - 1.0) as usize * w + x.clamp(0.0, w as f32 - 1.0) as usize];
    let between = |weight: f32, a: f32, b: f32| weight.mul_add(b - a, a);
    let row = |x: f32, y: f32| between(fx, value(x, y), value(x + 1.0, y));
    [[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]]
        .map(|[dx, dy]| between(fy, row(x + dx, y + dy), row(x + dx, y + dy + 1.0)))
}
