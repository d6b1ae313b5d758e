//! Operations on row-major matrices of binary64.

use rayon::prelude::*;

use super::Tensors;

/// Rows and columns of a tile of [`linear`].
const TILE: usize = 4;

/// `x · wᵀ + bias` for `x [m,k]`, `w [n,k]`; each sum in ascending order of `k`. Rows and columns are computed in
/// tiles.
pub fn linear(x: &[f64], w: &[f64], bias: Option<&[f64]>, k: usize) -> Vec<f64> {
    let (m, n) = (x.len() / k, w.len() / k);
    let tiles = |rows: &[f64], count: usize| -> Vec<f64> {
        let mut tiles = vec![0.0; count.next_multiple_of(TILE) * k];
        for (i, row) in rows.chunks(k).enumerate() {
            for (at, value) in row.iter().enumerate() {
                tiles[i / TILE * TILE * k + at * TILE + i % TILE] = *value;
            }
        }
        tiles
    };
    let (x, w) = (tiles(x, m), tiles(w, n));
    let mut out = vec![0.0; m * n];
    out.par_chunks_mut(TILE * n).zip(x.par_chunks(TILE * k)).for_each(|(out, x)| {
        for (tile, w) in w.chunks(TILE * k).enumerate() {
            let mut sums = [[0.0; TILE]; TILE];
            for (x, w) in x.chunks_exact(TILE).zip(w.chunks_exact(TILE)) {
                for i in 0..TILE {
                    for j in 0..TILE {
                        sums[i][j] += x[i] * w[j];
                    }
                }
            }
            for (row, sums) in out.chunks_mut(n).zip(sums) {
                for (j, (to, sum)) in row[tile * TILE..].iter_mut().zip(sums).enumerate() {
                    *to = sum + bias.map_or(0.0, |bias| bias[tile * TILE + j]);
                }
            }
        }
    });
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
    let keys = k.len() / d;
    // The channels of all keys.
    let channels: Vec<Vec<f64>> = (0..d).map(|c| k.chunks(d).map(|key| key[c]).collect()).collect();
    let mut out = vec![0.0; q.len()];
    out.par_chunks_mut(d).zip(q.par_chunks(d)).for_each(|(out, q)| {
        let mut logits = vec![0.0; keys];
        for head in (0..d).step_by(64) {
            logits.fill(0.0);
            for four in (head..head + 64).step_by(4) {
                let [a, b, c, d] = [0, 1, 2, 3].map(|i| &channels[four + i][..keys]);
                for j in 0..keys {
                    logits[j] =
                        logits[j] + q[four] * a[j] + q[four + 1] * b[j] + q[four + 2] * c[j] + q[four + 3] * d[j];
                }
            }
            logits.iter_mut().for_each(|logit| *logit /= 8.0);
            let largest = logits.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            logits.iter_mut().for_each(|logit| *logit = (*logit - largest).exp());
            let total: f64 = logits.iter().sum();
            let mut sums = [0.0; 64];
            for (j, w) in logits.iter().enumerate() {
                for (sum, v) in sums.iter_mut().zip(&v[j * d + head..][..64]) {
                    *sum += w / total * v;
                }
            }
            out[head..head + 64].copy_from_slice(&sums);
        }
    });
    out
}

/// Columns `from..from + width` of rows of `stride`.
pub fn columns(x: &[f64], stride: usize, from: usize, width: usize) -> Vec<f64> {
    x.chunks(stride).flat_map(|row| row[from..from + width].iter().copied()).collect()
}

/// Self-attention of the module `name`; with a window, inside consecutive runs of tokens after rolling forward by
/// `roll`.
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
