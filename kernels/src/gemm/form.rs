//! Operand format of each precision, and its products in the register block.
//!
//! Operands are 32-bit words: a weight panel is `[words][16]`, a group of rows `[words][MR]`. A word is one f32, two
//! bf16 (the earlier in the high half: the instruction takes that first) or four bytes. Levels without dot products of
//! words widen the panels in registers, and hold each row's word as two: two f32, or two pairs of i16. [`Uint8Weights`]
//! is not a form of inputs and weights but of attention's values and weights: there the panel's bytes have no sign.

#![expect(unsafe_code, reason = "register blocks read operands by pointer")]

use super::microkernel::{self, HOOK_STEPS, PrefetchHook, Strided, Tile};
use super::precision::{K_BLOCK, K_BLOCK_LOW, Precision, scale_of};
use crate::simd::{HIGH, LANES, SHIFTER, Simd, again, largest_magnitude, round_bf16};

/// A product of words.
pub(crate) trait Multiply: 'static {
    /// Row words that go with one word of a panel on a level.
    fn row_words_of_a_word<S: Simd>() -> usize;

    /// The sums of one block of `words`, from +0; `hook` is called before every [`HOOK_STEPS`] of them.
    ///
    /// # Safety
    /// `MR` rows are readable for the block's row words, every pointer of `panels` for `16 words`.
    unsafe fn multiply<S: Simd, const MR: usize, const NV: usize>(
        s: S,
        rows: Strided,
        panels: [*const u32; NV],
        words: usize,
        hook: &mut impl PrefetchHook,
    ) -> Tile<S, MR, NV>;
}

/// A precision's operands.
pub(crate) trait Form: Multiply {
    const PRECISION: Precision;

    /// Words of a row of `k` values on a level.
    fn row_words<S: Simd>(k: usize) -> usize;

    /// Turns a row into its words; returns its scale. `largest` is the row's largest magnitude if already computed,
    /// infinite where a value is not finite.
    fn convert<S: Simd>(s: S, row: &[f32], largest: Option<f32>, values: &mut [f32], words: &mut [u32]) -> f32;

    /// Turns a row into the words of one lane of a panel; returns its scale and the offset that [`Form::of_row`]
    /// subtracts. The words are the same on every level.
    fn convert_column<S: Simd>(s: S, row: &[f32], values: &mut [f32], words: &mut [u32]) -> (f32, i32);

    /// Adds a block's sums to those before.
    fn add<S: Simd>(s: S, before: S::F32, block: S::F32) -> S::F32;

    /// The product from its sums, without the scales of the columns.
    fn of_row<S: Simd>(s: S, sum: S::F32, row_scale: f32, offsets: S::I32) -> S::F32;

    /// The product from its sums.
    #[inline(always)]
    fn product<S: Simd>(s: S, sum: S::F32, row_scale: f32, column_scales: S::F32, offsets: S::I32) -> S::F32 {
        let product = Self::of_row(s, sum, row_scale, offsets);
        if Self::PRECISION == Precision::Int8 { s.mul(product, column_scales) } else { product }
    }
}

/// Values of `k` in one word of a panel.
pub(crate) const fn values_of_a_word(precision: Precision) -> usize {
    match precision {
        Precision::F32 => 1,
        Precision::Bf16 => 2,
        Precision::Int8 => 4,
    }
}

/// Words of a panel in one block: [`K_BLOCK`] or [`K_BLOCK_LOW`] values where the order of sums counts.
pub(super) const fn block_words(precision: Precision) -> usize {
    match precision {
        Precision::F32 => K_BLOCK,
        Precision::Bf16 => K_BLOCK_LOW / 2,
        Precision::Int8 => 1024,
    }
}

/// f32 as it is.
pub(crate) struct F32;

impl Multiply for F32 {
    #[inline(always)]
    fn row_words_of_a_word<S: Simd>() -> usize {
        1
    }
    #[inline(always)]
    unsafe fn multiply<S: Simd, const MR: usize, const NV: usize>(
        s: S,
        rows: Strided,
        panels: [*const u32; NV],
        words: usize,
        hook: &mut impl PrefetchHook,
    ) -> Tile<S, MR, NV> {
        // SAFETY: the caller's.
        unsafe { microkernel::multiply(s, rows, panels.map(<*const u32>::cast), words, hook) }
    }
}

impl Form for F32 {
    const PRECISION: Precision = Precision::F32;

