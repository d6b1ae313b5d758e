//! StreamSplat on one pair of frames.

use super::operations::*;
use super::{Outputs, Tensors};

/// Sizes that shapes do not determine.
#[derive(Clone, Copy, Debug)]
pub struct Sizes {
    /// Height and width of the frames.
    pub resolution: [usize; 2],
    /// Tokens per window of the upsamplers.
    pub upsampler_window: usize,
    /// Tokens per window of encoder and decoder self-attention.
    pub encoder_window: Option<usize>,
}

/// A pair of frames.
pub struct Inputs<'a> {
    /// `[2, 3, H, W]`
    pub frames: &'a [f64],
    /// `[2, 1, H, W]`
    pub depths: &'a [f64],
    /// `[2, M, C]`: features of each frame; without them the embeddings.
    pub condition: Option<&'a [f64]>,
}

/// All outputs, with the names of the parity data.
pub fn forward(t: &Tensors, sizes: Sizes, inputs: &Inputs<'_>) -> Outputs {
    let mut out = Outputs::new();
    let mut keep = |name: &str, values: &[f64]| out.entry(name.to_owned()).or_default().extend_from_slice(values);
    let area = sizes.resolution[0] * sizes.resolution[1];
    let (mut h, mut statics) = (Vec::new(), Vec::new());
    for frame in 0..2 {
        let rgb = &inputs.frames[frame * 3 * area..][..3 * area];
        let depth = &inputs.depths[frame * area..][..area];
        let tokens = tokenize(t, sizes, &[rgb, depth].concat());
        keep("tokens_conv", &tokens);
        let embedding = encode(t, sizes, tokens);
        keep("h", &embedding);
        let upsampled = upsample(t, "gs_predictor.gaussian_upsampler", sizes, &embedding);
        keep("static_tokens", &upsampled);
        for (name, values) in static_head(t, sizes, &upsampled) {
            keep(&format!("static.{name}"), &values);
        }
        h.push(embedding);
        statics.push(upsampled);
    }
    let features: Vec<&[f64]> = match inputs.condition {
        Some(c) => c.chunks(c.len() / 2).collect(),
        None => h.iter().map(Vec::as_slice).collect(),
    };
    // Each frame is conditioned on the other one's features.
    let d = decode(t, sizes, &h, [features[1], features[0]]);
    keep("d", &d);
    for (frame, d) in d.chunks(d.len() / 2).enumerate() {
        let upsampled = upsample(t, "gaussian_upsampler", sizes, d);
        keep("dynamic_tokens", &upsampled);
        let [velocity, gamma] = deformation_head(t, &statics[frame], &upsampled);
        keep("dynamic.velocity", &velocity);
        keep("dynamic.gamma", &gamma);
    }
    out
}

/// 8×8 stride-8 convolution of the four channels.
fn tokenize(t: &Tensors, sizes: Sizes, image: &[f64]) -> Vec<f64> {
    let name = "gs_predictor.encoder.transformer_encoder.conv.weight";
    let p = t.shape(name)[2];
    let [height, width] = sizes.resolution;
    let mut patches = Vec::new();
    for y in (0..height).step_by(p) {
        for x in (0..width).step_by(p) {
            for channel in 0..4 {
                for row in y..y + p {
                    patches.extend_from_slice(&image[(channel * height + row) * width + x..][..p]);
                }
            }
        }
    }
    linear(&patches, t.get(name), None, 4 * p * p)
}

