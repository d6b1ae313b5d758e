//! The image as a linear map of the colours: forward, adjoint, and the normal operator of least squares.
//!
//! With projection, order, α and transmittance fixed, an image is linear in the colours of its Gaussians:
//!
//! ```text
//! image = A·c + B + T·background      A[p, i] = α_ip·T_ip      T[p] = light left behind all Gaussians
//! ```
//!
//! B is 0 except for maps [`ColourMap::from_weight`]. There A omits a Gaussian on a block of 4×4 pixels where all its
//! weights are below the least one. B is the sum of the omitted Gaussians, in the colours with which the map was
//! prepared.
//!
//! The weights A are those of the blend, by the same code, rounded to 8 bits. Each Gaussian has a unit u on each block
//! of 4×4 pixels: the smallest power of two (at least 2⁻¹⁶) with its largest weight there below 256·u. A is `min(⌊α·T /
//! u + ½⌋, 255)·u` (the quotient and sum fused). Where α is below 1/255, and behind a finished pixel, a Gaussian has
//! weight 0. An image of the map is therefore within `½·Σ u·|c|` over a pixel's Gaussians of the rasteriser's (`u`
//! instead of `½·u` where a weight is 255 units). The weights of B are not rounded.
//!
//! # Order of operations
//!
//! Everything is binary32. A pixel of `A·c` and one of B are summed front to back, one fused multiply-add per Gaussian;
//! `T·background` is added to the first (fused), then B. A sum over pixels (the adjoint) has three steps:
//!
//! 1. on each of the 16 lanes of a block of 4×4 pixels, over those blocks of a tile on which the Gaussian has a weight,
//!    row-major, a fused multiply-add each, from +0;
//! 2. the lanes, folded as [`Simd::sum`](crate::simd::Simd::sum) does;
//! 3. the tiles of [`TILE_PIXELS`](super::TILE_PIXELS), added in ascending order, row-major, from +0.
//!
//! # Values that are not finite
//!
//! A Gaussian with a NaN or an infinity in mean, scale, rotation or opacity is dropped: its weights are 0, and so are
//! its sums. A component of a colour or of the background that is not finite counts as +0. So does a residual that is
//! not finite, on its pixel and channel alone. Sums beyond the largest binary32 number are infinite or NaN.

#![expect(unsafe_code, reason = "tasks write sums of tiles into one array")]

mod passes;
mod prepare;
mod record;
mod solve;

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use rayon::prelude::*;
use tracing::debug_span;

use super::bin::Grid;
use super::blend::{BLOCKS, BlockSet, Lanes, Shape, Transmittance, Walk, corner};
use super::project::BLOCK;
use super::rasteriser::{Rasteriser, finite_background};
use super::sort::Entry;
use super::{Gaussians, Projection, Request};
use crate::level::Level;
use crate::parallel::{Disjoint, for_each_chunk};
use crate::simd::dispatch;
use passes::{Adjoint, Forward, Moments, Normal, Place, Residual, Slots};
use record::{Record, RecordTile};

pub use solve::{ColourFit, Effort, FitView, Solution};

/// Bytes of weights that a [`ColourMap`] keeps by default.
pub const WEIGHT_BYTES: usize = 256 << 20;
/// Gaussians whose sums are merged in one task.
const MERGED: usize = 4096;

/// The linear map from colours to pixels of one scene, seen by one camera.
///
/// [`ColourMap::prepare`] projects, bins, sorts and walks the lists once. Afterwards any number of colours or images
/// can be taken through the map and its transpose. Before the first call it maps no Gaussians onto no pixels.
///
/// All methods run on the current rayon pool. Their results are the same for every level and number of threads.
#[derive(Debug)]
pub struct ColourMap {
    level: Level,
    budget: usize,
    least: f32,
    rasteriser: Rasteriser,
    shape: Shape,
    /// Width, height.
    size: [usize; 2],
    grid: Grid,
    tiles: Vec<Tile>,
    /// Tiles with a block that is not left out, most hits first.
    order: Vec<u32>,
    /// Start of the splats of each tile's record in `slots`; one more than tiles.
    starts: Vec<usize>,
    /// Destination of the sums of each splat of each tile: Gaussian by Gaussian, tiles ascending.
    slots: Vec<u32>,
    /// Start of the sums of each Gaussian; one more than Gaussians.
    offsets: Vec<u32>,
    spare: Mutex<Spare>,
}

