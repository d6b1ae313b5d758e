//! The program with `--renderer wgpu`.

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use streamsplat_fixtures as fixtures;

fn program(arguments: &[&dyn AsRef<std::ffi::OsStr>]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_streamsplat"));
    command.args(arguments.iter().map(AsRef::as_ref)).stdin(Stdio::null());
    command
}

fn output(mut command: Command) -> Output {
    command.output().expect("the program starts")
}

fn ok(arguments: &[&dyn AsRef<std::ffi::OsStr>]) -> String {
    let output = output(program(arguments));
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

fn fails(output: &Output, code: i32) -> String {
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(code), "{text}");
    assert!(text.starts_with("streamsplat: ") && text.trim_end().lines().count() == 1, "{text}");
    text
}

fn record(folder: &Path) -> serde_json::Value {
    let text = std::fs::read_to_string(folder.join("run.json")).expect("a record");
    serde_json::from_str(&text).expect("JSON")
}

/// Returns a small checkpoint (48×80).
fn model() -> PathBuf {
    fixtures::path("parity/tiny-nodino.safetensors")
}

fn clip() -> PathBuf {
    fixtures::path("clips/moving.y4m")
}

#[test]
fn a_run_says_what_drew_it_and_verify_compares_what_is_within_the_contract() {
    let scratch = tempfile::tempdir().expect("a temporary folder");
    let out = scratch.path().join("out");
    ok(&[
        &"run",
        &clip(),
        &"--model",
        &model(),
        &"--out",
        &out,
        &"--gap",
        &"2",
        &"--frames",
        &"5",
        &"--renderer",
        &"wgpu",
        &"--emit",
        &"rgb,depth,alpha,scene",
    ]);
    let run = record(&out);
    assert_eq!((&run["renderer"]["name"], &run["renderer"]["bit_contract"]), (&"wgpu".into(), &false.into()));
    assert!(run["renderer"]["adapter"].as_str().is_some_and(|name| !name.is_empty()), "{}", run["renderer"]);
    for (name, output) in run["outputs"].as_object().expect("outputs") {
        assert_eq!(output["outside_contract"] == true, !name.starts_with("scene/"), "{name}");
    }
    let report = std::fs::read_to_string(out.join("report.md")).expect("a report");
    assert!(report.contains("outside of the bit contract"), "{report}");

    let said = ok(&[&"verify", &out]);
    assert!(said.contains("15 images drawn by wgpu on ") && said.contains("were not repeated"), "{said}");
    // The scene is compared.
    let scene = out.join("scene/scene.json");
    std::fs::write(&scene, std::fs::read_to_string(&scene).expect("readable") + " ").expect("writable");
    assert!(fails(&output(program(&[&"verify", &out])), 1).contains("the digest differs"));
}

#[test]
fn verify_says_why_a_rendering_by_a_graphics_card_cannot_be_verified() {
    let scratch = tempfile::tempdir().expect("a temporary folder");
    let (out, images) = (scratch.path().join("out"), scratch.path().join("images"));
    ok(&[
        &"run",
        &clip(),
        &"--model",
        &model(),
        &"--out",
        &out,
        &"--gap",
        &"2",
        &"--frames",
        &"3",
        &"--emit",
        &"scene",
    ]);
    ok(&[&"render", &out, &"--out", &images, &"--renderer", &"wgpu", &"--size", &"64x36"]);
    assert_eq!(record(&images)["renderer"]["name"], "wgpu");
    let said = fails(&output(program(&[&"verify", &images])), 1);
    assert!(said.contains("drawn by wgpu on") && said.contains("outside of the bit contract"), "{said}");
    let plain = scratch.path().join("plain");
    ok(&[&"render", &out, &"--out", &plain, &"--renderer", &"cpu", &"--size", &"64x36"]);
    assert_eq!(record(&plain)["renderer"]["bit_contract"], true);
    ok(&[&"verify", &plain]);
}

#[test]
fn eval_measures_the_cards_images() {
    let scratch = tempfile::tempdir().expect("a temporary folder");
    let score = |renderer: &str| {
        let file = scratch.path().join(renderer);
        ok(&[&"eval", &clip(), &"--model", &model(), &"--gap", &"4", &"--renderer", &renderer, &"--json", &file]);
        let text = std::fs::read_to_string(file).expect("figures");
        let figures: serde_json::Value = serde_json::from_str(&text).expect("JSON");
        assert_eq!(figures["renderer"], renderer);
        figures["mean"]["middle"]["psnr"].as_f64().expect("a number")
    };
    let (card, cpu) = (score("wgpu"), score("cpu"));
    assert!((card - cpu).abs() < 0.01, "{card} dB and {cpu} dB");
}

#[test]
fn without_an_adapter_one_line_says_so_and_nothing_is_touched() {
    let scratch = tempfile::tempdir().expect("a temporary folder");
    let (none, out) = (scratch.path().join("none.json"), scratch.path().join("out"));
    std::fs::write(&none, "").expect("writable");
    let mut command = program(&[&"run", &clip(), &"--out", &out, &"--renderer", &"wgpu"]);
    // Both names that the Vulkan loader accepts for its list of drivers.
    command.env("VK_ICD_FILENAMES", &none).env("VK_DRIVER_FILES", &none);
    let said = fails(&output(command), 1);
    assert!(said.contains("expected a graphics card with a Vulkan driver, found none"), "{said}");
    assert!(!out.exists());
}
