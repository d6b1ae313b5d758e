//! Resizing with as many taps as the reduction needs.

use tracing::debug_span;

use crate::simd::{LANES, Operation, Simd, dispatch};
use crate::size::product;
use crate::{Level, parallel};

/// The kernel that is widened by the reduction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Filter {
    /// 1 − |x| on [−1, 1].
    Triangle,
    /// Keys's cubic with coefficient −½ on [−2, 2] (Catmull and Rom's spline).
    Cubic,
}

impl Filter {
    /// Half its width.
    pub fn radius(self) -> f64 {
        match self {
            Filter::Triangle => 1.0,
            Filter::Cubic => 2.0,
        }
    }

    /// Its value.
    pub fn at(self, x: f64) -> f64 {
        let x = x.abs();
        match self {
            Filter::Triangle if x < 1.0 => 1.0 - x,
            Filter::Cubic if x < 1.0 => (1.5 * x - 2.5) * x * x + 1.0,
            Filter::Cubic if x < 2.0 => ((-0.5 * x + 2.5) * x - 4.0) * x + 2.0,
            _ => 0.0,
        }
    }
}

/// The shape of values on a grid, row-major: planar images have `outer` channels and `inner` 1, interleaved ones
/// `outer` 1 and `inner` channels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Grid {
    /// Images.
    pub outer: usize,
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
    /// Values in a cell.
    pub inner: usize,
}

impl Grid {
    fn len(self) -> usize {
        product([self.outer, self.height, self.width, self.inner])
    }
}

/// Taps of every output of an axis.
pub(super) struct Taps {
    /// First tap and number of taps.
    pub range: Vec<(usize, usize)>,
    /// Tap t of output i at `t·outputs + i`, 0 past the last.
    pub weight: Vec<f32>,
    /// Most taps of an output.
    pub most: usize,
}

impl Taps {
    pub fn new(filter: Filter, n: usize, m: usize) -> Self {
        let ratio = n as f64 / m as f64;
        let scale = ratio.max(1.0);
        let support = filter.radius() * scale;
        let mut range = Vec::with_capacity(m);
        for i in 0..m {
            let centre = ratio * (i as f64 + 0.5);
            let first = ((centre - support + 0.5).max(0.0) as usize).min(n - 1);
            let end = ((centre + support + 0.5) as usize).clamp(first + 1, n);
            range.push((first, end - first));
        }
        let most = range.iter().map(|r| r.1).max().unwrap_or(0);
        let mut weight = vec![0.0; most * m];
        for (i, &(first, count)) in range.iter().enumerate() {
            let centre = ratio * (i as f64 + 0.5);
            let at = |t: usize| filter.at(((first + t) as f64 + 0.5 - centre) / scale);
            let total = (0..count).fold(0.0, |sum, t| sum + at(t));
            for t in 0..count {
                weight[t * m + i] = (at(t) / total) as f32;
            }
        }
        Self { range, weight, most }
    }

    fn outputs(&self) -> usize {
        self.range.len()
    }
}

/// `source` in another size with [`Filter`]: `out` has the shape of `grid` with `dst_h` rows and `dst_w` columns.
///
/// # Panics
/// When a length does not fit its shape, or the source is empty and the result is not.
pub fn antialiased(
    level: Level,
    filter: Filter,
    source: &[f32],
    grid: Grid,
    dst_h: usize,
    dst_w: usize,
    out: &mut [f32],
) {
    let Grid { outer, height, width, inner } = grid;
    assert_eq!(source.len(), grid.len(), "source of shape {grid:?}");
    assert_eq!(
        out.len(),
        Grid { height: dst_h, width: dst_w, ..grid }.len(),
        "result of {dst_h}×{dst_w} from {grid:?}"
    );
    if out.is_empty() {
        return;
    }
    assert!(height > 0 && width > 0, "a grid of {height}×{width} cannot be resized to {dst_h}×{dst_w}");
    let _span = debug_span!("resize", kind = ?filter, ?grid, dst_h, dst_w).entered();
    if height == dst_h && width == dst_w {
        out.copy_from_slice(source);
        return;
    }
    if height == dst_h {
        pass(level, &Taps::new(filter, width, dst_w), source, width, inner, out);
        return;
    }
    let rows = Taps::new(filter, height, dst_h);
    if width == dst_w {
        pass(level, &rows, source, height, width * inner, out);
        return;
    }
    let mut wide = vec![0.0; product([outer, height, dst_w, inner])];
    pass(level, &Taps::new(filter, width, dst_w), source, width, inner, &mut wide);
    pass(level, &rows, &wide, height, dst_w * inner, out);
}

