//! Standard output.

use std::io::Write;

use super::failure::Failure;

/// Prints a line on standard output.
pub fn say(line: impl std::fmt::Display) -> Result<(), Failure> {
    print(format!("{line}\n").as_bytes())
}

/// Writes to standard output; a reader that has gone away is no failure of the work.
pub fn print(text: &[u8]) -> Result<(), Failure> {
    let mut out = std::io::stdout();
    match out.write_all(text).and_then(|()| out.flush()) {
        Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => {
            Err(Failure::work(format!("standard output: cannot write: {e}")))
        }
        _ => Ok(()),
    }
}
