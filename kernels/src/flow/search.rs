//! Inverse search: the displacement of every patch.

#![expect(unsafe_code, reason = "rows of patches are read by pointer")]

use super::options::{Options, PATCH};
use super::pyramid::{PAD, Plane, Scale};
use crate::Level;
use crate::parallel::for_each_chunk;
use crate::simd::{Operation, Simd, dispatch};

/// Vectors of a patch, two rows each.
const VECTORS: usize = PATCH / 2;
/// Rows of patches of a task. Motion propagates inside a task and, between the passes, across tasks.
const STRIPE: usize = 6;
/// Added to the diagonal of the structure tensor: 64 pixels with a gradient of 1 level per pixel. Keeps flat patches
/// where they are.
const DAMPING: f32 = 64.0;
/// The squared step in pixels² under which a patch has settled.
const SETTLED: f32 = 1e-4;
/// Candidates nearer to each other than this, squared, are one.
const SAME: f32 = 1e-2;

/// Places of a picture's patches: every `stride` pixels, the last ones flush with the far border.
pub(super) struct Grid {
    pub ys: Vec<usize>,
    pub xs: Vec<usize>,
}

impl Grid {
    pub fn new([h, w]: [usize; 2], stride: usize) -> Self {
        let places = |n: usize| {
            let last = n.saturating_sub(PATCH);
            (0..=last.div_ceil(stride)).map(|i| (i * stride).min(last)).collect()
        };
        Self { ys: places(h), xs: places(w) }
    }
}

/// A patch's displacement and its cost: the squared differences after both patches' means are subtracted.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Found {
    pub u: f32,
    pub v: f32,
    pub cost: f32,
}

/// A displacement for a patch whose middle is at (x, y) of this scale, if there is one.
pub(super) trait Guess: Fn(f32, f32) -> Option<[f32; 2]> + Sync {}
impl<F: Fn(f32, f32) -> Option<[f32; 2]> + Sync> Guess for F {}

/// Displacements of the patches of `grid`, row by row.
pub(super) fn search(
    level: Level,
    first: &Scale,
    second: &Plane,
    grid: &Grid,
    guesses: &[&dyn Guess],
    options: &Options,
) -> Vec<Found> {
    let columns = grid.xs.len();
    let mut found = vec![Found::default(); grid.ys.len() * columns];
    for_each_chunk(&mut found, STRIPE * columns, |index, found| {
        let stripe = Stripe { first, second, grid, row: index * STRIPE, iterations: options.iterations };
        dispatch(level, Forward { stripe, guesses, found });
    });
    let mut last = found.clone();
    for_each_chunk(&mut last, STRIPE * columns, |index, last| {
        let stripe = Stripe { first, second, grid, row: index * STRIPE, iterations: options.iterations };
        dispatch(level, Backward { stripe, before: &found, last });
    });
    last
}

/// Some rows of patches.
struct Stripe<'a> {
    first: &'a Scale,
    second: &'a Plane,
    grid: &'a Grid,
    /// The first row.
    row: usize,
    iterations: usize,
}

/// First pass: guesses, the patch to the left and the one above.
struct Forward<'a> {
    stripe: Stripe<'a>,
    guesses: &'a [&'a dyn Guess],
    found: &'a mut [Found],
}

impl Operation for Forward<'_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let Stripe { first, second, grid, row, iterations } = self.stripe;
        let columns = grid.xs.len();
        for i in 0..self.found.len() / columns {
            for j in 0..columns {
                let (y, x) = (grid.ys[row + i], grid.xs[j]);
                let patch = Patch::new(s, first, second, y, x);
                let middle = (PATCH - 1) as f32 * 0.5;
                let mut best = Best::new();
                for guess in self.guesses {
                    if let Some(guess) = guess(x as f32 + middle, y as f32 + middle) {
                        best.offer(s, &patch, guess);
                    }
                }
                if j > 0 {
                    let f = self.found[i * columns + j - 1];
                    best.offer(s, &patch, [f.u, f.v]);
                }
                if i > 0 {
                    let f = self.found[(i - 1) * columns + j];
                    best.offer(s, &patch, [f.u, f.v]);
                }
                self.found[i * columns + j] = patch.descend(s, best.sums, iterations);
            }
        }
    }
}

/// Second pass, from the last patch to the first: the patch to the right and the one below.
struct Backward<'a> {
    stripe: Stripe<'a>,
    before: &'a [Found],
    last: &'a mut [Found],
}

