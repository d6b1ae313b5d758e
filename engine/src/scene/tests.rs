//! Scenes are written to disk and read again.

use std::path::Path;

use super::*;
use crate::stream::{Handover, Interval, Merge, Record, Reference};

fn interval(index: u64, start: f64, end: f64, count: u64) -> Interval {
    let record = |i: u64| Record {
        mean: [i as f32 * 0.1, 0.5, -0.25],
        velocity: [0.01, -0.02, i as f32],
        gamma: [i as f32, 0.5],
        opacity: 0.7,
        scale: [0.01, 0.02],
        rgb: [0.1, 0.2, i as f32 * 0.05],
        identity: u64::MAX - i,
        birth: i,
        frame: index,
        offset: [1e-9, 0.0, -1.0],
        reference: if i.is_multiple_of(2) { Reference::Start } else { Reference::End },
        handover: [Handover::None, Handover::Arrives, Handover::Leaves][i as usize % 3],
        ..Record::default()
    };
    Interval {
        index,
        start,
        end,
        gaussians: (0..count).map(record).collect(),
        placement: Placement { source: [90, 160], model: [64, 96], offset: [5, 0], content: [54, 96] },
        merges: vec![Merge { identity: 3, into: 4 }],
        dropped: 2,
    }
}

fn written(folder: &Path) -> Vec<Interval> {
    let intervals = vec![interval(0, 0.0, 0.0, 5), interval(1, 0.0, 0.1, 7), interval(2, 0.1, 1.0 / 3.0, 0)];
    let mut writer = SceneWriter::create(folder, 24.0).expect("writable");
    for interval in &intervals {
        writer.push(interval).expect("writable");
    }
    assert!(writer.finish().expect("writable").is_some());
    intervals
}

#[test]
fn intervals_come_back_bit_for_bit() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let intervals = written(folder.path());
    let scene = Scene::open(folder.path()).expect("just written");
    assert_eq!(scene.span(), (0.0, 1.0 / 3.0));
    assert_eq!(scene.placement(), intervals[0].placement);
    for (i, expected) in intervals.iter().enumerate() {
        let found = scene.interval(i).expect("just written");
        assert_eq!(found.gaussians, expected.gaussians);
        assert_eq!((found.index, found.start, found.end), (expected.index, expected.start, expected.end));
        assert_eq!((&found.merges, found.dropped), (&expected.merges, expected.dropped));
    }
}

#[test]
fn times_find_their_interval() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    written(folder.path());
    let scene = Scene::open(&folder.path().join(INDEX)).expect("just written");
    for (time, expected) in [(0.0, 1), (0.05, 1), (0.1, 1), (0.2, 2), (1.0 / 3.0, 2)] {
        assert_eq!(scene.find(time).expect("inside"), expected, "{time}");
    }
    for time in [-0.1, 0.4, f64::NAN] {
        assert!(matches!(scene.find(time), Err(SceneError::Time { .. })), "{time}");
    }
}

#[test]
fn a_flipped_byte_a_short_file_and_a_missing_one_are_named() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    written(folder.path());
    let scene = Scene::open(folder.path()).expect("just written");
    let file = folder.path().join("interval-000001.safetensors");
    let bytes = std::fs::read(&file).expect("readable");
    let mut flipped = bytes.clone();
    flipped[bytes.len() / 2] ^= 1;
    for (content, expected) in [(&flipped[..], "digest"), (&bytes[..50], "bytes")] {
        std::fs::write(&file, content).expect("writable");
        let error = scene.interval(1).expect_err("broken").to_string();
        assert!(error.contains("interval-000001.safetensors") && error.contains(expected), "{error}");
    }
    std::fs::remove_file(&file).expect("there");
    assert!(matches!(scene.interval(1), Err(SceneError::Read { .. })));
}

#[test]
fn broken_tensors_and_indices_are_errors() {
    let placement = interval(0, 0.0, 0.0, 0).placement;
    let bytes = to_safetensors(&interval(1, 0.0, 1.0, 4)).expect("even arrays");
    assert!(from_safetensors(&bytes, placement).is_ok());
    for end in [0, 7, 8, 100, bytes.len() - 1] {
        assert!(from_safetensors(&bytes[..end], placement).is_err(), "{end}");
    }
    let backwards = to_safetensors(&interval(1, 2.0, 1.0, 1)).expect("even arrays");
    assert!(from_safetensors(&backwards, placement).is_err_and(|e| e.contains("time")));

    let folder = tempfile::tempdir().expect("a temporary folder");
    written(folder.path());
    let path = folder.path().join(INDEX);
    let good = std::fs::read_to_string(&path).expect("readable");
    for (from, to) in [
        ("streamsplat-scene", "other"),
        ("\"version\": 1", "\"version\": 9"),
        ("interval-000001", "../interval-000001"),
        // One file for two intervals.
        ("interval-000001", "interval-000000"),
        ("\"fps\": ", "\"fps\": -"),
        ("\"fps\": ", "\"fps\": 0e"),
        ("\"gaussians\": 7", "\"gaussians\": 70000000000000"),
        ("\"start\": 0.1", "\"start\": -5.0"),
        ("54,", "99999,"),
        ("{", "["),
    ] {
        assert!(good.contains(from), "{from}");
        std::fs::write(&path, good.replacen(from, to, 1)).expect("writable");
        assert!(Scene::open(folder.path()).is_err(), "{from} → {to}");
    }
    assert!(Scene::open(Path::new("no/such/scene")).is_err());
}

