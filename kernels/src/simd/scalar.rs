//! The level that every machine has. It defines the bits of the others: every operation on one value, and on sixteen
//! values.

use super::bf16;
use super::elementwise::Elementwise;
use super::vector::{LANES, Registers, Simd};

/// `a·b + c`, rounded once, without an FMA instruction.
///
/// The product is exact in binary64. Its sum with `c` is rounded to odd: an inexact sum gets an odd last bit. The
/// conversion to binary32 then rounds as if the sum had been exact, since binary64 has more than two spare bits, also
/// where the result is denormal. Infinite and NaN operands pass through.
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

/// The nearest integer, ties to even, without an SSE4.1 instruction: magnitudes from 2²³ on are integers already.
#[inline(always)]
fn round_even(x: f32) -> f32 {
    const BIG: f32 = 8_388_608.0;
    let magnitude = x.abs();
    let rounded = if magnitude < BIG { (magnitude + BIG) - BIG } else { magnitude };
    rounded.copysign(x)
}

/// Elementwise operations on one value.
#[derive(Clone, Copy)]
pub(crate) struct One;

/// Methods that are one expression of their arguments.
macro_rules! of_one {
    ($($name:ident($($x:ident: $t:ty),+) -> $r:ty = $e:expr;)*) => {$(
        #[inline(always)]
        fn $name(self, $($x: $t),+) -> $r {
            $e
        }
    )*};
}

impl Elementwise for One {
    type F32 = f32;
    type I32 = i32;
    type Mask = bool;

    of_one! {
        splat(x: f32) -> f32 = x;
        map(a: f32, f: impl Fn(f32) -> f32) -> f32 = f(a);
        add(a: f32, b: f32) -> f32 = a + b;
        sub(a: f32, b: f32) -> f32 = a - b;
        mul(a: f32, b: f32) -> f32 = a * b;
        div(a: f32, b: f32) -> f32 = a / b;
        mul_add(a: f32, b: f32, c: f32) -> f32 = fused_mul_add(a, b, c);
        neg_mul_add(a: f32, b: f32, c: f32) -> f32 = fused_mul_add(-a, b, c);
        min(a: f32, b: f32) -> f32 = if a < b { a } else { b };
        max(a: f32, b: f32) -> f32 = if a > b { a } else { b };
        sqrt(a: f32) -> f32 = a.sqrt();
        abs(a: f32) -> f32 = a.abs();
        neg(a: f32) -> f32 = -a;
        round(a: f32) -> f32 = round_even(a);
        floor(a: f32) -> f32 = {
            let nearest = round_even(a);
            (if nearest > a { nearest - 1.0 } else { nearest }).copysign(a)
        };
        lt(a: f32, b: f32) -> bool = a < b;
        le(a: f32, b: f32) -> bool = a <= b;
        eq(a: f32, b: f32) -> bool = a == b;
        select(mask: bool, a: f32, b: f32) -> f32 = if mask { a } else { b };
        splat_i32(x: i32) -> i32 = x;
        to_bits(a: f32) -> i32 = a.to_bits().cast_signed();
        from_bits(a: i32) -> f32 = f32::from_bits(a.cast_unsigned());
        to_i32(a: f32) -> i32 = a as i32;
        to_f32(a: i32) -> f32 = a as f32;
        add_i32(a: i32, b: i32) -> i32 = a.wrapping_add(b);
        sub_i32(a: i32, b: i32) -> i32 = a.wrapping_sub(b);
        and_i32(a: i32, b: i32) -> i32 = a & b;
        or_i32(a: i32, b: i32) -> i32 = a | b;
        xor_i32(a: i32, b: i32) -> i32 = a ^ b;
        gt_i32(a: i32, b: i32) -> bool = a > b;
        eq_i32(a: i32, b: i32) -> bool = a == b;
        select_i32(mask: bool, a: i32, b: i32) -> i32 = if mask { a } else { b };
        and(a: bool, b: bool) -> bool = a & b;
        or(a: bool, b: bool) -> bool = a | b;
        not(a: bool) -> bool = !a;
        all(a: bool) -> bool = a;
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
}

/// Sixteen values.
#[derive(Clone, Copy)]
pub(crate) struct Scalar;

type F = [f32; LANES];
type I = [i32; LANES];
type M = [bool; LANES];

/// Methods that are those of [`One`] in every lane.
macro_rules! of_each {
    ($($name:ident($($x:ident: $t:ty),+) -> $r:ty;)*) => {$(
        #[inline(always)]
        fn $name(self, $($x: $t),+) -> $r {
            std::array::from_fn(|i| One.$name($($x[i]),+))
        }
    )*};
}

impl Elementwise for Scalar {
    type F32 = F;
    type I32 = I;
    type Mask = M;

