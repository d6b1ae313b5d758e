//! The formulas in binary64.

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
