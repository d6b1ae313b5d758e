//! `stages`: one call of each stage of the network, and one new key frame as a whole.
//!
//! `small` is the checkpoint inside the library; `paper` has the published model's sizes and weights from a seed, written to
//! a temporary file. Before a stage is timed, its result is compared in bits with that of another number of threads.

use std::io::{BufWriter, Write};
use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use clap::{Args, ValueEnum};
use serde::Serialize;
use streamsplat::stream::{EMBEDDED_CHECKPOINT, EMBEDDED_CONFIG};
use streamsplat_fixtures::seeded::{self, Sizes, uniform};
use streamsplat_kernels::raster::{Gaussians, Projection, Request, render};
use streamsplat_kernels::{Level, gemm};
use streamsplat_model::inspect::{dino_gflop, stages};
use streamsplat_model::{
    Deformation, Dino, FrameInput, LoadOptions, Network, Precision, Sampling, Side, StaticGaussians, motion,
};

use crate::Common;
use crate::machine::{self, Machine};
use crate::timing::{Seconds, once};

/// Options of `stages`.
#[derive(Args)]
pub(crate) struct Options {
    #[command(flatten)]
    common: Common,
    /// Which model.
    #[arg(long, value_enum, default_value_t = Size::Small)]
    size: Size,
    /// Only stages whose name contains this.
    #[arg(long, default_value = "")]
    only: String,
    /// f32, bf16 or int8.
    #[arg(long, default_value = "f32")]
    precision: Precision,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Size {
    Paper,
    Small,
    All,
}

#[derive(Serialize)]
struct Row {
    name: &'static str,
    size: &'static str,
    precision: &'static str,
    /// Operations of a call in 10⁹; none for drawing, whose work depends on the scene.
    gflop: Option<f64>,
    seconds: Seconds,
    fraction_of_peak: Option<f64>,
}

#[derive(Serialize)]
struct Results {
    machine: Machine,
    stages: Vec<Row>,
}

pub(crate) fn run(options: &Options) -> Result<()> {
    let pool = options.common.pool()?;
    println!("{:<10} {:<6} {:>10} {:>12} {:>10} {:>9}", "stage", "size", "GFLOP", "ms (min)", "GFLOP/s", "of peak");
    let (mut rows, mut peak) = (Vec::new(), 0.0_f64);
    for (size, name) in [(Size::Small, "small"), (Size::Paper, "paper")] {
        if options.size == Size::All || options.size == size {
            let model = pool.install(|| Model::load(size, options))?;
            pool.install(|| model.measure(name, options, &mut rows, &mut peak))?;
        }
    }
    let machine = pool.install(|| Machine::new(options.common.isa, (operands(options.precision), peak)));
    println!("{machine}");
    options.common.write(&Results { machine, stages: rows })
}

/// The format of the large products' operands.
fn operands(precision: Precision) -> gemm::Precision {
    match precision {
        Precision::F32 => gemm::Precision::F32,
        Precision::Bf16 => gemm::Precision::Bf16,
        Precision::Int8 => gemm::Precision::Int8,
    }
}

/// A network with everything that a new key frame reads.
struct Model {
    network: Network,
    dino: Option<Dino>,
    level: Level,
    rgb: [Vec<f32>; 2],
    tokens: Vec<f32>,
    h: [Vec<f32>; 2],
    static_tokens: [Vec<f32>; 2],
    condition: [Option<Vec<f32>>; 2],
    still: [StaticGaussians; 2],
    moving: [Deformation; 2],
}

/// A seeded model as a file that is removed when dropped.
struct Temporary(PathBuf);

impl Temporary {
    fn new(name: &str, write: impl FnOnce(&mut BufWriter<std::fs::File>) -> std::io::Result<()>) -> Result<Temporary> {
        let path = std::env::temp_dir().join(format!("streamsplat-{}-{name}.safetensors", std::process::id()));
        let file = std::fs::File::create(&path).with_context(|| format!("creating {}", path.display()))?;
        let file_guard = Temporary(path);
        let mut file = BufWriter::new(file);
        write(&mut file).and_then(|()| file.flush()).with_context(|| format!("writing {}", file_guard.0.display()))?;
        Ok(file_guard)
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        // Left behind at worst.
        let _ = std::fs::remove_file(&self.0);
    }
}

impl Model {
    fn load(size: Size, options: &Options) -> Result<Model> {
        let load = LoadOptions { level: options.common.isa, precision: options.precision };
        let (network, dino) = if size == Size::Paper {
            let file = Temporary::new("paper", |out| Sizes::paper().write(31, "model.", out))?;
            let network = Network::open(&file.0, &load)?;
            let file = Temporary::new("dino", |out| seeded::write(&seeded::dino_shapes(768, 12), 32, "", out))?;
            (network, Some(Dino::open(&file.0, &load)?))
        } else {
            (Network::from_parts(EMBEDDED_CHECKPOINT, EMBEDDED_CONFIG, &load)?, None)
        };
        let [height, width] = network.config().resolution;
        let image = |seed: u64| -> Vec<f32> {
            let mut state = seed;
            (0..3 * height * width).map(|_| uniform(&mut state)).collect()
        };
        let rgb = [image(1), image(2)];
        let tokens = network.tokenize(&FrameInput { rgb: &rgb[1], depth: None })?;
        let features = |rgb: &[f32]| -> Result<Option<Vec<f32>>> {
            Ok(match &dino {
                Some(dino) => Some(dino.features(rgb, [height, width])?.patch_tokens),
                None => None,
            })
        };
        let condition = [features(&rgb[0])?, features(&rgb[1])?];
        let embed = |rgb: &[f32]| -> Result<_> {
            let embedding = network.embed(&FrameInput { rgb, depth: None })?;
            let still = network.static_gaussians(&embedding, &Sampling::Mean)?;
            Ok((embedding.h, still))
        };
        let (h_a, a) = embed(&rgb[0])?;
        let (h_b, b) = embed(&rgb[1])?;
        let (h, static_tokens) = ([h_a, h_b], [a.tokens, b.tokens]);
        let side = |i: usize| Side { h: &h[i], static_tokens: &static_tokens[i], condition: condition[i].as_deref() };
        let moving = network.deform(side(0), side(1))?;
        let (level, still) = (options.common.isa, [a.gaussians, b.gaussians]);
        Ok(Model { network, dino, level, rgb, tokens, h, static_tokens, condition, still, moving })
    }

