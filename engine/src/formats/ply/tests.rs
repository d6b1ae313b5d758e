//! PLY files are read; other files are errors with a name.

use proptest::prelude::*;

use super::read;
use crate::formats;
use crate::formats::Limits;
use crate::open::{Opened, StillFile, scene_with};
use crate::scene::SceneError;
use crate::still::Still;

fn still(count: usize, degree: usize) -> Still {
    let value = |i: usize, k: usize| ((i * 37 + k * 11) % 101) as f32 * 0.07 - 3.1;
    let triple = |i: usize, k: usize| std::array::from_fn(|axis| value(i, k + axis));
    let rest = streamsplat_kernels::harmonics::rest(degree);
    Still {
        mean: (0..count).map(|i| triple(i, 0)).collect(),
        log_scale: (0..count).map(|i| triple(i, 3)).collect(),
        rotation: (0..count).map(|i| std::array::from_fn(|k| value(i, 6 + k))).collect(),
        logit: (0..count).map(|i| value(i, 10)).collect(),
        base: (0..count).map(|i| triple(i, 11)).collect(),
        degree,
        higher: (0..count * 3 * rest).map(|i| value(i, 14)).collect(),
        ..Still::default()
    }
}

/// Rewrites the file as text, or with reversed byte order.
fn rewritten(file: &[u8], format: &str) -> Vec<u8> {
    let end = file.windows(11).position(|w| w == b"end_header\n").expect("a header") + 11;
    let header = std::str::from_utf8(&file[..end]).expect("text");
    let per_vertex = header.matches("property").count();
    let mut out = header.replace("binary_little_endian", format).into_bytes();
    let values: Vec<f32> = file[end..].as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
    for vertex in values.chunks(per_vertex) {
        if format == "ascii" {
            let words: Vec<String> = vertex.iter().map(f32::to_string).collect();
            out.extend_from_slice((words.join(" ") + "\n").as_bytes());
        } else {
            vertex.iter().for_each(|x| out.extend_from_slice(&x.to_be_bytes()));
        }
    }
    out
}

#[test]
fn a_scene_comes_back_bit_for_bit_in_every_encoding() {
    for degree in 0..=3 {
        let still = still(5, degree);
        let file = formats::ply::write(&still).bytes;
        assert_eq!(read(&file).as_ref(), Ok(&still), "degree {degree}");
        for format in ["ascii", "binary_big_endian"] {
            assert_eq!(read(&rewritten(&file, format)).as_ref(), Ok(&still), "{format}, degree {degree}");
        }
    }
    assert_eq!(read(&formats::ply::write(&Still::default()).bytes), Ok(Still::default()));
}

#[test]
fn properties_may_stand_in_any_order_and_beside_others() {
    let header = "ply\r\nformat ascii 1.0\r\ncomment made by hand\r\nelement vertex 1\r\nproperty uchar red\r\n\
        property double rot_0\r\nproperty float rot_1\r\nproperty float rot_2\r\nproperty float rot_3\r\n\
        property float opacity\r\nproperty float z\r\nproperty float y\r\nproperty float x\r\nproperty float f_dc_2\r\n\
        property float f_dc_1\r\nproperty float f_dc_0\r\nproperty float scale_2\r\nproperty float scale_1\r\n\
        property float scale_0\r\nend_header\r\n7 1 0.5 0 -1 2.5 3 2 1 -0.3 -0.2 -0.1 9 8 nan\r\n\r\n";
    let found = read(header.as_bytes()).expect("valid");
    assert_eq!((found.mean[0], found.base[0], found.logit[0]), ([1.0, 2.0, 3.0], [-0.1, -0.2, -0.3], 2.5));
    assert_eq!(found.rotation[0], [1.0, 0.5, 0.0, -1.0]);
    assert!(found.log_scale[0][0].is_nan() && found.log_scale[0][1..] == [8.0, 9.0]);
}

