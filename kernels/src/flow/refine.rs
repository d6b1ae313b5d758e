//! Variational refinement: the linear systems of the fixed-point iterations. `relax.rs` solves them.

use super::options::Options;
use super::pyramid::{Plane, ROWS};
use super::relax::{SYSTEM, relax};
use super::sample::{Sampler, column};
use super::split::{Columns, Places, Split};
use crate::Level;
use crate::memory::Scratch;
use crate::parallel::for_each_chunk;
use crate::simd::{LANES, Operation, Simd, dispatch};

/// ε², under every square root.
const EPSILON: f32 = 1e-6;
/// ζ², added to the squared gradients that normalise the data terms, and to the system's diagonal.
const ZETA: f32 = 1e-2;

/// Constants of a pixel: the flow W by which the pictures were warped, and the linearised data terms, each divided by
/// the length of its gradient. The terms are brightness, derivative along x and derivative along y, each as (x, y,
/// rest).
const CONSTANTS: usize = 11;

/// `flow` (`[h, w]` each) improved by `options.refinement` fixed-point iterations.
pub(super) fn refine(level: Level, first: &Plane, second: &Plane, flow: &mut [Vec<f32>; 2], options: &Options) {
    let (h, w) = (first.h, first.w);
    let columns = Columns::new(w);
    let mut constants = Split::<CONSTANTS>::new(h, &columns);
    let mut total = Split::<2>::new(h, &columns);
    let places = total.places;
    for (y, block) in total.inside().chunks_mut(places.block()).enumerate() {
        for (kind, plane) in flow.iter().enumerate() {
            places.put(block, kind, &plane[y * w..][..w]);
        }
    }
    linearise(level, first, second, flow, &mut constants);
    let mut system = Split::<SYSTEM>::new(h, &columns);
    for _ in 0..options.refinement {
        let (places, block) = (system.places, system.places.block());
        for_each_chunk(system.inside(), ROWS * block, |index, rows| {
            let first = index * ROWS;
            let (columns, constants, total) = (&columns, &constants, &total);
            dispatch(level, Assemble { rows, places, first, h, columns, constants, total, options });
        });
        relax(level, &columns, h, &system, &mut total);
    }
    for (kind, plane) in flow.iter_mut().enumerate() {
        for (y, row) in plane.chunks_mut(w).enumerate() {
            total.take(y, kind, row);
        }
    }
}

/// Warps the second picture by the flow and fills `constants`.
fn linearise(level: Level, first: &Plane, second: &Plane, flow: &[Vec<f32>; 2], constants: &mut Split<CONSTANTS>) {
    let size = [first.h, first.w];
    let [u, v] = flow;
    let mut change = Plane::scratch(size);
    let stride = change.stride;
    for_each_chunk(change.inside(), ROWS * stride, |index, rows| {
        dispatch(level, Warp { first, second, u, v, y: index * ROWS, rows, stride });
    });
    change.replicate();
    let mut mean = Plane::scratch(size);
    mean.fill(level, |y, out| {
        for (out, (a, d)) in out.iter_mut().zip(first.row(y).iter().zip(change.row(y))) {
            *out = a + 0.5 * d;
        }
    });
    mean.replicate();
    let (places, block) = (constants.places, constants.places.block());
    for_each_chunk(constants.inside(), ROWS * block, |index, rows| {
        dispatch(level, Normalise { mean: &mean, change: &change, u, v, y: index * ROWS, places, rows });
    });
}

/// The second picture at x + W less the first, for some rows.
struct Warp<'a> {
    first: &'a Plane,
    second: &'a Plane,
    u: &'a [f32],
    v: &'a [f32],
    y: usize,
    rows: &'a mut [f32],
    stride: usize,
}

