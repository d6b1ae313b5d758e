//! Scenes with the statistics of training from many pictures: anisotropic Gaussians with harmonics of degree 3, seen at
//! 1920×1080 ([`streamsplat_fixtures::trained`]).

use anyhow::{Context, Result, ensure};
use serde::{Deserialize, Serialize};
use streamsplat_bench::table::{Column, Table};
use streamsplat_bench::timing::once;
use streamsplat_fixtures::trained::{DEGREE, FOCAL, HIGHER, SIZE, gaussians};
use streamsplat_kernels::Level;
use streamsplat_kernels::harmonics::{self, Eye};
use streamsplat_kernels::raster::{ColourMap, OwnedGaussians, Projection, Rasteriser, Request, Work};

use super::scenes::Scene;
use super::{Stages, check, peak_rss_bytes};
use crate::fit::ensure_near;

/// Gaussians.
pub(super) const COUNTS: [usize; 2] = [1_000_000, 10_000_000];

pub(super) const TABLE: Table<'_> = Table(&[
    Column::Number("trained Gaussians", 20),
    Column::Number("colours ms", 0),
    Column::Number("image", 7),
    Column::Number("both", 7),
    Column::Number("map", 7),
    Column::Number("adjoint", 7),
    Column::Number("entries each", 0),
    Column::Number("peak MiB", 0),
    Column::Number("project", 11),
    Column::Number("bin", 11),
    Column::Number("sort", 11),
    Column::Number("blend", 11),
]);

/// Milliseconds of the fastest run of each part.
#[derive(Serialize, Deserialize)]
pub(super) struct TrainedTiming {
    gaussians: usize,
    /// Colours of the harmonics from the camera.
    colours: f64,
    /// The image from them.
    image: f64,
    stages: Stages,
    /// Both.
    forward: f64,
    /// The map from colours to the image: preparation, and the step from a residual to sums. Only where its weights
    /// take little enough memory.
    prepare: Option<f64>,
    adjoint: Option<f64>,
    entries: u64,
    peak_rss_bytes: u64,
    /// The image's largest difference from the binary64 reference, where that was computed.
    error: Option<f64>,
}

struct Trained {
    scene: Scene,
    base: Vec<[f32; 3]>,
    higher: Vec<f32>,
}

fn trained(count: usize) -> Trained {
    let [width, height] = SIZE;
    let centre = [0.5 * (width - 1) as f32, 0.5 * (height - 1) as f32];
    let mut splats = OwnedGaussians { rotation: Some(Vec::with_capacity(count)), ..OwnedGaussians::default() };
    let (mut base, mut higher) = (Vec::with_capacity(count), Vec::with_capacity(count * HIGHER));
    for gaussian in gaussians(count) {
        let opacity = 1.0 / (1.0 + (-gaussian.logit).exp());
        splats.push(gaussian.mean, gaussian.scale, gaussian.rotation, opacity, [0.0; 3]);
        base.push(gaussian.base);
        higher.extend(gaussian.higher);
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
pub(super) fn measure(level: Level, count: usize, repeat: usize) -> Result<TrainedTiming> {
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
    let mut rasteriser = Rasteriser::new(level);
    rasteriser.render(&gaussians, &scene.projection, &scene.request);
    let small = count <= COUNTS[0];
    let error = small.then(|| check(&rasteriser, &scene)).transpose().with_context(|| format!("{count} Gaussians"))?;
    let mut best = (f64::INFINITY, Work::default());
    for _ in 0..repeat {
        rasteriser.forget();
        let milliseconds = fastest(1, || {
            std::hint::black_box(rasteriser.render(&gaussians, &scene.projection, &scene.request));
        });
        if milliseconds < best.0 {
            best = (milliseconds, rasteriser.work());
        }
    }
    let (image, work) = best;
    let (prepare, adjoint) = if small {
        let mut map = ColourMap::new(level);
        let prepare = fastest(repeat, || map.prepare(&gaussians, &scene.projection, SIZE));
        let mut linear = vec![0.0; 3 * SIZE[0] * SIZE[1]];
        map.forward(gaussians.rgb, scene.request.background, &mut linear);
        ensure_near(&linear, &rasteriser.image().rgb).with_context(|| format!("{count} Gaussians"))?;
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
    Ok(TrainedTiming {
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

impl TrainedTiming {
    /// Its line of [`TABLE`].
    pub(super) fn line(&self) -> String {
        let shown = |ms: Option<f64>| ms.map_or_else(|| "–".to_owned(), |ms| format!("{ms:.1}"));
        let times = [Some(self.colours), Some(self.image), Some(self.forward), self.prepare, self.adjoint].map(shown);
        let entries = format!("{:.1}", self.entries as f64 / self.gaussians as f64);
        let peak = format!("{:.0}", self.peak_rss_bytes as f64 / f64::from(1 << 20));
        TABLE.line(&[&[self.gaussians.to_string()], &times[..], &[entries, peak], &self.stages.cells()].concat())
    }
}
