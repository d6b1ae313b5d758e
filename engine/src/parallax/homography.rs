//! Homographies: the motion of one plane, or of any scene under a camera that only turns.

use glam::DVec3;

use super::linear::Normal;
use super::matches::Match;

/// The homography that leaves every point in its place, row by row without the last number, which is 1.
pub(super) const IDENTITY: [f64; 8] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0];
/// Rounds of weighting.
const ROUNDS: usize = 10;

/// Returns the fraction of the matches, by weight, that the best homography maps to within `fits`.
pub(super) fn share(matches: &[Match], fits: f64) -> f64 {
    let h = fit(matches, fits);
    let (mut all, mut fit) = (0.0, 0.0);
    for m in matches {
        all += m.weight;
        fit += if distance(&h, m) < fits { m.weight } else { 0.0 };
    }
    fit / all
}

/// Returns the homography that fits the matches by least squares, with weights that decrease with the distance.
pub(super) fn fit(matches: &[Match], fits: f64) -> [f64; 8] {
    let mut h = IDENTITY;
    for round in 0..ROUNDS {
        let mut normal = Normal::<8>::new();
        // The scale changes from loose to tight.
        let scale = fits * if round < ROUNDS / 2 { 8.0 } else { 2.0 };
        for m in matches {
            let (x, y, u, v) = (m.one.x, m.one.y, m.other.x, m.other.y);
            let d = if round == 0 { 0.0 } else { distance(&h, m) / scale };
            let depth = h[6] * x + h[7] * y + 1.0;
            let soft = 1.0 + d * d;
            let w = m.weight / (soft * soft * depth * depth);
            if !w.is_finite() {
                continue;
            }
            normal.add(w, &[x, y, 1.0, 0.0, 0.0, 0.0, -u * x, -u * y], u);
            normal.add(w, &[0.0, 0.0, 0.0, x, y, 1.0, -v * x, -v * y], v);
        }
        let Some(next) = normal.solve() else { break };
        h = next;
    }
    h
}

fn distance(h: &[f64; 8], m: &Match) -> f64 {
    miss(h, m.one, m.other)
}

/// Returns the distance of `other` from where the homography maps `one`.
pub(super) fn miss(h: &[f64; 8], one: DVec3, other: DVec3) -> f64 {
    let (x, y) = (one.x, one.y);
    let depth = h[6] * x + h[7] * y + 1.0;
    let du = (h[0] * x + h[1] * y + h[2]) / depth - other.x;
    let dv = (h[3] * x + h[4] * y + h[5]) / depth - other.y;
    (du * du + dv * dv).sqrt()
}