    #[inline(always)]
    fn row_words<S: Simd>(k: usize) -> usize {
        k
    }
    #[inline(always)]
    fn convert<S: Simd>(_: S, row: &[f32], _: Option<f32>, _: &mut [f32], words: &mut [u32]) -> f32 {
        words.copy_from_slice(bytemuck::cast_slice(row));
        1.0
    }
    #[inline(always)]
    fn convert_column<S: Simd>(s: S, row: &[f32], values: &mut [f32], words: &mut [u32]) -> (f32, i32) {
        (Self::convert(s, row, None, values, words), 0)
    }
    #[inline(always)]
    fn add<S: Simd>(s: S, before: S::F32, block: S::F32) -> S::F32 {
        s.add(before, block)
    }
    #[inline(always)]
    fn of_row<S: Simd>(_: S, sum: S::F32, _: f32, _: S::I32) -> S::F32 {
        sum
    }
}

/// bf16 operands, f32 sums.
pub(crate) struct Bf16;

impl Multiply for Bf16 {
    #[inline(always)]
    fn row_words_of_a_word<S: Simd>() -> usize {
        if S::BF16_DOT { 1 } else { 2 }
    }
    #[inline(always)]
    unsafe fn multiply<S: Simd, const MR: usize, const NV: usize>(
        s: S,
        mut rows: Strided,
        panels: [*const u32; NV],
        words: usize,
        hook: &mut impl PrefetchHook,
    ) -> Tile<S, MR, NV> {
        let mut acc = [[s.splat(0.0); NV]; MR];
        let mut i = 0;
        // SAFETY: i < words in every step.
        unsafe {
            while i + 2 <= words {
                if i.is_multiple_of(HOOK_STEPS) {
                    hook.prefetch();
                }
                let each = Self::row_words_of_a_word::<S>();
                bf16_step(s, &mut acc, rows, panels.map(|panel| panel.add(i * LANES)));
                bf16_step(s, &mut acc, rows.skip(each), panels.map(|panel| panel.add((i + 1) * LANES)));
                rows = rows.skip(2 * each);
                i += 2;
            }
            if i < words {
                bf16_step(s, &mut acc, rows, panels.map(|panel| panel.add(i * LANES)));
            }
        }
        acc
    }
}

impl Form for Bf16 {
    const PRECISION: Precision = Precision::Bf16;

    #[inline(always)]
    fn row_words<S: Simd>(k: usize) -> usize {
        if S::BF16_DOT { k.div_ceil(2) } else { k.next_multiple_of(2) }
    }
    #[inline(always)]
    fn convert<S: Simd>(s: S, row: &[f32], _: Option<f32>, values: &mut [f32], words: &mut [u32]) -> f32 {
        if S::BF16_DOT {
            pair_row(s, row, words);
        } else {
            let values = &mut values[..row.len().next_multiple_of(2)];
            values[row.len()..].fill(0.0);
            for (row, to) in row.chunks(LANES).zip(values.chunks_mut(LANES)) {
                s.store_partial(round_bf16(s, s.load_partial(row, 0.0)), &mut to[..row.len()]);
            }
            words.copy_from_slice(bytemuck::cast_slice(values));
        }
        1.0
    }
    #[inline(always)]
    fn convert_column<S: Simd>(s: S, row: &[f32], _: &mut [f32], words: &mut [u32]) -> (f32, i32) {
        pair_row(s, row, words);
        (1.0, 0)
    }
    #[inline(always)]
    fn add<S: Simd>(s: S, before: S::F32, block: S::F32) -> S::F32 {
        s.add(before, block)
    }
    #[inline(always)]
    fn of_row<S: Simd>(_: S, sum: S::F32, _: f32, _: S::I32) -> S::F32 {
        sum
    }
}

/// A row rounded to bf16, two values to a word; an odd last one is paired with 0.
#[inline(always)]
fn pair_row<S: Simd>(s: S, row: &[f32], words: &mut [u32]) {
    let words: &mut [f32] = bytemuck::cast_slice_mut(words);
    for (row, to) in row.chunks(2 * LANES).zip(words.chunks_mut(LANES)) {
        let (a, b) = row.split_at(row.len().min(LANES));
        let pairs = s.pairs_of_bf16(s.load_partial(a, 0.0), s.load_partial(b, 0.0));
        s.store_partial(s.from_bits(pairs), to);
    }
}

