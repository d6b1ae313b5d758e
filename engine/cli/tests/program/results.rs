//! Results of the commands.

use std::path::Path;
use std::process::Stdio;

use streamsplat_fixtures as fixtures;
use streamsplat_kernels::Level;

use crate::support::{Scratch, command, files, json, model, run, run_ok};

#[test]
fn a_run_writes_frames_scene_record_and_report() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 5, 60, 30);
    let out = scratch.path("out");
    run_ok(&clip, &out, &["--gap", "2", "--emit", "rgb,depth,alpha,scene", "--size", "source"]);
    let found = files(&out);
    let names: Vec<&str> = found.keys().map(String::as_str).collect();
    for name in ["frames/000000.png", "frames/000004.png", "depth/000001.exr", "alpha/000003.png", "scene/scene.json"] {
        assert!(names.contains(&name), "{name} in {names:?}");
    }
    // Key frames 0, 2 and 4.
    assert_eq!(names.iter().filter(|n| n.starts_with("scene/interval-")).count(), 3);
    let frame = image::load_from_memory(&found["frames/000003.png"]).expect("a PNG");
    assert_eq!((frame.width(), frame.height()), (60, 30));
    let record = json(&out.join("run.json"));
    assert_eq!(record["outputs"].as_object().expect("an object").len(), found.len());
    for (name, bytes) in &found {
        assert_eq!(record["outputs"][name]["blake3"], blake3::hash(bytes).to_hex().as_str(), "{name}");
    }
    for stage in ["encoder", "decoder", "render"] {
        assert!(record["work"][stage]["done"].as_u64().is_some_and(|n| n > 0), "{stage}");
        assert!(record["work"][stage]["unit"].is_string() && record["timing"]["seconds"][stage].is_number(), "{stage}");
    }
    assert!(record["model"]["blake3"].is_string() && record["input"]["blake3"].is_string());
    assert!(std::fs::read_to_string(out.join("report.md")).expect("readable").contains("| encoder |"));
}

#[test]
fn the_bytes_depend_on_neither_threads_nor_instruction_set_nor_run() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 3, 50, 40);
    let emit = ["--emit", "rgb,depth,alpha,scene", "--quiet"];
    let first = scratch.path("first");
    run_ok(&clip, &first, &emit);
    let expected = files(&first);
    assert_eq!(expected.len(), 3 * 4 + 1);
    let mut variants: Vec<Vec<String>> = ["1", "2", "3", "8"].map(|n| vec!["--threads".into(), n.into()]).to_vec();
    variants.extend(Level::available().iter().map(|level| vec!["--isa".into(), level.name().into()]));
    for variant in variants {
        let out = scratch.path("again");
        let more: Vec<&str> = emit.iter().copied().chain(variant.iter().map(String::as_str)).collect();
        run_ok(&clip, &out, &more);
        assert!(files(&out) == expected, "{variant:?}");
    }
}

#[test]
fn an_earlier_run_in_the_same_folder_leaves_nothing_behind() {
    let scratch = Scratch::new();
    let out = scratch.path("out");
    run_ok(&scratch.clip("long", 4, 40, 24), &out, &["--quiet"]);
    run_ok(&scratch.clip("short", 2, 40, 24), &out, &["--quiet", "--overwrite"]);
    let names: Vec<String> = files(&out).into_keys().collect();
    let expected = [
        "frames/000000.png",
        "frames/000001.png",
        "scene/interval-000000.safetensors",
        "scene/interval-000001.safetensors",
        "scene/scene.json",
    ];
    assert_eq!(names, expected);
}

