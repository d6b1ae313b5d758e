//! The exponential.

use super::polynomial;
use crate::simd::{Elementwise, SHIFTER};

/// ln 2 to 15 bits: its product with an integer of 8 bits is exact.
pub(super) const LN2_HI: f32 = 45_426.0 / 65_536.0;
/// The rest of ln 2.
pub(super) const LN2_LO: f32 = 1.428_606_8e-6;

/// exp(r) = 1 + r + r² Q(r) on |r| ≤ ln 2 / 2; minimax in relative error, 2^−28.2. Highest power first.
const Q: [f32; 5] = [
    f32::from_bits(0x3ab5_28d4),
    f32::from_bits(0x3c09_1cc1),
    f32::from_bits(0x3d2a_ac56),
    f32::from_bits(0x3e2a_aa49),
    f32::from_bits(0x3eff_fffe),
];

/// `x = n·ln 2 + r` with n = `t` − (the constant that was added).
#[inline(always)]
fn reduce<S: Elementwise>(s: S, x: S::F32, to_integer: f32) -> (S::F32, S::F32) {
    let magic = s.splat(to_integer);
    let t = s.mul_add(x, s.splat(std::f32::consts::LOG2_E), magic);
    let n = s.sub(t, magic);
    let r = s.neg_mul_add(n, s.splat(LN2_HI), x);
    let r = s.neg_mul_add(n, s.splat(LN2_LO), r);
    (t, r)
}

/// exp(x) = `p`·2ⁿ, with `n` as [`Elementwise::scale_by_any_pow2`] takes it.
///
/// `x` is not above 89 and not under −112 (or it is NaN, and so is `p`).
#[inline(always)]
pub(super) fn parts<S: Elementwise>(s: S, x: S::F32) -> (S::F32, S::F32) {
    let (t, r) = reduce(s, x, SHIFTER);
    let q = polynomial(s, r, &Q);
    let one = s.splat(1.0);
    (s.mul_add(s.mul_add(q, r, one), r, one), s.shifted_int(t))
}

/// exp(r) − 1 = `q` and 2ⁿ with x = n ln 2 + r; `x` between −87 and 88.
#[inline(always)]
pub(super) fn minus_one_parts<S: Elementwise>(s: S, x: S::F32) -> (S::F32, S::F32) {
    let (t, r) = reduce(s, x, SHIFTER + 127.0);
    let q = polynomial(s, r, &Q);
    (s.mul_add(s.mul(r, r), q, r), s.from_bits(s.shl::<23>(s.to_bits(t))))
}

/// eˣ. Overflows to ∞ above 88.72, underflows gradually to 0 below −103.97; NaN returns NaN.
#[inline(always)]
pub fn exp<S: Elementwise>(s: S, x: S::F32) -> S::F32 {
    let x = s.max(s.splat(-104.0), s.min(s.splat(89.0), x));
    let (p, n) = parts(s, x);
    s.scale_by_any_pow2(p, n)
}

/// eˣ for x ≤ 0, in 13 operations; same bits as [`exp`] where that is at least 2⁻¹²⁶.
///
/// Below 2^−126.5 the result is +0 (from there to 2⁻¹²⁶ it is denormal, rounded once). −∞ returns 0, NaN returns NaN;
/// for positive x the result is eˣ up to 88 and unspecified above.
#[inline(always)]
pub fn exp_nonpositive<S: Elementwise>(s: S, x: S::F32) -> S::F32 {
    // At this bound n = −127, and 2ⁿ is formed as +0.
    let x = s.max(s.splat(-88.0), x);
    let (t, r) = reduce(s, x, SHIFTER + 127.0);
    let q = polynomial(s, r, &Q);
    let one = s.splat(1.0);
    let p = s.mul_add(s.mul_add(q, r, one), r, one);
    s.mul(p, s.from_bits(s.shl::<23>(s.to_bits(t))))
}

/// 2^f on |f| ≤ ½; minimax in relative error, 2^−13.7. Highest power first.
pub(crate) const EXP2_LOW: [f32; 4] = [0.055_171_67, 0.242_611_13, 0.693_260_97, 0.999_928_06];

/// 2ˣ within 7.5e-5 of itself, for values then rounded to bf16 or 8 bits. `x` is from −125 to 126 (for others, and NaN,
/// the value is unspecified and differs between levels).
#[inline(always)]
pub fn exp2_low<S: Elementwise>(s: S, x: S::F32) -> S::F32 {
    let (whole, part) = s.split_int_frac(x);
    s.scale_by_pow2(polynomial(s, part, &EXP2_LOW), whole)
}
