//! A failure is one line with the cause and an exit code, and leaves no partial output.

use std::path::Path;

use streamsplat_fixtures as fixtures;

use crate::support::{Scratch, command, fails, model, run, run_ok};

/// Runs `run` with the small model and these arguments after the input and `--out`.
fn attempt(input: &Path, out: &Path, more: &[&str]) -> std::process::Output {
    command().arg("run").arg(input).arg("--out").arg(out).args(more).output().expect("the program starts")
}

/// Asserts that there is no file below `folder` (which may not exist).
fn nothing_written(folder: &Path) {
    if folder.exists() {
        let files = crate::support::files(folder);
        assert!(files.is_empty(), "{:?}", files.keys());
        assert!(!folder.join("run.json").exists());
    }
}

#[cfg(not(feature = "wgpu"))]
#[test]
fn a_renderer_that_was_not_built_in_is_wrong_use_that_names_the_feature() {
    let scratch = Scratch::new();
    let (clip, out) = (scratch.clip("clip", 2, 40, 24), scratch.path("out"));
    let text = fails(&attempt(&clip, &out, &["--renderer", "wgpu"]), 2);
    assert!(text.contains("--renderer wgpu: expected a program built with the cargo feature wgpu"), "{text}");
    nothing_written(&out);
}

#[test]
fn unknown_and_unavailable_values_are_wrong_use() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 2, 40, 24);
    let out = scratch.path("out");
    for (more, expected) in [
        (&["--isa", "sse9"][..], "--isa: unknown instruction set \"sse9\""),
        (&["--isa", if cfg!(target_arch = "aarch64") { "avx2" } else { "neon" }], "not available on this machine"),
        (&["--precision", "f64"], "--precision: unknown precision \"f64\""),
        (&["--threads", "0"], "--threads: expected a whole number from 1 to 1024, found \"0\""),
        (&["--threads", "many"], "--threads: expected a whole number from 1 to 1024"),
        (&["--gap", "0"], "--gap: expected a whole number"),
        (&["--gap", "auto:9-4"], "--gap: expected a whole number"),
        (&["--renderer", "metal"], "--renderer: unknown renderer \"metal\": expected one of cpu, wgpu"),
        (&["--fusion", "both"], "--fusion: unknown fusion \"both\""),
        (&["--resolution", "288"], "--resolution: unknown resolution \"288\""),
        (&["--motion", "flow"], "--motion: unknown motion \"flow\""),
        (&["--refine", "-1"], "--refine"),
        (&["--reuse", "1.1"], "--reuse: unknown reuse \"1.1\""),
        (&["--reuse", "some"], "--reuse: unknown reuse \"some\""),
        (&["--sampling", "mode"], "--sampling: unknown sampling"),
        (&["--seed", "x"], "--seed"),
        (&["--fit", "crop"], "--fit:"),
        (&["--depth", "onnx:model.onnx", "--depth-range", "clip"], "expected a folder of maps, found a network"),
        (&["--depth", "onnx:model.onnx", "--depth-model", "size=0"], "--depth-model: size=0: expected"),
        (
            &["--depth", "onnx:model.onnx", "--like-paper"],
            "--depth-range keys: expected a folder of maps, found a network",
        ),
        (
            &["--depth", ".", "--depth-range", "keys", "--gap", "auto:4"],
            "--depth-range keys: expected a fixed gap (--gap N)",
        ),
        (&["--like-paper", "--quality", "best"], "--like-paper"),
        (&["--depth-model", "metric"], "--depth-model: expected a network"),
        (&["--depth", "no/such/folder"], "--depth no/such/folder: expected"),
        (&["--depth-range", "all"], "--depth-range: unknown depth range \"all\": expected one of frame, clip, keys"),
        (&["--emit", "rgb,hologram"], "found \"hologram\""),
        (&["--size", "4x"], "--size: expected model, source or WIDTHxHEIGHT"),
        (&["--times", "2,1"], "--times: expected ascending times, found \"2,1\""),
        (&["--background", "red"], "--background: expected one number or R,G,B"),
        (&["--fps", "-3"], "--fps"),
        (&["--log", "loud"], "--log loud: expected"),
        (&["--matrix", "bt1886"], "--matrix: expected bt709, bt601,"),
    ] {
        let text = fails(&attempt(&clip, &out, more), 2);
        assert!(text.contains(expected), "{more:?}: {text}");
        nothing_written(&out);
    }
    for arguments in [&["fly"][..], &["run"], &["run", "-"], &[]] {
        let output = run(arguments);
        if arguments.is_empty() {
            // Without arguments the help is shown.
            assert!(matches!(output.status.code(), Some(0 | 2)));
        } else {
            fails(&output, 2);
        }
    }
}

