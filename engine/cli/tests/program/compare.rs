//! `compare`: images, folders, videos and scenes.

use std::path::Path;
use std::process::Output;

use streamsplat::export;

use crate::still::still;
use crate::support::{Scratch, command, fails, json};

fn compare(a: &Path, b: &Path, more: &[&str]) -> Output {
    command().arg("compare").arg(a).arg(b).args(more).output().expect("the program starts")
}

fn image(path: &Path, change: impl Fn(u32, u32) -> u8) {
    let pixel = |x: u32, y: u32| image::Rgb([(x * 3) as u8, 100 + change(x, y), (y * 5) as u8]);
    image::RgbImage::from_fn(40, 30, pixel).save(path).expect("writable");
}

#[test]
fn images_are_equal_or_said_to_differ_with_place_and_distance() {
    let scratch = Scratch::new();
    let [a, b, heat, found] = ["a.png", "b.png", "heat.png", "found.json"].map(|name| scratch.path(name));
    image(&a, |_, _| 0);
    image(&b, |x, y| if (x, y) == (7, 9) { 5 } else { u8::from(x == 20) });
    assert!(compare(&a, &a, &[]).status.success());
    let heat_option = format!("--heat={}", heat.display());
    let output = compare(&a, &b, &[&heat_option, &format!("--json={}", found.display())]);
    let text = fails(&output, 1);
    assert!(text.contains("1 of 1 images differ"), "{text}");
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(said.contains("largest difference 5.0000/255 at column 7, row 9 (green:"), "{said}");
    let found = json(&found);
    let picture = &found["pictures"][0];
    assert_eq!((&picture["column"], &picture["row"], &picture["passed"]), (&7.into(), &9.into(), &false.into()));
    assert!((picture["share"].as_f64().expect("a share") - 31.0 / 1200.0).abs() < 1e-12);
    let heat = image::open(&heat).expect("a PNG").into_rgb8();
    assert_eq!((heat.width(), heat.height()), (40, 30));
    let grey = |x, y| {
        let p = heat.get_pixel(x, y);
        p[0] == p[1] && p[1] == p[2]
    };
    assert!(grey(0, 0) && !grey(7, 9) && !grey(20, 3));
}

#[test]
fn limits_decide_what_passes() {
    let scratch = Scratch::new();
    let [a, b] = ["a.png", "b.png"].map(|name| scratch.path(name));
    image(&a, |_, _| 0);
    image(&b, |x, y| if (x, y) == (7, 9) { 5 } else { 0 });
    for (limits, code) in [
        (&["--max-abs", "5"][..], 0),
        (&["--max-abs", "4.9"], 1),
        (&["--psnr", "60"], 0),
        (&["--psnr", "75"], 1),
        (&["--max-abs", "5", "--psnr", "75"], 1),
        (&["--max-abs", "-1"], 2),
    ] {
        let output = compare(&a, &b, limits);
        assert_eq!(output.status.code(), Some(code), "{limits:?}: {}", String::from_utf8_lossy(&output.stderr));
    }
    let output = compare(&a, &b, &["--max-abs", "5", "--json"]);
    let value: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON alone on standard output");
    assert_eq!((&value["passed"], &value["equal"]), (&true.into(), &false.into()));
}

#[test]
fn folders_are_compared_by_name_and_what_is_missing_is_said() {
    let scratch = Scratch::new();
    let (a, b) = (scratch.clip("a", 3, 40, 30), scratch.clip("b", 3, 40, 30));
    assert!(compare(&a, &b, &[]).status.success());
    std::fs::remove_file(b.join("1.png")).expect("there");
    let output = compare(&a, &b, &[]);
    fails(&output, 1);
    assert!(String::from_utf8_lossy(&output.stdout).contains("1.png: missing in"));
    let text = fails(&compare(&a, &b.join("0.png"), &[]), 2);
    assert!(text.contains("expected two of a kind, found a folder of images and an image or a video"), "{text}");
    let text = fails(&compare(&a, &scratch.path("none"), &[]), 2);
    assert!(text.contains("none: cannot be read"), "{text}");
}

#[test]
fn videos_are_compared_frame_by_frame() {
    let scratch = Scratch::new();
    let [a, b, c] = ["a.y4m", "b.y4m", "c.y4m"].map(|name| scratch.path(name));
    let video = |frames: &[&str]| {
        let frames: String = frames.iter().map(|frame| format!("FRAME\n{frame}")).collect();
        format!("YUV4MPEG2 W2 H2 F24:1 Cmono\n{frames}")
    };
    std::fs::write(&a, video(&["aaaa", "bbbb"])).expect("writable");
    std::fs::write(&b, video(&["aaaa", "bbcb"])).expect("writable");
    std::fs::write(&c, video(&["aaaa"])).expect("writable");
    assert!(compare(&a, &a, &[]).status.success());
    let output = compare(&a, &b, &[]);
    assert!(fails(&output, 1).contains("1 of 2 frames differ"));
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(said.contains("frame 1: largest difference") && said.contains("at column 0, row 1"), "{said}");
    let output = compare(&a, &c, &[]);
    assert!(fails(&output, 1).contains("1 of 2 frames differ"));
    assert!(String::from_utf8_lossy(&output.stdout).contains("c.y4m has ended, the other has not"));
}

#[test]
fn one_bit_of_a_scene_is_found_with_its_gaussian_and_property() {
    let scratch = Scratch::new();
    let [a, b, c] = ["a.ply", "b.ply", "c.ply"].map(|name| scratch.path(name));
    let mut other = still();
    std::fs::write(&a, export::still::ply(&other)).expect("writable");
    other.base[123][1] = f32::from_bits(other.base[123][1].to_bits() ^ 1);
    std::fs::write(&b, export::still::ply(&other)).expect("writable");
    std::fs::write(&c, export::still::spz(&still())).expect("writable");
    assert!(compare(&a, &a, &[]).status.success());
    let output = compare(&a, &b, &[]);
    assert!(fails(&output, 1).contains("1 properties of 500 Gaussians differ"));
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(said.starts_with("colour: 1 Gaussians differ") && said.contains("(Gaussian 123)"), "{said}");
    fails(&compare(&a, &c, &[]), 1);
    assert!(fails(&compare(&a, &b, &["--psnr", "10"]), 2).contains("expected images or videos, found scenes"));
}

#[test]
fn scenes_in_time_are_compared_by_interval() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 3, 80, 48);
    let (a, b) = (scratch.path("a"), scratch.path("b"));
    crate::support::run_ok(&clip, &a, &["--emit", "scene"]);
    crate::support::run_ok(&clip, &b, &["--emit", "scene", "--motion", "frames"]);
    let output = compare(&a, &a, &[]);
    assert!(output.status.success() && String::from_utf8_lossy(&output.stdout).contains("every byte"));
    let output = compare(&a, &b, &[]);
    fails(&output, 1);
    assert!(String::from_utf8_lossy(&output.stdout).contains("interval 1: velocity: "));
}
