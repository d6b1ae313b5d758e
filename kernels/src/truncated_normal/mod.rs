//! Positions drawn from a truncated normal on [−1+ε, 1−ε], ε = 1e-3 (StreamSplat, ICLR 2026: probabilistic positions).
//!
//! Parameters per element: mean m = tanh(·)(1−ε) and log scale s, σ = eˢ.
//!
//! | function | gives |
//! |---|---|
//! | [`mean`] | m from the layer's output; what inference uses |
//! | [`quantile`] | the value under which the truncated normal has mass u, in binary64 |
//! | [`sample`] | the draw for a given u, with the published implementation's choices |
//! | [`draw`] | the same with u from [`philox`](crate::philox) |
//! | [`reference::published`] | the published formula in binary32, to compare with |
//!
//! # The published formula and this one
//!
//! The published one forms `u' = u·Δ + Φ(a)`, `Δ = Φ(b) − Φ(a)` with a, b = (∓(1−ε) − m)/σ, and then
//! m + σ√2·erf⁻¹(2u′−1). In binary32 Δ keeps no digits where σ is large, and 2u′−1 none where it is near ±1.
//! [`quantile`] computes the same in binary64 and without a difference of near values: with A, B = a/√2, b/√2,
//!
//! - w = (1−u)·erf A + u·erf B, where both tails hold much: m + σ√2·erf⁻¹(w);
//! - q = (1−u)·erfc A + u·erfc B, where the upper tail is small: m + σ√2·erfc⁻¹(q);
//! - p = (1−u)·erfc(−A) + u·erfc(−B), where the lower one is: m − σ√2·erfc⁻¹(p).
//!
//! As A ≤ 0 ≤ B, all sums but that of w are of one sign, and w only cancels where the result is near m. σ → ∞ gives the
//! uniform distribution, σ → 0 the mean.
//!
//! Over the published formula's own range the two differ by its rounding: 1.3e-5 at most over the 60,000 values of the
//! parity table (where σ is large or u near 1).
//!
//! [`sample`] keeps the three choices of the published implementation, because checkpoints were trained with them:
//! u is first clamped to [ε, 1−ε]; where Δ ≤ ε (σ from about 797 on) the value is the lower bound; where s ≤ −5 it is m.
//! [`quantile`] has none of them.
//!
//! Every value is inside the bounds. Nothing here depends on the instruction-set level or on the number of threads.

pub mod reference;

use crate::math::{self, f64 as double};
use crate::philox::Stream;
use crate::simd::{LANES, Operation, Simd, dispatch};
use crate::{Level, parallel};

/// Distance ε of the bounds from ±1.
pub const EPSILON: f32 = 1e-3;
/// The upper bound 1 − ε; the lower one is its negative.
pub const BOUND: f32 = 1.0 - EPSILON;
/// Log scales up to here are taken as no spread at all by [`sample`].
pub const NO_SPREAD: f32 = -5.0;

/// Elements of a task.
const CHUNK: usize = 4096;

/// `out[i]` = tanh(`x[i]`)·(1−ε). NaN gives NaN.
///
/// # Panics
/// When the lengths differ.
pub fn mean(level: Level, x: &[f32], out: &mut [f32]) {
    assert_eq!(x.len(), out.len(), "values and means");
    struct Mean<'a>(&'a [f32], &'a mut [f32]);
    impl Operation for Mean<'_> {
        type Output = ();
        #[inline(always)]
        fn run<S: Simd>(self, s: S) {
            for (x, out) in self.0.chunks(LANES).zip(self.1.chunks_mut(LANES)) {
                let y = s.mul(math::tanh(s, s.load_partial(x, 0.0)), s.splat(BOUND));
                s.store_partial(y, out);
            }
        }
    }
    parallel::for_each_chunk(out, CHUNK, |i, out| dispatch(level, Mean(&x[i * CHUNK..][..out.len()], out)));
}

/// The standardised bounds over √2, and σ√2; nothing where σ leaves no spread or no end.
fn standardised(mean: f64, log_scale: f64) -> Option<(f64, f64, f64)> {
    let scale = double::exp(log_scale) * std::f64::consts::SQRT_2;
    let bound = f64::from(BOUND);
    (scale > 0.0 && scale.is_finite()).then(|| ((-bound - mean) / scale, (bound - mean) / scale, scale))
}

