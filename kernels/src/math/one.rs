//! One value standing for sixteen equal lanes: how the scalar twins run the vector algorithms.

#![expect(unsafe_code, reason = "the trait of vectors has loads by pointer")]

use crate::level::Level;
use crate::simd::{LANES, Simd, fused_mul_add};

/// A vector whose lanes are all equal, kept as one value. Same operations, same bits as every level.
#[derive(Clone, Copy)]
pub(super) struct One;

/// The nearest integer, ties to even.
#[inline(always)]
fn round_even(x: f32) -> f32 {
    const BIG: f32 = 8_388_608.0;
    let magnitude = x.abs();
    let rounded = if magnitude < BIG { (magnitude + BIG) - BIG } else { magnitude };
    rounded.copysign(x)
}

impl Simd for One {
    type F32 = f32;
    type I32 = i32;
    type Mask = bool;
    const GEMM_ROWS: usize = 1;
    const GEMM_PANELS: usize = 1;

    fn level(self) -> Level {
        Level::scalar()
    }
    #[inline(always)]
    fn splat(self, x: f32) -> f32 {
        x
    }
    #[inline(always)]
    fn from_array(self, x: [f32; LANES]) -> f32 {
        x[0]
    }
    #[inline(always)]
    fn to_array(self, a: f32) -> [f32; LANES] {
        [a; LANES]
    }
    #[inline(always)]
    unsafe fn load_ptr(self, from: *const f32) -> f32 {
        // SAFETY: the caller's.
        unsafe { from.read_unaligned() }
    }
    #[inline(always)]
    unsafe fn store_ptr(self, a: f32, to: *mut f32) {
        // SAFETY: the caller's.
        unsafe { to.cast::<[f32; LANES]>().write_unaligned([a; LANES]) }
    }
    #[inline(always)]
    fn add(self, a: f32, b: f32) -> f32 {
        a + b
    }
    #[inline(always)]
    fn sub(self, a: f32, b: f32) -> f32 {
        a - b
    }
    #[inline(always)]
    fn mul(self, a: f32, b: f32) -> f32 {
        a * b
    }
    #[inline(always)]
    fn div(self, a: f32, b: f32) -> f32 {
        a / b
    }
    #[inline(always)]
    fn mul_add(self, a: f32, b: f32, c: f32) -> f32 {
        fused_mul_add(a, b, c)
    }
    #[inline(always)]
    fn neg_mul_add(self, a: f32, b: f32, c: f32) -> f32 {
        fused_mul_add(-a, b, c)
    }
    #[inline(always)]
    fn min(self, a: f32, b: f32) -> f32 {
        if a < b { a } else { b }
    }
    #[inline(always)]
    fn max(self, a: f32, b: f32) -> f32 {
        if a > b { a } else { b }
    }
    #[inline(always)]
    fn sqrt(self, a: f32) -> f32 {
        a.sqrt()
    }
    #[inline(always)]
    fn abs(self, a: f32) -> f32 {
        a.abs()
    }
    #[inline(always)]
    fn neg(self, a: f32) -> f32 {
        -a
    }
    #[inline(always)]
    fn round(self, a: f32) -> f32 {
        round_even(a)
    }
    #[inline(always)]
    fn floor(self, a: f32) -> f32 {
        let nearest = round_even(a);
        (if nearest > a { nearest - 1.0 } else { nearest }).copysign(a)
    }
    #[inline(always)]
    fn lt(self, a: f32, b: f32) -> bool {
        a < b
    }
    #[inline(always)]
    fn le(self, a: f32, b: f32) -> bool {
        a <= b
    }
    #[inline(always)]
    fn eq(self, a: f32, b: f32) -> bool {
        a == b
    }
    #[inline(always)]
    fn select(self, mask: bool, a: f32, b: f32) -> f32 {
        if mask { a } else { b }
    }
    #[inline(always)]
    fn splat_i32(self, x: i32) -> i32 {
        x
    }
    #[inline(always)]
    fn from_array_i32(self, x: [i32; LANES]) -> i32 {
        x[0]
    }
    #[inline(always)]
    fn to_array_i32(self, a: i32) -> [i32; LANES] {
        [a; LANES]
    }
    #[inline(always)]
    fn to_bits(self, a: f32) -> i32 {
        a.to_bits().cast_signed()
    }
    #[inline(always)]
    fn from_bits(self, a: i32) -> f32 {
        f32::from_bits(a.cast_unsigned())
    }
    #[inline(always)]
    fn to_i32(self, a: f32) -> i32 {
        a as i32
    }
    #[inline(always)]
    fn to_f32(self, a: i32) -> f32 {
        a as f32
    }
    #[inline(always)]
    fn add_i32(self, a: i32, b: i32) -> i32 {
        a.wrapping_add(b)
    }
    #[inline(always)]
    fn sub_i32(self, a: i32, b: i32) -> i32 {
        a.wrapping_sub(b)
    }
    #[inline(always)]
    fn and_i32(self, a: i32, b: i32) -> i32 {
        a & b
    }
    #[inline(always)]
    fn or_i32(self, a: i32, b: i32) -> i32 {
        a | b
    }
    #[inline(always)]
    fn xor_i32(self, a: i32, b: i32) -> i32 {
        a ^ b
    }
    #[inline(always)]
    fn shl<const BITS: i32>(self, a: i32) -> i32 {
        a << BITS
    }
    #[inline(always)]
    fn shr<const BITS: i32>(self, a: i32) -> i32 {
        (a.cast_unsigned() >> BITS).cast_signed()
    }
    #[inline(always)]
    fn sar<const BITS: i32>(self, a: i32) -> i32 {
        a >> BITS
    }
    #[inline(always)]
    fn gt_i32(self, a: i32, b: i32) -> bool {
        a > b
    }
    #[inline(always)]
    fn eq_i32(self, a: i32, b: i32) -> bool {
        a == b
    }
    #[inline(always)]
    fn select_i32(self, mask: bool, a: i32, b: i32) -> i32 {
        if mask { a } else { b }
    }
    #[inline(always)]
    fn and(self, a: bool, b: bool) -> bool {
        a & b
    }
    #[inline(always)]
    fn or(self, a: bool, b: bool) -> bool {
        a | b
    }
    #[inline(always)]
    fn not(self, a: bool) -> bool {
        !a
    }
    #[inline(always)]
    fn bits(self, a: bool) -> u16 {
        if a { u16::MAX } else { 0 }
    }
    #[inline(always)]
    fn mask_from_bits(self, bits: u16) -> bool {
        bits & 1 != 0
    }
    #[inline(always)]
    fn sum(self, a: f32) -> f32 {
        16.0 * a
    }
    #[inline(always)]
    fn max_lane(self, a: f32) -> f32 {
        a
    }
}
