//! The feed-forward layer of a transformer block: a residual branch on each row by itself.
//!
//! `x ← x + γ·(act(norm(x)·W₁ᵀ + b₁)·W₂ᵀ + b₂)` for `x [m,d]`, `W₁ [h,d]`, `W₂ [d,h]`; absent terms are left out.
//!
//! Every step is that of [`norm`](crate::norm) and [`gemm`](crate::gemm), with their orders of accumulation and their
//! bits. A task takes a block of rows through all of them. Rows are normalised while they are packed; hidden values are
//! in memory of the task alone, which stays in the second-level cache. Where there are too few rows for that, the two
//! products are cut into tasks separately.

#[cfg(test)]
mod tests;

use tracing::debug_span;

use crate::Level;
use crate::gemm::{Epilogue, Input, Product, Weights, linear, run_here};
use crate::memory::Scratch;
use crate::norm::Norm;
use crate::parallel::for_each_chunk;
use crate::size::product;

/// The layer.
#[derive(Clone, Copy)]
pub struct FeedForward<'a> {
    /// Normalisation of the input.
    pub norm: Norm<'a>,
    /// `W₁`.
    pub expand: &'a Weights,
    /// `b₁` and the activation.
    pub hidden: Epilogue<'a>,
    /// `W₂`.
    pub contract: &'a Weights,
    /// `b₂` and `γ`; with the residual.
    pub residual: Epilogue<'a>,
}

/// Tasks that a layer is cut into where there are rows enough.
const TASKS: usize = 24;

/// The fewest tasks that keep the threads busy to the end.
const FEWEST: usize = 8;

impl FeedForward<'_> {
    /// `x ← x + …` for every row of `x [m, d]`. See [the module](self).
    ///
    /// # Panics
    /// When `x` is not a whole number of rows, or a weight or vector does not fit the others.
    pub fn accumulate(&self, level: Level, x: &mut [f32]) {
        let (d, width) = (self.norm.width(), self.expand.n());
        assert_eq!(self.contract.n(), d, "W₂ gives {} values, expected d = {d}", self.contract.n());
        if d == 0 {
            return;
        }
        let m = x.len() / d;
        assert_eq!(x.len(), m * d, "{} values in rows of {d}", x.len());
        let _span = debug_span!("feed_forward", m, d, width, precision = ?self.expand.precision()).entered();
        let rows = block(m, width);
        if m.div_ceil(rows) < FEWEST {
            let mut hidden = Scratch::take(product([m, width]));
            linear(level, Input::Normed(x, self.norm), m, self.expand, &self.hidden, &mut hidden);
            linear(level, &*hidden, m, self.contract, &self.residual, x);
            return;
        }
        for_each_chunk(x, rows * d, |_, x| {
            let m = x.len() / d;
            let mut hidden = Scratch::take(product([m, width]));
            let expand = Product::new(Input::Normed(x, self.norm), m, self.expand, &self.hidden, hidden.len());
            run_here(level, expand, &mut hidden);
            run_here(level, Product::new(Input::Rows(&hidden), m, self.contract, &self.residual, x.len()), x);
        });
    }
}

/// Rows of a task: so few that there are [`TASKS`], and that their hidden values stay in the second-level cache.
fn block(m: usize, width: usize) -> usize {
    const WHOLE: usize = 12;
    let most = if width <= 1024 { 96 } else { 48 };
    m.div_ceil(TASKS).next_multiple_of(WHOLE).clamp(WHOLE, most)
}