/// Builds a file of one vertex: properties `x` to `rot_3`, then `more`, with these bytes.
fn vertex(kind: &str, more: &str, bytes: &[u8]) -> Vec<u8> {
    let names = "x y z opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3";
    let properties: String = names.split(' ').map(|name| format!("property {kind} {name}\n")).collect();
    let header = "ply\nformat binary_little_endian 1.0\nelement camera 2\nproperty short a\nelement vertex 1\n";
    let mut file = format!("{header}{properties}{more}element face 0\nend_header\n").into_bytes();
    // Two cameras come first.
    file.extend_from_slice(&[1, 2, 3, 4]);
    file.extend_from_slice(bytes);
    file
}

#[test]
fn colours_stand_in_for_coefficients_and_elements_beside_vertices_are_passed_over() {
    let single: Vec<u8> = (1..=11).flat_map(|i| (i as f32).to_le_bytes()).collect();
    let names = ["red", "green", "blue"];
    let colours = |kind: &str| names.map(|name| format!("property {kind} {name}\n")).concat();
    for (kind, bytes) in [
        ("uchar", vec![0, 51, 255]),
        ("ushort", [0_u16, 13107, 65535].iter().flat_map(|c| c.to_le_bytes()).collect()),
        ("float", [0.0_f32, 0.2, 1.0].iter().flat_map(|c| c.to_le_bytes()).collect()),
        ("half", [0_u16, 0x3266, 0x3c00].iter().flat_map(|c| c.to_le_bytes()).collect()),
    ] {
        let found = read(&vertex("float", &colours(kind), &[&single[..], &bytes].concat())).expect(kind);
        assert_eq!((found.mean[0], found.logit[0], found.rotation[0]), ([1.0, 2.0, 3.0], 4.0, [8.0, 9.0, 10.0, 11.0]));
        let seen = found.base[0].map(|c| 0.5 + f64::from(c) * streamsplat_kernels::harmonics::Y0);
        for (seen, expected) in seen.into_iter().zip([0.0, 0.2, 1.0]) {
            assert!((seen - expected).abs() < 1e-4, "{kind}: {seen}");
        }
    }
    let error =
        read(&vertex("float", &colours("int"), &[&single[..], &[0; 12]].concat())).expect_err("int").to_string();
    assert!(
        error.starts_with("property red: expected it as a float of 16, 32 or 64 bits, or a number of 8 or 16 bits"),
        "{error}"
    );
    // Halves hold small integers exactly.
    let halves: Vec<u8> = (1..=11).flat_map(|i| half::f16::from_f32(i as f32).to_le_bytes()).collect();
    let found = read(&vertex("half", &colours("uchar"), &[&halves[..], &[0, 51, 255]].concat())).expect("halves");
    assert_eq!((found.mean[0], found.log_scale[0]), ([1.0, 2.0, 3.0], [5.0, 6.0, 7.0]));
}

#[test]
fn every_shorter_and_longer_file_is_an_error() {
    for degree in [0, 1] {
        let file = formats::ply::write(&still(3, degree)).bytes;
        for format in ["binary_little_endian", "binary_big_endian"] {
            let file = if format.ends_with("big_endian") { rewritten(&file, format) } else { file.clone() };
            for end in 0..file.len() {
                assert!(read(&file[..end]).is_err(), "{format} {end}");
            }
            // Line ends and zeros may follow, and nothing else.
            let whole = read(&file);
            for after in [&b"\n"[..], b"\r\n", &[0; 16]] {
                assert!(read(&[&file[..], after].concat()) == whole, "{after:?}");
            }
            for after in [&b"x"[..], b"\n1", &[0; 17]] {
                let error = read(&[&file[..], after].concat()).expect_err("longer").to_string();
                assert_eq!(
                    error,
                    format!("file: expected its end after the last element, found {} more bytes", after.len())
                );
            }
        }
        let text = rewritten(&file, "ascii");
        // Without the last digits and the line feed, the last number may still be valid.
        let last = text.iter().rposition(|b| *b == b' ').expect("numbers");
        for end in 0..=last {
            assert!(read(&text[..end]).is_err(), "text {end}");
        }
        assert!(read(&[&text[..], b"1\n"].concat()).is_err());
    }
}

