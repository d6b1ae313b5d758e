//! The formula in binary64, every weight in memory; and in plain scalar steps of the defined order, which the kernel
//! must equal to the bit.

use super::rows::{KEY_BLOCK, LARGEST_SCALE};
use super::weight::COEFFICIENTS;
use crate::gemm::Precision;
use crate::gemm::reference::{self, round_bf16};
use crate::math::EXP2_LOW;
use crate::simd::fused_mul_add;

/// Attention of `q [n, heads·width]` over `k`, `v [m, heads·width]`; `sees(i, j)`: whether query `i` sees key `j`.
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

/// [`attend`] with operands in `precision`, in the defined order of operations: the kernel's result to the bit.
/// `keys(i)` are those that query `i` sees, in the order of its window.
pub fn attend_in_order(
    precision: Precision,
    q: &[f32],
    k: &[f32],
    v: &[f32],
    heads: usize,
    width: usize,
    keys: impl Fn(usize) -> Vec<usize>,
) -> Vec<f32> {
    let d = heads * width;
    let head = |x: &[f32], row: usize, h: usize| x[row * d + h * width..][..width].to_vec();
    let mut out = Vec::new();
    for i in 0..q.len() / d {
        for h in 0..heads {
            let [k, v] = [k, v].map(|x| keys(i).into_iter().map(|j| head(x, j, h)).collect::<Vec<_>>());
            out.extend(match precision {
                Precision::F32 => floats(&head(q, i, h), &k, &v, weight),
                Precision::Bf16 => {
                    let round = |x: &Vec<f32>| x.iter().map(|&x| round_bf16(x)).collect::<Vec<_>>();
                    let [k, v] = [k, v].map(|x| x.iter().map(round).collect::<Vec<_>>());
                    floats(&round(&head(q, i, h)), &k, &v, weight_bf16)
                }
                Precision::Int8 => integers(&head(q, i, h), &k, &v),
            });
        }
    }
    out
}

/// The factor of a score in an exponent of 2.
fn exponent_scale(width: usize) -> f32 {
    (std::f64::consts::LOG2_E / (width as f64).sqrt()) as f32
}

/// One query and head, with products in f32 and keys' weights by `weigh`.
fn floats(q: &[f32], k: &[Vec<f32>], v: &[Vec<f32>], weigh: fn(f32) -> f32) -> Vec<f32> {
    let c = exponent_scale(q.len());
    let (mut reference, mut total, mut sum) = (f32::NEG_INFINITY, 0.0, vec![0.0; q.len()]);
    for (k, v) in k.chunks(KEY_BLOCK).zip(v.chunks(KEY_BLOCK)) {
        let score = |k: &Vec<f32>| q.iter().zip(k).fold(0.0, |sum, (&q, &k)| fused_mul_add(q, k, sum));
        let scores: Vec<f32> = k.iter().map(score).collect();
        let before = reference;
        reference = larger(c * scores.iter().fold(f32::NEG_INFINITY, |most, &s| larger(s, most)), before);
        let r = if before == reference { 1.0 } else { weight(before - reference) };
        let weights: Vec<f32> = scores.iter().map(|&s| weigh(fused_mul_add(s, c, -reference))).collect();
        let mut four = [0.0; 4];
        weights.iter().enumerate().for_each(|(j, w)| four[j % 4] += w);
        total = fused_mul_add(total, r, (four[0] + four[1]) + (four[2] + four[3]));
        for (channel, sum) in sum.iter_mut().enumerate() {
            let block = weights.iter().zip(v).fold(0.0, |sum, (&w, v)| fused_mul_add(v[channel], w, sum));
            *sum = fused_mul_add(*sum, r, block);
        }
    }
    sum.iter().map(|sum| sum * (1.0 / total)).collect()
}

/// One query and head, with products in 8-bit integers.
fn integers(q: &[f32], k: &[Vec<f32>], v: &[Vec<f32>]) -> Vec<f32> {
    let (a, q) = reference::integers(q);
    let c = a.min(LARGEST_SCALE) * exponent_scale(q.len());
    let (mut reference, mut total, mut sum) = (f32::NEG_INFINITY, 0.0, vec![0.0; q.len()]);
    for (k, v) in k.chunks(KEY_BLOCK).zip(v.chunks(KEY_BLOCK)) {
        let score = |k: &Vec<f32>| {
            let (b, k) = reference::integers(k);
            q.iter().zip(&k).map(|(q, k)| q * k).sum::<i64>() as f32 * b.min(LARGEST_SCALE)
        };
        let scores: Vec<f32> = k.iter().map(score).collect();
        let own = c * scores.iter().fold(f32::NEG_INFINITY, |most, &s| larger(s, most));
        let before = reference;
        reference = larger(own, before);
        let (r, u) = (weight(before - reference), weight(own - reference));
        let number = |s: &f32| (f64::from(power_low(larger(s * c - own, -20.0))) * 255.0).round_ties_even() as i64;
        let weights: Vec<i64> = scores.iter().map(number).collect();
        total = fused_mul_add(total, r, weights.iter().sum::<i64>() as f32 * u);
        for (channel, sum) in sum.iter_mut().enumerate() {
            let (unit, values) = reference::integers(&v.iter().map(|v| v[channel]).collect::<Vec<_>>());
            let block: i64 = weights.iter().zip(&values).map(|(w, v)| w * v).sum();
            *sum = fused_mul_add(*sum, r, block as f32 * (u * unit));
        }
    }
    sum.iter().map(|sum| sum * (1.0 / total)).collect()
}

/// `a > b ? a : b`
fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// `t` between `lowest` and 1, as the nearest integer (ties to even) and the rest.
fn split(t: f32, lowest: f32) -> (f32, f32) {
    let t = larger(t, lowest);
    let t = if t < 1.0 { t } else { 1.0 };
    (t.round_ties_even(), t - t.round_ties_even())
}

/// `p · 2ⁿ`, exact, for a whole n from −1022 to 1023.
fn scaled(p: f32, n: f32) -> f32 {
    let power = f64::from_bits(((n as i64 + 1023) as u64) << 52);
    (f64::from(p) * power) as f32
}

/// `2^t`, not below 2⁻⁶⁴.
fn weight(t: f32) -> f32 {
    let (n, f) = split(t, -64.0);
    let p = COEFFICIENTS.iter().rev().copied().reduce(|p, c| fused_mul_add(p, f, c)).unwrap_or(0.0);
    scaled(fused_mul_add(p, f, 1.0), n)
}

/// `2^t` by the short polynomial, for −125 ≤ `t` ≤ 1.
fn power_low(t: f32) -> f32 {
    let (n, f) = split(t, -125.0);
    scaled(EXP2_LOW.into_iter().reduce(|p, c| fused_mul_add(p, f, c)).unwrap_or(0.0), n)
}

/// `2^t`, not below 2⁻⁵⁶, rounded to bf16 with ties up.
fn weight_bf16(t: f32) -> f32 {
    let bits = power_low(larger(t, -56.0)).to_bits();
    f32::from_bits((bits + 0x8000) & 0xffff_0000)
}
