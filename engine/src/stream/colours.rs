//! Colours that fit the frames.
//!
//! With geometry, opacity and order fixed, an image is linear in the colours of its Gaussians: `image = A·c +
//! T·background` ([`ColourMap`]). So the colours that best match given frames solve a linear least-squares problem. A
//! small ridge keeps a colour that hardly shows near its former value:
//!
//! ```text
//! key frame     min over c₀   |A·c₀ + T·b − frame|² + λ·|c₀ − network|²
//! interval      min over c₁   Σ_k |A_k·(c₀ + τ_k∘c₁) + T_k·b − frame_k|² + λ·|c₁|²        τ_k: time from each Gaussian's own key frame
//! ```
//!
//! Both are solved by preconditioned conjugate gradients ([`ColourFit`]).
//!
//! The steps end early once one lowers the sum of squares by less than [`ENOUGH`] of the remainder. Results are
//! clamped: c₀ to [`RANGE`], and c₁ so that the colour at the interval's other end, where little of the Gaussian is
//! visible, is in [`FAR_RANGE`]. (Clamped to [`RANGE`] there, colours fit 3 dB worse in between.)

use std::ops::Range;

use rayon::prelude::*;
use streamsplat_kernels::Level;
use streamsplat_kernels::raster::{
    BLOCK_PIXELS, ColourFit, ColourMap, Effort, FitView, Gaussians, Preparation, Projection, Solution,
};
use streamsplat_model::StaticGaussians;

use super::between::Partial;
use super::gaussians::deviations;
use super::{DynamicGaussians, Reference};
use crate::stream::Snapshot;
use crate::world::to_scene;

/// Gaussians per task.
const CHUNK: usize = 4096;
/// Weight of the ridge, relative to sums of squared weights over pixels.
const RIDGE: f32 = 1e-3;
/// The same over intervals whose Gaussians a depth map lifts: a Gaussian that hardly shows from the frames' own view
/// shows from the side. (3e-3 gains up to 0.04 dB in views from the side halfway between key frames of procedural
/// scenes, and costs 0.3 to 0.4 dB in images in between of two real clips.)
const RIDGE_LIFTED: f32 = 1.8e-3;
/// Least share of the remaining sum of squares that a step must remove.
const ENOUGH: f64 = 0.004;
/// A Gaussian whose weights on a block of pixels are all below this keeps its colour there (docs/choosing.md has the
/// cost).
const LEAST_WEIGHT: f32 = 1.0 / 64.0;
/// Range of colours at their own key frame.
pub(super) const RANGE: [f32; 2] = [-0.2, 1.2];
/// Range of colours at the other end of the interval.
const FAR_RANGE: [f32; 2] = [-4.0, 5.0];
/// Background of images while colours are fitted.
const BACKGROUND: [f32; 3] = [0.5; 3];

type Colours = Vec<[f32; 3]>;
/// Rows and columns of a rectangle of pixels.
pub(super) type Pixels = [Range<usize>; 2];

/// Maps from colours to images, and memory that is kept from fit to fit.
pub(super) struct Fitter {
    level: Level,
    maps: Vec<ColourMap>,
    preparation: Preparation,
    /// The picture of the last fit to a key frame: `[3, H, W]`; defined on the blocks that counted.
    pub(super) picture: Vec<f32>,
}

/// The unknowns of one view: the index and the factor of each Gaussian visible there ([`FitView`]).
struct Fitted {
    unknown: Vec<u32>,
    factor: Vec<f32>,
}

/// An interval whose colour rates are fitted.
pub(super) struct Rates<'a> {
    pub(super) gaussians: &'a DynamicGaussians,
    /// Those whose rates are fixed already.
    pub(super) kept: Range<usize>,
    pub(super) targets: &'a [Target<'a>],
    /// True if a depth map lifts Gaussians of it.
    pub(super) lifted: bool,
    /// The mean square error up to which a tile of an image is close enough to its frame.
    pub(super) close: f64,
    /// The blocks of 4×4 pixels that count.
    pub(super) wanted: &'a dyn Fn(Pixels) -> bool,
}

