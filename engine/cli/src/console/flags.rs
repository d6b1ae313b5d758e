//! `--quiet`, `--log` and `--trace`, and who is told of progress.

use std::io::Write;
use std::path::PathBuf;
use std::sync::Arc;

use clap::Args;

use super::stop::Stop;

/// Told how many of how many things are done; returns false to stop the work after the interval at hand.
pub type Observer = Arc<dyn Fn(usize, Option<usize>) -> bool + Send + Sync>;

/// Messages beside the results, and requests to stop.
#[derive(Args, Clone, Default)]
pub struct Console {
    /// Say nothing but errors
    #[arg(long, global = true)]
    pub quiet: bool,
    /// Log to standard error: error, warn, info, debug or trace
    #[arg(long, global = true, value_name = "LEVEL")]
    pub log: Option<String>,
    /// Write a trace for Chrome or Perfetto, one span per stage and operation
    #[arg(long, global = true, value_name = "FILE")]
    pub trace: Option<PathBuf>,
    /// Request to stop the work at hand.
    #[arg(skip)]
    pub stop: Stop,
    /// Another program inside of which this one runs.
    #[arg(skip)]
    pub observer: Option<Observer>,
}

impl Console {
    /// Says lines beside the results: on standard error, because standard output may carry a video.
    pub fn note(&self, lines: &[String]) {
        for line in lines.iter().filter(|_| !self.quiet) {
            let _ = writeln!(std::io::stderr(), "{}", super::visible(line));
        }
    }

    /// Takes signals as requests to stop. Inside another program they are that program's.
    pub fn listen(&self) {
        if self.observer.is_none() {
            self.stop.listen();
        }
    }
}
