//! AVX-512 (F, BW, DQ, VL): a logical vector is one 512-bit register.

use core::arch::x86_64::*;

use super::avx2::fold;
use super::bf16::{self, SMALLEST, round_bf16};
use super::elementwise::{Elementwise, SHIFTER};
use super::scalar::Scalar;
use super::vector::{LANES, Operation, Registers, Simd};

/// # Safety
/// The CPU has AVX2, FMA and AVX-512 F, BW, DQ and VL.
#[target_feature(enable = "avx2,fma,avx512f,avx512bw,avx512dq,avx512vl")]
pub(super) unsafe fn enter<O: Operation>(operation: O) -> O::Output {
    operation.run(Avx512::<false, false>(()))
}

/// [`enter`] with the dot products of bytes.
///
/// # Safety
/// As [`enter`], and the CPU has AVX-512 VNNI.
#[target_feature(enable = "avx2,fma,avx512f,avx512bw,avx512dq,avx512vl,avx512vnni")]
pub(super) unsafe fn enter_vnni<O: Operation>(operation: O) -> O::Output {
    operation.run(Avx512::<false, true>(()))
}

/// [`enter`] with the dot products of bytes and of bf16 pairs.
///
/// # Safety
/// As [`enter`], and the CPU has AVX-512 VNNI and BF16.
#[target_feature(enable = "avx2,fma,avx512f,avx512bw,avx512dq,avx512vl,avx512bf16,avx512vnni")]
pub(super) unsafe fn enter_bf16<O: Operation>(operation: O) -> O::Output {
    operation.run(Avx512::<true, true>(()))
}

/// With `BF16`, the CPU also has AVX-512 BF16, with `BYTES` AVX-512 VNNI.
#[derive(Clone, Copy)]
pub(crate) struct Avx512<const BF16: bool, const BYTES: bool>(());

type F = __m512;
type I = __m512i;
type M = __mmask16;

/// The intrinsics in here are safe because a token of [`Avx512`] exists only below [`enter`].
macro_rules! op {
    ($($call:tt)*) => {
        // SAFETY: the token proves AVX-512.
        unsafe { $($call)* }
    };
}

impl<const BF16: bool, const BYTES: bool> Elementwise for Avx512<BF16, BYTES> {
    type F32 = F;
    type I32 = I;
    type Mask = M;

