//! The formulas in binary64.

use super::antialiased::{Filter, Grid};
use super::bilinear::Axis;

/// [`super::bilinear`].
pub fn bilinear(source: &[f32], channels: usize, h: usize, w: usize, dst_h: usize, dst_w: usize) -> Vec<f64> {
    let (rows, columns) = (Axis::new(h, dst_h), Axis::new(w, dst_w));
    let mut out = Vec::with_capacity(channels * dst_h * dst_w);
    for c in 0..channels {
        let at = |y: usize, x: usize| f64::from(source[(c * h + y) * w + x]);
        for y in 0..dst_h {
            for x in 0..dst_w {
                let (a, b) = (f64::from(columns.weight[x]), f64::from(rows.weight[y]));
                let row = |y| (1.0 - a) * at(y, columns.low[x]) + a * at(y, columns.high[x]);
                out.push((1.0 - b) * row(rows.low[y]) + b * row(rows.high[y]));
            }
        }
    }
    out
}

/// [`super::antialiased`]: every input is weighed for every output.
pub fn antialiased(filter: Filter, source: &[f32], grid: Grid, dst_h: usize, dst_w: usize) -> Vec<f64> {
    let Grid { outer, height, width, inner } = grid;
    let weights = |n: usize, m: usize, i: usize| {
        if n == m {
            return (0..n).map(|j| f64::from(u8::from(i == j))).collect();
        }
        let ratio = n as f64 / m as f64;
        let weight = |j: usize| filter.at((j as f64 + 0.5 - ratio * (i as f64 + 0.5)) / ratio.max(1.0));
        let total: f64 = (0..n).map(weight).sum();
        (0..n).map(|j| weight(j) / total).collect::<Vec<f64>>()
    };
    let mut out = Vec::with_capacity(outer * dst_h * dst_w * inner);
    for image in 0..outer {
        for y in 0..dst_h {
            let rows = weights(height, dst_h, y);
            for x in 0..dst_w {
                let columns = weights(width, dst_w, x);
                for k in 0..inner {
                    let mut sum = 0.0;
                    for (j, row) in rows.iter().enumerate().filter(|(_, row)| **row != 0.0) {
                        for (i, column) in columns.iter().enumerate() {
                            sum += row * column * f64::from(source[((image * height + j) * width + i) * inner + k]);
                        }
                    }
                    out.push(sum);
                }
            }
        }
    }
    out
}