#[test]
fn inputs_that_cannot_be_read_name_the_file() {
    let scratch = Scratch::new();
    let empty = scratch.path("empty");
    std::fs::create_dir(&empty).expect("writable");
    std::fs::write(empty.join("notes.txt"), b"no image").expect("writable");
    let mixed = scratch.clip("mixed", 1, 40, 24);
    image::RgbImage::new(24, 40).save(mixed.join("1.png")).expect("writable");
    let zero = scratch.clip("zero", 1, 40, 24);
    std::fs::write(zero.join("1.png"), b"").expect("writable");
    let corrupt = scratch.clip("corrupt", 2, 40, 24);
    let bytes = std::fs::read(corrupt.join("1.png")).expect("readable");
    std::fs::write(corrupt.join("1.png"), &bytes[..bytes.len() / 2]).expect("writable");
    let cut = scratch.path("cut.y4m");
    std::fs::write(&cut, b"YUV4MPEG2 W4 H4 F24:1 C444\nFRAME\nxxxx").expect("writable");
    let hostile = scratch.path("hostile.y4m");
    std::fs::write(&hostile, b"YUV4MPEG2 W4000000000 H4000000000 F24:1 C444\nFRAME\n").expect("writable");
    let model = model();
    let more = ["--model", model.to_str().expect("UTF-8")];
    for (input, expected) in [
        (scratch.path("absent"), "absent: No such file"),
        (empty, "empty: the folder holds no image"),
        (mixed, "1.png: the frame is 24×40, expected 40×24 as in"),
        (zero, "1.png: the file is empty (0 bytes)"),
        (corrupt, "1.png: broken or unsupported"),
        (cut, "cut.y4m: frame 0 ends early: expected 48 bytes, found 4"),
        (hostile, "hostile.y4m: the header gives 4000000000×4000000000"),
    ] {
        let out = scratch.path("out");
        let text = fails(&attempt(&input, &out, &more), 1);
        assert!(text.contains(expected), "{text}");
        assert!(!out.join("run.json").exists() && !out.join("report.md").exists());
        let _ = std::fs::remove_dir_all(&out);
    }
}

#[test]
fn what_was_written_before_a_broken_frame_is_a_valid_scene() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 3, 40, 24);
    std::fs::write(clip.join("3.png"), b"").expect("writable");
    let out = scratch.path("out");
    let model = model();
    fails(&attempt(&clip, &out, &["--model", model.to_str().expect("UTF-8")]), 1);
    let scene = streamsplat::scene::Scene::open(&out).expect("a valid scene");
    assert_eq!(scene.index().intervals.len(), 3);
    for place in 0..3 {
        assert!(!scene.interval(place).expect("a whole interval").gaussians.is_empty(), "interval {place}");
    }
    for name in crate::support::files(&out).keys() {
        assert!(!name.contains("partial"), "{name}");
    }
}

#[test]
fn what_came_before_the_cut_of_a_stream_is_kept() {
    let scratch = Scratch::new();
    let (cut, whole) = (scratch.path("cut.y4m"), scratch.path("whole.y4m"));
    let frame = |luma: u8| [&b"FRAME\n"[..], &[luma; 40 * 24], &[128; 2 * 20 * 12]].concat();
    let frames = [&b"YUV4MPEG2 W40 H24 F24:1 C420jpeg\n"[..], &frame(60), &frame(90), &frame(120)].concat();
    std::fs::write(&whole, &frames).expect("writable");
    std::fs::write(&cut, [&frames[..], &frame(150)[..99]].concat()).expect("writable");
    let model = model();
    let model = ["--model", model.to_str().expect("UTF-8")];
    for name in ["folder", "video.y4m"] {
        let (out, expected) = (scratch.path(&format!("cut-{name}")), scratch.path(&format!("whole-{name}")));
        let text = fails(&attempt(&cut, &out, &[&model[..], &["--quiet"]].concat()), 1);
        assert!(text.contains("cut.y4m: frame 3 ends early"), "{text}");
        assert!(attempt(&whole, &expected, &model).status.success());
        // The output is that of the three frames, and the record contains the damage.
        let record = |out: &Path| match out.is_dir() {
            true => crate::support::record(&out.join("run.json")),
            false => crate::support::record(
                &out.with_file_name(format!("{}.run.json", out.file_name().and_then(|n| n.to_str()).expect("UTF-8"))),
            ),
        };
        let (found, whole) = (record(&out), record(&expected));
        assert!(
            found["input"]["damage"].as_str().is_some_and(|damage| damage.contains("frame 3 ends early")),
            "{found}"
        );
        assert_eq!((&found["complete"], &found["input"]["count"]), (&true.into(), &3.into()));
        let digests = |record: &serde_json::Value| -> Vec<serde_json::Value> {
            record["outputs"].as_object().expect("files").values().map(|file| file["blake3"].clone()).collect()
        };
        assert_eq!(digests(&found), digests(&whole));
        assert_eq!(whole["input"]["damage"], serde_json::Value::Null);
    }
}

