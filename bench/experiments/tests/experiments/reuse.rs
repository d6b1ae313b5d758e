//! `streamsplat-experiments reuse` on a small model and a few frames: its rows agree with the guarantees of reuse, and
//! its record with its rows.

use std::process::Command;

use serde_json::Value;

#[test]
fn exact_reuse_loses_nothing_and_every_variant_has_its_rows() {
    let folder = tempfile::tempdir().expect("a folder");
    let [json, markdown, manifest] = ["reuse.json", "reuse.md", "clips.tsv"].map(|name| folder.path().join(name));
    std::fs::write(&manifest, "clip\tstatic_camera\nmoving.y4m\tno\n").expect("written");
    let output = Command::new(env!("CARGO_BIN_EXE_streamsplat-experiments"))
        .arg("reuse")
        .arg(streamsplat_fixtures::path("clips/moving.y4m"))
        .arg("--model")
        .arg(streamsplat_fixtures::path("parity/tiny-nodino.safetensors"))
        .args(["--frames", "7", "--rounds", "2", "--reuse", "exact,0.02", "--gap", "1,auto", "--threads", "1"])
        .args(["--manifest".as_ref(), manifest.as_os_str(), "--json".as_ref(), json.as_os_str()])
        .args(["--markdown".as_ref(), markdown.as_os_str()])
        .output()
        .expect("the program starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let results: Value = serde_json::from_str(&std::fs::read_to_string(json).expect("JSON")).expect("JSON");
    let rows = results["rows"].as_array().expect("rows");
    let names: Vec<[&str; 2]> =
        rows.iter().map(|row| ["reuse", "gap"].map(|key| row[key].as_str().expect("a name"))).collect();
    let expected = ["1", "auto"].map(|gap| ["off", "exact", "0.02"].map(|reuse| [reuse, gap])).concat();
    assert_eq!(names, expected);
    for row in rows {
        let number = |key: &str| row[key].as_f64().unwrap_or_else(|| panic!("{key} in {row}"));
        assert!(number("cost") > 0.0 && row["still"] == false, "{row}");
        assert!(row["reuse"] == "0.02" || row["psnr_vs_off"].is_null() && number("gain") == 0.0, "{row}");
        assert!(row["gap"] == "1" || number("keys") < number("frames"), "{row}");
    }
    let text = std::fs::read_to_string(markdown).expect("Markdown");
    let part = |name: &str| text.split("## ").find(|part| part.starts_with(name)).unwrap_or_else(|| panic!("{text}"));
    for name in ["Summary", "Work", "Clips"] {
        let lines = part(name).lines().filter(|line| line.starts_with('|')).count();
        assert_eq!(lines, 2 + rows.len(), "{name}");
    }
}
