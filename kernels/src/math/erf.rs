//! The error function, the normal distribution and GELU.

use super::exp;
use super::log::log;
use super::polynomial;
use crate::simd::Elementwise;

/// erf x = x + x·P(x²) on [0, 1]; 2^−29.3.
const NEAR: [f32; 7] = [
    f32::from_bits(0x38a4_8b79),
    f32::from_bits(0xba51_ebf6),
    f32::from_bits(0x3baa_00b8),
    f32::from_bits(0xbcdb_fc46),
    f32::from_bits(0x3de7_1679),
    f32::from_bits(0xbec0_939f),
    f32::from_bits(0x3e03_75d4),
];
/// −ln erfc x on [1, 3.95]; 2^−29.8 of erf x.
const FAR: [f32; 7] = [
    f32::from_bits(0xb943_70c0),
    f32::from_bits(0x3b41_2eb0),
    f32::from_bits(0xbcb2_e659),
    f32::from_bits(0x3dd3_29f9),
    f32::from_bits(0x3f23_5d68),
    f32::from_bits(0x3f90_447a),
    f32::from_bits(0x39b2_fa1f),
];

/// e^(a²)·erfc a on [0, 10.6]; 2^−28.0.
const ERFC: Tail = Tail {
    pole: 3.0,
    centre: 1.0,
    last: 10.5,
    square: 1.0,
    polynomial: [
        f32::from_bits(0xbc4c_ee96),
        f32::from_bits(0x3cce_3f0a),
        f32::from_bits(0x3d11_b150),
        f32::from_bits(0xbe0b_a62b),
        f32::from_bits(0xbd3f_d19f),
        f32::from_bits(0x3f59_5d3b),
        f32::from_bits(0xc002_fb8e),
        f32::from_bits(0x4036_3aa5),
        f32::from_bits(0xc02a_4ec6),
        f32::from_bits(0x3fda_ec3c),
    ],
};
/// e^(a²/2)·Φ(−a) on [0, 15]; 2^−27.1.
const NORMAL: Tail = Tail {
    pole: 4.25,
    centre: 1.625,
    last: 14.9,
    square: 0.5,
    polynomial: [
        f32::from_bits(0xbbcd_8275),
        f32::from_bits(0x3c2f_72bb),
        f32::from_bits(0x3cc5_1f07),
        f32::from_bits(0xbd93_9a7e),
        f32::from_bits(0xbd44_3be8),
        f32::from_bits(0x3f05_7592),
        f32::from_bits(0xbf9d_c4d9),
        f32::from_bits(0x3fde_e644),
        f32::from_bits(0xbfd7_bffe),
        f32::from_bits(0x3f92_a84a),
    ],
};

/// An upper tail e^(−square·a²)·t·P((a − centre)·t), t = 1/(a + pole), that is 0 in binary32 at `last`.
///
/// The tails fall like 1/a, which t takes out; P then turns little of the rounding of its argument into its result.
struct Tail {
    pole: f32,
    centre: f32,
    last: f32,
    square: f32,
    polynomial: [f32; 10],
}

impl Tail {
    /// The tail at a = |x|, as `v`·2ⁿ, with `n` as [`Elementwise::scale_by_any_pow2`] takes it.
    #[inline(always)]
    fn parts<S: Elementwise>(&self, s: S, x: S::F32) -> (S::F32, S::F32) {
        let a = s.min(s.splat(self.last), s.abs(x));
        // t = 1/d, then corrected by the rounding errors of the sum and the quotient: up to 3 ulp of the result near a
        // = 0.
        let d = s.add(a, s.splat(self.pole));
        let lost = s.sub(a, s.sub(d, s.splat(self.pole)));
        let t = s.div(s.splat(1.0), d);
        let rest = s.neg_mul_add(t, lost, s.neg_mul_add(t, d, s.splat(1.0)));
        let t = s.mul_add(t, rest, t);
        let v = s.mul(s.sub(a, s.splat(self.centre)), t);
        let v = s.mul(t, polynomial(s, v, &self.polynomial));
        // a² = square + lost; e^−lost = 1 − lost to 2⁻³⁴.
        let square = s.mul(a, a);
        let lost = s.mul_add(a, a, s.neg(square));
        let (p, n) = exp::parts(s, s.mul(s.splat(-self.square), square));
        let v = s.mul(v, p);
        (s.neg_mul_add(s.mul(s.splat(self.square), lost), v, v), n)
    }
}

