//! `verify` confirms a run, and fails after one flipped byte.

use std::path::Path;

use crate::support::{Scratch, command, fails, files, json, run_ok};

fn verify(path: &Path) -> std::process::Output {
    command().arg("verify").arg(path).args(["--threads", "3"]).output().expect("the program starts")
}

fn flip(path: &Path) {
    let mut bytes = std::fs::read(path).expect("readable");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(path, bytes).expect("writable");
}

#[test]
fn one_flipped_byte_of_an_output_or_of_the_input_is_found_and_named() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 3, 40, 24);
    let out = scratch.path("out");
    run_ok(&clip, &out, &["--gap", "2", "--emit", "rgb,depth,scene"]);
    let output = verify(&out);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(String::from_utf8_lossy(&output.stdout).contains("all digests equal"));
    for name in ["frames/000001.png", "depth/000002.exr", "scene/interval-000001.safetensors", "scene/scene.json"] {
        flip(&out.join(name));
        let text = fails(&verify(&out), 1);
        assert!(text.contains(name) && text.contains("digest differs"), "{text}");
        flip(&out.join(name));
    }
    std::fs::remove_file(out.join("frames/000000.png")).expect("there");
    assert!(fails(&verify(&out), 1).contains("frames/000000.png"));

    let again = scratch.path("again");
    run_ok(&clip, &again, &[]);
    let changed = image::RgbImage::from_pixel(40, 24, image::Rgb([9, 9, 9]));
    changed.save(clip.join("1.png")).expect("writable");
    assert!(fails(&verify(&again), 1).contains("the input"));
}

#[test]
fn a_run_that_finds_depth_is_repeated_from_any_folder() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 3, 40, 24);
    let out = scratch.path("out");
    run_ok(&clip, &out, &["--depth", "auto"]);
    assert_eq!(json(&out.join("run.json"))["options"]["stream"]["depth"], "auto");
    let output = verify(&out);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn what_is_left_out_and_which_frames_are_key_frames_is_repeated() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 11, 80, 48);
    // A cut in the video.
    for frame in 6..11 {
        let path = clip.join(format!("{frame}.png"));
        let mut image = image::open(&path).expect("a picture").to_rgb8();
        image.pixels_mut().for_each(|pixel| pixel.0 = pixel.0.map(|c| 255 - c));
        image.save(path).expect("writable");
    }
    let out = scratch.path("out");
    let close = ["--motion", "between", "--refine", "4"];
    run_ok(&clip, &out, &[&close[..], &["--gap", "auto:1-4:10", "--reuse", "0.02", "--quiet"]].concat());
    let record = json(&out.join("run.json"));
    assert_eq!(record["options"]["stream"]["gap"], "auto:1-4:10");
    assert_eq!(record["options"]["stream"]["reuse"], "0.02");
    assert!(record["work"]["encoder.tokens"]["avoided"].as_u64().is_some_and(|n| n > 0), "{}", record["work"]);
    let scene = json(&out.join("scene/scene.json")).to_string();
    assert!(record["psnr"].as_f64().is_some_and(|found| found > 10.0), "{}", record["psnr"]);
    // The largest gap, the frame before the cut, the one after.
    for (index, expected) in [(1, 4), (2, 5), (3, 6), (4, 10)] {
        let name = format!("interval-{index:06}.safetensors");
        assert!(scene.contains(&name), "{name} ends with frame {expected}");
    }
    assert!(!scene.contains("interval-000005"));
    assert_eq!(files(&out).keys().filter(|name| name.starts_with("frames/")).count(), 11);
    let output = verify(&out);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn videos_and_renderings_are_verified_too() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 3, 40, 24);
    let video = scratch.path("v.y4m");
    run_ok(&clip, &video, &["--quiet"]);
    let record = scratch.path("v.y4m.run.json");
    let output = verify(&record);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    flip(&video);
    assert!(fails(&verify(&record), 1).contains("v.y4m"));

    let (out, images) = (scratch.path("out"), scratch.path("images"));
    run_ok(&clip, &out, &["--quiet"]);
    let output = command().arg("render").arg(&out).args(["--times", "0:0.05:4", "--out"]).arg(&images).output();
    assert!(output.expect("the program starts").status.success());
    assert!(verify(&images).status.success());
    flip(&images.join("frames/000003.png"));
    assert!(fails(&verify(&images), 1).contains("000003.png"));
}

#[test]
fn records_that_are_none_and_inputs_that_are_gone_are_errors() {
    let scratch = Scratch::new();
    assert!(fails(&verify(&scratch.path("absent")), 1).contains("run.json"));
    std::fs::create_dir(scratch.path("out")).expect("writable");
    for text in ["", "{}", "{\"program\": \"other\"}", "[1, 2"] {
        std::fs::write(scratch.path("out/run.json"), text).expect("writable");
        assert!(fails(&verify(&scratch.path("out")), 1).contains("run.json"));
    }
}

#[test]
fn a_changed_report_and_a_file_that_nobody_wrote_are_found() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 2, 40, 24);
    let out = scratch.path("out");
    run_ok(&clip, &out, &["--quiet"]);
    assert!(verify(&out).status.success());
    let report = out.join("report.md");
    let text = std::fs::read_to_string(&report).expect("a report");
    std::fs::write(&report, text.replace("frames", "fromes")).expect("writable");
    assert!(fails(&verify(&out), 1).contains("report.md"));
    std::fs::write(&report, text).expect("writable");
    std::fs::write(out.join("frames/000009.png"), "foreign").expect("writable");
    assert!(fails(&verify(&out), 1).contains("000009.png"));
}

#[test]
fn a_video_is_verified_by_the_record_beside_it() {
    let scratch = Scratch::new();
    let video = scratch.path("v.y4m");
    run_ok(&scratch.clip("clip", 2, 40, 24), &video, &["--quiet"]);
    assert!(verify(&video).status.success());
    std::fs::remove_file(scratch.path("v.y4m.run.json")).expect("there");
    assert!(fails(&verify(&video), 1).contains("found a video (y4m)"));
}
