//! Results of all pictures compared so far.

use std::path::Path;

use serde_json::{Value, json};
use streamsplat::difference::Difference;
use streamsplat::samples::{self, Pair, Part};

use crate::command::compare::{Outcome, Tolerance};
use crate::console;

/// Maximum number of lines printed about pictures that differ.
const LINES: usize = 20;
/// Maximum rounding of times in containers that count milliseconds.
const ROUNDED: f64 = 1e-3;

/// Sums over the pictures that were compared.
#[derive(Default)]
struct Mean {
    count: usize,
    error: f64,
    psnr: f64,
    ssim: f64,
    share: f64,
    /// Number of pictures for which SSIM is defined.
    with_ssim: usize,
    /// Lowest PSNR, and the name of its picture.
    least: Option<(f64, String)>,
}

/// Results of all pictures compared so far.
pub struct Account {
    tolerance: Tolerance,
    pictures: Vec<Value>,
    lines: Vec<String>,
    notes: Vec<String>,
    failed: usize,
    differing: usize,
    mean: Mean,
    worst: Option<(f64, Part, Part)>,
}

impl Account {
    /// Returns an empty account.
    pub fn new(tolerance: Tolerance) -> Self {
        let (pictures, lines, notes) = (Vec::new(), Vec::new(), Vec::new());
        Self { tolerance, pictures, lines, notes, failed: 0, differing: 0, mean: Mean::default(), worst: None }
    }

    fn line(&mut self, line: String) {
        if self.lines.len() < LINES {
            self.lines.push(line);
        }
    }

    /// Adds a note on the method of comparison, unless it exists already.
    pub fn note(&mut self, note: String) {
        if !self.notes.contains(&note) {
            self.notes.push(note);
        }
    }

    /// Adds an equal item that is not a picture.
    pub fn equal(&mut self, name: &str) {
        self.pictures.push(json!({ "name": name, "equal": true, "passed": true }));
    }

    /// Adds an item that differs and cannot be measured.
    pub fn odd(&mut self, name: &str, cause: &str) {
        self.failed += 1;
        self.differing += 1;
        self.line(format!("{name}: {cause}"));
        self.pictures.push(json!({ "name": name, "equal": false, "passed": false, "cause": cause }));
    }

    /// Adds the outcome of two scenes inside folders.
    pub fn scenes(&mut self, name: &str, outcome: Outcome) {
        if outcome.passed {
            self.note(format!("{name}: {}", outcome.summary));
            return self.equal(name);
        }
        self.odd(name, &outcome.summary);
        outcome.lines.into_iter().for_each(|line| self.line(format!("{name}: {line}")));
    }

    /// Compares two pictures and adds the result.
    pub fn add(&mut self, name: &str, a: Part, b: Part) {
        if let Some(cause) = self.times(&a, &b) {
            return self.odd(name, &cause);
        }
        let Pair { a, b, notes } = match samples::pair(a, b) {
            Ok(pair) => pair,
            Err(cause) => return self.odd(name, &cause),
        };
        notes.into_iter().for_each(|note| self.note(note));
        let found = Difference::between(&a, &b);
        self.mean.add(name, &found);
        let ssim = found.ssim;
        let Some(place) = &found.place else {
            self.pictures
                .push(json!({ "name": name, "equal": true, "passed": true, "psnr": found.psnr, "ssim": ssim }));
            return;
        };
        let largest = found.largest * 255.0;
        let passed = self.tolerance.allows(largest, found.psnr);
        self.differing += 1;
        self.failed += usize::from(!passed);
        let channel = a.channel(&place.channel).or(a.channels.first());
        let kind = channel.map_or("", |channel| channel.samples.kind());
        let far = match channel.is_some_and(|channel| channel.samples.is_scaled()) {
            true => format!("{largest:.4}/255"),
            false => format!("{} ({largest:.4}/255)", found.largest),
        };
        let word = word(&place.channel);
        let [first, second] = &place.samples;
        self.line(format!(
            "{name}: largest difference {far} at column {}, row {} ({word}: {first} and {second}, {kind}); PSNR {}{}; {:.4} % of pixels differ",
            place.column,
            place.row,
            decibels(found.psnr),
            ssim.map_or_else(String::new, |ssim| format!(", SSIM {ssim:.6}")),
            100.0 * found.share
        ));
        self.pictures.push(json!({
            "name": name,
            "equal": false,
            "passed": passed,
            "largest": largest,
            "column": place.column,
            "row": place.row,
            "channel": word,
            "samples": place.samples,
            "type": kind,
            "psnr": found.psnr,
            "ssim": ssim,
            "share": found.share,
        }));
        if self.worst.as_ref().is_none_or(|(worst, ..)| found.largest > *worst) {
            self.worst = Some((found.largest, a, b));
        }
    }

