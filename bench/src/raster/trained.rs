//! Scenes as training from many pictures makes them: anisotropic Gaussians with harmonics of degree 3, seen at 1920×1080.
//!
//! Nobody's scene is in the repository, so the statistics are: depths log-uniform from 1 to 30 over a frustum a fifth wider than the image; standard
//! deviations log-normal, by a median of 1.5 pixels and a factor of e^0.8, one axis of three e^1.5 times thinner; opacities the logistic function of a normal variable of
//! deviation 2 (a third below 0.3, a third above 0.7); rotations uniform; higher coefficients normal, of deviation 0.1. With these a pixel is
//! covered by some tens of Gaussians before it is opaque.

use anyhow::{Context, Result, ensure};
use serde::{Deserialize, Serialize};
use streamsplat_kernels::Level;
use streamsplat_kernels::harmonics::{self, Eye};
use streamsplat_kernels::raster::{ColourMap, OwnedGaussians, Projection, Renderer, Request, Work};

use super::scenes::{Random, Scene};
use super::{Stages, check, peak_rss_bytes};
use crate::timing::once;

/// Gaussians.
pub(super) const COUNTS: [usize; 2] = [1_000_000, 10_000_000];
const SIZE: [usize; 2] = [1920, 1080];
const FOCAL: f32 = 1600.0;
const DEGREE: usize = 3;

/// Milliseconds of the fastest run of each part.
#[derive(Serialize, Deserialize)]
pub(super) struct Row {
    gaussians: usize,
    /// Colours of the harmonics as the camera sees them.
    colours: f64,
    /// The image from them.
    image: f64,
    stages: Stages,
    /// Both.
    forward: f64,
    /// The map from colours to the image: made, and from a residual back to sums; where its weights take little enough.
    prepare: Option<f64>,
    adjoint: Option<f64>,
    entries: u64,
    peak_rss_bytes: u64,
    /// The image's largest difference from the binary64 reference, where that was made.
    error: Option<f64>,
}

impl Random {
    /// Of mean 0 and deviation 1 (Box and Muller).
    fn normal(&mut self) -> f32 {
        let (u, v) = (1.0 - self.unit(), self.unit());
        (-2.0 * u.ln()).sqrt() * (std::f32::consts::TAU * v).cos()
    }
}

struct Trained {
    scene: Scene,
    base: Vec<[f32; 3]>,
    higher: Vec<f32>,
}

fn trained(count: usize) -> Trained {
    let [width, height] = SIZE;
    let centre = [0.5 * (width - 1) as f32, 0.5 * (height - 1) as f32];
    let mut random = Random::new(6);
    let mut splats = OwnedGaussians { rotation: Some(Vec::with_capacity(count)), ..OwnedGaussians::default() };
    let rest = 3 * harmonics::rest(DEGREE);
    let (mut base, mut higher) = (Vec::with_capacity(count), Vec::with_capacity(count * rest));
    for _ in 0..count {
        let z = random.log_range(1.0, 30.0);
        let u = random.range(-0.6, 0.6) * width as f32;
        let v = random.range(-0.6, 0.6) * height as f32;
        let mut scale: [f32; 3] = std::array::from_fn(|_| 1.5 * (0.8 * random.normal()).exp() * z / FOCAL);
        scale[2] *= (-1.5_f32).exp();
        let q: [f32; 4] = std::array::from_fn(|_| random.normal());
        let norm = q.iter().map(|v| v * v).sum::<f32>().sqrt().max(1e-3);
        let opacity = 1.0 / (1.0 + (-2.0 * random.normal()).exp());
        splats.push([u * z / FOCAL, v * z / FOCAL, z], scale, q.map(|v| v / norm), opacity, [0.0; 3]);
        base.push(std::array::from_fn(|_| random.range(-1.5, 1.5)));
        higher.extend((0..rest).map(|_| 0.1 * random.normal()));
    }
    let projection = Projection::Pinhole { focal: [FOCAL; 2], centre };
    let request = Request::colour(width, height, [0.0; 3]);
    Trained { scene: Scene { splats, projection, request }, base, higher }
}

