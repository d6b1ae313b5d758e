//! Output places that are in use, hostile or damaged.

use std::io::Write as _;
use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use streamsplat_fixtures as fixtures;

use crate::support::{Scratch, command, fails, files, json, model, record, run_ok};

fn run(input: &Path, out: &Path, more: &[&str]) -> Command {
    let mut command = command();
    command.arg("run").arg(input).arg("--out").arg(out).arg("--model").arg(model()).args(more).arg("--quiet");
    command.stdin(Stdio::null());
    command
}

fn resume(input: &Path, out: &Path) -> Output {
    run(input, out, &["--resume"]).output().expect("the program starts")
}

/// Starts a run that waits for the rest of its input, with its place locked.
fn waiting(out: &Path, lock: &Path) -> Child {
    let stream = std::fs::read(fixtures::path("clips/moving.y4m")).expect("readable");
    let mut child = run(Path::new("-"), out, &[]).stdin(Stdio::piped()).spawn().expect("the program starts");
    child.stdin.as_mut().expect("a pipe").write_all(&stream[..stream.len() / 4]).expect("it reads");
    let start = Instant::now();
    while std::fs::read(lock).map_or(true, |text| text.is_empty()) {
        assert!(start.elapsed() < Duration::from_secs(60), "no lock");
        std::thread::sleep(Duration::from_millis(2));
    }
    child
}

#[test]
fn finished_results_of_another_run_are_replaced_only_when_asked() {
    let scratch = Scratch::new();
    let (clip, other) = (scratch.clip("clip", 3, 40, 24), scratch.clip("other", 2, 40, 24));
    for out in [scratch.path("out"), scratch.path("out.y4m")] {
        run_ok(&clip, &out, &["--quiet"]);
        // Running again leaves it unchanged.
        run_ok(&clip, &out, &["--quiet"]);
        let record = std::fs::read(record_of(&out)).expect("readable");
        for (input, options) in [(&other, &[][..]), (&clip, &["--gap", "2"][..])] {
            let said = fails(&run(input, &out, options).output().expect("the program starts"), 2);
            assert!(said.contains("--overwrite") && said.contains(clip.to_str().expect("UTF-8")), "{said}");
            assert_eq!(std::fs::read(record_of(&out)).expect("readable"), record);
        }
        run_ok(&other, &out, &["--overwrite", "--quiet"]);
        assert_ne!(std::fs::read(record_of(&out)).expect("readable"), record);
    }
}

#[test]
fn a_rendering_replaces_no_run_and_none_of_its_own_before_it_succeeds() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 3, 40, 24);
    let (out, other, drawn) = (scratch.path("out"), scratch.path("other"), scratch.path("drawn"));
    run_ok(&clip, &out, &["--quiet"]);
    run_ok(&clip, &other, &["--quiet"]);
    let render = |scene: &Path, out: &Path, more: &[&str]| {
        command().arg("render").arg(scene).arg("--out").arg(out).args(more).output().expect("the program starts")
    };
    let before = files(&out);
    let refused = |scene: &Path, expected: &str| {
        let said = fails(&render(scene, &out, &[]), 2);
        assert!(said.contains("--out") && said.contains(expected), "{said}");
        assert!(files(&out) == before && out.join("run.json").exists() == expected.starts_with('/'));
    };
    for scene in [&out, &out.join("scene"), &other] {
        refused(scene, clip.to_str().expect("UTF-8"));
    }
    std::fs::remove_file(out.join("run.json")).expect("there");
    std::fs::create_dir(out.join("resume")).expect("writable");
    refused(&out, "a run that was stopped");

    assert!(render(&other, &drawn, &[]).status.success());
    let before = files(&drawn);
    assert!(fails(&render(&other, &drawn, &["--size", "60000x60000"]), 1).contains("no memory"));
    assert!(files(&drawn) == before && drawn.join("run.json").exists());
    assert!(render(&other, &drawn, &["--times", "0"]).status.success());
    assert_eq!(files(&drawn).len(), 1);
}

