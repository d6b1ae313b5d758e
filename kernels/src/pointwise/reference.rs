//! The layer in plain Rust, on rows of tokens: the same bits.

use crate::gemm::{Activation, reference};
use crate::math::scalar;

/// `activation(x · wᵀ + b)` for `x [m,k]`, `w [n,k]`, `b [n]`, in the defined order.
pub fn layer(x: &[f32], w: &[f32], b: &[f32], activation: Activation, m: usize, k: usize) -> Vec<f32> {
    let n = b.len();
    let mut out = reference::product(x, w, m, n, k);
    for (i, y) in out.iter_mut().enumerate() {
        let sum = *y + b[i % n];
        *y = match activation {
            Activation::Identity => sum,
            Activation::Silu => scalar::silu(sum),
            Activation::Gelu => scalar::gelu(sum),
        };
    }
    out
}
