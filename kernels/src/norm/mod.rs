//! Normalisation of rows.
//!
//! - RMS: `out = x · r · w`, `r = 1/√(mean(x²) + ε)`
//! - layer: `out = (x − μ) · r · w + b`, `μ = mean(x)`, `r = 1/√(mean((x − μ)²) + ε)`
//!
//! Rows are independent. A sum over a row has 16 lanes. Lane `i mod 16` takes its elements in ascending order: squares
//! by fused multiply-add, the mean's terms by addition, the last part of a row filled with zeros. Then [`Simd::sum`]
//! folds the lanes. `x·r` and its product with `w` are rounded separately; `b` is added by fused multiply-add.
//!
//! A row whose largest magnitude is above 2⁴⁸ is scaled by 2⁻⁹⁶ before its squares are taken (and ε by 2⁻¹⁹², which is
//! 0): no square overflows below the largest finite number. Small rows need no scaling: ε outweighs their squares. A
//! NaN or an infinity in a row makes only that row's results NaN.
//!
//! Source: "StreamSplat (ICLR 2026)", encoder and decoder blocks (RMS, ε = 1e-5); DINOv2 (layer, ε = 1e-6).

pub mod reference;
#[cfg(test)]
mod tests;

use tracing::debug_span;

use crate::Level;
use crate::parallel::for_each_chunk;
use crate::simd::{LANES, Operation, Simd, dispatch, larger, largest};

/// Magnitudes above this are scaled before they are squared.
const LARGE: f32 = (1_u64 << 48) as f32;
/// The scale of large rows: 2⁻⁹⁶.
const SCALE: f32 = 1.0 / ((1_u128 << 96) as f32);

/// Values of a task.
const TASK: usize = 1 << 14;

/// `out = x / √(mean(x²) + ε) · w` for every row of `x [rows, w.len()]`. See [the module](self).
///
/// # Panics
/// When `x` is not a whole number of rows or `out` has another size.
pub fn rms_norm(level: Level, x: &[f32], w: &[f32], epsilon: f32, out: &mut [f32]) {
    rows(level, x, out, Norm::rms(w, epsilon));
}

/// `out = (x − mean(x)) / √(variance + ε) · w + b` for every row of `x [rows, w.len()]`. See [the module](self).
///
/// # Panics
/// When `x` is not a whole number of rows, or `b` or `out` have another size.
pub fn layer_norm(level: Level, x: &[f32], w: &[f32], b: &[f32], epsilon: f32, out: &mut [f32]) {
    rows(level, x, out, Norm::layer(w, b, epsilon));
}

pub(crate) fn rows(level: Level, x: &[f32], out: &mut [f32], norm: Norm<'_>) {
    let d = norm.width();
    assert_eq!(x.len(), out.len(), "input holds {} values, output {}", x.len(), out.len());
    assert!(x.len().is_multiple_of(d), "{} values in rows of {d}", x.len());
    if d == 0 {
        return;
    }
    let kind = if norm.b.is_some() { "layer" } else { "rms" };
    let _span = debug_span!("norm", kind, rows = x.len() / d, width = d).entered();
    let chunk = (TASK / d).max(1) * d;
    for_each_chunk(out, chunk, |i, out| {
        let x = &x[i * chunk..][..out.len()];
        dispatch(level, Task { norm, x, out });
    });
}

struct Task<'a> {
    norm: Norm<'a>,
    x: &'a [f32],
    out: &'a mut [f32],
}

impl Operation for Task<'_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let d = self.norm.width();
        for (x, out) in self.x.chunks_exact(d).zip(self.out.chunks_exact_mut(d)) {
            self.norm.apply(s, x, out);
        }
    }
}

/// The normalisation of a row.
#[derive(Clone, Copy, Debug)]
pub struct Norm<'a> {
    w: &'a [f32],
    b: Option<&'a [f32]>,
    epsilon: f32,
}

impl<'a> Norm<'a> {
    /// The norm of [`rms_norm`].
    pub const fn rms(w: &'a [f32], epsilon: f32) -> Self {
        Self { w, b: None, epsilon }
    }

    /// The norm of [`layer_norm`].
    ///
    /// # Panics
    /// When there are more or fewer biases than weights.
    pub fn layer(w: &'a [f32], b: &'a [f32], epsilon: f32) -> Self {
        assert_eq!(w.len(), b.len(), "{} weights but {} biases", w.len(), b.len());
        Self { w, b: Some(b), epsilon }
    }

