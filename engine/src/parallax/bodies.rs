//! Bodies: connected parts of the picture that move independently. Each has one depth.
//!
//! The distance of an independently moving object cannot be computed from two views, because its own motion looks like
//! parallax. Its motion can be detected where its flow leaves the epipolar lines, and its distance follows from the
//! ground under it.
//!
//! 1. *Seeds* are cells whose match certainly fits no point at rest; *hints* are cells where this is likely. Gaps
//!    between hints of up to twice [`GAP`] cells are closed. A component of hints is a body if [`SEEDS`] of it are
//!    seeds. Cells that belonged to a body at the previous key frame count as seeds while their score is at least
//!    [`STILL_BODY`]. The score falls by a fifth with each key frame without enough seeds of its own.
//! 2. A body grows, by at most a part of its size, over cells whose flow is nearer to its own (an affine field by least
//!    squares) than to that of the surroundings in the same rows.
//! 3. Its inverse depth is that of the ground right under its lowest cells; if that is unknown, that of the nearest
//!    quarter of its surroundings. It is averaged, with equal weights, with the body's inverse depth from the previous
//!    key frame. If neither is known, the body stays a hole.
//! 4. Connected parts that seem nearer than the body they touch, and do not reach below it, belong to it: they move
//!    along the epipolar lines.
//!
//! A body that moves along the epipolar lines as a whole is not detected: in two views it equals an object at rest at
//! another distance.

use std::ops::Range;

use super::filter::weighted_median;
use super::triangulate::Cell;
use super::{CELL, Sight};

/// Minimum size of a body, as a fraction of the picture.
const LEAST: f64 = 0.002;
/// Half the width of the gaps that are closed between hints, in cells.
const GAP: usize = 2;
/// Minimum fraction of seeds among a body's cells. Errors of the flow over objects at rest cause many hints and few
/// seeds.
const SEEDS: f64 = 0.25;
/// Number of rows under a body that are searched for the ground.
const UNDER: usize = 6;
/// Confidence of a body's depth over a ground that was measured.
pub(super) const CONFIDENCE: f32 = 0.5;
/// Fraction of the confidence of a body's depth, below which its depth of the previous key frame was guessed, while the
/// present one is measured.
const GUESSED: f32 = 0.06;
/// Minimum score of a cell that still counts as part of a body.
pub(super) const STILL_BODY: f32 = 0.4;
/// Ratio of inverse depths above which a part seems nearer than its body.
const NEARER: f32 = 1.2;
/// Maximum size of this part, relative to the body.
const PART: f64 = 0.4;
/// Rows of the surroundings that are averaged on each side of a row.
const BAND: usize = 3;

/// Assigns each body its depth, of this confidence, from this interval's cells and those of the previous frame, carried
/// along the flow.
pub(super) fn settle(cells: &mut [Cell], carried: Option<&[Cell]>, sight: &Sight<'_>, trust: f32) {
    let [rows, columns] = sight.grid;
    let was = |at: usize| carried.is_some_and(|carried| carried[at].body >= STILL_BODY);
    let hints: Vec<bool> = (0..cells.len()).map(|at| cells[at].hint || cells[at].moves || was(at)).collect();
    let joined = closed(&hints, sight.grid, GAP);
    let mut taken = vec![false; cells.len()];
    let (mut bodies, mut scores) = (Vec::new(), Vec::new());
    for first in 0..cells.len() {
        if !joined[first] || taken[first] {
            continue;
        }
        let body = connected(&joined, &mut taken, first, [rows, columns]);
        let enough = |count: usize| count as f64 >= SEEDS * body.len() as f64;
        let moving = body.iter().filter(|at| cells[**at].moves).count();
        let seeds = body.iter().filter(|at| cells[**at].moves || was(**at)).count();
        if body.len() as f64 >= LEAST * cells.len() as f64 && enough(seeds) {
            let then = body.iter().map(|at| carried.map_or(0.0, |carried| carried[*at].body)).fold(0.0, f32::max);
            scores.push(if enough(moving) { 1.0 } else { then });
            bodies.push(body);
        }
    }
    let mut owner = vec![usize::MAX; cells.len()];
    for (index, body) in bodies.iter().enumerate() {
        body.iter().for_each(|at| owner[*at] = index);
    }
    for (index, body) in bodies.iter_mut().enumerate() {
        grow(body, &mut owner, index, sight);
    }
    let depths: Vec<Option<f32>> =
        bodies.iter().map(|body| depth(cells, body, &owner, carried, sight.grid, trust)).collect();
    for (index, (body, depth)) in bodies.iter_mut().zip(&depths).enumerate() {
        if let Some(depth) = depth {
            nearer_parts(cells, body, &mut owner, index, *depth, [rows, columns]);
        }
    }
    for ((body, depth), score) in bodies.iter().zip(depths).zip(scores) {
        for &at in body {
            let (inverse, confidence) = depth.map_or((0.0, 0.0), |inverse| (inverse, trust));
            cells[at] = Cell { inverse, confidence, body: score, ..cells[at] };
        }
    }
}

