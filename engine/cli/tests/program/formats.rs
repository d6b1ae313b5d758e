//! Every format of still scenes: a first picture and a page in one command, and hostile files.

use std::path::PathBuf;

use streamsplat::import::{FORMATS, Format};
use streamsplat::still::Drawable;
use streamsplat::stream::Workers;
use streamsplat_kernels::Level;

use crate::still::still;
use crate::support::{Scratch, command, fails, json};

/// The scene as a file of a format.
fn written(format: &Format) -> Vec<u8> {
    let workers = Workers::new(Level::scalar(), 1).expect("one thread");
    (format.still)(&Drawable::new(still(), &workers).expect("even arrays"))
}

fn replaced(file: &[u8], from: &str, to: &str) -> Vec<u8> {
    let at = file.windows(from.len()).position(|w| w == from.as_bytes()).expect(from);
    [&file[..at], to.as_bytes(), &file[at + from.len()..]].concat()
}

/// Another byte at a place.
fn changed(file: &[u8], at: usize, value: u8) -> Vec<u8> {
    let mut file = file.to_vec();
    file[at] = value;
    file
}

fn shorter(file: &[u8], by: usize) -> Vec<u8> {
    file[..file.len() - by].to_vec()
}

/// The meta.json of a SOG scene without harmonics.
fn meta(version: u32, count: u64, means: &str) -> Vec<u8> {
    let codebook = vec!["0"; 256].join(",");
    format!(
        r#"{{"version": {version}, "count": {count}, "means": {{"mins": [0,0,0], "maxs": [1,1,1], "files": ["{means}", "b"]}},
        "scales": {{"codebook": [{codebook}], "files": ["c"]}}, "quats": {{"files": ["d"]}},
        "sh0": {{"codebook": [{codebook}], "files": ["e"]}}}}"#
    )
    .into_bytes()
}

/// Files that are no scenes of a format: their names, their bytes, and how the message begins behind the name.
fn hostile(format: &Format) -> Vec<(&'static str, Vec<u8>, &'static str)> {
    let good = written(format);
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
            ("a.spz", shorter(&good, 1), "harmonics: expected "),
            ("a.spz", changed(&good, 11, 200), "header: points: expected at most 16777216 Gaussians"),
            ("a.spz", changed(&good, 12, 5), "header: degree of the harmonics: expected 0 to 4, found 5"),
        ],
        "sog" => vec![
            ("a.sog", shorter(&good, 1), "zip file: expected "),
            ("meta.json", meta(1, 500, "a"), "meta.json: version: expected 2, found 1"),
            ("meta.json", meta(2, 1 << 40, "a"), "meta.json: count: expected at most 16777216 Gaussians"),
            ("meta.json", meta(2, 500, "../a"), "file \"../a\": expected a file beside this one"),
        ],
        "glb" => vec![
            ("a.glb", shorter(&good, 1), "header: length: expected "),
            ("a.glb", replaced(&good, "\"ellipse\"", "\"eclipse\""), "mesh 0, primitive 0: kernel: expected ellipse"),
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

#[test]
fn hostile_files_of_every_format_are_refused_in_one_line() {
    let scratch = Scratch::new();
    let page = scratch.path("page.html");
    for format in &FORMATS {
        let files = hostile(format);
        assert!(files.len() >= 3, "{}", format.name);
        for (k, (name, bytes, expected)) in files.into_iter().enumerate() {
            let folder = scratch.path(&format!("{}-{k}", format.option));
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
                assert!(text.starts_with(&start), "{}: {text}", format.name);
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
