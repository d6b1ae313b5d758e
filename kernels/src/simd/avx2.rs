//! AVX2 with FMA: a logical vector is two 256-bit registers.

use core::arch::x86_64::*;

use super::bf16;
use super::elementwise::Elementwise;
use super::scalar::Scalar;
use super::vector::{LANES, Operation, Registers, Simd};

/// # Safety
/// The CPU has AVX2 and FMA.
#[target_feature(enable = "avx2,fma")]
pub(super) unsafe fn enter<O: Operation>(operation: O) -> O::Output {
    operation.run(Avx2(()))
}

#[derive(Clone, Copy)]
pub(crate) struct Avx2(());

/// Lanes 0–7 and 8–15.
#[derive(Clone, Copy)]
pub(crate) struct F(__m256, __m256);
/// Lanes 0–7 and 8–15; also a mask, all bits of a lane set or none.
#[derive(Clone, Copy)]
pub(crate) struct I(__m256i, __m256i);

/// The intrinsics in here are safe because a token of [`Avx2`] exists only below [`enter`].
macro_rules! both {
    ($t:ident, $f:expr, $a:expr) => {
        // SAFETY: the token proves AVX2 and FMA.
        unsafe { $t($f($a.0), $f($a.1)) }
    };
    ($t:ident, $f:expr, $a:expr, $b:expr) => {
        // SAFETY: the token proves AVX2 and FMA.
        unsafe { $t($f($a.0, $b.0), $f($a.1, $b.1)) }
    };
    ($t:ident, $f:expr, $a:expr, $b:expr, $c:expr) => {
        // SAFETY: the token proves AVX2 and FMA.
        unsafe { $t($f($a.0, $b.0, $c.0), $f($a.1, $b.1, $c.1)) }
    };
}

/// Folds eight lanes: `i` with `i+4`, `i+2`, `i+1`.
macro_rules! fold {
    ($v:expr, $op4:ident, $op1:ident) => {{
        let v = $v;
        let four = $op4(_mm256_castps256_ps128(v), _mm256_extractf128_ps::<1>(v));
        let two = $op4(four, _mm_movehl_ps(four, four));
        _mm_cvtss_f32($op1(two, _mm_movehdup_ps(two)))
    }};
}
pub(super) use fold;

impl Elementwise for Avx2 {
    type F32 = F;
    type I32 = I;
    type Mask = I;

    #[inline(always)]
    fn map(self, a: F, f: impl Fn(f32) -> f32) -> F {
        self.from_array(self.to_array(a).map(f))
    }

