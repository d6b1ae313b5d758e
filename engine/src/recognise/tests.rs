use std::io::Write;
use std::path::PathBuf;

use flate2::Compression;
use flate2::write::GzEncoder;

use super::*;

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Folder {
        Folder(tempfile::tempdir().expect("a temporary folder"))
    }

    fn file(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.0.path().join(name);
        std::fs::create_dir_all(path.parent().expect("a folder")).expect("writable");
        std::fs::write(&path, bytes).expect("writable");
        path
    }
}

fn gz(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
    encoder.write_all(bytes).expect("memory");
    encoder.finish().expect("memory")
}

fn zip(names: &[&str]) -> Vec<u8> {
    let mut archive = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    for name in names {
        archive.start_file(*name, zip::write::SimpleFileOptions::default()).expect("memory");
        archive.write_all(b"content").expect("memory");
    }
    archive.finish().expect("memory").into_inner()
}

fn glb(json: &str) -> Vec<u8> {
    let mut bytes = b"glTF\x02\0\0\0".to_vec();
    bytes.extend((20 + json.len() as u32).to_le_bytes());
    bytes.extend((json.len() as u32).to_le_bytes());
    bytes.extend(b"JSON");
    bytes.extend(json.as_bytes());
    bytes
}

fn ply(lines: &str) -> Vec<u8> {
    format!("ply\nformat binary_little_endian 1.0\n{lines}end_header\n").into_bytes()
}

const XYZ: &str = "property float x\nproperty float y\nproperty float z\n";

