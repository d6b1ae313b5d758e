//! Compares the network at the paper's size with sampled values of the reference.
//!
//! ```text
//! python fixtures/parity/make_weights.py fixtures/parity/paper-dino.json paper-dino.safetensors
//! cargo run --release -p streamsplat-tests --example paper_parity -- paper-dino.safetensors paper-dino.io.safetensors
//! ```
//!
//! The second file holds `in.*`, and for each output 4,096 values `out.X` at flat indices `idx.X`.

use std::process::ExitCode;
use std::time::Instant;

use streamsplat_model::checkpoint::Checkpoint;
use streamsplat_model::{LoadOptions, ModelError, Network};
use streamsplat_tests::forward::forward;
use streamsplat_tests::reference::relative_l2;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [weights, io] = arguments.as_slice() else {
        eprintln!("usage: paper_parity WEIGHTS IO");
        return ExitCode::from(2);
    };
    match compare(weights, io) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

fn compare(weights: &str, io: &str) -> Result<bool, ModelError> {
    let start = Instant::now();
    let network = Network::open(weights, &LoadOptions::default())?;
    println!("loaded in {:.1?}, {} bytes of weights; {}", start.elapsed(), network.bytes(), resident());
    let io = Checkpoint::open(io)?;
    let start = Instant::now();
    let outputs = forward(&network, &io)?;
    println!("two frames in {:.1?}; {}", start.elapsed(), resident());
    let mut within = true;
    for tensor in outputs {
        let name = tensor.name.trim_start_matches("out.");
        let indices = io.bytes(&format!("idx.{name}")).unwrap_or_default().as_chunks::<8>().0;
        let expected = io.read(&tensor.name)?;
        let found = indices.iter().map(|&i| f64::from(tensor.values[i64::from_le_bytes(i) as usize]));
        let error = relative_l2(found, expected.iter().map(|&x| f64::from(x)));
        let good = error <= 3e-6;
        println!("{name}: {:?} {error:.2e}{}", tensor.shape, if good { "" } else { "  TOO FAR" });
        within &= good;
    }
    Ok(within)
}

/// Peak resident memory, where available.
fn resident() -> String {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    status.lines().find(|line| line.starts_with("VmHWM")).unwrap_or("peak memory unknown").to_owned()
}
