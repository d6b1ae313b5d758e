//! The published formula, in binary32 as published, and the exact distribution.

use super::{BOUND, EPSILON, NO_SPREAD, Normal};
use crate::math::{f64 as double, scalar};

/// The published implementation's draw: [`super::sample`] with all of its rounding.
pub fn published(mean: f32, log_scale: f32, uniform: f32) -> f32 {
    let scale = scalar::exp(log_scale);
    let cdf = |x: f32| 0.5 * (1.0 + scalar::erf(x / std::f32::consts::SQRT_2));
    let low = cdf((-BOUND - mean) / scale);
    let mass = cdf((BOUND - mean) / scale) - low;
    let u = uniform.clamp(EPSILON, BOUND) * mass + low;
    if log_scale <= NO_SPREAD {
        mean.clamp(-BOUND, BOUND)
    } else if mass <= EPSILON {
        -BOUND
    } else {
        mean + scale * std::f32::consts::SQRT_2 * scalar::erfinv(2.0 * u - 1.0)
    }
}

/// The mass of the truncated normal under `x`: the inverse of [`super::quantile`]. Preconditions: `mean` inside the
/// bounds, e^`log_scale` neither 0 nor infinite.
pub fn distribution(mean: f64, log_scale: f64, x: f64) -> f64 {
    let Some(Normal { scale, ends: [a, _], erf: [erf_a, erf_b], .. }) = Normal::new(mean, log_scale) else {
        return f64::NAN;
    };
    let z = (x - mean) / scale;
    let below = if z > -0.4 {
        double::erf(z) - erf_a
    } else {
        // In the tail neither is a difference from 1.
        double::erfc(-z) - double::erfc(-a)
    };
    below / (erf_b - erf_a)
}
