//! PLY files of 3D Gaussian splatting as input, images and other formats as output.

use std::path::{Path, PathBuf};

use streamsplat::camera::file;
use streamsplat::formats;
use streamsplat::picture::{Picture, to_u8};
use streamsplat::render::Renderer;
use streamsplat::still::{Drawable, Still};
use streamsplat::stream::Workers;
use streamsplat::{RenderOptions, Size};
use streamsplat_kernels::Level;

use crate::support::{Scratch, command, fails, files, json, run};

const CAMERA: &str =
    r#"{"type": "pinhole", "position": [0.3, -0.2, -3.0], "look_at": [0, 0, 0.5], "fov_y_degrees": 45, "aspect": 1.5}"#;

/// Returns a scene with harmonics of degree 3.
pub fn still() -> Still {
    let value = |i: usize, k: usize| ((i * 7919 + k * 104_729) % 1009) as f32 / 504.5 - 1.0;
    let count = 500;
    Still {
        mean: (0..count).map(|i| std::array::from_fn(|k| value(i, k))).collect(),
        log_scale: (0..count).map(|i| std::array::from_fn(|k| -2.5 + value(i, 3 + k))).collect(),
        rotation: (0..count).map(|i| std::array::from_fn(|k| 3.0 * value(i, 6 + k))).collect(),
        logit: (0..count).map(|i| 4.0 * value(i, 10)).collect(),
        base: (0..count).map(|i| std::array::from_fn(|k| value(i, 11 + k))).collect(),
        degree: 3,
        higher: (0..count * 45).map(|i| 0.3 * value(i, 14)).collect(),
        ..Still::default()
    }
}

/// Writes the scene as a PLY file, and a camera.
pub fn prepared(scratch: &Scratch) -> (PathBuf, PathBuf) {
    let (scene, camera) = (scratch.path("scene.ply"), scratch.path("camera.json"));
    std::fs::write(&scene, formats::ply::write(&still()).bytes).expect("writable");
    std::fs::write(&camera, CAMERA).expect("writable");
    (scene, camera)
}

fn render(scene: &Path, camera: &Path, out: &Path, more: &[&str]) -> std::process::Output {
    let mut command = command();
    command.arg("render").arg(scene).arg("--camera").arg(camera).arg("--out").arg(out);
    command.args(more).output().expect("the program starts")
}

#[test]
fn a_ply_file_is_drawn_as_the_library_draws_it_whatever_the_threads_and_verified() {
    let scratch = Scratch::new();
    let (scene, camera) = prepared(&scratch);
    let workers = Workers::new(Level::detect(), 2).expect("threads start");
    let drawable = Drawable::new(still(), &workers).expect("even arrays");
    let view = file::parse(CAMERA).expect("a camera").at(0.0);
    let options = RenderOptions { size: Size::Exact { width: 90, height: 60 }, ..RenderOptions::default() };
    let image = Renderer::new(&workers).render_still(&drawable, &view, &options).expect("a camera").clone();
    let picture = Picture { width: image.width, height: image.height, rgb: image.rgb };
    let mut outputs = Vec::new();
    for more in [&["--threads", "1", "--isa", "scalar"][..], &["--threads", "3"]] {
        let out = scratch.path(more[1]);
        let output = render(&scene, &camera, &out, &[&["--size", "90x60", "--emit", "rgb,depth,alpha"], more].concat());
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let found = files(&out);
        assert!(found["frames/000000.png"] == streamsplat::output::picture_png(&picture));
        assert_eq!(found.len(), 3);
        outputs.push(found);
        let output = command().arg("verify").arg(&out).output().expect("the program starts");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }
    assert!(outputs[0] == outputs[1]);
    assert!(picture.rgb.iter().map(|c| to_u8(*c)).any(|c| c > 200));
}

