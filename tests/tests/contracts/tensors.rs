//! The binaries `forward` and `splat`, with which other implementations are compared.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use safetensors::{Dtype, SafeTensors};
use streamsplat_fixtures as fixtures;
use streamsplat_tests::splats::Splats;

const FORWARD: &str = env!("CARGO_BIN_EXE_forward");
const SPLAT: &str = env!("CARGO_BIN_EXE_splat");

fn model() -> PathBuf {
    fixtures::path("parity/tiny-nodino.safetensors")
}

fn run(program: &str, files: &[&Path]) -> Output {
    Command::new(program).args(files).output().expect("the program starts")
}

fn done(output: &Output) {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// The error of a run that must fail.
fn failed(output: &Output) -> String {
    assert_eq!(output.status.code(), Some(1));
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn a_model_on_tensors_has_every_tensor_of_the_reference() {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("o.safetensors");
    let input = fixtures::path("parity/tiny-nodino.io.safetensors");
    done(&run(FORWARD, &[&model(), &input, &out]));
    let (expected, found) = (std::fs::read(input).expect("readable"), std::fs::read(out).expect("readable"));
    let expected = SafeTensors::deserialize(&expected).expect("valid");
    let found = SafeTensors::deserialize(&found).expect("valid");
    let mut compared = 0;
    for (name, tensor) in expected.tensors().iter().filter(|(name, _)| name.starts_with("out.")) {
        let ours = found.tensor(name).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert_eq!(ours.shape(), tensor.shape(), "{name}");
        let floats = |bytes: &[u8]| -> Vec<f64> {
            bytes.as_chunks::<4>().0.iter().map(|b| f64::from(f32::from_le_bytes(*b))).collect()
        };
        let (a, b) = (floats(ours.data()), floats(tensor.data()));
        let error: f64 = a.iter().zip(&b).map(|(a, b)| (a - b) * (a - b)).sum();
        let norm: f64 = b.iter().map(|b| b * b).sum();
        assert!((error / norm).sqrt() < 3e-6, "{name}: {}", (error / norm).sqrt());
        compared += 1;
    }
    assert_eq!(compared, 11);
}

#[test]
fn splat_draws_the_oracles_scene() {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("o.safetensors");
    let scene = fixtures::path("oracle/rotated-orthographic.safetensors");
    done(&run(SPLAT, &[&scene, &out]));
    let (expected, found) = (std::fs::read(scene).expect("readable"), std::fs::read(out).expect("readable"));
    let expected = SafeTensors::deserialize(&expected).expect("valid");
    let found = SafeTensors::deserialize(&found).expect("valid");
    let truth = expected.tensor("out.rgb").expect("the oracle's image");
    let ours = found.tensor("rgb").expect("an image");
    assert_eq!(ours.shape(), truth.shape());
    let truth: Vec<f64> = match truth.dtype() {
        Dtype::F64 => truth.data().as_chunks::<8>().0.iter().map(|b| f64::from_le_bytes(*b)).collect(),
        _ => truth.data().as_chunks::<4>().0.iter().map(|b| f64::from(f32::from_le_bytes(*b))).collect(),
    };
    for (found, expected) in ours.data().as_chunks::<4>().0.iter().zip(truth) {
        assert!((f64::from(f32::from_le_bytes(*found)) - expected).abs() <= 2e-5);
    }
    assert_eq!(found.tensor("blended").expect("a count").dtype(), Dtype::I32);
}

#[test]
fn tensors_that_do_not_fit_are_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("o.safetensors");
    let text = failed(&run(FORWARD, &[&model(), &fixtures::path("parity/tiny-dino.io.safetensors"), &out]));
    assert!(text.contains("in.frames"), "{text}");
    let text = failed(&run(SPLAT, &[&model(), &out]));
    assert!(text.contains("tensor mean is missing"), "{text}");
    assert!(!out.exists());
}

#[test]
fn splats_of_an_enormous_image_are_refused() {
    let shapes = [("mean", "[0,3]"), ("scale", "[0,3]"), ("rgb", "[0,3]"), ("opacity", "[0]")];
    let mut entries: Vec<String> = shapes
        .map(|(name, shape)| format!(r#""{name}":{{"dtype":"F32","shape":{shape},"data_offsets":[0,0]}}"#))
        .into();
    let mut data = Vec::new();
    for (name, values) in [("size", &[65536_f32, 65536.0][..]), ("focal", &[1.0, 1.0]), ("background", &[0.0; 3])] {
        let start = data.len();
        data.extend(values.iter().flat_map(|v| v.to_le_bytes()));
        let (count, end) = (values.len(), data.len());
        entries.push(format!(r#""{name}":{{"dtype":"F32","shape":[{count}],"data_offsets":[{start},{end}]}}"#));
    }
    let header = format!("{{{}}}", entries.join(","));
    let bytes = [&(header.len() as u64).to_le_bytes()[..], header.as_bytes(), &data].concat();
    let error = Splats::from_safetensors(&bytes).expect_err("too large");
    assert!(error.contains("found 65536×65536"), "{error}");
}