    #[inline(always)]
    fn splat(self, x: f32) -> F {
        // SAFETY: the token proves AVX2.
        let v = unsafe { _mm256_set1_ps(x) };
        F(v, v)
    }
    #[inline(always)]
    fn add(self, a: F, b: F) -> F {
        both!(F, _mm256_add_ps, a, b)
    }
    #[inline(always)]
    fn sub(self, a: F, b: F) -> F {
        both!(F, _mm256_sub_ps, a, b)
    }
    #[inline(always)]
    fn mul(self, a: F, b: F) -> F {
        both!(F, _mm256_mul_ps, a, b)
    }
    #[inline(always)]
    fn div(self, a: F, b: F) -> F {
        both!(F, _mm256_div_ps, a, b)
    }
    #[inline(always)]
    fn min(self, a: F, b: F) -> F {
        both!(F, _mm256_min_ps, a, b)
    }
    #[inline(always)]
    fn max(self, a: F, b: F) -> F {
        both!(F, _mm256_max_ps, a, b)
    }
    #[inline(always)]
    fn mul_add(self, a: F, b: F, c: F) -> F {
        both!(F, _mm256_fmadd_ps, a, b, c)
    }
    #[inline(always)]
    fn neg_mul_add(self, a: F, b: F, c: F) -> F {
        both!(F, _mm256_fnmadd_ps, a, b, c)
    }
    #[inline(always)]
    fn sqrt(self, a: F) -> F {
        both!(F, _mm256_sqrt_ps, a)
    }
    #[inline(always)]
    fn abs(self, a: F) -> F {
        self.from_bits(self.and_i32(self.to_bits(a), self.splat_i32(i32::MAX)))
    }
    #[inline(always)]
    fn neg(self, a: F) -> F {
        self.from_bits(self.xor_i32(self.to_bits(a), self.splat_i32(i32::MIN)))
    }
    #[inline(always)]
    fn round(self, a: F) -> F {
        both!(F, _mm256_round_ps::<{ _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC }>, a)
    }
    #[inline(always)]
    fn floor(self, a: F) -> F {
        both!(F, _mm256_round_ps::<{ _MM_FROUND_TO_NEG_INF | _MM_FROUND_NO_EXC }>, a)
    }
    #[inline(always)]
    fn lt(self, a: F, b: F) -> I {
        let m = both!(F, _mm256_cmp_ps::<_CMP_LT_OQ>, a, b);
        self.to_bits(m)
    }
    #[inline(always)]
    fn le(self, a: F, b: F) -> I {
        let m = both!(F, _mm256_cmp_ps::<_CMP_LE_OQ>, a, b);
        self.to_bits(m)
    }
    #[inline(always)]
    fn eq(self, a: F, b: F) -> I {
        let m = both!(F, _mm256_cmp_ps::<_CMP_EQ_OQ>, a, b);
        self.to_bits(m)
    }
    #[inline(always)]
    fn select(self, mask: I, a: F, b: F) -> F {
        let m = self.from_bits(mask);
        both!(F, _mm256_blendv_ps, b, a, m)
    }
    #[inline(always)]
    fn keep(self, mask: I, a: F) -> F {
        let m = self.from_bits(mask);
        both!(F, _mm256_and_ps, a, m)
    }
    #[inline(always)]
    fn splat_i32(self, x: i32) -> I {
        // SAFETY: the token proves AVX2.
        let v = unsafe { _mm256_set1_epi32(x) };
        I(v, v)
    }
    #[inline(always)]
    fn to_bits(self, a: F) -> I {
        both!(I, _mm256_castps_si256, a)
    }
    #[inline(always)]
    fn from_bits(self, a: I) -> F {
        both!(F, _mm256_castsi256_ps, a)
    }
    #[inline(always)]
    fn to_i32(self, a: F) -> I {
        both!(I, _mm256_cvttps_epi32, a)
    }
    #[inline(always)]
    fn to_f32(self, a: I) -> F {
        both!(F, _mm256_cvtepi32_ps, a)
    }
    #[inline(always)]
    fn add_i32(self, a: I, b: I) -> I {
        both!(I, _mm256_add_epi32, a, b)
    }
    #[inline(always)]
    fn sub_i32(self, a: I, b: I) -> I {
        both!(I, _mm256_sub_epi32, a, b)
    }
    #[inline(always)]
    fn and_i32(self, a: I, b: I) -> I {
        both!(I, _mm256_and_si256, a, b)
    }
    #[inline(always)]
    fn or_i32(self, a: I, b: I) -> I {
        both!(I, _mm256_or_si256, a, b)
    }
    #[inline(always)]
    fn xor_i32(self, a: I, b: I) -> I {
        both!(I, _mm256_xor_si256, a, b)
    }
    #[inline(always)]
    fn shl<const BITS: i32>(self, a: I) -> I {
        both!(I, _mm256_slli_epi32::<BITS>, a)
    }
    #[inline(always)]
    fn shr<const BITS: i32>(self, a: I) -> I {
        both!(I, _mm256_srli_epi32::<BITS>, a)
    }
    #[inline(always)]
    fn sar<const BITS: i32>(self, a: I) -> I {
        both!(I, _mm256_srai_epi32::<BITS>, a)
    }
    #[inline(always)]
    fn gt_i32(self, a: I, b: I) -> I {
        both!(I, _mm256_cmpgt_epi32, a, b)
    }
    #[inline(always)]
    fn max_i32(self, a: I, b: I) -> I {
        both!(I, _mm256_max_epi32, a, b)
    }
    #[inline(always)]
    fn eq_i32(self, a: I, b: I) -> I {
        both!(I, _mm256_cmpeq_epi32, a, b)
    }
    #[inline(always)]
    fn select_i32(self, mask: I, a: I, b: I) -> I {
        both!(I, _mm256_blendv_epi8, b, a, mask)
    }
    #[inline(always)]
    fn and(self, a: I, b: I) -> I {
        self.and_i32(a, b)
    }
    #[inline(always)]
    fn or(self, a: I, b: I) -> I {
        self.or_i32(a, b)
    }
    #[inline(always)]
    fn not(self, a: I) -> I {
        self.xor_i32(a, self.splat_i32(-1))
    }
    #[inline(always)]
    fn all(self, a: I) -> bool {
        let m = self.from_bits(a);
        // SAFETY: the token proves AVX2.
        unsafe { _mm256_movemask_ps(_mm256_and_ps(m.0, m.1)) == 0xff }
    }
}

