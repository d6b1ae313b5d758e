//! Fields of displacements, and pictures displaced by them.

#![expect(unsafe_code, reason = "tasks write rows of one field")]

use tracing::debug_span;

use super::FlowError;
use super::sample::{Sampler, sample_one};
use crate::Level;
use crate::parallel::{Disjoint, map_indexed};
use crate::simd::{LANES, Operation, Simd, dispatch};
use crate::size::product;

/// Rows of a task.
const ROWS: usize = 16;

/// A displacement for every pixel, in pixels: `u` to the right, `v` down, both `[h, w]`.
#[derive(Clone, Debug, PartialEq)]
pub struct Field {
    /// Rows and columns.
    pub size: [usize; 2],
    /// To the right.
    pub u: Vec<f32>,
    /// Down.
    pub v: Vec<f32>,
}

/// Computes `N` planes `[h, w]` vector by vector, in tasks of [`ROWS`] rows.
pub(super) fn planes<const N: usize, W>(level: Level, size: [usize; 2], out: &mut [f32], work: &W)
where
    W: Work<N> + Sync,
{
    let [h, w] = size;
    assert_eq!(out.len(), N * h * w, "{N} planes of shape [{h}, {w}]");
    let parts = Disjoint::new(out);
    map_indexed(h.div_ceil(ROWS), |block| {
        let rows = block * ROWS..((block + 1) * ROWS).min(h);
        let out: [&mut [f32]; N] = std::array::from_fn(|k| {
            let start = k * h * w;
            // SAFETY: tasks have different rows.
            unsafe { parts.part(start + rows.start * w..start + rows.end * w) }
        });
        dispatch(level, Block { work, rows: rows.clone(), w, out });
    });
}

/// Work on a vector of pixels, on any level.
pub(super) trait Work<const N: usize> {
    /// The values of the `n` pixels of row `y` from column `x` on.
    fn pixels<S: Simd>(&self, s: S, y: usize, x: usize, n: usize) -> [S::F32; N];
}

struct Block<'a, W, const N: usize> {
    work: &'a W,
    rows: std::ops::Range<usize>,
    w: usize,
    out: [&'a mut [f32]; N],
}

impl<W: Work<N>, const N: usize> Operation for Block<'_, W, N> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        for (i, y) in self.rows.enumerate() {
            for x in (0..self.w).step_by(LANES) {
                let n = LANES.min(self.w - x);
                let values = self.work.pixels(s, y, x, n);
                for k in 0..N {
                    s.store_partial(values[k], &mut self.out[k][i * self.w + x..][..n]);
                }
            }
        }
    }
}

impl Field {
    pub(super) fn check(&self) {
        let [h, w] = self.size;
        assert!(FlowError::allows(self.size), "{}", FlowError::Size { size: self.size });
        assert!(self.u.len() == h * w && self.v.len() == h * w, "a field of shape [2, {h}, {w}]");
    }

    pub(super) fn sampler(&self) -> Sampler {
        let [h, w] = self.size;
        Sampler { h, w, stride: w }
    }

    /// The displacements of `n` pixels.
    #[inline(always)]
    pub(super) fn load<S: Simd>(&self, s: S, y: usize, x: usize, n: usize) -> [S::F32; 2] {
        let at = y * self.size[1] + x;
        [s.load_partial(&self.u[at..at + n], 0.0), s.load_partial(&self.v[at..at + n], 0.0)]
    }

    /// No motion.
    ///
    /// # Panics
    /// When memory for it cannot be allocated.
    pub fn zero(size: [usize; 2]) -> Field {
        let pixels = product(size);
        Field { size, u: vec![0.0; pixels], v: vec![0.0; pixels] }
    }

    /// The displacement at column `x`, row `y`: bilinear, the border repeated.
    ///
    /// # Panics
    /// On a field without pixels, or without exactly one displacement per pixel.
    pub fn at(&self, x: f32, y: f32) -> [f32; 2] {
        assert!(!self.u.is_empty(), "a field without pixels");
        [sample_one(&self.u, self.size, x, y), sample_one(&self.v, self.size, x, y)]
    }

