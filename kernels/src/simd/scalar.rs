//! The level every machine has. It defines the bits of the others.

use super::{LANES, Simd};
use crate::level::{Kind, Level};

/// `a·b + c`, rounded once, without an FMA instruction.
///
/// The product is exact in binary64. Its sum with `c` is rounded to odd (an inexact sum gets an odd last bit), after which
/// the conversion to binary32 rounds as if the sum had been exact: binary64 has more than two bits to spare, also where
/// the result is denormal. Infinite and NaN operands pass through.
#[inline(always)]
pub fn fused_mul_add(a: f32, b: f32, c: f32) -> f32 {
    let product = f64::from(a) * f64::from(b);
    let addend = f64::from(c);
    let sum = product + addend;
    let part = sum - product;
    let error = (product - (sum - part)) + (addend - part);
    let bits = sum.to_bits();
    // NaN (from infinite operands) compares false and leaves the sum alone.
    let inexact = error.abs() > 0.0;
    let toward = if (error > 0.0) == (sum > 0.0) { bits.wrapping_add(1) } else { bits.wrapping_sub(1) };
    let odd = if inexact && bits & 1 == 0 { toward } else { bits };
    f64::from_bits(odd) as f32
}

#[derive(Clone, Copy)]
pub(crate) struct Scalar;

type F = [f32; LANES];
type I = [i32; LANES];
type M = [bool; LANES];

#[inline(always)]
fn map<A: Copy, R>(a: [A; LANES], f: impl Fn(A) -> R) -> [R; LANES] {
    std::array::from_fn(|i| f(a[i]))
}

#[inline(always)]
fn zip<A: Copy, B: Copy, R>(a: [A; LANES], b: [B; LANES], f: impl Fn(A, B) -> R) -> [R; LANES] {
    std::array::from_fn(|i| f(a[i], b[i]))
}

#[inline(always)]
fn fold(mut a: F, f: impl Fn(f32, f32) -> f32) -> f32 {
    for width in [8, 4, 2, 1] {
        for i in 0..width {
            a[i] = f(a[i], a[i + width]);
        }
    }
    a[0]
}

/// The nearest integer, ties to even, without an SSE4.1 instruction: magnitudes from 2²³ on are integers already.
#[inline(always)]
fn round_even(x: f32) -> f32 {
    const BIG: f32 = 8_388_608.0;
    let magnitude = x.abs();
    let rounded = if magnitude < BIG { (magnitude + BIG) - BIG } else { magnitude };
    rounded.copysign(x)
}

impl Simd for Scalar {
    type F32 = F;
    type I32 = I;
    type Mask = M;
    const GEMM_ROWS: usize = 4;
    const GEMM_PANELS: usize = 1;

