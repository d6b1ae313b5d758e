//! Matrix products with packed weights and fused epilogues.
//!
//! `out[i,j] = epilogue(Σ_k x[i,k] · w[j,k])` for `x [m,k]`, `w [n,k]` (the layout of a linear layer's weight), `out [m,n]`,
//! all row-major.
//!
//! # Order of accumulation
//! `k` is cut into blocks of [`K_BLOCK`]. Inside a block one fused multiply-add per step, `k` ascending, starting from +0;
//! block sums are added in ascending order (the first block's sum is taken as it is). The tile in which an element lies
//! has no part in this, so the bits are the same on every level and for any number of threads.
//!
//! # How it runs
//! Weights lie in panels of 16 columns, `[n/16][k][16]`, padded with zeros. A task owns a block of rows and a range of
//! panels (a fixed grid that follows from the sizes). For each panel it walks the blocks of `k`; a block of a panel
//! stays in the first-level cache while all rows of the task pass over it, the rows stay in the second level. The sums of
//! a panel wait in a small tile until their last block, then the epilogue writes them out.

mod epilogue;
mod microkernel;
pub mod reference;
#[cfg(test)]
mod tests;

use std::ops::Range;

use rayon::prelude::*;

pub use epilogue::{Activation, Epilogue};
pub(crate) use microkernel::{deinterleave, interleave, multiply};

use crate::Level;
use crate::memory::{Aligned, Scratch};
use crate::parallel::Disjoint;
use crate::simd::{LANES, Operation, Simd, dispatch, prefetch};

/// Steps of `k` whose products are summed in one chain.
pub const K_BLOCK: usize = 256;

/// A linear layer's weight, packed for [`linear`].
///
/// The packing is the same on every level. It replaces the original: nothing needs `weight` afterwards.
#[derive(Clone)]
pub struct Weights {
    n: usize,
    k: usize,
    panels: Aligned<f32>,
}

impl Weights {
    /// Packs `weight [n,k]` (row-major, as linear layers store it).
    ///
    /// # Panics
    /// When `weight` does not hold `n · k` values.
    pub fn pack(weight: &[f32], n: usize, k: usize) -> Self {
        assert_eq!(weight.len(), n * k, "weight holds {} values, expected n·k = {n}·{k}", weight.len());
        let mut panels = Aligned::zeroed(n.div_ceil(LANES) * k * LANES);
        if k > 0 {
            panels.par_chunks_mut(k * LANES).enumerate().for_each(|(panel, to)| {
                for lane in 0..LANES.min(n - panel * LANES) {
                    let row = &weight[(panel * LANES + lane) * k..][..k];
                    for (to, &value) in to[lane..].iter_mut().step_by(LANES).zip(row) {
                        *to = value;
                    }
                }
            });
        }
        Self { n, k, panels }
    }

    /// Output columns.
    pub fn n(&self) -> usize {
        self.n
    }

    /// Input columns.
    pub fn k(&self) -> usize {
        self.k
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        self.panels.bytes()
    }

    fn panel_count(&self) -> usize {
        self.n.div_ceil(LANES)
    }
}

/// `out[i,j] = epilogue(Σ_k x[i,k] · w[j,k])` for `x [m,k]`, `out [m,n]`. See [the module](self) for the order of accumulation
/// and [`Epilogue`] for what can follow the product. `m` may be 0.
///
/// # Panics
/// When a slice does not have the size that `m`, the weights' `n` and `k` ask for.
pub fn linear(level: Level, x: &[f32], m: usize, weights: &Weights, epilogue: &Epilogue<'_>, out: &mut [f32]) {
    let (n, k) = (weights.n, weights.k);
    assert_eq!(x.len(), m * k, "input holds {} values, expected m·k = {m}·{k}", x.len());
    assert_eq!(out.len(), m * n, "output holds {} values, expected m·n = {m}·{n}", out.len());
    epilogue.check(n);
    let grid = Grid::new(m, weights.panel_count(), k);
    let out = &Disjoint::new(out);
    (0..grid.tasks()).into_par_iter().with_max_len(1).for_each(|task| {
        let (rows, panels) = grid.task(task);
        dispatch(level, Task { x, weights, epilogue, out, rows, panels });
    });
}

