//! An interrupted run that is resumed with `--resume` ends with the bytes of an uninterrupted one.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;
use streamsplat_fixtures as fixtures;

use crate::support::{Scratch, command, fails, files, json, model, record, run_ok};

/// Returns the command `run INPUT --out OUT --model (the small one) MORE…`.
fn run(input: &Path, out: &Path, more: &[&str]) -> Command {
    let mut command = command();
    command.arg("run").arg(input).arg("--out").arg(out).arg("--model").arg(model()).args(more);
    command
}

fn resume(input: &Path, out: &Path, more: &[&str]) -> Output {
    run(input, out, more).arg("--resume").stdin(Stdio::null()).output().expect("the program starts")
}

fn succeeds(output: &Output) -> String {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// Asserts that every file, including hidden ones, and the record are the same.
fn assert_same(found: &Path, expected: &Path) {
    let (a, b) = (files(found), files(expected));
    assert_eq!(a.keys().collect::<Vec<_>>(), b.keys().collect::<Vec<_>>());
    for (name, bytes) in &a {
        assert!(*bytes == b[name], "{name}");
    }
    assert_eq!(record(&found.join("run.json")), record(&expected.join("run.json")));
    assert!(found.join("report.md").exists());
}

/// Runs until `ready`, then sends the signal.
fn stop_when(mut command: Command, signal: &str, ready: impl Fn() -> bool) -> Output {
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the program starts");
    let start = Instant::now();
    while !ready() {
        let ended = child.try_wait().expect("a child");
        assert!(ended.is_none_or(|_| ready()), "it ended before there was something to stop");
        assert!(start.elapsed() < Duration::from_secs(60), "nothing to stop");
        std::thread::sleep(Duration::from_millis(1));
    }
    let kill = format!("kill -{signal} {}", child.id());
    assert!(Command::new("sh").args(["-c", &kill]).status().expect("a shell").success());
    child.wait_with_output().expect("it ends")
}

/// Returns a clip long enough to be stopped in the middle.
fn clip() -> PathBuf {
    fixtures::path("clips/moving.y4m")
}

const EVERYTHING: [&str; 5] = ["--emit", "rgb,depth,alpha,scene,ply", "--gap", "2", "--quiet"];

#[test]
fn ctrl_c_finishes_the_interval_and_what_it_leaves_is_gone_on_with() {
    let scratch = Scratch::new();
    let (whole, out) = (scratch.path("whole"), scratch.path("out"));
    run_ok(&clip(), &whole, &EVERYTHING);
    let third = out.join("scene/interval-000003.safetensors");
    let output = stop_when(run(&clip(), &out, &EVERYTHING), "INT", || third.exists());
    let said = fails(&output, 130);
    assert!(said.contains("the same command with --resume goes on"), "{said}");
    let stopped = json(&out.join("run.json"));
    assert_eq!(stopped["complete"], false);
    let scene = streamsplat::scene::Scene::open(&out).expect("a valid scene");
    let intervals = scene.index().intervals.len();
    assert!((4..13).contains(&intervals), "{intervals} intervals");
    // There is every frame of every interval, and no other.
    let frames = files(&out).keys().filter(|name| name.starts_with("frames/")).count();
    assert_eq!(frames, 2 * intervals - 1);
    let verified = command().arg("verify").arg(&out).output().expect("the program starts");
    succeeds(&verified);

    succeeds(&resume(&clip(), &out, &EVERYTHING));
    assert_same(&out, &whole);
    // Nothing was written twice.
    let before = files(&out);
    let said = succeeds(&resume(&clip(), &out, &EVERYTHING[..4]));
    assert!(said.contains("complete already, nothing to resume"), "{said}");
    assert!(files(&out) == before);
}

#[test]
fn it_goes_on_with_whatever_chooses_its_work() {
    let scratch = Scratch::new();
    let depth = scratch.path("depth");
    std::fs::create_dir(&depth).expect("writable");
    for i in 0..24u8 {
        let plane = image::GrayImage::from_fn(24, 14, |x, y| image::Luma([(3 * x + 5 * y) as u8 + 4 * i]));
        plane.save(depth.join(format!("{i:02}.png"))).expect("writable");
    }
    let depth = depth.to_str().expect("UTF-8");
    let each: [&[&str]; 8] = [
        &["--gap", "3", "--motion", "between", "--refine", "2", "--resolution", "72x120"],
        &["--reuse", "0.1", "--gap", "2"],
        &["--reuse", "off", "--fusion", "pairwise"],
        &["--gap", "auto:4", "--reuse", "0.1"],
        &["--gap", "auto:1-6:34", "--motion", "between", "--refine", "2"],
        &["--depth", depth, "--gap", "2"],
        &["--depth", "auto", "--gap", "2"],
        &["--sway=5:0.5", "--stereo", "--gap", "2"],
    ];
    for (i, options) in each.iter().enumerate() {
        let (whole, out) = (scratch.path(&format!("whole{i}")), scratch.path(&format!("out{i}")));
        let options = [options, &["--quiet"][..]].concat();
        run_ok(&clip(), &whole, &options);
        let second = out.join("scene/interval-000002.safetensors");
        // First shown in a browser and then not: the bytes are the same.
        let mut shown = run(&clip(), &out, &options);
        shown.arg("--serve=0");
        stop_when(shown, "KILL", || second.exists());
        assert!(!out.join("run.json").exists());
        succeeds(&resume(&clip(), &out, &options));
        assert_same(&out, &whole);
    }
}

#[test]
fn the_first_image_waits_for_its_depth_however_often_the_run_is_stopped() {
    let scratch = Scratch::new();
    let run = |out: &Path| {
        let mut command = command();
        command.arg("run").arg(clip()).arg("--out").arg(out).args(["--frames", "13", "--gap", "4", "--quiet"]);
        command
    };
    let whole = scratch.path("whole");
    succeeds(&run(&whole).output().expect("the program starts"));
    assert!(json(&whole.join("run.json"))["work"]["lift"]["done"].as_u64() > Some(2));
    for (stopped, signal) in [(0, "KILL"), (0, "INT"), (1, "KILL"), (2, "INT")] {
        let out = scratch.path(&format!("{stopped}-{signal}"));
        let interval = out.join(format!("scene/interval-{stopped:06}.safetensors"));
        stop_when(run(&out), signal, || interval.exists());
        succeeds(&run(&out).arg("--resume").output().expect("the program starts"));
        assert_same(&out, &whole);
    }
    let (whole, out) = (scratch.path("whole.y4m"), scratch.path("out.y4m"));
    succeeds(&run(&whole).output().expect("the program starts"));
    let begun = scratch.path(".out.y4m.partial");
    stop_when(run(&out), "INT", || begun.exists());
    succeeds(&run(&out).arg("--resume").output().expect("the program starts"));
    assert!(std::fs::read(&out).expect("readable") == std::fs::read(&whole).expect("readable"));
}

#[test]
fn frames_that_are_whole_are_not_drawn_again() {
    let scratch = Scratch::new();
    let out = scratch.path("out");
    let options = ["--gap", "3", "--quiet"];
    let second = out.join("scene/interval-000002.safetensors");
    stop_when(run(&clip(), &out, &options), "INT", || second.exists());
    let times = |folder: &Path| {
        let entries = std::fs::read_dir(folder).expect("readable").flatten();
        let time = |entry: &std::fs::DirEntry| entry.metadata().expect("readable").modified().expect("a time");
        entries.map(|entry| (entry.file_name(), time(&entry))).collect::<std::collections::BTreeMap<_, _>>()
    };
    let before = [times(&out.join("frames")), times(&out.join("scene"))];
    std::thread::sleep(Duration::from_millis(20));
    succeeds(&resume(&clip(), &out, &options));
    let after = [times(&out.join("frames")), times(&out.join("scene"))];
    for (before, after) in before.iter().zip(&after) {
        for (name, time) in before.iter().filter(|(name, _)| *name != "scene.json") {
            assert_eq!(after[name], *time, "{} was written again", name.display());
        }
        assert!(after.len() > before.len());
    }
}

#[test]
fn one_interval_is_enough_and_none_starts_the_run() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 5, 40, 24);
    let (whole, out) = (scratch.path("whole"), scratch.path("out"));
    run_ok(&clip, &whole, &["--quiet"]);
    // There are no results yet.
    succeeds(&resume(&clip, &out, &["--quiet"]));
    assert_same(&out, &whole);
    std::fs::remove_dir_all(&out).expect("there");
    // A fifth frame that cannot be read stops the run after the others; on resuming, the same frames are required.
    let good = std::fs::read(clip.join("1.png")).expect("readable");
    for broken in [1, 4] {
        let frame = clip.join(format!("{broken}.png"));
        let content = std::fs::read(&frame).expect("readable");
        std::fs::write(&frame, &good[..40]).expect("writable");
        let text = fails(&run(&clip, &out, &["--quiet"]).output().expect("the program starts"), 1);
        assert!(text.contains(&format!("{broken}.png")), "{text}");
        let scene = streamsplat::scene::Scene::open(&out).expect("a valid scene");
        assert_eq!(scene.index().intervals.len(), broken);
        let listed = std::fs::read_to_string(out.join("resume/written.jsonl")).expect("readable");
        for line in listed.lines().map(|line| serde_json::from_str::<Value>(line).expect("JSON")) {
            let file = out.join(line["file"].as_str().expect("a name"));
            let digest = blake3::hash(&std::fs::read(file).expect("whole")).to_hex();
            assert_eq!(line["blake3"], digest.as_str());
        }
        assert_eq!(listed.lines().count(), 2 * broken, "an interval and an image for each frame");
        std::fs::write(&frame, content).expect("writable");
        succeeds(&resume(&clip, &out, &["--quiet"]));
        assert_same(&out, &whole);
        std::fs::remove_dir_all(&out).expect("there");
    }
}

