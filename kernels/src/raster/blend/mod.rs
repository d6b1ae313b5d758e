//! One tile: its list, front to back, onto its blocks of 4×4 pixels.

#![expect(unsafe_code, reason = "tasks write tiles of one image")]

mod sphere;
mod tables;
mod walk;

use std::time::Duration;

use super::project::{BLOCK, Splat};
use super::sort::Entry;
use crate::parallel::Disjoint;
use crate::simd::{LANES, Operation, Simd};

pub(super) use walk::{BLOCKS, Block, BlockSet, Hit, Lanes, Shape, Sink, Transmittance, Walk, corner};

/// Colour of 4×4 pixels.
type Rgb = [Lanes; 3];

/// Depth and count of a block's pixels.
#[derive(Clone, Debug)]
struct Extra {
    depth: Lanes,
    /// Splats drawn.
    count: Lanes,
}

/// Buffers that a thread needs to draw a tile.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    light: Transmittance,
    rgb: Vec<Rgb>,
    extras: Vec<Extra>,
    pub spare: Vec<Entry>,
    pub tally: Tally,
}

/// Work of the blend.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Tally {
    /// Blocks blended.
    pub blocks: u64,
    /// Entries of lists that were skipped because their tile was finished.
    pub unseen: u64,
    pub sort: Duration,
    pub blend: Duration,
}

/// Destination of a drawn tile.
pub(super) struct Planes<'a> {
    pub background: [f32; 3],
    pub rgb: Disjoint<'a, f32>,
    pub depth: Option<Disjoint<'a, f32>>,
    pub alpha: Option<Disjoint<'a, f32>>,
    pub final_t: Option<Disjoint<'a, f32>>,
    pub blended: Option<Disjoint<'a, u32>>,
}

/// Draws a tile.
pub(super) struct DrawTile<'a> {
    pub walk: Walk<'a>,
    pub planes: &'a Planes<'a>,
    pub scratch: &'a mut Scratch,
}

impl Operation for DrawTile<'_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(mut self, s: S) {
        let Scratch { light, rgb, extras, tally, .. } = &mut *self.scratch;
        rgb.clear();
        rgb.resize(BLOCKS, [Lanes::ZERO; 3]);
        let Some(rgb) = rgb.first_chunk_mut() else { unreachable!("a colour for each block") };
        let walked = if self.planes.depth.is_some() || self.planes.blended.is_some() {
            extras.clear();
            extras.resize(BLOCKS, Extra { depth: Lanes::ZERO, count: Lanes::ZERO });
            let Some(extras) = extras.first_chunk_mut::<BLOCKS>() else { unreachable!("a depth for each block") };
            self.walk.run(s, light, &mut Picture { rgb, extras })
        } else {
            self.walk.run(s, light, &mut Picture { rgb, extras: &mut [] })
        };
        tally.blocks += walked.blocks;
        tally.unseen += walked.unseen;
        self.store(s);
    }
}

/// Colour, and depth and counts where `EXTRAS` is [`BLOCKS`] and not 0, of a tile's blocks.
struct Picture<'a, const EXTRAS: usize> {
    rgb: &'a mut [Rgb; BLOCKS],
    extras: &'a mut [Extra; EXTRAS],
}

/// Colour and depth of a splat on all lanes.
struct Paint<S: Simd> {
    rgb: [S::F32; 3],
    depth: S::F32,
}

impl<S: Simd, const EXTRAS: usize> Sink<S> for Picture<'_, EXTRAS> {
    type Paint = Paint<S>;

    #[inline(always)]
    fn begin(&mut self, s: S, splat: &Splat, _: &Entry) -> Paint<S> {
        Paint { rgb: splat.rgb.map(|c| s.splat(c)), depth: s.splat(splat.depth) }
    }

    #[inline(always)]
    fn add(&mut self, s: S, at: Block, weight: S::F32, paint: &Paint<S>) {
        const { assert!(EXTRAS == 0 || EXTRAS == BLOCKS) };
        let rgb = &mut self.rgb[at.index()];
        for channel in 0..3 {
            let values = &mut rgb[channel].0;
            s.store(s.mul_add(weight, paint.rgb[channel], s.load(values)), values);
        }
        if EXTRAS > 0 {
            let Extra { depth, count } = &mut self.extras[at.index()];
            s.store(s.mul_add(weight, paint.depth, s.load(&depth.0)), &mut depth.0);
            let one = s.keep(s.lt(s.splat(0.0), weight), s.splat(1.0));
            s.store(s.add(s.load(&count.0), one), &mut count.0);
        }
    }
}

impl DrawTile<'_> {
    /// Adds the background and writes the planes.
    #[inline(always)]
    fn store<S: Simd>(&mut self, s: S) {
        let planes = self.planes;
        let size = self.walk.size;
        let plane = size[0] * size[1];
        let [red, green, blue] = planes.background;
        let background = [s.splat(red), s.splat(green), s.splat(blue)];
        for index in 0..BLOCKS {
            let [x, y] = corner(self.walk.tile, index);
            if x >= size[0] || y >= size[1] {
                continue;
            }
            let transmittance = self.scratch.light.last(s, index);
            for channel in 0..3 {
                let value = s.mul_add(transmittance, background[channel], s.load(&self.scratch.rgb[index][channel].0));
                put_block(&planes.rgb, channel * plane, size, [x, y], &s.to_array(value));
            }
            if let Some(to) = &planes.alpha {
                put_block(to, 0, size, [x, y], &s.to_array(s.sub(s.splat(1.0), transmittance)));
            }
            if let Some(to) = &planes.final_t {
                put_block(to, 0, size, [x, y], &s.to_array(transmittance));
            }
            if let Some(to) = &planes.depth {
                put_block(to, 0, size, [x, y], &self.scratch.extras[index].depth.0);
            }
            if let Some(to) = &planes.blended {
                put_block(to, 0, size, [x, y], &self.scratch.extras[index].count.0.map(|c| c as u32));
            }
        }
    }
}

/// Writes the pixels of a block that are in the image.
#[inline(always)]
pub(super) fn put_block<T: Copy>(
    to: &Disjoint<'_, T>,
    base: usize,
    [width, height]: [usize; 2],
    [x, y]: [usize; 2],
    values: &[T; LANES],
) {
    let (columns, rows) = (BLOCK.min(width - x), BLOCK.min(height - y));
    for row in 0..rows {
        let start = base + (y + row) * width + x;
        // SAFETY: a block belongs to one tile and a tile to one task; no other task writes its pixels.
        let pixels = unsafe { to.part(start..start + columns) };
        pixels.copy_from_slice(&values[row * BLOCK..][..columns]);
    }
}
