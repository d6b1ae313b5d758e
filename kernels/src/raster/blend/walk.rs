//! The weights `α·T` of a tile's splats, front to back, and their receiver.

use super::super::bin::{TILE, around};
use super::super::falloff::Cut;
use super::super::project::{BLOCK, Form, Splat, Viewport, split};
use super::super::sort::Entry;
use super::sphere::Sphere;
use super::tables::{Tables, exp2_negative, factors, fours, nearest, strips};
use crate::simd::{LANES, Simd, prefetch_near};

/// Blocks of a tile.
pub(in super::super) const BLOCKS: usize = TILE[0] * TILE[1];
const _: () = assert!(BLOCKS.is_power_of_two());
/// Records that are fetched together: their cache misses overlap.
const TOGETHER: usize = 32;
/// A box of at most this many blocks is drawn whole: testing which of them the footprint misses would cost more.
const WHOLE_BOX: usize = 12;
/// All pixels of a block.
const ALL: u16 = u16::MAX;

/// Some of a tile's blocks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in super::super) struct BlockSet(u128);
const _: () = assert!(BLOCKS <= 128);

impl BlockSet {
    pub(in super::super) const ALL: Self = Self(u128::MAX);

    /// Those of the tile of this column and row for which `wanted` returns true; it is called with the column and the
    /// row of each block that has a pixel in an image of `[width, height]`.
    pub(in super::super) fn of(
        tile: [usize; 2],
        [width, height]: [usize; 2],
        wanted: impl Fn([usize; 2]) -> bool,
    ) -> Self {
        let in_set = |block: &usize| {
            let [x, y] = corner(tile, *block);
            x < width && y < height && wanted([x / BLOCK, y / BLOCK])
        };
        Self((0..BLOCKS).filter(in_set).fold(0, |set, block| set | 1 << block))
    }

    pub(in super::super) fn is_empty(self) -> bool {
        self.0 == 0
    }

    #[inline(always)]
    pub(in super::super) fn has(self, block: usize) -> bool {
        self.0 >> block & 1 == 1
    }
}

/// A value for each of 4×4 pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(64))]
pub(in super::super) struct Lanes(pub [f32; LANES]);

impl Lanes {
    pub(in super::super) const ZERO: Self = Self([0.0; LANES]);
}

/// A block of a tile, counted row by row. Masking its index makes the compiler drop the bounds check in arrays of
/// [`BLOCKS`] values.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct Block(usize);

impl Block {
    #[inline(always)]
    fn new(row: usize, column: usize) -> Self {
        debug_assert!(row < TILE[1] && column < TILE[0]);
        Self(row * TILE[0] + column)
    }

    #[inline(always)]
    pub(in super::super) fn index(self) -> usize {
        self.0 & (BLOCKS - 1)
    }
}

/// Transmittance of a tile's pixels.
#[derive(Debug, Default)]
pub(in super::super) struct Transmittance {
    /// Transmittance so far; zero where the pixel is finished.
    left: Vec<Lanes>,
    /// Transmittance with which a pixel was finished.
    finished: Vec<Lanes>,
    /// Finished pixels of each block.
    done: Vec<u16>,
}

impl Transmittance {
    /// Sets 1 inside an image of `width`×`height` pixels. Pixels outside, and those of blocks that are not `wanted`,
    /// are finished from the start.
    #[inline(always)]
    fn clear(&mut self, [column, row]: [usize; 2], [width, height]: [usize; 2], wanted: BlockSet) {
        self.left.clear();
        self.left.resize(BLOCKS, Lanes([1.0; LANES]));
        self.finished.clear();
        self.finished.resize(BLOCKS, Lanes::ZERO);
        self.done.clear();
        self.done.resize(BLOCKS, 0);
        for block in 0..BLOCKS {
            if !wanted.has(block) {
                (self.left[block], self.done[block]) = (Lanes::ZERO, ALL);
                continue;
            }
            let [x, y] = corner([column, row], block);
            if x + BLOCK <= width && y + BLOCK <= height {
                continue;
            }
            for lane in 0..LANES {
                if x + lane % BLOCK >= width || y + lane / BLOCK >= height {
                    self.left[block].0[lane] = 0.0;
                    self.done[block] |= 1 << lane;
                }
            }
        }
    }

    /// Transmittance behind all splats of the list; zero outside the image.
    #[inline(always)]
    pub(in super::super) fn last<S: Simd>(&self, s: S, block: usize) -> S::F32 {
        let done = s.mask_from_bits(self.done[block]);
        s.select(done, s.load(&self.finished[block].0), s.load(&self.left[block].0))
    }
}