impl Operation for Warp<'_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let Warp { first, second, u, v, .. } = self;
        let w = first.w;
        let sampler = Sampler { h: first.h, w, stride: second.stride };
        let image = &second.data[second.at(0, 0)..];
        for (i, row) in self.rows.chunks_mut(self.stride).enumerate() {
            let y = self.y + i;
            let row = &mut row[super::pyramid::PAD..][..w];
            for x in (0..w).step_by(LANES) {
                let n = LANES.min(w - x);
                let at = y * w + x;
                let (u, v) = (s.load_partial(&u[at..at + n], 0.0), s.load_partial(&v[at..at + n], 0.0));
                let taps = sampler.taps(s, sampler.columns(s, x, u), sampler.row(s, y, v));
                let own = s.load_partial(&first.row(y)[x..x + n], 0.0);
                s.store_partial(s.sub(taps.take(s, image), own), &mut row[x..x + n]);
            }
        }
    }
}

/// Constants of some rows.
struct Normalise<'a> {
    mean: &'a Plane<Scratch>,
    change: &'a Plane<Scratch>,
    u: &'a [f32],
    v: &'a [f32],
    y: usize,
    places: Places<CONSTANTS>,
    rows: &'a mut [f32],
}

/// Derivatives of three rows, row y at y mod 3, each with its first and last value repeated once outwards.
struct Slopes {
    w: usize,
    x: [Vec<f32>; 3],
    y: [Vec<f32>; 3],
}

impl Slopes {
    fn new(w: usize) -> Self {
        let rows = || [0; 3].map(|_| vec![0.0; w + 1 + 2 * LANES]);
        Self { w, x: rows(), y: rows() }
    }

    /// Half the differences of the neighbours.
    #[inline(always)]
    fn fill(&mut self, plane: &Plane<Scratch>, y: usize) {
        let w = self.w;
        let row = |y: isize| &plane.data[plane.at(y, -1)..][..w + 2];
        let (above, own, below) = (row(y as isize - 1), row(y as isize), row(y as isize + 1));
        let (dx, dy) = (&mut self.x[y % 3][..w + 2], &mut self.y[y % 3][..w + 2]);
        for x in 1..=w {
            dx[x] = 0.5 * (own[x + 1] - own[x - 1]);
            dy[x] = 0.5 * (below[x] - above[x]);
        }
        for row in [dx, dy] {
            row[0] = row[1];
            row[w + 1] = row[w];
        }
    }
}

/// ½(b − a)
#[inline(always)]
fn half_difference<S: Simd>(s: S, a: &[f32], b: &[f32]) -> S::F32 {
    s.mul(s.splat(0.5), s.sub(s.load(b), s.load(a)))
}

/// 1 / √(a² + b² + ζ²)
#[inline(always)]
fn inverse_length<S: Simd>(s: S, a: S::F32, b: S::F32) -> S::F32 {
    s.div(s.splat(1.0), s.sqrt(s.mul_add(a, a, s.mul_add(b, b, s.splat(ZETA)))))
}

