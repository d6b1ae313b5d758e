//! Splats in the planes of images: no camera, axis-aligned footprints.

use rayon::prelude::*;
use streamsplat_kernels::Level;
use streamsplat_kernels::raster::{self, Drawing, FootprintGradient, WorldProjection, WorldRasteriser, WorldView};

use super::{MAX_GAUSSIANS, RasterError, check};

/// A splat in an image's plane: u and v in pixels with pixel centres at integers, variances along both axes in px²,
/// opacity.
pub type PlaneSplat = [f32; 5];

/// Splats with depths beyond this are not drawn. Keys from the smallest positive normal number up to it serve as depths
/// themselves; if any key is outside, ranks replace the keys.
const FAR: f32 = 3e38;
/// An orthographic camera with one pixel per unit.
const WORLD_TO_VIEW: [[f32; 4]; 3] = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]];

/// `M` images of `N` splats each: their lists, images in any colours, and gradients. Used for training.
///
/// A splat is `α(x, y) = o·exp(−½((x − u)²/a + (y − v)²/c))`. Splats are blended front to back in the order of keys as
/// [`View`](super::View) does; equal keys keep the order of storage. Images are processed in parallel; the bits do not
/// depend on it.
#[derive(Debug)]
pub struct Planes {
    images: Vec<WorldRasteriser>,
    splats: Vec<PlaneSplat>,
    count: usize,
    size: [usize; 2],
}

impl Planes {
    /// Builds the lists of `splats [M, N]` in the order of `keys [M, N]`, in images of `[width, height]` pixels.
    ///
    /// # Errors
    /// Arguments that cannot be drawn.
    pub fn new(
        splats: Vec<PlaneSplat>,
        keys: &[f32],
        count: usize,
        [width, height]: [usize; 2],
        largest_alpha: f32,
    ) -> Result<Self, RasterError> {
        check::some("splats", MAX_GAUSSIANS, count)?;
        check::options(&super::Options { largest_alpha, ..super::Options::new(width, height) })?;
        check::length("splats", splats.len().div_ceil(count) * count, splats.len())?;
        check::length("keys", splats.len(), keys.len())?;
        check::finite("splats", splats.as_flattened())?;
        check::finite("keys", keys)?;
        if let Some(&found) = splats.iter().flat_map(|splat| &splat[2..4]).find(|variance| **variance < 0.0) {
            let (name, expected) = ("splats", "variances from 0 on");
            return Err(RasterError::Range { name, expected, found: found.into() });
        }
        let view = WorldView {
            projection: WorldProjection::Orthographic,
            near: 0.0,
            far: FAR,
            low_pass: 0.0,
            largest_alpha,
            ..WorldView::pinhole(WORLD_TO_VIEW, [1.0; 2], [0.0; 2], [width, height])
        };
        let project = |(splats, keys): (&[PlaneSplat], &[f32])| {
            let mut mean: Vec<[f32; 3]> = splats.iter().map(|&[u, v, ..]| [u + 0.5, v + 0.5, 0.0]).collect();
            if keys.iter().all(|key| (f32::MIN_POSITIVE..FAR).contains(key)) {
                mean.iter_mut().zip(keys).for_each(|(mean, key)| mean[2] = *key);
            } else {
                let mut order: Vec<u32> = (0..keys.len() as u32).collect();
                // −0 becomes 0.
                let key = |at: u32| keys[at as usize] + 0.0;
                order.sort_unstable_by(|&a, &b| key(a).total_cmp(&key(b)).then(a.cmp(&b)));
                (1_u32..).zip(order).for_each(|(rank, at)| mean[at as usize][2] = rank as f32);
            }
            let scale: Vec<[f32; 3]> = splats.iter().map(|&[_, _, a, c, _]| [a.sqrt(), c.sqrt(), 0.0]).collect();
            let opacity: Vec<f32> = splats.iter().map(|splat| splat[4]).collect();
            let gaussians =
                raster::Gaussians { mean: &mean, scale: &scale, rotation: None, opacity: &opacity, rgb: &[] };
            let mut image = WorldRasteriser::new(Level::detect());
            image.project(&gaussians, &view);
            image
        };
        let images = splats.par_chunks(count).zip(keys.par_chunks(count)).map(project).collect();
        Ok(Self { images, splats, count, size: [width, height] })
    }

