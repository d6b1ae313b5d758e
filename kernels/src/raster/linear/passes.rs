//! Passes over the record of one tile: colours to pixels, pixels to sums.

#![expect(unsafe_code, reason = "tasks write sums of splats into one array")]

use super::super::blend::{BLOCKS, BlockSet, Lanes, corner, put_block};
use super::super::project::BLOCK;
use super::record::{Record, Unit, Weights};
use crate::parallel::Disjoint;
use crate::simd::{LANES, Operation, Simd};

/// Channels of a tile's blocks.
pub(super) type Pixels<const C: usize> = [[Lanes; C]; BLOCKS];

/// A block's pixels in channel `c`: the sum of its hits, the background behind them, and the sum of the weights below
/// the least.
#[inline(always)]
fn whole<S: Simd>(s: S, record: &Record, block: usize, c: usize, sum: &Lanes, background: f32) -> S::F32 {
    let value = s.mul_add(s.load(&record.light[block].0), s.splat(background), s.load(&sum.0));
    match record.rest.get(block) {
        Some(rest) => s.add(value, s.load(&rest[c].0)),
        None => value,
    }
}

/// Position of a tile: its column and row in the grid, width and height of the image; and its blocks that count.
#[derive(Clone, Copy)]
pub(super) struct Place {
    pub tile: [usize; 2],
    pub size: [usize; 2],
    pub wanted: BlockSet,
}

/// Destination of a tile's sums: those of its splat `at` are contiguous at `slots[at]`.
#[derive(Clone, Copy)]
pub(super) struct Slots<'a> {
    pub slots: &'a [u32],
    pub partial: &'a Disjoint<'a, f32>,
}

/// `value` where it is finite, +0 elsewhere.
#[inline(always)]
fn finite<S: Simd>(s: S, value: S::F32) -> S::F32 {
    s.keep(s.eq(s.sub(value, value), s.splat(0.0)), value)
}

/// Splats between the prefetch of a colour and its use.
const AHEAD: usize = 12;

/// The colours of a tile's splats.
pub(super) trait Paint<const C: usize> {
    /// The value of splat `at` of the record, which belongs to `gaussian`.
    fn of(&self, at: usize, gaussian: u32) -> [f32; C];

    /// Prefetches the colour of splat `at`, if there is one.
    fn prefetch(&self, at: usize);
}

impl<const C: usize> Paint<C> for &[[f32; C]] {
    #[inline(always)]
    fn of(&self, _: usize, gaussian: u32) -> [f32; C] {
        self[gaussian as usize]
    }

    #[inline(always)]
    fn prefetch(&self, _: usize) {}
}

/// The weights of a hit.
#[inline(always)]
fn load<S: Simd>(s: S, (weights, unit): (&Weights, &Unit)) -> S::F32 {
    s.mul(s.load_u8(&weights.0), s.splat(unit.value()))
}

/// `pixels = Σ w·colour`, hit by hit, each a fused multiply-add.
#[inline(always)]
fn spread<S: Simd, const C: usize>(s: S, record: &Record, colours: &impl Paint<C>, pixels: &mut Pixels<C>) {
    pixels.fill([Lanes::ZERO; C]);
    for (at, gaussian, hits) in record.splats() {
        colours.prefetch(at + AHEAD);
        let mut paint = [s.splat(0.0); C];
        for (paint, c) in paint.iter_mut().zip(colours.of(at, gaussian)) {
            *paint = s.splat(if c.is_finite() { c } else { 0.0 });
        }
        for (&block, weight) in record.hits(hits) {
            let weight = load(s, weight);
            let pixels = &mut pixels[usize::from(block) % BLOCKS];
            for c in 0..C {
                s.store(s.mul_add(weight, paint[c], s.load(&pixels[c].0)), &mut pixels[c].0);
            }
        }
    }
}

/// For each splat `Σ w·pixels` over its hits in order, a fused multiply-add on each lane, folded by [`Simd::sum`].
#[inline(always)]
fn gather<S: Simd, const C: usize>(s: S, record: &Record, pixels: &Pixels<C>, to: Slots<'_>) {
    for (at, _, hits) in record.splats() {
        let mut sums = [s.splat(0.0); C];
        for (&block, weight) in record.hits(hits) {
            let weight = load(s, weight);
            let pixels = &pixels[usize::from(block) % BLOCKS];
            for c in 0..C {
                sums[c] = s.mul_add(weight, s.load(&pixels[c].0), sums[c]);
            }
        }
        put::<S, C>(s, sums, at, to);
    }
}

/// Folds and stores the sums of a splat.
#[inline(always)]
fn put<S: Simd, const C: usize>(s: S, sums: [S::F32; C], at: usize, to: Slots<'_>) {
    let slot = to.slots[at] as usize * C;
    // SAFETY: every splat of every tile has a slot of its own.
    let partial = unsafe { to.partial.part(slot..slot + C) };
    for c in 0..C {
        partial[c] = s.sum(sums[c]);
    }
}

/// The pixels of a block of a plane; zero where they are outside the image.
#[inline(always)]
fn take_block(plane: &[f32], [width, height]: [usize; 2], [x, y]: [usize; 2]) -> [f32; LANES] {
    let mut values = [0.0; LANES];
    let (columns, rows) = (BLOCK.min(width - x), BLOCK.min(height - y));
    for row in 0..rows {
        let from = &plane[(y + row) * width + x..][..columns];
        if columns == BLOCK {
            values[row * BLOCK..][..BLOCK].copy_from_slice(&from[..BLOCK]);
        } else {
            values[row * BLOCK..][..columns].copy_from_slice(from);
        }
    }
    values
}