    /// This field followed by `next`: `f(x) + next(x + f(x))`.
    ///
    /// # Panics
    /// When the sizes differ, or a [`Pyramid`](super::Pyramid) cannot have them.
    pub fn then(&self, level: Level, next: &Field) -> Field {
        let [u, v] = self.carried(level, next, "then");
        Field { size: self.size, u, v }
    }

    /// The forward–backward error `|f(x) + back(x + f(x))|` of every pixel, in pixels.
    ///
    /// # Panics
    /// When the sizes differ, or a [`Pyramid`](super::Pyramid) cannot have them.
    pub fn round_trip(&self, level: Level, back: &Field) -> Vec<f32> {
        let [u, mut v] = self.carried(level, back, "round trip");
        for (v, u) in v.iter_mut().zip(&u) {
            *v = (u * u + *v * *v).sqrt();
        }
        v
    }

    fn carried(&self, level: Level, next: &Field, step: &'static str) -> [Vec<f32>; 2] {
        self.check();
        next.check();
        assert_eq!(self.size, next.size, "fields of different sizes");
        let [h, w] = self.size;
        let _span = debug_span!("flow", step, h, w).entered();
        let mut out = vec![0.0; 2 * h * w];
        planes(level, self.size, &mut out, &Carry { first: self, next });
        let v = out.split_off(h * w);
        [out, v]
    }
}

struct Carry<'a> {
    first: &'a Field,
    next: &'a Field,
}

impl Work<2> for Carry<'_> {
    #[inline(always)]
    fn pixels<S: Simd>(&self, s: S, y: usize, x: usize, n: usize) -> [S::F32; 2] {
        let [u, v] = self.first.load(s, y, x, n);
        let sampler = self.next.sampler();
        let taps = sampler.taps(s, sampler.columns(s, x, u), sampler.row(s, y, v));
        [s.add(u, taps.take(s, &self.next.u)), s.add(v, taps.take(s, &self.next.v))]
    }
}

/// `image` `[3, h, w]` at x + f(x): bilinear, the border repeated.
///
/// # Panics
/// When a length does not fit `size`, or a [`Pyramid`](super::Pyramid) has no such size.
pub fn warp(level: Level, image: &[f32], size: [usize; 2], field: &Field) -> Vec<f32> {
    let [h, w] = size;
    field.check();
    assert_eq!(field.size, size, "a field of another size");
    assert_eq!(image.len(), 3 * h * w, "an image of shape [3, {h}, {w}]");
    let _span = debug_span!("flow", step = "warp", h, w).entered();
    let mut out = vec![0.0; 3 * h * w];
    planes(level, size, &mut out, &Moved { image, field });
    out
}

struct Moved<'a> {
    image: &'a [f32],
    field: &'a Field,
}

impl Work<3> for Moved<'_> {
    #[inline(always)]
    fn pixels<S: Simd>(&self, s: S, y: usize, x: usize, n: usize) -> [S::F32; 3] {
        let [u, v] = self.field.load(s, y, x, n);
        let sampler = self.field.sampler();
        colours(s, sampler, self.image, y, x, [u, v])
    }
}

/// Three channels at a displacement.
#[inline(always)]
pub(super) fn colours<S: Simd>(
    s: S,
    sampler: Sampler,
    image: &[f32],
    y: usize,
    x: usize,
    [u, v]: [S::F32; 2],
) -> [S::F32; 3] {
    let taps = sampler.taps(s, sampler.columns(s, x, u), sampler.row(s, y, v));
    let area = sampler.h * sampler.w;
    let mut colours = [s.splat(0.0); 3];
    for k in 0..3 {
        colours[k] = taps.take(s, &image[k * area..][..area]);
    }
    colours
}
