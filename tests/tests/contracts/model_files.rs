//! Model files that are truncated, of another kind, corrupt or contradictory: an error with the reason, never a panic.

use std::collections::BTreeMap;
use std::path::PathBuf;

use proptest::prelude::*;
use streamsplat_model::checkpoint::Checkpoint;
use streamsplat_model::inspect::inspect;
use streamsplat_model::{Config, FrameInput, LoadOptions, ModelError, Network, Sampling};
use streamsplat_tests::forward::{forward_file, write};
use streamsplat_tests::parity;

/// A small model, tensor by tensor.
struct Model {
    tensors: BTreeMap<String, (Vec<usize>, Vec<f32>)>,
    json: serde_json::Value,
    folder: tempfile::TempDir,
}

impl Model {
    fn new() -> Model {
        let (checkpoint, _) = parity::case("tiny-nodino");
        let tensors = checkpoint.tensors().iter().map(|(name, info)| {
            (name.clone(), (info.shape.clone(), checkpoint.read(name).expect("a tensor").into_owned()))
        });
        let folder = tempfile::tempdir().expect("a folder");
        Model { tensors: tensors.collect(), json: parity::config("tiny-nodino")["config"].clone(), folder }
    }

    fn tensor(&mut self, leaf: &str) -> &mut (Vec<usize>, Vec<f32>) {
        let name = format!("model._orig_mod.{leaf}");
        self.tensors.get_mut(&name).expect("a tensor")
    }

    fn save(&self) -> PathBuf {
        let path = self.folder.path().join("m.safetensors");
        let list: Vec<_> = self.tensors.iter().map(|(n, (s, v))| (n.clone(), s.clone(), v.as_slice())).collect();
        write(&path, &list).expect("a written file");
        std::fs::write(self.folder.path().join("m.json"), self.json.to_string()).expect("a written file");
        path
    }

    fn load(&self) -> Result<Network, ModelError> {
        Network::open(self.save(), &LoadOptions::default())
    }

    /// The message of its error.
    fn refused(&self) -> String {
        let message = self.load().expect_err("an error").to_string();
        assert!(!message.contains('\n'), "{message}");
        message
    }
}

/// Asserts that all of `words` occur.
fn says(message: &str, words: &[&str]) {
    for word in words {
        assert!(message.contains(word), "{message:?} does not say {word:?}");
    }
}

#[test]
fn a_missing_tensor_is_named() {
    for leaf in [
        "gs_predictor.encoder.transformer_encoder.layernorm2.weight",
        "decoder.transformer_decoder.transformer.resblocks.0.cross_attn.out_proj.bias",
        "gaussian_upsampler.attention_1.resblocks.1.mlp.c_proj.weight",
        "gs_dynamic_predictor.dynamic_scalar",
        "gs_predictor.predictor.gs_layer.rgb.weight",
    ] {
        let mut model = Model::new();
        model.tensors.remove(&format!("model._orig_mod.{leaf}"));
        says(&model.refused(), &["m.safetensors", leaf, "missing"]);
    }
}

#[test]
fn a_tensor_of_another_shape_is_named() {
    let mut model = Model::new();
    model.tensor("encoder_proj.weight").0 = vec![32, 128];
    says(&model.refused(), &["m.safetensors", "encoder_proj.weight", "[64, 64]", "[32, 128]"]);
}

#[test]
fn weights_that_are_not_finite_are_named() {
    let mut model = Model::new();
    model.tensor("encoder_proj.weight").1[77] = f32::NAN;
    says(&model.refused(), &["m.safetensors", "encoder_proj.weight", "NaN", "77"]);
}

