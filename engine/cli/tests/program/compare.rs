//! `compare`: images, folders, videos and scenes.

use std::path::Path;
use std::process::Output;

use streamsplat::formats;
use streamsplat::openexr::Planes;

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
fn a_limit_of_one_level_passes_one_level_whatever_its_place() {
    let scratch = Scratch::new();
    let [a, b] = ["a.png", "b.png"].map(|name| scratch.path(name));
    // Pixels of 150 levels, and of the level above each.
    image(&a, |x, y| ((x + 40 * y) % 150) as u8);
    image(&b, |x, y| ((x + 40 * y) % 150) as u8 + 1);
    assert!(compare(&a, &b, &["--max-abs", "1"]).status.success());
    fails(&compare(&a, &b, &["--max-abs", "0.999"]), 1);
}

#[cfg(unix)]
#[test]
fn names_that_are_not_text_are_compared() {
    use std::os::unix::ffi::OsStrExt;
    let scratch = Scratch::new();
    let name = std::ffi::OsStr::from_bytes(b"\xff.png");
    let [a, b] = ["a", "b"].map(|folder| scratch.path(folder));
    for (folder, level) in [(&a, 0), (&b, 9)] {
        std::fs::create_dir(folder).expect("writable");
        // The image writer chooses its format by a UTF-8 name.
        image(&folder.join("1.png"), |_, _| level);
        std::fs::rename(folder.join("1.png"), folder.join(name)).expect("writable");
    }
    assert!(compare(&a, &a, &[]).status.success() && compare(&a.join(name), &a.join(name), &[]).status.success());
    for (a, b) in [(a.clone(), b.clone()), (a.join(name), b.join(name))] {
        let output = compare(&a, &b, &["--json"]);
        fails(&output, 1);
        let found: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
        assert_eq!(found["passed"], false);
    }
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
    assert!(text.contains("expected two of a kind, found a folder and an image or a video"), "{text}");
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
    // The mean is printed last, also if the difference is within the limits.
    for output in [output, compare(&a, &b, &["--max-abs", "2"])] {
        let said = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(said.lines().last().is_some_and(|line| line.starts_with("mean of 2 frames: PSNR ")), "{said}");
    }
    let output = compare(&a, &c, &[]);
    assert!(fails(&output, 1).contains("1 of 2 frames differ"));
    assert!(String::from_utf8_lossy(&output.stdout).contains("c.y4m has ended, the other has not"));
}

#[test]
fn videos_with_alpha_that_would_not_be_compared_are_refused_and_conversions_are_said() {
    let scratch = Scratch::new();
    let [alpha, a, b] = ["alpha.y4m", "a.y4m", "b.y4m"].map(|name| scratch.path(name));
    std::fs::write(&alpha, "YUV4MPEG2 W1 H1 F24:1 C444alpha\nFRAME\nabca").expect("writable");
    std::fs::write(&a, "YUV4MPEG2 W2 H2 F24:1 C444 A2:1\nFRAME\naaaabbbbcccc").expect("writable");
    std::fs::write(&b, "YUV4MPEG2 W2 H2 F24:1 C422 A2:1\nFRAME\naaaabbcc").expect("writable");
    let text = fails(&compare(&alpha, &a, &[]), 1);
    assert!(text.contains("alpha.y4m: expected a video without alpha, found one with it"), "{text}");
    // Two of one layout are compared by their planes, alpha too.
    assert!(compare(&alpha, &alpha, &[]).status.success());
    let output = compare(&a, &b, &[]);
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success() && said.contains("a.y4m: pixels of 2:1 were made square"), "{said}");
}

#[test]
fn a_runs_frames_are_compared_with_a_folder_of_images() {
    let scratch = Scratch::new();
    let (clip, out) = (scratch.clip("clip", 3, 80, 48), scratch.path("out"));
    crate::support::run_ok(&clip, &out, &[]);
    let output = compare(&out, &out.join("frames"), &[]);
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success() && said.contains("out: its frames alone are compared"), "{said}");
}

