//! The pass of one head's block of queries over the keys of its window.

#![expect(unsafe_code, reason = "register blocks read operands by pointer, and tasks write rows of one output")]

use std::marker::PhantomData;

use super::layout::{Layout, QueryBlock};
use super::rows::{KEY_BLOCK, LARGEST_SCALE, Rows, WHOLE};
use super::weighted_sum::{Scores, Weighed, WeightedSum};
use crate::gemm::form::{Form, Multiply, values_of_a_word};
use crate::gemm::{Precision, Strided, deinterleave, interleave};
use crate::memory::Scratch;
use crate::parallel::Disjoint;
use crate::simd::{LANES, Operation, Registers, Simd};

/// Channels of a head in all known models.
const USUAL_WIDTH: usize = 64;

/// All keys and values as [`super::pack`] leaves them; empty in f32.
#[derive(Clone, Copy)]
pub(super) struct Packed<'a> {
    pub(super) keys: &'a [f32],
    pub(super) values: &'a [f32],
    pub(super) scales: &'a [f32],
    pub(super) value_scales: &'a [f32],
}

/// The work of one [`QueryBlock`], with the operands of `q·k` in the form `A` and `w·v` as `W` holds it.
pub(super) struct Block<'a, A, W> {
    pub(super) layout: &'a Layout,
    pub(super) task: &'a QueryBlock,
    pub(super) q: Rows<'a>,
    pub(super) k: Rows<'a>,
    pub(super) v: Rows<'a>,
    /// Converted operands of the lower modes, read instead of `k` and `v`.
    pub(super) packed: Packed<'a>,
    pub(super) out: &'a Disjoint<'a, f32>,
    pub(super) forms: PhantomData<fn(A, W)>,
}

impl<A: Form, W: WeightedSum> Operation for Block<'_, A, W> {
    const DOT_PRODUCTS: bool = !matches!(A::PRECISION, Precision::F32);
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        // Rows of keys, rows of channels, panels of queries of the register blocks.
        match S::REGISTERS {
            Registers::Avx512 => self.attend::<S, 12, 8, 2>(s),
            Registers::Avx2 | Registers::Neon => self.attend::<S, 6, 6, 1>(s),
            Registers::Scalar => self.attend::<S, 4, 4, 1>(s),
        }
    }
}