/// Returns the numbers of `0..side` at most `reach` from `i`.
fn near(i: usize, side: usize, reach: usize) -> Range<usize> {
    i.saturating_sub(reach)..(i + reach + 1).min(side)
}

/// Returns the cells with a cell of the mask within `reach` rows and columns (a dilation).
fn spread(mask: &[bool], [rows, columns]: [usize; 2], reach: usize) -> Vec<bool> {
    let across: Vec<bool> = (0..mask.len())
        .map(|at| near(at % columns, columns, reach).any(|column| mask[at / columns * columns + column]))
        .collect();
    (0..mask.len()).map(|at| near(at / columns, rows, reach).any(|row| across[row * columns + at % columns])).collect()
}

/// Returns the mask with gaps of at most twice `reach` filled: dilated, then eroded by the same amount (a morphological
/// closing).
fn closed(mask: &[bool], grid: [usize; 2], reach: usize) -> Vec<bool> {
    let outside: Vec<bool> = spread(mask, grid, reach).into_iter().map(|inside| !inside).collect();
    spread(&outside, grid, reach).into_iter().map(|outside| !outside).collect()
}

/// Returns the cells of the mask that are connected with `first`, ascending.
fn connected(mask: &[bool], taken: &mut [bool], first: usize, [rows, columns]: [usize; 2]) -> Vec<usize> {
    let (mut body, mut next) = (Vec::new(), vec![first]);
    taken[first] = true;
    while let Some(at) = next.pop() {
        body.push(at);
        for to in around(at, [rows, columns]) {
            if mask[to] && !taken[to] {
                taken[to] = true;
                next.push(to);
            }
        }
    }
    body.sort_unstable();
    body
}

/// Iterates over the four neighbours of a cell.
fn around(at: usize, [rows, columns]: [usize; 2]) -> impl Iterator<Item = usize> {
    let (row, column) = (at / columns, at % columns);
    [
        (row > 0).then(|| at - columns),
        (row + 1 < rows).then(|| at + columns),
        (column > 0).then(|| at - 1),
        (column + 1 < columns).then(|| at + 1),
    ]
    .into_iter()
    .flatten()
}

/// Returns the flow at a cell, in pixels of a picture 512 wide.
fn flow(at: usize, sight: &Sight<'_>) -> [f64; 2] {
    let [x, y] = sight.middle(at);
    sight.evidence.there.at(x, y).map(|d| f64::from(d) / sight.unit)
}

/// Adds cells around a body that move with the body rather than with the surroundings.
fn grow(body: &mut Vec<usize>, owner: &mut [usize], index: usize, sight: &Sight<'_>) {
    let [rows, columns] = sight.grid;
    let place = |at: usize| [(at % columns * CELL) as f64 / sight.unit, (at / columns * CELL) as f64 / sight.unit];
    let points: Vec<_> = body.iter().map(|&at| (place(at), flow(at, sight))).collect();
    let Some(own) = affine(&points) else { return };
    let rows_of = || body.iter().map(|at| at / columns);
    let columns_of = || body.iter().map(|at| at % columns);
    let [top, bottom] = [rows_of().min(), rows_of().max()].map(Option::unwrap_or_default);
    let [left, right] = [columns_of().min(), columns_of().max()].map(Option::unwrap_or_default);
    let size = (bottom - top).min(right - left) + 1;
    let reach = (size / 3).clamp(2, columns / 16 + 2);
    // Mean flow of the surroundings, row by row.
    let (from, to) = (left.saturating_sub(3 * reach), (right + 3 * reach + 1).min(columns));
    let mut outside: Vec<[f64; 3]> = Vec::with_capacity(rows);
    for row in 0..rows {
        let mut sum = [0.0; 3];
        for at in (from..to).map(|column| row * columns + column).filter(|at| owner[*at] == usize::MAX) {
            let [u, v] = flow(at, sight);
            if u.is_finite() && v.is_finite() {
                sum = [sum[0] + u, sum[1] + v, sum[2] + 1.0];
            }
        }
        outside.push(sum);
    }
    let ground = |row: usize| {
        let sum = near(row, rows, BAND).fold([0.0; 3], |sum, row| [0, 1, 2].map(|k| sum[k] + outside[row][k]));
        (sum[2] > 0.0).then(|| [sum[0] / sum[2], sum[1] / sum[2]])
    };
    let apart = |a: [f64; 2], b: [f64; 2]| ((a[0] - b[0]) * (a[0] - b[0]) + (a[1] - b[1]) * (a[1] - b[1])).sqrt();
    let mut edge = body.clone();
    for _ in 0..reach {
        let mut next = Vec::new();
        for &at in &edge {
            for to in around(at, [rows, columns]) {
                if owner[to] != usize::MAX {
                    continue;
                }
                let (here, expected) = (flow(to, sight), own(place(to)));
                let Some(ground) = ground(to / columns) else { continue };
                let between = apart(expected, ground);
                if between > 1.0 && apart(here, expected) < (0.4 * between).min(2.0) {
                    owner[to] = index;
                    next.push(to);
                }
            }
        }
        next.sort_unstable();
        body.extend(&next);
        edge = next;
    }
    body.sort_unstable();
}

