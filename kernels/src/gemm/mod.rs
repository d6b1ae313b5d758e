//! Matrix products with packed weights and fused epilogues.
//!
//! `out[i,j] = epilogue(Σ_k x[i,k] · w[j,k])` for `x [m,k]`, `w [n,k]` (the layout of a linear layer's weight), `out [m,n]`,
//! all row-major.
//!
//! # Order of accumulation
//! `k` is cut into blocks of [`K_BLOCK`] ([`K_BLOCK_LOW`] in bf16). Inside a block one fused multiply-add per step, `k` ascending, starting from +0;
//! block sums are added in ascending order (the first block's sum is taken as it is). The tile in which an element lies
//! has no part in this, so the bits are the same on every level and for any number of threads.
//!
//! # Precision
//! The precision given to [`Weights::pack_as`] decides how [`linear`] holds both operands; everything else is f32 in every mode, SiLU with fewer
//! correct bits in the lower ones.
//! - **f32**: as given.
//! - **bf16**: weights and inputs are rounded to nearest even, magnitudes below 2⁻⁵⁶ become 0; the products are exact in f32
//!   and are summed as above.
//! - **int8**: a weight row has the scale `a = max|w|/127`, an input row `b = max|x|/127`; both are divided by theirs (as a product
//!   with `127/max`, rounded) and rounded to nearest even. The sum of integer products is exact, whatever its order; the result
//!   is `(f32(sum)·b)·a`. A row with a value that is not finite, or none above 1e-36, counts as zeros.
//!
//! # How it runs
//! Weights lie in panels of 16 columns, `[n/16][k][16]`, padded with zeros. A task owns a block of rows and a range of
//! panels (a fixed grid that follows from the sizes). For each panel it walks the blocks of `k`; a block of a panel
//! stays in the first-level cache while all rows of the task pass over it, the rows stay in the second level. The sums of
//! a panel wait in a small tile until their last block, then the epilogue writes them out.

pub(crate) mod epilogue;
pub(crate) mod form;
mod input;
mod microkernel;
mod places;
mod precision;
pub mod reference;
mod task;
#[cfg(test)]
mod tests;
mod weights;

pub use epilogue::{Activation, Epilogue};
pub use input::Input;
pub(crate) use microkernel::{Rows, deinterleave, interleave};
pub use precision::Precision;
#[cfg(target_arch = "x86_64")]
pub(crate) use precision::SMALLEST;
#[cfg(test)]
pub(crate) use precision::round_bf16_scalar;
pub(crate) use precision::{larger, largest, pair, pair_bf16, round_bf16, scales_of};
pub use weights::Weights;

use tracing::debug_span;

use crate::Level;
use crate::size::product;

/// Steps of `k` whose products are summed in one chain.
pub const K_BLOCK: usize = 256;

/// [`K_BLOCK`] where operands are bf16: the error of longer chains is far below that of the operands.
pub const K_BLOCK_LOW: usize = 1024;

/// `out[i,j] = epilogue(Σ_k x[i,k] · w[j,k])` for `x [m,k]`, `out [m,n]`. See [the module](self) for the order of accumulation,
/// [`Input`] for rows that are normalised first, and [`Epilogue`] for what can follow the product and for how `out` lies. `m` may be 0.
///
/// # Panics
/// When a slice does not have the size that `m`, the weights' `n` and `k` ask for.
pub fn linear<'a>(
    level: Level,
    x: impl Into<Input<'a>>,
    m: usize,
    weights: &Weights,
    epilogue: &Epilogue<'_>,
    out: &mut [f32],
) {
    let product = Product::new(x.into(), m, weights, epilogue, out.len());
    let _span = debug_span!("gemm", m, n = weights.n, k = weights.k, precision = ?weights.precision).entered();
    product.run(level, out);
}

/// A product whose sizes have been checked.
#[derive(Clone, Copy)]
pub(crate) struct Product<'a> {
    x: Input<'a>,
    m: usize,
    weights: &'a Weights,
    epilogue: &'a Epilogue<'a>,
}

impl<'a> Product<'a> {
    /// Checks the sizes, with `len` values to write.
    pub(crate) fn new(x: Input<'a>, m: usize, weights: &'a Weights, epilogue: &'a Epilogue<'a>, len: usize) -> Self {
        let (n, k) = (weights.n, weights.k);
        x.check(m, k);
        assert_eq!(len, product([m, n]), "output holds {len} values, expected m·n = {m}·{n}");
        epilogue.check(m, n);
        Self { x, m, weights, epilogue }
    }

    /// In tasks.
    fn run(self, level: Level, out: &mut [f32]) {
        match self.weights.precision {
            Precision::F32 => task::run::<form::Single>(level, self, out),
            Precision::Bf16 => task::run::<form::Brain>(level, self, out),
            Precision::Int8 => task::run::<form::Bytes>(level, self, out),
        }
    }

    /// On the calling thread, as part of a larger task.
    pub(crate) fn run_here(self, level: Level, out: &mut [f32]) {
        match self.weights.precision {
            Precision::F32 => task::run_here::<form::Single>(level, self, out),
            Precision::Bf16 => task::run_here::<form::Brain>(level, self, out),
            Precision::Int8 => task::run_here::<form::Bytes>(level, self, out),
        }
    }
}
