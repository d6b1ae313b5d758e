//! Still scenes as images.

use rayon::prelude::*;
use streamsplat_kernels::harmonics::{self, Eye};
use streamsplat_kernels::math::f64::exp;
use streamsplat_kernels::raster::{self, Gaussians, Image, Request};

use super::Still;
use crate::camera::{Camera, Lens, Pose, Rotation};
use crate::render::{Painter, RenderError, RenderOptions, Size, View};
use crate::stream::Workers;

/// Gaussians per task.
const CHUNK: usize = 4096;

/// A still scene with what every image of it needs.
#[derive(Clone, Debug)]
pub struct Drawable {
    still: Still,
    scale: Vec<[f32; 3]>,
    /// Of length 1; NaN where the file's has none.
    rotation: Vec<[f64; 4]>,
    opacity: Vec<f32>,
}

impl Drawable {
    /// Prepares a scene.
    ///
    /// # Errors
    /// Arrays that differ in length.
    pub fn new(still: Still, workers: &Workers) -> Result<Self, RenderError> {
        if let Some((array, found)) = still.uneven() {
            return Err(RenderError::Records { array, expected: still.len(), found });
        }
        let (scale, rotation, opacity) = workers.install(|| {
            let scale = still.log_scale.par_iter().with_min_len(CHUNK).map(|s| s.map(grown)).collect();
            let rotation = still.rotation.par_iter().with_min_len(CHUNK).map(|q| unit(*q)).collect();
            let opacity = still.logit.par_iter().with_min_len(CHUNK).map(|x| sigmoid(*x)).collect();
            (scale, rotation, opacity)
        });
        Ok(Self { still, scale, rotation, opacity })
    }

    /// The scene.
    pub fn still(&self) -> &Still {
        &self.still
    }

    /// Standard deviations along the Gaussians' own axes.
    pub fn scale(&self) -> &[[f32; 3]] {
        &self.scale
    }

    /// Opacities.
    pub fn opacity(&self) -> &[f32] {
        &self.opacity
    }
}

/// e^x, rounded once.
fn grown(x: f32) -> f32 {
    if x.is_finite() { exp(f64::from(x)) as f32 } else { f32::NAN }
}

/// 1 / (1 + e^−x), rounded once.
fn sigmoid(x: f32) -> f32 {
    // Beyond, the result is 0 or 1 in binary32, whatever the exponential.
    let x = f64::from(x);
    if x.is_nan() { f32::NAN } else { (1.0 / (1.0 + exp(-x.clamp(-200.0, 200.0)))) as f32 }
}

fn unit(q: [f32; 4]) -> [f64; 4] {
    Rotation::from_quaternion(q.map(f64::from)).map_or([f64::NAN; 4], |rotation| rotation.quaternion())
}

/// The rotation `a` after `b`, sums from left to right.
fn after([aw, ax, ay, az]: [f64; 4], [bw, bx, by, bz]: [f64; 4]) -> [f32; 4] {
    [
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    ]
    .map(|c| c as f32)
}

/// Where a camera sees colours from.
pub(super) fn eye(pose: &Pose, lens: &Lens) -> Eye {
    match lens {
        Lens::Pinhole { .. } => Eye::At(pose.position.map(|x| x as f32)),
        Lens::Orthographic { .. } => Eye::Along(pose.rotation.matrix().map(|row| row[2] as f32)),
    }
}

impl Painter {
    /// A still scene, seen by `camera`.
    ///
    /// # Errors
    /// The canonical camera and sizes that need a source, neither of which such a scene has; sizes that cannot be drawn; cameras that
    /// see nothing.
    pub fn draw_still(
        &mut self,
        scene: &Drawable,
        camera: &Camera,
        options: &RenderOptions,
    ) -> Result<&Image, RenderError> {
        let Camera::Posed { pose, lens } = camera else { return Err(RenderError::NoOwnCamera) };
        if !camera.is_usable() {
            return Err(RenderError::Camera);
        }
        let Size::Exact { width, height } = options.size else { return Err(RenderError::NoOwnSize) };
        if [height, width].iter().any(|side| !(1..=raster::MAX_SIDE).contains(side)) {
            return Err(RenderError::Size { most: raster::MAX_SIDE, width, height });
        }
        let view = View::posed(pose, lens, [height, width]);
        let RenderOptions { background, depth, alpha, statistics, .. } = *options;
        let request = Request { width, height, background, depth, alpha, statistics };
        let Drawable { still, scale, rotation, opacity } = scene;
        let (workers, drawer) = self.parts();
        workers.install(|| {
            let mut rgb = vec![[0.0; 3]; still.len()];
            let eye = eye(pose, lens);
            harmonics::colours(workers.level(), still.degree, &still.base, &still.higher, &still.mean, eye, &mut rgb);
            let mut mean = still.mean.clone();
            view.apply(&mut mean);
            let turn = pose.rotation.inverse().quaternion();
            let rotation: Vec<[f32; 4]> =
                rotation.par_iter().with_min_len(CHUNK).map(|own| after(turn, *own)).collect();
            let gaussians = Gaussians { mean: &mean, scale, rotation: Some(&rotation), opacity, rgb: &rgb };
            drawer.render(&gaussians, view.projection(), &request)
        })
    }
}
