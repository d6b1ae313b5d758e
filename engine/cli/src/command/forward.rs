//! `forward`: runs a model on tensors.

use streamsplat::output::Partial;
use streamsplat_model::{LoadOptions, forward};

use crate::console::failure::Failure;
use crate::options::args::ForwardArgs;

/// Reads, computes, and writes the whole output or nothing.
pub fn command(args: &ForwardArgs) -> Result<(), Failure> {
    let options = LoadOptions { level: args.machine.level(), precision: args.precision, ..LoadOptions::default() };
    let workers = args.machine.workers()?;
    let output = Partial::create(&args.output)?;
    workers.install(|| forward::forward_file(&args.model, &args.input, output.path(), &options))?;
    Ok(output.keep()?)
}
