//! Keys and values in the formats of the lower modes.

use std::marker::PhantomData;

use super::layout::Layout;
use super::rows::{KEY_BLOCK, LARGEST_SCALE, Rows};
use super::values::Values;
use super::weighted_sum::WeightedSum;
use crate::gemm::Precision;
use crate::gemm::form::{Form, Multiply};
use crate::memory::Scratch;
use crate::simd::{LANES, Operation, Simd};

/// Converts the keys and values of one head of one window: keys as `[keys][words]` in the form `A`; values as `W` holds
/// them, by blocks of [`KEY_BLOCK`], as `[row words of the block's keys][width]`. The end of `keys` and `values` may
/// stay as it was.
pub(super) struct Pack<'a, A, W> {
    pub(super) layout: &'a Layout,
    pub(super) k: Rows<'a>,
    pub(super) v: Rows<'a>,
    pub(super) window: usize,
    pub(super) head: usize,
    pub(super) keys: &'a mut [f32],
    pub(super) values: &'a mut [f32],
    /// Per key.
    pub(super) scales: &'a mut [f32],
    /// Per block of keys and channel, where `W` has them.
    pub(super) value_scales: &'a mut [f32],
    pub(super) forms: PhantomData<fn(A, W)>,
}

impl<A: Form, W: WeightedSum> Operation for Pack<'_, A, W> {
    const DOT_PRODUCTS: bool = !matches!(A::PRECISION, Precision::F32);
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
            let scales = if W::SCALED { &mut self.value_scales[index * width..][..width] } else { &mut [] };
            convert::<S, W>(s, &block, &mut self.values[first * width..], scales);
        }
    }
}

/// Writes the block as `[row words][width]` as `W` holds it, and its channels' scales.
#[inline(always)]
fn convert<S: Simd, W: WeightedSum>(s: S, block: &Values<'_>, to: &mut [f32], scales: &mut [f32]) {
    let width = block.layout.shape.width;
    let rows = block.present.div_ceil(W::KEYS) * W::Product::row_words_of_a_word::<S>();
    for c in (0..width).step_by(LANES) {
        let inverse = if W::SCALED { block.scales_of_channels(s, c, &mut scales[c..c + LANES]) } else { s.splat(1.0) };
        for (i, to) in to.chunks_exact_mut(width).take(rows).enumerate() {
            s.store(W::row_word(s, i, block, c, inverse), &mut to[c..]);
        }
    }
}