    fn side(&self, i: usize) -> Side<'_> {
        Side { h: &self.h[i], static_tokens: &self.static_tokens[i], condition: self.condition[i].as_deref() }
    }

    fn features(&self, i: usize) -> Result<Vec<f32>> {
        Ok(match &self.dino {
            Some(dino) => dino.features(&self.rgb[i], self.network.config().resolution)?.patch_tokens,
            None => Vec::new(),
        })
    }

    /// Runs a stage once and gives what it computed.
    fn stage(&self, name: &str) -> Result<Vec<f32>> {
        let network = &self.network;
        Ok(match name {
            "encoder" => network.encode(&self.tokens)?.h,
            "upsampler" => network.upsample_static(&self.h[1])?,
            "decoder" => network.decode(&self.side(0), &self.side(1))?.concat(),
            "dinov2" => self.features(1)?,
            "heads" => {
                let still = network.static_head(&self.static_tokens[1], &Sampling::Mean)?;
                let mut out = still.position.into_flattened();
                for (moving, tokens) in self.moving.iter().zip(&self.static_tokens) {
                    out.extend(network.deformation_head(tokens, &moving.tokens)?.0.into_flattened());
                }
                out
            }
            "raster" => self.draw(),
            // All that one more key frame costs.
            _ => {
                let features = self.features(1)?;
                let embedding = network.embed(&FrameInput { rgb: &self.rgb[1], depth: None })?;
                let still = network.static_gaussians(&embedding, &Sampling::Mean)?;
                let condition = self.dino.is_some().then_some(features.as_slice());
                let new = Side { h: &embedding.h, static_tokens: &still.tokens, condition };
                let [a, b] = network.deform(self.side(0), new)?;
                [a.velocity, b.velocity].concat().into_flattened()
            }
        })
    }

