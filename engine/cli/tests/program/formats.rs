//! Every format of still scenes: a first picture and a page in one command, and hostile files.

use std::path::PathBuf;

use streamsplat::formats::{self, FORMATS, Format, Options, READ_ONLY, SpzVersion};
use streamsplat::still::Drawable;
use streamsplat::stream::Workers;
use streamsplat_kernels::Level;

use crate::still::still;
use crate::support::{Scratch, command, fails, json};

/// Writes the scene as a file of a format.
fn written(format: &Format) -> Vec<u8> {
    let workers = Workers::new(Level::scalar(), 1).expect("one thread");
    (format.still)(&Drawable::new(still(), &workers).expect("even arrays"), &Options::default()).bytes
}

fn replaced(file: &[u8], from: &str, to: &str) -> Vec<u8> {
    let at = file.windows(from.len()).position(|w| w == from.as_bytes()).expect(from);
    [&file[..at], to.as_bytes(), &file[at + from.len()..]].concat()
}

/// Returns the file with another byte at an offset.
fn changed(file: &[u8], at: usize, value: u8) -> Vec<u8> {
    let mut file = file.to_vec();
    file[at] = value;
    file
}

fn shorter(file: &[u8], by: usize) -> Vec<u8> {
    file[..file.len() - by].to_vec()
}

/// Returns the meta.json of a SOG scene without harmonics.
fn meta(version: u32, count: u64, means: &str) -> Vec<u8> {
    let codebook = vec!["0"; 256].join(",");
    format!(
        r#"{{"version": {version}, "count": {count}, "means": {{"mins": [0,0,0], "maxs": [1,1,1], "files": ["{means}", "b"]}},
        "scales": {{"codebook": [{codebook}], "files": ["c"]}}, "quats": {{"files": ["d"]}},
        "sh0": {{"codebook": [{codebook}], "files": ["e"]}}}}"#
    )
    .into_bytes()
}

/// Returns files that are no scenes of a format: their names, their bytes, and the start of the message after the name.
fn hostile(format: &Format) -> Vec<(&'static str, Vec<u8>, &'static str)> {
    let good = written(format);
    let newest = formats::spz::write(&still(), SpzVersion::V4).bytes;
    match format.option {
        "ply" => vec![
            ("a.ply", shorter(&good, 1), "element vertex: expected 500 of 248 bytes each"),
            (
                "a.ply",
                replaced(&good, "vertex 500", "vertex 99999999999"),
                "element vertex: expected 99999999999 of 248 bytes each",
            ),
            (
                "a.ply",
                replaced(&good, "float f_rest_44", "float f_rest_45"),
                "property f_rest_44: expected it as a float",
            ),
            ("a.ply", replaced(&good, "float opacity", "uchar opacity"), "property opacity: expected it as a float"),
        ],
        "compressed-ply" => vec![
            ("a.ply", shorter(&good, 1), "element sh: expected 500 of 45 bytes each"),
            (
                "a.ply",
                replaced(&good, "chunk 2", "chunk 1"),
                "element chunk: expected 2 of them for 500 vertices, found 1",
            ),
            (
                "a.ply",
                replaced(&good, "uint packed_color", "int packed_color"),
                "property packed_color of vertex: expected",
            ),
        ],
        "spz" => vec![
            ("a.spz", shorter(&good, 1), "gzip stream: expected "),
            ("a.spz", changed(&newest, 11, 200), "header: points: expected at most 16777216 Gaussians"),
            ("a.spz", changed(&newest, 12, 5), "header: degree of the harmonics: expected 0 to 4, found 5"),
            ("a.spz", shorter(&newest, 1), "harmonics: expected "),
        ],
        "sog" => vec![
            ("a.sog", shorter(&good, 1), "zip file: expected "),
            ("meta.json", meta(1, 500, "a"), "meta.json: version: expected 2, or none beside means.shape, found 1"),
            ("meta.json", meta(2, 1 << 40, "a"), "meta.json: count: expected at most 16777216 Gaussians"),
            ("meta.json", meta(2, 500, "../a"), "file \"../a\": expected a file beside this one"),
        ],
        "glb" => vec![
            ("a.glb", shorter(&good, 1), "header: length: expected "),
            (
                "a.glb",
                replaced(&good, "\"srgb_rec709_display\"", "\"srgb_rec709_displax\""),
                "mesh 0, primitive 0: colorSpace: expected srgb_rec709_display or lin_rec709_display",
            ),
            ("a.glb", replaced(&good, "\"count\":500", "\"count\":999"), "accessor 0: expected 999 elements"),
        ],
        "splat" => vec![
            ("a.splat", shorter(&good, 1), "file: expected records of 32 bytes, found 15999 bytes"),
            ("a.splat", changed(&good, 15, 0xbf), "record 0: expected standard deviations of 0 or more"),
            ("a.splat", vec![0; 33], "file: expected records of 32 bytes, found 33 bytes"),
        ],
        other => panic!("{other}: a format without hostile files"),
    }
}

