//! `stages`: one call of each stage of the network, and one new key frame as a whole.
//!
//! `small` is the checkpoint inside the library. `paper` has the published model's sizes and weights from a seed,
//! written to a temporary file. Its first row is loading, from its files in the system's cache to the tokens of a first
//! frame. Before a stage is timed, its result is compared in bits with that of another number of threads.

use std::path::PathBuf;

use anyhow::{Result, ensure};
use clap::{Args, ValueEnum};
use serde::Serialize;
use streamsplat_bench::Common;
use streamsplat_bench::machine::{self, Machine};
use streamsplat_bench::table::{Column, Table};
use streamsplat_bench::timing::{Seconds, Spent, Stopwatch};
use streamsplat_kernels::gemm;
use streamsplat_model::cost::{dino_gflop, stages};
use streamsplat_model::{LoadOptions, Precision, zero_output};

use crate::instructions;
use crate::model::{Model, Which, loading, noise};

/// Options of `stages`.
#[derive(Args)]
pub(crate) struct Options {
    #[command(flatten)]
    common: Common,
    /// The model.
    #[arg(long, value_enum, default_value_t = Size::Small)]
    size: Size,
    /// A checkpoint that is not conditioned on DINOv2, instead of these.
    #[arg(long, value_name = "FILE", conflicts_with = "size")]
    model: Option<PathBuf>,
    /// Only stages whose name contains this.
    #[arg(long, default_value = "")]
    only: String,
    /// f32, bf16 or int8.
    #[arg(long, default_value = "f32")]
    precision: Precision,
    /// Count instructions instead, by valgrind, of a small network on one thread.
    #[arg(long, conflicts_with_all = ["size", "model", "only", "precision"])]
    instructions: bool,
    /// Recorded counts; more than 3 % above them is a failure.
    #[arg(long, value_name = "FILE", requires = "instructions")]
    recorded: Option<PathBuf>,
    /// Work that runs under valgrind.
    #[arg(long, hide = true)]
    counted_work: bool,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Size {
    Paper,
    Small,
    All,
}

const TABLE: Table<'_> = Table(&[
    Column::Text("stage", 10),
    Column::Text("size", 6),
    Column::Number("GFLOP", 9),
    Column::Number("ms (min)", 10),
    Column::Number("GFLOP/s", 9),
    Column::Number("% of peak", 9),
    Column::Number("cpu ms (min)", 12),
    Column::Number("all branches", 12),
]);

#[derive(Serialize)]
struct StageTiming {
    name: &'static str,
    size: &'static str,
    precision: &'static str,
    /// Operations of a call in 10⁹; `None` for drawing, whose work depends on the scene.
    gflop: Option<f64>,
    seconds: Seconds,
    /// Time of the processor.
    processor: Seconds,
    /// Time of a network that computes its zero-output branches, run in turn with the other.
    processor_with_zero_output: Option<Seconds>,
    fraction_of_peak: Option<f64>,
}

#[derive(Serialize)]
struct Results {
    machine: Machine,
    stages: Vec<StageTiming>,
}

