//! `--quiet`, `--log` and `--trace`.

use std::io::Write;
use std::path::PathBuf;

use clap::Args;

use streamsplat::run::Stop;

use super::stop;

/// Messages in addition to the results, and requests to stop.
#[derive(Args, Clone, Default)]
pub struct Console {
    /// Print only errors
    #[arg(long, global = true)]
    pub quiet: bool,
    /// Log to standard error: error, warn, info, debug or trace
    #[arg(long, global = true, value_name = "LEVEL")]
    pub log: Option<String>,
    /// Write a trace for Chrome or Perfetto, one span per stage and operation
    #[arg(long, global = true, value_name = "FILE")]
    pub trace: Option<PathBuf>,
    /// Request to stop the current work.
    #[arg(skip)]
    pub stop: Stop,
}

impl Console {
    /// Prints lines in addition to the results: on standard error, because standard output may carry a video.
    pub fn note(&self, lines: &[String]) {
        for line in lines.iter().filter(|_| !self.quiet) {
            let _ = writeln!(std::io::stderr(), "{}", super::visible(line));
        }
    }

    /// Handles signals as requests to stop.
    pub fn listen(&self) {
        stop::listen(&self.stop);
    }
}