impl Place {
    /// Calls `visit` with the blocks that count and have a pixel in the image, and their first pixel.
    #[inline(always)]
    fn blocks(self, mut visit: impl FnMut(usize, [usize; 2])) {
        for block in 0..BLOCKS {
            let [x, y] = corner(self.tile, block);
            if x < self.size[0] && y < self.size[1] && self.wanted.has(block) {
                visit(block, [x, y]);
            }
        }
    }
}

/// `A·c + B + T·background` of a tile.
pub(super) struct Forward<'a> {
    pub record: &'a Record,
    pub place: Place,
    pub colours: &'a [[f32; 3]],
    pub background: [f32; 3],
    pub pixels: &'a mut Pixels<3>,
    /// `[3, H, W]`
    pub image: &'a Disjoint<'a, f32>,
}

impl Operation for Forward<'_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let Self { record, place, pixels, .. } = self;
        spread(s, record, &self.colours, pixels);
        place.blocks(|block, xy| {
            for c in 0..3 {
                let value = whole(s, record, block, c, &pixels[block][c], self.background[c]);
                put_block(self.image, c * place.size[0] * place.size[1], place.size, xy, &s.to_array(value));
            }
        });
    }
}

/// `Aᵀr` of a tile.
pub(super) struct Adjoint<'a> {
    pub record: &'a Record,
    pub place: Place,
    /// `[3, H, W]`
    pub residual: &'a [f32],
    pub pixels: &'a mut Pixels<3>,
    pub to: Slots<'a>,
}

impl Operation for Adjoint<'_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let Self { record, place, residual, pixels, to } = self;
        let plane = place.size[0] * place.size[1];
        place.blocks(|block, xy| {
            for c in 0..3 {
                let value = take_block(&residual[c * plane..][..plane], place.size, xy);
                s.store(finite(s, s.from_array(value)), &mut pixels[block][c].0);
            }
        });
        gather(s, record, pixels, to);
    }
}

/// `AᵀA·c` of a tile.
pub(super) struct Normal<'a, P, const C: usize> {
    pub record: &'a Record,
    pub colours: P,
    pub pixels: &'a mut Pixels<C>,
    pub to: Slots<'a>,
}

impl<P: Paint<C>, const C: usize> Operation for Normal<'_, P, C> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let Self { record, colours, pixels, to } = self;
        spread(s, record, &colours, pixels);
        for pixel in pixels.iter_mut().flatten() {
            // The black background's zero: −0 becomes +0.
            let value = s.add(s.load(&pixel.0), s.splat(0.0));
            s.store(finite(s, value), &mut pixel.0);
        }
        gather(s, record, pixels, to);
    }
}

/// `Aᵀ(target − A·c − B − T·background)` of a tile; returns the sum of squares.
pub(super) struct Residual<'a, P> {
    pub record: &'a Record,
    pub place: Place,
    pub colours: P,
    pub background: [f32; 3],
    /// `[3, H, W]`
    pub target: &'a [f32],
    pub pixels: &'a mut Pixels<3>,
    pub to: Slots<'a>,
}

impl<P: Paint<3>> Operation for Residual<'_, P> {
    type Output = f64;
    #[inline(always)]
    fn run<S: Simd>(self, s: S) -> f64 {
        let Self { record, place, pixels, to, .. } = self;
        spread(s, record, &self.colours, pixels);
        let plane = place.size[0] * place.size[1];
        let mut squares = [0.0_f64; LANES];
        place.blocks(|block, xy| {
            for c in 0..3 {
                let pixel = &mut pixels[block][c];
                let value = whole(s, record, block, c, pixel, self.background[c]);
                let target = s.from_array(take_block(&self.target[c * plane..][..plane], place.size, xy));
                let mut residual = s.to_array(finite(s, s.sub(target, value)));
                outside(&mut residual, place.size, xy);
                for (sum, r) in squares.iter_mut().zip(residual) {
                    *sum += f64::from(r) * f64::from(r);
                }
                pixel.0 = residual;
            }
        });
        gather(s, record, pixels, to);
        for half in [8, 4, 2, 1] {
            for lane in 0..half {
                squares[lane] += squares[lane + half];
            }
        }
        squares[0]
    }
}

/// Zeroes the pixels of a block that are outside the image.
#[inline(always)]
fn outside(values: &mut [f32; LANES], [width, height]: [usize; 2], [x, y]: [usize; 2]) {
    if x + BLOCK <= width && y + BLOCK <= height {
        return;
    }
    for (lane, value) in values.iter_mut().enumerate() {
        if x + lane % BLOCK >= width || y + lane / BLOCK >= height {
            *value = 0.0;
        }
    }
}

/// `Σ w` and `Σ w²` of a tile's splats.
pub(super) struct Moments<'a> {
    pub record: &'a Record,
    pub to: Slots<'a>,
}

impl Operation for Moments<'_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        for (at, _, hits) in self.record.splats() {
            let mut sums = [s.splat(0.0); 2];
            for (_, weight) in self.record.hits(hits) {
                let weight = load(s, weight);
                sums = [s.add(sums[0], weight), s.mul_add(weight, weight, sums[1])];
            }
            put::<S, 2>(s, sums, at, self.to);
        }
    }
}
