//! The same scenes on a graphics card.

use anyhow::{Result, ensure};
use streamsplat::wgpu::WgpuRasteriser;
use streamsplat_bench::machine::Machine;
use streamsplat_bench::timing::{Seconds, once};
use streamsplat_kernels::gemm::Precision;
use streamsplat_kernels::raster::{Work, render};

use super::{Options, Results, SCENES, Scene, SceneTiming, WHOLE};

/// One pixel in this many may differ by more than [`CLOSE`].
const ONE_IN: usize = 2000;
/// Largest difference of the other pixels.
const CLOSE: f32 = 2.0 / 255.0;

/// Compares every scene's image with the CPU's, then measures. A row's `error` is the largest difference.
pub(super) fn run(options: &Options) -> Result<()> {
    let level = options.common.isa;
    let mut renderer = WgpuRasteriser::new(level)?;
    println!("{}", renderer.adapter());
    println!("{}", SCENES.heads());
    let mut rows = Vec::new();
    for (name, scene) in WHOLE {
        if name.contains(&options.only) {
            rows.push(measure(&mut renderer, options, name, &scene()?)?);
        }
    }
    let machine = Machine::new(level, (Precision::F32, 0.0));
    let renderer = format!("wgpu on {}", renderer.adapter());
    options.common.write(&Results {
        machine,
        renderer,
        scenes: rows,
        parts: Vec::new(),
        scaling: Vec::new(),
        trained: Vec::new(),
    })
}

fn measure(renderer: &mut WgpuRasteriser, options: &Options, name: &str, scene: &Scene) -> Result<SceneTiming> {
    let expected = render(options.common.isa, &scene.gaussians(), &scene.projection, &scene.request);
    let found = renderer.render(&scene.gaussians(), &scene.projection, &scene.request)?;
    ensure!(
        found.rgb.len() == expected.rgb.len(),
        "{name}: {} values, expected {}",
        found.rgb.len(),
        expected.rgb.len()
    );
    let pixels = scene.request.width * scene.request.height;
    let mut off = vec![false; pixels];
    let mut worst = 0.0_f32;
    for (at, (found, expected)) in found.rgb.iter().zip(&expected.rgb).enumerate() {
        let error = (found - expected).abs();
        off[at % pixels] |= error.is_nan() || error > CLOSE;
        worst = worst.max(error);
    }
    let off = off.into_iter().filter(|off| *off).count();
    ensure!(off * ONE_IN <= pixels, "{name}: {off} of {pixels} pixels are off by more than 2/255");
    let mut times = Vec::new();
    let mut best = (f64::INFINITY, Work::default());
    for _ in 0..options.common.repeat.max(3) {
        let mut failed = None;
        let seconds = once(|| {
            failed = renderer.render(&scene.gaussians(), &scene.projection, &scene.request).err();
        });
        failed.map_or(Ok(()), Err)?;
        times.push(seconds);
        if seconds < best.0 {
            best = (seconds, renderer.work());
        }
    }
    Ok(SceneTiming::new(name, scene, Seconds::of(times), best.1, f64::from(worst)))
}
