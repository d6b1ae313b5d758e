//! Smoothing that stops at edges of the picture and fills cells without a value.
//!
//! The domain transform's recursive filter (Gastal & Oliveira 2011, section 4.2.3) is applied to `c·ρ` and to `c`:
//! along rows and columns, forwards and backwards, three times with decreasing width. Their quotient is the filled map.

use streamsplat_kernels::math::scalar::exp_nonpositive;

/// Width of the filter, in cells.
const SPACE: f32 = 20.0;
/// Width of the filter, as a sum of colour differences.
const RANGE: f32 = 0.3;
/// Widths of the passes in units of σ, `√3·2^(n−i−1) / √(4ⁿ−1)` with n = 3.
const WIDTHS: [f32; 3] = [0.872_871_6, 0.436_435_8, 0.218_217_9];

/// Returns `inverse`, weighted by `confidence` and smoothed, at every cell. `colours` are `[rows·columns]`.
pub(super) fn fill(inverse: &[f32], confidence: &[f32], colours: &[[f32; 3]], [rows, columns]: [usize; 2]) -> Vec<f32> {
    let mut planes: Vec<[f32; 2]> = inverse.iter().zip(confidence).map(|(v, c)| [v * (c + 1e-9), c + 1e-9]).collect();
    let far = |a: usize, b: usize| {
        let d = (0..3).fold(0.0, |sum, k| sum + (colours[a][k] - colours[b][k]).abs());
        (SPACE / RANGE).mul_add(d, 1.0)
    };
    for width in WIDTHS {
        let rate = -std::f32::consts::SQRT_2 / (SPACE * width);
        let mut line = |start: usize, step: usize, count: usize| {
            let keep: Vec<f32> =
                (1..count).map(|i| exp_nonpositive(rate * far(start + (i - 1) * step, start + i * step))).collect();
            for i in 1..count {
                let (from, to) = (planes[start + (i - 1) * step], &mut planes[start + i * step]);
                *to = [0, 1].map(|k| keep[i - 1].mul_add(from[k] - to[k], to[k]));
            }
            for i in (0..count.saturating_sub(1)).rev() {
                let (from, to) = (planes[start + (i + 1) * step], &mut planes[start + i * step]);
                *to = [0, 1].map(|k| keep[i].mul_add(from[k] - to[k], to[k]));
            }
        };
        (0..rows).for_each(|row| line(row * columns, 1, columns));
        (0..columns).for_each(|column| line(column, columns, rows));
    }
    planes.into_iter().map(|[v, c]| v / c.max(f32::MIN_POSITIVE)).collect()
}
