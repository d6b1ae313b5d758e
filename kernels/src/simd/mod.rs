//! One vector of 16 lanes on every instruction-set level; the home of intrinsics.
//!
//! A kernel is written once, generic over [`Simd`], and entered through [`dispatch`]. Every operation is defined to the
//! bit, so a kernel that uses nothing else gives equal bits on every level:
//!
//! - arithmetic is IEEE 754 binary32, round to nearest even, denormals kept; [`Simd::mul_add`] rounds once everywhere,
//!   [`Simd::mul`] and [`Simd::add`] are never fused;
//! - [`Simd::min`] and [`Simd::max`] are comparisons followed by a selection: where either operand is NaN, or both are
//!   zeros, the *second* operand is the result;
//! - [`Simd::sum`] and [`Simd::max_lane`] fold lanes `i` and `i+8`, then `i` and `i+4`, `i+2`, `i+1`;
//! - the bits of a NaN *result* are the only thing left open; kernels keep NaN out of what they store.
//!
//! Inside a parallel task call [`dispatch`] again: a closure handed to another thread leaves the instruction-set context.

#![expect(unsafe_code, reason = "the home of intrinsics")]

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod dot;
#[cfg(target_arch = "aarch64")]
mod neon;
mod scalar;
mod transpose;

pub use scalar::fused_mul_add;
pub(crate) use transpose::{transpose2, transpose4};

use crate::level::{Kind, Level};

/// Added to a float below 2²² in magnitude, leaves its nearest integer in the low bits: 1.5 · 2²³.
pub(crate) const SHIFTER: f32 = 12_582_912.0;

/// Lanes of the logical vector.
pub const LANES: usize = 16;