pub(crate) fn run(options: &Options) -> Result<()> {
    if options.counted_work {
        return instructions::work(options.common.isa, options.precision);
    }
    if options.instructions {
        return instructions::run(options.recorded.as_deref(), options.common.json.as_deref());
    }
    let pool = options.common.pool()?;
    println!("{}", TABLE.heads());
    let (mut rows, mut peak) = (Vec::new(), 0.0_f64);
    let load = LoadOptions { level: options.common.isa, precision: options.precision, ..LoadOptions::default() };
    let mut all = |which, name| -> Result<()> {
        if "load".contains(&options.only) {
            rows.extend(pool.install(|| opening(which, name, &load, options.common.repeat))?);
        }
        if options.only == "load" {
            return Ok(());
        }
        let model = pool.install(|| Model::load(which, &load, &noise))?;
        let full = match model.network.zero_output().iter().any(|part| part.zero_output > 0) {
            true => {
                let load = LoadOptions { compute_zero_output: true, ..load };
                Some(pool.install(|| Model::load(which, &load, &noise))?)
            }
            false => None,
        };
        pool.install(|| measure(&model, full.as_ref(), name, options, &mut rows, &mut peak))
    };
    match &options.model {
        Some(checkpoint) => all(Which::File { checkpoint, dinov2: None }, "file")?,
        None => {
            for (size, which, name) in [(Size::Small, Which::Small, "small"), (Size::Paper, Which::Paper, "paper")] {
                if options.size == Size::All || options.size == size {
                    all(which, name)?;
                }
            }
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

/// The row of loading a model from files.
fn opening(which: Which<'_>, size: &'static str, load: &LoadOptions, repeat: usize) -> Result<Option<StageTiming>> {
    let spent = loading(which, load, repeat)?;
    if spent.is_empty() {
        return Ok(None);
    }
    let seconds = Seconds::of(spent.iter().map(Spent::clock).collect());
    let processor = Seconds::of(spent.iter().map(Spent::seconds).collect());
    let [seconds_cell, processor_cell] = [seconds, processor].map(|s| format!("{:.2}", s.min * 1e3));
    let none = || "-".to_owned();
    let cells = ["load".to_owned(), size.to_owned(), none(), seconds_cell, none(), none(), processor_cell, none()];
    println!("{}", TABLE.line(&cells));
    Ok(Some(StageTiming {
        name: "load",
        size,
        precision: load.precision.name(),
        gflop: None,
        seconds,
        processor,
        processor_with_zero_output: None,
        fraction_of_peak: None,
    }))
}

/// Measures `model` and `full`, which computes the same and its zero-output branches too.
fn measure(
    model: &Model,
    full: Option<&Model>,
    size: &'static str,
    options: &Options,
    rows: &mut Vec<StageTiming>,
    peak: &mut f64,
) -> Result<()> {
    let parts = model.network.zero_output();
    // The stage named upsampler here is the static one.
    let part = |stage| if stage == "upsampler" { "static upsampler" } else { stage };
    let left_out = |stage| parts.iter().filter(|s| s.part == part(stage)).map(|s| s.gflop).sum::<f64>();
    let mut costs: Vec<(&'static str, Option<f64>)> = stages(model.network.config())
        .into_iter()
        .map(|cost| (cost.stage, Some(cost.gflop - left_out(cost.stage))))
        .collect();
    let nominal: f64 = stages(model.network.config()).iter().map(|cost| cost.gflop * cost.calls as f64).sum();
    let frame = nominal - zero_output::gflop(parts);
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
        if let Some(full) = full {
            ensure!(bits(&full.stage(name)?) == bits(&expected), "{name}: zero-output branches change bits");
        }

        let (mut spent, mut spent_in_full, mut own_peak) = (Vec::new(), Vec::new(), 0.0_f64);
        for _ in 0..options.common.repeat.max(1) {
            // The peak is measured next to every run, as clock rates change.
            own_peak = own_peak.max(machine::peak(model.level, operands(options.precision)));
            let run = |model: &Model, spent: &mut Vec<Spent>| -> Result<()> {
                let watch = Stopwatch::start();
                std::hint::black_box(model.stage(name)?);
                spent.push(watch.stop());
                Ok(())
            };
            run(model, &mut spent)?;
            if let Some(full) = full {
                run(full, &mut spent_in_full)?;
            }
        }
        *peak = peak.max(own_peak);
        let seconds = Seconds::of(spent.iter().map(Spent::clock).collect());
        let of_processor = |spent: &[Spent]| Seconds::of(spent.iter().map(Spent::seconds).collect());
        let (processor, processor_with_zero_output) =
            (of_processor(&spent), full.map(|_| of_processor(&spent_in_full)));
        let speed = gflop.map(|gflop| gflop / seconds.min);
        let fraction_of_peak = speed.map(|speed| speed / own_peak);
        let figure = |x: Option<f64>| x.map_or_else(|| "-".to_owned(), |x| format!("{x:.1}"));
        let cells = [
            name.to_owned(),
            size.to_owned(),
            figure(gflop),
            format!("{:.2}", seconds.min * 1e3),
            figure(speed),
            figure(fraction_of_peak.map(|f| 100.0 * f)),
            format!("{:.2}", processor.min * 1e3),
            figure(processor_with_zero_output.map(|s| s.min * 1e3)),
        ];
        println!("{}", TABLE.line(&cells));
        let precision = options.precision.name();
        rows.push(StageTiming {
            name,
            size,
            precision,
            gflop,
            seconds,
            processor,
            processor_with_zero_output,
            fraction_of_peak,
        });
    }
    Ok(())
}
