//! Depth from parallax: the inverse depth of a scene's parts, from the optical flow between two pictures by a moving
//! camera.
//!
//! A point seen at `x₁` (homogeneous, divided by the focal length) in one picture is seen at
//!
//! ```text
//! x₂ ~ R·x₁ + ρ·t        ρ: its inverse depth, in units of the length of t
//! ```
//!
//! in the other, where `R` and `t` are the camera's motion. [`find`] has these steps, each in its own module:
//!
//! 1. Matches of a sparse grid, weighted by texture, where backward and forward flow agree.
//! 2. Model selection. A camera that does not move, one that only turns, and a single plane show no parallax (Hartley &
//!    Zisserman, *Multiple View Geometry*, 13.1): `homography`. With a camera that only turns, independently moving
//!    objects look like parallax. If most matches fit a homography that is not a rotation, the camera moves, and the
//!    residual is parallax: `turning`.
//! 3. The camera's motion, by a random search with a fixed number of draws, refined on all matches with robust weights
//!    (ibid. 11.4.3, 11.6): `ransac`, `epipolar`.
//! 4. Inverse depth of every cell of a grid of 2×2 pixels, linear in `ρ` (ibid. 12.2), with a confidence: texture,
//!    length of the parallax, distance from the epipolar line, and agreement of backward and forward flow:
//!    `triangulate`.
//!    Where the parallax is short, the flow is followed over several key frames, and their baselines are joined:
//!    `window`.
//! 5. Independently moving objects fit no epipolar line; each gets one depth, that of the ground under it: `bodies`.
//! 6. The inverse depth of the previous frame is carried along the flow, brought to one scale, and averaged by
//!    confidence: `filter`.
//! 7. Holes are filled by smoothing that stops at edges of the picture (Gastal & Oliveira, *Domain transform*, SIGGRAPH
//!    2011): `fill`.
//!
//! # Without parallax
//!
//! | interval | result |
//! |---|---|
//! | a camera that does not move or only turns, a single plane, no motion that half of the matches fit, a median parallax of less than 0.4 pixels of 512, upper parts that would be nearer through every lens tried | the inverse depth of the previous frame, carried along the flow; its confidence falls with each key frame |
//! | no depth to carry, or one without confidence | none: the frame is processed without a map |
//! | flow with NaN | none |
//! | constant inverse depth | none |
//!
//! With [`Settings::guess_depth`](crate::Settings::guess_depth) an interval in which the camera does not move or only
//! turns, or sees one plane, adds a guess: a ground with upright bodies on it, `ground`. Measured depth that is carried
//! or found later outweighs it.
//!
//! A stream's first key frame has no flow. Its depth is computed together with the second key frame's, along the flow
//! to that frame, and joined with it.
//!
//! The focal length is unknown and assumed to be [`FOCAL`] times the picture's longer side. A wrong focal length
//! distorts depth. If the camera turns while it moves, it may even reverse the order: then longer ones are tried, see
//! `lens`. All arithmetic is in binary64 or binary32 in one order on one thread, with +, −,
//! ×, / and √ and the exponential of [`streamsplat_kernels::math`].

mod bodies;
mod epipolar;
mod fill;
mod filter;
mod ground;
mod homography;
mod lens;
mod linear;
mod matches;
mod ransac;
mod triangulate;
mod turning;
mod window;

#[cfg(test)]
mod tests;

use glam::DMat3;
use streamsplat_kernels::Level;
use streamsplat_kernels::flow::Field;
use streamsplat_kernels::philox::Stream;

pub(crate) use filter::Filled;
pub use filter::Found;
pub use window::{Track, Window};

/// Focal length, relative to the picture's longer side.
pub const FOCAL: f64 = 0.82;
/// Side of a cell, in pixels.
pub const CELL: usize = 2;
/// Distance in pixels, of a picture 512 pixels wide, within which a match fits a model.
const FITS: f64 = 1.0;
/// Median length of the flow, in the same pixels, below which the picture is still.
const STILL: f64 = 1.0;
/// Fraction of the matches that fit a homography. Above it, if a rotation may explain the homography, the other matches
/// do not count as parallax, because they may be independently moving objects.
const FLAT: f64 = 0.8;
/// A rotation explains a homography if it fits this fraction of the matches that fit the homography.
const TURNS: f64 = 0.8;
/// Fraction of the matches that a motion must explain beyond those that fit a homography.
const BEYOND: f64 = 0.05;
/// Median length of the parallax, in the same pixels, above which it exceeds the flow's errors.
const LEAST_LENGTH: f64 = 0.4;

/// A picture, and the flow between it and an earlier one.
#[derive(Clone, Copy)]
pub struct Evidence<'a> {
    /// The picture, `[3, H, W]` in [0, 1].
    pub rgb: &'a [f32],
    /// Flow to the earlier picture.
    pub there: &'a Field,
    /// Flow from the earlier picture.
    pub back: &'a Field,
}

