//! Depth over a window: where each cell of a key frame was in the key frames before, and the inverse depth that these
//! baselines measure together.
//!
//! Slow motion moves the camera so little between two key frames that the parallax is as short as the flow's errors.
//! Over several key frames it is longer. A [`Track`] follows each cell's flow from key frame to key frame:
//!
//! ```text
//! u_k(p) = u_1(p) + u_{k−1}(p + u_1(p))        e_k(p)² = e_1(p)² + e_{k−1}(p + u_1(p))²
//! ```
//!
//! with `u_1` the flow to the key frame before, `e_1` the distance by which the flow back misses `p`, and values
//! between cells interpolated bilinearly. The baselines [`AGES`] are tried from the shortest on. Each estimates its own
//! camera, or is skipped if it shows no parallax ([`NoParallax`](super::NoParallax)). The search ends as soon as the
//! median parallax is [`ENOUGH`]: a longer baseline would only add errors of the chained flow.
//!
//! The first baseline with parallax sets the scale. The others are brought to it by the weighted median ratio; inverse
//! depth is the mean by confidence, summed from the shortest on. Confidence rises with the square of the parallax'
//! length in pixels, so long baselines count more where the flow holds.

use streamsplat_kernels::Level;
use streamsplat_kernels::flow::{self, Field};
use streamsplat_kernels::philox::Stream;

use super::filter::{NEAREST, weighted_median};
use super::matches::LEAST;
use super::triangulate::{self, Cell};
use super::{CELL, NoParallax, Sight};

/// Key frames that are remembered.
pub(super) const LENGTH: usize = 8;
/// Baselines, in key frames.
const AGES: [usize; 4] = [1, 2, 4, LENGTH];
/// Median length of the parallax, in pixels of a picture 512 pixels wide, that needs no longer baseline.
const ENOUGH: f64 = 8.0;

/// Median length of the flow, in the same pixels, from which on the errors of a chain that is twice as long outweigh
/// its parallax.
const FAR: f64 = 24.0;

/// Where each cell of a key frame is in an earlier one.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Track {
    /// Displacement of each cell's middle to the right, in pixels.
    pub u: Vec<f32>,
    /// Displacement downwards.
    pub v: Vec<f32>,
    /// Standard error of the displacement, in pixels; infinite where the cell is not seen in the earlier frame.
    pub astray: Vec<f32>,
}

/// The tracks of a key frame to those before it, the newest first: at most 8, and no longer than a quarter of the cells
/// are seen.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Window {
    /// One track per earlier key frame.
    pub tracks: Vec<Track>,
}

impl Track {
    /// The track to the key frame before.
    pub(super) fn of(sight: &Sight<'_>) -> Track {
        let count = sight.grid[0] * sight.grid[1];
        let mut track = Track { u: vec![0.0; count], v: vec![0.0; count], astray: vec![f32::INFINITY; count] };
        for cell in 0..count {
            let [x, y] = sight.middle(cell);
            let [u, v] = sight.evidence.there.at(x, y);
            let astray = sight.astray[sight.pixel(cell)];
            if u.is_finite() && v.is_finite() && astray.is_finite() {
                (track.u[cell], track.v[cell], track.astray[cell]) = (u, v, astray);
            }
        }
        track
    }

    /// The median length of the displacement of the cells that are seen, in pixels; 0 without any.
    fn length(&self) -> f32 {
        let seen = (0..self.u.len()).filter(|cell| self.astray[*cell].is_finite());
        let mut squares: Vec<f32> =
            seen.map(|cell| self.u[cell] * self.u[cell] + self.v[cell] * self.v[cell]).collect();
        if squares.is_empty() {
            return 0.0;
        }
        let middle = squares.len() / 2;
        squares.select_nth_unstable_by(middle, f32::total_cmp).1.sqrt()
    }

    /// Returns true if as large a part of the cells is seen as a camera's motion needs. Longer tracks see no more.
    fn is_seen(&self) -> bool {
        let seen = self.astray.iter().filter(|astray| astray.is_finite()).count();
        seen as f64 >= LEAST * self.astray.len() as f64
    }