/// First pixel of a tile's block.
#[inline(always)]
pub(in super::super) fn corner([column, row]: [usize; 2], block: usize) -> [usize; 2] {
    [(column * TILE[0] + block % TILE[0]) * BLOCK, (row * TILE[1] + block / TILE[0]) * BLOCK]
}

/// A splat on the 16 pixels of a block.
pub(in super::super) struct Hit<S: Simd> {
    /// `α·T`, zero where the splat is not drawn.
    pub weight: S::F32,
    /// α before it is lowered to the largest.
    pub alpha: S::F32,
    /// Exponent's roots `t = p·(x − m(y))` and `s = q·(y − v)`; zero unless the sink has [`Sink::GEOMETRY`].
    pub across: S::F32,
    pub down: S::F32,
}

/// Receiver of the weights of splats on the blocks of a tile, splat by splat.
pub(in super::super) trait Sink<S: Simd> {
    /// True if hits of general footprints need [`Hit::across`] and [`Hit::down`].
    const GEOMETRY: bool = false;
    /// Values of a splat, kept while its blocks are visited.
    type Paint;
    /// Called with the splat whose blocks are visited next; `entry` is its entry in the list.
    fn begin(&mut self, s: S, splat: &Splat, entry: &Entry) -> Self::Paint;
    /// [`Sink::add`], with all of the hit.
    #[inline(always)]
    fn hit(&mut self, s: S, at: Block, hit: &Hit<S>, paint: &Self::Paint) {
        self.add(s, at, hit.weight, paint);
    }
    /// Weights of the splat on the block `at`: `α·T`, zero where it is not drawn. A block is passed at most once
    /// between [`Sink::begin`] and [`Sink::end`], which alternate.
    fn add(&mut self, s: S, at: Block, weight: S::F32, paint: &Self::Paint);
    /// Called after the splat's last block; `entry` is its entry in the list.
    fn end(&mut self, entry: &Entry) {
        let _ = entry;
    }
}

/// How α follows from a footprint's record.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct Shape {
    pub form: Form,
    /// Ends of footprints.
    pub cut: Cut,
}

impl Shape {
    /// The shape of general Gaussians.
    pub(in super::super) const GENERAL: Shape = Shape { form: Form::General, cut: Cut::GAUSSIAN };

    pub(in super::super) fn of(view: &Viewport) -> Self {
        Self { form: view.form, cut: view.cut }
    }
}

/// A tile's list and its position.
#[derive(Clone, Copy)]
pub(in super::super) struct Walk<'a> {
    pub splats: &'a [Splat],
    /// In drawing order.
    pub list: &'a [Entry],
    pub shape: Shape,
    /// Column and row of the tile in the grid.
    pub tile: [usize; 2],
    /// Width and height of the image.
    pub size: [usize; 2],
}

/// Work of a walk.
#[derive(Clone, Copy, Debug, Default)]
pub(in super::super) struct Walked {
    /// Blocks visited.
    pub blocks: u64,
    /// Entries that were skipped because the tile was finished.
    pub unseen: u64,
}

/// The blocks of a footprint's box that are in a tile, first and end, counted from the tile's first.
///
/// [`BlockBox::new`] keeps `first ≤ end ≤ TILE` on both axes for any footprint record and tile.
#[derive(Clone, Copy)]
struct BlockBox {
    columns: [usize; 2],
    rows: [usize; 2],
}

impl BlockBox {
    /// The blocks of `splat` in the tile of this column and row.
    #[inline(always)]
    fn new(splat: &Splat, tile: [usize; 2]) -> Self {
        let inside = |[first, last]: [u16; 2], start: usize, size: usize| {
            let end = (usize::from(last) + 1).saturating_sub(start).min(size);
            [usize::from(first).saturating_sub(start).min(end), end]
        };
        Self {
            columns: inside(splat.columns, tile[0] * TILE[0], TILE[0]),
            rows: inside(splat.rows, tile[1] * TILE[1], TILE[1]),
        }
    }
}

