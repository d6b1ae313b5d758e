//! Gaussians lifted to a depth map, for models whose own depth is little more than a drawing order.
//!
//! A model that ignores depth ([`Reconstructor::ignores_depth`](super::Reconstructor::ignores_depth)) places every
//! Gaussian of a frame on a nearly flat card, in an order that makes the picture. Where the frame has a [`DepthMap`],
//! each Gaussian takes the map's depth at its centre instead, on its own side of an [edge](edges). It is then moved
//! just enough to keep that [order] among its neighbours on one surface:
//!
//! ```text
//! y = FAR + (NEAR − FAR)·d        d: the map, 0 farthest to 1 nearest
//! ```
//!
//! Standard deviations s_x and s_z are multiplied by [`NARROWER`], and limited in front of an edge so that little of a
//! Gaussian extends over it. Gaussians of a pixel's size along its [outline] restore what the picture loses by that.
//! Along the axis of view the standard deviation becomes
//!
//! ```text
//! √((THIN·(s_x + s_z)/2)² + (a·s_x)² + (b·s_z)²)
//! ```
//!
//! with the [slopes](Surfaces::slope) a and b of the map: a surface is thinner than its Gaussians are wide, except
//! where it falls away. Where a turned view looks past an edge, Gaussians are added [behind] it, in the colours that
//! earlier frames [saw](covered) there. Colours of visible Gaussians are fitted afterwards; next to edges they start
//! from the picture's colours and are [held](HELD) to them.
//!
//! # Maps with little information
//!
//! | map | result |
//! |---|---|
//! | holes: NaN, infinities, a confidence of 0 | filled from around them ([`fill`]) |
//! | no finite value, or one value alone | as if there were no map |
//! | values beyond [0, 1], after normalisation | clamped |
//! | inverted | used as given: the scene is inside out |
//!
//! Maps that are given are [aligned](align) with those of the frames before, along optical flow; without flow
//! (`--motion network`) each is used as it is. Depth [found](crate::parallax) in the stream has one scale already.

use rayon::prelude::*;
use streamsplat_kernels::Level;
use streamsplat_model::StaticGaussians;

use crate::world::{scene_depth, y_at};
use edges::Surfaces;

mod align;
mod behind;
mod beyond;
mod covered;
mod edges;
mod fill;
mod order;
mod outline;
mod sides;

pub(super) use align::{Alignment, Link, align};
pub use covered::Covered;
pub(super) use covered::{Memory, Past, contradiction};
pub(super) use edges::tear;
pub(super) use fill::normalise_most;

/// Factor on standard deviations: Gaussians that overlap less depend less on their order.
const NARROWER: f32 = 0.95;
/// Standard deviation of a Gaussian in front of an edge, per pixel from its pixel's far side to the edge; and the least
/// one, in pixels.
const TO_EDGE: f32 = 0.4;
const LEAST: f32 = 0.3;
/// Standard deviation across a surface over the mean of those along it.
const THIN: f32 = 0.5;
/// Pixels from an edge within which colours are held.
const BESIDE: f32 = 3.0;
/// Factors on the unknowns of the fit for colours next to an edge, on its farther and on its nearer side. The ridge
/// holds these colours more strongly, by the inverse square of the factor. Without that the fit would cancel the parts
/// of Gaussians that extend over the edge, and a turned view would show the cancelling colours alone.
const HELD: [f32; 2] = [0.6, 0.8];

/// Inverse depth of a key frame, at the model's size.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthMap {
    /// `[H, W]`, 0 farthest to 1 nearest. Values that are not finite are holes.
    pub inverse: Vec<f32>,
    /// `[H, W]`, confidence in each value, 0 none to 1 full; `None`: the same for all.
    pub confidence: Option<Vec<f32>>,
    /// Height and width.
    pub resolution: [usize; 2],
}

/// Gaussians that a lift adds after the model's own, and [details](super::detail) after these.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Added {
    /// Number of those seen along edges. Those behind these and the model's own follow.
    pub(super) outline: usize,
    /// Number of details, the last ones.
    pub(super) details: usize,
    /// The places whose motion they take.
    pub(super) moving: Vec<[f32; 3]>,
    /// Colours remembered of surfaces that the foreground hides.
    pub(super) covered: Vec<Covered>,
    /// For each Gaussian of the frame the factor on the unknowns of its colour, as [`HELD`]; 0 for those behind others.
    pub(super) held: Vec<f32>,
    /// Number of those behind others whose colour is in `covered`.
    pub(super) known: usize,
}