#[test]
fn what_is_wrong_is_named() {
    let good = String::from_utf8(rewritten(&formats::ply::write(&still(2, 1)).bytes, "ascii")).expect("text");
    assert!(read(good.as_bytes()).is_ok());
    for (from, to, expected) in [
        ("ply\n", "plx\n", "first line: expected ply, found \"plx\""),
        ("ascii 1.0", "ascii 2.0", "format: expected version 1.0, found \"2.0\""),
        ("ascii", "utf16", "format: expected ascii, binary_little_endian or binary_big_endian"),
        ("vertex 2", "vertex -2", "element vertex: expected how many there are, found \"-2\""),
        ("vertex 2", "vertex 3", "element vertex: expected 3 lines, found 2"),
        ("vertex 2", "vertex 18446744073709551615", "element vertex: expected 18446744073709551615 of 26 numbers each"),
        ("vertex 2", "vertex 1", "file: expected nothing after the last element"),
        ("element vertex", "element face", "element vertex: expected a line before end_header, found none"),
        ("end_header", "element vertex 0\nend_header", "element vertex: expected it once, found it twice"),
        ("end_header", "element face 1\nproperty int a\nend_header", "element face: expected 1 lines, found 0"),
        (
            "end_header",
            "element face 1\nproperty list uchar int a\nend_header",
            "element face: property a: expected a number, found a list",
        ),
        (
            "property float opacity",
            "property list uchar int opacity",
            "element vertex: property opacity: expected a number, found a list",
        ),
        (
            "property float opacity",
            "property float alpha",
            "property opacity: expected it as a float of 16, 32 or 64 bits, found none",
        ),
        (
            "property float opacity",
            "property uchar opacity",
            "property opacity: expected it as a float of 16, 32 or 64 bits, found whole",
        ),
        ("property float opacity", "property quad opacity", "property opacity: expected a scalar type, found \"quad\""),
        ("property float nx", "property float x", "property x: expected it once, found it twice"),
        ("property float f_rest_8\n", "", "properties f_rest_*: expected none, 9, 24, 45 or 72 of them, found 8"),
        ("f_rest_8", "f_rest_9", "property f_rest_8: expected it as a float of 16, 32 or 64 bits, found none"),
        ("-3.1 ", "abc ", "property x of vertex 0: expected a number, found \"abc\""),
        ("end_header\n", "", "header: expected"),
        ("format", "fromat", "header: expected"),
    ] {
        assert!(good.contains(from), "{from}");
        let error = read(good.replacen(from, to, 1).as_bytes()).expect_err(to).to_string();
        assert!(error.starts_with(expected), "{to}: {error}");
    }
}

#[test]
fn a_hostile_count_is_refused_before_memory_is_taken() {
    let file = formats::ply::write(&still(1, 3)).bytes;
    for count in ["4000000000", "18446744073709551615", "78200000000000000"] {
        for format in ["binary_little_endian", "ascii"] {
            let mut hostile = file.clone();
            let at = hostile.windows(8).position(|w| w == b"vertex 1").expect("a count");
            hostile.splice(at + 7..at + 8, count.bytes());
            let text = String::from_utf8_lossy(&hostile).replacen("binary_little_endian", format, 1);
            let error = read(text.as_bytes()).expect_err("hostile").to_string();
            assert!(error.contains("element vertex") && error.contains(count), "{error}");
        }
    }
    // A header without an end.
    let endless = [b"ply\n".as_slice(), &b"comment x\n".repeat(500_000)].concat();
    assert!(read(&endless).is_err());
    let wide: String = (0..4097).map(|i| format!("property float p{i}\n")).collect();
    let error = read(format!("ply\nelement vertex 1\n{wide}").as_bytes()).expect_err("wide").to_string();
    assert_eq!(error, "element vertex: expected at most 4096 properties of an element, found more");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn any_numbers_come_back(
        bits in proptest::collection::vec(any::<u32>(), 26..=260),
        degree in 0usize..=3,
    ) {
        let each = 14 + 3 * streamsplat_kernels::harmonics::rest(degree);
        let values: Vec<f32> = bits.iter().map(|b| f32::from_bits(*b)).collect();
        let mut still = Still { degree, ..Still::default() };
        for v in values.chunks_exact(each) {
            still.mean.push([v[0], v[1], v[2]]);
            still.log_scale.push([v[3], v[4], v[5]]);
            still.rotation.push([v[6], v[7], v[8], v[9]]);
            still.logit.push(v[10]);
            still.base.push([v[11], v[12], v[13]]);
            still.higher.extend_from_slice(&v[14..]);
        }
        let file = formats::ply::write(&still).bytes;
        let again = read(&file).expect("just written");
        prop_assert!(formats::ply::write(&again).bytes == file);
        prop_assert_eq!(again.len(), values.len() / each);
    }

    #[test]
    fn any_bytes_are_an_error_or_a_scene(
        at in proptest::collection::vec((any::<proptest::sample::Index>(), any::<u8>()), 1..6),
        text in any::<bool>(),
    ) {
        let mut file = formats::ply::write(&still(2, 1)).bytes;
        if text {
            file = rewritten(&file, "ascii");
        }
        for (index, byte) in at {
            let i = index.index(file.len());
            file[i] = byte;
        }
        if let Ok(still) = read(&file) {
            prop_assert_eq!(still.uneven(), None);
        }
    }
}

