//! `forward MODEL INPUT OUTPUT`: runs a checkpoint (a StreamSplat model or a DINOv2 file) on the tensors of a
//! safetensors file and writes every intermediate result of one pair of frames ([`streamsplat_tests::forward`] lists
//! them).

use std::error::Error;
use std::path::PathBuf;
use std::process::ExitCode;

use streamsplat_model::LoadOptions;
use streamsplat_tests::forward::{forward_file, write};

fn main() -> ExitCode {
    let arguments: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let [model, input, output] = arguments.as_slice() else {
        eprintln!("usage: forward MODEL INPUT OUTPUT");
        return ExitCode::from(2);
    };
    let done = || -> Result<(), Box<dyn Error>> {
        let tensors = forward_file(model, input, &LoadOptions::default())?;
        let list: Vec<_> = tensors.iter().map(|t| (t.name.clone(), t.shape.clone(), t.values.as_slice())).collect();
        Ok(write(output, &list)?)
    };
    match done() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("forward: {error}");
            ExitCode::FAILURE
        }
    }
}
