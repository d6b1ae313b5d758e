//! Splat files of other programs: content that is read, assumed and left out, and the notes on it.

use std::path::Path;
use std::process::Output;

use streamsplat::formats::{self, SpzVersion};
use streamsplat::still::Still;

use crate::still::{prepared, still};
use crate::support::{Scratch, command, fails, json};

/// Returns standard error of a command that succeeds.
fn said(arguments: &[&str]) -> String {
    let output: Output = command().args(arguments).output().expect("the program starts");
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{arguments:?}: {text}");
    text
}

fn text(path: &Path) -> &str {
    path.to_str().expect("UTF-8")
}

fn picture(scene: &Path, camera: &Path, out: &Path, more: &[&str]) -> (Vec<u8>, String) {
    let base = ["render", text(scene), "--camera", text(camera), "--size", "90x60", "-o", text(out)];
    let lines = said(&[&base[..], more].concat());
    (std::fs::read(out).expect("an image"), lines)
}

/// Writes a file of version 4 without a record of its axes, which are RDF.
fn silent(still: &Still) -> Vec<u8> {
    let file = formats::spz::write(still, SpzVersion::V4).bytes;
    let table = u32::from_le_bytes(file[16..20].try_into().expect("four bytes")) as usize;
    let mut head = file[..32].to_vec();
    head[14] &= !2;
    head[16..20].copy_from_slice(&32_u32.to_le_bytes());
    [&head, &file[table..]].concat()
}

#[test]
fn axes_that_a_file_does_not_say_are_told_and_can_be_given() {
    let scratch = Scratch::new();
    let (_, camera) = prepared(&scratch);
    let (stated, unsaid) = (scratch.path("stated.spz"), scratch.path("unsaid.spz"));
    std::fs::write(&stated, formats::spz::write(&still(), SpzVersion::V4).bytes).expect("writable");
    std::fs::write(&unsaid, silent(&still())).expect("writable");
    let out = scratch.path("a.png");
    let (right, lines) = picture(&stated, &camera, &out, &[]);
    assert!(!lines.contains("axes"), "{lines}");
    let (turned, lines) = picture(&unsaid, &camera, &out, &[]);
    assert!(lines.contains("unsaid.spz: the file does not say its axes: taken as RUB"), "{lines}");
    assert!(turned != right);
    let (told, lines) = picture(&unsaid, &camera, &out, &["--axes", "rdf"]);
    assert!(told == right && !lines.contains("axes"), "{lines}");
    // The option is part of the record, and other commands support it.
    let folder = scratch.path("folder");
    said(&["render", text(&unsaid), "--axes", "rdf", "-o", text(&folder), "--size", "9x6"]);
    assert_eq!(json(&folder.join("run.json"))["options"]["axes"], "rdf");
    said(&["verify", text(&folder)]);
    let ply = scratch.path("a.ply");
    said(&["export", text(&unsaid), "--axes", "RDF", "-o", text(&ply)]);
    assert!(picture(&ply, &camera, &out, &[]).0 == right);
    let found = scratch.path("found.json");
    for (more, axes, assumed) in [(&[][..], "RUB", true), (&["--axes", "luf"], "LUF", false)] {
        said(&[&["inspect", text(&unsaid), "--json", text(&found)][..], more].concat());
        let found = json(&found);
        assert_eq!((&found["axes"], &found["axes_assumed"]), (&axes.into(), &assumed.into()));
    }
    let page = scratch.path("page.html");
    assert!(said(&["view", text(&unsaid), "--html", text(&page)]).contains("taken as RUB"));
    let output = command().args(["inspect", text(&unsaid), "--axes", "abc"]).output().expect("the program starts");
    assert!(fails(&output, 2).contains("--axes: expected LDB, RDB"));
}

#[test]
fn spz_is_written_in_version_3_or_4() {
    let scratch = Scratch::new();
    let (scene, _) = prepared(&scratch);
    let out = scratch.path("a.spz");
    for (more, version) in [
        (&[][..], SpzVersion::V3),
        (&["--spz-version", "3"], SpzVersion::V3),
        (&["--spz-version", "4"], SpzVersion::V4),
    ] {
        said(&[&["export", text(&scene), "-o", text(&out)][..], more].concat());
        let expected = formats::spz::write(&still(), version).bytes;
        assert!(std::fs::read(&out).expect("written") == expected, "{more:?}");
    }
    for (more, expected) in [
        (["--spz-version", "2", "--format", "spz"], "--spz-version: expected 3 or 4, found 2"),
        (["--spz-version", "3", "--format", "sog"], "--spz-version 3: expected --format spz"),
    ] {
        let output = command().args(["export", text(&scene), "-o", text(&scratch.path("b"))]).args(more).output();
        assert!(fails(&output.expect("the program starts"), 2).contains(expected));
    }
}

