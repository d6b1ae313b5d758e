//! Scaled dot-product attention over heads, in runs of tokens, without a matrix of all pairs.
//!
//! For every head and every window of tokens, with queries `q`, keys `k`, values `v` of `width` channels:
//!
//! `out[i] = Σ_j w[i,j] v[j] / Σ_j w[i,j]`, `w[i,j] = exp((q[i]·k[j] − max_j q[i]·k[j]) / √width)`
//!
//! # Order of operations
//! - `s = q·k`: one chain of fused multiply-adds over the channels, ascending, from +0.
//! - Keys are taken in blocks of [`KEY_BLOCK`], ascending. With `c` = `log2(e)/√width` rounded to f32, the row's reference
//!   is `M = max(M, c·max s)`; what was accumulated before is scaled by `r = 2^(M_old − M)`.
//! - The weight of a key is `2^(fma(s, c, −M))` (see `weight.rs`), never below `2^−126`.
//! - `Σ w`: lane `j mod 16` of a block's sum adds its keys in ascending order; the row's lanes become `fma(lanes, r, block)`;
//!   at the end [`Simd::sum`] folds them.
//! - `Σ w v`: one chain over a block's keys, ascending, from +0; the row's sum becomes `fma(sum, r, block)`.
//! - The result is `sum · (1 / Σ w)`.
//!
//! # Extremes
//! A logit that is NaN or −∞ weighs `2^−126` of the largest, so a row of nothing else gives the mean of its values; so does a
//! row whose largest is +∞. A NaN or infinite *value* reaches every row that sees its key: callers reject such input.
//!
//! Source: "StreamSplat (ICLR 2026)", encoder, decoder and upsampler blocks; the online form is that of Milakov and Gimelshein
//! (2018) and of FlashAttention (2022).

pub mod reference;
#[cfg(test)]
mod tests;
mod weight;

use std::ops::Range;

use rayon::prelude::*;

use crate::Level;
use crate::gemm::multiply;
use crate::memory::Scratch;
use crate::parallel::Disjoint;
use crate::simd::{LANES, Operation, Simd, dispatch};
use weight::weight;

/// Keys of a block.
pub const KEY_BLOCK: usize = 128;

/// Queries of a task: their scores against a block of keys stay in the first-level cache.
const QUERY_BLOCK: usize = 48;

/// A matrix `[rows, heads·width]` that may be part of a wider one.
#[derive(Clone, Copy)]
pub struct Rows<'a> {
    values: &'a [f32],
    rows: usize,
    stride: usize,
    first: usize,
}

impl<'a> Rows<'a> {
    /// Columns `first..` of `values [rows, stride]`.
    ///
    /// # Panics
    /// When `values` does not hold `rows · stride` values.
    pub fn new(values: &'a [f32], rows: usize, stride: usize, first: usize) -> Self {
        assert_eq!(values.len(), rows * stride, "{} values, expected rows·stride = {rows}·{stride}", values.len());
        Self { values, rows, stride, first }
    }

    /// Rows of the matrix.
    pub fn rows(&self) -> usize {
        self.rows
    }

    #[inline(always)]
    fn head(&self, row: usize, head: usize, width: usize) -> &'a [f32] {
        &self.values[row * self.stride + self.first + head * width..][..width]
    }
}

/// Which keys a query sees.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Windows {
    /// All of them.
    Full,
    /// The keys of its own run: the sequence rolled forward by `roll` (the last `roll` tokens wrap to the front) is cut into
    /// consecutive runs of `length`; the last may be shorter. Needs as many queries as keys.
    Runs {
        /// Tokens of a run.
        length: usize,
        /// Tokens by which the sequence is rolled forward before it is cut.
        roll: usize,
    },
}

/// Heads and windows of an attention.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Shape {
    /// Heads.
    pub heads: usize,
    /// Channels of a head, a multiple of 16.
    pub width: usize,
    /// Which keys a query sees.
    pub windows: Windows,
}

