//! NEON: a logical vector is four 128-bit registers.

use core::arch::aarch64::*;

use super::bf16;
use super::elementwise::Elementwise;
use super::scalar::Scalar;
use super::vector::{LANES, Operation, Registers, Simd};

/// # Safety
/// The CPU has NEON.
#[target_feature(enable = "neon")]
pub(super) unsafe fn enter<O: Operation>(operation: O) -> O::Output {
    operation.run(Neon(()))
}

#[derive(Clone, Copy)]
pub(crate) struct Neon(());

/// Lanes 0–3, 4–7, 8–11, 12–15.
#[derive(Clone, Copy)]
pub(crate) struct F([float32x4_t; 4]);
/// Lanes 0–3, 4–7, 8–11, 12–15.
#[derive(Clone, Copy)]
pub(crate) struct I([int32x4_t; 4]);
/// All bits of a lane set or none.
#[derive(Clone, Copy)]
pub(crate) struct M([uint32x4_t; 4]);

/// The intrinsics in here are safe because a token of [`Neon`] exists only below [`enter`].
macro_rules! four {
    ($t:ident, $f:expr $(, $a:expr)+) => {
        // SAFETY: the token proves NEON.
        unsafe { $t([$f($($a.0[0]),+), $f($($a.0[1]),+), $f($($a.0[2]),+), $f($($a.0[3]),+)]) }
    };
}

/// Folds the lanes: `i` with `i+8`, `i+4`, `i+2`, `i+1`.
macro_rules! fold {
    ($a:expr, $op4:expr, $op2:expr) => {{
        let [a, b, c, d] = $a.0;
        let four = $op4($op4(a, c), $op4(b, d));
        let two = $op2(vget_low_f32(four), vget_high_f32(four));
        vget_lane_f32::<0>($op2(two, vdup_lane_f32::<1>(two)))
    }};
}

impl Elementwise for Neon {
    type F32 = F;
    type I32 = I;
    type Mask = M;

    #[inline(always)]
    fn map(self, a: F, f: impl Fn(f32) -> f32) -> F {
        self.from_array(self.to_array(a).map(f))
    }
    #[inline(always)]
    fn all(self, a: M) -> bool {
        self.bits(a) == u16::MAX
    }

