//! Scenes are written to a container and read again.

use std::path::Path;

use proptest::prelude::*;
use streamsplat_kernels::Level;

use super::chunk::{decode, encode};
use super::quantise::Quantised;
use super::table::{LIMIT, LINKS, MERGES, VALUES};
use super::*;
use crate::fit::Placement;
use crate::scene::{Scene, SceneError};
use crate::stream::{Handover, Interval, Merge, Record, Reference, Workers};

const PLACEMENT: Placement = Placement { source: [90, 160], model: [64, 96], offset: [5, 0], content: [54, 96] };

fn workers(threads: usize) -> Workers {
    Workers::new(Level::scalar(), threads).expect("threads start")
}

/// A scene whose records are carried, following and fresh, as an engine's are.
fn intervals(count: u64) -> Vec<Interval> {
    let noise = |seed: u64| (seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40) as f32 / (1 << 24) as f32;
    let record = |frame: u64, cell: u64| {
        let seed = frame * 1000 + cell;
        Record {
            mean: [cell as f32 * 0.02 - 0.8, noise(seed), noise(seed + 1) - 0.5],
            velocity: [0.01 * noise(seed + 2), 0.0, -0.02],
            gamma: [5.0 * noise(seed + 3), noise(seed + 4)],
            opacity: noise(seed + 5),
            scale: [0.01 + 0.1 * noise(seed + 6), 0.02],
            // Every second key frame is not lifted.
            thickness: if frame.is_multiple_of(2) { 1.0 } else { 0.5 + noise(seed + 11) },
            rgb: [noise(seed + 7), noise(seed + 8), 0.3],
            // Every third key frame's colours stay.
            rgb_rate: [noise(seed + 10) - 0.5, 0.1, -0.3].map(|c| c * (frame % 3) as f32),
            identity: if cell.is_multiple_of(3) { frame * 100 + cell } else { cell },
            birth: if cell.is_multiple_of(3) { frame } else { 0 },
            frame,
            offset: [0.001 * noise(seed + 9), 0.0, 0.0],
            reference: Reference::End,
            handover: Handover::Arrives,
        }
    };
    let interval = |k: u64| {
        let old = (0..40 * u64::from(k > 0)).map(|cell| Record {
            velocity: [0.02, 0.01, 0.0],
            reference: Reference::Start,
            handover: Handover::Leaves,
            ..record(k.saturating_sub(1), cell)
        });
        let new = (0..40).map(|cell| record(k, cell));
        Interval {
            index: k,
            start: k.saturating_sub(1) as f64 / 7.0,
            end: k as f64 / 7.0,
            gaussians: old.chain(new).collect(),
            placement: PLACEMENT,
            merges: (0..k % 3).map(|m| Merge { identity: 100 * k + m, into: m }).collect(),
            dropped: k,
        }
    };
    (0..count).map(interval).collect()
}

fn written(path: &Path, intervals: &[Interval]) -> Vec<u8> {
    written_by(&workers(1), path, intervals)
}

fn written_by(workers: &Workers, path: &Path, intervals: &[Interval]) -> Vec<u8> {
    let mut writer = ContainerWriter::create(path, 24.0).expect("writable");
    for interval in intervals {
        writer.push(interval, workers).expect("writable");
    }
    let written = writer.finish().expect("writable").expect("intervals");
    let bytes = std::fs::read(path).expect("readable");
    assert_eq!(written, crate::output::Written::of(&bytes));
    bytes
}

fn close(a: &[f32], b: &[f32], most: f32) -> bool {
    a.iter().zip(b).all(|(a, b)| (a - b).abs() <= most)
}