#[test]
fn a_run_replaces_neither_its_input_nor_a_video_of_someone_else() {
    let scratch = Scratch::new();
    let input = scratch.path("a.y4m");
    std::fs::copy(fixtures::path("clips/moving.y4m"), &input).expect("readable");
    let frames = scratch.clip("p/frames", 3, 40, 24);
    let maps = scratch.clip("p/depth", 3, 40, 24);
    let depth = ["--emit", "depth", "--depth", maps.to_str().expect("UTF-8")];
    let (before, video) = (files(&scratch.path("p")), std::fs::read(&input).expect("readable"));
    for more in [&[][..], &["--overwrite"]] {
        for (input, out, options) in [
            (&input, scratch.path("./a.y4m"), &[][..]),
            (&frames, scratch.path("p"), &[]),
            (&scratch.path("p/../p/frames"), scratch.path("p"), &[]),
            (&frames, scratch.path("p"), &depth),
        ] {
            let said = fails(&run(input, &out, &[options, more].concat()).output().expect("the program starts"), 2);
            assert!(said.contains("expected another place than the input's"), "{said}");
        }
    }
    assert!(files(&scratch.path("p")) == before && std::fs::read(&input).expect("readable") == video);
    let other = scratch.path("b.y4m");
    std::fs::write(&other, "mine").expect("writable");
    let said = fails(&run(&frames, &other, &[]).output().expect("the program starts"), 2);
    assert!(said.contains("a file without the record of a run; --overwrite"), "{said}");
    assert_eq!(std::fs::read(&other).expect("there"), b"mine");
    run_ok(&frames, &other, &["--overwrite", "--quiet"]);
}

#[test]
fn results_stay_until_there_are_others() {
    let scratch = Scratch::new();
    let (clip, maps) = (scratch.clip("clip", 3, 40, 24), scratch.clip("maps", 3, 40, 24));
    let out = scratch.path("out");
    run_ok(&clip, &out, &["--quiet"]);
    let (before, record) = (files(&out), std::fs::read(out.join("run.json")).expect("there"));
    // Colour images are no depth maps.
    let options = ["--overwrite", "--depth", maps.to_str().expect("UTF-8")];
    let said = fails(&run(&clip, &out, &options).output().expect("the program starts"), 1);
    assert!(said.contains("maps"), "{said}");
    assert!(files(&out) == before && std::fs::read(out.join("run.json")).expect("there") == record);
}

/// Returns the record of a run to `out`.
fn record_of(out: &Path) -> std::path::PathBuf {
    if out.is_dir() { out.join("run.json") } else { out.with_extension("y4m.run.json") }
}

#[test]
fn without_a_place_results_go_into_a_folder_named_after_the_input() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 2, 40, 24);
    let mut run = command();
    run.arg("run").arg(&clip).arg("--model").arg(model()).current_dir(scratch.path(""));
    let output = run.stdin(Stdio::null()).output().expect("the program starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(scratch.path("clip-scene/run.json").is_file());
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(said.contains("Next: streamsplat view clip-scene"), "{said}");
    let said = fails(&command().args(["run", "-"]).stdin(Stdio::null()).output().expect("the program starts"), 2);
    assert!(said.contains("--out"), "{said}");
}

#[test]
fn a_second_run_into_the_same_place_is_refused() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 3, 40, 24);
    for (name, lock) in [("out", "out/.streamsplat.lock"), ("v.y4m", ".v.y4m.lock")] {
        let out = scratch.path(name);
        let mut first = waiting(&out, &scratch.path(lock));
        for more in [&[][..], &["--resume"]] {
            let text = fails(&run(&clip, &out, more).output().expect("the program starts"), 2);
            assert!(text.contains(&format!("process {} is writing there", first.id())), "{text}");
        }
        first.kill().expect("a child");
        first.wait().expect("it ends");
        // The file that it left is no obstacle.
        assert!(scratch.path(lock).exists());
        run_ok(&clip, &out, &["--quiet"]);
        assert!(!scratch.path(lock).exists());
    }
}

