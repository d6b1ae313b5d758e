//! The weighted sum of values, `Σ w v`, as each precision holds weights and values.

use super::values::Values;
use super::weight::{NUMBERED, numbered, weight, weight_low};
use crate::gemm::form::{Bf16, F32, Multiply, Uint8Weights};
use crate::simd::{LANES, SHIFTER, Simd, pair_bf16, round_bf16};

/// A block's scores of 16 queries.
pub(super) struct Scores<'a, S: Simd> {
    /// `[KEY_BLOCK][16]`; the first `present` keys count.
    pub(super) values: &'a mut [f32],
    pub(super) present: usize,
    /// From a score to a logit.
    pub(super) scale: S::F32,
    /// The largest of them.
    pub(super) largest: S::F32,
    /// The reference before them, `M`.
    pub(super) reference: S::F32,
}

/// Result of weighing a block of scores.
#[derive(Clone, Copy)]
pub(super) struct Weighed<S: Simd> {
    /// The reference from now on, `M`.
    pub(super) reference: S::F32,
    /// Scale of the sums before the block, `r`.
    pub(super) before: S::F32,
    /// Scale of the block's own sums, `u`.
    pub(super) block: S::F32,
    /// The block's `Σ w`, scaled.
    pub(super) total: S::F32,
}

impl<S: Simd> Weighed<S> {
    #[inline(always)]
    pub(super) fn nothing(s: S) -> Self {
        let (zero, one) = (s.splat(0.0), s.splat(1.0));
        Self { reference: zero, before: one, block: one, total: zero }
    }
}

