//! `raster`: drawing whole scenes, redrawing after a change, images of a part of a scene, and growth with the number of
//! Gaussians.

#[cfg(feature = "wgpu")]
mod card;
mod part;
pub(crate) mod scenes;
mod trained;

use std::process::Command;

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use serde::{Deserialize, Serialize};
use streamsplat::render::Backend;
use streamsplat_kernels::Level;
use streamsplat_kernels::exposure::{self, Exposure};
use streamsplat_kernels::gemm::Precision;
use streamsplat_kernels::raster::{Projection, Rasteriser, Work, reference};

use scenes::Scene;
use streamsplat_bench::Common;
use streamsplat_bench::machine::Machine;
use streamsplat_bench::table::{Column, Table};
use streamsplat_bench::timing::{Seconds, once};

/// Options of `raster`.
#[derive(Args)]
pub(crate) struct Options {
    #[command(flatten)]
    common: Common,
    /// Only scenes whose name contains this.
    #[arg(long, default_value = "")]
    only: String,
    /// Most Gaussians of the growth measurement (0: leave it out).
    #[arg(long, default_value_t = 10_000_000)]
    largest: usize,
    /// Renderer: cpu, or wgpu (compared with the CPU's images first; redrawing and growth are left out).
    #[arg(long, default_value_t = Backend::Cpu)]
    renderer: Backend,
    /// Measure one step of the growth measurement and print it (used by the command itself).
    #[arg(long, hide = true)]
    step: Option<usize>,
    /// Measure one scene of this size with the statistics of trained ones and print it (used by the command itself).
    #[arg(long, hide = true)]
    trained: Option<usize>,
}

#[derive(Serialize)]
struct Milliseconds {
    min: f64,
    median: f64,
    max: f64,
}

impl From<Seconds> for Milliseconds {
    fn from(s: Seconds) -> Self {
        Self { min: s.min * 1e3, median: s.median * 1e3, max: s.max * 1e3 }
    }
}

/// Milliseconds of each stage in the fastest run; sorting and blending share their threads' time.
#[derive(Clone, Copy, Serialize, Deserialize)]
struct Stages {
    project: f64,
    bin: f64,
    sort: f64,
    blend: f64,
}

impl From<Work> for Stages {
    fn from(work: Work) -> Self {
        let ms = |d: std::time::Duration| d.as_secs_f64() * 1e3;
        Self { project: ms(work.project), bin: ms(work.bin), sort: ms(work.sort), blend: ms(work.blend) }
    }
}

impl Stages {
    /// Time and share of each stage.
    fn cells(&self) -> [String; 4] {
        let all = [self.project, self.bin, self.sort, self.blend];
        let total = all.iter().sum::<f64>().max(1e-9);
        all.map(|ms| format!("{ms:.2} {:>3.0}%", 100.0 * ms / total))
    }
}

#[derive(Serialize)]
struct SceneTiming {
    name: String,
    gaussians: usize,
    /// Width, height.
    size: [usize; 2],
    milliseconds: Milliseconds,
    stages: Stages,
    work: Counts,
    /// Largest difference from the binary64 reference, away from its thresholds.
    error: f64,
}

/// Work of one image, and skipped work.
#[derive(Serialize)]
struct Counts {
    culled: u64,
    changed: u64,
    tiles: u64,
    tiles_drawn: u64,
    entries: u64,
    entries_unseen: u64,
    blocks: u64,
}

#[derive(Serialize, Deserialize)]
struct Growth {
    gaussians: usize,
    milliseconds: f64,
    peak_rss_bytes: u64,
    stages: Stages,
}

#[derive(Serialize)]
struct Results {
    machine: Machine,
    /// Renderer.
    renderer: String,
    scenes: Vec<SceneTiming>,
    parts: Vec<part::PartTiming>,
    scaling: Vec<Growth>,
    trained: Vec<trained::TrainedTiming>,
}

