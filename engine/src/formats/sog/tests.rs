//! SOG files are read; other files are errors with a name.

use std::io::Write;

use serde_json::{Value, json};
use zip::write::SimpleFileOptions;

use super::*;
use crate::formats;

fn still(count: usize, degree: usize) -> Still {
    let value = |i: usize, k: usize| ((i * 7919 + k * 104_729) % 1009) as f32 / 504.0 - 1.0;
    let triple = |i: usize, k: usize| std::array::from_fn(|axis| value(i, k + axis));
    Still {
        mean: (0..count).map(|i| triple(i, 0).map(|x: f32| 3.0 * x)).collect(),
        log_scale: (0..count).map(|i| triple(i, 3).map(|x: f32| 3.0 * x - 4.0)).collect(),
        rotation: (0..count).map(|i| std::array::from_fn(|k| value(i, 6 + k))).collect(),
        logit: (0..count).map(|i| 3.0 * value(i, 10)).collect(),
        base: (0..count).map(|i| triple(i, 11)).collect(),
        degree,
        higher: (0..count * 3 * rest(degree)).map(|i| value(i, 14)).collect(),
        ..Still::default()
    }
}

#[test]
fn a_scene_comes_back_within_its_precision() {
    for degree in 0..=3 {
        let still = still(300, degree);
        let file = formats::sog::write(&still).bytes;
        assert!(file == formats::sog::write(&still).bytes);
        let found = read(&file).expect("just written");
        assert_eq!((found.len(), found.degree, found.uneven()), (300, degree, None));
        let width = 3 * rest(degree);
        for i in 0..found.len() {
            let distance = |j: usize| (0..3).map(|k| (found.mean[i][k] - still.mean[j][k]).abs()).fold(0.0, f32::max);
            let j = (0..still.len()).min_by(|a, b| distance(*a).total_cmp(&distance(*b))).expect("one");
            assert!(distance(j) < 1e-4);
            let close = |a: &[f32], b: &[f32], step: f32| a.iter().zip(b).all(|(a, b)| (a - b).abs() <= step);
            assert!(
                close(&found.log_scale[i], &still.log_scale[j], 0.02),
                "{:?} {:?}",
                found.log_scale[i],
                still.log_scale[j]
            );
            assert!(close(&found.base[i], &still.base[j], 0.01));
            let opacity = |x: f32| 1.0 / (1.0 + (-x).exp());
            assert!((opacity(found.logit[i]) - opacity(still.logit[j])).abs() < 0.5 / 255.0 + 1e-6);
            // Few enough Gaussians that each has its own row.
            assert!(close(&found.higher[i * width..][..width], &still.higher[j * width..][..width], 0.01));
            let q = still.rotation[j].map(f64::from);
            let length = q.iter().map(|c| c * c).sum::<f64>().sqrt();
            let cosine: f64 = q.iter().zip(found.rotation[i]).map(|(a, b)| a / length * f64::from(b)).sum();
            assert!(cosine.abs() > 0.9999, "{cosine}");
        }
    }
    let none = read(&formats::sog::write(&Still { degree: 2, ..Still::default() }).bytes).expect("an empty scene");
    assert!(none.is_empty());
}

/// Unpacks the files of a `.sog` file.
fn files(file: &[u8]) -> Vec<(String, Vec<u8>)> {
    let mut archive = zip::ZipArchive::new(Cursor::new(file)).expect("a zip file");
    (0..archive.len())
        .map(|i| {
            let mut entry = archive.by_index(i).expect("an entry");
            let mut bytes = Vec::new();
            std::io::Read::read_to_end(&mut entry, &mut bytes).expect("readable");
            (entry.name().expect("UTF-8").into_owned(), bytes)
        })
        .collect()
}

fn together(files: &[(String, Vec<u8>)]) -> Vec<u8> {
    let mut archive = zip::ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in files {
        archive.start_file(name.as_str(), SimpleFileOptions::DEFAULT).expect("memory");
        archive.write_all(bytes).expect("memory");
    }
    archive.finish().expect("memory").into_inner()
}

#[test]
fn images_may_lie_beside_their_meta_json() {
    let file = formats::sog::write(&still(50, 1)).bytes;
    let folder = tempfile::tempdir().expect("a temporary folder");
    for (name, bytes) in files(&file) {
        std::fs::write(folder.path().join(name), bytes).expect("writable");
    }
    let path = folder.path().join("meta.json");
    let Ok(crate::open::Opened::Still(found)) = crate::open::scene(&path, &Limits::default()) else {
        panic!("expected a still scene");
    };
    assert_eq!(Ok(&found.still), read(&file).as_ref());
    let length: usize = files(&file).iter().map(|(_, bytes)| bytes.len()).sum();
    assert_eq!((found.format, found.bytes), ("SOG", length as u64));
    std::fs::remove_file(folder.path().join("quats.webp")).expect("there");
    let error = crate::open::scene(&path, &Limits::default()).expect_err("an image is missing").to_string();
    assert!(error.contains("file \"quats.webp\": expected a file beside this one"), "{error}");
}

