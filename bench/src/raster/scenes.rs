//! The scenes that are timed. All are generated from fixed seeds.

use anyhow::{Context, Result};
use streamsplat::render::View;
use streamsplat::stream::Snapshot;
use streamsplat::{Camera, Engine, Frame, Settings};
use streamsplat_fixtures::clip::{Clip, ClipKind};
pub(crate) use streamsplat_fixtures::random::Random;
use streamsplat_kernels::raster::{Defocus, Falloff, Gaussians, OwnedGaussians, Projection, Request};

/// Gaussians with the view they are drawn in.
#[derive(Clone)]
pub(crate) struct Scene {
    pub(crate) splats: OwnedGaussians,
    pub(crate) projection: Projection,
    pub(crate) request: Request,
}

/// Uniform.
fn colour(random: &mut Random) -> [f32; 3] {
    std::array::from_fn(|_| random.unit())
}

const GREY: [f32; 3] = [0.5; 3];

impl Scene {
    pub(crate) fn gaussians(&self) -> Gaussians<'_> {
        self.splats.gaussians()
    }

    fn canonical(width: usize, height: usize) -> Self {
        Self {
            splats: OwnedGaussians::default(),
            projection: Projection::Orthographic { focal: [width as f32 / 2.0, height as f32 / 2.0] },
            request: Request::colour(width, height, GREY),
        }
    }

    /// Adds a Gaussian of the canonical view, in pixels.
    fn push_pixels(&mut self, centre: [f32; 2], sigma: [f32; 2], depth: f32, opacity: f32, rgb: [f32; 3]) {
        let (w, h) = (self.request.width as f32, self.request.height as f32);
        let mean = [(2.0 * centre[0] + 1.0) / w - 1.0, (2.0 * centre[1] + 1.0) / h - 1.0, depth];
        let scale = [sigma[0] * 2.0 / w, sigma[1] * 2.0 / h];
        let scale = [scale[0], scale[1], 0.5 * (scale[0] + scale[1])];
        self.splats.push(mean, scale, [1.0, 0.0, 0.0, 0.0], opacity, rgb);
    }

    fn push_ordinary(&mut self, random: &mut Random, centre: [f32; 2]) {
        let sigma = [random.log_range(0.5, 3.0), random.log_range(0.5, 3.0)];
        let (depth, opacity) = (random.range(0.1, 5.0), random.range(0.05, 1.0));
        let rgb = colour(random);
        self.push_pixels(centre, sigma, depth, opacity, rgb);
    }

    /// Scene with the statistics of the paper's model's prediction for two frames: one Gaussian per cell of 2×2 pixels
    /// and frame.
    pub(crate) fn paper_grid() -> Self {
        let (mut scene, mut random) = (Self::canonical(512, 288), Random::new(1));
        for _ in 0..2 {
            for row in 0..144 {
                for column in 0..256 {
                    let jitter = [random.range(-1.0, 1.0), random.range(-1.0, 1.0)];
                    let centre = [column as f32 * 2.0 + 0.5 + jitter[0], row as f32 * 2.0 + 0.5 + jitter[1]];
                    scene.push_ordinary(&mut random, centre);
                }
            }
        }
        scene
    }

    /// `count` Gaussians with the grid's statistics anywhere in its image.
    pub(crate) fn scattered(count: usize) -> Self {
        let (mut scene, mut random) = (Self::canonical(512, 288), Random::new(2));
        let splats = &mut scene.splats;
        for list in [&mut splats.mean, &mut splats.scale, &mut splats.rgb] {
            list.reserve_exact(count);
        }
        splats.opacity.reserve_exact(count);
        for _ in 0..count {
            let centre = [random.range(-0.5, 511.5), random.range(-0.5, 287.5)];
            scene.push_ordinary(&mut random, centre);
        }
        scene
    }

    /// 200,000 turned Gaussians, each axis between half a pixel and six, through a pinhole.
    pub(crate) fn anisotropic_720p() -> Self {
        let (width, height, focal) = (1280, 720, 1000.0);
        let (mut scene, mut random) = (Self::canonical(width, height), Random::new(3));
        scene.projection = Projection::Pinhole { focal: [focal; 2], centre: [639.5, 359.5] };
        scene.splats.rotation = Some(Vec::new());
        for _ in 0..200_000 {
            let z = random.log_range(1.0, 20.0);
            let (u, v) = (random.range(-650.0, 650.0), random.range(-370.0, 370.0));
            let scale = std::array::from_fn(|_| random.log_range(0.5, 6.0) * z / focal);
            let q: [f32; 4] = std::array::from_fn(|_| random.range(-1.0, 1.0));
            let norm = q.iter().map(|v| v * v).sum::<f32>().sqrt().max(1e-3);
            let opacity = random.range(0.05, 1.0);
            let rgb = colour(&mut random);
            scene.splats.push([u * z / focal, v * z / focal, z], scale, q.map(|v| v / norm), opacity, rgb);
        }
        scene
    }

    /// The scene with footprints that end.
    pub(crate) fn ending(mut self) -> Self {
        self.request.falloff = Falloff::SplatTransform;
        self
    }

    /// The scene through a lens that blurs the farthest Gaussians by discs of 10 px.
    pub(crate) fn blurred(mut self) -> Self {
        self.request.defocus = Some(Defocus { aperture: 0.08, focus: 4.0 });
        self
    }

    /// The scene's Gaussians in directions all around the eye, in 2048×1024 pixels, where they have about the same
    /// size.
    pub(crate) fn around(mut self) -> Self {
        let mut random = Random::new(5);
        for mean in &mut self.splats.mean {
            let distance = 0.33 * mean[2];
            // Uniform on the sphere.
            let (height, angle) = (random.range(-1.0, 1.0), random.range(-std::f32::consts::PI, std::f32::consts::PI));
            let level = (1.0 - height * height).sqrt();
            *mean = [level * angle.sin(), height, level * angle.cos()].map(|c| distance * c);
        }
        (self.projection, self.request.width, self.request.height) = (Projection::Equirectangular, 2048, 1024);
        self
    }

    /// Prediction of the model inside the library for two frames of a procedural clip, halfway between them, drawn at
    /// twice the model's size in each direction.
    pub(crate) fn predicted() -> Result<Self> {
        let clip = Clip::new(ClipKind::Moving, 1, 512, 288);
        let mut engine = Engine::new(Settings::default())?;
        let mut interval = None;
        for time in [0.0, 0.2] {
            let picture = clip.picture(time);
            let frame = Frame { width: picture.width, height: picture.height, rgb: picture.rgb, depth: None };
            interval = Some(engine.push(frame, time)?);
        }
        let interval = interval.context("no interval")?;
        let mut seen = Snapshot::of(&interval, 0.1, engine.workers())?;
        let view = View::new(&Camera::Canonical, &interval.placement, [288, 512]);
        view.apply(&mut seen.mean);
        let Snapshot { mean, scale, opacity, rgb, .. } = seen;
        Ok(Self {
            splats: OwnedGaussians { mean, scale, rotation: None, opacity, rgb },
            projection: *view.projection(),
            ..Self::canonical(512, 288)
        })
    }

    /// One Gaussian over the whole image behind 100,000 Gaussians smaller than a pixel.
    pub(crate) fn one_over_all() -> Self {
        let (mut scene, mut random) = (Self::canonical(512, 288), Random::new(4));
        scene.push_pixels([255.5, 143.5], [2000.0, 2000.0], 10.0, 0.9, [0.2, 0.4, 0.8]);
        for _ in 0..100_000 {
            let centre = [random.range(-0.5, 511.5), random.range(-0.5, 287.5)];
            let sigma = [random.log_range(0.05, 0.5), random.log_range(0.05, 0.5)];
            let (depth, opacity) = (random.range(0.1, 5.0), random.range(0.05, 1.0));
            let rgb = colour(&mut random);
            scene.push_pixels(centre, sigma, depth, opacity, rgb);
        }
        scene
    }

    /// The Gaussians of the grid whose cells are in one object of 5 % of the image.
    pub(crate) fn object(&self) -> Vec<usize> {
        let (w, h) = (self.request.width as f32, self.request.height as f32);
        let side = 0.05_f32.sqrt();
        let inside = |mean: &[f32; 3]| {
            let (x, y) = ((mean[0] + 1.0) * 0.5 * w, (mean[1] + 1.0) * 0.5 * h);
            (x / w - 0.4).abs() < 0.5 * side && (y / h - 0.45).abs() < 0.5 * side
        };
        (0..self.splats.mean.len()).filter(|&i| inside(&self.splats.mean[i])).collect()
    }

    /// Every twentieth Gaussian, scattered.
    pub(crate) fn scatter(&self) -> Vec<usize> {
        let mut random = Random::new(5);
        (0..self.splats.mean.len()).filter(|_| random.unit() < 0.05).collect()
    }

    /// Moves the chosen Gaussians by (x, y) pixels.
    pub(crate) fn moved(&self, chosen: &[usize], [x, y]: [f32; 2]) -> Self {
        let mut scene = self.clone();
        for &i in chosen {
            scene.splats.mean[i][0] += 2.0 * x / self.request.width as f32;
            scene.splats.mean[i][1] += 2.0 * y / self.request.height as f32;
        }
        scene
    }
}
