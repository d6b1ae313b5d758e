//! Footprints, panoramas, lenses, shutters, and single images of other kinds.

use std::path::{Path, PathBuf};
use std::process::Output;

use streamsplat::camera::Camera;
use streamsplat::output::picture_png;
use streamsplat::picture::Picture;
use streamsplat::render::{Exposure, Renderer};
use streamsplat::scene::Scene;
use streamsplat::stream::Workers;
use streamsplat::{Image, RenderOptions};
use streamsplat_kernels::Level;
use streamsplat_kernels::harmonics::Y0;

use crate::still::prepared;
use crate::support::{Scratch, command, fails, files, json, run_ok};

fn render(scene: &Path, out: &Path, more: &[&str]) -> Output {
    let mut command = command();
    command.arg("render").arg(scene).arg("--out").arg(out).args(more);
    command.output().expect("the program starts")
}

fn render_ok(scene: &Path, out: &Path, more: &[&str]) {
    let output = render(scene, out, more);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// Decodes the pixels of a file of any kind.
fn pixels(path: &Path) -> image::RgbaImage {
    image::open(path).unwrap_or_else(|e| panic!("{}: {e}", path.display())).into_rgba8()
}

/// Returns how many samples of two pictures differ, and the largest difference.
fn apart(a: &image::RgbaImage, b: &image::RgbaImage) -> (usize, u8) {
    assert_eq!(a.dimensions(), b.dimensions());
    let steps = a.as_raw().iter().zip(b.as_raw()).map(|(a, b)| a.abs_diff(*b));
    steps.fold((0, 0), |(count, most), step| (count + usize::from(step > 0), most.max(step)))
}

#[test]
fn each_option_changes_the_picture_and_no_byte_depends_on_threads_or_level() {
    let scratch = Scratch::new();
    let (scene, camera) = prepared(&scratch);
    let seen = ["--camera", camera.to_str().expect("a name"), "--size", "60x40"];
    let path = |name: &str| scratch.path(&format!("{name}.png"));
    render_ok(&scene, &path("plain"), &seen);
    let plain = pixels(&path("plain"));
    let kinds: [(&str, &[&str]); 4] = [
        ("splat-transform", &["--footprint", "splat-transform"]),
        ("playcanvas", &["--footprint", "playcanvas"]),
        ("blurred", &["--f-stop", "1.4", "--sensor-height", "2", "--focus", "2.5"]),
        ("around", &["--panorama"]),
    ];
    for (name, options) in kinds {
        let both = [&["--threads", "1", "--isa", "scalar"][..], &["--threads", "3"]].map(|machine| {
            render_ok(&scene, &path(name), &[&seen[..], options, machine].concat());
            std::fs::read(path(name)).expect("readable")
        });
        assert!(both[0] == both[1], "{name}");
        assert!(apart(&plain, &pixels(&path(name))).0 > 500, "{name}");
    }
    for same in [&["--footprint", "gaussian"][..], &["--f-stop", "inf"]] {
        render_ok(&scene, &path("same"), &[&seen[..], same].concat());
        assert!(std::fs::read(path("same")).expect("readable") == std::fs::read(path("plain")).expect("readable"));
    }
    // The record of a folder contains them.
    let out = scratch.path("folder");
    render_ok(
        &scene,
        &out,
        &[&seen[..], kinds[2].1, &["--footprint", "playcanvas", "--emit", "rgb,webp,exr"]].concat(),
    );
    let output = command().arg("verify").arg(&out).output().expect("the program starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// Builds a grid of N×N Gaussians as in splat-transform's tests (fixtures/splat-transform/README.md), as a PLY file.
fn grid(side: usize, spacing: f64, deviation: f64) -> Vec<u8> {
    let names = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3";
    let properties: String = names.split(' ').map(|name| format!("property float {name}\n")).collect();
    let header =
        format!("ply\nformat binary_little_endian 1.0\nelement vertex {}\n{properties}end_header\n", side * side);
    let mut bytes = header.into_bytes();
    let coefficient = |colour: f64| (colour - 0.5) / Y0;
    let shade = |i: usize| coefficient((i + 1) as f64 / (side + 1) as f64);
    let place = |i: usize| (i as f64 - side as f64 / 2.0) * spacing;
    for (z, x) in (0..side).flat_map(|z| (0..side).map(move |x| (z, x))) {
        let scale = deviation.ln();
        let row =
            [place(x), 0.0, place(z), shade(x), shade(z), 0.0, 9_f64.ln(), scale, scale, scale, 1.0, 0.0, 0.0, 0.0];
        bytes.extend(row.iter().flat_map(|value| (*value as f32).to_le_bytes()));
    }
    bytes
}

#[test]
fn golden_pictures_of_splat_transform_come_out_with_its_footprint() {
    let scratch = Scratch::new();
    let scenes = [("400", 20, 1.0, 0.1, [0, 5, -8], [320, 240]), ("48400", 220, 0.3, 0.05, [0, 10, -15], [640, 360])];
    for (name, side, spacing, deviation, position, [width, height]) in scenes {
        let (scene, camera, out) = (scratch.path("grid.ply"), scratch.path("camera.json"), scratch.path("grid.png"));
        std::fs::write(&scene, grid(side, spacing, deviation)).expect("writable");
        let look = serde_json::json!({
            "type": "pinhole", "position": position, "look_at": [0, 0, 0], "up": [0, 1, 0],
            "fov_y_degrees": 60, "aspect": f64::from(width) / f64::from(height),
        });
        std::fs::write(&camera, look.to_string()).expect("writable");
        let golden = pixels(&streamsplat_fixtures::path(&format!("splat-transform/{name}.webp")));
        let size = format!("{width}x{height}");
        let seen = ["--camera", camera.to_str().expect("a name"), "--size", &size, "--background", "0"];
        render_ok(&scene, &out, &[&seen[..], &["--footprint", "splat-transform"]].concat());
        let (differ, most) = apart(&golden, &pixels(&out));
        // They differ only by rounding to 8 bits.
        assert!(most <= 1 && differ < golden.as_raw().len() / 1000, "{name}: {differ} samples, at most {most} apart");
        render_ok(&scene, &out, &seen);
        assert!(apart(&golden, &pixels(&out)).1 >= 5, "{name}: the plain footprint is another");
    }
}

#[test]
fn a_panorama_is_taken_from_the_middle_and_a_camera_file_can_ask_for_one() {
    let scratch = Scratch::new();
    let (scene, _) = prepared(&scratch);
    let out = scratch.path("around.png");
    render_ok(&scene, &out, &["--panorama", "--json", scratch.path("run.json").to_str().expect("a name")]);
    let image = pixels(&out);
    assert_eq!(image.dimensions(), (2048, 1024));
    assert_eq!(json(&scratch.path("run.json"))["image_size"], serde_json::json!([2048, 1024]));
    // No seam: the edges differ no more than neighbours elsewhere.
    let column = |x: u32| (0..1024).map(|y| image.get_pixel(x, y).0).collect::<Vec<_>>();
    let differ = |a: u32, b: u32| -> u64 {
        column(a).iter().flatten().zip(column(b).iter().flatten()).map(|(a, b)| u64::from(a.abs_diff(*b))).sum()
    };
    assert!(differ(2047, 0) < 2 * differ(1000, 1001).max(differ(1500, 1501)) + 2000, "{}", differ(2047, 0));
    // Around a pole the colour is constant.
    let top: Vec<[u8; 4]> = (0..2048).map(|x| image.get_pixel(x, 0).0).collect();
    for channel in 0..3 {
        let values = || top.iter().map(|pixel| pixel[channel]);
        assert!(values().max().expect("pixels") - values().min().expect("pixels") < 8, "channel {channel}");
    }
    let camera = scratch.path("around.json");
    std::fs::write(&camera, r#"{"type": "equirectangular", "position": [0.1, 0, 0], "look_at": [1, 0, 0]}"#)
        .expect("writable");
    let (by_type, by_option) = (scratch.path("type.png"), scratch.path("option.png"));
    let seen = ["--camera", camera.to_str().expect("a name"), "--size", "128x64"];
    render_ok(&scene, &by_type, &seen);
    render_ok(&scene, &by_option, &[&seen[..], &["--panorama"]].concat());
    assert!(std::fs::read(by_type).expect("readable") == std::fs::read(by_option).expect("readable"));
}

#[test]
fn what_cannot_be_drawn_so_is_wrong_use() {
    let scratch = Scratch::new();
    let (scene, camera) = prepared(&scratch);
    let camera = camera.to_str().expect("a name");
    let around = scratch.path("around.json");
    std::fs::write(&around, r#"{"type": "equirectangular"}"#).expect("writable");
    let around = around.to_str().expect("a name");
    let out = scratch.path("a.png");
    let wrong: [(&[&str], &str); 12] = [
        (&["--f-stop", "0"], "--f-stop 0: expected a number above 0"),
        (&["--f-stop", "NaN"], "--f-stop NaN"),
        (&["--f-stop", "2", "--focus", "0"], "--focus 0: expected a distance above 0, or inf"),
        (&["--f-stop", "2", "--focus", "nan"], "--focus nan"),
        (&["--f-stop", "2", "--focus", "-inf"], "--focus -inf"),
        (&["--f-stop", "2", "--sensor-height", "0"], "--sensor-height 0"),
        (&["--f-stop", "2", "--panorama"], "--f-stop: expected none beside --panorama"),
        (&["--footprint", "round"], "--footprint round: expected gaussian, splat-transform, playcanvas"),
        (&["--shutter", "361"], "--shutter 361: expected from 0 to 360 degrees"),
        (&["--shutter", "-1"], "--shutter -1"),
        (&["--shutter", "NaN"], "--shutter NaN"),
        (&["--shutter", "180"], "--shutter: expected a camera that moves"),
    ];
    for (options, expected) in wrong {
        let line = fails(&render(&scene, &out, &[&["--camera", camera, "--size", "30x20"], options].concat()), 2);
        assert!(line.contains(expected), "{line}");
        assert!(!out.exists(), "{options:?}");
    }
    let line = fails(&render(&scene, &out, &["--camera", around, "--size", "32x16", "--f-stop", "2"]), 1);
    assert!(line.contains("aperture: expected a pinhole camera"), "{line}");
    let line = fails(&render(&scene, &out, &["--camera", around, "--size", "32x16", "--stereo"]), 2);
    assert!(line.contains("--stereo"), "{line}");
    // The scene's middle is behind the camera.
    let behind = scratch.path("behind.json");
    let view =
        r#"{"type": "pinhole", "position": [0, 0, 9], "look_at": [0, 0, 10], "fov_y_degrees": 45, "aspect": 1.5}"#;
    std::fs::write(&behind, view).expect("writable");
    let seen = ["--camera", behind.to_str().expect("a name"), "--size", "30x20", "--f-stop", "2"];
    assert!(fails(&render(&scene, &out, &seen), 1).contains("distance of the focus"));
    assert!(!out.exists());
}

#[test]
fn a_still_is_written_as_webp_without_loss() {
    let scratch = Scratch::new();
    let (scene, camera) = prepared(&scratch);
    let seen = ["--camera", camera.to_str().expect("a name"), "--size", "61x40"];
    for background in ["0.25,0.5,0.75", "transparent"] {
        let [webp, png] = ["webp", "png"].map(|ending| {
            let out = scratch.path(&format!("still.{ending}"));
            render_ok(&scene, &out, &[&seen[..], &["--background", background]].concat());
            out
        });
        let bytes = std::fs::read(&webp).expect("readable");
        assert!(bytes.starts_with(b"RIFF") && &bytes[8..16] == b"WEBPVP8L", "{background}");
        assert_eq!(apart(&pixels(&webp), &pixels(&png)), (0, 0), "{background}");
        let again = scratch.path("again.webp");
        render_ok(
            &scene,
            &again,
            &[&seen[..], &["--background", background, "--threads", "1", "--isa", "scalar"]].concat(),
        );
        assert!(std::fs::read(again).expect("readable") == bytes);
    }
    let out = scratch.path("emitted");
    render_ok(&scene, &out, &[&seen[..], &["--emit", "rgb,webp"]].concat());
    let names: Vec<String> = files(&out).into_keys().collect();
    assert_eq!(names, ["frames/000000.png", "frames/000000.webp"]);
    let line = fails(&render(&scene, &scratch.path("a.webp"), &[&seen[..2], &["--size", "16384x2"]].concat()), 2);
    assert!(line.contains("expected at most 16383 a side for WebP"), "{line}");
}

/// Runs a clip and returns its scene.
fn moving(scratch: &Scratch) -> PathBuf {
    let (clip, out) = (scratch.clip("clip", 4, 80, 48), scratch.path("run"));
    run_ok(&clip, &out, &["--emit", "scene", "--fps", "8"]);
    out
}

#[test]
fn a_shutter_is_the_mean_of_its_images_across_intervals_as_well() {
    let scratch = Scratch::new();
    let scene = moving(&scratch);
    let folder = |name: &str, more: &[&str]| {
        let out = scratch.path(name);
        render_ok(&scene, &out, more);
        files(&out)
    };
    assert!(folder("closed", &["--shutter", "0"]) == folder("plain", &[]));
    let times = ["--times", "0,0.125,0.2"];
    let open = ["--shutter", "270", "--shutter-samples", "6"];
    let found = folder("open", &[&times[..], &open].concat());
    assert!(found == folder("again", &[&times[..], &open, &["--threads", "1", "--isa", "scalar"]].concat()));
    let output = command().arg("verify").arg(scratch.path("open")).output().expect("the program starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));

    let workers = Workers::new(Level::detect(), 2).expect("threads start");
    let opened = Scene::open(&scene.join("scene")).expect("a scene");
    let (first, last) = opened.span();
    let draw = |time: f64| -> Image {
        let interval = opened.interval(opened.find(time).expect("inside")).expect("an interval");
        Renderer::new(&workers)
            .render(&interval, time, &Camera::Canonical, &RenderOptions::default())
            .expect("drawn")
            .clone()
    };
    for (index, time) in [0.0, 0.125, 0.2].into_iter().enumerate() {
        let mut exposure = Exposure::new(Level::scalar(), false);
        for i in 0..6 {
            let part = 0.75 * ((f64::from(i) + 0.5) / 6.0 - 0.5);
            exposure.add(&draw((time + part / 8.0_f64).clamp(first, last)));
        }
        let Image { width, height, rgb, .. } = exposure.mean();
        let expected = picture_png(&Picture { width, height, rgb });
        assert!(found[&format!("frames/{index:06}.png")] == expected, "{time}");
    }
    // A camera that moves around one time, and one that moves while time runs on.
    for motion in [&["--times", "0.125", "--sway=6:0.5"][..], &["--orbit", "20"]] {
        let sharp = folder("sharp", motion);
        let blurred = folder("blurred", &[motion, &["--shutter", "360", "--shutter-samples", "3"]].concat());
        assert!(sharp.len() == blurred.len() && sharp != blurred, "{motion:?}");
    }
    let line = fails(&render(&scene, &scratch.path("no"), &["--f-stop", "2"]), 2);
    assert!(line.contains("expected --focus as well"), "{line}");
    let line = fails(&render(&scene, &scratch.path("no"), &["--panorama"]), 2);
    assert!(line.contains("--panorama: expected a place (--camera)"), "{line}");
    let line = fails(&render(&scene, &scratch.path("no"), &["--f-stop", "2", "--focus", "1"]), 1);
    assert!(line.contains("aperture: expected a pinhole camera"), "{line}");
    // Scenes in time have panoramas and depth of field if a camera has a position.
    let camera = scratch.path("inside.json");
    let view =
        r#"{"type": "pinhole", "position": [0, 0, -1], "look_at": [0, 0, 1], "fov_y_degrees": 60, "aspect": 1.6}"#;
    std::fs::write(&camera, view).expect("writable");
    let seen = ["--camera", camera.to_str().expect("a name"), "--times", "0.1"];
    let sharp = folder("seen", &seen);
    let blurred = folder("lens", &[&seen[..], &["--f-stop", "1", "--focus", "1", "--sensor-height", "1"]].concat());
    assert!(sharp != blurred);
    let around = scratch.path("around.png");
    render_ok(&scene, &around, &[&seen[..], &["--panorama", "--size", "128x64"]].concat());
    assert_eq!(pixels(&around).dimensions(), (128, 64));
}

#[test]
fn a_shutter_blurs_what_a_moving_camera_sees_of_a_still_scene() {
    let scratch = Scratch::new();
    let (scene, _) = prepared(&scratch);
    let round = ["--turntable", "0.25", "--fps", "16", "--size", "60x40"];
    let folder = |name: &str, more: &[&str]| {
        let out = scratch.path(name);
        render_ok(&scene, &out, &[&round[..], more].concat());
        files(&out)
    };
    let (sharp, blurred) = (folder("sharp", &[]), folder("blurred", &["--shutter", "180", "--shutter-samples", "4"]));
    assert_eq!(sharp.len(), 4);
    assert!(blurred.iter().zip(&sharp).all(|((_, a), (_, b))| a != b));
    assert!(folder("closed", &["--shutter", "0"]) == sharp);
    // A single sample is in the middle: the image itself, up to a rounding of its light.
    folder("one", &["--shutter", "360", "--shutter-samples", "1"]);
    let one = |name: &str| pixels(&scratch.path(name).join("frames/000002.png"));
    assert!(apart(&one("one"), &one("sharp")).1 <= 1);
}
