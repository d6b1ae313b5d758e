//! Colours of least squares: conjugate gradients on the normal equations of several views of the same Gaussians.
//!
//! Unknowns are changes x of colours, one per Gaussian and channel. In view k Gaussian i has colour `c_i + τ_ki·x_i`;
//! with A_k the [`ColourMap`] of the view and r_k the residual of its frame at x = 0,
//!
//! ```text
//! min over x   Σ_k |A_k·(τ_k∘x) − r_k|² + λ·|x|²
//! (Σ_k τ_k∘A_kᵀA_k∘τ_k + λ)·x = Σ_k τ_k∘A_kᵀ·r_k
//! ```
//!
//! is solved channel by channel by preconditioned conjugate gradients (Hestenes and Stiefel 1952; Saad, Iterative
//! Methods for Sparse Linear Systems, algorithm 9.1). The preconditioner is the inverse of the row sums of the matrix
//! of magnitudes. The lists of a view are walked once per step.
//!
//! Tiles of a view whose image is [close](Effort::close) enough to its frame at x = 0 are left out of the sums over
//! pixels.
//!
//! # Order of operations
//!
//! Vectors are binary32. A product with the matrix is `λ·x_i`, then per view in ascending order a fused `τ·Σ + …`, Σ
//! the sum over tiles of [`ColourMap::normal`]. Steps along a direction are fused. Inner products are binary64, summed
//! in chunks of [`CHUNK`] Gaussians, chunk after chunk.

#![expect(unsafe_code, reason = "tasks write sums of tiles into one array")]

use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;
use tracing::debug_span;

use super::super::rasteriser::finite_background;
use super::passes::{Normal, Paint, Residual, Slots};
use super::{ColourMap, Thread};
use crate::level::Level;
use crate::parallel::{Disjoint, map_indexed};
use crate::simd::{Operation, Registers, Simd, dispatch, fused_mul_add, prefetch_near};

/// Gaussians per task and per partial sum.
const CHUNK: usize = 4096;

/// One view in a [`ColourFit`].
#[derive(Clone, Copy, Debug)]
pub struct FitView<'a> {
    /// The map from colours to its image.
    pub map: &'a ColourMap,
    /// The unknown of each of the map's Gaussians, strictly ascending.
    pub unknown: &'a [u32],
    /// Factor τ of that unknown in the Gaussian's colour; empty where all are 1.
    pub factor: &'a [f32],
}

/// A least-squares problem: the colours with which the images of several views are nearest to frames.
#[derive(Debug)]
pub struct ColourFit<'a> {
    level: Level,
    views: Vec<FitView<'a>>,
    unknowns: usize,
    ridge: f32,
    /// Of each view.
    splats: Vec<Splats>,
    /// View and tile of every task, most hits first.
    order: Vec<[u32; 2]>,
    /// Tasks that are left out.
    left_out: Vec<[u32; 2]>,
    /// Start of the sums of each view, in slots; one more than views.
    starts: Vec<usize>,
}

/// Limits of [`ColourFit::solve`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Effort {
    /// Steps at most.
    pub steps: u32,
    /// Stops after a step that lowers the sum of squares by less than this fraction of the remaining sum.
    pub enough: f64,
    /// Mean square over pixels and channels up to which a tile counts as close. A tile is left out where it is close in
    /// all views.
    pub close: f64,
}

/// Result of [`ColourFit::solve`].
#[derive(Clone, Debug, PartialEq)]
pub struct Solution {
    /// The change of each colour.
    pub change: Vec<[f32; 3]>,
    /// Steps taken.
    pub steps: u32,
}

/// Unknown and factor of each splat of a view's tiles, tile by tile.
#[derive(Debug)]
struct Splats {
    unknown: Vec<u32>,
    /// Empty where all are 1.
    factor: Vec<f32>,
}

/// [`Splats`] of one tile.
#[derive(Clone, Copy)]
struct TileSplats<'a> {
    unknown: &'a [u32],
    factor: &'a [f32],
}