#[test]
fn rendering_a_scene_gives_the_images_of_the_run() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 4, 40, 24);
    let (out, again) = (scratch.path("out"), scratch.path("again"));
    run_ok(&clip, &out, &["--fps", "10", "--gap", "2", "--quiet"]);
    let output = command().arg("render").arg(&out).arg("--out").arg(&again).output().expect("the program starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let (first, second) = (files(&out), files(&again));
    for frame in 0..4 {
        let name = format!("frames/{frame:06}.png");
        assert!(first[&name] == second[&name], "{name}");
    }
    let camera = scratch.path("camera.json");
    let view = r#"{"type": "pinhole", "position": [0.1, 0.0, -0.5], "focal": [1.0, 1.6], "centre": [0.5, 0.5]}"#;
    std::fs::write(&camera, view).expect("writable");
    let output = command()
        .arg("render")
        .arg(&out)
        .args(["--times", "0:0.3:5", "--size", "33x21", "--background", "0,0,1", "--camera"])
        .arg(&camera)
        .arg("--out")
        .arg(scratch.path("v.y4m"))
        .output()
        .expect("the program starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let video = std::fs::read(scratch.path("v.y4m")).expect("readable");
    assert!(video.starts_with(b"YUV4MPEG2 W33 H21 F10:1 "));
    assert_eq!(json(&scratch.path("v.y4m.run.json"))["work"]["render"]["done"], 5);
}

#[test]
fn where_depth_is_found_the_first_image_has_it_too() {
    let scratch = Scratch::new();
    let clip = fixtures::path("clips/moving.y4m");
    let run = |name: &str, more: &[&str]| {
        let out = scratch.path(name);
        let mut run = command();
        run.arg("run").arg(&clip).arg("--out").arg(&out).args(["--gap", "4", "--quiet"]).args(more);
        let output = run.output().expect("the program starts");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let lifted = json(&out.join("run.json"))["work"]["lift"]["done"].as_u64();
        (files(&out), lifted, out)
    };
    let (found, lifted, out) = run("found", &["--frames", "5"]);
    assert_eq!(lifted, Some(2));
    let again = scratch.path("again");
    let output = command().arg("render").arg(&out).arg("--out").arg(&again).output().expect("the program starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let rendered = files(&again);
    let (flat, none, _) = run("flat", &["--frames", "5", "--depth", "none"]);
    assert_eq!(none, Some(0));
    for frame in 0..5 {
        let name = format!("frames/{frame:06}.png");
        assert!(found[&name] == rendered[&name], "{name}");
        assert!(found[&name] != flat[&name], "{name}");
    }
    let (_, lifted, _) = run("alone", &["--frames", "1"]);
    assert_eq!(lifted, Some(0), "one frame shows no parallax");
    for more in [["--quality", "realtime"], ["--motion", "network"]] {
        let (.., out) = run(more[1], &[&more[..], &["--frames", "1"]].concat());
        assert_eq!(json(&out.join("run.json"))["options"]["stream"]["depth"], "none", "{more:?}");
    }
}

#[test]
fn the_camera_path_of_the_fixtures_moves_through_a_scene() {
    let scratch = Scratch::new();
    let out = scratch.path("out");
    run_ok(&scratch.clip("clip", 4, 40, 24), &out, &["--fps", "10", "--quiet"]);
    let render = |name: &str, times: &str| {
        let to = scratch.path(name);
        let path = fixtures::path("cameras/sway.json");
        let output = command()
            .arg("render")
            .arg(&out)
            .args(["--times", times, "--size", "64x36", "--emit", "exr", "--quiet", "--camera"])
            .arg(path)
            .arg("--out")
            .arg(&to)
            .output()
            .expect("the program starts");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        files(&to)
    };
    let moving = render("moving", "0,0.05,0.1,0.2");
    assert_eq!(moving.keys().map(String::as_str).collect::<Vec<_>>(), [0, 1, 2, 3].map(|i| format!("exr/{i:06}.exr")));
    let planes = |name: &str| streamsplat::openexr::read(&moving[name]).expect("an EXR file");
    let pictures = ["exr/000000.exr", "exr/000001.exr", "exr/000002.exr", "exr/000003.exr"].map(planes);
    for picture in &pictures {
        assert_eq!((picture.width, picture.height, picture.channels.len()), (64, 36, 3));
        let red = picture.channel("R").expect("the first layer is colour");
        assert!(red.iter().any(|v| (v - 0.5).abs() > 0.05), "only background is seen");
    }
    assert!(pictures.windows(2).all(|pair| pair[0] != pair[1]), "the camera stands still");
    // The last view is used after its time.
    assert_eq!(render("held", "0.2,0.25").len(), 2);
}

#[test]
fn y4m_flows_from_standard_input_to_standard_output() {
    let scratch = Scratch::new();
    let clip = fixtures::path("clips/moving.y4m");
    let input = std::fs::File::open(&clip).expect("readable");
    let output = command()
        .args(["run", "-", "--out", "-", "--frames", "3", "--model"])
        .arg(model())
        .stdin(Stdio::from(input))
        .output()
        .expect("the program starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    // A video has the source's size, whatever the model's is.
    assert!(output.stdout.starts_with(b"YUV4MPEG2 W256 H144 F24:1 "), "{:?}", &output.stdout[..40]);
    assert_eq!(
        output.stdout.len() - output.stdout.iter().position(|&c| c == b'\n').expect("a header") - 1,
        3 * (6 + 3 * 256 * 144)
    );
    let out = scratch.path("v.y4m");
    run_ok(&clip, &out, &["--frames", "3", "--quiet"]);
    assert!(std::fs::read(&out).expect("readable") == output.stdout);
    // A 16:9 source in an input of 80×48: letterboxed to 80×45.
    run_ok(&clip, &out, &["--frames", "3", "--quiet", "--overwrite", "--size", "model"]);
    assert!(std::fs::read(&out).expect("readable").starts_with(b"YUV4MPEG2 W80 H45 F24:1 "));
}

#[test]
fn frames_between_key_frames_are_measured_where_there_are_some() {
    let clip = fixtures::path("clips/moving.y4m");
    let eval = |more: &[&str]| {
        let output = command().arg("eval").arg(&clip).arg("--model").arg(model()).args(more).output();
        output.expect("the program starts")
    };
    let output = eval(&[]);
    assert_eq!(output.status.code(), Some(2));
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(said.starts_with("streamsplat: --gap: expected") && said.lines().count() == 1, "{said}");
    assert!(eval(&["--gap", "1", "--quiet"]).status.success());
}

#[test]
fn a_repeated_frame_costs_no_network_and_changes_no_bit() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 2, 40, 24);
    std::fs::copy(clip.join("1.png"), clip.join("2.png")).expect("writable");
    std::fs::copy(clip.join("1.png"), clip.join("3.png")).expect("writable");
    let (exact, off) = (scratch.path("exact"), scratch.path("off"));
    run_ok(&clip, &exact, &["--quiet"]);
    run_ok(&clip, &off, &["--quiet", "--reuse", "off"]);
    assert!(files(&exact) == files(&off));
    let (exact, off) = (json(&exact.join("run.json")), json(&off.join("run.json")));
    assert_eq!((&exact["work"]["encoder"]["done"], &exact["work"]["encoder"]["avoided"]), (&2.into(), &2.into()));
    assert_eq!((&off["work"]["encoder"]["done"], &off["work"]["encoder"]["avoided"]), (&4.into(), &0.into()));
}

#[test]
fn evaluation_reports_key_and_middle_frames_and_baselines() {
    let scratch = Scratch::new();
    let clips = scratch.path("clips");
    std::fs::create_dir(&clips).expect("writable");
    scratch.clip("clips/b2", 7, 80, 48);
    scratch.clip("clips/b10", 4, 80, 48);
    std::fs::write(scratch.path("clips/notes.txt"), "not a clip").expect("writable");
    let evaluate = |more: &[&str]| {
        let figures = scratch.path("eval.json");
        let output = command()
            .arg("eval")
            .arg(&clips)
            .args(["--gap", "3", "--quiet", "--json"])
            .arg(&figures)
            .arg("--model")
            .arg(model())
            .args(more)
            .output()
            .expect("the program starts");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        assert!(output.stdout.is_empty());
        json(&figures)
    };
    let (figures, pairwise) = (evaluate(&[]), evaluate(&["--fusion", "pairwise"]));
    let clips = figures["clips"].as_array().expect("a list");
    assert_eq!(clips.iter().map(|c| c["name"].as_str().expect("a name")).collect::<Vec<_>>(), ["b2", "b10"]);
    assert_eq!((&clips[0]["key"]["frames"], &clips[0]["middle"]["frames"]), (&3.into(), &4.into()));
    assert_eq!((&figures["mean"]["key"]["frames"], &figures["mean"]["middle"]["frames"]), (&5.into(), &6.into()));
    for row in [&clips[0], &clips[1], &figures["mean"]] {
        assert_eq!(row["gap"], 3);
        assert_eq!(row["fusion"]["persistent"]["middle"], row["middle"]);
        // Images do not jump at key frames; only pairs change with the frame they were made for.
        assert_eq!(row["fusion"]["persistent"]["pop"]["ratio"], 0.0);
        let pairs = &pairwise["mean"]["fusion"]["pairwise"]["pop"];
        let [jump, step, ratio] = ["jump", "step", "ratio"].map(|name| pairs[name].as_f64().expect("a number"));
        assert!(jump > 0.0 && step > 0.0 && (ratio - jump / step).abs() < 1e-12, "{pairs}");
        for score in [
            &row["key"],
            &row["middle"],
            &row["baselines"]["crossfade"],
            &row["baselines"]["nearest"],
            &row["baselines"]["flow"],
        ] {
            let (psnr, ssim) = (score["psnr"].as_f64().expect("dB"), score["ssim"].as_f64().expect("SSIM"));
            assert!((1.0..100.0).contains(&psnr) && (-1.0..=1.0).contains(&ssim), "{score}");
        }
    }
    assert_eq!(figures["seen"], false);
    let groups = ["moving", "still"].map(|group| figures["mean"][group]["clips"].as_u64().expect("a count"));
    assert_eq!(groups.iter().sum::<u64>(), 2);
    // The output names the properties that distinguish the groups.
    let output =
        command().arg("eval").arg(scratch.path("clips/b2")).args(["--gap", "3", "--model"]).arg(model()).output();
    let said = String::from_utf8_lossy(&output.expect("the program starts").stdout).into_owned();
    let last = said.lines().last().unwrap_or_default();
    assert!(last.starts_with("1 clip with a cross-fade ") && last.contains(" 26 dB: middle "), "{said}");
    // Parts at rest are equal in both key frames: the baselines predict most of the picture.
    assert!(clips[0]["baselines"]["crossfade"]["psnr"].as_f64().expect("dB") > 15.0);
}

#[test]
fn evaluation_reads_what_lies_between_key_frames_only_where_it_is_seen() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 7, 80, 48);
    let evaluate = |clip: &Path, more: &[&str]| {
        let (figures, out) = (scratch.path("eval.json"), command());
        let mut program = out;
        let options = ["--gap", "3", "--resolution", "24x40", "--refine", "2", "--quiet", "--json"];
        program.arg("eval").arg(clip).args(options).arg(&figures).args(more);
        let output = program.output().expect("the program starts");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        json(&figures)["mean"].clone()
    };
    let (blind, seen) = (evaluate(&clip, &[]), evaluate(&clip, &["--seen"]));
    let psnr = |mean: &serde_json::Value| mean["middle"]["psnr"].as_f64().expect("dB");
    assert!(psnr(&seen) > psnr(&blind), "{seen} {blind}");
    // Other pictures in between: the scene and its images of key frames are unchanged, but the comparison differs.
    for (index, path) in images(&clip).iter().enumerate() {
        if index % 3 != 0 {
            image::RgbImage::from_pixel(80, 48, image::Rgb([250, 3, 60])).save(path).expect("writable");
        }
    }
    let (poisoned, poisoned_seen) = (evaluate(&clip, &[]), evaluate(&clip, &["--seen"]));
    assert_eq!(poisoned["key"], blind["key"]);
    assert_eq!(poisoned["fusion"]["persistent"]["pop"], blind["fusion"]["persistent"]["pop"]);
    assert_ne!(poisoned_seen["fusion"]["persistent"]["pop"], seen["fusion"]["persistent"]["pop"]);
    assert!(psnr(&poisoned) < psnr(&blind) - 3.0);
}