/// Memory in which maps are prepared one after another: projected Gaussians and the tiles' lists. A map that keeps all
/// its weights no longer needs them.
#[derive(Debug)]
pub struct Preparation(Rasteriser);

impl Preparation {
    /// Empty memory for maps on `level`.
    pub fn new(level: Level) -> Self {
        Self(Rasteriser::new(level))
    }
}

/// The record of a tile.
#[derive(Debug)]
struct Tile {
    record: Record,
    /// The blocks that are not left out.
    wanted: BlockSet,
    /// True if the record holds weights; otherwise they are recomputed where they are needed.
    kept: bool,
}

impl Default for Tile {
    fn default() -> Self {
        Self { record: Record::default(), wanted: BlockSet::ALL, kept: false }
    }
}

/// Buffers between calls.
#[derive(Debug, Default)]
struct Spare {
    threads: Vec<Thread>,
    partial: Vec<f32>,
}

/// Buffers of a thread.
#[derive(Debug, Default)]
struct Thread {
    light: Transmittance,
    record: Record,
    spare: Vec<Entry>,
    pixels: Vec<[Lanes; 3]>,
    single: Vec<[Lanes; 1]>,
}

impl Thread {
    fn clear(&mut self) {
        self.pixels.resize(BLOCKS, [Lanes::ZERO; 3]);
        self.single.resize(BLOCKS, [Lanes::ZERO; 1]);
    }
}

impl ColourMap {
    /// A map that runs on `level` and keeps [`WEIGHT_BYTES`] of weights.
    pub fn new(level: Level) -> Self {
        Self::with_budget(level, WEIGHT_BYTES)
    }

    /// A map that keeps about `bytes` of weights (18 for a Gaussian and a block of 4×4 pixels) between calls. The
    /// others are recomputed in every call, to the same bits.
    pub fn with_budget(level: Level, bytes: usize) -> Self {
        Self {
            level,
            budget: bytes,
            least: 0.0,
            rasteriser: Rasteriser::new(level),
            shape: Shape::GENERAL,
            size: [0; 2],
            grid: Grid::new(0, 0),
            tiles: Vec::new(),
            order: Vec::new(),
            starts: vec![0],
            slots: Vec::new(),
            offsets: vec![0],
            spare: Mutex::default(),
        }
    }

    /// Leaves out small weights: those of a Gaussian on a block of 4×4 pixels where all of them are below `weight`.
    /// Their sum in the colours with which the map is prepared is the constant B of its images.
    #[must_use]
    pub fn from_weight(self, weight: f32) -> Self {
        Self { least: weight, ..self }
    }

    /// Makes this the map of a scene onto an image of `[width, height]` pixels. Without a least weight `Gaussians::rgb`
    /// is ignored and may be empty.
    ///
    /// # Panics
    /// As [`super::render`], except for colours.
    pub fn prepare(&mut self, gaussians: &Gaussians<'_>, projection: &Projection, size: [usize; 2]) {
        self.prepare_blocks(gaussians, projection, size, |_| true);
    }

    /// [`ColourMap::prepare_blocks`] in memory shared with other maps, to the same bits. A map that cannot keep all its
    /// weights keeps the memory.
    ///
    /// # Panics
    /// As [`ColourMap::prepare`].
    pub fn prepare_in(
        &mut self,
        memory: &mut Preparation,
        gaussians: &Gaussians<'_>,
        projection: &Projection,
        size: [usize; 2],
        wanted: impl Fn([usize; 2]) -> bool,
    ) {
        std::mem::swap(&mut self.rasteriser, &mut memory.0);
        self.prepare_blocks(gaussians, projection, size, wanted);
        if self.order.iter().all(|&tile| self.tiles[tile as usize].kept) {
            std::mem::swap(&mut self.rasteriser, &mut memory.0);
        }
    }

