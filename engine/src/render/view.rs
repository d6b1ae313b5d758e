//! Gaussians at one time as a camera sees them.

use std::f64::consts::PI;

use rayon::prelude::*;
use streamsplat_kernels::Level;
use streamsplat_kernels::raster::Projection;

use super::RenderError;
use crate::camera::{Camera, Lens, Pose};
use crate::fit::Placement;
use crate::stream::{DynamicGaussians, Interval, Snapshot, Workers};

/// Gaussians per task.
const CHUNK: usize = 4096;
/// Low-pass that the rasteriser adds to variances, in px².
const LOW_PASS: f64 = 0.3;

impl Snapshot {
    /// Returns the Gaussians of an interval that can be seen at `time` seconds.
    ///
    /// # Errors
    /// Times outside the interval, and intervals whose arrays differ in length.
    pub fn of(interval: &Interval, time: f64, workers: &Workers) -> Result<Self, RenderError> {
        Self::made(Self::new, interval, time, workers)
    }

    /// The Gaussians of an interval at `time` seconds for a rasteriser ([`Snapshot::in_place`]), in `square` units or
    /// those of the model's input; and the number of those that are the same at all times.
    pub(super) fn for_image(
        interval: &Interval,
        time: f64,
        square: bool,
        workers: &Workers,
    ) -> Result<(Self, usize), RenderError> {
        let (snapshot, rest) = Self::made(Self::in_place, interval, time, workers)?;
        Ok((if square { snapshot.in_square_units(interval) } else { snapshot }, rest))
    }

    fn made<T: Send>(
        make: impl Fn(Level, &DynamicGaussians, f32) -> T + Sync,
        interval: &Interval,
        time: f64,
        workers: &Workers,
    ) -> Result<T, RenderError> {
        let (start, end) = (interval.start, interval.end);
        let t = interval.relative(time).ok_or(RenderError::Time { time, start, end })?;
        if let Some((array, found)) = interval.gaussians.uneven() {
            return Err(RenderError::Records { array, expected: interval.gaussians.len(), found });
        }
        Ok(workers.install(|| make(workers.level(), &interval.gaussians, t)))
    }

    /// Returns the Gaussians of an interval that can be seen at `time` seconds, in square units: for posed cameras and
    /// exports.
    ///
    /// Scene space has x and y in [−1, 1] over the model's input of any shape. Here x and z, and standard deviations
    /// along them, are multiplied by [the input's width over its height](crate::fit::Placement::aspect) (in binary64,
    /// rounded once), so that a unit is half of its height along every axis. A pinhole at the origin with a focal
    /// length of half the input's width shows things at z = 1 of scene space as large as the source's own view.
    ///
    /// # Errors
    /// As [`Snapshot::of`].
    pub fn square(interval: &Interval, time: f64, workers: &Workers) -> Result<Self, RenderError> {
        Ok(Self::of(interval, time, workers)?.in_square_units(interval))
    }

    fn in_square_units(mut self, interval: &Interval) -> Self {
        let aspect = interval.placement.aspect();
        let times = |x: &mut f32| *x = (f64::from(*x) * aspect) as f32;
        self.mean.iter_mut().chain(&mut self.scale).for_each(|[x, _, z]| {
            times(x);
            times(z);
        });
        self
    }
}

/// A camera's view of scene space, for one image size: in the units of the model's input for the canonical camera, in
/// square units for others.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// Position and rotation of the view in scene space.
    pose: Pose,
    /// Projection from view space to the image.
    projection: Projection,
    /// Units along x, and along z, per unit of the model's input.
    units: f64,
    /// Width and height of the image.
    sides: [f64; 2],
}

impl View {
    /// The view of `camera` in an image of `[height, width]`.
    pub fn new(camera: &Camera, placement: &Placement, [height, width]: [usize; 2]) -> Self {
        let sides = [width as f64, height as f64];
        match *camera {
            Camera::Canonical => {
                let [rows, columns] = placement.content.map(|s| s as f64);
                let [model_h, model_w] = placement.model.map(|s| s as f64);
                let [top, left] = placement.offset.map(|s| s as f64);
                // The content's middle; exactly 0 where it fills the input.
                let x = (2.0 * left + columns) / model_w - 1.0;
                let y = (2.0 * top + rows) / model_h - 1.0;
                let focal = [0.5 * sides[0] * model_w / columns, 0.5 * sides[1] * model_h / rows];
                let pose = Pose { position: [x, y, 0.0], ..Pose::default() };
                Self {
                    pose,
                    projection: Projection::Orthographic { focal: focal.map(|f| f as f32) },
                    units: 1.0,
                    sides,
                }
            }
            Camera::Posed { ref pose, ref lens } => {
                Self { units: placement.aspect(), ..Self::posed(pose, lens, [height, width]) }
            }
        }
    }