/// Returns the images of a folder, in order.
fn images(folder: &Path) -> Vec<std::path::PathBuf> {
    let mut images: Vec<_> = std::fs::read_dir(folder).expect("readable").flatten().map(|entry| entry.path()).collect();
    images.sort();
    images
}

#[test]
fn inspect_tells_sizes_of_models_and_scenes() {
    let scratch = Scratch::new();
    let report = scratch.path("i.json");
    let inspect = |path: &std::path::Path| {
        let output =
            command().arg("inspect").arg(path).arg("--json").arg(&report).output().expect("the program starts");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        json(&report)
    };
    let found = inspect(&model());
    assert_eq!(
        (&found["configuration"]["hidden_dim"], &found["configuration"]["use_dino"]),
        (&128.into(), &false.into())
    );
    assert!(found["parameters"].as_u64().is_some_and(|n| n > 1_000_000));
    assert!(found["gflop_per_key_frame"].as_f64().is_some_and(|g| g > 0.1));
    assert_eq!(
        (&found["zero_output"]["decoder"]["branches"], &found["zero_output"]["decoder"]["of"]),
        (&0.into(), &3.into())
    );
    let out = scratch.path("out");
    run_ok(&scratch.clip("clip", 2, 40, 24), &out, &["--quiet"]);
    assert_eq!(inspect(&out)["intervals"], 2);
    let interval = inspect(&out.join("scene/interval-000001.safetensors"));
    assert!(interval["gaussians"].as_u64().is_some_and(|n| n > 100));
}

