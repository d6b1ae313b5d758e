//! The formulas in binary64; and in plain scalar steps of the defined order, which the kernel must equal to the bit.

use crate::simd::fused_mul_add;

/// `x / √(mean(x²) + ε) · w` of one row.
pub fn rms_norm(x: &[f32], w: &[f32], epsilon: f64) -> Vec<f64> {
    let x: Vec<f64> = x.iter().map(|&x| f64::from(x)).collect();
    let mean = x.iter().map(|x| x * x).sum::<f64>() / x.len() as f64;
    x.iter().zip(w).map(|(x, &w)| x / (mean + epsilon).sqrt() * f64::from(w)).collect()
}

/// `(x − μ) / √(variance + ε) · w + b` of one row.
pub fn layer_norm(x: &[f32], w: &[f32], b: &[f32], epsilon: f64) -> Vec<f64> {
    let x: Vec<f64> = x.iter().map(|&x| f64::from(x)).collect();
    let n = x.len() as f64;
    let mean = x.iter().sum::<f64>() / n;
    let variance = x.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / n;
    let affine = w.iter().zip(b);
    x.iter()
        .zip(affine)
        .map(|(x, (&w, &b))| (x - mean) / (variance + epsilon).sqrt() * f64::from(w) + f64::from(b))
        .collect()
}

/// The norm of one row in the defined order of operations: a layer norm where there are biases `b`, else an RMS norm.
pub fn norm_in_order(x: &[f32], w: &[f32], b: Option<&[f32]>, epsilon: f32) -> Vec<f32> {
    let n = x.len() as f32;
    let large = x.iter().any(|x| x.abs() > (1_u64 << 48) as f32);
    let (scale, epsilon) = if large { (1.0 / (1_u128 << 96) as f32, 0.0) } else { (1.0, epsilon) };
    let x: Vec<f32> = x.iter().map(|x| x * scale).collect();
    let mean = if b.is_some() { lanes(&x, |sum, x| sum + x) / n } else { 0.0 };
    let x: Vec<f32> = x.iter().map(|x| x - mean).collect();
    let r = 1.0 / (lanes(&x, |sum, x| fused_mul_add(x, x, sum)) / n + epsilon).sqrt();
    (0..x.len()).map(|i| b.map_or(x[i] * r * w[i], |b| fused_mul_add(x[i] * r, w[i], b[i]))).collect()
}

/// A sum over sixteen lanes: lane `i mod 16` takes value `i`; then lanes `i` and `i + 8`, `i + 4`, `i + 2`, `i + 1` are
/// added.
fn lanes(x: &[f32], add: impl Fn(f32, f32) -> f32) -> f32 {
    let mut lanes = [0.0; 16];
    x.iter().enumerate().for_each(|(i, &x)| lanes[i % 16] = add(lanes[i % 16], x));
    for half in [8, 4, 2, 1] {
        for i in 0..half {
            lanes[i] += lanes[i + half];
        }
    }
    lanes[0]
}
