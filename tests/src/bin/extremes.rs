//! `extremes [--write] [--short] [WORD]`: runs the cases whose name contains WORD (default: all) and prints their
//! table. `--write` writes the report and the record of all cases to `tests/extremes`.

use std::process::ExitCode;

use streamsplat_tests::extremes::{Form, cases, record, report};

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let has = |flag: &str| arguments.iter().any(|a| a == flag);
    let word = arguments.iter().find(|a| !a.starts_with("--")).cloned().unwrap_or_default();
    if has("--write") && !word.is_empty() {
        eprintln!("--write is of all cases, found {word:?}");
        return ExitCode::from(2);
    }
    let form = if has("--short") { Form::Short } else { Form::Long };
    let (mut rows, mut errors) = (Vec::new(), record::Errors::new());
    for case in cases().into_iter().filter(|case| case.key().contains(&word)) {
        eprintln!("{}", case.key());
        let mut judged = case.run(Form::Short);
        errors.insert(case.key(), judged.error);
        if case.long && form == Form::Long {
            let long = case.run(Form::Long);
            (judged.error, judged.ours, judged.exact) = (long.error, long.ours, long.exact);
            judged.broken.extend(long.broken);
        }
        rows.push((case, judged));
    }
    let text = report::markdown(&rows);
    print!("{text}");
    if has("--write") {
        let folder = record::folder();
        let json = serde_json::to_string_pretty(&errors).unwrap_or_default() + "\n";
        let written = std::fs::write(folder.join("REPORT.md"), text)
            .and_then(|()| std::fs::write(folder.join("record.json"), json));
        if let Err(error) = written {
            eprintln!("{}: {error}", folder.display());
            return ExitCode::FAILURE;
        }
    }
    if rows.iter().all(|(_, judged)| judged.broken.is_empty()) { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