    /// The view through `lens` from `pose` in an image of `[height, width]`.
    pub fn posed(pose: &Pose, lens: &Lens, [height, width]: [usize; 2]) -> Self {
        let sides = [width as f64, height as f64];
        let projection = match *lens {
            Lens::Orthographic { half_extent } => {
                let half_extent = half_extent.unwrap_or([sides[0] / sides[1], 1.0]);
                Projection::Orthographic { focal: std::array::from_fn(|i| (0.5 * sides[i] / half_extent[i]) as f32) }
            }
            Lens::Pinhole { focal, centre } => Projection::Pinhole {
                focal: std::array::from_fn(|i| (focal[i] * sides[i]) as f32),
                centre: std::array::from_fn(|i| (centre[i] * sides[i] - 0.5) as f32),
            },
            Lens::Equirectangular => Projection::Equirectangular,
        };
        Self { pose: *pose, projection, units: 1.0, sides }
    }

    /// Position and rotation of the view in scene space.
    pub(crate) fn pose(&self) -> &Pose {
        &self.pose
    }

    /// Projection from view space to the image.
    pub fn projection(&self) -> &Projection {
        &self.projection
    }

    /// Transforms scene-space centres into view space, in place.
    ///
    /// `m' = Rᵀ(m − c)`, in binary64, sums from left to right, then rounded; untouched where the pose is the identity.
    pub fn apply(&self, mean: &mut [[f32; 3]]) {
        let c = self.pose.position;
        if self.pose.rotation.is_identity() {
            if c != [0.0; 3] {
                mean.iter_mut().for_each(|m| *m = std::array::from_fn(|i| (f64::from(m[i]) - c[i]) as f32));
            }
            return;
        }
        let rows = self.pose.rotation.inverse().matrix();
        mean.par_chunks_mut(CHUNK).flatten_iter().for_each(|m| {
            let d: [f64; 3] = std::array::from_fn(|i| f64::from(m[i]) - c[i]);
            *m = rows.map(|row| (row[0] * d[0] + row[1] * d[1] + row[2] * d[2]) as f32);
        });
    }

    /// Widens Gaussians in view space that this view magnifies beyond the model's own pixels.
    ///
    /// The rasteriser adds 0.3 px² to every projected variance. Gaussians were trained, and their colours fitted, where
    /// a pixel is one of the model's. A unit of the input has `m = side / 2` of them along an axis (in square units
    /// along x `m = width / 2` over the input's aspect). Where it has `f > m` pixels, that addition is too small and
    /// gaps open between Gaussians. To keep its size in the scene,
    ///
    /// ```text
    /// s' = √(s² + a)      a = 0.3·(m⁻² − f⁻²), 0 where that is not above 10⁻⁶·0.3·m⁻²      f: the focal length, for a pinhole over the Gaussian's z, all around H/π over its distance
    /// ```
    ///
    /// along x and y, with the mean of both along z. The variance in the image is then `(f·s)² + 0.3·(f/m)²` px². `m`
    /// and `f` are computed in binary64, the rest in binary32. At the model's own size no bit changes.
    pub fn widen(&self, placement: &Placement, mean: &[[f32; 3]], scale: &mut [[f32; 3]]) {
        let (focal, around) = match self.projection {
            Projection::Orthographic { focal } | Projection::Pinhole { focal, .. } => (focal, false),
            // Pixels per radian.
            Projection::Equirectangular => ([self.sides[1] / PI; 2].map(|f| f as f32), true),
        };
        let pinhole = !matches!(self.projection, Projection::Orthographic { .. });
        let depth = |[x, y, z]: [f32; 3]| if around { (x * x + y * y + z * z).sqrt() } else { z };
        let [height, width] = placement.model.map(|side| 0.5 * side.max(1) as f64);
        let own = [width / self.units, height];
        let most = own.map(|m| (LOW_PASS / (m * m)) as f32);
        let inverse = focal.map(|f| (LOW_PASS.sqrt() / f64::from(f)) as f32);
        let added = |z: f32| -> [f32; 2] {
            std::array::from_fn(|i| {
                let root = if pinhole { inverse[i] * z } else { inverse[i] };
                let a = most[i] - root * root;
                if a > 1e-6 * most[i] { a } else { 0.0 }
            })
        };
        if !pinhole && added(1.0) == [0.0; 2] {
            return;
        }
        scale.par_iter_mut().with_min_len(CHUNK).zip(mean).for_each(|(s, mean)| {
            let [x, y] = added(depth(*mean));
            if x + y > 0.0 {
                let added = [x, y, 0.5 * (x + y)];
                *s = std::array::from_fn(|i| (s[i] * s[i] + added[i]).sqrt());
            }
        });
    }

    /// The rotation (w, x, y, z) of every Gaussian in view space; `None` where it is the identity.
    pub fn rotation(&self) -> Option<[f32; 4]> {
        let rotation = self.pose.rotation;
        (!rotation.is_identity()).then(|| rotation.inverse().quaternion().map(|c| c as f32))
    }
}
