//! A comparison as text, and as Markdown for a comment on a pull request.

use std::fmt::Write as _;

use streamsplat_bench::table::{Column, Table};
use streamsplat_bench::timing::Seconds;

use super::record::Benchmark;
use super::{Change, Comparison, Verdict};

impl Verdict {
    fn word(self) -> &'static str {
        match self {
            Verdict::Equal => "",
            Verdict::Better => "better",
            Verdict::Worse => "worse",
            Verdict::Spread => "within the spread",
            Verdict::New => "new",
            Verdict::Gone => "gone",
        }
    }
}

impl Comparison {
    /// One line: how many rows are worse, and by which limit.
    pub(super) fn summary(&self) -> String {
        let of = |verdict: Verdict| self.changes.iter().filter(|change| change.verdict == verdict).count();
        let mut line = format!(
            "{} of {} {} more than {} % worse",
            of(Verdict::Worse),
            self.changes.len(),
            self.noun(),
            self.limit
        );
        for (verdict, said) in [(Verdict::Better, "better"), (Verdict::Spread, "as much apart but within the spread")] {
            if of(verdict) > 0 {
                let _ = write!(line, ", {} {said}", of(verdict));
            }
        }
        line
    }

    fn noun(&self) -> &'static str {
        match self.kind {
            Benchmark::Instructions => "counts of instructions",
            Benchmark::Stages | Benchmark::Kernels | Benchmark::Raster => "times",
        }
    }

    /// The value of a row, with the spread of its runs.
    fn value(&self, value: Option<Seconds>) -> String {
        let Some(value) = value else { return "–".to_owned() };
        if self.kind == Benchmark::Instructions {
            return grouped(value.median as u64);
        }
        let (unit, factor) = match value.median {
            s if s >= 1.0 => ("s", 1.0),
            s if s >= 1e-3 => ("ms", 1e3),
            _ => ("µs", 1e6),
        };
        let [least, middle, most] = [value.min, value.median, value.max].map(|x| x * factor);
        format!("{middle:.2} {unit} ({least:.2}–{most:.2})")
    }

    /// The table for a terminal.
    pub(super) fn text(&self) -> String {
        let cells: Vec<[String; 5]> = self.changes.iter().map(|change| self.cells(change)).collect();
        let wide = |i: usize| cells.iter().map(|row| row[i].chars().count()).max().unwrap_or(0);
        let columns = columns([0, 1, 2, 3].map(wide));
        let mut text = String::new();
        for row in &cells {
            let _ = writeln!(text, "{}", Table(&columns).line(row));
        }
        let _ = writeln!(text, "{}", self.summary());
        for note in &self.notes {
            let _ = writeln!(text, "{note}");
        }
        text
    }

    /// The comparison in Markdown: the summary, changed rows, and the others folded.
    pub(super) fn markdown(&self) -> String {
        let mark = if self.is_worse() { "❌" } else { "✅" };
        let mut text = format!("**{mark} {}**\n", self.summary());
        let (rest, changed): (Vec<&Change>, Vec<&Change>) =
            self.changes.iter().partition(|change| change.verdict == Verdict::Equal);
        let mut table = |title: &str, changes: &[&Change], end: &str| {
            if changes.is_empty() {
                return;
            }
            let rows = changes.iter().map(|change| self.cells(change));
            let _ = write!(text, "{title}\n{}{end}", Table(&columns([0; 4])).markdown(rows));
        };
        table("", &changed, "");
        let title = format!("\n<details><summary>{} within {} %</summary>\n", rest.len(), self.limit);
        table(&title, &rest, "\n</details>\n");
        for note in [&self.conditions].into_iter().chain(&self.notes) {
            let _ = write!(text, "\n{note}\n");
        }
        text
    }

    fn cells(&self, change: &Change) -> [String; 5] {
        let percent = change.percent.map_or_else(String::new, |percent| format!("{percent:+.2} %"));
        let verdict = change.verdict.word().to_owned();
        [change.name.clone(), self.value(change.before), self.value(change.now), percent, verdict]
    }
}

fn columns([name, before, now, change]: [usize; 4]) -> [Column; 5] {
    [
        Column::Text("", name),
        Column::Number("before", before),
        Column::Number("now", now),
        Column::Number("change", change),
        Column::Text("", 0),
    ]
}

/// Digits in groups of three.
fn grouped(number: u64) -> String {
    let digits = number.to_string();
    let mut text = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}