/// `out [queries, heads·width]` = attention of `q` over `k` and `v`. See [the module](self).
///
/// Without keys the result is zero.
///
/// # Panics
/// When `width` is not a multiple of 16, when `k` and `v` differ in rows, when runs are asked for and `q` and `k` differ in
/// rows, when a matrix is narrower than `heads · width`, or `out` has another size.
pub fn attend(level: Level, shape: Shape, q: Rows<'_>, k: Rows<'_>, v: Rows<'_>, out: &mut [f32]) {
    let Shape { heads, width, .. } = shape;
    assert!(width > 0 && width.is_multiple_of(LANES), "heads of {width} channels, expected a multiple of {LANES}");
    assert_eq!(k.rows, v.rows, "{} keys but {} values", k.rows, v.rows);
    for (name, m) in [("queries", q), ("keys", k), ("values", v)] {
        let columns = heads * width;
        assert!(
            m.rows == 0 || m.first + columns <= m.stride,
            "{name}: {columns} columns from {} of {}",
            m.first,
            m.stride
        );
    }
    assert_eq!(
        out.len(),
        q.rows * heads * width,
        "output holds {} values, expected {}·{heads}·{width}",
        out.len(),
        q.rows
    );
    let layout = Layout::new(shape, q.rows, k.rows);
    if k.rows == 0 {
        out.fill(0.0);
        return;
    }
    let mut packed = Scratch::take(2 * layout.packed_len());
    let (keys, values) = packed.split_at_mut(layout.packed_len());
    pack(&layout, k, v, keys, values);
    let (keys, values, out) = (&*keys, &*values, &Disjoint::new(out));
    let tasks = layout.tasks();
    tasks.par_iter().with_max_len(1).for_each(|task| {
        dispatch(level, Block { layout: &layout, q, keys, values, out, task });
    });
}

/// Where the tokens of windows lie, in the sequences and packed.
struct Layout {
    shape: Shape,
    queries: usize,
    keys: usize,
}

/// A block of queries of one head and window.
struct Task {
    window: usize,
    head: usize,
    queries: Range<usize>,
}

impl Layout {
    fn new(shape: Shape, queries: usize, keys: usize) -> Self {
        if let Windows::Runs { length, .. } = shape.windows {
            assert!(length > 0, "windows of no tokens");
            assert_eq!(queries, keys, "windows need as many queries as keys, found {queries} and {keys}");
        }
        Self { shape, queries, keys }
    }

    fn length(&self) -> usize {
        match self.shape.windows {
            Windows::Full => self.keys,
            Windows::Runs { length, .. } => length.min(self.keys),
        }
    }

    fn windows(&self) -> usize {
        match self.shape.windows {
            Windows::Full => 1,
            Windows::Runs { .. } => self.keys.div_ceil(self.length().max(1)),
        }
    }

    /// Tokens of a window among `all` of a sequence.
    fn count(&self, window: usize, all: usize) -> usize {
        match self.shape.windows {
            Windows::Full => all,
            Windows::Runs { .. } => self.length().min(all - window * self.length()),
        }
    }

    /// The row of token `i` of a window.
    #[inline(always)]
    fn row(&self, window: usize, i: usize) -> usize {
        match self.shape.windows {
            Windows::Full => i,
            Windows::Runs { roll, .. } => {
                let back = self.keys - roll % self.keys;
                (window * self.length() + i + back) % self.keys
            }
        }
    }

    /// Keys of a window, with room to whole vectors.
    fn padded(&self) -> usize {
        self.length().next_multiple_of(LANES)
    }

    /// Values that the packed keys of one head of one window take.
    fn head_len(&self) -> usize {
        self.padded() * self.shape.width
    }

    fn packed_len(&self) -> usize {
        self.windows() * self.shape.heads * self.head_len()
    }