/// Lifts the Gaussians of a key frame `[3, H, W]` to its map and makes its [outline] sharp; with a `memory`, adds
/// [Gaussians behind](behind) its foreground. Where no two values of the map differ, the Gaussians stay as they are.
pub(super) fn lift(
    level: Level,
    gaussians: &mut StaticGaussians,
    map: &DepthMap,
    frame: &[f32],
    memory: Option<&Memory<'_>>,
) -> Added {
    let Some(filled) = map.filled() else { return Added::default() };
    let [height, width] = filled.resolution;
    let surfaces = Surfaces::new(level, &filled, frame);
    let each = gaussians.position.par_iter_mut().zip(&mut gaussians.scale).zip(&mut gaussians.thickness);
    let each = each.zip(&mut gaussians.rgb).enumerate();
    let on_surfaces = each.with_min_len(256).filter_map(|(i, (((&mut [x, y, z], scale), thickness), rgb))| {
        let (row, column) = (pixel(-z, height)?, pixel(x, width)?);
        let place = surfaces.at(row, column);
        if place.is_held() {
            *rgb = surfaces.colour(row * width + column);
        }
        for axis in 0..2 {
            scale[axis] *= NARROWER;
            if place.near {
                let unit = 2.0 / if axis == 0 { width } else { height } as f32;
                scale[axis] = scale[axis].min((TO_EDGE * (place.clear[axis] + 0.5)).max(LEAST) * unit);
            }
        }
        *thickness = across(*scale, surfaces.slope(row, column, scene_depth(place.inverse)));
        let at = [(x + 1.0) * 0.5 * width as f32, (1.0 - z) * 0.5 * height as f32];
        let sigma = (0.5 * scale[0] * width as f32).max(0.5 * scale[1] * height as f32);
        let own = order::Lifted { at, sigma, z: scene_depth(place.inverse), rank: y };
        (y.is_finite() && scale.iter().all(|s| s.is_finite())).then_some(((i, place.held()), own))
    });
    let (indices, lifted): (Vec<(usize, f32)>, Vec<order::Lifted>) = on_surfaces.unzip();
    let mut held = vec![1.0; gaussians.position.len()];
    let z = order::keep(level, &lifted, filled.resolution, surfaces.tear());
    for ((i, share), z) in indices.into_iter().zip(z) {
        gaussians.position[i][1] = y_at(z);
        held[i] = share;
    }
    let own = gaussians.position.len();
    let outline = outline::add(gaussians, &surfaces);
    held.extend(&outline);
    let outline = outline.len();
    let moving = gaussians.position[own..].to_vec();
    let mut added = Added { outline, moving, held, ..Added::default() };
    if let Some(memory) = memory {
        let beyond = surfaces.beyond();
        added.covered = memory.recall(&surfaces, &beyond);
        let (moving, known) = behind::add(gaussians, &surfaces, &beyond, &added.covered);
        added.held.resize(gaussians.position.len(), 0.0);
        added.moving.extend(moving);
        added.known = known;
    }
    added
}

/// Thickness of a Gaussian of these standard deviations on a surface of these slopes; [`THIN`] where it has no width.
fn across([sx, sz]: [f32; 2], [a, b]: [f32; 2]) -> f32 {
    let mean = 0.5 * (sx + sz);
    let falls = (a * sx / mean).mul_add(a * sx / mean, (b * sz / mean) * (b * sz / mean));
    let thickness = THIN.mul_add(THIN, falls).sqrt();
    if thickness.is_finite() { thickness } else { THIN }
}

impl edges::Place {
    /// Returns true next to an edge.
    fn is_held(&self) -> bool {
        self.clear[0].min(self.clear[1]) < BESIDE
    }

    /// The factor on the unknowns of a colour here.
    fn held(&self) -> f32 {
        if self.is_held() { HELD[usize::from(self.near)] } else { 1.0 }
    }
}