#[test]
fn models_that_cannot_be_loaded_name_the_file() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 2, 40, 24);
    let bytes = std::fs::read(model()).expect("readable");
    let file = |name: &str, content: &[u8]| {
        let path = scratch.path(name);
        std::fs::write(&path, content).expect("writable");
        path
    };
    let mut corrupt = bytes.clone();
    corrupt[20] ^= 0x55;
    let scene = fixtures::path("oracle/extreme.safetensors");
    for path in [
        scratch.path("absent.safetensors"),
        file("truncated.safetensors", &bytes[..bytes.len() / 3]),
        file("corrupt.safetensors", &corrupt),
        file("empty.safetensors", b""),
        file("foreign.safetensors", b"this is no model, only some text that someone named like one"),
        scene,
    ] {
        let out = scratch.path("out");
        let name = path.file_name().and_then(|n| n.to_str()).expect("UTF-8").to_owned();
        let text = fails(&attempt(&clip, &out, &["--model", path.to_str().expect("UTF-8")]), 1);
        assert!(text.contains(&name), "{text}");
        nothing_written(&out);
        let output = command().arg("inspect").arg(&path).output().expect("the program starts");
        assert!(fails(&output, 1).contains(&name));
    }
}

#[test]
fn models_and_depth_networks_that_cannot_be_loaded_leave_no_folder() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 2, 40, 24);
    let (absent, model) = (scratch.path("absent.onnx"), model());
    let network = format!("onnx:{}", absent.display());
    let out = scratch.path("a/b");
    for more in [
        &["--depth", &network, "--model", model.to_str().expect("UTF-8")][..],
        &["--model", absent.to_str().expect("UTF-8")],
    ] {
        fails(&attempt(&clip, &out, more), 1);
        assert!(!scratch.path("a").exists(), "{more:?}");
        // Existing folders stay, and nothing is left in them.
        std::fs::create_dir_all(&out).expect("writable");
        fails(&attempt(&clip, &out, more), 1);
        assert_eq!(std::fs::read_dir(&out).expect("there").count(), 0, "{more:?}");
        std::fs::remove_dir_all(scratch.path("a")).expect("there");
    }
}

#[test]
fn an_unwritable_output_is_found_before_the_work() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 2, 40, 24);
    // A file is in the place of a folder: this fails for every user, even the superuser.
    let file = scratch.path("file");
    std::fs::write(&file, b"in the way").expect("writable");
    for out in [file.join("out"), file.join("video.y4m"), file.clone()] {
        // The error comes before the model is searched for.
        let text = fails(&attempt(&clip, &out, &["--model", "no/such/model.safetensors"]), 1);
        assert!(text.contains("cannot write") && text.contains("file"), "{text}");
    }
    assert_eq!(std::fs::read(&file).expect("readable"), b"in the way");
}

