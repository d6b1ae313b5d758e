//! SPZ files survive a round trip, and errors name the invalid part.

use std::io::{Read, Write};

use proptest::prelude::*;

use super::super::Limits;
use super::read;
use crate::formats::{self, SpzVersion};
use crate::still::{Axes, Orbit, Still};

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
        ..Still::default()
    }
}

/// Writes a scene as a file of version 4.
fn newest(still: &Still) -> Vec<u8> {
    formats::spz::write(still, SpzVersion::V4).bytes
}

/// Writes the same scene in version 2 or 3.
fn old(still: &Still, version: u32) -> Vec<u8> {
    let file = newest(still);
    let packed = super::current(&file, &Limits::default()).expect("just written");
    let mut bytes = [&b"NGSP"[..], &version.to_le_bytes(), &file[8..14], &[0, 0]].concat();
    for attribute in [&packed.positions, &packed.alphas, &packed.colours, &packed.scales] {
        bytes.extend_from_slice(attribute);
    }
    match version {
        2 => {
            for q in &still.rotation {
                let norm = q.iter().map(|c| c * c).sum::<f32>().sqrt() * q[0].signum();
                let [_, x, y, z] = q.map(|c| c / norm);
                bytes.extend_from_slice(&[x, y, z].map(|c| (c * 127.5 + 127.5).round() as u8));
            }
        }
        _ => bytes.extend_from_slice(&packed.rotations),
    }
    bytes.extend_from_slice(&packed.harmonics);
    gzipped(&bytes, Some("axes RDF"))
}

fn gzipped(bytes: &[u8], comment: Option<&str>) -> Vec<u8> {
    let builder = comment.into_iter().fold(flate2::GzBuilder::new(), |builder, comment| builder.comment(comment));
    let mut encoder = builder.write(Vec::new(), flate2::Compression::best());
    encoder.write_all(bytes).expect("memory");
    encoder.finish().expect("memory")
}

fn gunzipped(file: &[u8]) -> Vec<u8> {
    let mut plain = Vec::new();
    flate2::read::GzDecoder::new(file).read_to_end(&mut plain).expect("a gzip stream");
    plain
}

/// Builds a file of version 3 with coefficients of degree 4 after those of degree 3.
fn of_degree_4(still: &Still) -> Vec<u8> {
    let plain = gunzipped(&old(still, 3));
    let before = plain.len() - 45 * still.len();
    let mut bytes = plain[..before].to_vec();
    bytes[12] = 4;
    for own in plain[before..].chunks_exact(45) {
        bytes.extend_from_slice(own);
        bytes.extend_from_slice(&[200; 27]);
    }
    gzipped(&bytes, Some("axes RDF"))
}

#[test]
fn of_harmonics_of_degree_4_those_up_to_degree_3_are_kept() {
    let still = still(40, 3);
    let mut expected = read(&old(&still, 3)).expect("version 3");
    expected.about.notes.push("harmonics of degree 4 read to degree 3".to_owned());
    assert!(read(&of_degree_4(&still)) == Ok(expected));
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
        assert_close(
            &read(&formats::spz::write(&still, formats::SpzVersion::V3).bytes).expect("version 3"),
            &still,
            1e-5,
        );
        assert_close(&read(&newest(&still)).expect("version 4"), &still, 1e-5);
        assert_close(&read(&old(&still, 3)).expect("version 3"), &still, 1e-5);
        // w is computed from x, y and z, which is imprecise where w is small.
        assert_close(&read(&old(&still, 2)).expect("version 2"), &still, 1e-2);
    }
    assert_eq!(read(&formats::spz::write(&Still::default(), formats::SpzVersion::V3).bytes), Ok(Still::default()));
}

#[test]
fn what_is_read_is_written_again_as_the_same_bytes() {
    for degree in [0, 3] {
        let once = read(&formats::spz::write(&still(64, degree), formats::SpzVersion::V3).bytes).expect("just written");
        for version in [SpzVersion::V3, SpzVersion::V4] {
            let written = |still: &Still| formats::spz::write(still, version).bytes;
            let file = written(&once);
            assert!(written(&read(&file).expect("just written")) == file, "degree {degree}");
        }
    }
}