    fn packed(&self, window: usize, head: usize) -> Range<usize> {
        let start = (window * self.shape.heads + head) * self.head_len();
        start..start + self.head_len()
    }

    fn tasks(&self) -> Vec<Task> {
        let mut tasks = Vec::new();
        for window in 0..self.windows() {
            let count = self.count(window, self.queries);
            for head in 0..self.shape.heads {
                for start in (0..count).step_by(QUERY_BLOCK) {
                    tasks.push(Task { window, head, queries: start..(start + QUERY_BLOCK).min(count) });
                }
            }
        }
        tasks
    }
}

/// Packs keys as `[keys/16][width][16]` and values as `[width/16][keys][16]`, per window and head, padded with zeros.
fn pack(layout: &Layout, k: Rows<'_>, v: Rows<'_>, keys: &mut [f32], values: &mut [f32]) {
    let Shape { heads, width, .. } = layout.shape;
    let (len, padded) = (layout.head_len(), layout.padded());
    keys.par_chunks_mut(len).zip(values.par_chunks_mut(len)).enumerate().for_each(|(index, (keys, values))| {
        let (window, head) = (index / heads, index % heads);
        let count = layout.count(window, layout.keys);
        for i in 0..padded {
            let panel = &mut keys[i / LANES * LANES * width..][..LANES * width];
            if i >= count {
                panel[i % LANES..].iter_mut().step_by(LANES).for_each(|to| *to = 0.0);
                for channels in values.chunks_exact_mut(padded * LANES) {
                    channels[i * LANES..][..LANES].fill(0.0);
                }
                continue;
            }
            let row = layout.row(window, i);
            for (to, &from) in panel[i % LANES..].iter_mut().step_by(LANES).zip(k.head(row, head, width)) {
                *to = from;
            }
            let from = v.head(row, head, width).chunks_exact(LANES);
            for (channels, from) in values.chunks_exact_mut(padded * LANES).zip(from) {
                channels[i * LANES..][..LANES].copy_from_slice(from);
            }
        }
    });
}

/// The work of one [`Task`].
struct Block<'a> {
    layout: &'a Layout,
    q: Rows<'a>,
    keys: &'a [f32],
    values: &'a [f32],
    out: &'a Disjoint<'a, f32>,
    task: &'a Task,
}

impl Operation for Block<'_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        match (S::GEMM_ROWS, S::GEMM_PANELS) {
            (12, 2) => self.attend::<S, 12, 2>(s),
            (6, 1) => self.attend::<S, 6, 1>(s),
            _ => self.attend::<S, 4, 1>(s),
        }
    }
}

/// What a block of queries keeps while it passes over the keys.
struct State<'a> {
    /// `[rows][width]`
    q: &'a [f32],
    /// `[rows][KEY_BLOCK]`: scores, then weights.
    scores: &'a mut [f32],
    /// `[rows][16]`: largest score of the key block per lane.
    largest: &'a mut [f32],
    /// `[rows][16]`: sums of weights per lane.
    total: &'a mut [f32],
    /// `[rows][width]`: weighted sums of values.
    sum: &'a mut [f32],
    /// `[rows]`, to whole vectors: the row's reference `M`.
    reference: &'a mut [f32],
    /// `[rows]`, to whole vectors: `r` of the current key block.
    rescale: &'a mut [f32],
    rows: usize,
    width: usize,
}