/// The step of one word.
///
/// # Safety
/// The row words that go with a word are readable, every pointer of `panels` for 16 words.
#[inline(always)]
unsafe fn bf16_step<S: Simd, const MR: usize, const NV: usize>(
    s: S,
    acc: &mut Tile<S, MR, NV>,
    rows: Strided,
    panels: [*const u32; NV],
) {
    // SAFETY: the caller's.
    unsafe {
        let mut b = [s.splat_i32(0); NV];
        for v in 0..NV {
            b[v] = s.to_bits(s.load_ptr(panels[v].cast()));
        }
        if S::BF16_DOT {
            for r in 0..MR {
                let a = s.splat_i32((*rows.word(0, r)).cast_signed());
                for v in 0..NV {
                    acc[r][v] = s.dot_bf16(acc[r][v], a, b[v]);
                }
            }
            return;
        }
        for v in 0..NV {
            b[v] = s.and_i32(b[v], s.splat_i32(HIGH));
        }
        for r in 0..MR {
            let a = s.splat(*rows.word(0, r).cast::<f32>());
            for v in 0..NV {
                acc[r][v] = s.mul_add(a, s.from_bits(b[v]), acc[r][v]);
            }
        }
        for v in 0..NV {
            b[v] = s.shl::<16>(s.to_bits(s.load_ptr(again(panels[v]).cast())));
        }
        for r in 0..MR {
            let a = s.splat(*rows.word(1, r).cast::<f32>());
            for v in 0..NV {
                acc[r][v] = s.mul_add(a, s.from_bits(b[v]), acc[r][v]);
            }
        }
    }
}

/// Four bytes to a word, i32 sums; the bytes of panels or else those of rows (as the instruction has them) are signed.
pub(crate) struct EightBit<const SIGNED: bool>;

/// Inputs and weights, with scales.
pub(crate) type Int8 = EightBit<true>;

/// Attention's values as rows, and its weights as panels.
pub(crate) type Uint8Weights = EightBit<false>;

impl<const SIGNED: bool> Multiply for EightBit<SIGNED> {
    #[inline(always)]
    fn row_words_of_a_word<S: Simd>() -> usize {
        if S::BYTE_DOT { 1 } else { 2 }
    }
    #[inline(always)]
    unsafe fn multiply<S: Simd, const MR: usize, const NV: usize>(
        s: S,
        mut rows: Strided,
        panels: [*const u32; NV],
        words: usize,
        hook: &mut impl PrefetchHook,
    ) -> Tile<S, MR, NV> {
        let mut acc = [[s.splat_i32(0); NV]; MR];
        for i in 0..words {
            if i.is_multiple_of(HOOK_STEPS) {
                hook.prefetch();
            }
            // SAFETY: the caller's; i < words.
            unsafe {
                if S::BYTE_DOT {
                    let b = panels.map(|panel| panel.add(i * LANES).cast::<f32>());
                    for r in 0..MR {
                        let a = s.splat_i32((*rows.word(0, r)).cast_signed());
                        for v in 0..NV {
                            let b = s.to_bits(s.load_ptr(b[v]));
                            let (unsigned, signed) = if SIGNED { (a, b) } else { (b, a) };
                            acc[r][v] = s.dot_bytes(acc[r][v], unsigned, signed);
                        }
                    }
                    rows = rows.skip(1);
                    continue;
                }
                let mut b = [[s.splat_i32(0); 2]; NV];
                for v in 0..NV {
                    let word = s.to_bits(s.load_ptr(panels[v].add(i * LANES).cast()));
                    b[v] = if SIGNED { s.split_bytes(word) } else { Uint8Weights::halves(s, word) };
                }
                for r in 0..MR {
                    for half in 0..2 {
                        let a = s.splat_i32((*rows.word(half, r)).cast_signed());
                        for v in 0..NV {
                            acc[r][v] = s.add_i32(acc[r][v], s.dot_i16(a, b[v][half]));
                        }
                    }
                }
                rows = rows.skip(2);
            }
        }
        let mut tile = [[s.splat(0.0); NV]; MR];
        for r in 0..MR {
            for v in 0..NV {
                tile[r][v] = s.from_bits(acc[r][v]);
            }
        }
        tile
    }
}

impl Form for Int8 {
    const PRECISION: Precision = Precision::Int8;