    /// [`ColourMap::prepare`] for the pixels of the blocks of 4×4 pixels that are `wanted`, by column and row. Pixels
    /// of the others are no part of the map: [`ColourMap::forward`] leaves them unchanged, and their residuals are
    /// ignored.
    ///
    /// # Panics
    /// As [`ColourMap::prepare`].
    pub fn prepare_blocks(
        &mut self,
        gaussians: &Gaussians<'_>,
        projection: &Projection,
        size: [usize; 2],
        wanted: impl Fn([usize; 2]) -> bool,
    ) {
        let _span = debug_span!("colour_map", gaussians = gaussians.len(), width = size[0], height = size[1]).entered();
        // Means are passed as colours: where they are not finite the Gaussian is dropped in any case.
        let rgb = if self.least > 0.0 { gaussians.rgb } else { gaussians.mean };
        let gaussians = Gaussians { rgb, ..*gaussians };
        self.rasteriser.forget();
        let request = Request::colour(size[0], size[1], [0.0; 3]);
        let (now, grid) = self.rasteriser.begin(&gaussians, projection, &request);
        self.rasteriser.coarse(&gaussians, &now.view, grid, false);
        (self.shape, self.size, self.grid) = (Shape::of(&now.view), size, grid);
        self.order.clear();
        self.tiles.resize_with(grid.len(), Tile::default);
        for (index, tile) in self.tiles.iter_mut().enumerate() {
            tile.wanted = BlockSet::of([index % grid.columns, index / grid.columns], size, &wanted);
            if !tile.wanted.is_empty() {
                self.order.push(index as u32);
            }
        }
        self.record();
        self.index(gaussians.len());
    }

    /// Gaussians of the scene.
    pub fn gaussians(&self) -> usize {
        self.offsets.len() - 1
    }

    /// Width and height of the image.
    pub fn size(&self) -> [usize; 2] {
        self.size
    }

    /// Tiles across and down, of [`super::TILE_PIXELS`] each.
    pub fn tiles(&self) -> [usize; 2] {
        [self.grid.columns, self.grid.rows]
    }

    /// Pixels of a tile that are not left out.
    fn area(&self, index: usize) -> usize {
        let tile = [index % self.grid.columns, index / self.grid.columns];
        let of_block = |block: usize| {
            let start = corner(tile, block);
            (0..2).map(|axis| BLOCK.min(self.size[axis].saturating_sub(start[axis]))).product::<usize>()
        };
        (0..BLOCKS).filter(|block| self.tiles[index].wanted.has(*block)).map(of_block).sum()
    }

    /// Bytes of weights that are kept.
    pub fn weight_bytes(&self) -> usize {
        self.tiles.iter().filter(|tile| tile.kept).map(|tile| tile.record.bytes()).sum()
    }

