//! Networks of sizes that no stored checkpoint has agree with the binary64 reference.

use streamsplat_fixtures::seeded::{self, uniform};
use streamsplat_model::checkpoint::Checkpoint;
use streamsplat_model::{Dino, LoadOptions, Network};
use streamsplat_tests::forward::{Tensor, forward, forward_dino, write};
use streamsplat_tests::reference::{self, Inputs, Outputs, Tensors, relative_l2};

fn numbers(count: usize, mut seed: u64) -> Vec<f32> {
    (0..count).map(|_| uniform(&mut seed)).collect()
}

fn widen(values: &[f32]) -> Vec<f64> {
    values.iter().map(|&x| f64::from(x)).collect()
}

fn compare(found: &[Tensor], expected: &Outputs) {
    assert_eq!(found.len(), expected.len());
    for tensor in found {
        let expected = &expected[tensor.name.trim_start_matches("out.")];
        let error = relative_l2(widen(&tensor.values), expected.iter().copied());
        assert!(error <= 3e-6, "{}: {error:.2e}", tensor.name);
    }
}

fn agrees(sizes: &seeded::Sizes, prefix: &str, condition_tokens: usize) {
    let mut bytes = Vec::new();
    sizes.write(5, prefix, &mut bytes).expect("bytes");
    let checkpoint = Checkpoint::from_storage(bytes.clone(), "weights").expect("a checkpoint");
    let tensors = Tensors::new(&checkpoint);
    let network = Network::from_parts(bytes, &sizes.json().to_string(), &LoadOptions::default()).expect("a model");

    let [height, width] = sizes.resolution;
    let frames = numbers(6 * height * width, 1);
    let depths = numbers(2 * height * width, 2);
    let condition = sizes.features.map(|channels| (channels, numbers(2 * condition_tokens * channels, 3)));
    let mut inputs = vec![
        ("in.frames".to_owned(), vec![2, 3, height, width], frames.as_slice()),
        ("in.depths".to_owned(), vec![2, 1, height, width], depths.as_slice()),
    ];
    if let Some((channels, condition)) = &condition {
        inputs.push(("in.condition".to_owned(), vec![2, condition_tokens, *channels], condition.as_slice()));
    }
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("io.safetensors");
    write(&path, &inputs).expect("a written file");
    let found = forward(&network, &Checkpoint::open(path).expect("a file")).expect("outputs");

    let reference_sizes = reference::Sizes {
        resolution: sizes.resolution,
        upsampler_window: sizes.upsampler_window,
        encoder_window: sizes.encoder_window,
    };
    let (frames, depths) = (widen(&frames), widen(&depths));
    let condition = condition.map(|(_, condition)| widen(&condition));
    let inputs = Inputs { frames: &frames, depths: &depths, condition: condition.as_deref() };
    compare(&found, &reference::forward(&tensors, reference_sizes, &inputs));
}

fn small() -> seeded::Sizes {
    seeded::Sizes {
        hidden_dim: 64,
        encoder_layers: 3,
        decoder_layers: 2,
        resolution: [24, 40],
        upsampler_window: 15,
        encoder_window: Some(5),
        features: None,
        truncated_normal: false,
    }
}

#[test]
fn one_head_and_odd_windows_agree() {
    agrees(&small(), "", 0);
}

#[test]
fn five_heads_and_a_wide_condition_agree() {
    let sizes = seeded::Sizes {
        hidden_dim: 320,
        encoder_layers: 1,
        decoder_layers: 1,
        resolution: [16, 24],
        upsampler_window: 24,
        encoder_window: None,
        features: Some(96),
        truncated_normal: true,
    };
    agrees(&sizes, "model.", 7);
}

#[test]
fn no_blocks_and_a_single_row_agree() {
    let sizes = seeded::Sizes {
        encoder_layers: 0,
        decoder_layers: 0,
        resolution: [8, 104],
        upsampler_window: 1,
        encoder_window: None,
        ..small()
    };
    agrees(&sizes, "model._orig_mod.", 0);
}

#[test]
fn dino_of_another_width_and_a_small_frame_agrees() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("dino.safetensors");
    let mut file = std::fs::File::create(&path).expect("a file");
    seeded::write(&seeded::dino_shapes(64, 1), 9, "", &mut file).expect("a written file");
    std::fs::write(folder.path().join("dino.json"), r#"{"resized_to": [56, 98]}"#).expect("a written file");
    let frame = numbers(3 * 31 * 45, 4);
    let io = folder.path().join("io.safetensors");
    write(&io, &[("in.frame".to_owned(), vec![1, 3, 31, 45], &frame)]).expect("a written file");
    let dino = Dino::open(&path, &LoadOptions::default()).expect("a model");
    let found = forward_dino(&dino, &Checkpoint::open(io).expect("a file")).expect("outputs");
    let tensors = Tensors::new(&Checkpoint::open(path).expect("a file"));
    compare(&found, &reference::dino(&tensors, &widen(&frame), [31, 45], [56, 98]));
}
