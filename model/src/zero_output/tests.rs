use streamsplat_fixtures::seeded::Sizes;
use streamsplat_kernels::Level;

use crate::reuse::Saving;
use crate::{FrameInput, LoadOptions, Network, Precision, Sampling, Session, Side};

const SIZES: Sizes = Sizes {
    hidden_dim: 128,
    encoder_layers: 2,
    decoder_layers: 2,
    resolution: [16, 48],
    upsampler_window: 16,
    encoder_window: Some(4),
    features: None,
    truncated_normal: false,
};

/// Zero-output branches of every kind, in blocks with others and alone.
const ZERO_OUTPUT: [&str; 12] = [
    "gs_predictor.encoder.transformer_encoder.transformer.resblocks.0.attn.out_proj",
    "gs_predictor.encoder.transformer_encoder.transformer.resblocks.1.mlp.c_proj",
    "gs_predictor.gaussian_upsampler.attention_0.resblocks.0.attn.out_proj",
    "gs_predictor.gaussian_upsampler.attention_1.resblocks.1.attn.out_proj",
    "gs_predictor.gaussian_upsampler.attention_1.resblocks.1.mlp.c_proj",
    "decoder.transformer_decoder.transformer.resblocks.0.self_attn.out_proj",
    "decoder.transformer_decoder.transformer.resblocks.0.mlp.c_proj",
    "decoder.transformer_decoder.transformer.resblocks.1.cross_attn.out_proj",
    "gaussian_upsampler.attention_0.resblocks.0.attn.out_proj",
    "gaussian_upsampler.attention_0.resblocks.0.mlp.c_proj",
    "gaussian_upsampler.attention_0.resblocks.1.mlp.c_proj",
    "gaussian_upsampler.attention_1.resblocks.0.attn.out_proj",
];

/// The values of a tensor of a checkpoint, F32.
fn values<'a>(bytes: &'a mut [u8], name: &str) -> impl Iterator<Item = &'a mut [u8]> {
    let length = u64::from_le_bytes(bytes[..8].try_into().expect("eight")) as usize;
    let header: serde_json::Value = serde_json::from_slice(&bytes[8..8 + length]).expect("a header");
    let [begin, end] = [0, 1].map(|i| header[name]["data_offsets"][i].as_u64().expect(name) as usize);
    bytes[8 + length..][begin..end].chunks_exact_mut(4)
}

/// Zeros of both signs.
fn silence(bytes: &mut [u8], name: &str) {
    for (i, value) in values(bytes, name).enumerate() {
        value.copy_from_slice(&[0.0f32, -0.0][usize::from(i % 3 == 1)].to_le_bytes());
    }
}

fn seeded(sizes: &Sizes) -> Vec<u8> {
    let mut bytes = Vec::new();
    sizes.write(7, "", &mut bytes).expect("written");
    bytes
}

fn checkpoint() -> Vec<u8> {
    let mut bytes = seeded(&SIZES);
    for name in ZERO_OUTPUT {
        silence(&mut bytes, &format!("{name}.weight"));
        if name.ends_with("out_proj") {
            silence(&mut bytes, &format!("{name}.bias"));
        }
    }
    // A bias alone makes a branch count.
    silence(&mut bytes, "gs_predictor.gaussian_upsampler.attention_0.resblocks.1.attn.out_proj.weight");
    bytes
}

fn load(bytes: &[u8], sizes: &Sizes, level: Level, precision: Precision, compute_zero_output: bool) -> Network {
    let options = LoadOptions { level, precision, compute_zero_output };
    Network::from_parts(bytes.to_vec(), &sizes.json().to_string(), &options).expect("a model")
}

/// The bits of all outputs of the network for four frames in which a square moves.
fn pass(session: &mut Session<&Network>) -> Vec<Vec<u32>> {
    let [height, width] = session.network().config().resolution;
    let mut results: Vec<Vec<f32>> = Vec::new();
    let mut before: Option<(Vec<f32>, Vec<f32>)> = None;
    for column in [0, 8, 8, 24] {
        let pixel = |i: usize| match (column..column + 8).contains(&(i % width)) && i / width % height < 8 {
            true => 0.9,
            false => (i * 7919 % 1013) as f32 / 2000.0,
        };
        let rgb: Vec<f32> = (0..3 * height * width).map(pixel).collect();
        let tokens = session.tokenize(&FrameInput { rgb: &rgb, depth: None }).expect("tokens");
        let h = session.encode(&tokens).expect("h").h;
        let still = session.upsample_static(&h).expect("tokens");
        results.extend([h.clone(), still.clone()]);
        results.push(
            session.network().session(None).static_head(&still, &Sampling::Mean).expect("Gaussians").position.concat(),
        );
        if let Some((h_a, still_a)) = &before {
            let a = Side { h: h_a, static_tokens: still_a, condition: None };
            let b = Side { h: &h, static_tokens: &still, condition: None };
            for m in session.deform(a, b).expect("motion") {
                results.extend([m.tokens, m.d]);
            }
        }
        before = Some((h, still));
    }
    results.iter().map(|values| values.iter().map(|x| x.to_bits()).collect()).collect()
}

