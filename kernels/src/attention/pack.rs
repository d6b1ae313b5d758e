//! Keys and values in the formats of the lower modes.

use std::marker::PhantomData;

use super::layout::Layout;
use super::mix::Mix;
use super::{KEY_BLOCK, LARGEST_SCALE, Rows};
use crate::gemm::form::{Form, Multiply};
use crate::gemm::{larger, scales_of};
use crate::memory::Scratch;
use crate::simd::{LANES, Operation, Simd};

/// Converts the keys and values of one head of one window: keys as `[keys][words]` in the form `A`; values as `M` holds them, by blocks of
/// [`KEY_BLOCK`], as `[row words of the block's keys][width]`. A part at the end of `keys` and `values` may stay as it was.
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
    fn run<S: Simd>(self, s: S) {
        let width = self.layout.shape.width;
        let count = self.layout.count(self.window, self.layout.keys);
        let (layout, window, head, v) = (self.layout, self.window, self.head, self.v);
        let words = A::row_words::<S>(width);
        let mut work = Scratch::take(width);
        for (i, to) in self.keys.chunks_exact_mut(words).take(count).enumerate() {
            let key = self.k.head(layout.row(window, i), head, width);
            self.scales[i] = A::convert(s, key, None, &mut work, bytemuck::cast_slice_mut(to)).min(LARGEST_SCALE);
        }
        for (index, first) in (0..count).step_by(KEY_BLOCK).enumerate() {
            let block = Values { v, layout, window, head, first, present: KEY_BLOCK.min(count - first) };
            let scales = if M::SCALED { &mut self.value_scales[index * width..][..width] } else { &mut [] };
            block.convert::<S, M>(s, &mut self.values[first * width..], scales);
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
    /// Writes the block as `[row words][width]` as `M` holds it, and its channels' scales.
    #[inline(always)]
    fn convert<S: Simd, M: Mix>(&self, s: S, to: &mut [f32], scales: &mut [f32]) {
        let width = self.layout.shape.width;
        let rows = self.present.div_ceil(M::KEYS) * M::Product::row_words_of_a_word::<S>();
        for c in (0..width).step_by(LANES) {
            let inverse =
                if M::SCALED { self.scales_of_channels(s, c, &mut scales[c..c + LANES]) } else { s.splat(1.0) };
            for (i, to) in to.chunks_exact_mut(width).take(rows).enumerate() {
                s.store(M::row_word(s, i, self, c, inverse), &mut to[c..]);
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
