//! A block of values in the form of attention's input.

use super::layout::Layout;
use super::rows::Rows;
use crate::gemm::scales_of;
use crate::simd::{Simd, larger};

/// A block of values.
pub(super) struct Values<'a> {
    pub(super) v: Rows<'a>,
    pub(super) layout: &'a Layout,
    pub(super) window: usize,
    pub(super) head: usize,
    pub(super) first: usize,
    pub(super) present: usize,
}

impl Values<'_> {
    /// Scales of 16 channels from `c` on, as [`scales_of`] has them; returns their inverses.
    #[inline(always)]
    pub(super) fn scales_of_channels<S: Simd>(&self, s: S, c: usize, scales: &mut [f32]) -> S::F32 {
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
