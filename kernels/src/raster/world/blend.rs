//! One tile: its channels front to back, and the adjoint.

#![expect(unsafe_code, reason = "tasks write tiles of one image and sums of splats into one array")]

use super::super::bin::TILE;
use super::super::blend::{BLOCKS, Block, Hit, Lanes, Sink, Transmittance, Walk, corner};
use super::super::project::{BLOCK, Splat};
use super::super::sort::Entry;
use super::{Drawing, FootprintGradient};
use crate::parallel::Disjoint;
use crate::simd::{LANES, Operation, Simd};

/// Tiles of a splat's box, first and last, by column and by row.
#[inline(always)]
pub(super) fn tiles_of(splat: &Splat) -> [[usize; 2]; 2] {
    [splat.columns.map(|c| usize::from(c) / TILE[0]), splat.rows.map(|r| usize::from(r) / TILE[1])]
}

/// Sums of a Gaussian on a tile, without colours: `Σv, Σvt, Σvs, Σvt², Σvts, Σvs²`.
pub(super) const MOMENTS: usize = 6;

/// A group of channels of a drawing.
#[derive(Clone, Copy)]
pub(super) struct Channels<'a> {
    pub drawing: Drawing<'a>,
    pub first: usize,
}

/// `value` where it is finite, +0 elsewhere.
#[inline(always)]
fn finite(value: f32) -> f32 {
    if value.is_finite() { value } else { 0.0 }
}

impl Channels<'_> {
    /// A Gaussian's colour on all lanes.
    #[inline(always)]
    fn of<S: Simd, const C: usize>(&self, s: S, index: u32) -> [S::F32; C] {
        let start = index as usize * self.drawing.channels + self.first;
        let colour = &self.drawing.colours[start..start + C];
        std::array::from_fn(|c| s.splat(finite(colour[c])))
    }

    #[inline(always)]
    fn background<const C: usize>(&self) -> [f32; C] {
        std::array::from_fn(|c| self.drawing.background.get(self.first + c).map_or(0.0, |&b| finite(b)))
    }
}

/// Draws a tile.
pub(super) struct DrawTile<'a, const C: usize> {
    pub walk: Walk<'a>,
    pub channels: Channels<'a>,
    /// `[H, W, D]`
    pub image: &'a Disjoint<'a, f32>,
    /// `[H, W]`
    pub alpha: Option<&'a Disjoint<'a, f32>>,
    pub light: &'a mut Transmittance,
    pub pixels: &'a mut Vec<[Lanes; C]>,
}

impl<const C: usize> Operation for DrawTile<'_, C> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let Self { walk, channels, image, alpha, light, pixels } = self;
        pixels.clear();
        pixels.resize(BLOCKS, [Lanes::ZERO; C]);
        let Some(values) = pixels.first_chunk_mut() else { unreachable!("a colour for each block") };
        walk.run(s, light, &mut Picture { channels, values });
        let [width, height] = walk.size;
        let (stride, background) = (channels.drawing.channels, channels.background::<C>());
        for index in 0..BLOCKS {
            let [x, y] = corner(walk.tile, index);
            if x >= width || y >= height {
                continue;
            }
            let left = light.last(s, index);
            let values: [[f32; LANES]; C] = std::array::from_fn(|c| {
                s.to_array(s.mul_add(left, s.splat(background[c]), s.load(&pixels[index][c].0)))
            });
            let opaque = s.to_array(s.sub(s.splat(1.0), left));
            for row in 0..BLOCK.min(height - y) {
                let (start, columns) = ((y + row) * width + x, BLOCK.min(width - x));
                if let Some(alpha) = alpha {
                    // SAFETY: a block belongs to one tile and a tile to one task; no other task writes its pixels.
                    let to = unsafe { alpha.part(start..start + columns) };
                    to.copy_from_slice(&opaque[row * BLOCK..][..columns]);
                }
                if C == 0 {
                    continue;
                }
                // SAFETY: as above.
                let to = unsafe { image.part(start * stride..(start + columns) * stride) };
                for (column, to) in to.chunks_exact_mut(stride).enumerate() {
                    let to = &mut to[channels.first..channels.first + C];
                    for c in 0..C {
                        to[c] = values[c][row * BLOCK + column];
                    }
                }
            }
        }
    }
}

/// Channels of a tile's blocks.
struct Picture<'a, const C: usize> {
    channels: Channels<'a>,
    values: &'a mut [[Lanes; C]; BLOCKS],
}

