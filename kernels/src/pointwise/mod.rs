//! Narrow linear layers on each token separately, with tokens in the lanes.
//!
//! `out[j,t] = activation(Σ_k w[j,k] · x[k,t] + b[j])` for a block of [`TOKENS`] tokens: `x [k, 48]`, `w [n,k]`, `out
//! [n, 48]`, row-major.
//!
//! A layer's result has the layout of the next one's input. So tokens are transposed into lanes once ([`load`]), pass
//! through all layers of a network in the first-level cache, and are transposed back once ([`store`]).
//! [`gemm`](crate::gemm) would interleave its input again for every layer, which is worth it where layers are wide.
//!
//! # Order of accumulation
//! That of [`gemm`](crate::gemm) in f32. `k` is cut into blocks of [`K_BLOCK`]; inside a block there is one fused
//! multiply-add per step, `k` ascending, starting from +0. Block sums are added in ascending order. Both compute the
//! same bits.
//!
//! # How it runs
//! Weights are stored in groups of 8 rows, `[n/8][k][8]`, padded with zeros. The register block is 8 rows of weights by
//! 48 tokens, or 4 by 16 where there are fewer registers.

#![expect(unsafe_code, reason = "register blocks read operands by pointer")]

pub mod reference;
#[cfg(test)]
mod tests;

use tracing::debug_span;

use crate::Level;
use crate::gemm::epilogue::{Function, Gelu, Identity, Silu};
use crate::gemm::{Activation, K_BLOCK, interleave};
use crate::memory::Aligned;
use crate::parallel::for_each_chunk;
use crate::simd::{LANES, Operation, Registers, Simd, dispatch};
use crate::size::product;

/// Tokens of a block.
pub const TOKENS: usize = 3 * LANES;

/// Blocks of a task.
const BLOCKS: usize = 4;

/// Rows of weights that are stored together.
const ROWS: usize = 8;

/// A linear layer and the function behind it.
#[derive(Clone)]
pub struct Layer {
    n: usize,
    k: usize,
    /// `[n/8][k][8]`
    weights: Aligned<f32>,
    /// −0 where there is none, which changes no bit of a sum.
    bias: Vec<f32>,
    activation: Activation,
}

impl Layer {
    /// Packs `weight [n,k]` (row-major, as linear layers store it) and `bias [n]`.
    ///
    /// # Panics
    /// When `weight` does not hold `n · k` values, or `bias` not `n`.
    pub fn pack(weight: &[f32], bias: Option<&[f32]>, activation: Activation, n: usize, k: usize) -> Self {
        assert_eq!(weight.len(), product([n, k]), "weight holds {} values, expected n·k = {n}·{k}", weight.len());
        let bias = bias.map_or_else(|| vec![-0.0; n], <[f32]>::to_vec);
        assert_eq!(bias.len(), n, "bias holds {} values, expected n = {n}", bias.len());
        let mut weights = Aligned::zeroed(product([n.div_ceil(ROWS), ROWS, k]));
        interleave::<ROWS>(n, k, |j| &weight[j * k..][..k], &mut weights);
        Self { n, k, weights, bias, activation }
    }

    /// Output channels.
    pub fn n(&self) -> usize {
        self.n
    }

    /// Input channels.
    pub fn k(&self) -> usize {
        self.k
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        self.weights.bytes() + 4 * self.bias.len()
    }

    /// The layer on one block: `x [k, 48]`, `out [n, 48]`. Runs on the calling thread.
    ///
    /// # Panics
    /// When a slice has another size.
    pub fn apply(&self, level: Level, x: &[f32], out: &mut [f32]) {
        assert_eq!(
            x.len(),
            product([self.k, TOKENS]),
            "input holds {} values, expected k·48 with k = {}",
            x.len(),
            self.k
        );
        assert_eq!(
            out.len(),
            product([self.n, TOKENS]),
            "output holds {} values, expected n·48 with n = {}",
            out.len(),
            self.n
        );
        dispatch(level, Apply { layer: self, x, out });
    }
}

/// Calls `work(first, rows)` for every block of at most [`TOKENS`] rows of `width` values of `out`; `first` is the
/// index of the block's first row. `work` applies a network's layers one after the other.
///
/// # Panics
/// When `out` is not a whole number of rows.
pub fn for_each_block(out: &mut [f32], width: usize, work: impl Fn(usize, &mut [f32]) + Sync + Send) {
    if out.is_empty() {
        return;
    }
    assert!(out.len().is_multiple_of(width), "{} values in rows of {width}", out.len());
    let _span = debug_span!("pointwise", tokens = out.len() / width, width).entered();
    for_each_chunk(out, product([BLOCKS, TOKENS, width]), |task, rows| {
        for (block, rows) in rows.chunks_mut(TOKENS * width).enumerate() {
            work((task * BLOCKS + block) * TOKENS, rows);
        }
    });
}

