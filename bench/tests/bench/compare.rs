//! `streamsplat-bench --compare`: exit codes, tables, comparable records.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::{Value, json};

fn bench(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_streamsplat-bench")).args(arguments).output().expect("the program starts")
}

fn said(output: &Output, code: i32) -> String {
    let text = [&output.stdout[..], &output.stderr[..]].map(String::from_utf8_lossy).concat();
    assert_eq!(output.status.code(), Some(code), "{text}");
    text
}

fn recorded() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("record/instructions.json")
}

fn written(folder: &Path, name: &str, value: &Value) -> String {
    let path = folder.join(name);
    std::fs::write(&path, value.to_string()).expect("writable");
    path.display().to_string()
}

/// A record of stages with one time each.
fn stages(threads: u64, times: &[(&str, [f64; 3])]) -> Value {
    let rows: Vec<Value> = times
        .iter()
        .map(|(name, [min, median, max])| {
            let seconds = json!({"min": min, "median": median, "max": max});
            json!({"name": name, "size": "small", "precision": "f32", "seconds": seconds, "processor": seconds})
        })
        .collect();
    json!({"machine": {"cpu": "Some CPU", "threads": threads, "isa": "avx2"}, "stages": rows})
}

#[test]
fn more_instructions_than_the_limit_are_a_failure_that_markdown_shows() {
    let folder = tempfile::tempdir().expect("a folder");
    let base: Value = serde_json::from_str(&std::fs::read_to_string(recorded()).expect("there")).expect("JSON");
    let grown = |percent: u64| {
        let mut counts = base.clone();
        let stage = &mut counts["stages"][1]["instructions"];
        *stage = (stage.as_u64().expect("a count") * (100 + percent) / 100).into();
        written(folder.path(), &format!("grown-{percent}.json"), &counts)
    };
    let markdown = folder.path().join("comment.md").display().to_string();
    let recorded = recorded().display().to_string();
    let text = said(&bench(&["--compare", &recorded, "--with", &grown(2), "--markdown", &markdown]), 0);
    assert!(text.contains("0 of 15 counts of instructions more than 3 % worse"), "{text}");
    assert!(std::fs::read_to_string(&markdown).expect("written").starts_with("**✅ 0 of 15"));
    let text = said(&bench(&["--compare", &recorded, "--with", &grown(5), "--markdown", &markdown]), 1);
    assert!(text.lines().any(|line| line.starts_with("upsampler f32") && line.ends_with("worse")), "{text}");
    let comment = std::fs::read_to_string(&markdown).expect("written");
    assert!(comment.starts_with("**❌ 1 of 15 counts of instructions more than 3 % worse**"), "{comment}");
    let line = comment.lines().find(|line| line.starts_with("| upsampler f32 | ")).unwrap_or_default();
    assert!(line.ends_with(" | +5.00 % | worse |"), "{comment}");
    let digits: String = line.chars().filter(|c| c.is_ascii_digit() || *c == '|').collect();
    let before = base["stages"][1]["instructions"].as_u64().expect("a count");
    assert!(digits.contains(&format!("|{before}|{}|", before * 105 / 100)), "{comment}");
    assert!(comment.contains("<details><summary>14 within 3 %</summary>"), "{comment}");
    said(&bench(&["--compare", &recorded, "--with", &grown(5), "--limit", "6"]), 0);
    said(&bench(&["--compare", &recorded, "--with", &grown(2), "--limit", "1"]), 1);
}

#[test]
fn times_are_judged_with_their_spread_and_on_one_machine() {
    let folder = tempfile::tempdir().expect("a folder");
    let of = |name: &str, value: &Value| written(folder.path(), name, value);
    let base = of("base.json", &stages(2, &[("encoder", [0.9, 1.0, 1.4]), ("decoder", [0.002, 0.003, 0.004])]));
    let slow = of("slow.json", &stages(2, &[("encoder", [1.1, 1.2, 1.3]), ("heads", [1.0, 1.0, 1.0])]));
    let text = said(&bench(&["--compare", &base, "--with", &slow]), 1);
    for expected in ["encoder small f32", "1.00 s (0.90–1.40)", "+20.00 %  worse", "new", "gone", "3.00 ms (2.00–4.00)"]
    {
        assert!(text.contains(expected), "{expected}: {text}");
    }
    let unclear = of("unclear.json", &stages(2, &[("encoder", [0.95, 1.2, 1.3])]));
    let text = said(&bench(&["--compare", &base, "--with", &unclear]), 0);
    assert!(text.contains("within the spread"), "{text}");
    let other = of("other.json", &stages(4, &[("encoder", [1.0, 1.0, 1.0])]));
    let text = said(&bench(&["--compare", &base, "--with", &other]), 2);
    assert!(text.contains("cannot be compared: before 2 threads, avx2, Some CPU, now 4 threads"), "{text}");
    let none = of("none.json", &stages(2, &[("elsewhere", [1.0, 1.0, 1.0])]));
    assert!(said(&bench(&["--compare", &base, "--with", &none]), 2).contains("no row in common"));
}

#[test]
fn what_is_no_record_is_wrong_use() {
    let folder = tempfile::tempdir().expect("a folder");
    let base = recorded().display().to_string();
    let missing = folder.path().join("missing.json").display().to_string();
    let empty = written(folder.path(), "empty.json", &json!({}));
    let zero = written(folder.path(), "zero.json", &stages(1, &[("encoder", [0.0, 0.0, 0.0])]));
    for wrong in [
        &["--compare", &missing][..],
        &["--compare", &empty],
        &["--compare", &zero],
        &["--compare", &base, "--with", &empty],
        &["--compare", &base, "--with", &base, "--limit", "-1"],
        &["--compare", &base, "--with", &base, "--limit", "nan"],
        &["--limit", "3"],
        &["--compare", &base, "stages"],
    ] {
        said(&bench(wrong), 2);
    }
}

#[test]
fn a_record_of_times_is_measured_again_as_it_was_made() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (base, now) = (path("base.json"), path("now.json"));
    said(&bench(&["stages", "--only", "raster", "--threads", "1", "--repeat", "1", "--json", &base]), 0);
    let text = said(&bench(&["--compare", &base, "--repeat", "1", "--json", &now, "--limit", "100000"]), 0);
    assert!(text.lines().any(|line| line.starts_with("raster small f32") && line.contains('%')), "{text}");
    let now: Value = serde_json::from_str(&std::fs::read_to_string(now).expect("written")).expect("JSON");
    assert_eq!((now["machine"]["threads"].as_u64(), now["stages"][0]["size"].as_str()), (Some(1), Some("small")));
}