impl TileSplats<'_> {
    #[inline(always)]
    fn prefetch<T>(&self, at: usize, of: &[T]) {
        if let Some(&unknown) = self.unknown.get(at) {
            prefetch_near(of.as_ptr().wrapping_add(unknown as usize));
        }
    }
}

/// Colours of the unknowns times the factors.
struct Scaled<'a> {
    splats: TileSplats<'a>,
    of: &'a [[f32; 3]],
}

impl Paint<3> for Scaled<'_> {
    #[inline(always)]
    fn of(&self, at: usize, _: u32) -> [f32; 3] {
        let colour = self.of[self.splats.unknown[at] as usize];
        match self.splats.factor.get(at) {
            None => colour,
            Some(&factor) => colour.map(|c| c * factor),
        }
    }

    #[inline(always)]
    fn prefetch(&self, at: usize) {
        self.splats.prefetch(at, self.of);
    }
}

/// Colours of the unknowns as they are.
struct Given<'a> {
    splats: TileSplats<'a>,
    of: &'a [[f32; 3]],
}

impl Paint<3> for Given<'_> {
    #[inline(always)]
    fn of(&self, at: usize, _: u32) -> [f32; 3] {
        self.of[self.splats.unknown[at] as usize]
    }

    #[inline(always)]
    fn prefetch(&self, at: usize) {
        self.splats.prefetch(at, self.of);
    }
}

/// The magnitudes of the factors.
struct Magnitudes<'a>(TileSplats<'a>);

impl Paint<1> for Magnitudes<'_> {
    #[inline(always)]
    fn of(&self, at: usize, _: u32) -> [f32; 1] {
        [self.0.factor.get(at).map_or(1.0, |factor| factor.abs())]
    }

    #[inline(always)]
    fn prefetch(&self, _: usize) {}
}

/// Buffers of a solution.
#[derive(Default)]
struct Buffers {
    threads: Vec<Thread>,
    partial: Vec<f32>,
}

impl Splats {
    fn of(FitView { map, unknown, factor }: &FitView<'_>) -> Self {
        let gaussians: Vec<u32> = map.tiles.iter().flat_map(|tile| tile.record.gaussians.iter().copied()).collect();
        Self {
            unknown: gaussians.iter().map(|&i| unknown[i as usize]).collect(),
            factor: if factor.is_empty() {
                Vec::new()
            } else {
                gaussians.iter().map(|&i| factor[i as usize]).collect()
            },
        }
    }
}

impl<'a> ColourFit<'a> {
    /// The problem of `unknowns` colours seen in `views`, with `ridge` for λ.
    ///
    /// # Panics
    /// When a view does not have one unknown per Gaussian of its map, or has factors but not one per unknown. When
    /// unknowns are not strictly ascending and below `unknowns`.
    pub fn new(level: Level, views: Vec<FitView<'a>>, unknowns: usize, ridge: f32) -> Self {
        let mut starts = vec![0];
        for FitView { map, unknown, factor } in &views {
            assert_eq!(unknown.len(), map.gaussians(), "one unknown per Gaussian of the view");
            assert!(factor.is_empty() || factor.len() == unknown.len(), "one factor per Gaussian of the view, or none");
            assert!(unknown.is_sorted_by(|a, b| a < b), "unknowns ascend");
            assert!(unknown.last().is_none_or(|&last| (last as usize) < unknowns), "unknowns under {unknowns}");
            starts.push(starts[starts.len() - 1] + map.slots.len());
        }
        let mut order: Vec<[u32; 2]> =
            views.iter().zip(0..).flat_map(|(view, k)| view.map.order.iter().map(move |&tile| [k, tile])).collect();
        let splats = |[k, tile]: [u32; 2]| views[k as usize].map.tiles[tile as usize].record.gaussians.len();
        order.sort_by_key(|&task| std::cmp::Reverse(splats(task)));
        let splats = views.par_iter().map(Splats::of).collect();
        Self { level, views, unknowns, ridge, splats, order, left_out: Vec::new(), starts }
    }

