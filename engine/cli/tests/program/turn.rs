//! Cameras that move around a scene while its time runs or is held, and pairs of eyes.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Output;

use streamsplat_fixtures as fixtures;

use crate::still::prepared;
use crate::support::{Scratch, command, fails, files, json, run_ok};

fn render(scene: &Path, out: &Path, more: &[&str]) -> Output {
    command().arg("render").arg(scene).arg("--out").arg(out).args(more).output().expect("the program starts")
}

fn ok(output: &Output) {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// Returns the images of a rendering that `verify` confirms.
fn drawn(scratch: &Scratch, scene: &Path, name: &str, more: &[&str]) -> BTreeMap<String, Vec<u8>> {
    let out = scratch.path(name);
    ok(&render(scene, &out, more));
    ok(&command().arg("verify").arg(&out).output().expect("the program starts"));
    files(&out)
}

/// Runs the clip's first second; returns its scene.
fn ran(scratch: &Scratch, name: &str, more: &[&str]) -> std::path::PathBuf {
    let out = scratch.path(name);
    run_ok(&fixtures::path("clips/moving.y4m"), &out, &[&["--frames", "13", "--gap", "4", "--quiet"], more].concat());
    out
}

fn frames(all: &BTreeMap<String, Vec<u8>>) -> Vec<&Vec<u8>> {
    all.iter().filter(|(name, _)| name.starts_with("frames/")).map(|(_, bytes)| bytes).collect()
}

#[test]
fn a_run_that_turns_has_the_bytes_of_its_scene_turned_and_both_are_verified() {
    let scratch = Scratch::new();
    for (i, motion) in
        [&["--orbit", "20:0.25"][..], &["--sway=5:0.5"], &["--turntable", "1", "--stereo"]].iter().enumerate()
    {
        let out = ran(&scratch, &format!("run{i}"), motion);
        ok(&command().arg("verify").arg(&out).output().expect("the program starts"));
        let images = drawn(&scratch, &out, &format!("render{i}"), motion);
        let all = files(&out);
        let found = frames(&all);
        assert_eq!(found.len(), 13);
        assert!(found == frames(&images), "{motion:?}");
        let distinct: std::collections::BTreeSet<_> = found.iter().collect();
        assert_eq!(distinct.len(), 13, "time runs on while the camera moves");
    }
}

#[test]
fn at_an_angle_of_zero_the_image_is_the_sources_own_view() {
    let scratch = Scratch::new();
    let scene = ran(&scratch, "run", &[]);
    let own = drawn(&scratch, &scene, "own", &["--times", "0.25"]);
    // One time is held: five images from left to right, of which the third is from the front.
    let held = drawn(&scratch, &scene, "held", &["--times", "0.25", "--fps", "10", "--orbit", "30:0.5"]);
    let held = frames(&held);
    assert_eq!(held.len(), 5);
    assert!(held[2] == frames(&own)[0]);
    for other in [0, 1, 3, 4] {
        assert!(held[other] != held[2], "{other}");
    }
    // While time runs, an orbit without seconds takes all of it.
    let running = drawn(&scratch, &scene, "running", &["--orbit", "30"]);
    let whole = files(&scene);
    let equal: Vec<usize> = (0..13).filter(|i| frames(&running)[*i] == frames(&whole)[*i]).collect();
    assert_eq!(equal, [6]);
}

/// Returns the fraction of an image's pixels that are near pure blue, the background.
fn blue(out: &Path, name: &str) -> f64 {
    let image = image::open(out.join(name)).expect("an image").into_rgb8();
    let blue = image.pixels().filter(|p| p[2] > 200 && p[0] < 55 && p[1] < 55).count();
    blue as f64 / f64::from(image.width() * image.height())
}

#[test]
fn what_was_not_filmed_shows_the_colours_around_it_or_is_cropped() {
    let scratch = Scratch::new();
    // The embedded model's scene, with a moving camera.
    let scene = scratch.path("run");
    let clip = fixtures::path("clips/moving.y4m");
    let mut run = command();
    run.arg("run").arg(clip).args(["--frames", "13", "--gap", "4", "--quiet", "--out"]).arg(&scene);
    ok(&run.output().expect("the program starts"));
    let turned = |name: &str, more: &[&str]| {
        let out = scratch.path(name);
        let options = ["--times", "0.25", "--fps", "8", "--orbit", "50:0.375", "--background", "0,0,1"];
        let output = render(&scene, &out, &[&options[..], more].concat());
        ok(&output);
        let text = String::from_utf8(output.stderr).expect("text");
        let note = text.lines().find(|line| line.contains("was never filmed")).unwrap_or_default().to_owned();
        let image = image::open(out.join("frames/000000.png")).expect("an image").into_rgb8();
        (blue(&out, "frames/000000.png"), note, image)
    };
    let (none, note, plain) = turned("none", &["--fill", "none"]);
    assert!(none > 0.05 && note.contains("at 25 degrees") && note.contains("shows the background"), "{none}: {note}");
    let (extended, note, same) = turned("extend", &[]);
    assert!(extended < 0.001 && note.contains("shows the colours around it (--fill)"), "{extended}: {note}");
    // Filmed parts are unchanged, except where the background showed through.
    let (x, y) = (plain.width() / 2, plain.height() / 2);
    let apart = |a: u8, b: u8| a.abs_diff(b);
    assert!((0..3).all(|c| apart(plain.get_pixel(x, y)[c], same.get_pixel(x, y)[c]) < 12), "the middle");
    let (cropped, after, larger) = turned("crop", &["--fill", "crop"]);
    assert!(cropped < 0.001 && note.contains("10 %") && !after.contains("10 %"), "{cropped}: {after}");
    assert_eq!((larger.dimensions(), larger == same), (same.dimensions(), false));
    // Supported in a list of golden images as well; `run`, which draws images during processing, rejects it.
    let list = scratch.path("list.toml");
    let entry = |fill: &str| {
        format!(
            "[[render]]\nname = '{fill}'\nscene = 'run'\ntimes = 0.25\nfps = 8\norbit = '50:0.375'\nfill = '{fill}'\n"
        )
    };
    std::fs::write(&list, entry("extend") + &entry("crop")).expect("writable");
    ok(&command().args(["golden", "record"]).arg(&list).output().expect("the program starts"));
    let renders = &json(&scratch.path("list.golden/record.json"))["renders"];
    let digest = |fill: &str| renders[fill]["images"][0]["blake3"].as_str().expect("a digest").to_owned();
    assert!(digest("extend") != digest("crop"));
    for more in [&[][..], &["--times", "0.25"]] {
        let mut run = command();
        run.arg("run").arg(fixtures::path("clips/moving.y4m")).args(["--orbit", "9", "--fill", "crop", "--out"]);
        let text = fails(&run.arg(scratch.path("none-of-it")).args(more).output().expect("the program starts"), 2);
        assert!(text.contains("render has it"), "{text}");
    }
    // Its alpha is the scene's.
    let out = scratch.path("alpha");
    ok(&render(&scene, &out, &["--times", "0.25", "--fps", "8", "--orbit", "50:0.25", "--emit", "rgb,alpha"]));
    let alpha = image::open(out.join("alpha/000000.png")).expect("an image").into_luma8();
    assert!(alpha.pixels().any(|p| p[0] < 20));
    // The record counts it.
    let work = &json(&out.join("run.json"))["work"]["render.unfilmed"];
    assert!(work["done"].as_u64().expect("pixels") > 0 && work["unit"] == "pixels", "{work}");
}

#[test]
fn words_of_other_programs_have_a_hint() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 2, 32, 32).display().to_string();
    for (words, hint) in [
        (&[&*clip][..], "streamsplat run"),
        (&["convert", "a.ply", "b.spz"], "streamsplat export IN --out OUT"),
        (&["render", "a.ply", "--fov", "60"], "fov_y_degrees"),
        (&["render", "a.ply", "--width=60"], "--size WIDTHxHEIGHT"),
        (&["run", "a.mp4", "--gpu"], "--renderer wgpu"),
    ] {
        let text = fails(&command().args(words).output().expect("the program starts"), 2);
        assert!(text.contains(hint) && text.lines().count() == 1, "{words:?}: {text}");
    }
}