    #[inline(always)]
    fn level(self) -> Level {
        Level(Kind::Scalar)
    }
    #[inline(always)]
    fn splat(self, x: f32) -> F {
        [x; LANES]
    }
    #[inline(always)]
    fn from_array(self, x: F) -> F {
        x
    }
    #[inline(always)]
    fn to_array(self, a: F) -> F {
        a
    }
    #[inline(always)]
    unsafe fn load_ptr(self, from: *const f32) -> F {
        // SAFETY: the caller's.
        unsafe { from.cast::<F>().read_unaligned() }
    }
    #[inline(always)]
    unsafe fn store_ptr(self, a: F, to: *mut f32) {
        // SAFETY: the caller's.
        unsafe { to.cast::<F>().write_unaligned(a) }
    }
    #[inline(always)]
    fn add(self, a: F, b: F) -> F {
        zip(a, b, |a, b| a + b)
    }
    #[inline(always)]
    fn sub(self, a: F, b: F) -> F {
        zip(a, b, |a, b| a - b)
    }
    #[inline(always)]
    fn mul(self, a: F, b: F) -> F {
        zip(a, b, |a, b| a * b)
    }
    #[inline(always)]
    fn div(self, a: F, b: F) -> F {
        zip(a, b, |a, b| a / b)
    }
    #[inline(always)]
    fn mul_add(self, a: F, b: F, c: F) -> F {
        std::array::from_fn(|i| fused_mul_add(a[i], b[i], c[i]))
    }
    #[inline(always)]
    fn neg_mul_add(self, a: F, b: F, c: F) -> F {
        std::array::from_fn(|i| fused_mul_add(-a[i], b[i], c[i]))
    }
    #[inline(always)]
    fn min(self, a: F, b: F) -> F {
        zip(a, b, |a, b| if a < b { a } else { b })
    }
    #[inline(always)]
    fn max(self, a: F, b: F) -> F {
        zip(a, b, |a, b| if a > b { a } else { b })
    }
    #[inline(always)]
    fn sqrt(self, a: F) -> F {
        map(a, f32::sqrt)
    }
    #[inline(always)]
    fn abs(self, a: F) -> F {
        map(a, f32::abs)
    }
    #[inline(always)]
    fn neg(self, a: F) -> F {
        map(a, |x| -x)
    }
    #[inline(always)]
    fn round(self, a: F) -> F {
        map(a, round_even)
    }
    #[inline(always)]
    fn floor(self, a: F) -> F {
        map(a, |x| {
            let nearest = round_even(x);
            (if nearest > x { nearest - 1.0 } else { nearest }).copysign(x)
        })
    }
    #[inline(always)]
    fn lt(self, a: F, b: F) -> M {
        zip(a, b, |a, b| a < b)
    }
    #[inline(always)]
    fn le(self, a: F, b: F) -> M {
        zip(a, b, |a, b| a <= b)
    }
    #[inline(always)]
    fn eq(self, a: F, b: F) -> M {
        zip(a, b, |a, b| a == b)
    }
    #[inline(always)]
    fn select(self, mask: M, a: F, b: F) -> F {
        std::array::from_fn(|i| if mask[i] { a[i] } else { b[i] })
    }
    #[inline(always)]
    fn splat_i32(self, x: i32) -> I {
        [x; LANES]
    }
    #[inline(always)]
    fn from_array_i32(self, x: I) -> I {
        x
    }
    #[inline(always)]
    fn to_array_i32(self, a: I) -> I {
        a
    }
    #[inline(always)]
    fn to_bits(self, a: F) -> I {
        map(a, |x| x.to_bits().cast_signed())
    }
    #[inline(always)]
    fn from_bits(self, a: I) -> F {
        map(a, |x| f32::from_bits(x.cast_unsigned()))
    }
    #[inline(always)]
    fn to_i32(self, a: F) -> I {
        map(a, |x| x as i32)
    }
    #[inline(always)]
    fn to_f32(self, a: I) -> F {
        map(a, |x| x as f32)
    }
    #[inline(always)]
    fn add_i32(self, a: I, b: I) -> I {
        zip(a, b, i32::wrapping_add)
    }
    #[inline(always)]
    fn sub_i32(self, a: I, b: I) -> I {
        zip(a, b, i32::wrapping_sub)
    }
    #[inline(always)]
    fn and_i32(self, a: I, b: I) -> I {
        zip(a, b, |a, b| a & b)
    }
    #[inline(always)]
    fn or_i32(self, a: I, b: I) -> I {
        zip(a, b, |a, b| a | b)
    }
    #[inline(always)]
    fn xor_i32(self, a: I, b: I) -> I {
        zip(a, b, |a, b| a ^ b)
    }
    #[inline(always)]
    fn shl<const BITS: i32>(self, a: I) -> I {
        map(a, |x| x << BITS)
    }
    #[inline(always)]
    fn shr<const BITS: i32>(self, a: I) -> I {
        map(a, |x| (x.cast_unsigned() >> BITS).cast_signed())
    }
    #[inline(always)]
    fn sar<const BITS: i32>(self, a: I) -> I {
        map(a, |x| x >> BITS)
    }
    #[inline(always)]
    fn gt_i32(self, a: I, b: I) -> M {
        zip(a, b, |a, b| a > b)
    }
    #[inline(always)]
    fn eq_i32(self, a: I, b: I) -> M {
        zip(a, b, |a, b| a == b)
    }
    #[inline(always)]
    fn select_i32(self, mask: M, a: I, b: I) -> I {
        std::array::from_fn(|i| if mask[i] { a[i] } else { b[i] })
    }
    #[inline(always)]
    fn and(self, a: M, b: M) -> M {
        zip(a, b, |a, b| a & b)
    }
    #[inline(always)]
    fn or(self, a: M, b: M) -> M {
        zip(a, b, |a, b| a | b)
    }
    #[inline(always)]
    fn not(self, a: M) -> M {
        map(a, |a| !a)
    }
    #[inline(always)]
    fn bits(self, a: M) -> u16 {
        (0..LANES).fold(0, |bits, i| bits | (u16::from(a[i]) << i))
    }
    #[inline(always)]
    fn mask_from_bits(self, bits: u16) -> M {
        std::array::from_fn(|i| bits >> i & 1 != 0)
    }
    #[inline(always)]
    fn sum(self, a: F) -> f32 {
        fold(a, |a, b| a + b)
    }
    #[inline(always)]
    fn max_lane(self, a: F) -> f32 {
        fold(a, |a, b| if a > b { a } else { b })
    }
}
