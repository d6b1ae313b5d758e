//! Colours that fit the frames.
//!
//! With geometry, opacity and order fixed, an image is linear in the colours of its Gaussians: `image = A·c + T·background` ([`ColourMap`]). So the colours that come nearest to
//! given frames solve a linear least-squares problem, here with a small ridge that keeps a colour that hardly shows near what it was:
//!
//! ```text
//! key frame     min over c₀   |A·c₀ + T·b − frame|² + λ·|c₀ − network|²
//! interval      min over c₁   Σ_k |A_k·(c₀ + τ_k∘c₁) + T_k·b − frame_k|² + λ·|c₁|²        τ_k: time from each Gaussian's own key frame
//! ```
//!
//! Both are solved by conjugate gradients on the normal equations, channel by channel, preconditioned by the row sums of the matrix (Hestenes and Stiefel 1952; Saad, Iterative Methods
//! for Sparse Linear Systems, algorithm 9.1). Vectors are binary32; inner products are binary64, summed in chunks of [`CHUNK`] in ascending order, chunk after chunk. No step
//! depends on threads or level.
//!
//! The steps end early once one lowers the sum of squares by less than [`ENOUGH`] of what is left. Results are clamped: c₀ to [`RANGE`], c₁ so that the colour at the
//! interval's other end, where little of the Gaussian is left to be seen, lies in [`FAR_RANGE`]. (Held to [`RANGE`] there, colours fit 3 dB worse in between.)

use rayon::prelude::*;
use streamsplat_kernels::Level;
use streamsplat_kernels::raster::{ColourMap, Gaussians, Projection};
use streamsplat_model::StaticGaussians;

use super::{DynamicGaussians, Reference};
use crate::render::{Snapshot, to_scene};

/// Gaussians per task and per partial sum.
const CHUNK: usize = 4096;
/// Weight of the ridge, beside sums of squared weights over pixels.
const RIDGE: f32 = 1e-3;
/// The share of the remaining sum of squares that a step must take away.
const ENOUGH: f64 = 0.004;
/// Range of colours at their own key frame.
pub(super) const RANGE: [f32; 2] = [-0.2, 1.2];
/// Range of colours at the other end of the interval.
const FAR_RANGE: [f32; 2] = [-4.0, 5.0];
/// What images are drawn on while colours are fitted.
const BACKGROUND: [f32; 3] = [0.5; 3];

type Colours = Vec<[f32; 3]>;

/// Maps from colours to images, and their memory, kept from fit to fit.
pub(super) struct Fitter {
    level: Level,
    maps: Vec<ColourMap>,
}

/// A frame to come near to.
pub(super) struct Target<'a> {
    /// Its time in the interval, 0 to 1.
    pub(super) t: f32,
    /// `[3, H, W]`
    pub(super) rgb: &'a [f32],
}

impl Fitter {
    /// A fitter that has no memory yet.
    pub(super) fn new(level: Level) -> Self {
        Self { level, maps: Vec::new() }
    }

    /// The colours c₀ of a key frame `[3, H, W]`, and the steps they took.
    pub(super) fn key(
        &mut self,
        gaussians: &StaticGaussians,
        frame: &[f32],
        resolution: [usize; 2],
        steps: u32,
    ) -> (Colours, u32) {
        let mut seen = Snapshot::default();
        for (i, &position) in gaussians.position.iter().enumerate() {
            let ([sx, sz], opacity, rgb) = (gaussians.scale[i], gaussians.opacity[i], gaussians.rgb[i]);
            let sound = [sx, sz, opacity].iter().chain(&rgb).all(|x| x.is_finite()) && sx >= 0.0 && sz >= 0.0;
            let Some(mean) = to_scene(position).filter(|mean| sound && mean.iter().all(|x| x.is_finite())) else {
                continue;
            };
            seen.index.push(i as u32);
            seen.mean.push(mean);
            seen.scale.push([sx, sz, (sx + sz) * 0.5]);
            seen.opacity.push(opacity);
            seen.rgb.push(rgb);
        }
        let count = gaussians.position.len();
        let views = [seen];
        let mut system = self.system(&views, &[None], resolution, count);
        let start = system.residual(&[frame], |_, at| views[0].rgb[at]);
        let (change, taken) = system.solve(start, steps);
        let mut colours = gaussians.rgb.clone();
        for (colour, change) in colours.iter_mut().zip(change) {
            // What is not finite is dropped later; it is not made finite here.
            *colour = std::array::from_fn(|i| match change[i] == 0.0 {
                true => colour[i],
                false => (colour[i] + change[i]).clamp(RANGE[0], RANGE[1]),
            });
        }
        (colours, taken)
    }

