//! Images of still scenes.

use std::borrow::Cow;

use rayon::prelude::*;
use streamsplat_kernels::harmonics::{self, Eye};
use streamsplat_kernels::math::f64::exp;
use streamsplat_kernels::raster::{Gaussians, Image, Request};

use super::Still;
use crate::camera::{Camera, Lens, Pose, Rotation};
use crate::render::{RenderError, RenderOptions, Renderer, Size, View};
use crate::space::{Groups, Window};
use crate::stream::Workers;

/// Gaussians per task.
const CHUNK: usize = 4096;
/// Largest coefficient with finite colours from every direction.
const LARGEST_COEFFICIENT: f32 = 1e30;

/// A still scene with the values that all its images share.
#[derive(Clone, Debug)]
pub struct Drawable {
    still: Still,
    scale: Vec<[f32; 3]>,
    /// Unit quaternions; NaN where the file's has no direction. Stored only for many images; for a single image each is
    /// computed when it is used.
    rotation: Option<Vec<[f64; 4]>>,
    opacity: Vec<f32>,
    groups: Option<Groups>,
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
        let (scale, opacity) = workers.install(|| {
            let scale = still.log_scale.par_iter().with_min_len(CHUNK).map(|s| s.map(grown)).collect();
            let opacity = still.logit.par_iter().with_min_len(CHUNK).map(|x| sigmoid(*x)).collect();
            (scale, opacity)
        });
        Ok(Self { still, scale, rotation: None, opacity, groups: None })
    }

    /// Prepares the scene for many images of parts of it: Gaussians that a pinhole camera's image cannot show are then
    /// left out before their colours are computed ([`crate::space`]). The images keep their bits.
    pub fn grouped(mut self, workers: &Workers) -> Self {
        let Self { still, scale, opacity, .. } = &self;
        let units = || still.rotation.par_iter().with_min_len(CHUNK).map(|q| unit(*q)).collect();
        let rotation: Vec<[f64; 4]> = workers.install(units);
        let width = 3 * still.rest();
        let sound = |c: &f32| c.abs() <= LARGEST_COEFFICIENT;
        let tame = |i: usize| {
            let turned = rotation[i].iter().all(|c| c.is_finite());
            turned && still.base[i].iter().all(sound) && still.higher[i * width..(i + 1) * width].iter().all(sound)
        };
        self.groups = Some(workers.install(|| Groups::new(&still.mean, scale, opacity, tame)));
        self.rotation = Some(rotation);
        self
    }

    /// The scene.
    pub fn still(&self) -> &Still {
        &self.still
    }

    /// Standard deviations along the Gaussians' own axes.
    pub fn scale(&self) -> &[[f32; 3]] {
        &self.scale
    }

    /// A Gaussian's rotation as a quaternion (w, x, y, z) of length 1; NaN where the scene has none.
    pub fn rotation(&self, i: usize) -> [f64; 4] {
        unit(self.still.rotation[i])
    }

    /// Opacities.
    pub fn opacity(&self) -> &[f32] {
        &self.opacity
    }

    /// Draws the scene, seen by `camera`, with `workers`: the image of [`Renderer::render_still`]. To draw many images
    /// use a [`Renderer`].
    ///
    /// # Errors
    /// As [`Renderer::render_still`].
    pub fn render(&self, camera: &Camera, options: &RenderOptions, workers: &Workers) -> Result<Image, RenderError> {
        let mut renderer = Renderer::new(workers);
        renderer.render_still(self, camera, options).cloned()
    }
}

/// e^x, rounded once.
pub(crate) fn grown(x: f32) -> f32 {
    match x {
        f32::NEG_INFINITY => 0.0,
        x if x.is_finite() => exp(f64::from(x)) as f32,
        _ => f32::NAN,
    }
}

/// 1 / (1 + e^−x), rounded once.
pub(super) fn sigmoid(x: f32) -> f32 {
    // Outside this range the result is 0 or 1 in binary32 for any exponential.
    let x = f64::from(x);
    if x.is_nan() { f32::NAN } else { (1.0 / (1.0 + exp(-x.clamp(-200.0, 200.0)))) as f32 }
}