    #[inline(always)]
    fn splat(self, x: f32) -> F {
        // SAFETY: the token proves NEON.
        F([unsafe { vdupq_n_f32(x) }; 4])
    }
    #[inline(always)]
    fn add(self, a: F, b: F) -> F {
        four!(F, vaddq_f32, a, b)
    }
    #[inline(always)]
    fn sub(self, a: F, b: F) -> F {
        four!(F, vsubq_f32, a, b)
    }
    #[inline(always)]
    fn mul(self, a: F, b: F) -> F {
        four!(F, vmulq_f32, a, b)
    }
    #[inline(always)]
    fn div(self, a: F, b: F) -> F {
        four!(F, vdivq_f32, a, b)
    }
    #[inline(always)]
    fn mul_add(self, a: F, b: F, c: F) -> F {
        four!(F, vfmaq_f32, c, a, b)
    }
    #[inline(always)]
    fn neg_mul_add(self, a: F, b: F, c: F) -> F {
        four!(F, vfmsq_f32, c, a, b)
    }
    #[inline(always)]
    fn min(self, a: F, b: F) -> F {
        self.select(self.lt(a, b), a, b)
    }
    #[inline(always)]
    fn max(self, a: F, b: F) -> F {
        self.select(self.lt(b, a), a, b)
    }
    #[inline(always)]
    fn sqrt(self, a: F) -> F {
        four!(F, vsqrtq_f32, a)
    }
    #[inline(always)]
    fn abs(self, a: F) -> F {
        four!(F, vabsq_f32, a)
    }
    #[inline(always)]
    fn neg(self, a: F) -> F {
        four!(F, vnegq_f32, a)
    }
    #[inline(always)]
    fn round(self, a: F) -> F {
        four!(F, vrndnq_f32, a)
    }
    #[inline(always)]
    fn floor(self, a: F) -> F {
        four!(F, vrndmq_f32, a)
    }
    #[inline(always)]
    fn lt(self, a: F, b: F) -> M {
        four!(M, vcltq_f32, a, b)
    }
    #[inline(always)]
    fn le(self, a: F, b: F) -> M {
        four!(M, vcleq_f32, a, b)
    }
    #[inline(always)]
    fn eq(self, a: F, b: F) -> M {
        four!(M, vceqq_f32, a, b)
    }
    #[inline(always)]
    fn select(self, mask: M, a: F, b: F) -> F {
        four!(F, vbslq_f32, mask, a, b)
    }
    #[inline(always)]
    fn splat_i32(self, x: i32) -> I {
        // SAFETY: the token proves NEON.
        I([unsafe { vdupq_n_s32(x) }; 4])
    }
    #[inline(always)]
    fn to_bits(self, a: F) -> I {
        four!(I, vreinterpretq_s32_f32, a)
    }
    #[inline(always)]
    fn from_bits(self, a: I) -> F {
        four!(F, vreinterpretq_f32_s32, a)
    }
    #[inline(always)]
    fn to_i32(self, a: F) -> I {
        four!(I, vcvtq_s32_f32, a)
    }
    #[inline(always)]
    fn to_f32(self, a: I) -> F {
        four!(F, vcvtq_f32_s32, a)
    }
    #[inline(always)]
    fn add_i32(self, a: I, b: I) -> I {
        four!(I, vaddq_s32, a, b)
    }
    #[inline(always)]
    fn sub_i32(self, a: I, b: I) -> I {
        four!(I, vsubq_s32, a, b)
    }
    #[inline(always)]
    fn and_i32(self, a: I, b: I) -> I {
        four!(I, vandq_s32, a, b)
    }
    #[inline(always)]
    fn or_i32(self, a: I, b: I) -> I {
        four!(I, vorrq_s32, a, b)
    }
    #[inline(always)]
    fn xor_i32(self, a: I, b: I) -> I {
        four!(I, veorq_s32, a, b)
    }
    #[inline(always)]
    fn shl<const BITS: i32>(self, a: I) -> I {
        let count = self.splat_i32(BITS);
        four!(I, vshlq_s32, a, count)
    }
    #[inline(always)]
    fn sar<const BITS: i32>(self, a: I) -> I {
        let count = self.splat_i32(-BITS);
        four!(I, vshlq_s32, a, count)
    }
    #[inline(always)]
    fn shr<const BITS: i32>(self, a: I) -> I {
        let count = self.splat_i32(-BITS);
        // SAFETY: the token proves NEON.
        let logical = |a, n| unsafe { vreinterpretq_s32_u32(vshlq_u32(vreinterpretq_u32_s32(a), n)) };
        let ([a0, a1, a2, a3], [n0, n1, n2, n3]) = (a.0, count.0);
        I([logical(a0, n0), logical(a1, n1), logical(a2, n2), logical(a3, n3)])
    }
    #[inline(always)]
    fn gt_i32(self, a: I, b: I) -> M {
        four!(M, vcgtq_s32, a, b)
    }
    #[inline(always)]
    fn max_i32(self, a: I, b: I) -> I {
        four!(I, vmaxq_s32, a, b)
    }
    #[inline(always)]
    fn eq_i32(self, a: I, b: I) -> M {
        four!(M, vceqq_s32, a, b)
    }
    #[inline(always)]
    fn select_i32(self, mask: M, a: I, b: I) -> I {
        four!(I, vbslq_s32, mask, a, b)
    }
    #[inline(always)]
    fn and(self, a: M, b: M) -> M {
        four!(M, vandq_u32, a, b)
    }
    #[inline(always)]
    fn or(self, a: M, b: M) -> M {
        four!(M, vorrq_u32, a, b)
    }
    #[inline(always)]
    fn not(self, a: M) -> M {
        four!(M, vmvnq_u32, a)
    }
}

impl Simd for Neon {
    const REGISTERS: Registers = Registers::Neon;

    #[inline(always)]
    fn dot_bf16(self, acc: F, a: I, b: I) -> F {
        bf16::dot(self, acc, a, b)
    }
    #[inline(always)]
    fn dot_bytes(self, acc: I, a: I, b: I) -> I {
        let [acc, a, b] = [acc, a, b].map(|x| self.to_array_i32(x));
        self.from_array_i32(Scalar.dot_bytes(acc, a, b))
    }
    #[inline(always)]
    fn pairs_of_bf16(self, a: F, b: F) -> I {
        bf16::pairs_of_neighbours(self, a, b)
    }
    #[inline(always)]
    fn dot_i16(self, a: I, b: I) -> I {
        self.from_array_i32(Scalar.dot_i16(self.to_array_i32(a), self.to_array_i32(b)))
    }
    #[inline(always)]
    fn split_bytes(self, a: I) -> [I; 2] {
        Scalar.split_bytes(self.to_array_i32(a)).map(|x| self.from_array_i32(x))
    }