#[test]
fn a_held_sway_is_a_loop_and_shows_what_is_near_and_far_move() {
    let scratch = Scratch::new();
    let scene = ran(&scratch, "run", &[]);
    let out = scratch.path("sway.y4m");
    ok(&render(&scene, &out, &["--times", "0.25", "--fps", "8", "--sway=6:1"]));
    let mut video =
        streamsplat::source::y4m::Y4m::new(std::io::BufReader::new(std::fs::File::open(&out).expect("written")), &out)
            .expect("a video");
    let mut pictures = Vec::new();
    while let Some(picture) = video.next_picture().expect("whole") {
        pictures.push(picture.rgb);
    }
    assert_eq!(pictures.len(), 8);
    let apart = |a: usize, b: usize| -> f64 {
        let pairs = pictures[a].iter().zip(&pictures[b]);
        pairs.map(|(a, b)| f64::from((a - b).abs())).sum::<f64>() / pictures[a].len() as f64
    };
    let (step, across) = (apart(0, 1), apart(0, 4));
    assert!(across > 0.0 && apart(7, 0) < 1.5 * step && apart(7, 0) < across, "{} {step} {across}", apart(7, 0));
}

#[test]
fn an_image_of_two_eyes_or_of_an_open_shutter_is_one_image() {
    let scratch = Scratch::new();
    let scene = ran(&scratch, "run", &[]);
    for more in [&["--stereo"][..], &["--shutter", "180"], &["--stereo", "--shutter", "180"]] {
        let out = scratch.path(&more.concat());
        let output = render(&scene, &out, &[&["--times", "0.25"], more].concat());
        ok(&output);
        let said = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(said.contains(": 1 image of "), "{said}");
        assert_eq!(json(&out.join("run.json"))["work"]["render"]["done"], 1);
    }
}