    /// Values of a row.
    pub const fn width(&self) -> usize {
        self.w.len()
    }

    #[inline(always)]
    pub(crate) fn apply<S: Simd>(&self, s: S, x: &[f32], out: &mut [f32]) {
        self.write::<S, false>(s, x, out);
    }

    /// [`Norm::apply`]; returns the largest magnitude of the result, infinite where a value is not finite.
    #[inline(always)]
    pub(crate) fn apply_largest<S: Simd>(&self, s: S, x: &[f32], out: &mut [f32]) -> f32 {
        let most = self.write::<S, true>(s, x, out);
        largest(s, most)
    }

    /// Writes the result; returns the largest of its magnitudes in each lane if requested.
    #[inline(always)]
    fn write<S: Simd, const LARGEST: bool>(&self, s: S, x: &[f32], out: &mut [f32]) -> S::I32 {
        let n = x.len() as f32;
        let whole = x.len() / LANES * LANES;
        let (mut most, mut squares) = (s.splat(0.0), s.splat(0.0));
        for x in x[..whole].chunks_exact(LANES) {
            let x = s.load(x);
            most = s.max(s.abs(x), most);
            squares = s.mul_add(x, x, squares);
        }
        if whole < x.len() {
            let x = s.load_partial(&x[whole..], 0.0);
            most = s.max(s.abs(x), most);
            squares = s.mul_add(x, x, squares);
        }
        let large = s.max_lane(most) > LARGE;
        if self.b.is_some() || large {
            return self.write_any::<S, LARGEST>(s, x, large, out);
        }
        // An RMS norm has no mean, and these rows have the scale 1.
        let r = s.splat(1.0 / (s.sum(squares) / n + self.epsilon).sqrt());
        let mut most = s.splat_i32(0);
        for ((x, w), out) in x.chunks(LANES).zip(self.w.chunks(LANES)).zip(out.chunks_mut(LANES)) {
            let y = s.mul(s.mul(s.load_partial(x, 0.0), r), s.load_partial(w, 0.0));
            if LARGEST {
                most = larger(s, most, y);
            }
            s.store_partial(y, out);
        }
        most
    }

    /// [`Norm::write`] of layer norms and of large rows.
    #[inline(always)]
    fn write_any<S: Simd, const LARGEST: bool>(&self, s: S, x: &[f32], large: bool, out: &mut [f32]) -> S::I32 {
        let n = x.len() as f32;
        let (scale, epsilon) = if large { (SCALE, 0.0) } else { (1.0, self.epsilon) };
        let scale = s.splat(scale);
        let load = |x: &[f32], fill: f32| s.mul(s.load_partial(x, fill), scale);

        let mean = if self.b.is_some() {
            let mut sum = s.splat(0.0);
            for x in x.chunks(LANES) {
                sum = s.add(sum, load(x, 0.0));
            }
            s.sum(sum) / n
        } else {
            0.0
        };
        let mu = s.splat(mean);
        let mut squares = s.splat(0.0);
        let whole = x.len() / LANES * LANES;
        for x in x[..whole].chunks_exact(LANES) {
            let y = s.sub(load(x, 0.0), mu);
            squares = s.mul_add(y, y, squares);
        }
        if whole < x.len() {
            let there = s.mask_from_bits((1 << (x.len() - whole)) - 1);
            let y = s.select(there, s.sub(load(&x[whole..], 0.0), mu), s.splat(0.0));
            squares = s.mul_add(y, y, squares);
        }
        let r = s.splat(1.0 / (s.sum(squares) / n + epsilon).sqrt());
        let mut most = s.splat_i32(0);
        for (i, out) in out.chunks_mut(LANES).enumerate() {
            let at = i * LANES..(i * LANES + LANES).min(x.len());
            let y = s.mul(s.sub(load(&x[at.clone()], 0.0), mu), r);
            let w = s.load_partial(&self.w[at.clone()], 0.0);
            let y = match self.b {
                Some(b) => s.mul_add(y, w, s.load_partial(&b[at], 0.0)),
                None => s.mul(y, w),
            };
            if LARGEST {
                most = larger(s, most, y);
            }
            s.store_partial(y, out);
        }
        most
    }
}
