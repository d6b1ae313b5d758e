//! Progress output: a bar on a terminal, plain lines otherwise, nothing with `--quiet`. A plain line is written only
//! after new progress, and the time left never increases.

use std::io::{IsTerminal, Write};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressState, ProgressStyle};

use super::flags::Console;

/// Interval at which a bar is redrawn, even without progress.
const TICK: Duration = Duration::from_millis(200);
/// Intervals between plain lines: at first, and after [`MANY`] of them.
const EVERY: [Duration; 2] = [Duration::from_secs(1), Duration::from_secs(10)];
/// Number of plain lines after which they become rarer, so that logs of long runs stay readable.
const MANY: usize = 10;

/// Counter of finished items.
pub struct Progress {
    state: Arc<Mutex<State>>,
    bar: Option<ProgressBar>,
    /// Thread that writes plain lines.
    lines: Option<(Sender<()>, JoinHandle<()>)>,
}

struct State {
    what: &'static str,
    total: Option<usize>,
    done: usize,
    start: Instant,
    estimate: Estimate,
    /// Content of the last plain line: its count and the work.
    said: Option<(usize, &'static str)>,
}

/// Estimate of the time left.
#[derive(Default)]
struct Estimate {
    /// At the last finished item: seconds since the start, and seconds left.
    last: Option<(f64, f64)>,
    /// The least printed value.
    said: Option<f64>,
}

impl Estimate {
    /// Records that `done` of `total` are finished `passed` seconds after the start.
    fn update(&mut self, passed: f64, done: usize, total: usize) {
        if done > 0 {
            self.last = Some((passed, passed / done as f64 * total.saturating_sub(done) as f64));
        }
    }

