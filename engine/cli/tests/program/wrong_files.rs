//! Files of the wrong kind: every command prints the kind found and advice.

use std::path::Path;
use std::process::Output;

use crate::support::{Scratch, command, fails};

/// Returns the error message of a command that expects a scene, for `path`.
fn said(scratch: &Scratch, name: &str, path: &Path) -> String {
    let out = scratch.path("out");
    let mut program = command();
    program.arg(name).arg(path);
    match name {
        "view" => program.arg("--html").arg(scratch.path("page.html")),
        "render" => program.arg("--out").arg(&out),
        "export" => program.args(["--format", "ply", "--out"]).arg(&out),
        "track" => program.args(["--at", "0", "--point", "1,1"]),
        "compare" => program.arg(path),
        _ => &mut program,
    };
    let output: Output = program.output().expect("the program starts");
    let text = fails(&output, 1);
    assert!(!out.exists() && !scratch.path("page.html").exists(), "{name}");
    text
}

const XYZ: &str = "property float x\nproperty float y\nproperty float z\nproperty uchar red\n";

#[test]
fn every_command_that_takes_a_scene_tells_what_it_is_given() {
    let scratch = Scratch::new();
    let points = format!("ply\nformat ascii 1.0\nelement vertex 1\n{XYZ}end_header\n0 0 0 9\n");
    for (name, bytes, found) in [
        ("clip.mp4", &b"\0\0\0\x20ftypisom\0\0\0\0isom"[..], "a video (MP4): streamsplat run makes a scene of it"),
        ("a.ply", b"<!doctype html><html></html>", "a web page (HTML): it came in place of the file"),
        ("b.ply", b"version https://git-lfs.github.com/spec/v1\n", "a pointer of Git LFS: git lfs pull"),
        (
            "c.ply",
            points.as_bytes(),
            "a point cloud (PLY of 1 points without opacities and scales): points have no size",
        ),
        ("a.npy", b"\x93NUMPY\x01\0v\0", "an array of NumPy (.npy): "),
    ] {
        let path = scratch.path(name);
        std::fs::write(&path, bytes).expect("writable");
        for command in ["view", "render", "export", "inspect", "track"] {
            let text = said(&scratch, command, &path);
            let expected = if command == "inspect" { "a model, a scene or an interval" } else { "a scene" };
            let start = format!("streamsplat: {}: expected {expected}, found {found}", path.display());
            assert!(text.starts_with(&start), "{command}: {text}");
        }
    }
    let folder = scratch.path("plies");
    std::fs::create_dir(&folder).expect("writable");
    std::fs::write(folder.join("a.ply"), "ply\n").expect("writable");
    for command in ["view", "render", "export", "inspect", "track"] {
        let text = said(&scratch, command, &folder);
        assert!(text.contains("found a folder with one scene in it: name the file, such as"), "{command}: {text}");
    }
}

#[test]
fn a_run_a_comparison_and_a_verification_tell_what_they_are_given() {
    let scratch = Scratch::new();
    let (scene, sound, video) = (scratch.path("a.ply"), scratch.path("a.mp3"), scratch.path("a.mp4"));
    std::fs::write(&scene, "ply\nformat ascii 1.0\n").expect("writable");
    std::fs::write(&sound, b"ID3\x04\0\0").expect("writable");
    std::fs::write(&video, b"\0\0\0\x20ftypisom\0\0\0\0isom").expect("writable");
    let run = |path: &Path| {
        let output = command().arg("run").arg(path).arg("--out").arg(scratch.path("out")).output();
        fails(&output.expect("the program starts"), 1)
    };
    assert!(run(&scene).contains("found a scene (PLY): streamsplat view shows it"), "{}", run(&scene));
    assert!(run(&sound).contains("found sound alone (MP3): there is no picture in it"), "{}", run(&sound));
    assert!(said(&scratch, "verify", &video).contains("found a video (MP4): the record of a run that wrote it"));
    let page = scratch.path("b.png");
    std::fs::write(&page, "<html>").expect("writable");
    let output = command().arg("compare").arg(&page).arg(&video).output().expect("the program starts");
    assert!(fails(&output, 1).contains("found a web page (HTML)"));
}