/// Measures.
pub(crate) fn run(options: &Options) -> Result<()> {
    let level = options.common.isa;
    let pool = options.common.pool()?;
    if let Some(count) = options.step {
        let step = pool.install(|| growth_step(level, count, options.common.repeat))?;
        println!("{}", serde_json::to_string(&step)?);
        return Ok(());
    }
    if let Some(count) = options.trained {
        let row = pool.install(|| trained::measure(level, count, options.common.repeat))?;
        println!("{}", serde_json::to_string(&row)?);
        return Ok(());
    }
    if options.renderer == Backend::Wgpu {
        #[cfg(feature = "wgpu")]
        return pool.install(|| card::run(options));
        #[cfg(not(feature = "wgpu"))]
        bail!("--renderer wgpu: expected a program built with the cargo feature wgpu, found one without");
    }
    pool.install(|| {
        let wanted = |name: &str| name.contains(&options.only);
        let repeat = options.common.repeat.max(3);
        let mut rows = Vec::new();
        println!("{}", SCENES.heads());
        for (name, scene) in WHOLE.into_iter().chain(OPTICS) {
            if wanted(name) {
                rows.push(measure(level, name, &[scene()?], false, repeat)?);
            }
        }
        if wanted("shutter-720p") {
            rows.push(shutter(level, repeat)?);
        }
        let choices: [(&str, fn(&Scene) -> Vec<usize>); 2] =
            [("moved-5pc", Scene::object), ("moved-5pc-scattered", Scene::scatter)];
        for (name, choose) in choices {
            if wanted(name) {
                let scene = Scene::paper_grid();
                let chosen = choose(&scene);
                let steps: Vec<Scene> =
                    (0..4).map(|i| scene.moved(&chosen, [0.7 * i as f32, 0.3 * i as f32])).collect();
                rows.push(measure(level, name, &steps, true, repeat)?);
            }
        }
        let parts = if wanted("part") { part::run(level, repeat)? } else { Vec::new() };
        let scaling = growth(options)?;
        let trained = large(options)?;
        let machine = Machine::new(level, (Precision::F32, 0.0));
        let renderer = options.renderer.to_string();
        options.common.write(&Results { machine, renderer, scenes: rows, parts, scaling, trained })
    })
}

/// Scenes that are drawn as a whole.
const WHOLE: [(&str, fn() -> Result<Scene>); 4] = [
    ("paper-grid", || Ok(Scene::paper_grid())),
    ("anisotropic-720p", || Ok(Scene::anisotropic_720p())),
    ("one-over-all", || Ok(Scene::one_over_all())),
    ("predicted", Scene::predicted),
];

/// The turned Gaussians with optics that only the CPU draws.
const OPTICS: [(&str, fn() -> Result<Scene>); 3] = [
    ("footprint-720p", || Ok(Scene::anisotropic_720p().ending())),
    ("lens-720p", || Ok(Scene::anisotropic_720p().blurred())),
    ("panorama-2048", || Ok(Scene::anisotropic_720p().around())),
];

const SCENES: Table<'_> = Table(&[
    Column::Text("scene", 20),
    Column::Number("Gaussians", 9),
    Column::Number("size", 9),
    Column::Number("min ms", 7),
    Column::Number("median", 7),
    Column::Number("max", 7),
    Column::Number("project", 11),
    Column::Number("bin", 11),
    Column::Number("sort", 11),
    Column::Number("blend", 11),
    Column::Number("error", 7),
]);

const GROWTH: Table<'_> = Table(&[
    Column::Number("Gaussians", 20),
    Column::Number("ms", 9),
    Column::Number("ns each", 9),
    Column::Number("peak MiB", 9),
    Column::Number("project", 11),
    Column::Number("bin", 11),
    Column::Number("sort", 11),
    Column::Number("blend", 11),
]);

/// Draws the scenes in turn, `repeat` times: each as a whole, or with `keep` only the changes from one to the next.
fn measure(level: Level, name: &str, scenes: &[Scene], keep: bool, repeat: usize) -> Result<SceneTiming> {
    let mut rasteriser = Rasteriser::new(level);
    let mut error = 0.0_f64;
    for scene in scenes {
        rasteriser.render(&scene.gaussians(), &scene.projection, &scene.request);
        error = error.max(check(&rasteriser, scene).with_context(|| name.to_owned())?);
    }
    let mut times = Vec::new();
    let mut best: Option<(f64, Work)> = None;
    for _ in 0..repeat {
        for scene in scenes {
            if !keep {
                rasteriser.forget();
            }
            let seconds = once(|| {
                std::hint::black_box(rasteriser.render(&scene.gaussians(), &scene.projection, &scene.request));
            });
            times.push(seconds);
            if best.is_none_or(|(least, _)| seconds < least) {
                best = Some((seconds, rasteriser.work()));
            }
        }
    }
    let (_, work) = best.context("nothing was drawn")?;
    Ok(SceneTiming::new(name, &scenes[0], Seconds::of(times), work, error))
}

