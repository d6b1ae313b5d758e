//! What the measurements of `streamsplat-bench` share with those of `streamsplat-experiments`: options, times, tables,
//! the machine's peak, and variants of the engine on a clip.

pub mod machine;
pub mod passage;
pub mod table;
pub mod timing;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::Args;
use streamsplat_kernels::Level;

/// Options of every measurement.
#[derive(Args, Clone)]
pub struct Common {
    /// Instruction set: scalar, avx2, avx512, avx512vnni, avx512bf16, neon or auto.
    #[arg(long, default_value = "auto", value_parser = level)]
    pub isa: Level,
    /// Threads (0: one per core).
    #[arg(long, default_value_t = 0)]
    pub threads: usize,
    /// Times each measurement is repeated.
    #[arg(long, default_value_t = 7)]
    pub repeat: usize,
    /// Write the results here as JSON.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

impl Common {
    /// A pool of the requested threads.
    pub fn pool(&self) -> Result<rayon::ThreadPool> {
        rayon::ThreadPoolBuilder::new().num_threads(self.threads).build().context("starting threads")
    }

    /// Writes `value` to the file of `--json`.
    pub fn write(&self, value: &impl serde::Serialize) -> Result<()> {
        self.json.as_deref().map_or(Ok(()), |path| write_json(path, value))
    }
}

/// An instruction set that this machine has, by its name.
///
/// # Errors
/// Other names.
pub fn level(name: &str) -> Result<Level, String> {
    Level::named(name).map_err(|e| e.to_string())
}

/// Writes a value as a file of JSON.
///
/// # Errors
/// The file cannot be written.
pub fn write_json(path: &Path, value: &impl serde::Serialize) -> Result<()> {
    let text = serde_json::to_string_pretty(value)?;
    std::fs::write(path, text + "\n").with_context(|| format!("writing {}", path.display()))
}