#[test]
fn intervals_come_back_in_any_order_as_closely_as_is_said() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("scene.ssz");
    let intervals = intervals(19);
    written(&path, &intervals);
    let scene = Scene::open(&path).expect("just written");
    assert_eq!((scene.placement(), scene.span()), (PLACEMENT, (0.0, 18.0 / 7.0)));
    assert_eq!(scene.index().fps, 24.0);
    let mut kept = Vec::new();
    for i in [0, 1, 2, 18, 17, 5, 9, 8, 7, 16, 0, 10, 11] {
        let (found, expected) = (scene.interval(i).expect("just written"), &intervals[i]);
        assert_eq!((found.index, found.start, found.end), (expected.index, expected.start, expected.end));
        assert_eq!((&found.merges, found.dropped), (&expected.merges, expected.dropped));
        assert_eq!(found.gaussians.len(), expected.gaussians.len());
        for (a, b) in found.gaussians.iter().zip(expected.gaussians.iter()) {
            assert_eq!((a.identity, a.birth, a.frame), (b.identity, b.birth, b.frame));
            assert_eq!((a.reference, a.handover), (b.reference, b.handover));
            let across = |r: &Record| [r.mean[0], r.mean[2]];
            assert!(close(&across(&a), &across(&b), 0.501 / 2048.0));
            assert!(close(&a.mean[1..2], &b.mean[1..2], 0.501 / 16384.0));
            let across = |r: &Record| [r.offset[0], r.offset[2]];
            assert!(close(&a.velocity, &b.velocity, 0.501 / 1024.0) && close(&across(&a), &across(&b), 0.501 / 1024.0));
            assert!(close(&a.offset[1..2], &b.offset[1..2], 0.501 / 128.0));
            assert!(close(&a.rgb, &b.rgb, 0.501 / 128.0) && close(&a.rgb_rate, &b.rgb_rate, 0.651 / 16.0));
            let octaves = |r: &Record| [r.scale[0], r.scale[1], r.thickness].map(f32::log2);
            assert!(close(&octaves(&a), &octaves(&b), 0.501 / 8.0));
            assert!(close(&[a.opacity.log2()], &[b.opacity.log2()], 0.501 / 16.0));
            assert!(((1.0 + a.gamma[0]).log2() - (1.0 + b.gamma[0]).log2()).abs() < 0.501 / 32.0);
            assert!((a.gamma[1] - b.gamma[1]).abs() < 0.501 / 256.0);
        }
        kept.push((i, found.gaussians));
    }
    for (i, gaussians) in kept {
        let fresh = Scene::open(&path).expect("just written").interval(i).expect("just written");
        assert!(fresh.gaussians == gaussians, "{i}: whatever was read before");
    }
}

#[test]
fn another_version_is_refused() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("scene.ssz");
    let bytes = written(&path, &intervals(2));
    for version in [0, 2, 3, 255] {
        let mut other = bytes.clone();
        other[8] = version;
        std::fs::write(&path, &other).expect("writable");
        let expected = format!("header: expected version 1, found version {version}");
        let found = Scene::open(&path).expect_err("another version").to_string();
        assert!(found.ends_with(&expected), "{found}");
        assert_eq!(intervals_from_container(&other).expect_err("another version").to_string(), expected);
    }
}

/// The columns of a chunk as they are stored.
fn columns_of(chunk: &[u8]) -> Vec<Vec<u8>> {
    let (mut rest, mut all) = (chunk, Vec::new());
    while !rest.is_empty() {
        let stored = u32::from_le_bytes(rest[4..8].try_into().expect("four bytes")) as usize;
        let (column, after) = rest.split_at(8 + stored);
        all.push(column.to_vec());
        rest = after;
    }
    all
}

#[test]
fn columns_of_rates_and_thickness_of_another_length_are_refused() {
    let interval = &intervals(2)[1];
    let records: Vec<Quantised> = interval.gaussians.iter().map(|r| Quantised::of(&r)).collect();
    let still: Vec<Quantised> =
        records.iter().map(|r| Quantised::of(&Record { rgb_rate: [0.0; 3], thickness: 1.0, ..r.record() })).collect();
    let (bytes, plain) = (encode(&[], &records, &interval.merges), encode(&[], &still, &interval.merges));
    let (full, empty) = (columns_of(&bytes), columns_of(&plain));
    let (many, merges) = (records.len(), interval.merges.len());
    assert_eq!(
        (full.len(), empty[24].len(), decode(&[], &plain, many, merges).map(|(found, _)| found)),
        (31, 8, Ok(still))
    );
    for (k, _) in VALUES.iter().enumerate().filter(|(_, value)| value.rare) {
        // Fewer numbers than records, more, and ones beyond the limit.
        let mut column = super::columns::Column::default();
        (1..many).for_each(|_| column.push_signed(1));
        let fewer = column.stored();
        (0..2).for_each(|_| column.push_signed(1));
        let more = column.stored();
        let mut vast = super::columns::Column::default();
        (0..many).for_each(|_| vast.push_signed(1 << 47));
        for wrong in [fewer, more, vast.stored()] {
            let mut hostile = full.clone();
            hostile[LINKS.len() + k] = wrong;
            let error = decode(&[], &hostile.concat(), many, merges).expect_err("hostile").to_string();
            assert!(error.contains("_rate: expected") || error.contains("thickness"), "{error}");
        }
    }
}