    of_each! {
        add(a: F, b: F) -> F;
        sub(a: F, b: F) -> F;
        mul(a: F, b: F) -> F;
        div(a: F, b: F) -> F;
        mul_add(a: F, b: F, c: F) -> F;
        neg_mul_add(a: F, b: F, c: F) -> F;
        min(a: F, b: F) -> F;
        max(a: F, b: F) -> F;
        sqrt(a: F) -> F;
        abs(a: F) -> F;
        neg(a: F) -> F;
        round(a: F) -> F;
        floor(a: F) -> F;
        lt(a: F, b: F) -> M;
        le(a: F, b: F) -> M;
        eq(a: F, b: F) -> M;
        select(mask: M, a: F, b: F) -> F;
        to_bits(a: F) -> I;
        from_bits(a: I) -> F;
        to_i32(a: F) -> I;
        to_f32(a: I) -> F;
        add_i32(a: I, b: I) -> I;
        sub_i32(a: I, b: I) -> I;
        and_i32(a: I, b: I) -> I;
        or_i32(a: I, b: I) -> I;
        xor_i32(a: I, b: I) -> I;
        gt_i32(a: I, b: I) -> M;
        eq_i32(a: I, b: I) -> M;
        select_i32(mask: M, a: I, b: I) -> I;
        and(a: M, b: M) -> M;
        or(a: M, b: M) -> M;
        not(a: M) -> M;
    }
    #[inline(always)]
    fn splat(self, x: f32) -> F {
        [x; LANES]
    }
    #[inline(always)]
    fn splat_i32(self, x: i32) -> I {
        [x; LANES]
    }
    #[inline(always)]
    fn map(self, a: F, f: impl Fn(f32) -> f32) -> F {
        a.map(f)
    }
    #[inline(always)]
    fn shl<const BITS: i32>(self, a: I) -> I {
        a.map(|x| One.shl::<BITS>(x))
    }
    #[inline(always)]
    fn shr<const BITS: i32>(self, a: I) -> I {
        a.map(|x| One.shr::<BITS>(x))
    }
    #[inline(always)]
    fn sar<const BITS: i32>(self, a: I) -> I {
        a.map(|x| One.sar::<BITS>(x))
    }
    #[inline(always)]
    fn all(self, a: M) -> bool {
        a == [true; LANES]
    }
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

impl Simd for Scalar {
    const REGISTERS: Registers = Registers::Scalar;

    #[inline(always)]
    fn dot_bf16(self, acc: F, a: I, b: I) -> F {
        bf16::dot(self, acc, a, b)
    }
    #[inline(always)]
    fn dot_bytes(self, mut acc: I, a: I, b: I) -> I {
        for i in 0..LANES {
            for (a, b) in a[i].to_le_bytes().into_iter().zip(b[i].to_le_bytes()) {
                acc[i] = acc[i].wrapping_add(i32::from(a) * i32::from(b.cast_signed()));
            }
        }
        acc
    }
    #[inline(always)]
    fn dot_i16(self, a: I, b: I) -> I {
        let dot = |a: i32, b: i32| ((a << 16 >> 16) * (b << 16 >> 16)).wrapping_add((a >> 16) * (b >> 16));
        std::array::from_fn(|i| dot(a[i], b[i]))
    }
    #[inline(always)]
    fn split_bytes(self, a: I) -> [I; 2] {
        let pair = |low: i32, high: i32| (low & 0xffff) | high << 16;
        [a.map(|a| pair(a << 24 >> 24, a << 8 >> 24)), a.map(|a| pair(a << 16 >> 24, a >> 24))]
    }
    #[inline(always)]
    fn pairs_of_bf16(self, a: F, b: F) -> I {
        bf16::pairs_of_neighbours(self, a, b)
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
    fn from_array_i32(self, x: I) -> I {
        x
    }
    #[inline(always)]
    fn to_array_i32(self, a: I) -> I {
        a
    }
    #[inline(always)]
    fn mask_from_bits(self, bits: u16) -> M {
        std::array::from_fn(|i| bits >> i & 1 != 0)
    }
    #[inline(always)]
    fn bits(self, a: M) -> u16 {
        (0..LANES).fold(0, |bits, i| bits | (u16::from(a[i]) << i))
    }
    #[inline(always)]
    fn sum(self, a: F) -> f32 {
        fold(a, |a, b| a + b)
    }
    #[inline(always)]
    fn max_lane(self, a: F) -> f32 {
        fold(a, |a, b| if a > b { a } else { b })
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
}