    /// The splats of a tile of view `k`.
    fn splats(&self, k: usize, tile: usize) -> TileSplats<'_> {
        let starts = &self.views[k].map.starts;
        let range = starts[tile]..starts[tile + 1];
        let Splats { unknown, factor } = &self.splats[k];
        TileSplats { unknown: &unknown[range.clone()], factor: factor.get(range).unwrap_or_default() }
    }

    /// Steps from `colours` towards `frames`, one `[3, H, W]` per view. Returns the change of the colours.
    ///
    /// # Panics
    /// When there is not one colour per unknown, or not one frame of the view's size per view.
    pub fn solve(
        mut self,
        colours: &[[f32; 3]],
        frames: &[&[f32]],
        background: [f32; 3],
        Effort { steps, enough, close }: Effort,
    ) -> Solution {
        let _span = debug_span!("colour_fit", unknowns = self.unknowns, views = self.views.len(), steps).entered();
        assert_eq!(colours.len(), self.unknowns, "one colour per unknown");
        assert_eq!(frames.len(), self.views.len(), "one frame per view");
        for (view, frame) in self.views.iter().zip(frames) {
            view.map.assert_image(frame);
        }
        let mut change = vec![[0.0; 3]; self.unknowns];
        if steps == 0 || self.unknowns == 0 {
            return Solution { change, steps: 0 };
        }
        let mut buffers = Buffers::default();
        let (mut r, tiles) = self.residual(&mut buffers, colours, frames, background);
        if self.leave_out(&tiles, close) {
            self.zero_left_out::<3>(&mut buffers);
            self.sums(&buffers, &mut r, |_| [0.0; 3], |_, _| ());
            self.zero_left_out::<1>(&mut buffers);
        }
        if self.order.is_empty() {
            return Solution { change, steps: 0 };
        }
        let mut squares = self.total(&tiles);
        let diagonal = self.preconditioner(&mut buffers);
        self.zero_left_out::<3>(&mut buffers);
        let mut p = vec![[0.0; 3]; self.unknowns];
        let mut q = vec![[0.0; 3]; self.unknowns];
        // The first direction is the preconditioned residual itself.
        self.turn(&mut p, &r, &diagonal, [0.0; 3]);
        let mut rz = sum(&map_indexed(self.unknowns.div_ceil(CHUNK), |chunk| {
            let range = self.chunk(chunk);
            dispatch(self.level, Dot { a: &r[range.clone()], b: &p[range] })
        }));
        for step in 0..steps {
            let pq = self.normal(&mut buffers, &p, &mut q);
            let length: [f64; 3] = std::array::from_fn(|c| if pq[c] > 0.0 { rz[c] / pq[c] } else { 0.0 });
            let gain: f64 = (0..3).map(|c| length[c] * rz[c]).sum();
            if !gain.is_finite() || gain <= 0.0 {
                return Solution { change, steps: step };
            }
            let new = self.step(&mut change, &mut r, &p, &q, &diagonal, length.map(|a| a as f32));
            squares -= gain;
            if gain < enough * squares || step + 1 == steps {
                return Solution { change, steps: step + 1 };
            }
            let ratio = std::array::from_fn(|c| if rz[c] > 0.0 { (new[c] / rz[c]) as f32 } else { 0.0 });
            self.turn(&mut p, &r, &diagonal, ratio);
            rz = new;
        }
        unreachable!("the last step returns")
    }

    fn chunk(&self, index: usize) -> std::ops::Range<usize> {
        index * CHUNK..self.unknowns.min((index + 1) * CHUNK)
    }

    /// Calls `work` with every view's tiles.
    fn each_tile<const C: usize>(
        &self,
        Buffers { threads, partial }: &mut Buffers,
        work: impl Fn(usize, usize, &super::Record, super::Place, Slots<'_>, super::Pixels<'_>) + Sync,
    ) {
        threads.resize_with(rayon::current_num_threads(), Thread::default);
        let slots = self.starts[self.views.len()] * C;
        partial.resize(partial.len().max(slots), 0.0);
        let parts: Vec<Disjoint<'_, f32>> = {
            let mut rest = &mut partial[..slots];
            self.starts
                .windows(2)
                .map(|ends| Disjoint::new(rest.split_off_mut(..(ends[1] - ends[0]) * C).expect("room for each view")))
                .collect()
        };
        let next = AtomicUsize::new(0);
        threads.par_iter_mut().with_max_len(1).for_each(|thread| {
            while let Some(&[k, tile]) = self.order.get(next.fetch_add(1, Ordering::Relaxed)) {
                let (k, tile) = (k as usize, tile as usize);
                self.views[k].map.tile(tile, thread, |record, place, slots, pixels| {
                    work(k, tile, record, place, Slots { slots, partial: &parts[k] }, pixels);
                });
            }
        });
    }

    /// Leaves out tiles that are close enough in all views; returns true if there are any.
    fn leave_out(&mut self, tiles: &[Vec<f64>], close: f64) -> bool {
        let far = |[k, tile]: [u32; 2]| {
            let (map, tile) = (self.views[k as usize].map, tile as usize);
            tiles[k as usize][tile] > close * 3.0 * map.area(tile) as f64
        };
        let count = tiles.iter().map(Vec::len).max().unwrap_or(0);
        let mut wanted = vec![false; count];
        for &task in self.order.iter().filter(|task| far(**task)) {
            wanted[task[1] as usize] = true;
        }
        let (kept, left_out) = self.order.iter().partition(|[_, tile]| wanted[*tile as usize]);
        (self.order, self.left_out) = (kept, left_out);
        !self.left_out.is_empty()
    }

    /// Sums of the tiles that are left out become zero, `C` of each splat.
    fn zero_left_out<const C: usize>(&self, buffers: &mut Buffers) {
        for &[k, tile] in &self.left_out {
            let (map, tile) = (self.views[k as usize].map, tile as usize);
            for &slot in &map.slots[map.starts[tile]..map.starts[tile + 1]] {
                let at = (self.starts[k as usize] + slot as usize) * C;
                buffers.partial[at..at + C].fill(0.0);
            }
        }
    }

    /// The sum of squares over the tiles of all views that are not left out.
    fn total(&self, tiles: &[Vec<f64>]) -> f64 {
        let mut tiles = tiles.to_vec();
        for &[k, tile] in &self.left_out {
            tiles[k as usize][tile as usize] = 0.0;
        }
        tiles.iter().map(|of| of.iter().fold(0.0, |total, sum| total + sum)).fold(0.0, |a, b| a + b)
    }

    /// Σ τ∘Aᵀ·(frame − image of `colours`), and the sum of squares of each view's tiles.
    fn residual(
        &self,
        buffers: &mut Buffers,
        colours: &[[f32; 3]],
        frames: &[&[f32]],
        background: [f32; 3],
    ) -> (Vec<[f32; 3]>, Vec<Vec<f64>>) {
        let background = finite_background(background);
        let mut squares: Vec<Vec<f64>> = self.views.iter().map(|view| vec![0.0; view.map.grid.len()]).collect();
        {
            let squares: Vec<Disjoint<'_, f64>> = squares.iter_mut().map(|squares| Disjoint::new(squares)).collect();
            self.each_tile::<3>(buffers, |k, tile, record, place, to, super::Pixels { three: pixels, .. }| {
                let colours = Given { splats: self.splats(k, tile), of: colours };
                let sum = dispatch(
                    self.level,
                    Residual { record, place, colours, background, target: frames[k], pixels, to },
                );
                // SAFETY: a tile of a view is taken once.
                unsafe { squares[k].part(tile..tile + 1)[0] = sum };
            });
        }
        let mut gradient = vec![[0.0; 3]; self.unknowns];
        self.sums(buffers, &mut gradient, |_| [0.0; 3], |_, _| ());
        (gradient, squares)
    }

    /// The inverse of the row sums of the matrix of |τ_i·(AᵀA)_ij·τ_j| + λ.
    fn preconditioner(&self, buffers: &mut Buffers) -> Vec<f32> {
        self.each_tile::<1>(buffers, |k, tile, record, _, to, super::Pixels { one: pixels, .. }| {
            dispatch(self.level, Normal { record, colours: Magnitudes(self.splats(k, tile)), pixels, to });
        });
        let mut rows = vec![[0.0]; self.unknowns];
        self.sums_of(buffers, &mut rows, true, |_| [self.ridge], |_, _| ());
        rows.par_iter().with_min_len(CHUNK).map(|[row]| 1.0 / row).collect()
    }

    /// `q = (matrix)·p`; returns p·q.
    fn normal(&self, buffers: &mut Buffers, p: &[[f32; 3]], q: &mut [[f32; 3]]) -> [f64; 3] {
        self.each_tile::<3>(buffers, |k, tile, record, _, to, super::Pixels { three: pixels, .. }| {
            let colours = Scaled { splats: self.splats(k, tile), of: p };
            dispatch(self.level, Normal { record, colours, pixels, to });
        });
        let ridge = self.ridge;
        sum(&self.sums(
            buffers,
            q,
            |i| p[i].map(|p| ridge * p),
            |first, q| dispatch(self.level, Dot { a: &p[first..first + q.len()], b: q }),
        ))
    }

    /// Sums the contributions of all views' tiles for each unknown, from `start` on; returns `then` of each chunk.
    fn sums<R: Send>(
        &self,
        buffers: &Buffers,
        out: &mut [[f32; 3]],
        start: impl Fn(usize) -> [f32; 3] + Sync,
        then: impl Fn(usize, &[[f32; 3]]) -> R + Sync,
    ) -> Vec<R> {
        self.sums_of(buffers, out, false, start, then)
    }

    fn sums_of<const C: usize, R: Send>(
        &self,
        buffers: &Buffers,
        out: &mut [[f32; C]],
        magnitudes: bool,
        start: impl Fn(usize) -> [f32; C] + Sync,
        then: impl Fn(usize, &[[f32; C]]) -> R + Sync,
    ) -> Vec<R> {
        let partial: &[[f32; C]] = buffers.partial[..self.starts[self.views.len()] * C].as_chunks().0;
        out.par_chunks_mut(CHUNK)
            .enumerate()
            .map(|(chunk, out)| {
                let first = chunk * CHUNK;
                for (i, out) in out.iter_mut().enumerate() {
                    *out = start(first + i);
                }
                for (k, &view) in self.views.iter().enumerate() {
                    let partial = &partial[self.starts[k]..self.starts[k + 1]];
                    dispatch(self.level, Sums { view, first, partial, magnitudes, out });
                }
                then(first, out)
            })
            .collect()
    }

    /// `x += a∘p`, `r −= a∘q`; returns r·(D∘r).
    fn step(
        &self,
        x: &mut [[f32; 3]],
        r: &mut [[f32; 3]],
        p: &[[f32; 3]],
        q: &[[f32; 3]],
        diagonal: &[f32],
        a: [f32; 3],
    ) -> [f64; 3] {
        let parts: Vec<[f64; 3]> = x
            .par_chunks_mut(CHUNK)
            .zip(r.par_chunks_mut(CHUNK))
            .zip(p.par_chunks(CHUNK).zip(q.par_chunks(CHUNK)))
            .zip(diagonal.par_chunks(CHUNK))
            .map(|(((x, r), (p, q)), diagonal)| dispatch(self.level, Step { x, r, p, q, diagonal, a }))
            .collect();
        sum(&parts)
    }

    /// `p = D∘r + ratio∘p`
    fn turn(&self, p: &mut [[f32; 3]], r: &[[f32; 3]], diagonal: &[f32], ratio: [f32; 3]) {
        p.par_chunks_mut(CHUNK)
            .zip(r.par_chunks(CHUNK).zip(diagonal.par_chunks(CHUNK)))
            .for_each(|(p, (r, diagonal))| dispatch(self.level, Turn { p, r, diagonal, ratio }));
    }
}