#[test]
fn times_outside_the_video_are_wrong_use() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 2, 40, 24);
    let out = scratch.path("out");
    run_ok(&clip, &out, &["--quiet"]);
    let render = |times: &str| {
        command()
            .args(["render", "--times", times, "--out"])
            .arg(scratch.path("again"))
            .arg(&out)
            .output()
            .expect("the program starts")
    };
    let text = fails(&render("0,7.5"), 2);
    assert!(text.contains("time 7.5 s: expected one between 0 s and"), "{text}");
    assert!(!scratch.path("again").exists());
    let model = model();
    let text = fails(
        &attempt(&clip, &scratch.path("third"), &["--times", "0,9", "--model", model.to_str().expect("UTF-8")]),
        2,
    );
    assert!(text.contains("9 s lies outside the video"), "{text}");
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_behind_standard_output_is_a_failure() {
    let scratch = Scratch::new();
    let out = scratch.path("out");
    run_ok(&scratch.clip("clip", 2, 40, 24), &out, &["--quiet"]);
    let (record, model) = (out.join("run.json"), model());
    for words in
        [&["inspect".as_ref(), model.as_os_str()][..], &["verify".as_ref(), record.as_os_str()], &["--help".as_ref()]]
    {
        let full = std::fs::File::options().write(true).open("/dev/full").expect("there");
        let output = command().args(words).stdout(full).output().expect("the program starts");
        assert!(fails(&output, 1).contains("standard output: cannot write"), "{words:?}");
    }
}

#[test]
fn options_that_change_nothing_are_told_or_refused() {
    let scratch = Scratch::new();
    let (clip, out) = (scratch.clip("clip", 2, 40, 24), scratch.path("out"));
    let options = "--refine 0 --refine-every 2 --refine-to 40 --detail 8 --depth-range clip --behind off \
        --fusion pairwise --max-age 3 --motion network --flow coarse --emit ply --size 20x12 --stereo --matrix bt709";
    let mut run = command();
    run.arg("run").arg(&clip).arg("--out").arg(&out).arg("--model").arg(model()).args(options.split_whitespace());
    let output = run.output().expect("the program starts");
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{text}");
    for (option, cause) in [
        ("--refine-every", "with --refine 0"),
        ("--refine-to", "with --refine 0"),
        ("--detail", "with --refine 0"),
        ("--depth-range", "without a folder of depth maps"),
        ("--behind", "without depth"),
        ("--max-age", "with --fusion pairwise"),
        ("--flow", "with --motion network"),
        ("--size", "as no images are drawn"),
        ("--stereo", "as no images are drawn"),
    ] {
        assert!(text.contains(&format!("{option} changes nothing {cause}\n")), "{option}: {text}");
    }
    assert!(text.contains("--matrix changes nothing"), "{text}");
    // The record also has values of presets, which are repeated without a line.
    let output = command().arg("verify").arg(&out).output().expect("the program starts");
    assert!(output.status.success() && output.stderr.is_empty(), "{}", String::from_utf8_lossy(&output.stderr));

    let (scene, _) = crate::still::prepared(&scratch);
    let drawn = scratch.path("drawn.png");
    let output = crate::support::run([Path::new("render"), &scene, Path::new("--fps=9"), Path::new("--out"), &drawn]);
    assert!(String::from_utf8_lossy(&output.stderr).contains("--fps changes nothing for one image"));
    std::fs::remove_file(&drawn).expect("drawn");
    run_ok(&clip, &out, &["--quiet", "--overwrite"]);
    for (command, input, more, code, expected) in [
        ("run", &clip, &["--dinov2", "/nowhere"][..], 2, "--dinov2: expected --model as well"),
        ("run", &clip, &["--resolution", "100x100"], 2, "--resolution 100x100: expected multiples of"),
        ("render", &out, &["--times", "0", "--lod", "3"], 1, "level of detail: expected a streamed SOG scene"),
        ("render", &out, &["--times", "0", "--crf", "7"], 2, "drawn.png"),
    ] {
        let place = if command == "run" { scratch.path("none") } else { drawn.clone() };
        let output = self::command().arg(command).arg(input).arg("--out").arg(&place).args(more).output();
        let text = fails(&output.expect("the program starts"), code);
        assert!(text.contains(expected) && !text.contains(".streamsplat-") && !place.exists(), "{text}");
    }
}

#[test]
fn a_resolution_that_is_mostly_border_is_told() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 2, 40, 24);
    for (size, line) in [
        ("144x80", Some("--resolution 144x80 (HEIGHTxWIDTH): the picture has 48x80 of it, and 67 % is a border")),
        ("48x80", None),
    ] {
        let mut run = command();
        run.arg("run").arg(&clip).arg("--out").arg(scratch.path(size)).arg("--model").arg(model());
        let output = run.args(["--resolution", size]).output().expect("the program starts");
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.success(), "{text}");
        assert!(line.map_or(!text.contains("border"), |line| text.contains(line)), "{size}: {text}");
    }
}
