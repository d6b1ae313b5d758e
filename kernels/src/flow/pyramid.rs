//! One frame at every scale, with its gradient.

use std::ops::{Deref, DerefMut};

use tracing::debug_span;

use super::options::{FlowError, Options, PATCH};
use crate::memory::Scratch;
use crate::parallel::for_each_chunk;
use crate::simd::{LANES, Operation, Simd, dispatch};
use crate::{Level, parallel};

/// Values beyond the picture on every side of a [`Plane`]: a patch overlaps the picture by a row or column at least.
pub(super) const PAD: usize = PATCH;

/// Rows of a task.
pub(super) const ROWS: usize = 16;

/// A plane with [`PAD`] values beyond every side.
pub(super) struct Plane<D = Vec<f32>> {
    pub w: usize,
    pub h: usize,
    pub stride: usize,
    pub data: D,
}

/// Values of a plane. A vector that starts on the last value inside still ends inside.
fn values([h, w]: [usize; 2]) -> usize {
    (w + 2 * PAD) * (h + 2 * PAD) + LANES
}

impl Plane {
    /// Zeros.
    pub fn new(size @ [h, w]: [usize; 2]) -> Self {
        Self { w, h, stride: w + 2 * PAD, data: vec![0.0; values(size)] }
    }
}

impl Plane<Scratch> {
    /// Unspecified values.
    pub fn scratch(size @ [h, w]: [usize; 2]) -> Self {
        Self { w, h, stride: w + 2 * PAD, data: Scratch::take(values(size)) }
    }
}

impl<D: Deref<Target = [f32]>> Plane<D> {
    /// Index of the value at row `y` and column `x`, both from −[`PAD`] on.
    #[inline(always)]
    pub fn at(&self, y: isize, x: isize) -> usize {
        ((y + PAD as isize) * self.stride as isize + x + PAD as isize) as usize
    }

    /// Row `y` inside the picture.
    #[inline(always)]
    pub fn row(&self, y: usize) -> &[f32] {
        let start = self.at(y as isize, 0);
        &self.data[start..start + self.w]
    }
}

impl<D: DerefMut<Target = [f32]>> Plane<D> {
    /// The rows inside the picture, with the border to their left and right.
    pub fn inside(&mut self) -> &mut [f32] {
        let (stride, h) = (self.stride, self.h);
        &mut self.data[PAD * stride..(PAD + h) * stride]
    }

    /// Calls `work(y, row)` for the rows inside the picture, in tasks of [`ROWS`] rows on `level`.
    pub fn fill<F: Fn(usize, &mut [f32]) + Sync>(&mut self, level: Level, work: F) {
        let (stride, w) = (self.stride, self.w);
        for_each_chunk(self.inside(), ROWS * stride, |index, rows| {
            dispatch(level, Rows { rows, stride, w, first: index * ROWS, work: &work });
        });
    }

    /// Repeats the values at the border outwards.
    pub fn replicate(&mut self) {
        let (stride, w, h) = (self.stride, self.w, self.h);
        for row in self.inside().chunks_mut(stride) {
            let (first, last) = (row[PAD], row[PAD + w - 1]);
            row[..PAD].fill(first);
            row[PAD + w..].fill(last);
        }
        for i in 0..PAD {
            self.data.copy_within(PAD * stride..(PAD + 1) * stride, i * stride);
            self.data.copy_within((PAD + h - 1) * stride..(PAD + h) * stride, (PAD + h + i) * stride);
        }
    }
}

/// Plain loops over rows, compiled for a level: nothing in them is fused or reordered.
struct Rows<'a, F> {
    rows: &'a mut [f32],
    stride: usize,
    w: usize,
    first: usize,
    work: &'a F,
}

impl<F: Fn(usize, &mut [f32])> Operation for Rows<'_, F> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        for (i, row) in self.rows.chunks_mut(self.stride).enumerate() {
            (self.work)(self.first + i, &mut row[PAD..PAD + self.w]);
        }
    }
}

/// A frame at one scale: luma from 0 to 255 and its derivatives, which are 0 outside.
pub(super) struct Scale {
    pub luma: Plane,
    pub dx: Plane,
    pub dy: Plane,
}