/// Builds a `.ksplat` file of 16-bit numbers: two Gaussians in one bucket.
fn ksplat() -> Vec<u8> {
    let mut bytes = vec![0; 4096 + 1024];
    let mut put = |at: usize, value: &[u8]| bytes[at..at + value.len()].copy_from_slice(value);
    put(1, &[1]);
    for (at, value) in [(4, 1), (8, 1), (12, 2), (16, 2), (4096, 2), (4100, 2), (4104, 256), (4108, 1), (4132, 1)] {
        put(at, &u32::to_le_bytes(value));
    }
    put(20, &1_u16.to_le_bytes());
    put(4112, &5.0_f32.to_le_bytes());
    put(4116, &12_u16.to_le_bytes());
    bytes.extend(2_u32.to_le_bytes());
    [0.5_f32, -0.5, 0.0].iter().for_each(|x| bytes.extend(x.to_le_bytes()));
    for i in 0..2_u16 {
        [32767 + 4000 * i, 32767, 32767].iter().for_each(|n| bytes.extend(n.to_le_bytes()));
        let numbers = [0.3, 0.3, 0.3, 1.0, 0.0, 0.0, 0.0].map(half::f16::from_f32);
        numbers.iter().for_each(|n| bytes.extend(n.to_le_bytes()));
        bytes.extend([255, 128, 0, 255]);
    }
    bytes
}

/// Returns the index of a streamed SOG scene of one chunk.
fn lod(version: u32, file: &str, count: usize) -> Vec<u8> {
    format!(
        r#"{{"version": {version}, "lodLevels": 1, "counts": [{count}], "filenames": ["{file}"],
        "tree": {{"lods": {{"0": {{"file": 0, "offset": 0, "count": {count}}}}}}}}}"#
    )
    .into_bytes()
}

/// Returns files as [`hostile`] does, for a format that is only read.
fn hostile_read_only(name: &str) -> Vec<(&'static str, Vec<u8>, &'static str)> {
    let good = ksplat();
    match name {
        "ksplat" => vec![
            ("a.ksplat", shorter(&good, 1), "section 0: splats: expected 48 bytes, found 47"),
            ("a.ksplat", changed(&good, 15, 200), "header: splats: expected at most 16777216 Gaussians"),
            ("a.ksplat", changed(&good, 20, 9), "header: compression level: expected 0 to 2, found 9"),
            ("a.ksplat", changed(&good, 4120 + 16, 3), "section 0: degree of the harmonics: expected 0 to 2, found 3"),
        ],
        "streamed SOG" => vec![
            ("lod-meta.json", lod(2, "0_0/meta.json", 5), "lod-meta.json: version: expected 1, found 2"),
            ("lod-meta.json", lod(1, "0_0/meta.json", 1 << 40), "lod-meta.json: level 0: expected at most 16777216"),
            (
                "lod-meta.json",
                lod(1, "../a/meta.json", 5),
                "file \"../a/meta.json\": expected a file in a folder beside",
            ),
            ("lod-meta.json", lod(1, "0_0/meta.json", 5), "file \"meta.json\": expected a file beside this one"),
        ],
        other => panic!("{other}: a format without hostile files"),
    }
}

#[test]
fn hostile_files_of_every_format_are_refused_in_one_line() {
    let scratch = Scratch::new();
    let page = scratch.path("page.html");
    let written = FORMATS.iter().map(|format| (format.name, format.option, hostile(format)));
    let read = READ_ONLY.iter().map(|format| (format.name, format.name, hostile_read_only(format.name)));
    for (format, option, files) in written.chain(read) {
        assert!(files.len() >= 3, "{format}");
        for (k, (name, bytes, expected)) in files.into_iter().enumerate() {
            let folder = scratch.path(&format!("{option}-{k}"));
            std::fs::create_dir(&folder).expect("writable");
            let path = folder.join(name);
            std::fs::write(&path, bytes).expect("writable");
            let mut view = command();
            view.arg("view").arg(&path).arg("--html").arg(&page);
            let mut inspect = command();
            inspect.arg("inspect").arg(&path);
            for mut command in [view, inspect] {
                let text = fails(&command.output().expect("the program starts"), 1);
                let start = format!("streamsplat: {}: {expected}", path.display());
                assert!(text.starts_with(&start), "{format}: {text}");
                assert!(text.contains(", found "), "{text}");
            }
            assert!(!page.exists() && !page.with_extension("png").exists());
            std::fs::remove_file(&path).expect("there");
        }
    }
}