/// Reasons why an interval shows no parallax.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoParallax {
    /// Most of the picture is still.
    Still,
    /// A homography explains the flow: the camera only turns, the scene is one plane, or the parallax is too short.
    Flat,
    /// Too few matches fit any motion of a camera.
    Inconsistent,
    /// What is higher in the picture would be nearer, with every focal length that was tried.
    Reversed,
}

/// The camera's motion from one picture to another: `x₂ ~ R·x₁ + ρ·t`, `|t| = 1`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// The rotation R.
    pub rotation: DMat3,
    /// The translation t.
    pub translation: glam::DVec3,
    /// The focal length by which positions are divided, relative to the picture's longer side.
    pub focal: f64,
}

/// Estimates the motion of the camera, if there is parallax. `stream`: source of the random numbers.
///
/// # Errors
/// The reason why there is no parallax.
pub fn camera(level: Level, evidence: Evidence<'_>, stream: Stream) -> Result<Motion, NoParallax> {
    let sight = Sight::new(level, evidence);
    sight.camera(&Track::of(&sight), stream, 0, None).map(|(motion, _)| motion)
}

/// Computes the inverse depth of the picture's cells from this interval, `before`, the result for the earlier picture,
/// and `window`, the earlier picture's. `None` if none has any. Returns the picture's window as well.
pub fn find(
    level: Level,
    evidence: Evidence<'_>,
    before: Option<&Found>,
    window: &Window,
    stream: Stream,
) -> (Option<Found>, Window) {
    let Search { filled, window, .. } = search(level, evidence, before, window, stream, false);
    (filled.map(|filled| filled.found), window)
}

/// Result of [`search`].
pub(crate) struct Search {
    /// Inverse depth, if there is any.
    pub(crate) filled: Option<Filled>,
    /// True if a guess is part of it.
    pub(crate) guessed: bool,
    /// The picture's window.
    pub(crate) window: Window,
}

/// [`find`] with the holes filled. `guess`: an interval without parallax may add a guess ([`ground`]).
pub(crate) fn search(
    level: Level,
    evidence: Evidence<'_>,
    before: Option<&Found>,
    window: &Window,
    stream: Stream,
    guess: bool,
) -> Search {
    let sight = Sight::new(level, evidence);
    let carried = before.map(|found| filter::carry(found, &sight));
    let window = window.advance(level, &sight);
    let before = carried.as_ref().and_then(|carried| carried.as_ref()).map(|(cells, _)| &cells[..]);
    let (now, carried, guessed) = match (window.cells(&sight, stream), window.tracks.first()) {
        (Ok(mut cells), _) => {
            bodies::settle(&mut cells, before, &sight, bodies::CONFIDENCE);
            (Some(cells), carried, false)
        }
        (Err(reason @ (NoParallax::Still | NoParallax::Flat)), Some(track)) if guess => {
            let mut cells = ground::cells(&sight, track, reason, before);
            bodies::settle(&mut cells, before, &sight, ground::TRUST);
            match carried.flatten() {
                None => (Some(cells), None, true),
                // They are in the carried scale already.
                Some((_, nearest)) => (None, Some(Some((cells, nearest))), true),
            }
        }
        _ => (None, carried, false),
    };
    let filled = filter::join(level, now, carried, &sight);
    Search { guessed: guessed && filled.is_some(), filled, window }
}

/// Values computed once for a pair of pictures.
struct Sight<'a> {
    evidence: Evidence<'a>,
    /// Rows and columns of cells.
    grid: [usize; 2],
    /// Assumed focal length in pixels.
    focal: f64,
    /// The picture's width divided by 512.
    unit: f64,
    /// Certainty of each pixel's position in every direction, from 0 to 1.
    texture: Vec<f32>,
    /// Distance by which the backward flow misses each pixel; infinity where the flow leaves the picture.
    astray: Vec<f32>,
}

