//! The product in plain Rust: the same bits, one element at a time; and in binary64, for its error.

use super::precision::{K_BLOCK, K_BLOCK_LOW, Precision, scale_of};
use crate::simd::fused_mul_add;
use crate::size;

/// `x · wᵀ` for `x [m,k]`, `w [n,k]`, in the defined order.
pub fn product(x: &[f32], w: &[f32], m: usize, n: usize, k: usize) -> Vec<f32> {
    blockwise(K_BLOCK, x, w, m, n, k)
}

/// [`product`] with chains of `block` steps.
fn blockwise(block: usize, x: &[f32], w: &[f32], m: usize, n: usize, k: usize) -> Vec<f32> {
    let mut out = vec![0.0; size::product([m, n])];
    for row in 0..m {
        for column in 0..n {
            let (a, b) = (&x[row * k..][..k], &w[column * k..][..k]);
            let blocks = a
                .chunks(block)
                .zip(b.chunks(block))
                .map(|(a, b)| a.iter().zip(b).fold(0.0, |sum, (&a, &b)| fused_mul_add(a, b, sum)));
            out[row * n + column] = blocks.reduce(|sum, block| sum + block).unwrap_or(0.0);
        }
    }
    out
}

/// `x · wᵀ` in binary64.
pub fn product_f64(x: &[f32], w: &[f32], m: usize, n: usize, k: usize) -> Vec<f64> {
    let mut out = vec![0.0; size::product([m, n])];
    for row in 0..m {
        for column in 0..n {
            let (a, b) = (&x[row * k..][..k], &w[column * k..][..k]);
            out[row * n + column] = a.iter().zip(b).map(|(&a, &b)| f64::from(a) * f64::from(b)).sum();
        }
    }
    out
}

/// `x · wᵀ` with both operands held in `precision`.
pub fn product_as(precision: Precision, x: &[f32], w: &[f32], m: usize, n: usize, k: usize) -> Vec<f32> {
    match precision {
        Precision::F32 => product(x, w, m, n, k),
        Precision::Bf16 => {
            let round = |x: &[f32]| -> Vec<f32> { x.iter().map(|&x| round_bf16(x)).collect() };
            blockwise(K_BLOCK_LOW, &round(x), &round(w), m, n, k)
        }
        Precision::Int8 => {
            let rows = |x: &[f32]| -> Vec<(f32, Vec<i64>)> { x.chunks(k.max(1)).map(integers).collect() };
            let (x, w) = (rows(x), rows(w));
            let mut out = vec![0.0; size::product([m, n])];
            for (row, (b, x)) in x.iter().enumerate() {
                for (column, (a, w)) in w.iter().enumerate() {
                    let sum: i64 = x.iter().zip(w).map(|(x, w)| x * w).sum();
                    out[row * n + column] = sum as f32 * b * a;
                }
            }
            out
        }
    }
}

/// A row's scale and its values in units of that.
pub(crate) fn integers(row: &[f32]) -> (f32, Vec<i64>) {
    let most = row.iter().fold(0.0, |most: f32, x| if x.is_nan() { f32::INFINITY } else { most.max(x.abs()) });
    let (scale, inverse) = scale_of(most);
    let unit = |&x: &f32| if scale > 0.0 { (x * inverse).round_ties_even() as i64 } else { 0 };
    (scale, row.iter().map(unit).collect())
}

/// The nearest bf16 (ties to even), as f32; NaN stays NaN, magnitudes below 2⁻⁵⁶ become 0.
pub(crate) fn round_bf16(x: f32) -> f32 {
    if x.is_nan() {
        f32::NAN
    } else if f64::from(x.abs()) < (-56.0_f64).exp2() {
        0.0
    } else {
        let bits = x.to_bits();
        f32::from_bits((bits + 0x7fff + (bits >> 16 & 1)) & 0xffff_0000)
    }
}
