//! One tile: its list, front to back, onto its blocks of 4×4 pixels.

use std::marker::PhantomData;
use std::time::Duration;

use super::bin::{Reach, TILE};
use super::project::{ALPHA_MAX, ALPHA_MIN, BLOCK, Splat, TRANSMITTANCE_MIN, split};
use super::sort::Entry;
use crate::parallel::Disjoint;
use crate::simd::{LANES, Operation, SHIFTER, Simd};

/// Blocks of a tile.
const BLOCKS: usize = TILE[0] * TILE[1];
/// Records that are fetched together: their cache misses overlap.
const TOGETHER: usize = 32;
/// A box of at most this many blocks is drawn whole: to tell which of them the footprint misses would cost more.
const WHOLE_BOX: usize = 12;
/// A value for each column or row of pixels of a tile, whichever are more, and for a vector more.
type Pixels = [f32; PIXELS];
const PIXELS: usize = (if TILE[0] > TILE[1] { TILE[0] } else { TILE[1] }) * BLOCK + LANES;
const COUNTING: [f32; LANES] = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0, 15.0];
/// All pixels of a block.
const ALL: u16 = u16::MAX;

const _: () = assert!(TILE[0] <= LANES && TILE[1] <= LANES && BLOCK * BLOCK == LANES);

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

/// What is known of 4×4 pixels.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
struct Block {
    /// Zero where the pixel is finished.
    transmittance: [f32; LANES],
    rgb: [[f32; LANES]; 3],
}

/// What else is known of them.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
struct Extra {
    /// Transmittance with which a pixel was finished.
    finished: [f32; LANES],
    depth: [f32; LANES],
    /// Splats drawn.
    count: [f32; LANES],
}

/// What a thread needs to draw a tile.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    blocks: Vec<Block>,
    extras: Vec<Extra>,
    /// Finished pixels of each block.
    done: Vec<u16>,
    pub spare: Vec<Entry>,
    pub tally: Tally,
}

/// Work of the blend.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Tally {
    /// Blocks blended.
    pub blocks: u64,
    /// Entries of lists that were not looked at because their tile was finished.
    pub unseen: u64,
    pub sort: Duration,
    pub blend: Duration,
}

/// Where a drawn tile goes.
pub(super) struct Planes<'a> {
    pub width: usize,
    pub height: usize,
    pub background: [f32; 3],
    pub rgb: Disjoint<'a, f32>,
    pub depth: Option<Disjoint<'a, f32>>,
    pub alpha: Option<Disjoint<'a, f32>>,
    pub final_t: Option<Disjoint<'a, f32>>,
    pub blended: Option<Disjoint<'a, u32>>,
}

/// Draws the tile at (`column`, `row`) of the grid.
pub(super) struct DrawTile<'a> {
    pub splats: &'a [Splat],
    /// In drawing order.
    pub list: &'a [Entry],
    pub separable: bool,
    pub column: usize,
    pub row: usize,
    pub planes: &'a Planes<'a>,
    pub scratch: &'a mut Scratch,
}

impl Operation for DrawTile<'_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(mut self, s: S) {
        self.clear();
        let extras = self.planes.depth.is_some() || self.planes.blended.is_some();
        match (self.separable, extras) {
            (true, false) => self.blend::<S, true, false>(s),
            (true, true) => self.blend::<S, true, true>(s),
            (false, false) => self.blend::<S, false, false>(s),
            (false, true) => self.blend::<S, false, true>(s),
        }
        self.store(s);
    }
}

/// Colour and depth of a splat on all lanes.
struct Paint<S: Simd> {
    rgb: [S::F32; 3],
    depth: S::F32,
}

impl<S: Simd> Paint<S> {
    #[inline(always)]
    fn new(s: S, splat: &Splat) -> Self {
        let [red, green, blue] = splat.rgb;
        Self { rgb: [s.splat(red), s.splat(green), s.splat(blue)], depth: s.splat(splat.depth) }
    }
}

/// The blocks of a footprint's box that lie in a tile, first and end, counted from the tile's first.
struct Box4 {
    columns: [usize; 2],
    rows: [usize; 2],
}

