//! The logistic function and its relatives.

use super::exp;
use crate::simd::Elementwise;

/// 1 / (1 + e^−x), as e/(1 + e) with e = e^−|x| where x < 0: accurate down to denormal results.
#[inline(always)]
pub fn sigmoid<S: Elementwise>(s: S, x: S::F32) -> S::F32 {
    let e = exp::exp(s, s.neg(s.abs(x)));
    let one = s.splat(1.0);
    s.div(s.select(s.lt(x, s.splat(0.0)), e, one), s.add(one, e))
}

/// x / (1 + e^−x), the sigmoid linear unit. −∞ returns −0.
#[inline(always)]
pub fn silu<S: Elementwise>(s: S, x: S::F32) -> S::F32 {
    // From −112 down the result is −0.
    let x = s.max(s.splat(-112.0), x);
    let (p, n) = exp::parts(s, s.max(s.splat(-112.0), s.neg(s.abs(x))));
    let e = s.scale_by_any_pow2(p, n);
    // x·e with x multiplied in before e could become denormal.
    let xe = s.scale_by_any_pow2(s.mul(x, p), n);
    s.div(s.select(s.lt(x, s.splat(0.0)), xe, x), s.add(s.splat(1.0), e))
}

/// [`silu`] within 1e-4 of itself from −87 on, for values then rounded to bf16 or 8 bits. Below, −∞ included, it is
/// negative and above −2e-36.
#[inline(always)]
pub fn silu_low<S: Elementwise>(s: S, x: S::F32) -> S::F32 {
    // NaN stays.
    let x = s.max(s.splat(-112.0), x);
    let t = s.mul(x, s.splat(-std::f32::consts::LOG2_E));
    let e = exp::exp2_low(s, s.max(s.min(t, s.splat(126.0)), s.splat(-125.0)));
    s.div(x, s.add(s.splat(1.0), e))
}

/// The hyperbolic tangent, as E/(E + 2) with E = e^2|x| − 1. Odd; ±1 from |x| = 9.02 on.
#[inline(always)]
pub fn tanh<S: Elementwise>(s: S, x: S::F32) -> S::F32 {
    let double = s.min(s.splat(20.0), s.mul(s.splat(2.0), s.abs(x)));
    let (q, scale) = exp::minus_one_parts(s, double);
    let e = s.mul_add(scale, q, s.sub(scale, s.splat(1.0)));
    let magnitude = s.div(e, s.add(e, s.splat(2.0)));
    let sign = s.and_i32(s.to_bits(x), s.splat_i32(i32::MIN));
    s.from_bits(s.or_i32(s.to_bits(magnitude), sign))
}