/// The fixed grid of tasks: blocks of rows, in each of them ranges of panels.
struct Grid {
    rows: usize,
    panels: usize,
    row_block: usize,
    panel_block: usize,
}

impl Grid {
    /// Row blocks that stay in a second-level cache, fewer rows where that would leave few tasks; ranges of panels only where
    /// there are few rows, since each range interleaves its rows again.
    fn new(rows: usize, panels: usize, k: usize) -> Self {
        const TASKS: usize = 24;
        const WHOLE: usize = 12;
        let most = if k <= 1024 { 96 } else { 48 };
        let row_block = rows.div_ceil(TASKS).next_multiple_of(WHOLE).clamp(WHOLE, most);
        let row_blocks = rows.div_ceil(row_block).max(1);
        // An even number of panels: some levels take two at a time.
        let panel_block = panels.div_ceil(TASKS.div_ceil(row_blocks)).max(4).next_multiple_of(2);
        Self { rows, panels, row_block, panel_block }
    }

    fn ranges(&self) -> usize {
        self.panels.div_ceil(self.panel_block)
    }

    fn tasks(&self) -> usize {
        self.rows.div_ceil(self.row_block) * self.ranges()
    }

    fn task(&self, index: usize) -> (Range<usize>, Range<usize>) {
        let row = index / self.ranges() * self.row_block;
        let panel = index % self.ranges() * self.panel_block;
        (row..(row + self.row_block).min(self.rows), panel..(panel + self.panel_block).min(self.panels))
    }
}

/// One task of [`linear`].
struct Task<'a> {
    x: &'a [f32],
    weights: &'a Weights,
    epilogue: &'a Epilogue<'a>,
    out: &'a Disjoint<'a, f32>,
    rows: Range<usize>,
    panels: Range<usize>,
}

impl Operation for Task<'_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        // The constants of a level choose one of these; the others are not compiled for it.
        match (S::GEMM_ROWS, S::GEMM_PANELS) {
            (12, 2) => self.blocks::<S, 12, 2>(s),
            (6, 1) => self.blocks::<S, 6, 1>(s),
            _ => self.blocks::<S, 4, 1>(s),
        }
    }
}