    /// Checks `colours [M, N, D]` and `backgrounds [M, D]`.
    fn check(&self, colours: &[f32], channels: usize, backgrounds: &[f32]) -> Result<(), RasterError> {
        check::channels(channels)?;
        check::length("colours", self.splats.len() * channels, colours.len())?;
        check::length("backgrounds", self.images.len() * channels, backgrounds.len())
    }

    /// Draws the images `[M, H, W, D]` and their alphas `[M, H, W]` in `colours [M, N, D]` on `backgrounds [M, D]`.
    ///
    /// # Errors
    /// Slices of wrong length, and images that do not fit in memory.
    pub fn draw(
        &self,
        colours: &[f32],
        channels: usize,
        backgrounds: &[f32],
    ) -> Result<(Vec<f32>, Vec<f32>), RasterError> {
        self.check(colours, channels, backgrounds)?;
        let pixels = self.size[0] * self.size[1];
        let mut images = check::zeros(self.images.len() * pixels * channels, self.size)?;
        let mut alphas = check::zeros(self.images.len() * pixels, self.size)?;
        let to = images.par_chunks_mut(pixels * channels).zip(alphas.par_chunks_mut(pixels));
        let from = colours.par_chunks(self.count * channels).zip(backgrounds.par_chunks(channels));
        self.images.par_iter().zip(from).zip(to).for_each(|((image, (colours, background)), (to, alpha))| {
            image.draw(&Drawing { channels, colours, background }, to, alpha);
        });
        Ok((images, alphas))
    }

    /// Computes the gradients of a loss by splats `[M, N]` and colours `[M, N, D]`. `drawn` are the images and alphas
    /// of [`Planes::draw`], and `of` the gradients by them. A variance of 0 has no gradient.
    ///
    /// # Errors
    /// Slices of wrong length.
    pub fn gradients(
        &self,
        colours: &[f32],
        channels: usize,
        backgrounds: &[f32],
        drawn: [&[f32]; 2],
        of: [&[f32]; 2],
    ) -> Result<(Vec<PlaneSplat>, Vec<f32>), RasterError> {
        self.check(colours, channels, backgrounds)?;
        let pixels = self.size[0] * self.size[1];
        for [images, alphas] in [drawn, of] {
            check::length("images", self.images.len() * pixels * channels, images.len())?;
            check::length("alphas", self.images.len() * pixels, alphas.len())?;
        }
        let (mut of_splats, mut of_colours) = (vec![[0.0; 5]; self.splats.len()], vec![0.0; colours.len()]);
        let images = |[images, alphas]: [_; 2]| {
            <[f32]>::par_chunks(images, pixels * channels).zip(<[f32]>::par_chunks(alphas, pixels))
        };
        let from = colours.par_chunks(self.count * channels).zip(backgrounds.par_chunks(channels));
        let to = of_splats.par_chunks_mut(self.count).zip(of_colours.par_chunks_mut(self.count * channels));
        let work = self.images.par_iter().zip(self.splats.par_chunks(self.count)).zip(from);
        work.zip(images(drawn).zip(images(of))).zip(to).for_each(
            |((((image, splats), (colours, background)), ((drawn, alpha), (of, of_alpha))), (to, of_colours))| {
                let mut footprints = vec![FootprintGradient::default(); self.count];
                let mut of_background = vec![0.0; channels];
                let drawing = Drawing { channels, colours, background };
                let (drawn, of) = ([drawn, alpha], [of, of_alpha]);
                image.draw_adjoint(&drawing, drawn, of, &mut footprints, of_colours, &mut of_background);
                for ((to, footprint), splat) in to.iter_mut().zip(&footprints).zip(splats) {
                    // p = √(½log₂e/a) and q = √(½log₂e/c).
                    let by = |shape: f32, variance: f32| if variance > 0.0 { -0.5 * shape / variance } else { 0.0 };
                    let FootprintGradient { centre: [u, v], shape: [p, _, q], opacity } = *footprint;
                    *to = [u, v, by(p, splat[2]), by(q, splat[3]), opacity];
                }
            },
        );
        Ok((of_splats, of_colours))
    }
}
