//! Depth without parallax: a guess from where things are in the picture.
//!
//! A camera that stands, or only turns, measures no depth. In most of its pictures a ground rises from the lower edge
//! to a wall, a wood or a horizon, and what stands on it is upright:
//!
//! ```text
//! ρ(row) = max(1, 1 + (NEAR − 1)·(row − base) / (rows − base))        base = BASE·rows
//! ```
//!
//! with ρ the inverse depth. A plane `n·X = d` has `ρ = n·x / d` at the position `x` of its point `X = x / ρ`: linear
//! in the row, if the camera is upright. Flow that is not the camera's own belongs to something that moves by itself.
//! It is at the depth of the ground under it: `bodies`.
//!
//! The confidence is [`TRUST`], and does not grow when the guess is repeated. Depth that was measured and is carried
//! stays until its confidence has decayed to that; depth that is measured later outweighs the guess.

use super::bodies::STILL_BODY;
use super::filter::{NEAREST, weighted_median};
use super::triangulate::Cell;
use super::window::Track;
use super::{NoParallax, Sight, homography, matches};

/// Row from which on the ground rises, as a fraction of the rows.
const BASE: f64 = 0.45;
/// Inverse depth of the ground at the picture's lower edge, relative to that behind it.
const NEAR: f64 = 3.5;
/// Confidence of the guess.
pub(super) const TRUST: f32 = 0.03;
/// Distance from the camera's own flow, in pixels of a picture 512 wide, above which a match certainly moves by itself;
/// and distance above which this is likely.
const MOVES: f64 = 2.0;
const LIKELY: f64 = 1.0;
/// Fraction of the flow's length that is added to both.
const TRAVEL: f64 = 0.08;

/// The cells of the picture that `sight` is of, guessed where `carried` holds nothing better. `track`: the flow to the
/// key frame before; `reason`: why it shows no parallax. They are in the scale of the carried cells, if there are any.
pub(super) fn cells(sight: &Sight<'_>, track: &Track, reason: NoParallax, carried: Option<&[Cell]>) -> Vec<Cell> {
    let [rows, columns] = sight.grid;
    let fits = super::FITS * sight.unit / sight.focal;
    let own = match reason {
        NoParallax::Still => None,
        _ => matches::of(sight, track).map(|matches| homography::fit(&matches, fits)),
    };
    let own = own.unwrap_or(homography::IDENTITY);
    let base = BASE * rows as f64;
    let guessed = (0..rows * columns).map(|cell| {
        let row = (cell / columns) as f64 + 0.5;
        let inverse = (1.0 + (NEAR - 1.0) * (row - base) / (rows as f64 - base)).max(1.0);
        let at = sight.middle(cell);
        let (u, v) = (track.u[cell], track.v[cell]);
        let one = sight.direction(at, sight.focal);
        let other = sight.direction([at[0] + u, at[1] + v], sight.focal);
        let off = homography::miss(&own, one, other) * sight.focal / sight.unit;
        let travel = f64::from((u * u + v * v).sqrt()) / sight.unit;
        let (astray, texture) = (f64::from(track.astray[cell]) / sight.unit, sight.texture[sight.pixel(cell)]);
        let beyond = |least: f64| off > TRAVEL.mul_add(travel, least);
        let moves = astray < 1.0 && texture > 0.3 && beyond(MOVES);
        let hint = astray < 2.0 && texture > 0.1 && beyond(LIKELY);
        Cell { inverse: inverse as f32, confidence: TRUST, moves, hint, body: 0.0 }
    });
    let mut cells: Vec<Cell> = guessed.collect();
    if let Some(carried) = carried {
        join(&mut cells, carried);
    }
    cells
}

/// Brings the guess to the scale of the carried cells, by the weighted median ratio. Carried cells stay while their
/// confidence is at least twice [`TRUST`]; from there to [`TRUST`] the guess replaces them linearly. Those of a body
/// are replaced at once: the body may have left them.
fn join(cells: &mut [Cell], carried: &[Cell]) {
    let ratios = cells.iter().zip(carried).map(|(now, then)| (then.inverse / now.inverse, then.confidence));
    let scale = weighted_median(ratios).unwrap_or(1.0);
    for (now, then) in cells.iter_mut().zip(carried) {
        now.inverse = (now.inverse * scale).min(NEAREST);
        if then.body < STILL_BODY {
            let share = (then.confidence / TRUST - 1.0).clamp(0.0, 1.0);
            now.inverse = (then.inverse - now.inverse).mul_add(share, now.inverse);
            now.confidence = now.confidence.max(then.confidence);
        }
    }
}