#[test]
fn the_player_reads_the_same_columns() {
    let player = include_str!("../../../player/src/chunk.js").replace("\" +\n  \"", "");
    let names: Vec<_> = LINKS.into_iter().chain(VALUES.iter().map(|value| value.name)).chain(MERGES).collect();
    assert!(player.contains(&format!("\"{}\"", names.join(" "))), "{names:?}");
}

#[test]
fn the_bytes_do_not_depend_on_threads_and_a_second_passage_changes_nothing() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let [a, b, c] = ["a", "b", "c"].map(|name| folder.path().join(name));
    let bytes = written(&a, &intervals(11));
    assert!(written_by(&workers(3), &b, &intervals(11)) == bytes);
    let scene = Scene::open(&a).expect("just written");
    let again: Vec<Interval> = (0..11).map(|i| scene.interval(i).expect("just written")).collect();
    let same = Scene::open(&{
        written(&c, &again);
        c
    })
    .expect("just written");
    for (i, interval) in again.iter().enumerate() {
        assert!(same.interval(i).expect("just written").gaussians == interval.gaussians, "{i}");
    }
}

#[test]
fn extreme_records_stay_sound_and_unsound_ones_are_counted() {
    let extreme = |x: f32| Record {
        mean: [x, -x, 0.0],
        velocity: [x; 3],
        gamma: [x.abs(), 1.0],
        opacity: x.abs().min(1.0),
        scale: [x.abs(), 0.0],
        thickness: x.abs(),
        rgb: [x, -x, x],
        rgb_rate: [-0.5 * x, x, 0.0],
        offset: [-x; 3],
        identity: u64::MAX,
        birth: u64::MAX,
        ..Record::default()
    };
    let values = [0.0, 1e-45, 1e-30, 1.0, 1e9, 1e30, f32::MAX, -f32::MAX, f32::NAN, f32::INFINITY];
    let mut interval = intervals(1).remove(0);
    interval.gaussians = values.into_iter().map(extreme).collect();
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("x.ssz");
    written(&path, &[interval.clone(), Interval { start: 0.0, end: 1.0, ..interval }]);
    let scene = Scene::open(&path).expect("just written");
    for i in 0..2 {
        let found = scene.interval(i).expect("just written");
        assert_eq!((found.gaussians.len(), found.dropped), (8, 2));
        assert!(found.gaussians.iter().all(|r| r.is_sound()), "{:?}", found.gaussians);
        assert_eq!(found.gaussians.scale[0], [0.0; 2]);
        assert_eq!(found.gaussians.scale[3][0], 1.0);
        assert_eq!((found.gaussians.thickness[0], found.gaussians.thickness[3]), (0.0, 1.0));
        assert_eq!(found.gaussians.gamma[0][0], 0.0);
    }
}

#[test]
fn every_truncated_file_and_every_changed_byte_is_refused() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("scene.ssz");
    let bytes = written(&path, &intervals(2));
    let broken = folder.path().join("broken.ssz");
    let whole = |content: &[u8]| -> Result<(), SceneError> {
        std::fs::write(&broken, content).expect("writable");
        let scene = Scene::open(&broken)?;
        (0..scene.index().intervals.len()).try_for_each(|i| scene.interval(i).map(drop))
    };
    assert!(whole(&bytes).is_ok());
    for end in 0..bytes.len() {
        assert!(whole(&bytes[..end]).is_err(), "{end}");
    }
    assert!(whole(&[&bytes[..], b"\0"].concat()).is_err());
    for at in 0..bytes.len() {
        let mut flipped = bytes.clone();
        flipped[at] ^= 1 << (at % 8);
        let error = whole(&flipped).expect_err("changed").to_string();
        assert!(error.contains("broken.ssz") && error.contains("expected"), "{at}: {error}");
    }
}

