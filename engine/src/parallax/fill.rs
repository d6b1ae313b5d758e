//! Smoothing that stops at edges of the picture and fills cells without a value.
//!
//! The domain transform's recursive filter (Gastal & Oliveira 2011, section 4.2.3) is applied to `c·ρ` and to `c`:
//! along rows and columns, forwards and backwards, three times with decreasing width. Their quotient is the filled map.
//!
//! Each value along a line becomes `x + k·(x' − x)` (fused), where x' is the value before it on its line. Lines are
//! independent of one another: rows are filtered in the transposed grid, so that a vector holds 16 lines.

use streamsplat_kernels::Level;
use streamsplat_kernels::math::exp_nonpositive;
use streamsplat_kernels::simd::{LANES, Operation, Simd, dispatch};

/// Width of the filter, in cells.
const SPACE: f32 = 20.0;
/// Width of the filter, as a sum of colour differences.
const RANGE: f32 = 0.3;
/// Widths of the passes in units of σ, `√3·2^(n−i−1) / √(4ⁿ−1)` with n = 3.
const WIDTHS: [f32; 3] = [0.872_871_6, 0.436_435_8, 0.218_217_9];

/// Returns `inverse`, weighted by `confidence` and smoothed, at every cell. `colours` are `[rows·columns]`.
pub(super) fn fill(
    level: Level,
    inverse: &[f32],
    confidence: &[f32],
    colours: &[[f32; 3]],
    [rows, columns]: [usize; 2],
) -> Vec<f32> {
    if inverse.is_empty() {
        return Vec::new();
    }
    let far = |a: usize, b: usize| {
        let d = (0..3).fold(0.0, |sum, k| sum + (colours[a][k] - colours[b][k]).abs());
        (SPACE / RANGE).mul_add(d, 1.0)
    };
    let weighted = inverse.iter().zip(confidence).map(|(v, c)| v * (c + 1e-9)).collect();
    let mut planes: [Vec<f32>; 2] = [weighted, confidence.iter().map(|c| c + 1e-9).collect()];
    // Distances from each cell to the one before it on its line: down the columns, and along the rows, transposed.
    let down: Vec<f32> = (columns..rows * columns).map(|cell| far(cell - columns, cell)).collect();
    let along = (1..columns).flat_map(|column| (0..rows).map(move |row| row * columns + column));
    let along: Vec<f32> = along.map(|cell| far(cell - 1, cell)).collect();
    for width in WIDTHS {
        let rate = -std::f32::consts::SQRT_2 / (SPACE * width);
        planes = planes.map(|plane| transposed(&plane, [rows, columns]));
        dispatch(level, Pass { planes: &mut planes, distance: &along, rate, columns: rows });
        planes = planes.map(|plane| transposed(&plane, [columns, rows]));
        dispatch(level, Pass { planes: &mut planes, distance: &down, rate, columns });
    }
    let [value, weight] = planes;
    value.into_iter().zip(weight).map(|(v, c)| v / c.max(f32::MIN_POSITIVE)).collect()
}

/// `[rows, columns]` → `[columns, rows]`
fn transposed(plane: &[f32], [rows, columns]: [usize; 2]) -> Vec<f32> {
    (0..columns).flat_map(|column| (0..rows).map(move |row| plane[row * columns + column])).collect()
}

/// The filter down all columns and back up.
struct Pass<'a> {
    planes: &'a mut [Vec<f32>; 2],
    /// Of each cell but those of the first row: the distance to the cell above.
    distance: &'a [f32],
    /// Logarithm of what a value keeps over a distance of 1.
    rate: f32,
    columns: usize,
}

impl Operation for Pass<'_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let Self { planes, distance, rate, columns } = self;
        let mut keep = vec![0.0; distance.len()];
        for (keep, distance) in keep.chunks_mut(LANES).zip(distance.chunks(LANES)) {
            let exponent = s.mul(s.splat(rate), s.load_partial(distance, 0.0));
            s.store_partial(exp_nonpositive(s, exponent), keep);
        }
        for plane in planes {
            for (row, keep) in keep.chunks(columns).enumerate() {
                let (above, own) = plane[row * columns..].split_at_mut(columns);
                approach(s, &mut own[..columns], above, keep);
            }
            for (row, keep) in keep.chunks(columns).enumerate().rev() {
                let (own, below) = plane[row * columns..].split_at_mut(columns);
                approach(s, own, &below[..columns], keep);
            }
        }
    }
}

/// `own += keep·(from − own)`
#[inline(always)]
fn approach<S: Simd>(s: S, own: &mut [f32], from: &[f32], keep: &[f32]) {
    let rows = own.chunks_mut(LANES).zip(from.chunks(LANES).zip(keep.chunks(LANES)));
    for (own, (from, keep)) in rows {
        let (value, from, keep) = (s.load_partial(own, 0.0), s.load_partial(from, 0.0), s.load_partial(keep, 0.0));
        s.store_partial(s.mul_add(keep, s.sub(from, value), value), own);
    }
}
