//! Scenes in the formats of other programs, and scenes that have been on disk.

use std::path::Path;

use streamsplat::formats::{FORMATS, Options};
use streamsplat::scene::{Scene, SceneWriter};
use streamsplat::stream::{Interval, ModelSource, Snapshot, Workers};
use streamsplat::{Engine, Frame, Settings};

use crate::support::{Scratch, command, fails, files, model, run_ok};

fn export(scene: &Path, out: &Path, more: &[&str]) -> std::process::Output {
    command().arg("export").arg(scene).arg("--out").arg(out).args(more).output().expect("the program starts")
}

fn export_ok(scene: &Path, out: &Path, more: &[&str]) {
    let output = export(scene, out, more);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// Returns a short stream as the engine returns it.
fn live() -> (Vec<Interval>, Workers) {
    let settings = Settings::with_model(ModelSource::File { checkpoint: model(), dinov2: None });
    let mut engine = Engine::new(settings).expect("the small model");
    let (width, height) = (40, 24);
    let frame = |shift: usize| {
        let pixel = |i: usize| ((i % width + 3 * shift) / 7 % 2) as f32 * 0.75 + (i / width) as f32 / 100.0;
        Frame { width, height, rgb: (0..3 * width * height).map(pixel).collect(), depth: None }
    };
    let intervals = (0..4).map(|k| engine.push(frame(k), k as f64 / 10.0).expect("a sound frame")).collect();
    (intervals, engine.workers().clone())
}

#[cfg(unix)]
#[test]
fn an_export_that_is_stopped_fails_as_such() {
    let scratch = Scratch::new();
    let (scene, out) = (scratch.path("scene"), scratch.path("out"));
    run_ok(&scratch.clip("clip", 2, 40, 24), &scene, &["--quiet"]);
    let mut export = command();
    export.arg("export").arg(&scene).arg("--out").arg(&out).args(["--format", "ply", "--times", "0:0.04:20000"]);
    let mut export = export.stderr(std::process::Stdio::null()).spawn().expect("the program starts");
    let end = std::time::Instant::now() + std::time::Duration::from_secs(60);
    while !out.join("000000.ply").exists() {
        assert!(std::time::Instant::now() < end, "no file");
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
    let stopped = std::process::Command::new("kill").args(["-TERM", &export.id().to_string()]).status();
    assert!(stopped.expect("kill starts").success());
    assert_eq!(export.wait().expect("it ends").code(), Some(130));
}

#[test]
fn a_scene_read_back_exports_what_the_live_one_shows() {
    let scratch = Scratch::new();
    let (intervals, workers) = live();
    let folder = scratch.path("scene");
    let mut writer = SceneWriter::create(&folder, 10.0).expect("writable");
    for interval in &intervals {
        writer.push(interval).expect("writable");
    }
    writer.finish().expect("writable");

    let scene = Scene::open(&folder).expect("just written");
    let times = [0.0, 0.03, 0.1, 0.15, 0.2, 0.29];
    let mut expected = Vec::new();
    for time in times {
        let place = scene.find(time).expect("inside");
        let snapshot = Snapshot::of(&intervals[place], time, &workers).expect("inside");
        let read = scene.interval(place).expect("just written");
        assert_eq!(Snapshot::of(&read, time, &workers).expect("inside"), snapshot, "{time}");
        assert!(!snapshot.mean.is_empty(), "{time}");
        let exported = Snapshot::square(&read, time, &workers).expect("inside");
        assert!(exported.mean.iter().zip(&snapshot.mean).all(|(a, b)| a[1] == b[1]));
        // The picture's shape: 80 by 48.
        let wide = |of: &Snapshot, axis: usize| of.mean.iter().map(move |m| m[axis].abs()).fold(0.0, f32::max);
        for axis in [0, 2] {
            assert!((wide(&exported, axis) / wide(&snapshot, axis) - 5.0 / 3.0).abs() < 1e-6, "{time}");
        }
        expected.push(exported);
    }
    assert_ne!(expected[1], expected[3]);

    let list = ["--times", "0,0.03,0.1,0.15,0.2,0.29", "--threads", "3", "--format"];
    // The source's own view is next to the files of each export.
    for format in &FORMATS {
        let (option, ending) = (format.option, format.ending);
        let out = scratch.path(option);
        export_ok(&folder, &out, &[&list[..], &[option]].concat());
        let found = files(&out);
        assert_eq!(found.len(), times.len() + 1);
        assert!(found.contains_key("source.camera.json"));
        for (index, snapshot) in expected.iter().enumerate() {
            let written = (format.snapshot)(snapshot, &Options::default()).bytes;
            assert!(found[&format!("{index:06}.{ending}")] == written, "{option} {index}");
        }
    }
}

#[test]
fn a_run_emits_the_files_that_its_scene_exports() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 3, 40, 24);
    let (out, again) = (scratch.path("out"), scratch.path("again"));
    run_ok(&clip, &out, &["--quiet", "--gap", "2", "--emit", "ply,scene"]);
    export_ok(&out, &again, &["--format", "ply"]);
    let (run, mut exported) = (files(&out), files(&again));
    assert!(exported.remove("source.camera.json").is_some());
    assert_eq!(exported.len(), 3);
    for (name, bytes) in &exported {
        assert!(&run[&format!("ply/{name}")] == bytes, "{name}");
    }
    assert!(!run.keys().any(|name| name.starts_with("frames/")));
    let output = command().arg("verify").arg(&out).output().expect("the program starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    // A single time may go to one file.
    let one = scratch.path("one.ply");
    export_ok(&out, &one, &["--format", "ply", "--times", "0"]);
    assert!(std::fs::read(&one).expect("readable") == exported["000000.ply"]);
}

#[test]
fn what_cannot_be_exported_is_said_and_nothing_written() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 3, 40, 24);
    let scene = scratch.path("scene");
    run_ok(&clip, &scene, &["--quiet"]);
    let out = scratch.path("out");
    for (more, expected) in [
        (&["--format", "obj"][..], "--format obj: expected ply, compressed-ply, spz, sog, glb, splat or ssz"),
        (&["--format", "ply", "--times", "0,9"], "--times: time 9 s: expected one between 0 s and"),
        (&["--format", "ply", "--times", "1,0"], "--times: expected ascending times, found \"1,0\""),
        (&["--format", "ply", "--fps", "0"], "--fps: expected a number above 0"),
        (&[], "--format"),
    ] {
        let text = fails(&export(&scene, &out, more), 2);
        assert!(text.contains(expected), "{more:?}: {text}");
        assert!(!out.exists(), "{more:?}");
    }
    let one = scratch.path("one.ply");
    let text = fails(&export(&scene, &one, &["--format", "ply"]), 2);
    assert!(text.contains("expected one time for one file, found 3") && !one.exists(), "{text}");
    let text = fails(&export(&scratch.path("absent"), &out, &["--format", "ply"]), 1);
    assert!(text.contains("absent"), "{text}");

    export_ok(&scene, &out, &["--format", "ply"]);
    export_ok(&scene, &out, &["--format", "ply"]);
    let text = fails(&export(&scene, &out, &["--format", "ply", "--times", "0,0.01"]), 1);
    assert!(text.contains("000002.ply: another export's file is in the way"), "{text}");
}