#[test]
fn a_compressed_file_comes_back_within_its_precision() {
    for degree in 0..=3 {
        let original = still(600, degree);
        let file = formats::compressed_ply::write(&original).bytes;
        let found = read(&file).expect("just written");
        assert_eq!((found.len(), found.degree, found.uneven()), (600, degree, None));
        let width = 3 * original.rest();
        for i in 0..found.len() {
            // Scenes of `still` repeat after 101 Gaussians; the nearest one is an equal one.
            let distance =
                |j: usize| (0..3).map(|k| (found.mean[i][k] - original.mean[j][k]).abs()).fold(0.0, f32::max);
            let j = (0..original.len()).min_by(|a, b| distance(*a).total_cmp(&distance(*b))).expect("one");
            let close = |a: &[f32], b: &[f32], step: f32| a.iter().zip(b).all(|(a, b)| (a - b).abs() <= step);
            assert!(distance(j) < 0.5 * 7.0 / 1023.0 + 1e-5);
            assert!(close(&found.log_scale[i], &original.log_scale[j], 0.5 * 7.0 / 1023.0 + 1e-5));
            assert!(close(&found.base[i], &original.base[j], 0.5 * 7.0 / 255.0 + 1e-5));
            let cosine: f32 = {
                let q = original.rotation[j];
                let length = q.iter().map(|c| c * c).sum::<f32>().sqrt();
                q.iter().zip(found.rotation[i]).map(|(a, b)| a / length * b).sum()
            };
            assert!(cosine.abs() > 0.999_99, "{cosine}");
            assert!(degree > 0 || found.higher.is_empty());
            if j == i {
                assert!(close(
                    &found.higher[i * width..][..width],
                    &original.higher[j * width..][..width],
                    8.0 / 256.0
                ));
            }
        }
    }
    assert_eq!(read(&formats::compressed_ply::write(&Still::default()).bytes), Ok(Still::default()));
}