impl BlockBox {
    /// The blocks of `splat` in the tile of this column and row, in an image whose left and right edges meet, with this
    /// number of blocks across.
    #[inline(always)]
    fn around(splat: &Splat, tile: [usize; 2], blocks: usize) -> Self {
        let Self { columns: _, rows } = Self::new(splat, tile);
        let start = tile[0] * TILE[0];
        let inside = |[first, last]: [usize; 2]| {
            let end = (last + 1).saturating_sub(start).min(TILE[0]);
            [first.saturating_sub(start).min(end), end]
        };
        let columns = match around(splat.columns, blocks).map(inside) {
            [own, beyond] if beyond[0] >= beyond[1] => own,
            [own, beyond] if own[0] >= own[1] => beyond,
            [own, beyond] => [own[0].min(beyond[0]), own[1].max(beyond[1])],
        };
        Self { columns, rows }
    }
}

impl Walk<'_> {
    /// Passes the weights of the list to `sink`, front to back, until all pixels are finished.
    #[inline(always)]
    pub(in super::super) fn run<S: Simd, K: Sink<S>>(&self, s: S, light: &mut Transmittance, sink: &mut K) -> Walked {
        self.run_on(s, light, BlockSet::ALL, sink)
    }

    /// [`Walk::run`] on the blocks that are `wanted`.
    #[inline(always)]
    pub(in super::super) fn run_on<S: Simd, K: Sink<S>>(
        &self,
        s: S,
        light: &mut Transmittance,
        wanted: BlockSet,
        sink: &mut K,
    ) -> Walked {
        light.clear(self.tile, self.size, wanted);
        match self.shape.form {
            Form::Separable => self.walk::<S, K, true>(s, light, sink),
            Form::General => self.walk::<S, K, false>(s, light, sink),
            Form::Spherical => self.walk_around(s, light, sink),
        }
    }

    /// Copies the records of the entries from `at` on; returns their number.
    #[inline(always)]
    fn fetch(&self, at: usize, near: &mut [Splat; TOGETHER]) -> usize {
        let entries = &self.list[at..];
        for (near, entry) in near.iter_mut().zip(entries) {
            *near = self.splats[entry.index as usize];
        }
        entries.len().min(TOGETHER)
    }

    /// [`Self::walk`] on the sphere.
    #[inline(always)]
    fn walk_around<S: Simd, K: Sink<S>>(&self, s: S, light: &mut Transmittance, sink: &mut K) -> Walked {
        let mut canvas = Canvas::new(light, self.shape.cut);
        let mut sphere = Sphere::new(self.tile, self.size);
        let (mut at, mut blocks) = (0, 0);
        while at < self.list.len() && canvas.open > 0 {
            let splat = &self.splats[self.list[at].index as usize];
            let bounds = BlockBox::around(splat, self.tile, self.size[0].div_ceil(BLOCK));
            let entry = &self.list[at];
            blocks += canvas.spherical(s, splat, entry, bounds, &mut sphere, sink);
            sink.end(entry);
            at += 1;
        }
        Walked { blocks: blocks as u64, unseen: (self.list.len() - at) as u64 }
    }

    /// As many records at a time as are fetched together.
    #[inline(always)]
    fn walk<S: Simd, K: Sink<S>, const SEPARABLE: bool>(
        &self,
        s: S,
        light: &mut Transmittance,
        sink: &mut K,
    ) -> Walked {
        let mut canvas = Canvas::new(light, self.shape.cut);
        let mut tables = Tables::new(self.tile[0], self.tile[1]);
        let mut near = [Splat::HIDDEN; TOGETHER];
        let (mut at, mut blocks) = (0, 0);
        while at < self.list.len() && canvas.open > 0 {
            let count = self.fetch(at, &mut near);
            for (i, splat) in near[..count].iter().enumerate() {
                if let Some(later) = self.list.get(at + TOGETHER + i) {
                    prefetch_near(self.splats.as_ptr().wrapping_add(later.index as usize));
                }
                let bounds = BlockBox::new(splat, self.tile);
                let entry = &self.list[at + i];
                blocks += if SEPARABLE {
                    canvas.separable(s, splat, entry, bounds, &mut tables, sink)
                } else {
                    canvas.general(s, splat, entry, bounds, &mut tables, sink)
                };
                sink.end(entry);
            }
            at += count;
        }
        Walked { blocks: blocks as u64, unseen: (self.list.len() - at) as u64 }
    }
}

/// The blocks of the tile that is walked: [`Transmittance`], as arrays.
struct Canvas<'a> {
    left: &'a mut [Lanes; BLOCKS],
    finished: &'a mut [Lanes; BLOCKS],
    done: &'a mut [u16; BLOCKS],
    /// Blocks with a pixel that is not finished.
    open: usize,
    /// Least α that is drawn, and the largest.
    least: f32,
    most: f32,
    /// Transmittance below which a pixel is finished.
    end: f32,
    /// Offset added to 2^−e before the multiplication by the opacity.
    dip: f32,
}

