//! The binary64 reference agrees with the parity data to within the error of the data.

use streamsplat_model::checkpoint::Checkpoint;
use streamsplat_tests::parity;
use streamsplat_tests::reference::{Inputs, Outputs, Sizes, Tensors, dino, forward, relative_l2};

fn read(io: &Checkpoint, name: &str) -> Vec<f64> {
    io.read(name).expect("a parity tensor").iter().map(|&x| f64::from(x)).collect()
}

/// Asserts that every `out.*` of the data exists and is within `bound`.
fn compare(case: &str, io: &Checkpoint, found: &Outputs, bound: impl Fn(&str) -> f64) {
    let mut compared = 0;
    for name in io.tensors().keys().filter_map(|name| name.strip_prefix("out.")) {
        let error = relative_l2(found[name].iter().copied(), read(io, &format!("out.{name}")));
        println!("{case} {name}: {error:.2e}");
        assert!(error <= bound(name), "{case} {name}: {error:.2e}");
        compared += 1;
    }
    assert_eq!(compared, found.len(), "{case}");
}

fn agrees(case: &str) {
    let (checkpoint, io) = parity::case(case);
    let json = parity::config(case);
    let size = |key: &str| json["config"][key].as_u64().map(|n| n as usize);
    let sizes = Sizes {
        resolution: [0, 1].map(|i| json["config"]["resolution"][i].as_u64().expect("a size") as usize),
        upsampler_window: size("upsampler_window").expect("a size"),
        encoder_window: size("encoder_window"),
    };
    let (frames, depths) = (read(&io, "in.frames"), read(&io, "in.depths"));
    let condition = io.shape("in.condition").map(|_| read(&io, "in.condition"));
    let inputs = Inputs { frames: &frames, depths: &depths, condition: condition.as_deref() };
    let found = forward(&Tensors::new(&checkpoint), sizes, &inputs);
    // The file contains the distance of its own f32 results from f64.
    let own = &json["reference_f32_rel_l2"];
    compare(case, &io, &found, |name| 1.01 * own[name].as_f64().expect("a number") + 1e-8);
}

#[test]
fn reference_agrees_with_a_model_conditioned_on_features() {
    agrees("tiny-dino");
}

#[test]
fn reference_agrees_with_a_model_conditioned_on_embeddings() {
    agrees("tiny-nodino");
}

#[test]
fn reference_agrees_with_a_model_of_sampled_positions() {
    agrees("tiny-sampled");
}

#[test]
fn reference_agrees_with_a_model_of_windowed_blocks() {
    agrees("tiny-window");
}

#[test]
fn reference_agrees_with_dino() {
    let (checkpoint, io) = parity::case("dino-tiny");
    let shape = io.shape("in.frame").expect("a frame");
    let found = dino(&Tensors::new(&checkpoint), &read(&io, "in.frame"), [shape[2], shape[3]], [252, 448]);
    // The data compute the coordinates of the resized frame in f32.
    compare("dino-tiny", &io, &found, |name| if name == "resized" { 2e-6 } else { 1e-6 });
}
