//! Red-black over-relaxation of the system that `refine.rs` assembles.
//!
//! A half-step updates the pixels of one colour, whose neighbours all have the other: no update sees another of the same half-step, so
//! neither their order nor the tasks they are cut into change a bit. The half-steps of a solve are done in bands of rows that stay in the cache: first
//! a trapezoid of every band that shrinks by a row on either side a half-step, then the gaps between the bands, which grow likewise.

use super::split::{Columns, Places, Split};
use crate::Level;
use crate::parallel::{Disjoint, map_indexed};
use crate::simd::{LANES, Operation, Simd, dispatch};

/// The weight of the edge to the pixel on the right.
pub(super) const EDGE_X: usize = 0;
/// The weight of the edge to the pixel below.
pub(super) const EDGE_Y: usize = 1;
/// The element off the diagonal.
pub(super) const A12: usize = 2;
/// The inverses of the elements on the diagonal, 0 outside the picture.
pub(super) const INVERSE_U: usize = 3;
pub(super) const INVERSE_V: usize = 4;
/// The right-hand side.
pub(super) const RIGHT_U: usize = 5;
pub(super) const RIGHT_V: usize = 6;
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

/// Half-steps on the rows that `rows(half-step)` gives.
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
        let omega = s.splat(OMEGA);
        // SAFETY: tasks that run at the same time write different rows, and none reads the colour of a row that another writes.
        let flow = unsafe { self.flow.parts(0, self.flow.len()) };
        for half in 0..HALF_STEPS {
            let [top, bottom] = (self.rows)(half);
            for y in top..bottom {
                let y = y as isize;
                // The colour that is updated: even columns of even rows first. Its neighbours to the left and right have the other parity.
                let own = (y as usize + half) & 1;
                let other = 1 - own;
                let around = |parity: usize, row: isize, kind: usize| places.start(y + row, parity, kind);
                let at = |kind: usize| system.places.start(y, own, kind);
                let above = system.places.start(y - 1, own, EDGE_Y);
                // One before the neighbour on the left in the same place.
                let beside = system.places.start(y, other, EDGE_X) + own - 1;
                let (u, v) = (around(own, 0, 0), around(own, 0, 1));
                let sides = around(other, 0, 0) + own - 1;
                let rows = [around(own, -1, 0), around(own, 1, 0)];
                let kinds = v - u;
                for column in (0..self.columns.whole).step_by(LANES) {
                    let element = |start: usize| s.load(&system.data[start + column..]);
                    // SAFETY: a vector of a row between zeros; nothing writes it now but this task.
                    let value = |start: usize| unsafe { s.load_ptr(flow.add(start + column)) };
                    let edges = [element(beside), element(at(EDGE_X)), element(above), element(at(EDGE_Y))];
                    let near = [sides, sides + 1, rows[0], rows[1]];
                    let pull = |kind: usize, right: S::F32| {
                        let mut sum = right;
                        for i in 0..4 {
                            sum = s.mul_add(edges[i], value(near[i] + kind * kinds), sum);
                        }
                        sum
                    };
                    let across = element(at(A12));
                    let (old_u, old_v) = (value(u), value(v));
                    let goal = s.neg_mul_add(across, old_v, pull(0, element(at(RIGHT_U))));
                    let new_u = s.mul_add(omega, s.sub(s.mul(goal, element(at(INVERSE_U))), old_u), old_u);
                    let goal = s.neg_mul_add(across, new_u, pull(1, element(at(RIGHT_V))));
                    let new_v = s.mul_add(omega, s.sub(s.mul(goal, element(at(INVERSE_V))), old_v), old_v);
                    // SAFETY: as above.
                    unsafe {
                        s.store_ptr(new_u, flow.add(u + column));
                        s.store_ptr(new_v, flow.add(v + column));
                    }
                }
            }
        }
    }
}
