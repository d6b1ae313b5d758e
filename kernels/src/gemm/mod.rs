//! Matrix products with packed weights and fused epilogues.
//!
//! `out[i,j] = epilogue(Σ_k x[i,k] · w[j,k])` for `x [m,k]`, `w [n,k]` (the layout of a linear layer's weight), `out
//! [m,n]`, all row-major.
//!
//! # Order of accumulation
//! `k` is cut into blocks of [`K_BLOCK`] ([`K_BLOCK_LOW`] in bf16). Inside a block one fused multiply-add per step, `k`
//! ascending, starting from +0; block sums are added in ascending order (the first block's sum is taken as it is). This
//! does not depend on the tile that holds an element, so the bits are the same on every level and for any number of
//! threads.
//!
//! # Precision
//! The precision passed to [`Weights::pack_as`] decides how [`linear`] holds both operands; everything else is f32 in
//! every mode, SiLU with fewer correct bits in the lower ones.
//! - **f32**: unchanged.
//! - **bf16**: weights and inputs are rounded to nearest even, magnitudes below 2⁻⁵⁶ become 0; the products are exact
//!   in f32 and are summed as above.
//! - **int8**: a weight row has the scale `a = max|w|/127`, an input row `b = max|x|/127`; both are divided by theirs
//!   (as a product with `127/max`, rounded) and rounded to nearest even. The sum of integer products is exact in any
//!   order; the result is `(f32(sum)·b)·a`. A row with a value that is not finite, or none above 1e-36, counts as
//!   zeros.
//!
//! # How it runs
//! Weights are stored in panels of 16 columns, `[n/16][k][16]`, padded with zeros. A task owns a block of rows and a
//! range of panels (a fixed grid that follows from the sizes). For each panel it walks the blocks of `k`. A block of a
//! panel stays in the first-level cache while all rows of the task pass over it; the rows stay in the second level. The
//! sums of a panel are kept in a small tile until their last block, then the epilogue writes them out.

pub(crate) mod epilogue;
pub(crate) mod form;
mod input;
mod microkernel;
mod places;
mod precision;
mod product;
pub mod reference;
mod task;
#[cfg(test)]
mod tests;
mod weights;

pub use epilogue::{Activation, Epilogue};
pub use input::Input;
pub(crate) use microkernel::{Strided, deinterleave, interleave};
pub(crate) use precision::scales_of;
pub use precision::{K_BLOCK, K_BLOCK_LOW, Precision};
pub(crate) use product::Product;
pub(crate) use task::run_here;
pub use weights::Weights;

use tracing::debug_span;

use crate::Level;

/// `out[i,j] = epilogue(Σ_k x[i,k] · w[j,k])` for `x [m,k]`, `out [m,n]`. See [the module](self) for the order of
/// accumulation, [`Input`] for rows that are normalised first, and [`Epilogue`] for the steps after the product and the
/// layout of `out`. `m` may be 0.
///
/// # Panics
/// When a slice does not have the size of `m` and the weights' `n` and `k`.
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
    task::run(level, product, out);
}
