//! bf16, the upper half of binary32: rounding, pairs in one word, and their dot product in plain operations.

use super::elementwise::Elementwise;
use super::vector::{LANES, Simd};

/// The smallest magnitude that bf16 operands keep.
///
/// Products of such operands are whole multiples of 2⁻¹²⁶, and so is every sum of them. None is near the denormal
/// numbers, which the instructions for bf16 flush in their own way.
pub(crate) const SMALLEST: f32 = f32::from_bits((127 - 56) << 23);

/// The bits of the earlier bf16 of a pair.
pub(crate) const HIGH: i32 = 0xffff_0000_u32.cast_signed();

/// The nearest bf16 (ties to even), as f32. NaN stays NaN; magnitudes below [`SMALLEST`] become 0.
#[inline(always)]
pub(crate) fn round_bf16<S: Elementwise>(s: S, x: S::F32) -> S::F32 {
    let bits = s.to_bits(x);
    let odd = s.and_i32(s.shr::<16>(bits), s.splat_i32(1));
    let rounded = s.add_i32(bits, s.add_i32(odd, s.splat_i32(0x7fff)));
    let rounded = s.from_bits(s.and_i32(rounded, s.splat_i32(HIGH)));
    let rounded = s.select(s.eq(x, x), rounded, s.splat(f32::NAN));
    s.select(s.lt(s.abs(x), s.splat(SMALLEST)), s.splat(0.0), rounded)
}

/// Two bf16, held as f32, in one word: `first` in the high half.
#[inline(always)]
pub(crate) fn pair_bf16<S: Elementwise>(s: S, first: S::F32, second: S::F32) -> S::I32 {
    s.or_i32(s.to_bits(first), s.shr::<16>(s.to_bits(second)))
}

/// [`Simd::dot_bf16`] by two fused multiply-adds.
#[inline(always)]
pub(super) fn dot<S: Elementwise>(s: S, acc: S::F32, a: S::I32, b: S::I32) -> S::F32 {
    let high = s.splat_i32(HIGH);
    let acc = s.mul_add(s.from_bits(s.and_i32(a, high)), s.from_bits(s.and_i32(b, high)), acc);
    s.mul_add(s.from_bits(s.shl::<16>(a)), s.from_bits(s.shl::<16>(b)), acc)
}

/// [`Simd::pairs_of_bf16`], lane by lane.
#[inline(always)]
pub(super) fn pairs_of_neighbours<S: Simd>(s: S, a: S::F32, b: S::F32) -> S::I32 {
    let (a, b) = (s.to_array_i32(s.to_bits(round_bf16(s, a))), s.to_array_i32(s.to_bits(round_bf16(s, b))));
    let pair = |first: i32, second: i32| first | (second.cast_unsigned() >> 16).cast_signed();
    let mut pairs = [0; LANES];
    for i in 0..LANES / 2 {
        pairs[i] = pair(a[2 * i], a[2 * i + 1]);
        pairs[LANES / 2 + i] = pair(b[2 * i], b[2 * i + 1]);
    }
    s.from_array_i32(pairs)
}

#[cfg(test)]
mod tests {
    use crate::gemm::reference::round_bf16;
    use crate::simd::{LANES, Operation, Simd, dispatch};

    #[test]
    fn vectors_become_pairs_of_bf16_alike_on_every_level() {
        struct Pairs([f32; LANES], [f32; LANES]);
        impl Operation for Pairs {
            const DOT_PRODUCTS: bool = true;
            type Output = [i32; LANES];
            #[inline(always)]
            fn run<S: Simd>(self, s: S) -> [i32; LANES] {
                s.to_array_i32(s.pairs_of_bf16(s.from_array(self.0), s.from_array(self.1)))
            }
        }
        // Numbered lanes show the permutation; ties, flushed values and NaN show the rounding.
        let a = std::array::from_fn(|i| i as f32);
        let b = [1.0, 1.00390625, 1.01171875, -1e-17, 1.4e-17, f32::MAX, f32::INFINITY, f32::NEG_INFINITY]
            .map(|x: f32| [x, -x * 1.001]);
        let b: [f32; LANES] = std::array::from_fn(|i| b[i / 2][i % 2]);
        let expected: [i32; LANES] = std::array::from_fn(|i| {
            let of = |j: usize| round_bf16(if j < LANES { a[j] } else { b[j - LANES] }).to_bits();
            (of(2 * i) | of(2 * i + 1) >> 16).cast_signed()
        });
        for level in crate::testing::levels() {
            assert_eq!(dispatch(level, Pairs(a, b)), expected, "{level}");
        }
    }
}
