//! Small files of packed formats that unpack to gigabytes: an error within 100 MB and five seconds. Small content is
//! read.

use std::ffi::OsString;
use std::io::{Cursor, Write};
use std::path::Path;
use std::time::{Duration, Instant};

use flate2::Compression;
use flate2::write::GzEncoder;
use serde_json::{Value, json};
use streamsplat::formats::FORMATS;
use streamsplat::still::Drawable;
use streamsplat::stream::Workers;
use streamsplat_kernels::Level;
use zip::write::SimpleFileOptions;

use crate::hostile::{measured, write};
use crate::still::still;
use crate::support::{Scratch, fails};

/// Runs a command on a file, with limits on its memory and time. Returns its error message if it fails.
fn run(file: &Path, words: &[&str]) -> Option<String> {
    let words: Vec<OsString> =
        words[..1].iter().map(Into::into).chain([file.into()]).chain(words[1..].iter().map(Into::into)).collect();
    let before = Instant::now();
    let (output, most) = measured(&words);
    let took = before.elapsed();
    assert!(most < 100_000, "{most} KiB for {words:?}");
    (!output.status.success()).then(|| {
        assert!(took < Duration::from_secs(5), "{took:?} for {words:?}");
        fails(&output, 1)
    })
}

/// Asserts that a file is an error for the command that only inspects it and for the one that draws it.
fn is_refused(file: &Path, expected: &str) {
    let out = file.with_extension("out");
    for words in [&["inspect"][..], &["render", "--out", out.to_str().expect("UTF-8")]] {
        let text = run(file, words).expect("refused");
        assert!(text.contains(expected), "{text}");
        assert!(text.contains(" bytes (the ratio can be raised), found "), "{text}");
    }
    assert!(!out.exists());
}

/// Encodes a WebP image of one colour, with an alpha that is valid for rotations.
fn solid(side: u32) -> Vec<u8> {
    let mut file = Cursor::new(Vec::new());
    let image = image::RgbaImage::from_pixel(side, side, image::Rgba([128, 128, 128, 255]));
    image.write_to(&mut file, image::ImageFormat::WebP).expect("memory");
    file.into_inner()
}

/// Returns the `meta.json` of a scene whose images are all `a.webp`.
fn meta(count: u32) -> Vec<u8> {
    let codebook = vec![-4.0; 256];
    let coded = json!({"codebook": codebook, "files": ["a.webp"]});
    let means = json!({"mins": [-1, -1, -1], "maxs": [1, 1, 1], "files": ["a.webp", "a.webp"]});
    json!({"version": 2, "count": count, "means": means, "scales": coded, "quats": {"files": ["a.webp"]}, "sh0": coded})
        .to_string()
        .into_bytes()
}

fn zipped(files: &[(&str, &[u8])]) -> Vec<u8> {
    let mut out = zip::ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in files {
        out.start_file(*name, SimpleFileOptions::default()).expect("memory");
        out.write_all(bytes).expect("memory");
    }
    out.finish().expect("memory").into_inner()
}

#[test]
fn images_of_one_colour_that_stand_for_millions_of_gaussians_are_refused() {
    let scratch = Scratch::new();
    let (count, image) = (2048 * 2048, solid(2048));
    let together = zipped(&[("meta.json", &meta(count)), ("a.webp", &image)]);
    assert!(together.len() < 6000, "{}", together.len());
    is_refused(&write(scratch.path("a.sog"), &together), "meta.json: count: expected at most");
    write(scratch.path("a.webp"), &image);
    is_refused(&write(scratch.path("meta.json"), &meta(count)), "count: expected at most");
    // A scene of few Gaussians may compress by any ratio, and the limit can be raised.
    let image = solid(552);
    let file = |count| zipped(&[("meta.json", &meta(count)), ("a.webp", &image)]);
    let few = write(scratch.path("few.sog"), &file(200_000));
    assert_eq!(run(&few, &["inspect"]), None);
    let more = write(scratch.path("more.sog"), &file(552 * 552));
    is_refused(&more, "meta.json: count: expected at most 299593 Gaussians in a file of");
    assert_eq!(run(&more, &["inspect", "--limit-ratio", "1000000"]), None);
}