fn encode(t: &Tensors, sizes: Sizes, tokens: Vec<f64>) -> Vec<f64> {
    let name = "gs_predictor.encoder.transformer_encoder";
    let d = t.shape(&format!("{name}.layernorm1.weight"))[0];
    let mut x = tokens;
    let pe = format!("{name}.positional_encoding.pe");
    let table = if t.has(&pe) { t.get(&pe).to_vec() } else { sinusoid(x.len() / d, d) };
    add(&mut x, &table);
    x = rms_norm(&x, t.get(&format!("{name}.layernorm1.weight")));
    for i in 0..t.count(&format!("{name}.transformer.resblocks"), "layernorm1.weight") {
        let roll = if i % 2 == 1 { sizes.encoder_window.unwrap_or(0) / 2 } else { 0 };
        block(t, &format!("{name}.transformer.resblocks.{i}"), &mut x, d, sizes.encoder_window, roll);
    }
    rms_norm(&x, t.get(&format!("{name}.layernorm2.weight")))
}

fn block(t: &Tensors, name: &str, x: &mut [f64], d: usize, window: Option<usize>, roll: usize) {
    let y = rms_norm(x, t.get(&format!("{name}.layernorm1.weight")));
    add(x, &self_attention(t, &format!("{name}.attn"), &y, d, window, roll));
    let y = rms_norm(x, t.get(&format!("{name}.layernorm2.weight")));
    add(x, &feed_forward(t, &format!("{name}.mlp"), &y));
}

/// Two stages, each with a linear layer to four times the channels, their spread over 2×2 sub-tokens, and a pair of
/// window blocks.
fn upsample(t: &Tensors, name: &str, sizes: Sizes, h: &[f64]) -> Vec<f64> {
    let p = t.shape("gs_predictor.encoder.transformer_encoder.conv.weight")[2];
    let [mut rows, mut columns] = sizes.resolution.map(|side| side / p);
    let mut x = h.to_vec();
    for stage in 0..2 {
        let expanded = layer(t, &format!("{name}.upsampler_{stage}.residual_fc"), &x);
        let d = expanded.len() / (4 * rows * columns);
        x = vec![0.0; expanded.len()];
        for (token, channels) in expanded.chunks(4 * d).enumerate() {
            let (row, column) = (token / columns, token % columns);
            for (c, &value) in channels.iter().enumerate() {
                let (channel, i, j) = (c / 4, c / 2 % 2, c % 2);
                x[((2 * row + i) * 2 * columns + 2 * column + j) * d + channel] = value;
            }
        }
        [rows, columns] = [2 * rows, 2 * columns];
        for i in 0..2 {
            let (window, blocks) = (sizes.upsampler_window, format!("{name}.attention_{stage}.resblocks.{i}"));
            block(t, &blocks, &mut x, d, Some(window), i * (window / 2));
        }
    }
    rms_norm(&x, t.get(&format!("{name}.layernorm2.weight")))
}

/// Position, scale, opacity and colour per token.
fn static_head(t: &Tensors, sizes: Sizes, tokens: &[f64]) -> Vec<(&'static str, Vec<f64>)> {
    let name = "gs_predictor.predictor";
    let head = |leaf: &str| layer(t, &format!("{name}.{leaf}"), tokens);
    let mut position = if t.has(&format!("{name}.gs_layer.xyz_static.weight")) {
        head("gs_layer.xyz_static").into_iter().map(f64::tanh).collect()
    } else {
        // The mean parameter of the truncated normal on [−1+ε, 1−ε], ε = 10⁻³.
        head("mix_layer.xyz_static_mean").into_iter().map(|x| x.tanh() * (1.0 - 1e-3)).collect::<Vec<_>>()
    };
    let p = t.shape("gs_predictor.encoder.transformer_encoder.conv.weight")[2];
    let [rows, columns] = sizes.resolution.map(|side| (4 * side / p) as f64);
    for (cell, offset) in position.chunks_mut(3).enumerate() {
        let (row, column) = ((cell / columns as usize) as f64, (cell % columns as usize) as f64);
        offset[0] = (2.0 * column + 1.0) / columns - 1.0 + offset[0] / columns;
        offset[1] = 0.5 + 0.5 * offset[1];
        offset[2] = 1.0 - (2.0 * row + 1.0) / rows + offset[2] / rows;
    }
    vec![
        ("xyz_static", position),
        ("scale", head("gs_layer.scale").into_iter().map(|x| 0.1 * softplus(x)).collect()),
        ("opacity", head("gs_layer.opacity").into_iter().map(|x| 0.05 + 0.95 * sigmoid(x)).collect()),
        ("rgb", head("gs_layer.rgb").into_iter().map(sigmoid).collect()),
    ]
}