impl Block<'_> {
    #[inline(always)]
    fn attend<S: Simd, const MR: usize, const NV: usize>(&self, s: S) {
        let width = self.layout.shape.width;
        let (window, head) = (self.task.window, self.task.head);
        let rows = self.task.queries.len();
        let per_row = 2 * width + KEY_BLOCK + 2 * LANES;
        let whole = QUERY_BLOCK.next_multiple_of(LANES);
        let mut scratch = Scratch::take(QUERY_BLOCK * per_row + 2 * whole);
        let (q, rest) = scratch.split_at_mut(QUERY_BLOCK * width);
        let (sum, rest) = rest.split_at_mut(QUERY_BLOCK * width);
        let (scores, rest) = rest.split_at_mut(QUERY_BLOCK * KEY_BLOCK);
        let (largest, rest) = rest.split_at_mut(QUERY_BLOCK * LANES);
        let (total, rest) = rest.split_at_mut(QUERY_BLOCK * LANES);
        let (reference, rescale) = rest.split_at_mut(whole);
        for i in 0..rows {
            let row = self.layout.row(window, self.task.queries.start + i);
            q[i * width..][..width].copy_from_slice(self.q.head(row, head, width));
        }
        total.fill(0.0);
        sum.fill(0.0);
        largest.fill(f32::NEG_INFINITY);
        reference.fill(f32::NEG_INFINITY);
        let mut state = State { q, scores, largest, total, sum, reference, rescale, rows, width };

        let count = self.layout.count(window, self.layout.keys);
        let keys = &self.keys[self.layout.packed(window, head)];
        let values = &self.values[self.layout.packed(window, head)];
        let scale = (std::f64::consts::LOG2_E / (width as f64).sqrt()) as f32;
        for start in (0..count).step_by(KEY_BLOCK) {
            let present = KEY_BLOCK.min(count - start);
            state.score::<S, MR, NV>(s, &keys[start * width..], present);
            state.weigh(s, scale, present);
            state.accumulate::<S, MR, NV>(s, &values[start * LANES..], self.layout.padded(), present);
        }

        for i in 0..rows {
            let row = self.layout.row(window, self.task.queries.start + i);
            let start = (row * self.layout.shape.heads + head) * width;
            // SAFETY: tasks own disjoint rows of a head.
            let out = unsafe { self.out.part(start..start + width) };
            let inverse = s.splat(1.0 / s.sum(s.load(&state.total[i * LANES..])));
            for c in (0..width).step_by(LANES) {
                s.store(s.mul(s.load(&state.sum[i * width + c..]), inverse), &mut out[c..]);
            }
        }
    }
}