#[test]
fn every_shorter_and_longer_file_is_an_error() {
    for file in [
        newest(&still(5, 1)),
        formats::spz::write(&still(5, 1), formats::SpzVersion::V3).bytes,
        old(&still(5, 1), 3),
        old(&still(5, 0), 2),
    ] {
        assert!(read(&file).is_ok());
        for end in 0..file.len() {
            assert!(read(&file[..end]).is_err(), "{end}");
        }
        assert!(read(&[&file[..], &[0]].concat()).is_err());
    }
}

#[test]
fn what_is_wrong_is_named() {
    let good = newest(&still(5, 1));
    // One record: the axes.
    for (at, value, expected) in [
        (0, 0, "header: first word: expected NGSP"),
        (4, 3, "header: version: expected 4 to 4 in a file of this kind, found 3"),
        (8, 6, "positions: expected 54 bytes, found 45"),
        (11, 200, "header: points: expected at most"),
        (12, 5, "header: degree of the harmonics: expected 0 to 4, found 5"),
        (12, 0, "header: streams: expected 5, found 6"),
        (12, 2, "harmonics: expected 120 bytes, found 45"),
        (13, 24, "header: fractional bits: expected 0 to 23, found 24"),
        (14, 4, "header: flags: expected none but those of anti-aliasing (1) and of extensions (2), found 4"),
        (14, 0, "header: table: expected it at byte 32"),
        (15, 7, "header: streams: expected 6, found 7"),
        (16, 31, "header: table: expected it from byte 32 on"),
        (16, 43, "extension record 0xadbe0003: expected 4 bytes, found 3 bytes"),
        (36, 5, "extension record 0xadbe0003: expected 5 bytes, found 4 bytes"),
        (36, 0, "extension record 0xadbe0003: expected 4 bytes, found 0"),
        (40, 17, "extension record 0xadbe0003: expected axes from 1 to 16, found 17"),
        (31, 1, "header: table: expected it at byte 32, and zeros between"),
        (51, 1, "positions: expected 72057594037927"),
        (59, 1, "positions: expected 45 bytes, found 72057594037927"),
    ] {
        let mut file = good.clone();
        file[at] = value;
        let error = read(&file).expect_err(expected).to_string();
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
            0 => newest(&still(9, 1)),
            version => old(&still(9, 1), version as u32 + 1),
        };
        for (index, byte) in changes {
            let at = index.index(file.len());
            file[at] = byte;
        }
        if let Ok(still) = read(&file) {
            prop_assert_eq!(still.uneven(), None);
        }
    }
}

/// Builds a file of version 4 with other records.
fn with_records(file: &[u8], records: &[u8]) -> Vec<u8> {
    let table = u32::from_le_bytes(file[16..20].try_into().expect("four bytes")) as usize;
    let mut head = file[..32].to_vec();
    head[14] |= 2;
    head[16..20].copy_from_slice(&(32 + records.len() as u32).to_le_bytes());
    [&head, records, &file[table..]].concat()
}

fn record(kind: u32, payload: &[u8]) -> Vec<u8> {
    [&kind.to_le_bytes()[..], &(payload.len() as u32).to_le_bytes(), payload].concat()
}

