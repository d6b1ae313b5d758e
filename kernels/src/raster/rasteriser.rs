//! Drawing a scene repeatedly: buffers are kept, and only tiles whose splats changed are redrawn.

#![expect(unsafe_code, reason = "tasks fill, sort and draw lists of one array")]

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use rayon::prelude::*;
use tracing::debug_span;

use super::bin::Grid;
use super::blend::{DrawTile, Planes, Scratch, Shape, Tally, Walk};
use super::falloff::Cut;
use super::project::{Batch, Blur, Form, Splat, Viewport, bounds};
use super::sort::{Entry, by_depth};
use super::{Gaussians, Image, MAX_SIDE, Projection, Request};
use crate::level::Level;
use crate::parallel::Disjoint;
use crate::simd::{LANES, Operation, Simd, dispatch};
use crate::size::product;

/// Work done and avoided by the last [`Rasteriser::render`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Work {
    /// Gaussians passed in.
    pub gaussians: u64,
    /// Gaussians with a field that is not finite.
    pub dropped: u64,
    /// Gaussians that cannot change a pixel: neither binned nor sorted.
    pub culled: u64,
    /// Gaussians whose record changed since the last image.
    pub changed: u64,
    /// Tiles of the image.
    pub tiles: u64,
    /// Tiles drawn; the others kept their pixels.
    pub tiles_drawn: u64,
    /// Entries of the lists of the tiles drawn.
    pub entries: u64,
    /// Entries that were skipped because every pixel of their tile was finished.
    pub entries_unseen: u64,
    /// Blocks of 4×4 pixels on which a splat was blended.
    pub blocks: u64,
    /// Time of projection and comparison with the last image.
    pub project: Duration,
    /// Time of filling the lists.
    pub bin: Duration,
    /// Time of sorting the lists: its share of the threads' time in the last stage.
    pub sort: Duration,
    /// Time of blending: the rest of the last stage.
    pub blend: Duration,
}

/// A rasteriser that keeps its buffers and its last image.
#[derive(Debug)]
pub struct Rasteriser {
    level: Level,
    /// Scene and request of the last image; `None` before the first.
    last: Option<Last>,
    pub(super) splats: Vec<Splat>,
    /// Entries per chunk of Gaussians and tile; later the start of each chunk's entries of a tile.
    pub(super) counts: Vec<u32>,
    /// Start of each tile's list; one more than tiles.
    pub(super) starts: Vec<u32>,
    pub(super) entries: Vec<Entry>,
    /// Place of each Gaussian's footprint, when lists are made for a blend elsewhere.
    pub(super) places: Vec<u32>,
    pub(super) dirty: Vec<AtomicBool>,
    order: Vec<u32>,
    scratch: Vec<Scratch>,
    image: Image,
    pub(super) work: Work,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Last {
    pub(super) view: Viewport,
    request: Request,
    gaussians: usize,
}

/// Gaussians of a chunk when there are few; there are at most `MOST_CHUNKS` chunks.
const CHUNK: usize = 2048;
const _: () = assert!(CHUNK.is_multiple_of(LANES));
const MOST_CHUNKS: usize = 64;

/// Returns true if the rotation leaves everything in place.
fn is_identity(q: &[f32; 4]) -> bool {
    q[1] == 0.0 && q[2] == 0.0 && q[3] == 0.0
}

/// How α follows from the footprints of a scene.
fn form(gaussians: &Gaussians<'_>, projection: &Projection) -> Form {
    let upright = || gaussians.rotation.is_none_or(|r| r.par_chunks(1 << 14).all(|r| r.iter().all(is_identity)));
    match projection {
        Projection::Equirectangular => Form::Spherical,
        Projection::Orthographic { .. } if upright() => Form::Separable,
        _ => Form::General,
    }
}

/// Background, with +0 for components that are not finite or −0.
pub(super) fn finite_background(background: [f32; 3]) -> [f32; 3] {
    background.map(|c| if c.is_finite() { c + 0.0 } else { 0.0 })
}

impl Rasteriser {
    /// A rasteriser that runs on `level`.
    pub fn new(level: Level) -> Self {
        Self {
            level,
            last: None,
            splats: Vec::new(),
            counts: Vec::new(),
            starts: Vec::new(),
            entries: Vec::new(),
            places: Vec::new(),
            dirty: Vec::new(),
            order: Vec::new(),
            scratch: Vec::new(),
            image: Image::default(),
            work: Work::default(),
        }
    }