/// A zero-size proof that the CPU has a level, and that level's operations on vectors of [`LANES`] lanes.
///
/// All methods are inlined; call them only below [`dispatch`].
pub trait Simd: Copy + Send + Sync + 'static {
    /// Sixteen `f32`.
    type F32: Copy + Send + Sync;
    /// Sixteen `i32`.
    type I32: Copy + Send + Sync;
    /// Sixteen truth values.
    type Mask: Copy + Send + Sync;

    /// Rows of the register block that fills this level's registers in a matrix product, with
    /// [`Simd::GEMM_PANELS`] vectors of columns.
    const GEMM_ROWS: usize;
    /// Vectors of columns of the register block of a matrix product.
    const GEMM_PANELS: usize;

    /// True if [`Simd::dot_bf16`] is a single instruction. See [`dispatch_dot`].
    const BF16_DOT: bool = false;
    /// True if [`Simd::dot_bytes`] is a single instruction.
    const BYTE_DOT: bool = false;

    /// `acc + a₁b₁ + a₀b₀` in every lane for pairs of bf16: a fused step of the high halves, then one of the low halves.
    ///
    /// Precondition: every bf16 is zero, infinite, NaN or at least 2⁻⁵⁶ in magnitude, and `acc` is +0 or the result of such
    /// steps. Then no step is near the denormal numbers, where the instruction departs from a fused multiply-add.
    #[inline(always)]
    fn dot_bf16(self, acc: Self::F32, a: Self::I32, b: Self::I32) -> Self::F32 {
        dot::bf16(self, acc, a, b)
    }
    /// `acc + Σ a·b` in every lane for four unsigned bytes `a` and four signed bytes `b`, wrapping.
    #[inline(always)]
    fn dot_bytes(self, acc: Self::I32, a: Self::I32, b: Self::I32) -> Self::I32 {
        dot::bytes(self, acc, a, b)
    }
    /// The signed bytes 0 and 2, and the signed bytes 1 and 3, of every lane as pairs of i16.
    #[inline(always)]
    fn split_bytes(self, a: Self::I32) -> [Self::I32; 2] {
        dot::split_bytes(self, a)
    }
    /// `a₀b₀ + a₁b₁` in every lane for pairs of i16, wrapping.
    #[inline(always)]
    fn dot_i16(self, a: Self::I32, b: Self::I32) -> Self::I32 {
        dot::i16s(self, a, b)
    }

    /// 32 values rounded to bf16, in pairs of neighbours, the earlier in the high half: those of `a`, then those of `b`. Magnitudes below
    /// 2⁻⁵⁶ become 0.
    #[inline(always)]
    fn pairs_of_bf16(self, a: Self::F32, b: Self::F32) -> Self::I32 {
        dot::pairs_of_bf16(self, a, b)
    }
    /// Integer `n` in the form that [`Simd::times_power`] takes, from `shifted`, the rounding constant of the shift trick (1.5·2²³) plus `n`.
    #[inline(always)]
    fn whole(self, shifted: Self::F32) -> Self::F32 {
        shifted
    }
    /// The integer nearest to `t` (ties to even) as [`Simd::times_power`] takes it, and `t` less that integer, for |t| < 2²².
    #[inline(always)]
    fn whole_and_part(self, t: Self::F32) -> (Self::F32, Self::F32) {
        let shifter = self.splat(SHIFTER);
        let shifted = self.add(t, shifter);
        (self.whole(shifted), self.sub(t, self.sub(shifted, shifter)))
    }
    /// `p · 2ⁿ`, where `p` and the result are normal numbers.
    #[inline(always)]
    fn times_power(self, p: Self::F32, whole: Self::F32) -> Self::F32 {
        // The integer, moved to the exponent; what lies above falls off.
        self.from_bits(self.add_i32(self.to_bits(p), self.shl::<23>(self.to_bits(whole))))
    }
    /// `p · 2ⁿ` for −252 ≤ `n` ≤ 254, rounded once, where `p·2^⌊n/2⌋` is a normal number or `p` is none.
    #[inline(always)]
    fn times_any_power(self, p: Self::F32, whole: Self::F32) -> Self::F32 {
        let n = self.sub_i32(self.to_bits(whole), self.splat_i32(SHIFTER.to_bits().cast_signed()));
        let half = self.sar::<1>(n);
        let bias = self.splat_i32(127);
        let a = self.from_bits(self.shl::<23>(self.add_i32(half, bias)));
        let b = self.from_bits(self.shl::<23>(self.add_i32(self.sub_i32(n, half), bias)));
        self.mul(self.mul(p, a), b)
    }
    /// The lowest byte of every lane.
    #[inline(always)]
    fn low_bytes(self, a: Self::I32) -> [u8; LANES] {
        let a = self.to_array_i32(a);
        let mut bytes = [0; LANES];
        for i in 0..LANES {
            bytes[i] = a[i] as u8;
        }
        bytes
    }

    /// The level of this token.
    fn level(self) -> Level;

    /// All lanes `x`.
    fn splat(self, x: f32) -> Self::F32;
    /// Lanes from 16 values.
    fn from_array(self, x: [f32; LANES]) -> Self::F32;
    /// The 16 values.
    fn to_array(self, a: Self::F32) -> [f32; LANES];

    /// Reads 16 values.
    ///
    /// # Safety
    /// `from` is readable for 16 values; no alignment is needed.
    unsafe fn load_ptr(self, from: *const f32) -> Self::F32;
    /// Writes 16 values.
    ///
    /// # Safety
    /// `to` is writable for 16 values; no alignment is needed.
    unsafe fn store_ptr(self, a: Self::F32, to: *mut f32);

    /// Reads 16 halfwords as numbers from 0 to 65,535.
    ///
    /// # Safety
    /// `from` is readable for 16 halfwords; no alignment is needed.
    #[inline(always)]
    unsafe fn load_u16(self, from: *const u16) -> Self::F32 {
        // SAFETY: the caller's.
        let halfwords = unsafe { from.cast::<[u16; LANES]>().read_unaligned() };
        self.from_array(halfwords.map(f32::from))
    }
    /// Writes 16 integers as halfwords. Precondition: they are 0 to 65,535.
    ///
    /// # Safety
    /// `to` is writable for 16 halfwords; no alignment is needed.
    #[inline(always)]
    unsafe fn store_u16(self, a: Self::I32, to: *mut u16) {
        let halfwords = self.to_array_i32(a).map(|x| x as u16);
        // SAFETY: the caller's.
        unsafe { to.cast::<[u16; LANES]>().write_unaligned(halfwords) }
    }

    /// The first 16 values of a slice. Panics on a shorter one.
    #[inline(always)]
    fn load(self, from: &[f32]) -> Self::F32 {
        let from = &from[..LANES];
        // SAFETY: the slice holds 16 values.
        unsafe { self.load_ptr(from.as_ptr()) }
    }
    /// Writes the first 16 values of a slice. Panics on a shorter one.
    #[inline(always)]
    fn store(self, a: Self::F32, to: &mut [f32]) {
        let to = &mut to[..LANES];
        // SAFETY: the slice holds 16 values.
        unsafe { self.store_ptr(a, to.as_mut_ptr()) }
    }
    /// Up to 16 values; lanes past the end of the slice hold `fill`.
    #[inline(always)]
    fn load_partial(self, from: &[f32], fill: f32) -> Self::F32 {
        if from.len() >= LANES {
            return self.load(from);
        }
        let mut all = [fill; LANES];
        all[..from.len()].copy_from_slice(from);
        self.from_array(all)
    }
    /// Writes as many lanes as the slice takes, at most 16.
    #[inline(always)]
    fn store_partial(self, a: Self::F32, to: &mut [f32]) {
        if to.len() >= LANES {
            return self.store(a, to);
        }
        let all = self.to_array(a);
        to.copy_from_slice(&all[..to.len()]);
    }

    /// Four values, four times over: lane `i` is value `i mod 4`.
    ///
    /// # Safety
    /// `from` is readable for four values.
    #[inline(always)]
    unsafe fn repeat_four(self, from: *const f32) -> Self::F32 {
        // SAFETY: the caller's.
        let four = unsafe { from.cast::<[f32; 4]>().read_unaligned() };
        self.from_array(std::array::from_fn(|i| four[i % 4]))
    }
    /// Each of four values on four lanes: lane `i` is value `i / 4`.
    ///
    /// # Safety
    /// `from` is readable for four values.
    #[inline(always)]
    unsafe fn spread_four(self, from: *const f32) -> Self::F32 {
        // SAFETY: the caller's.
        let four = unsafe { from.cast::<[f32; 4]>().read_unaligned() };
        self.from_array(std::array::from_fn(|i| four[i / 4]))
    }
    /// Eight values on lanes 0–7, eight others on lanes 8–15.
    ///
    /// # Safety
    /// Both are readable for eight values; no alignment is needed.
    #[inline(always)]
    unsafe fn load_halves(self, low: *const f32, high: *const f32) -> Self::F32 {
        let mut all = [0.0; LANES];
        // SAFETY: the caller's.
        let (low, high) =
            unsafe { (low.cast::<[f32; 8]>().read_unaligned(), high.cast::<[f32; 8]>().read_unaligned()) };
        all[..8].copy_from_slice(&low);
        all[8..].copy_from_slice(&high);
        self.from_array(all)
    }
    /// Hints that the cache line at `at` is read soon. Any address is allowed.
    #[inline(always)]
    fn prefetch<T>(self, at: *const T) {
        let _ = at;
    }

    /// `a + b`
    fn add(self, a: Self::F32, b: Self::F32) -> Self::F32;
    /// `a − b`
    fn sub(self, a: Self::F32, b: Self::F32) -> Self::F32;
    /// `a · b`
    fn mul(self, a: Self::F32, b: Self::F32) -> Self::F32;
    /// `a / b`
    fn div(self, a: Self::F32, b: Self::F32) -> Self::F32;
    /// `a·b + c`, rounded once.
    fn mul_add(self, a: Self::F32, b: Self::F32, c: Self::F32) -> Self::F32;
    /// `c − a·b`, rounded once.
    fn neg_mul_add(self, a: Self::F32, b: Self::F32, c: Self::F32) -> Self::F32;
    /// `a < b ? a : b`
    fn min(self, a: Self::F32, b: Self::F32) -> Self::F32;
    /// `a > b ? a : b`
    fn max(self, a: Self::F32, b: Self::F32) -> Self::F32;
    /// The square root, correctly rounded.
    fn sqrt(self, a: Self::F32) -> Self::F32;
    /// `|a|`
    fn abs(self, a: Self::F32) -> Self::F32;
    /// `−a`
    fn neg(self, a: Self::F32) -> Self::F32;
    /// The nearest integer, ties to even.
    fn round(self, a: Self::F32) -> Self::F32;
    /// The largest integer not above `a`.
    fn floor(self, a: Self::F32) -> Self::F32;

    /// `a < b`; false with NaN.
    fn lt(self, a: Self::F32, b: Self::F32) -> Self::Mask;
    /// `a ≤ b`; false with NaN.
    fn le(self, a: Self::F32, b: Self::F32) -> Self::Mask;
    /// `a = b`; false with NaN.
    fn eq(self, a: Self::F32, b: Self::F32) -> Self::Mask;
    /// `mask ? a : b`
    fn select(self, mask: Self::Mask, a: Self::F32, b: Self::F32) -> Self::F32;
    /// `mask ? a : +0`
    #[inline(always)]
    fn keep(self, mask: Self::Mask, a: Self::F32) -> Self::F32 {
        self.select(mask, a, self.splat(0.0))
    }

    /// All lanes `x`.
    fn splat_i32(self, x: i32) -> Self::I32;
    /// Lanes from 16 values.
    fn from_array_i32(self, x: [i32; LANES]) -> Self::I32;
    /// The 16 values.
    fn to_array_i32(self, a: Self::I32) -> [i32; LANES];
    /// The bits of the lanes.
    fn to_bits(self, a: Self::F32) -> Self::I32;
    /// Lanes from their bits.
    fn from_bits(self, a: Self::I32) -> Self::F32;
    /// Lanes to integers, rounding toward zero. Precondition: |a| < 2³¹ (other values give any bits).
    fn to_i32(self, a: Self::F32) -> Self::I32;
    /// Integers to lanes, rounded to nearest even.
    fn to_f32(self, a: Self::I32) -> Self::F32;
    /// `a + b`, wrapping.
    fn add_i32(self, a: Self::I32, b: Self::I32) -> Self::I32;
    /// `a − b`, wrapping.
    fn sub_i32(self, a: Self::I32, b: Self::I32) -> Self::I32;
    /// The bits of both.
    fn and_i32(self, a: Self::I32, b: Self::I32) -> Self::I32;
    /// The bits of either.
    fn or_i32(self, a: Self::I32, b: Self::I32) -> Self::I32;
    /// The bits of exactly one.
    fn xor_i32(self, a: Self::I32, b: Self::I32) -> Self::I32;
    /// Shift left by `BITS`.
    fn shl<const BITS: i32>(self, a: Self::I32) -> Self::I32;
    /// Shift right by `BITS`, zeros from the left.
    fn shr<const BITS: i32>(self, a: Self::I32) -> Self::I32;
    /// Shift right by `BITS`, the sign from the left.
    fn sar<const BITS: i32>(self, a: Self::I32) -> Self::I32;
    /// `a > b`, signed.
    fn gt_i32(self, a: Self::I32, b: Self::I32) -> Self::Mask;
    /// The larger of both, signed.
    #[inline(always)]
    fn max_i32(self, a: Self::I32, b: Self::I32) -> Self::I32 {
        self.select_i32(self.gt_i32(a, b), a, b)
    }
    /// `a = b`
    fn eq_i32(self, a: Self::I32, b: Self::I32) -> Self::Mask;
    /// `mask ? a : b`
    fn select_i32(self, mask: Self::Mask, a: Self::I32, b: Self::I32) -> Self::I32;

    /// Both.
    fn and(self, a: Self::Mask, b: Self::Mask) -> Self::Mask;
    /// Either.
    fn or(self, a: Self::Mask, b: Self::Mask) -> Self::Mask;
    /// The opposite.
    fn not(self, a: Self::Mask) -> Self::Mask;
    /// Bit `i` is lane `i`.
    fn bits(self, a: Self::Mask) -> u16;
    /// Lane `i` is bit `i`.
    fn mask_from_bits(self, bits: u16) -> Self::Mask;
    /// Returns true if any lane is true.
    #[inline(always)]
    fn any(self, a: Self::Mask) -> bool {
        self.bits(a) != 0
    }
    /// Returns true if all lanes are true.
    #[inline(always)]
    fn all(self, a: Self::Mask) -> bool {
        self.bits(a) == u16::MAX
    }

    /// The sum of the lanes: `i` with `i+8`, then `i+4`, `i+2`, `i+1`.
    fn sum(self, a: Self::F32) -> f32;
    /// The largest lane, folded like [`Simd::sum`] with [`Simd::max`].
    fn max_lane(self, a: Self::F32) -> f32;
}

