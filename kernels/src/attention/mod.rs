//! Scaled dot-product attention over heads, in runs of tokens, without a matrix of all pairs.
//!
//! For every head and every window of tokens, with queries `q`, keys `k`, values `v` of `width` channels:
//!
//! `out[i] = Σ_j w[i,j] v[j] / Σ_j w[i,j]`, `w[i,j] = exp((q[i]·k[j] − max_j q[i]·k[j]) / √width)`
//!
//! # Order of operations
//! - `s = q·k`: one chain of fused multiply-adds over the channels, ascending, from +0.
//! - Keys are taken in blocks of [`KEY_BLOCK`], ascending. With `c` = `log2(e)/√width` rounded to f32, the query's reference
//!   is `M = max(M, c·max s)`; what was accumulated before is scaled by `r = 2^(M_old − M)`.
//! - The weight of a key is `2^(fma(s, c, −M))` (see `weight.rs`), never below `2^−126`.
//! - `Σ w`: a block has four sums, of its keys 0, 4, 8 …, of 1, 5, 9 …, and so on, each ascending from +0; the block's sum is
//!   `(0 + 1) + (2 + 3)`, and the query's sum becomes `fma(sum, r, block)`.
//! - `Σ w v`: one chain over a block's keys, ascending, from +0; the query's sum becomes `fma(sum, r, block)`.
//! - The result is `sum · (1 / Σ w)`.
//!
//! # How it runs
//! Lanes are queries: a vector holds one key's score for 16 queries, so that softmax needs no sums across a vector. Keys
//! and values are the interleaved rows of the register block, queries and weights its panels; a block of weights is stored
//! as the panel that its product with the values reads.
//!
//! # Precision
//! In bf16 and int8 ([`attend_as`]) the queries, keys and values are rounded to bf16 as inputs of [`crate::gemm`] are, and so is
//! every weight before it is summed or multiplied; the order of operations is the same.
//!
//! # Extremes
//! A logit that is NaN or −∞ weighs `2^−126` of the largest, and nothing in bf16 and int8. A row of nothing else gives the mean of its
//! values, and so does a row in which every logit is +∞: while `M` is infinite, `r` is 1 where `M` stays and all weights are equal
//! (`2^−126` in f32, 1 in bf16 and int8). A row with some logits at +∞ gives some mean of its values. A NaN or infinite *value*
//! reaches every row that sees its key: callers reject such input.
//!
//! Source: "StreamSplat (ICLR 2026)", encoder, decoder and upsampler blocks; the online form is that of Milakov and Gimelshein
//! (2018) and of FlashAttention (2022).

pub mod reference;
#[cfg(test)]
mod tests;
mod weight;

use std::ops::Range;

use rayon::prelude::*;
use tracing::debug_span;

use crate::Level;
use crate::gemm::{Precision, deinterleave, interleave, multiply, round_bf16};
use crate::memory::Scratch;
use crate::parallel::Disjoint;
use crate::simd::{LANES, Operation, Simd, dispatch};
use weight::weight;

/// Keys of a block: whole register blocks on every level.
pub const KEY_BLOCK: usize = 192;

/// Queries of a task: while they pass over a block of keys, it stays in the second-level cache.
const QUERY_BLOCK: usize = 64;

/// Keys are packed to a multiple of this: whole register blocks on every level.
const WHOLE: usize = 12;

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
    attend_as(Precision::F32, level, shape, q, k, v, out);
}

/// [`attend`] with the operands of both products held in `precision`.
///
/// # Panics
/// As [`attend`].
pub fn attend_as(
    precision: Precision,
    level: Level,
    shape: Shape,
    q: Rows<'_>,
    k: Rows<'_>,
    v: Rows<'_>,
    out: &mut [f32],
) {
    run(precision, level, shape, None, q, k, v, out);
}

