//! A progress bar on a terminal, plain lines otherwise, nothing with `--quiet`.

use std::io::{IsTerminal, Write};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

use super::flags::Console;

/// How often a bar is drawn, whether or not anything was done.
const TICK: Duration = Duration::from_millis(200);
/// How often a plain line is written at first, and after [`MANY`] of them.
const EVERY: [Duration; 2] = [Duration::from_secs(1), Duration::from_secs(10)];
/// Plain lines after which they become rarer, so that logs of long runs stay readable.
const MANY: usize = 10;

/// Counts what is done.
pub struct Progress {
    state: Arc<Mutex<State>>,
    bar: Option<ProgressBar>,
    /// Writes plain lines.
    lines: Option<(Sender<()>, JoinHandle<()>)>,
}

struct State {
    what: &'static str,
    total: Option<usize>,
    done: usize,
    start: Instant,
}

impl Progress {
    /// Of `total` things called `what`, where the number is known.
    pub fn new(what: &'static str, total: Option<usize>, console: &Console) -> Progress {
        let terminal = std::io::stderr().is_terminal();
        let state = Arc::new(Mutex::new(State { what, total, done: 0, start: Instant::now() }));
        let bar = (terminal && !console.quiet).then(|| {
            let bar = total.map_or_else(ProgressBar::new_spinner, |n| ProgressBar::new(n as u64));
            let template = if total.is_some() {
                "{wide_bar} {percent}% {pos}/{len} {msg}, {per_sec}, {eta} left"
            } else {
                "{spinner} {pos} {msg}, {per_sec}, {elapsed}"
            };
            if let Ok(style) = ProgressStyle::with_template(template) {
                bar.set_style(style);
            }
            bar.set_message(what);
            bar.enable_steady_tick(TICK);
            bar
        });
        let lines = (!terminal && !console.quiet).then(|| {
            let (end, ended) = channel();
            let state = state.clone();
            let writer = std::thread::spawn(move || {
                for said in 0.. {
                    if ended.recv_timeout(EVERY[usize::from(said >= MANY)]) != Err(RecvTimeoutError::Timeout) {
                        return;
                    }
                    lock(&state).say();
                }
            });
            (end, writer)
        });
        Progress { state, bar, lines }
    }

    /// One more is done.
    pub fn step(&mut self) {
        lock(&self.state).done += 1;
        if let Some(bar) = &self.bar {
            bar.inc(1);
        }
    }

    /// So many are done.
    pub fn reach(&mut self, done: usize) {
        lock(&self.state).done = done;
        if let Some(bar) = &self.bar {
            bar.set_position(done as u64);
        }
    }

    /// Names what is done now, once everything that was counted is done.
    pub fn phase(&mut self, what: &'static str) {
        lock(&self.state).what = what;
        if let Some(bar) = &self.bar {
            bar.set_message(what);
        }
    }

    /// All is done. (After a failure nothing is added to its message.)
    pub fn finish(mut self) {
        if self.lines.is_some() {
            self.end_lines();
            lock(&self.state).say();
        }
    }

    fn end_lines(&mut self) {
        if let Some((end, writer)) = self.lines.take() {
            drop(end);
            // A thread that writes lines has nothing to tell.
            let _ = writer.join();
        }
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.end_lines();
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

impl State {
    /// A plain line: what is done, the share and the time left where the number is known, the time of each.
    fn say(&self) {
        let passed = self.start.elapsed().as_secs_f64();
        let each = passed / self.done.max(1) as f64;
        let of = self.total.filter(|&n| n > 0).map(|n| {
            let percent = 100 * self.done.min(n) / n;
            let left = each * n.saturating_sub(self.done) as f64;
            let left = if self.done > 0 && self.done < n { format!(", {left:.0} s left") } else { String::new() };
            format!(" of {n} ({percent} %{left})")
        });
        let _ = writeln!(std::io::stderr(), "{}{} {}, {each:.3} s each", self.done, of.unwrap_or_default(), self.what);
    }
}

fn lock(state: &Mutex<State>) -> std::sync::MutexGuard<'_, State> {
    state.lock().unwrap_or_else(PoisonError::into_inner)
}
