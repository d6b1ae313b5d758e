//! Still images and depth maps as inputs of a run.

use std::path::Path;

use streamsplat_fixtures as fixtures;

use crate::compare::apng;
use crate::support::{Scratch, command, fails, model};

/// Runs `run` with the small model.
fn attempt(input: &Path, out: &Path, more: &[&str]) -> std::process::Output {
    let mut command = command();
    command.arg("run").arg(input).arg("--out").arg(out).arg("--model").arg(model()).args(more);
    command.output().expect("the program starts")
}

/// Builds an NPY file of 2×2 numbers.
fn npy(value: f32) -> Vec<u8> {
    let header = "{'descr': '<f4', 'fortran_order': False, 'shape': (2, 2), }\n";
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend_from_slice(header.as_bytes());
    bytes.extend([value, 1.0, 2.0, 3.0].iter().flat_map(|v| v.to_le_bytes()));
    bytes
}

#[test]
fn another_number_of_depth_maps_than_of_frames_is_refused_before_any_work() {
    let scratch = Scratch::new();
    let (maps, out) = (scratch.path("maps"), scratch.path("out"));
    std::fs::create_dir(&maps).expect("writable");
    for index in 0..6 {
        std::fs::write(maps.join(format!("{index}.npy")), npy(index as f32)).expect("writable");
    }
    let clip = fixtures::path("clips/moving.y4m");
    let of = |more: &[&str]| attempt(&clip, &out, &[&["--depth", maps.to_str().expect("UTF-8")], more].concat());
    let text = fails(&of(&["--frames", "3"]), 1);
    assert!(text.contains("maps: expected 3 depth maps, one for each frame, found 6"), "{text}");
    let text = fails(&of(&[]), 1);
    assert!(text.contains("depth maps, one for each frame, found 6"), "{text}");
    assert!(!out.join("run.json").exists());
    // Previews with the same names are not maps.
    for index in 0..6 {
        if index > 2 {
            std::fs::remove_file(maps.join(format!("{index}.npy"))).expect("there");
        } else {
            image::GrayImage::new(2, 2).save(maps.join(format!("{index}.png"))).expect("writable");
        }
    }
    let done = of(&["--frames", "3", "--gap", "1"]);
    let text = String::from_utf8_lossy(&done.stderr);
    assert!(done.status.success(), "{text}");
    assert!(text.contains("depth is taken from 3 .npy files, 3 other files of the same names are left out"), "{text}");
}

#[test]
fn what_is_done_to_an_image_after_the_first_is_said_once() {
    let scratch = Scratch::new();
    let (clip, out) = (scratch.clip("clip", 4, 40, 24), scratch.path("out"));
    for name in ["1.png", "2.png"] {
        image::RgbaImage::new(40, 24).save(clip.join(name)).expect("writable");
    }
    let done = attempt(&clip, &out, &[]);
    let text = String::from_utf8_lossy(&done.stderr);
    assert!(done.status.success(), "{text}");
    assert_eq!(text.matches("transparent parts are laid over mid grey").count(), 1, "{text}");
}

#[test]
fn files_of_a_folder_that_are_no_images_are_said_and_links_to_nowhere_refused() {
    let scratch = Scratch::new();
    let (clip, out) = (scratch.clip("clip", 2, 40, 24), scratch.path("out"));
    for name in ["0004.jp2", "0005.heic", ".hidden"] {
        std::fs::write(clip.join(name), "x").expect("writable");
    }
    let done = attempt(&clip, &out, &[]);
    let text = String::from_utf8_lossy(&done.stderr);
    assert!(done.status.success(), "{text}");
    assert!(text.contains("left out, as it is no image of a kind that is read: 0004.jp2, and 1 more"), "{text}");
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink("nowhere", clip.join("3.png")).expect("writable");
        let text = fails(&attempt(&clip, &scratch.path("other"), &[]), 1);
        assert!(text.contains("3.png: No such file"), "{text}");
    }
}

#[test]
fn depth_maps_that_hold_no_depth_are_said() {
    let scratch = Scratch::new();
    let (clip, maps) = (scratch.clip("clip", 3, 40, 24), scratch.path("maps"));
    std::fs::create_dir(&maps).expect("writable");
    for index in 0..3 {
        let map = npy(1.0);
        let values = if index == 1 { [2.0; 4] } else { [-1.0; 4] };
        let numbers = values.iter().flat_map(|v: &f32| v.to_le_bytes());
        let file: Vec<u8> = map[..map.len() - 16].iter().copied().chain(numbers).collect();
        std::fs::write(maps.join(format!("{index}.npy")), file).expect("writable");
    }
    let more = ["--depth", maps.to_str().expect("UTF-8"), "--depth-model", "metric", "--gap", "1"];
    let done = attempt(&clip, &scratch.path("out"), &more);
    let text = String::from_utf8_lossy(&done.stderr);
    assert!(done.status.success(), "{text}");
    assert!(text.contains("3 of 3 depth maps hold no depth: nothing measured, or one value everywhere"), "{text}");
}

#[test]
fn times_that_y4m_cannot_hold_are_said_by_render_too() {
    let scratch = Scratch::new();
    let (clip, out) = (scratch.path("clip.png"), scratch.path("out"));
    std::fs::write(&clip, apng(&[[1, 2], [3, 4], [5, 6]])).expect("writable");
    let run = attempt(&clip, &out, &["--gap", "1"]);
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    let render = |more: &[&str]| {
        let mut command = command();
        command.arg("render").arg(&out).args(more).arg("--out").arg(scratch.path("v.y4m"));
        let done = command.output().expect("the program starts");
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        String::from_utf8_lossy(&done.stderr).contains("y4m holds no times")
    };
    assert!(render(&[]) && !render(&["--fps", "10"]));
}