#[test]
fn what_is_wrong_is_named() {
    let good = files(&formats::sog::write(&still(300, 1)).bytes);
    let changed = |place: &str, value: Value| {
        let mut files = good.clone();
        let meta = files.iter_mut().find(|(name, _)| name == "meta.json").expect("there");
        let mut text: Value = serde_json::from_slice(&meta.1).expect("JSON");
        *text.pointer_mut(place).expect(place) = value;
        meta.1 = text.to_string().into_bytes();
        together(&files)
    };
    for (place, value, expected) in [
        ("/version", json!(1), "meta.json: version: expected 2, or none beside means.shape, found 1"),
        ("/count", json!(1_u64 << 40), "meta.json: count: expected at most 16777216 Gaussians"),
        ("/count", json!(100_000), "means_l.webp: expected an image of 100000 to 200000 pixels, found 20×"),
        ("/count", json!(-1), "meta.json: expected a SOG scene's"),
        (
            "/scales/codebook",
            json!([1, 2]),
            "meta.json: expected a SOG scene's, found codebook: expected 256 values, found 2",
        ),
        ("/means/files/0", json!("../a"), "../a: expected a file in the zip file"),
        ("/quats/files/0", json!("sh0.webp"), "quats: alpha of "),
        ("/shN/count", json!(0), "meta.json: shN.count: expected 1 to 65536"),
        ("/shN/count", json!(2), "shN_labels.webp: label "),
        ("/shN/bands", json!(4), "meta.json: shN.bands: expected 1 to 3, found 4"),
        ("/shN/bands", json!(3), "shN_centroids.webp: expected 960×5 pixels at least, found 192×5"),
    ] {
        let error = read(&changed(place, value)).expect_err(place).to_string();
        assert!(error.starts_with(expected), "{place}: {error}");
    }
    let without = |gone: &str| together(&good.iter().filter(|(name, _)| name != gone).cloned().collect::<Vec<_>>());
    assert!(
        read(&without("meta.json"))
            .expect_err("no meta.json")
            .to_string()
            .starts_with("meta.json: expected a file in the zip file")
    );
    assert!(read(&without("scales.webp")).is_err());
    let file = together(&good);
    for end in (0..file.len()).step_by(37) {
        assert!(read(&file[..end]).is_err(), "{end}");
    }
}

#[test]
fn an_image_that_swells_is_refused() {
    let mut bomb = files(&formats::sog::write(&still(10, 0)).bytes);
    bomb.iter_mut().find(|(name, _)| name == "sh0.webp").expect("there").1 = vec![0; 64 << 20];
    let file = together(&bomb);
    assert!(file.len() < 1 << 20, "deflated");
    let error = read(&file).expect_err("a bomb").to_string();
    assert_eq!(error, "sh0.webp: expected a file in the zip file, found one of more than 524288 bytes");
}

#[test]
fn the_mark_of_antialiased_training_and_the_offset_come_back() {
    let mut marked = still(20, 1);
    marked.about.antialiased = true;
    marked.about.offset = [431_250.0, 5_411_800.0, 312.0];
    let file = formats::sog::write(&marked).bytes;
    assert_eq!(read(&file).expect("just written").about, marked.about);
    let mut own = files(&file);
    let meta = own.iter_mut().find(|(name, _)| name == "meta.json").expect("there");
    let mut text: Value = serde_json::from_slice(&meta.1).expect("JSON");
    assert_eq!(text["model"], "antialiased");
    text["model"] = json!("hexagons");
    meta.1 = text.to_string().into_bytes();
    let about = read(&together(&own)).expect("an unknown model").about;
    assert!(!about.antialiased && about.notes[0].contains("\"hexagons\" is not known"), "{about:?}");
}

#[test]
fn version_1_has_least_and_greatest_values() {
    let mut own = files(&formats::sog::write(&still(70, 1)).bytes);
    let meta = own.iter_mut().find(|(name, _)| name == "meta.json").expect("there");
    let text: Value = serde_json::from_slice(&meta.1).expect("JSON");
    let first = json!({
        "means": { "shape": [70, 3], "dtype": "float32", "mins": text["means"]["mins"], "maxs": text["means"]["maxs"], "files": text["means"]["files"] },
        "scales": { "mins": [-8.0, -7.0, -6.0], "maxs": [0.0, 1.0, 2.0], "files": ["scales.webp"] },
        "quats": { "files": ["quats.webp"], "encoding": "quaternion_packed" },
        "sh0": { "mins": [-2.0, -2.0, -2.0, -5.0], "maxs": [2.0, 2.0, 2.0, 5.0], "files": ["sh0.webp"] },
        "shN": { "mins": -1.0, "maxs": 1.0, "files": ["shN_centroids.webp", "shN_labels.webp"] },
    });
    meta.1 = first.to_string().into_bytes();
    let found = read(&together(&own)).expect("version 1");
    let second = read(&formats::sog::write(&still(70, 1)).bytes).expect("version 2");
    assert_eq!((found.len(), found.degree, &found.mean), (70, 1, &second.mean));
    let scales: Vec<f32> = (0..=255).map(|b| (-7.0 + 8.0 * (f64::from(b) / 255.0)) as f32).collect();
    assert!(found.log_scale.iter().all(|s| scales.contains(&s[1]) && (-8.0..=0.0).contains(&s[0])));
    assert!(found.logit.iter().all(|x| (-5.0..=5.0).contains(x)) && found.logit != second.logit);
    assert!(found.higher.iter().all(|c| c.abs() <= 1.0));
}
