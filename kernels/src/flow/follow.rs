//! Points that follow the flow through several frames.

use tracing::debug_span;

use super::field::Field;
use super::sample::Sampler;
use crate::Level;
use crate::parallel::for_each_chunk;
use crate::simd::{LANES, Operation, Simd, dispatch};

/// Points per task.
const TASK: usize = 1024;
/// Pixels by which the backward flow may miss the start of a step, in addition to a tenth of the step.
const ASTRAY: f32 = 2.0;

/// Flow from one frame to the next and back.
#[derive(Clone, Copy)]
pub struct Step<'a> {
    /// Towards the next frame.
    pub there: &'a Field,
    /// Back from it.
    pub back: &'a Field,
    /// Time s from the frame in which the points start to the next frame: positive.
    pub distance: f32,
}

/// Velocities, in pixels per unit of time, of points that start at `starts` (column, row; pixels have their centres at
/// whole numbers) and follow `steps`.
///
/// `p₀` is the start, `p_k = p_{k−1} + F_k(p_{k−1})` the position after step k (bilinear, the border repeated), `s_k`
/// its distance in time. A velocity is the slope of the line through `p₀` that fits the positions by least squares:
///
/// ```text
/// v = Σ s_k·(p_k − p₀) / Σ s_k²          k ascending, a fused step each, in binary32
/// ```
///
/// Where there are several steps, a point ends before the first one that leaves the picture by more than half a pixel.
/// It also ends before one that the flow back does not undo to within 2 pixels plus a tenth of the step's length.
/// Points that are not finite or that end before the first step have no velocity: both of its numbers are NaN.
///
/// # Panics
/// When there is not one velocity per start, a field's buffers do not fit its size, or sizes differ.
pub fn follow(level: Level, starts: &[[f32; 2]], steps: &[Step<'_>], velocities: &mut [[f32; 2]]) {
    each(level, starts, steps, velocities, "follow", Follow);
}

/// Positions of points from `starts` after all `steps`. Both numbers are NaN where a point is not finite, or where any
/// step leaves the picture or does not come back ([`follow`]). Distances are ignored.
///
/// # Panics
/// As [`follow`], `ends` for velocities.
pub fn trace(level: Level, starts: &[[f32; 2]], steps: &[Step<'_>], ends: &mut [[f32; 2]]) {
    each(level, starts, steps, ends, "trace", Trace);
}

/// Calls `walk` with vectors of starts, on all threads, and stores its results.
fn each(
    level: Level,
    starts: &[[f32; 2]],
    steps: &[Step<'_>],
    out: &mut [[f32; 2]],
    step: &'static str,
    walk: impl Walk,
) {
    assert_eq!(starts.len(), out.len(), "a result for each start");
    check(steps);
    let _span = debug_span!("flow", step, points = starts.len(), steps = steps.len()).entered();
    for_each_chunk(out, TASK, |index, out| {
        let starts = &starts[index * TASK..][..out.len()];
        dispatch(level, Points { starts, steps, out, walk });
    });
}

/// Refuses fields of different sizes.
pub(super) fn check(steps: &[Step<'_>]) {
    for step in steps {
        for field in [step.there, step.back] {
            field.check();
            assert_eq!(field.size, steps[0].there.size, "fields of one size");
        }
    }
}

/// A result for each point of a vector.
pub(super) trait Walk: Copy + Sync + Send {
    /// Results for the points that start here and take these steps.
    fn lanes<S: Simd>(self, s: S, start: [S::F32; 2], steps: &[Step<'_>]) -> [S::F32; 2];
}

#[derive(Clone, Copy)]
pub(super) struct Follow;

#[derive(Clone, Copy)]
struct Trace;

struct Points<'a, W> {
    starts: &'a [[f32; 2]],
    steps: &'a [Step<'a>],
    out: &'a mut [[f32; 2]],
    walk: W,
}

impl<W: Walk> Operation for Points<'_, W> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let Self { starts, steps, out, walk } = self;
        for (starts, out) in starts.chunks(LANES).zip(out.chunks_mut(LANES)) {
            let [mut x, mut y] = [[f32::NAN; LANES]; 2];
            for (i, start) in starts.iter().enumerate() {
                (x[i], y[i]) = (start[0], start[1]);
            }
            let [u, v] = walk.lanes(s, [s.from_array(x), s.from_array(y)], steps);
            let (u, v) = (s.to_array(u), s.to_array(v));
            for (i, out) in out.iter_mut().enumerate() {
                *out = [u[i], v[i]];
            }
        }
    }
}

impl Walk for Follow {
    #[inline(always)]
    fn lanes<S: Simd>(self, s: S, start: [S::F32; 2], steps: &[Step<'_>]) -> [S::F32; 2] {
        let zero = s.splat(0.0);
        let mut alive = finite(s, start);
        let (mut at, mut sums, mut squares) = (start, [zero; 2], zero);
        for step in steps {
            if !s.any(alive) {
                break;
            }
            let moved = sample(s, step.there, at);
            let next = [s.add(at[0], moved[0]), s.add(at[1], moved[1])];
            if steps.len() > 1 {
                alive = s.and(alive, s.not(strays(s, step.back, moved, next)));
            }
            let distance = s.splat(step.distance);
            for axis in 0..2 {
                let sum = s.mul_add(distance, s.sub(next[axis], start[axis]), sums[axis]);
                sums[axis] = s.select(alive, sum, sums[axis]);
            }
            squares = s.select(alive, s.mul_add(distance, distance, squares), squares);
            at = next;
        }
        let none = s.eq(squares, zero);
        let nan = s.splat(f32::NAN);
        let [u, v] = sums;
        [s.select(none, nan, s.div(u, squares)), s.select(none, nan, s.div(v, squares))]
    }
}

impl Walk for Trace {
    #[inline(always)]
    fn lanes<S: Simd>(self, s: S, start: [S::F32; 2], steps: &[Step<'_>]) -> [S::F32; 2] {
        let (mut alive, mut at) = (finite(s, start), start);
        for step in steps {
            if !s.any(alive) {
                break;
            }
            let moved = sample(s, step.there, at);
            at = [s.add(at[0], moved[0]), s.add(at[1], moved[1])];
            alive = s.and(alive, s.not(strays(s, step.back, moved, at)));
        }
        let (nan, [x, y]) = (s.splat(f32::NAN), at);
        [s.select(alive, x, nan), s.select(alive, y, nan)]
    }
}

/// The lanes on which both coordinates are finite.
#[inline(always)]
pub(super) fn finite<S: Simd>(s: S, at: [S::F32; 2]) -> S::Mask {
    // x − x is 0 for finite numbers, NaN for others.
    let [x, y] = at;
    s.and(s.eq(s.sub(x, x), s.splat(0.0)), s.eq(s.sub(y, y), s.splat(0.0)))
}

/// The lanes on which a step by `moved`, to `next`, leaves the picture or does not come back.
#[inline(always)]
fn strays<S: Simd>(s: S, back: &Field, moved: [S::F32; 2], next: [S::F32; 2]) -> S::Mask {
    let [height, width] = back.size.map(|side| side as f32);
    let inside = s.and(within(s, next[0], width), within(s, next[1], height));
    let [u, v] = sample(s, back, next);
    let missed = length(s, [s.add(moved[0], u), s.add(moved[1], v)]);
    let allowed = s.mul_add(s.splat(0.1), length(s, moved), s.splat(ASTRAY));
    s.or(s.not(inside), s.lt(allowed, missed))
}

/// The lanes on which a coordinate is within the picture.
#[inline(always)]
fn within<S: Simd>(s: S, x: S::F32, side: f32) -> S::Mask {
    s.and(s.le(s.splat(-0.5), x), s.le(x, s.splat(side - 0.5)))
}

#[inline(always)]
fn length<S: Simd>(s: S, [x, y]: [S::F32; 2]) -> S::F32 {
    s.sqrt(s.mul_add(x, x, s.mul(y, y)))
}

/// The displacements of a field at points.
#[inline(always)]
fn sample<S: Simd>(s: S, field: &Field, [x, y]: [S::F32; 2]) -> [S::F32; 2] {
    let sampler: Sampler = field.sampler();
    let taps = sampler.taps(s, Sampler::axis(s, x, sampler.w), Sampler::axis(s, y, sampler.h));
    [taps.take(s, &field.u), taps.take(s, &field.v)]
}