/// Name, content, and the message's description if a scene is expected.
fn others() -> Vec<(&'static str, Vec<u8>, &'static str)> {
    let mut transport = vec![0; 600];
    [0, 188, 376].iter().for_each(|at| transport[*at] = 0x47);
    let mut tar = vec![b'a'; 257];
    tar.extend(b"ustar\0");
    let mesh = format!("element vertex 8\n{XYZ}element face 12\nproperty list uchar int vertex_indices\n");
    vec![
        ("a.mp4", b"\0\0\0\x20ftypisom\0\0\x02\0".to_vec(), "a video (MP4)"),
        ("a.mov", b"\0\0\0\x14ftypqt  \0\0\0\0".to_vec(), "a video (QuickTime)"),
        ("b.mov", b"\0\0\0\x08wide\0\0\0\0mdat".to_vec(), "a video (QuickTime)"),
        ("a.webm", b"\x1a\x45\xdf\xa3\x01\0\0\0".to_vec(), "a video (Matroska or WebM)"),
        ("a.avi", b"RIFF\0\0\0\0AVI LIST".to_vec(), "a video (AVI)"),
        ("a.ts", transport, "a video (MPEG transport stream)"),
        ("a.ogv", b"OggS\0\x02 \x80theora".to_vec(), "a video (Ogg)"),
        ("a.y4m", b"YUV4MPEG2 W2 H2\n".to_vec(), "a video (y4m)"),
        // The content decides, not a wrong name.
        ("b.ply", b"\0\0\0\x20ftypmp42\0\0\0\0".to_vec(), "a video (MP4)"),
        ("a.png", b"\x89PNG\r\n\x1a\n\0\0".to_vec(), "an image (PNG)"),
        ("a.jpg", b"\xff\xd8\xff\xe0\0\x10".to_vec(), "an image (JPEG)"),
        ("a.tif", b"II+\0\x08\0\0\0".to_vec(), "an image (BigTIFF)"),
        ("a.webp", b"RIFF\0\0\0\0WEBPVP8 ".to_vec(), "an image (WebP)"),
        ("a.avif", b"\0\0\0\x20ftypavif\0\0\0\0".to_vec(), "an image (AVIF)"),
        ("a.mp3", b"ID3\x04\0\0\0\0".to_vec(), "sound alone (MP3)"),
        ("b.mp3", b"\xff\xfb\x90\x64".to_vec(), "sound alone (MP3 or AAC)"),
        ("a.wav", b"RIFF\0\0\0\0WAVEfmt ".to_vec(), "sound alone (WAV)"),
        ("a.ogg", b"OggS\0\x02 \x01vorbis".to_vec(), "sound alone (Ogg)"),
        ("a.m4a", b"\0\0\0\x20ftypM4A \0\0\0\0".to_vec(), "sound alone (M4A)"),
        ("c.ply", b"  <!DOCTYPE HTML>\n<html>".to_vec(), "a web page (HTML)"),
        ("a.splat", b"<html><head>".to_vec(), "a web page (HTML)"),
        ("d.ply", b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n".to_vec(), "a pointer of Git LFS"),
        ("a.ksplat", b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n".to_vec(), "a pointer of Git LFS"),
        ("a.ply.gz", gz(b"ply\nformat ascii 1.0\n"), "a gzip file of a PLY file"),
        ("a.tar.gz", gz(&tar), "a gzip file of a tar archive"),
        ("b.gz", gz(b"hello"), "a gzip file"),
        ("a.tar", tar, "a tar archive"),
        (
            "a.zip",
            zip(&["readme.txt", "scene/point_cloud.ply"]),
            "a zip file: unpack it first (unzip); scene/point_cloud.ply",
        ),
        ("b.zip", zip(&["readme.txt"]), "a zip file: unpack it first (unzip); no scene"),
        ("c.zip", zip(&[]), "a zip file with nothing in it"),
        ("a.npz", zip(&["xyz.npy"]), "arrays of NumPy (.npz)"),
        ("a.npy", b"\x93NUMPY\x01\0".to_vec(), "an array of NumPy (.npy)"),
        ("a.ckpt", zip(&["step/data.pkl", "step/version"]), "a checkpoint of PyTorch"),
        ("e.ply", ply(&format!("element vertex 5\n{XYZ}property uchar red\n")), "a point cloud (PLY of 5 points"),
        ("f.ply", ply(&mesh), "a mesh (PLY of 8 vertices and 12 faces)"),
        (
            "a.glb",
            glb(r#"{"asset":{},"meshes":[{"primitives":[{}]}]}"#),
            "a mesh (glTF without KHR_gaussian_splatting)",
        ),
        ("a.gltf", br#"{"asset":{},"meshes":[{"primitives":[{}]}]}"#.to_vec(), "a mesh (glTF without"),
        ("a.las", b"LASF\0\0".to_vec(), "a point cloud (LAS)"),
        ("a.obj", b"# made by hand\nv 0 0 0\n".to_vec(), "a mesh (OBJ)"),
        ("g.ply", Vec::new(), "an empty file (0 bytes)"),
    ]
}

#[test]
fn what_is_no_scene_is_told_by_what_it_holds() {
    let folder = Folder::new();
    for (name, bytes, expected) in others() {
        let path = folder.file(name, &bytes);
        let found = not_a_scene(&path).unwrap_or_else(|| panic!("{name}: nothing found")).to_string();
        assert!(found.starts_with(&format!("expected a scene, found {expected}")), "{name}: {found}");
        assert!(found.contains(": ") && !found.contains('\n'), "{name}: {found}");
    }
}

#[test]
fn text_and_an_empty_folder_are_named() {
    let folder = Folder::new();
    let text = folder.file("notes.nfo", "Dear diary,\n\té".as_bytes());
    let found = |path: &Path| not_a_scene(path).expect("no scene").to_string();
    assert!(found(&text).starts_with("expected a scene, found a text file: "), "{}", found(&text));
    assert!(not_a_video(&text).is_some() && not_a_record(&text).is_some());
    let empty = folder.0.path().join("empty");
    std::fs::create_dir(&empty).expect("writable");
    assert!(found(&empty).starts_with("expected a scene, found an empty folder: "), "{}", found(&empty));
    // If text is expected, other text may be right, and a video is not.
    let video = folder.file("clip.mp4", b"\0\0\0\x20ftypisom");
    assert_eq!(not_a_text(&text, "a list"), None);
    let wrong = not_a_text(&video, "a list").expect("no list").to_string();
    assert!(wrong.starts_with("expected a list, found a video (MP4)"), "{wrong}");
    assert!(!is_text(b"\xff\xfe") && !is_text(b"") && is_text(b"a\xc3"));
}

#[test]
fn what_may_be_a_scene_is_left_to_its_reader() {
    let folder = Folder::new();
    let gaussians = format!("element vertex 5\n{XYZ}property float opacity\n");
    let splats = r#"{"asset":{},"meshes":[{"primitives":[{"extensions":{"KHR_gaussian_splatting":{}}}]}]}"#;
    for (name, bytes) in [
        ("a.ply", ply(&gaussians)),
        // The reader names the missing file.
        ("b.ply", b"ply\nformat ascii 1.0\n".to_vec()),
        ("c.ply", ply(&format!("element vertex 5\n{XYZ}property uint packed_position\n"))),
        ("a.spz", gz(b"NGSP\x03\0\0\0")),
        ("b.spz", b"NGSP\x04\0\0\0".to_vec()),
        ("a.sog", zip(&["meta.json", "means_l.webp"])),
        // Truncated, so it has no list of names.
        ("b.sog", b"PK\x03\x04\x14\0".to_vec()),
        ("a.glb", glb(splats)),
        ("b.glb", glb("{")),
        ("a.gltf", splats.as_bytes().to_vec()),
        ("a.splat", b"\xff\xd8\xff\xe0 any bytes at all".to_vec()),
        ("empty.splat", Vec::new()),
        ("a.ksplat", b"\0\x01\0\0".to_vec()),
        ("a.ssz", crate::scene::MAGIC.to_vec()),
        ("scene.json", b"{}".to_vec()),
        ("meta.json", b"{}".to_vec()),
        ("a.safetensors", b"\x08\0\0\0\0\0\0\0{}      ".to_vec()),
        ("unknown", b"something else\x01".to_vec()),
    ] {
        assert_eq!(not_a_scene(&folder.file(name, &bytes)), None, "{name}");
    }
    assert_eq!(not_a_scene(&folder.0.path().join("none")), None);
}

#[test]
fn a_video_names_its_scene_and_a_scene_is_no_video() {
    let folder = Folder::new();
    let video = folder.file("clip.mp4", b"\0\0\0\x20ftypisom");
    let text = not_a_scene(&video).expect("a video").to_string();
    assert_eq!(text, "expected a scene, found a video (MP4): streamsplat run makes a scene of it");
    let scene = folder.file("clip-scene.ssz", &crate::scene::MAGIC);
    let text = not_a_scene(&video).expect("a video").to_string();
    assert!(text.ends_with(&format!("; {} is one", scene.display())), "{text}");
    assert_eq!((not_a_video(&video), not_a_video(&folder.file("a.png", b"\x89PNG\r\n\x1a\n"))), (None, None));
    let text = not_a_video(&scene).expect("a scene").to_string();
    assert!(text.starts_with("expected a video or images, found a scene (container): streamsplat view"), "{text}");
    let sound = not_a_video(&folder.file("a.mp3", b"ID3\x04")).expect("no picture").to_string();
    assert_eq!(sound, "expected a video or images, found sound alone (MP3): there is no picture in it");
    let text = not_a_record(&video).expect("a video").to_string();
    assert!(text.contains("found a video (MP4): the record of a run that wrote it would be"), "{text}");
    folder.file("clip.mp4.run.json", b"{}");
    assert!(not_a_record(&video).expect("a video").to_string().ends_with("is the record of the run that wrote it"));
    assert_eq!(not_a_record(&folder.file("run.json", b"{}")), None);
}

#[test]
fn folders_are_told_by_the_names_in_them() {
    let folder = Folder::new();
    let path = |name: &str| folder.0.path().join(name);
    let text = |name: &str| not_a_scene(&path(name)).map(|wrong| wrong.to_string()).unwrap_or_default();
    folder.file("plies/b10.ply", b"ply\n");
    folder.file("plies/b9.ply", b"ply\n");
    assert!(text("plies").contains("found a folder with 2 scenes in it: name the file, such as"), "{}", text("plies"));
    assert!(text("plies").ends_with("b9.ply"));
    folder.file("frames/1.png", b"x");
    assert_eq!(text("frames"), "expected a scene, found a folder of images: streamsplat run makes a scene of it");
    assert_eq!(not_a_video(&path("frames")), None);
    folder.file("both/1.png", b"x");
    folder.file("both/a.ply", b"ply\n");
    assert!(text("both").contains("a folder with one scene in it") && not_a_video(&path("both")).is_none());
    folder.file("trained/point_cloud/iteration_7000/point_cloud.ply", b"ply\n");
    folder.file("trained/point_cloud/iteration_30000/point_cloud.ply", b"ply\n");
    assert!(text("trained").ends_with("iteration_30000/point_cloud.ply"), "{}", text("trained"));
    folder.file("model/sparse/0/cameras.bin", b"x");
    assert!(text("model").contains("found a COLMAP model"), "{}", text("model"));
    folder.file("sog/meta.json", b"{}");
    folder.file("run/scene/scene.json", b"{}");
    assert_eq!((text("sog"), text("run")), (String::new(), String::new()));
    assert_eq!(index(&path("sog")), Some(path("sog/meta.json")));
}
