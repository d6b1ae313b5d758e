//! `streamsplat-experiments`: measurements by which the engine is developed. Those for users are in
//! `streamsplat-bench`, as `streamsplat bench`.

mod depth;
mod enlarging;
mod live;
mod reuse;
mod soak;
mod turned;

use clap::{Parser, Subcommand};

#[global_allocator]
static ALLOCATOR: live::Counting = live::Counting;

/// Measure views from the side, reuse, image sizes and long streams.
#[derive(Parser)]
#[command(name = "streamsplat-experiments", version, arg_required_else_help = true)]
struct Program {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Views of scenes of cards from cameras turned around them, with and without true depth.
    Depth(depth::Options),
    /// Images of the source's size compared with the enlarged model-size image, on a set of clips.
    Enlarging(enlarging::Options),
    /// Cost and saving of reuse on a set of clips.
    Reuse(reuse::Options),
    /// A stream of thousands of key frames: memory, time, identities, drift.
    Soak(soak::Options),
    /// Scenes with one moving body, rendered from the side.
    Turned(turned::Options),
}

fn main() -> anyhow::Result<()> {
    match Program::parse().command {
        Command::Depth(options) => depth::run(&options),
        Command::Enlarging(options) => enlarging::run(&options),
        Command::Reuse(options) => reuse::run(&options),
        Command::Soak(options) => soak::run(&options),
        Command::Turned(options) => turned::run(&options),
    }
}