impl<A: Form, W: WeightedSum> Block<'_, A, W> {
    #[inline(always)]
    fn attend<S: Simd, const KR: usize, const CR: usize, const NV: usize>(&self, s: S) {
        const {
            assert!(
                WHOLE.is_multiple_of(KR) && KEY_BLOCK.is_multiple_of(KR),
                "blocks of keys are whole register blocks"
            );
            // Widths are multiples of 16: none, two or four channels are left at the end.
            assert!(matches!(CR, 4 | 6 | 8), "the last channels have a register block of their own");
        }
        let (heads, width) = (self.layout.shape.heads, self.layout.shape.width);
        let (window, head) = (self.task.window, self.task.head);
        let queries = self.task.queries.len();
        let row = |i| self.layout.query(window, self.task.queries.start + i);
        let padded = queries.next_multiple_of(LANES);
        let mut scratch = Scratch::take(2 * padded * width + NV * KEY_BLOCK * LANES + 4 * padded);
        let (q, rest) = scratch.split_at_mut(padded * width);
        let (sum, rest) = rest.split_at_mut(padded * width);
        let (scores, rest) = rest.split_at_mut(NV * KEY_BLOCK * LANES);
        let (total, rest) = rest.split_at_mut(padded);
        let (reference, rest) = rest.split_at_mut(padded);
        let (scales, offsets) = rest.split_at_mut(padded);
        let scale = (std::f64::consts::LOG2_E / (width as f64).sqrt()) as f32;
        scales.fill(scale);
        offsets.fill(0.0);
        let words = width / values_of_a_word(A::PRECISION);
        if A::PRECISION == Precision::F32 {
            interleave::<LANES>(queries, width, |i| self.q.head(row(i), head, width), q);
        } else {
            let offsets: &mut [i32] = bytemuck::cast_slice_mut(offsets);
            let mut converted = Scratch::take(queries * words);
            let mut work = Scratch::take(width);
            for (i, to) in converted.chunks_exact_mut(words).enumerate() {
                let to = bytemuck::cast_slice_mut(to);
                let unit;
                (unit, offsets[i]) = A::convert_column(s, self.q.head(row(i), head, width), &mut work, to);
                scales[i] = unit.min(LARGEST_SCALE) * scale;
            }
            interleave::<LANES>(queries, words, |i| &converted[i * words..][..words], q);
        }
        total.fill(0.0);
        sum.fill(0.0);
        reference.fill(f32::NEG_INFINITY);
        let mut state = State::<A, W> {
            q,
            sum,
            scores,
            total,
            reference,
            scales,
            offsets: bytemuck::cast_slice(offsets),
            width,
            words,
            forms: PhantomData,
        };

        let count = self.layout.count(window, self.layout.keys);
        let mut copy = Scratch::take(0);
        for start in (0..count).step_by(KEY_BLOCK) {
            let present = KEY_BLOCK.min(count - start);
            let rows = present.next_multiple_of(KR);
            let keys = if A::PRECISION == Precision::F32 {
                self.in_place(start, present, rows, &mut copy)
            } else {
                self.converted::<S>(start, present, rows)
            };
            let mut panel = 0;
            while (panel + NV) * LANES <= padded {
                state.pass::<S, KR, CR, NV>(s, panel, &keys);
                panel += NV;
            }
            while panel * LANES < padded {
                state.pass::<S, KR, CR, 1>(s, panel, &keys);
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

impl<'a, A: Form, W: WeightedSum> Block<'a, A, W> {
    /// The `present` keys from `start` on, in place, with the memory behind them up to `rows`. Keys that are not
    /// contiguous, or at the end of memory, are copied to `copy`.
    #[inline(always)]
    fn in_place<'b>(&self, start: usize, present: usize, rows: usize, copy: &'b mut Scratch) -> Keys<'b>
    where
        'a: 'b,
    {
        let (window, head, width) = (self.task.window, self.task.head, self.layout.shape.width);
        let first = self.layout.row(window, start);
        let keys = |words, stride, values, value_stride| Keys {
            words,
            stride,
            scales: &[1.0; KEY_BLOCK],
            values,
            value_stride,
            value_scales: &[],
            present,
        };
        if self.layout.row(window, start + present - 1) == first + present - 1
            && let Some(words) = self.k.lines(first, rows, head, width)
            && let Some(values) = self.v.lines(first, present, head, width)
        {
            return keys(words, self.k.stride, values, self.v.stride);
        }
        *copy = Scratch::take(2 * rows * width);
        let (words, values) = copy.split_at_mut(rows * width);
        words[present * width..].fill(0.0);
        for (i, (key, value)) in
            words.chunks_exact_mut(width).zip(values.chunks_exact_mut(width)).take(present).enumerate()
        {
            let row = self.layout.row(window, start + i);
            key.copy_from_slice(self.k.head(row, head, width));
            value.copy_from_slice(self.v.head(row, head, width));
        }
        keys(words, width, values, width)
    }

    /// The `present` converted keys from `start` on, with the memory behind them up to `rows`.
    #[inline(always)]
    fn converted<S: Simd>(&self, start: usize, present: usize, rows: usize) -> Keys<'a> {
        let (window, head, width) = (self.task.window, self.task.head, self.layout.shape.width);
        let (packed, stride) = (self.layout.packed(window, head), A::row_words::<S>(width));
        let value_scales = if W::SCALED {
            &self.packed.value_scales[self.layout.value_scales(window, head)][start / KEY_BLOCK * width..][..width]
        } else {
            &[]
        };
        Keys {
            words: &self.packed.keys[packed.clone()][start * stride..][..rows * stride],
            stride,
            scales: &self.packed.scales[self.layout.packed_scales(window, head)][start..][..rows],
            values: &self.packed.values[packed][start * width..],
            value_stride: width,
            value_scales,
            present,
        }
    }
}

/// A block of keys and their values.
struct Keys<'a> {
    /// The words of a key one after the other.
    words: &'a [f32],
    /// From a key to the next.
    stride: usize,
    scales: &'a [f32],
    /// For each row word of the keys, one of every channel.
    values: &'a [f32],
    /// From a row word's channels to those of the next.
    value_stride: usize,
    value_scales: &'a [f32],
    present: usize,
}

/// State of a block of queries on its pass over the keys. Everything comes in panels of 16 queries.
struct State<'a, A, W> {
    /// `[panels][words][16]`
    q: &'a [f32],
    /// `[panels][width][16]`: weighted sums of values.
    sum: &'a mut [f32],
    /// `[NV][KEY_BLOCK][16]`: scores, then words of weights.
    scores: &'a mut [f32],
    /// `[panels][16]`: sums of weights.
    total: &'a mut [f32],
    /// `[panels][16]`: the references `M`.
    reference: &'a mut [f32],
    /// `[panels][16]`: factors that turn scores into powers of 2.
    scales: &'a [f32],
    /// `[panels][16]`: offsets that the form of the keys adds to a score.
    offsets: &'a [i32],
    width: usize,
    words: usize,
    forms: PhantomData<fn(A, W)>,
}

