//! The parity data: inputs of the reference implementation and its outputs.

use std::path::PathBuf;

use streamsplat_model::checkpoint::Checkpoint;

/// The path of a file of the parity data.
pub fn path(name: &str) -> PathBuf {
    PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../fixtures/parity")).join(name)
}

/// The checkpoint, and the inputs and outputs, of a case.
///
/// # Panics
/// When they cannot be read.
pub fn case(name: &str) -> (Checkpoint, Checkpoint) {
    let open = |file: String| Checkpoint::open(path(&file)).expect("a parity file");
    (open(format!("{name}.safetensors")), open(format!("{name}.io.safetensors")))
}

/// The configuration of a case.
///
/// # Panics
/// When it cannot be read.
pub fn config(name: &str) -> serde_json::Value {
    let text = std::fs::read_to_string(path(&format!("{name}.json"))).expect("a parity file");
    serde_json::from_str(&text).expect("JSON")
}