impl DrawTile<'_> {
    /// Transmittance 1 inside the image; pixels outside are finished from the start.
    #[inline(always)]
    fn clear(&mut self) {
        let scratch = &mut *self.scratch;
        const CLEAR: Block = Block { transmittance: [1.0; LANES], rgb: [[0.0; LANES]; 3] };
        const NOTHING: Extra = Extra { finished: [0.0; LANES], depth: [0.0; LANES], count: [0.0; LANES] };
        scratch.blocks.clear();
        scratch.blocks.resize(BLOCKS, CLEAR);
        scratch.extras.clear();
        scratch.extras.resize(BLOCKS, NOTHING);
        scratch.done.clear();
        scratch.done.resize(BLOCKS, 0);
        for block in 0..BLOCKS {
            let x = (self.column * TILE[0] + block % TILE[0]) * BLOCK;
            let y = (self.row * TILE[1] + block / TILE[0]) * BLOCK;
            if x + BLOCK <= self.planes.width && y + BLOCK <= self.planes.height {
                continue;
            }
            for lane in 0..LANES {
                if x + lane % BLOCK >= self.planes.width || y + lane / BLOCK >= self.planes.height {
                    scratch.blocks[block].transmittance[lane] = 0.0;
                    scratch.done[block] |= 1 << lane;
                }
            }
        }
    }

    /// Copies the records of the entries from `at` on; gives how many there were.
    #[inline(always)]
    fn fetch(&self, at: usize, near: &mut [Splat; TOGETHER]) -> usize {
        let entries = &self.list[at..];
        for (near, entry) in near.iter_mut().zip(entries) {
            *near = self.splats[entry.index as usize];
        }
        entries.len().min(TOGETHER)
    }

    /// The blocks of a splat's box in the tile.
    #[inline(always)]
    fn clip(&self, splat: &Splat) -> Box4 {
        let (x, y) = (self.column * TILE[0], self.row * TILE[1]);
        let [left, right] = splat.columns.map(usize::from);
        let [top, bottom] = splat.rows.map(usize::from);
        let columns = [left.max(x) - x, (right + 1).min(x + TILE[0]) - x];
        Box4 { columns, rows: [top.max(y) - y, (bottom + 1).min(y + TILE[1]) - y] }
    }

    /// Blends the list, as many records at a time as are fetched together.
    #[inline(always)]
    fn blend<S: Simd, const SEPARABLE: bool, const EXTRAS: bool>(&mut self, s: S) {
        let mut canvas = Canvas::new(self.scratch);
        let mut tables = Tables::new(self.column, self.row);
        let mut near = [Splat::HIDDEN; TOGETHER];
        let (mut at, mut blocks) = (0, 0);
        while at < self.list.len() && canvas.open > 0 {
            let count = self.fetch(at, &mut near);
            for (i, splat) in near[..count].iter().enumerate() {
                if let Some(later) = self.list.get(at + TOGETHER + i) {
                    s.prefetch(self.splats.as_ptr().wrapping_add(later.index as usize));
                }
                let bounds = self.clip(splat);
                blocks += if SEPARABLE {
                    canvas.separable::<S, EXTRAS>(s, splat, bounds, &mut tables)
                } else {
                    canvas.general::<S, EXTRAS>(s, splat, bounds, &mut tables)
                };
            }
            at += count;
        }
        self.scratch.tally.unseen += (self.list.len() - at) as u64;
        self.scratch.tally.blocks += blocks as u64;
    }

    /// Adds the background and writes the planes.
    #[inline(always)]
    fn store<S: Simd>(&mut self, s: S) {
        let planes = self.planes;
        let plane = planes.width * planes.height;
        let [red, green, blue] = planes.background;
        let background = [s.splat(red), s.splat(green), s.splat(blue)];
        for index in 0..BLOCKS {
            let x = (self.column * TILE[0] + index % TILE[0]) * BLOCK;
            let y = (self.row * TILE[1] + index / TILE[0]) * BLOCK;
            if x >= planes.width || y >= planes.height {
                continue;
            }
            let (block, extra) = (&self.scratch.blocks[index], &self.scratch.extras[index]);
            let done = s.mask_from_bits(self.scratch.done[index]);
            let transmittance = s.select(done, s.load(&extra.finished), s.load(&block.transmittance));
            for channel in 0..3 {
                let value = s.mul_add(transmittance, background[channel], s.load(&block.rgb[channel]));
                put_block(&planes.rgb, channel * plane, planes, x, y, &s.to_array(value));
            }
            if let Some(to) = &planes.alpha {
                put_block(to, 0, planes, x, y, &s.to_array(s.sub(s.splat(1.0), transmittance)));
            }
            if let Some(to) = &planes.final_t {
                put_block(to, 0, planes, x, y, &s.to_array(transmittance));
            }
            if let Some(to) = &planes.depth {
                put_block(to, 0, planes, x, y, &extra.depth);
            }
            if let Some(to) = &planes.blended {
                put_block(to, 0, planes, x, y, &extra.count.map(|c| c as u32));
            }
        }
    }
}

