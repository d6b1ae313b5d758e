//! Weights in the layout that the register block reads.

use std::marker::PhantomData;

use rayon::prelude::*;

use super::Precision;
use super::form::{Bf16, F32, Form, Int8, values_of_a_word};
use crate::Level;
use crate::memory::{Aligned, Scratch};
use crate::simd::{LANES, Operation, Simd, dispatch};
use crate::size::product;

/// A linear layer's weight, packed for [`linear`](super::linear).
///
/// The packing is the same on every level. It replaces the original: `weight` can be dropped afterwards.
#[derive(Clone)]
pub struct Weights {
    pub(super) n: usize,
    pub(super) k: usize,
    pub(super) precision: Precision,
    /// `[n/16][words][16]`
    pub(super) panels: Aligned<u32>,
    /// Scale of the integers per column, to whole panels. Empty except for 8-bit integers.
    pub(super) scales: Vec<f32>,
    /// Per column, to whole panels: 128 times the sum of its integers. Empty except for 8-bit integers.
    pub(super) offsets: Vec<i32>,
}

impl Weights {
    /// Packs `weight [n,k]` (row-major, as linear layers store it) in f32.
    ///
    /// # Panics
    /// When `weight` does not hold `n · k` values.
    pub fn pack(level: Level, weight: &[f32], n: usize, k: usize) -> Self {
        Self::pack_as(level, Precision::F32, weight, n, k)
    }

    /// Packs `weight [n,k]` for products in `precision`: half of f32's memory in bf16, a quarter in 8-bit integers.
    ///
    /// # Panics
    /// When `weight` does not hold `n · k` values, or `k` is above 2¹⁶ (where sums of 8-bit products could overflow).
    pub fn pack_as(level: Level, precision: Precision, weight: &[f32], n: usize, k: usize) -> Self {
        match precision {
            Precision::F32 => Self::pack_form::<F32>(level, weight, n, k),
            Precision::Bf16 => Self::pack_form::<Bf16>(level, weight, n, k),
            Precision::Int8 => Self::pack_form::<Int8>(level, weight, n, k),
        }
    }

    fn pack_form<F: Form>(level: Level, weight: &[f32], n: usize, k: usize) -> Self {
        assert_eq!(weight.len(), product([n, k]), "weight holds {} values, expected n·k = {n}·{k}", weight.len());
        assert!(k <= 1 << 16, "rows of {k} values, expected at most 65536");
        let words = k.div_ceil(values_of_a_word(F::PRECISION));
        let mut panels = Aligned::<u32>::zeroed(product([n.div_ceil(LANES), words, LANES]));
        let columns: Vec<_> = match (words, F::PRECISION) {
            (0, Precision::Int8) => vec![([0.0; LANES], [0; LANES]); n.div_ceil(LANES)],
            (0, _) => Vec::new(),
            _ => panels
                .par_chunks_mut(words * LANES)
                .zip(weight.par_chunks(LANES * k))
                .map(|(panel, rows)| dispatch(level, Pack { rows, k, panel, form: PhantomData::<fn(F)> }))
                .collect(),
        };
        let (scales, offsets): (Vec<_>, Vec<_>) = match F::PRECISION {
            Precision::Int8 => columns.into_iter().unzip(),
            _ => Default::default(),
        };
        Self {
            n,
            k,
            precision: F::PRECISION,
            panels,
            scales: scales.into_flattened(),
            offsets: offsets.into_flattened(),
        }
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

/// Packs a panel of up to 16 rows of `k` weights; returns their scales and offsets, as [`Form::convert_column`] has
/// them.
struct Pack<'a, F> {
    rows: &'a [f32],
    k: usize,
    panel: &'a mut [u32],
    form: PhantomData<fn(F)>,
}

impl<F: Form> Operation for Pack<'_, F> {
    type Output = ([f32; LANES], [i32; LANES]);
    #[inline(always)]
    fn run<S: Simd>(self, s: S) -> Self::Output {
        let (mut scales, mut offsets) = ([0.0; LANES], [0; LANES]);
        let mut values = Scratch::take(self.k.next_multiple_of(4));
        let mut line = Scratch::take(self.panel.len() / LANES);
        let line: &mut [u32] = bytemuck::cast_slice_mut(&mut line);
        for (lane, row) in self.rows.chunks_exact(self.k).enumerate() {
            (scales[lane], offsets[lane]) = F::convert_column(s, row, &mut values, line);
            for (to, word) in self.panel[lane..].iter_mut().step_by(LANES).zip(&*line) {
                *to = *word;
            }
        }
        (scales, offsets)
    }
}
