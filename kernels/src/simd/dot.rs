//! The dot products of the lower precisions in plain operations: what their instructions are held to.

#[cfg(any(test, target_arch = "x86_64"))]
use super::Operation;
use super::{LANES, Simd};
use crate::gemm::{pair, round_bf16};

/// `acc + a₁b₁ + a₀b₀` in every lane, two fused steps, for pairs of bf16 (index 1 in the high half), the high halves first.
#[inline(always)]
pub(super) fn bf16<S: Simd>(s: S, acc: S::F32, a: S::I32, b: S::I32) -> S::F32 {
    let high = s.splat_i32(0xffff_0000_u32.cast_signed());
    let acc = s.mul_add(s.from_bits(s.and_i32(a, high)), s.from_bits(s.and_i32(b, high)), acc);
    s.mul_add(s.from_bits(s.shl::<16>(a)), s.from_bits(s.shl::<16>(b)), acc)
}

/// 32 values rounded to bf16, in pairs of neighbours, the earlier in the high half.
#[inline(always)]
pub(super) fn pairs_of_bf16<S: Simd>(s: S, a: S::F32, b: S::F32) -> S::I32 {
    let (a, b) = (s.to_array(round_bf16(s, a)), s.to_array(round_bf16(s, b)));
    let mut pairs = [0; LANES];
    for i in 0..LANES / 2 {
        pairs[i] = pair(a[2 * i], a[2 * i + 1]).cast_signed();
        pairs[LANES / 2 + i] = pair(b[2 * i], b[2 * i + 1]).cast_signed();
    }
    s.from_array_i32(pairs)
}

/// `acc + Σ a·b` in every lane for four unsigned bytes `a` and four signed bytes `b`, wrapping.
#[inline(always)]
pub(super) fn bytes<S: Simd>(s: S, acc: S::I32, a: S::I32, b: S::I32) -> S::I32 {
    let (mut sum, a, b) = (s.to_array_i32(acc), s.to_array_i32(a), s.to_array_i32(b));
    for i in 0..LANES {
        for (a, b) in a[i].to_le_bytes().into_iter().zip(b[i].to_le_bytes()) {
            sum[i] = sum[i].wrapping_add(i32::from(a) * i32::from(b.cast_signed()));
        }
    }
    s.from_array_i32(sum)
}

/// The signed bytes 0 and 2, and 1 and 3, of every lane as pairs of i16.
#[inline(always)]
pub(super) fn split_bytes<S: Simd>(s: S, a: S::I32) -> [S::I32; 2] {
    let a = s.to_array_i32(a);
    let pair = |low: i32, high: i32| (low & 0xffff) | high << 16;
    let even = a.map(|a| pair(a << 24 >> 24, a << 8 >> 24));
    let odd = a.map(|a| pair(a << 16 >> 24, a >> 24));
    [s.from_array_i32(even), s.from_array_i32(odd)]
}

/// `a₀b₀ + a₁b₁` in every lane for pairs of i16, wrapping (where all four are −2¹⁵).
#[inline(always)]
pub(super) fn i16s<S: Simd>(s: S, a: S::I32, b: S::I32) -> S::I32 {
    let (a, b) = (s.to_array_i32(a), s.to_array_i32(b));
    let dot = |a: i32, b: i32| ((a << 16 >> 16) * (b << 16 >> 16)).wrapping_add((a >> 16) * (b >> 16));
    s.from_array_i32(std::array::from_fn(|i| dot(a[i], b[i])))
}

/// Sums that an instruction has to reproduce before it is used: random pairs of every magnitude that products have, and
/// sums that cancel.
#[cfg(any(test, target_arch = "x86_64"))]
pub(super) struct Answers;