impl Simd for Avx2 {
    const REGISTERS: Registers = Registers::Avx2;

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
    fn low_bytes(self, a: I) -> [u8; LANES] {
        let mut bytes = [0; LANES];
        // SAFETY: the token proves AVX2; the array holds the 16 bytes that are stored.
        unsafe {
            let low = _mm256_set1_epi32(0xff);
            // Packed are the halves of either register in turn.
            let pairs = _mm256_packus_epi32(_mm256_and_si256(a.0, low), _mm256_and_si256(a.1, low));
            let words = _mm256_permute4x64_epi64::<0b11_01_10_00>(pairs);
            let packed = _mm_packus_epi16(_mm256_castsi256_si128(words), _mm256_extracti128_si256::<1>(words));
            _mm_storeu_si128(bytes.as_mut_ptr().cast(), packed);
        }
        bytes
    }
    #[inline(always)]
    fn split_bytes(self, a: I) -> [I; 2] {
        let high = both!(I, _mm256_slli_epi16::<8>, a);
        [both!(I, _mm256_srai_epi16::<8>, high), both!(I, _mm256_srai_epi16::<8>, a)]
    }
    #[inline(always)]
    fn dot_i16(self, a: I, b: I) -> I {
        both!(I, _mm256_madd_epi16, a, b)
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
    unsafe fn load_ptr(self, from: *const f32) -> F {
        // SAFETY: the caller's; the token proves AVX2.
        unsafe { F(_mm256_loadu_ps(from), _mm256_loadu_ps(from.add(8))) }
    }
    #[inline(always)]
    unsafe fn store_ptr(self, a: F, to: *mut f32) {
        // SAFETY: the caller's; the token proves AVX2.
        unsafe {
            _mm256_storeu_ps(to, a.0);
            _mm256_storeu_ps(to.add(8), a.1);
        }
    }
    #[inline(always)]
    fn load_u8(self, from: &[u8; LANES]) -> F {
        // SAFETY: an array of that many values; the token proves AVX2.
        unsafe {
            let half = |at: *const u8| _mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(_mm_loadl_epi64(at.cast())));
            F(half(from.as_ptr()), half(from.as_ptr().add(8)))
        }
    }
    #[inline(always)]
    unsafe fn load_halves(self, low: *const f32, high: *const f32) -> F {
        // SAFETY: the caller's; the token proves AVX2.
        unsafe { F(_mm256_loadu_ps(low), _mm256_loadu_ps(high)) }
    }
    #[inline(always)]
    unsafe fn gather_fours(self, from: *const f32, places: &[u32; LANES]) -> [F; 4] {
        // SAFETY: the caller's; the token proves AVX2.
        unsafe {
            let mut halves = [[_mm256_setzero_ps(); 4]; 2];
            for (first, half) in [0, 8].into_iter().zip(&mut halves) {
                // Lanes i and 4 + i, so that transposing each 4×4 values puts all lanes in order.
                let mut lanes = [_mm256_setzero_ps(); 4];
                for i in 0..4 {
                    let four = [first + i, first + 4 + i].map(|lane| from.add(places[lane] as usize));
                    let low = _mm256_castps128_ps256(_mm_loadu_ps(four[0]));
                    lanes[i] = _mm256_insertf128_ps::<1>(low, _mm_loadu_ps(four[1]));
                }
                let [a, b, c, d] = lanes;
                let (ab, cd) = (_mm256_unpacklo_ps(a, b), _mm256_unpacklo_ps(c, d));
                let (ab_high, cd_high) = (_mm256_unpackhi_ps(a, b), _mm256_unpackhi_ps(c, d));
                *half = [
                    _mm256_shuffle_ps::<0x44>(ab, cd),
                    _mm256_shuffle_ps::<0xee>(ab, cd),
                    _mm256_shuffle_ps::<0x44>(ab_high, cd_high),
                    _mm256_shuffle_ps::<0xee>(ab_high, cd_high),
                ];
            }
            let [low, high] = halves;
            [F(low[0], high[0]), F(low[1], high[1]), F(low[2], high[2]), F(low[3], high[3])]
        }
    }
    #[inline(always)]
    fn repeat_four(self, from: &[f32; 4]) -> F {
        // SAFETY: an array of that many values; the token proves AVX2.
        unsafe {
            let both = _mm256_broadcast_ps(&_mm_loadu_ps(from.as_ptr()));
            F(both, both)
        }
    }
    #[inline(always)]
    fn spread_four(self, from: &[f32; 4]) -> F {
        // SAFETY: an array of that many values; the token proves AVX2.
        unsafe {
            let both = _mm256_broadcast_ps(&_mm_loadu_ps(from.as_ptr()));
            F(
                _mm256_permutevar_ps(both, _mm256_setr_epi32(0, 0, 0, 0, 1, 1, 1, 1)),
                _mm256_permutevar_ps(both, _mm256_setr_epi32(2, 2, 2, 2, 3, 3, 3, 3)),
            )
        }
    }
    #[inline(always)]
    fn from_array_i32(self, x: [i32; LANES]) -> I {
        // SAFETY: an array of 16 values; the token proves AVX2.
        unsafe { I(_mm256_loadu_si256(x.as_ptr().cast()), _mm256_loadu_si256(x.as_ptr().add(8).cast())) }
    }
    #[inline(always)]
    fn to_array_i32(self, a: I) -> [i32; LANES] {
        let mut x = [0; LANES];
        // SAFETY: an array of 16 values; the token proves AVX2.
        unsafe {
            _mm256_storeu_si256(x.as_mut_ptr().cast(), a.0);
            _mm256_storeu_si256(x.as_mut_ptr().add(8).cast(), a.1);
        }
        x
    }
    #[inline(always)]
    fn bits(self, a: I) -> u16 {
        let m = self.from_bits(a);
        // SAFETY: the token proves AVX2.
        let (low, high) = unsafe { (_mm256_movemask_ps(m.0), _mm256_movemask_ps(m.1)) };
        (low | high << 8) as u16
    }
    #[inline(always)]
    fn any(self, a: I) -> bool {
        let m = self.from_bits(a);
        // SAFETY: the token proves AVX2.
        unsafe { _mm256_movemask_ps(_mm256_or_ps(m.0, m.1)) != 0 }
    }
    #[inline(always)]
    fn mask_from_bits(self, bits: u16) -> I {
        let lane = self.from_array_i32(std::array::from_fn(|i| 1 << i));
        self.eq_i32(self.and_i32(self.splat_i32(i32::from(bits)), lane), lane)
    }
    #[inline(always)]
    fn sum(self, a: F) -> f32 {
        // SAFETY: the token proves AVX2.
        unsafe { fold!(_mm256_add_ps(a.0, a.1), _mm_add_ps, _mm_add_ss) }
    }
    #[inline(always)]
    fn max_lane(self, a: F) -> f32 {
        // SAFETY: the token proves AVX2.
        unsafe { fold!(_mm256_max_ps(a.0, a.1), _mm_max_ps, _mm_max_ss) }
    }
}