    /// Counts of the last image's work, done and left out.
    pub fn work(&self) -> Work {
        self.work
    }

    /// The last image.
    pub fn image(&self) -> &Image {
        &self.image
    }

    /// The last image, without the buffers.
    pub fn into_image(self) -> Image {
        self.image
    }

    /// Makes the next image be drawn as a whole.
    pub fn forget(&mut self) {
        self.last = None;
    }

    /// Draws `gaussians`; the same bits as [`super::render`].
    ///
    /// When projection and request are those of the last call and there are as many Gaussians, tiles that no changed
    /// Gaussian touches or touched keep their pixels.
    ///
    /// # Panics
    /// As [`super::render`].
    pub fn render(&mut self, gaussians: &Gaussians<'_>, projection: &Projection, request: &Request) -> &Image {
        let (now, grid) = self.begin(gaussians, projection, request);
        // Taken, so that after a panic the next image is drawn as a whole.
        let keep = self.last.take() == Some(now);
        let Last { view, request, .. } = now;
        self.coarse(gaussians, &view, grid, keep);
        let binned = Instant::now();
        self.prepare_image(&request, keep);
        let sorting = self.blend(&view, &request, grid);
        let rest = binned.elapsed();
        self.work.sort = rest.mul_f64(sorting);
        self.work.blend = rest - self.work.sort;
        self.image.dropped = self.work.dropped;
        self.last = Some(now);
        &self.image
    }

    /// Checks the request and resets the counts of work.
    pub(super) fn begin(
        &mut self,
        gaussians: &Gaussians<'_>,
        projection: &Projection,
        request: &Request,
    ) -> (Last, Grid) {
        gaussians.assert_equal_lengths();
        assert!(u32::try_from(gaussians.len()).is_ok(), "{} Gaussians, at most 2³² − 1", gaussians.len());
        assert!(
            request.width <= MAX_SIDE && request.height <= MAX_SIDE,
            "an image of {}×{}, at most {MAX_SIDE} a side",
            request.width,
            request.height
        );
        let mut request = *request;
        request.background = finite_background(request.background);
        let blur = Blur::new(projection, request.defocus);
        let view = Viewport {
            projection: *projection,
            width: request.width,
            height: request.height,
            form: form(gaussians, projection),
            antialias: request.antialias,
            bounds: bounds(projection, &request),
            cut: Cut::new(request.falloff, blur.is_some()),
            blur,
        };
        let now = Last { view, request, gaussians: gaussians.len() };
        let grid = Grid { around: view.form == Form::Spherical, ..Grid::new(request.width, request.height) };
        self.work = Work { gaussians: gaussians.len() as u64, tiles: grid.len() as u64, ..Work::default() };
        (now, grid)
    }

    /// Projects and bins.
    pub(super) fn coarse(&mut self, gaussians: &Gaussians<'_>, view: &Viewport, grid: Grid, keep: bool) {
        let start = Instant::now();
        self.project(gaussians, view, grid, keep);
        let projected = Instant::now();
        self.bin(grid, keep);
        self.work.project = projected - start;
        self.work.bin = projected.elapsed();
    }

    pub(super) fn chunk(&self) -> usize {
        self.splats.len().div_ceil(MOST_CHUNKS).max(CHUNK).next_multiple_of(LANES)
    }

    /// Fills `splats` and `dirty`, and `counts` where nothing is kept.
    fn project(&mut self, gaussians: &Gaussians<'_>, view: &Viewport, grid: Grid, keep: bool) {
        let _span = debug_span!("project", gaussians = gaussians.len(), keep).entered();
        self.splats.resize(gaussians.len(), Splat::HIDDEN);
        let chunk = self.chunk();
        let chunks = gaussians.len().div_ceil(chunk);
        self.dirty.resize_with(grid.len(), AtomicBool::default);
        for dirty in &mut self.dirty {
            *dirty.get_mut() = !keep;
        }
        self.counts.clear();
        self.counts.resize(chunks * grid.len(), 0);
        let (level, dirty) = (self.level, &self.dirty);
        let width = grid.len().max(1);
        let tallies: Vec<[u64; 3]> = self
            .splats
            .par_chunks_mut(chunk)
            .zip(self.counts.par_chunks_mut(width))
            .enumerate()
            .map(|(index, (splats, counts))| {
                let first = index * chunk;
                dispatch(level, ProjectChunk { gaussians, view, grid, first, splats, counts, dirty, keep })
            })
            .collect();
        for [dropped, culled, changed] in tallies {
            self.work.dropped += dropped;
            self.work.culled += culled;
            self.work.changed += changed;
        }
    }

