//! Cameras of other programs: one scene through all of them has the same bytes.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Output;

use crate::still::prepared;
use crate::support::{Scratch, command, fails, files};

/// World to camera: quaternion and translation of two images, with principal points off centre and pixels that are not
/// square.
const IMAGES: [(&str, [f64; 4], [f64; 3]); 2] = [
    ("left.png", [0.9833474432563559, 0.03427, 0.17825, 0.00631], [0.31, -0.12, 3.1]),
    ("right.png", [0.9721, -0.0532, -0.2217, 0.0431], [-0.2, 0.17, 2.7]),
];
const SIZE: [f64; 2] = [90.0, 60.0];
const FOCAL: [f64; 2] = [88.0, 72.5];
const CENTRE: [f64; 2] = [41.5, 33.25];

/// Converts to camera to world: the rotation's rows and the centre.
fn pose([w, x, y, z]: [f64; 4], t: [f64; 3]) -> ([[f64; 3]; 3], [f64; 3]) {
    let n = (w * w + x * x + y * y + z * z).sqrt();
    let [w, x, y, z] = [w / n, -x / n, -y / n, -z / n];
    let rows = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ];
    (rows, rows.map(|row| -(row[0] * t[0] + row[1] * t[1] + row[2] * t[2])))
}

fn own(scratch: &Scratch, centre: [f64; 2]) -> PathBuf {
    let views = IMAGES.iter().enumerate().map(|(i, (_, [w, x, y, z], t))| {
        let (_, position) = pose([*w, *x, *y, *z], *t);
        let rotation = [*w, -x, -y, -z];
        let [fx, fy] = [FOCAL[0] / SIZE[0], FOCAL[1] / SIZE[1]];
        let [cx, cy] = [centre[0] / SIZE[0], centre[1] / SIZE[1]];
        format!(
            r#"{{"time": {i}, "type": "pinhole", "position": {position:?}, "rotation": {rotation:?}, "focal": [{fx}, {fy}], "centre": [{cx}, {cy}]}}"#
        )
    });
    let path = scratch.path("own.json");
    let views: Vec<String> = views.collect();
    std::fs::write(&path, format!(r#"{{"views": [{}]}}"#, views.join(", "))).expect("writable");
    path
}

fn inria(scratch: &Scratch, centre: [f64; 2]) -> PathBuf {
    let ([w, h], [cx, cy]) = (SIZE, centre);
    let [fx, fy] = FOCAL;
    let entries: Vec<String> = IMAGES
        .iter()
        .enumerate()
        .map(|(id, (name, q, t))| {
            let (rows, position) = pose(*q, *t);
            let name = name.trim_end_matches(".png");
            format!(
                r#"{{"id": {id}, "img_name": "{name}", "width": {w}, "height": {h}, "position": {position:?}, "rotation": {rows:?}, "fy": {fy}, "fx": {fx}, "cx": {cx}, "cy": {cy}}}"#
            )
        })
        .collect();
    let path = scratch.path("cameras.json");
    std::fs::write(&path, format!("[{}]", entries.join(", "))).expect("writable");
    path
}

fn transforms(scratch: &Scratch, centre: [f64; 2]) -> PathBuf {
    let ([w, h], [fx, fy], [cx, cy]) = (SIZE, FOCAL, centre);
    let frames: Vec<String> = IMAGES
        .iter()
        .map(|(name, q, t)| {
            let (rows, c) = pose(*q, *t);
            let row = |i: usize| format!("[{}, {}, {}, {}]", rows[i][0], -rows[i][1], -rows[i][2], c[i]);
            let matrix = format!("[{}, {}, {}, [0, 0, 0, 1]]", row(0), row(1), row(2));
            format!(r#"{{"file_path": "images/{name}", "transform_matrix": {matrix}}}"#)
        })
        .collect();
    let path = scratch.path("transforms.json");
    let lens = format!(
        r#""camera_model": "OPENCV", "w": {w}, "h": {h}, "fl_x": {fx}, "fl_y": {fy}, "cx": {cx}, "cy": {cy}, "k1": 0.0"#
    );
    std::fs::write(&path, format!(r#"{{{lens}, "frames": [{}]}}"#, frames.join(", "))).expect("writable");
    path
}

fn colmap_text(scratch: &Scratch, centre: [f64; 2]) -> PathBuf {
    let ([w, h], [fx, fy], [cx, cy]) = (SIZE, FOCAL, centre);
    let folder = scratch.path("text");
    std::fs::create_dir_all(&folder).expect("writable");
    std::fs::write(folder.join("cameras.txt"), format!("# cameras\n4 PINHOLE {w} {h} {fx} {fy} {cx} {cy}\n"))
        .expect("writable");
    let lines: String = IMAGES
        .iter()
        .rev()
        .map(|(name, [w, x, y, z], [a, b, c])| format!("9 {w} {x} {y} {z} {a} {b} {c} 4 {name}\n1 2 -1\n"))
        .collect();
    std::fs::write(folder.join("images.txt"), lines).expect("writable");
    folder
}

/// Writes a model with wrong poses in `images.txt`, and the right ones in its rigs and frames.
fn colmap_rigs(scratch: &Scratch, centre: [f64; 2]) -> PathBuf {
    let folder = colmap_text(scratch, centre);
    let (model, [a, b]) = (scratch.path("rigs"), IMAGES);
    std::fs::create_dir_all(&model).expect("writable");
    let write = |name: &str, text: String| std::fs::write(model.join(name), text).expect("writable");
    std::fs::copy(folder.join("cameras.txt"), model.join("cameras.txt")).expect("writable");
    write("images.txt", format!("1 1 0 0 0 9 9 9 4 {}\n\n2 1 0 0 0 9 9 9 4 {}\n\n", a.0, b.0));
    write("rigs.txt", "# rigs\n3 1 CAMERA 4\n".to_owned());
    let frames =
        [a, b].map(|(_, q, t)| [&q[..], &t[..]].concat().iter().map(f64::to_string).collect::<Vec<_>>().join(" "));
    write("frames.txt", format!("1 3 {} 1 CAMERA 4 1\n2 3 {} 1 CAMERA 4 2\n", frames[0], frames[1]));
    model
}

fn colmap_binary(scratch: &Scratch, centre: [f64; 2]) -> PathBuf {
    let folder = scratch.path("project");
    let model = folder.join("sparse/0");
    std::fs::create_dir_all(&model).expect("writable");
    let mut cameras = 1_u64.to_le_bytes().to_vec();
    [4_u32, 1].iter().for_each(|n| cameras.extend(n.to_le_bytes()));
    SIZE.iter().for_each(|side| cameras.extend((*side as u64).to_le_bytes()));
    FOCAL.iter().chain(&centre).for_each(|p| cameras.extend(p.to_le_bytes()));
    let mut images = 2_u64.to_le_bytes().to_vec();
    for (name, q, t) in IMAGES {
        images.extend(1_u32.to_le_bytes());
        q.iter().chain(&t).for_each(|n| images.extend(n.to_le_bytes()));
        images.extend(4_u32.to_le_bytes());
        images.extend(name.as_bytes());
        images.extend([0_u8; 9]);
    }
    std::fs::write(model.join("cameras.bin"), cameras).expect("writable");
    std::fs::write(model.join("images.bin"), images).expect("writable");
    folder
}

fn render(scene: &Path, camera: &Path, out: &Path, more: &[&str]) -> Output {
    let mut command = command();
    command.arg("render").arg(scene).arg("--camera").arg(camera).arg("--out").arg(out);
    command.args(more).output().expect("the program starts")
}

fn drawn(scratch: &Scratch, name: &str, scene: &Path, camera: &Path, more: &[&str]) -> BTreeMap<String, Vec<u8>> {
    let out = scratch.path(name);
    let output = render(scene, camera, &out, more);
    assert!(output.status.success(), "{name}: {}", String::from_utf8_lossy(&output.stderr));
    files(&out)
}

#[test]
fn a_scene_through_every_camera_file_has_the_same_bytes() {
    let scratch = Scratch::new();
    let (scene, _) = prepared(&scratch);
    for (kind, centre) in [("middle", SIZE.map(|side| 0.5 * side)), ("off", CENTRE)] {
        let own = own(&scratch, centre);
        let expected = drawn(&scratch, &format!("{kind}-own"), &scene, &own, &["--size", "90x60", "--times", "0,1"]);
        assert_eq!(expected.len(), 2);
        assert!(expected["frames/000000.png"] != expected["frames/000001.png"]);
        let others = vec![
            ("inria", inria(&scratch, centre)),
            ("rigs", colmap_rigs(&scratch, centre)),
            ("transforms", transforms(&scratch, centre)),
            ("text", colmap_text(&scratch, centre)),
            ("binary", colmap_binary(&scratch, centre)),
            ("one-file", colmap_text(&scratch, centre).join("images.txt")),
        ];
        for (name, camera) in others {
            // Without a size: the cameras' own.
            let found = drawn(&scratch, &format!("{kind}-{name}"), &scene, &camera, &[]);
            assert!(found == expected, "{kind}, {name}");
            for view in ["1", "right"] {
                let out = format!("{kind}-{name}-{view}");
                let one = drawn(&scratch, &out, &scene, &camera, &["--view", view]);
                assert_eq!(one.len(), 1);
                assert!(one["frames/000000.png"] == expected["frames/000001.png"], "{out}");
            }
        }
    }
}

#[test]
fn a_rendering_with_cameras_of_others_can_be_verified() {
    let scratch = Scratch::new();
    let (scene, _) = prepared(&scratch);
    let out = scratch.path("out");
    let output = render(&scene, &colmap_binary(&scratch, CENTRE), &out, &["--view", "left.png"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let output = command().arg("verify").arg(&out).output().expect("the program starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn cameras_that_cannot_be_used_are_named() {
    let scratch = Scratch::new();
    let (scene, own) = prepared(&scratch);
    let out = scratch.path("out");
    let inria = inria(&scratch, CENTRE);
    let text = fails(&render(&scene, &inria, &out, &["--view", "9"]), 2);
    assert!(text.contains("expected a number from 0 to 1 or a name such as left, found 9"), "{text}");
    let text = fails(&render(&scene, &own, &out, &["--view", "0", "--size", "9x6"]), 2);
    assert!(text.contains("expected a camera file of another program"), "{text}");
    let folder = colmap_text(&scratch, CENTRE);
    std::fs::write(folder.join("cameras.txt"), "4 OPENCV 90 60 88 88 45 30 0.1 0 0 0\n").expect("writable");
    let text = fails(&render(&scene, &folder, &out, &[]), 1);
    assert!(text.contains("camera 4: expected SIMPLE_PINHOLE or PINHOLE") && text.contains("found OPENCV"), "{text}");
    let empty = scratch.path("empty");
    std::fs::create_dir(&empty).expect("writable");
    assert!(fails(&render(&scene, &empty, &out, &[]), 1).contains("expected cameras and images as .bin or .txt"));
    std::fs::write(&inria, "[]").expect("writable");
    assert!(fails(&render(&scene, &inria, &out, &[]), 1).contains("expected at least one camera, found none"));
    assert!(!out.exists());
}

#[test]
fn a_distorted_camera_refuses_only_the_views_through_it() {
    let scratch = Scratch::new();
    let (scene, _) = prepared(&scratch);
    let folder = colmap_text(&scratch, CENTRE);
    let expected = drawn(&scratch, "all", &scene, &folder, &["--view", "left"]);
    let cameras = std::fs::read_to_string(folder.join("cameras.txt")).expect("just written");
    std::fs::write(folder.join("cameras.txt"), cameras + "5 EUCM 90 60 88 88 45 30 0.1 0\n").expect("writable");
    let images = std::fs::read_to_string(folder.join("images.txt")).expect("just written");
    std::fs::write(folder.join("images.txt"), images.replace("4 right.png", "5 right.png")).expect("writable");
    assert!(drawn(&scratch, "one", &scene, &folder, &["--view", "left"]) == expected);
    for (more, code) in [(&["--view", "right"][..], 1), (&[], 1)] {
        let text = fails(&render(&scene, &folder, &scratch.path("none"), more), code);
        assert!(text.contains("camera 5: expected SIMPLE_PINHOLE or PINHOLE") && text.contains("found EUCM"), "{text}");
        assert_eq!(text.contains("--view left.png"), more.is_empty(), "{text}");
    }
}

#[test]
fn cameras_of_viewers_are_read_with_their_fields_of_view() {
    let scratch = Scratch::new();
    let (scene, _) = prepared(&scratch);
    let write = |name: &str, text: &str| {
        let path = scratch.path(name);
        std::fs::write(&path, text).expect("writable");
        path
    };
    // The same view three times: at (1, −2, −4), looking along +z, with 60° from top to bottom of 90×60 pixels.
    let own =
        write("own.json", r#"{"type": "pinhole", "position": [0.1, -0.2, -4], "fov_y_degrees": 60, "aspect": 1.5}"#);
    let nerfstudio = write(
        "camera_path.json",
        r#"{"camera_type": "perspective", "render_width": 90, "render_height": 60, "fps": 10, "seconds": 1, "camera_path": [
            {"camera_to_world": [1,0,0,0.1, 0,-1,0,-0.2, 0,0,-1,-4, 0,0,0,1], "fov": 60, "aspect": 7},
            {"camera_to_world": [1,0,0,0.1, 0,-1,0,-0.2, 0,0,-1,-4, 0,0,0,1], "fov": 60, "aspect": 7}]}"#,
    );
    let across = 2.0 * (1.5 * 30.0_f64.to_radians().tan()).atan().to_degrees();
    let supersplat = write(
        "settings.json",
        &format!(
            r#"{{"version": 2, "cameras": [{{"initial": {{"position": [-0.1, 0.2, -4], "target": [-0.1, 0.2, 0], "fov": {across}}}}}], "animTracks": [], "annotations": []}}"#
        ),
    );
    let picture = |name: &str, camera: &Path, more: &[&str]| {
        image::load_from_memory(&drawn(&scratch, name, &scene, camera, more)["frames/000000.png"])
            .expect("a picture")
            .into_rgb8()
    };
    let expected = picture("own", &own, &["--size", "90x60"]);
    for (name, camera, more) in [("path", &nerfstudio, &[][..]), ("settings", &supersplat, &["--size", "90x60"])] {
        let found = picture(name, camera, more);
        let far = found.as_raw().iter().zip(expected.as_raw()).map(|(a, b)| a.abs_diff(*b)).max();
        // Fields of view are angles, and so not exact in binary64.
        assert!(far <= Some(1), "{name}: {far:?}");
    }
    assert_eq!(drawn(&scratch, "both", &scene, &nerfstudio, &[]).len(), 2);
}

#[test]
fn what_is_no_camera_is_told_what_is_read() {
    let scratch = Scratch::new();
    let (scene, own) = prepared(&scratch);
    let path = scratch.path("other.json");
    let text = |content: &[u8]| {
        std::fs::write(&path, content).expect("writable");
        fails(&render(&scene, &path, &scratch.path("none"), &["--size", "9x6"]), 1)
    };
    for content in [&b"{\"cameras\": 3, \"b\": 4}"[..], b"\x80\x02 pickled", b"", b"hello", b"7"] {
        let text = text(content);
        for read in [
            "expected a camera of this program",
            "cameras.json",
            "transforms.json",
            "camera_path.json",
            "settings.json",
            "COLMAP",
        ] {
            assert!(text.contains(read), "{text}");
        }
    }
    let keys = text(b"{\"cameras\": 3, \"b\": 4}");
    assert!(keys.contains("found an object with") && keys.contains("cameras") && keys.contains("b"), "{keys}");
    let nan = text(br#"{"w": 9, "h": 6, "fl_x": 9, "k1": NaN, "frames": []}"#);
    assert!(nan.contains("expected a finite number for k1, found NaN, which Python's json module writes"), "{nan}");
    let content = std::fs::read(&own).expect("a camera");
    let plain = drawn(&scratch, "plain", &scene, &own, &["--size", "9x6"]);
    std::fs::write(&path, [&b"\xef\xbb\xbf"[..], &content].concat()).expect("writable");
    assert!(drawn(&scratch, "marked", &scene, &path, &["--size", "9x6"]) == plain);
}
