//! Homographies: the motion of one plane, or of any scene under a camera that only turns.

use super::linear::Normal;
use super::matches::Match;

/// Rounds of weighting.
const ROUNDS: usize = 10;

/// Returns the fraction of the matches, by weight, that the best homography maps to within `fits`. The homography is
/// fitted by least squares with weights that decrease with the distance.
pub(super) fn share(matches: &[Match], fits: f64) -> f64 {
    let mut h = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0];
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
    let (mut all, mut fit) = (0.0, 0.0);
    for m in matches {
        all += m.weight;
        fit += if distance(&h, m) < fits { m.weight } else { 0.0 };
    }
    fit / all
}

fn distance(h: &[f64; 8], m: &Match) -> f64 {
    let (x, y) = (m.one.x, m.one.y);
    let depth = h[6] * x + h[7] * y + 1.0;
    let du = (h[0] * x + h[1] * y + h[2]) / depth - m.other.x;
    let dv = (h[3] * x + h[4] * y + h[5]) / depth - m.other.y;
    (du * du + dv * dv).sqrt()
}