#[test]
fn the_embedded_model_needs_no_file() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 2, 64, 36);
    let out = scratch.path("out");
    let output = run(["run".as_ref(), clip.as_os_str(), "--out".as_ref(), out.as_os_str()]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(json(&out.join("run.json"))["model"]["path"], "embedded");
    let frame = image::open(out.join("frames/000001.png")).expect("a PNG");
    // Whole patches of 8 pixels in the source's shape, never more than it has.
    assert_eq!((frame.width(), frame.height()), (56, 32));
}

#[test]
fn depth_maps_change_the_scene_and_both_ranges_work() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 2, 40, 24);
    let depth = scratch.path("depth");
    std::fs::create_dir(&depth).expect("writable");
    for frame in 0..2u32 {
        let map = image::ImageBuffer::<image::Luma<u16>, _>::from_fn(20, 12, |x, y| {
            image::Luma([(1000 * x + 300 * y + 5000 * frame) as u16])
        });
        map.save(depth.join(format!("{frame}.png"))).expect("writable");
    }
    let with = |name: &str, more: &[&str]| {
        let out = scratch.path(name);
        run_ok(&clip, &out, &[&["--quiet"], more].concat());
        files(&out)
    };
    let depth = depth.to_str().expect("UTF-8");
    let none = with("none", &[]);
    let frame = with("frame", &["--depth", depth]);
    let whole = with("whole", &["--depth", depth, "--depth-range", "clip"]);
    assert!(none != frame && frame != whole && none != whole);
    std::fs::remove_file(scratch.path("depth/1.png")).expect("there");
    let output = command()
        .arg("run")
        .arg(&clip)
        .arg("--out")
        .arg(scratch.path("short"))
        .args(["--depth", depth, "--model"])
        .arg(model())
        .output()
        .expect("the program starts");
    let text = crate::support::fails(&output, 1);
    assert!(text.contains("expected 2 depth maps, one for each frame, found 1"), "{text}");
}