/// Sums of chunks, in ascending order.
fn sum(parts: &[[f64; 3]]) -> [f64; 3] {
    parts.iter().fold([0.0; 3], |sum, part| std::array::from_fn(|c| sum[c] + part[c]))
}

/// A fused multiply-add of one value: one instruction on levels that have it.
#[inline(always)]
fn fused<S: Simd>(_: S, a: f32, b: f32, c: f32) -> f32 {
    match S::REGISTERS {
        Registers::Scalar => fused_mul_add(a, b, c),
        Registers::Avx2 | Registers::Avx512 | Registers::Neon => a.mul_add(b, c),
    }
}

/// Adds `τ·Σ` of the unknowns from `first` on.
struct Sums<'a, const C: usize> {
    view: FitView<'a>,
    first: usize,
    partial: &'a [[f32; C]],
    magnitudes: bool,
    out: &'a mut [[f32; C]],
}

impl<const C: usize> Operation for Sums<'_, C> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let Self { view: FitView { map, unknown, factor }, first, partial, magnitudes, out } = self;
        let from = unknown.partition_point(|&i| (i as usize) < first);
        let to = from + unknown[from..].partition_point(|&i| (i as usize) < first + out.len());
        for at in from..to {
            let mut total = [0.0; C];
            for part in &partial[map.offsets[at] as usize..map.offsets[at + 1] as usize] {
                for c in 0..C {
                    total[c] += part[c];
                }
            }
            let tau = factor.get(at).map_or(1.0, |&tau| if magnitudes { tau.abs() } else { tau });
            let out = &mut out[unknown[at] as usize - first];
            for c in 0..C {
                out[c] = fused(s, total[c], tau, out[c]);
            }
        }
    }
}

