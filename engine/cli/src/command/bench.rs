//! `bench`: runs the `streamsplat-bench` next to this program.

use std::ffi::OsString;
use std::process::Command;

use crate::console::failure::Failure;

/// Runs it and returns its exit code.
pub fn command(arguments: &[OsString]) -> Result<u8, Failure> {
    let own =
        std::env::current_exe().map_err(|e| Failure::work(format!("cannot find this program's own file: {e}")))?;
    let bench = own.with_file_name(format!("streamsplat-bench{}", std::env::consts::EXE_SUFFIX));
    if !bench.is_file() {
        let message = format!("{}: not found; cargo build --release builds it beside this program", bench.display());
        return Err(Failure::work(message));
    }
    let status = Command::new(&bench)
        .args(arguments)
        .status()
        .map_err(|e| Failure::work(format!("{}: cannot start: {e}", bench.display())))?;
    Ok(status.code().and_then(|code| u8::try_from(code).ok()).unwrap_or(1))
}
