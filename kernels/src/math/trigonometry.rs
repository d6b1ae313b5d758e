//! Sine and cosine.

use super::{f64 as double, polynomial};
use crate::simd::{Elementwise, SHIFTER};

/// Arguments up to here are reduced in vectors.
const LAST: f32 = 8192.0;
/// π/2 in three parts: x − n·A is exact for n up to 2¹³.
const A: f32 = std::f32::consts::FRAC_PI_2;
const B: f32 = -4.371_139e-8;
const C: f32 = -1.715_124_7e-15;

/// sin r = r + r³ P(r²) on |r| ≤ π/4; 2^−27.9.
const SIN: [f32; 3] = [f32::from_bits(0xb94c_a9f1), f32::from_bits(0x3c08_83bc), f32::from_bits(0xbe2a_aaa3)];
/// cos r = 1 − r²/2 + r⁴ P(r²) on |r| ≤ π/4; 2^−33.
const COS: [f32; 3] = [f32::from_bits(0x37cc_f482), f32::from_bits(0xbab6_0615), f32::from_bits(0x3d2a_aaa5)];

/// (sin x, cos x), for every finite x; ±∞ and NaN return NaN.
///
/// Lanes beyond ±8192 are computed one by one in binary64.
#[inline(always)]
pub fn sin_cos<S: Elementwise>(s: S, x: S::F32) -> (S::F32, S::F32) {
    let magic = s.splat(SHIFTER);
    let t = s.mul_add(x, s.splat(std::f32::consts::FRAC_2_PI), magic);
    let n = s.sub(t, magic);
    let r = s.neg_mul_add(n, s.splat(A), x);
    let r = s.neg_mul_add(n, s.splat(B), r);
    let r = s.neg_mul_add(n, s.splat(C), r);
    let z = s.mul(r, r);
    let sin = s.mul_add(s.mul(z, r), polynomial(s, z, &SIN), r);
    let cos = s.mul_add(s.mul(z, z), polynomial(s, z, &COS), s.neg_mul_add(s.splat(0.5), z, s.splat(1.0)));
    let quadrant = s.to_bits(t);
    let odd = s.eq_i32(s.and_i32(quadrant, s.splat_i32(1)), s.splat_i32(1));
    let sign = |bit: S::I32| s.shl::<30>(s.and_i32(bit, s.splat_i32(2)));
    let signed = |v, sign| s.from_bits(s.xor_i32(s.to_bits(v), sign));
    let sin_x = signed(s.select(odd, cos, sin), sign(quadrant));
    let cos_x = signed(s.select(odd, sin, cos), sign(s.add_i32(quadrant, s.splat_i32(1))));
    // −0 would leave the reduction as +0.
    let sin_x = s.select(s.eq(x, s.splat(0.0)), x, sin_x);
    let reduced = s.le(s.abs(x), s.splat(LAST));
    if s.all(reduced) {
        return (sin_x, cos_x);
    }
    let far_sin = s.map(x, |x| double::sin_cos(f64::from(x)).0 as f32);
    let far_cos = s.map(x, |x| double::sin_cos(f64::from(x)).1 as f32);
    (s.select(reduced, sin_x, far_sin), s.select(reduced, cos_x, far_cos))
}