/// How weights and values are held. The weights of 16 queries are a panel of `[words][16]`, values are groups of rows.
pub(super) trait WeightedSum: 'static {
    /// The product, with values as its rows and weights as its panels.
    type Product: Multiply;

    /// True if values have a scale per channel and block of keys.
    const SCALED: bool;

    /// Keys of one word.
    const KEYS: usize;

    /// Turns scores into words of weights `[words][16]`, in their place.
    fn weigh<S: Simd>(s: S, scores: Scores<'_, S>) -> Weighed<S>;

    /// Adds a block's sums of a channel to those before. `scale` is the scale of the channel's values, where there are
    /// scales.
    #[inline(always)]
    fn add<S: Simd>(s: S, before: S::F32, block: S::F32, weighed: &Weighed<S>, _scale: f32) -> S::F32 {
        s.mul_add(before, weighed.before, block)
    }

    /// Row word `i` of 16 channels, from `c` on, of a block of values; `inverse` is that of the channels' scales.
    fn row_word<S: Simd>(s: S, i: usize, values: &Values<'_>, c: usize, inverse: S::F32) -> S::F32;
}

/// The reference moves to the block's largest logit where that is above it; earlier sums are scaled to it, the block is
/// not.
#[inline(always)]
fn moved<S: Simd>(s: S, scores: &Scores<'_, S>) -> Weighed<S> {
    let before = scores.reference;
    let reference = s.max(s.mul(scores.largest, scores.scale), before);
    // Unchanged infinities have no difference.
    let rescale = s.select(s.eq(before, reference), s.splat(1.0), weight(s, s.sub(before, reference)));
    Weighed { reference, before: rescale, block: s.splat(1.0), total: s.splat(0.0) }
}

/// Weights and values in f32.
pub(super) struct F32Sum;

impl WeightedSum for F32Sum {
    type Product = F32;
    const SCALED: bool = false;
    const KEYS: usize = 1;

    #[inline(always)]
    fn weigh<S: Simd>(s: S, scores: Scores<'_, S>) -> Weighed<S> {
        let mut weighed = moved(s, &scores);
        let Scores { values: scores, present, scale, .. } = scores;
        let minus = s.neg(weighed.reference);
        let mut sums = [s.splat(0.0); 4];
        for four in scores[..present * LANES].chunks_mut(4 * LANES) {
            for (score, sum) in four.chunks_exact_mut(LANES).zip(&mut sums) {
                let w = weight(s, s.mul_add(s.load(score), scale, minus));
                s.store(w, score);
                *sum = s.add(*sum, w);
            }
        }
        weighed.total = s.add(s.add(sums[0], sums[1]), s.add(sums[2], sums[3]));
        weighed
    }

    #[inline(always)]
    fn row_word<S: Simd>(s: S, i: usize, values: &Values<'_>, c: usize, _: S::F32) -> S::F32 {
        values.value(s, i, c)
    }
}

/// Weights and values in bf16.
pub(super) struct Bf16Sum;

impl WeightedSum for Bf16Sum {
    type Product = Bf16;
    const SCALED: bool = false;
    const KEYS: usize = 2;

    #[inline(always)]
    fn weigh<S: Simd>(s: S, scores: Scores<'_, S>) -> Weighed<S> {
        let mut weighed = moved(s, &scores);
        let Scores { values: scores, present, scale, .. } = scores;
        let minus = s.neg(weighed.reference);
        let mut sums = [s.splat(0.0); 4];
        let whole = present / 4 * 4;
        for i in (0..whole).step_by(4) {
            let mut four = [s.splat(0.0); 4];
            for j in 0..4 {
                four[j] = weight_low(s, s.mul_add(s.load(&scores[(i + j) * LANES..]), scale, minus));
                sums[j] = s.add(sums[j], four[j]);
            }
            let to = &mut scores[i / 2 * LANES..][..2 * LANES];
            s.store(s.from_bits(pair_bf16(s, four[0], four[1])), to);
            s.store(s.from_bits(pair_bf16(s, four[2], four[3])), &mut to[LANES..]);
        }
        for i in (whole..present).step_by(2) {
            let mut two = [s.splat(0.0); 2];
            for j in 0..2.min(present - i) {
                two[j] = weight_low(s, s.mul_add(s.load(&scores[(i + j) * LANES..]), scale, minus));
                sums[(i + j) % 4] = s.add(sums[(i + j) % 4], two[j]);
            }
            s.store(s.from_bits(pair_bf16(s, two[0], two[1])), &mut scores[i / 2 * LANES..]);
        }
        weighed.total = s.add(s.add(sums[0], sums[1]), s.add(sums[2], sums[3]));
        weighed
    }

    #[inline(always)]
    fn row_word<S: Simd>(s: S, i: usize, values: &Values<'_>, c: usize, _: S::F32) -> S::F32 {
        if Bf16::row_words_of_a_word::<S>() == 2 {
            return round_bf16(s, values.value(s, i, c));
        }
        let (a, b) = (values.value(s, 2 * i, c), values.value(s, 2 * i + 1, c));
        s.from_bits(pair_bf16(s, round_bf16(s, a), round_bf16(s, b)))
    }
}

/// Weights as numbers from 0 to 255, values as 8-bit integers with a scale per channel of a block.
pub(super) struct Int8Sum;

impl WeightedSum for Int8Sum {
    type Product = Uint8Weights;
    const SCALED: bool = true;
    const KEYS: usize = 4;

    #[inline(always)]
    fn weigh<S: Simd>(s: S, scores: Scores<'_, S>) -> Weighed<S> {
        let Scores { values: scores, present, scale, largest, reference } = scores;
        let own = s.mul(largest, scale);
        let now = s.max(own, reference);
        // Past the last score are zeros or an earlier block's scores: they get no weight.
        let words = present.div_ceil(4);
        scores[present * LANES..words * 4 * LANES].fill(f32::NEG_INFINITY);
        // Only the marks of the lowest two numbers remain in a word: those of the others are shifted out.
        let marks = s.splat_i32(NUMBERED.wrapping_add(NUMBERED << 8));
        let mut total = s.splat_i32(0);
        for i in 0..words {
            let mut n = [s.splat_i32(0); 4];
            for j in 0..4 {
                let logit = s.mul(s.load(&scores[(4 * i + j) * LANES..]), scale);
                n[j] = numbered(s, s.sub(logit, own));
            }
            let low = s.add_i32(s.sub_i32(n[0], marks), s.shl::<8>(n[1]));
            let word = s.add_i32(low, s.add_i32(s.shl::<16>(n[2]), s.shl::<24>(n[3])));
            total = Uint8Weights::count(s, total, word);
            s.store(s.from_bits(word), &mut scores[i * LANES..]);
        }
        let block = weight(s, s.sub(own, now));
        Weighed {
            reference: now,
            before: weight(s, s.sub(reference, now)),
            block,
            total: s.mul(s.to_f32(Uint8Weights::counted(s, total)), block),
        }
    }

    #[inline(always)]
    fn add<S: Simd>(s: S, before: S::F32, block: S::F32, weighed: &Weighed<S>, scale: f32) -> S::F32 {
        let unit = s.mul(weighed.block, s.splat(scale));
        s.mul_add(before, weighed.before, s.mul(s.to_f32(s.to_bits(block)), unit))
    }

    #[inline(always)]
    fn row_word<S: Simd>(s: S, i: usize, values: &Values<'_>, c: usize, inverse: S::F32) -> S::F32 {
        let each = Uint8Weights::row_words_of_a_word::<S>();
        let mut integers = [s.splat_i32(0); 4];
        for j in 0..4 {
            // The nearest integer is in the low bits, its sign in those above.
            let x = s.mul(values.value(s, i / each * 4 + j, c), inverse);
            integers[j] = s.to_bits(s.add(x, s.splat(SHIFTER)));
        }
        Uint8Weights::row_word(s, integers, i % each)
    }
}
