//! Conversion of linear colours to sRGB.

use streamsplat_kernels::harmonics::Y0;
use streamsplat_kernels::math::f64::{exp, ln};

use crate::still::Still;

/// Slope of the encoding near black.
const STEEPEST: f64 = 12.92;

/// Converts a colour of sRGB to linear light, both from 0 to 1.
pub(super) fn linear_of_srgb(c: f64) -> f64 {
    if c <= 0.040_45 { c / STEEPEST } else { exp(2.4 * ln((c + 0.055) / 1.055)) }
}

/// Converts linear light, which is 0 or more, to sRGB.
pub(super) fn srgb_of_linear(c: f64) -> f64 {
    if c <= 0.003_130_8 { c * STEEPEST } else { 1.055 * exp(ln(c) / 2.4) - 0.055 }
}

/// Returns the slope of [`srgb_of_linear`].
fn slope(c: f64) -> f64 {
    if c <= 0.003_130_8 { STEEPEST } else { 1.055 / 2.4 * exp(ln(c) * (1.0 / 2.4 - 1.0)) }
}

/// Returns the first coefficient of a colour, which is converted to sRGB first if `encode`.
pub(super) fn coefficient(c: f64, encode: bool) -> f32 {
    let seen = if encode { srgb_of_linear(c.max(0.0)) } else { c };
    ((seen - 0.5) / Y0) as f32
}

/// Converts harmonics of linear colours to sRGB: the first coefficients exactly, the others by the slope at the first.
pub(super) fn to_srgb(still: &mut Still) {
    let width = 3 * still.rest();
    for (i, base) in still.base.iter_mut().enumerate() {
        for (channel, first) in base.iter_mut().enumerate() {
            let seen = (0.5 + f64::from(*first) * Y0).max(0.0);
            *first = coefficient(seen, true);
            let slope = slope(seen);
            for c in still.higher[i * width..(i + 1) * width].iter_mut().skip(channel).step_by(3) {
                *c = (f64::from(*c) * slope) as f32;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_encoding_is_srgbs_and_the_way_back() {
        for (linear, srgb) in [(0.0, 0.0), (0.002, 0.025_84), (0.214_041, 0.5), (0.5, 0.735_357), (1.0, 1.0)] {
            assert!((srgb_of_linear(linear) - srgb).abs() < 1e-5, "{linear}");
            assert!((linear_of_srgb(srgb) - linear).abs() < 1e-5, "{srgb}");
            let step = 1e-6;
            let measured = (srgb_of_linear(linear + step) - srgb_of_linear(linear)) / step;
            assert!((slope(linear) - measured).abs() < 1e-3 * measured, "{linear}");
        }
    }
}