/// Adds connected cells that touch a body and seem nearer than it, if they are at most [`PART`] of its size and end
/// above or on its lowest row.
fn nearer_parts(
    cells: &[Cell],
    body: &mut Vec<usize>,
    owner: &mut [usize],
    index: usize,
    depth: f32,
    grid @ [_, columns]: [usize; 2],
) {
    let bottom = body.last().map_or(0, |last| last / columns);
    let nearer: Vec<bool> = (0..cells.len())
        .map(|at| owner[at] == usize::MAX && cells[at].confidence > 0.0 && cells[at].inverse > NEARER * depth)
        .collect();
    let mut taken = vec![false; cells.len()];
    let mut added = Vec::new();
    for &at in body.iter() {
        for first in around(at, grid) {
            if nearer[first] && !taken[first] {
                let part = connected(&nearer, &mut taken, first, grid);
                let ends = part.last().map_or(0, |last| last / columns);
                if part.len() as f64 <= PART * body.len() as f64 && ends <= bottom {
                    added.extend(part);
                }
            }
        }
    }
    added.iter().for_each(|at| owner[*at] = index);
    body.extend(added);
    body.sort_unstable();
}

/// Returns the affine field that fits the flow at some points best; `None` if the points do not determine it.
fn affine(points: &[([f64; 2], [f64; 2])]) -> Option<impl Fn([f64; 2]) -> [f64; 2] + use<>> {
    let (mut x, mut y) = (super::linear::Normal::<3>::new(), super::linear::Normal::<3>::new());
    let (mut count, mut middle) = (0.0, [0.0; 2]);
    for (place, _) in points {
        count += 1.0;
        middle = [middle[0] + place[0], middle[1] + place[1]];
    }
    let middle = middle.map(|sum| sum / f64::max(count, 1.0));
    for (place, flow) in points {
        let j = [1.0, place[0] - middle[0], place[1] - middle[1]];
        if flow.iter().all(|d| d.is_finite()) {
            x.add(1.0, &j, flow[0]);
            y.add(1.0, &j, flow[1]);
        }
    }
    let (x, y) = (x.solve()?, y.solve()?);
    Some(move |place: [f64; 2]| {
        let [dx, dy] = [place[0] - middle[0], place[1] - middle[1]];
        [x, y].map(|[a, b, c]| a + b * dx + c * dy)
    })
}

/// Returns the inverse depth of a body.
fn depth(
    cells: &[Cell],
    body: &[usize],
    owner: &[usize],
    carried: Option<&[Cell]>,
    [rows, columns]: [usize; 2],
    trust: f32,
) -> Option<f32> {
    let (first, last) = (body.first()?, body.last()?);
    let (top, bottom) = (first / columns, last / columns);
    let low = bottom - (bottom - top) / 5;
    let mut ground = Vec::new();
    for &at in body.iter().filter(|at| **at / columns >= low) {
        for row in at / columns + 1..(at / columns + 1 + UNDER).min(rows) {
            let under = row * columns + at % columns;
            if owner[under] != usize::MAX {
                break;
            }
            ground.push((cells[under].inverse, cells[under].confidence));
        }
    }
    let now = weighted_median(ground.into_iter()).or_else(|| {
        let mut inside = vec![false; cells.len()];
        body.iter().for_each(|at| inside[*at] = true);
        let around = spread(&inside, [rows, columns], UNDER);
        let outside = (0..cells.len()).filter(|at| around[*at] && owner[*at] == usize::MAX);
        let mut ring: Vec<(f32, f32)> = outside.map(|at| (cells[at].inverse, cells[at].confidence)).collect();
        // The nearest quarter of the surroundings, or the nearest eighth where the picture's lower edge cuts the body
        // off.
        for _ in 0..if bottom + 1 == rows { 2 } else { 1 } {
            let half = weighted_median(ring.iter().copied())?;
            ring.retain(|(inverse, _)| *inverse >= half);
        }
        weighted_median(ring.into_iter())
    });
    // In this interval's scale: the median ratio of the current to the previous inverse depth outside bodies.
    let before = carried.and_then(|carried| {
        let ratio = |at: usize| {
            let (now, then) = (cells[at], carried[at]);
            (now.inverse / then.inverse.max(1e-6), now.confidence.min(then.confidence))
        };
        let scale = weighted_median((0..cells.len()).filter(|at| owner[*at] == usize::MAX).map(ratio))?;
        let was = |at: &usize| carried[*at].body >= STILL_BODY;
        let known = body
            .iter()
            .filter(|at| was(at) && carried[**at].confidence > GUESSED * trust)
            .map(|at| (carried[*at].inverse, carried[*at].confidence));
        let of_body = body.iter().filter(|at| was(at)).count();
        let then = weighted_median(known)?;
        (2 * of_body >= body.len()).then_some(then * scale)
    });
    match (now, before) {
        (Some(now), Some(before)) => Some(0.5 * (now + before)),
        (now, before) => now.or(before),
    }
}