#[test]
fn axes_are_those_that_the_file_says_or_else_rub_which_is_told() {
    let still = still(20, 3);
    let stated = read(&newest(&still)).expect("version 4");
    assert_eq!((stated.about.axes, stated.about.axes_assumed), (Axes::RDF, false));
    let assumed = |found: &Still| {
        assert_eq!((found.about.axes, found.about.axes_assumed), (Axes::RUB, true));
        assert!(found.about.lines()[0].contains("taken as RUB"), "{:?}", found.about.lines());
        let [x, y, z] = stated.mean[0];
        assert_eq!(found.mean[0], [x, -y, -z]);
    };
    let silent = with_records(&newest(&still), &[]);
    assumed(&read(&silent).expect("no records"));
    assumed(&read(&gzipped(&gunzipped(&old(&still, 3)), None)).expect("no comment"));
    assumed(&read(&with_records(&silent, &record(0xadbe_0003, &[0; 4]))).expect("axes that are not specified"));
    // Axes set by the user have the same effect as axes in the file.
    let mut told = read(&silent).expect("no records");
    told.taken_along(Axes::RDF);
    assert!(told == stated);
    for axes in Axes::all() {
        let found = read(&with_records(&silent, &record(0xadbe_0003, &axes.code().to_le_bytes()))).expect("axes");
        let mut expected = stated.clone();
        expected.taken_along(axes);
        assert!(found == expected, "{axes}");
    }
}

#[test]
fn records_are_read_or_skipped_by_their_length() {
    let still = still(20, 1);
    let records = [
        record(0x1234_0001, &[7; 24]),
        record(0xadbe_0002, [0.1_f32, 0.6, 2.5].map(f32::to_le_bytes).as_flattened()),
        record(0xadbe_0003, &6_u32.to_le_bytes()),
    ]
    .concat();
    let mut old = gunzipped(&old(&still, 3));
    old[14] |= 2;
    old.extend_from_slice(&records);
    for file in [with_records(&newest(&still), &records), gzipped(&old, None)] {
        let found = read(&file).expect("records");
        assert_eq!(found.mean, read(&newest(&still)).expect("version 4").mean);
        assert_eq!(found.about.notes, ["extension record 0x12340001 of 24 bytes left out"]);
        assert_eq!(found.about.orbit, Some(Orbit { elevation: [0.1, 0.6], radius: 2.5 }));
    }
    for end in 1..records.len() {
        let cut = read(&with_records(&newest(&still), &records[..end]));
        assert!(cut.is_ok() == [32, 52].contains(&end), "{end}");
    }
}

#[test]
fn version_1_has_centres_in_binary16() {
    let still = still(7, 0);
    let plain = gunzipped(&old(&still, 2));
    let mut bytes = [&plain[..4], &1_u32.to_le_bytes(), &plain[8..16]].concat();
    for x in still.mean.as_flattened() {
        bytes.extend_from_slice(&half::f16::from_f32(*x).to_le_bytes());
    }
    bytes.extend_from_slice(&plain[16 + 9 * 7..]);
    let found = read(&gzipped(&bytes, Some("axes RDF"))).expect("version 1");
    let near = |(a, b): (&f32, &f32)| (a - b).abs() <= b.abs() / 2048.0;
    assert!(found.mean.as_flattened().iter().zip(still.mean.as_flattened()).all(near));
    assert_eq!(found.rotation, read(&old(&still, 2)).expect("version 2").rotation);
}

#[test]
fn version_1_has_centres_in_fixed_point_where_the_file_is_as_long() {
    let still = still(7, 1);
    let plain = gunzipped(&old(&still, 2));
    let first = [&plain[..4], &1_u32.to_le_bytes(), &plain[8..]].concat();
    let expected = read(&old(&still, 2)).expect("version 2");
    assert_eq!(read(&gzipped(&first, Some("axes RDF"))), Ok(expected));
    let text = read(&gzipped(&first[..first.len() - 1], None)).expect_err("a byte short").to_string();
    assert!(text.contains("attributes: expected 175 bytes, or 196 with positions in fixed point, found 195"), "{text}");
    let more = read(&gzipped(&[&first[..], &[0]].concat(), None)).expect_err("a byte more").to_string();
    assert!(more.contains("attributes: expected 175 bytes, found more"), "{more}");
}