#[test]
fn one_bit_of_a_scene_is_found_with_its_gaussian_and_property() {
    let scratch = Scratch::new();
    let [a, b, c] = ["a.ply", "b.ply", "c.ply"].map(|name| scratch.path(name));
    let mut other = still();
    std::fs::write(&a, formats::ply::write(&other).bytes).expect("writable");
    other.base[123][1] = f32::from_bits(other.base[123][1].to_bits() ^ 1);
    std::fs::write(&b, formats::ply::write(&other).bytes).expect("writable");
    std::fs::write(&c, formats::spz::write(&still(), formats::SpzVersion::V3).bytes).expect("writable");
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

/// Writes an EXR file with one channel called `name`.
fn exr(path: &Path, name: &str, value: f32) {
    let planes = Planes { width: 12, height: 12, channels: vec![(name.to_owned(), vec![value; 144])] };
    let mut bytes = Vec::new();
    streamsplat::openexr::write(&planes, "", &mut bytes).expect("memory");
    std::fs::write(path, bytes).expect("writable");
}

#[test]
fn depth_above_one_is_not_clamped_and_one_bit_of_it_is_found() {
    let scratch = Scratch::new();
    let [a, b, c] = ["a.exr", "b.exr", "c.exr"].map(|name| scratch.path(name));
    exr(&a, "Z", 2.0);
    exr(&b, "Z", 10.0);
    exr(&c, "Z", f32::from_bits(2.0_f32.to_bits() + 1));
    assert!(compare(&a, &a, &[]).status.success());
    let output = compare(&a, &b, &["--max-abs", "255"]);
    fails(&output, 1);
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(said.contains("largest difference 8 (2040.0000/255)") && said.contains("(Z: 2 and 10, f32)"), "{said}");
    fails(&compare(&a, &c, &[]), 1);
    assert!(compare(&a, &c, &["--max-abs", "0.01"]).status.success());
}

#[test]
fn alpha_is_compared_as_a_channel() {
    let scratch = Scratch::new();
    let [a, b, c] = ["a.png", "b.png", "c.png"].map(|name| scratch.path(name));
    image::RgbaImage::from_pixel(20, 20, image::Rgba([128, 128, 128, 0])).save(&a).expect("writable");
    image::RgbaImage::from_pixel(20, 20, image::Rgba([128, 128, 128, 255])).save(&b).expect("writable");
    image::RgbImage::from_pixel(20, 20, image::Rgb([128; 3])).save(&c).expect("writable");
    let output = compare(&a, &b, &["--max-abs", "254"]);
    fails(&output, 1);
    assert!(String::from_utf8_lossy(&output.stdout).contains("(alpha: 0 and 255, u8)"));
    // An image without alpha is compared as opaque, with a note.
    let output = compare(&b, &c, &[]);
    assert!(output.status.success() && String::from_utf8_lossy(&output.stdout).contains("compared as opaque"));
    fails(&compare(&a, &c, &["--max-abs", "254"]), 1);
}

/// Builds a PNG chunk.
fn chunk(kind: &[u8; 4], data: &[u8]) -> Vec<u8> {
    let body = [&kind[..], data].concat();
    let mut crc = flate2::Crc::new();
    crc.update(&body);
    [&(data.len() as u32).to_be_bytes()[..], &body, &crc.sum().to_be_bytes()].concat()
}

/// Builds an animated PNG of grey frames of 2x1 pixels; the first pixel of each is its duration in tenths of a second.
pub fn apng(frames: &[[u8; 2]]) -> Vec<u8> {
    let mut bytes = b"\x89PNG\r\n\x1a\n".to_vec();
    bytes.extend(chunk(b"IHDR", &[0, 0, 0, 2, 0, 0, 0, 1, 8, 0, 0, 0, 0]));
    bytes.extend(chunk(b"acTL", &[&(frames.len() as u32).to_be_bytes()[..], &[0; 4]].concat()));
    let mut sequence = 0_u32;
    for (at, frame) in frames.iter().enumerate() {
        let control = [sequence, 2, 1, 0, 0]
            .iter()
            .flat_map(|v| v.to_be_bytes())
            .chain([0, frame[0], 0, 10, 0, 0])
            .collect::<Vec<u8>>();
        bytes.extend(chunk(b"fcTL", &control));
        sequence += 1;
        let mut packed = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::default());
        std::io::Write::write_all(&mut packed, &[0, frame[0], frame[1]]).expect("memory");
        let packed = packed.finish().expect("memory");
        if at == 0 {
            bytes.extend(chunk(b"IDAT", &packed));
        } else {
            bytes.extend(chunk(b"fdAT", &[&sequence.to_be_bytes()[..], &packed].concat()));
            sequence += 1;
        }
    }
    bytes.extend(chunk(b"IEND", &[]));
    bytes
}

