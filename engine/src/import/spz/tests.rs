//! SPZ files go out and come back, and what is none is named.

use std::io::{Read, Write};

use proptest::prelude::*;

use super::super::Limits;
use super::spz;
use crate::export;
use crate::still::Still;

fn still(count: usize, degree: usize) -> Still {
    let value = |i: usize, k: usize| ((i * 37 + k * 11) % 101) as f32 / 50.5 - 0.99;
    let rest = streamsplat_kernels::harmonics::rest(degree);
    Still {
        mean: (0..count).map(|i| std::array::from_fn(|k| 4.0 * value(i, k))).collect(),
        log_scale: (0..count).map(|i| std::array::from_fn(|k| -4.0 + 3.0 * value(i, 3 + k))).collect(),
        rotation: (0..count).map(|i| std::array::from_fn(|k| 2.0 * value(i, 6 + k) + 0.01)).collect(),
        logit: (0..count).map(|i| 4.0 * value(i, 10)).collect(),
        base: (0..count).map(|i| std::array::from_fn(|k| 2.0 * value(i, 11 + k))).collect(),
        degree,
        higher: (0..count * 3 * rest).map(|i| 0.9 * value(i, 14)).collect(),
    }
}

/// The same scene in version 2 or 3.
fn old(still: &Still, version: u32) -> Vec<u8> {
    let file = export::still::spz(still);
    let packed = super::current(&file, &Limits::default()).expect("just written");
    let mut bytes = [&b"NGSP"[..], &version.to_le_bytes(), &file[8..15], &[0]].concat();
    for attribute in [&packed.positions, &packed.alphas, &packed.colours, &packed.scales] {
        bytes.extend_from_slice(attribute);
    }
    match version {
        2 => {
            for q in &still.rotation {
                let norm = q.iter().map(|c| c * c).sum::<f32>().sqrt() * q[0].signum();
                let [_, x, y, z] = q.map(|c| c / norm);
                bytes.extend_from_slice(&[x, -y, -z].map(|c| (c * 127.5 + 127.5).round() as u8));
            }
        }
        _ => bytes.extend_from_slice(&packed.rotations),
    }
    bytes.extend_from_slice(&packed.harmonics);
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
    encoder.write_all(&bytes).expect("memory");
    encoder.finish().expect("memory")
}

/// A file of version 3 with coefficients of degree 4 behind those of degree 3.
fn of_degree_4(still: &Still) -> Vec<u8> {
    let mut plain = Vec::new();
    flate2::read::GzDecoder::new(&old(still, 3)[..]).read_to_end(&mut plain).expect("just written");
    let before = plain.len() - 45 * still.len();
    let mut bytes = plain[..before].to_vec();
    bytes[12] = 4;
    for own in plain[before..].chunks_exact(45) {
        bytes.extend_from_slice(own);
        bytes.extend_from_slice(&[200; 27]);
    }
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
    encoder.write_all(&bytes).expect("memory");
    encoder.finish().expect("memory")
}

#[test]
fn of_harmonics_of_degree_4_those_up_to_degree_3_are_kept() {
    let still = still(40, 3);
    assert!(spz(&of_degree_4(&still)) == spz(&old(&still, 3)));
}

