//! DINOv2 with registers on one frame.

use super::operations::*;
use super::{Outputs, Tensors};

/// `resized`, `patch_tokens` and `cls_token` of a frame `[3, h, w]`, resized to `to`.
pub fn dino(t: &Tensors, frame: &[f64], [h, w]: [usize; 2], to: [usize; 2]) -> Outputs {
    let d = t.shape("cls_token")[2];
    let p = t.shape("patch_embed.proj.weight")[2];
    let [rows, columns] = to.map(|side| side / p);
    let resized: Vec<f64> = frame.chunks(h * w).flat_map(|plane| bilinear(plane, [h, w], to)).collect();

    let mut patches = Vec::new();
    for row in 0..rows {
        for column in 0..columns {
            for channel in 0..3 {
                for y in row * p..(row + 1) * p {
                    patches.extend_from_slice(&resized[(channel * to[0] + y) * to[1] + column * p..][..p]);
                }
            }
        }
    }
    let mut tokens =
        linear(&patches, t.get("patch_embed.proj.weight"), Some(t.get("patch_embed.proj.bias")), 3 * p * p);
    let positions = t.get("pos_embed");
    let side = (positions.len() / d - 1).isqrt();
    add(&mut tokens, &position_grid(&positions[d..], side, [rows, columns], d));
    let mut first = t.get("cls_token").to_vec();
    add(&mut first, &positions[..d]);
    let registers = t.get("register_tokens");
    let mut x = [&first, registers, &tokens].concat();

    for i in 0..t.count("blocks", "norm1.weight") {
        let block = format!("blocks.{i}");
        let norm = |x: &[f64], leaf: &str| {
            let name = format!("{block}.{leaf}");
            layer_norm(x, t.get(&format!("{name}.weight")), t.get(&format!("{name}.bias")))
        };
        let scaled = |mut y: Vec<f64>, leaf: &str| {
            let gamma = t.get(&format!("{block}.{leaf}.gamma"));
            y.chunks_mut(d).for_each(|row| row.iter_mut().zip(gamma).for_each(|(y, g)| *y *= g));
            y
        };
        let qkv = layer(t, &format!("{block}.attn.qkv"), &norm(&x, "norm1"));
        let [q, k, v] = [0, 1, 2].map(|part| super::operations::columns(&qkv, 3 * d, part * d, d));
        let y = layer(t, &format!("{block}.attn.proj"), &attention(&q, &k, &v, d));
        add(&mut x, &scaled(y, "ls1"));
        let hidden: Vec<f64> =
            layer(t, &format!("{block}.mlp.fc1"), &norm(&x, "norm2")).into_iter().map(gelu).collect();
        add(&mut x, &scaled(layer(t, &format!("{block}.mlp.fc2"), &hidden), "ls2"));
    }
    let x = layer_norm(&x, t.get("norm.weight"), t.get("norm.bias"));
    Outputs::from([
        ("resized".to_owned(), resized),
        ("cls_token".to_owned(), x[..d].to_vec()),
        ("patch_tokens".to_owned(), x[d + registers.len()..].to_vec()),
    ])
}

/// Half-pixel centres; indices clamped at the border.
fn bilinear(from: &[f64], [h, w]: [usize; 2], [to_h, to_w]: [usize; 2]) -> Vec<f64> {
    let taps = |i: usize, from: usize, to: usize| {
        let x = ((i as f64 + 0.5) * from as f64 / to as f64 - 0.5).max(0.0);
        let low = (x.floor() as usize).min(from - 1);
        (low, (low + 1).min(from - 1), x - low as f64)
    };
    let mut out = Vec::with_capacity(to_h * to_w);
    for i in 0..to_h {
        let (y0, y1, fy) = taps(i, h, to_h);
        for j in 0..to_w {
            let (x0, x1, fx) = taps(j, w, to_w);
            let row = |y: usize| from[y * w + x0] * (1.0 - fx) + from[y * w + x1] * fx;
            out.push(row(y0) * (1.0 - fy) + row(y1) * fy);
        }
    }
    out
}

/// The square grid of position vectors, resized bicubically with antialiasing.
fn position_grid(grid: &[f64], side: usize, [rows, columns]: [usize; 2], d: usize) -> Vec<f64> {
    let (vertical, horizontal) = (cubic_weights(side, rows), cubic_weights(side, columns));
    let mut out = vec![0.0; rows * columns * d];
    for (i, taps_y) in vertical.iter().enumerate() {
        for (j, taps_x) in horizontal.iter().enumerate() {
            for &(y, wy) in taps_y {
                for &(x, wx) in taps_x {
                    for c in 0..d {
                        out[(i * columns + j) * d + c] += wy * wx * grid[(y * side + x) * d + c];
                    }
                }
            }
        }
    }
    out
}

/// Per output index the inputs in reach and their weights, which sum to 1: the kernel is widened by the reduction.
fn cubic_weights(from: usize, to: usize) -> Vec<Vec<(usize, f64)>> {
    let scale = from as f64 / to as f64;
    let widen = scale.max(1.0);
    let all = (0..to).map(|i| {
        let centre = scale * (i as f64 + 0.5);
        let low = ((centre - 2.0 * widen + 0.5).floor().max(0.0)) as usize;
        let high = ((centre + 2.0 * widen + 0.5).floor() as usize).min(from);
        let weights: Vec<f64> = (low..high).map(|x| cubic((x as f64 - centre + 0.5) / widen)).collect();
        let total: f64 = weights.iter().sum();
        (low..high).zip(weights.into_iter().map(|w| w / total)).collect()
    });
    all.collect()
}

/// The cubic convolution kernel with coefficient −½.
fn cubic(x: f64) -> f64 {
    const A: f64 = -0.5;
    let x = x.abs();
    if x < 1.0 {
        ((A + 2.0) * x - (A + 3.0)) * x * x + 1.0
    } else if x < 2.0 {
        ((A * x - 5.0 * A) * x + 8.0 * A) * x - 4.0 * A
    } else {
        0.0
    }
}

/// `x · Φ(x)`, with erf from its series (small arguments) and continued fraction (large ones).
fn gelu(x: f64) -> f64 {
    let z = x / std::f64::consts::SQRT_2;
    let erf = if z.abs() < 3.0 {
        // 2/√π Σ (−1)ⁿ z^{2n+1} / (n! (2n+1))
        let (mut power, mut sum) = (z, 0.0);
        for n in 0..80 {
            sum += power / f64::from(2 * n + 1);
            power *= -z * z / f64::from(n + 1);
        }
        sum * 2.0 / std::f64::consts::PI.sqrt()
    } else {
        // erfc(z) = e^{−z²}/√π · 1/(z + ½/(z + 1/(z + 3/2/(z + …))))
        let a = z.abs();
        let mut fraction = a;
        for n in (1..120).rev() {
            fraction = a + 0.5 * f64::from(n) / fraction;
        }
        (1.0 - (-a * a).exp() / (std::f64::consts::PI.sqrt() * fraction)).copysign(z)
    };
    0.5 * x * (1.0 + erf)
}