fn unit(q: [f32; 4]) -> [f64; 4] {
    Rotation::from_quaternion(q.map(f64::from)).map_or([f64::NAN; 4], |rotation| rotation.quaternion())
}

/// The rotation `a` after `b`, sums from left to right.
pub(crate) fn after([aw, ax, ay, az]: [f64; 4], [bw, bx, by, bz]: [f64; 4]) -> [f32; 4] {
    [
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    ]
    .map(|c| c as f32)
}

/// The elements at `places`; all if `places` is `None`.
fn chosen<'a, T: Copy + Send + Sync>(all: &'a [T], places: Option<&[u32]>) -> Cow<'a, [T]> {
    let Some(places) = places else { return Cow::Borrowed(all) };
    Cow::Owned(places.par_iter().with_min_len(CHUNK).map(|&i| all[i as usize]).collect())
}

/// The same for rows of `width` elements.
fn chosen_rows<'a>(all: &'a [f32], width: usize, places: Option<&[u32]>) -> Cow<'a, [f32]> {
    let Some(places) = places else { return Cow::Borrowed(all) };
    let mut rows = vec![0.0; places.len() * width];
    if width > 0 {
        rows.par_chunks_mut(width).zip(places).with_min_len(CHUNK).for_each(|(row, &i)| {
            row.copy_from_slice(&all[i as usize * width..][..width]);
        });
    }
    Cow::Owned(rows)
}

/// The position from which a camera sees colours.
pub(super) fn eye(pose: &Pose, lens: &Lens) -> Eye {
    match lens {
        Lens::Pinhole { .. } | Lens::Equirectangular => Eye::At(pose.position.map(|x| x as f32)),
        Lens::Orthographic { .. } => Eye::Along(pose.rotation.matrix().map(|row| row[2] as f32)),
    }
}

impl Renderer {
    /// Draws a still scene, seen by `camera`.
    ///
    /// # Errors
    /// The canonical camera and sizes that need a source, since a still scene has neither; sizes that cannot be drawn;
    /// cameras with an empty view.
    pub fn render_still(
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
        let request = Request { bounded: true, ..options.seen_by(camera, [height, width])? };
        let Drawable { still, scale, rotation, opacity, groups } = scene;
        // Cameras are in the scene's coordinates, centres are relative to its offset.
        let position = std::array::from_fn(|k| pose.position[k] - still.about.offset[k]);
        let pose = &Pose { position, ..*pose };
        let view = View::posed(pose, lens, [height, width]);
        let window = Window::new(&view, [height, width]);
        // The window does not include the radius of a blur.
        let sharp = request.defocus.is_none();
        let places = groups.as_ref().filter(|_| sharp).zip(window);
        let places = places.and_then(|(groups, window)| self.workers().install(|| groups.seen(&window)));
        let places = places.as_deref();
        let (workers, rasteriser) = self.parts(places.map_or(0, |places| (still.len() - places.len()) as u64));
        workers.install(|| {
            let mut mean = chosen(&still.mean, places).into_owned();
            let (scale, opacity) = (chosen(scale, places), chosen(opacity, places));
            let base = chosen(&still.base, places);
            let higher = chosen_rows(&still.higher, 3 * still.rest(), places);
            let mut rgb = vec![[0.0; 3]; mean.len()];
            let eye = eye(pose, lens);
            harmonics::colours(workers.level(), still.degree, &base, &higher, &mean, eye, &mut rgb);
            view.apply(&mut mean);
            let turn = pose.rotation.inverse().quaternion();
            let rotation: Vec<[f32; 4]> = match rotation {
                Some(kept) => {
                    chosen(kept, places).par_iter().with_min_len(CHUNK).map(|own| after(turn, *own)).collect()
                }
                // Without groups every Gaussian is drawn.
                None => still.rotation.par_iter().with_min_len(CHUNK).map(|q| after(turn, unit(*q))).collect(),
            };
            let gaussians =
                Gaussians { mean: &mean, scale: &scale, rotation: Some(&rotation), opacity: &opacity, rgb: &rgb };
            rasteriser.render(&gaussians, view.projection(), &request)
        })
    }
}