#[test]
fn a_configuration_that_contradicts_the_tensors_is_named() {
    let cases = [
        ("resolution", serde_json::json!([64, 80]), "60 patches"),
        ("resolution", serde_json::json!([47, 80]), "60 patches"),
        ("resolution", serde_json::json!("48x80"), "[height, width]"),
        ("resolution", serde_json::json!([1u64 << 60, 1u64 << 60]), "[height, width]"),
        ("upsampler_window", serde_json::json!(61), "divisor of 240"),
        ("upsampler_window", serde_json::json!(0), "positive"),
        ("encoder_window", serde_json::json!(7), "divisor of 60"),
        ("encoder_layers", serde_json::json!(2), "1, as the tensors"),
        ("hidden_dim", serde_json::json!(64), "128"),
        ("use_dino", serde_json::json!("yes"), "true or false"),
        ("static_position", serde_json::json!("truncated_normal"), "xyz_static"),
        ("depth", serde_json::json!("sometimes"), r#""used" or "ignored""#),
        ("depth", serde_json::json!(true), "a string"),
    ];
    for (key, value, expected) in cases {
        let mut model = Model::new();
        model.json[key] = value;
        says(&model.refused(), &["m.json", key, expected]);
    }
}

#[test]
fn a_model_without_its_configuration_says_what_was_assumed() {
    let model = Model::new();
    let path = model.save();
    std::fs::remove_file(model.folder.path().join("m.json")).expect("a removed file");
    let error = Network::open(path, &LoadOptions::default()).expect_err("an error").to_string();
    says(&error, &["resolution", "[288, 512]", "default", "JSON"]);
}

#[test]
fn a_malformed_configuration_is_an_error() {
    let model = Model::new();
    let path = model.save();
    for text in ["", "{", "[1]", "{\"resolution\": [48, 80]", "\u{0}"] {
        std::fs::write(model.folder.path().join("m.json"), text).expect("a written file");
        let error = Network::open(&path, &LoadOptions::default()).expect_err("an error").to_string();
        says(&error, &["m.json", "JSON"]);
    }
}

#[test]
fn every_prefix_and_unknown_keys_are_accepted() {
    for prefix in ["model.", "model._orig_mod.", ""] {
        let mut model = Model::new();
        let rename = |name: String| format!("{prefix}{}", &name["model._orig_mod.".len()..]);
        model.tensors = std::mem::take(&mut model.tensors).into_iter().map(|(n, t)| (rename(n), t)).collect();
        model.tensors.insert(format!("{prefix}lpips_loss.net.weight"), (vec![2], vec![f32::NAN; 2]));
        model.load().expect("a model");
        let report = inspect(model.save()).expect("a report");
        assert_eq!(report.ignored, [format!("{prefix}lpips_loss.net.weight")]);
    }
}

#[test]
fn a_dino_file_is_no_streamsplat_model() {
    let error = Network::open(parity::path("dino-tiny.safetensors"), &LoadOptions::default()).expect_err("an error");
    says(&error.to_string(), &["dino-tiny.safetensors", "DINOv2"]);
}

#[test]
fn foreign_files_and_folders_are_errors() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("m.safetensors");
    for content in [&b""[..], b"GIF89a", &[0; 4096], &[255; 4096], b"{\"a\": 1}"] {
        std::fs::write(&path, content).expect("a written file");
        let error = Network::open(&path, &LoadOptions::default()).expect_err("an error").to_string();
        says(&error, &["m.safetensors", "not a "]);
    }
    says(&Network::open(folder.path(), &LoadOptions::default()).expect_err("an error").to_string(), &["not a regular"]);
    let missing = folder.path().join("missing.safetensors");
    says(&Network::open(missing, &LoadOptions::default()).expect_err("an error").to_string(), &["missing.safetensors"]);
}

#[test]
fn frames_that_do_not_fit_are_errors() {
    let network = Model::new().load().expect("a model");
    let rgb = vec![0.5; 3 * 48 * 80];
    let embed =
        |rgb: &[f32], depth: Option<&[f32]>| network.session(None).embed(&FrameInput { rgb, depth }).map(|_| ());
    embed(&rgb, None).expect("an embedding");
    says(&embed(&rgb[1..], None).expect_err("an error").to_string(), &["frame", "[3, 48, 80]", "11519"]);
    says(&embed(&rgb, Some(&rgb)).expect_err("an error").to_string(), &["depth", "[48, 80]"]);
    let mut bad = rgb.clone();
    bad[5] = f32::INFINITY;
    says(&embed(&bad, None).expect_err("an error").to_string(), &["frame", "inf", "index 5"]);
}

