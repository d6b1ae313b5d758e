//! Exponents of footprints on the sphere, for the pixels of a tile of an equirectangular image.

use std::f64::consts::{PI, TAU};

use super::super::bin::TILE;
use super::super::project::{BLOCK, Splat, frame};
use super::tables::{PIXELS, Pixels, fours};
use crate::math::f64::sin_cos;
use crate::simd::{LANES, Simd};

/// Directions of a tile's columns and rows, and the contribution of each to a splat's exponents.
///
/// The pixel (u, v) is seen along `d = (cos φ·sin λ, sin φ, cos φ·cos λ)` with `λ = 2π·((u + ½)/W − ½)` and
/// `φ = π·((v + ½)/H − ½)`. With n, e and s of the splat (`project/sphere.rs`), `a = p·(e − k·s)` and `b = q·s`,
/// rounded to binary32,
///
/// ```text
/// e(u, v) = ((a·d)² + (b·d)²) / (n·d)²     where n·d > 0     a·d = cos φ·(a_x·sin λ + a_z·cos λ) + a_y·sin φ
/// ```
///
/// in binary32: a product `a_z·cos λ`, two fused steps, and the same for b and n; sines and cosines are rounded from
/// binary64.
pub(super) struct Sphere {
    /// Sines and cosines of longitudes and latitudes.
    longitude: [Pixels; 2],
    latitude: [Pixels; 2],
    /// Contribution of a column and of a row to a, b and n.
    across: [Pixels; 3],
    down: [Pixels; 3],
}

/// Parts of a row of blocks.
pub(super) struct Line<S: Simd> {
    cos: S::F32,
    down: [S::F32; 3],
}

impl Sphere {
    pub(super) fn new(tile: [usize; 2], size: [usize; 2]) -> Self {
        let angles = |axis: usize, whole: f64| {
            let mut pair = [[0.0; PIXELS]; 2];
            for i in 0..TILE[axis] * BLOCK {
                let at = (tile[axis] * TILE[axis] * BLOCK + i) as f64;
                let (sin, cos) = sin_cos(((at + 0.5) / size[axis] as f64 - 0.5) * whole);
                (pair[0][i], pair[1][i]) = (sin as f32, cos as f32);
            }
            pair
        };
        Self {
            longitude: angles(0, TAU),
            latitude: angles(1, PI),
            across: [[0.0; PIXELS]; 3],
            down: [[0.0; PIXELS]; 3],
        }
    }

    /// Prepares the blocks `columns` and `rows`, first and end, for a splat.
    #[inline(always)]
    pub(super) fn aim<S: Simd>(&mut self, s: S, splat: &Splat, columns: [usize; 2], rows: [usize; 2]) {
        let towards = [splat.x[0], splat.x[1], splat.y[0]];
        let [east, south] = frame(towards.map(f64::from));
        let (p, q) = (f64::from(splat.p), f64::from(splat.q));
        let first = std::array::from_fn(|i| (p * (east[i] - splat.k * south[i])) as f32);
        let second = std::array::from_fn(|i| (q * south[i]) as f32);
        let [sin, cos] = &self.longitude;
        for ([x, y, z], (across, down)) in
            [first, second, towards].into_iter().zip(self.across.iter_mut().zip(&mut self.down))
        {
            let mut at = columns[0] * BLOCK;
            while at < columns[1] * BLOCK {
                // The mask does not change the index. With it the compiler drops bounds checks: a vector from there
                // ends inside the arrays.
                let from = at & (PIXELS - LANES - 1);
                let level = s.mul(s.splat(z), s.load(&cos[from..]));
                s.store(s.mul_add(s.splat(x), s.load(&sin[from..]), level), &mut across[from..]);
                at += LANES;
            }
            for row in rows[0] * BLOCK..rows[1] * BLOCK {
                down[row] = y * self.latitude[0][row];
            }
        }
    }

    /// Parts of a row of blocks.
    #[inline(always)]
    pub(super) fn line<S: Simd>(&self, s: S, row: usize) -> Line<S> {
        Line {
            cos: s.spread_four(&fours(&self.latitude[1])[row]),
            down: [0, 1, 2].map(|i| s.spread_four(&fours(&self.down[i])[row])),
        }
    }

    /// Exponents on a block, and which pixels are on the side of the sphere that the splat is on.
    #[inline(always)]
    pub(super) fn exponent<S: Simd>(&self, s: S, line: &Line<S>, column: usize) -> (S::F32, S::Mask) {
        let part = |i: usize| s.mul_add(line.cos, s.repeat_four(&fours(&self.across[i])[column]), line.down[i]);
        let (a, b, n) = (part(0), part(1), part(2));
        (s.div(s.mul_add(a, a, s.mul(b, b)), s.mul(n, n)), s.lt(s.splat(0.0), n))
    }
}