#[test]
fn every_frame_of_an_animation_is_compared() {
    let scratch = Scratch::new();
    let [a, b, c] = ["a.png", "b.png", "c.png"].map(|name| scratch.path(name));
    std::fs::write(&a, apng(&[[1, 2], [3, 4], [5, 6]])).expect("writable");
    std::fs::write(&b, apng(&[[1, 2], [3, 4], [5, 7]])).expect("writable");
    image::GrayImage::from_raw(2, 1, vec![1, 2]).expect("2 pixels").save(&c).expect("writable");
    let output = compare(&a, &a, &[]);
    assert!(output.status.success() && String::from_utf8_lossy(&output.stdout).contains("equal (3 images)"));
    let output = compare(&a, &b, &[]);
    assert!(fails(&output, 1).contains("1 of 3 images differ"));
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(
        said.contains("frame 2: largest difference 1.0000/255 at column 1") && said.contains("mean of 3 images"),
        "{said}"
    );
    fails(&compare(&a, &c, &["--max-abs", "255"]), 1);
}

#[test]
fn files_of_which_nothing_can_be_read_are_never_equal() {
    let scratch = Scratch::new();
    let [a, b] = ["a.png", "b.png"].map(|name| scratch.path(name));
    for content in [&b""[..], b"no picture at all", b"\x89PNG\r\n\x1a\n"] {
        std::fs::write(&a, content).expect("writable");
        std::fs::write(&b, content).expect("writable");
        fails(&compare(&a, &b, &[]), 1);
        fails(&compare(&a, &a, &["--max-abs", "255"]), 1);
    }
    let [c, d] = ["c", "d"].map(|name| scratch.path(name));
    [&c, &d].into_iter().for_each(|folder| std::fs::create_dir(folder).expect("writable"));
    fails(&compare(&c, &d, &[]), 1);
    [&c, &d].into_iter().for_each(|folder| std::fs::write(folder.join("0.png"), "").expect("writable"));
    fails(&compare(&c, &d, &[]), 1);
}

#[test]
fn outputs_of_render_are_compared_in_every_kind() {
    let scratch = Scratch::new();
    let scene = scratch.path("scene.ply");
    std::fs::write(&scene, formats::ply::write(&still()).bytes).expect("writable");
    let [a, b] = ["a", "b"].map(|name| scratch.path(name));
    for out in [&a, &b] {
        let output = command()
            .arg("render")
            .arg(&scene)
            .args(["--size", "32x24", "--emit", "rgb,depth,alpha,exr", "--out"])
            .arg(out)
            .output();
        let output = output.expect("the program starts");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }
    let output = compare(&a, &b, &[]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    // Its depth alone, as a file.
    let [depth, other] = [&a, &b].map(|out| out.join("depth/000000.exr"));
    assert!(compare(&depth, &other, &[]).status.success());
    exr(&other, "Z", 1.0);
    let output = compare(&a, &b, &["--max-abs", "255"]);
    fails(&output, 1);
    assert!(String::from_utf8_lossy(&output.stdout).contains("depth/000000.exr"));
    std::fs::remove_file(&other).expect("there");
    let output = compare(&a, &b, &[]);
    fails(&output, 1);
    assert!(String::from_utf8_lossy(&output.stdout).contains("depth/000000.exr: missing in"));
}

#[test]
fn every_interval_of_a_scene_is_read_whatever_its_index_says() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 3, 80, 48);
    let (a, b) = (scratch.path("a"), scratch.path("b"));
    for out in [&a, &b] {
        crate::support::run_ok(&clip, out, &["--emit", "scene", "--quiet"]);
    }
    let (first, second) = (a.join("scene"), b.join("scene"));
    assert!(compare(&first, &second, &[]).status.success());
    let list = scratch.path("list.toml");
    std::fs::write(&list, "[[render]]\nname = 'first'\nscene = 'b'\ntimes = [0]\nsize = '40x24'\n").expect("writable");
    let golden = |action: &str| command().args(["golden", action]).arg(&list).output().expect("the program starts");
    assert!(golden("record").status.success());
    let inspect = |path: &Path| command().arg("inspect").arg(path).output().expect("the program starts");
    assert!(golden("check").status.success() && inspect(&second).status.success());
    let last = second.join("interval-000002.safetensors");
    let bytes = std::fs::read(&last).expect("readable");
    let mut flipped = bytes.clone();
    let middle = flipped.len() / 2;
    flipped[middle] ^= 1;
    for changed in [Some(flipped), Some(Vec::new()), None] {
        match &changed {
            Some(changed) => std::fs::write(&last, changed).expect("writable"),
            None => std::fs::remove_file(&last).expect("there"),
        }
        assert!(fails(&compare(&first, &second, &[]), 1).contains("interval-000002"));
        // Compared with itself, too: a damaged interval is an error.
        assert!(fails(&compare(&second, &second, &[]), 1).contains("interval-000002"));
        assert!(fails(&inspect(&second), 1).contains("interval-000002"));
        let output = golden("check");
        fails(&output, 1);
        assert!(String::from_utf8_lossy(&output.stdout).contains("interval-000002"));
    }
}
