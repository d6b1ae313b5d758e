//! A progress bar on a terminal, plain lines otherwise, nothing with `--quiet`.

use std::io::{IsTerminal, Write};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

/// How often a plain line is written.
const EVERY: Duration = Duration::from_secs(2);

/// Counts what is done.
pub struct Progress {
    what: &'static str,
    total: Option<usize>,
    done: usize,
    bar: Option<ProgressBar>,
    plain: bool,
    start: Instant,
    said: Instant,
}

impl Progress {
    /// Of `total` things called `what`, where the number is known.
    pub fn new(what: &'static str, total: Option<usize>, quiet: bool) -> Progress {
        let terminal = std::io::stderr().is_terminal();
        let bar = (terminal && !quiet).then(|| {
            let bar = total.map_or_else(ProgressBar::new_spinner, |n| ProgressBar::new(n as u64));
            let template = if total.is_some() {
                "{wide_bar} {pos}/{len} {msg} {elapsed} eta {eta}"
            } else {
                "{spinner} {pos} {msg} {elapsed}"
            };
            if let Ok(style) = ProgressStyle::with_template(template) {
                bar.set_style(style);
            }
            bar.set_message(what);
            bar
        });
        let now = Instant::now();
        Progress { what, total, done: 0, bar, plain: !terminal && !quiet, start: now, said: now }
    }

    /// One more is done.
    pub fn step(&mut self) {
        self.done += 1;
        if let Some(bar) = &self.bar {
            bar.inc(1);
        } else if self.plain && self.said.elapsed() >= EVERY {
            self.said = Instant::now();
            self.line();
        }
    }

    /// All is done. (After a failure nothing is added to its message.)
    pub fn finish(self) {
        if self.plain {
            self.line();
        }
    }

    fn line(&self) {
        let each = self.start.elapsed().as_secs_f64() / self.done.max(1) as f64;
        let of = self.total.map(|n| format!(" of {n}")).unwrap_or_default();
        let _ = writeln!(std::io::stderr(), "{}{of} {}, {each:.3} s each", self.done, self.what);
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}