/// [`attend_as`] of some queries: row `i` of `q` and of `out` is that of the token `places[i]`. A row's bits do not depend on
/// which others there are.
///
/// # Panics
/// As [`attend`], but for the number of queries; when there are not as many places as queries, or, where runs are asked for, one
/// is not that of a key.
#[expect(clippy::too_many_arguments, reason = "those of `attend_as` and the places")]
pub fn attend_some(
    precision: Precision,
    level: Level,
    shape: Shape,
    places: &[u32],
    q: Rows<'_>,
    k: Rows<'_>,
    v: Rows<'_>,
    out: &mut [f32],
) {
    assert_eq!(places.len(), q.rows, "{} places for {} queries", places.len(), q.rows);
    run(precision, level, shape, Some(places), q, k, v, out);
}

#[expect(clippy::too_many_arguments, reason = "those of `attend_as` and the places")]
fn run(
    precision: Precision,
    level: Level,
    shape: Shape,
    places: Option<&[u32]>,
    q: Rows<'_>,
    k: Rows<'_>,
    v: Rows<'_>,
    out: &mut [f32],
) {
    let low = precision != Precision::F32;
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
    let _span = debug_span!("attention", queries = q.rows, keys = k.rows, heads, ?precision).entered();
    let layout = Layout::new(shape, q.rows, k.rows, places);
    if k.rows == 0 {
        out.fill(0.0);
        return;
    }
    let mut packed = Scratch::take(2 * layout.packed_len());
    let (keys, values) = packed.split_at_mut(layout.packed_len());
    let len = layout.head_len();
    keys.par_chunks_mut(len).zip(values.par_chunks_mut(len)).enumerate().for_each(|(index, (keys, values))| {
        let (window, head) = (index / heads, index % heads);
        if layout.queries(window) > 0 {
            dispatch(level, Pack { layout: &layout, k, v, window, head, keys, values, low });
        }
    });
    let (keys, values, out) = (&*keys, &*values, &Disjoint::new(out));
    layout.tasks().par_iter().with_max_len(1).for_each(|task| {
        dispatch(level, Block { layout: &layout, q, keys, values, out, task, low });
    });
}

/// Where the tokens of windows lie, in the sequences and packed.
struct Layout {
    shape: Shape,
    queries: usize,
    keys: usize,
    /// Where only some tokens of runs are queried.
    gathered: Option<Gathered>,
}

/// Rows of queries by the window they lie in.
struct Gathered {
    /// Rows of the queries, window by window.
    rows: Vec<u32>,
    /// Where each window's begin, and the end.
    starts: Vec<usize>,
}

/// A block of queries of one head and window.
struct Task {
    window: usize,
    head: usize,
    queries: Range<usize>,
}

impl Layout {
    fn new(shape: Shape, queries: usize, keys: usize, places: Option<&[u32]>) -> Self {
        let mut layout = Self { shape, queries, keys, gathered: None };
        if let Windows::Runs { length, .. } = shape.windows {
            assert!(length > 0, "windows of no tokens");
            match places {
                Some(places) => layout.gathered = Some(layout.gather(places)),
                None => assert_eq!(queries, keys, "windows need as many queries as keys, found {queries} and {keys}"),
            }
        }
        layout
    }

    /// Sorts queries into their windows.
    fn gather(&self, places: &[u32]) -> Gathered {
        let mut starts = vec![0; self.windows() + 1];
        for &place in places {
            starts[self.window(place as usize) + 1] += 1;
        }
        for window in 0..self.windows() {
            starts[window + 1] += starts[window];
        }
        let (mut next, mut rows) = (starts.clone(), vec![0; places.len()]);
        for (row, &place) in places.iter().enumerate() {
            let next = &mut next[self.window(place as usize)];
            rows[*next] = row as u32;
            *next += 1;
        }
        Gathered { rows, starts }
    }

    /// The window of a token.
    fn window(&self, token: usize) -> usize {
        assert!(token < self.keys, "a query at {token} among {} tokens", self.keys);
        match self.shape.windows {
            Windows::Full => 0,
            Windows::Runs { roll, .. } => (token + roll % self.keys) % self.keys / self.length(),
        }
    }

