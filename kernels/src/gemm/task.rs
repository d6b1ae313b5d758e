//! A product cut into tasks, and the walk of one task over its rows and panels.

#![expect(unsafe_code, reason = "tasks write blocks of rows and columns of one output, by pointer")]

use std::marker::PhantomData;
use std::ops::Range;

use rayon::prelude::*;

use super::epilogue::{Activation, Affine, Function, Gelu, Identity, Silu, SiluLow};
use super::form::{Bf16, F32, Form, Int8, block_words};
use super::microkernel::{HOOK_STEPS, PrefetchHook, Strided, Tile};
use super::places::{Places, Walk};
use super::{Input, Precision, Product, interleave};
use crate::Level;
use crate::memory::Scratch;
use crate::parallel::Disjoint;
use crate::simd::{LANES, Operation, Registers, Simd, dispatch, prefetch};

/// A product in tasks.
pub(super) fn run(level: Level, product: Product<'_>, out: &mut [f32]) {
    let grid = Grid::new(product.m, product.weights.panel_count(), product.weights.words());
    let out = &Disjoint::new(out);
    (0..grid.tasks()).into_par_iter().with_max_len(1).for_each(|index| {
        let (rows, panels) = grid.task(index);
        enter(level, product, out, rows, panels);
    });
}

/// A product on the calling thread, as part of a larger task.
pub(crate) fn run_here(level: Level, product: Product<'_>, out: &mut [f32]) {
    enter(level, product, &Disjoint::new(out), 0..product.m, 0..product.weights.panel_count());
}

fn enter(level: Level, product: Product<'_>, out: &Disjoint<'_, f32>, rows: Range<usize>, panels: Range<usize>) {
    match product.weights.precision {
        Precision::F32 => dispatch(level, Task { product, out, rows, panels, form: PhantomData::<fn(F32)> }),
        Precision::Bf16 => dispatch(level, Task { product, out, rows, panels, form: PhantomData::<fn(Bf16)> }),
        Precision::Int8 => dispatch(level, Task { product, out, rows, panels, form: PhantomData::<fn(Int8)> }),
    }
}

/// Rows of a register block on any level divide this.
const WHOLE: usize = 12;

/// The fixed grid of tasks: blocks of rows, in each of them ranges of panels.
struct Grid {
    rows: usize,
    panels: usize,
    row_block: usize,
    panel_block: usize,
}

impl Grid {
    /// Row blocks stay in a second-level cache, and have fewer rows where that would leave few tasks. Panels are cut
    /// into ranges only where there are few rows, since each range interleaves its rows again.
    fn new(rows: usize, panels: usize, words: usize) -> Self {
        const TASKS: usize = 24;
        let most = if words <= 1024 { 96 } else { 48 };
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

/// One task of a product.
struct Task<'a, F> {
    product: Product<'a>,
    out: &'a Disjoint<'a, f32>,
    rows: Range<usize>,
    panels: Range<usize>,
    form: PhantomData<fn(F)>,
}

impl<F: Form> Operation for Task<'_, F> {
    const DOT_PRODUCTS: bool = !matches!(F::PRECISION, Precision::F32);
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        // Rows and panels of the register block that fills the registers.
        match S::REGISTERS {
            Registers::Avx512 => self.blocks::<S, 12, 2>(s),
            Registers::Avx2 | Registers::Neon => self.blocks::<S, 6, 1>(s),
            Registers::Scalar => self.blocks::<S, 4, 1>(s),
        }
    }
}

