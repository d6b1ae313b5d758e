//! Gaussians lifted to a depth map, for models whose own depth is little more than an order.
//!
//! A model that ignores depth ([`Reconstructor::ignores_depth`](super::Reconstructor::ignores_depth)) gives every Gaussian of a frame a place on a nearly flat card, in an
//! order that makes the picture. Where the frame has a [`DepthMap`], each Gaussian takes the map's depth at its centre instead, and keeps of its own just so much
//! relief that neighbours on one surface are still drawn in the model's order:
//!
//! ```text
//! y = FAR + (NEAR − FAR)·d + RELIEF·(y_model − ½)/slope        d: the map, 0 farthest to 1 nearest
//! ```
//!
//! with `slope` the steepness of `1 / (9.8·y + 0.2)`, so that the relief is the same length in the scene at any depth.

use rayon::prelude::*;
use streamsplat_kernels::Level;
use streamsplat_model::StaticGaussians;

use edges::Surfaces;

mod align;
mod edges;
mod fill;
mod turned;

pub(super) use align::{Alignment, Link, align};
pub(super) use fill::normalise_most;
pub(super) use turned::{Turned, turned};

/// y of what a map calls farthest.
pub const FAR: f32 = 0.1;
/// y of what a map calls nearest.
pub const NEAR: f32 = 0.95;

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

fn knobs() -> &'static [f32] {
    static K: std::sync::OnceLock<Vec<f32>> = std::sync::OnceLock::new();
    K.get_or_init(|| std::env::var("LIFT").unwrap_or_default().split(',').filter_map(|t| t.parse().ok()).collect())
}
pub(super) fn knob(i: usize) -> f32 {
    let default = [0.02, 0.0, 0.0, 0.0, 1.0, 0.02, 0.0, 0.0, 0.0, 0.0];
    knobs().get(i).copied().unwrap_or(default[i])
}

/// z in the scene of a map's value.
fn scene_depth(d: f32) -> f32 {
    let y = (NEAR - FAR).mul_add(d.clamp(0.0, 1.0), FAR);
    1.0 / 9.8f32.mul_add(y, 0.2)
}

/// The map's value of a z in the scene.
fn map_value(z: f32) -> f32 {
    ((1.0 / z - 0.2) / 9.8 - FAR) / (NEAR - FAR)
}

/// Lifts the Gaussians of a key frame to its map. Returns false, and leaves them as they are, where the map tells nothing: fewer than two values in it that differ.
pub(super) fn lift(level: Level, gaussians: &mut StaticGaussians, map: &DepthMap, frame: &[f32]) -> bool {
    let _ = level;
    let Some(filled) = map.filled() else { return false };
    let [height, width] = filled.resolution;
    let surfaces = Surfaces::new(&filled, frame);
    let limit = knob(2);
    let each = gaussians.position.par_iter_mut().zip(&mut gaussians.scale);
    each.with_min_len(256).for_each(|(position, scale)| {
        let [x, y, z] = *position;
        let (Some(column), Some(row)) = (pixel(x, width), pixel(-z, height)) else { return };
        let place = if knob(1) > 0.0 {
            surfaces.at(row, column)
        } else {
            let mut p = surfaces.at(row, column);
            p.inverse = filled.inverse[row * width + column];
            p
        };
        let depth = (NEAR - FAR).mul_add(place.inverse.clamp(0.0, 1.0), FAR);
        position[1] = with_relief(depth, y);
        for axis in 0..2 {
            let unit = 2.0 / if axis == 0 { width } else { height } as f32;
            scale[axis] *= knob(4);
            if limit > 0.0 {
                let most = (limit * (place.clear[axis] + knob(6))).max(knob(7)) * unit;
                scale[axis] = scale[axis].min(most);
            }
        }
    });
    true
}

/// The depth with the model's own relief.
fn with_relief(depth: f32, own: f32) -> f32 {
    // d(1 / (9.8·y + 0.2)) / dy = −9.8 / (9.8·y + 0.2)²
    let distance = 9.8f32.mul_add(depth, 0.2);
    let step = distance * distance * (knob(0) / 9.8);
    (own - 0.5).mul_add(step, depth).clamp(0.0, 1.0)
}

/// The pixel of a coordinate in [−1, 1] along a side; the nearest one outside, `None` where it is not finite.
fn pixel(x: f32, side: usize) -> Option<usize> {
    x.is_finite().then(|| (((x + 1.0) * 0.5 * side as f32).max(0.0) as usize).min(side - 1))
}