#[test]
fn a_change_of_colour_comes_back_bit_for_bit_and_is_not_there_where_there_is_none() {
    let mut changing = interval(1, 0.0, 1.0, 7);
    let placement = changing.placement;
    let plain = to_safetensors(&changing).expect("even arrays");
    assert!(!plain.windows(8).any(|w| w == b"rgb_rate"));
    let found = from_safetensors(&plain, placement).expect("just written");
    assert_eq!(found.gaussians.rgb_rate, vec![[0.0; 3]; 7]);
    changing.gaussians.rgb_rate[3] = [0.1, -0.0, f32::from_bits(1)];
    changing.gaussians.rgb_rate[6] = [-1.0 / 3.0, 2.5, 1e-9];
    let bytes = to_safetensors(&changing).expect("even arrays");
    let found = from_safetensors(&bytes, placement).expect("just written");
    let bits =
        |g: &crate::stream::DynamicGaussians| g.rgb_rate.as_flattened().iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(&found.gaussians), bits(&changing.gaussians));
    assert_eq!(found.gaussians, changing.gaussians);
}

#[test]
fn thickness_comes_back_bit_for_bit_and_is_not_there_where_all_are_1() {
    let mut lifted = interval(1, 0.0, 1.0, 7);
    let placement = lifted.placement;
    let plain = to_safetensors(&lifted).expect("even arrays");
    assert!(!plain.windows(9).any(|w| w == b"thickness"));
    assert_eq!(from_safetensors(&plain, placement).expect("just written").gaussians.thickness, vec![1.0; 7]);
    (lifted.gaussians.thickness[3], lifted.gaussians.thickness[6]) = (0.1, 0.0);
    let found = from_safetensors(&to_safetensors(&lifted).expect("even arrays"), placement).expect("just written");
    assert_eq!(found.gaussians, lifted.gaussians);
    lifted.gaussians.thickness[2] = f32::INFINITY;
    assert!(
        to_safetensors(&lifted).is_err_and(|e| e.contains("tensor thickness: expected finite numbers, found inf at 2"))
    );
    lifted.gaussians.thickness.pop();
    assert!(to_safetensors(&lifted).is_err_and(|e| e.contains("thickness: expected 7 records, found 6")));
}

#[test]
fn rates_and_thicknesses_of_another_kind_shape_or_without_a_value_are_refused() {
    use records::serialize;
    use safetensors::tensor::Dtype;
    use streamsplat_model::columns::Numbers;

    let mut whole = interval(1, 0.0, 1.0, 4);
    let read = |(name, dtype, shape, bytes): (&'static str, Dtype, Vec<usize>, Vec<u8>)| {
        let mut tensors = records::write(&interval(1, 0.0, 1.0, 4).gaussians).expect("even arrays");
        tensors.push((name.into(), dtype, shape, bytes));
        let bytes = serialize(&tensors, None).expect("sound shapes");
        records::read(&safetensors::SafeTensors::deserialize(&bytes).expect("just written"))
    };
    let floats = |name, shape, values: &[f32]| (name, Dtype::F32, shape, Numbers::Floats(values).to_bytes());
    let rates = |shape: Vec<usize>, values: &[f32]| floats("rgb_rate", shape, values);
    let thickness = |shape: Vec<usize>, values: &[f32]| floats("thickness", shape, values);
    assert!(read(thickness(vec![4], &[0.5; 4])).is_ok());
    for (wrong, expected) in [
        (thickness(vec![3], &[0.5; 3]), "expected F32 [4], found F32 [3]"),
        (thickness(vec![4, 1], &[0.5; 4]), "expected F32 [4], found F32 [4, 1]"),
        (thickness(vec![4], &[0.5, 0.5, 0.5, f32::NAN]), "expected finite numbers, found NaN at 3"),
    ] {
        let error = read(wrong).expect_err(expected);
        assert!(error.contains("tensor thickness") && error.contains(expected), "{error}");
    }
    assert!(read(rates(vec![4, 3], &[0.5; 12])).is_ok());
    for (wrong, expected) in [
        (rates(vec![3, 3], &[0.5; 9]), "expected F32 [4, 3], found F32 [3, 3]"),
        (rates(vec![5, 3], &[0.5; 15]), "expected F32 [4, 3]"),
        (rates(vec![12], &[0.5; 12]), "expected F32 [4, 3]"),
        (("rgb_rate", Dtype::F64, vec![4, 3], vec![0; 96]), "found F64"),
        (rates(vec![4, 3], &[&[0.0; 11][..], &[f32::NAN]].concat()), "expected finite numbers, found NaN at 11"),
        (rates(vec![4, 3], &[f32::INFINITY; 12]), "expected finite numbers, found inf at 0"),
    ] {
        let error = read(wrong).expect_err(expected);
        assert!(error.contains("tensor rgb_rate") && error.contains(expected), "{error}");
    }
    whole.gaussians.rgb_rate[2][1] = f32::NAN;
    assert!(to_safetensors(&whole).is_err_and(|e| e.contains("rgb_rate")));
    whole.gaussians.rgb_rate.pop();
    assert!(to_safetensors(&whole).is_err_and(|e| e.contains("rgb_rate: expected 4 records, found 3")));
}