    /// Calls `work` with every tile's record, index, place and slots.
    fn each_tile(&self, threads: &mut Vec<Thread>, work: impl Fn(usize, &Record, Place, &[u32], Pixels<'_>) + Sync) {
        threads.resize_with(rayon::current_num_threads(), Thread::default);
        let next = AtomicUsize::new(0);
        threads.par_iter_mut().with_max_len(1).for_each(|thread| {
            while let Some(&tile) = self.order.get(next.fetch_add(1, Ordering::Relaxed)) {
                let index = tile as usize;
                self.tile(index, thread, |record, place, slots, pixels| work(index, record, place, slots, pixels));
            }
        });
    }

    /// Calls `work` with a tile's record, place and slots, and buffers of a thread.
    #[inline(always)]
    fn tile<R>(
        &self,
        index: usize,
        thread: &mut Thread,
        work: impl FnOnce(&Record, Place, &[u32], Pixels<'_>) -> R,
    ) -> R {
        thread.clear();
        let tile = [index % self.grid.columns, index / self.grid.columns];
        let wanted = self.tiles[index].wanted;
        let place = Place { tile, size: self.size, wanted };
        let Thread { light, record: spare, pixels, single, .. } = thread;
        let record = if self.tiles[index].kept {
            &self.tiles[index].record
        } else {
            let Rasteriser { splats, entries, starts, .. } = &self.rasteriser;
            let list = &entries[starts[index] as usize..starts[index + 1] as usize];
            let walk = Walk { splats, list, shape: self.shape, tile, size: self.size };
            dispatch(self.level, RecordTile { walk, wanted, light, record: &mut *spare, least: self.least });
            &*spare
        };
        let slots = &self.slots[self.starts[index]..self.starts[index + 1]];
        let (three, one) = (pixels.first_chunk_mut(), single.first_chunk_mut());
        let (three, one) = three.zip(one).expect("a value for each block");
        work(record, place, slots, Pixels { three, one })
    }

    /// Runs `work` with buffers of an earlier call.
    fn with_spare<R>(&self, work: impl FnOnce(&mut Spare) -> R) -> R {
        let lock = || self.spare.lock().unwrap_or_else(PoisonError::into_inner);
        let mut spare = std::mem::take(&mut *lock());
        let result = work(&mut spare);
        *lock() = spare;
        result
    }

    /// Adds up, for every Gaussian, the `C` sums that `work` has stored for each of its tiles, and passes them to
    /// `put`.
    fn sum_tiles<const C: usize, T: Send>(
        &self,
        sums: &mut [T],
        work: impl Fn(usize, &Record, Place, Slots<'_>, Pixels<'_>) + Sync,
        put: impl Fn([f32; C]) -> T + Sync + Send,
    ) {
        assert_eq!(sums.len(), self.gaussians(), "one sum per Gaussian");
        self.with_spare(|Spare { threads, partial }| {
            partial.resize(partial.len().max(self.slots.len() * C), 0.0);
            let partial_of = Disjoint::new(partial);
            self.each_tile(threads, |tile, record, place, slots, pixels| {
                work(tile, record, place, Slots { slots, partial: &partial_of }, pixels);
            });
            let partial: &[[f32; C]] = partial[..self.slots.len() * C].as_chunks().0;
            for_each_chunk(sums, MERGED, |index, sums| {
                let first = index * MERGED;
                for (i, sum) in sums.iter_mut().enumerate() {
                    let range = self.offsets[first + i] as usize..self.offsets[first + i + 1] as usize;
                    let mut total = [0.0; C];
                    for part in &partial[range] {
                        for c in 0..C {
                            total[c] += part[c];
                        }
                    }
                    *sum = put(total);
                }
            });
        });
    }

    fn assert_colours(&self, colours: &[[f32; 3]]) {
        assert_eq!(colours.len(), self.gaussians(), "one colour per Gaussian");
    }

    fn assert_image(&self, image: &[f32]) {
        let [width, height] = self.size;
        assert_eq!(image.len(), 3 * width * height, "three planes of {width}×{height} pixels");
    }

    /// `image = A·colours + B + T·background`, `[3, H, W]`. Where colours are finite it is [`super::render`]'s image of
    /// the Gaussians with these colours, apart from the rounding of the weights.
    ///
    /// # Panics
    /// When there is not one colour per Gaussian, or `image` is not of the map's size.
    pub fn forward(&self, colours: &[[f32; 3]], background: [f32; 3], image: &mut [f32]) {
        let _span = debug_span!("colour_map_forward", gaussians = colours.len()).entered();
        self.assert_colours(colours);
        self.assert_image(image);
        let background = finite_background(background);
        let image = Disjoint::new(image);
        self.with_spare(|spare| {
            self.each_tile(&mut spare.threads, |_, record, place, _, Pixels { three: pixels, .. }| {
                dispatch(self.level, Forward { record, place, colours, background, pixels, image: &image });
            });
        });
    }

    /// `sums = Aᵀ·residual` for a residual `[3, H, W]`: one sum per Gaussian and channel.
    ///
    /// # Panics
    /// When there is not one sum per Gaussian, or `residual` is not of the map's size.
    pub fn adjoint(&self, residual: &[f32], sums: &mut [[f32; 3]]) {
        let _span = debug_span!("colour_map_adjoint", gaussians = sums.len()).entered();
        self.assert_image(residual);
        self.sum_tiles(
            sums,
            |_, record, place, to, Pixels { three: pixels, .. }| {
                dispatch(self.level, Adjoint { record, place, residual, pixels, to });
            },
            |sum: [f32; 3]| sum,
        );
    }

    /// `sums = AᵀA·colours`, tile by tile without an image: to the bit [`ColourMap::adjoint`] of
    /// [`ColourMap::forward`] on black.
    ///
    /// # Panics
    /// When there is not one colour or not one sum per Gaussian.
    pub fn normal(&self, colours: &[[f32; 3]], sums: &mut [[f32; 3]]) {
        let _span = debug_span!("colour_map_normal", gaussians = colours.len()).entered();
        self.assert_colours(colours);
        self.sum_tiles(
            sums,
            |_, record, _, to, Pixels { three: pixels, .. }| {
                dispatch(self.level, Normal { record, colours, pixels, to });
            },
            |sum: [f32; 3]| sum,
        );
    }

    /// `sums = AᵀA·1`: the sum of each row of `AᵀA`, one per Gaussian. No weight is negative, so these bound the
    /// eigenvalues of `AᵀA` and are the diagonal of a preconditioner.
    ///
    /// # Panics
    /// When there is not one sum per Gaussian.
    pub fn row_sums(&self, sums: &mut [f32]) {
        let _span = debug_span!("colour_map_row_sums", gaussians = sums.len()).entered();
        let ones = vec![[1.0]; self.gaussians()];
        self.sum_tiles(
            sums,
            |_, record, _, to, Pixels { one: pixels, .. }| {
                dispatch(self.level, Normal { record, colours: &*ones, pixels, to });
            },
            |[sum]: [f32; 1]| sum,
        );
    }

    /// `[Σ_p A[p, i], Σ_p A[p, i]²]` for each Gaussian i: the sum of its weights (`Aᵀ·1`), and the diagonal of `AᵀA`.
    ///
    /// # Panics
    /// When there is not one pair per Gaussian.
    pub fn column_sums(&self, sums: &mut [[f32; 2]]) {
        let _span = debug_span!("colour_map_column_sums", gaussians = sums.len()).entered();
        self.sum_tiles(sums, |_, record, _, to, _| dispatch(self.level, Moments { record, to }), |sums: [f32; 2]| sums);
    }

    /// `sums = Aᵀ(target − A·colours − T·background)` for a target `[3, H, W]`; returns the sum of the squared
    /// residuals in binary64. See [`ColourMap::residual_adjoint_tiles`].
    ///
    /// # Panics
    /// When there is not one colour or not one sum per Gaussian, or `target` is not of the map's size.
    pub fn residual_adjoint(
        &self,
        colours: &[[f32; 3]],
        background: [f32; 3],
        target: &[f32],
        sums: &mut [[f32; 3]],
    ) -> f64 {
        self.residual_adjoint_tiles(colours, background, target, sums, &mut vec![0.0; self.grid.len()])
    }

    /// [`ColourMap::residual_adjoint`] that also writes the sum of squares of each tile to `squares`, 0 for tiles that
    /// are left out.
    ///
    /// The squares are summed in binary64. Each lane adds them over the blocks of the tile, row-major, and the channels
    /// of each block. The lanes are folded `i` with `i+8`, `i+4`, `i+2`, `i+1`; the tiles are added in ascending order.
    ///
    /// # Panics
    /// As [`ColourMap::residual_adjoint`], and when there is not one of `squares` per tile.
    pub fn residual_adjoint_tiles(
        &self,
        colours: &[[f32; 3]],
        background: [f32; 3],
        target: &[f32],
        sums: &mut [[f32; 3]],
        squares: &mut [f64],
    ) -> f64 {
        let _span = debug_span!("colour_map_residual_adjoint", gaussians = colours.len()).entered();
        self.assert_colours(colours);
        self.assert_image(target);
        assert_eq!(squares.len(), self.grid.len(), "one sum of squares per tile");
        squares.fill(0.0);
        let background = finite_background(background);
        let squares_of = Disjoint::new(squares);
        self.sum_tiles(
            sums,
            |tile, record, place, to, Pixels { three: pixels, .. }| {
                let sum = dispatch(self.level, Residual { record, place, colours, background, target, pixels, to });
                // SAFETY: a tile is taken once.
                unsafe { squares_of.part(tile..tile + 1)[0] = sum };
            },
            |sum: [f32; 3]| sum,
        );
        squares.iter().fold(0.0, |total, sum| total + sum)
    }
}

/// Pixels of a tile, of three channels and of one.
struct Pixels<'a> {
    three: &'a mut [[Lanes; 3]; BLOCKS],
    one: &'a mut [[Lanes; 1]; BLOCKS],
}