    /// Queries of a window.
    fn queries(&self, window: usize) -> usize {
        match &self.gathered {
            Some(gathered) => gathered.starts[window + 1] - gathered.starts[window],
            None => self.count(window, self.queries),
        }
    }

    /// The row of query `i` of a window.
    #[inline(always)]
    fn query(&self, window: usize, i: usize) -> usize {
        match &self.gathered {
            Some(gathered) => gathered.rows[gathered.starts[window] + i] as usize,
            None => self.row(window, i),
        }
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

    /// Values that the packed keys (or values) of one head of one window take: whole register blocks of keys.
    fn head_len(&self) -> usize {
        self.length().next_multiple_of(WHOLE) * self.shape.width
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
            let count = self.queries(window);
            for head in 0..self.shape.heads {
                for start in (0..count).step_by(QUERY_BLOCK) {
                    tasks.push(Task { window, head, queries: start..(start + QUERY_BLOCK).min(count) });
                }
            }
        }
        tasks
    }
}

/// Rounds all values to bf16.
#[inline(always)]
fn round<S: Simd>(s: S, x: &mut [f32]) {
    for x in x.chunks_mut(LANES) {
        s.store_partial(round_bf16(s, s.load_partial(x, 0.0)), x);
    }
}

/// Packs the keys and values of one head of one window.
struct Pack<'a> {
    layout: &'a Layout,
    k: Rows<'a>,
    v: Rows<'a>,
    window: usize,
    head: usize,
    keys: &'a mut [f32],
    values: &'a mut [f32],
    low: bool,
}

impl Operation for Pack<'_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(mut self, s: S) {
        match (S::GEMM_ROWS, S::GEMM_PANELS) {
            (12, 2) => self.pack::<12, 8>(),
            (6, 1) => self.pack::<6, 6>(),
            _ => self.pack::<4, 4>(),
        }
        if self.low {
            round(s, self.keys);
            round(s, self.values);
        }
    }
}

impl Pack<'_> {
    /// Keys as `[keys/KR][width][KR]`; values, by blocks of [`KEY_BLOCK`], as `[width/CR][keys of the block][CR]`.
    #[inline(always)]
    fn pack<const KR: usize, const CR: usize>(&mut self) {
        let width = self.layout.shape.width;
        let count = self.layout.count(self.window, self.layout.keys);
        let row = |i| self.layout.row(self.window, i);
        interleave::<KR>(count, width, |i| self.k.head(row(i), self.head, width), &mut *self.keys);
        for (block, to) in self.values[..count * width].chunks_mut(KEY_BLOCK * width).enumerate() {
            let present = to.len() / width;
            for i in 0..present {
                let from = self.v.head(row(block * KEY_BLOCK + i), self.head, width);
                let whole = width / CR * CR;
                for c in (0..whole).step_by(CR) {
                    to[c * present + i * CR..][..CR].copy_from_slice(&from[c..c + CR]);
                }
                let rest = width - whole;
                to[whole * present + i * rest..][..rest].copy_from_slice(&from[whole..]);
            }
        }
    }
}

/// The work of one [`Task`].
struct Block<'a> {
    layout: &'a Layout,
    q: Rows<'a>,
    keys: &'a [f32],
    values: &'a [f32],
    out: &'a Disjoint<'a, f32>,
    task: &'a Task,
    low: bool,
}

impl Operation for Block<'_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        // Rows of keys, rows of channels, panels of queries: what fills the registers of a level and divides its sizes.
        match (S::GEMM_ROWS, S::GEMM_PANELS) {
            (12, 2) => self.attend::<S, 12, 8, 2>(s),
            (6, 1) => self.attend::<S, 6, 6, 1>(s),
            _ => self.attend::<S, 4, 4, 1>(s),
        }
    }
}