#[test]
fn forward_names_the_input_that_does_not_fit() {
    let folder = tempfile::tempdir().expect("a folder");
    let input = folder.path().join("io.safetensors");
    let run = || forward_file(&parity::path("tiny-dino.safetensors"), &input, &LoadOptions::default());
    let frames = vec![0.5; 2 * 3 * 64 * 128];
    write(&input, &[("in.frames".to_owned(), vec![2, 3, 64, 128], &frames)]).expect("a written file");
    says(&run().expect_err("an error").to_string(), &["io.safetensors", "in.condition", "missing"]);
    write(&input, &[("in.frames".to_owned(), vec![2, 3, 128, 64], &frames)]).expect("a written file");
    says(&run().expect_err("an error").to_string(), &["io.safetensors", "in.frames", "[2, 3, 64, 128]"]);
}

#[test]
fn values_of_every_size_are_read_to_the_bit() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("values.safetensors");
    let values = [1.0, f32::MIN_POSITIVE, -0.0, 3.5, 1e-40, f32::MAX];
    write(&path, &[("x.y".to_owned(), vec![2, 3], &values), ("z".to_owned(), vec![0], &[])]).expect("a written file");
    let checkpoint = Checkpoint::open(&path).expect("a checkpoint");
    assert_eq!((checkpoint.shape("x.y"), checkpoint.shape("z")), (Some(&[2, 3][..]), Some(&[0][..])));
    let found: Vec<u32> = checkpoint.read("x.y").expect("a tensor").iter().map(|x| x.to_bits()).collect();
    assert_eq!(found, values.map(f32::to_bits));
}

#[test]
fn samples_depend_on_seed_and_frame_alone() {
    let options = LoadOptions::default();
    let network = Network::open(parity::path("tiny-sampled.safetensors"), &options).expect("a model");
    let config: &Config = network.config();
    let rgb = vec![0.25; 3 * config.resolution[0] * config.resolution[1]];
    let embedding = network.session(None).embed(&FrameInput { rgb: &rgb, depth: None }).expect("an embedding");
    let position =
        |sampling| network.session(None).static_gaussians(&embedding, &sampling).expect("Gaussians").gaussians.position;
    let sample = |seed, frame| position(Sampling::Sample { seed, frame });
    assert_eq!(sample(1, 2), sample(1, 2));
    assert_ne!(sample(1, 2), sample(1, 3));
    assert_ne!(sample(1, 2), sample(2, 2));
    assert_ne!(sample(1, 2), position(Sampling::Mean));
    let [rows, columns] = config.gaussian_grid();
    for (i, [x, y, z]) in sample(7, 0).into_iter().enumerate() {
        let cell = [(i % columns) as f32, (i / columns) as f32];
        assert!((0.0..=1.0).contains(&y));
        assert!((x - ((2.0 * cell[0] + 1.0) / columns as f32 - 1.0)).abs() * columns as f32 <= 1.0);
        assert!((z + ((2.0 * cell[1] + 1.0) / rows as f32 - 1.0)).abs() * rows as f32 <= 1.0);
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn corrupt_files_never_panic(at in 0usize..22_000, byte: u8, cut in 0usize..2_000_000) {
        let path = parity::path("tiny-nodino.safetensors");
        let mut bytes = std::fs::read(&path).expect("a file");
        let length = bytes.len();
        bytes[at % length] = byte;
        bytes.truncate(cut.max(at + 1).min(length));
        if let Ok(checkpoint) = Checkpoint::from_storage(bytes.clone(), "it") {
            for name in checkpoint.tensors().keys() {
                let _ = checkpoint.read(name);
            }
        }
        let _ = Network::from_parts(bytes, "{\"resolution\": [48, 80], \"upsampler_window\": 60, \"use_dino\": false}", &LoadOptions::default());
    }
}