    #[inline(always)]
    fn map(self, a: F, f: impl Fn(f32) -> f32) -> F {
        self.from_array(self.to_array(a).map(f))
    }
    #[inline(always)]
    fn all(self, a: M) -> bool {
        a == u16::MAX
    }
    #[inline(always)]
    fn splat(self, x: f32) -> F {
        op!(_mm512_set1_ps(x))
    }
    #[inline(always)]
    fn add(self, a: F, b: F) -> F {
        op!(_mm512_add_ps(a, b))
    }
    #[inline(always)]
    fn sub(self, a: F, b: F) -> F {
        op!(_mm512_sub_ps(a, b))
    }
    #[inline(always)]
    fn mul(self, a: F, b: F) -> F {
        op!(_mm512_mul_ps(a, b))
    }
    #[inline(always)]
    fn div(self, a: F, b: F) -> F {
        op!(_mm512_div_ps(a, b))
    }
    #[inline(always)]
    fn shifted_int(self, shifted: F) -> F {
        self.sub(shifted, self.splat(SHIFTER))
    }
    #[inline(always)]
    fn split_int_frac(self, t: F) -> (F, F) {
        let part = op!(_mm512_reduce_ps::<0>(t));
        (self.sub(t, part), part)
    }
    #[inline(always)]
    fn scale_by_pow2(self, p: F, whole: F) -> F {
        op!(_mm512_scalef_ps(p, whole))
    }
    #[inline(always)]
    fn scale_by_any_pow2(self, p: F, whole: F) -> F {
        op!(_mm512_scalef_ps(p, whole))
    }
    #[inline(always)]
    fn min(self, a: F, b: F) -> F {
        op!(_mm512_min_ps(a, b))
    }
    #[inline(always)]
    fn max(self, a: F, b: F) -> F {
        op!(_mm512_max_ps(a, b))
    }
    #[inline(always)]
    fn mul_add(self, a: F, b: F, c: F) -> F {
        op!(_mm512_fmadd_ps(a, b, c))
    }
    #[inline(always)]
    fn neg_mul_add(self, a: F, b: F, c: F) -> F {
        op!(_mm512_fnmadd_ps(a, b, c))
    }
    #[inline(always)]
    fn sqrt(self, a: F) -> F {
        op!(_mm512_sqrt_ps(a))
    }
    #[inline(always)]
    fn abs(self, a: F) -> F {
        op!(_mm512_abs_ps(a))
    }
    #[inline(always)]
    fn neg(self, a: F) -> F {
        self.from_bits(self.xor_i32(self.to_bits(a), self.splat_i32(i32::MIN)))
    }
    #[inline(always)]
    fn round(self, a: F) -> F {
        op!(_mm512_roundscale_ps::<{ _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC }>(a))
    }
    #[inline(always)]
    fn floor(self, a: F) -> F {
        op!(_mm512_roundscale_ps::<{ _MM_FROUND_TO_NEG_INF | _MM_FROUND_NO_EXC }>(a))
    }
    #[inline(always)]
    fn lt(self, a: F, b: F) -> M {
        op!(_mm512_cmp_ps_mask::<_CMP_LT_OQ>(a, b))
    }
    #[inline(always)]
    fn le(self, a: F, b: F) -> M {
        op!(_mm512_cmp_ps_mask::<_CMP_LE_OQ>(a, b))
    }
    #[inline(always)]
    fn eq(self, a: F, b: F) -> M {
        op!(_mm512_cmp_ps_mask::<_CMP_EQ_OQ>(a, b))
    }
    #[inline(always)]
    fn select(self, mask: M, a: F, b: F) -> F {
        op!(_mm512_mask_blend_ps(mask, b, a))
    }
    #[inline(always)]
    fn keep(self, mask: M, a: F) -> F {
        op!(_mm512_maskz_mov_ps(mask, a))
    }
    #[inline(always)]
    fn splat_i32(self, x: i32) -> I {
        op!(_mm512_set1_epi32(x))
    }
    #[inline(always)]
    fn to_bits(self, a: F) -> I {
        op!(_mm512_castps_si512(a))
    }
    #[inline(always)]
    fn from_bits(self, a: I) -> F {
        op!(_mm512_castsi512_ps(a))
    }
    #[inline(always)]
    fn to_i32(self, a: F) -> I {
        op!(_mm512_cvttps_epi32(a))
    }
    #[inline(always)]
    fn to_f32(self, a: I) -> F {
        op!(_mm512_cvtepi32_ps(a))
    }
    #[inline(always)]
    fn add_i32(self, a: I, b: I) -> I {
        op!(_mm512_add_epi32(a, b))
    }
    #[inline(always)]
    fn sub_i32(self, a: I, b: I) -> I {
        op!(_mm512_sub_epi32(a, b))
    }
    #[inline(always)]
    fn and_i32(self, a: I, b: I) -> I {
        op!(_mm512_and_si512(a, b))
    }
    #[inline(always)]
    fn or_i32(self, a: I, b: I) -> I {
        op!(_mm512_or_si512(a, b))
    }
    #[inline(always)]
    fn xor_i32(self, a: I, b: I) -> I {
        op!(_mm512_xor_si512(a, b))
    }
    #[inline(always)]
    fn shl<const BITS: i32>(self, a: I) -> I {
        op!(_mm512_sll_epi32(a, _mm_cvtsi32_si128(BITS)))
    }
    #[inline(always)]
    fn shr<const BITS: i32>(self, a: I) -> I {
        op!(_mm512_srl_epi32(a, _mm_cvtsi32_si128(BITS)))
    }
    #[inline(always)]
    fn sar<const BITS: i32>(self, a: I) -> I {
        op!(_mm512_sra_epi32(a, _mm_cvtsi32_si128(BITS)))
    }
    #[inline(always)]
    fn gt_i32(self, a: I, b: I) -> M {
        op!(_mm512_cmpgt_epi32_mask(a, b))
    }
    #[inline(always)]
    fn max_i32(self, a: I, b: I) -> I {
        op!(_mm512_max_epi32(a, b))
    }
    #[inline(always)]
    fn eq_i32(self, a: I, b: I) -> M {
        op!(_mm512_cmpeq_epi32_mask(a, b))
    }
    #[inline(always)]
    fn select_i32(self, mask: M, a: I, b: I) -> I {
        op!(_mm512_mask_blend_epi32(mask, b, a))
    }
    #[inline(always)]
    fn and(self, a: M, b: M) -> M {
        a & b
    }
    #[inline(always)]
    fn or(self, a: M, b: M) -> M {
        a | b
    }
    #[inline(always)]
    fn not(self, a: M) -> M {
        !a
    }
}

