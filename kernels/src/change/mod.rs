//! The rows of a matrix that moved since their last comparison.
//!
//! A row `x` has moved from its reference `r` unless `Σ (x − r)² ≤ τ² · Σ r²` with the tolerance `τ`. Without a
//! tolerance it has moved as soon as one bit differs.
//!
//! # Order of operations
//! Both sums have 16 lanes. Lane `i mod 16` takes its elements in ascending order, each by one fused multiply-add from
//! +0; the last part of a row is filled with zeros. Then [`Simd::sum`] folds the lanes. `τ²` is rounded, then its
//! product with the second sum.
//!
//! # Extremes
//! A row whose difference overflows, or that holds a NaN, moved. Rows are independent.

pub mod reference;
#[cfg(test)]
mod tests;

use tracing::debug_span;

use crate::Level;
use crate::parallel::for_each_chunk;
use crate::simd::{LANES, Operation, Simd, dispatch};
use crate::size::product;

/// Values of a task.
const TASK: usize = 1 << 14;

/// When a row counts as moved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Tolerance {
    /// As soon as a bit differs.
    Bits,
    /// When its distance from the reference is above this fraction of the reference's length.
    Relative(f32),
}

/// Sets `out[i]` to whether row `i` of `x [out.len(), d]` moved from row `at[i]` of `references [_, d]`, or from row
/// `i` without `at`.
///
/// # Panics
/// When `x` or `at` have another number of rows than `out`, or `references` too few.
pub fn moved(
    level: Level,
    tolerance: Tolerance,
    d: usize,
    x: &[f32],
    references: &[f32],
    at: Option<&[u32]>,
    out: &mut [bool],
) {
    assert_eq!(x.len(), product([out.len(), d]), "{} values in {} rows of {d}", x.len(), out.len());
    if let Some(at) = at {
        assert_eq!(at.len(), out.len(), "{} places for {} rows", at.len(), out.len());
    }
    let _span = debug_span!("change", rows = out.len(), width = d).entered();
    let chunk = (TASK / d.max(1)).max(1);
    for_each_chunk(out, chunk, |index, out| {
        let first = index * chunk;
        dispatch(level, Task { tolerance, d, x: &x[first * d..][..out.len() * d], references, at, first, out });
    });
}

struct Task<'a> {
    tolerance: Tolerance,
    d: usize,
    x: &'a [f32],
    references: &'a [f32],
    at: Option<&'a [u32]>,
    /// The first row's index.
    first: usize,
    out: &'a mut [bool],
}

impl Operation for Task<'_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let d = self.d;
        for (i, out) in self.out.iter_mut().enumerate() {
            let row = self.first + i;
            let row = self.at.map_or(row, |at| at[row] as usize);
            let (x, r) = (&self.x[i * d..][..d], &self.references[product([row, d])..][..d]);
            *out = match self.tolerance {
                Tolerance::Bits => x.iter().zip(r).any(|(x, r)| x.to_bits() != r.to_bits()),
                Tolerance::Relative(tau) => is_further(s, tau, x, r),
            };
        }
    }
}

#[inline(always)]
fn is_further<S: Simd>(s: S, tau: f32, x: &[f32], r: &[f32]) -> bool {
    let (mut distance, mut length) = (s.splat(0.0), s.splat(0.0));
    for (x, r) in x.chunks(LANES).zip(r.chunks(LANES)) {
        let r = s.load_partial(r, 0.0);
        let step = s.sub(s.load_partial(x, 0.0), r);
        distance = s.mul_add(step, step, distance);
        length = s.mul_add(r, r, length);
    }
    let distance = s.sum(distance);
    !(distance < f32::INFINITY && distance <= (tau * tau) * s.sum(length))
}
