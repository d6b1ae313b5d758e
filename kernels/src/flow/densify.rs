//! From patches to pixels.

#![expect(unsafe_code, reason = "tasks write rows of one field")]

use super::options::PATCH;
use super::pyramid::{Plane, ROWS};
use super::search::{Found, Grid};
use crate::Level;
use crate::parallel;
use crate::simd::{LANES, Operation, Simd, dispatch};

/// Returns the flow of every pixel, `u` and `v` `[h, w]`: the mean over the patches that contain it, weighted by 1 /
/// max(1, |difference|).
///
/// Patches are added in ascending order of rows, then columns.
pub(super) fn densify(level: Level, first: &Plane, second: &Plane, grid: &Grid, found: &[Found]) -> [Vec<f32>; 2] {
    let (h, w) = (first.h, first.w);
    let (mut u, mut v) = (vec![0.0; h * w], vec![0.0; h * w]);
    let (to_u, to_v) = (parallel::Disjoint::new(&mut u), parallel::Disjoint::new(&mut v));
    parallel::map_indexed(h.div_ceil(ROWS), |block| {
        let rows = block * ROWS..((block + 1) * ROWS).min(h);
        // SAFETY: blocks have different rows.
        let (u, v) = unsafe { (to_u.part(rows.start * w..rows.end * w), to_v.part(rows.start * w..rows.end * w)) };
        dispatch(level, Block { first, second, grid, found, rows, u, v });
    });
    [u, v]
}

struct Block<'a> {
    first: &'a Plane,
    second: &'a Plane,
    grid: &'a Grid,
    found: &'a [Found],
    rows: std::ops::Range<usize>,
    u: &'a mut [f32],
    v: &'a mut [f32],
}

impl Operation for Block<'_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let Block { first, second, grid, found, rows, u, v } = self;
        // Three sums a row: weight, weight · u, weight · v. A vector that starts in a patch's last column ends inside.
        let w = first.w;
        let width = w.max(PATCH) + LANES;
        let mut sums = vec![0.0; 3 * width * rows.len()];
        // The lanes of a patch's row.
        let inside = s.mask_from_bits(((1_u32 << PATCH) - 1) as u16);
        for (i, &y) in grid.ys.iter().enumerate() {
            let covered = y.max(rows.start)..(y + PATCH).min(rows.end);
            if covered.is_empty() {
                continue;
            }
            for (j, &x) in grid.xs.iter().enumerate() {
                let f = found[i * grid.xs.len() + j];
                let pad = super::pyramid::PAD as f32;
                let (px, py) = (x as f32 + f.u + pad, y as f32 + f.v + pad);
                let (cx, cy) = (px as usize, py as usize);
                let (fx, fy) = (s.splat(px - cx as f32), s.splat(py - cy as f32));
                let (u, v) = (s.splat(f.u), s.splat(f.v));
                let mut upper = between(s, second, (cy + covered.start - y) * second.stride + cx, fx);
                for row in covered.clone() {
                    let lower = between(s, second, (cy + row + 1 - y) * second.stride + cx, fx);
                    let moved = s.mul_add(fy, s.sub(lower, upper), upper);
                    upper = lower;
                    let own = s.load(&first.data[first.at(row as isize, x as isize)..]);
                    let difference = s.abs(s.sub(moved, own));
                    let weight = s.div(s.splat(1.0), s.max(difference, s.splat(1.0)));
                    let weight = s.keep(inside, weight);
                    let sums = &mut sums[3 * width * (row - rows.start)..][..3 * width];
                    let (sum, rest) = sums.split_at_mut(width);
                    let (sum_u, sum_v) = rest.split_at_mut(width);
                    s.store(s.add(s.load(&sum[x..]), weight), &mut sum[x..]);
                    s.store(s.mul_add(weight, u, s.load(&sum_u[x..])), &mut sum_u[x..]);
                    s.store(s.mul_add(weight, v, s.load(&sum_v[x..])), &mut sum_v[x..]);
                }
            }
        }
        for (row, (u, v)) in u.chunks_mut(w).zip(v.chunks_mut(w)).enumerate() {
            let sums = &sums[3 * width * row..][..3 * width];
            for x in (0..w).step_by(LANES) {
                let n = LANES.min(w - x);
                let take = |k: usize| s.load_partial(&sums[k * width + x..][..n], 1.0);
                let weight = take(0);
                s.store_partial(s.div(take(1), weight), &mut u[x..x + n]);
                s.store_partial(s.div(take(2), weight), &mut v[x..x + n]);
            }
        }
    }
}

/// A row from `start` on, moved by a part of a pixel.
#[inline(always)]
fn between<S: Simd>(s: S, plane: &Plane, start: usize, fx: S::F32) -> S::F32 {
    let (a, b) = (s.load(&plane.data[start..]), s.load(&plane.data[start + 1..]));
    s.mul_add(fx, s.sub(b, a), a)
}