impl<A: Form, W: WeightedSum> State<'_, A, W> {
    /// `NV` panels of queries over one block of keys.
    #[inline(always)]
    fn pass<S: Simd, const KR: usize, const CR: usize, const NV: usize>(
        &mut self,
        s: S,
        panel: usize,
        keys: &Keys<'_>,
    ) {
        let largest = self.score::<S, KR, NV>(s, panel, keys);
        let mut weighed = [Weighed::nothing(s); NV];
        for v in 0..NV {
            weighed[v] = self.weigh(s, panel, v, largest[v], keys.present);
        }
        let words = keys.present.div_ceil(W::KEYS);
        let whole = self.width / CR * CR;
        for c in (0..whole).step_by(CR) {
            self.accumulate::<S, CR, NV>(s, panel, keys, c, words, &weighed);
        }
        match self.width - whole {
            4 => self.accumulate::<S, 4, NV>(s, panel, keys, whole, words, &weighed),
            2 => self.accumulate::<S, 2, NV>(s, panel, keys, whole, words, &weighed),
            _ => {}
        }
    }

    /// Scores of a block of keys; returns the largest of each query.
    #[inline(always)]
    fn score<S: Simd, const KR: usize, const NV: usize>(
        &mut self,
        s: S,
        panel: usize,
        keys: &Keys<'_>,
    ) -> [S::F32; NV] {
        let len = self.words * LANES;
        let from = std::array::from_fn(|v| self.q[(panel + v) * len..][..len].as_ptr().cast());
        let mut offsets = [s.splat_i32(0); NV];
        for v in 0..NV {
            let from = &self.offsets[(panel + v) * LANES..][..LANES];
            offsets[v] = s.to_bits(s.load(bytemuck::cast_slice(from)));
        }
        let (row_words, usual) = (A::row_words::<S>(self.width), A::row_words::<S>(USUAL_WIDTH));
        let mut largest = [s.splat(f32::NEG_INFINITY); NV];
        for first in (0..keys.present).step_by(KR) {
            let scales = &keys.scales[first..][..KR];
            let at = &keys.words[first * keys.stride..][..(KR - 1) * keys.stride + row_words];
            let along = |stride| Strided::along(at.as_ptr().cast(), stride);
            // SAFETY: each pointer is that of a slice of the length read.
            let mut acc = unsafe {
                // With a compile-time stride, the addresses of all keys need one register.
                if keys.stride == usual {
                    A::multiply::<S, KR, NV>(s, along(usual), from, self.words, &mut ())
                } else {
                    A::multiply::<S, KR, NV>(s, along(keys.stride), from, self.words, &mut ())
                }
            };
            for r in 0..KR {
                for v in 0..NV {
                    acc[r][v] = A::of_row(s, acc[r][v], scales[r], offsets[v]);
                }
            }
            for v in 0..NV {
                let to = &mut self.scores[(v * KEY_BLOCK + first) * LANES..][..KR * LANES];
                for r in 0..KR {
                    s.store(acc[r][v], &mut to[r * LANES..]);
                }
            }
            for r in 0..KR {
                if first + r < keys.present {
                    for v in 0..NV {
                        largest[v] = s.max(acc[r][v], largest[v]);
                    }
                }
            }
        }
        largest
    }

    /// Turns a panel's scores into weights, moves its references and adds to its totals.
    #[inline(always)]
    fn weigh<S: Simd>(&mut self, s: S, panel: usize, v: usize, largest: S::F32, present: usize) -> Weighed<S> {
        let at = (panel + v) * LANES;
        let scores = Scores {
            values: &mut self.scores[v * KEY_BLOCK * LANES..][..KEY_BLOCK * LANES],
            present,
            scale: s.load(&self.scales[at..]),
            largest,
            reference: s.load(&self.reference[at..]),
        };
        let weighed = W::weigh(s, scores);
        s.store(weighed.reference, &mut self.reference[at..][..LANES]);
        let total = &mut self.total[at..][..LANES];
        s.store(s.mul_add(s.load(total), weighed.before, weighed.total), total);
        weighed
    }

    /// Adds `CR` channels of a block's weighted values, whose weights take `words` words of a panel.
    #[inline(always)]
    fn accumulate<S: Simd, const CR: usize, const NV: usize>(
        &mut self,
        s: S,
        panel: usize,
        keys: &Keys<'_>,
        channel: usize,
        words: usize,
        weighed: &[Weighed<S>; NV],
    ) {
        let row_words = words * W::Product::row_words_of_a_word::<S>();
        let from = std::array::from_fn(|v| self.scores[v * KEY_BLOCK * LANES..][..words * LANES].as_ptr().cast());
        let values = &keys.values[channel..][..(row_words - 1) * keys.value_stride + CR];
        let values = Strided::across(values.as_ptr().cast(), keys.value_stride);
        // SAFETY: each pointer is that of a slice of the length read.
        let acc = unsafe { W::Product::multiply::<S, CR, NV>(s, values, from, words, &mut ()) };
        for v in 0..NV {
            let sum = &mut self.sum[((panel + v) * self.width + channel) * LANES..][..CR * LANES];
            for r in 0..CR {
                let at = &mut sum[r * LANES..][..LANES];
                let scale = if W::SCALED { keys.value_scales[channel + r] } else { 1.0 };
                s.store(W::add(s, s.load(at), acc[r][v], &weighed[v], scale), at);
            }
        }
    }
}
