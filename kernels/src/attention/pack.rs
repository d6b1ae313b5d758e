//! Keys and values in the layout that the register blocks read.

use std::marker::PhantomData;

use super::layout::Layout;
use super::{KEY_BLOCK, Rows};
use crate::gemm::form::{Form, values_of_a_word};
use crate::gemm::{Precision, interleave, pair_bf16, round_bf16};
use crate::memory::Scratch;
use crate::simd::{LANES, Operation, Simd};

/// Packs the keys and values of one head of one window: keys as `[keys/KR][words][KR]` in the form `A`; values in the form `B`, by
/// blocks of [`KEY_BLOCK`], as `[width/CR][words of the block's keys][CR]`. A part at the end of `keys` and `values` may stay as it was.
pub(super) struct Pack<'a, A, B> {
    pub(super) layout: &'a Layout,
    pub(super) k: Rows<'a>,
    pub(super) v: Rows<'a>,
    pub(super) window: usize,
    pub(super) head: usize,
    pub(super) keys: &'a mut [f32],
    pub(super) values: &'a mut [f32],
    /// Per key.
    pub(super) scales: &'a mut [f32],
    pub(super) forms: PhantomData<fn(A, B)>,
}

impl<A: Form, B: Form> Operation for Pack<'_, A, B> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(mut self, s: S) {
        match (S::GEMM_ROWS, S::GEMM_PANELS) {
            (12, 2) => self.pack::<S, 12, 8>(s),
            (6, 1) => self.pack::<S, 6, 6>(s),
            _ => self.pack::<S, 4, 4>(s),
        }
    }
}

impl<A: Form, B: Form> Pack<'_, A, B> {
    #[inline(always)]
    fn pack<S: Simd, const KR: usize, const CR: usize>(&mut self, s: S) {
        let width = self.layout.shape.width;
        let count = self.layout.count(self.window, self.layout.keys);
        let (layout, window, head, k, v) = (self.layout, self.window, self.head, self.k, self.v);
        let key = |i| k.head(layout.row(window, i), head, width);
        if A::PRECISION == Precision::F32 {
            interleave::<KR>(count, width, key, &mut *self.keys);
        } else {
            let words = A::row_words::<S>(width);
            let mut converted = Scratch::take(count * words);
            let mut work = Scratch::take(width);
            for (i, to) in converted.chunks_exact_mut(words).enumerate() {
                self.scales[i] = A::convert(s, key(i), &mut work, bytemuck::cast_slice_mut(to));
            }
            interleave::<KR>(count, words, |i| &converted[i * words..][..words], &mut *self.keys);
        }
        for first in (0..count).step_by(KEY_BLOCK) {
            let block = Values { v, layout, window, head, first, present: KEY_BLOCK.min(count - first) };
            block.spread::<S, B, CR>(s, &mut self.values[first * width..]);
        }
    }
}

/// A block of values.
struct Values<'a> {
    v: Rows<'a>,
    layout: &'a Layout,
    window: usize,
    head: usize,
    first: usize,
    present: usize,
}

impl Values<'_> {
    /// Writes the block as `[width/CR][rows][CR]` words in the form `B`; what is left of `width` is a last group of its own.
    #[inline(always)]
    fn spread<S: Simd, B: Form, const CR: usize>(&self, s: S, to: &mut [f32]) {
        let width = self.layout.shape.width;
        let (values, words) = (values_of_a_word(B::PRECISION), B::row_words_of_a_word::<S>());
        let rows = self.present.div_ceil(values) * words;
        let whole = width / CR * CR;
        for i in 0..rows {
            for c in (0..width).step_by(LANES) {
                let from = if B::PRECISION == Precision::F32 {
                    self.value(s, i, c)
                } else if values == words {
                    round_bf16(s, self.value(s, i, c))
                } else {
                    let (a, b) = (self.value(s, 2 * i, c), self.value(s, 2 * i + 1, c));
                    s.from_bits(pair_bf16(s, round_bf16(s, a), round_bf16(s, b)))
                };
                let from = s.to_array(from);
                let mut at = 0;
                while at < LANES {
                    let (group, inside) = ((c + at) / CR * CR, (c + at) % CR);
                    let size = if group < whole { CR } else { width - whole };
                    let length = (size - inside).min(LANES - at);
                    to[group * rows + i * size + inside..][..length].copy_from_slice(&from[at..at + length]);
                    at += length;
                }
            }
        }
    }

    /// 16 channels from `c` on of value `i`; zeros past the last.
    #[inline(always)]
    fn value<S: Simd>(&self, s: S, i: usize, c: usize) -> S::F32 {
        if i >= self.present {
            return s.splat(0.0);
        }
        let row = self.layout.row(self.window, self.first + i);
        s.load(&self.v.head(row, self.head, self.layout.shape.width)[c..])
    }
}
