//! Gaussians in time: position and opacity at any instant of an interval.
//!
//! With τ = t − t₀ the time since the Gaussian's own frame, in units of the pair's interval (the frame before has τ ≥ 0,
//! the frame after τ ≤ 0):
//!
//! ```text
//! position(τ) = position + velocity · τ
//! opacity(τ)  = opacity · σ(−γ₀(|τ| − γ₁)) / σ(γ₀ γ₁)
//! ```
//!
//! The quotient is evaluated as `(1 + e^{−a}) / (1 + e^{x})` with `a = γ₀·γ₁` and `x = γ₀·(|τ| − γ₁)`. Nothing overflows:
//! `−a ≤ 0`, and where `x > 87` the quotient, below 2e−38, is zero. At τ = 0, `x = −a` exactly (rounding is symmetric), so
//! the quotient is exactly 1 and opacity is the static one. Every step is monotone in |τ| under rounding, so the whole is.
//!
//! StreamSplat (ICLR 2026), deformation field.

use streamsplat_kernels::Level;

use crate::scalar::exp;

/// Where x is larger, the opacity's factor is under 2e−38: zero.
const VANISHED: f32 = 87.0;

/// Positions `τ` after (or, negative, before) the Gaussians' own frame: `out[i] = position[i] + velocity[i]·τ`.
///
/// One multiplication and one addition, each rounded.
///
/// # Panics
/// When the three slices differ in length.
pub fn position_at(position: &[[f32; 3]], velocity: &[[f32; 3]], tau: f32, out: &mut [[f32; 3]]) {
    assert!(
        position.len() == velocity.len() && position.len() == out.len(),
        "one velocity and one result per position"
    );
    for ((p, v), o) in position.iter().zip(velocity).zip(out) {
        *o = std::array::from_fn(|axis| p[axis] + v[axis] * tau);
    }
}

/// The factor that takes a static opacity to the one at `τ`: in [0, 1], 1 at τ = 0, falling with |τ|.
///
/// Preconditions: γ₀ ≥ 0 and γ₁ in [0, 1], both finite; τ finite.
pub fn opacity_factor([gamma0, gamma1]: [f32; 2], tau: f32) -> f32 {
    let x = gamma0 * (tau.abs() - gamma1);
    if x > VANISHED {
        return 0.0;
    }
    let a = gamma0 * gamma1;
    ((1.0 + exp(-f64::from(a))) / (1.0 + exp(f64::from(x)))) as f32
}

/// Opacities at `τ`: `out[i] = opacity[i] · opacity_factor(gamma[i], τ)`.
///
/// # Panics
/// When the three slices differ in length.
pub fn opacity_at(level: Level, opacity: &[f32], gamma: &[[f32; 2]], tau: f32, out: &mut [f32]) {
    assert!(opacity.len() == gamma.len() && opacity.len() == out.len(), "one γ and one result per opacity");
    // Scalar binary64: the same on every level.
    let _ = level;
    for ((o, g), out) in opacity.iter().zip(gamma).zip(out) {
        *out = o * opacity_factor(*g, tau);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn opacity_is_static_at_its_own_frame() {
        for gamma0 in [0.0, 1e-30, 0.3, 1.0, 17.3, 86.9, 87.1, 1e3, 1e6, 1e30, f32::MAX] {
            for gamma1 in [0.0, 1e-30, 0.1, 0.49, 0.5, 0.99, 1.0] {
                assert_eq!(opacity_factor([gamma0, gamma1], 0.0), 1.0, "γ = ({gamma0}, {gamma1})");
                assert_eq!(opacity_factor([gamma0, gamma1], -0.0), 1.0, "γ = ({gamma0}, {gamma1})");
            }
        }
    }

    #[test]
    fn opacity_falls_with_distance_in_time_and_stays_in_range() {
        for gamma0 in [0.0, 1e-30, 0.3, 1.0, 17.3, 86.9, 87.1, 1e3, 1e6, 1e30, f32::MAX] {
            for gamma1 in [0.0, 1e-30, 0.1, 0.49, 0.5, 0.99, 1.0] {
                let mut last = 1.0;
                for step in 0..=4000 {
                    let tau = step as f32 / 4000.0;
                    let factor = opacity_factor([gamma0, gamma1], tau);
                    assert!(
                        (0.0..=last).contains(&factor),
                        "γ = ({gamma0}, {gamma1}), τ = {tau}: {factor} after {last}"
                    );
                    assert_eq!(factor.to_bits(), opacity_factor([gamma0, gamma1], -tau).to_bits());
                    last = factor;
                }
            }
        }
    }

    #[test]
    fn a_stiff_opacity_is_a_step() {
        assert_eq!(opacity_factor([1e6, 0.5], 0.499), 1.0);
        assert_eq!(opacity_factor([1e6, 0.5], 0.5), 0.5);
        assert_eq!(opacity_factor([1e6, 0.5], 0.501), 0.0);
        assert_eq!(opacity_factor([1e6, 0.0], 1e-3), 0.0);
        assert_eq!(opacity_factor([1e6, 1.0], 1.0), 0.5);
    }

    #[test]
    fn opacity_follows_its_formula() {
        let sigma = |x: f64| 1.0 / (1.0 + (-x).exp());
        for gamma0 in [0.0f32, 0.3, 1.0, 5.0, 40.0] {
            for gamma1 in [0.0f32, 0.2, 0.7, 1.0] {
                for tau in [-1.0f32, -0.3, 0.1, 0.5, 1.0] {
                    let (g0, g1, t) = (f64::from(gamma0), f64::from(gamma1), f64::from(tau));
                    let expected = sigma(-g0 * (t.abs() - g1)) / sigma(g0 * g1);
                    let found = f64::from(opacity_factor([gamma0, gamma1], tau));
                    assert!((found - expected).abs() <= 1e-5 * expected, "{found} {expected}");
                }
            }
        }
    }

    #[test]
    fn position_moves_on_a_line() {
        let mut out = [[0.0; 3]; 2];
        position_at(&[[0.0, 0.5, 1.0], [1.0; 3]], &[[1.0, 0.0, -1.0], [0.0; 3]], 0.25, &mut out);
        assert_eq!(out, [[0.25, 0.5, 0.75], [1.0; 3]]);
    }
}