/// Writes the pixels of a block that lie in the image.
#[inline(always)]
fn put_block<T: Copy>(to: &Disjoint<'_, T>, base: usize, planes: &Planes<'_>, x: usize, y: usize, values: &[T; LANES]) {
    let (columns, rows) = (BLOCK.min(planes.width - x), BLOCK.min(planes.height - y));
    for row in 0..rows {
        let start = base + (y + row) * planes.width + x;
        // SAFETY: a block belongs to one tile and a tile to one task; its pixels are nobody else's.
        let pixels = unsafe { to.part(start..start + columns) };
        pixels.copy_from_slice(&values[row * BLOCK..][..columns]);
    }
}

/// `(scale·d)²` on lane i, with d the distance of the centre from the nearest pixel of the i-th block along one axis.
#[inline(always)]
fn nearest<S: Simd>(s: S, centre: [f32; 2], scale: f32, pixels: &Pixels) -> S::F32 {
    let first = s.mul_add(s.from_array(COUNTING), s.splat(BLOCK as f32), s.splat(pixels[0] - centre[0]));
    let low = s.sub(first, s.splat(centre[1]));
    let high = s.add(low, s.splat(BLOCK as f32 - 1.0));
    // At most one of both is positive.
    let t = s.mul(s.splat(scale), s.max(s.max(low, s.neg(high)), s.splat(0.0)));
    s.mul(t, t)
}

