//! Gaussians lifted to a depth map, for models whose own depth is little more than an order.
//!
//! A model that ignores depth ([`Reconstructor::ignores_depth`](super::Reconstructor::ignores_depth)) gives every
//! Gaussian of a frame a place on a nearly flat card, in an order that makes the picture. Where the frame has a
//! [`DepthMap`], each Gaussian takes the map's depth at its centre instead, on its own side of an [edge](edges), and
//! keeps the model's relief, which orders neighbours on one surface:
//!
//! ```text
//! y = FAR + (NEAR − FAR)·d + RELIEF·(y_model − ½)·(9.8·y₀ + 0.2)²/9.8        d: the map, 0 farthest to 1 nearest; y₀: the first two terms
//! ```
//!
//! so that the relief is the same length in the scene at any depth. Standard deviations become [`NARROWER`], and before
//! an edge so narrow that little of a Gaussian reaches over it. Where nothing was seen behind an edge, Gaussians are
//! [added](behind). Colours are fitted afterwards.
//!
//! # Maps that tell little
//!
//! | map | result |
//! |---|---|
//! | holes: NaN, infinities, a confidence of 0 | filled from around them ([`fill`]) |
//! | no finite value, or one value alone | as if there were no map |
//! | values beyond [0, 1], after normalisation | held to it |
//! | inverted | taken at its word: the scene is inside out |
//!
//! Maps that are given are [aligned](align) with those of the frames before, along optical flow; without flow
//! (`--motion network`) each is taken as it is. Depth [found](crate::parallax) in the stream has one scale already.

use rayon::prelude::*;
use streamsplat_model::StaticGaussians;

use edges::Surfaces;

mod align;
mod behind;
mod edges;
mod fill;

pub(super) use align::{Alignment, Link, align};
pub(super) use fill::normalise_most;

/// y of what a map calls farthest.
pub const FAR: f32 = 0.1;
/// y of what a map calls nearest.
pub const NEAR: f32 = 0.95;

/// Length in scene units of the model's own relief, were it to fill the whole range of y.
///
/// It is what the relief has in the middle of that range as the model gives it: a camera that turns by 10° sorts
/// neighbours on one surface by their place along the turn unless they are that far apart in depth, and in another
/// order than the model's the picture comes apart.
const RELIEF: f32 = 0.37;
/// Factor on standard deviations: Gaussians that overlap less depend less on their order.
const NARROWER: f32 = 0.9;
/// Standard deviation of a Gaussian before an edge per pixel to the edge from its pixel's far side, and the least one
/// in pixels.
const TO_EDGE: f32 = 0.35;
const LEAST: f32 = 0.4;

/// Inverse depth of a key frame, at the size at which the model sees it.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthMap {
    /// `[H, W]`, 0 farthest to 1 nearest. Values that are not finite are holes.
    pub inverse: Vec<f32>,
    /// `[H, W]`, how far each value can be trusted, 0 not at all to 1; `None`: every value alike.
    pub confidence: Option<Vec<f32>>,
    /// Height and width.
    pub resolution: [usize; 2],
}

/// z in the scene of a map's value.
pub(crate) fn scene_depth(d: f32) -> f32 {
    let y = (NEAR - FAR).mul_add(d.clamp(0.0, 1.0), FAR);
    1.0 / 9.8f32.mul_add(y, 0.2)
}

/// The map's value of a z in the scene.
pub(crate) fn map_value(z: f32) -> f32 {
    ((1.0 / z - 0.2) / 9.8 - FAR) / (NEAR - FAR)
}

/// y of a map's value.
fn depth_of(inverse: f32) -> f32 {
    (NEAR - FAR).mul_add(inverse.clamp(0.0, 1.0), FAR)
}

/// Lifts the Gaussians of a key frame `[3, H, W]` to its map; with `behind`, adds [Gaussians behind](behind) its
/// foreground. Gives the places whose motion these have. Where the map tells nothing, since no two of its values
/// differ, the Gaussians stay as they are.
pub(super) fn lift(gaussians: &mut StaticGaussians, map: &DepthMap, frame: &[f32], behind: bool) -> Vec<[f32; 3]> {
    let Some(filled) = map.filled() else { return Vec::new() };
    let [height, width] = filled.resolution;
    let surfaces = Surfaces::new(&filled, frame);
    let each = gaussians.position.par_iter_mut().zip(&mut gaussians.scale);
    each.with_min_len(256).for_each(|(position, scale)| {
        let [x, y, z] = *position;
        let (Some(column), Some(row)) = (pixel(x, width), pixel(-z, height)) else { return };
        let place = surfaces.at(row, column);
        position[1] = with_relief(depth_of(place.inverse), y);
        for axis in 0..2 {
            scale[axis] *= NARROWER;
            if place.near {
                let unit = 2.0 / if axis == 0 { width } else { height } as f32;
                scale[axis] = scale[axis].min((TO_EDGE * (place.clear[axis] + 0.5)).max(LEAST) * unit);
            }
        }
    });
    if behind { behind::add(gaussians, &surfaces) } else { Vec::new() }
}

/// The depth with the model's own relief.
fn with_relief(depth: f32, own: f32) -> f32 {
    // d(1 / (9.8·y + 0.2)) / dy = −9.8 / (9.8·y + 0.2)²
    let distance = 9.8f32.mul_add(depth, 0.2);
    let step = distance * distance * (RELIEF / 9.8);
    (own - 0.5).mul_add(step, depth).clamp(0.0, 1.0)
}

/// The pixel of a coordinate in [−1, 1] along a side; the nearest one outside, `None` where it is not finite.
fn pixel(x: f32, side: usize) -> Option<usize> {
    x.is_finite().then(|| (((x + 1.0) * 0.5 * side as f32).max(0.0) as usize).min(side - 1))
}
