//! `streamsplat-bench`: measurements of the kernels, the network's stages and the rasteriser.
//!
//! Every measurement checks its answer before it is timed and reports the fraction of the machine's peak, which is
//! measured in the same run.

mod compare;
mod fit;
mod instructions;
mod kernels;
mod model;
mod raster;
mod serve;
mod stages;
mod tradeoff;

use clap::{Parser, Subcommand};

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
    /// Optical flow, and steps of the fit of colours.
    Fit(fit::Options),
    /// Matrix products, attention and norms, as fractions of the measured peak.
    Kernels(kernels::Options),
    /// Whole scenes of Gaussians, redrawing, and growth with their number.
    Raster(raster::Options),
    /// Stages of the network on request, for comparisons driven from outside.
    Serve(serve::Options),
    /// The stages of the network and a whole key frame.
    Stages(stages::Options),
    /// Error against run time: precision, reuse and gap on a clip; each stage's error and time.
    Tradeoff(tradeoff::Options),
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
        Command::Fit(options) => fit::run(&options),
        Command::Kernels(options) => kernels::run(&options),
        Command::Raster(options) => raster::run(&options),
        Command::Serve(options) => serve::run(&options),
        Command::Stages(options) => stages::run(&options),
        Command::Tradeoff(options) => tradeoff::run(&options),
    };
    match result {
        Ok(()) => std::process::ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            std::process::ExitCode::FAILURE
        }
    }
}
