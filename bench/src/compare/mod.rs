//! `--compare BASE.json`: a measurement against an earlier one, for machines without a graphics card and with other
//! load, as in continuous integration.
//!
//! Counted instructions differ only where the code does, under any load of the machine. Times are compared only between
//! runs on the same processor, with the same number of threads and the same instruction set. A row is worse when its
//! median is more than the limit above the one before **and** its fastest run was slower than half of the runs before.
//! A less clear difference above the limit is listed but is not a failure.

mod record;
mod report;

use std::path::PathBuf;
use std::process::Command;

use anyhow::{Context, Result, ensure};
use clap::Args;
use streamsplat_bench::timing::Seconds;

use self::record::{Benchmark, Measured, Record};

/// Limit for instructions, in percent.
const INSTRUCTIONS: f64 = 3.0;
/// Limit for instructions where the compiler or its settings differ.
const INSTRUCTIONS_OF_OTHERS: f64 = 10.0;
/// Limit for times.
const TIMES: f64 = 10.0;

/// Options of a comparison.
#[derive(Args)]
#[group(multiple = true, requires = "compare")]
pub(crate) struct Options {
    /// Compare with this record, which stages, stages --instructions, kernels or raster wrote with --json. Measures the
    /// same again and fails where something got worse by more than the limit.
    #[arg(long, value_name = "BASE.json", required = true)]
    compare: Option<PathBuf>,
    /// Compare this record instead of measuring.
    #[arg(long, value_name = "NOW.json")]
    with: Option<PathBuf>,
    /// Percent by which a row may get worse [default: 3 for instructions, 10 where the compiler differs; 10 for times].
    #[arg(long, value_name = "PERCENT", allow_negative_numbers = true)]
    limit: Option<f64>,
    /// Write the comparison here as Markdown.
    #[arg(long, value_name = "FILE")]
    markdown: Option<PathBuf>,
    /// Times each measurement is repeated.
    #[arg(long, value_name = "N", conflicts_with = "with")]
    repeat: Option<usize>,
    /// Write the measurements as JSON.
    #[arg(long, value_name = "FILE", conflicts_with = "with")]
    json: Option<PathBuf>,
}

/// Difference of a row from the one before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Verdict {
    /// Less than the limit.
    Equal,
    Better,
    Worse,
    /// More than the limit, but runs before were as slow.
    Spread,
    /// Not measured before.
    New,
    /// Not measured now.
    Gone,
}

/// One row of a comparison.
struct Change {
    name: String,
    before: Option<Seconds>,
    now: Option<Seconds>,
    percent: Option<f64>,
    verdict: Verdict,
}

/// All rows.
struct Comparison {
    kind: Benchmark,
    limit: f64,
    changes: Vec<Change>,
    conditions: String,
    notes: Vec<String>,
}

/// Compares and prints the result; returns true where something got worse.
pub(crate) fn run(options: &Options) -> Result<bool> {
    let base = options.compare.as_deref().context("--compare: expected a file")?;
    let before = record::read(base)?;
    if let Some(limit) = options.limit {
        ensure!(limit >= 0.0 && limit.is_finite(), "--limit {limit}: expected percent, 0 or more");
    }
    let now = match &options.with {
        Some(file) => record::read(file)?,
        None => measure(&before, options)?,
    };
    let comparison = compare(&before, &now, options.limit)?;
    print!("{}", comparison.text());
    if let Some(file) = &options.markdown {
        std::fs::write(file, comparison.markdown()).with_context(|| format!("writing {}", file.display()))?;
    }
    Ok(comparison.is_worse())
}

/// Measures what `before` measured, by another run of this program.
fn measure(before: &Record, options: &Options) -> Result<Record> {
    let again =
        before.again.as_ref().context("the record does not tell how to measure it again: expected --with NOW.json")?;
    let folder = std::env::temp_dir().join(format!("streamsplat-compare-{}.json", std::process::id()));
    let json = options.json.clone().unwrap_or_else(|| folder.clone());
    let mut command = Command::new(std::env::current_exe()?);
    command.args(again).arg("--json").arg(&json);
    if let Some(repeat) = options.repeat.filter(|_| before.kind != Benchmark::Instructions) {
        command.arg("--repeat").arg(repeat.to_string());
    }
    // The output is captured: the measurement's own tables would come before that of the comparison.
    let output = command.stderr(std::process::Stdio::inherit()).output().context("cannot start the measurement")?;
    ensure!(output.status.success(), "the measurement failed: {}", output.status);
    let record = record::read(&json);
    if options.json.is_none() {
        // At worst the file remains.
        let _ = std::fs::remove_file(&folder);
    }
    record
}