#[test]
fn a_wrong_compressed_file_is_named() {
    let file = formats::compressed_ply::write(&still(300, 1)).bytes;
    let end = file.windows(11).position(|w| w == b"end_header\n").expect("a header") + 11;
    let header = std::str::from_utf8(&file[..end]).expect("text");
    for (from, to, expected) in [
        ("element chunk 2", "element chunk 1", "element chunk: expected 2 of them for 300 vertices, found 1"),
        ("float min_y", "double min_y", "property min_y of chunk: expected it as F32, found F64"),
        ("float max_scale_z", "float other", "property max_scale_z of chunk: expected it as F32, found none"),
        ("uint packed_color", "int packed_color", "property packed_color of vertex: expected it as U32, found I32"),
        ("element sh 300", "element sh 299", "element sh: expected 300, as of vertices, found 299"),
        ("property uchar f_rest_8\n", "", "element sh: expected none, 9, 24 or 45 properties, found 8"),
        ("uchar f_rest_3", "uchar g_rest_3", "element sh: expected f_rest_3 as U8, found g_rest_3 as U8"),
        ("binary_little_endian", "ascii", "format: expected a binary one"),
        ("element vertex 300", "element vertex 99999999999", "element chunk: expected 390625000 of them"),
    ] {
        assert!(header.contains(from), "{from}");
        let changed = [header.replacen(from, to, 1).as_bytes(), &file[end..]].concat();
        let error = read(&changed).expect_err(to).to_string();
        assert!(error.starts_with(expected), "{to}: {error}");
    }
    for end in (0..file.len()).step_by(13) {
        assert!(read(&file[..end]).is_err(), "{end}");
    }
}

/// Reads a file from disk in blocks; returns the scene and the reported progress.
fn from_disk(bytes: &[u8], limits: &Limits) -> (Result<StillFile, SceneError>, Vec<(u64, u64)>) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("scene.ply");
    std::fs::write(&path, bytes).expect("writable");
    let mut told = Vec::new();
    let opened = scene_with(&path, limits, &mut |done, total| told.push((done, total)));
    let file = opened.map(|opened| match opened {
        Opened::Still(file) => file,
        Opened::Moving(_) => panic!("a still scene"),
    });
    (file, told)
}

#[test]
fn a_file_read_in_blocks_is_the_one_read_as_a_whole() {
    // With degree 3 these are two blocks and a part of a third.
    for (count, degree) in [(0, 0), (1, 1), (700, 2), (80_000, 3)] {
        let still = still(count, degree);
        let little = formats::ply::write(&still).bytes;
        for file in [rewritten(&little, "binary_big_endian"), little] {
            let (found, told) = from_disk(&file, &Limits::default());
            let found = found.expect("a scene");
            assert!(found.still == still, "{count} of degree {degree}");
            assert_eq!(found.blake3, blake3::hash(&file).to_hex().to_string());
            assert_eq!(found.bytes, file.len() as u64);
            assert!(told.is_sorted() && told.last() == Some(&(file.len() as u64, file.len() as u64)), "{told:?}");
            assert!(count < 80_000 || told.len() > 3);
        }
    }
    // Elements before and after the vertices are part of the digest, not of the scene.
    let names = ["red", "green", "blue"].map(|name| format!("property half {name}\n")).concat();
    let bytes: Vec<u8> = (0..50).collect();
    let file = vertex("float", &names, &bytes);
    let (found, _) = from_disk(&file, &Limits::default());
    let found = found.expect("a scene");
    assert_eq!((Ok(found.still), found.blake3), (read(&file), blake3::hash(&file).to_hex().to_string()));
}

#[test]
fn what_is_wrong_with_a_file_is_said_alike_in_blocks_and_as_a_whole() {
    let file = formats::ply::write(&still(3, 1)).bytes;
    for end in [10, 200, file.len() - 1] {
        let (found, _) = from_disk(&file[..end], &Limits::default());
        let (found, expected) = (found.expect_err("cut").to_string(), read(&file[..end]).expect_err("cut").to_string());
        assert!(found.ends_with(&expected), "{found}, {expected}");
    }
    let (found, _) = from_disk(&[&file[..], b"\n"].concat(), &Limits::default());
    assert_eq!(found.expect("a line feed").still, still(3, 1));
    let (found, _) = from_disk(&[&file[..], b"\n2"].concat(), &Limits::default());
    assert!(found.expect_err("longer").to_string().contains("its end after the last element"));
    let (found, _) = from_disk(&file, &Limits { gaussians: 2, ..Limits::default() });
    assert!(found.expect_err("too many").to_string().contains("at most 2 Gaussians"));
    // A header that declares more than fits in memory.
    let text = String::from_utf8_lossy(&file).replace("vertex 3", "vertex 18446744073709551615");
    let (found, _) = from_disk(text.as_bytes(), &Limits::default());
    assert!(found.expect_err("too long").to_string().contains("element vertex"));
}