/// Transposes up to [`TOKENS`] rows of `k` values into `to [k, 48]`; lanes without a row hold zeros.
///
/// # Panics
/// When `rows` is not a whole number of rows, or holds too many, or `to` has another size.
pub fn load(rows: &[f32], k: usize, to: &mut [f32]) {
    assert_eq!(to.len(), product([k, TOKENS]), "a block holds {} values, expected k·48 with k = {k}", to.len());
    if k == 0 {
        return;
    }
    let count = rows.len() / k;
    assert!(rows.len() == count * k && count <= TOKENS, "{} values in rows of {k}, at most 48", rows.len());
    if count == 0 {
        to.fill(0.0);
    }
    interleave::<TOKENS>(count, k, |t| &rows[t * k..][..k], to);
}

/// Transposes the first tokens of `from [n, 48]` into as many rows of `n` values as `rows` holds.
///
/// # Panics
/// When `rows` is not a whole number of rows, or holds too many, or `from` has another size.
pub fn store(from: &[f32], n: usize, rows: &mut [f32]) {
    assert_eq!(from.len(), product([n, TOKENS]), "a block holds {} values, expected n·48 with n = {n}", from.len());
    if n == 0 {
        return;
    }
    assert!(rows.len().is_multiple_of(n) && rows.len() <= from.len(), "{} values in rows of {n}", rows.len());
    for (t, row) in rows.chunks_exact_mut(n).enumerate() {
        for (to, channel) in row.iter_mut().zip(from.chunks_exact(TOKENS)) {
            *to = channel[t];
        }
    }
}

struct Apply<'a> {
    layer: &'a Layer,
    x: &'a [f32],
    out: &'a mut [f32],
}

impl Operation for Apply<'_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        match self.layer.activation {
            Activation::Identity => self.with::<S, Identity>(s),
            Activation::Silu => self.with::<S, Silu>(s),
            Activation::Gelu => self.with::<S, Gelu>(s),
        }
    }
}

impl Apply<'_> {
    #[inline(always)]
    fn with<S: Simd, A: Function>(self, s: S) {
        // Rows of weights and vectors of tokens of the register block.
        match S::REGISTERS {
            Registers::Avx512 => self.blocks::<S, A, 8, 3>(s),
            Registers::Avx2 | Registers::Neon | Registers::Scalar => self.blocks::<S, A, 4, 1>(s),
        }
    }

    /// Register blocks of `MR` rows of weights and `NV` vectors of tokens.
    #[inline(always)]
    fn blocks<S: Simd, A: Function, const MR: usize, const NV: usize>(mut self, s: S) {
        const { assert!(ROWS.is_multiple_of(MR) && TOKENS.is_multiple_of(NV * LANES), "register blocks fill groups") };
        for first in (0..self.layer.n).step_by(MR) {
            for token in (0..TOKENS).step_by(NV * LANES) {
                self.block::<S, A, MR, NV>(s, first, token);
            }
        }
    }

    /// Channels from `first` on and tokens from `token` on.
    #[inline(always)]
    fn block<S: Simd, A: Function, const MR: usize, const NV: usize>(&mut self, s: S, first: usize, token: usize) {
        let Layer { n, k, weights, bias, .. } = self.layer;
        let weights = &weights[first / ROWS * ROWS * k..][..ROWS * k];
        let mut sums = [[s.splat(0.0); NV]; MR];
        for start in (0..*k).step_by(K_BLOCK) {
            let length = K_BLOCK.min(k - start);
            let weights = &weights[start * ROWS..][..length * ROWS];
            let x = &self.x[start * TOKENS..][..length * TOKENS];
            // SAFETY: both hold `length` steps; MR rows from `first mod 8` on are among the 8, NV vectors from `token`
            // on among the 48.
            let chain = unsafe { chain(s, weights.as_ptr().add(first % ROWS), x.as_ptr().add(token), length) };
            if start == 0 {
                sums = chain;
                continue;
            }
            for r in 0..MR {
                for v in 0..NV {
                    sums[r][v] = s.add(sums[r][v], chain[r][v]);
                }
            }
        }
        for r in 0..MR.min(n - first) {
            let bias = s.splat(bias[first + r]);
            let to = &mut self.out[(first + r) * TOKENS + token..][..NV * LANES];
            for v in 0..NV {
                s.store(A::of(s, s.add(sums[r][v], bias)), &mut to[v * LANES..]);
            }
        }
    }
}

/// `Σ_k weights[k][r] · x[k][v]`: one fused multiply-add per step, `k` ascending, from +0.
///
/// # Safety
/// From each step's start, 8 and 48 values apart, `MR` values of `weights` and `16 NV` of `x` are readable, for `k`
/// steps.
#[inline(always)]
unsafe fn chain<S: Simd, const MR: usize, const NV: usize>(
    s: S,
    weights: *const f32,
    x: *const f32,
    k: usize,
) -> [[S::F32; NV]; MR] {
    let mut sums = [[s.splat(0.0); NV]; MR];
    for i in 0..k {
        // SAFETY: the caller's; i < k.
        unsafe {
            let mut b = [s.splat(0.0); NV];
            for v in 0..NV {
                b[v] = s.load_ptr(x.add(i * TOKENS + v * LANES));
            }
            for r in 0..MR {
                let a = s.splat(*weights.add(i * ROWS + r));
                for v in 0..NV {
                    sums[r][v] = s.mul_add(a, b[v], sums[r][v]);
                }
            }
        }
    }
    sums
}
