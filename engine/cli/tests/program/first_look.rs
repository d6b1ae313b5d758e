//! A still scene without a camera file: framed automatically, turned, as a single image, with an empty background.

use std::path::Path;
use std::process::Output;

use streamsplat::openexr;

use crate::still::{prepared, still};
use crate::support::{Scratch, command, fails, files, json};

fn render(scene: &Path, out: &Path, more: &[&str]) -> Output {
    command().arg("render").arg(scene).arg("--out").arg(out).args(more).output().expect("the program starts")
}

fn ok(output: &Output) {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn a_ply_file_alone_becomes_an_image_that_shows_it_and_can_be_verified() {
    let scratch = Scratch::new();
    let (scene, _) = prepared(&scratch);
    let out = scratch.path("out");
    ok(&render(&scene, &out, &[]));
    let image = image::open(out.join("frames/000000.png")).expect("an image").into_rgb8();
    assert_eq!((image.width(), image.height()), (1280, 720));
    let behind = |x, y| image.get_pixel(x, y).0 == [128; 3];
    let shown = (0..720).flat_map(|y| (0..1280).map(move |x| (x, y))).filter(|(x, y)| !behind(*x, *y));
    let (mut count, mut left, mut right) = (0, 1280, 0);
    for (x, _) in shown {
        (count, left, right) = (count + 1, left.min(x), right.max(x));
    }
    assert!(count > 1280 * 720 / 20, "{count}");
    assert!(left + right > 900 && left + right < 1660, "{left} {right}");
    ok(&command().arg("verify").arg(&out).output().expect("the program starts"));
}

#[test]
fn orbits_and_turntables_have_their_images_and_can_be_verified() {
    let scratch = Scratch::new();
    let (scene, camera) = prepared(&scratch);
    let size = ["--size", "48x32", "--fps", "8"];
    let of = |name: &str, more: &[&str]| {
        let out = scratch.path(name);
        ok(&render(&scene, &out, &[&size[..], more].concat()));
        ok(&command().arg("verify").arg(&out).output().expect("the program starts"));
        files(&out)
    };
    let turn = of("turn", &["--turntable", "1"]);
    assert_eq!(turn.len(), 8);
    let distinct: std::collections::BTreeSet<_> = turn.values().collect();
    assert_eq!(distinct.len(), 8, "every image from another side");
    let orbit = of("orbit", &["--orbit", "90:0.625"]);
    assert_eq!(orbit.len(), 5);
    // The middle of an orbit and the start of a turn are the front.
    assert!(orbit["frames/000002.png"] == turn["frames/000000.png"]);
    let out = scratch.path("wrong");
    for wrong in [&["--orbit", "a"][..], &["--orbit", "9:0"], &["--turntable", "-1"], &["--turntable", "1e9"]] {
        fails(&render(&scene, &out, wrong), 2);
    }
    let camera = camera.display().to_string();
    fails(&render(&scene, &out, &["--turntable", "1", "--camera", &camera]), 2);
    assert!(!out.exists());
}

#[test]
fn a_single_image_has_the_bytes_of_the_one_in_a_folder() {
    let scratch = Scratch::new();
    let (scene, _) = prepared(&scratch);
    let (out, png, exr) = (scratch.path("out"), scratch.path("x.png"), scratch.path("x.exr"));
    ok(&render(&scene, &out, &["--size", "60x40", "--emit", "rgb,exr"]));
    ok(&render(&scene, &png, &["--size", "60x40", "--json", &scratch.path("r.json").display().to_string()]));
    ok(&render(&scene, &exr, &["--size", "60x40"]));
    let found = files(&out);
    assert!(std::fs::read(&png).expect("written") == found["frames/000000.png"]);
    assert!(std::fs::read(&exr).expect("written") == found["exr/000000.exr"]);
    assert_eq!(json(&scratch.path("r.json"))["input"]["size"], serde_json::json!([60, 40]));
    let output = render(&scene, &png, &["--size", "60x40"]);
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(said.contains("x.png: 1 image of 60×40, 1 file, "), "{said}");
    let text = fails(&render(&scene, &png, &["--turntable", "1"]), 2);
    assert!(text.contains("found a single file"), "{text}");
    fails(&render(&scene, &png, &["--emit", "depth"]), 2);
    let names = std::fs::read_dir(scratch.path("")).expect("readable").flatten();
    assert!(names.filter(|e| e.file_name().to_string_lossy().starts_with('.')).count() == 0, "nothing is left behind");
}

#[test]
fn a_transparent_background_keeps_alpha_in_png_and_exr() {
    let scratch = Scratch::new();
    let (scene, _) = prepared(&scratch);
    let out = scratch.path("out");
    let size = ["--size", "60x40", "--background", "transparent"];
    ok(&render(&scene, &out, &[&size[..], &["--emit", "rgb,exr,alpha"]].concat()));
    let image = image::open(out.join("frames/000000.png")).expect("an image");
    assert_eq!(image.color(), image::ColorType::Rgba8);
    let alpha = image::open(out.join("alpha/000000.png")).expect("an image").into_luma8();
    let image = image.into_rgba8();
    for (pixel, alpha) in image.pixels().zip(alpha.pixels()) {
        assert_eq!(pixel[3], alpha[0]);
    }
    assert!(image.pixels().any(|p| p[3] == 0) && image.pixels().any(|p| p[3] > 200));
    let exr = openexr::read(&std::fs::read(out.join("exr/000000.exr")).expect("written")).expect("valid");
    assert!(exr.channel("A").is_some() && exr.channel("R").is_some());
    ok(&command().arg("verify").arg(&out).output().expect("the program starts"));
    let text = fails(&render(&scene, &scratch.path("v.y4m"), &size), 2);
    assert!(text.contains("a video has no alpha"), "{text}");
    let clip = scratch.clip("clip", 2, 80, 48);
    let mut run = command();
    run.arg("run").arg(&clip).arg("--out").arg(scratch.path("r")).args(["--background", "transparent"]);
    let text = fails(&run.output().expect("the program starts"), 2);
    assert!(text.contains("--background transparent"), "{text}");
}

#[test]
fn antialiasing_makes_what_is_small_fainter_and_is_part_of_the_record() {
    let scratch = Scratch::new();
    let (scene, _) = prepared(&scratch);
    let size = ["--size", "60x40"];
    let of = |name: &str, more: &[&str]| {
        let out = scratch.path(name);
        ok(&command().arg("render").arg(&scene).arg("-o").arg(&out).args(size).args(more).output().expect("it starts"));
        ok(&command().arg("verify").arg(&out).output().expect("the program starts"));
        (files(&out)["frames/000000.png"].clone(), json(&out.join("run.json")))
    };
    let (plain, record) = of("plain", &[]);
    assert!(record["options"].get("antialias").is_none(), "{record}");
    let (lowered, record) = of("lowered", &["--antialias", "--isa", "scalar", "--threads", "1"]);
    assert_eq!(record["options"]["antialias"], true, "{record}");
    assert!(plain != lowered);
    assert!(of("again", &["--antialias"]).0 == lowered);
    // A list of golden images supports it too.
    let list = scratch.path("renders.toml");
    let recorded = |more: &str| {
        let text = format!("[[render]]\nname = 'a'\nscene = 'scene.ply'\nsize = '60x40'\n{more}");
        std::fs::write(&list, text).expect("writable");
        ok(&command().args(["golden", "record"]).arg(&list).output().expect("the program starts"));
        json(&scratch.path("renders.golden/record.json"))["renders"]["a"]["images"][0]["blake3"].clone()
    };
    assert_ne!(recorded(""), recorded("antialias = true\n"));
}

#[test]
fn inspect_says_what_a_scene_is_like_and_what_of_it_is_not_drawn() {
    let scratch = Scratch::new();
    let mut scene = still();
    scene.mean[3][1] = f32::NAN;
    scene.rotation[5] = [0.0; 4];
    (scene.logit[7], scene.logit[8]) = (-9.0, -6.0);
    let (file, out) = (scratch.path("scene.ply"), scratch.path("found.json"));
    std::fs::write(&file, streamsplat::formats::ply::write(&scene).bytes).expect("writable");
    let output = command().arg("inspect").arg(&file).arg("--json").arg(&out).output().expect("the program starts");
    ok(&output);
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(text.contains("not_drawn:"), "{text}");
    let found = json(&out);
    assert_eq!(found["not_drawn"], serde_json::json!({ "not_finite": 1, "no_rotation": 1, "opacity_under_1_255": 2 }));
    let opacity = &found["opacity"];
    let shares = ["least", "p5", "median", "p95", "greatest"].map(|name| opacity[name].as_f64().expect("a number"));
    assert!(shares.is_sorted() && shares[0] < 0.001 && shares[4] > 0.9, "{opacity}");
    assert!(found["standard_deviation"]["greatest"].as_f64().is_some_and(|x| x < 0.3), "{found}");
    assert_eq!(found["most_of_it"]["least"].as_array().map(Vec::len), Some(3));
}