#[test]
fn nothing_is_removed_or_written_through_links() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 3, 40, 24);
    let other = scratch.path("other");
    run_ok(&clip, &other, &["--quiet"]);
    let before = files(&other);
    for name in ["frames", "scene", "resume"] {
        // The record names files behind the link, with their lengths and digests.
        let out = scratch.path(&format!("out-{name}"));
        std::fs::create_dir(&out).expect("writable");
        std::fs::copy(other.join("run.json"), out.join("run.json")).expect("writable");
        std::fs::create_dir_all(other.join(name)).expect("writable");
        symlink(other.join(name), out.join(name)).expect("writable");
        let text = fails(&run(&clip, &out, &[]).output().expect("the program starts"), 1);
        assert!(text.contains("symbolic link") && text.contains(name), "{text}");
        assert!(files(&other) == before, "{name}");
    }
    let out = scratch.path("out");
    let precious = scratch.path("precious");
    std::fs::create_dir_all(out.join("frames")).expect("writable");
    std::fs::write(&precious, "text").expect("writable");
    for name in [
        ".run.json.partial",
        ".report.md.partial",
        ".streamsplat.partial",
        "frames/.000000.png.partial",
        "frames/000001.png",
    ] {
        symlink(&precious, out.join(name)).expect("writable");
    }
    run_ok(&clip, &out, &["--quiet"]);
    assert_eq!(std::fs::read(&precious).expect("there"), b"text");
    assert!(files(&out) == before);
}

#[test]
fn only_what_a_run_wrote_is_removed() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 3, 40, 24);
    let out = scratch.path("out");
    run_ok(&clip, &out, &["--quiet"]);
    std::fs::write(out.join("frames/000002.png"), "edited by hand").expect("writable");
    run_ok(&clip, &out, &["--quiet", "--frames", "1", "--overwrite"]);
    assert_eq!(std::fs::read(out.join("frames/000002.png")).expect("there"), b"edited by hand");
    assert!(!out.join("frames/000001.png").exists());
}

#[test]
fn a_complete_run_whose_files_were_damaged_is_not_complete() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 3, 40, 24);
    let (whole, out) = (scratch.path("whole"), scratch.path("out"));
    run_ok(&clip, &whole, &["--quiet"]);
    run_ok(&clip, &out, &["--quiet"]);
    std::fs::write(out.join("frames/000001.png"), "").expect("writable");
    assert!(resume(&clip, &out).status.success());
    assert!(files(&out) == files(&whole));
    assert_eq!(record(&out.join("run.json")), record(&whole.join("run.json")));
}

#[test]
fn damage_takes_a_stopped_run_back_but_never_ends_it() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 5, 40, 24);
    let whole = scratch.path("whole");
    run_ok(&clip, &whole, &["--quiet"]);
    let last = clip.join("4.png");
    let content = std::fs::read(&last).expect("readable");
    for damaged in [
        "frames/000003.png",
        "frames/000000.png",
        "resume/state.safetensors",
        "resume/written.jsonl",
        "scene/interval-000003.safetensors",
        "run.json",
    ] {
        let out = scratch.path(&damaged.replace(['/', '.'], "-"));
        std::fs::write(&last, "").expect("writable");
        fails(&run(&clip, &out, &[]).output().expect("the program starts"), 1);
        std::fs::write(&last, &content).expect("writable");
        std::fs::write(out.join(damaged), "").expect("writable");
        let output = resume(&clip, &out);
        assert!(output.status.success(), "{damaged}: {}", String::from_utf8_lossy(&output.stderr));
        assert!(files(&out) == files(&whole), "{damaged}");
        assert_eq!(json(&out.join("run.json"))["outputs"], json(&whole.join("run.json"))["outputs"]);
    }
    // A complete run with an emptied record starts again.
    let expected = files(&whole);
    std::fs::write(whole.join("run.json"), "").expect("writable");
    let output = resume(&clip, &whole);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(files(&whole) == expected);
}
