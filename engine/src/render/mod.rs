//! From an interval, a time and a camera to an image.
//!
//! The Gaussians are evaluated at the time ([`Record::position_at`](crate::stream::Record::position_at) and
//! [`opacity_at`](crate::stream::Record::opacity_at)) and transformed into scene space and into the camera's view,
//! which the kernels rasterise. Scene space is x right, y down, z forward, with x and y in [−1, 1] over the model's
//! input, and z as in [`world`](crate::world),
//! and standard deviations (s_x, s_z, s_y) along these axes (StreamSplat (ICLR 2026), camera and image). The canonical
//! camera is axis-aligned, so its splats need no rotation. Other cameras see the scene in [square
//! units](crate::stream::Snapshot::square) and rotate every Gaussian by the inverse of their own rotation.
//!
//! A canonical image shows the content of the model's input, without the border that the frame's shape left. Its
//! Gaussians are drawn at the requested size, not scaled from an image.

mod backend;
mod optics;
mod options;
pub mod turn;
mod view;

pub use backend::Backend;
pub use optics::{Aperture, Focus, SENSOR_HEIGHT};
pub use options::{RenderError, RenderOptions, Size};
pub use streamsplat_kernels::exposure::Exposure;
pub use streamsplat_kernels::raster::{Falloff, Image};
pub use view::View;

use backend::Rasteriser;
use streamsplat_kernels::raster::{self, Gaussians};

use crate::camera::Camera;
use crate::stream::{Interval, Snapshot, Workers};

/// An image is compared with the one before where at least one record in so many can be seen and is the same at all
/// times of the interval.
const LEAST_REST: usize = 4;

impl Interval {
    /// Draws the scene at `time` seconds, seen by `camera`, with `workers`.
    ///
    /// To draw many images use a [`Renderer`].
    ///
    /// # Errors
    /// Times outside the interval, sizes that cannot be drawn, cameras that see nothing, and intervals whose arrays
    /// differ in length.
    pub fn render(
        &self,
        time: f64,
        camera: &Camera,
        options: &RenderOptions,
        workers: &Workers,
    ) -> Result<Image, RenderError> {
        let mut renderer = Renderer::new(workers);
        renderer.render(self, time, camera, options)?;
        Ok(renderer.rasteriser.into_image())
    }
}

/// Draws one image after another; on the CPU only the parts that changed, where a quarter of the records rest. The
/// images are those of [`Interval::render`], to the last bit on the CPU and nearly so on a graphics card ([`Backend`]).
pub struct Renderer {
    workers: Workers,
    rasteriser: Rasteriser,
    /// Gaussians of the last image that were left out before projection.
    left_out: u64,
}

impl Renderer {
    /// A renderer that works with `workers`, on the CPU.
    pub fn new(workers: &Workers) -> Self {
        Self::from(workers, Rasteriser::Cpu(Box::new(raster::Rasteriser::new(workers.level()))))
    }

    /// A renderer that draws with `backend`.
    ///
    /// # Errors
    /// When the library was built without it, or there is no graphics card to draw with.
    pub fn with(workers: &Workers, backend: Backend) -> Result<Self, RenderError> {
        Ok(Self::from(workers, Rasteriser::new(backend, workers.level())?))
    }

    fn from(workers: &Workers, rasteriser: Rasteriser) -> Self {
        Self { workers: workers.clone(), rasteriser, left_out: 0 }
    }

    /// The graphics card that draws; `None` on the CPU.
    pub fn adapter(&self) -> Option<&str> {
        self.rasteriser.adapter()
    }

    /// Draws the scene at `time` seconds, seen by `camera`.
    ///
    /// # Errors
    /// As [`Interval::render`]; and where the graphics card fails.
    pub fn render(
        &mut self,
        interval: &Interval,
        time: f64,
        camera: &Camera,
        options: &RenderOptions,
    ) -> Result<&Image, RenderError> {
        if !camera.is_usable() {
            return Err(RenderError::Camera);
        }
        let size = options.size.resolve(&interval.placement);
        let request = options.seen_by(camera, size)?;
        let square = matches!(camera, Camera::Posed { .. });
        let (mut seen, rest) = Snapshot::for_image(interval, time, square, &self.workers)?;
        if rest * LEAST_REST < seen.mean.len() {
            // Nearly every tile would be drawn anyway, so looking for those that did not change does not pay.
            self.rasteriser.forget();
        }
        let view = View::new(camera, &interval.placement, size);
        self.left_out = 0;
        let rasteriser = &mut self.rasteriser;
        self.workers.install(|| {
            view.apply(&mut seen.mean);
            view.widen(&interval.placement, &seen.mean, &mut seen.scale);
            let rotation = view.rotation().map(|q| vec![q; seen.mean.len()]);
            let gaussians = Gaussians {
                mean: &seen.mean,
                scale: &seen.scale,
                rotation: rotation.as_deref(),
                opacity: &seen.opacity,
                rgb: &seen.rgb,
            };
            rasteriser.render(&gaussians, view.projection(), &request)
        })
    }

    /// Threads and level.
    pub(crate) fn workers(&self) -> &Workers {
        &self.workers
    }

    /// Returns threads, level and rasteriser for an image with this number of Gaussians left out.
    pub(crate) fn parts(&mut self, left_out: u64) -> (&Workers, &mut Rasteriser) {
        self.left_out = left_out;
        (&self.workers, &mut self.rasteriser)
    }

    /// Work done and work avoided by the last image. Gaussians that were [left out](Self::left_out) count like others
    /// that reach no pixel.
    pub fn work(&self) -> raster::Work {
        let mut work = self.rasteriser.work();
        work.gaussians += self.left_out;
        work.culled += self.left_out;
        work
    }

    /// Gaussians of the last image that were found invisible and left out before projection ([`crate::space`]).
    pub fn left_out(&self) -> u64 {
        self.left_out
    }
}

#[cfg(test)]
mod tests;
