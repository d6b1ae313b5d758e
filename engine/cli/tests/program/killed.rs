//! Runs that are killed at any moment, or out of disk space: existing files are whole, and `--resume` ends with the
//! same bytes.
//!
//! `STREAMSPLAT_KILLS=50 STREAMSPLAT_SEED=7 cargo test --release -p streamsplat-cli --test program killed --
//! --nocapture` kills more often, at other moments.

use std::io::Read;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use streamsplat::scene::Scene;
use streamsplat_fixtures as fixtures;

use crate::support::{Scratch, command, fails, files, model, record, run_ok};

const OPTIONS: [&str; 5] = ["--emit", "rgb,depth,alpha,scene,ply", "--gap", "2", "--quiet"];

fn number(name: &str, otherwise: u64) -> u64 {
    std::env::var(name).map_or(otherwise, |text| text.parse().unwrap_or_else(|_| panic!("{name}={text}: a number")))
}

/// SplitMix64.
fn random(state: &mut u64) -> u64 {
    *state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let mut z = *state;
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

fn run(input: &Path, out: &Path) -> Command {
    let mut command = command();
    command.arg("run").arg(input).arg("--out").arg(out).arg("--model").arg(model());
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

/// Checks the state after a kill: every interval of the index is whole, and every file under its own name is readable.
/// Returns their numbers.
fn check(out: &Path) -> (usize, usize) {
    let mut intervals = 0;
    if out.join("scene/scene.json").exists() {
        let scene = Scene::open(out).expect("a valid index");
        intervals = scene.index().intervals.len();
        for i in 0..intervals {
            scene.interval(i).expect("a whole interval");
        }
    }
    let mut images = 0;
    for (name, bytes) in if out.exists() { files(out) } else { Default::default() } {
        let hidden = name.rsplit('/').next().is_some_and(|file| file.starts_with('.'));
        if name.ends_with(".png") && !hidden {
            image::load_from_memory(&bytes).unwrap_or_else(|e| panic!("{name}: {e}"));
            images += 1;
        }
    }
    assert!(!out.join("run.json").exists(), "a record means that the run ended");
    (intervals, images)
}

fn assert_same(out: &Path, whole: &Path) {
    if whole.is_file() {
        assert!(std::fs::read(out).expect("readable") == std::fs::read(whole).expect("readable"));
    } else {
        let (found, expected) = (files(out), files(whole));
        assert_eq!(found.keys().collect::<Vec<_>>(), expected.keys().collect::<Vec<_>>());
        assert!(found == expected);
    }
    assert_eq!(record(&record_of(out)), record(&record_of(whole)));
}

/// Returns the record of a run to a folder or a y4m file.
fn record_of(out: &Path) -> std::path::PathBuf {
    if out.extension().is_some() { out.with_extension("y4m.run.json") } else { out.join("run.json") }
}

#[test]
fn killed_at_random_moments_it_ends_with_the_same_bytes() {
    endure(&fixtures::path("clips/moving.y4m"), "out", &OPTIONS, 8);
}

#[test]
fn killed_with_the_default_options_it_ends_with_the_same_bytes() {
    // The choice of key frames depends on earlier frames (`--gap auto`).
    let moving = fixtures::path("clips/moving.y4m");
    endure(&moving, "out", &["--quiet"], 4);
    endure(&moving, "out.y4m", &["--quiet"], 4);
}

#[test]
fn killed_with_a_folder_of_images_as_its_input_it_ends_with_the_same_bytes() {
    let scratch = Scratch::new();
    endure(&scratch.clip("clip", 12, 40, 24), "out", &["--emit", "rgb,scene,exr,tracks", "--quiet"], 4);
}

/// Kills runs of `input` to an output of this name, and resumed ones, the given number of times; the last one runs to
/// its end.
fn endure(input: &Path, name: &str, options: &[&str], kills: u64) {
    let kills = number("STREAMSPLAT_KILLS", kills);
    let mut seed = number("STREAMSPLAT_SEED", 1);
    let scratch = Scratch::new();
    std::fs::create_dir(scratch.path("whole")).expect("writable");
    let (whole, out) = (scratch.path("whole").join(name), scratch.path(name));
    let start = Instant::now();
    run_ok(input, &whole, options);
    let length = start.elapsed();
    let (mut killed, mut ends) = (0, 0);
    while killed < kills {
        // Runs and resumed runs are killed alike, early more often than late, so that some are killed repeatedly.
        let part = (random(&mut seed) % 1000) as f64 / 1000.0;
        let moment = length.mul_f64(0.9 * part * part + 0.02);
        let mut child = run(input, &out).args(options).arg("--resume").spawn().expect("the program starts");
        let start = Instant::now();
        while start.elapsed() < moment && child.try_wait().expect("a child").is_none() {
            std::thread::sleep(Duration::from_micros(200));
        }
        child.kill().expect("a child");
        let output = child.wait_with_output().expect("it ends");
        if output.status.success() {
            assert_same(&out, &whole);
            let removed = if out.is_dir() { std::fs::remove_dir_all(&out) } else { std::fs::remove_file(&out) };
            removed.expect("there");
            if !record_of(&out).starts_with(&out) {
                std::fs::remove_file(record_of(&out)).expect("there");
            }
            ends += 1;
            continue;
        }
        assert_eq!(output.status.code(), None, "{}", String::from_utf8_lossy(&output.stderr));
        killed += 1;
        if name.ends_with("y4m") {
            assert!(out.exists() || !record_of(&out).exists(), "a record without its video");
        } else if !out.join("run.json").exists() {
            let (intervals, images) = check(&out);
            println!("kill {killed} after {moment:.1?} of {length:.1?}: {intervals} intervals, {images} images");
        }
    }
    let output = run(input, &out).args(options).arg("--resume").output().expect("the program starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_same(&out, &whole);
    println!("{killed} kills, {} complete runs with the same bytes", ends + 1);
}

/// Runs the program with a limit of `kilobytes` on each file that it writes, as on a full disk.
fn limited(out: &Path, kilobytes: u32) -> Command {
    let mut shell = Command::new("bash");
    shell.args(["-c", &format!("trap '' XFSZ; ulimit -f {kilobytes}; exec \"$@\""), "bash"]);
    let inner = run(&fixtures::path("clips/moving.y4m"), out);
    shell.arg(inner.get_program()).args(inner.get_args()).args(["--gap", "2", "--quiet"]);
    shell
}

#[test]
fn out_of_room_it_says_so_and_what_was_written_stays_valid() {
    let scratch = Scratch::new();
    // The first interval has 960 Gaussians, the next ones twice as many: 90 kB fit, 180 kB do not.
    let (out, whole) = (scratch.path("out"), scratch.path("whole"));
    let text = fails(&limited(&out, 150).output().expect("a shell"), 1);
    assert!(text.contains("interval-000001.safetensors: cannot write: File too large"), "{text}");
    assert_eq!(check(&out), (1, 1));
    assert!(files(&out).keys().all(|name| !name.contains("partial")));
    let options = ["--gap", "2", "--quiet"];
    let output = run(&fixtures::path("clips/moving.y4m"), &out)
        .args(options)
        .arg("--resume")
        .output()
        .expect("the program starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    run_ok(&fixtures::path("clips/moving.y4m"), &whole, &options);
    assert_same(&out, &whole);

    // 24 frames of 10,806 bytes.
    let (out, whole) = (scratch.path("out.y4m"), scratch.path("whole.y4m"));
    let text = fails(&limited(&out, 150).output().expect("a shell"), 1);
    // The video or the resume state, whichever exceeds the limit first.
    assert!(text.contains("cannot write: File too large"), "{text}");
    assert!(!out.exists(), "it has no name before it is whole");
    let output = run(&fixtures::path("clips/moving.y4m"), &out)
        .args(options)
        .arg("--resume")
        .output()
        .expect("the program starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    run_ok(&fixtures::path("clips/moving.y4m"), &whole, &options);
    assert!(std::fs::read(&out).expect("readable") == std::fs::read(&whole).expect("readable"));
}

#[test]
fn a_reader_that_takes_a_thousand_bytes_gets_the_right_ones() {
    let scratch = Scratch::new();
    let whole = scratch.path("whole.y4m");
    run_ok(&fixtures::path("clips/moving.y4m"), &whole, &["--quiet", "--size", "640x384"]);
    let mut child = run(&fixtures::path("clips/moving.y4m"), Path::new("-"))
        .args(["--quiet", "--size", "640x384"])
        .spawn()
        .expect("the program starts");
    let mut start = [0; 1000];
    child.stdout.take().expect("a pipe").read_exact(&mut start).expect("a thousand bytes");
    let text = fails(&child.wait_with_output().expect("it ends"), 1);
    assert!(text.contains("-: cannot write: Broken pipe"), "{text}");
    assert!(std::fs::read(&whole).expect("readable").starts_with(&start));
}
