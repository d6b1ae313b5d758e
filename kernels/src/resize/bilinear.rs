//! Two taps per axis.

use tracing::debug_span;

use crate::Level;
use crate::parallel::for_each_chunk;
use crate::simd::{LANES, Operation, Simd, dispatch};
use crate::size::product;

/// Where each output of an axis reads.
pub(super) struct Axis {
    pub low: Vec<usize>,
    pub high: Vec<usize>,
    pub weight: Vec<f32>,
    /// Output i is input i.
    pub identity: bool,
}

impl Axis {
    pub fn new(n: usize, m: usize) -> Self {
        let scale = n as f32 / m as f32;
        let mut axis = Self { low: vec![0; m], high: vec![0; m], weight: vec![0.0; m], identity: n == m };
        for i in 0..m {
            let x = scale * (i as f32 + 0.5) - 0.5;
            let x = if x > 0.0 { x } else { 0.0 };
            let low = (x as usize).min(n - 1);
            axis.low[i] = low;
            axis.high[i] = (low + 1).min(n - 1);
            // At most 1, where rounding put x past the last input.
            axis.weight[i] = (x - low as f32).min(1.0);
        }
        axis
    }
}

/// Output rows of a task.
const ROWS: usize = 16;

/// `source` `[channels, h, w]` in the size `dst_h × dst_w`: `out` `[channels, dst_h, dst_w]`.
///
/// # Panics
/// When a length does not fit its shape, or the source is empty and the result is not.
pub fn bilinear(
    level: Level,
    source: &[f32],
    channels: usize,
    h: usize,
    w: usize,
    dst_h: usize,
    dst_w: usize,
    out: &mut [f32],
) {
    assert_eq!(source.len(), product([channels, h, w]), "source of shape [{channels}, {h}, {w}]");
    assert_eq!(out.len(), product([channels, dst_h, dst_w]), "result of shape [{channels}, {dst_h}, {dst_w}]");
    if out.is_empty() {
        return;
    }
    assert!(h > 0 && w > 0, "an image of {h}×{w} cannot be resized to {dst_h}×{dst_w}");
    let _span = debug_span!("resize", kind = "bilinear", channels, h, w, dst_h, dst_w).entered();
    let (rows, columns) = (Axis::new(h, dst_h), Axis::new(w, dst_w));
    for_each_chunk(out, dst_h * dst_w, |channel, out| {
        let source = &source[channel * h * w..][..h * w];
        for_each_chunk(out, ROWS * dst_w, |block, out| {
            dispatch(level, Block { source, w, rows: &rows, columns: &columns, first: block * ROWS, out });
        });
    });
}

/// Consecutive output rows of one channel.
struct Block<'a> {
    source: &'a [f32],
    w: usize,
    rows: &'a Axis,
    columns: &'a Axis,
    first: usize,
    out: &'a mut [f32],
}

impl Operation for Block<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let width = self.columns.low.len();
        // The two current source rows in the new width, and their numbers.
        let (mut low, mut high) = (vec![0.0; width], vec![0.0; width]);
        let (mut low_is, mut high_is) = (usize::MAX, usize::MAX);
        for (i, out) in self.out.chunks_mut(width).enumerate() {
            let (j, k) = (self.rows.low[self.first + i], self.rows.high[self.first + i]);
            if low_is != j {
                if high_is == j {
                    std::mem::swap(&mut low, &mut high);
                    std::mem::swap(&mut low_is, &mut high_is);
                } else {
                    widen(s, &self.source[j * self.w..][..self.w], self.columns, &mut low);
                    low_is = j;
                }
            }
            if self.rows.identity {
                out.copy_from_slice(&low);
                continue;
            }
            if high_is != k {
                widen(s, &self.source[k * self.w..][..self.w], self.columns, &mut high);
                high_is = k;
            }
            let weight = s.splat(self.rows.weight[self.first + i]);
            for ((a, b), out) in low.chunks(LANES).zip(high.chunks(LANES)).zip(out.chunks_mut(LANES)) {
                let a = s.load_partial(a, 0.0);
                let b = s.load_partial(b, 0.0);
                s.store_partial(s.mul_add(weight, s.sub(b, a), a), out);
            }
        }
    }
}

/// One row in the new width.
#[inline(always)]
fn widen<S: Simd>(s: S, row: &[f32], axis: &Axis, out: &mut [f32]) {
    if axis.identity {
        out.copy_from_slice(row);
        return;
    }
    for (i, out) in out.chunks_mut(LANES).enumerate() {
        let at = i * LANES;
        let take = |index: &[usize]| {
            let mut lanes = [0.0; LANES];
            for (lane, &j) in lanes.iter_mut().zip(&index[at..at + out.len()]) {
                *lane = row[j];
            }
            s.from_array(lanes)
        };
        let (a, b) = (take(&axis.low), take(&axis.high));
        let weight = s.load_partial(&axis.weight[at..at + out.len()], 0.0);
        s.store_partial(s.mul_add(weight, s.sub(b, a), a), out);
    }
}