    #[inline(always)]
    fn row_words<S: Simd>(k: usize) -> usize {
        k.div_ceil(4) * Self::row_words_of_a_word::<S>()
    }
    #[inline(always)]
    fn convert<S: Simd>(s: S, row: &[f32], largest: Option<f32>, values: &mut [f32], words: &mut [u32]) -> f32 {
        // No closure: code passed to the standard library may leave the instruction-set context.
        let largest = match largest {
            Some(largest) => largest,
            None => largest_magnitude(s, row),
        };
        if S::BYTE_DOT {
            // The instruction takes these unsigned; the weights' offsets undo it.
            return quantise_row::<S, 128>(s, row, largest, words);
        }
        let bytes = &mut bytemuck::cast_slice_mut(values)[..words.len() / 2];
        let scale = quantise_row::<S, 0>(s, row, largest, bytes);
        for (two, bytes) in words.chunks_exact_mut(2).zip(bytes) {
            let [a, b, c, d] = bytes.to_le_bytes().map(|byte| i32::from(byte.cast_signed()) as u32 & 0xffff);
            (two[0], two[1]) = (a | c << 16, b | d << 16);
        }
        scale
    }
    #[inline(always)]
    fn convert_column<S: Simd>(s: S, row: &[f32], _: &mut [f32], words: &mut [u32]) -> (f32, i32) {
        let scale = quantise_row::<S, 0>(s, row, largest_magnitude(s, row), words);
        let bytes: &[i8] = bytemuck::cast_slice(words);
        (scale, 128 * bytes.iter().map(|&q| i32::from(q)).sum::<i32>())
    }
    #[inline(always)]
    fn add<S: Simd>(s: S, before: S::F32, block: S::F32) -> S::F32 {
        s.from_bits(s.add_i32(s.to_bits(before), s.to_bits(block)))
    }
    #[inline(always)]
    fn of_row<S: Simd>(s: S, sum: S::F32, row_scale: f32, offsets: S::I32) -> S::F32 {
        let sum = if S::BYTE_DOT { s.sub_i32(s.to_bits(sum), offsets) } else { s.to_bits(sum) };
        s.mul(s.to_f32(sum), s.splat(row_scale))
    }
}

impl Uint8Weights {
    /// Bytes 0 and 2, and 1 and 3, of every lane as pairs of i16.
    #[inline(always)]
    fn halves<S: Simd>(s: S, word: S::I32) -> [S::I32; 2] {
        let low = s.splat_i32(0x00ff_00ff);
        [s.and_i32(word, low), s.and_i32(s.shr::<8>(word), low)]
    }

    /// Row word `i` of those that go with one word: of four integers in −128..128, in the low bits.
    #[inline(always)]
    pub(crate) fn row_word<S: Simd>(s: S, integers: [S::I32; 4], i: usize) -> S::F32 {
        let [a, b, c, d] = integers;
        s.from_bits(if Self::row_words_of_a_word::<S>() == 2 {
            let (first, second) = if i == 0 { (a, c) } else { (b, d) };
            s.or_i32(s.and_i32(first, s.splat_i32(0xffff)), s.shl::<16>(second))
        } else {
            let byte = s.splat_i32(0xff);
            let low = s.or_i32(s.and_i32(a, byte), s.shl::<8>(s.and_i32(b, byte)));
            s.or_i32(low, s.or_i32(s.shl::<16>(s.and_i32(c, byte)), s.shl::<24>(d)))
        })
    }

    /// Adds a panel word's bytes to a count that [`Uint8Weights::counted`] reads, of at most 128 words.
    #[inline(always)]
    pub(crate) fn count<S: Simd>(s: S, count: S::I32, word: S::I32) -> S::I32 {
        if S::BYTE_DOT {
            return s.dot_bytes(count, word, s.splat_i32(0x0101_0101));
        }
        // Two counts of 16 bits.
        let [a, b] = Self::halves(s, word);
        s.add_i32(count, s.add_i32(a, b))
    }

    /// The sum of all bytes.
    #[inline(always)]
    pub(crate) fn counted<S: Simd>(s: S, count: S::I32) -> S::I32 {
        if S::BYTE_DOT {
            return count;
        }
        s.add_i32(s.and_i32(count, s.splat_i32(0xffff)), s.shr::<16>(count))
    }
}

/// A row in units of its scale, `OFFSET` added, as the bytes of words, the first lowest; the rest of the last word is
/// `OFFSET`. Returns the scale. A row of zeros, or one with a value that is not finite, is zeros.
#[inline(always)]
fn quantise_row<S: Simd, const OFFSET: u8>(s: S, row: &[f32], largest: f32, words: &mut [u32]) -> f32 {
    let (scale, inverse) = scale_of(largest);
    let bytes: &mut [u8] = bytemuck::cast_slice_mut(words);
    if scale == 0.0 {
        bytes.fill(OFFSET);
        return 0.0;
    }
    let inverse = s.splat(inverse);
    // Adding this leaves the nearest integer, and the offset, in the low bits.
    let to_integer = s.splat(SHIFTER + f32::from(OFFSET));
    let whole = row.len() / LANES * LANES;
    let (rows, last) = row.split_at(whole);
    let (to, end) = bytes.split_at_mut(whole);
    for (x, to) in rows.chunks_exact(LANES).zip(to.chunks_exact_mut(LANES)) {
        to.copy_from_slice(&s.low_bytes(s.to_bits(s.add(s.mul(s.load(x), inverse), to_integer))));
    }
    if !end.is_empty() {
        let x = s.mul(s.load_partial(last, 0.0), inverse);
        end.copy_from_slice(&s.low_bytes(s.to_bits(s.add(x, to_integer)))[..end.len()]);
    }
    scale
}
