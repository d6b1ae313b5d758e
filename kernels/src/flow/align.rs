//! Velocities along which points keep their brightness, where flow has others.

use tracing::debug_span;

use super::follow::{Step, check, finite};
use crate::Level;
use crate::parallel::for_each_chunk;
use crate::simd::{LANES, Operation, Simd, dispatch};

/// Points per task.
const TASK: usize = 1024;
/// Mean difference of luma, from 0 to 1, under which a velocity stays.
const MISFIT: f32 = 0.04;
/// A larger difference of luma counts as this: another surface may cover the point there.
const HIDDEN: f32 = 0.12;
/// A new velocity has at most this part of the old one's misfit, less [`MARGIN`].
const BETTER: f32 = 0.9;
const MARGIN: f32 = 0.003;
/// Neighbours whose velocities compete, in pixels (columns, rows).
const NEIGHBOURS: [[f32; 2]; 8] =
    [[8.0, 0.0], [-8.0, 0.0], [0.0, 8.0], [0.0, -8.0], [6.0, 6.0], [6.0, -6.0], [-6.0, 6.0], [-6.0, -6.0]];
/// Side in pixels of a square whose points are taken for each other's neighbours.
const SQUARE: usize = 4;
/// Changes of a velocity that are tried in each round, times its step.
const CROSS: [[f32; 2]; 4] = [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]];
/// Rounds of these.
const ROUNDS: usize = 3;

/// The frames that points are followed through, as luma `[h, w]` from 0 to 1 ([`luma`](super::luma)).
#[derive(Clone, Copy)]
pub struct Lumas<'a> {
    /// The frame in which the points start.
    pub from: &'a [f32],
    /// The frames after each step but the last, in their order.
    pub to: &'a [&'a [f32]],
}

/// Replaces velocities of points, as [`follow`](super::follow) computes them, where others fit the frames better.
///
/// Flow is smooth: at the edge of a body it moves a strip of what is behind along with it. The misfit of a velocity v
/// of a point p is the difference in luma L along its straight line, on the point and its four neighbours q:
///
/// ```text
/// misfit(v) = Σ_k w_k·Σ_q min(|L_k(q + v·s_k) − L_0(q)|, 0.12)      w_k = (1 − s_k/s_n) / (5·Σ (1 − s_k/s_n))
/// ```
///
/// with the frames k = 1 … n−1 of `lumas.to`, `s_k` the distance of step k, and all samples bilinear, the border
/// repeated; the five of a point have its weights. Sums run over k, then q (the point, right, left, below, above), a
/// fused step each, in binary32. Where no velocity is known (NaN), it is 0.
///
/// A velocity whose misfit is at least 0.04 competes with those of the points at eight places around (8 pixels to the
/// right, left, below and above, and 6 pixels along both axes), and with 0. The point at a place (x, y) is the first
/// of all starts with a velocity in the same square ⌊(x + ½)/4⌋, ⌊(y + ½)/4⌋ of the picture; outside there is none.
/// From the best one, three rounds try a step of one pixel per unit of time right, left, down and up; a round without a
/// better one halves the step. The first of equals wins. The winner replaces the velocity if its misfit is less than
/// 0.9 times the former one's less 0.003.
///
/// Nothing changes where there are fewer than two steps, and for points that are not finite.
///
/// Candidates from around, then changes at random, are the steps of PatchMatch (Barnes, Shechtman, Finkelstein and
/// Goldman, SIGGRAPH 2009). The changes here are fixed.
///
/// # Panics
/// When there is not one velocity per start and one frame per step but the last, and as
/// [`follow`](super::follow) does; also when a frame has another size.
pub fn align(level: Level, lumas: Lumas<'_>, starts: &[[f32; 2]], steps: &[Step<'_>], velocities: &mut [[f32; 2]]) {
    assert_eq!(starts.len(), velocities.len(), "a velocity for each start");
    let [_, .., last] = steps else { return };
    assert_eq!(lumas.to.len(), steps.len() - 1, "a frame for each step but the last");
    let size = last.there.size;
    check(steps);
    for frame in lumas.to.iter().chain([&lumas.from]) {
        assert_eq!(Some(frame.len()), size[0].checked_mul(size[1]), "frames of one size");
    }
    let part = |step: &Step<'_>| 1.0 - step.distance / last.distance;
    let sum = 5.0 * steps[..steps.len() - 1].iter().fold(0.0, |sum, step| sum + part(step));
    let weights: Vec<f32> = steps[..steps.len() - 1].iter().map(|step| part(step) / sum).collect();
    let _span = debug_span!("flow", step = "align", points = starts.len(), steps = steps.len()).entered();
    let around = Around::new(size, starts, velocities);
    for_each_chunk(velocities, TASK, |index, velocities| {
        let starts = &starts[index * TASK..][..velocities.len()];
        dispatch(level, Aligned { lumas, weights: &weights, starts, steps, around: &around, velocities });
    });
}