/// erf x = 2/√π ∫₀ˣ e^(−t²) dt. Odd; ±1 from |x| = 3.92 on.
#[inline(always)]
pub fn erf<S: Elementwise>(s: S, x: S::F32) -> S::F32 {
    let a = s.abs(x);
    let near = s.mul_add(a, polynomial(s, s.mul(a, a), &NEAR), a);
    let g = polynomial(s, s.min(s.splat(3.95), a), &FAR);
    let far = s.sub(s.splat(1.0), exp::exp_nonpositive(s, s.neg(g)));
    let magnitude = s.select(s.lt(a, s.splat(1.0)), near, far);
    let sign = s.and_i32(s.to_bits(x), s.splat_i32(i32::MIN));
    s.from_bits(s.or_i32(s.to_bits(magnitude), sign))
}

/// erfc x = 1 − erf x, with full relative accuracy in the tail, down to denormal results.
#[inline(always)]
pub fn erfc<S: Elementwise>(s: S, x: S::F32) -> S::F32 {
    let (v, n) = ERFC.parts(s, x);
    let tail = s.scale_by_any_pow2(v, n);
    s.select(s.lt(x, s.splat(0.0)), s.sub(s.splat(2.0), tail), tail)
}

/// Φ(x), the distribution function of the standard normal, with full relative accuracy in the lower tail.
#[inline(always)]
pub fn normal_cdf<S: Elementwise>(s: S, x: S::F32) -> S::F32 {
    let (v, n) = NORMAL.parts(s, x);
    let tail = s.scale_by_any_pow2(v, n);
    s.select(s.lt(s.splat(0.0), x), s.sub(s.splat(1.0), tail), tail)
}

/// x·Φ(x), the Gaussian error linear unit in its exact form. −∞ returns −0.
#[inline(always)]
pub fn gelu<S: Elementwise>(s: S, x: S::F32) -> S::F32 {
    // From −14.9 down the result is −0.
    let x = s.max(s.splat(-14.9), x);
    let (v, n) = NORMAL.parts(s, x);
    // x·Φ(x) with x multiplied in before the tail could become denormal.
    let lower = s.scale_by_any_pow2(s.mul(x, v), n);
    let upper = s.mul(x, s.sub(s.splat(1.0), s.scale_by_any_pow2(v, n)));
    s.select(s.lt(s.splat(0.0), x), upper, lower)
}

/// erf⁻¹(x)/x as a function of w − 2.5, w = −ln(1 − x²), for w in [0, 5]; 2^−24.6.
const INVERSE_NEAR: [f32; 11] = [
    f32::from_bits(0xaf24_30ba),
    f32::from_bits(0xb215_705d),
    f32::from_bits(0x32e3_d43a),
    f32::from_bits(0x34f9_8677),
    f32::from_bits(0xb66a_21c2),
    f32::from_bits(0xb6a6_4d32),
    f32::from_bits(0x3965_0bba),
    f32::from_bits(0xbaa4_3386),
    f32::from_bits(0xbb88_e38b),
    f32::from_bits(0x3e7c_8f46),
    f32::from_bits(0x3fc0_2e2f),
];
/// erf⁻¹(x)/x as a function of √w − 3, for √w in [√5, 4.01]; 2^−26.6.
const INVERSE_FAR: [f32; 10] = [
    f32::from_bits(0x3904_3b71),
    f32::from_bits(0xb9a5_0218),
    f32::from_bits(0xb89b_27a4),
    f32::from_bits(0x3ac3_5d55),
    f32::from_bits(0xbb6b_185d),
    f32::from_bits(0x3bba_4e5f),
    f32::from_bits(0xbbfa_560a),
    f32::from_bits(0x3c1a_c042),
    f32::from_bits(0x3f80_36e4),
    f32::from_bits(0x4035_4f7e),
];

/// The inverse of [`erf`]. ±1 return ±∞, values beyond them NaN.
#[inline(always)]
pub fn erfinv<S: Elementwise>(s: S, x: S::F32) -> S::F32 {
    let one = s.splat(1.0);
    let w = s.neg(log(s, s.neg_mul_add(x, x, one)));
    let near = polynomial(s, s.sub(w, s.splat(2.5)), &INVERSE_NEAR);
    let far = polynomial(s, s.sub(s.sqrt(w), s.splat(3.0)), &INVERSE_FAR);
    let result = s.mul(x, s.select(s.lt(w, s.splat(5.0)), near, far));
    let a = s.abs(x);
    let outside = s.select(s.eq(a, one), s.mul(x, s.splat(f32::INFINITY)), s.splat(f32::NAN));
    s.select(s.lt(a, one), result, outside)
}