impl<F: Form> Task<'_, F> {
    #[inline(always)]
    fn blocks<S: Simd, const MR: usize, const NV: usize>(&self, s: S) {
        const { assert!(WHOLE.is_multiple_of(MR), "blocks of rows are whole register blocks") };
        let (k, rows) = (self.product.weights.k, self.rows.len());
        let row_words = F::row_words::<S>(k);
        let mut tile = Scratch::take(rows.next_multiple_of(MR) * NV * LANES);
        let mut scales = Scratch::take(rows);
        let mut words = Scratch::take(rows.next_multiple_of(MR) * row_words);
        if F::PRECISION == Precision::F32 {
            let normed = self.normed(s);
            let row = |i: usize| normed.as_ref().map_or_else(|| self.row(i), |normed| &normed[i * k..][..k]);
            interleave::<MR>(rows, k, row, &mut words);
        } else {
            let mut converted = Scratch::take(rows * row_words);
            let mut values = Scratch::take(k.next_multiple_of(4));
            let mut line = Scratch::take(k);
            for i in 0..rows {
                let to = bytemuck::cast_slice_mut(&mut converted[i * row_words..][..row_words]);
                scales[i] = match self.product.x {
                    Input::Rows(_) => F::convert(s, self.row(i), None, &mut values, to),
                    Input::Normed(_, norm) => {
                        let largest = norm.apply_largest(s, self.row(i), &mut line);
                        F::convert(s, &line, Some(largest), &mut values, to)
                    }
                };
            }
            interleave::<MR>(rows, row_words, |i| &converted[i * row_words..][..row_words], &mut words);
        }
        let x: &[u32] = bytemuck::cast_slice(&words);
        let mut panel = self.panels.start;
        while panel + NV <= self.panels.end {
            self.panel_group::<S, MR, NV>(s, panel, x, &scales, &mut tile);
            panel += NV;
        }
        while panel < self.panels.end {
            self.panel_group::<S, MR, 1>(s, panel, x, &scales, &mut tile);
            panel += 1;
        }
    }

    /// Row `i` of the task, before any normalisation.
    #[inline(always)]
    fn row(&self, i: usize) -> &[f32] {
        let k = self.product.weights.k;
        &self.product.x.values()[(self.rows.start + i) * k..][..k]
    }

    /// The rows of the task, where they are normalised.
    #[inline(always)]
    fn normed<S: Simd>(&self, s: S) -> Option<Scratch> {
        let Input::Normed(_, norm) = self.product.x else {
            return None;
        };
        let k = norm.width();
        let mut normed = Scratch::take(self.rows.len() * k);
        if k > 0 {
            for (i, to) in normed.chunks_exact_mut(k).enumerate() {
                norm.apply(s, self.row(i), to);
            }
        }
        Some(normed)
    }

    /// `NV` panels over all rows of the task.
    #[inline(always)]
    fn panel_group<S: Simd, const MR: usize, const NV: usize>(
        &self,
        s: S,
        panel: usize,
        x: &[u32],
        scales: &[f32],
        tile: &mut [f32],
    ) {
        let (n, k) = (self.product.weights.n, self.product.weights.words());
        let (each, row_words) = (F::row_words_of_a_word::<S>(), F::row_words::<S>(self.product.weights.k));
        let rows = self.rows.len();
        let start = panel * LANES;
        let columns = start..(start + NV * LANES).min(n);
        let (places, mut from_row) = (self.places(), [0; NV]);
        for v in 0..NV {
            from_row[v] = places.of_column(start + v * LANES);
        }
        let far = self.product.weights.panels.len() > NEAR;
        // Without a function to apply, whole register blocks are written straight from the registers of the last block.
        let direct = self.product.epilogue.is_affine() && columns.len() == NV * LANES && k > 0;
        if k == 0 {
            tile[..rows * NV * LANES].fill(0.0);
        }
        for start in (0..k).step_by(block_words(F::PRECISION)) {
            let length = block_words(F::PRECISION).min(k - start);
            let (first_block, last_block) = (start == 0, start + length == k);
            let mut from = [std::ptr::null(); NV];
            for v in 0..NV {
                from[v] = self.product.weights.panels[((panel + v) * k + start) * LANES..][..length * LANES].as_ptr();
            }
            let mut ahead = Prefetches::new(length, rows.div_ceil(MR), MR, places.stride());
            if far {
                ahead.weights_after(from, length, if last_block { (NV - 1) * k * LANES } else { 0 });
            }
            let mut walk = places.rows_from(self.rows.start);
            for first in (0..rows).step_by(MR) {
                let at = &x[first * row_words + start * each * MR..];
                let at = &at[..length * each * MR];
                if last_block {
                    let mut out = [std::ptr::null(); NV];
                    for v in 0..NV {
                        out[v] = self.out.address(walk.at + from_row[v]);
                    }
                    ahead.expect(MR, out);
                }
                // SAFETY: `at` holds `length` steps of MR rows' words, and each of `from` `length` vectors of weights.
                let mut acc =
                    unsafe { F::multiply::<S, MR, NV>(s, Strided::across(at.as_ptr(), MR), from, length, &mut ahead) };
                let tile = &mut tile[first * NV * LANES..][..MR * NV * LANES];
                if !first_block {
                    for r in 0..MR {
                        for v in 0..NV {
                            acc[r][v] = F::add(s, s.load(&tile[(r * NV + v) * LANES..]), acc[r][v]);
                        }
                    }
                }
                if last_block && direct && first + MR <= rows {
                    self.write(s, columns.start, walk, from_row, acc, &scales[first..]);
                } else {
                    for r in 0..MR {
                        for v in 0..NV {
                            s.store(acc[r][v], &mut tile[(r * NV + v) * LANES..]);
                        }
                    }
                }
                walk = walk.skip(MR);
            }
        }
        let written = if direct { rows / MR * MR } else { 0 };
        let rest = written..rows;
        match (self.product.epilogue.activation(), F::PRECISION) {
            (Activation::Identity, _) => self.finish::<S, Identity, NV>(s, columns, rest, scales, tile),
            (Activation::Silu, Precision::F32) => self.finish::<S, Silu, NV>(s, columns, rest, scales, tile),
            (Activation::Silu, _) => self.finish::<S, SiluLow, NV>(s, columns, rest, scales, tile),
            (Activation::Gelu, _) => self.finish::<S, Gelu, NV>(s, columns, rest, scales, tile),
        }
    }

    /// Places of the output's rows and columns.
    #[inline(always)]
    fn places(&self) -> Places {
        self.product.epilogue.places(self.product.m, self.product.weights.n)
    }

    /// Vectors of the epilogue and of the form for up to 16 columns that start a panel.
    #[inline(always)]
    fn of_columns<S: Simd>(&self, s: S, columns: &Range<usize>) -> (Affine<S>, S::F32, S::I32) {
        let affine = self.product.epilogue.affine(s, columns);
        if F::PRECISION != Precision::Int8 {
            return (affine, s.splat(1.0), s.splat_i32(0));
        }
        let whole = columns.start..columns.start + LANES;
        let mut offsets = [0; LANES];
        offsets.copy_from_slice(&self.product.weights.offsets[whole.clone()]);
        (affine, s.load(&self.product.weights.scales[whole]), s.from_array_i32(offsets))
    }

    /// Writes a whole register block of columns from `column`, whose epilogue has no function, to the rows of a walk;
    /// `from_row` is where each panel's columns begin in a row.
    #[inline(always)]
    fn write<S: Simd, const MR: usize, const NV: usize>(
        &self,
        s: S,
        column: usize,
        mut walk: Walk,
        from_row: [usize; NV],
        acc: Tile<S, MR, NV>,
        scales: &[f32],
    ) {
        let (scales, last) = (&scales[..MR], walk.skip(MR - 1).at);
        let mut of = [self.of_columns(s, &(column..column + LANES)); NV];
        let mut out = [std::ptr::null_mut(); NV];
        for v in 0..NV {
            let column = column + v * LANES;
            if v > 0 {
                of[v] = self.of_columns(s, &(column..column + LANES));
            }
            // SAFETY: tasks own disjoint blocks of rows and columns.
            out[v] = unsafe { self.out.parts(from_row[v], last + from_row[v] + LANES) };
        }
        // SAFETY: each vector is inside the rows; the slice includes the last one.
        unsafe {
            if of[0].0.residual {
                for r in 0..MR {
                    for v in 0..NV {
                        let at = out[v].add(walk.at);
                        let p = F::product(s, acc[r][v], scales[r], of[v].1, of[v].2);
                        s.store_ptr(of[v].0.apply(s, p, s.load_ptr(at)), at);
                    }
                    walk.step();
                }
            } else {
                for r in 0..MR {
                    for v in 0..NV {
                        let p = F::product(s, acc[r][v], scales[r], of[v].1, of[v].2);
                        s.store_ptr(of[v].0.apply(s, p, p), out[v].add(walk.at));
                    }
                    walk.step();
                }
            }
        }
    }

    /// Applies the epilogue, whose function is `A`, to rows of a tile and writes them.
    #[inline(always)]
    fn finish<S: Simd, A: Function, const NV: usize>(
        &self,
        s: S,
        columns: Range<usize>,
        rows: Range<usize>,
        scales: &[f32],
        tile: &[f32],
    ) {
        let places = self.places();
        for v in 0..NV {
            let start = columns.start + v * LANES;
            let columns = start..(start + LANES).min(columns.end);
            if columns.is_empty() || rows.is_empty() {
                continue;
            }
            let (affine, scaled, offsets) = self.of_columns(s, &columns);
            let (tile, scales) = (&tile[v * LANES..], &scales[rows.clone()]);
            let tile = tile[rows.start * NV * LANES..].chunks(NV * LANES).zip(scales);
            let (from_row, mut walk) =
                (places.of_column(columns.start), places.rows_from(self.rows.start + rows.start));
            let end = walk.skip(rows.len() - 1).at + from_row + columns.len();
            // SAFETY: tasks own disjoint blocks of rows and columns.
            let out = unsafe { self.out.parts(from_row, end) };
            for (sums, &scale) in tile {
                let y = A::of(s, s.add(F::product(s, s.load(sums), scale, scaled, offsets), affine.bias));
                // SAFETY: inside the rows; the slice includes the last one.
                let to = unsafe { std::slice::from_raw_parts_mut(out.add(walk.at), columns.len()) };
                walk.step();
                let before = if affine.residual { s.load_partial(to, 0.0) } else { y };
                s.store_partial(affine.finish(s, y, before), to);
            }
        }
    }
}