#[test]
fn a_stopped_y4m_goes_on_and_other_videos_cannot() {
    let scratch = Scratch::new();
    let (whole, out) = (scratch.path("whole.y4m"), scratch.path("out.y4m"));
    let options = ["--gap", "2", "--quiet"];
    run_ok(&clip(), &whole, &options);
    let state = scratch.path("out.y4m.resume/state.safetensors");
    for signal in ["INT", "TERM", "KILL"] {
        let output = stop_when(run(&clip(), &out, &options), signal, || state.exists());
        assert_eq!(output.status.code(), (signal != "KILL").then_some(130));
        assert_eq!(out.exists(), signal != "KILL", "a name means that it was finished");
        succeeds(&resume(&clip(), &out, &options));
        assert!(std::fs::read(&out).expect("readable") == std::fs::read(&whole).expect("readable"), "{signal}");
        let [mut a, mut b] = [&out, &whole].map(|path| record(&PathBuf::from(format!("{}.run.json", path.display()))));
        let [a, b] = [&mut a, &mut b].map(|r| r["outputs"].as_object().expect("files").values().next().cloned());
        assert_eq!(a, b);
        assert!(!scratch.path("out.y4m.resume").exists() && !scratch.path(".out.y4m.partial").exists());
        std::fs::remove_file(&out).expect("there");
        std::fs::remove_file(scratch.path("out.y4m.run.json")).expect("there");
    }
    for name in ["-", "v.mp4"] {
        let text = fails(&resume(&clip(), Path::new(name), &options), 2);
        assert!(text.contains("--resume: expected a folder or a .y4m file"), "{text}");
    }
}