#[test]
fn stereo_images_are_twice_as_wide_and_differ_by_the_distance_of_the_eyes() {
    let scratch = Scratch::new();
    let scene = ran(&scratch, "run", &[]);
    let halves = |name: &str, more: &[&str]| {
        let options = [&["--times", "0.25", "--size", "64x36", "--emit", "rgb,depth,alpha"], more].concat();
        let out = scratch.path(name);
        drawn(&scratch, &scene, name, &options);
        let image = image::open(out.join("frames/000000.png")).expect("an image").into_rgb8();
        let alpha = image::open(out.join("alpha/000000.png")).expect("an image").into_luma8();
        assert_eq!((image.dimensions(), alpha.dimensions()), ((128, 36), (128, 36)));
        let half = |from: u32| -> Vec<u8> {
            (0..36)
                .flat_map(|y| (0..64).map(move |x| (from + x, y)))
                .flat_map(|(x, y)| image.get_pixel(x, y).0)
                .collect()
        };
        let (left, right) = (half(0), half(64));
        let apart: u64 = left.iter().zip(&right).map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
        (left, apart)
    };
    let (_, near) = halves("near", &["--stereo", "--eye-distance", "0.02"]);
    let (left, far) = halves("far", &["--stereo", "--eye-distance", "0.2"]);
    assert!(near > 0 && far > 2 * near, "{near} {far}");
    // The left eye is on the left, at atan(0.1) degrees.
    let angle = -2.0 * 0.1f64.atan().to_degrees();
    let orbit =
        ["--times", "0.25", "--size", "64x36", "--fps", "2", "--fill", "none", "--orbit", &format!("{}:1", -angle)];
    let orbit = drawn(&scratch, &scene, "orbit", &orbit);
    let image = image::load_from_memory(frames(&orbit)[0]).expect("an image").into_rgb8();
    let most = image.as_raw().iter().zip(&left).map(|(a, b)| a.abs_diff(*b)).max();
    assert!(most <= Some(2), "{most:?}");
}

#[test]
fn still_scenes_sway_and_have_two_eyes() {
    let scratch = Scratch::new();
    let (scene, camera) = prepared(&scratch);
    let size = ["--size", "48x32", "--fps", "8"];
    let sway = drawn(&scratch, &scene, "sway", &[&size[..], &["--sway=8:1"]].concat());
    let distinct: std::collections::BTreeSet<_> = sway.values().collect();
    assert_eq!((sway.len(), distinct.len()), (8, 8));
    for (name, more) in [("framed", &[][..]), ("camera", &["--camera", &camera.display().to_string(), "--times", "0"])]
    {
        let stereo = drawn(&scratch, &scene, name, &[&size[..], &["--stereo"], more].concat());
        let image = image::load_from_memory(frames(&stereo)[0]).expect("an image").into_rgb8();
        assert_eq!(image.dimensions(), (96, 32));
        let half = |from: u32| (0..32).flat_map(move |y| (0..48).map(move |x| (from + x, y)));
        assert!(half(0).zip(half(48)).any(|((x, y), (u, v))| image.get_pixel(x, y) != image.get_pixel(u, v)));
    }
    fails(&render(&scene, &scratch.path("wrong"), &["--sway", "--times", "0"]), 2);
}

