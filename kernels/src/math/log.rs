//! Logarithms, and functions built from them.

use super::exp::{self, LN2_HI, LN2_LO};
use super::polynomial;
use crate::simd::Elementwise;

/// log(1 + f) = f − f²/2 + f³ P(f) on [√½ − 1, √2 − 1]; minimax in relative error, 2^−30.2. Highest power first.
const P: [f32; 9] = [
    f32::from_bits(0x3d89_df1e),
    f32::from_bits(0xbdee_cca0),
    f32::from_bits(0x3df3_6e90),
    f32::from_bits(0xbdfe_1f1c),
    f32::from_bits(0x3e11_9d7b),
    f32::from_bits(0xbe2a_adc6),
    f32::from_bits(0x3e4c_d23c),
    f32::from_bits(0xbe80_0004),
    f32::from_bits(0x3eaa_aaa4),
];
/// The bits of √½.
const SQRT_HALF: i32 = 0x3f35_04f3;

/// log(1 + f) + k ln 2, `f` in [√½ − 1, √2 − 1], `k` an integer of up to 8 bits.
#[inline(always)]
fn log_1p_plus<S: Elementwise>(s: S, f: S::F32, k: S::F32) -> S::F32 {
    let ff = s.mul(f, f);
    let tail = s.mul(s.mul(ff, f), polynomial(s, f, &P));
    let tail = s.mul_add(k, s.splat(LN2_LO), tail);
    let tail = s.neg_mul_add(s.splat(0.5), ff, tail);
    s.mul_add(k, s.splat(LN2_HI), s.add(f, tail))
}

/// ln x. ±0 return −∞, ∞ returns ∞; negative x and NaN return NaN. Denormal x are as accurate as others.
#[inline(always)]
pub fn log<S: Elementwise>(s: S, x: S::F32) -> S::F32 {
    let denormal = s.lt(x, s.splat(f32::MIN_POSITIVE));
    let scaled = s.select(denormal, s.mul(x, s.splat(8_388_608.0)), x);
    let offset = s.sub_i32(s.to_bits(scaled), s.splat_i32(SQRT_HALF));
    let k = s.add(s.to_f32(s.sar::<23>(offset)), s.select(denormal, s.splat(-23.0), s.splat(0.0)));
    let mantissa = s.from_bits(s.add_i32(s.and_i32(offset, s.splat_i32(0x7f_ffff)), s.splat_i32(SQRT_HALF)));
    let result = log_1p_plus(s, s.sub(mantissa, s.splat(1.0)), k);
    let ordinary = s.and(s.lt(s.splat(0.0), x), s.lt(x, s.splat(f32::INFINITY)));
    let zero = s.eq(x, s.splat(0.0));
    let special = s.select(s.lt(x, s.splat(0.0)), s.splat(f32::NAN), x);
    let special = s.select(zero, s.splat(f32::NEG_INFINITY), special);
    s.select(ordinary, result, special)
}

/// ln(1 + eˣ), as max(x, 0) + ln(1 + e^−|x|): never overflows, and keeps its relative accuracy down to denormal
/// results.
#[inline(always)]
pub fn softplus<S: Elementwise>(s: S, x: S::F32) -> S::F32 {
    let u = exp::exp(s, s.neg(s.abs(x)));
    // From u = √2 − 1 on, 1 + u = 2 (1 + f).
    let upper = s.lt(s.splat(std::f32::consts::SQRT_2 - 1.0), u);
    let half = s.splat(0.5);
    let f = s.select(upper, s.mul_add(half, u, s.neg(half)), u);
    let k = s.select(upper, s.splat(1.0), s.splat(0.0));
    s.add(s.max(s.splat(0.0), x), log_1p_plus(s, f, k))
}
