//! Weights of the two sides of an [edge](super::edges) around each pixel, sixteen pixels of a row at once.
//!
//! The picture's planes are padded with colours at infinity, whose weight is 0. So the sum over a window that leaves
//! the picture has the bits of the sum over its part inside.

use rayon::prelude::*;
use streamsplat_kernels::Level;
use streamsplat_kernels::simd::{LANES, Operation, Simd, dispatch};

use super::edges::REACH;

/// Pixels along a side of the window.
const SIDE: usize = 2 * REACH + 1;
/// C².
const COLOUR: f32 = 0.08 * 0.08;
/// R².
const NEARBY: f32 = 2.0 * 2.0;

/// Sums of weights over the window around a pixel, row by row.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Weights {
    /// Of the pixels nearer than the middle of the depth range around the pixel, and of the rest.
    pub(super) sides: [f32; 2],
    /// Of the pixels on the pixel's own side and no [tear](super::edges::tear) away from its depth.
    pub(super) own: f32,
}

/// Colours and z of a picture, padded.
pub(super) struct Picture {
    level: Level,
    size: [usize; 2],
    /// Values from one row to the next.
    stride: usize,
    /// Red, green, blue and z, each of `height` rows of `stride`.
    planes: [Vec<f32>; 4],
}

impl Picture {
    /// The picture of a frame `[3, H, W]` and its z `[H, W]`.
    pub(super) fn new(level: Level, frame: &[f32], z: &[f32], [height, width]: [usize; 2]) -> Self {
        // The last vector of a row starts within it and reads up to the end of the window.
        let stride = width.next_multiple_of(LANES) + LANES;
        let padded = |plane: &[f32]| {
            let mut out = vec![f32::INFINITY; height * stride];
            for (out, row) in out.chunks_mut(stride).zip(plane.chunks(width)) {
                out[REACH..][..width].copy_from_slice(row);
            }
            out
        };
        let [r, g, b] = [0, 1, 2].map(|channel| padded(&frame[channel * z.len()..][..z.len()]));
        Self { level, size: [height, width], stride, planes: [r, g, b, padded(z)] }
    }

    /// The weights around each pixel with an edge in its range `around`; elsewhere 0. `tear`: difference of z at an
    /// edge.
    pub(super) fn weights(&self, around: &[[f32; 2]], tear: f32) -> Vec<Weights> {
        let width = self.size[1];
        let mut weights = vec![Weights::default(); around.len()];
        weights.par_chunks_mut(width).zip(around.par_chunks(width)).enumerate().for_each(|(row, (out, around))| {
            dispatch(self.level, Row { picture: self, row, around, tear, out });
        });
        weights
    }

    /// z and weight of the pixels around one that are on a side of `middle`, in no order.
    pub(super) fn on_side(&self, [row, column]: [usize; 2], side: usize, middle: f32) -> Members {
        let mut members = Members { all: [0; SIDE * SIDE], count: 0 };
        dispatch(self.level, Window { picture: self, row, column, side, middle, members: &mut members });
        members
    }

    /// Rows of the window around `row`, with their distances.
    fn rows(&self, row: usize) -> impl Iterator<Item = (usize, usize)> {
        (row.saturating_sub(REACH)..(row + REACH + 1).min(self.size[0])).map(move |y| (y, y.abs_diff(row)))
    }

    /// Sixteen colours and z, from a place in the padded planes on.
    #[inline(always)]
    fn load<S: Simd>(&self, s: S, row: usize, column: usize) -> ([S::F32; 3], S::F32) {
        let [r, g, b, z] = &self.planes;
        let at = row * self.stride + column;
        ([s.load(&r[at..]), s.load(&g[at..]), s.load(&b[at..])], s.load(&z[at..]))
    }
}

/// `1/(1 + |c − c₀|²/C²)² · 1/(1 + r²/R²)`; `distant`: the second denominator.
#[inline(always)]
fn weight<S: Simd>(s: S, c: [S::F32; 3], c0: [S::F32; 3], distant: S::F32) -> S::F32 {
    let one = s.splat(1.0);
    let mut apart = s.splat(0.0);
    for i in 0..3 {
        let d = s.sub(c[i], c0[i]);
        apart = s.mul_add(d, d, apart);
    }
    let alike = s.div(one, s.add(one, s.div(apart, s.splat(COLOUR))));
    s.div(s.mul(alike, alike), distant)
}