    /// The colour rates c₁ of an interval, from frames in it, and the steps they took.
    pub(super) fn rates(
        &mut self,
        gaussians: &DynamicGaussians,
        targets: &[Target<'_>],
        resolution: [usize; 2],
        steps: u32,
    ) -> (Colours, u32) {
        let level = self.level;
        let views: Vec<Snapshot> = targets.iter().map(|target| Snapshot::new(level, gaussians, target.t)).collect();
        let taus: Vec<Option<Vec<f32>>> = targets
            .iter()
            .zip(&views)
            .map(|(target, view)| {
                Some(view.index.iter().map(|&i| gaussians.reference[i as usize].tau(target.t)).collect())
            })
            .collect();
        let mut system = self.system(&views, &taus, resolution, gaussians.len());
        let frames: Vec<&[f32]> = targets.iter().map(|target| target.rgb).collect();
        let start = system.residual(&frames, |view, at| gaussians.rgb[views[view].index[at] as usize]);
        let (mut rates, taken) = system.solve(start, steps);
        for (i, rate) in rates.iter_mut().enumerate() {
            // At the other end of the interval the colour is rgb + rate or rgb − rate.
            let sign: f32 = if gaussians.reference[i] == Reference::Start { 1.0 } else { -1.0 };
            for (rate, rgb) in rate.iter_mut().zip(gaussians.rgb[i]) {
                let end = sign.mul_add(*rate, rgb);
                if !(FAR_RANGE[0]..=FAR_RANGE[1]).contains(&end) {
                    *rate = sign * (end.clamp(FAR_RANGE[0].min(rgb), FAR_RANGE[1].max(rgb)) - rgb);
                }
            }
        }
        (rates, taken)
    }

    fn system<'a>(
        &'a mut self,
        views: &'a [Snapshot],
        taus: &'a [Option<Vec<f32>>],
        [height, width]: [usize; 2],
        count: usize,
    ) -> System<'a> {
        let level = self.level;
        self.maps.resize_with(views.len().max(self.maps.len()), || ColourMap::new(level));
        let projection = Projection::Orthographic { focal: [0.5 * width as f32, 0.5 * height as f32] };
        for (map, view) in self.maps.iter_mut().zip(views) {
            let Snapshot { mean, scale, opacity, rgb, .. } = view;
            map.prepare(&Gaussians { mean, scale, rotation: None, opacity, rgb }, &projection, [width, height]);
        }
        System { maps: &self.maps[..views.len()], views, taus, count }
    }
}

/// The least-squares problem: one map per view; per view the factor of each Gaussian's unknown (`None`: 1).
struct System<'a> {
    maps: &'a [ColourMap],
    views: &'a [Snapshot],
    taus: &'a [Option<Vec<f32>>],
    /// Unknowns.
    count: usize,
}

/// The right side of the normal equations and the sum of squares at the start.
struct Start {
    gradient: Colours,
    squares: f64,
}