/// Replaces the document of a binary glTF file.
fn glb(document: &Value, binary: &[u8]) -> Vec<u8> {
    let mut text = document.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut binary = binary.to_vec();
    binary.resize(binary.len().next_multiple_of(4), 0);
    let word = |n: usize| (n as u32).to_le_bytes();
    let length = 12 + 8 + text.len() + 8 + binary.len();
    let head = [*b"glTF", word(2), word(length), word(text.len()), *b"JSON"].concat();
    [&head[..], &text, &word(binary.len()), b"BIN\0", &binary].concat()
}

/// Builds an SPZ file of version 3 with `count` equal Gaussians.
fn spz(count: u32) -> Vec<u8> {
    let mut out = GzEncoder::new(Vec::new(), Compression::best());
    let head = [*b"NGSP", 3_u32.to_le_bytes(), count.to_le_bytes(), [0, 12, 0, 0]].concat();
    out.write_all(&head).and_then(|()| out.write_all(&vec![0; 20 * count as usize])).expect("memory");
    out.finish().expect("memory")
}

#[test]
fn nodes_that_share_a_mesh_are_counted_each() {
    let scratch = Scratch::new();
    let format = FORMATS.iter().find(|format| format.option == "glb").expect("glTF");
    let workers = Workers::new(Level::scalar(), 1).expect("one thread");
    let good = (format.still)(
        &Drawable::new(still(), &workers).expect("even arrays"),
        &streamsplat::formats::Options::default(),
    )
    .bytes;
    let length = good[12..].first_chunk().map(|b| u32::from_le_bytes(*b) as usize).expect("a length");
    let mut document: Value = serde_json::from_slice(&good[20..20 + length]).expect("JSON");
    let binary = &good[20 + length + 8..];
    let instances = |document: &mut Value, count: usize| {
        document["nodes"] = vec![json!({"mesh": 0}); count].into();
        document["scenes"] = json!([{"nodes": (0..count).collect::<Vec<_>>()}]);
        document["scene"] = 0.into();
    };
    instances(&mut document, 4096);
    is_refused(&write(scratch.path("a.glb"), &glb(&document, binary)), "meshes of all nodes: expected at most");
    // A moderate number of instances is allowed.
    instances(&mut document, 20);
    assert_eq!(run(&write(scratch.path("few.glb"), &glb(&document, binary)), &["inspect"]), None);
    // An SPZ file with many instances.
    let packed = spz(20_000);
    let extension = json!({"extensions": {"KHR_gaussian_splatting_compression_spz_2": {"bufferView": 0}}});
    let mut document = json!({
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": packed.len()}],
        "bufferViews": [{"buffer": 0, "byteLength": packed.len()}],
        "meshes": [{"primitives": [{"attributes": {}, "mode": 0, "extensions": {"KHR_gaussian_splatting": extension}}]}],
    });
    instances(&mut document, 500);
    is_refused(&write(scratch.path("spz.glb"), &glb(&document, &packed)), "meshes of all nodes: expected at most");
    instances(&mut document, 5);
    assert_eq!(run(&write(scratch.path("few-spz.glb"), &glb(&document, &packed)), &["inspect"]), None);
    // So do many meshes of one buffer view, without a scene.
    document["meshes"] = vec![document["meshes"][0].clone(); 500].into();
    for name in ["scene", "scenes", "nodes"] {
        document.as_object_mut().expect("an object").remove(name);
    }
    is_refused(&write(scratch.path("meshes.glb"), &glb(&document, &packed)), "meshes of all nodes: expected at most");
}

