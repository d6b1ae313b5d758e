//! Cameras that only turn.

use super::epipolar::rotation;
use super::lens::through;
use super::matches::Match;

/// Focal lengths that are tried, relative to the assumed one: from wide angle to short telephoto.
const FOCALS: [f64; 3] = [0.8, 1.0, 1.25];

/// Returns the largest fraction of the matches, by weight, that a rotation maps to within `fits`, over all focal
/// lengths tried.
pub(super) fn share(matches: &[Match], fits: f64) -> f64 {
    FOCALS.into_iter().map(|focal| share_at(focal, matches, fits)).fold(0.0, f64::max)
}

fn share_at(focal: f64, matches: &[Match], fits: f64) -> f64 {
    let matches = through(focal, matches);
    let fits = fits / focal;
    let Some(turn) = rotation(&matches, fits) else { return 0.0 };
    let (mut all, mut fit) = (0.0, 0.0);
    for m in &matches {
        let y = turn * m.one;
        let (du, dv) = (y.x / y.z - m.other.x, y.y / y.z - m.other.y);
        all += m.weight;
        fit += if (du * du + dv * dv).sqrt() < fits { m.weight } else { 0.0 };
    }
    fit / all
}