/// Asks for the cache line at `at`, to be read soon. A hint: nothing is read through the pointer, which may be any.
#[inline(always)]
pub fn prefetch<T>(at: *const T) {
    #[cfg(all(target_arch = "x86_64", not(miri)))]
    // SAFETY: every x86-64 CPU has the instruction, and it faults on no address.
    unsafe {
        core::arch::x86_64::_mm_prefetch::<{ core::arch::x86_64::_MM_HINT_T1 }>(at.cast());
    }
    #[cfg(any(not(target_arch = "x86_64"), miri))]
    let _ = at;
}

/// The same pointer, of which the compiler knows nothing: a second read through it stays a read.
///
/// Where a register block fills all registers, reading an operand again from the nearest cache is cheaper than keeping it.
#[inline(always)]
pub(crate) fn again<T>(mut at: *const T) -> *const T {
    #[cfg(all(any(target_arch = "x86_64", target_arch = "aarch64"), not(miri)))]
    #[expect(clippy::pointers_in_nomem_asm_block, reason = "nothing is read or written through it there")]
    // SAFETY: no instruction at all.
    unsafe {
        core::arch::asm!("/* {0} */", inout(reg) at, options(pure, nomem, nostack, preserves_flags));
    }
    #[cfg(any(not(any(target_arch = "x86_64", target_arch = "aarch64")), miri))]
    let _ = &mut at;
    at
}

