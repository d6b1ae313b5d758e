//! Inverse depth of single matches and of all cells.

use glam::DVec3;

use super::matches::Match;
use super::window::Track;
use super::{Motion, Sight};

/// Distance from the epipolar line, in pixels of a picture 512 wide, above which a match certainly fits no point at
/// rest.
const SEED: f64 = 2.5;
/// Distance above which this is likely.
const HINT: f64 = 1.0;
/// Fraction of the flow's length that is added to both distances, since long flow is less exact.
const TRAVEL: f64 = 0.08;
/// Fraction of these distances that suffices for a point behind the camera.
const BEHIND: f64 = 0.7;

/// Inverse depth and confidence of a cell.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Cell {
    pub(super) inverse: f32,
    pub(super) confidence: f32,
    /// True if the match certainly fits no point at rest.
    pub(super) moves: bool,
    /// True if this is likely.
    pub(super) hint: bool,
    /// Score from 0 to 1: 1 where a body moves independently, less for each key frame since.
    pub(super) body: f32,
}

/// Returns, for a match: ρ by least squares, the length of parallax that a ρ of 1 causes, and the distance from the
/// epipolar line.
///
/// From `x₂·(y₃ + ρ·t₃) = (y + ρ·t)₁₂` with `y = R·x₁`: `ρ·a = b`, `a = t₁₂ − x₂·t₃`, `b = x₂·y₃ − y₁₂`.
pub(super) fn inverse_depth(motion: &Motion, one: DVec3, other: DVec3) -> (f64, f64, f64) {
    let (y, t) = (motion.rotation * one, motion.translation);
    let (ax, ay) = (t.x - other.x * t.z, t.y - other.y * t.z);
    let (bx, by) = (other.x * y.z - y.x, other.y * y.z - y.y);
    let square = ax * ax + ay * ay + 1e-18;
    let length = square.sqrt();
    ((ax * bx + ay * by) / square, length / y.z, (ax * by - ay * bx).abs() / (length * y.z))
}

/// Returns all cells of the picture, seen along `track` by a camera of this motion, with inverse depth in units of the
/// median of the certain ones. Also returns the parallax, in pixels of a picture 512 pixels wide, that has a confidence
/// of 1: `unit`, or the median of this track.
pub(super) fn cells(sight: &Sight<'_>, track: &Track, motion: &Motion, unit: Option<f64>) -> (Vec<Cell>, f64) {
    let focal = motion.focal / super::FOCAL * sight.focal;
    let pixels = focal / sight.unit;
    let count = sight.grid[0] * sight.grid[1];
    let mut lengths = Vec::with_capacity(count);
    let mut cells: Vec<(Cell, f64)> = (0..count)
        .map(|cell| {
            let at = sight.middle(cell);
            let [u, v] = [track.u[cell], track.v[cell]];
            let m = Match {
                one: sight.direction(at, focal),
                other: sight.direction([at[0] + u, at[1] + v], focal),
                weight: 1.0,
            };
            let (inverse, length, beside) = inverse_depth(motion, m.one, m.other);
            let pixel = sight.pixel(cell);
            let (astray, texture) = (f64::from(track.astray[cell]) / sight.unit, f64::from(sight.texture[pixel]));
            let (beside, length) = (beside * pixels, length * pixels);
            lengths.push(length);
            let travel = f64::from((u * u + v * v).sqrt()) / sight.unit;
            let off = |least: f64| {
                let limit = TRAVEL.mul_add(travel, least);
                beside > limit || inverse * length < -BEHIND * limit
            };
            let moves = astray < 1.0 && texture > 0.3 && off(SEED);
            let hint = astray < 2.0 && texture > 0.1 && off(HINT);
            let soft = 1.0 + beside * beside;
            let trust = texture / (soft * soft * (1.0 + astray * astray));
            let known = inverse > 0.0 && inverse.is_finite() && trust.is_finite() && astray < 4.0 && !moves;
            let confidence = if known { trust as f32 } else { 0.0 };
            (Cell { inverse: if known { inverse as f32 } else { 0.0 }, confidence, moves, hint, body: 0.0 }, length)
        })
        .collect();
    lengths.sort_by(f64::total_cmp);
    let middle = unit.unwrap_or_else(|| lengths[count / 2].max(1e-12));
    for (cell, length) in &mut cells {
        // Near the epipole the parallax is short and the depth uncertain.
        cell.confidence *= ((*length / middle) * (*length / middle)).min(16.0) as f32;
    }
    let mut cells: Vec<Cell> = cells.into_iter().map(|(cell, _)| cell).collect();
    let scale = super::filter::weighted_median(cells.iter().map(|c| (c.inverse, c.confidence))).unwrap_or(1.0);
    for cell in &mut cells {
        cell.inverse = (cell.inverse / scale).min(super::filter::NEAREST);
    }
    (cells, middle)
}