impl System<'_> {
    /// Aᵀ·(frames − image of `colour(view, place)`).
    fn residual(&mut self, frames: &[&[f32]], colour: impl Fn(usize, usize) -> [f32; 3]) -> Start {
        let mut start = Start { gradient: vec![[0.0; 3]; self.count], squares: 0.0 };
        for (at, (map, frame)) in self.maps.iter().zip(frames).enumerate() {
            let colours: Colours = (0..self.views[at].index.len()).map(|place| colour(at, place)).collect();
            let mut sums = vec![[0.0; 3]; colours.len()];
            start.squares += map.residual_adjoint(&colours, BACKGROUND, frame, &mut sums);
            self.gather(at, &sums, &mut start.gradient);
        }
        start
    }

    /// The unknowns `x` as colours of a view.
    fn spread(&self, view: usize, x: &[[f32; 3]]) -> Colours {
        let index = &self.views[view].index;
        match &self.taus[view] {
            None => index.par_iter().map(|&i| x[i as usize]).collect(),
            Some(tau) => index.par_iter().zip(tau).map(|(&i, tau)| x[i as usize].map(|x| x * tau)).collect(),
        }
    }

    /// Adds a view's sums to those of the unknowns.
    fn gather(&self, view: usize, sums: &[[f32; 3]], to: &mut [[f32; 3]]) {
        let tau = |at: usize| self.taus[view].as_ref().map_or(1.0, |tau| tau[at]);
        for (at, (&i, sum)) in self.views[view].index.iter().zip(sums).enumerate() {
            let (to, tau) = (&mut to[i as usize], tau(at));
            (0..3).for_each(|c| to[c] = sum[c].mul_add(tau, to[c]));
        }
    }

    /// (AᵀA + λ)·x
    fn normal(&self, x: &[[f32; 3]]) -> Colours {
        let mut out: Colours = x.iter().map(|x| x.map(|x| RIDGE * x)).collect();
        for (at, map) in self.maps.iter().enumerate() {
            let colours = self.spread(at, x);
            let mut sums = vec![[0.0; 3]; colours.len()];
            map.normal(&colours, &mut sums);
            self.gather(at, &sums, &mut out);
        }
        out
    }

    /// The inverse of the row sums of the matrix's magnitudes (of |τ_i·(AᵀA)_ij·τ_j| + λ).
    fn preconditioner(&self) -> Vec<f32> {
        let mut rows = vec![RIDGE; self.count];
        for (at, map) in self.maps.iter().enumerate() {
            let tau = |place: usize| self.taus[at].as_ref().map_or(1.0, |tau| tau[place].abs());
            let colours: Colours = (0..self.views[at].index.len()).map(|place| [tau(place); 3]).collect();
            let mut sums = vec![[0.0; 3]; colours.len()];
            map.normal(&colours, &mut sums);
            for (place, (&i, sum)) in self.views[at].index.iter().zip(&sums).enumerate() {
                rows[i as usize] = sum[0].mul_add(tau(place), rows[i as usize]);
            }
        }
        rows.iter_mut().for_each(|row| *row = 1.0 / *row);
        rows
    }

    /// At most `steps` steps of conjugate gradients from 0; gives how many there were.
    fn solve(&mut self, start: Start, steps: u32) -> (Colours, u32) {
        let Start { gradient: mut r, mut squares } = start;
        let diagonal = self.preconditioner();
        let mut x = vec![[0.0; 3]; self.count];
        let precondition = |r: &[[f32; 3]]| -> Colours {
            r.par_iter().zip(&diagonal).with_min_len(CHUNK).map(|(r, d)| r.map(|r| r * d)).collect()
        };
        let mut z = precondition(&r);
        let mut p = z.clone();
        let mut rz = dot(&r, &z);
        for step in 0..steps {
            let q = self.normal(&p);
            let pq = dot(&p, &q);
            let length: [f64; 3] = std::array::from_fn(|c| if pq[c] > 0.0 { rz[c] / pq[c] } else { 0.0 });
            let gain: f64 = (0..3).map(|c| length[c] * rz[c]).sum();
            if !gain.is_finite() || gain <= 0.0 {
                return (x, step);
            }
            step_along(&mut x, &p, length);
            step_along(&mut r, &q, length.map(|a| -a));
            squares -= gain;
            if gain < ENOUGH * squares {
                return (x, step + 1);
            }
            z = precondition(&r);
            let new = dot(&r, &z);
            let ratio: [f32; 3] = std::array::from_fn(|c| if rz[c] > 0.0 { (new[c] / rz[c]) as f32 } else { 0.0 });
            p.par_iter_mut().zip(&z).with_min_len(CHUNK).for_each(|(p, z)| {
                (0..3).for_each(|c| p[c] = p[c].mul_add(ratio[c], z[c]));
            });
            rz = new;
        }
        (x, steps)
    }
}

/// x += a∘y
fn step_along(x: &mut [[f32; 3]], y: &[[f32; 3]], a: [f64; 3]) {
    let a = a.map(|a| a as f32);
    x.par_iter_mut().zip(y).with_min_len(CHUNK).for_each(|(x, y)| (0..3).for_each(|c| x[c] = y[c].mul_add(a[c], x[c])));
}

/// Inner products, channel by channel.
fn dot(a: &[[f32; 3]], b: &[[f32; 3]]) -> [f64; 3] {
    let parts: Vec<[f64; 3]> = a
        .par_chunks(CHUNK)
        .zip(b.par_chunks(CHUNK))
        .map(|(a, b)| {
            let mut sum = [0.0; 3];
            for (a, b) in a.iter().zip(b) {
                (0..3).for_each(|c| sum[c] += f64::from(a[c]) * f64::from(b[c]));
            }
            sum
        })
        .collect();
    parts.into_iter().fold([0.0; 3], |sum, part| std::array::from_fn(|c| sum[c] + part[c]))
}