fn decode(t: &Tensors, sizes: Sizes, h: &[Vec<f64>], conditions: [&[f64]; 2]) -> Vec<f64> {
    let name = "decoder.transformer_decoder";
    let weight = |leaf: &str| t.get(&format!("{name}.{leaf}.weight"));
    let d = weight("layernorm1").len();
    let n = h[0].len() / d;
    let conditions = conditions.map(|condition| {
        let mut c = layer(t, &format!("{name}.condition_proj"), condition);
        let pe = format!("{name}.positional_encoding.pe");
        let table = if t.has(&pe) { t.get(&pe)[..c.len()].to_vec() } else { sinusoid(c.len() / d, d) };
        add(&mut c, &table);
        rms_norm(&c, weight("condition_ln"))
    });
    let mut x = h.concat();
    add(&mut x, t.get(&format!("{name}.positional_embedding")));
    let types = t.get(&format!("{name}.cls_embedding"));
    for (i, row) in x.chunks_mut(d).enumerate() {
        add(row, &types[i / n * d..][..d]);
    }
    x = rms_norm(&x, weight("layernorm1"));
    for i in 0..t.count(&format!("{name}.transformer.resblocks"), "self_attn_ln.weight") {
        let block = format!("{name}.transformer.resblocks.{i}");
        let roll = if i % 2 == 1 { sizes.encoder_window.unwrap_or(0) / 2 } else { 0 };
        let y = rms_norm(&x, t.get(&format!("{block}.self_attn_ln.weight")));
        add(&mut x, &self_attention(t, &format!("{block}.self_attn"), &y, d, sizes.encoder_window, roll));
        for (x, condition) in x.chunks_mut(n * d).zip(&conditions) {
            let y = rms_norm(x, t.get(&format!("{block}.cross_attn_ln.weight")));
            add(x, &cross_attention(t, &format!("{block}.cross_attn"), &y, condition, d));
        }
        let y = rms_norm(&x, t.get(&format!("{block}.mlp_ln.weight")));
        add(&mut x, &feed_forward(t, &format!("{block}.mlp"), &y));
    }
    rms_norm(&x, weight("layernorm2"))
}

/// Velocity and γ.
fn deformation_head(t: &Tensors, static_tokens: &[f64], tokens: &[f64]) -> [Vec<f64>; 2] {
    let projected = layer(t, "encoder_proj", static_tokens);
    let d = t.shape("encoder_proj.weight")[0];
    let mut joined = Vec::with_capacity(2 * tokens.len());
    for (s, dynamic) in projected.chunks(d).zip(tokens.chunks(d)) {
        joined.extend_from_slice(s);
        joined.extend_from_slice(dynamic);
    }
    let mlp = |name: &str| {
        let stem = format!("gs_dynamic_predictor.gs_layer.{name}.layers");
        let mut x = joined.clone();
        for index in [1, 4] {
            x = layer(t, &format!("{stem}.{index}"), &x).into_iter().map(silu).collect();
        }
        layer(t, &format!("{stem}.7"), &x)
    };
    let (mut velocity, mut gamma) = (mlp("xyz_dynamic"), mlp("opacity_dynamic"));
    for v in velocity.chunks_mut(3) {
        for (v, scalar) in v.iter_mut().zip(t.get("gs_dynamic_predictor.dynamic_scalar")) {
            *v = v.tanh() * (1.0 - 1e-3) * scalar;
        }
    }
    for g in gamma.chunks_mut(2) {
        g[0] = g[0].max(0.0);
        g[1] = sigmoid(g[1]);
    }
    [velocity, gamma]
}