/// Images of one exposure, as many as `render --shutter` takes by default.
const SAMPLES: usize = 16;
/// One value in this many is compared with the reference.
const COMPARED: usize = 97;

/// Moving, rotated Gaussians during an exposure: [`SAMPLES`] images and their mean in linear light. Stages are those of
/// one image.
fn shutter(level: Level, repeat: usize) -> Result<SceneTiming> {
    let still = Scene::anisotropic_720p();
    let all: Vec<usize> = (0..still.splats.mean.len()).collect();
    let scenes: Vec<Scene> = (0..SAMPLES).map(|i| still.moved(&all, [i as f32, 0.0])).collect();
    let mut rasteriser = Rasteriser::new(level);
    let mut exposed = |mut compared: Option<&mut Vec<Vec<f32>>>| {
        let mut exposure = Exposure::new(level, false);
        for scene in &scenes {
            rasteriser.forget();
            let image = rasteriser.render(&scene.gaussians(), &scene.projection, &scene.request);
            exposure.add(image);
            if let Some(compared) = &mut compared {
                compared.push(image.rgb.iter().step_by(COMPARED).copied().collect());
            }
        }
        (exposure.mean(), rasteriser.work())
    };
    let mut each = Vec::new();
    let (image, mut work) = exposed(Some(&mut each));
    let mut error = 0.0_f64;
    for (at, found) in image.rgb.iter().step_by(COMPARED).enumerate() {
        let values: Vec<f32> = each.iter().map(|image| image[at]).collect();
        error = error.max((f64::from(*found) - exposure::reference::mean(&values)).abs());
    }
    ensure!(error <= 2e-5, "shutter: off by {error:e}");
    let times = (0..repeat).map(|_| once(|| work = std::hint::black_box(exposed(None)).1)).collect();
    Ok(SceneTiming::new("shutter-720p", &still, Seconds::of(times), work, error))
}

impl SceneTiming {
    /// The row, printed.
    fn new(name: &str, scene: &Scene, seconds: Seconds, work: Work, error: f64) -> Self {
        let row = SceneTiming {
            name: name.to_owned(),
            gaussians: scene.splats.mean.len(),
            size: [scene.request.width, scene.request.height],
            milliseconds: seconds.into(),
            stages: work.into(),
            work: Counts {
                culled: work.culled,
                changed: work.changed,
                tiles: work.tiles,
                tiles_drawn: work.tiles_drawn,
                entries: work.entries,
                entries_unseen: work.entries_unseen,
                blocks: work.blocks,
            },
            error,
        };
        let Milliseconds { min, median, max } = row.milliseconds;
        let size = format!("{}×{}", row.size[0], row.size[1]);
        let times = [min, median, max].map(|ms| format!("{ms:.2}"));
        let cells = [&[row.name.clone(), row.gaussians.to_string(), size][..], &times, &row.stages.cells()].concat();
        println!("{}", SCENES.line(&[cells, vec![format!("{:.1e}", row.error)]].concat()));
        row
    }
}

