//! Positions drawn from a truncated normal on [−1+ε, 1−ε], ε = 1e-3 (StreamSplat, ICLR 2026: probabilistic positions).
//!
//! Parameters per element: mean m = tanh(·)(1−ε) and log scale s, σ = eˢ.
//!
//! | function | returns |
//! |---|---|
//! | [`mean`] | m from the layer's output; used in inference |
//! | [`quantile`] | the value under which the truncated normal has mass u, in binary64 |
//! | [`sample`] | the draw for this u, with the published implementation's choices |
//! | [`draw`] | the same with u from [`philox`](crate::philox) |
//! | [`reference::published`] | the published formula in binary32, to compare with |
//!
//! # The published formula and this one
//!
//! The published formula computes `u' = u·Δ + Φ(a)`, `Δ = Φ(b) − Φ(a)` with a, b = (∓(1−ε) − m)/σ, and then m +
//! σ√2·erf⁻¹(2u′−1). In binary32 Δ keeps no digits where σ is large, and 2u′−1 none where it is near ±1. [`quantile`]
//! computes the same in binary64 and without a difference of near values: with A, B = a/√2, b/√2, from
//!
//! - w = (1−u)·erf A + u·erf B, where |w| ≤ ¾: m + σ√2·erf⁻¹(w);
//! - q = (1−u)·erfc A + u·erfc B, where w > ¾, the upper tail: m + σ√2·erfc⁻¹(q);
//! - p = (1−u)·erfc(−A) + u·erfc(−B), where w < −¾, the lower tail: m − σ√2·erfc⁻¹(p).
//!
//! As A ≤ 0 ≤ B, the sums of the tails are of one sign, and w only cancels where the result is near m. The limit for σ
//! → ∞ is the uniform distribution, for σ → 0 the mean.
//!
//! Over the published formula's own range the two differ by its rounding: 1.3e-5 at most over the 60,000 values of the
//! parity table (where σ is large or u near 1).
//!
//! [`sample`] keeps the three choices of the published implementation, because checkpoints were trained with them.
//! First, u is clamped to [ε, 1−ε]. Second, where Δ ≤ ε (σ from about 797 on), the value is the lower bound. Third,
//! where s ≤ −5, the value is m. [`quantile`] has none of them.
//!
//! Every value is inside the bounds. Nothing here depends on the instruction-set level or on the number of threads.

pub mod reference;

use tracing::debug_span;

use crate::math::{self, f64 as double};
use crate::philox::Stream;
use crate::simd::{LANES, Operation, Simd, dispatch};
use crate::{Level, parallel};

/// Distance ε of the bounds from ±1.
pub const EPSILON: f32 = 1e-3;
/// The upper bound 1 − ε; the lower one is its negative.
pub const BOUND: f32 = 1.0 - EPSILON;
/// [`sample`] treats log scales up to this as no spread.
pub const NO_SPREAD: f32 = -5.0;

/// Elements of a task.
const CHUNK: usize = 4096;

/// `out[i]` = tanh(`x[i]`)·(1−ε). NaN returns NaN.
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
    let _span = debug_span!("truncated_normal", kind = "mean", values = x.len()).entered();
    parallel::for_each_chunk(out, CHUNK, |i, out| dispatch(level, Mean(&x[i * CHUNK..][..out.len()], out)));
}

/// A normal and its bounds, in units of √2·σ.
struct Normal {
    mean: f64,
    /// σ√2.
    scale: f64,
    /// The bounds A ≤ 0 ≤ B.
    ends: [f64; 2],
    /// erf A and erf B.
    erf: [f64; 2],
}

impl Normal {
    /// Nothing where σ is 0 or infinite in binary64. `mean` is inside the bounds.
    fn new(mean: f64, log_scale: f64) -> Option<Self> {
        let scale = double::exp(log_scale) * std::f64::consts::SQRT_2;
        let ends = [-f64::from(BOUND), f64::from(BOUND)].map(|bound| (bound - mean) / scale);
        (scale > 0.0 && scale.is_finite()).then(|| Self { mean, scale, ends, erf: ends.map(double::erf) })
    }

    /// The mass Δ inside the bounds.
    fn mass(&self) -> f64 {
        0.5 * (self.erf[1] - self.erf[0])
    }

    /// The value under which the truncated normal has mass `u`.
    fn quantile(&self, u: f64) -> f64 {
        let mix = |a: f64, b: f64| (1.0 - u) * a + u * b;
        let w = mix(self.erf[0], self.erf[1]);
        let z = if w > 0.75 {
            double::erfcinv(mix(1.0 - self.erf[0], double::erfc(self.ends[1])))
        } else if w < -0.75 {
            -double::erfcinv(mix(double::erfc(-self.ends[0]), 1.0 + self.erf[1]))
        } else {
            double::erfinv(w)
        };
        let bound = f64::from(BOUND);
        (self.mean + self.scale * z).clamp(-bound, bound)
    }
}

/// Returns the value under which the normal of `mean` and e^`log_scale`, truncated to the bounds, has mass `u`.
///
/// A mean outside the bounds is moved to the nearer one, u to [0, 1]. NaN in any argument returns NaN.
pub fn quantile(mean: f64, log_scale: f64, u: f64) -> f64 {
    if mean.is_nan() || log_scale.is_nan() || u.is_nan() {
        return f64::NAN;
    }
    let bound = f64::from(BOUND);
    let (mean, u) = (mean.clamp(-bound, bound), u.clamp(0.0, 1.0));
    match Normal::new(mean, log_scale) {
        Some(normal) => normal.quantile(u),
        // No spread, or an infinite one.
        None if log_scale < 0.0 => mean,
        None => (-bound + 2.0 * bound * u).clamp(-bound, bound),
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
    match Normal::new(f64::from(mean), f64::from(log_scale)) {
        Some(normal) if normal.mass() > f64::from(EPSILON) => {
            let u = uniform.clamp(EPSILON, BOUND);
            (normal.quantile(f64::from(u)) as f32).clamp(-BOUND, BOUND)
        }
        _ => -BOUND,
    }
}

/// `out[i]` = the draw from the truncated normal of `mean[i]` and e^`log_scale[i]` for the uniform number `uniform[i]`
/// in [0, 1), with the choices of the published implementation (see the module).
///
/// Inside the bounds for all parameters, infinite ones too; a mean outside is moved to the nearer bound. An element
/// with a NaN among its three numbers is NaN, for the caller to drop.
///
/// # Panics
/// When the lengths differ.
pub fn sample(mean: &[f32], log_scale: &[f32], uniform: &[f32], out: &mut [f32]) {
    assert_eq!(mean.len(), out.len(), "means");
    assert_eq!(log_scale.len(), out.len(), "log scales");
    assert_eq!(uniform.len(), out.len(), "uniform numbers");
    let _span = debug_span!("truncated_normal", kind = "sample", values = out.len()).entered();
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
    let _span = debug_span!("truncated_normal", kind = "draw", values = out.len()).entered();
    parallel::for_each_chunk(out, CHUNK, |chunk, out| {
        for (i, x) in out.iter_mut().enumerate() {
            let i = chunk * CHUNK + i;
            *x = sample_one(mean[i], log_scale[i], stream.uniform(i as u64));
        }
    });
}

#[cfg(test)]
mod tests;