/// The denominator `1 + r²/R²` at a distance of `dy` rows and `dx` columns.
#[inline(always)]
fn distant(dy: usize, dx: usize) -> f32 {
    1.0 + (dx * dx + dy * dy) as f32 / NEARBY
}

/// [`Weights`] of a row.
struct Row<'a> {
    picture: &'a Picture,
    row: usize,
    around: &'a [[f32; 2]],
    tear: f32,
    out: &'a mut [Weights],
}

impl Operation for Row<'_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let (picture, tear) = (self.picture, s.splat(self.tear));
        for (block, (out, around)) in self.out.chunks_mut(LANES).zip(self.around.chunks(LANES)).enumerate() {
            if !around.iter().any(|[near, far]| (near - far).abs() > self.tear) {
                continue;
            }
            let mut middle = [0.0; LANES];
            middle.iter_mut().zip(around).for_each(|(middle, [near, far])| *middle = 0.5 * (near + far));
            let middle = s.from_array(middle);
            let (c0, z0) = picture.load(s, self.row, block * LANES + REACH);
            let own_far = s.lt(middle, z0);
            let mut sums = [s.splat(0.0); 3];
            for (y, dy) in picture.rows(self.row) {
                for dx in 0..SIDE {
                    let (c, z) = picture.load(s, y, block * LANES + dx);
                    let w = weight(s, c, c0, s.splat(distant(dy, dx.abs_diff(REACH))));
                    let far = s.lt(middle, z);
                    let sides = [s.keep(s.not(far), w), s.keep(far, w)];
                    let close = s.le(s.abs(s.sub(z, z0)), tear);
                    let own = s.keep(close, s.select(own_far, sides[1], sides[0]));
                    for (sum, w) in sums.iter_mut().zip([sides[0], sides[1], own]) {
                        *sum = s.add(*sum, w);
                    }
                }
            }
            let [near, far, own] = sums.map(|sum| s.to_array(sum));
            for (i, out) in out.iter_mut().enumerate() {
                *out = Weights { sides: [near[i], far[i]], own: own[i] };
            }
        }
    }
}

/// z and weight of the pixels of one side in a window. Both are positive, so that their bits have the same order: those
/// of z in the upper half, those of the weight in the lower.
pub(super) struct Members {
    all: [u64; SIDE * SIDE],
    count: usize,
}

impl Members {
    /// The z at which half of the weight `total` is reached, ascending; equal values in order of their weights.
    pub(super) fn median(&mut self, total: f32) -> f32 {
        let members = &mut self.all[..self.count];
        members.sort_unstable();
        let z = |member: u64| f32::from_bits((member >> 32) as u32);
        let mut sum = 0.0;
        for member in members.iter() {
            sum += f32::from_bits(*member as u32);
            if sum >= 0.5 * total {
                return z(*member);
            }
        }
        members.last().map_or(0.0, |last| z(*last))
    }
}

/// [`Picture::on_side`].
struct Window<'a> {
    picture: &'a Picture,
    row: usize,
    column: usize,
    side: usize,
    middle: f32,
    members: &'a mut Members,
}

impl Operation for Window<'_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let Window { picture, row, column, members, .. } = self;
        let at = row * picture.stride + column + REACH;
        let c0 = std::array::from_fn(|channel| s.splat(picture.planes[channel][at]));
        let inside = REACH.saturating_sub(column)..SIDE.min(picture.size[1] + REACH - column);
        for (y, dy) in picture.rows(row) {
            let (c, z) = picture.load(s, y, column);
            let distant = s.from_array(std::array::from_fn(|lane| distant(dy, lane.abs_diff(REACH))));
            let (w, z) = (s.to_array(weight(s, c, c0, distant)), s.to_array(z));
            for x in inside.clone() {
                if usize::from(z[x] > self.middle) == self.side {
                    members.all[members.count] = u64::from(z[x].to_bits()) << 32 | u64::from(w[x].to_bits());
                    members.count += 1;
                }
            }
        }
    }
}