fn compare(before: &Record, now: &Record, limit: Option<f64>) -> Result<Comparison> {
    ensure!(before.kind == now.kind, "expected two records of one kind, found {:?} and {:?}", before.kind, now.kind);
    ensure!(
        before.conditions == now.conditions,
        "these cannot be compared: before {}, now {}",
        before.conditions,
        now.conditions
    );
    let (mut usual, mut notes) = (TIMES, Vec::new());
    if now.kind == Benchmark::Instructions {
        usual = INSTRUCTIONS;
        if before.built != now.built {
            usual = INSTRUCTIONS_OF_OTHERS;
            let of = |record: &Record| record.built.clone().unwrap_or_default();
            notes.push(format!("Built by different compilers: before {}, now {}.", of(before), of(now)));
        }
    }
    let limit = limit.unwrap_or(usual);
    let mut changes: Vec<Change> = Vec::new();
    for row in &now.rows {
        let name = row.name.clone();
        let Some(earlier) = find(before, &name) else {
            changes.push(Change { name, before: None, now: Some(row.value), percent: None, verdict: Verdict::New });
            continue;
        };
        // Processor time is less disturbed by other load.
        let (before, now) = earlier.processor.zip(row.processor).unwrap_or((earlier.value, row.value));
        let (percent, verdict) = judged(before, now, limit);
        changes.push(Change { name, before: Some(before), now: Some(now), percent: Some(percent), verdict });
    }
    for row in before.rows.iter().filter(|row| find(now, &row.name).is_none()) {
        let name = row.name.clone();
        changes.push(Change { name, before: Some(row.value), now: None, percent: None, verdict: Verdict::Gone });
    }
    ensure!(changes.iter().any(|change| change.percent.is_some()), "the records have no row in common");
    Ok(Comparison { kind: now.kind, limit, changes, conditions: format!("Measured with {}.", now.conditions), notes })
}

fn find<'a>(record: &'a Record, name: &str) -> Option<&'a Measured> {
    record.rows.iter().find(|row| row.name == name)
}

/// Growth of a row's median in percent, and the verdict.
fn judged(before: Seconds, now: Seconds, limit: f64) -> (f64, Verdict) {
    let percent = 100.0 * (now.median / before.median - 1.0);
    let verdict = if percent > limit {
        if now.min > before.median { Verdict::Worse } else { Verdict::Spread }
    } else if percent < -limit {
        if before.min > now.median { Verdict::Better } else { Verdict::Spread }
    } else {
        Verdict::Equal
    };
    (percent, verdict)
}

impl Comparison {
    fn is_worse(&self) -> bool {
        self.changes.iter().any(|change| change.verdict == Verdict::Worse)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row([min, median, max]: [f64; 3]) -> Seconds {
        Seconds { min, median, max }
    }

    #[test]
    fn a_row_is_worse_only_where_its_fastest_run_is_slow_too() {
        let before = [0.9, 1.0, 1.4];
        for (now, expected) in [
            ([0.9, 1.0, 1.4], Verdict::Equal),
            ([1.0, 1.09, 1.2], Verdict::Equal),
            ([1.05, 1.2, 1.3], Verdict::Worse),
            ([0.95, 1.2, 1.3], Verdict::Spread),
            ([0.7, 0.8, 0.9], Verdict::Better),
            ([0.85, 0.89, 0.95], Verdict::Better),
            ([0.5, 0.9, 0.95], Verdict::Equal),
        ] {
            assert_eq!(judged(row(before), row(now), 10.0).1, expected, "{now:?}");
        }
        let slow = [0.85, 1.0, 1.4];
        assert_eq!(judged(row(slow), row([0.8, 0.88, 0.9]), 10.0).1, Verdict::Spread);
    }

    #[test]
    fn every_record_of_the_tree_that_can_be_compared_is_read() {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("record");
        let mut kinds = Vec::new();
        for entry in std::fs::read_dir(folder).expect("a folder").flatten() {
            let name = entry.file_name().to_string_lossy().into_owned();
            let starts = ["instructions", "kernels-", "stages-", "raster-"];
            if name.ends_with(".json") && starts.iter().any(|start| name.starts_with(start)) {
                let record = record::read(&entry.path()).unwrap_or_else(|e| panic!("{name}: {e:#}"));
                let same = compare(&record, &record, None).unwrap_or_else(|e| panic!("{name}: {e:#}"));
                assert!(same.changes.iter().all(|change| change.percent == Some(0.0)), "{name}");
                assert!(record.again.is_some(), "{name}");
                kinds.push(record.kind);
            }
        }
        for kind in [Benchmark::Instructions, Benchmark::Stages, Benchmark::Kernels, Benchmark::Raster] {
            assert!(kinds.contains(&kind), "{kind:?}");
        }
    }
}
