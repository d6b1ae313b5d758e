//! Threads, instruction set, memory.

use crate::stream::Workers;
use streamsplat_kernels::Level;

use crate::run::Error;
use crate::run::options::Machine;

/// Most threads that can be asked for.
const MAX_THREADS: usize = 1024;

impl Machine {
    /// The instruction set asked for.
    pub fn level(&self) -> Result<Level, Error> {
        Level::named(&self.isa).map_err(|e| Error::usage(format!("--isa: {e}")))
    }

    /// Threads asked for; 0 is one per processor.
    pub fn threads(&self) -> Result<usize, Error> {
        let Some(text) = &self.threads else { return Ok(0) };
        match text.parse() {
            Ok(n @ 1..=MAX_THREADS) => Ok(n),
            _ => Err(Error::usage(format!("--threads {text}: expected a whole number from 1 to {MAX_THREADS}"))),
        }
    }

    /// A pool of them.
    pub fn workers(&self) -> Result<Workers, Error> {
        Ok(Workers::new(self.level()?, self.threads()?)?)
    }
}

/// The most memory this process has held, in bytes, where the system tells.
pub fn peak_resident_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kilobytes: u64 = line.split_whitespace().next()?.parse().ok()?;
    Some(kilobytes * 1024)
}