/// The pixel of a coordinate in [−1, 1] along a side; the nearest one outside, `None` where it is not finite.
pub(super) fn pixel(x: f32, side: usize) -> Option<usize> {
    x.is_finite().then(|| (((x + 1.0) * 0.5 * side as f32).max(0.0) as usize).min(side - 1))
}

#[cfg(test)]
mod tests {
    use streamsplat_model::StaticGaussian;

    use super::*;

    /// One of the model's own.
    fn own() -> StaticGaussian {
        StaticGaussian { scale: [1.0 / 32.0; 2], opacity: 0.9, rgb: [0.9; 3], ..StaticGaussian::default() }
    }

    #[test]
    fn colours_beside_an_edge_start_from_the_picture_and_are_held_to_it() {
        const SIZE: [usize; 2] = [8, 64];
        let near = |x: usize| x >= 32;
        let inverse = (0..8 * 64).map(|at| f32::from(u8::from(near(at % 64)))).collect();
        let map = DepthMap { inverse, confidence: None, resolution: SIZE };
        let mut gaussians = StaticGaussians::default();
        for at in 0..8 * 64 {
            gaussians.push(StaticGaussian {
                position: [(at % 64) as f32 / 32.0 - 63.0 / 64.0, 0.5, 7.0 / 8.0 - (at / 64) as f32 / 4.0],
                ..own()
            });
        }
        let added = lift(Level::scalar(), &mut gaussians, &map, &[0.3; 3 * 8 * 64], Some(&Memory::None));
        assert_eq!(added.held.len(), gaussians.position.len());
        for at in 0..8 * 64 {
            let x = at % 64;
            let (rgb, held) = match x {
                29..32 => (0.3, HELD[0]),
                32..35 => (0.3, HELD[1]),
                _ => (0.9, 1.0),
            };
            assert_eq!((gaussians.rgb[at], added.held[at]), ([rgb; 3], held), "column {x}");
        }
        let behind = &added.held[8 * 64 + added.outline..];
        assert!(!behind.is_empty() && behind.iter().all(|held| *held == 0.0), "those behind keep their colours");
    }

    #[test]
    fn thickness_is_that_of_a_thin_surface_with_the_depth_that_it_falls_through() {
        assert_eq!(across([0.02, 0.01], [0.0, 0.0]), THIN);
        let expected = |s: [f32; 2], a: f32, b: f32| {
            let mean = 0.5 * (s[0] + s[1]);
            ((THIN * mean).powi(2) + (a * s[0]).powi(2) + (b * s[1]).powi(2)).sqrt() / mean
        };
        for (s, a, b) in [([0.02, 0.01], 1.5, 0.0), ([0.02, 0.01], 0.0, -2.0), ([0.0, 0.3], 3.0, 3.0)] {
            assert!((across(s, [a, b]) - expected(s, a, b)).abs() < 1e-5, "{s:?} {a} {b}");
        }
        for none in [[0.0; 2], [1e-45, 0.0], [f32::NAN, 0.1], [f32::INFINITY; 2], [f32::MAX; 2]] {
            let found = across(none, [3.0, -3.0]);
            assert!(found.is_finite() && found >= THIN, "{none:?}: {found}");
        }
    }

    #[test]
    fn what_is_seen_gets_thin_and_what_stands_behind_does_not() {
        const SIZE: [usize; 2] = [16, 64];
        let inverse = (0..16 * 64).map(|at| f32::from(u8::from(at % 64 >= 32))).collect();
        let map = DepthMap { inverse, confidence: None, resolution: SIZE };
        let frame: Vec<f32> = (0..3 * 16 * 64).map(|at| f32::from(u8::from(at % 64 >= 32))).collect();
        let place = |at| [at as f32 / 32.0 - 63.0 / 64.0, 0.5, 0.1];
        let mut gaussians: StaticGaussians =
            (0..64).map(|at| StaticGaussian { position: place(at), ..own() }).collect();
        let added = lift(Level::scalar(), &mut gaussians, &map, &frame, Some(&Memory::None));
        assert_eq!(gaussians.thickness.len(), gaussians.position.len());
        let (seen, behind) = gaussians.thickness.split_at(64 + added.outline);
        assert!(added.outline > 0 && !behind.is_empty());
        assert!(seen.iter().all(|t| *t == THIN) && behind.iter().all(|t| *t == 1.0), "{:?}", gaussians.thickness);
    }
}
