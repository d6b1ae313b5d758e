//! `golden`: images recorded once are checked with zero tolerance.

use std::path::{Path, PathBuf};
use std::process::Output;

use streamsplat::formats;

use crate::still::still;
use crate::support::{Scratch, command, fails, json};

const LIST: &str = r#"
[[render]]
name = "front"
scene = "scene.ply"
size = "96x64"

[[render]]
name = "turn"
scene = "scene.ply"
size = "64x48"
orbit = "40:0.125"
background = "transparent"
"#;

fn golden(action: &str, list: &Path, more: &[&str]) -> Output {
    command().args(["golden", action]).arg(list).args(more).output().expect("the program starts")
}

fn recorded(scratch: &Scratch) -> PathBuf {
    let list = scratch.path("list.toml");
    std::fs::write(&list, LIST).expect("writable");
    std::fs::write(scratch.path("scene.ply"), formats::ply::write(&still()).bytes).expect("writable");
    let output = golden("record", &list, &[]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    list
}

#[test]
fn a_record_holds_on_every_level_and_thread_count() {
    let scratch = Scratch::new();
    let list = recorded(&scratch);
    let record = json(&scratch.path("list.golden/record.json"));
    assert_eq!(record["bit_contract"], streamsplat::BIT_CONTRACT);
    assert_eq!(record["renders"]["turn"]["images"].as_array().map(Vec::len), Some(3));
    let preview = image::open(scratch.path("list.golden/front-000000.png")).expect("a preview");
    assert_eq!((preview.width(), preview.height()), (96, 64));
    for level in streamsplat_kernels::Level::available() {
        for threads in ["1", "3"] {
            let output = golden("check", &list, &["--isa", level.name(), "--threads", threads]);
            assert!(output.status.success(), "{}: {}", level.name(), String::from_utf8_lossy(&output.stderr));
            let said = String::from_utf8_lossy(&output.stdout).into_owned();
            assert_eq!(said.lines().filter(|line| line.ends_with("equal")).count(), 4, "{said}");
            assert_eq!(said.lines().last(), Some(&*format!("{}: equal (4 images)", list.display())), "{said}");
        }
    }
    assert!(!scratch.path("list.failed").exists());
}

#[test]
fn a_recording_says_what_it_changed() {
    let scratch = Scratch::new();
    let list = recorded(&scratch);
    let again = |list: &Path| String::from_utf8(golden("record", list, &[]).stdout).expect("text");
    let text = again(&list);
    assert!(text.contains("front: 1 image, unchanged") && text.contains("turn: 3 images, unchanged"), "{text}");
    let other = LIST.replace("64x48", "64x50") + "[[render]]\nname = 'more'\nscene = 'scene.ply'\nsize = '8x8'\n";
    std::fs::write(&list, other).expect("writable");
    let text = fails(&golden("check", &list, &[]), 1);
    assert!(text.contains("images differ, 1 other check failed"), "{text}");
    let table = String::from_utf8(golden("check", &list, &[]).stdout).expect("text");
    assert!(table.contains("expected 64x48 pixels, found 64x50\n"), "{table}");
    let text = again(&list);
    assert!(text.contains("turn: 3 images, 3 changed") && text.contains("more: 1 image, new"), "{text}");
}

#[test]
fn one_bit_of_one_colour_is_found() {
    let scratch = Scratch::new();
    let list = recorded(&scratch);
    let before = json(&scratch.path("list.golden/record.json"));
    let mut changed = still();
    // The largest opaque Gaussian in front of the others is certain to be visible.
    let seen = |i: &usize| changed.logit[*i] > 2.0;
    let one = (0..changed.len()).filter(seen).min_by(|a, b| changed.mean[*a][2].total_cmp(&changed.mean[*b][2]));
    let one = one.expect("an opaque one");
    let scene = scratch.path("scene.ply");
    // The last bit is rounded away before blending, but the scene's digest differs.
    let original = changed.base[one][0].to_bits();
    changed.base[one][0] = f32::from_bits(original ^ 1);
    std::fs::write(&scene, formats::ply::write(&changed).bytes).expect("writable");
    let output = golden("check", &list, &["--isa", "scalar"]);
    fails(&output, 1);
    assert!(String::from_utf8_lossy(&output.stdout).contains("the scene changed"));
    // Another bit changes the images, far below the precision of 8 bits.
    changed.base[one][0] = f32::from_bits(original ^ (1 << 12));
    std::fs::write(&scene, formats::ply::write(&changed).bytes).expect("writable");
    let (junit, found) = (scratch.path("junit.xml"), scratch.path("found.json"));
    let [junit_option, found_option] = [format!("--junit={}", junit.display()), format!("--json={}", found.display())];
    let text = fails(&golden("check", &list, &[&junit_option, &found_option]), 1);
    assert!(
        text.contains(" differ, ") && text.contains(" other checks failed; see") && text.contains("list.failed"),
        "{text}"
    );
    let found = json(&found);
    let front = &found["checks"][0];
    assert_eq!((&front["render"], &front["passed"]), (&"front".into(), &false.into()), "{found}");
    assert_eq!(front["expected"], before["renders"]["front"]["images"][0]["blake3"]);
    assert_ne!(front["expected"], front["blake3"]);
    for kind in ["actual", "expected", "heat"] {
        assert!(scratch.path(&format!("list.failed/front-000000.{kind}.png")).is_file(), "{kind}");
    }
    let junit = std::fs::read_to_string(&junit).expect("XML");
    assert!(
        junit.contains(r#"<testcase classname="front" name="0 s""#) && junit.contains("<failure message="),
        "{junit}"
    );
    assert!(golden("record", &list, &[]).status.success());
    assert!(golden("check", &list, &["--quiet"]).status.success());
}

#[test]
fn a_scene_that_changed_where_no_image_shows_it_is_said() {
    let scratch = Scratch::new();
    let list = recorded(&scratch);
    let scene = scratch.path("scene.ply");
    let text = formats::ply::write(&still()).bytes;
    let end = text.windows(11).position(|part| part == b"end_header\n").expect("a header");
    let commented = [&text[..end], b"comment another\n", &text[end..]].concat();
    std::fs::write(&scene, commented).expect("writable");
    let output = golden("check", &list, &[]);
    assert!(fails(&output, 1).contains("list.toml: 2 checks failed"));
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(said.contains("the scene changed, and no bit of an image"), "{said}");
}

#[test]
fn a_record_of_another_contract_says_so() {
    let scratch = Scratch::new();
    let list = recorded(&scratch);
    let record = scratch.path("list.golden/record.json");
    let text = std::fs::read_to_string(&record).expect("a record");
    let current = format!("\"bit_contract\": {}", streamsplat::BIT_CONTRACT);
    let digest = json(&record)["renders"]["front"]["images"][0]["blake3"].as_str().expect("a digest").to_owned();
    std::fs::write(&record, text.replace(&current, "\"bit_contract\": 0").replace(&digest, "00")).expect("writable");
    let text = fails(&golden("check", &list, &[]), 1);
    assert!(text.contains("made under version 0 of the bit contract"), "{text}");
}

#[test]
fn what_is_missing_or_broken_is_named() {
    let scratch = Scratch::new();
    let list = scratch.path("list.toml");
    let text = fails(&golden("check", &list, &[]), 2);
    assert!(text.contains("list.toml"), "{text}");
    std::fs::write(&list, LIST).expect("writable");
    let text = fails(&golden("check", &list, &[]), 1);
    assert!(text.contains("record.json: expected a record, found none; make one with"), "{text}");
    let text = fails(&golden("record", &list, &[]), 1);
    assert!(text.contains("front: ") && text.contains("scene.ply"), "{text}");
    recorded(&scratch);
    std::fs::write(&list, LIST.replace("\"turn\"", "\"other\"")).expect("writable");
    let output = golden("check", &list, &[]);
    fails(&output, 1);
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(said.contains("not recorded yet") && said.contains("recorded, but not in the list any more"), "{said}");
    std::fs::write(scratch.path("list.golden/record.json"), "{}").expect("writable");
    fails(&golden("check", &list, &[]), 1);
}

#[test]
fn only_previews_that_a_recording_wrote_are_removed() {
    let scratch = Scratch::new();
    let list = recorded(&scratch);
    let precious = scratch.path("list.golden/turn-000001.png");
    std::fs::write(&precious, "mine").expect("writable");
    std::fs::write(&list, LIST.replace("\"turn\"", "\"other\"")).expect("writable");
    let output = golden("record", &list, &[]);
    assert!(output.status.success());
    assert!(String::from_utf8_lossy(&output.stderr).contains("turn-000001.png: left"));
    assert_eq!(std::fs::read(&precious).expect("there"), b"mine");
    assert!(!scratch.path("list.golden/turn-000000.png").exists(), "what was written is removed");
    assert!(scratch.path("list.golden/other-000000.png").is_file());
}

#[cfg(unix)]
#[test]
fn nothing_is_written_through_a_link() {
    let scratch = Scratch::new();
    let list = recorded(&scratch);
    std::fs::write(scratch.path("scene.ply"), formats::ply::write(&changed()).bytes).expect("writable");
    let elsewhere = scratch.path("elsewhere");
    std::fs::create_dir(&elsewhere).expect("writable");
    std::os::unix::fs::symlink(&elsewhere, scratch.path("list.failed")).expect("writable");
    fails(&golden("check", &list, &[]), 1);
    assert_eq!(std::fs::read_dir(&elsewhere).expect("there").count(), 0);
    // A folder that the user names may be a link.
    fails(&golden("check", &list, &["--out", scratch.path("list.failed").to_str().expect("UTF-8")]), 1);
    assert!(elsewhere.join("front-000000.actual.png").is_file());
}

/// Returns the scene with every colour changed.
#[cfg(unix)]
fn changed() -> streamsplat::still::Still {
    let mut changed = still();
    changed.base.iter_mut().flatten().for_each(|value| *value += 0.25);
    changed
}