/// A computation that can be entered on any level.
///
/// `run` and everything it calls should be `#[inline(always)]`, so that all of it is compiled for the level.
pub trait Operation {
    /// Result of the computation.
    type Output;
    /// The computation.
    fn run<S: Simd>(self, s: S) -> Self::Output;
}

/// Runs `operation` with the token of `level`, compiled for that level's instructions.
#[inline]
pub fn dispatch<O: Operation>(level: Level, operation: O) -> O::Output {
    match level.0 {
        Kind::Scalar => operation.run(scalar::Scalar),
        #[cfg(target_arch = "x86_64")]
        // SAFETY: a `Level` proves that the CPU has its instructions.
        Kind::Avx2 => unsafe { avx2::enter(operation) },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: a `Level` proves that the CPU has its instructions.
        Kind::Avx512 => unsafe { avx512::enter(operation) },
        #[cfg(target_arch = "aarch64")]
        // SAFETY: a `Level` proves that the CPU has its instructions.
        Kind::Neon => unsafe { neon::enter(operation) },
    }
}

/// [`dispatch`], with the dot products of the lower precisions as instructions where the CPU has them and they are no loss.
///
/// They are a capability beside the level: before the first use they have to reproduce known answers, and a CPU whose
/// instructions do not is served by the plain operations, with the same bits.
#[inline]
pub fn dispatch_dot<O: Operation>(level: Level, operation: O) -> O::Output {
    #[cfg(target_arch = "x86_64")]
    if level.0 == Kind::Avx512 {
        match avx512::Dots::detect() {
            // SAFETY: the level and the check prove that the CPU has the instructions.
            avx512::Dots::All => return unsafe { avx512::enter_dot(operation) },
            // SAFETY: as above.
            avx512::Dots::Bytes => return unsafe { avx512::enter_bytes(operation) },
            avx512::Dots::None => {}
        }
    }
    dispatch(level, operation)
}

/// A set of dot products that [`dispatch_dot`] can be asked to use.
#[cfg(test)]
#[derive(Clone, Copy, Debug)]
pub(crate) struct DotProducts(#[cfg(target_arch = "x86_64")] avx512::Dots);

#[cfg(test)]
impl DotProducts {
    /// The sets that the CPU has at a level.
    pub(crate) fn available(level: Level) -> Vec<Self> {
        #[cfg(target_arch = "x86_64")]
        if level.0 == Kind::Avx512 {
            return avx512::Dots::available().into_iter().map(Self).collect();
        }
        let _ = level;
        Vec::new()
    }

    /// Lets this thread use this set from now on: what one call has packed, the next has to read.
    pub(crate) fn use_in_this_thread(self) {
        #[cfg(target_arch = "x86_64")]
        avx512::ASKED.set(Some(self.0));
    }
}

#[cfg(test)]
mod tests;
