//! `--log` and `--trace`.

use std::fs::File;
use std::io::BufWriter;

use tracing_chrome::{ChromeLayerBuilder, FlushGuard};
use tracing_subscriber::filter::LevelFilter;
use tracing_subscriber::prelude::*;

use crate::console::Console;
use crate::console::failure::Failure;

/// Sets up the requested logging and tracing; the trace is complete when the guard is dropped.
pub fn start(console: &Console) -> Result<Option<FlushGuard>, Failure> {
    let log = match &console.log {
        None => None,
        Some(name) if ["error", "warn", "info", "debug", "trace"].contains(&name.as_str()) => {
            let level: LevelFilter = name.parse().map_err(|e| Failure::usage(format!("--log {name}: {e}")))?;
            Some(tracing_subscriber::fmt::layer().with_writer(std::io::stderr).with_filter(level))
        }
        Some(name) => return Err(Failure::usage(format!("--log {name}: expected error, warn, info, debug or trace"))),
    };
    let (chrome, guard) = match &console.trace {
        None => (None, None),
        Some(path) => {
            let file =
                File::create(path).map_err(|e| Failure::work(format!("{}: cannot write: {e}", path.display())))?;
            let (layer, guard) = ChromeLayerBuilder::new().writer(BufWriter::new(file)).include_args(true).build();
            (Some(layer), Some(guard))
        }
    };
    if log.is_some() || chrome.is_some() {
        tracing_subscriber::registry().with(chrome).with(log).init();
    }
    Ok(guard)
}