#[test]
fn dinov2_is_not_computed_where_no_decoder_reads_it() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 3, 40, 24);
    let work = |name: &str, more: &[&str]| {
        let out = scratch.path(name);
        let run = command()
            .arg("run")
            .arg(&clip)
            .arg("--model")
            .arg(fixtures::path("parity/tiny-dino.safetensors"))
            .arg("--dinov2")
            .arg(fixtures::path("parity/dino-tiny.safetensors"))
            .args(["--quiet", "--out"])
            .arg(&out)
            .args(more)
            .output();
        let output = run.expect("the program starts");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let work = &json(&out.join("run.json"))["work"];
        ["dinov2", "decoder"].map(|stage| [&work[stage]["done"], &work[stage]["avoided"]].map(|n| n.as_u64()))
    };
    assert_eq!(work("network", &[]), [[Some(3), Some(0)], [Some(2), Some(0)]]);
    let fixed = ["--motion", "between", "--fade", "fixed"];
    assert_eq!(work("fixed", &fixed), [[Some(0), Some(3)], [Some(0), Some(2)]]);
    assert_eq!(work("fade", &["--motion", "between"]), [[Some(3), Some(0)], [Some(2), Some(0)]]);
}

#[test]
fn the_authors_way_is_the_options_that_it_stands_for() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 8, 40, 24);
    let depth = scratch.path("depth");
    std::fs::create_dir(&depth).expect("writable");
    for frame in 0..8u32 {
        // The largest value of all is in a map of a frame that is no key frame.
        let nearest = if frame == 4 { 60_000 } else { 20_000 + 1000 * frame };
        let map = image::ImageBuffer::<image::Luma<u16>, _>::from_fn(40, 24, |x, y| {
            image::Luma([if (x, y) == (7, 7) { nearest as u16 } else { (300 * x + 200 * y) as u16 }])
        });
        map.save(depth.join(format!("{frame}.png"))).expect("writable");
    }
    let maps = ["--depth", depth.to_str().expect("UTF-8")];
    let with = |name: &str, more: &[&str]| {
        let out = scratch.path(name);
        run_ok(&clip, &out, &[&["--quiet", "--emit", "rgb,scene"], more].concat());
        (files(&out), json(&out.join("run.json"))["options"].clone())
    };
    const WAY: &str = "--gap 3 --resolution native --motion network --fade network --refine 0 --fusion pairwise --sampling mean --precision f32 --fit stretch";
    let way: Vec<&str> = WAY.split(' ').collect();
    let (theirs, recorded) = with("theirs", &[&maps[..], &["--like-paper"]].concat());
    let (spelled, options) = with("spelled", &[&maps[..], &["--depth-range", "keys"], &way].concat());
    assert!(theirs == spelled);
    // The record contains every option, and the name.
    let mut named = options.clone();
    named["stream"]["like_paper"] = true.into();
    assert_eq!(recorded, named);
    assert_eq!((&options["stream"]["depth_range"], &options["fit"]), (&"keys".into(), &"stretch".into()));
    // Each of these options would change it.
    let (plain, _) = with("plain", &maps);
    let (clips, _) = with("clips", &[&maps[..], &["--like-paper", "--depth-range", "clip"]].concat());
    let (flat, _) = with("flat", &["--like-paper"]);
    let (none, _) = with("none", &[&["--depth", "none"], &way[..]].concat());
    let (gap, _) = with("gap", &[&maps[..], &["--like-paper", "--gap", "2"]].concat());
    let spelled_with_two = way.iter().map(|word| if *word == "3" { "2" } else { word }).collect::<Vec<_>>();
    let (two, _) = with("two", &[&maps[..], &["--depth-range", "keys"], &spelled_with_two].concat());
    assert!(flat == none && gap == two);
    assert!(plain != theirs && clips != theirs && flat != theirs && gap != theirs);
    // A video has the size at which the model sees frames.
    let video = scratch.path("v.y4m");
    run_ok(&clip, &video, &["--like-paper", "--quiet"]);
    assert!(std::fs::read(&video).expect("readable").starts_with(b"YUV4MPEG2 W80 H48 "));
}