/// A frame that colours are fitted to.
pub(super) struct Target<'a> {
    /// Its time in the interval, 0 to 1.
    pub(super) t: f32,
    /// `[3, H, W]`
    pub(super) rgb: &'a [f32],
    /// Where it counts, if not everywhere.
    pub(super) within: Option<&'a Partial>,
}

/// Returns whether each block of 4×4 pixels is wanted, row by row.
fn blocks([height, width]: [usize; 2], wanted: &dyn Fn(Pixels) -> bool) -> Vec<bool> {
    let along = |at: usize, size: usize| at * BLOCK_PIXELS..((at + 1) * BLOCK_PIXELS).min(size);
    let rows = 0..height.div_ceil(BLOCK_PIXELS);
    let row = |y: usize| (0..width.div_ceil(BLOCK_PIXELS)).map(move |x| [along(y, height), along(x, width)]);
    rows.flat_map(row).map(wanted).collect()
}

impl Fitter {
    /// A fitter without buffers yet.
    pub(super) fn new(level: Level) -> Self {
        Self { level, maps: Vec::new(), preparation: Preparation::new(level), picture: Vec::new() }
    }

    /// Fits the colours c₀ of a key frame `[3, H, W]`; returns them with the number of steps taken. `held`: the factor
    /// on each Gaussian's unknowns ([`FitView`]), 0 for one that keeps its colour; empty where all are free. `wanted`:
    /// the blocks of 4×4 pixels that count.
    pub(super) fn key(
        &mut self,
        gaussians: &StaticGaussians,
        held: &[f32],
        frame: &[f32],
        resolution: [usize; 2],
        steps: u32,
        wanted: &dyn Fn(Pixels) -> bool,
    ) -> (Colours, u32) {
        let mut view = Snapshot::default();
        for (i, &position) in gaussians.position.iter().enumerate() {
            let ([sx, sz], opacity, rgb) = (gaussians.scale[i], gaussians.opacity[i], gaussians.rgb[i]);
            let sound = [sx, sz, opacity].iter().chain(&rgb).all(|x| x.is_finite()) && sx >= 0.0 && sz >= 0.0;
            let Some(mean) = to_scene(position).filter(|mean| sound && mean.iter().all(|x| x.is_finite())) else {
                continue;
            };
            view.index.push(i as u32);
            view.mean.push(mean);
            view.scale.push(deviations([sx, sz], gaussians.thickness[i]));
            view.opacity.push(opacity);
            view.rgb.push(rgb);
        }
        let factor = match held.is_empty() {
            true => Vec::new(),
            false => view.index.iter().map(|&i| held[i as usize]).collect(),
        };
        let fitted = vec![self.prepare(0, view, factor, resolution, &blocks(resolution, wanted))];
        let Solution { change, steps: taken } = self.solve(&fitted, &[frame], &gaussians.rgb, RIDGE, (steps, 0.0));
        let mut colours = gaussians.rgb.clone();
        for (i, (colour, change)) in colours.iter_mut().zip(change).enumerate() {
            let change = held.get(i).map_or(change, |held| change.map(|c| c * held));
            // Values that are not finite are dropped later, and must not become finite here.
            *colour = std::array::from_fn(|i| match change[i] == 0.0 {
                true => colour[i],
                false => (colour[i] + change[i]).clamp(RANGE[0], RANGE[1]),
            });
        }
        let shown: Colours = fitted[0].unknown.iter().map(|&i| colours[i as usize]).collect();
        self.picture.resize(frame.len(), 0.0);
        self.maps[0].forward(&shown, BACKGROUND, &mut self.picture);
        (colours, taken)
    }