impl Task<'_> {
    #[inline(always)]
    fn blocks<S: Simd, const MR: usize, const NV: usize>(&self, s: S) {
        let mut tile = Scratch::take(self.rows.len() * NV * LANES);
        let (k, rows) = (self.weights.k, self.rows.len());
        let mut x = Scratch::take(rows.next_multiple_of(MR) * k);
        interleave::<MR>(rows, k, |i| &self.x[(self.rows.start + i) * k..][..k], &mut x);
        let mut panel = self.panels.start;
        while panel + NV <= self.panels.end {
            self.panel_group::<S, MR, NV>(s, panel, &x, &mut tile);
            panel += NV;
        }
        while panel < self.panels.end {
            self.panel_group::<S, MR, 1>(s, panel, &x, &mut tile);
            panel += 1;
        }
    }

    /// `NV` panels over all rows of the task.
    #[inline(always)]
    fn panel_group<S: Simd, const MR: usize, const NV: usize>(&self, s: S, panel: usize, x: &[f32], tile: &mut [f32]) {
        let (n, k) = (self.weights.n, self.weights.k);
        let rows = self.rows.len();
        let tile = &mut tile[..rows * NV * LANES];
        let start = panel * LANES;
        let columns = start..(start + NV * LANES).min(n);
        // Without a function to apply, whole vectors are written straight from the registers of the last block.
        let direct = self.epilogue.is_affine() && columns.len() == NV * LANES && k > 0;
        if k == 0 {
            tile.fill(0.0);
        }
        for start in (0..k).step_by(K_BLOCK) {
            let length = K_BLOCK.min(k - start);
            let (first_block, last_block) = (start == 0, start + length == k);
            let mut from = [std::ptr::null(); NV];
            for v in 0..NV {
                from[v] = self.weights.panels[((panel + v) * k + start) * LANES..][..length * LANES].as_ptr();
            }
            let mut ahead = Ahead::after(
                from,
                length * LANES,
                if last_block { (NV - 1) * k * LANES } else { 0 },
                rows.div_ceil(MR),
            );
            for first in (0..rows).step_by(MR) {
                ahead.fetch();
                let present = MR.min(rows - first);
                let at = &x[first * k + start * MR..][..length * MR];
                if last_block {
                    for r in 0..MR {
                        let row = self.rows.start + first + r;
                        prefetch(self.out.address(row * n + columns.start));
                    }
                }
                // SAFETY: each pointer is that of a slice of the length read.
                let mut acc = unsafe { multiply::<S, MR, NV>(s, at.as_ptr(), from, length) };
                let tile = &mut tile[first * NV * LANES..][..present * NV * LANES];
                if !first_block {
                    for r in 0..MR {
                        if r < present {
                            for v in 0..NV {
                                acc[r][v] = s.add(s.load(&tile[(r * NV + v) * LANES..]), acc[r][v]);
                            }
                        }
                    }
                }
                if last_block && direct {
                    for v in 0..NV {
                        let columns = columns.start + v * LANES..columns.start + (v + 1) * LANES;
                        let affine = self.epilogue.affine(s, &columns);
                        for r in 0..MR {
                            if r < present {
                                let row = (self.rows.start + first + r) * n;
                                // SAFETY: tasks own disjoint blocks of rows and columns.
                                let out = unsafe { self.out.part(row + columns.start..row + columns.end) };
                                s.store(affine.apply(s, acc[r][v], || s.load(out)), out);
                            }
                        }
                    }
                } else {
                    for r in 0..MR {
                        if r < present {
                            for v in 0..NV {
                                s.store(acc[r][v], &mut tile[(r * NV + v) * LANES..]);
                            }
                        }
                    }
                }
            }
        }
        if !direct {
            self.finish::<S, NV>(s, columns, tile);
        }
    }

    /// Applies the epilogue to a tile and writes it.
    #[inline(always)]
    fn finish<S: Simd, const NV: usize>(&self, s: S, columns: Range<usize>, tile: &[f32]) {
        let n = self.weights.n;
        for v in 0..NV {
            let start = columns.start + v * LANES;
            let columns = start..(start + LANES).min(columns.end);
            if columns.is_empty() {
                continue;
            }
            let affine = self.epilogue.affine(s, &columns);
            for (i, sums) in tile.chunks_exact(NV * LANES).enumerate() {
                let row = (self.rows.start + i) * n;
                // SAFETY: tasks own disjoint blocks of rows and columns.
                let out = unsafe { self.out.part(row + columns.start..row + columns.end) };
                let y = self.epilogue.activate(s, s.add(s.load(&sums[v * LANES..]), affine.bias));
                s.store_partial(affine.finish(s, y, || s.load_partial(out, 0.0)), out);
            }
        }
    }
}

/// Brings the weights of the next block into the cache, a part of them before every register block of this one.
struct Ahead<const NV: usize> {
    at: [*const f32; NV],
    lines: usize,
}

impl<const NV: usize> Ahead<NV> {
    /// What follows `len` values from each of `from`, after `skip` more, in `calls` parts.
    #[inline(always)]
    fn after(from: [*const f32; NV], len: usize, skip: usize, calls: usize) -> Self {
        Self { at: from.map(|p| p.wrapping_add(len + skip)), lines: (len / LANES).div_ceil(calls) }
    }

    #[inline(always)]
    fn fetch(&mut self) {
        for at in &mut self.at {
            for _ in 0..self.lines {
                prefetch(*at);
                *at = at.wrapping_add(LANES);
            }
        }
    }
}
