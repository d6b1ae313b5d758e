//! The formula in binary64, every weight in memory.

/// Attention of `q [n, heads·width]` over `k`, `v [m, heads·width]`; `sees(i, j)` tells whether query `i` sees key `j`.
pub fn attend(
    q: &[f32],
    k: &[f32],
    v: &[f32],
    heads: usize,
    width: usize,
    sees: impl Fn(usize, usize) -> bool,
) -> Vec<f64> {
    let d = heads * width;
    let (n, m) = (q.len() / d, k.len() / d);
    let mut out = vec![0.0; n * d];
    for i in 0..n {
        for h in 0..heads {
            let at = |x: &[f32], row: usize, c: usize| f64::from(x[row * d + h * width + c]);
            let logit = |j: usize| (0..width).map(|c| at(q, i, c) * at(k, j, c)).sum::<f64>() / (width as f64).sqrt();
            let logits: Vec<_> = (0..m).filter(|&j| sees(i, j)).map(|j| (j, logit(j))).collect();
            let most = logits.iter().fold(f64::NEG_INFINITY, |most, l| most.max(l.1));
            let total: f64 = logits.iter().map(|l| (l.1 - most).exp()).sum();
            for c in 0..width {
                let sum: f64 = logits.iter().map(|l| (l.1 - most).exp() * at(v, l.0, c)).sum();
                out[i * d + h * width + c] = sum / total;
            }
        }
    }
    out
}