#[test]
fn images_along_a_path_are_those_drawn_alone() {
    let scratch = Scratch::new();
    let (scene, _) = prepared(&scratch);
    let camera = scratch.path("path.json");
    let view = |time: f64, x: f64| {
        format!(
            r#"{{"time": {time}, "type": "pinhole", "position": [0.1, 0, 0], "look_at": [{x}, 0.2, 1], "fov_y_degrees": 20, "aspect": 1.5}}"#
        )
    };
    std::fs::write(&camera, format!(r#"{{"views": [{}, {}]}}"#, view(0.0, -3.0), view(7.0, 3.0))).expect("writable");
    let size = ["--size", "60x40", "--emit", "rgb,depth"];
    let out = scratch.path("all");
    let output = render(&scene, &camera, &out, &[&size[..], &["--times", "0,1,2,3,4,5,6,7"]].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let window = |out: &Path| json(&out.join("run.json"))["work"]["render.window"].clone();
    // Out of 4000.
    assert!(window(&out)["avoided"].as_u64().is_some_and(|n| n > 2000), "{}", window(&out));
    let all = files(&out);
    for time in 0..8 {
        let out = scratch.path(&time.to_string());
        let output = render(&scene, &camera, &out, &[&size[..], &["--times", &time.to_string()]].concat());
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        assert_eq!(window(&out)["avoided"], 0);
        let alone = files(&out);
        assert_eq!(alone.len() * 8, all.len());
        for (name, bytes) in &alone {
            assert!(*bytes == all[&name.replace("000000", &format!("{time:06}"))], "{name}, {time}");
        }
    }
}

#[test]
fn a_path_of_a_camera_is_drawn_from_its_first_time_to_its_last() {
    let scratch = Scratch::new();
    let (scene, _) = prepared(&scratch);
    let camera = scratch.path("path.json");
    let views = [(1, -1), (2, 1)].map(|(time, x)| {
        format!(
            r#"{{"time": {time}, "type": "pinhole", "position": [{x}, 0, -3], "fov_y_degrees": 45, "aspect": 1.5}}"#
        )
    });
    std::fs::write(&camera, format!(r#"{{"views": [{}]}}"#, views.join(", "))).expect("writable");
    let drawn = |name: &str, more: &[&str]| {
        let out = scratch.path(name);
        let output = render(&scene, &camera, &out, &[&["--size", "30x20"], more].concat());
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        files(&out)
    };
    let all = drawn("all", &["--fps", "4"]);
    assert_eq!((all.len(), drawn("own", &[]).len()), (5, 25));
    assert!(all == drawn("times", &["--times", "1,1.25,1.5,1.75,2"]));
    for (out, more, expected) in [
        ("before", &["--times=-2,1.5"][..], "--times: -2 s lies outside the path of --camera (1 s to 2 s)"),
        ("after", &["--times", "1.5,3"], "--times: 3 s lies outside"),
        ("one.png", &[], "expected a folder or a video for 25 images"),
    ] {
        let more = [&["--size", "30x20"], more].concat();
        let text = fails(&render(&scene, &camera, &scratch.path(out), &more), 2);
        assert!(text.contains(expected) && !scratch.path(out).exists(), "{text}");
    }
}

#[test]
fn images_of_another_shape_than_the_picture_are_told() {
    let scratch = Scratch::new();
    let (scene, camera) = prepared(&scratch);
    let (clip, out) = (scratch.clip("clip", 2, 40, 24), scratch.path("run"));
    for (size, line) in [
        ("60x60", Some("images of 60×60 (1.00:1) show a picture of 1.50:1: its pixels are not square")),
        ("60x40", None),
        ("61x40", None),
    ] {
        let output = render(&scene, &camera, &scratch.path("out"), &["--size", size]);
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(line.map_or(!text.contains("show a picture"), |line| text.contains(line)), "{size}: {text}");
    }
    for (size, told) in [("64x64", true), ("80x48", false)] {
        let text = |command: &str, input: &Path, out: &Path, more: &[&str]| {
            let mut words = vec![command.as_ref(), input.as_os_str(), "--out".as_ref(), out.as_os_str()];
            words.extend(["--size", size].iter().chain(more).map(|word| std::ffi::OsStr::new(*word)));
            let output = run(words);
            assert!(output.status.success());
            String::from_utf8_lossy(&output.stderr).contains("show a picture of 1.67:1")
        };
        assert_eq!(text("run", &clip, &out, &["--overwrite"]), told);
        assert_eq!(text("render", &out, &scratch.path("drawn"), &[]), told);
    }
}

#[test]
fn a_ply_file_exported_again_is_the_same_file() {
    let scratch = Scratch::new();
    let (scene, _) = prepared(&scratch);
    for (format, expected) in [
        ("ply", formats::ply::write(&still()).bytes),
        ("splat", splat()),
        ("spz", formats::spz::write(&still(), formats::SpzVersion::V3).bytes),
    ] {
        for out in [format!("again.{format}"), format!("folder-{format}")] {
            let path = scratch.path(&out);
            let output =
                command().arg("export").arg(&scene).arg("--out").arg(&path).args(["--format", format]).output();
            let output = output.expect("the program starts");
            assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
            let file = if path.is_dir() { path.join(format!("000000.{format}")) } else { path };
            assert!(std::fs::read(&file).expect("readable") == expected, "{out}");
        }
    }
    let output = run([Path::new("inspect"), &scene, Path::new("--json"), &scratch.path("found.json")]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let found = json(&scratch.path("found.json"));
    assert_eq!((&found["kind"], &found["format"]), (&"still scene".into(), &"PLY".into()));
    assert_eq!((&found["gaussians"], &found["harmonics_degree"]), (&500.into(), &3.into()));
}

fn splat() -> Vec<u8> {
    let workers = Workers::new(Level::scalar(), 1).expect("one thread");
    formats::splat::write(&Drawable::new(still(), &workers).expect("even arrays")).bytes
}

#[test]
fn what_a_ply_file_does_not_have_is_said_and_nothing_written() {
    let scratch = Scratch::new();
    let (scene, camera) = prepared(&scratch);
    let out = scratch.path("out");
    let text = fails(&render(&scene, &camera, &out, &[]), 2);
    assert!(text.contains("--size model: expected WIDTHxHEIGHT") && text.contains("scene.ply"), "{text}");
    let source = command().arg("render").arg(&scene).arg("--out").arg(&out).args(["--size", "source"]).output();
    let text = fails(&source.expect("the program starts"), 2);
    assert!(text.contains("--size source: expected WIDTHxHEIGHT"), "{text}");
    std::fs::write(&camera, r#"{"type": "canonical"}"#).expect("writable");
    let text = fails(&render(&scene, &camera, &scratch.path("other"), &["--size", "9x6"]), 1);
    assert!(text.contains("found canonical"), "{text}");
    let track = ["track", "--at", "0", "--point", "1,1"].map(std::ffi::OsStr::new);
    let text = fails(&run([&track[..], &[scene.as_os_str()]].concat()), 1);
    assert!(text.contains("expected a scene in time, found a still one (PLY)"), "{text}");
    for (more, expected) in [
        (&["--format", "ply", "--times", "0"][..], "which has no time"),
        (&["--format", "ssz"], "--format ssz: expected the format of a still scene"),
    ] {
        let output = command().arg("export").arg(&scene).arg("--out").arg(&out).args(more).output();
        let text = fails(&output.expect("the program starts"), 2);
        assert!(text.contains(expected), "{text}");
    }
    let mut short = formats::ply::write(&still()).bytes;
    short.truncate(short.len() - 1);
    std::fs::write(&scene, short).expect("writable");
    for name in ["render", "inspect", "export", "track", "view"] {
        let mut command = command();
        command.arg(name).arg(&scene);
        match name {
            "render" => command.arg("--out").arg(&out),
            "export" => command.args(["--format", "ply", "--out"]).arg(&out),
            "track" => command.args(["--at", "0", "--point", "1,1"]),
            _ => &mut command,
        };
        let text = fails(&command.output().expect("the program starts"), 1);
        assert!(text.contains("scene.ply: element vertex: expected 500 of 248 bytes each"), "{name}: {text}");
    }
    assert!(!out.exists());
}