#[cfg(any(test, target_arch = "x86_64"))]
impl Operation for Answers {
    type Output = Vec<i32>;
    #[inline(always)]
    fn run<S: Simd>(self, s: S) -> Vec<i32> {
        let mut answers = Vec::new();
        let mut state = 0x1234_5678_u32;
        let mut floats = s.splat(0.0);
        let mut whole = s.splat_i32(0);
        for round in 0..512 {
            let mut words = [[0_i32; LANES]; 2];
            let mut raw = [[0_i32; LANES]; 2];
            for which in 0..2 {
                for lane in 0..LANES {
                    let mut word = 0_u32;
                    for half in 0..2 {
                        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                        // Exponents from 2^-56 on, wide in some rounds and near 1 in others; some zeros.
                        let spread = if round % 3 == 0 { 100 } else { 6 };
                        let exponent = if round % 3 == 0 { 71 } else { 124 } + (state >> 20) % spread;
                        let bits = (state >> 31 << 15) | exponent << 7 | (state >> 9 & 0x7f);
                        word |= (if state >> 13 & 31 == 0 { 0 } else { bits }) << (16 * half);
                    }
                    words[which][lane] = word.cast_signed();
                    raw[which][lane] = state.rotate_left(7).wrapping_mul(0x9e37_79b9).cast_signed();
                }
            }
            if round % 16 == 0 {
                floats = s.splat(0.0);
            }
            floats = s.dot_bf16(floats, s.from_array_i32(words[0]), s.from_array_i32(words[1]));
            whole = s.dot_bytes(whole, s.from_array_i32(raw[0]), s.from_array_i32(raw[1]));
            answers.extend(s.to_array_i32(s.to_bits(floats)));
            answers.extend(s.to_array_i32(whole));
        }
        answers
    }
}

/// Result of [`Answers`] in plain operations.
#[cfg(any(test, target_arch = "x86_64"))]
pub(super) fn known_answers() -> Vec<i32> {
    super::dispatch(crate::Level::scalar(), Answers)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Level;
    use crate::gemm::round_bf16_scalar;
    use crate::simd::{DotProducts, dispatch, dispatch_dot};

    #[test]
    fn dot_products_have_their_known_answers_on_every_level() {
        let expected = known_answers();
        for level in Level::available() {
            assert!(dispatch(level, Answers) == expected, "{level}");
            assert!(dispatch_dot(level, Answers) == expected, "{level} with its dot products");
            for dots in DotProducts::available(level) {
                dots.use_in_this_thread();
                assert!(dispatch_dot(level, Answers) == expected, "{level} with {dots:?}");
            }
        }
    }

    #[test]
    fn vectors_become_pairs_of_bf16_alike_on_every_level() {
        struct Pairs([f32; LANES], [f32; LANES]);
        impl Operation for Pairs {
            type Output = [i32; LANES];
            #[inline(always)]
            fn run<S: Simd>(self, s: S) -> [i32; LANES] {
                s.to_array_i32(s.pairs_of_bf16(s.from_array(self.0), s.from_array(self.1)))
            }
        }
        // Numbered lanes tell where each went; ties and what is flushed or no number, how it was rounded.
        let a = std::array::from_fn(|i| i as f32);
        let b = [1.0, 1.00390625, 1.01171875, -1e-17, 1.4e-17, f32::MAX, f32::INFINITY, f32::NEG_INFINITY]
            .map(|x: f32| [x, -x * 1.001]);
        let b: [f32; LANES] = std::array::from_fn(|i| b[i / 2][i % 2]);
        let expected: [i32; LANES] = std::array::from_fn(|i| {
            let of = |j: usize| round_bf16_scalar(if j < LANES { a[j] } else { b[j - LANES] });
            pair(of(2 * i), of(2 * i + 1)).cast_signed()
        });
        for level in Level::available() {
            assert_eq!(dispatch_dot(level, Pairs(a, b)), expected, "{level}");
            for dots in DotProducts::available(level) {
                dots.use_in_this_thread();
                assert_eq!(dispatch_dot(level, Pairs(a, b)), expected, "{level} with {dots:?}");
            }
        }
    }

    #[test]
    fn bytes_split_into_pairs_and_pairs_multiply_on_every_level() {
        struct Split;
        impl Operation for Split {
            type Output = [i32; LANES];
            #[inline(always)]
            fn run<S: Simd>(self, s: S) -> [i32; LANES] {
                let a = s.from_array_i32(std::array::from_fn(|i| {
                    (i as i32).wrapping_mul(0x1c9e_b74d) ^ 0x80ff_7f01_u32 as i32
                }));
                let [even, odd] = s.split_bytes(a);
                s.to_array_i32(s.add_i32(s.dot_i16(even, odd), s.dot_i16(even, even)))
            }
        }
        let expected: [i32; LANES] = std::array::from_fn(|i| {
            let b = ((i as i32).wrapping_mul(0x1c9e_b74d) ^ 0x80ff_7f01_u32 as i32).to_le_bytes();
            let [a, b, c, d] = b.map(|b| i32::from(b.cast_signed()));
            a * b + c * d + a * a + c * c
        });
        for level in Level::available() {
            assert_eq!(dispatch(level, Split), expected, "{level}");
        }
    }
}