/// The value under which the normal of `mean` and e^`log_scale`, truncated to the bounds, has mass `u`.
///
/// A mean outside the bounds is moved to the nearer one, u to [0, 1]. NaN anywhere gives NaN.
pub fn quantile(mean: f64, log_scale: f64, u: f64) -> f64 {
    if mean.is_nan() || log_scale.is_nan() || u.is_nan() {
        return f64::NAN;
    }
    let bound = f64::from(BOUND);
    let (mean, u) = (mean.clamp(-bound, bound), u.clamp(0.0, 1.0));
    let Some((a, b, scale)) = standardised(mean, log_scale) else {
        // No spread, or all of it.
        return if log_scale < 0.0 { mean } else { (-bound + 2.0 * bound * u).clamp(-bound, bound) };
    };
    let mix = |f: fn(f64) -> f64, sign: f64| (1.0 - u) * f(sign * a) + u * f(sign * b);
    let (upper, lower) = (mix(double::erfc, 1.0), mix(double::erfc, -1.0));
    let z = if upper < 0.5 {
        double::erfcinv(upper)
    } else if lower < 0.5 {
        -double::erfcinv(lower)
    } else {
        double::erfinv(mix(double::erf, 1.0))
    };
    (mean + scale * z).clamp(-bound, bound)
}

/// The mass Δ of the untruncated normal inside the bounds.
fn mass(mean: f64, log_scale: f64) -> f64 {
    match standardised(mean, log_scale) {
        Some((a, b, _)) => 0.5 * (double::erf(b) - double::erf(a)),
        None if log_scale < 0.0 => 1.0,
        None => 0.0,
    }
}

/// The draw for one element.
fn sample_one(mean: f32, log_scale: f32, uniform: f32) -> f32 {
    if mean.is_nan() || log_scale.is_nan() || uniform.is_nan() {
        return f32::NAN;
    }
    let mean = mean.clamp(-BOUND, BOUND);
    if log_scale <= NO_SPREAD {
        return mean;
    }
    let (m, s) = (f64::from(mean), f64::from(log_scale));
    if mass(m, s) <= f64::from(EPSILON) {
        return -BOUND;
    }
    let u = uniform.clamp(EPSILON, BOUND);
    (quantile(m, s, f64::from(u)) as f32).clamp(-BOUND, BOUND)
}

/// `out[i]` = the draw from the truncated normal of `mean[i]` and e^`log_scale[i]` for the uniform number `uniform[i]` in
/// [0, 1), with the choices of the published implementation (see the module).
///
/// Inside the bounds for all parameters, infinite ones too; a mean outside is moved to the nearer bound. An element with
/// a NaN among its three numbers is NaN, for the caller to drop.
///
/// # Panics
/// When the lengths differ.
pub fn sample(mean: &[f32], log_scale: &[f32], uniform: &[f32], out: &mut [f32]) {
    assert_eq!(mean.len(), out.len(), "means");
    assert_eq!(log_scale.len(), out.len(), "log scales");
    assert_eq!(uniform.len(), out.len(), "uniform numbers");
    parallel::for_each_chunk(out, CHUNK, |chunk, out| {
        for (i, x) in out.iter_mut().enumerate() {
            let i = chunk * CHUNK + i;
            *x = sample_one(mean[i], log_scale[i], uniform[i]);
        }
    });
}

/// [`sample`] with the uniform numbers of `stream`: that of element `i` for `out[i]`.
///
/// # Panics
/// When the lengths differ.
pub fn draw(stream: Stream, mean: &[f32], log_scale: &[f32], out: &mut [f32]) {
    assert_eq!(mean.len(), out.len(), "means");
    assert_eq!(log_scale.len(), out.len(), "log scales");
    parallel::for_each_chunk(out, CHUNK, |chunk, out| {
        for (i, x) in out.iter_mut().enumerate() {
            let i = chunk * CHUNK + i;
            *x = sample_one(mean[i], log_scale[i], stream.uniform(i as u64));
        }
    });
}

#[cfg(test)]
mod tests;
