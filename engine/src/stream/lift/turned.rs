//! Pictures of a key frame from cameras turned about its middle, made from its depth map.
//!
//! Gaussians of one surface overlap, and a turned camera sorts them otherwise than the frame's own does: by their place along the turn. Colours that fit the frame alone come apart
//! there. So they are fitted to these pictures as well.
//!
//! With `z = 1 / (9.8·y + 0.2)` of the map, θ the turn and p the mean z, the pixel in column x of a row comes to
//!
//! ```text
//! x' = m + cos θ·(x − m) − sin θ·(z − p)·W/2        m = (W − 1)/2
//! ```
//!
//! Colours between two neighbours on one surface are linear; at an edge of depth a pixel is as wide as it is. What is nearest to the camera is seen. What the frame does not show takes the
//! colour of the farther of the two sides.

use rayon::prelude::*;
use streamsplat_kernels::math::f64::sin_cos;

use super::DepthMap;
use super::edges::tear;
use crate::camera::{Camera, Pose, Rotation};
use crate::fit::Placement;

/// A picture from a turned camera.
#[derive(Clone, Debug)]
pub(in crate::stream) struct Turned {
    pub(in crate::stream) camera: Camera,
    /// `[3, H, W]`
    pub(in crate::stream) rgb: Vec<f32>,
}

impl Turned {
    /// A placement of pictures of this size that fill the model's input.
    pub(in crate::stream) fn placement(&self, size: [usize; 2]) -> Placement {
        Placement { source: size, model: size, offset: [0; 2], content: size }
    }
}

/// Pictures of `frame`, `[3, H, W]`, from both sides of its middle.
pub(in crate::stream) fn turned(map: &DepthMap, frame: &[f32]) -> Vec<Turned> {
    let degrees = super::knob(3);
    if degrees == 0.0 {
        return Vec::new();
    }
    let z: Vec<f64> = map.inverse.iter().map(|d| f64::from(super::scene_depth(*d))).collect();
    let pivot = z.iter().sum::<f64>() / z.len() as f64;
    [1.0, -1.0].map(|sign| view(map, &z, frame, sign * f64::from(degrees), pivot)).into()
}

fn view(map: &DepthMap, z: &[f64], frame: &[f32], degrees: f64, pivot: f64) -> Turned {
    let [height, width] = map.resolution;
    let (sin, cos) = sin_cos(degrees * (std::f64::consts::PI / 180.0));
    let rows: Vec<Vec<[f32; 3]>> = (0..height)
        .into_par_iter()
        .map(|y| {
            let row = y * width..(y + 1) * width;
            let colour = |x: usize| [0, 1, 2].map(|c| frame[c * height * width + y * width + x]);
            Row { z: &z[row], sin, cos, pivot }.seen(colour)
        })
        .collect();
    let mut rgb = Vec::with_capacity(3 * height * width);
    for channel in 0..3 {
        rgb.extend(rows.iter().flatten().map(|colour| colour[channel]));
    }
    let rotation = Rotation::from_columns([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]]).unwrap_or_default();
    let back = pivot + 1.0;
    let camera = Camera::orthographic(Pose { position: [-back * sin, 0.0, pivot - back * cos], rotation });
    Turned { camera, rgb }
}

/// A row of pixels and the turn.
struct Row<'a> {
    z: &'a [f64],
    sin: f64,
    cos: f64,
    pivot: f64,
}

impl Row<'_> {
    /// Column to which column x comes, and its distance along the turned view.
    fn place(&self, x: usize) -> [f64; 2] {
        let half = 0.5 * self.z.len() as f64;
        let (from_middle, depth) = (x as f64 - (half - 0.5), self.z[x] - self.pivot);
        [
            half - 0.5 + self.cos * from_middle - self.sin * depth * half,
            self.sin * from_middle / half + self.cos * depth,
        ]
    }

    /// The row as the turned camera sees it.
    fn seen(&self, colour: impl Fn(usize) -> [f32; 3]) -> Vec<[f32; 3]> {
        let width = self.z.len();
        let places: Vec<[f64; 2]> = (0..width).map(|x| self.place(x)).collect();
        let mut nearest = vec![f64::INFINITY; width];
        let mut out = vec![[0.5f32; 3]; width];
        let mut put = |from: f64, to: f64, depth: f64, colour: &dyn Fn(f64) -> [f32; 3]| {
            let first = from.ceil().max(0.0);
            let last = to.floor().min(width as f64 - 1.0);
            let mut at = first;
            while at <= last {
                let i = at as usize;
                if depth < nearest[i] {
                    nearest[i] = depth;
                    out[i] = colour((at - from) / (to - from).max(1e-9));
                }
                at += 1.0;
            }
        };
        for x in 0..width {
            let [at, depth] = places[x];
            let joined = |other: usize| (self.z[x] - self.z[other]).abs() <= f64::from(tear(width));
            let (left, right) = (x > 0 && joined(x - 1), x + 1 < width && joined(x + 1));
            let own = colour(x);
            if !left {
                put(at - 0.5 * self.cos, at, depth, &|_| own);
            }
            if !right {
                put(at, at + 0.5 * self.cos, depth, &|_| own);
            } else {
                let [next, far] = places[x + 1];
                let other = colour(x + 1);
                put(at, next, 0.5 * (depth + far), &|t| {
                    std::array::from_fn(|c| (t as f32).mul_add(other[c] - own[c], own[c]))
                });
            }
        }
        fill(&nearest, &mut out);
        out
    }
}

/// Gives what is not seen the colour of the farther of its two sides.
fn fill(nearest: &[f64], out: &mut [[f32; 3]]) {
    let mut x = 0;
    while x < out.len() {
        if nearest[x].is_finite() {
            x += 1;
            continue;
        }
        let end = (x..out.len()).find(|i| nearest[*i].is_finite()).unwrap_or(out.len());
        let colour = match (x.checked_sub(1), (end < out.len()).then_some(end)) {
            (Some(a), Some(b)) if nearest[a] >= nearest[b] => out[a],
            (_, Some(b)) => out[b],
            (Some(a), None) => out[a],
            (None, None) => return,
        };
        out[x..end].fill(colour);
        x = end;
    }
}