impl Operation for Backward<'_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let Stripe { first, second, grid, row, iterations } = self.stripe;
        let columns = grid.xs.len();
        let rows = self.last.len() / columns;
        for i in (0..rows).rev() {
            for j in (0..columns).rev() {
                let own = self.last[i * columns + j];
                let mut near = [own; 3];
                if j + 1 < columns {
                    near[0] = self.last[i * columns + j + 1];
                }
                if i + 1 < rows {
                    near[1] = self.last[(i + 1) * columns + j];
                } else if row + i + 1 < grid.ys.len() {
                    near[1] = self.before[(row + i + 1) * columns + j];
                }
                if i == 0 && row > 0 {
                    near[2] = self.before[(row - 1) * columns + j];
                }
                if near.iter().all(|f| is_same([f.u, f.v], [own.u, own.v])) {
                    continue;
                }
                let patch = Patch::new(s, first, second, grid.ys[row + i], grid.xs[j]);
                let mut best = Best::new();
                best.sums.at = [own.u, own.v];
                best.sums.cost = own.cost;
                best.tried = 1;
                best.places[0] = best.sums.at;
                for f in near {
                    best.offer(s, &patch, [f.u, f.v]);
                }
                if best.sums.cost < own.cost {
                    self.last[i * columns + j] = patch.descend(s, best.sums, iterations);
                }
            }
        }
    }
}

#[inline(always)]
fn is_same(a: [f32; 2], b: [f32; 2]) -> bool {
    let (x, y) = (a[0] - b[0], a[1] - b[1]);
    x * x + y * y < SAME
}

/// The cheapest of several displacements; of equals, the first.
struct Best {
    sums: Sums,
    places: [[f32; 2]; 8],
    tried: usize,
}

impl Best {
    #[inline(always)]
    fn new() -> Self {
        Self { sums: Sums { at: [0.0; 2], cost: f32::INFINITY, slope: [0.0; 2] }, places: [[0.0; 2]; 8], tried: 0 }
    }

    #[inline(always)]
    fn offer<S: Simd>(&mut self, s: S, patch: &Patch<'_, S>, at: [f32; 2]) {
        if self.tried == self.places.len() || self.places[..self.tried].iter().any(|&place| is_same(place, at)) {
            return;
        }
        self.places[self.tried] = at;
        self.tried += 1;
        let sums = patch.at(s, at);
        if sums.cost < self.sums.cost {
            self.sums = sums;
        }
    }
}

/// A patch's differences at a displacement.
#[derive(Clone, Copy)]
struct Sums {
    at: [f32; 2],
    cost: f32,
    /// Σ difference · derivative
    slope: [f32; 2],
}

/// A patch of the first picture that is searched for in the second.
struct Patch<'a, S: Simd> {
    second: &'a Plane,
    y: f32,
    x: f32,
    luma: [S::F32; VECTORS],
    /// Derivatives minus their means, so that a change of brightness common to all pixels of a patch moves nothing.
    dx: [S::F32; VECTORS],
    dy: [S::F32; VECTORS],
    /// The inverse of Σ ∇∇ᵀ + damping: xx, xy, yy.
    inverse: [f32; 3],
}

impl<'a, S: Simd> Patch<'a, S> {
    #[inline(always)]
    fn new(s: S, first: &Scale, second: &'a Plane, y: usize, x: usize) -> Self {
        let luma = rows(s, &first.luma, y, x);
        let dx = centred(s, rows(s, &first.dx, y, x));
        let dy = centred(s, rows(s, &first.dy, y, x));
        let xx = dot(s, &dx, &dx) + DAMPING;
        let xy = dot(s, &dx, &dy);
        let yy = dot(s, &dy, &dy) + DAMPING;
        let scale = 1.0 / (xx * yy - xy * xy);
        Self { second, y: y as f32, x: x as f32, luma, dx, dy, inverse: [yy * scale, -(xy * scale), xx * scale] }
    }