impl Block<'_> {
    #[inline(always)]
    fn attend<S: Simd, const KR: usize, const CR: usize, const NV: usize>(&self, s: S) {
        let Layout { shape: Shape { heads, width, .. }, keys, .. } = *self.layout;
        let (window, head) = (self.task.window, self.task.head);
        let queries = self.task.queries.len();
        let row = |i| self.layout.query(window, self.task.queries.start + i);
        let padded = queries.next_multiple_of(LANES);
        let mut scratch = Scratch::take(2 * padded * width + NV * KEY_BLOCK * LANES + 2 * padded);
        let (q, rest) = scratch.split_at_mut(padded * width);
        let (sum, rest) = rest.split_at_mut(padded * width);
        let (scores, rest) = rest.split_at_mut(NV * KEY_BLOCK * LANES);
        let (total, reference) = rest.split_at_mut(padded);
        interleave::<LANES>(queries, width, |i| self.q.head(row(i), head, width), q);
        if self.low {
            round(s, q);
        }
        total.fill(0.0);
        sum.fill(0.0);
        reference.fill(f32::NEG_INFINITY);
        let mut state = State { q, sum, scores, total, reference, width, low: self.low };

        let packed = self.layout.packed(window, head);
        let (packed_keys, packed_values) = (&self.keys[packed.clone()], &self.values[packed]);
        let count = self.layout.count(window, keys);
        let scale = (std::f64::consts::LOG2_E / (width as f64).sqrt()) as f32;
        for start in (0..count).step_by(KEY_BLOCK) {
            let present = KEY_BLOCK.min(count - start);
            let keys = &packed_keys[start * width..][..present.next_multiple_of(KR) * width];
            let values = &packed_values[start * width..][..present * width];
            let mut panel = 0;
            while (panel + NV) * LANES <= padded {
                state.pass::<S, KR, CR, NV>(s, panel, keys, values, present, scale);
                panel += NV;
            }
            while panel * LANES < padded {
                state.pass::<S, KR, CR, 1>(s, panel, keys, values, present, scale);
                panel += 1;
            }
        }

        for (panel, sum) in state.sum.chunks_exact_mut(width * LANES).enumerate() {
            let inverse = s.div(s.splat(1.0), s.load(&state.total[panel * LANES..]));
            for sum in sum.chunks_exact_mut(LANES) {
                s.store(s.mul(s.load(sum), inverse), sum);
            }
            let present = LANES.min(queries - panel * LANES);
            let mut out: [&mut [f32]; LANES] = std::array::from_fn(|_| Default::default());
            for (i, out) in out[..present].iter_mut().enumerate() {
                let start = (row(panel * LANES + i) * heads + head) * width;
                // SAFETY: tasks own disjoint rows of a head.
                *out = unsafe { self.out.part(start..start + width) };
            }
            deinterleave(sum, &mut out[..present]);
        }
    }
}

/// What a block of queries keeps while it passes over the keys. Everything comes in panels of 16 queries.
struct State<'a> {
    /// `[panels][width][16]`
    q: &'a [f32],
    /// `[panels][width][16]`: weighted sums of values.
    sum: &'a mut [f32],
    /// `[NV][KEY_BLOCK][16]`: scores, then weights.
    scores: &'a mut [f32],
    /// `[panels][16]`: sums of weights.
    total: &'a mut [f32],
    /// `[panels][16]`: the references `M`.
    reference: &'a mut [f32],
    width: usize,
    low: bool,
}

