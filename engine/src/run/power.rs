//! Power losses, full disks and failing devices at every operation of a short run: `--resume` always ends with the
//! bytes of an uninterrupted run.
//!
//! Every ninth operation by default; `STREAMSPLAT_EVERY=1 cargo test --release -p streamsplat power` tries all.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use streamsplat_fixtures as fixtures;

use super::{Error, Machine, Record, Run, RunOptions};
#[cfg(unix)]
use crate::output::storage::faults::inject_with;
use crate::output::storage::faults::{Fault, inject};

const FAULTS: [Fault; 5] = [Fault::LosesBytes, Fault::LosesNames, Fault::NoSpace, Fault::Device, Fault::ShortWrite];

/// Creates five frames with a moving object.
fn clip(folder: &Path) -> PathBuf {
    let clip = folder.join("clip");
    std::fs::create_dir(&clip).expect("writable");
    for frame in 0..5_u32 {
        let image = image::RgbImage::from_fn(40, 24, |x, y| {
            let inside = x.abs_diff(10 + 3 * frame) < 5 && y.abs_diff(12) < 5;
            if inside { image::Rgb([240, 80, 30]) } else { image::Rgb([(x * 3) as u8, (y * 5) as u8, (x ^ y) as u8]) }
        });
        image.save(clip.join(format!("{frame}.png"))).expect("writable");
    }
    clip
}

/// A run with a small model on one thread.
fn run(clip: &Path, out: &Path) -> Run {
    let mut options = RunOptions::default();
    let model = fixtures::path("parity/tiny-nodino.safetensors").display().to_string();
    assert!(options.set("model", &model).expect("a value"));
    Run::new(clip, options).machine(Machine { threads: "1".parse().ok(), ..Machine::default() }).out(out)
}

fn attempt(clip: &Path, out: &Path, resume: bool, fault: Option<(Fault, u64)>) -> (Result<Record, Error>, u64) {
    inject(fault, || run(clip, out).resume(resume).finish())
}

/// Returns all files in and around a folder except reports; records are replaced by their outputs.
fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for entry in std::fs::read_dir(&next).expect("readable").flatten() {
            let path = entry.path();
            let name = path.strip_prefix(folder).expect("below").to_owned();
            if path.is_dir() {
                folders.push(path);
            } else if name.ends_with("run.json") || name.to_string_lossy().ends_with(".run.json") {
                let text = std::fs::read(&path).expect("readable");
                let record: serde_json::Value = serde_json::from_slice(&text).expect("JSON");
                assert_eq!(record["complete"], true);
                found.insert(name, record["outputs"].to_string().into_bytes());
            } else if !name.ends_with("report.md") {
                found.insert(name, std::fs::read(&path).expect("readable"));
            }
        }
    }
    found
}

fn sweep(name: &str) {
    let every = std::env::var("STREAMSPLAT_EVERY").map_or(9, |text| text.parse().expect("a number"));
    let scratch = tempfile::tempdir().expect("a temporary folder");
    let clip = clip(scratch.path());
    let whole = scratch.path().join("whole");
    std::fs::create_dir(&whole).expect("writable");
    let (result, operations) = attempt(&clip, &whole.join(name), false, None);
    result.expect("nothing fails");
    assert!(operations > 50, "{operations} operations");
    let expected = files(&whole);
    for (i, fault) in FAULTS.into_iter().enumerate() {
        for at in (1 + i as u64..=operations).step_by(every) {
            let folder = scratch.path().join(format!("{fault:?}-{at}"));
            std::fs::create_dir(&folder).expect("writable");
            let (_, _) = attempt(&clip, &folder.join(name), false, Some((fault, at)));
            let (result, _) = attempt(&clip, &folder.join(name), true, None);
            if let Err(failure) = result {
                panic!("{fault:?} at {at} of {operations}: {failure}");
            }
            let found = files(&folder);
            assert_eq!(found.keys().collect::<Vec<_>>(), expected.keys().collect::<Vec<_>>(), "{fault:?} at {at}");
            assert!(found == expected, "{fault:?} at {at} of {operations}");
            std::fs::remove_dir_all(&folder).expect("there");
        }
    }
}

/// A fake ffmpeg. It writes its input and an end mark, with exit code 0 whatever happens to the file, and counts the
/// frames of a file with its end mark.
#[cfg(unix)]
const ENCODER: &str = r#"#!/bin/sh
case $* in
*framecrc*)
  while [ "$1" != -i ]; do shift; done
  file=${2#file:}
  [ "$(tail -c 3 "$file")" = END ] || { echo "moov atom not found" >&2; exit 1; }
  LC_ALL=C grep -a -o "$(printf '\037C\266u')" "$file" | sed 's/.*/0, 0/'
  ;;
*)
  for last; do :; done
  { cat; printf END; } >"${last#file:}"
  ;;
esac
"#;

/// Runs to `video`, where another file exists, with this encoder.
#[cfg(unix)]
fn encoded(clip: &Path, video: &Path, encoder: &Path, fault: Option<(Fault, u64)>) -> (Result<Record, Error>, u64) {
    std::fs::write(video, "another").expect("writable");
    let mut run = run(clip, video);
    assert!(run.options.set("emit", "rgb").expect("a value"));
    inject_with(fault, Some(encoder.to_owned()), || run.overwrite(true).finish())
}

#[cfg(unix)]
#[test]
fn an_encoded_video_replaces_another_whole_or_not_at_all() {
    let scratch = tempfile::tempdir().expect("a temporary folder");
    let clip = clip(scratch.path());
    // Another process writes the encoder: this process would hold it open while other threads start programs.
    let encoder = scratch.path().join("encoder");
    let mut writer = std::process::Command::new("sh")
        .args(["-c", "cat >\"$0\" && chmod +x \"$0\""])
        .arg(&encoder)
        .stdin(std::process::Stdio::piped())
        .spawn()
        .expect("a shell");
    std::io::Write::write_all(&mut writer.stdin.take().expect("a pipe"), ENCODER.as_bytes()).expect("writable");
    assert!(writer.wait().expect("a shell").success());
    let whole = scratch.path().join("whole.mp4");
    let (result, operations) = encoded(&clip, &whole, &encoder, None);
    result.unwrap_or_else(|failure| panic!("{failure}"));
    let expected = std::fs::read(&whole).expect("there");
    assert!(expected.len() > 5 * 3 * 40 * 24, "{}", expected.len());
    let mut cut = 0;
    for fault in FAULTS {
        for at in 1..=operations {
            let folder = scratch.path().join(format!("{fault:?}-{at}"));
            std::fs::create_dir(&folder).expect("writable");
            let video = folder.join("v.mp4");
            let (result, _) = encoded(&clip, &video, &encoder, Some((fault, at)));
            let found = std::fs::read(&video).expect("one or the other");
            assert!(found == b"another" || found == expected, "{fault:?} at {at} of {operations}: neither");
            match result {
                Ok(_) => assert!(found == expected, "{fault:?} at {at} of {operations}: said to be done"),
                Err(failure) => cut += u32::from(failure.to_string().contains("moov atom not found")),
            }
            std::fs::remove_dir_all(&folder).expect("there");
        }
    }
    assert_eq!(cut, 3, "no room, a failing device and a short write under the encoder");
}

#[test]
fn a_folder_survives_every_fault() {
    sweep("out");
}

#[test]
fn a_y4m_file_survives_every_fault() {
    sweep("v.y4m");
}
