//! Factors of α by column and by row of a tile's pixels, and the blocks that a footprint reaches.

use super::super::bin::{Reach, TILE};
use super::super::project::{BLOCK, Splat};
use crate::simd::{LANES, SHIFTER, Simd};

/// A value for each column or row of pixels of a tile (the larger number), and for a vector more.
pub(super) type Pixels = [f32; PIXELS];
pub(super) const PIXELS: usize = (if TILE[0] > TILE[1] { TILE[0] } else { TILE[1] }) * BLOCK + LANES;
const COUNTING: [f32; LANES] = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0, 15.0];

const _: () = assert!(TILE[0] <= LANES && TILE[1] <= LANES && BLOCK * BLOCK == LANES);
const _: () = assert!((PIXELS - LANES).is_power_of_two());

/// The values of each block's columns or rows of pixels.
#[inline(always)]
pub(super) fn fours(pixels: &Pixels) -> &[[f32; BLOCK]] {
    pixels.as_chunks().0
}

/// 2^−q for q ≥ 0, at most 4 units in the last place off; exactly 1 for 0; 2^−125 for q ≥ 125 and for NaN.
///
/// q is rounded to the whole number n by adding 1.5·2²³; with h = q − n in [−½, ½], 2^−h is a polynomial of degree 5
/// (Chebyshev), and −n goes into the exponent.
#[inline(always)]
pub(super) fn exp2_negative<S: Simd>(s: S, q: S::F32) -> S::F32 {
    let q = s.min(q, s.splat(125.0));
    let shifted = s.sub(s.splat(SHIFTER), q);
    let h = s.add(q, s.sub(shifted, s.splat(SHIFTER)));
    let mut sum = s.splat(-0.001_338_130_2);
    for c in [0.009_666_368, -0.055_503_81, 0.240_223_5, -std::f32::consts::LN_2, 1.0] {
        sum = s.mul_add(sum, h, s.splat(c));
    }
    s.from_bits(s.add_i32(s.to_bits(sum), s.shl::<23>(s.to_bits(shifted))))
}

/// `(scale·d)²` on lane i, with d the distance of the centre from the nearest pixel of the i-th block along one axis.
#[inline(always)]
pub(super) fn nearest<S: Simd>(s: S, centre: [f32; 2], scale: f32, pixels: &Pixels) -> S::F32 {
    let first = s.mul_add(s.from_array(COUNTING), s.splat(BLOCK as f32), s.splat(pixels[0] - centre[0]));
    let low = s.sub(first, s.splat(centre[1]));
    let high = s.add(low, s.splat(BLOCK as f32 - 1.0));
    // At most one of both is positive.
    let t = s.mul(s.splat(scale), s.max(s.max(low, s.neg(high)), s.splat(0.0)));
    s.mul(t, t)
}

/// `factor·2^−(scale·d)²` for every pixel of the blocks `span`, with d its distance from the centre along one axis.
/// `span[1]` is at most the blocks of the tile on this axis.
#[inline(always)]
pub(super) fn factors<S: Simd>(
    s: S,
    centre: [f32; 2],
    scale: f32,
    factor: f32,
    span: [usize; 2],
    pixels: &Pixels,
    to: &mut Pixels,
) {
    debug_assert!(span[1] * BLOCK + LANES <= PIXELS);
    let (whole, rest, scale) = (s.splat(centre[0]), s.splat(centre[1]), s.splat(scale));
    let mut at = span[0] * BLOCK;
    while at < span[1] * BLOCK {
        // The mask changes no value. With it the compiler can prove that a vector from there on ends in the arrays.
        let from = at & (PIXELS - LANES - 1);
        let t = s.mul(scale, s.sub(s.sub(s.load(&pixels[from..]), whole), rest));
        s.store(s.mul(s.splat(factor), exp2_negative(s, s.mul(t, t))), &mut to[from..]);
        at += LANES;
    }
}