#[test]
fn a_reader_that_goes_away_is_no_panic() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 6, 40, 24);
    let mut child = command()
        .arg("run")
        .arg(&clip)
        .args(["--out", "-", "--quiet", "--size", "640x384", "--model"])
        .arg(model())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    drop(child.stdout.take());
    let output = child.wait_with_output().expect("it ends");
    let text = crate::support::fails(&output, 1);
    assert!(text.contains("cannot write"), "{text}");
}

#[test]
fn closeness_does_not_depend_on_what_is_written() {
    // Images of the model's own size are drawn once, for both the file and the comparison.
    let scratch = Scratch::new();
    let clip = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/clips/moving.y4m");
    let size = |size: &'static str| ["--size", size];
    let runs = [
        ("rgb", size("model"), [0, 13]),
        ("rgb,depth", size("source"), [0, 13]),
        ("scene", size("model"), [13, 0]),
        ("rgb", size("40x40"), [13, 0]),
    ];
    let found: Vec<_> = runs
        .iter()
        .enumerate()
        .map(|(i, (emit, size, images))| {
            let out = scratch.path(&format!("out{i}"));
            let mut run = command();
            run.arg("run").arg(&clip).args([
                "--gap",
                "auto:1-6:38",
                "--frames",
                "13",
                "--quiet",
                "--emit",
                emit,
                "--out",
            ]);
            assert!(run.arg(&out).args(size).output().expect("the program starts").status.success());
            let record = json(&out.join("run.json"));
            assert!(record["psnr"].as_f64().is_some_and(|psnr| psnr > 20.0), "{record}");
            let compare = |stage: &str, kind: &str| record["work"][stage][kind].as_u64();
            assert_eq!(compare("compare", "done"), Some(13));
            let drawn = ["done", "avoided"].map(|kind| compare("compare.images", kind));
            assert_eq!(
                drawn,
                images.map(Some),
                "--emit {emit} {size:?}: images drawn for the comparison, and left out"
            );
            (record["psnr"].clone(), record["key_frames"].clone())
        })
        .collect();
    assert!(found.iter().all(|of| of == &found[0]), "{found:?}");
}

