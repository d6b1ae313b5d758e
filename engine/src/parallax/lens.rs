//! The focal length of a scene that would otherwise be upside down.
//!
//! The focal length is assumed ([`FOCAL`](super::FOCAL)). If the true one is longer, and the camera turns while it
//! moves (it follows a runner, a car), the assumed one takes a part of the turn for parallax. Where this part is larger
//! than the parallax and opposite to it, near and far change places: the background is in front of the car. Matches
//! alone cannot tell the two apart: with a longer focal length the reversed scene fits about as well (the bas-relief
//! ambiguity; Szeliski & Kang, *Shape ambiguities in structure from motion*, 1997).
//!
//! The ground can: in most pictures what is lower is nearer. [`upright`] is the rank correlation of a match's
//! inverse depth with its row. If it is less than −[`DOUBT`], or the assumed focal length fits no motion (it puts many
//! matches behind the camera), longer ones are tried. The one of least cost that puts the scene upright (more than
//! [`DOUBT`]), and fits nearly as well, is used. If none does, there is no depth
//! ([`NoParallax::Reversed`](super::NoParallax::Reversed)).

use super::Motion;
use super::epipolar::distance;
use super::matches::Match;
use super::triangulate::inverse_depth;

/// Focal lengths that are tried, relative to the assumed one: to a long telephoto.
pub(super) const LENSES: [f64; 3] = [1.5, 2.2, 3.5];
/// Rank correlation of inverse depth and row, below which order is in doubt.
pub(super) const DOUBT: f64 = 0.2;
/// The cost of a longer focal length, relative to that of the assumed one, up to which it fits nearly as well.
pub(super) const NEARLY: f64 = 1.25;

/// Returns the matches through a lens of this focal length, relative to the one of the matches.
pub(super) fn through(lens: f64, matches: &[Match]) -> Vec<Match> {
    let at = |d: glam::DVec3| glam::DVec3::new(d.x / lens, d.y / lens, 1.0);
    matches.iter().map(|m| Match { one: at(m.one), other: at(m.other), weight: m.weight }).collect()
}

/// Returns Spearman's rank correlation of inverse depth and row, downwards, over the matches within `fits` of their
/// epipolar lines: 1 if everything lower is nearer. Equal values have the order of the matches.
pub(super) fn upright(motion: &Motion, matches: &[Match], fits: f64) -> f64 {
    let fitting = matches.iter().filter(|m| distance(motion, m).abs() < fits);
    let pairs: Vec<(f64, f64)> =
        fitting.map(|m| (inverse_depth(motion, m.one, m.other).0, m.one.y)).filter(|(v, _)| v.is_finite()).collect();
    let [nearness, rows] = [ranks(pairs.iter().map(|p| p.0)), ranks(pairs.iter().map(|p| p.1))];
    let (product, square) = nearness.iter().zip(&rows).fold((0.0, 0.0), |(ab, aa), (a, b)| (ab + a * b, aa + a * a));
    if square > 0.0 { product / square } else { 0.0 }
}

/// Returns the rank of each value, from −½(n−1) to ½(n−1).
fn ranks(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut order: Vec<(usize, f64)> = values.enumerate().collect();
    order.sort_by(|a, b| a.1.total_cmp(&b.1));
    let middle = 0.5 * (order.len() as f64 - 1.0);
    let mut ranks = vec![0.0; order.len()];
    for (rank, (at, _)) in order.into_iter().enumerate() {
        ranks[at] = rank as f64 - middle;
    }
    ranks
}