    /// The differences at a displacement, which is first shortened until patch and picture overlap.
    #[inline(always)]
    fn at(&self, s: S, [u, v]: [f32; 2]) -> Sums {
        let pad = PAD as f32;
        let (px, py) = (clamp(self.x + u, self.second.w), clamp(self.y + v, self.second.h));
        let (cx, cy) = ((px + pad) as usize, (py + pad) as usize);
        let (fx, fy) = (px + pad - cx as f32, py + pad - cy as f32);
        let stride = self.second.stride;
        let start = cy * stride + cx;
        let rows = &self.second.data[start..start + PATCH * stride + PATCH + 1];
        let (fx, fy) = (s.splat(fx), s.splat(fy));
        let mut differences = [s.splat(0.0); VECTORS];
        for i in 0..VECTORS {
            // SAFETY: the last of nine rows of nine values ends with the slice.
            let [a, b, c, d] = unsafe {
                let first = rows.as_ptr().add(2 * i * stride);
                let (second, third) = (first.add(stride), first.add(2 * stride));
                [
                    s.load_halves(first, second),
                    s.load_halves(first.add(1), second.add(1)),
                    s.load_halves(second, third),
                    s.load_halves(second.add(1), third.add(1)),
                ]
            };
            let upper = s.mul_add(fx, s.sub(b, a), a);
            let lower = s.mul_add(fx, s.sub(d, c), c);
            differences[i] = s.sub(s.mul_add(fy, s.sub(lower, upper), upper), self.luma[i]);
        }
        let sum = s.sum(s.add(s.add(differences[0], differences[1]), s.add(differences[2], differences[3])));
        let squares = dot(s, &differences, &differences);
        let slope = [dot(s, &differences, &self.dx), dot(s, &differences, &self.dy)];
        let cost = squares - sum * sum * (1.0 / (PATCH * PATCH) as f32);
        Sums { at: [px - self.x, py - self.y], cost, slope }
    }

    /// Gauss–Newton steps from `sums` on, while they are larger than a hundredth of a pixel and the cost falls.
    #[inline(always)]
    fn descend(&self, s: S, start: Sums, iterations: usize) -> Found {
        let mut best = start;
        for _ in 0..iterations {
            let [gx, gy] = best.slope;
            let [xx, xy, yy] = self.inverse;
            let (dx, dy) = (xx * gx + xy * gy, xy * gx + yy * gy);
            if dx * dx + dy * dy < SETTLED {
                break;
            }
            let next = self.at(s, [best.at[0] - dx, best.at[1] - dy]);
            if next.cost >= best.cost {
                break;
            }
            best = next;
        }
        let (x, y) = (best.at[0] - start.at[0], best.at[1] - start.at[1]);
        if x * x + y * y > (PATCH * PATCH) as f32 {
            best = start;
        }
        Found { u: best.at[0], v: best.at[1], cost: best.cost }
    }
}

/// A patch's position on one axis, moved until it overlaps the picture.
#[inline(always)]
fn clamp(p: f32, n: usize) -> f32 {
    let p = if p < n as f32 - 1.0 { p } else { n as f32 - 1.0 };
    if p > -(PAD as f32) { p } else { -(PAD as f32) }
}

/// A patch of a plane, two rows a vector.
#[inline(always)]
fn rows<S: Simd>(s: S, plane: &Plane, y: usize, x: usize) -> [S::F32; VECTORS] {
    let start = plane.at(y as isize, x as isize);
    let rows = &plane.data[start..start + (PATCH - 1) * plane.stride + PATCH];
    let mut patch = [s.splat(0.0); VECTORS];
    for i in 0..VECTORS {
        // SAFETY: both rows end inside the slice.
        patch[i] = unsafe {
            let first = rows.as_ptr().add(2 * i * plane.stride);
            s.load_halves(first, first.add(plane.stride))
        };
    }
    patch
}

/// A patch minus its mean.
#[inline(always)]
fn centred<S: Simd>(s: S, mut patch: [S::F32; VECTORS]) -> [S::F32; VECTORS] {
    let sum = s.sum(s.add(s.add(patch[0], patch[1]), s.add(patch[2], patch[3])));
    let mean = s.splat(sum * (1.0 / (PATCH * PATCH) as f32));
    for i in 0..VECTORS {
        patch[i] = s.sub(patch[i], mean);
    }
    patch
}

/// Σ a·b: lanes by fused steps in ascending order of the vectors, then [`Simd::sum`].
#[inline(always)]
fn dot<S: Simd>(s: S, a: &[S::F32; VECTORS], b: &[S::F32; VECTORS]) -> f32 {
    let mut sum = s.mul(a[0], b[0]);
    for i in 1..VECTORS {
        sum = s.mul_add(a[i], b[i], sum);
    }
    s.sum(sum)
}