#[test]
fn closeness_at_the_sources_size_is_that_of_the_images_written() {
    let scratch = Scratch::new();
    let (clip, out) = (scratch.clip("clip", 9, 96, 64), scratch.path("out"));
    run_ok(&clip, &out, &["--size", "source", "--fit", "letterbox", "--gap", "auto:2-4:30", "--quiet"]);
    let record = json(&out.join("run.json"));
    let samples = |path: std::path::PathBuf| image::open(path).expect("an image").into_rgb8().into_raw();
    let psnr = |frame: usize| {
        let truth = samples(clip.join(format!("{frame}.png")));
        let image = samples(out.join(format!("frames/{frame:06}.png")));
        let squares: f64 = truth.iter().zip(&image).map(|(a, b)| f64::from(a.abs_diff(*b)).powi(2)).sum();
        10.0 * (255.0_f64.powi(2) * truth.len() as f64 / squares.max(1.0)).log10()
    };
    let expected = (0..9).map(psnr).sum::<f64>() / 9.0;
    let found = record["psnr_source_size"].as_f64().expect("a figure");
    assert!((found - expected).abs() < 1e-6, "{found} dB, expected {expected}");
    let (least, worst) = (record["psnr_least"].as_f64().expect("a figure"), (0..9).map(psnr).fold(f64::MAX, f64::min));
    assert!((least - worst).abs() < 1e-6, "{least} dB, expected {worst}");
    // The model of this test sees frames at another size.
    assert!(record["psnr"].as_f64().is_some_and(|seen| seen != found), "{record}");
    let seen = record["psnr_size"].as_array().expect("a size").clone();
    assert_ne!(seen, [96, 64], "{record}");
    let report = std::fs::read_to_string(out.join("report.md")).expect("a report");
    for [width, height] in [["96".into(), "64".into()], [seen[0].to_string(), seen[1].to_string()]] {
        assert!(report.contains(&format!("mean PSNR of all frames at {width}×{height}")), "{report}");
    }
    let line = format!("at 96×64, {least:.2} dB in the worst frame |");
    assert!(report.contains(&line), "{line}: {report}");
    // `eval` measures the same images.
    let figures = scratch.path("eval.json");
    let eval = ["--seen", "--fit", "letterbox", "--gap", "auto:2-4:30", "--quiet", "--json"];
    let output = command().arg("eval").arg(&clip).args(eval).arg(&figures).arg("--model").arg(model()).output();
    assert!(output.expect("the program starts").status.success());
    let mean = json(&figures)["mean"].clone();
    let sum = |group: &str| {
        let score = &mean[group];
        score["psnr_source_size"].as_f64().expect("dB") * score["frames"].as_f64().expect("a count")
    };
    let measured = (sum("key") + sum("middle")) / 9.0;
    assert!((measured - found).abs() < 1e-6, "{measured} dB, {found} by run");
    // Where the model sees frames at their own size, there is one figure.
    let [width, height] = [0, 1].map(|axis| seen[axis].as_u64().expect("pixels") as u32);
    let (small, same) = (scratch.clip("small", 9, width, height), scratch.path("same"));
    run_ok(&small, &same, &["--size", "source", "--fit", "letterbox", "--gap", "auto:2-4:30", "--quiet"]);
    let record = json(&same.join("run.json"));
    assert_eq!(record["psnr_size"], serde_json::json!([width, height]));
    assert!(record["psnr"].is_f64() && record["psnr"] == record["psnr_source_size"], "{record}");
    let report = std::fs::read_to_string(same.join("report.md")).expect("a report");
    assert_eq!(report.matches("mean PSNR of all frames").count(), 1, "{report}");
    // Images of another size are not compared with the frames directly.
    let other = scratch.path("other");
    run_ok(&clip, &other, &["--size", "48x32", "--gap", "auto:2-4:30", "--quiet"]);
    let record = json(&other.join("run.json"));
    assert!(record.get("psnr_source_size").is_none());
    let [least, mean] = ["psnr_least", "psnr"].map(|name| record[name].as_f64().expect("a figure"));
    assert!(least < mean, "{record}");
}