#[test]
fn a_hostile_index_is_refused_though_its_digest_is_right() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("scene.ssz");
    let bytes = written(&path, &intervals(2));
    let end = bytes.len() - index::TRAILER;
    let at = u64::from_le_bytes(bytes[end..end + 8].try_into().expect("eight bytes")) as usize;
    // Offsets inside the index, the bytes written there, and a part of the error message.
    let entry = 44 + 96;
    for (offset, value, expected) in [
        (0, &f64::NAN.to_le_bytes()[..], "frames per second"),
        (8, &0_u32.to_le_bytes(), "placement"),
        (40, &u32::MAX.to_le_bytes(), "44 bytes and 96"),
        (40, &1_u32.to_le_bytes(), "times of frames: expected 8 bytes for each, found 96 for 0"),
        (entry, &0_u64.to_le_bytes(), "interval 1: place"),
        (entry + 8, &u64::MAX.to_le_bytes(), "interval 1: place"),
        (entry + 16, &(-1.0_f64).to_le_bytes(), "interval 1: times"),
        (entry + 48, &u32::MAX.to_le_bytes(), "interval 1: counts"),
        (entry + 48, &79_u32.to_le_bytes(), "column kind: expected at most 79 numbers"),
        (entry + 48, &(1_u32 << 24).to_le_bytes(), "interval 1: expected at most"),
        (entry + 52, &(1_u32 << 24).to_le_bytes(), "merges in a file"),
        (entry + 56, &2_u32.to_le_bytes(), "chunks back"),
        (entry + 56, &0_u32.to_le_bytes(), "column link"),
    ] {
        let mut hostile = bytes.clone();
        hostile[at + offset..at + offset + value.len()].copy_from_slice(value);
        let digest = blake3::hash(&[&hostile[..index::HEADER], &hostile[at..end]].concat());
        hostile[end + 16..].copy_from_slice(digest.as_bytes());
        std::fs::write(&path, &hostile).expect("writable");
        let error = Scene::open(&path).and_then(|scene| scene.interval(1)).expect_err("hostile").to_string();
        assert!(error.contains(expected), "{offset}: {error}");
    }
}

#[test]
fn what_does_not_belong_in_one_container_is_refused_and_nothing_left() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("scene.ssz");
    let [first, second] = <[Interval; 2]>::try_from(intervals(2)).expect("two");
    let mut writer = ContainerWriter::create(&path, 24.0).expect("writable");
    writer.push(&second, &workers(1)).expect("writable");
    let elsewhere =
        Interval { placement: Placement { offset: [0, 0], ..PLACEMENT }, start: 5.0, end: 6.0, ..second.clone() };
    let mut uneven = Interval { start: 5.0, end: 6.0, ..second };
    uneven.gaussians.rgb.pop();
    for (wrong, expected) in [(&first, "ascending times"), (&elsewhere, "one placement"), (&uneven, "rgb: expected")] {
        let error = writer.push(wrong, &workers(1)).expect_err(expected).to_string();
        assert!(error.contains(expected), "{error}");
    }
    drop(writer);
    assert!(ContainerWriter::create(&path, 24.0).expect("writable").finish().expect("writable").is_none());
    assert_eq!(std::fs::read_dir(folder.path()).expect("readable").count(), 0);
}

#[test]
fn what_readers_would_refuse_for_its_size_is_not_written() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("scene.ssz");
    // Equal Gaussians, which take no bits each.
    let equal = |count: usize| Interval {
        gaussians: (0..count as u64).map(|identity| Record { identity, ..Record::default() }).collect(),
        ..intervals(1).remove(0)
    };
    written(&path, &[equal(150_000)]);
    let before = std::fs::read(&path).expect("just written");
    let mut writer = ContainerWriter::create(&path, 24.0).expect("writable");
    writer.push(&equal(160_000), &workers(1)).expect("taken");
    let error = writer.finish().expect_err("too many for its size").to_string();
    assert!(error.contains("readers would refuse it: interval 0: expected at most 152520 Gaussians"), "{error}");
    assert!(std::fs::read(&path).expect("as before") == before);
}

#[test]
fn links_out_of_their_range_are_refused() {
    let records = intervals(2)[1].gaussians.iter().map(|r| Quantised::of(&r)).collect::<Vec<_>>();
    let columns = columns_of(&encode(&[], &records, &[]));
    let [row, link] = ["link_row", "link"].map(|name| LINKS.iter().position(|it| *it == name).expect("a column"));
    let count = u32::from_le_bytes(columns[link][..4].try_into().expect("four bytes"));
    for (column, value) in [(row, 1 << 54), (row, -65_537), (link, 128), (link, -129), (link, 5 - (1 << 62))] {
        let mut wrong = super::columns::Column::default();
        (0..count).for_each(|_| wrong.push_signed(value));
        let mut hostile = columns.clone();
        hostile[column] = wrong.stored();
        let error = decode(&[], &hostile.concat(), records.len(), 0).expect_err("hostile").to_string();
        assert!(error.contains("at most 65536 rows either way"), "{value}: {error}");
    }
}