#[test]
fn a_camera_sees_an_exported_file_as_it_sees_the_scene() {
    let scratch = Scratch::new();
    let camera = scratch.path("camera.json");
    // Wide, upright, and in the model's shape. The last camera is turned and orthographic.
    for (width, height) in [(80, 34), (30, 54), (80, 48)] {
        let clip = scratch.clip(&format!("clip{width}"), 2, width, height);
        let (out, files) = (scratch.path(&format!("out{width}")), scratch.path(&format!("ply{width}")));
        run_ok(&clip, &out, &["--quiet", "--gap", "1", "--emit", "scene"]);
        export_ok(&out, &files, &["--format", "ply", "--times", "0.02"]);
        // Small enough that no part of the scene is drawn larger than at the model's size and widened.
        let size = format!("{}x{}", width / 2, height / 2);
        let aspect = f64::from(width) / f64::from(height);
        for (name, view) in [
            (
                "front",
                format!(r#"{{"type": "pinhole", "position": [0, 0, -4], "fov_y_degrees": 40, "aspect": {aspect}}}"#),
            ),
            (
                "side",
                format!(
                    r#"{{"type": "pinhole", "position": [-2.1, -0.9, -3], "look_at": [0, 0, 1], "fov_y_degrees": 45, "aspect": {aspect}, "units": "square"}}"#
                ),
            ),
            (
                "parallel",
                r#"{"type": "orthographic", "position": [6, 3, -9], "look_at": [0, 0, 1], "half_extent": [2.4, 2.4]}"#
                    .to_owned(),
            ),
        ] {
            std::fs::write(&camera, view).expect("writable");
            let drawn = |scene: &Path, name: String, more: &[&str]| {
                let image = scratch.path(&name);
                let mut command = command();
                command.arg("render").arg(scene).arg("--camera").arg(&camera).arg("--out").arg(&image);
                let output = command.args(["--size", &size]).args(more).output().expect("the program starts");
                assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
                image::open(image).expect("an image").into_rgb8().into_raw()
            };
            let scene = drawn(&out, format!("{name}{width}-scene.png"), &["--times", "0.02"]);
            let file = drawn(&files.join("000000.ply"), format!("{name}{width}-file.png"), &[]);
            let square: f64 = scene.iter().zip(&file).map(|(a, b)| f64::from(a.abs_diff(*b)).powi(2)).sum();
            let decibels = 20.0 * 255f64.log10() - 10.0 * (square / scene.len() as f64).max(1e-9).log10();
            println!("{width}x{height} {name}: {decibels:.1} dB");
            assert!(decibels > 50.0, "{width}x{height} {name}: {decibels:.1} dB");
            assert!(scene.iter().max() > scene.iter().min(), "something is seen");
        }
    }
}

#[test]
fn an_exported_file_is_rendered_from_where_its_scene_was_filmed() {
    let scratch = Scratch::new();
    // Letterboxed above and below, at the sides, and not at all.
    for (width, height) in [(80, 34), (30, 54), (80, 48)] {
        let clip = scratch.clip(&format!("clip{width}x{height}"), 2, width, height);
        let scene = scratch.path(&format!("scene{width}x{height}"));
        run_ok(&clip, &scene, &["--quiet", "--gap", "1", "--emit", "scene"]);
        let (folder, one) =
            (scratch.path(&format!("f{width}x{height}")), scratch.path(&format!("{width}x{height}.ply")));
        export_ok(&scene, &folder, &["--format", "ply", "--times", "0,0.02"]);
        export_ok(&scene, &one, &["--times", "0.02"]);
        let drawn = |of: &Path, name: &str, more: &[&str]| {
            let image = scratch.path(name);
            let output = command().arg("render").arg(of).arg("--out").arg(&image).args(more).output();
            let output = output.expect("the program starts");
            assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
            let image = image::open(image).expect("an image").into_rgb8();
            (image.dimensions(), image.into_raw(), String::from_utf8_lossy(&output.stderr).into_owned())
        };
        let (size, scene, _) = drawn(&scene, "scene.png", &["--times", "0.02", "--size", "source"]);
        for file in [folder.join("000001.ply"), one.clone()] {
            let (found, image, said) = drawn(&file, "file.png", &[]);
            assert_eq!(found, size);
            assert!(said.contains(": seen from ") && said.contains(".camera.json"), "{said}");
            let square: f64 = scene.iter().zip(&image).map(|(a, b)| f64::from(a.abs_diff(*b)).powi(2)).sum();
            let decibels = 20.0 * 255f64.log10() - 10.0 * (square / scene.len() as f64).max(1e-9).log10();
            println!("{width}x{height}: {decibels:.1} dB");
            // The upright clip's source is larger than the model's input: the scene is widened, which a file cannot
            // express.
            assert!(decibels > 40.0, "{width}x{height}: {decibels:.1} dB");
        }
        // Options select other views, and a rendering can be repeated.
        let (found, _, said) = drawn(&one, "turned.png", &["--turntable", "0.04", "--size", "32x24"]);
        assert!(found == (32, 24) && !said.contains("seen from"), "{said}");
        let out = scratch.path("out");
        let output = command().arg("render").arg(&one).arg("--out").arg(&out).output().expect("the program starts");
        assert!(output.status.success());
        assert!(
            crate::support::json(&out.join("run.json"))["options"]["view"]["camera"]
                .as_str()
                .is_some_and(|c| c.ends_with(".camera.json"))
        );
        let output = command().arg("verify").arg(&out).output().expect("the program starts");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        std::fs::remove_dir_all(&out).expect("there");
    }
}

#[test]
fn scenes_one_after_another_become_one() {
    let scratch = Scratch::new();
    let [first, second] = ["first", "second"].map(|name| {
        let out = scratch.path(name);
        run_ok(&scratch.clip(&format!("{name}-clip"), 5, 80, 48), &out, &["--quiet", "--gap", "2", "--emit", "scene"]);
        out
    });
    let (one, whole) = (scratch.path("one.ssz"), scratch.path("whole.ssz"));
    export_ok(&first, &one, &[]);
    export_ok(&first, &whole, &[second.to_str().expect("UTF-8")]);
    let (part, whole) = (Scene::open(&one).expect("written"), Scene::open(&whole).expect("written"));
    let (n, fps) = (part.index().intervals.len(), part.index().fps);
    assert_eq!(whole.index().intervals.len(), 2 * n);
    let (frames, own) = (whole.index().frames().expect("few"), part.index().frames().expect("few"));
    assert_eq!((own.len(), frames.len()), (5, 10));
    assert!(frames.iter().enumerate().all(|(i, time)| (time - i as f64 / fps).abs() < 1e-9), "{frames:?}");
    let mut known = 0;
    for i in 0..n {
        let (expected, before) = (part.interval(i).expect("written"), whole.interval(i).expect("written"));
        assert_eq!(before.gaussians, expected.gaussians, "the first is as it is alone");
        known = known.max(before.gaussians.identity.iter().copied().max().unwrap_or_default());
    }
    for i in 0..n {
        let (expected, after) = (part.interval(i).expect("written"), whole.interval(n + i).expect("written"));
        assert_eq!(after.gaussians.mean, expected.gaussians.mean);
        assert_eq!(after.index, expected.index + part.interval(n - 1).expect("written").index + 1);
        assert!(after.gaussians.identity.iter().all(|&identity| identity > known), "no identity is used twice");
        assert!(after.gaussians.birth.iter().all(|&birth| birth > expected.index.min(1)));
    }
    // Only containers hold several scenes, and only with one rate.
    let more = second.to_str().expect("UTF-8");
    let text = fails(&export(&first, &scratch.path("x.ply"), &[more, "--times", "0"]), 2);
    assert!(text.contains("second: expected one scene, or --format ssz for several in time"), "{text}");
    let other = scratch.path("other");
    run_ok(&scratch.clip("other-clip", 3, 80, 48), &other, &["--quiet", "--gap", "2", "--emit", "scene", "--fps", "7"]);
    let text = fails(&export(&first, &scratch.path("x.ssz"), &[other.to_str().expect("UTF-8")]), 2);
    assert!(text.contains("other: expected 24 frames a second as before, found 7"), "{text}");
    assert!(!scratch.path("x.ssz").exists());
}