impl<'a> Canvas<'a> {
    /// The canvas of a tile for which `light` was cleared.
    #[inline(always)]
    fn new(light: &'a mut Transmittance, cut: Cut) -> Self {
        let open = light.done.iter().filter(|&&done| done != ALL).count();
        let Transmittance { left, finished, done } = light;
        let arrays =
            (left.as_mut_slice().try_into(), finished.as_mut_slice().try_into(), done.as_mut_slice().try_into());
        let (Ok(left), Ok(finished), Ok(done)) = arrays else { unreachable!("a value for each block of a tile") };
        Self { left, finished, done, open, least: cut.least, most: cut.most, end: cut.end, dip: cut.dip() }
    }

    /// Weights of a splat on its box, with `α = min(0.99, (o·2^−(q·dy)²)·2^−(p·dx)² − o·f)`, fused. Returns the number
    /// of blocks.
    #[inline(always)]
    fn separable<S: Simd, K: Sink<S>>(
        &mut self,
        s: S,
        splat: &Splat,
        entry: &Entry,
        BlockBox { columns, rows }: BlockBox,
        tables: &mut Tables,
        sink: &mut K,
    ) -> usize {
        let paint = sink.begin(s, splat, entry);
        let offset = s.splat(splat.opacity * self.dip);
        factors(s, splat.x, splat.p, 1.0, columns, &tables.columns, &mut tables.across);
        factors(s, splat.y, splat.q, splat.opacity, rows, &tables.rows, &mut tables.down);
        let count = (columns[1] - columns[0]) * (rows[1] - rows[0]);
        if count <= WHOLE_BOX {
            for row in rows[0]..rows[1] {
                self.walk_row(s, tables, offset, row, columns, sink, &paint);
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
                self.walk_row(s, tables, offset, row, columns, sink, &paint);
            }
        }
        count
    }

    /// Weights of a splat on its box, with `α = min(0.99, o·2^−((p·(x − m(y)))² + (q·dy)²) − o·f)`, fused. Returns the
    /// number of blocks.
    #[inline(always)]
    fn general<S: Simd, K: Sink<S>>(
        &mut self,
        s: S,
        splat: &Splat,
        entry: &Entry,
        BlockBox { columns, rows }: BlockBox,
        tables: &mut Tables,
        sink: &mut K,
    ) -> usize {
        let (from, to) = strips(s, splat, [tables.columns[0], tables.rows[0]], columns);
        let (p, opacity) = (s.splat(splat.p), s.splat(splat.opacity));
        let offset = s.splat(splat.opacity * self.dip);
        let paint = sink.begin(s, splat, entry);
        let (u, v) = (f64::from(splat.x[0]) + f64::from(splat.x[1]), f64::from(splat.y[0]) + f64::from(splat.y[1]));
        let span = rows[0] * BLOCK..rows[1] * BLOCK;
        let lines =
            tables.lines[span.clone()].chunks_exact(BLOCK).zip(tables.down[span.clone()].chunks_exact_mut(BLOCK));
        let middles = tables.middle[span.clone()]
            .chunks_exact_mut(BLOCK)
            .zip(tables.rest[span.clone()].chunks_exact_mut(BLOCK))
            .zip(tables.distance[span].chunks_exact_mut(BLOCK));
        for ((lines, down), ((middle, rest), distance)) in lines.zip(middles) {
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
            if K::GEOMETRY {
                distance.copy_from_slice(&t);
            }
        }
        let mut count = 0;
        for row in rows[0]..rows[1] {
            let along_y = s.spread_four(&fours(&tables.down)[row]);
            let whole = s.spread_four(&fours(&tables.middle)[row]);
            let rest = s.spread_four(&fours(&tables.rest)[row]);
            let distance = if K::GEOMETRY { s.spread_four(&fours(&tables.distance)[row]) } else { s.splat(0.0) };
            let (from, to) = (from[row] as usize, (to[row] + 1) as usize);
            count += to.saturating_sub(from);
            if from >= to {
                continue;
            }
            for (column, x) in (from..).zip(&fours(&tables.columns)[from..to]) {
                let at = Block::new(row, column);
                if !self.is_finished(at) {
                    let t = s.mul(p, s.sub(s.sub(s.repeat_four(x), whole), rest));
                    let alpha = s.mul_add(opacity, exp2_negative(s, s.mul_add(t, t, along_y)), offset);
                    self.composite(s, alpha, [t, distance], at, sink, &paint);
                }
            }
        }
        count
    }

