//! `streamsplat-bench tradeoff` on a small model and a few frames: its files are complete, agree with one another, and
//! mark the front.

use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

fn tradeoff(out: &Path, more: &[&str]) -> Output {
    let fixture = |name: &str| streamsplat_fixtures::path(name);
    Command::new(env!("CARGO_BIN_EXE_streamsplat-bench"))
        .arg("tradeoff")
        .arg(fixture("clips/moving.y4m"))
        .arg("--model")
        .arg(fixture("parity/tiny-nodino.safetensors"))
        .args(["--frames", "5", "--rounds", "2", "--repeat", "1", "--reuse", "exact,0.02", "--gap", "1,4,auto"])
        .arg("--out")
        .arg(out)
        .args(more)
        .output()
        .expect("the program starts")
}

fn text(out: &Path, name: &str) -> String {
    std::fs::read_to_string(out.join(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
}

fn number(row: &Value, key: &str) -> f64 {
    row[key].as_f64().unwrap_or_else(|| panic!("{key} in {row}"))
}

#[test]
fn files_are_whole_and_exactly_what_nothing_dominates_is_marked() {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("new/folder");
    let output = tradeoff(&out, &[]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let results: Value = serde_json::from_str(&text(&out, "tradeoff.json")).expect("JSON");

    let rows = results["rows"].as_array().expect("rows");
    assert_eq!(rows.len(), 3 * 3 * 3, "every combination once");
    let points: Vec<(f64, f64)> =
        rows.iter().map(|row| (number(row, "seconds_per_frame"), number(row, "psnr_vs_truth"))).collect();
    for (row, a) in rows.iter().zip(&points) {
        let dominated = points.iter().any(|b| b.0 <= a.0 && b.1 >= a.1 && b != a);
        assert_eq!(row["pareto"].as_bool(), Some(!dominated), "{row}");
        assert_eq!(row["resolution"], "80x48");
        let is_base = row["precision"] == "f32" && row["reuse"] != "0.02";
        assert!(!is_base || number(row, "relative_l2") == 0.0 && number(row, "psnr_vs_f32") == 100.0, "{row}");
        assert!(a.0 > 0.0 && number(row, "psnr_vs_f32") > 20.0, "{row}");
    }
    let csv = text(&out, "tradeoff.csv");
    let columns: Vec<&str> = csv.lines().next().expect("a head").split(',').collect();
    for key in ["precision", "reuse", "gap", "resolution", "seconds_per_frame", "relative_l2", "psnr_vs_f32", "pareto"]
    {
        assert!(columns.contains(&key), "{key}");
    }
    for (line, row) in csv.lines().skip(1).zip(rows) {
        let cells: Vec<&str> = line.split(',').collect();
        assert_eq!(cells.len(), columns.len(), "{line}");
        assert_eq!(cells[..3], [&row["precision"], &row["reuse"], &row["gap"]].map(|x| x.as_str().expect("a name")));
        assert_eq!(cells.last().copied(), Some(if row["pareto"] == true { "true" } else { "false" }), "{line}");
    }
    assert_eq!(csv.lines().count(), 1 + rows.len());

    let stages = results["stages"].as_array().expect("stages");
    assert_eq!(stages.len(), 3 * 4);
    for stage in stages {
        let error = number(stage, "relative_l2");
        assert!(if stage["precision"] == "f32" { error < 3e-6 } else { error > 1e-4 && error < 0.1 }, "{stage}");
        // Only f32 is reported in units of the last place; every rounding may cost half of one.
        let ulp = stage["worst_ulp"].as_f64();
        assert!(
            if stage["precision"] == "f32" { ulp.is_some_and(|ulp| ulp > 0.5 && ulp < 1e4) } else { ulp.is_none() },
            "{stage}"
        );
    }
    assert_eq!(text(&out, "tradeoff-stages.csv").lines().count(), 1 + stages.len());

    let svg = text(&out, "tradeoff.svg");
    for svg in [&svg, &text(&out, "tradeoff-stages.svg")] {
        assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>") && !svg.contains("NaN"));
    }
    let front = rows.iter().filter(|row| row["pareto"] == true).count();
    let markdown = text(&out, "tradeoff.md");
    assert_eq!(markdown.matches("\n| ● |").count(), front);
    assert!(svg.contains(&format!("{front}  ")), "the list names every member of the front");
}

#[test]
fn unknown_choices_and_a_clip_of_one_frame_are_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let output = tradeoff(&folder.path().join("out"), &["--against", "f16"]);
    assert_eq!(output.status.code(), Some(2), "{}", String::from_utf8_lossy(&output.stderr));
    let clip = folder.path().join("one.y4m");
    let bytes = std::fs::read(streamsplat_fixtures::path("clips/moving.y4m")).expect("the clip");
    let head = bytes.iter().position(|&b| b == b'\n').expect("a line") + 1;
    std::fs::write(&clip, &bytes[..head + 6 + 256 * 144 * 3 / 2]).expect("writable");
    let mut command = Command::new(env!("CARGO_BIN_EXE_streamsplat-bench"));
    let output =
        command.arg("tradeoff").arg(&clip).arg("--out").arg(folder.path().join("out")).output().expect("starts");
    assert_eq!(output.status.code(), Some(1));
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(message.contains("one.y4m: expected two frames or more, found 1"), "{message}");
    assert!(!folder.path().join("out").exists());
}