#[test]
fn a_scene_of_every_format_has_a_first_picture_which_its_page_shows_as_its_poster() {
    let scratch = Scratch::new();
    for format in &FORMATS {
        let path = |ending: &str| -> PathBuf { scratch.path(&format!("{}.{ending}", format.option)) };
        let (scene, image, page) = (path(format.ending), path("first.png"), path("html"));
        std::fs::write(&scene, written(format)).expect("writable");
        for arguments in [["render", "--out"], ["view", "--html"]] {
            let out = if arguments[0] == "view" { &page } else { &image };
            let output = command().arg(arguments[0]).arg(&scene).arg(arguments[1]).arg(out).output();
            let output = output.expect("the program starts");
            assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        }
        let picture = std::fs::read(&image).expect("an image");
        assert!(std::fs::read(page.with_extension("png")).expect("a poster") == picture, "{}", format.name);
        let drawn = image::load_from_memory(&picture).expect("an image").into_rgb8();
        assert!(drawn.pixels().filter(|pixel| pixel.0 != [128; 3]).count() > 1280 * 720 / 20, "{}", format.name);
        let text = std::fs::read_to_string(&page).expect("a page");
        assert_eq!(text.matches("id=\"interval-").count(), 1);
        let found = scratch.path("found.json");
        let output = command().arg("inspect").arg(&scene).arg("--json").arg(&found).output();
        assert!(output.expect("the program starts").status.success());
        let name = json(&found)["format"].as_str().expect("a name").to_owned();
        assert!(text.contains(&format!("\"format\":\"{name}\"")), "{name}");
    }
}

