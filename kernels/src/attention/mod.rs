//! Scaled dot-product attention over heads, in runs of tokens, without a matrix of all pairs.
//!
//! For every head and every window of tokens, with queries `q`, keys `k`, values `v` of `width` channels:
//!
//! `out[i] = Σ_j w[i,j] v[j] / Σ_j w[i,j]`, `w[i,j] = exp((q[i]·k[j] − max_j q[i]·k[j]) / √width)`
//!
//! # Order of operations
//! - `s = q·k`: one chain of fused multiply-adds over the channels, ascending, from +0.
//! - Keys are taken in blocks of [`KEY_BLOCK`], ascending. With `c` = `log2(e)/√width` rounded to f32, the query's
//!   reference is `M = max(M, c·max s)`; earlier sums are scaled by `r = 2^(M_old − M)`.
//! - The weight of a key is `2^(fma(s, c, −M))` (see `weight.rs`), never below `2^−64` nor, where logits are so large
//!   that `M` is rounded by more, above 2.
//! - `Σ w`: a block has four sums, of its keys 0, 4, 8 …, of 1, 5, 9 …, and so on, each ascending from +0. The block's
//!   sum is `(0 + 1) + (2 + 3)`; the query's sum becomes `fma(sum, r, block)`.
//! - `Σ w v`: one chain over a block's keys, ascending, from +0; the query's sum becomes `fma(sum, r, block)`.
//! - The result is `sum · (1 / Σ w)`.
//!
//! # How it runs
//! Lanes are queries: a vector holds one key's score for 16 queries, so that softmax needs no sums across a vector.
//! Keys and channels of values are the rows of the register block, queries and weights its panels; a block of weights
//! is stored as the panel that its product with the values reads. A row's words may be anywhere as long as the next
//! row's are a fixed distance away. So f32 keys and values are read where the projection wrote them, best in the layout
//! of [`Rows::of_heads`]. In the lower modes they are converted once, in the same order. Only a block of keys that is
//! cut apart by the roll is copied.
//!
//! # Precision
//! In the lower modes ([`attend_as`]) both products have smaller operands; the order of operations is otherwise the
//! same.
//! - bf16: queries, keys and values are rounded to bf16 as inputs of [`crate::gemm`] are; `s` is the same chain. A
//!   weight is rounded to bf16 (to nearest, ties up) before it is summed or multiplied, comes from a shorter polynomial
//!   (7.5e-5) and is never below `2^−56`.
//! - int8: a query's or key's channels of a head are 8-bit integers with one scale each, `a` and `b`, as a row of a
//!   product's inputs has (but at most 2⁴⁸). `s = f32(Σ integers)·b`, whose sum is exact, and `c` is multiplied by `a`
//!   (rounded). A block of keys has a reference of its own, `B = max s·c`; its weights are the integers nearest to
//!   `255·2^(s·c − B)` (the same short polynomial; ties to even), its values 8-bit integers with a scale `d` per
//!   channel of the block. `Σ w` and `Σ w v` of a block are exact. With `M = max(M, B)`, `r` as above and `u = 2^(B −
//!   M)`, the query's sums become `fma(sum, r, f32(Σ w)·u)` and `fma(sum, r, f32(Σ w v)·(u·d))`. A weight less than
//!   1/510 of the largest of its block weighs nothing.
//!
//! # Extremes
//! A logit that is NaN or −∞ weighs `2^−64` (`2^−56` in bf16) of the largest. A row in which all logits are NaN or −∞
//! returns the mean of its values. So does a row in which every logit is +∞: while `M` is infinite, `r` is 1 where `M`
//! stays, and all weights are equal. A row with some logits at +∞ returns some mean of its values. In int8 a query or
//! key with a value that is not finite counts as zeros, and so does a channel of a block of values. Otherwise a NaN or
//! infinite *value* reaches every row that sees its key: callers reject such input.
//!
//! Source: "StreamSplat (ICLR 2026)", encoder, decoder and upsampler blocks; the online form is that of Milakov and
//! Gimelshein (2018) and of FlashAttention (2022).

mod block;
mod layout;
mod pack;
pub mod reference;
mod rows;
#[cfg(test)]
mod tests;
mod values;
mod weight;
mod weighted_sum;

pub use rows::{KEY_BLOCK, Rows, Shape, Windows};

use std::marker::PhantomData;

use rayon::prelude::*;
use tracing::debug_span;

use crate::Level;
use crate::gemm::Precision;
use crate::gemm::form::{Bf16, F32, Form, Int8};
use crate::memory::Scratch;
use crate::parallel::Disjoint;
use crate::simd::{LANES, dispatch};
use crate::size::product;
use block::{Block, Packed};
use layout::Layout;
use pack::Pack;
use weighted_sum::{Bf16Sum, F32Sum, Int8Sum, WeightedSum};