impl<S: Simd, const C: usize> Sink<S> for Picture<'_, C> {
    type Paint = [S::F32; C];

    #[inline(always)]
    fn begin(&mut self, s: S, _: &Splat, entry: &Entry) -> [S::F32; C] {
        self.channels.of(s, entry.index)
    }

    #[inline(always)]
    fn add(&mut self, s: S, at: Block, weight: S::F32, paint: &[S::F32; C]) {
        let values = &mut self.values[at.index()];
        for c in 0..C {
            let value = &mut values[c].0;
            s.store(s.mul_add(weight, paint[c], s.load(value)), value);
        }
    }
}

/// The drawn image, `[H, W, D]` and `[H, W]`, and a loss's gradients with respect to it.
#[derive(Clone, Copy)]
pub(super) struct Pixels<'a> {
    pub image: &'a [f32],
    pub alpha: &'a [f32],
    pub of_image: &'a [f32],
    pub of_alpha: &'a [f32],
}

/// Buffers that a thread needs for the adjoint of a tile.
#[derive(Default)]
pub(super) struct Buffers {
    light: Transmittance,
    /// Channels' gradients, and then g_α and B, of each block.
    values: Vec<Lanes>,
}

/// The adjoint of a tile; returns the sum of T·g of each channel.
pub(super) struct AdjointTile<'a, const C: usize> {
    pub walk: Walk<'a>,
    pub channels: Channels<'a>,
    pub pixels: Pixels<'a>,
    pub offsets: &'a [usize],
    pub sums: &'a Disjoint<'a, f32>,
    pub buffers: &'a mut Buffers,
}

/// Gradients of a block's pixels.
struct Ground<const C: usize> {
    of: [Lanes; C],
    of_alpha: Lanes,
    behind: Lanes,
}

impl<const C: usize> AdjointTile<'_, C> {
    /// The gradients of a block; zero outside the image.
    #[inline(always)]
    fn ground(&self, index: usize) -> Ground<C> {
        let mut ground = Ground { of: [Lanes::ZERO; C], of_alpha: Lanes::ZERO, behind: Lanes::ZERO };
        let ([width, height], [x, y]) = (self.walk.size, corner(self.walk.tile, index));
        if x >= width || y >= height {
            return ground;
        }
        let Pixels { image, alpha, of_image, of_alpha } = self.pixels;
        let (stride, first) = (self.channels.drawing.channels, self.channels.first);
        for row in 0..BLOCK.min(height - y) {
            for column in 0..BLOCK.min(width - x) {
                let (at, lane) = ((y + row) * width + x + column, row * BLOCK + column);
                let mut behind = 0.0;
                if first == 0 {
                    ground.of_alpha.0[lane] = finite(of_alpha[at]);
                    behind = ground.of_alpha.0[lane] * alpha[at];
                }
                let start = at * stride + first;
                let (of, drawn) = (&of_image[start..start + C], &image[start..start + C]);
                for c in 0..C {
                    let g = finite(of[c]);
                    ground.of[c].0[lane] = g;
                    behind = g.mul_add(drawn[c], behind);
                }
                ground.behind.0[lane] = finite(behind);
            }
        }
        ground
    }
}

impl<const C: usize> Operation for AdjointTile<'_, C> {
    type Output = [f64; C];
    #[inline(always)]
    fn run<S: Simd>(self, s: S) -> [f64; C] {
        let mut values = std::mem::take(&mut self.buffers.values);
        values.clear();
        for index in 0..BLOCKS {
            let Ground { of, of_alpha, behind } = self.ground(index);
            values.extend_from_slice(&of);
            values.push(of_alpha);
            values.push(behind);
        }
        let Self { walk, channels, offsets, sums, buffers, .. } = self;
        let gather =
            Gather { s, channels, tile: walk.tile, offsets, sums, values: &mut values, most: walk.shape.cut.most };
        let zero = s.splat(0.0);
        walk.run(
            s,
            &mut buffers.light,
            &mut Gathering { gather, slot: 0, drawn: false, moments: [zero; MOMENTS], colours: [zero; C] },
        );
        let mut totals = [0.0; C];
        if !channels.drawing.background.is_empty() {
            for (index, values) in values.chunks_exact(C + 2).enumerate() {
                let left = s.to_array(buffers.light.last(s, index));
                for c in 0..C {
                    let of = (0..LANES).map(|l| f64::from(left[l]) * f64::from(values[c].0[l]));
                    totals[c] += of.fold(0.0, |total, of| total + of);
                }
            }
        }
        buffers.values = values;
        totals
    }
}