/// Inner products, channel by channel.
struct Dot<'a> {
    a: &'a [[f32; 3]],
    b: &'a [[f32; 3]],
}

impl Operation for Dot<'_> {
    type Output = [f64; 3];
    #[inline(always)]
    fn run<S: Simd>(self, _: S) -> [f64; 3] {
        let mut sum = [0.0; 3];
        for (a, b) in self.a.iter().zip(self.b) {
            for c in 0..3 {
                sum[c] += f64::from(a[c]) * f64::from(b[c]);
            }
        }
        sum
    }
}

struct Step<'a> {
    x: &'a mut [[f32; 3]],
    r: &'a mut [[f32; 3]],
    p: &'a [[f32; 3]],
    q: &'a [[f32; 3]],
    diagonal: &'a [f32],
    a: [f32; 3],
}

impl Operation for Step<'_> {
    type Output = [f64; 3];
    #[inline(always)]
    fn run<S: Simd>(self, s: S) -> [f64; 3] {
        let Self { x, r, p, q, diagonal, a } = self;
        let mut sum = [0.0; 3];
        for ((x, r), ((p, q), d)) in x.iter_mut().zip(r).zip(p.iter().zip(q).zip(diagonal)) {
            for c in 0..3 {
                x[c] = fused(s, p[c], a[c], x[c]);
                r[c] = fused(s, q[c], -a[c], r[c]);
                sum[c] += f64::from(r[c]) * f64::from(r[c] * d);
            }
        }
        sum
    }
}

struct Turn<'a> {
    p: &'a mut [[f32; 3]],
    r: &'a [[f32; 3]],
    diagonal: &'a [f32],
    ratio: [f32; 3],
}

impl Operation for Turn<'_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        for ((p, r), d) in self.p.iter_mut().zip(self.r).zip(self.diagonal) {
            for c in 0..3 {
                p[c] = fused(s, p[c], self.ratio[c], r[c] * d);
            }
        }
    }
}