    /// Describes how the times of two frames differ, if both have one.
    fn times(&self, a: &Part, b: &Part) -> Option<String> {
        let ((start, length), (other, other_length)) = a.shown.zip(b.shown)?;
        let rounded = if self.tolerance.is_given() { ROUNDED } else { 0.0 };
        let apart = |x: f64, y: f64| (x - y).abs() > rounded;
        if apart(start, other) {
            return Some(format!("expected two frames of one time, found {start} s and {other} s"));
        }
        let (length, other) = length.zip(other_length)?;
        apart(length, other).then(|| format!("expected two frames shown as long, found {length} s and {other} s"))
    }

    /// Returns the outcome; `what` is the plural of the compared items.
    pub fn finish(mut self, what: &str) -> Outcome {
        let Self { failed, differing, .. } = self;
        let count = self.pictures.len();
        if differing > self.lines.len() {
            self.lines.push(format!("and {} more that differ", differing - self.lines.len()));
        }
        let mut lines = self.notes.clone();
        lines.append(&mut self.lines);
        let counted = console::count(count, what.trim_end_matches('s'));
        let summary = match (differing, failed) {
            (0, _) => format!("equal ({counted})"),
            (n, 0) => format!("{n} of {count} {what} differ, within the limits"),
            (n, m) if n == m => format!("{n} of {count} {what} differ"),
            (n, m) => format!("{n} of {count} {what} differ, {m} beyond the limits"),
        };
        let mean = self.mean.json();
        Outcome {
            passed: failed == 0,
            summary,
            lines,
            mean: self.mean.line(what).filter(|_| differing > 0),
            json: json!({ "kind": what, "equal": differing == 0, "notes": self.notes, "mean": mean, "pictures": self.pictures }),
            worst: self.worst.map(|(_, a, b)| (a, b)),
        }
    }
}

impl Mean {
    fn add(&mut self, name: &str, found: &Difference) {
        self.count += 1;
        self.error += found.error;
        self.psnr += found.psnr;
        self.share += found.share;
        if let Some(ssim) = found.ssim {
            self.ssim += ssim;
            self.with_ssim += 1;
        }
        if self.least.as_ref().is_none_or(|(least, _)| found.psnr < *least) {
            self.least = Some((found.psnr, name.to_owned()));
        }
    }

    /// Returns the PSNR of the mean square error, the mean PSNR, the mean SSIM (if it is defined for all), and the mean
    /// fraction of pixels that differ.
    fn figures(&self) -> Option<(f64, f64, Option<f64>, f64)> {
        let count = (self.count > 1).then_some(self.count as f64)?;
        let ssim = (self.with_ssim == self.count).then(|| self.ssim / count);
        Some((streamsplat::metrics::psnr_of(self.error / count), self.psnr / count, ssim, self.share / count))
    }

    fn line(&self, what: &str) -> Option<String> {
        let (all, mean, ssim, share) = self.figures()?;
        let (least, name) = self.least.as_ref()?;
        Some(format!(
            "mean of {} {what}: PSNR {} ({} of the mean square error), least {} ({name}){}; {:.4} % of pixels differ",
            self.count,
            decibels(mean),
            decibels(all),
            decibels(*least),
            ssim.map_or_else(String::new, |ssim| format!(", SSIM {ssim:.6}")),
            100.0 * share
        ))
    }

    fn json(&self) -> Value {
        match self.figures() {
            None => Value::Null,
            Some((all, mean, ssim, share)) => {
                json!({ "count": self.count, "psnr": mean, "psnr_of_mean_error": all, "ssim": ssim, "share": share })
            }
        }
    }
}

fn decibels(psnr: f64) -> String {
    if psnr.is_finite() { format!("{psnr:.2} dB") } else { "none, for a sample is not finite".to_owned() }
}

/// Returns a channel's name for messages.
fn word(channel: &str) -> &str {
    match channel {
        "R" => "red",
        "G" => "green",
        "B" => "blue",
        "A" => "alpha",
        "Y" => "grey",
        other => other,
    }
}

/// Returns the last part of a path.
pub fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}