#[test]
fn a_mark_of_antialiased_training_is_used_shown_and_can_be_overruled() {
    let scratch = Scratch::new();
    let (scene, camera) = prepared(&scratch);
    let mut thin = still();
    thin.log_scale.iter_mut().flatten().for_each(|s| *s -= 2.0);
    let out = scratch.path("a.png");
    std::fs::write(&scene, formats::ply::write(&thin).bytes).expect("writable");
    let (plain, faint) =
        (picture(&scene, &camera, &out, &[]).0, picture(&scene, &camera, &out, &["--antialias", "on"]).0);
    assert!(plain != faint && picture(&scene, &camera, &out, &["--antialias"]).0 == faint);
    thin.about.antialiased = true;
    std::fs::write(&scene, formats::ply::write(&thin).bytes).expect("writable");
    for (more, expected) in [(&[][..], &faint), (&["--antialias", "auto"], &faint), (&["--antialias", "off"], &plain)] {
        assert!(picture(&scene, &camera, &out, more).0 == *expected, "{more:?}");
    }
    let found = scratch.path("found.json");
    said(&["inspect", text(&scene), "--json", text(&found)]);
    assert_eq!(json(&found)["trained_with_antialiasing"], true);
    for (ending, kept) in [("spz", true), ("sog", true), ("compressed.ply", true), ("glb", false), ("splat", false)] {
        let path = scratch.path(&format!("b.{ending}"));
        let lines = said(&["export", text(&scene), "-o", text(&path)]);
        assert_eq!(lines.contains("has no mark for scenes trained with anti-aliasing"), !kept, "{ending}: {lines}");
        said(&["inspect", text(&path), "--json", text(&found)]);
        assert_eq!(json(&found)["trained_with_antialiasing"], kept, "{ending}");
    }
    let output = command().args(["render", text(&scene), "-o", text(&out), "--antialias", "some"]).output();
    assert!(fails(&output.expect("the program starts"), 2).contains("expected auto, on or off"));
}

#[test]
fn a_picture_of_nothing_and_what_is_not_drawn_are_told() {
    let scratch = Scratch::new();
    let (scene, camera) = prepared(&scratch);
    let out = scratch.path("a.png");
    let lines = picture(&scene, &camera, &out, &[]).1;
    assert!(!lines.contains("scene.ply"), "{lines}");
    let mut spoiled = still();
    spoiled.logit[3] = f32::NAN;
    spoiled.logit[4] = f32::INFINITY;
    spoiled.log_scale[5][2] = f32::NEG_INFINITY;
    std::fs::write(&scene, formats::ply::write(&spoiled).bytes).expect("writable");
    let lines = picture(&scene, &camera, &out, &[]).1;
    assert!(lines.contains("scene.ply: 1 of 500 Gaussians not drawn: numbers that are not finite"), "{lines}");
    let packed = scratch.path("b.spz");
    let lines = said(&["export", text(&scene), "-o", text(&packed)]);
    assert!(lines.contains("b.spz: 1 of 500 Gaussians left out: 1 with numbers that are not finite"), "{lines}");
    // A camera that looks away from the scene.
    std::fs::write(
        &camera,
        r#"{"type": "pinhole", "position": [0, 0, -3], "look_at": [0, 0, -9], "fov_y_degrees": 45, "aspect": 1.5}"#,
    )
    .expect("writable");
    let lines = picture(&scene, &camera, &out, &[]).1;
    assert!(lines.contains("scene.ply: nothing drawn: the camera sees none of 500 Gaussians"), "{lines}");
    assert_eq!(
        said(&["render", text(&scene), "--camera", text(&camera), "--size", "9x6", "-o", text(&out), "--quiet"]),
        ""
    );
}

#[test]
fn coordinates_of_maps_are_drawn_as_those_near_zero() {
    let scratch = Scratch::new();
    let (scene, camera) = prepared(&scratch);
    let (out, far_camera) = (scratch.path("a.png"), scratch.path("far.json"));
    let near = picture(&scene, &camera, &out, &[]).0;
    let mut far = still();
    far.about.offset = [431_250.0, 5_411_800.0, 312.0];
    std::fs::write(&scene, formats::ply::write(&far).bytes).expect("writable");
    std::fs::write(
        &far_camera,
        r#"{"type": "pinhole", "position": [431250.3, 5411799.8, 309.0], "look_at": [431250, 5411800, 312.5], "fov_y_degrees": 45, "aspect": 1.5}"#,
    )
    .expect("writable");
    let (found, lines) = picture(&scene, &far_camera, &out, &[]);
    assert!(lines.contains("scene.ply: coordinates are kept relative to (4312"), "{lines}");
    let [a, b] = [&near, &found].map(|bytes| image::load_from_memory(bytes).expect("an image").into_rgb8());
    let worst = a.as_raw().iter().zip(b.as_raw()).map(|(a, b)| a.abs_diff(*b)).max();
    assert!(worst <= Some(1), "{worst:?}");
    let found = scratch.path("found.json");
    said(&["inspect", text(&scene), "--json", text(&found)]);
    assert!(json(&found)["most_of_it"]["least"][0].as_f64().is_some_and(|x| x > 4e5));
}

#[test]
fn bounds_far_from_zero_keep_the_digits_that_differ() {
    let scratch = Scratch::new();
    let path = scratch.path("map.ply");
    let mut scene = still();
    scene.mean.iter_mut().for_each(|mean| mean[0] += 431_250.0);
    std::fs::write(&path, formats::ply::write(&scene).bytes).expect("writable");
    let output = command().arg("inspect").arg(&path).output().expect("the program starts");
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let (_, bounds) = text.split_once("most_of_it:").expect("bounds");
    let end = |name: &str| -> f64 {
        let (_, values) = bounds.split_once(&format!("{name}: [")).expect("a list");
        values.split(',').next().and_then(|first| first.trim().parse().ok()).expect("a number")
    };
    assert!(end("greatest") > end("least") + 0.1, "{text}");
}
