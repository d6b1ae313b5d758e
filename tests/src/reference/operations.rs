//! Operations on row-major matrices of binary64.

use super::Tensors;

/// `x · wᵀ + bias` for `x [m,k]`, `w [n,k]`.
pub fn linear(x: &[f64], w: &[f64], bias: Option<&[f64]>, k: usize) -> Vec<f64> {
    let n = w.len() / k;
    let mut out = Vec::with_capacity(x.len() / k * n);
    for row in x.chunks(k) {
        for j in 0..n {
            let sum: f64 = row.iter().zip(&w[j * k..][..k]).map(|(a, b)| a * b).sum();
            out.push(sum + bias.map_or(0.0, |b| b[j]));
        }
    }
    out
}

/// The linear layer `name`, with a bias where the checkpoint has one.
pub fn layer(t: &Tensors, name: &str, x: &[f64]) -> Vec<f64> {
    let bias = format!("{name}.bias");
    let weight = format!("{name}.weight");
    let k = t.shape(&weight)[1..].iter().product();
    linear(x, t.get(&weight), t.has(&bias).then(|| t.get(&bias)), k)
}

/// `x / √(mean(x²) + 10⁻⁵) · w` for every row.
pub fn rms_norm(x: &[f64], w: &[f64]) -> Vec<f64> {
    let mut out = Vec::with_capacity(x.len());
    for row in x.chunks(w.len()) {
        let mean = row.iter().map(|x| x * x).sum::<f64>() / row.len() as f64;
        let scale = 1.0 / (mean + 1e-5).sqrt();
        out.extend(row.iter().zip(w).map(|(x, w)| x * scale * w));
    }
    out
}

/// `(x − mean) / √(variance + 10⁻⁶) · w + b` for every row.
pub fn layer_norm(x: &[f64], w: &[f64], b: &[f64]) -> Vec<f64> {
    let mut out = Vec::with_capacity(x.len());
    for row in x.chunks(w.len()) {
        let mean = row.iter().sum::<f64>() / row.len() as f64;
        let variance = row.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / row.len() as f64;
        let scale = 1.0 / (variance + 1e-6).sqrt();
        out.extend(row.iter().zip(w.iter().zip(b)).map(|(x, (w, b))| (x - mean) * scale * w + b));
    }
    out
}

/// Softmax attention with heads of 64 channels: `q [m,d]`, `k, v [n,d]`.
pub fn attention(q: &[f64], k: &[f64], v: &[f64], d: usize) -> Vec<f64> {
    let mut out = vec![0.0; q.len()];
    let keys = k.len() / d;
    for head in (0..d).step_by(64) {
        for i in 0..q.len() / d {
            let q = &q[i * d + head..][..64];
            let dot = |j: usize| q.iter().zip(&k[j * d + head..][..64]).map(|(a, b)| a * b).sum::<f64>() / 8.0;
            let logits: Vec<f64> = (0..keys).map(dot).collect();
            let largest = logits.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            let weights: Vec<f64> = logits.iter().map(|l| (l - largest).exp()).collect();
            let total: f64 = weights.iter().sum();
            for (j, w) in weights.iter().enumerate() {
                for c in 0..64 {
                    out[i * d + head + c] += w / total * v[j * d + head + c];
                }
            }
        }
    }
    out
}

/// Columns `from..from + width` of rows of `stride`.
pub fn columns(x: &[f64], stride: usize, from: usize, width: usize) -> Vec<f64> {
    x.chunks(stride).flat_map(|row| row[from..from + width].iter().copied()).collect()
}

/// Self-attention of the module `name`; with a window inside consecutive runs of tokens, after rolling forward by `roll`.
pub fn self_attention(t: &Tensors, name: &str, x: &[f64], d: usize, window: Option<usize>, roll: usize) -> Vec<f64> {
    let qkv = layer(t, &format!("{name}.packed_proj"), x);
    let mut qkv: Vec<&[f64]> = qkv.chunks(3 * d).collect();
    let n = qkv.len();
    qkv.rotate_right(roll);
    let mut mixed = Vec::with_capacity(x.len());
    for run in qkv.chunks(window.unwrap_or(n)) {
        let run = run.concat();
        let [q, k, v] = [0, 1, 2].map(|part| columns(&run, 3 * d, part * d, d));
        mixed.extend(attention(&q, &k, &v, d));
    }
    mixed.rotate_left(roll * d);
    layer(t, &format!("{name}.out_proj"), &mixed)
}

/// Cross-attention of `x` to the condition `c`.
pub fn cross_attention(t: &Tensors, name: &str, x: &[f64], c: &[f64], d: usize) -> Vec<f64> {
    let (w, b) = (t.get(&format!("{name}.packed_proj.weight")), t.get(&format!("{name}.packed_proj.bias")));
    let part = |x, i: usize| linear(x, &w[i * d * d..][..d * d], Some(&b[i * d..][..d]), d);
    layer(t, &format!("{name}.out_proj"), &attention(&part(x, 0), &part(c, 1), &part(c, 2), d))
}

/// `W₂ · silu(W₁ · x)`
pub fn feed_forward(t: &Tensors, name: &str, x: &[f64]) -> Vec<f64> {
    let hidden: Vec<f64> = layer(t, &format!("{name}.c_fc"), x).into_iter().map(silu).collect();
    layer(t, &format!("{name}.c_proj"), &hidden)
}

/// `x += y`
pub fn add(x: &mut [f64], y: &[f64]) {
    assert_eq!(x.len(), y.len());
    x.iter_mut().zip(y).for_each(|(x, y)| *x += y);
}

pub fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

pub fn silu(x: f64) -> f64 {
    x * sigmoid(x)
}

pub fn softplus(x: f64) -> f64 {
    x.max(0.0) + (-x.abs()).exp().ln_1p()
}

/// Position code of token `i`: `pe[2k] = sin(i·ω_k)`, `pe[2k+1] = cos(i·ω_k)`, `ω_k = 10000^(−2k/d)`.
pub fn sinusoid(n: usize, d: usize) -> Vec<f64> {
    let mut table = Vec::with_capacity(n * d);
    for i in 0..n {
        for k in 0..d / 2 {
            let angle = i as f64 * (-(2.0 * k as f64) / d as f64 * 10000f64.ln()).exp();
            table.extend([angle.sin(), angle.cos()]);
        }
    }
    table
}