impl<const BF16: bool, const BYTES: bool> Simd for Avx512<BF16, BYTES> {
    const REGISTERS: Registers = Registers::Avx512;
    const BF16_DOT: bool = BF16;
    const BYTE_DOT: bool = BYTES;

    #[inline(always)]
    fn dot_bf16(self, acc: F, a: I, b: I) -> F {
        if BF16 {
            // SAFETY: the token proves AVX-512 BF16; both types are 512 bits without invalid values.
            unsafe {
                _mm512_dpbf16_ps(acc, std::mem::transmute::<I, __m512bh>(a), std::mem::transmute::<I, __m512bh>(b))
            }
        } else {
            bf16::dot(self, acc, a, b)
        }
    }
    #[inline(always)]
    fn dot_bytes(self, acc: I, a: I, b: I) -> I {
        if BYTES {
            op!(_mm512_dpbusd_epi32(acc, a, b))
        } else {
            let [acc, a, b] = [acc, a, b].map(|x| self.to_array_i32(x));
            self.from_array_i32(Scalar.dot_bytes(acc, a, b))
        }
    }
    #[inline(always)]
    fn pairs_of_bf16(self, a: F, b: F) -> I {
        if !BF16 {
            let (a, b) = (self.to_bits(round_bf16(self, a)), self.to_bits(round_bf16(self, b)));
            return op!({
                let even = _mm512_set_epi32(30, 28, 26, 24, 22, 20, 18, 16, 14, 12, 10, 8, 6, 4, 2, 0);
                let odd = _mm512_add_epi32(even, _mm512_set1_epi32(1));
                let (first, second) = (_mm512_permutex2var_epi32(a, even, b), _mm512_permutex2var_epi32(a, odd, b));
                _mm512_or_epi32(first, _mm512_srli_epi32::<16>(second))
            });
        }
        let least = self.splat(SMALLEST);
        // "Not below" keeps NaN.
        let (a, b) =
            (self.keep(self.not(self.lt(self.abs(a), least)), a), self.keep(self.not(self.lt(self.abs(b), least)), b));
        // SAFETY: the token proves AVX-512 BF16; both types are 512 bits without invalid values.
        unsafe { _mm512_rol_epi32::<16>(std::mem::transmute::<__m512bh, I>(_mm512_cvtne2ps_pbh(b, a))) }
    }
    #[inline(always)]
    fn low_bytes(self, a: I) -> [u8; LANES] {
        let mut bytes = [0; LANES];
        op!(_mm_storeu_si128(bytes.as_mut_ptr().cast(), _mm512_cvtepi32_epi8(a)));
        bytes
    }
    #[inline(always)]
    fn split_bytes(self, a: I) -> [I; 2] {
        op!([_mm512_srai_epi16::<8>(_mm512_slli_epi16::<8>(a)), _mm512_srai_epi16::<8>(a)])
    }
    #[inline(always)]
    fn dot_i16(self, a: I, b: I) -> I {
        op!(_mm512_madd_epi16(a, b))
    }
    #[inline(always)]
    unsafe fn load_ptr(self, from: *const f32) -> F {
        // SAFETY: the caller's; the token proves AVX-512.
        unsafe { _mm512_loadu_ps(from) }
    }
    #[inline(always)]
    unsafe fn store_ptr(self, a: F, to: *mut f32) {
        // SAFETY: the caller's; the token proves AVX-512.
        unsafe { _mm512_storeu_ps(to, a) }
    }
    #[inline(always)]
    fn load_u8(self, from: &[u8; LANES]) -> F {
        // SAFETY: an array of that many values; the token proves AVX-512.
        unsafe { _mm512_cvtepi32_ps(_mm512_cvtepu8_epi32(_mm_loadu_si128(from.as_ptr().cast()))) }
    }
    #[inline(always)]
    fn from_array(self, x: [f32; LANES]) -> F {
        op!(_mm512_loadu_ps(x.as_ptr()))
    }
    #[inline(always)]
    fn to_array(self, a: F) -> [f32; LANES] {
        let mut x = [0.0; LANES];
        op!(_mm512_storeu_ps(x.as_mut_ptr(), a));
        x
    }
    #[inline(always)]
    unsafe fn load_halves(self, low: *const f32, high: *const f32) -> F {
        // SAFETY: the caller's; the token proves AVX-512.
        unsafe { _mm512_insertf32x8::<1>(_mm512_castps256_ps512(_mm256_loadu_ps(low)), _mm256_loadu_ps(high)) }
    }
    #[inline(always)]
    unsafe fn gather_fours(self, from: *const f32, places: &[u32; LANES]) -> [F; 4] {
        // SAFETY: the caller's; the token proves AVX-512.
        unsafe {
            // Lanes i, 4 + i, 8 + i and 12 + i, so that transposing each 4×4 values puts all lanes in order.
            let mut lanes = [_mm512_setzero_ps(); 4];
            for i in 0..4 {
                let four = [i, 4 + i, 8 + i, 12 + i].map(|lane| from.add(places[lane] as usize));
                let low = _mm512_castps128_ps512(_mm_loadu_ps(four[0]));
                let low = _mm512_insertf32x4::<1>(low, _mm_loadu_ps(four[1]));
                let low = _mm512_insertf32x4::<2>(low, _mm_loadu_ps(four[2]));
                lanes[i] = _mm512_insertf32x4::<3>(low, _mm_loadu_ps(four[3]));
            }
            let [a, b, c, d] = lanes;
            let (ab, cd) = (_mm512_unpacklo_ps(a, b), _mm512_unpacklo_ps(c, d));
            let (ab_high, cd_high) = (_mm512_unpackhi_ps(a, b), _mm512_unpackhi_ps(c, d));
            [
                _mm512_shuffle_ps::<0x44>(ab, cd),
                _mm512_shuffle_ps::<0xee>(ab, cd),
                _mm512_shuffle_ps::<0x44>(ab_high, cd_high),
                _mm512_shuffle_ps::<0xee>(ab_high, cd_high),
            ]
        }
    }
    #[inline(always)]
    fn repeat_four(self, from: &[f32; 4]) -> F {
        // SAFETY: an array of that many values; the token proves AVX-512.
        unsafe { _mm512_broadcast_f32x4(_mm_loadu_ps(from.as_ptr())) }
    }
    #[inline(always)]
    fn spread_four(self, from: &[f32; 4]) -> F {
        // SAFETY: an array of that many values; the token proves AVX-512.
        unsafe {
            let lanes = _mm512_setr_epi32(0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3);
            _mm512_permutexvar_ps(lanes, _mm512_castps128_ps512(_mm_loadu_ps(from.as_ptr())))
        }
    }
    #[inline(always)]
    fn from_array_i32(self, x: [i32; LANES]) -> I {
        op!(_mm512_loadu_si512(x.as_ptr().cast()))
    }
    #[inline(always)]
    fn to_array_i32(self, a: I) -> [i32; LANES] {
        let mut x = [0; LANES];
        op!(_mm512_storeu_si512(x.as_mut_ptr().cast(), a));
        x
    }
    #[inline(always)]
    fn bits(self, a: M) -> u16 {
        a
    }
    #[inline(always)]
    fn mask_from_bits(self, bits: u16) -> M {
        bits
    }
    #[inline(always)]
    fn sum(self, a: F) -> f32 {
        op!(fold!(_mm256_add_ps(_mm512_castps512_ps256(a), _mm512_extractf32x8_ps::<1>(a)), _mm_add_ps, _mm_add_ss))
    }
    #[inline(always)]
    fn max_lane(self, a: F) -> f32 {
        op!(fold!(_mm256_max_ps(_mm512_castps512_ps256(a), _mm512_extractf32x8_ps::<1>(a)), _mm_max_ps, _mm_max_ss))
    }
}
