//! The weight of a key: `2^t` for `t ≤ 0`, the innermost function of attention.

use crate::math;
use crate::simd::{SHIFTER, Simd};

/// Weights are never below `2^LOWEST`. This is too little to count, but enough that products with values are not
/// denormal, which some CPUs compute far more slowly.
const LOWEST: f32 = -64.0;

/// The largest `t`. The rounding error of `s·c − M` exceeds it only where logits pass 2²⁴.
const HIGHEST: f32 = 1.0;

/// `(2^f − 1)/f` on [−½, ½], minimax in the relative error of `2^f` (2.2e-8), lowest power first.
pub(super) const COEFFICIENTS: [f32; 6] =
    [0.693_147_24, 0.240_226_52, 0.055_503_104, 0.009_617_693, 0.001_340_664_3, 0.000_155_946_78];

/// `2^t` for `−64 ≤ t ≤ 1`, within 1.5 ulp; `2^−64` below, and for NaN; 2 above.
#[inline(always)]
pub(super) fn weight<S: Simd>(s: S, t: S::F32) -> S::F32 {
    // NaN compares false and becomes the second operand.
    let t = s.min(s.max(t, s.splat(LOWEST)), s.splat(HIGHEST));
    let (whole, part) = s.split_int_frac(t);
    let mut p = s.splat(COEFFICIENTS[5]);
    for i in (0..5).rev() {
        p = s.mul_add(p, part, s.splat(COEFFICIENTS[i]));
    }
    s.scale_by_pow2(s.mul_add(p, part, s.splat(1.0)), whole)
}

/// Weights of the lower precisions are never below `2^LOWEST_LOW`: there their products with values are far from the
/// denormal numbers.
const LOWEST_LOW: f32 = -56.0;

/// `2^t` for `−56 ≤ t ≤ 1`, rounded to bf16 (to nearest, ties up): within 0.52 of its last place; `2^−56` below, and
/// for NaN; 2 above.
#[inline(always)]
pub(super) fn weight_low<S: Simd>(s: S, t: S::F32) -> S::F32 {
    let w = s.to_bits(math::exp2_low(s, s.min(s.max(t, s.splat(LOWEST_LOW)), s.splat(HIGHEST))));
    let rounded = s.add_i32(w, s.splat_i32(0x8000));
    s.from_bits(s.and_i32(rounded, s.splat_i32(0xffff_0000_u32.cast_signed())))
}

/// Offset that [`numbered`] adds to a number: the bits of [`SHIFTER`].
pub(super) const NUMBERED: i32 = SHIFTER.to_bits().cast_signed();

/// `255·2^t` for `t ≤ 0`, to the nearest integer (of a value within 7.5e-5; ties to even), [`NUMBERED`] added; 0 for
/// values below ½, and for NaN.
#[inline(always)]
pub(super) fn numbered<S: Simd>(s: S, t: S::F32) -> S::I32 {
    let w = math::exp2_low(s, s.max(t, s.splat(-20.0)));
    s.to_bits(s.mul_add(w, s.splat(255.0), s.splat(SHIFTER)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Level;
    use crate::simd::{LANES, Operation, dispatch};

    struct Weights([f32; LANES]);
    impl Operation for Weights {
        type Output = [f32; LANES];
        #[inline(always)]
        fn run<S: Simd>(self, s: S) -> [f32; LANES] {
            s.to_array(weight(s, s.from_array(self.0)))
        }
    }

    #[test]
    fn weights_are_powers_of_two_on_every_level() {
        for level in crate::testing::levels() {
            let mut worst = 0.0_f64;
            for i in 0..200_000 {
                let t: [f32; LANES] = std::array::from_fn(|j| -((i * 16 + j) as f32) * (64.0 / 3_200_000.0));
                let w = dispatch(level, Weights(t));
                assert_eq!(w, dispatch(Level::scalar(), Weights(t)));
                for j in 0..LANES {
                    worst = worst.max((f64::from(w[j]) / f64::from(t[j]).exp2() - 1.0).abs());
                }
            }
            assert!(worst < 1.5 * f64::from(f32::EPSILON), "{worst:e}");
        }
    }

    struct LowWeights([f32; LANES]);
    impl Operation for LowWeights {
        type Output = [f32; LANES];
        #[inline(always)]
        fn run<S: Simd>(self, s: S) -> [f32; LANES] {
            s.to_array(weight_low(s, s.from_array(self.0)))
        }
    }

    #[test]
    fn low_weights_are_the_nearest_bf16_on_every_level() {
        for level in crate::testing::levels() {
            for i in 0..20_000 {
                let t: [f32; LANES] = std::array::from_fn(|j| -((i * 16 + j) as f32) * (56.0 / 320_000.0));
                let w = dispatch(level, LowWeights(t));
                assert_eq!(w, dispatch(Level::scalar(), LowWeights(t)));
                for j in 0..LANES {
                    let exact = f64::from(t[j]).exp2();
                    // Half a last place of 8 bits, and the error of the short polynomial.
                    assert!((f64::from(w[j]) / exact - 1.0).abs() < 1.05 / 256.0, "2^{}: {}", t[j], w[j]);
                    assert_eq!(w[j].to_bits() & 0xffff, 0, "2^{} is no bf16", t[j]);
                }
            }
            let mut t = [f32::NEG_INFINITY; LANES];
            (t[0], t[1], t[2]) = (0.0, f32::NAN, -1e30);
            let least = f32::from_bits((127 - 56) << 23);
            assert_eq!(dispatch(level, LowWeights(t))[..4], [1.0, least, least, least]);
        }
    }

    struct Numbers([f32; LANES]);
    impl Operation for Numbers {
        type Output = [i32; LANES];
        #[inline(always)]
        fn run<S: Simd>(self, s: S) -> [i32; LANES] {
            s.to_array_i32(numbered(s, s.from_array(self.0)))
        }
    }

    #[test]
    fn numbers_are_the_nearest_to_255_powers_of_two_on_every_level() {
        for level in crate::testing::levels() {
            for i in 0..20_000 {
                let t: [f32; LANES] = std::array::from_fn(|j| -((i * 16 + j) as f32) * (24.0 / 320_000.0));
                let n = dispatch(level, Numbers(t)).map(|n| n - NUMBERED);
                assert_eq!(n, dispatch(Level::scalar(), Numbers(t)).map(|n| n - NUMBERED));
                for j in 0..LANES {
                    let exact = 255.0 * f64::from(t[j]).exp2();
                    assert!((f64::from(n[j]) - exact).abs() < 0.5 + exact * 7.5e-5 + 1e-6, "2^{}: {}", t[j], n[j]);
                }
            }
            let mut t = [f32::NEG_INFINITY; LANES];
            (t[0], t[1], t[2]) = (0.0, f32::NAN, -1e30);
            assert_eq!(dispatch(level, Numbers(t))[..4], [255, 0, 0, 0].map(|n| n + NUMBERED));
        }
    }

    #[test]
    fn the_largest_logit_weighs_one_and_what_cannot_count_weighs_the_least() {
        for level in crate::testing::levels() {
            let mut t = [f32::NEG_INFINITY; LANES];
            (t[0], t[1], t[2], t[3], t[4]) = (0.0, -0.0, f32::NAN, -64.0, -1e30);
            let least = f32::from_bits((127 - 64) << 23);
            assert_eq!(dispatch(level, Weights(t))[..6], [1.0, 1.0, least, least, least, least]);
        }
    }
}