    /// Continues along `before`, a track of the frame that this one leads to. `step`: this track in cells.
    fn then(&self, level: Level, step: &Field, before: &Track) -> Track {
        let planes = [&before.u[..], &before.v, &before.astray].concat();
        let far = flow::warp(level, &planes, step.size, step);
        let count = self.u.len();
        let mut track = Track { u: vec![0.0; count], v: vec![0.0; count], astray: vec![f32::INFINITY; count] };
        for cell in 0..count {
            let [u, v, error] = [far[cell], far[count + cell], far[2 * count + cell]];
            let astray = (self.astray[cell] * self.astray[cell] + error * error).sqrt();
            if astray.is_finite() {
                (track.u[cell], track.v[cell], track.astray[cell]) = (self.u[cell] + u, self.v[cell] + v, astray);
            }
        }
        track
    }
}

impl Window {
    /// The tracks of the picture that `sight` is of, if this window is that of the picture before.
    pub(super) fn advance(&self, level: Level, sight: &Sight<'_>) -> Window {
        let first = Track::of(sight);
        let cells = first.u.len();
        let in_cells = |plane: &[f32]| plane.iter().map(|pixels| pixels / CELL as f32).collect();
        let step = Field { size: sight.grid, u: in_cells(&first.u), v: in_cells(&first.v) };
        let before = self.tracks.iter().take(LENGTH - 1).take_while(|track| track.u.len() == cells);
        let longer = before.map(|before| first.then(level, &step, before)).take_while(Track::is_seen);
        let longer: Vec<Track> = longer.collect();
        Window { tracks: std::iter::once(first).chain(longer).collect() }
    }

    /// Inverse depth of all cells from the baselines of this window, in units of the median of the shortest one with
    /// parallax. Where none has any, the reason of the shortest one.
    pub(super) fn cells(&self, sight: &Sight<'_>, stream: Stream) -> Result<Vec<Cell>, NoParallax> {
        let mut joined: Option<(Vec<Cell>, f64)> = None;
        let (mut shorter, mut reason) = (None, None);
        for (part, age) in AGES.into_iter().enumerate() {
            let Some(track) = self.tracks.get(age - 1) else { break };
            let mut enough = f64::from(track.length()) >= FAR * sight.unit;
            match sight.camera(track, stream, part as u64, shorter.as_ref()) {
                Ok((motion, parallax)) => {
                    let unit = joined.as_ref().map(|(_, unit)| *unit);
                    let (cells, unit) = triangulate::cells(sight, track, &motion, unit);
                    match &mut joined {
                        None => joined = Some((cells, unit)),
                        Some((joined, _)) => add(joined, &cells),
                    }
                    enough |= parallax >= ENOUGH;
                    shorter = Some(motion);
                }
                Err(none) => reason = reason.or(Some(none)),
            }
            if enough {
                break;
            }
        }
        joined.map(|(cells, _)| cells).ok_or(reason.unwrap_or(NoParallax::Inconsistent))
    }

    /// Expected and found values, if this cannot be the window of a picture of this size.
    pub fn contradiction(&self, size: [usize; 2]) -> Option<String> {
        let count = size.map(|side| side.div_ceil(CELL)).into_iter().try_fold(1_usize, usize::checked_mul);
        let lengths =
            |track: &Track| [&track.u, &track.v, &track.astray].iter().all(|plane| count == Some(plane.len()));
        let finite = |plane: &[f32]| plane.iter().all(|v| v.is_finite());
        let sound = |track: &Track| finite(&track.u) && finite(&track.v) && track.astray.iter().all(|e| *e >= 0.0);
        let fits = self.tracks.len() <= LENGTH && self.tracks.iter().all(|track| lengths(track) && sound(track));
        let [height, width] = size;
        (!fits).then(|| format!("expected at most {LENGTH} finite tracks of the cells of {width}x{height} pixels"))
    }
}

/// Adds the cells of a longer baseline, brought to the scale of `now`.
fn add(now: &mut [Cell], longer: &[Cell]) {
    let both = now.iter().zip(longer);
    let ratios = both.map(|(a, b)| (a.inverse / b.inverse.max(1e-6), a.confidence.min(b.confidence)));
    let Some(scale) = weighted_median(ratios) else { return };
    for (now, longer) in now.iter_mut().zip(longer) {
        let whole = now.confidence + longer.confidence;
        if whole > 0.0 {
            let sum = (longer.inverse * scale).mul_add(longer.confidence, now.inverse * now.confidence);
            (now.inverse, now.confidence) = ((sum / whole).min(NEAREST), whole);
        }
        now.moves |= longer.moves;
        now.hint |= longer.hint;
    }
}
