//! Depth from parallax: how near the parts of a scene are, from the optical flow between two pictures by a moving
//! camera.
//!
//! A point that is seen at `x₁` (homogeneous, divided by the focal length) in one picture is seen at
//!
//! ```text
//! x₂ ~ R·x₁ + ρ·t        ρ: its inverse depth, in units of the length of t
//! ```
//!
//! in the other, `R` and `t` being the camera's motion. [`find`] goes these steps, each in a module of its own:
//!
//! 1. Matches of a sparse grid, weighted by texture, where the flow back undoes the flow.
//! 2. Model selection. A camera that does not move, one that only turns, or one plane show no parallax (Hartley &
//!    Zisserman, *Multiple View Geometry*, 13.1): `homography`. Things that move by themselves before a camera that
//!    only turns look like parallax; where most matches fit a homography that is no turn the camera moves, and the
//!    residual is parallax: `turning`.
//! 3. The camera's motion by a search of random samples with a fixed number of draws, refined on all matches with
//!    robust weights (ibid. 11.4.3, 11.6): `ransac`, `epipolar`.
//! 4. Inverse depth of every cell of a grid of 2×2 pixels, linear in `ρ` (ibid. 12.2), with a confidence: texture,
//!    length of the parallax, distance from the epipolar line, and how well the flow back undoes the flow:
//!    `triangulate`.
//! 5. Things that move by themselves fit no epipolar line; each takes one depth, that of the ground under it: `bodies`.
//! 6. The inverse depth of the frame before is carried along the flow, brought to one scale, and averaged by
//!    confidence: `filter`.
//! 7. Holes are filled by smoothing that stops at edges of the picture (Gastal & Oliveira, *Domain transform*, SIGGRAPH
//!    2011): `fill`.
//!
//! # Without parallax
//!
//! | interval | result |
//! |---|---|
//! | a camera that does not move, one that only turns, one plane, no one motion that half of the matches fit, a median parallax of less than 0.4 pixels of 512 | the inverse depth of the frame before, carried along the flow; its confidence falls from key frame to key frame |
//! | nothing to carry, or nothing left of its confidence | none: the frame is as without a map |
//! | flow that is no number | none |
//! | one inverse depth all over | none |
//!
//! A stream's first key frame has no flow. Its depth is found with the second one's, along the flow to it, and joined
//! with that.
//!
//! The focal length is unknown; [`FOCAL`] of the picture's longer side is taken. Where it is wrong depth is bent but
//! keeps its order. All arithmetic is in binary64 or binary32 in one order on one thread, with +, −, ×, / and √ and the
//! exponential of [`streamsplat_kernels::math`].

mod bodies;
mod epipolar;
mod fill;
mod filter;
mod homography;
mod linear;
mod matches;
mod ransac;
mod triangulate;
mod turning;

#[cfg(test)]
mod tests;

use glam::DMat3;
use streamsplat_kernels::Level;
use streamsplat_kernels::flow::Field;
use streamsplat_kernels::philox::Stream;

pub use filter::Found;

/// Focal length in longer sides of the picture.
pub const FOCAL: f64 = 0.82;
/// Pixels of a cell's side.
pub const CELL: usize = 2;
/// Distance in pixels, of a picture 512 pixels wide, within which a match fits a model.
const FITS: f64 = 1.0;
/// Median length of the flow, in the same pixels, below which the picture is still.
const STILL: f64 = 1.0;
/// Share of the matches that fit a homography from which on the rest is not taken for parallax where a turn may explain
/// the homography: it may as well move by itself.
const FLAT: f64 = 0.8;
/// A turn explains a homography if so large a part of the matches that fit it fit the turn.
const TURNS: f64 = 0.8;
/// Share of the matches that a motion must explain beyond those that fit a homography.
const BEYOND: f64 = 0.05;
/// Median length of the parallax, in the same pixels, from which on it exceeds the flow's errors.
const LEAST_LENGTH: f64 = 0.4;

/// A picture, and the flow that leads from it to an earlier one.
#[derive(Clone, Copy)]
pub struct Evidence<'a> {
    /// `[3, H, W]` in [0, 1].
    pub rgb: &'a [f32],
    /// To the earlier picture.
    pub there: &'a Field,
    /// From the earlier picture.
    pub back: &'a Field,
}