/// Velocities of the points of a picture, one for each square of [`SQUARE`] pixels a side.
struct Around {
    columns: usize,
    /// Row by row; NaN where no point has one.
    velocities: Vec<[f32; 2]>,
}

impl Around {
    fn new([height, width]: [usize; 2], starts: &[[f32; 2]], velocities: &[[f32; 2]]) -> Self {
        let columns = width.div_ceil(SQUARE);
        let mut around = Self { columns, velocities: vec![[f32::NAN; 2]; columns * height.div_ceil(SQUARE)] };
        for (start, velocity) in starts.iter().zip(velocities) {
            if velocity.iter().all(|x| x.is_finite())
                && let Some(place) = around.place(*start)
                && around.velocities[place][0].is_nan()
            {
                around.velocities[place] = *velocity;
            }
        }
        around
    }

    /// The square of a place; `None` outside the picture's squares, the last of which may reach beyond its edge.
    #[inline(always)]
    fn place(&self, [x, y]: [f32; 2]) -> Option<usize> {
        let (x, y) = ((x + 0.5) * (1.0 / SQUARE as f32), (y + 0.5) * (1.0 / SQUARE as f32));
        // False for NaN.
        if !(x >= 0.0 && y >= 0.0 && x < self.columns as f32) {
            return None;
        }
        let place = (y as usize).checked_mul(self.columns)? + x as usize;
        (place < self.velocities.len()).then_some(place)
    }

    /// The velocities at places; NaN where there is none.
    #[inline(always)]
    fn at<S: Simd>(&self, s: S, [x, y]: [S::F32; 2]) -> [S::F32; 2] {
        let (x, y) = (s.to_array(x), s.to_array(y));
        let mut found = [[f32::NAN; LANES]; 2];
        for lane in 0..LANES {
            if let Some(place) = self.place([x[lane], y[lane]]) {
                let [u, v] = self.velocities[place];
                (found[0][lane], found[1][lane]) = (u, v);
            }
        }
        found.map(|lanes| s.from_array(lanes))
    }
}

struct Aligned<'a> {
    lumas: Lumas<'a>,
    weights: &'a [f32],
    starts: &'a [[f32; 2]],
    steps: &'a [Step<'a>],
    around: &'a Around,
    velocities: &'a mut [[f32; 2]],
}

impl Operation for Aligned<'_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let mut wrong = Vec::with_capacity(self.starts.len());
        for first in (0..self.starts.len()).step_by(LANES) {
            let points: [usize; LANES] = std::array::from_fn(|lane| first + lane);
            let points = &points[..LANES.min(self.starts.len() - first)];
            let (start, own) = self.load(s, points);
            let bases = self.sample(s, self.lumas.from, start);
            let misfit = self.misfit(s, start, bases, own, s.splat(MISFIT));
            let wanted = s.and(finite(s, start), s.le(s.splat(MISFIT), misfit));
            let wanted = s.to_array(s.select(wanted, s.splat(1.0), s.splat(0.0)));
            wrong.extend(points.iter().zip(wanted).filter(|(_, wanted)| *wanted > 0.0).map(|(point, _)| *point));
        }
        for points in wrong.chunks(LANES) {
            let (start, own) = self.load(s, points);
            let [u, v] = self.best(s, start, own);
            let (u, v) = (s.to_array(u), s.to_array(v));
            for (lane, &point) in points.iter().enumerate() {
                if !u[lane].is_nan() {
                    self.velocities[point] = [u[lane], v[lane]];
                }
            }
        }
    }
}

