//! Scenes in the formats of others, and scenes that have been on disk.

use std::path::Path;

use streamsplat::export;
use streamsplat::render::Snapshot;
use streamsplat::scene::{Scene, SceneWriter};
use streamsplat::stream::{Interval, ModelSource, Workers};
use streamsplat::{Engine, Frame, Settings};

use crate::support::{Scratch, command, fails, files, model, run_ok};

fn export(scene: &Path, out: &Path, more: &[&str]) -> std::process::Output {
    command().arg("export").arg(scene).arg("--out").arg(out).args(more).output().expect("the program starts")
}

fn export_ok(scene: &Path, out: &Path, more: &[&str]) {
    let output = export(scene, out, more);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// A short stream, as it comes out of the engine.
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
        let exported = Snapshot::exported(&read, time, &workers).expect("inside");
        assert!(exported.mean.iter().zip(&snapshot.mean).all(|(a, b)| a[1..] == b[1..]));
        // The picture's shape: 80 by 48.
        let wide = |of: &Snapshot| of.mean.iter().map(|m| m[0].abs()).fold(0.0, f32::max);
        assert!((wide(&exported) / wide(&snapshot) - 5.0 / 3.0).abs() < 1e-6, "{time}");
        expected.push(exported);
    }
    assert_ne!(expected[1], expected[3]);

    let list = ["--times", "0,0.03,0.1,0.15,0.2,0.29", "--threads", "3", "--format"];
    for (format, write) in
        [("ply", export::ply as fn(&Snapshot) -> Vec<u8>), ("splat", export::splat), ("spz", export::spz)]
    {
        let out = scratch.path(format);
        export_ok(&folder, &out, &[&list[..], &[format]].concat());
        let found = files(&out);
        assert_eq!(found.len(), times.len());
        for (index, snapshot) in expected.iter().enumerate() {
            assert!(found[&format!("{index:06}.{format}")] == write(snapshot), "{format} {index}");
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
    let (run, exported) = (files(&out), files(&again));
    assert_eq!(exported.len(), 3);
    for (name, bytes) in &exported {
        assert!(&run[&format!("ply/{name}")] == bytes, "{name}");
    }
    assert!(!run.keys().any(|name| name.starts_with("frames/")));
    let output = command().arg("verify").arg(&out).output().expect("the program starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    // One time may go to one file.
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
        (&["--format", "ply", "--times", "1,0"], "--times 1,0: expected ascending times"),
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
