//! Red-black over-relaxation of the system that `refine.rs` assembles.
//!
//! A half-step updates the pixels of one colour, whose neighbours all have the other colour. No update reads another of
//! the same half-step, so neither their order nor their division into tasks changes a bit. The half-steps of a solve
//! run in bands of rows that stay in the cache. First comes a trapezoid of every band, which shrinks by a row on either
//! side per half-step; then the gaps between the bands, which grow likewise.

#![expect(unsafe_code, reason = "tasks update rows of one field, whose neighbours are read by pointer")]

use super::split::{Columns, Places, Split};
use crate::Level;
use crate::parallel::{Disjoint, map_indexed};
use crate::simd::{LANES, Operation, Simd, dispatch};

// Kinds of the system, in the order in which `refine.rs` writes them.
/// The weight of the edge to the pixel on the right.
const EDGE_X: usize = 0;
/// The weight of the edge to the pixel below.
const EDGE_Y: usize = 1;
/// The element off the diagonal.
const A12: usize = 2;
/// The inverses of the elements on the diagonal, 0 outside the picture.
const INVERSE_U: usize = 3;
const INVERSE_V: usize = 4;
/// The right-hand side.
const RIGHT_U: usize = 5;
const RIGHT_V: usize = 6;
/// Values of a pixel in the system.
pub(super) const SYSTEM: usize = 7;

/// Steps of a solve.
const STEPS: usize = 5;
const HALF_STEPS: usize = 2 * STEPS;
/// Over-relaxation.
const OMEGA: f32 = 1.6;

/// `STEPS` steps on `flow`.
pub(super) fn relax(level: Level, columns: &Columns, h: usize, system: &Split<SYSTEM>, flow: &mut Split<2>) {
    let bands = (h / (2 * HALF_STEPS)).max(1);
    let border = |band: usize| band * h / bands;
    let places = flow.places;
    let shared = Disjoint::new(&mut flow.data);
    let run = |rows: &(dyn Fn(usize) -> [usize; 2] + Sync)| {
        dispatch(level, Band { columns, system, places, flow: &shared, rows });
    };
    map_indexed(bands, |band| {
        let (top, bottom) = (border(band), border(band + 1));
        run(&|half| {
            let shrunk = |at: usize, by: usize| if at == 0 || at == h { 0 } else { by };
            [top + shrunk(top, half), bottom - shrunk(bottom, half)]
        });
    });
    map_indexed(bands - 1, |gap| {
        let middle = border(gap + 1);
        run(&|half| [middle - half, middle + half]);
    });
}

/// Half-steps on the rows `rows(half-step)`.
struct Band<'a, 'b> {
    columns: &'a Columns,
    system: &'a Split<SYSTEM>,
    places: Places<2>,
    flow: &'a Disjoint<'b, f32>,
    rows: &'a (dyn Fn(usize) -> [usize; 2] + Sync),
}

impl Operation for Band<'_, '_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let (places, system) = (self.places, self.system);
        // SAFETY: tasks that run at the same time write different rows, and none reads the colour of a row that another
        // writes.
        let flow = unsafe { self.flow.parts(0, self.flow.len()) };
        for half in 0..HALF_STEPS {
            let [top, bottom] = (self.rows)(half);
            for y in top..bottom {
                let y = y as isize;
                // The colour that is updated: even columns of even rows first. Its neighbours to the left and right
                // have the other parity.
                let own = (y as usize + half) & 1;
                let other = 1 - own;
                let end = places.start(y + 1, 1, 1) + self.columns.whole + 1;
                let end_of_system = system.places.start(y, 1, SYSTEM - 1) + self.columns.whole;
                assert!(end <= self.flow.len() && end_of_system <= system.data.len());
                let around = |parity: usize, row: isize, kind: usize| places.start(y + row, parity, kind);
                let at = |kind: usize| system.places.start(y, own, kind);
                let above = system.places.start(y - 1, own, EDGE_Y);
                // One before the left neighbour of the same index.
                let beside = system.places.start(y, other, EDGE_X) + own - 1;
                let (u, v) = (around(own, 0, 0), around(own, 0, 1));
                let sides = around(other, 0, 0) + own - 1;
                let rows = [around(own, -1, 0), around(own, 1, 0)];
                let starts = Starts {
                    flow: [u, v],
                    near: [sides, sides + 1, rows[0], rows[1]],
                    kinds: v - u,
                    edges: [beside, at(EDGE_X), above, at(EDGE_Y)],
                    across: at(A12),
                    inverse: [at(INVERSE_U), at(INVERSE_V)],
                    right: [at(RIGHT_U), at(RIGHT_V)],
                };
                for column in (0..self.columns.whole).step_by(LANES) {
                    // SAFETY: vectors of rows between zeros, inside both planes as asserted; nothing else writes these
                    // rows now.
                    unsafe { starts.step(s, system.data.as_ptr().add(column), flow.add(column)) };
                }
            }
        }
    }
}

/// Where the values of a row of pixels and of their neighbours start.
struct Starts {
    flow: [usize; 2],
    /// Left, right, above, below, for u.
    near: [usize; 4],
    /// From u to v.
    kinds: usize,
    edges: [usize; 4],
    across: usize,
    inverse: [usize; 2],
    right: [usize; 2],
}

impl Starts {
    /// Updates one vector.
    ///
    /// # Safety
    /// Both planes hold a vector at all of the starts.
    #[inline(always)]
    unsafe fn step<S: Simd>(&self, s: S, system: *const f32, flow: *mut f32) {
        // SAFETY: the caller's.
        unsafe {
            let omega = s.splat(OMEGA);
            let (mut sum_u, mut sum_v) = (s.load_ptr(system.add(self.right[0])), s.load_ptr(system.add(self.right[1])));
            for i in 0..4 {
                let edge = s.load_ptr(system.add(self.edges[i]));
                sum_u = s.mul_add(edge, s.load_ptr(flow.add(self.near[i])), sum_u);
                sum_v = s.mul_add(edge, s.load_ptr(flow.add(self.near[i] + self.kinds)), sum_v);
            }
            let across = s.load_ptr(system.add(self.across));
            let (u, v) = (s.load_ptr(flow.add(self.flow[0])), s.load_ptr(flow.add(self.flow[1])));
            let goal = s.mul(s.neg_mul_add(across, v, sum_u), s.load_ptr(system.add(self.inverse[0])));
            let u = s.mul_add(omega, s.sub(goal, u), u);
            let goal = s.mul(s.neg_mul_add(across, u, sum_v), s.load_ptr(system.add(self.inverse[1])));
            let v = s.mul_add(omega, s.sub(goal, v), v);
            s.store_ptr(u, flow.add(self.flow[0]));
            s.store_ptr(v, flow.add(self.flow[1]));
        }
    }
}