#[test]
fn standard_input_is_read_again_from_its_start() {
    let scratch = Scratch::new();
    let (whole, out) = (scratch.path("whole"), scratch.path("out"));
    let stream = std::fs::read(clip()).expect("readable");
    let piped = |out: &Path, bytes: &[u8], more: &[&str]| {
        let mut child = run(Path::new("-"), out, &["--quiet", "--gap", "2"])
            .args(more)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the program starts");
        // A program that rejects the stream closes it.
        let _ = child.stdin.take().expect("a pipe").write_all(bytes);
        child.wait_with_output().expect("it ends")
    };
    succeeds(&piped(&whole, &stream, &[]));
    // A stream that ends inside a frame.
    fails(&piped(&out, &stream[..stream.len() / 2], &[]), 1);
    let mut other = stream.clone();
    let place = other.len() / 10;
    other[place] ^= 0x40;
    let text = fails(&piped(&out, &other, &["--resume"]), 1);
    assert!(text.contains("--resume: the input: recorded") && text.contains("found"), "{text}");
    succeeds(&piped(&out, &stream, &["--resume"]));
    assert_same(&out, &whole);
}

#[test]
fn what_differs_from_the_stopped_run_is_named() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 4, 40, 24);
    std::fs::write(clip.join("4.png"), b"").expect("writable");
    let out = scratch.path("out");
    let stopped = || fails(&run(&clip, &out, &["--gap", "2"]).output().expect("the program starts"), 1);
    stopped();
    let before = files(&out);
    for (more, expected) in [
        (&["--gap", "3"][..], "--gap: the run was started with 2, given 3"),
        (&["--gap", "2", "--max-age", "2"], "--max-age: the run was started with its default, given 2"),
        (&["--gap", "2", "--emit", "rgb"], "--emit: the run was started with its default, given rgb"),
        (&["--gap", "2", "--size", "source"], "--size: the run was started with model, given source"),
    ] {
        let text = fails(&resume(&clip, &out, more), 2);
        assert!(text.contains(expected), "{text}");
    }
    let mut other = command();
    other.arg("run").arg(&clip).arg("--out").arg(&out).args(["--gap", "2", "--resume"]);
    let text = fails(&other.output().expect("the program starts"), 1);
    assert!(text.contains("--resume: the model: recorded") && text.contains("embedded"), "{text}");
    // The number of threads and the instruction set may change.
    let text = fails(&resume(&clip, &out, &["--gap", "2", "--threads", "3", "--isa", "scalar"]), 1);
    assert!(text.contains("4.png"), "{text}");
    assert!(files(&out) == before, "what was refused changed nothing");

    let frame = std::fs::read(clip.join("1.png")).expect("readable");
    std::fs::write(clip.join("1.png"), std::fs::read(clip.join("2.png")).expect("readable")).expect("writable");
    let text = fails(&resume(&clip, &out, &["--gap", "2"]), 1);
    assert!(text.contains("--resume: the input: recorded 3 frames"), "{text}");
    std::fs::write(clip.join("1.png"), frame).expect("writable");
    // Damaged files are no obstacle: the run resumes before them and continues to the frame that stopped it.
    let image = out.join("frames/000001.png");
    let content = std::fs::read(&image).expect("readable");
    std::fs::write(&image, &content[1..]).expect("writable");
    let text = fails(&resume(&clip, &out, &["--gap", "2"]), 1);
    assert!(text.contains("4.png"), "{text}");
    for broken in [&b""[..], b"{}", &[0xff; 64]] {
        std::fs::write(out.join("resume/state.safetensors"), broken).expect("writable");
        let text = fails(&resume(&clip, &out, &["--gap", "2"]), 1);
        assert!(text.contains("4.png"), "{text}");
    }
    // Without --resume the folder is cleared and the run starts from the beginning.
    std::fs::remove_file(clip.join("4.png")).expect("there");
    run_ok(&clip, &out, &["--quiet"]);
    let fresh = scratch.path("fresh");
    run_ok(&clip, &fresh, &["--quiet"]);
    assert_same(&out, &fresh);
    let text = fails(&resume(&clip, &out, &["--gap", "2"]), 2);
    assert!(text.contains("--gap: the run was started with 1, given 2"), "{text}");
}