impl Sight<'_> {
    fn new(level: Level, evidence: Evidence<'_>) -> Sight<'_> {
        let size @ [height, width] = evidence.there.size;
        let mut astray = evidence.there.round_trip(level, evidence.back);
        for (i, astray) in astray.iter_mut().enumerate() {
            let (x, y) = ((i % width) as f32 + evidence.there.u[i], (i / width) as f32 + evidence.there.v[i]);
            let inside = (0.0..=width as f32 - 1.0).contains(&x) && (0.0..=height as f32 - 1.0).contains(&y);
            if !inside || !astray.is_finite() {
                *astray = f32::INFINITY;
            }
        }
        let longer = height.max(width) as f64;
        Sight {
            evidence,
            grid: size.map(|side| side.div_ceil(CELL)),
            focal: FOCAL * longer,
            unit: longer / 512.0,
            texture: matches::texture(evidence.rgb, size),
            astray,
        }
    }

    /// The camera's motion along a track, and the median length of the parallax in pixels of a picture 512 pixels wide.
    /// `part`: which part of the random stream is used. `shorter`: the motion along a shorter track, whose focal length
    /// is tried first.
    fn camera(
        &self,
        track: &Track,
        stream: Stream,
        part: u64,
        shorter: Option<&Motion>,
    ) -> Result<(Motion, f64), NoParallax> {
        let matches = matches::of(self, track).ok_or(NoParallax::Inconsistent)?;
        if matches::median_length(&matches) * self.focal < STILL * self.unit {
            return Err(NoParallax::Still);
        }
        let fits = FITS * self.unit / self.focal;
        let flat = homography::share(&matches, fits);
        if flat > FLAT && turning::share(&matches, fits) >= TURNS * flat {
            return Err(NoParallax::Flat);
        }
        let usual = shorter.map_or(1.0, |motion| motion.focal / FOCAL);
        let first =
            self.motion(&matches, flat, usual, |matches, fits| ransac::motion(matches, fits, stream, part, shorter));
        let (most, reason) = match first {
            Ok(seen) if seen.upright >= -lens::DOUBT => return Ok((seen.motion, seen.parallax)),
            Ok(seen) => (lens::NEARLY * seen.cost, NoParallax::Reversed),
            Err(NoParallax::Inconsistent) => (f64::INFINITY, NoParallax::Inconsistent),
            Err(reason) => return Err(reason),
        };
        let longer = lens::LENSES.into_iter().filter(|lens| *lens > usual);
        let seen = longer.filter_map(|lens| {
            let search = |matches: &[matches::Match], fits| ransac::motion(matches, fits, stream, part, None);
            let seen = self.motion(&matches, flat, lens, search).ok()?;
            (seen.upright > lens::DOUBT && seen.cost <= most).then_some(seen)
        });
        let best = seen.min_by(|a, b| a.cost.total_cmp(&b.cost)).ok_or(reason)?;
        Ok((best.motion, best.parallax))
    }

    /// The motion that `search` finds in the matches through a lens, if it explains enough of them beyond `flat`.
    fn motion(
        &self,
        matches: &[matches::Match],
        flat: f64,
        lens: f64,
        search: impl Fn(&[matches::Match], f64) -> Option<Motion>,
    ) -> Result<Seen, NoParallax> {
        let focal = lens * self.focal;
        let matches = lens::through(lens, matches);
        let fits = FITS * self.unit / focal;
        let motion = Motion { focal: lens * FOCAL, ..search(&matches, fits).ok_or(NoParallax::Inconsistent)? };
        let fit = epipolar::fit(&motion, &matches, fits);
        if fit.share < 0.5 || fit.ahead < 0.75 {
            return Err(NoParallax::Inconsistent);
        }
        if fit.share < flat + BEYOND || fit.parallax * focal < LEAST_LENGTH * self.unit {
            return Err(NoParallax::Flat);
        }
        Ok(Seen {
            motion,
            parallax: fit.parallax * focal / self.unit,
            cost: epipolar::cost(&motion, matches.iter(), fits),
            upright: lens::upright(&motion, &matches, 2.0 * fits),
        })
    }

    /// Returns column and row of a cell's middle, in pixels.
    fn middle(&self, cell: usize) -> [f32; 2] {
        let [row, column] = [cell / self.grid[1], cell % self.grid[1]];
        let half = (CELL - 1) as f32 * 0.5;
        let [height, width] = self.evidence.there.size;
        [((column * CELL) as f32 + half).min(width as f32 - 1.0), ((row * CELL) as f32 + half).min(height as f32 - 1.0)]
    }

    /// Returns the pixel next to a cell's middle.
    fn pixel(&self, cell: usize) -> usize {
        let [row, column] = [cell / self.grid[1], cell % self.grid[1]];
        row * CELL * self.evidence.there.size[1] + column * CELL
    }

    /// Converts a position in pixels to a direction, for a focal length in pixels.
    fn direction(&self, [x, y]: [f32; 2], focal: f64) -> glam::DVec3 {
        let [height, width] = self.evidence.there.size.map(|side| (side as f64 - 1.0) * 0.5);
        glam::DVec3::new((f64::from(x) - width) / focal, (f64::from(y) - height) / focal, 1.0)
    }
}

/// A camera's motion that the matches show.
struct Seen {
    motion: Motion,
    /// Median length of the parallax, in pixels of a picture 512 pixels wide.
    parallax: f64,
    /// The sum of the matches' distances from it: [`epipolar::cost`].
    cost: f64,
    /// Rank correlation of inverse depth and row: [`lens::upright`].
    upright: f64,
}