impl Scale {
    fn new(level: Level, luma: Plane) -> Self {
        let size = [luma.h, luma.w];
        let (mut dx, mut dy) = (Plane::new(size), Plane::new(size));
        let around = |y: usize| {
            let start = |y: isize| luma.at(y, -1);
            let y = y as isize;
            [start(y - 1), start(y), start(y + 1)].map(|start| &luma.data[start..start + luma.w + 2])
        };
        dx.fill(level, |y, out| {
            let n = out.len();
            let [a, b, c] = around(y).map(|row| &row[..n + 2]);
            for x in 0..n {
                out[x] = ((a[x + 2] - a[x]) + (c[x + 2] - c[x])) * 0.125 + (b[x + 2] - b[x]) * 0.25;
            }
        });
        dy.fill(level, |y, out| {
            let n = out.len();
            let [a, _, c] = around(y).map(|row| &row[..n + 2]);
            for x in 0..n {
                out[x] = ((c[x] - a[x]) + (c[x + 2] - a[x + 2])) * 0.125 + (c[x + 1] - a[x + 1]) * 0.25;
            }
        });
        Self { luma, dx, dy }
    }
}

/// Luma of one frame at every scale with its derivatives. Built once, it is used for the pairs with the frame before
/// and the frame after, in both directions.
///
/// Scale k + 1 has half the rows and columns of scale k, rounded up; a value is the mean of 2×2, the border repeated.
/// Derivatives are Sobel's, a central difference with the weights ¼, ½, ¼ across.
pub struct Pyramid {
    pub(super) size: [usize; 2],
    /// The scale of the first of `scales`.
    pub(super) finest: usize,
    pub(super) scales: Vec<Scale>,
}

impl Pyramid {
    /// The pyramid of `luma` `[h, w]`, whose values are from 0 to 1 (others are clamped).
    ///
    /// # Errors
    /// A value that is not finite; a picture without pixels, with a side above 2¹⁶ or with more than 2²⁸ pixels; a
    /// weight of `options` that is not from 0 to 10⁶.
    ///
    /// # Panics
    /// When `luma` does not fit `size`.
    pub fn new(level: Level, luma: &[f32], size: [usize; 2], options: &Options) -> Result<Pyramid, FlowError> {
        let [h, w] = size;
        if !FlowError::allows(size) {
            return Err(FlowError::Size { size });
        }
        options.check()?;
        assert_eq!(luma.len(), h * w, "luma of shape [{h}, {w}]");
        let _span = debug_span!("flow", step = "pyramid", h, w).entered();
        let blocks = luma.len().div_ceil(1 << 16);
        let bad = parallel::map_indexed(blocks, |i| {
            let start = i << 16;
            let block = &luma[start..luma.len().min(start + (1 << 16))];
            block.iter().position(|x| !x.is_finite()).map(|at| start + at)
        });
        if let Some(index) = bad.into_iter().flatten().next() {
            return Err(FlowError::NotFinite { row: index / w, column: index % w });
        }
        let mut plane = Plane::new(size);
        plane.fill(level, |y, out| {
            for (out, x) in out.iter_mut().zip(&luma[y * w..][..w]) {
                *out = x.clamp(0.0, 1.0) * 255.0;
            }
        });
        plane.replicate();
        let coarsest = options.coarsest(size);
        let finest = options.finest.min(coarsest);
        let mut scales = Vec::with_capacity(coarsest + 1 - finest);
        for scale in 0..=coarsest {
            let next = (scale < coarsest).then(|| halve(level, &plane));
            if scale >= finest {
                scales.push(Scale::new(level, plane));
            }
            match next {
                Some(next) => plane = next,
                None => break,
            }
        }
        Ok(Pyramid { size, finest, scales })
    }

    /// Rows and columns of the frame.
    pub fn size(&self) -> [usize; 2] {
        self.size
    }
}

/// The next scale.
fn halve(level: Level, plane: &Plane) -> Plane {
    let mut half = Plane::new([plane.h.div_ceil(2), plane.w.div_ceil(2)]);
    half.fill(level, |y, out| {
        let n = out.len();
        let row = |y: usize| &plane.data[plane.at(y as isize, 0)..][..2 * n];
        let (a, b) = (row(2 * y), row(2 * y + 1));
        for x in 0..n {
            out[x] = ((a[2 * x] + a[2 * x + 1]) + (b[2 * x] + b[2 * x + 1])) * 0.25;
        }
    });
    half.replicate();
    half
}