/// The fastest of `repeat` runs, in milliseconds.
fn fastest(repeat: usize, mut work: impl FnMut()) -> f64 {
    (0..repeat).map(|_| 1e3 * once(&mut work)).fold(f64::INFINITY, f64::min)
}

/// Measures a scene of `count` Gaussians: the image and the sums are checked first.
pub(super) fn measure(level: Level, count: usize, repeat: usize) -> Result<Row> {
    let Trained { mut scene, base, higher } = trained(count);
    let repeat = if count > 1_000_000 { repeat.min(3) } else { repeat };
    let mut rgb = vec![[0.0; 3]; count];
    let eye = Eye::At([0.0; 3]);
    let colours = fastest(repeat, || {
        harmonics::colours(level, DEGREE, &base, &higher, &scene.splats.mean, eye, &mut rgb);
    });
    drop((base, higher));
    scene.splats.rgb = rgb;
    let gaussians = scene.gaussians();
    let mut renderer = Renderer::new(level);
    renderer.render(&gaussians, &scene.projection, &scene.request);
    let small = count <= COUNTS[0];
    let error = small.then(|| check(&renderer, &scene)).transpose().with_context(|| format!("{count} Gaussians"))?;
    let mut best = (f64::INFINITY, Work::default());
    for _ in 0..repeat {
        renderer.forget();
        let milliseconds = fastest(1, || {
            std::hint::black_box(renderer.render(&gaussians, &scene.projection, &scene.request));
        });
        if milliseconds < best.0 {
            best = (milliseconds, renderer.work());
        }
    }
    let (image, work) = best;
    let (prepare, adjoint) = if small {
        let mut map = ColourMap::new(level);
        let prepare = fastest(repeat, || map.prepare(&gaussians, &scene.projection, SIZE));
        let mut linear = vec![0.0; 3 * SIZE[0] * SIZE[1]];
        map.forward(gaussians.rgb, scene.request.background, &mut linear);
        ensure!(linear == renderer.image().rgb, "{count} Gaussians: the map's image is not the rasteriser's");
        let mut sums = vec![[0.0; 3]; count];
        let adjoint = fastest(repeat, || map.adjoint(&linear, &mut sums));
        // ⟨A·c, A·c⟩ = ⟨c, Aᵀ·A·c⟩, on black.
        let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>();
        let (left, right) = (dot(&linear, &linear), dot(gaussians.rgb.as_flattened(), sums.as_flattened()));
        ensure!((left - right).abs() <= 1e-4 * left.abs(), "⟨A·c, A·c⟩ is {left}, ⟨c, Aᵀ·A·c⟩ {right}");
        (Some(prepare), Some(adjoint))
    } else {
        (None, None)
    };
    let (forward, entries) = (colours + image, work.entries);
    let peak_rss_bytes = peak_rss_bytes()?;
    Ok(Row {
        gaussians: count,
        colours,
        image,
        stages: work.into(),
        forward,
        prepare,
        adjoint,
        entries,
        peak_rss_bytes,
        error,
    })
}

impl Row {
    pub(super) fn print(&self) {
        let shown = |ms: Option<f64>| ms.map_or_else(|| "–".to_owned(), |ms| format!("{ms:.1}"));
        println!(
            "{:>10} trained-like  colours {:.1} ms, image {:.1}, both {:.1}; map {}, adjoint {}; {:.1} entries each; peak {:.0} MiB; {}",
            self.gaussians,
            self.colours,
            self.image,
            self.forward,
            shown(self.prepare),
            shown(self.adjoint),
            self.entries as f64 / self.gaussians as f64,
            self.peak_rss_bytes as f64 / f64::from(1 << 20),
            self.stages.shown(),
        );
    }
}