impl State<'_> {
    /// `NV` panels of queries over one block of keys.
    #[inline(always)]
    fn pass<S: Simd, const KR: usize, const CR: usize, const NV: usize>(
        &mut self,
        s: S,
        panel: usize,
        keys: &[f32],
        values: &[f32],
        present: usize,
        scale: f32,
    ) {
        let largest = self.score::<S, KR, NV>(s, panel, keys, present);
        let mut rescale = [s.splat(1.0); NV];
        for v in 0..NV {
            rescale[v] = self.weigh(s, panel, v, largest[v], present, scale);
        }
        let whole = self.width / CR * CR;
        for c in (0..whole).step_by(CR) {
            self.accumulate::<S, CR, NV>(s, panel, &values[c * present..], c, present, rescale);
        }
        // Widths are multiples of 16, and the levels' blocks have 4, 6 or 8 rows.
        match self.width - whole {
            4 => self.accumulate::<S, 4, NV>(s, panel, &values[whole * present..], whole, present, rescale),
            2 => self.accumulate::<S, 2, NV>(s, panel, &values[whole * present..], whole, present, rescale),
            _ => {}
        }
    }

    /// Scores of a block of keys; returns the largest of each query.
    #[inline(always)]
    fn score<S: Simd, const KR: usize, const NV: usize>(
        &mut self,
        s: S,
        panel: usize,
        keys: &[f32],
        present: usize,
    ) -> [S::F32; NV] {
        let width = self.width;
        let from = std::array::from_fn(|v| self.q[(panel + v) * width * LANES..][..width * LANES].as_ptr());
        let mut largest = [s.splat(f32::NEG_INFINITY); NV];
        for first in (0..present).step_by(KR) {
            let at = &keys[first * width..][..KR * width];
            // SAFETY: each pointer is that of a slice of the length read.
            let acc = unsafe { multiply::<S, KR, NV>(s, at.as_ptr(), from, width) };
            for v in 0..NV {
                let to = &mut self.scores[(v * KEY_BLOCK + first) * LANES..][..KR * LANES];
                for r in 0..KR {
                    s.store(acc[r][v], &mut to[r * LANES..]);
                    if first + r < present {
                        largest[v] = s.max(acc[r][v], largest[v]);
                    }
                }
            }
        }
        largest
    }

    /// Moves a panel's references, turns its scores into weights and adds these to its totals; returns `r`.
    #[inline(always)]
    fn weigh<S: Simd>(&mut self, s: S, panel: usize, v: usize, largest: S::F32, present: usize, scale: f32) -> S::F32 {
        let scale = s.splat(scale);
        let reference = &mut self.reference[(panel + v) * LANES..][..LANES];
        let before = s.load(reference);
        let now = s.max(s.mul(largest, scale), before);
        s.store(now, reference);
        // Infinities that stay what they were have no difference.
        let rescale = s.select(s.eq(before, now), s.splat(1.0), weight(s, s.sub(before, now)));
        let (minus, finite) = (s.neg(now), s.lt(s.abs(now), s.splat(f32::INFINITY)));
        let scores = &mut self.scores[v * KEY_BLOCK * LANES..][..present * LANES];
        let mut sums = [s.splat(0.0); 4];
        let low = self.low;
        for four in scores.chunks_mut(4 * LANES) {
            for (score, sum) in four.chunks_exact_mut(LANES).zip(&mut sums) {
                let mut w = weight(s, s.mul_add(s.load(score), scale, minus));
                if low {
                    // Where every weight is the least, rounding would leave none.
                    w = s.select(finite, round_bf16(s, w), s.splat(1.0));
                }
                s.store(w, score);
                *sum = s.add(*sum, w);
            }
        }
        let block = s.add(s.add(sums[0], sums[1]), s.add(sums[2], sums[3]));
        let total = &mut self.total[(panel + v) * LANES..][..LANES];
        s.store(s.mul_add(s.load(total), rescale, block), total);
        rescale
    }

    /// Adds `CR` channels of a block's weighted values.
    #[inline(always)]
    fn accumulate<S: Simd, const CR: usize, const NV: usize>(
        &mut self,
        s: S,
        panel: usize,
        values: &[f32],
        channel: usize,
        present: usize,
        rescale: [S::F32; NV],
    ) {
        let from = std::array::from_fn(|v| self.scores[v * KEY_BLOCK * LANES..][..present * LANES].as_ptr());
        let values = &values[..CR * present];
        // SAFETY: each pointer is that of a slice of the length read.
        let acc = unsafe { multiply::<S, CR, NV>(s, values.as_ptr(), from, present) };
        for v in 0..NV {
            let sum = &mut self.sum[((panel + v) * self.width + channel) * LANES..][..CR * LANES];
            for r in 0..CR {
                let at = &mut sum[r * LANES..][..LANES];
                s.store(s.mul_add(s.load(at), rescale[v], acc[r][v]), at);
            }
        }
    }
}
