//! PLY files go in, and what is none is named.

use proptest::prelude::*;

use super::ply;
use crate::export;
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
    }
}

/// The same file as text, or with its numbers' bytes turned round.
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
        let file = export::still::ply(&still);
        assert_eq!(ply(&file).as_ref(), Ok(&still), "degree {degree}");
        for format in ["ascii", "binary_big_endian"] {
            assert_eq!(ply(&rewritten(&file, format)).as_ref(), Ok(&still), "{format}, degree {degree}");
        }
    }
    assert_eq!(ply(&export::still::ply(&Still::default())), Ok(Still::default()));
}

#[test]
fn properties_may_stand_in_any_order_and_beside_others() {
    let header = "ply\r\nformat ascii 1.0\r\ncomment made by hand\r\nelement vertex 1\r\nproperty uchar red\r\n\
        property double rot_0\r\nproperty float rot_1\r\nproperty float rot_2\r\nproperty float rot_3\r\n\
        property float opacity\r\nproperty float z\r\nproperty float y\r\nproperty float x\r\nproperty float f_dc_2\r\n\
        property float f_dc_1\r\nproperty float f_dc_0\r\nproperty float scale_2\r\nproperty float scale_1\r\n\
        property float scale_0\r\nend_header\r\n7 1 0.5 0 -1 2.5 3 2 1 -0.3 -0.2 -0.1 9 8 nan\r\n\r\n";
    let found = ply(header.as_bytes()).expect("valid");
    assert_eq!((found.mean[0], found.base[0], found.logit[0]), ([1.0, 2.0, 3.0], [-0.1, -0.2, -0.3], 2.5));
    assert_eq!(found.rotation[0], [1.0, 0.5, 0.0, -1.0]);
    assert!(found.log_scale[0][0].is_nan() && found.log_scale[0][1..] == [8.0, 9.0]);
}

#[test]
fn every_shorter_and_longer_file_is_an_error() {
    for degree in [0, 1] {
        let file = export::still::ply(&still(3, degree));
        for format in ["binary_little_endian", "binary_big_endian"] {
            let file = if format.ends_with("big_endian") { rewritten(&file, format) } else { file.clone() };
            for end in 0..file.len() {
                assert!(ply(&file[..end]).is_err(), "{format} {end}");
            }
            assert!(ply(&[&file[..], b"\n"].concat()).is_err());
        }
        let text = rewritten(&file, "ascii");
        // Without its last digits and line feed the last number may still be one.
        let last = text.iter().rposition(|b| *b == b' ').expect("numbers");
        for end in 0..=last {
            assert!(ply(&text[..end]).is_err(), "text {end}");
        }
        assert!(ply(&[&text[..], b"1\n"].concat()).is_err());
    }
}

#[test]
fn what_is_wrong_is_named() {
    let good = String::from_utf8(rewritten(&export::still::ply(&still(2, 1)), "ascii")).expect("text");
    assert!(ply(good.as_bytes()).is_ok());
    for (from, to, expected) in [
        ("ply\n", "plx\n", "first line: expected ply, found \"plx\""),
        ("ascii 1.0", "ascii 2.0", "format: expected version 1.0, found \"2.0\""),
        ("ascii", "utf16", "format: expected ascii, binary_little_endian or binary_big_endian"),
        ("vertex 2", "vertex -2", "element vertex: expected a number of vertices, found \"-2\""),
        ("vertex 2", "vertex 3", "vertices: expected 3 lines, found 2"),
        ("vertex 2", "vertex 18446744073709551615", "vertices: expected 18446744073709551615 of 26 numbers each"),
        ("vertex 2", "vertex 1", "vertices: expected nothing after the last"),
        ("element vertex", "element face", "element face: expected one element, vertex"),
        ("end_header", "element face 0\nend_header", "element face: expected one element, vertex"),
        (
            "property float opacity",
            "property list uchar int opacity",
            "property opacity: expected a number, found a list",
        ),
        (
            "property float opacity",
            "property float alpha",
            "property opacity: expected it as float or double, found none",
        ),
        (
            "property float opacity",
            "property uchar opacity",
            "property opacity: expected it as float or double, found whole",
        ),
        ("property float opacity", "property quad opacity", "property opacity: expected a scalar type, found \"quad\""),
        ("property float nx", "property float x", "property x: expected it once, found it twice"),
        ("property float f_rest_8\n", "", "properties f_rest_*: expected none, 9, 24 or 45 of them, found 8"),
        ("f_rest_8", "f_rest_9", "property f_rest_8: expected it as float or double, found none"),
        ("-3.1 ", "abc ", "property x of vertex 0: expected a number, found \"abc\""),
        ("end_header\n", "", "header: expected"),
        ("format", "fromat", "header: expected"),
    ] {
        assert!(good.contains(from), "{from}");
        let error = ply(good.replacen(from, to, 1).as_bytes()).expect_err(to).to_string();
        assert!(error.starts_with(expected), "{to}: {error}");
    }
}

#[test]
fn a_hostile_count_is_refused_before_memory_is_taken() {
    let file = export::still::ply(&still(1, 3));
    for count in ["4000000000", "18446744073709551615", "78200000000000000"] {
        for format in ["binary_little_endian", "ascii"] {
            let mut hostile = file.clone();
            let at = hostile.windows(8).position(|w| w == b"vertex 1").expect("a count");
            hostile.splice(at + 7..at + 8, count.bytes());
            let text = String::from_utf8_lossy(&hostile).replacen("binary_little_endian", format, 1);
            let error = ply(text.as_bytes()).expect_err("hostile").to_string();
            assert!(error.contains("vertices") && error.contains(count), "{error}");
        }
    }
    // A header without end.
    let endless = [b"ply\n".as_slice(), &b"comment x\n".repeat(100_000)].concat();
    assert!(ply(&endless).is_err());
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
        let file = export::still::ply(&still);
        let again = ply(&file).expect("just written");
        prop_assert!(export::still::ply(&again) == file);
        prop_assert_eq!(again.len(), values.len() / each);
    }

    #[test]
    fn any_bytes_are_an_error_or_a_scene(
        at in proptest::collection::vec((any::<proptest::sample::Index>(), any::<u8>()), 1..6),
        text in any::<bool>(),
    ) {
        let mut file = export::still::ply(&still(2, 1));
        if text {
            file = rewritten(&file, "ascii");
        }
        for (index, byte) in at {
            let i = index.index(file.len());
            file[i] = byte;
        }
        if let Ok(still) = ply(&file) {
            prop_assert_eq!(still.uneven(), None);
        }
    }
}
