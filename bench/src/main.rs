//! `streamsplat-bench`: measurements of the kernels, the network's stages and the rasteriser.
//!
//! Every measurement checks its answer before it is timed and reports the fraction of the machine's peak, which is
//! measured in the same run.

mod compare;
mod depth;
mod enlarging;
mod fit;
mod instructions;
mod kernels;
mod live;
mod machine;
mod model;
mod passage;
mod process;
mod raster;
mod reuse;
mod serve;
mod soak;
mod stages;
mod table;
mod timing;
mod tradeoff;
mod turned;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::{Args, Parser, Subcommand};
use streamsplat_kernels::Level;

#[global_allocator]
static ALLOCATOR: live::Counting = live::Counting;

/// Measure StreamSplat on this machine.
#[derive(Parser)]
#[command(
    name = "streamsplat-bench",
    version,
    arg_required_else_help = true,
    args_conflicts_with_subcommands = true,
    subcommand_negates_reqs = true
)]
struct Program {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    compare: compare::Options,
}

#[derive(Subcommand)]
enum Command {
    /// Views of scenes of cards from cameras turned around them, with and without true depth.
    Depth(depth::Options),
    /// Images of the source's size compared with the enlarged model-size image, on a set of clips.
    Enlarging(enlarging::Options),
    /// Optical flow, and steps of the fit of colours.
    Fit(fit::Options),
    /// Matrix products, attention and norms, as fractions of the measured peak.
    Kernels(kernels::Options),
    /// Whole scenes of Gaussians, redrawing, and growth with their number.
    Raster(raster::Options),
    /// Cost and saving of reuse on a set of clips.
    Reuse(reuse::Options),
    /// A stream of thousands of key frames: memory, time, identities, drift.
    Soak(soak::Options),
    /// Stages of the network on request, for comparisons driven from outside.
    Serve(serve::Options),
    /// The stages of the network and a whole key frame.
    Stages(stages::Options),
    /// Error against run time: precision, reuse and gap on a clip; each stage's error and time.
    Tradeoff(tradeoff::Options),
    /// Scenes with one moving body, rendered from the side.
    Turned(turned::Options),
}

/// Options of every measurement.
#[derive(Args, Clone)]
pub(crate) struct Common {
    /// Instruction set: scalar, avx2, avx512, avx512vnni, avx512bf16, neon or auto.
    #[arg(long, default_value = "auto", value_parser = level)]
    isa: Level,
    /// Threads (0: one per core).
    #[arg(long, default_value_t = 0)]
    threads: usize,
    /// Times each measurement is repeated.
    #[arg(long, default_value_t = 7)]
    repeat: usize,
    /// Write the results here as JSON.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

impl Common {
    /// A pool of the requested threads.
    fn pool(&self) -> Result<rayon::ThreadPool> {
        rayon::ThreadPoolBuilder::new().num_threads(self.threads).build().context("starting threads")
    }

    /// Writes `value` to the file of `--json`.
    fn write(&self, value: &impl serde::Serialize) -> Result<()> {
        self.json.as_deref().map_or(Ok(()), |path| write_json(path, value))
    }
}

fn level(name: &str) -> Result<Level, String> {
    Level::named(name).map_err(|e| e.to_string())
}

fn write_json(path: &Path, value: &impl serde::Serialize) -> Result<()> {
    let text = serde_json::to_string_pretty(value)?;
    std::fs::write(path, text + "\n").with_context(|| format!("writing {}", path.display()))
}

fn main() -> std::process::ExitCode {
    let Program { command, compare } = Program::parse();
    let Some(command) = command else {
        return match compare::run(&compare) {
            Ok(worse) => std::process::ExitCode::from(u8::from(worse)),
            Err(error) => {
                eprintln!("error: {error:#}");
                std::process::ExitCode::from(2)
            }
        };
    };
    let result = match command {
        Command::Depth(options) => depth::run(&options),
        Command::Enlarging(options) => enlarging::run(&options),
        Command::Fit(options) => fit::run(&options),
        Command::Kernels(options) => kernels::run(&options),
        Command::Raster(options) => raster::run(&options),
        Command::Reuse(options) => reuse::run(&options),
        Command::Serve(options) => serve::run(&options),
        Command::Soak(options) => soak::run(&options),
        Command::Stages(options) => stages::run(&options),
        Command::Tradeoff(options) => tradeoff::run(&options),
        Command::Turned(options) => turned::run(&options),
    };
    match result {
        Ok(()) => std::process::ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            std::process::ExitCode::FAILURE
        }
    }
}
