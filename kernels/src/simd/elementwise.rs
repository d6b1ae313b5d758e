//! Operations on each lane alone, from which elementary functions are built.

/// Rounding constant of the shift trick, 1.5 · 2²³: added to a float below 2²² in magnitude, it leaves the nearest
/// integer in the low bits.
pub(crate) const SHIFTER: f32 = 12_582_912.0;

/// Arithmetic on every lane alone, defined to the bit (see [the module](super)), for one value or sixteen.
pub trait Elementwise: Copy + Send + Sync + 'static {
    /// `f32` lanes.
    type F32: Copy + Send + Sync;
    /// `i32` lanes.
    type I32: Copy + Send + Sync;
    /// Truth values.
    type Mask: Copy + Send + Sync;

    /// All lanes `x`.
    fn splat(self, x: f32) -> Self::F32;
    /// `f` of every lane, one after the other.
    fn map(self, a: Self::F32, f: impl Fn(f32) -> f32) -> Self::F32;
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
    /// The bits of the lanes.
    fn to_bits(self, a: Self::F32) -> Self::I32;
    /// Lanes from their bits.
    fn from_bits(self, a: Self::I32) -> Self::F32;
    /// Lanes to integers, rounding toward zero. Precondition: |a| < 2³¹ (for other values the bits are unspecified).
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
    /// Returns true if all lanes are true.
    fn all(self, a: Self::Mask) -> bool;

    /// The integer `n` in the form that [`scale_by_pow2`](Elementwise::scale_by_pow2) takes, from `n` plus the rounding
    /// constant of the shift trick.
    #[inline(always)]
    fn shifted_int(self, shifted: Self::F32) -> Self::F32 {
        shifted
    }
    /// The integer nearest to `t` (ties to even), in the form that [`scale_by_pow2`](Elementwise::scale_by_pow2) takes,
    /// and `t` minus that integer, for |t| < 2²².
    #[inline(always)]
    fn split_int_frac(self, t: Self::F32) -> (Self::F32, Self::F32) {
        let shifter = self.splat(SHIFTER);
        let shifted = self.add(t, shifter);
        (self.shifted_int(shifted), self.sub(t, self.sub(shifted, shifter)))
    }
    /// `p · 2ⁿ`, where `p` and the result are normal numbers.
    #[inline(always)]
    fn scale_by_pow2(self, p: Self::F32, n: Self::F32) -> Self::F32 {
        // The integer, shifted to the exponent; higher bits are dropped.
        self.from_bits(self.add_i32(self.to_bits(p), self.shl::<23>(self.to_bits(n))))
    }
    /// `p · 2ⁿ` for −252 ≤ `n` ≤ 254, rounded once, where `p·2^⌊n/2⌋` is a normal number or `p` is not one.
    #[inline(always)]
    fn scale_by_any_pow2(self, p: Self::F32, n: Self::F32) -> Self::F32 {
        let n = self.sub_i32(self.to_bits(n), self.splat_i32(SHIFTER.to_bits().cast_signed()));
        let half = self.sar::<1>(n);
        let bias = self.splat_i32(127);
        let a = self.from_bits(self.shl::<23>(self.add_i32(half, bias)));
        let b = self.from_bits(self.shl::<23>(self.add_i32(self.sub_i32(n, half), bias)));
        self.mul(self.mul(p, a), b)
    }
}