impl Operation for Normalise<'_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let Normalise { mean, change, u, v, places, .. } = self;
        let (h, w) = (mean.h, mean.w);
        let whole = w.next_multiple_of(LANES);
        let mut row = vec![0.0; (CONSTANTS - 2) * whole];
        let mut slopes = Slopes::new(w);
        slopes.fill(mean, self.y.saturating_sub(1));
        slopes.fill(mean, self.y);
        let (bottom, right) = (s.splat((h - 1) as f32), s.splat((w - 1) as f32));
        let zero = s.splat(0.0);
        for (i, block) in self.rows.chunks_mut(places.block()).enumerate() {
            let y = self.y + i;
            let (above, below) = (y.saturating_sub(1), (y + 1).min(h - 1));
            if below > y {
                slopes.fill(mean, below);
            }
            let (u, v) = (&u[y * w..][..w], &v[y * w..][..w]);
            places.put(block, 0, u);
            places.put(block, 1, v);
            let dz_above = &change.data[change.at(y as isize - 1, -1)..];
            let dz_own = &change.data[change.at(y as isize, -1)..];
            let dz_below = &change.data[change.at(y as isize + 1, -1)..];
            for x in (0..w).step_by(LANES) {
                let n = LANES.min(w - x);
                let (own, next) = (x + 1, x + 2);
                let (dx, dy) = (s.load(&slopes.x[y % 3][own..]), s.load(&slopes.y[y % 3][own..]));
                let dz = s.load(&dz_own[own..]);
                let xx = half_difference(s, &slopes.x[y % 3][x..], &slopes.x[y % 3][next..]);
                let xy = half_difference(s, &slopes.x[above % 3][own..], &slopes.x[below % 3][own..]);
                let yy = half_difference(s, &slopes.y[above % 3][own..], &slopes.y[below % 3][own..]);
                let xz = half_difference(s, &dz_own[x..], &dz_own[next..]);
                let yz = half_difference(s, &dz_above[own..], &dz_below[own..]);
                // Outside the picture the data terms are 0.
                let at_x = s.add(s.load_partial(&u[x..x + n], 0.0), column(s, x));
                let at_y = s.add(s.load_partial(&v[x..x + n], 0.0), s.splat(y as f32));
                let inside = s.and(s.le(zero, at_x), s.le(at_x, right));
                let inside = s.and(inside, s.and(s.le(zero, at_y), s.le(at_y, bottom)));
                let brightness = s.keep(inside, inverse_length(s, dx, dy));
                let slope_x = s.keep(inside, inverse_length(s, xx, xy));
                let slope_y = s.keep(inside, inverse_length(s, xy, yy));
                let values = [dx, dy, dz, xx, xy, xz, xy, yy, yz];
                let scales = [brightness, slope_x, slope_y];
                for k in 0..CONSTANTS - 2 {
                    s.store(s.mul(values[k], scales[k / 3]), &mut row[k * whole + x..]);
                }
            }
            for kind in 2..CONSTANTS {
                places.put(block, kind, &row[(kind - 2) * whole..][..w]);
            }
        }
    }
}

/// The system of some rows at the present flow.
struct Assemble<'a> {
    rows: &'a mut [f32],
    places: Places<SYSTEM>,
    first: usize,
    h: usize,
    columns: &'a Columns,
    constants: &'a Split<CONSTANTS>,
    total: &'a Split<2>,
    options: &'a Options,
}