    #[inline(always)]
    unsafe fn load_ptr(self, from: *const f32) -> F {
        // SAFETY: the caller's; the token proves NEON.
        unsafe { F([vld1q_f32(from), vld1q_f32(from.add(4)), vld1q_f32(from.add(8)), vld1q_f32(from.add(12))]) }
    }
    #[inline(always)]
    unsafe fn store_ptr(self, a: F, to: *mut f32) {
        // SAFETY: the caller's; the token proves NEON.
        unsafe {
            vst1q_f32(to, a.0[0]);
            vst1q_f32(to.add(4), a.0[1]);
            vst1q_f32(to.add(8), a.0[2]);
            vst1q_f32(to.add(12), a.0[3]);
        }
    }
    #[inline(always)]
    fn from_array(self, x: [f32; LANES]) -> F {
        // SAFETY: an array of 16 values.
        unsafe { self.load_ptr(x.as_ptr()) }
    }
    #[inline(always)]
    fn to_array(self, a: F) -> [f32; LANES] {
        let mut x = [0.0; LANES];
        // SAFETY: an array of 16 values.
        unsafe { self.store_ptr(a, x.as_mut_ptr()) };
        x
    }
    #[inline(always)]
    unsafe fn load_halves(self, low: *const f32, high: *const f32) -> F {
        // SAFETY: the caller's; the token proves NEON.
        unsafe { F([vld1q_f32(low), vld1q_f32(low.add(4)), vld1q_f32(high), vld1q_f32(high.add(4))]) }
    }
    #[inline(always)]
    fn load_u8(self, from: &[u8; LANES]) -> F {
        // SAFETY: an array of that many values; the token proves NEON.
        unsafe {
            let bytes = vld1q_u8(from.as_ptr());
            let [low, high] = [vmovl_u8(vget_low_u8(bytes)), vmovl_u8(vget_high_u8(bytes))];
            let numbers = |half| vcvtq_f32_u32(vmovl_u16(half));
            F([
                numbers(vget_low_u16(low)),
                numbers(vget_high_u16(low)),
                numbers(vget_low_u16(high)),
                numbers(vget_high_u16(high)),
            ])
        }
    }
    #[inline(always)]
    fn repeat_four(self, from: &[f32; 4]) -> F {
        // SAFETY: an array of that many values; the token proves NEON.
        F([unsafe { vld1q_f32(from.as_ptr()) }; 4])
    }
    #[inline(always)]
    fn spread_four(self, from: &[f32; 4]) -> F {
        // SAFETY: an array of that many values; the token proves NEON.
        unsafe {
            let v = vld1q_f32(from.as_ptr());
            F([vdupq_laneq_f32::<0>(v), vdupq_laneq_f32::<1>(v), vdupq_laneq_f32::<2>(v), vdupq_laneq_f32::<3>(v)])
        }
    }
    #[inline(always)]
    fn from_array_i32(self, x: [i32; LANES]) -> I {
        let p = x.as_ptr();
        // SAFETY: an array of 16 values; the token proves NEON.
        unsafe { I([vld1q_s32(p), vld1q_s32(p.add(4)), vld1q_s32(p.add(8)), vld1q_s32(p.add(12))]) }
    }
    #[inline(always)]
    fn to_array_i32(self, a: I) -> [i32; LANES] {
        let mut x = [0; LANES];
        for (i, v) in a.0.into_iter().enumerate() {
            // SAFETY: an array of 16 values; the token proves NEON.
            unsafe { vst1q_s32(x.as_mut_ptr().add(4 * i), v) };
        }
        x
    }
    #[inline(always)]
    fn bits(self, a: M) -> u16 {
        // SAFETY: the token proves NEON.
        unsafe {
            let narrow = |a, b| vcombine_u16(vmovn_u32(a), vmovn_u32(b));
            let weight = vld1q_u16([1, 2, 4, 8, 16, 32, 64, 128].as_ptr());
            let low = vaddvq_u16(vandq_u16(narrow(a.0[0], a.0[1]), weight));
            let high = vaddvq_u16(vandq_u16(narrow(a.0[2], a.0[3]), weight));
            low | high << 8
        }
    }
    #[inline(always)]
    fn mask_from_bits(self, bits: u16) -> M {
        let lane = self.from_array_i32(std::array::from_fn(|i| 1 << i));
        self.eq_i32(self.and_i32(self.splat_i32(i32::from(bits)), lane), lane)
    }
    #[inline(always)]
    fn sum(self, a: F) -> f32 {
        // SAFETY: the token proves NEON.
        unsafe { fold!(a, vaddq_f32, vadd_f32) }
    }
    #[inline(always)]
    fn max_lane(self, a: F) -> f32 {
        // SAFETY: the token proves NEON.
        unsafe {
            let larger4 = |a, b| vbslq_f32(vcgtq_f32(a, b), a, b);
            let larger2 = |a, b| vbsl_f32(vcgt_f32(a, b), a, b);
            fold!(a, larger4, larger2)
        }
    }
}