impl Aligned<'_> {
    /// Starts and velocities of up to [`LANES`] points; 0 for a velocity that is not known.
    #[inline(always)]
    fn load<S: Simd>(&self, s: S, points: &[usize]) -> ([S::F32; 2], [S::F32; 2]) {
        let mut start = [[f32::NAN; LANES]; 2];
        let mut own = [[0.0; LANES]; 2];
        for (lane, &point) in points.iter().enumerate() {
            let known = !self.velocities[point].iter().any(|x| x.is_nan());
            for axis in 0..2 {
                start[axis][lane] = self.starts[point][axis];
                own[axis][lane] = if known { self.velocities[point][axis] } else { 0.0 };
            }
        }
        let [[x, y], [u, v]] = [start, own];
        ([s.from_array(x), s.from_array(y)], [s.from_array(u), s.from_array(v)])
    }

    /// Luma at points of a frame and around them.
    #[inline(always)]
    fn sample<S: Simd>(&self, s: S, frame: &[f32], at: [S::F32; 2]) -> [S::F32; 5] {
        self.steps[0].there.sampler().cross(s, frame, at)
    }

    /// The misfit of velocities. No step makes a sum smaller, so once none is under `limit` the rest is left out.
    #[inline(always)]
    fn misfit<S: Simd>(
        &self,
        s: S,
        start: [S::F32; 2],
        bases: [S::F32; 5],
        [u, v]: [S::F32; 2],
        limit: S::F32,
    ) -> S::F32 {
        let mut sum = s.splat(0.0);
        for ((&frame, step), &weight) in self.lumas.to.iter().zip(self.steps).zip(self.weights) {
            let distance = s.splat(step.distance);
            let at = [s.mul_add(u, distance, start[0]), s.mul_add(v, distance, start[1])];
            let found = self.sample(s, frame, at);
            for i in 0..5 {
                let difference = s.abs(s.sub(found[i], bases[i]));
                sum = s.mul_add(s.splat(weight), s.min(difference, s.splat(HIDDEN)), sum);
            }
            if !s.any(s.lt(sum, limit)) {
                break;
            }
        }
        sum
    }

    /// The velocities that replace `own`; NaN where none does.
    #[inline(always)]
    fn best<S: Simd>(&self, s: S, start: [S::F32; 2], own: [S::F32; 2]) -> [S::F32; 2] {
        let bases = self.sample(s, self.lumas.from, start);
        let former = self.misfit(s, start, bases, own, s.splat(f32::INFINITY));
        let mut best = Best { misfit: former, velocity: own };
        for [x, y] in NEIGHBOURS {
            let neighbour = [s.add(start[0], s.splat(x)), s.add(start[1], s.splat(y))];
            self.compete(s, start, bases, &mut best, self.around.at(s, neighbour));
        }
        self.compete(s, start, bases, &mut best, [s.splat(0.0); 2]);
        let mut length = s.splat(1.0);
        for _ in 0..ROUNDS {
            let [u, v] = best.velocity;
            let mut any = s.lt(length, s.splat(0.0));
            for [x, y] in CROSS {
                let velocity = [s.mul_add(s.splat(x), length, u), s.mul_add(s.splat(y), length, v)];
                any = s.or(any, self.compete(s, start, bases, &mut best, velocity));
            }
            length = s.select(any, length, s.mul(length, s.splat(0.5)));
        }
        let better = s.lt(best.misfit, s.sub(s.mul(s.splat(BETTER), former), s.splat(MARGIN)));
        let [u, v] = best.velocity;
        [s.select(better, u, s.splat(f32::NAN)), s.select(better, v, s.splat(f32::NAN))]
    }

    /// Replaces the best velocity on the lanes where this one is finite and fits better; returns those.
    #[inline(always)]
    fn compete<S: Simd>(
        &self,
        s: S,
        start: [S::F32; 2],
        bases: [S::F32; 5],
        best: &mut Best<S>,
        velocity: [S::F32; 2],
    ) -> S::Mask {
        let misfit = self.misfit(s, start, bases, velocity, best.misfit);
        let better = s.and(finite(s, velocity), s.lt(misfit, best.misfit));
        best.misfit = s.select(better, misfit, best.misfit);
        for axis in 0..2 {
            best.velocity[axis] = s.select(better, velocity[axis], best.velocity[axis]);
        }
        better
    }
}

/// The velocity of least misfit so far.
struct Best<S: Simd> {
    misfit: S::F32,
    velocity: [S::F32; 2],
}