#[test]
fn motions_that_cannot_be_are_wrong_use() {
    let scratch = Scratch::new();
    let scene = ran(&scratch, "run", &[]);
    let out = scratch.path("out");
    let camera = scratch.path("camera.json");
    std::fs::write(&camera, r#"{"type": "orthographic", "position": [0, 0, 9]}"#).expect("writable");
    let camera = camera.display().to_string();
    for wrong in [
        &["--orbit", "a"][..],
        &["--orbit", "9:0"],
        &["--sway=-4"],
        &["--sway=4:0"],
        &["--sway=90"],
        &["--turntable", "-1"],
        &["--sway", "--fill", "grow"],
        &["--fill", "crop"],
        &["--times", "0.25", "--turntable", "1e9"],
        &["--stereo", "--eye-distance", "2"],
        &["--stereo", "--eye-distance", "nan"],
        &["--stereo", "--camera", &camera],
    ] {
        fails(&render(&scene, &out, wrong), 2);
    }
    for wrong in [&["--sway", "--orbit", "3"][..], &["--sway", "--camera", &camera], &["--eye-distance", "0.1"]] {
        let output = render(&scene, &out, wrong);
        assert_eq!(output.status.code(), Some(2), "{wrong:?}");
    }
    let png = scratch.path("x.png").display().to_string();
    let text = fails(&render(&scene, Path::new(&png), &["--times", "0.25", "--sway"]), 2);
    assert!(text.contains("found a single file: the camera moves from image to image"), "{text}");
    let record = json(&scene.join("run.json"));
    assert!(record["task"].to_string().find("orbit").is_none(), "nothing is said where nothing moves");
}

#[test]
fn a_turned_run_in_which_no_depth_is_found_names_the_guess() {
    let scratch = Scratch::new();
    // A camera that does not move.
    let folder = scratch.path("standing");
    std::fs::create_dir(&folder).expect("a folder");
    for k in 0..3_u8 {
        let picture = image::RgbImage::from_fn(96, 64, |x, y| {
            let noise = (x * 37 + y * 91 + x * y * 13) % 101;
            image::Rgb([noise as u8 + 60 + k, (2 * x) as u8, (3 * y) as u8])
        });
        picture.save(folder.join(format!("{k}.png"))).expect("written");
    }
    for (depth, hinted) in [("auto", true), ("none", false), ("guess", false)] {
        let mut run = command();
        run.arg("run").arg(&folder).args(["--gap", "1", "--orbit", "8", "--still", "keep", "--depth", depth, "--out"]);
        let output = run.arg(scratch.path(depth)).output().expect("the program starts");
        ok(&output);
        let text = String::from_utf8(output.stderr).expect("text");
        assert_eq!(
            text.contains("no depth was found, so the turned scene is a flat card; --depth guess"),
            hinted,
            "{depth}: {text}"
        );
        let unkept = text.contains("--still changes nothing with --depth guess");
        assert_eq!(unkept, depth == "guess", "{depth}: {text}");
        let guessed = &json(&scratch.path(depth).join("run.json"))["work"]["guess"]["done"];
        assert_eq!(guessed.as_u64(), Some(if depth == "guess" { 2 } else { 0 }), "{depth}");
    }
    // A model without motion from frames guesses nothing, which is told.
    let mut run = command();
    run.arg("run").arg(&folder).args(["--gap", "1", "--motion", "network", "--depth", "guess", "--out"]);
    let output = run.arg(scratch.path("network")).output().expect("the program starts");
    ok(&output);
    let text = String::from_utf8(output.stderr).expect("text");
    assert!(
        text.contains("--depth guess changes nothing: the model reads depth, or motion is the network's"),
        "{text}"
    );
}