#[test]
fn a_ksplat_file_is_drawn_as_the_gaussians_that_it_holds() {
    let scratch = Scratch::new();
    let (file, ply) = (scratch.path("a.ksplat"), scratch.path("a.ply"));
    std::fs::write(&file, ksplat()).expect("writable");
    let output = command().arg("export").arg(&file).arg("--out").arg(&ply).output().expect("the program starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let found = streamsplat::formats::ply::read(&std::fs::read(&ply).expect("a file")).expect("a scene");
    assert_eq!(found.mean[0], [0.5, -0.5, 0.0]);
    assert!((found.mean[1][0] - (0.5 + 4000.0 * 2.5 / 32767.0)).abs() < 1e-6, "{:?}", found.mean);
    let expected = f64::from(half::f16::from_f32(0.3)).ln();
    assert!((f64::from(found.log_scale[1][2]) - expected).abs() < 1e-6);
}

#[test]
fn a_streamed_sog_scene_is_the_union_of_its_chunks_also_by_its_folder() {
    let scratch = Scratch::new();
    let folder = scratch.path("streamed");
    let sog = FORMATS.iter().find(|format| format.option == "sog").expect("SOG");
    let unpack = |name: &str| {
        let mut archive = zip::ZipArchive::new(std::io::Cursor::new(written(sog))).expect("a SOG file");
        archive.extract(folder.join(name)).expect("writable");
    };
    ["0_0", "0_1", "env"].into_iter().for_each(unpack);
    let index = r#"{"version": 1, "lodLevels": 1, "counts": [503], "filenames": ["0_0/meta.json", "0_1/meta.json"], "environment": "env/meta.json",
        "tree": {"children": [{"lods": {"0": {"file": 1, "offset": 497, "count": 3}}}, {"lods": {"0": {"file": 0, "offset": 0, "count": 500}}}]}}"#;
    std::fs::write(folder.join("lod-meta.json"), index).expect("writable");
    let whole = streamsplat::formats::sog::read(&written(sog)).expect("a SOG file");
    for path in [folder.join("lod-meta.json"), folder.clone()] {
        let ply = scratch.path("a.ply");
        let output = command().arg("export").arg(&path).arg("--out").arg(&ply).output().expect("the program starts");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let found = streamsplat::formats::ply::read(&std::fs::read(&ply).expect("a file")).expect("a scene");
        assert_eq!((found.len(), found.degree), (1003, whole.degree));
        let expected = [&whole.mean[..], &whole.mean[497..], &whole.mean[..]].concat();
        assert!(found.mean == expected && found.higher[500 * 45..503 * 45] == whole.higher[497 * 45..]);
    }
    // An existing level, a missing one, and a file without levels.
    let two = index.replace(r#""lodLevels": 1, "counts": [503]"#, r#""lodLevels": 2, "counts": [503, 4]"#);
    let two = two.replace(
        r#"{"lods": {"0": {"file": 1,"#,
        r#"{"lods": {"1": {"file": 0, "offset": 9, "count": 4}, "0": {"file": 1,"#,
    );
    std::fs::write(folder.join("lod-meta.json"), two).expect("writable");
    let export = |path: &std::path::Path, level: &str| {
        let mut export = command();
        export.arg("export").arg(path).args(["--lod", level, "--out"]).arg(scratch.path("b.ply"));
        export.output().expect("the program starts")
    };
    let output = export(&folder, "1");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let found =
        streamsplat::formats::ply::read(&std::fs::read(scratch.path("b.ply")).expect("a file")).expect("a scene");
    assert!(found.mean == [&whole.mean[9..13], &whole.mean[..]].concat());
    assert!(fails(&export(&folder, "2"), 1).contains("lodLevels: expected more than 2"));
    assert!(
        fails(&export(&scratch.path("a.ply"), "1"), 1)
            .contains("expected a streamed SOG scene, for a level above 0, found PLY")
    );
}

/// A text file of SpacetimeGaussians: one Gaussian that moves along x, and fades.
const SPACETIME: &str = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3 trbf_center trbf_scale motion_0 motion_1 motion_2 motion_3 motion_4 motion_5 motion_6 motion_7 motion_8 omega_0 omega_1 omega_2 omega_3";

#[test]
fn a_file_of_spacetime_gaussians_is_drawn_at_each_time() {
    let scratch = Scratch::new();
    let header: String = SPACETIME.split(' ').map(|name| format!("property float {name}\n")).collect();
    let row = "0 0 0 1 0.5 0 3 -2 -2 -2 1 0 0 0  0 0  1 0 0 2 0 0 0 0 0  0 0 0 0";
    let file = scratch.path("moving.ply");
    std::fs::write(&file, format!("ply\nformat ascii 1.0\nelement vertex 1\n{header}end_header\n{row}\n"))
        .expect("writable");
    let out = scratch.path("plies");
    let output = command()
        .arg("export")
        .arg(&file)
        .args(["--format", "ply", "--times", "0,0.5"])
        .arg("--out")
        .arg(&out)
        .output();
    let output = output.expect("the program starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(String::from_utf8_lossy(&output.stderr).contains(": Gaussians in time, most opaque from 0 to 0"));
    let at =
        |name: &str| streamsplat::formats::ply::read(&std::fs::read(out.join(name)).expect("a file")).expect("a scene");
    assert_eq!((at("000000.ply").mean[0], at("000001.ply").mean[0]), ([0.0; 3], [1.0, 0.0, 0.0]));
    assert!(at("000001.ply").logit[0] < at("000000.ply").logit[0]);
    // A render of the file at a time equals that of the still scene of the time.
    let camera = scratch.path("camera.json");
    std::fs::write(&camera, r#"{"type": "pinhole", "position": [0, 0, -4], "fov_y_degrees": 45, "aspect": 1.5}"#)
        .expect("writable");
    let mut pictures = Vec::new();
    for (name, path, times) in [("moving", file.clone(), "0.5"), ("still", out.join("000001.ply"), "0")] {
        let image = scratch.path(&format!("{name}.png"));
        let mut render = command();
        render
            .arg("render")
            .arg(path)
            .arg("--camera")
            .arg(&camera)
            .args(["--size", "90x60", "--times", times])
            .arg("-o")
            .arg(&image);
        let output = render.output().expect("the program starts");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        pictures.push(std::fs::read(&image).expect("an image"));
    }
    assert!(pictures[0] == pictures[1]);
    let found = scratch.path("found.json");
    let output = command().arg("inspect").arg(&file).arg("--json").arg(&found).output().expect("the program starts");
    assert!(output.status.success() && json(&found)["in_time"]["span"][0] == 0.0);
}
