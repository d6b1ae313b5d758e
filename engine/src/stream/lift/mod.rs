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
pub(in crate::stream) fn knob(i: usize) -> f32 {
    let default = [0.37, 1.0, 0.4, 0.0, 0.9, 0.02, 0.5, 0.4, 0.0, 0.0];
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

/// y of a map's value.
fn depth_of(inverse: f32) -> f32 {
    (NEAR - FAR).mul_add(inverse.clamp(0.0, 1.0), FAR)
}

/// Lifts the Gaussians of a key frame `[3, H, W]` to its map; with `behind`, adds [Gaussians behind](behind) its foreground. Gives the places whose motion these have. Where the map tells nothing,
/// since no two of its values differ, the Gaussians stay as they are.
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
            let unit = 2.0 / if axis == 0 { width } else { height } as f32;
            scale[axis] *= knob(4);
            if knob(8) == 0.0 || place.near {
                let most = (knob(2) * (place.clear[axis] + knob(6))).max(knob(7)) * unit;
                scale[axis] = scale[axis].min(most);
            }
        }
    });
    if behind { behind::add(gaussians, &surfaces) } else { Vec::new() }
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
