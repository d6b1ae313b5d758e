//! A scene as one compressed file.

use std::path::Path;

use streamsplat::scene::Scene;

use crate::support::{Scratch, command, fails, files, json, run, run_ok};

fn ok(command: &mut std::process::Command) -> String {
    let output = command.output().expect("the program starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

fn export(scene: &Path, out: &Path, more: &[&str]) -> std::process::Command {
    let mut command = command();
    command.arg("export").arg(scene).arg("--out").arg(out).args(["--format", "ssz"]).args(more);
    command
}

#[test]
fn every_command_reads_a_container_and_its_bytes_do_not_depend_on_threads() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 5, 40, 24);
    let (scene, container, again) = (scratch.path("scene"), scratch.path("scene.ssz"), scratch.path("again.ssz"));
    run_ok(&clip, &scene, &["--quiet", "--gap", "2"]);
    ok(&mut export(&scene, &container, &["--threads", "1", "--isa", "scalar"]));
    ok(&mut export(&scene, &again, &["--threads", "3"]));
    let bytes = std::fs::read(&container).expect("readable");
    assert!(bytes == std::fs::read(&again).expect("readable"));

    ok(command().arg("inspect").arg(&container).arg("--json").arg(scratch.path("found.json")));
    let found = json(&scratch.path("found.json"));
    assert_eq!((&found["kind"], &found["intervals"]), (&"scene".into(), &3.into()));
    assert_eq!(found["format"], "streamsplat-scene-container version 1");

    let (raw, small) = (scratch.path("raw"), scratch.path("small"));
    for (scene, out) in [(&scene, &raw), (&container, &small)] {
        ok(command().arg("render").arg(scene).arg("--out").arg(out).arg("--quiet"));
    }
    assert_eq!(files(&raw).keys().collect::<Vec<_>>(), files(&small).keys().collect::<Vec<_>>());
    ok(command().arg("verify").arg(&small));

    // The same identity under the same point, on nearly the same path.
    let track = |scene: &Path| {
        let text = ok(command().arg("track").arg(scene).args(["--at", "0.0417", "--point", "20,12"]));
        let rows =
            text.lines().skip(1).map(|line| line.split(',').map(|x| x.parse::<f64>().expect("a number")).collect());
        rows.collect::<Vec<Vec<f64>>>()
    };
    let (a, b) = (track(&scene), track(&container));
    assert!(a.len() > 1 && a.len() == b.len());
    for (a, b) in a.iter().zip(&b) {
        assert_eq!((a[0], a[1]), (b[0], b[1]));
        assert!((a[2] - b[2]).abs() < 0.05 && (a[3] - b[3]).abs() < 0.05, "{a:?} {b:?}");
    }

    // Exporting a container produces the container again.
    ok(&mut export(&container, &again, &[]));
    let (a, b) = (Scene::open(&container).expect("valid"), Scene::open(&again).expect("valid"));
    assert_eq!(a.index().intervals, b.index().intervals);
}

#[test]
fn what_cannot_be_a_container_is_said() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 2, 40, 24);
    let (scene, container) = (scratch.path("scene"), scratch.path("scene.ssz"));
    run_ok(&clip, &scene, &["--quiet"]);
    let text = fails(&export(&scene, &container, &["--times", "0"]).output().expect("starts"), 2);
    assert!(text.contains("--format ssz holds the whole scene"), "{text}");
    let text = fails(&export(&scene, &scene, &[]).output().expect("starts"), 2);
    assert!(text.contains("expected a file's name"), "{text}");
    assert!(!container.exists());
    ok(&mut export(&scene, &container, &[]));
    let bytes = std::fs::read(&container).expect("readable");
    std::fs::write(&container, &bytes[..bytes.len() - 7]).expect("writable");
    let arguments = ["inspect".as_ref(), container.as_os_str()];
    let text = fails(&run(arguments), 1);
    assert!(text.contains("scene.ssz: trailer: expected"), "{text}");
}