/// Builds a container of intervals with `count` records of zeros each.
fn container(intervals: usize, count: u32) -> Vec<u8> {
    // Column after column; the columns of links, of the change of colour, of thickness and of merges are empty. A table
    // of one token takes no bits for each.
    let column = |numbers: u32| {
        let coded = if numbers == 0 { &[][..] } else { &[1, 1, 1, 2, 0, 0, 0, 1, 0, 0, 0] };
        [&numbers.to_le_bytes()[..], &(coded.len() as u32).to_le_bytes(), coded].concat()
    };
    let (full, empty) = (column(count), column(0));
    let chunk: Vec<u8> =
        (0..31).flat_map(|k| if k == 1 || k == 2 || k > 23 { &empty } else { &full }).copied().collect();
    let header = [&b"ssplat\x1a\n"[..], &1_u64.to_le_bytes()].concat();
    let mut index = 25_f64.to_le_bytes().to_vec();
    index.extend([64_u32, 64, 64, 64, 0, 0, 64, 64, intervals as u32].iter().flat_map(|side| side.to_le_bytes()));
    let mut file = header.clone();
    for i in 0..intervals {
        let times = [i, i + 1].map(|time| (time as f64).to_bits());
        let words = [file.len() as u64, chunk.len() as u64, times[0], times[1], i as u64, 0];
        index.extend(words.iter().flat_map(|word| word.to_le_bytes()));
        index.extend([count, 0, 0, 0].iter().flat_map(|count| count.to_le_bytes()));
        index.extend(blake3::hash(&chunk).as_bytes());
        file.extend(&chunk);
    }
    let trailer = [file.len() as u64, index.len() as u64].map(u64::to_le_bytes).concat();
    let digest = blake3::hash(&[&header[..], &index].concat());
    [&file[..], &index, &trailer, digest.as_bytes()].concat()
}

#[test]
fn intervals_of_nothing_but_zeros_are_refused() {
    let scratch = Scratch::new();
    // One interval with many records; and many intervals, none of which is large.
    for (name, intervals, count, part) in
        [("one.ssz", 1, 1 << 22, "interval 0"), ("many.ssz", 300, 1 << 16, "intervals")]
    {
        let file = container(intervals, count);
        assert!(file.len() < 800_000, "{}", file.len());
        is_refused(&write(scratch.path(name), &file), &format!("{part}: expected at most"));
    }
    let few = write(scratch.path("few.ssz"), &container(3, 5000));
    assert_eq!(run(&few, &["inspect"]), None);
    let out = scratch.path("few");
    assert_eq!(run(&few, &["render", "--out", out.to_str().expect("UTF-8"), "--times", "0.5"]), None);
    let more = write(scratch.path("more.ssz"), &container(8, 20_000));
    is_refused(&more, "intervals: expected at most 152520 Gaussians in a file of");
    assert_eq!(run(&more, &["inspect", "--limit-ratio", "1000000"]), None);
}

#[test]
fn packed_vertices_that_are_not_there_are_refused() {
    let scratch = Scratch::new();
    let ends =
        ["min", "max"].map(|end| ["x", "y", "z", "scale_x", "scale_y", "scale_z"].map(|name| format!("{end}_{name}")));
    let floats: String = ends.as_flattened().iter().map(|name| format!("property float {name}\n")).collect();
    let words = ["position", "rotation", "scale", "color"].map(|name| format!("property uint packed_{name}\n"));
    let count = 1 << 24;
    let head = format!(
        "ply\nformat binary_little_endian 1.0\nelement chunk {}\n{}element vertex {count}\n{}end_header\n",
        count / 256,
        floats,
        words.concat()
    );
    let file = write(scratch.path("a.ply"), &[head.as_bytes(), &[0; 24 << 10]].concat());
    let text = run(&file, &["inspect"]).expect("refused");
    assert!(text.contains("element chunk: expected 65536 of 48 bytes each, found 24576 bytes"), "{text}");
}

#[test]
fn an_index_whose_intervals_share_a_file_is_refused() {
    let scratch = Scratch::new();
    let entry = |i: usize| json!({"file": "a.safetensors", "start": i, "end": i, "gaussians": 100, "bytes": 11_000, "blake3": "0".repeat(64)});
    let placement = json!({"source": [64, 64], "model": [64, 64], "offset": [0, 0], "content": [64, 64]});
    let intervals: Vec<Value> = (0..200_000).map(entry).collect();
    let index =
        json!({"format": "streamsplat-scene", "version": 1, "fps": 25, "placement": placement, "intervals": intervals});
    let file = write(scratch.path("scene.json"), index.to_string().as_bytes());
    write(scratch.path("a.safetensors"), &[0; 11_000]);
    let expected = "interval 1: expected a file of its own, found \"a.safetensors\" of interval 0";
    for words in [&["inspect"][..], &["render", "--out", "o"]] {
        let text = run(&file, words).expect("refused");
        assert!(text.contains(expected), "{text}");
    }
}