#[test]
fn times_of_frames_come_back() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("scene.ssz");
    let intervals = intervals(3);
    let even = written(&path, &intervals);
    assert!(!Scene::open(&path).expect("just written").index().is_uneven());
    let frames: [&[f64]; 3] = [&[0.0], &[0.1, 1.0 / 7.0], &[2.0 / 7.0]];
    let mut writer = ContainerWriter::create(&path, 9.0).expect("writable");
    for (interval, frames) in intervals.iter().zip(frames) {
        writer.push_with(interval, frames, &workers(1)).expect("writable");
    }
    let written = writer.finish().expect("writable").expect("intervals");
    let bytes = std::fs::read(&path).expect("readable");
    assert_eq!(written, crate::output::Written::of(&bytes));
    let scene = Scene::open(&path).expect("just written");
    assert_eq!(scene.index().frames(), Some(frames.concat()));
    assert!(scene.index().is_uneven());
    // Chunks are the same; there are three times of frames more, where the first follows from the rate.
    assert_eq!(bytes.len(), even.len() + 3 * 8);
    assert_eq!(intervals_from_container(&bytes).expect("valid").len(), 3);
    // The number of times must match the list, and they ascend.
    let [list, counts] = [48 + 3 * 8, 48 + 3 * 8 + 2 * 96 - 60].map(|back| bytes.len() - back);
    for (at, value) in [(counts, 1), (counts, 3), (list + 7, 0x7f), (list + 15, 0xbf)] {
        let mut wrong = bytes.clone();
        wrong[at] = value;
        let error = intervals_from_container(&wrong).expect_err("impossible").to_string();
        assert!(error.contains("index") && error.contains("times of frames"), "{error}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn any_records_come_back(
        records in proptest::collection::vec(
            (proptest::collection::vec(-(1_i64 << 40)..1 << 40, VALUES.len()), 0_u64..6, 0_u64..3, 0_u64..3, 0_u8..6), 0..60,
        ),
        split in any::<proptest::sample::Index>(),
        merges in proptest::collection::vec((any::<u64>(), any::<u64>()), 0..5),
    ) {
        let all: Vec<Quantised> = records
            .into_iter()
            .map(|(mut values, identity, birth, frame, code)| {
                for (value, row) in values.iter_mut().zip(&VALUES).filter(|(_, row)| row.range[0] > -LIMIT) {
                    *value = value.rem_euclid(row.range[1].min(4000));
                }
                Quantised {
                    values: values.try_into().expect("as many as rows"),
                    identity: identity.wrapping_sub(2),
                    birth,
                    frame,
                    reference: Reference::from_code(code & 1).expect("0 or 1"),
                    handover: Handover::from_code(code >> 1).expect("0 to 2"),
                }
            })
            .collect();
        let merges: Vec<Merge> = merges.into_iter().map(|(identity, into)| Merge { identity, into }).collect();
        let (before, records) = all.split_at(if all.is_empty() { 0 } else { split.index(all.len()) });
        let bytes = encode(before, records, &merges);
        let (found, ended) = decode(before, &bytes, records.len(), merges.len()).expect("just encoded");
        prop_assert_eq!(&found, records);
        prop_assert_eq!(ended, merges);
        prop_assert!(decode(before, &bytes, records.len() + 1, 0).is_err());
    }

    #[test]
    fn any_chunk_is_an_error_or_sound_records(
        changes in proptest::collection::vec((any::<proptest::sample::Index>(), any::<u8>()), 1..8),
    ) {
        let interval = &intervals(2)[1];
        let records: Vec<Quantised> = interval.gaussians.iter().map(|r| Quantised::of(&r)).collect();
        let mut bytes = encode(&[], &records, &interval.merges);
        for (index, byte) in changes {
            let at = index.index(bytes.len());
            bytes[at] = byte;
        }
        if let Ok((found, _)) = decode(&[], &bytes, records.len(), interval.merges.len()) {
            prop_assert!(found.iter().all(|r| r.record().is_sound()));
        }
    }
}