#[test]
fn a_network_without_its_zero_output_branches_gives_the_bits_of_one_with_them() {
    let bytes = checkpoint();
    for precision in Precision::ALL {
        for level in Level::available() {
            let [lean, full] = [false, true].map(|computed| load(&bytes, &SIZES, level, precision, computed));
            for threads in [1, 3] {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
                pool.install(|| {
                    let [found, expected] = [&lean, &full].map(|network| pass(&mut network.session(None)));
                    assert!(found == expected, "{precision} {level} {threads}");
                    for saving in [Saving::Exact, Saving::Within(0.02)] {
                        let kept = |network: &Network| {
                            let mut session = network.session(Some(saving));
                            (pass(&mut session), session.cache().expect("windows can be kept").bytes())
                        };
                        let ((found, less), (expected, more)) = (kept(&lean), kept(&full));
                        assert!(found == expected, "{precision} {level} {threads} {saving:?}");
                        assert!(less < more, "no keys and values of zero-output attention: {less} of {more} bytes");
                    }
                });
            }
        }
    }
}

#[test]
fn zero_output_branches_are_counted_and_take_no_memory() {
    let bytes = checkpoint();
    let [lean, full] = [false, true].map(|all| load(&bytes, &SIZES, Level::scalar(), Precision::F32, all));
    let counts: Vec<_> = lean.zero_output().iter().map(|s| (s.part, s.branches, s.zero_output)).collect();
    let expected = [("encoder", 4, 2), ("static upsampler", 8, 3), ("decoder", 6, 3), ("deformation upsampler", 8, 4)];
    assert_eq!(counts, expected);
    assert!(lean.zero_output().iter().all(|s| s.gflop > 0.0));
    assert_eq!(full.zero_output(), lean.zero_output());
    let parameters: usize = lean.zero_output().iter().map(|s| s.parameters).sum();
    // The norms before them as well.
    let norms = 2 * 128 + (64 + 2 * 64) + 3 * 128 + (3 * 64 + 64);
    assert_eq!(full.bytes() - lean.bytes(), 4 * (parameters + norms));
    assert!(
        load(&seeded(&SIZES), &SIZES, Level::scalar(), Precision::F32, false)
            .zero_output()
            .iter()
            .all(|s| s.zero_output == 0)
    );
}

#[test]
fn a_zero_output_branch_turns_minus_zero_into_zero() {
    let sizes = Sizes { encoder_layers: 1, ..SIZES };
    let mut bytes = seeded(&sizes);
    let encoder = "gs_predictor.encoder.transformer_encoder";
    let block = format!("{encoder}.transformer.resblocks.0");
    for name in ["attn.out_proj.weight", "attn.out_proj.bias", "mlp.c_proj.weight"] {
        silence(&mut bytes, &format!("{block}.{name}"));
    }
    // A black patch at the origin of the position code: its first channel enters the block as −0.
    values(&mut bytes, &format!("{encoder}.layernorm1.weight"))
        .for_each(|w| w.copy_from_slice(&(-1.0f32).to_le_bytes()));
    let black = vec![0.0; 3 * 16 * 48];
    for precision in Precision::ALL {
        let h = [false, true].map(|all| {
            let network = load(&bytes, &sizes, Level::detect(), precision, all);
            network.session(None).embed(&FrameInput { rgb: &black, depth: None }).expect("h").h
        });
        assert_eq!(h[0][0].to_bits(), 0);
        assert!(h[0].iter().zip(&h[1]).all(|(a, b)| a.to_bits() == b.to_bits()));
    }
}

#[test]
fn tensors_of_zero_output_branches_are_checked() {
    let mut bytes = checkpoint();
    let name = format!("{}.packed_proj.weight", ZERO_OUTPUT[0].trim_end_matches(".out_proj"));
    values(&mut bytes, &name).nth(5).expect("a value").copy_from_slice(&f32::NAN.to_le_bytes());
    let error = Network::from_parts(bytes, &SIZES.json().to_string(), &LoadOptions::default()).expect_err("NaN");
    assert!(error.to_string().contains(&name), "{error}");
}

#[test]
fn an_upsampler_of_zero_output_blocks_alone_gives_no_minus_zero() {
    let mut bytes = seeded(&SIZES);
    for (stage, block) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
        for branch in ["attn.out_proj.weight", "attn.out_proj.bias", "mlp.c_proj.weight"] {
            silence(&mut bytes, &format!("gaussian_upsampler.attention_{stage}.resblocks.{block}.{branch}"));
        }
    }
    // Products of both signs that underflow, and biases that keep the sign of the last of them.
    let layer = |stage| format!("gaussian_upsampler.upsampler_{stage}.residual_fc");
    for (i, value) in values(&mut bytes, &format!("{}.weight", layer(1))).enumerate() {
        value.copy_from_slice(&[1e-30f32, -1e-30][i % 3 % 2].to_le_bytes());
    }
    for bias in [0, 1].map(|stage| format!("{}.bias", layer(stage))) {
        values(&mut bytes, &bias).for_each(|value| value.copy_from_slice(&(-0.0f32).to_le_bytes()));
    }
    for level in Level::available() {
        let [lean, full] = [false, true].map(|computed| load(&bytes, &SIZES, level, Precision::F32, computed));
        let config = lean.config();
        let d: Vec<f32> = (0..config.tokens() * config.hidden_dim).map(|i| (i % 7) as f32 * 1e-20 - 3e-20).collect();
        let bits = |network: &Network| -> Vec<u32> {
            network.session(None).upsample_deformation(0, &d).expect("tokens").iter().map(|x| x.to_bits()).collect()
        };
        assert!(bits(&lean).iter().all(|&bits| bits == 0), "{level}: something else than +0");
        assert!(bits(&full).iter().all(|&bits| bits == 0), "{level}, computed: something else than +0");
    }
}