/// Source and destination of a tile's sums.
struct Gather<'a, S: Simd> {
    s: S,
    channels: Channels<'a>,
    tile: [usize; 2],
    offsets: &'a [usize],
    sums: &'a Disjoint<'a, f32>,
    values: &'a mut [Lanes],
    /// An α above this is lowered to it.
    most: f32,
}

/// Sums of a splat.
struct Gathering<'a, S: Simd, const C: usize> {
    gather: Gather<'a, S>,
    /// Slot of the splat's sums on this tile.
    slot: usize,
    /// True if the splat is drawn on a pixel.
    drawn: bool,
    moments: [S::F32; MOMENTS],
    colours: [S::F32; C],
}

impl<S: Simd, const C: usize> Sink<S> for Gathering<'_, S, C> {
    const GEOMETRY: bool = true;
    type Paint = [S::F32; C];

    #[inline(always)]
    fn begin(&mut self, s: S, splat: &Splat, entry: &Entry) -> [S::F32; C] {
        let [column, row] = self.gather.tile;
        let [columns, rows] = tiles_of(splat);
        self.slot = self.gather.offsets[entry.index as usize]
            + (row - rows[0]) * (columns[1] - columns[0] + 1)
            + (column - columns[0]);
        self.drawn = false;
        self.moments = [s.splat(0.0); MOMENTS];
        self.colours = [s.splat(0.0); C];
        self.gather.channels.of(s, entry.index)
    }

    #[inline(always)]
    fn add(&mut self, _: S, _: Block, _: S::F32, _: &[S::F32; C]) {}

    #[inline(always)]
    fn hit(&mut self, s: S, at: Block, hit: &Hit<S>, paint: &[S::F32; C]) {
        let weight = hit.weight;
        let seen = s.lt(s.splat(0.0), weight);
        if !s.any(seen) {
            return;
        }
        self.drawn = true;
        let values = &mut self.gather.values[at.index() * (C + 2)..][..C + 2];
        let mut total = s.load(&values[C].0);
        for c in 0..C {
            let of = s.load(&values[c].0);
            total = s.mul_add(of, paint[c], total);
            self.colours[c] = s.mul_add(weight, of, self.colours[c]);
        }
        let (most, one) = (s.splat(self.gather.most), s.splat(1.0));
        let own = s.mul(weight, total);
        let behind = s.sub(s.load(&values[C + 1].0), own);
        s.store(behind, &mut values[C + 1].0);
        let alpha = s.min(hit.alpha, most);
        let odds = s.div(alpha, s.sub(one, alpha));
        let free = s.and(seen, s.le(hit.alpha, most));
        let v = s.keep(free, s.neg_mul_add(odds, behind, own));
        let (across, down) = (s.mul(v, hit.across), s.mul(v, hit.down));
        let sums = &mut self.moments;
        sums[0] = s.add(sums[0], v);
        sums[1] = s.add(sums[1], across);
        sums[2] = s.add(sums[2], down);
        sums[3] = s.mul_add(across, hit.across, sums[3]);
        sums[4] = s.mul_add(across, hit.down, sums[4]);
        sums[5] = s.mul_add(down, hit.down, sums[5]);
    }

    #[inline(always)]
    fn end(&mut self, _: &Entry) {
        if !self.drawn {
            return;
        }
        let s = self.gather.s;
        let start = self.slot * (MOMENTS + C);
        // SAFETY: every Gaussian has a place for each tile of its box, and a tile is one task's.
        let to = unsafe { self.gather.sums.part(start..start + MOMENTS + C) };
        for (to, &sum) in to.iter_mut().zip(self.moments.iter().chain(&self.colours)) {
            *to = s.sum(sum);
        }
    }
}

/// Adds the gradients that follow from a splat's moments, in binary64, each rounded once and then added.
#[inline(always)]
pub(super) fn add_moments(to: &mut FootprintGradient, splat: &Splat, moments: [f32; MOMENTS]) {
    /// ∂ ln α/∂t = −2·ln 2·t.
    const TWICE_LN_2: f64 = 2.0 * std::f64::consts::LN_2;
    let [v, vt, vs, vtt, vts, vss] = moments.map(f64::from);
    let (p, q) = (f64::from(splat.p), f64::from(splat.q));
    to.centre[0] += (TWICE_LN_2 * (p * vt)) as f32;
    to.centre[1] += (TWICE_LN_2 * (q * vs - splat.k * p * vt)) as f32;
    to.shape[0] += (-TWICE_LN_2 * vtt) as f32;
    to.shape[1] += (TWICE_LN_2 * vts) as f32;
    to.shape[2] += (-TWICE_LN_2 * vss) as f32;
    to.opacity += (v / f64::from(splat.opacity)) as f32;
}