    /// Fills `starts` and `entries` for the dirty tiles; other tiles get empty lists.
    pub(super) fn bin(&mut self, grid: Grid, keep: bool) {
        let (tiles, chunk) = (grid.len(), self.chunk());
        let _span = debug_span!("bin", tiles, keep).entered();
        let chunks = self.splats.len().div_ceil(chunk);
        let dirty: &[AtomicBool] = &self.dirty;
        if keep {
            self.splats.par_chunks(chunk).zip(self.counts.par_chunks_mut(tiles.max(1))).for_each(|(splats, counts)| {
                for splat in splats {
                    grid.for_each_tile(splat, |tile| {
                        counts[tile] += u32::from(dirty[tile].load(Ordering::Relaxed));
                    });
                }
            });
        }
        self.starts.clear();
        let mut start = 0_u32;
        for tile in 0..tiles {
            self.starts.push(start);
            for at in 0..chunks {
                let count = std::mem::replace(&mut self.counts[at * tiles + tile], start);
                start = start.checked_add(count).expect("fewer than 2³² entries");
            }
        }
        self.starts.push(start);
        self.work.entries = u64::from(start);
        if self.entries.len() < start as usize {
            self.entries.resize(start as usize, Entry::default());
        }
        let entries = Disjoint::new(&mut self.entries);
        self.splats.par_chunks(chunk).zip(self.counts.par_chunks_mut(tiles.max(1))).enumerate().for_each(
            |(at, (splats, counts))| {
                for (i, splat) in splats.iter().enumerate() {
                    let entry = Entry { key: splat.depth.to_bits(), index: (at * chunk + i) as u32 };
                    grid.for_each_tile(splat, |tile| {
                        if !keep || dirty[tile].load(Ordering::Relaxed) {
                            let slot = counts[tile] as usize;
                            // SAFETY: the places from `counts[tile]` on, as many as the chunk has footprints in the
                            // tile, are this chunk's alone. The same walk over the same splats and flags counted them,
                            // and nothing has written to those since.
                            unsafe { entries.part(slot..slot + 1)[0] = entry };
                            counts[tile] += 1;
                        }
                    });
                }
            },
        );
    }

    fn prepare_image(&mut self, request: &Request, keep: bool) {
        if keep {
            return;
        }
        fn plane<T: Copy + Default>(wanted: bool, old: Option<Vec<T>>, pixels: usize) -> Option<Vec<T>> {
            wanted.then(|| {
                let mut plane = old.unwrap_or_default();
                plane.resize(pixels, T::default());
                plane
            })
        }
        let pixels = product([request.width, request.height]);
        let image = &mut self.image;
        (image.width, image.height) = (request.width, request.height);
        image.rgb.resize(product([3, pixels]), 0.0);
        image.depth = plane(request.depth, image.depth.take(), pixels);
        image.alpha = plane(request.alpha, image.alpha.take(), pixels);
        image.final_t = plane(request.statistics, image.final_t.take(), pixels);
        image.blended = plane(request.statistics, image.blended.take(), pixels);
    }