#[test]
fn the_mark_of_anti_aliasing_the_orbit_and_the_offset_come_back() {
    let mut still = still(9, 1);
    still.about.antialiased = true;
    still.about.offset = [431_250.0, 5_411_800.5, -312.0];
    let about = |file: &[u8]| read(file).expect("just written").about;
    assert_eq!(about(&formats::spz::write(&still, formats::SpzVersion::V3).bytes), still.about);
    still.about.orbit = Some(Orbit { elevation: [-0.1, 0.6], radius: 2.0 });
    assert_eq!(about(&newest(&still)), still.about);
    let notes = |version| formats::spz::write(&still, version).notes;
    assert_eq!(notes(SpzVersion::V4).len(), 1);
    assert!(notes(SpzVersion::V4)[0].starts_with("coordinates are relative to (431250, 5411800.5, -312)"));
    assert!(notes(SpzVersion::V3)[1].starts_with("the limits of an orbiting camera left out"));
}

#[test]
fn a_floater_costs_no_one_elses_precision_and_is_told() {
    let mut still = still(400, 0);
    still.mean[7][0] = 5.3e8;
    let written = formats::spz::write(&still, SpzVersion::V4);
    assert_eq!(
        written.notes,
        ["1 of 400 Gaussians moved to 2048 units, the farthest that keeps the others' precision"]
    );
    let found = read(&written.bytes).expect("just written");
    assert_eq!(found.mean[7][0], 8_388_607.0 / 4096.0);
    for i in (0..400).filter(|i| *i != 7) {
        assert!((0..3).all(|k| (found.mean[i][k] - still.mean[i][k]).abs() <= 0.501 / 4096.0), "{i}");
    }
}

#[test]
fn a_tiny_scene_keeps_its_places() {
    let mut tiny = still(400, 0);
    tiny.mean.iter_mut().flatten().for_each(|x| *x *= 1e-3);
    tiny.log_scale.iter_mut().flatten().for_each(|x| *x = -9.0);
    let found = read(&formats::spz::write(&tiny, SpzVersion::V3).bytes).expect("just written");
    let width = (-9.0_f32).exp();
    assert!((0..400).all(|i| (0..3).all(|k| (found.mean[i][k] - tiny.mean[i][k]).abs() <= 0.2 * width)));
}

#[test]
fn a_wide_scene_is_not_cut_off_and_a_map_is_written_around_its_middle() {
    // A tenth of the Gaussians is at 3000 units, like a sky.
    let mut wide = still(400, 0);
    wide.mean.iter_mut().step_by(10).for_each(|m| m[2] = 3000.0);
    let written = formats::spz::write(&wide, SpzVersion::V3);
    assert_eq!(written.notes, ["positions to 1/2048 unit, as the scene reaches farther than 2048 units"]);
    let found = read(&written.bytes).expect("just written");
    assert!((0..400).all(|i| (0..3).all(|k| (found.mean[i][k] - wide.mean[i][k]).abs() <= 0.501 / 2048.0)));
    // A single Gaussian far away does not count as a stray one.
    let mut alone = still(1, 0);
    alone.mean[0] = [5000.0, -7.0, 1.0];
    let found = read(&formats::spz::write(&alone, formats::SpzVersion::V3).bytes).expect("just written");
    assert_eq!((found.mean[0], found.about.offset), ([5000.0, -7.0, 1.0], [0.0; 3]));
    // Map coordinates in binary32: relative ones are more precise than SPZ's own would be.
    let mut map = still(400, 0);
    map.mean.iter_mut().for_each(|m| *m = [m[0] + 431_250.0, m[1] + 411_800.0, m[2] + 312.0]);
    let written = formats::spz::write(&map, SpzVersion::V3);
    assert_eq!(written.notes.len(), 1, "{:?}", written.notes);
    assert!(written.notes[0].starts_with("coordinates are relative to (431250, 411800, 312)"), "{:?}", written.notes);
    let found = read(&written.bytes).expect("just written");
    let place = |i: usize, k: usize| f64::from(found.mean[i][k]) + found.about.offset[k];
    assert!((0..400).all(|i| (0..3).all(|k| (place(i, k) - f64::from(map.mean[i][k])).abs() <= 0.501 / 4096.0)));
}