/// Replaces text in a file's header.
fn with_header(file: &[u8], from: &str, to: &[u8]) -> Vec<u8> {
    let at = file.windows(from.len()).position(|w| w == from.as_bytes()).expect(from);
    [&file[..at], to, &file[at + from.len()..]].concat()
}

#[test]
fn headers_of_other_programs_are_read() {
    let file = formats::ply::write(&still(3, 1)).bytes;
    let whole = read(&file);
    let long = [&b"comment "[..], &b"x".repeat(100_000), b"\nelement vertex"].concat();
    for to in [
        // A comment in GBK, a list of no records, a long header.
        &b"comment \xd6\xd0\xce\xc4\nobj_info \xff\nelement vertex"[..],
        b"element face 0\nproperty list uchar int vertex_indices\nelement vertex",
        &long,
    ] {
        let changed = with_header(&file, "element vertex", to);
        assert!(read(&changed) == whole, "{:?}", String::from_utf8_lossy(&to[..20]));
        assert!(from_disk(&changed, &Limits::default()).0.expect("a scene").still == still(3, 1));
    }
    let changed = with_header(&file, "property float x", b"property float \xd6\xd0");
    let error = read(&changed).expect_err("a name").to_string();
    assert!(error.starts_with("header: expected text"), "{error}");
}

#[test]
fn an_axis_that_points_up_is_noted_with_the_axes_that_show_it_upright() {
    let file = formats::ply::write(&still(2, 0)).bytes;
    let notes = |comment: &str| {
        let to = format!("comment {comment}\nelement vertex");
        read(&with_header(&file, "element vertex", to.as_bytes())).expect("comments").about.notes
    };
    let found = notes("Vertical Axis: z");
    assert!(found.len() == 1 && found[0].contains("z axis") && found[0].contains("--axes rfu"), "{found:?}");
    assert!(notes("Vertical Axis: y")[0].contains("--axes rub"));
    assert!(notes("Vertical Axis: x").is_empty() && notes("made by hand").is_empty());
}

#[test]
fn marks_of_antialiased_training_are_read_and_written() {
    let file = formats::ply::write(&still(2, 0)).bytes;
    let of = |comments: &str| {
        let to = format!("{comments}element vertex");
        read(&with_header(&file, "element vertex", to.as_bytes())).expect("comments").about.antialiased
    };
    for (comments, expected) in [
        ("comment SplatRenderMode: mip\n", true),
        ("comment splatrendermode:  MIP\n", true),
        ("comment antialiased 1\n", true),
        ("obj_info antialiased 1\n", true),
        ("comment antialiased 1\ncomment SplatRenderMode: default\n", false),
        ("comment SplatRenderMode: 2dgs\n", false),
        ("comment antialiased 0\n", false),
        ("comment not antialiased 1\n", false),
        ("", false),
    ] {
        assert_eq!(of(comments), expected, "{comments}");
    }
    let mut marked = still(300, 1);
    marked.about.antialiased = true;
    marked.about.offset = [1e6, 0.5, -3.0];
    let packed = read(&formats::compressed_ply::write(&marked).bytes).expect("just written");
    assert_eq!(packed.about, marked.about);
    let plain = read(&formats::ply::write(&marked).bytes).expect("just written");
    assert!(plain.about.antialiased);
}

#[test]
fn harmonics_of_degree_4_are_read_to_degree_3() {
    let still = still(2, 3);
    let file = formats::ply::write(&still).bytes;
    let end = file.windows(11).position(|w| w == b"end_header\n").expect("a header") + 11;
    // f_rest_i of 24 per channel; the last nine are those of degree 4.
    let header = String::from_utf8(file[..end].to_vec()).expect("text");
    let names: String = (45..72).map(|i| format!("property float f_rest_{i}\n")).collect();
    let header = header.replace("property float f_rest_44\n", &format!("property float f_rest_44\n{names}"));
    let mut body = Vec::new();
    for record in file[end..].chunks_exact(62 * 4) {
        body.extend_from_slice(&record[..9 * 4]);
        for channel in record[9 * 4..54 * 4].chunks_exact(15 * 4) {
            body.extend_from_slice(channel);
            body.extend_from_slice(&7.0_f32.to_le_bytes().repeat(9));
        }
        body.extend_from_slice(&record[54 * 4..]);
    }
    let mut found = read(&[header.as_bytes(), &body].concat()).expect("degree 4");
    assert_eq!(std::mem::take(&mut found.about.notes), ["harmonics of degree 4 read to degree 3"]);
    assert!(found == still);
}