    /// Weights of a splat on its box, with `α = min(0.99, o·2^−e − o·f)`, fused, where [`Sphere`] has the exponent e.
    /// Returns the number of blocks.
    #[inline(always)]
    fn spherical<S: Simd, K: Sink<S>>(
        &mut self,
        s: S,
        splat: &Splat,
        entry: &Entry,
        BlockBox { columns, rows }: BlockBox,
        sphere: &mut Sphere,
        sink: &mut K,
    ) -> usize {
        let paint = sink.begin(s, splat, entry);
        let (opacity, offset) = (s.splat(splat.opacity), s.splat(splat.opacity * self.dip));
        sphere.aim(s, splat, columns, rows);
        for row in rows[0]..rows[1] {
            let line = sphere.line(s, row);
            for column in columns[0]..columns[1] {
                let at = Block::new(row, column);
                if !self.is_finished(at) {
                    let (exponent, ahead) = sphere.exponent(s, &line, column);
                    let alpha = s.mul_add(opacity, exp2_negative(s, exponent), offset);
                    self.composite(s, s.keep(ahead, alpha), [s.splat(0.0); 2], at, sink, &paint);
                }
            }
        }
        (columns[1] - columns[0]) * (rows[1] - rows[0])
    }

    #[inline(always)]
    fn is_finished(&self, at: Block) -> bool {
        self.done[at.index()] == ALL
    }

    /// Weights of one splat on the blocks `columns` (first and end) of a row, separably. No row is visited twice
    /// between [`Sink::begin`] and [`Sink::end`].
    #[inline(always)]
    fn walk_row<S: Simd, K: Sink<S>>(
        &mut self,
        s: S,
        tables: &Tables,
        offset: S::F32,
        row: usize,
        columns: [usize; 2],
        sink: &mut K,
        paint: &K::Paint,
    ) {
        let along_y = s.spread_four(&fours(&tables.down)[row]);
        for (column, across) in (columns[0]..).zip(&fours(&tables.across)[columns[0]..columns[1]]) {
            let at = Block::new(row, column);
            if !self.is_finished(at) {
                self.composite(
                    s,
                    s.mul_add(along_y, s.repeat_four(across), offset),
                    [s.splat(0.0); 2],
                    at,
                    sink,
                    paint,
                );
            }
        }
    }

    /// Weights of one splat on one block, and the transmittance after it.
    #[inline(always)]
    fn composite<S: Simd, K: Sink<S>>(
        &mut self,
        s: S,
        alpha: S::F32,
        [across, down]: [S::F32; 2],
        at: Block,
        sink: &mut K,
        paint: &K::Paint,
    ) {
        let light = &mut self.left[at.index()].0;
        let held = s.min(alpha, s.splat(self.most));
        let drawn = s.le(s.splat(self.least), held);
        let transmittance = s.load(light);
        let mut weight = s.mul(s.keep(drawn, held), transmittance);
        let mut left = s.sub(transmittance, weight);
        // A finished pixel has no transmittance and is not less than itself.
        let below = s.lt(left, s.min(transmittance, s.splat(self.end)));
        if s.any(below) {
            let mut weights = s.to_array(weight);
            let (finished, done) = (&mut self.finished[at.index()].0, &mut self.done[at.index()]);
            self.open -= usize::from(finish(s.bits(below), light, finished, done, &mut weights));
            weight = s.from_array(weights);
            left = s.sub(s.load(light), weight);
        }
        s.store(left, light);
        sink.hit(s, at, &Hit { weight, alpha, across, down }, paint);
    }
}

/// Finishes the pixels of `below`: stores their transmittance in `finished` and sets this splat's weight on them to 0.
/// Returns true when all pixels of the block are finished.
#[cold]
#[inline(never)]
fn finish(
    below: u16,
    left: &mut [f32; LANES],
    finished: &mut [f32; LANES],
    done: &mut u16,
    weights: &mut [f32; LANES],
) -> bool {
    for lane in (0..LANES).filter(|lane| below >> lane & 1 != 0) {
        finished[lane] = left[lane];
        left[lane] = 0.0;
        weights[lane] = 0.0;
    }
    *done |= below;
    *done == ALL
}