    /// Both frames' Gaussians in the middle of their interval, from the canonical camera.
    fn draw(&self) -> Vec<f32> {
        let [height, width] = self.network.config().resolution;
        let (mut mean, mut scale, mut opacity, mut rgb) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for ((still, moving), tau) in self.still.iter().zip(&self.moving).zip([0.5, -0.5]) {
            let mut position = vec![[0.0; 3]; still.position.len()];
            motion::position_at(&still.position, &moving.velocity, tau, &mut position);
            mean.extend(position.iter().map(|[x, y, z]| [*x, -z, 1.0 / (9.8 * y + 0.2 + 1e-6)]));
            scale.extend(still.scale.iter().map(|[x, z]| [*x, *z, 0.5 * (x + z)]));
            let mut faded = vec![0.0; position.len()];
            motion::opacity_at(self.level, &still.opacity, &moving.gamma, tau, &mut faded);
            opacity.extend(faded);
            rgb.extend_from_slice(&still.rgb);
        }
        let gaussians = Gaussians { mean: &mean, scale: &scale, rotation: None, opacity: &opacity, rgb: &rgb };
        let projection = Projection::Orthographic { focal: [width as f32 / 2.0, height as f32 / 2.0] };
        let request = Request { width, height, background: [0.5; 3], depth: false, alpha: false, statistics: false };
        render(self.level, &gaussians, &projection, &request).rgb
    }

    fn measure(&self, size: &'static str, options: &Options, rows: &mut Vec<Row>, peak: &mut f64) -> Result<()> {
        let mut costs: Vec<(&'static str, Option<f64>)> =
            stages(self.network.config()).into_iter().map(|cost| (cost.stage, Some(cost.gflop))).collect();
        let frame: f64 = stages(self.network.config()).iter().map(|cost| cost.gflop * cost.calls as f64).sum();
        let dino = self.dino.as_ref().map(|dino| dino_gflop(dino.config()));
        costs.extend(dino.map(|gflop| ("dinov2", Some(gflop))));
        costs.extend([("raster", None), ("step", Some(frame + dino.unwrap_or(0.0)))]);
        for (name, gflop) in costs.into_iter().filter(|(name, _)| name.contains(&options.only)) {
            let expected = self.stage(name)?;
            ensure!(expected.iter().all(|x| x.is_finite()), "{name}: a result is not finite");
            let other = rayon::ThreadPoolBuilder::new().num_threads(3).build()?;
            let again = other.install(|| self.stage(name))?;
            let bits = |x: &[f32]| x.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
            ensure!(bits(&again) == bits(&expected), "{name}: another number of threads gives other bits");
            drop(other);

            let (mut times, mut own_peak) = (Vec::new(), 0.0_f64);
            for _ in 0..options.common.repeat.max(1) {
                // The peak is taken beside every run: clocks move.
                own_peak = own_peak.max(machine::peak(self.level, operands(options.precision)));
                let mut result = Ok(Vec::new());
                times.push(once(|| result = self.stage(name)));
                std::hint::black_box(result?);
            }
            *peak = peak.max(own_peak);
            let seconds = Seconds::of(times);
            let speed = gflop.map(|gflop| gflop / seconds.min);
            let fraction_of_peak = speed.map(|speed| speed / own_peak);
            let figure = |x: Option<f64>| x.map_or_else(|| "-".to_owned(), |x| format!("{x:.1}"));
            println!(
                "{name:<10} {size:<6} {:>10} {:>12.2} {:>10} {:>8}%",
                figure(gflop),
                seconds.min * 1e3,
                figure(speed),
                figure(fraction_of_peak.map(|f| 100.0 * f))
            );
            rows.push(Row { name, size, precision: options.precision.name(), gflop, seconds, fraction_of_peak });
        }
        Ok(())
    }
}