/// `out [queries, heads·width]` = attention of `q` over `k` and `v`. See [the module](self).
///
/// Without keys the result is zero.
///
/// # Panics
/// When `width` is not a multiple of 16, when `k` and `v` differ in rows, or when runs are requested and `q` and `k`
/// differ in rows. When a matrix is narrower than `heads · width` or has heads of another width, or `out` has another
/// size.
pub fn attend(level: Level, shape: Shape, q: Rows<'_>, k: Rows<'_>, v: Rows<'_>, out: &mut [f32]) {
    attend_as(Precision::F32, level, shape, q, k, v, out);
}

/// [`attend`] with the operands of both products held in `precision`.
///
/// # Panics
/// As [`attend`].
pub fn attend_as(
    precision: Precision,
    level: Level,
    shape: Shape,
    q: Rows<'_>,
    k: Rows<'_>,
    v: Rows<'_>,
    out: &mut [f32],
) {
    run(precision, level, shape, None, q, k, v, out);
}

/// [`attend_as`] for some of the queries: row `i` of `q` and of `out` belongs to token `places[i]`. A row's bits do not
/// depend on the other rows.
///
/// # Panics
/// As [`attend`], except that the number of queries is free. When there are not as many places as queries, or when runs
/// are requested and a place is not that of a key.
#[expect(clippy::too_many_arguments, reason = "those of `attend_as` and the places")]
pub fn attend_some(
    precision: Precision,
    level: Level,
    shape: Shape,
    places: &[u32],
    q: Rows<'_>,
    k: Rows<'_>,
    v: Rows<'_>,
    out: &mut [f32],
) {
    assert_eq!(places.len(), q.rows, "{} places for {} queries", places.len(), q.rows);
    run(precision, level, shape, Some(places), q, k, v, out);
}

#[expect(clippy::too_many_arguments, reason = "those of `attend_as` and the places")]
fn run(
    precision: Precision,
    level: Level,
    shape: Shape,
    places: Option<&[u32]>,
    q: Rows<'_>,
    k: Rows<'_>,
    v: Rows<'_>,
    out: &mut [f32],
) {
    let Shape { heads, width, .. } = shape;
    assert!(width > 0 && width.is_multiple_of(LANES), "heads of {width} channels, expected a multiple of {LANES}");
    assert_eq!(k.rows, v.rows, "{} keys but {} values", k.rows, v.rows);
    for (name, m) in [("queries", q), ("keys", k), ("values", v)] {
        assert!(
            m.holds(heads, width),
            "{name}: {heads} heads of {width} from value {} on, in rows of {} and {} values",
            m.first,
            m.stride,
            m.values.len()
        );
    }
    assert_eq!(
        out.len(),
        product([q.rows, heads, width]),
        "output holds {} values, expected {}·{heads}·{width}",
        out.len(),
        q.rows
    );
    let _span = debug_span!("attention", queries = q.rows, keys = k.rows, heads, ?precision).entered();
    if heads == 0 {
        return;
    }
    let layout = Layout::new(shape, q.rows, k.rows, places);
    if k.rows == 0 {
        out.fill(0.0);
        return;
    }
    match precision {
        Precision::F32 => compute::<F32, F32Sum>(level, &layout, q, k, v, out),
        Precision::Bf16 => compute::<Bf16, Bf16Sum>(level, &layout, q, k, v, out),
        Precision::Int8 => compute::<Int8, Int8Sum>(level, &layout, q, k, v, out),
    }
}

/// The attention with the operands of `q·k` in the form `A` and `w·v` as `W` holds it.
fn compute<A: Form, W: WeightedSum>(
    level: Level,
    layout: &Layout,
    q: Rows<'_>,
    k: Rows<'_>,
    v: Rows<'_>,
    out: &mut [f32],
) {
    let sized = |len: usize| Scratch::take(if A::PRECISION == Precision::F32 { 0 } else { len });
    let (mut keys, mut values) = (sized(layout.packed_len()), sized(layout.packed_len()));
    let (mut scales, mut value_scales) = (sized(layout.packed_rows()), sized(layout.all_value_scales()));
    if A::PRECISION != Precision::F32 {
        let parts = keys.par_chunks_mut(layout.head_len()).zip(values.par_chunks_mut(layout.head_len()));
        let scale_parts =
            scales.par_chunks_mut(layout.head_rows()).zip(value_scales.par_chunks_mut(layout.head_value_scales()));
        parts.zip(scale_parts).enumerate().for_each(|(index, ((keys, values), (scales, value_scales)))| {
            let (window, head) = (index / layout.shape.heads, index % layout.shape.heads);
            if layout.queries(window) > 0 {
                let pack =
                    Pack::<A, W> { layout, k, v, window, head, keys, values, scales, value_scales, forms: PhantomData };
                dispatch(level, pack);
            }
        });
    }
    let packed = Packed { keys: &keys, values: &values, scales: &scales, value_scales: &value_scales };
    let out = &Disjoint::new(out);
    layout.tasks().par_iter().with_max_len(1).for_each(|task| {
        let block = Block::<A, W> { layout, task, q, k, v, packed, out, forms: PhantomData };
        dispatch(level, block);
    });
}