impl Operation for Assemble<'_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let Assemble { rows, places, first, h, columns, constants, total, options } = self;
        let whole = columns.whole;
        let edges = Edges { columns, total, h, alpha: options.smoothness };
        // Weights of the edges from the row above, even and odd columns.
        let mut above = [vec![0.0; whole], vec![0.0; whole]];
        let mut right = [vec![0.0; whole], vec![0.0; whole]];
        let mut below = [vec![0.0; whole], vec![0.0; whole]];
        if first > 0 {
            edges.row(s, first - 1, &mut right, &mut above);
        }
        for (i, block) in rows.chunks_mut(places.block()).enumerate() {
            let y = first + i;
            edges.row(s, y, &mut right, &mut below);
            for parity in 0..2 {
                for column in (0..whole).step_by(LANES) {
                    let constant = &constants.data[constants.places.start(y as isize, parity, 0) + column..];
                    let at = constants.places.step();
                    let flow = &total.data[total.places.start(y as isize, parity, 0) + column..];
                    let (w_u, w_v) = (s.load(constant), s.load(&constant[at..]));
                    let du = s.sub(s.load(flow), w_u);
                    let dv = s.sub(s.load(&flow[total.places.step()..]), w_v);
                    let mut terms = [[w_u; 3]; 3];
                    let mut rest = [w_u; 3];
                    for k in 0..3 {
                        for i in 0..3 {
                            terms[k][i] = s.load(&constant[at * (2 + 3 * k + i)..]);
                        }
                        rest[k] = s.mul_add(terms[k][0], du, s.mul_add(terms[k][1], dv, terms[k][2]));
                    }
                    let epsilon = s.splat(EPSILON);
                    let brightness = s.mul_add(rest[0], rest[0], epsilon);
                    let slope = s.mul_add(rest[1], rest[1], s.mul_add(rest[2], rest[2], epsilon));
                    let brightness = s.div(s.splat(options.brightness), s.sqrt(brightness));
                    let slope = s.div(s.splat(options.gradient), s.sqrt(slope));
                    let (mut a11, mut a12, mut a22) = (s.splat(ZETA), s.splat(0.0), s.splat(ZETA));
                    let (mut b1, mut b2) = (s.splat(0.0), s.splat(0.0));
                    let weights = [brightness, slope, slope];
                    for k in 0..3 {
                        let ([x, y, z], weight) = (terms[k], weights[k]);
                        let (wx, wy) = (s.mul(weight, x), s.mul(weight, y));
                        a11 = s.mul_add(wx, x, a11);
                        a12 = s.mul_add(wx, y, a12);
                        a22 = s.mul_add(wy, y, a22);
                        b1 = s.neg_mul_add(wx, z, b1);
                        b2 = s.neg_mul_add(wy, z, b2);
                    }
                    let b1 = s.mul_add(a11, w_u, s.mul_add(a12, w_v, b1));
                    let b2 = s.mul_add(a12, w_u, s.mul_add(a22, w_v, b2));
                    // The edge to the left is the one to the right of the neighbour there, which has the other parity.
                    let to_right = s.load(&right[parity][column..]);
                    let to_left = if parity == 1 {
                        s.load(&right[0][column..])
                    } else {
                        let mut lanes = [0.0; LANES];
                        let from = &right[1][column.saturating_sub(1)..];
                        let skip = usize::from(column == 0);
                        lanes[skip..].copy_from_slice(&from[..LANES - skip]);
                        s.from_array(lanes)
                    };
                    let to_below = s.load(&below[parity][column..]);
                    let to_above = s.load(&above[parity][column..]);
                    let edges = s.add(s.add(to_left, to_right), s.add(to_above, to_below));
                    let exists = s.load(&columns.exists[parity][column..]);
                    let inverse_u = s.div(exists, s.add(a11, edges));
                    let inverse_v = s.div(exists, s.add(a22, edges));
                    let out = &mut block[places.within(parity, 0) + column..];
                    let values = [to_right, to_below, a12, inverse_u, inverse_v, b1, b2];
                    for kind in 0..SYSTEM {
                        s.store(values[kind], &mut out[kind * places.step()..]);
                    }
                }
            }
            std::mem::swap(&mut above, &mut below);
        }
    }
}

/// Weights of the edges of the grid of pixels.
struct Edges<'a> {
    columns: &'a Columns,
    total: &'a Split<2>,
    h: usize,
    alpha: f32,
}

impl Edges<'_> {
    /// α / √(|∇u|² + |∇v|² + ε²) of row `y` with forward differences, for the edges to the right and down; 0 where
    /// there is none.
    #[inline(always)]
    fn row<S: Simd>(&self, s: S, y: usize, right: &mut [Vec<f32>; 2], below: &mut [Vec<f32>; 2]) {
        let last = s.splat(if y + 1 < self.h { 1.0 } else { 0.0 });
        let (places, data) = (self.total.places, &self.total.data);
        for parity in 0..2 {
            for column in (0..self.columns.whole).step_by(LANES) {
                let to_right = s.load(&self.columns.right[parity][column..]);
                let to_below = s.mul(last, s.load(&self.columns.exists[parity][column..]));
                let mut square = s.splat(EPSILON);
                for kind in 0..2 {
                    let start = places.start(y as isize, parity, kind) + column;
                    let beside = places.start(y as isize, 1 - parity, kind) + column + parity;
                    let own = s.load(&data[start..]);
                    let x = s.mul(to_right, s.sub(s.load(&data[beside..]), own));
                    let y = s.mul(to_below, s.sub(s.load(&data[start + places.block()..]), own));
                    square = s.mul_add(x, x, s.mul_add(y, y, square));
                }
                let weight = s.div(s.splat(self.alpha), s.sqrt(square));
                s.store(s.mul(weight, to_right), &mut right[parity][column..]);
                s.store(s.mul(weight, to_below), &mut below[parity][column..]);
            }
        }
    }
}