/// `factor·2^−(scale·d)²` for every pixel of the blocks `span`, with d its distance from the centre along one axis.
///
/// # Safety
/// `span` lies in the tile.
#[inline(always)]
unsafe fn factors<S: Simd>(
    s: S,
    centre: [f32; 2],
    scale: f32,
    factor: f32,
    span: [usize; 2],
    pixels: &Pixels,
    to: &mut [f32],
) {
    let (whole, rest, scale) = (s.splat(centre[0]), s.splat(centre[1]), s.splat(scale));
    let mut at = span[0] * BLOCK;
    while at < span[1] * BLOCK {
        // SAFETY: `at` is a pixel of the tile; both arrays go on for a vector behind its last.
        unsafe {
            let x = s.load_ptr(pixels.as_ptr().add(at));
            let t = s.mul(scale, s.sub(s.sub(x, whole), rest));
            s.store_ptr(s.mul(s.splat(factor), exp2_negative(s, s.mul(t, t))), to.as_mut_ptr().add(at));
        }
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

/// First and last block column that a footprint can reach in each row of blocks of the tile at (`left`, `top`), inside `columns`.
#[inline(always)]
fn strips<S: Simd>(s: S, splat: &Splat, [left, top]: [f32; 2], columns: [usize; 2]) -> ([i32; LANES], [i32; LANES]) {
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

/// Coordinates of a tile's pixels, and what a splat's lanes are made of, by column and by row of pixels; with a vector to spare.
struct Tables {
    columns: Pixels,
    rows: Pixels,
    /// `rows` in binary64.
    lines: [f64; PIXELS],
    /// Factor of each column, separably.
    across: Pixels,
    /// Factor of each row, separably; otherwise its exponent.
    down: Pixels,
    /// Middle of the footprint on each row, in two parts.
    middle: Pixels,
    rest: Pixels,
}

impl Tables {
    #[inline(always)]
    fn new(column: usize, row: usize) -> Self {
        let mut tables = Self {
            columns: [0.0; PIXELS],
            rows: [0.0; PIXELS],
            lines: [0.0; PIXELS],
            across: [0.0; PIXELS],
            down: [0.0; PIXELS],
            middle: [0.0; PIXELS],
            rest: [0.0; PIXELS],
        };
        for i in 0..PIXELS {
            tables.columns[i] = (column * TILE[0] * BLOCK + i) as f32;
            tables.rows[i] = (row * TILE[1] * BLOCK + i) as f32;
            tables.lines[i] = (row * TILE[1] * BLOCK + i) as f64;
        }
        tables
    }
}

/// The blocks of the tile that is drawn.
struct Canvas<'a> {
    blocks: *mut Block,
    extras: *mut Extra,
    done: *mut u16,
    /// Blocks with a pixel that is not finished.
    open: usize,
    life: PhantomData<&'a mut Scratch>,
}

impl<'a> Canvas<'a> {
    /// `scratch` was cleared for a tile.
    #[inline(always)]
    fn new(scratch: &mut Scratch) -> Canvas<'a> {
        assert!(scratch.blocks.len() == BLOCKS && scratch.extras.len() == BLOCKS && scratch.done.len() == BLOCKS);
        Canvas {
            open: scratch.done.iter().filter(|&&done| done != ALL).count(),
            blocks: scratch.blocks.as_mut_ptr(),
            extras: scratch.extras.as_mut_ptr(),
            done: scratch.done.as_mut_ptr(),
            life: PhantomData,
        }
    }

    /// Draws a splat on its box, with `α = min(0.99, (o·2^−(q·dy)²)·2^−(p·dx)²)`. Gives the number of blocks.
    #[inline(always)]
    fn separable<S: Simd, const EXTRAS: bool>(
        &mut self,
        s: S,
        splat: &Splat,
        Box4 { columns, rows }: Box4,
        tables: &mut Tables,
    ) -> usize {
        let paint = Paint::new(s, splat);
        // SAFETY: columns and rows are blocks of the tile; the arrays have a vector to spare beyond its last.
        unsafe {
            factors(s, splat.x, splat.p, 1.0, columns, &tables.columns, &mut tables.across);
            factors(s, splat.y, splat.q, splat.opacity, rows, &tables.rows, &mut tables.down);
        }
        let count = (columns[1] - columns[0]) * (rows[1] - rows[0]);
        if count <= WHOLE_BOX {
            for row in rows[0]..rows[1] {
                // SAFETY: the factors were made for these rows and columns.
                unsafe { self.blend_row::<S, EXTRAS>(s, tables, row, columns, &paint) };
            }
            return count;
        }
        let column_exponent = nearest(s, splat.x, splat.p, &tables.columns);
        let row_exponent = s.to_array(nearest(s, splat.y, splat.q, &tables.rows));
        let inside = (1_u32 << columns[1]) - (1 << columns[0]);
        let mut count = 0;
        for row in rows[0]..rows[1] {
            // A block on which even the nearest pixel's exponent is out of reach cannot change.
            let reached = s.le(column_exponent, s.splat(splat.reach - row_exponent[row]));
            let reached = u32::from(s.bits(reached)) & inside;
            if reached != 0 {
                let columns = [reached.trailing_zeros() as usize, 32 - reached.leading_zeros() as usize];
                count += columns[1] - columns[0];
                // SAFETY: the factors were made for these rows and columns.
                unsafe { self.blend_row::<S, EXTRAS>(s, tables, row, columns, &paint) };
            }
        }
        count
    }

    /// Draws a splat on its box, with `α = min(0.99, o·2^−((p·(x − m(y)))² + (q·dy)²))`. Gives the number of blocks.
    #[inline(always)]
    fn general<S: Simd, const EXTRAS: bool>(
        &mut self,
        s: S,
        splat: &Splat,
        Box4 { columns, rows }: Box4,
        tables: &mut Tables,
    ) -> usize {
        let (from, to) = strips(s, splat, [tables.columns[0], tables.rows[0]], columns);
        let (p, opacity) = (s.splat(splat.p), s.splat(splat.opacity));
        let paint = Paint::new(s, splat);
        let (u, v) = (f64::from(splat.x[0]) + f64::from(splat.x[1]), f64::from(splat.y[0]) + f64::from(splat.y[1]));
        let span = rows[0] * BLOCK..rows[1] * BLOCK;
        let lines =
            tables.lines[span.clone()].chunks_exact(BLOCK).zip(tables.down[span.clone()].chunks_exact_mut(BLOCK));
        let middles =
            tables.middle[span.clone()].chunks_exact_mut(BLOCK).zip(tables.rest[span].chunks_exact_mut(BLOCK));
        for ((lines, down), (middle, rest)) in lines.zip(middles) {
            // One array after the other, so that each step is a vector instruction.
            let (mut dy, mut m, mut t) = ([0.0; BLOCK], [0.0; BLOCK], [0.0; BLOCK]);
            for i in 0..BLOCK {
                dy[i] = lines[i] - v;
            }
            for i in 0..BLOCK {
                m[i] = u + splat.k * dy[i];
            }
            for i in 0..BLOCK {
                t[i] = splat.q * dy[i] as f32;
            }
            for i in 0..BLOCK {
                (middle[i], rest[i]) = split(m[i]);
                down[i] = t[i] * t[i];
            }
        }
        let mut count = 0;
        for row in rows[0]..rows[1] {
            // SAFETY: `row` is a row of the tile and the arrays have four values for each.
            let (along_y, whole, rest) = unsafe {
                (
                    s.spread_four(tables.down.as_ptr().add(row * BLOCK)),
                    s.spread_four(tables.middle.as_ptr().add(row * BLOCK)),
                    s.spread_four(tables.rest.as_ptr().add(row * BLOCK)),
                )
            };
            let (from, to) = (from[row] as usize, (to[row] + 1) as usize);
            count += to.saturating_sub(from);
            for column in from..to {
                // SAFETY: a block of the tile.
                unsafe {
                    if !self.is_finished(row * TILE[0] + column) {
                        let x = s.repeat_four(tables.columns.as_ptr().add(column * BLOCK));
                        let t = s.mul(p, s.sub(s.sub(x, whole), rest));
                        let alpha = s.mul(opacity, exp2_negative(s, s.mul_add(t, t, along_y)));
                        self.composite::<S, EXTRAS>(s, alpha, &paint, row * TILE[0] + column);
                    }
                }
            }
        }
        count
    }

    /// # Safety
    /// `at` is a block of the tile.
    #[inline(always)]
    unsafe fn is_finished(&self, at: usize) -> bool {
        // SAFETY: the caller's.
        unsafe { *self.done.add(at) == ALL }
    }

    /// Draws one splat on the blocks `columns` (first and end) of a row, separably.
    ///
    /// # Safety
    /// They are blocks of the tile.
    #[inline(always)]
    unsafe fn blend_row<S: Simd, const EXTRAS: bool>(
        &mut self,
        s: S,
        tables: &Tables,
        row: usize,
        columns: [usize; 2],
        paint: &Paint<S>,
    ) {
        // SAFETY: the caller's.
        let along_y = unsafe { s.spread_four(tables.down.as_ptr().add(row * BLOCK)) };
        for column in columns[0]..columns[1] {
            // SAFETY: the caller's.
            unsafe {
                let at = row * TILE[0] + column;
                if !self.is_finished(at) {
                    let alpha = s.mul(along_y, s.repeat_four(tables.across.as_ptr().add(column * BLOCK)));
                    self.composite::<S, EXTRAS>(s, alpha, paint, at);
                }
            }
        }
    }

    /// Draws one splat on one block.
    ///
    /// # Safety
    /// `at` is a block of the tile.
    #[inline(always)]
    unsafe fn composite<S: Simd, const EXTRAS: bool>(&mut self, s: S, alpha: S::F32, paint: &Paint<S>, at: usize) {
        debug_assert!(at < BLOCKS);
        // SAFETY: the caller's; nothing else refers to the block.
        let block = unsafe { &mut *self.blocks.add(at) };
        let alpha = s.min(alpha, s.splat(ALPHA_MAX));
        let hit = s.le(s.splat(ALPHA_MIN), alpha);
        let transmittance = s.load(&block.transmittance);
        let mut weight = s.mul(s.keep(hit, alpha), transmittance);
        let mut left = s.sub(transmittance, weight);
        // A finished pixel has no transmittance and is not less than itself.
        let below = s.lt(left, s.min(transmittance, s.splat(TRANSMITTANCE_MIN)));
        if s.any(below) {
            let mut weights = s.to_array(weight);
            // SAFETY: the caller's; nothing else refers to them.
            let (extra, done) = unsafe { (&mut *self.extras.add(at), &mut *self.done.add(at)) };
            self.open -= usize::from(finish(s.bits(below), block, extra, done, &mut weights));
            weight = s.from_array(weights);
            left = s.sub(s.load(&block.transmittance), weight);
        }
        s.store(left, &mut block.transmittance);
        for channel in 0..3 {
            let values = &mut block.rgb[channel];
            s.store(s.mul_add(weight, paint.rgb[channel], s.load(values)), values);
        }
        if EXTRAS {
            // SAFETY: the caller's; nothing else refers to it.
            let extra = unsafe { &mut *self.extras.add(at) };
            s.store(s.mul_add(weight, paint.depth, s.load(&extra.depth)), &mut extra.depth);
            let one = s.keep(s.lt(s.splat(0.0), weight), s.splat(1.0));
            s.store(s.add(s.load(&extra.count), one), &mut extra.count);
        }
    }
}

/// Finishes the pixels of `below`: keeps their transmittance apart and gives this splat no weight on them.
/// True when the block has no other pixels.
#[cold]
#[inline(never)]
fn finish(below: u16, block: &mut Block, extra: &mut Extra, done: &mut u16, weights: &mut [f32; LANES]) -> bool {
    for lane in (0..LANES).filter(|lane| below >> lane & 1 != 0) {
        extra.finished[lane] = block.transmittance[lane];
        block.transmittance[lane] = 0.0;
        weights[lane] = 0.0;
    }
    *done |= below;
    *done == ALL
}
