//! Gaussians in time: position and opacity at any instant of an interval.
//!
//! With τ = t − t₀ the time since the Gaussian's own frame, in units of the pair's interval (the frame before has τ ≥
//! 0, the frame after τ ≤ 0):
//!
//! ```text
//! position(τ) = position + velocity · τ
//! opacity(τ)  = opacity · σ(−γ₀(|τ| − γ₁)) / σ(γ₀ γ₁)
//! ```
//!
//! The quotient is evaluated as `(1 + e^{−a}) / (1 + e^{x})` with `a = γ₀·γ₁` and `x = γ₀·(|τ| − γ₁)`. Nothing
//! overflows: `−a ≤ 0`, and where `x > 87` the quotient, below 2e−38, is zero. At τ = 0, `x = −a` exactly (rounding is
//! symmetric), so the quotient is exactly 1 and opacity is the static one. Sums and quotients are monotone under
//! rounding, so the result falls with |τ| wherever the exponential rises.
//!
//! StreamSplat (ICLR 2026), deformation field.

use streamsplat_kernels::Level;
use streamsplat_kernels::math;
use streamsplat_kernels::parallel::for_each_chunk;
use streamsplat_kernels::simd::{LANES, Operation, Simd, dispatch};

/// Where x is larger, the opacity's factor is under 2e−38 and set to zero.
const VANISHED: f32 = 87.0;

/// Gaussians of a task.
const TASK: usize = 1 << 12;

/// Positions at time `τ` from the Gaussians' own frame (negative: before it): `out[i] = position[i] + velocity[i]·τ`.
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
/// Preconditions: γ₀ ≥ 0 and γ₁ in [0, 1], both finite; τ finite. For other values the result is some factor in [0, 1],
/// or NaN.
pub fn opacity_factor([gamma0, gamma1]: [f32; 2], tau: f32) -> f32 {
    let x = gamma0 * (tau.abs() - gamma1);
    let fading = 1.0 + math::scalar::exp(if x < VANISHED { x } else { VANISHED });
    let factor = (1.0 + math::scalar::exp(-(gamma0 * gamma1))) / fading;
    let factor = if factor < 1.0 { factor } else { 1.0 };
    if VANISHED < x { 0.0 } else { factor }
}

/// [`opacity_factor`] on 16 Gaussians.
#[inline(always)]
fn factor<S: Simd>(s: S, gamma0: S::F32, gamma1: S::F32, tau: f32) -> S::F32 {
    let (one, vanished) = (s.splat(1.0), s.splat(VANISHED));
    let x = s.mul(gamma0, s.sub(s.splat(tau.abs()), gamma1));
    let fading = s.add(one, math::exp(s, s.min(x, vanished)));
    let whole = s.add(one, math::exp(s, s.neg(s.mul(gamma0, gamma1))));
    // One ulp of the exponential may take the quotient above 1 near τ = 0.
    let factor = s.min(s.div(whole, fading), one);
    s.select(s.lt(vanished, x), s.splat(0.0), factor)
}

/// Opacities at `τ`: `out[i] = opacity[i] · opacity_factor(gamma[i], τ)`.
///
/// # Panics
/// When the three slices differ in length.
pub fn opacity_at(level: Level, opacity: &[f32], gamma: &[[f32; 2]], tau: f32, out: &mut [f32]) {
    assert!(opacity.len() == gamma.len() && opacity.len() == out.len(), "one γ and one result per opacity");
    for_each_chunk(out, TASK, |chunk, out| {
        let part = chunk * TASK..chunk * TASK + out.len();
        dispatch(level, OpacityAt { opacity: &opacity[part.clone()], gamma: &gamma[part], tau, out });
    });
}

struct OpacityAt<'a> {
    opacity: &'a [f32],
    gamma: &'a [[f32; 2]],
    tau: f32,
    out: &'a mut [f32],
}

impl Operation for OpacityAt<'_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let chunks = self.opacity.chunks(LANES).zip(self.gamma.chunks(LANES)).zip(self.out.chunks_mut(LANES));
        for ((opacity, gamma), out) in chunks {
            let mut lanes = [[0.0; LANES]; 2];
            for (i, [gamma0, gamma1]) in gamma.iter().enumerate() {
                (lanes[0][i], lanes[1][i]) = (*gamma0, *gamma1);
            }
            let factor = factor(s, s.from_array(lanes[0]), s.from_array(lanes[1]), self.tau);
            s.store_partial(s.mul(s.load_partial(opacity, 0.0), factor), out);
        }
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
    fn slices_give_the_bits_of_single_values_on_every_level() {
        let gamma: Vec<[f32; 2]> = (0..4 * TASK + 37)
            .map(|i| [(i % 97) as f32 * 1.7_f32.powi((i % 23) as i32 - 3), (i % 31) as f32 / 30.0])
            .collect();
        let opacity: Vec<f32> = (0..gamma.len()).map(|i| 0.05 + 0.95 * (i % 101) as f32 / 100.0).collect();
        for tau in [-1.0, -0.7, 0.0, 1e-6, 0.25, 0.5, 1.0] {
            let expected: Vec<u32> =
                opacity.iter().zip(&gamma).map(|(o, g)| (o * opacity_factor(*g, tau)).to_bits()).collect();
            for level in Level::available() {
                let mut out = vec![0.0; gamma.len()];
                opacity_at(level, &opacity, &gamma, tau, &mut out);
                let found: Vec<u32> = out.iter().map(|x| x.to_bits()).collect();
                assert!(found == expected, "{level}, τ = {tau}");
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