    /// Returns the seconds left, `passed` seconds after the start, at most the value printed before. `None` if nothing
    /// is known, or if the value printed before was less than half of the new estimate.
    fn left(&mut self, passed: f64) -> Option<f64> {
        let (then, left) = self.last?;
        let now = (left - (passed - then)).max(0.0);
        let said = self.said.map_or(now, |said| said.min(now));
        self.said = Some(said);
        (now <= 2.0 * said.max(1.0)).then_some(said)
    }
}

impl Progress {
    /// Starts the progress of `total` items called `what`, if the number is known.
    pub fn new(what: &'static str, total: Option<usize>, console: &Console) -> Progress {
        let terminal = std::io::stderr().is_terminal();
        let state = Arc::new(Mutex::new(State {
            what,
            total,
            done: 0,
            start: Instant::now(),
            estimate: Estimate::default(),
            said: None,
        }));
        let bar = (terminal && !console.quiet).then(|| {
            let bar = total.map_or_else(ProgressBar::new_spinner, |n| ProgressBar::new(n as u64));
            let template = if total.is_some() {
                "{wide_bar} {percent}% {pos}/{len} {msg}, {per_sec}{left}"
            } else {
                "{spinner} {pos} {msg}, {per_sec}, {elapsed}"
            };
            if let Ok(style) = ProgressStyle::with_template(template) {
                let state = state.clone();
                let left = move |_: &ProgressState, out: &mut dyn std::fmt::Write| {
                    let left = lock(&state).left().map(time).map_or_else(String::new, |left| format!(", {left} left"));
                    // Write errors of the terminal are ignored.
                    let _ = out.write_str(&left);
                };
                bar.set_style(style.with_key("left", left));
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

    /// Adds one finished item.
    pub fn step(&mut self) {
        let done = lock(&self.state).done + 1;
        self.advance(done);
        if let Some(bar) = &self.bar {
            bar.inc(1);
        }
    }

    /// Sets the number of finished items.
    pub fn reach(&mut self, done: usize) {
        self.advance(done);
        if let Some(bar) = &self.bar {
            bar.set_position(done as u64);
        }
    }

    fn advance(&self, done: usize) {
        let mut state = lock(&self.state);
        let passed = state.start.elapsed().as_secs_f64();
        state.done = done;
        if let Some(total) = state.total {
            state.estimate.update(passed, done, total);
        }
    }

    /// Names the work that follows after all counted items.
    pub fn phase(&mut self, what: &'static str) {
        lock(&self.state).what = what;
        if let Some(bar) = &self.bar {
            bar.set_message(what);
        }
    }

    /// Ends the progress display. (After a failure it is not called, so that nothing follows the error message.)
    pub fn finish(mut self) {
        if self.lines.is_some() {
            self.end_lines();
            lock(&self.state).say();
        }
    }

    fn end_lines(&mut self) {
        if let Some((end, writer)) = self.lines.take() {
            drop(end);
            // The writer thread returns no result.
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
    fn left(&mut self) -> Option<f64> {
        let passed = self.start.elapsed().as_secs_f64();
        self.estimate.left(passed)
    }

    /// Returns a plain line if there is progress: the work, the fraction and time left if the total is known, and the
    /// time per item.
    fn line(&mut self) -> Option<String> {
        let now = (self.done, self.what);
        if self.done == 0 || self.said == Some(now) {
            return None;
        }
        self.said = Some(now);
        let passed = self.start.elapsed().as_secs_f64();
        let each = passed / self.done.max(1) as f64;
        let of = self.total.filter(|&n| n > 0).map(|n| {
            let percent = 100 * self.done.min(n) / n;
            let left = self.left().filter(|_| self.done < n).map(time);
            let left = left.map_or_else(String::new, |left| format!(", {left} left"));
            format!(" of {n} ({percent} %{left})")
        });
        let what = if self.total.unwrap_or(self.done) == 1 { singular(self.what) } else { self.what.to_owned() };
        Some(format!("{}{} {what}, {each:.3} s each", self.done, of.unwrap_or_default()))
    }

    fn say(&mut self) {
        if let Some(line) = self.line() {
            let _ = writeln!(std::io::stderr(), "{line}");
        }
    }
}

/// Returns a description of items with its first word for one of them.
fn singular(what: &str) -> String {
    let (word, rest) = what.split_at(what.find(|c: char| !c.is_alphabetic()).unwrap_or(what.len()));
    format!("{}{rest}", word.strip_suffix('s').unwrap_or(word))
}

/// Formats seconds for the terminal.
fn time(seconds: f64) -> String {
    let seconds = seconds.round() as u64;
    match seconds {
        0..=99 => format!("{seconds} s"),
        _ => format!("{} min {} s", seconds / 60, seconds % 60),
    }
}

fn lock(state: &Mutex<State>) -> std::sync::MutexGuard<'_, State> {
    state.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plain_line_says_something_new_or_nothing() {
        let console = Console { quiet: true, ..Console::default() };
        let mut progress = Progress::new("images", Some(3), &console);
        let line = |progress: &Progress| lock(&progress.state).line();
        assert_eq!(line(&progress), None);
        progress.step();
        assert!(line(&progress).is_some_and(|line| line.starts_with("1 of 3 (33 %, ")));
        assert_eq!(line(&progress), None);
        progress.reach(3);
        assert!(line(&progress).is_some_and(|line| line.starts_with("3 of 3 (100 %) images, ")));
        progress.phase("images; finishing the files");
        assert!(line(&progress).is_some_and(|line| line.contains("finishing")));
        assert_eq!(line(&progress), None);
    }

    #[test]
    fn one_item_has_the_word_for_one() {
        let console = Console { quiet: true, ..Console::default() };
        for (what, total, expected) in
            [("images", Some(1), "1 of 1 (100 %) image,"), ("MB read", Some(1), "1 of 1 (100 %) MB read,")]
        {
            let mut progress = Progress::new(what, total, &console);
            progress.step();
            let line = lock(&progress.state).line();
            assert!(line.as_ref().is_some_and(|line| line.starts_with(expected)), "{line:?}");
        }
        let mut progress = Progress::new("frames; finishing the files", None, &console);
        progress.step();
        assert!(lock(&progress.state).line().is_some_and(|line| line.starts_with("1 frame; finishing the files,")));
    }

    #[test]
    fn the_time_left_never_climbs() {
        // Frames arrive four at a time, and later ones take longer.
        let (total, mut done, mut passed) = (100, 0, 3.0);
        let (mut estimate, mut said) = (Estimate::default(), Vec::new());
        while done < total {
            done += 4;
            estimate.update(passed, done, total);
            for _ in 0..10 {
                said.extend(estimate.left(passed));
                passed += 0.02 * (1.0 + done as f64 / 50.0);
            }
        }
        assert!(said.len() > 100, "{}", said.len());
        assert!(said.is_sorted_by(|a, b| a >= b), "{said:?}");
        assert!(said.last().is_some_and(|&left| left < 1.0), "{said:?}");
    }

    #[test]
    fn an_estimate_that_was_much_too_low_is_withdrawn_until_it_holds() {
        let mut estimate = Estimate::default();
        assert_eq!(estimate.left(1.0), None);
        estimate.update(1.0, 10, 20);
        assert_eq!(estimate.left(1.0), Some(1.0));
        estimate.update(60.0, 11, 20);
        assert_eq!(estimate.left(60.0), None);
        estimate.update(61.0, 20, 20);
        assert_eq!(estimate.left(61.0), Some(0.0));
    }
}