    /// Sorts and draws the dirty tiles, longest lists first. Returns the fraction of the threads' time spent on
    /// sorting.
    fn blend(&mut self, view: &Viewport, request: &Request, grid: Grid) -> f64 {
        let _span = debug_span!("blend", width = request.width, height = request.height).entered();
        let starts = &self.starts;
        self.order.clear();
        self.order.extend((0..grid.len() as u32).filter(|&tile| self.dirty[tile as usize].load(Ordering::Relaxed)));
        let length = |tile: u32| starts[tile as usize + 1] - starts[tile as usize];
        self.order.sort_unstable_by_key(|&tile| (std::cmp::Reverse(length(tile)), tile));
        self.work.tiles_drawn = self.order.len() as u64;
        self.scratch.resize_with(rayon::current_num_threads(), Scratch::default);
        let image = &mut self.image;
        let planes = Planes {
            background: request.background,
            rgb: Disjoint::new(&mut image.rgb),
            depth: image.depth.as_deref_mut().map(Disjoint::new),
            alpha: image.alpha.as_deref_mut().map(Disjoint::new),
            final_t: image.final_t.as_deref_mut().map(Disjoint::new),
            blended: image.blended.as_deref_mut().map(Disjoint::new),
        };
        let entries = Disjoint::new(&mut self.entries);
        let next = AtomicUsize::new(0);
        let (order, splats, level) = (&self.order, &self.splats, self.level);
        self.scratch.par_iter_mut().with_max_len(1).for_each(|scratch| {
            scratch.tally = Tally::default();
            while let Some(&tile) = order.get(next.fetch_add(1, Ordering::Relaxed)) {
                let tile = tile as usize;
                // SAFETY: a tile is taken once, and lists of tiles do not overlap.
                let list = unsafe { entries.part(starts[tile] as usize..starts[tile + 1] as usize) };
                let start = Instant::now();
                by_depth(list, &mut scratch.spare);
                let sorted = Instant::now();
                let tile = [tile % grid.columns, tile / grid.columns];
                let walk = Walk { splats, list, shape: Shape::of(view), tile, size: [request.width, request.height] };
                dispatch(level, DrawTile { walk, planes: &planes, scratch });
                scratch.tally.sort += sorted - start;
                scratch.tally.blend += sorted.elapsed();
            }
        });
        let (mut sort, mut blend) = (Duration::ZERO, Duration::ZERO);
        for scratch in &self.scratch {
            sort += scratch.tally.sort;
            blend += scratch.tally.blend;
            self.work.blocks += scratch.tally.blocks;
            self.work.entries_unseen += scratch.tally.unseen;
        }
        sort.as_secs_f64() / (sort + blend).as_secs_f64().max(1e-9)
    }
}

/// Projects a chunk, counts entries per tile or marks the tiles that changed; returns dropped, culled, changed.
struct ProjectChunk<'a> {
    gaussians: &'a Gaussians<'a>,
    view: &'a Viewport,
    grid: Grid,
    first: usize,
    splats: &'a mut [Splat],
    counts: &'a mut [u32],
    dirty: &'a [AtomicBool],
    keep: bool,
}

impl Operation for ProjectChunk<'_> {
    type Output = [u64; 3];
    #[inline(always)]
    fn run<S: Simd>(mut self, s: S) -> [u64; 3] {
        let (gaussians, view) = (self.gaussians, self.view);
        let middle = [view.width, view.height].map(|size| (size as f64 - 1.0) / 2.0);
        let mut tally = [0; 3];
        for start in (0..self.splats.len()).step_by(LANES) {
            let first = self.first + start;
            match view.projection {
                Projection::Equirectangular => {
                    let batch = Batch::spherical(s, gaussians, first, view);
                    self.take::<true>(&batch, start, &mut tally);
                }
                Projection::Orthographic { focal } if view.form == Form::Separable => {
                    let batch = Batch::separable(s, gaussians, first, focal, view);
                    self.take::<true>(&batch, start, &mut tally);
                }
                Projection::Orthographic { focal } => {
                    let batch = Batch::general::<S, false, false>(s, gaussians, first, focal, middle, view);
                    self.take::<false>(&batch, start, &mut tally);
                }
                Projection::Pinhole { focal, centre } if view.blur.is_some() => {
                    let centre = centre.map(f64::from);
                    let batch = Batch::general::<S, true, true>(s, gaussians, first, focal, centre, view);
                    self.take::<false>(&batch, start, &mut tally);
                }
                Projection::Pinhole { focal, centre } => {
                    let centre = centre.map(f64::from);
                    let batch = Batch::general::<S, true, false>(s, gaussians, first, focal, centre, view);
                    self.take::<false>(&batch, start, &mut tally);
                }
            }
        }
        tally
    }
}

impl ProjectChunk<'_> {
    #[inline(always)]
    fn take<const PARTS: bool>(&mut self, batch: &Batch, start: usize, tally: &mut [u64; 3]) {
        let lanes = LANES.min(self.splats.len() - start);
        let dropped = batch.dropped.count_ones();
        tally[0] += u64::from(dropped);
        tally[1] += lanes as u64 - u64::from(dropped + batch.visible.count_ones());
        for l in 0..lanes {
            let splat = batch.splat::<PARTS>(self.gaussians, l, self.first + start + l);
            let old = &mut self.splats[start + l];
            if !self.keep {
                self.grid.for_each_tile(&splat, |tile| self.counts[tile] += 1);
                *old = splat;
            } else if !splat.same_bits(old) {
                tally[2] += 1;
                for splat in [&*old, &splat] {
                    self.grid.for_each_tile(splat, |tile| self.dirty[tile].store(true, Ordering::Relaxed));
                }
                *old = splat;
            }
        }
    }
}