/// Words of weights that stay in a second-level cache together with a task's rows.
const NEAR: usize = 1 << 16;

/// Prefetches, spread over the legs of the register blocks: the weights of the next block, and the lines of the output
/// that a register block is about to write.
struct Prefetches<const NV: usize> {
    weights: [*const u32; NV],
    /// Lines of each panel in a leg, if weights are prefetched.
    lines: u32,
    /// Lines that a leg would have to prefetch.
    share: u32,
    out: [*const f32; NV],
    /// From a row of the output to the next.
    stride: usize,
    /// Rows that are left.
    rows: u32,
    /// Rows in a leg.
    each: u32,
}

impl<const NV: usize> Prefetches<NV> {
    /// For `blocks` register blocks of `words`, which write `height` rows that are `stride` values apart.
    #[inline(always)]
    fn new(words: usize, blocks: usize, height: usize, stride: usize) -> Self {
        let calls = words.div_ceil(HOOK_STEPS) as u32;
        Self {
            weights: [std::ptr::null(); NV],
            lines: 0,
            share: (words as u32).div_ceil((blocks as u32).max(1) * calls),
            out: [std::ptr::null(); NV],
            stride,
            rows: 0,
            each: (height as u32).div_ceil(calls),
        }
    }

    /// The next block's weights are those after `words` at `from` and `skipped` more.
    #[inline(always)]
    fn weights_after(&mut self, from: [*const u32; NV], words: usize, skipped: usize) {
        self.weights = from.map(|p| p.wrapping_add(words * LANES + skipped));
        self.lines = self.share;
    }

    /// The next register block writes `rows` rows that begin at `out`.
    #[inline(always)]
    fn expect(&mut self, rows: usize, out: [*const f32; NV]) {
        (self.out, self.rows) = (out, rows as u32);
    }
}

impl<const NV: usize> PrefetchHook for Prefetches<NV> {
    #[inline(always)]
    fn prefetch(&mut self) {
        for _ in 0..self.lines {
            for at in &mut self.weights {
                prefetch(*at);
                *at = at.wrapping_add(LANES);
            }
        }
        let now = self.each.min(self.rows);
        self.rows -= now;
        for _ in 0..now {
            for out in &mut self.out {
                prefetch(*out);
                *out = out.wrapping_add(self.stride);
            }
        }
    }
}