impl State<'_> {
    /// Scores of a block of keys, and the largest of each row.
    #[inline(always)]
    fn score<S: Simd, const MR: usize, const NV: usize>(&mut self, s: S, keys: &[f32], present: usize) {
        let panels = present.div_ceil(LANES);
        let mut panel = 0;
        while panel + NV <= panels {
            self.score_panels::<S, MR, NV>(s, keys, panel, present);
            panel += NV;
        }
        while panel < panels {
            self.score_panels::<S, MR, 1>(s, keys, panel, present);
            panel += 1;
        }
    }

    #[inline(always)]
    fn score_panels<S: Simd, const MR: usize, const NV: usize>(
        &mut self,
        s: S,
        keys: &[f32],
        panel: usize,
        present: usize,
    ) {
        let width = self.width;
        let mut from = [std::ptr::null(); NV];
        for v in 0..NV {
            from[v] = keys[(panel + v) * LANES * width..][..LANES * width].as_ptr();
        }
        for first in (0..self.rows).step_by(MR) {
            let rows = MR.min(self.rows - first);
            let mut at = [std::ptr::null(); MR];
            for r in 0..MR {
                at[r] = self.q[(first + r.min(rows - 1)) * width..][..width].as_ptr();
            }
            // SAFETY: each pointer is that of a slice of the length read.
            let acc = unsafe { multiply::<S, MR, NV>(s, at, from, width) };
            for r in 0..MR {
                if r < rows {
                    let largest = &mut self.largest[(first + r) * LANES..][..LANES];
                    let scores = &mut self.scores[(first + r) * KEY_BLOCK + panel * LANES..][..NV * LANES];
                    let mut most = s.load(largest);
                    for v in 0..NV {
                        let mut score = acc[r][v];
                        let lanes = present - (panel + v) * LANES;
                        if lanes < LANES {
                            let there = s.mask_from_bits((1 << lanes) - 1);
                            score = s.select(there, score, s.splat(f32::NEG_INFINITY));
                        }
                        most = s.max(score, most);
                        s.store(score, &mut scores[v * LANES..]);
                    }
                    s.store(most, largest);
                }
            }
        }
    }

    /// Moves the references, turns scores into weights and adds these to the totals.
    #[inline(always)]
    fn weigh<S: Simd>(&mut self, s: S, scale: f32, present: usize) {
        for i in 0..self.rows {
            self.rescale[i] = s.max_lane(s.load(&self.largest[i * LANES..]));
        }
        let rows = self.rows.next_multiple_of(LANES);
        let (reference, rescale) = (self.reference[..rows].chunks_exact_mut(LANES), &mut self.rescale[..rows]);
        for (reference, rescale) in reference.zip(rescale.chunks_exact_mut(LANES)) {
            let before = s.load(reference);
            let now = s.max(s.mul(s.load(rescale), s.splat(scale)), before);
            s.store(now, reference);
            s.store(weight(s, s.sub(before, now)), rescale);
        }
        let panels = present.div_ceil(LANES);
        let scale = s.splat(scale);
        for i in 0..self.rows {
            let minus = s.splat(-self.reference[i]);
            let scores = &mut self.scores[i * KEY_BLOCK..][..panels * LANES];
            let mut block = s.splat(0.0);
            for (panel, scores) in scores.chunks_exact_mut(LANES).enumerate() {
                let mut w = weight(s, s.mul_add(s.load(scores), scale, minus));
                let lanes = present - panel * LANES;
                if lanes < LANES {
                    w = s.select(s.mask_from_bits((1 << lanes) - 1), w, s.splat(0.0));
                }
                s.store(w, scores);
                block = s.add(block, w);
            }
            let total = &mut self.total[i * LANES..][..LANES];
            s.store(s.mul_add(s.load(total), s.splat(self.rescale[i]), block), total);
        }
    }

    /// Adds the weighted values of a block of keys.
    #[inline(always)]
    fn accumulate<S: Simd, const MR: usize, const NV: usize>(
        &mut self,
        s: S,
        values: &[f32],
        padded: usize,
        present: usize,
    ) {
        let panels = self.width / LANES;
        let mut panel = 0;
        while panel + NV <= panels {
            self.accumulate_panels::<S, MR, NV>(s, values, padded, panel, present);
            panel += NV;
        }
        while panel < panels {
            self.accumulate_panels::<S, MR, 1>(s, values, padded, panel, present);
            panel += 1;
        }
    }

    #[inline(always)]
    fn accumulate_panels<S: Simd, const MR: usize, const NV: usize>(
        &mut self,
        s: S,
        values: &[f32],
        padded: usize,
        panel: usize,
        present: usize,
    ) {
        let width = self.width;
        let mut from = [std::ptr::null(); NV];
        for v in 0..NV {
            from[v] = values[(panel + v) * padded * LANES..][..present * LANES].as_ptr();
        }
        for first in (0..self.rows).step_by(MR) {
            let rows = MR.min(self.rows - first);
            let mut at = [std::ptr::null(); MR];
            for r in 0..MR {
                at[r] = self.scores[(first + r.min(rows - 1)) * KEY_BLOCK..][..present].as_ptr();
            }
            // SAFETY: each pointer is that of a slice of the length read.
            let acc = unsafe { multiply::<S, MR, NV>(s, at, from, present) };
            for r in 0..MR {
                if r < rows {
                    let rescale = s.splat(self.rescale[first + r]);
                    let sum = &mut self.sum[(first + r) * width + panel * LANES..][..NV * LANES];
                    for v in 0..NV {
                        let at = &mut sum[v * LANES..][..LANES];
                        s.store(s.mul_add(s.load(at), rescale, acc[r][v]), at);
                    }
                }
            }
        }
    }
}
