//! `streamsplat-bench fit` checks its answers and writes its times.

use std::process::Command;

use serde_json::Value;

#[test]
fn answers_are_right_and_each_part_has_a_time() {
    let folder = tempfile::tempdir().expect("a folder");
    let json = folder.path().join("fit.json");
    let output = Command::new(env!("CARGO_BIN_EXE_streamsplat-bench"))
        .args(["fit", "--repeat", "1", "--json"])
        .arg(&json)
        .output()
        .expect("the program starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let report: Value = serde_json::from_str(&std::fs::read_to_string(json).expect("JSON")).expect("JSON");
    let rows = report["rows"].as_array().expect("rows");
    assert_eq!(rows.len(), 9, "{report}");
    assert!(rows.iter().all(|row| row["milliseconds"]["min"].as_f64().is_some_and(|time| time > 0.0)), "{report}");
}
