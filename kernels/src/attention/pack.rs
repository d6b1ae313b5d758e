//! Keys and values in the layout that the register blocks read.

use std::marker::PhantomData;

use super::layout::Layout;
use super::mix::Mix;
use super::{KEY_BLOCK, LARGEST_SCALE, Rows};
use crate::gemm::form::{Form, Multiply};
use crate::gemm::{Precision, interleave, larger, scales_of};
use crate::memory::Scratch;
use crate::simd::{LANES, Operation, Simd};

/// Packs the keys and values of one head of one window: keys as `[keys/KR][words][KR]` in the form `A`; values as `M` holds them, by
/// blocks of [`KEY_BLOCK`], as `[width/CR][row words of the block's keys][CR]`. A part at the end of `keys` and `values` may stay as it was.
pub(super) struct Pack<'a, A, M> {
    pub(super) layout: &'a Layout,
    pub(super) k: Rows<'a>,
    pub(super) v: Rows<'a>,
    pub(super) window: usize,
    pub(super) head: usize,
    pub(super) keys: &'a mut [f32],
    pub(super) values: &'a mut [f32],
    /// Per key.
    pub(super) scales: &'a mut [f32],
    /// Per block of keys and channel, where `M` has them.
    pub(super) value_scales: &'a mut [f32],
    pub(super) forms: PhantomData<fn(A, M)>,
}

impl<A: Form, M: Mix> Operation for Pack<'_, A, M> {
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

impl<A: Form, M: Mix> Pack<'_, A, M> {
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
                self.scales[i] =
                    A::convert(s, key(i), None, &mut work, bytemuck::cast_slice_mut(to)).min(LARGEST_SCALE);
            }
            interleave::<KR>(count, words, |i| &converted[i * words..][..words], &mut *self.keys);
        }
        for (index, first) in (0..count).step_by(KEY_BLOCK).enumerate() {
            let block = Values { v, layout, window, head, first, present: KEY_BLOCK.min(count - first) };
            let scales = if M::SCALED { &mut self.value_scales[index * width..][..width] } else { &mut [] };
            block.spread::<S, M, CR>(s, &mut self.values[first * width..], scales);
        }
    }
}

/// A block of values.
pub(super) struct Values<'a> {
    v: Rows<'a>,
    layout: &'a Layout,
    window: usize,
    head: usize,
    first: usize,
    present: usize,
}

impl Values<'_> {
    /// Writes the block as `[width/CR][row words][CR]` as `M` holds it, and its channels' scales; what is left of `width` is a last group of
    /// its own.
    #[inline(always)]
    fn spread<S: Simd, M: Mix, const CR: usize>(&self, s: S, to: &mut [f32], scales: &mut [f32]) {
        let width = self.layout.shape.width;
        let rows = self.present.div_ceil(M::KEYS) * M::Product::row_words_of_a_word::<S>();
        let whole = width / CR * CR;
        for c in (0..width).step_by(LANES) {
            let inverse =
                if M::SCALED { self.scales_of_channels(s, c, &mut scales[c..c + LANES]) } else { s.splat(1.0) };
            for i in 0..rows {
                let from = s.to_array(M::row_word(s, i, self, c, inverse));
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

    /// Scales of 16 channels from `c` on, as [`scales_of`] has them; returns their inverses.
    #[inline(always)]
    fn scales_of_channels<S: Simd>(&self, s: S, c: usize, scales: &mut [f32]) -> S::F32 {
        let mut most = s.splat_i32(0);
        for i in 0..self.present {
            most = larger(s, most, self.value(s, i, c));
        }
        let (scale, inverse) = scales_of(s, s.from_bits(most));
        s.store(scale, scales);
        inverse
    }

    /// 16 channels from `c` on of value `i`; zeros past the last.
    #[inline(always)]
    pub(super) fn value<S: Simd>(&self, s: S, i: usize, c: usize) -> S::F32 {
        if i >= self.present {
            return s.splat(0.0);
        }
        let row = self.layout.row(self.window, self.first + i);
        s.load(&self.v.head(row, self.head, self.layout.shape.width)[c..])
    }
}