    /// Fits the colour rates c₁ of an interval to frames in it; returns them with the number of steps taken.
    pub(super) fn rates(&mut self, fit: Rates<'_>, resolution: [usize; 2], steps: u32) -> (Colours, u32) {
        let Rates { gaussians, kept, targets, lifted, close, wanted } = fit;
        if targets.is_empty() {
            return (gaussians.rgb_rate.clone(), 0);
        }
        let everywhere = blocks(resolution, wanted);
        // One view after another: only the weights of a view are kept.
        let fitted: Vec<Fitted> = targets
            .iter()
            .enumerate()
            .map(|(place, target)| {
                let view = Snapshot::new(self.level, gaussians, target.t);
                let tau = |&i: &u32| match kept.contains(&(i as usize)) {
                    true => 0.0,
                    false => gaussians.reference[i as usize].tau(target.t),
                };
                let factor = view.index.par_iter().map(tau).collect();
                let of = |partial: &Partial| blocks(resolution, &|at| partial.counts_in(&at) && wanted(at));
                let wanted = target.within.map(of);
                self.prepare(place, view, factor, resolution, wanted.as_ref().unwrap_or(&everywhere))
            })
            .collect();
        // Colours that change already enter with their value halfway.
        let halfway = |i: usize| match kept.contains(&i) {
            true => std::array::from_fn(|c| 0.5f32.mul_add(gaussians.rgb_rate[i][c], gaussians.rgb[i][c])),
            false => gaussians.rgb[i],
        };
        let from: Colours = (0..gaussians.len()).into_par_iter().with_min_len(CHUNK).map(halfway).collect();
        let ridge = if lifted { RIDGE_LIFTED } else { RIDGE };
        let frames: Vec<&[f32]> = targets.iter().map(|target| target.rgb).collect();
        let Solution { change: mut rates, steps: taken } = self.solve(&fitted, &frames, &from, ridge, (steps, close));
        // The next frame's network can have their memory.
        self.maps.clear();
        rates.par_iter_mut().with_min_len(CHUNK).enumerate().for_each(|(i, rate)| {
            if kept.contains(&i) {
                *rate = gaussians.rgb_rate[i];
                return;
            }
            // The colour at the other end of the interval is rgb + rate or rgb − rate.
            let sign: f32 = if gaussians.reference[i] == Reference::Start { 1.0 } else { -1.0 };
            for (rate, rgb) in rate.iter_mut().zip(gaussians.rgb[i]) {
                let end = sign.mul_add(*rate, rgb);
                if !(FAR_RANGE[0]..=FAR_RANGE[1]).contains(&end) {
                    *rate = sign * (end.clamp(FAR_RANGE[0].min(rgb), FAR_RANGE[1].max(rgb)) - rgb);
                }
            }
        });
        (rates, taken)
    }

    /// Prepares map `place` for a view. `wanted`: whether each block of 4×4 pixels counts, row by row.
    fn prepare(
        &mut self,
        place: usize,
        view: Snapshot,
        factor: Vec<f32>,
        [height, width]: [usize; 2],
        wanted: &[bool],
    ) -> Fitted {
        let Self { level, maps, preparation, .. } = self;
        maps.resize_with(maps.len().max(place + 1), || ColourMap::new(*level).from_weight(LEAST_WEIGHT));
        let projection = Projection::Orthographic { focal: [0.5 * width as f32, 0.5 * height as f32] };
        let Snapshot { index, mean, scale, opacity, rgb, .. } = view;
        let gaussians = Gaussians { mean: &mean, scale: &scale, rotation: None, opacity: &opacity, rgb: &rgb };
        let columns = width.div_ceil(BLOCK_PIXELS);
        maps[place].prepare_in(preparation, &gaussians, &projection, [width, height], |[x, y]| wanted[y * columns + x]);
        Fitted { unknown: index, factor }
    }

    /// Fits the first maps, one per entry of `fitted`, to `frames`. The ridge pulls towards the starting colours
    /// `from`.
    fn solve(
        &self,
        fitted: &[Fitted],
        frames: &[&[f32]],
        from: &[[f32; 3]],
        ridge: f32,
        (steps, close): (u32, f64),
    ) -> Solution {
        let views =
            self.maps.iter().zip(fitted).map(|(map, of)| FitView { map, unknown: &of.unknown, factor: &of.factor });
        let views = views.collect();
        let effort = Effort { steps, enough: ENOUGH, close };
        ColourFit::new(self.level, views, from.len(), ridge).solve(from, frames, BACKGROUND, effort)
    }
}
