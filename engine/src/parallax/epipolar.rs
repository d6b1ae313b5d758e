//! Epipolar geometry: the distance of matches from a camera motion's epipolar lines, and the motion of least distance.
//!
//! With `y = R·x₁` a match fits if `e = x₂·(t × y)` is zero. Sampson's distance (Hartley & Zisserman 11.4.3) is `e / s`
//! with `s² = (E·x₁)₁² + (E·x₁)₂² + (Eᵀ·x₂)₁² + (Eᵀ·x₂)₂²`, `E = [t]ₓR`. Motions are refined by Gauss–Newton over five
//! numbers, a rotation `δ` and two components of `t` perpendicular to `t`, with `s` held constant:
//!
//! ```text
//! ∂e/∂δ = y × (x₂ × t)        ∂e/∂t = y × x₂
//! ```

use glam::{DMat3, DQuat, DVec3};

use super::Motion;
use super::linear::Normal;
use super::matches::Match;

/// Maximum step of a rotation or of the translation's direction.
const LONGEST: f64 = 0.2;

/// Returns a rotation by about `δ` (Cayley's map: no trigonometry).
pub(super) fn turn(delta: DVec3) -> DMat3 {
    let half = 0.5 * delta;
    let norm = (1.0 + half.length_squared()).sqrt();
    DMat3::from_quat(DQuat::from_xyzw(half.x / norm, half.y / norm, half.z / norm, 1.0 / norm))
}

/// Returns e and s of a match.
fn terms(motion: &Motion, m: &Match) -> (f64, f64) {
    let Motion { rotation, translation, .. } = motion;
    let line = translation.cross(*rotation * m.one);
    let back = rotation.transpose() * m.other.cross(*translation);
    let s = line.x * line.x + line.y * line.y + back.x * back.x + back.y * back.y;
    (m.other.dot(line), (s + 1e-24).sqrt())
}

/// Returns Sampson's distance of a match.
pub(super) fn distance(motion: &Motion, m: &Match) -> f64 {
    let (e, s) = terms(motion, m);
    e / s
}

/// Returns `Σ w·d²/(d² + fits²)` over the matches.
pub(super) fn cost<'a>(motion: &Motion, matches: impl Iterator<Item = &'a Match>, fits: f64) -> f64 {
    matches.fold(0.0, |sum, m| {
        let d = distance(motion, m);
        sum + m.weight * (d * d / (d * d + fits * fits))
    })
}

/// Returns the motion after `rounds` steps towards the least cost; `None` if the matches do not determine it.
pub(super) fn refine<'a>(
    mut motion: Motion,
    matches: impl Iterator<Item = &'a Match> + Clone,
    fits: f64,
    rounds: usize,
) -> Option<Motion> {
    for _ in 0..rounds {
        let t = motion.translation;
        let (u, v) = across(t);
        let mut normal = Normal::<5>::new();
        for m in matches.clone() {
            let (e, s) = terms(&motion, m);
            let soft = 1.0 + (e / s / fits) * (e / s / fits);
            let y = motion.rotation * m.one;
            let turned = y.cross(m.other.cross(t)) / s;
            let moved = y.cross(m.other) / s;
            let j = [turned.x, turned.y, turned.z, moved.dot(u), moved.dot(v)];
            normal.add(m.weight / (soft * soft), &j, -e / s);
        }
        let mut step = normal.solve()?;
        let longest = step.iter().fold(0.0, |longest: f64, x| longest.max(x.abs()));
        if longest > LONGEST {
            step = step.map(|x| x * (LONGEST / longest));
        }
        let [a, b, c, d, e] = step;
        motion.rotation = turn(DVec3::new(a, b, c)) * motion.rotation;
        motion.translation = (t + d * u + e * v).try_normalize()?;
    }
    Some(motion)
}

/// Returns two directions perpendicular to `t` and to each other.
fn across(t: DVec3) -> (DVec3, DVec3) {
    let a = t.abs();
    let axis = if a.x <= a.y && a.x <= a.z {
        DVec3::X
    } else if a.y <= a.z {
        DVec3::Y
    } else {
        DVec3::Z
    };
    let u = t.cross(axis);
    let u = u / u.length();
    (u, t.cross(u))
}

/// Returns the rotation that alone explains all matches best, with robust weights.
pub(super) fn rotation(matches: &[Match], fits: f64) -> Option<DMat3> {
    let mut rotation = DMat3::IDENTITY;
    for _ in 0..12 {
        let mut normal = Normal::<3>::new();
        for m in matches {
            let y = rotation * m.one;
            let (x, z) = (y.x / y.z, y.y / y.z);
            let (du, dv) = (m.other.x - x, m.other.y - z);
            let w = m.weight / (1.0 + (du * du + dv * dv).sqrt() / fits);
            normal.add(w, &[-x * z, 1.0 + x * x, -z], du);
            normal.add(w, &[-(1.0 + z * z), x * z, x], dv);
        }
        rotation = turn(DVec3::from_array(normal.solve()?)) * rotation;
    }
    Some(rotation)
}

/// Agreement of a motion with all matches.
pub(super) struct Fit {
    /// Fraction of the matches, by weight, that fit.
    pub(super) share: f64,
    /// Fraction of those that are in front of the camera.
    pub(super) ahead: f64,
    /// The median length of their parallax, in units of the focal length.
    pub(super) parallax: f64,
}

/// Measures the agreement of a motion with the matches.
pub(super) fn fit(motion: &Motion, matches: &[Match], fits: f64) -> Fit {
    let (mut all, mut fit, mut ahead) = (0.0, 0.0, 0.0);
    let mut lengths = Vec::with_capacity(matches.len());
    for m in matches {
        all += m.weight;
        if distance(motion, m).abs() < fits {
            fit += m.weight;
            let (inverse, length, _) = super::triangulate::inverse_depth(motion, m.one, m.other);
            ahead += if inverse * length > -fits { m.weight } else { 0.0 };
            lengths.push((inverse * length).abs());
        }
    }
    lengths.sort_by(f64::total_cmp);
    let parallax = lengths.get(lengths.len() / 2).copied().unwrap_or(0.0);
    Fit { share: fit / all, ahead: ahead / (fit + 1e-12), parallax }
}