#[inline(always)]
fn clamp<S: Simd>(s: S, v: S::F32, low: S::F32, high: S::F32) -> S::F32 {
    s.min(s.max(v, low), high)
}

/// `√(exponent − (q·dy)²)`, or 0 beyond the footprint.
#[inline(always)]
fn rim<S: Simd>(s: S, reach: &Reach, dy: S::F32) -> S::F32 {
    let t = s.mul(s.splat(reach.q), dy);
    s.sqrt(s.max(s.neg_mul_add(t, t, s.splat(reach.exponent)), s.splat(0.0)))
}

/// First and last block column that a footprint can reach in each row of blocks of the tile at (`left`, `top`), inside
/// `columns`.
#[inline(always)]
pub(super) fn strips<S: Simd>(
    s: S,
    splat: &Splat,
    [left, top]: [f32; 2],
    columns: [usize; 2],
) -> ([i32; LANES], [i32; LANES]) {
    let reach = Reach::new(splat);
    let (above, below) = (s.splat(-reach.height), s.splat(reach.height));
    let y = s.mul_add(s.from_array(COUNTING), s.splat(BLOCK as f32), s.splat(top - reach.y));
    let low = clamp(s, y, above, below);
    let high = clamp(s, s.add(y, s.splat(BLOCK as f32 - 1.0)), above, below);
    let inverse = s.splat(1.0 / reach.p);
    let at_right = clamp(s, s.splat(reach.rightmost), low, high);
    let at_left = clamp(s, s.splat(-reach.rightmost), low, high);
    let last = s.mul_add(s.splat(reach.k), at_right, s.mul(rim(s, &reach, at_right), inverse));
    let first = s.sub(s.mul(s.splat(reach.k), at_left), s.mul(rim(s, &reach, at_left), inverse));
    let per_block = s.splat(1.0 / BLOCK as f32);
    let first = s.floor(s.mul(s.add(s.splat(reach.x - left - reach.slack), first), per_block));
    let last = s.floor(s.mul(s.add(s.splat(reach.x - left + reach.slack), last), per_block));
    // With NaN bounds the second operand is the result: the box of the footprint.
    let first = s.min(s.max(first, s.splat(columns[0] as f32)), s.splat(columns[1] as f32));
    let last = s.max(s.min(last, s.splat(columns[1] as f32 - 1.0)), s.splat(columns[0] as f32 - 1.0));
    (s.to_array_i32(s.to_i32(first)), s.to_array_i32(s.to_i32(last)))
}

/// Coordinates of a tile's pixels, and the factors of a splat's lanes, by column and by row of pixels; with a vector to
/// spare.
pub(super) struct Tables {
    pub(super) columns: Pixels,
    pub(super) rows: Pixels,
    /// `rows` in binary64.
    pub(super) lines: [f64; PIXELS],
    /// Factor of each column, separably.
    pub(super) across: Pixels,
    /// Factor of each row, separably; otherwise its exponent.
    pub(super) down: Pixels,
    /// Middle of the footprint on each row, in two parts.
    pub(super) middle: Pixels,
    pub(super) rest: Pixels,
    /// Root of the exponent of each row, for sinks that need it.
    pub(super) distance: Pixels,
}

impl Tables {
    #[inline(always)]
    pub(super) fn new(column: usize, row: usize) -> Self {
        let mut tables = Self {
            columns: [0.0; PIXELS],
            rows: [0.0; PIXELS],
            lines: [0.0; PIXELS],
            across: [0.0; PIXELS],
            down: [0.0; PIXELS],
            middle: [0.0; PIXELS],
            rest: [0.0; PIXELS],
            distance: [0.0; PIXELS],
        };
        for i in 0..PIXELS {
            tables.columns[i] = (column * TILE[0] * BLOCK + i) as f32;
            tables.rows[i] = (row * TILE[1] * BLOCK + i) as f32;
            tables.lines[i] = (row * TILE[1] * BLOCK + i) as f64;
        }
        tables
    }
}