/// The largest error of the rasteriser's image against the binary64 reference, over pixels that no threshold decides.
fn check(rasteriser: &Rasteriser, scene: &Scene) -> Result<f64> {
    let expected = reference::render(&scene.gaussians(), &scene.projection, &scene.request);
    let pixels = scene.request.width * scene.request.height;
    let found = &rasteriser.image().rgb;
    ensure!(found.len() == expected.rgb.len(), "{} values, expected {}", found.len(), expected.rgb.len());
    // Rays of a panorama are formed in binary32. An α may be off by a thousandth, as in the kernel's own tests, so more
    // pixels are near a threshold.
    let around = scene.projection == Projection::Equirectangular;
    let (doubt, share) = if around { (2e-3, 10) } else { (1e-5, 100) };
    let (mut worst, mut undecided) = (0.0_f64, 0);
    for (at, (&found, &expected_value)) in found.iter().zip(&expected.rgb).enumerate() {
        let error = (f64::from(found) - expected_value).abs();
        if expected.margin[at % pixels] > doubt {
            worst = worst.max(error);
        } else {
            undecided += 1;
            ensure!(error <= 2.0 / 255.0, "value {at} is {found}, expected {expected_value}");
        }
    }
    ensure!(worst <= 2e-5, "off by {worst:e}");
    ensure!(undecided * share <= found.len(), "{undecided} of {} values hang on a threshold", found.len());
    Ok(worst)
}

/// Scenes with the statistics of trained ones, each in a process of its own.
fn large(options: &Options) -> Result<Vec<trained::TrainedTiming>> {
    let wanted = |count: &usize| *count <= options.largest && "trained".contains(&options.only);
    let mut rows = Vec::new();
    for count in trained::COUNTS.into_iter().filter(wanted) {
        let row: trained::TrainedTiming = alone(options, "--trained", count)?;
        if rows.is_empty() {
            println!("\n{}", trained::TABLE.heads());
        }
        println!("{}", row.line());
        rows.push(row);
    }
    Ok(rows)
}

/// Measures `count` Gaussians in a process of its own, for its peak memory.
fn alone<T: for<'a> Deserialize<'a>>(options: &Options, what: &str, count: usize) -> Result<T> {
    let program = std::env::current_exe().context("finding this program")?;
    let output = Command::new(&program)
        .args(["raster", what, &count.to_string(), "--isa", options.common.isa.name()])
        .args(["--threads", &rayon::current_num_threads().to_string()])
        .args(["--repeat", &options.common.repeat.to_string()])
        .output()
        .context("starting a measurement")?;
    if !output.status.success() {
        bail!("{count} Gaussians: {}", String::from_utf8_lossy(&output.stderr).trim());
    }
    Ok(serde_json::from_slice(&output.stdout)?)
}

/// Times for 10⁴, 10⁵ … Gaussians, each in a process of its own, so that its peak memory is its own.
fn growth(options: &Options) -> Result<Vec<Growth>> {
    let mut rows = Vec::new();
    let mut count = 10_000;
    while count <= options.largest && options.only.is_empty() {
        let row: Growth = alone(options, "--step", count)?;
        if rows.is_empty() {
            println!("\n{}", GROWTH.heads());
        }
        let figures = [
            row.gaussians.to_string(),
            format!("{:.2}", row.milliseconds),
            format!("{:.1}", row.milliseconds * 1e6 / row.gaussians as f64),
            format!("{:.0}", row.peak_rss_bytes as f64 / f64::from(1 << 20)),
        ];
        println!("{}", GROWTH.line(&[figures, row.stages.cells()].concat()));
        rows.push(row);
        count *= 10;
    }
    Ok(rows)
}

fn growth_step(level: Level, count: usize, repeat: usize) -> Result<Growth> {
    let scene = Scene::scattered(count);
    let mut rasteriser = Rasteriser::new(level);
    let mut best = (f64::INFINITY, Work::default());
    for _ in 0..repeat.clamp(2, if count > 1_000_000 { 3 } else { 100 }) {
        rasteriser.forget();
        let seconds = once(|| {
            std::hint::black_box(rasteriser.render(&scene.gaussians(), &scene.projection, &scene.request));
        });
        if seconds < best.0 {
            best = (seconds, rasteriser.work());
        }
    }
    let (seconds, work) = best;
    Ok(Growth { gaussians: count, milliseconds: seconds * 1e3, peak_rss_bytes: peak_rss_bytes()?, stages: work.into() })
}

/// The most memory that this process has had resident.
fn peak_rss_bytes() -> Result<u64> {
    let status = std::fs::read_to_string("/proc/self/status").context("reading /proc/self/status")?;
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:")).context("no VmHWM in /proc/self/status")?;
    let kilobytes: u64 = line.trim().trim_end_matches("kB").trim().parse().context("VmHWM is no number")?;
    Ok(kilobytes * 1024)
}