/// Reasons why an interval shows no parallax.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoParallax {
    /// Most of the picture is still.
    Still,
    /// The camera turns, there is one plane, or the parallax is too short: a homography explains the flow.
    Flat,
    /// Too few matches fit any motion of a camera.
    Inconsistent,
}

/// The camera's motion from a picture to another: `x₂ ~ R·x₁ + ρ·t`, `|t| = 1`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// R
    pub rotation: DMat3,
    /// t
    pub translation: glam::DVec3,
}

/// The motion of the camera, if there is any parallax. `stream`: source of the random numbers.
///
/// # Errors
/// The reason why there is none.
pub fn camera(level: Level, evidence: Evidence<'_>, stream: Stream) -> Result<Motion, NoParallax> {
    let sight = Sight::new(level, evidence);
    sight.camera(stream)
}

/// Inverse depth of the picture's cells from this interval and `before`, the result for the earlier picture. `None`
/// where neither has any.
pub fn find(level: Level, evidence: Evidence<'_>, before: Option<&Found>, stream: Stream) -> Option<Found> {
    let sight = Sight::new(level, evidence);
    let carried = before.map(|found| filter::carry(found, &sight));
    let now = sight.camera(stream).ok().map(|motion| {
        let mut cells = triangulate::cells(&sight, &motion);
        let before = carried.as_ref().and_then(|carried| carried.as_ref());
        bodies::settle(&mut cells, before.map(|(cells, _)| &cells[..]), &sight);
        cells
    });
    filter::join(now, carried, &sight)
}

/// Values computed once of a pair of pictures.
struct Sight<'a> {
    evidence: Evidence<'a>,
    /// Rows and columns of cells.
    grid: [usize; 2],
    /// Focal length in pixels.
    focal: f64,
    /// Pixels of a picture as many times narrower than 512.
    unit: f64,
    /// Per pixel, from 0 to 1: certainty of its place in every direction.
    texture: Vec<f32>,
    /// Per pixel: distance by which the backward flow misses it, or infinity where the flow leaves the picture.
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

    fn camera(&self, stream: Stream) -> Result<Motion, NoParallax> {
        let matches = matches::of(self).ok_or(NoParallax::Inconsistent)?;
        if matches::median_length(&matches) * self.focal < STILL * self.unit {
            return Err(NoParallax::Still);
        }
        let fits = FITS * self.unit / self.focal;
        let flat = homography::share(&matches, fits);
        if flat > FLAT && turning::share(&matches, fits) >= TURNS * flat {
            return Err(NoParallax::Flat);
        }
        let motion = ransac::motion(&matches, fits, stream).ok_or(NoParallax::Inconsistent)?;
        let fit = epipolar::fit(&motion, &matches, fits);
        if fit.share < 0.5 || fit.ahead < 0.75 {
            return Err(NoParallax::Inconsistent);
        }
        if fit.share < flat + BEYOND || fit.parallax * self.focal < LEAST_LENGTH * self.unit {
            return Err(NoParallax::Flat);
        }
        Ok(motion)
    }

    /// Column and row of a cell's middle, in pixels.
    fn middle(&self, cell: usize) -> [f32; 2] {
        let [row, column] = [cell / self.grid[1], cell % self.grid[1]];
        let half = (CELL - 1) as f32 * 0.5;
        let [height, width] = self.evidence.there.size;
        [((column * CELL) as f32 + half).min(width as f32 - 1.0), ((row * CELL) as f32 + half).min(height as f32 - 1.0)]
    }

    /// The pixel next to a cell's middle.
    fn pixel(&self, cell: usize) -> usize {
        let [row, column] = [cell / self.grid[1], cell % self.grid[1]];
        row * CELL * self.evidence.there.size[1] + column * CELL
    }

    /// A place in pixels as a direction.
    fn direction(&self, [x, y]: [f32; 2]) -> glam::DVec3 {
        let [height, width] = self.evidence.there.size.map(|side| (side as f64 - 1.0) * 0.5);
        glam::DVec3::new((f64::from(x) - width) / self.focal, (f64::from(y) - height) / self.focal, 1.0)
    }
}
