//! `fit`: optical flow between two frames of 512×288, and the steps of a fit of colours: the map from colours to an
//! image.

use anyhow::{Result, ensure};
use clap::Args;
use serde::Serialize;
use streamsplat_bench::Common;
use streamsplat_bench::machine::Machine;
use streamsplat_bench::table::{Column, Table};
use streamsplat_bench::timing::{Seconds, once};
use streamsplat_fixtures::clip::{Clip, ClipKind};
use streamsplat_kernels::flow::{self, Blend, Options as FlowOptions, Pyramid};
use streamsplat_kernels::gemm::Precision;
use streamsplat_kernels::raster::{ColourMap, render};

use crate::raster::scenes::Scene;

/// Options of `fit`.
#[derive(Args)]
pub(crate) struct Options {
    #[command(flatten)]
    common: Common,
}

const TABLE: Table<'_> = Table(&[
    Column::Text("milliseconds", 56),
    Column::Number("least", 8),
    Column::Number("median", 8),
    Column::Number("most", 8),
]);

#[derive(Serialize)]
struct FitTiming {
    what: &'static str,
    milliseconds: Seconds,
}

#[derive(Serialize)]
struct Report {
    machine: Machine,
    rows: Vec<FitTiming>,
}

pub(crate) fn run(options: &Options) -> Result<()> {
    let (rows, machine) = options.common.pool()?.install(|| -> Result<_> {
        let mut rows = flow_rows(&options.common)?;
        rows.extend(map_rows(&options.common)?);
        Ok((rows, Machine::new(options.common.isa, (Precision::F32, 0.0))))
    })?;
    println!("{}", TABLE.heads());
    for FitTiming { what, milliseconds: Seconds { min, median, max } } in &rows {
        let [least, median, most] = [min, median, max].map(|ms| format!("{ms:.2}"));
        println!("{}", TABLE.line(&[what, least.as_str(), &median, &most]));
    }
    options.common.write(&Report { machine, rows })
}

/// Times of `work`, after one run that is not counted.
fn measure(common: &Common, what: &'static str, mut work: impl FnMut()) -> FitTiming {
    work();
    let times = (0..common.repeat.max(1)).map(|_| 1e3 * once(&mut work)).collect();
    FitTiming { what, milliseconds: Seconds::of(times) }
}

fn flow_rows(common: &Common) -> Result<Vec<FitTiming>> {
    let (level, size, options) = (common.isa, [288, 512], FlowOptions::default());
    let clip = Clip::new(ClipKind::Moving, 1, size[1], size[0]);
    let [a, b] = [0.0, 0.1].map(|time| clip.picture(time).rgb);
    let pyramid = |rgb: &[f32]| Pyramid::new(level, &flow::luma(level, rgb), size, &options);
    let pyramids = [pyramid(&a)?, pyramid(&b)?];
    let both = || flow::both(level, &pyramids[0], &pyramids[1], [None; 2], &options);
    let [forward, backward] = both();
    let apart = |x: &[f32]| a.iter().zip(x).map(|(a, b)| f64::from((a - b).abs())).sum::<f64>();
    let (still, moved) = (apart(&b), apart(&flow::warp(level, &b, size, &forward)));
    ensure!(moved < 0.5 * still, "the flow explains too little: {moved} of {still} is left");
    let blend = Blend::new(level, [&a, &b], [&forward, &backward]);
    Ok(vec![
        measure(common, "pyramids of two frames of 512×288", || {
            let _ = std::hint::black_box((pyramid(&a), pyramid(&b)));
        }),
        measure(common, "flow, both directions", || drop(std::hint::black_box(both()))),
        measure(common, "a picture between, first the comparison of the frames", || {
            drop(std::hint::black_box(Blend::new(level, [&a, &b], [&forward, &backward]).at(0.4)));
        }),
        measure(common, "a picture between, each further one", || drop(std::hint::black_box(blend.at(0.6)))),
    ])
}

/// Checks an image of a map, whose weights are rounded to 8 bits, against the rasteriser's: 2/255 at most, and a
/// thousandth in the mean.
pub(crate) fn ensure_near(linear: &[f32], drawn: &[f32]) -> Result<()> {
    ensure!(linear.len() == drawn.len(), "the map's image: expected {} samples, found {}", drawn.len(), linear.len());
    let apart: Vec<f64> = linear.iter().zip(drawn).map(|(a, b)| f64::from((a - b).abs())).collect();
    let most = apart.iter().copied().max_by(f64::total_cmp).unwrap_or_default();
    let mean = apart.iter().sum::<f64>() / apart.len() as f64;
    ensure!(most <= 2.0 / 255.0, "the map's image: expected at most 2/255 from the rasteriser's, found {most}");
    ensure!(mean <= 1e-3, "the map's image: expected 0.001 from the rasteriser's in the mean, found {mean}");
    Ok(())
}

fn map_rows(common: &Common) -> Result<Vec<FitTiming>> {
    let scene = Scene::paper_grid();
    let gaussians = scene.gaussians();
    let size @ [width, height] = [scene.request.width, scene.request.height];
    let background = scene.request.background;
    let mut map = ColourMap::new(common.isa);
    map.prepare(&gaussians, &scene.projection, size);
    let mut image = vec![0.0; 3 * width * height];
    map.forward(gaussians.rgb, background, &mut image);
    let drawn = render(common.isa, &gaussians, &scene.projection, &scene.request);
    ensure_near(&image, &drawn.rgb)?;
    let residual: Vec<f32> = image.iter().enumerate().map(|(i, x)| x - (i % 7) as f32 * 0.1).collect();
    let mut sums = vec![[0.0; 3]; gaussians.len()];
    map.adjoint(&residual, &mut sums);
    // ⟨A·c, r⟩ = ⟨c, Aᵀ·r⟩, on black.
    let mut linear = vec![0.0; image.len()];
    map.forward(gaussians.rgb, [0.0; 3], &mut linear);
    let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>();
    let (left, right) = (dot(&linear, &residual), dot(gaussians.rgb.as_flattened(), sums.as_flattened()));
    ensure!((left - right).abs() <= 1e-4 * left.abs(), "⟨A·c, r⟩ is {left}, ⟨c, Aᵀ·r⟩ {right}");
    Ok(vec![
        measure(common, "73,728 Gaussians at 512×288, the rasteriser", || {
            drop(std::hint::black_box(render(common.isa, &gaussians, &scene.projection, &scene.request)));
        }),
        measure(common, "the same, preparing the map", || {
            ColourMap::new(common.isa).prepare(&gaussians, &scene.projection, size);
        }),
        measure(common, "the same, forward", || map.forward(gaussians.rgb, background, &mut image)),
        measure(common, "the same, adjoint", || map.adjoint(&residual, &mut sums)),
        measure(common, "the same, a step of the fit: AᵀA·c", || map.normal(gaussians.rgb, &mut sums)),
    ])
}
