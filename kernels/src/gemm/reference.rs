//! The product in plain Rust: the same bits, one element at a time; and in binary64, for its error.

use super::K_BLOCK;
use crate::simd::fused_mul_add;

/// `x · wᵀ` for `x [m,k]`, `w [n,k]`, in the defined order.
pub fn product(x: &[f32], w: &[f32], m: usize, n: usize, k: usize) -> Vec<f32> {
    let mut out = vec![0.0; m * n];
    for row in 0..m {
        for column in 0..n {
            let (a, b) = (&x[row * k..][..k], &w[column * k..][..k]);
            let blocks = a
                .chunks(K_BLOCK)
                .zip(b.chunks(K_BLOCK))
                .map(|(a, b)| a.iter().zip(b).fold(0.0, |sum, (&a, &b)| fused_mul_add(a, b, sum)));
            out[row * n + column] = blocks.reduce(|sum, block| sum + block).unwrap_or(0.0);
        }
    }
    out
}

/// `x · wᵀ` in binary64.
pub fn product_f64(x: &[f32], w: &[f32], m: usize, n: usize, k: usize) -> Vec<f64> {
    let mut out = vec![0.0; m * n];
    for row in 0..m {
        for column in 0..n {
            let (a, b) = (&x[row * k..][..k], &w[column * k..][..k]);
            out[row * n + column] = a.iter().zip(b).map(|(&a, &b)| f64::from(a) * f64::from(b)).sum();
        }
    }
    out
}
