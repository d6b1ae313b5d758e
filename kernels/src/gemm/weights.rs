//! Weights in the layout that the register block reads.

use rayon::prelude::*;

use super::form::values_of_a_word;
use super::precision::{Precision, pair, round_bf16_scalar, scale_of};
use crate::memory::Aligned;
use crate::simd::LANES;

/// A linear layer's weight, packed for [`linear`](super::linear).
///
/// The packing is the same on every level. It replaces the original: nothing needs `weight` afterwards.
#[derive(Clone)]
pub struct Weights {
    pub(super) n: usize,
    pub(super) k: usize,
    pub(super) precision: Precision,
    /// `[n/16][words][16]`
    pub(super) panels: Aligned<u32>,
    /// Per column, to whole panels: what one unit of the integers stands for. Empty but for 8-bit integers.
    pub(super) scales: Vec<f32>,
    /// Per column, to whole panels: 128 times the sum of its integers. Empty but for 8-bit integers.
    pub(super) offsets: Vec<i32>,
}

impl Weights {
    /// Packs `weight [n,k]` (row-major, as linear layers store it) in f32.
    ///
    /// # Panics
    /// When `weight` does not hold `n · k` values.
    pub fn pack(weight: &[f32], n: usize, k: usize) -> Self {
        Self::pack_as(Precision::F32, weight, n, k)
    }

    /// Packs `weight [n,k]` for products in `precision`: half of f32's memory in bf16, a quarter in 8-bit integers.
    ///
    /// # Panics
    /// When `weight` does not hold `n · k` values, or `k` is above 2¹⁶ (where sums of 8-bit products could overflow).
    pub fn pack_as(precision: Precision, weight: &[f32], n: usize, k: usize) -> Self {
        assert_eq!(weight.len(), n * k, "weight holds {} values, expected n·k = {n}·{k}", weight.len());
        assert!(k <= 1 << 16, "rows of {k} values, expected at most 65536");
        let words = k.div_ceil(values_of_a_word(precision));
        let mut panels = Aligned::<u32>::zeroed(n.div_ceil(LANES) * words * LANES);
        let integers = precision == Precision::Int8;
        let columns = if integers { n.next_multiple_of(LANES) } else { 0 };
        let (mut scales, mut offsets) = (vec![0.0; columns], vec![0; columns]);
        if words > 0 {
            panels.par_chunks_mut(words * LANES).enumerate().for_each(|(panel, to)| {
                for lane in 0..LANES.min(n - panel * LANES) {
                    let row = &weight[(panel * LANES + lane) * k..][..k];
                    pack_row(precision, row, to[lane..].iter_mut().step_by(LANES));
                }
            });
        }
        if integers && k > 0 {
            scales.par_iter_mut().zip(&mut offsets).zip(weight.par_chunks(k)).for_each(|((scale, offset), row)| {
                let (step, inverse) = row_scale(row);
                *scale = step;
                *offset = 128 * row.iter().map(|&w| quantise(w, inverse)).sum::<i32>();
            });
        }
        Self { n, k, precision, panels, scales, offsets }
    }

    /// Output columns.
    pub fn n(&self) -> usize {
        self.n
    }

    /// Input columns.
    pub fn k(&self) -> usize {
        self.k
    }

    /// The format of the operands.
    pub fn precision(&self) -> Precision {
        self.precision
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        self.panels.bytes() + 8 * self.scales.len()
    }

    pub(super) fn panel_count(&self) -> usize {
        self.n.div_ceil(LANES)
    }

    /// Words of one lane of a panel.
    pub(super) fn words(&self) -> usize {
        self.k.div_ceil(values_of_a_word(self.precision))
    }
}

/// The scale of a row of weights and its inverse; zeros for a row with a value that is not finite.
pub(super) fn row_scale(row: &[f32]) -> (f32, f32) {
    scale_of(row.iter().fold(0.0, |most: f32, w| if w.is_nan() { f32::INFINITY } else { most.max(w.abs()) }))
}

/// A weight in units of its scale.
pub(super) fn quantise(w: f32, inverse: f32) -> i32 {
    if inverse > 0.0 { (w * inverse).round_ties_even() as i32 } else { 0 }
}

fn pack_row<'a>(precision: Precision, row: &[f32], to: impl Iterator<Item = &'a mut u32>) {
    match precision {
        Precision::F32 => to.zip(row).for_each(|(to, w)| *to = w.to_bits()),
        Precision::Bf16 => to.zip(row.chunks(2)).for_each(|(to, two)| {
            let second = two.get(1).copied().unwrap_or(0.0);
            *to = pair(round_bf16_scalar(two[0]), round_bf16_scalar(second));
        }),
        Precision::Int8 => {
            let (_, inverse) = row_scale(row);
            to.zip(row.chunks(4)).for_each(|(to, four)| {
                *to = four.iter().rev().fold(0, |word, &w| word << 8 | quantise(w, inverse) as u8 as u32);
            });
        }
    }
}