/// [`antialiased`] with the triangle, on planar images `[channels, h, w]`.
///
/// # Panics
/// As [`antialiased`].
pub fn bilinear_antialiased(
    level: Level,
    source: &[f32],
    channels: usize,
    h: usize,
    w: usize,
    dst_h: usize,
    dst_w: usize,
    out: &mut [f32],
) {
    let grid = Grid { outer: channels, height: h, width: w, inner: 1 };
    antialiased(level, Filter::Triangle, source, grid, dst_h, dst_w, out);
}

/// [`antialiased`] with the cubic, on a grid of vectors `[h, w, channels]`.
///
/// # Panics
/// As [`antialiased`].
pub fn bicubic_antialiased(
    level: Level,
    source: &[f32],
    h: usize,
    w: usize,
    channels: usize,
    dst_h: usize,
    dst_w: usize,
    out: &mut [f32],
) {
    let grid = Grid { outer: 1, height: h, width: w, inner: channels };
    antialiased(level, Filter::Cubic, source, grid, dst_h, dst_w, out);
}

/// One axis: `source` `[any, n, inner]` to `out` `[any, outputs, inner]`.
fn pass(level: Level, taps: &Taps, source: &[f32], n: usize, inner: usize, out: &mut [f32]) {
    const ELEMENTS: usize = 8192;
    let m = taps.outputs();
    if inner == 1 {
        let rows = (ELEMENTS / m).max(1);
        parallel::for_each_chunk(out, rows * m, |task, out| {
            let source = &source[task * rows * n..][..out.len() / m * n];
            dispatch(level, Rows { taps, source, n, out });
        });
    } else {
        let cells = (ELEMENTS / inner).max(1);
        parallel::for_each_chunk(out, cells * inner, |task, out| {
            dispatch(level, Cells { taps, source, n, inner, first: task * cells, out });
        });
    }
}

/// Rows of single values: lanes are outputs.
struct Rows<'a> {
    taps: &'a Taps,
    source: &'a [f32],
    n: usize,
    out: &'a mut [f32],
}

impl Operation for Rows<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let m = self.taps.outputs();
        for (row, out) in self.source.chunks(self.n).zip(self.out.chunks_mut(m)) {
            for (i, out) in out.chunks_mut(LANES).enumerate() {
                let at = i * LANES..i * LANES + out.len();
                let ranges = &self.taps.range[at.clone()];
                let mut sum = s.splat(0.0);
                for t in 0..self.taps.most {
                    let mut lanes = [0.0; LANES];
                    for (lane, &(first, count)) in lanes.iter_mut().zip(ranges) {
                        // Past its last tap an output repeats it with weight 0.
                        *lane = row[first + t.min(count - 1)];
                    }
                    let weight = s.load_partial(&self.taps.weight[t * m..][at.clone()], 0.0);
                    let lanes = s.from_array(lanes);
                    sum = if t == 0 { s.mul(weight, lanes) } else { s.mul_add(weight, lanes, sum) };
                }
                s.store_partial(sum, out);
            }
        }
    }
}

/// Cells of several values: lanes are values of one cell.
struct Cells<'a> {
    taps: &'a Taps,
    source: &'a [f32],
    n: usize,
    inner: usize,
    /// The first cell of `out`, counted through all rows.
    first: usize,
    out: &'a mut [f32],
}

impl Operation for Cells<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let m = self.taps.outputs();
        for (cell, out) in self.out.chunks_mut(self.inner).enumerate() {
            let (row, i) = ((self.first + cell) / m, (self.first + cell) % m);
            let (first, count) = self.taps.range[i];
            let source = &self.source[(row * self.n + first) * self.inner..][..count * self.inner];
            for (k, out) in out.chunks_mut(LANES).enumerate() {
                let at = k * LANES..k * LANES + out.len();
                let mut sum = s.splat(0.0);
                for (t, values) in source.chunks(self.inner).enumerate() {
                    let weight = s.splat(self.taps.weight[t * m + i]);
                    let values = s.load_partial(&values[at.clone()], 0.0);
                    sum = if t == 0 { s.mul(weight, values) } else { s.mul_add(weight, values, sum) };
                }
                s.store_partial(sum, out);
            }
        }
    }
}
