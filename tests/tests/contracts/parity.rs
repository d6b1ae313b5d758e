//! The network reproduces every tensor of the parity data.

use streamsplat_kernels::Level;
use streamsplat_model::{Dino, LoadOptions, Network, Precision};
use streamsplat_tests::forward::{Tensor, forward, forward_dino};
use streamsplat_tests::parity;
use streamsplat_tests::reference::relative_l2;

/// Relative L2 error per tensor; the data themselves differ from the exact results by about 1e-6.
const BOUND: f64 = 3e-6;

fn outputs(case: &str, level: Level, precision: Precision) -> Vec<Tensor> {
    let (_, io) = parity::case(case);
    let options = LoadOptions { level, precision, ..LoadOptions::default() };
    let path = parity::path(&format!("{case}.safetensors"));
    if case.starts_with("dino") {
        return forward_dino(&Dino::open(path, &options).expect("a model"), &io).expect("inputs that fit");
    }
    forward(&Network::open(path, &options).expect("a model"), &io).expect("inputs that fit")
}

fn reproduces(case: &str) {
    stays_within(case, Precision::F32, BOUND);
}

fn stays_within(case: &str, precision: Precision, bound: f64) {
    let (_, io) = parity::case(case);
    let found = outputs(case, Level::detect(), precision);
    let expected = io.tensors().keys().filter(|name| name.starts_with("out."));
    assert_eq!(expected.count(), found.len());
    for tensor in found {
        let expected = io.read(&tensor.name).expect("a parity tensor");
        assert_eq!(Some(tensor.shape.as_slice()), io.shape(&tensor.name), "{case} {}", tensor.name);
        let widen = |values: &[f32]| values.iter().map(|&x| f64::from(x)).collect::<Vec<_>>();
        let error = relative_l2(widen(&tensor.values), widen(&expected));
        println!("{case} {precision} {}: {error:.2e}", tensor.name);
        assert!(error <= bound, "{case} {precision} {}: {error:.2e}", tensor.name);
    }
}

#[test]
fn dino_is_reproduced() {
    reproduces("dino-tiny");
}

#[test]
fn model_conditioned_on_features_is_reproduced() {
    reproduces("tiny-dino");
}

#[test]
fn model_conditioned_on_embeddings_is_reproduced() {
    reproduces("tiny-nodino");
}

#[test]
fn model_of_sampled_positions_is_reproduced() {
    reproduces("tiny-sampled");
}

#[test]
fn model_of_windowed_blocks_is_reproduced() {
    reproduces("tiny-window");
}

/// The weights of the tiny models are random: nothing in them is smooth, and errors grow more than in a trained one.
#[test]
fn reduced_precision_stays_near() {
    for case in ["tiny-dino", "tiny-nodino", "tiny-window", "dino-tiny"] {
        stays_within(case, Precision::Bf16, 3e-2);
        stays_within(case, Precision::Int8, 1.2e-1);
    }
}

#[test]
fn every_level_and_number_of_threads_gives_the_same_bits() {
    let bits = |tensors: Vec<Tensor>| -> Vec<(String, Vec<u32>)> {
        tensors.into_iter().map(|t| (t.name, t.values.into_iter().map(f32::to_bits).collect())).collect()
    };
    for (case, precision) in [
        ("tiny-nodino", Precision::F32),
        ("tiny-nodino", Precision::Bf16),
        ("tiny-nodino", Precision::Int8),
        ("tiny-sampled", Precision::F32),
        ("dino-tiny", Precision::F32),
    ] {
        let expected = bits(outputs(case, Level::scalar(), precision));
        for level in Level::available() {
            // DINOv2 is slow without vectors.
            let threads: &[usize] = if case == "dino-tiny" { &[2] } else { &[1, 2, 3, 8] };
            for &threads in threads {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
                let found = bits(pool.install(|| outputs(case, level, precision)));
                for (found, expected) in found.iter().zip(&expected) {
                    let same = found == expected;
                    assert!(same, "{case} {precision} {} on {level} with {threads} threads", found.0);
                }
            }
        }
    }
}
