//! `stages`: one call of each stage of the network, and one new key frame as a whole.
//!
//! `small` is the checkpoint inside the library; `paper` has the published model's sizes and weights from a seed, written to
//! a temporary file. Before a stage is timed, its result is compared in bits with that of another number of threads.

use std::path::PathBuf;

use anyhow::{Result, ensure};
use clap::{Args, ValueEnum};
use serde::Serialize;
use streamsplat_kernels::gemm;
use streamsplat_model::inspect::{dino_gflop, stages};
use streamsplat_model::{LoadOptions, Precision};

use crate::Common;
use crate::instructions;
use crate::machine::{self, Machine};
use crate::model::{Model, Which, noise};
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
    /// Count instructions instead, by valgrind, of a small network on one thread.
    #[arg(long, conflicts_with_all = ["size", "only", "precision"])]
    instructions: bool,
    /// Recorded counts; more than 3 % above them is a failure.
    #[arg(long, value_name = "FILE", requires = "instructions")]
    recorded: Option<PathBuf>,
    /// What runs under valgrind.
    #[arg(long, hide = true)]
    counted_work: bool,
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
    if options.counted_work {
        return instructions::work(options.common.isa, options.precision);
    }
    if options.instructions {
        return instructions::run(options.recorded.as_deref(), options.common.json.as_deref());
    }
    let pool = options.common.pool()?;
    println!("{:<10} {:<6} {:>10} {:>12} {:>10} {:>9}", "stage", "size", "GFLOP", "ms (min)", "GFLOP/s", "of peak");
    let (mut rows, mut peak) = (Vec::new(), 0.0_f64);
    let load = LoadOptions { level: options.common.isa, precision: options.precision };
    for (size, which, name) in [(Size::Small, Which::Small, "small"), (Size::Paper, Which::Paper, "paper")] {
        if options.size == Size::All || options.size == size {
            let model = pool.install(|| Model::load(which, &load, &noise))?;
            pool.install(|| measure(&model, name, options, &mut rows, &mut peak))?;
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

fn measure(model: &Model, size: &'static str, options: &Options, rows: &mut Vec<Row>, peak: &mut f64) -> Result<()> {
    let mut costs: Vec<(&'static str, Option<f64>)> =
        stages(model.network.config()).into_iter().map(|cost| (cost.stage, Some(cost.gflop))).collect();
    let frame: f64 = stages(model.network.config()).iter().map(|cost| cost.gflop * cost.calls as f64).sum();
    let dino = model.dino.as_ref().map(|dino| dino_gflop(dino.config()));
    costs.extend(dino.map(|gflop| ("dinov2", Some(gflop))));
    costs.extend([("raster", None), ("step", Some(frame + dino.unwrap_or(0.0)))]);
    for (name, gflop) in costs.into_iter().filter(|(name, _)| name.contains(&options.only)) {
        let expected = model.stage(name)?;
        ensure!(expected.iter().all(|x| x.is_finite()), "{name}: a result is not finite");
        let other = rayon::ThreadPoolBuilder::new().num_threads(3).build()?;
        let again = other.install(|| model.stage(name))?;
        let bits = |x: &[f32]| x.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
        ensure!(bits(&again) == bits(&expected), "{name}: another number of threads gives other bits");
        drop(other);

        let (mut times, mut own_peak) = (Vec::new(), 0.0_f64);
        for _ in 0..options.common.repeat.max(1) {
            // The peak is taken beside every run: clocks move.
            own_peak = own_peak.max(machine::peak(model.level, operands(options.precision)));
            let mut result = Ok(Vec::new());
            times.push(once(|| result = model.stage(name)));
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
