//! The vector of sixteen lanes, and the trait of code that runs on a level.

use super::elementwise::Elementwise;

/// Lanes of the logical vector.
pub const LANES: usize = 16;

/// The register file of a level: kernels choose the sizes of their register blocks by it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Registers {
    /// Of any kind; a vector takes several.
    Scalar,
    /// Sixteen of 256 bits; a vector takes two.
    Avx2,
    /// Thirty-two of 512 bits; a vector takes one.
    Avx512,
    /// Thirty-two of 128 bits; a vector takes four.
    Neon,
}

/// A zero-size token that proves that the CPU has a level, and that level's operations on vectors of [`LANES`] lanes.
///
/// All methods are inlined; call them only below [`dispatch`](super::dispatch).
pub trait Simd: Elementwise {
    /// The registers that hold vectors.
    const REGISTERS: Registers;
    /// True if [`Simd::dot_bf16`] is a single instruction. Only an [`Operation`] with [`Operation::DOT_PRODUCTS`] runs
    /// on that level.
    const BF16_DOT: bool = false;
    /// True if [`Simd::dot_bytes`] is a single instruction. Only an [`Operation`] with [`Operation::DOT_PRODUCTS`] runs
    /// on that level.
    const BYTE_DOT: bool = false;

    /// `acc + a₁b₁ + a₀b₀` in every lane for pairs of bf16: a fused step of the high halves, then one of the low
    /// halves.
    ///
    /// Precondition: every bf16 is zero, infinite, NaN or at least 2⁻⁵⁶ in magnitude, and `acc` is +0 or the result of
    /// such steps. Then no step is near the denormal numbers, where the instruction differs from a fused multiply-add.
    fn dot_bf16(self, acc: Self::F32, a: Self::I32, b: Self::I32) -> Self::F32;
    /// `acc + Σ a·b` in every lane for four unsigned bytes `a` and four signed bytes `b`, wrapping.
    fn dot_bytes(self, acc: Self::I32, a: Self::I32, b: Self::I32) -> Self::I32;
    /// `a₀b₀ + a₁b₁` in every lane for pairs of i16, wrapping (where all four are −2¹⁵).
    fn dot_i16(self, a: Self::I32, b: Self::I32) -> Self::I32;
    /// The signed bytes 0 and 2, and the signed bytes 1 and 3, of every lane as pairs of i16.
    fn split_bytes(self, a: Self::I32) -> [Self::I32; 2];
    /// 32 values rounded to bf16, in pairs of neighbours, the earlier in the high half: those of `a`, then those of
    /// `b`. Magnitudes below 2⁻⁵⁶ become 0.
    fn pairs_of_bf16(self, a: Self::F32, b: Self::F32) -> Self::I32;
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

    /// Lanes from 16 values.
    fn from_array(self, x: [f32; LANES]) -> Self::F32;
    /// The 16 values.
    fn to_array(self, a: Self::F32) -> [f32; LANES];
    /// Lanes from 16 values.
    fn from_array_i32(self, x: [i32; LANES]) -> Self::I32;
    /// The 16 values.
    fn to_array_i32(self, a: Self::I32) -> [i32; LANES];
    /// Lane `i` is bit `i`.
    fn mask_from_bits(self, bits: u16) -> Self::Mask;
    /// Bit `i` is lane `i`.
    fn bits(self, a: Self::Mask) -> u16;
    /// Returns true if any lane is true.
    #[inline(always)]
    fn any(self, a: Self::Mask) -> bool {
        self.bits(a) != 0
    }
    /// The sum of the lanes: `i` with `i+8`, then `i+4`, `i+2`, `i+1`.
    fn sum(self, a: Self::F32) -> f32;
    /// The largest lane, folded like [`Simd::sum`] with [`Elementwise::max`].
    fn max_lane(self, a: Self::F32) -> f32;

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

    /// Bytes as numbers from 0 to 255.
    #[inline(always)]
    fn load_u8(self, from: &[u8; LANES]) -> Self::F32 {
        self.from_array(from.map(f32::from))
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
    #[inline(always)]
    fn repeat_four(self, from: &[f32; 4]) -> Self::F32 {
        self.from_array(std::array::from_fn(|i| from[i % 4]))
    }
    /// Each of four values on four lanes: lane `i` is value `i / 4`.
    #[inline(always)]
    fn spread_four(self, from: &[f32; 4]) -> Self::F32 {
        self.from_array(std::array::from_fn(|i| from[i / 4]))
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
    /// Four neighbouring values from each of 16 places: lane `i` of vector `k` is value `k` from `places[i]` on.
    ///
    /// # Safety
    /// `from` is readable for four values from each of the places on; no alignment is needed.
    #[inline(always)]
    unsafe fn gather_fours(self, from: *const f32, places: &[u32; LANES]) -> [Self::F32; 4] {
        let mut all = [[0.0; LANES]; 4];
        for lane in 0..LANES {
            // SAFETY: the caller's.
            let four = unsafe { from.add(places[lane] as usize).cast::<[f32; 4]>().read_unaligned() };
            for k in 0..4 {
                all[k][lane] = four[k];
            }
        }
        let [a, b, c, d] = all;
        [self.from_array(a), self.from_array(b), self.from_array(c), self.from_array(d)]
    }
}

/// A computation that can be entered on any level.
///
/// `run` and everything it calls should be `#[inline(always)]`, so that all of it is compiled for the level.
pub trait Operation {
    /// True if the computation uses [`Simd::dot_bf16`] or [`Simd::dot_bytes`]. It is then compiled for each level that
    /// has them as instructions, otherwise once for all levels that differ only in these.
    const DOT_PRODUCTS: bool = false;
    /// Result of the computation.
    type Output;
    /// The computation.
    fn run<S: Simd>(self, s: S) -> Self::Output;
}