#[test]
fn gaussians_without_a_third_scale_have_no_thickness() {
    let still = still(3, 1);
    let file = rewritten(&formats::ply::write(&still).bytes, "ascii");
    let text = String::from_utf8(file).expect("text");
    let (header, body) = text.split_once("end_header\n").expect("a header");
    let without: Vec<String> = body
        .lines()
        .map(|line| {
            let mut words: Vec<&str> = line.split(' ').collect();
            words.remove(words.len() - 5);
            words.join(" ")
        })
        .collect();
    let file = format!("{}end_header\n{}\n", header.replace("property float scale_2\n", ""), without.join("\n"));
    let found = read(file.as_bytes()).expect("2D Gaussians");
    assert_eq!(found.log_scale[1], [still.log_scale[1][0], still.log_scale[1][1], f32::NEG_INFINITY]);
    assert_eq!((found.rotation[1], found.defect(1)), (still.rotation[1], None));
    assert_eq!(found.about.notes, ["no scale_2: Gaussians without thickness, as of 2D Gaussian splatting"]);
}

#[test]
fn doubles_far_from_zero_are_kept_relative_to_an_offset() {
    let mut far = still(5000, 0);
    far.about.offset = [431_250.0, 5_411_800.0, 312.0];
    let file = formats::ply::write(&far).bytes;
    assert!(String::from_utf8_lossy(&file).contains("property double x\nproperty double y\nproperty double z\n"));
    let found = read(&file).expect("doubles");
    // Integers near the middle.
    let place = |still: &Still, i: usize, k: usize| f64::from(still.mean[i][k]) + still.about.offset[k];
    for i in 0..far.len() {
        assert!((0..3).all(|k| (place(&found, i, k) - place(&far, i, k)).abs() < 1e-6), "{i}");
    }
    assert!(found.about.offset.iter().all(|x| x.fract() == 0.0 && *x != 0.0), "{:?}", found.about.offset);
    // The other encodings: three doubles and fourteen floats.
    let end = file.windows(11).position(|w| w == b"end_header\n").expect("a header") + 11;
    let header = String::from_utf8(file[..end].to_vec()).expect("text");
    let (mut big, mut text) = (Vec::new(), String::new());
    for record in file[end..].chunks_exact(24 + 56) {
        for x in record[..24].as_chunks().0.iter().map(|b| f64::from_le_bytes(*b)) {
            big.extend_from_slice(&x.to_be_bytes());
            text.push_str(&format!("{x} "));
        }
        for x in record[24..].as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)) {
            big.extend_from_slice(&x.to_be_bytes());
            text.push_str(&format!("{x} "));
        }
        text.push('\n');
    }
    for (format, body) in [("binary_big_endian", big), ("ascii", text.into_bytes())] {
        let other = [header.replace("binary_little_endian", format).as_bytes(), &body].concat();
        assert!(read(&other) == Ok(found.clone()), "{format}");
    }
    assert!(from_disk(&file, &Limits::default()).0.expect("in blocks").still == found);
    // Writing and reading it again changes nothing.
    assert!(read(&formats::ply::write(&found).bytes) == Ok(found.clone()));
    // Doubles near zero are read like other numbers.
    far.about.offset = [1.0, 0.0, 0.0];
    let near = read(&formats::ply::write(&far).bytes).expect("doubles");
    assert_eq!((near.about.offset, near.mean[7][0]), ([0.0; 3], (f64::from(far.mean[7][0]) + 1.0) as f32));
}