fn assert_close(found: &Still, expected: &Still, turn: f64) {
    assert_eq!((found.len(), found.degree, found.uneven()), (expected.len(), expected.degree, None));
    let near = |a: &[f32], b: &[f32], most: f32, what: &str| {
        let worst = a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(worst <= most, "{what}: {worst}");
    };
    near(found.mean.as_flattened(), expected.mean.as_flattened(), 0.501 / 4096.0, "mean");
    near(found.log_scale.as_flattened(), expected.log_scale.as_flattened(), 0.501 / 16.0, "scale");
    near(found.base.as_flattened(), expected.base.as_flattened(), 0.501 / 255.0 / 0.15, "base");
    // Rounded twice, to a byte and to a bucket of 16.
    near(&found.higher, &expected.higher, 1.0 / 16.0 + 0.501 / 128.0, "higher");
    let opacity = |logit: &[f32]| logit.iter().map(|x| 1.0 / (1.0 + (-x).exp())).collect::<Vec<f32>>();
    near(&opacity(&found.logit), &opacity(&expected.logit), 0.501 / 255.0, "opacity");
    for (a, b) in found.rotation.iter().zip(&expected.rotation) {
        let dot = |a: &[f32; 4], b: &[f32; 4]| a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>();
        let cosine = dot(a, b).abs() / (dot(a, a) * dot(b, b)).sqrt();
        assert!(1.0 - cosine < turn, "{a:?} {b:?}");
    }
}

#[test]
fn a_scene_comes_back_to_the_formats_precision_in_every_version() {
    for degree in 0..=3 {
        let still = still(101, degree);
        assert_close(&spz(&export::still::spz(&still)).expect("version 4"), &still, 1e-5);
        assert_close(&spz(&old(&still, 3)).expect("version 3"), &still, 1e-5);
        // Its w is what x, y and z leave, which says little where it is small.
        assert_close(&spz(&old(&still, 2)).expect("version 2"), &still, 1e-2);
    }
    assert_eq!(spz(&export::still::spz(&Still::default())), Ok(Still::default()));
}

#[test]
fn what_is_read_is_written_again_as_the_same_bytes() {
    for degree in [0, 3] {
        let once = spz(&export::still::spz(&still(64, degree))).expect("just written");
        let file = export::still::spz(&once);
        assert!(export::still::spz(&spz(&file).expect("just written")) == file, "degree {degree}");
    }
}

#[test]
fn every_shorter_and_longer_file_is_an_error() {
    for file in [export::still::spz(&still(5, 1)), old(&still(5, 1), 3), old(&still(5, 0), 2)] {
        assert!(spz(&file).is_ok());
        for end in 0..file.len() {
            assert!(spz(&file[..end]).is_err(), "{end}");
        }
        assert!(spz(&[&file[..], &[0]].concat()).is_err());
    }
}

#[test]
fn what_is_wrong_is_named() {
    let good = export::still::spz(&still(5, 1));
    for (at, value, expected) in [
        (0, 0, "header: first word: expected NGSP"),
        (4, 3, "header: version: expected 4 to 4 in a file of this kind, found 3"),
        (8, 6, "positions: expected 54 bytes, found 45"),
        (11, 200, "header: points: expected at most"),
        (12, 5, "header: degree of the harmonics: expected 0 to 4, found 5"),
        (12, 0, "header: streams: expected 5, found 6"),
        (12, 2, "harmonics: expected 120 bytes, found 45"),
        (13, 24, "header: fractional bits: expected 0 to 23, found 24"),
        (14, 2, "header: flags: expected none but anti-aliasing"),
        (15, 7, "header: streams: expected 6, found 7"),
        (16, 33, "header: table: expected it at byte 32"),
        (31, 1, "header: table: expected it at byte 32, and zeros between"),
        (39, 1, "positions: expected 72057594037927"),
        (47, 1, "positions: expected 45 bytes, found 72057594037927"),
    ] {
        let mut file = good.clone();
        file[at] = value;
        let error = spz(&file).expect_err(expected).to_string();
        assert!(error.starts_with(expected), "{error}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn any_bytes_are_an_error_or_a_scene(
        changes in proptest::collection::vec((any::<proptest::sample::Index>(), any::<u8>()), 1..6),
        kind in 0_usize..3,
    ) {
        let mut file = match kind {
            0 => export::still::spz(&still(9, 1)),
            version => old(&still(9, 1), version as u32 + 1),
        };
        for (index, byte) in changes {
            let at = index.index(file.len());
            file[at] = byte;
        }
        if let Ok(still) = spz(&file) {
            prop_assert_eq!(still.uneven(), None);
        }
    }
}
