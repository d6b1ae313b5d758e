//! Sizes from the tensors' shapes, completed by the configuration file.

use super::json::Settings;
use super::{Config, DinoConfig, StaticPosition};
use crate::checkpoint::{Checkpoint, Weights};
use crate::keys;
use crate::{DinoLayout, ModelError};

/// Resolution and window of the published checkpoint, which its shapes do not determine.
const PUBLISHED_RESOLUTION: [usize; 2] = [288, 512];
const PUBLISHED_WINDOW: usize = 2304;
/// Input of DINOv2 in the published model.
const PUBLISHED_DINO_INPUT: [usize; 2] = [252, 448];

/// Most patches along a side of a vision transformer.
const LARGEST_GRID: usize = 512;

/// The prefix of a StreamSplat checkpoint's keys.
pub(crate) fn prefix(checkpoint: &Checkpoint) -> Result<&'static str, ModelError> {
    let probe = format!("{}.conv.weight", keys::ENCODER);
    let found = keys::PREFIXES.into_iter().find(|prefix| checkpoint.shape(&format!("{prefix}{probe}")).is_some());
    found.ok_or_else(|| ModelError::Format {
        file: checkpoint.file().to_owned(),
        reason: format!(
            "not a StreamSplat checkpoint: expected a tensor {}{probe}{}",
            keys::PREFIXES[0],
            hint(checkpoint)
        ),
    })
}

/// Names the actual kind of a file of the wrong kind, for the end of an error message.
pub(crate) fn hint(checkpoint: &Checkpoint) -> String {
    if let Some(layout) = DinoLayout::of(checkpoint) {
        return format!("; this is a file of DINOv2 (names of {})", layout.name());
    }
    let probe = format!("{}.conv.weight", keys::ENCODER);
    if keys::PREFIXES.iter().any(|prefix| checkpoint.shape(&format!("{prefix}{probe}")).is_some()) {
        return "; this is a StreamSplat checkpoint".to_owned();
    }
    match checkpoint.tensors().keys().next() {
        Some(first) => format!("; found {} tensors, the first of them {first}", checkpoint.tensors().len()),
        None => "; found no tensors".to_owned(),
    }
}

impl Config {
    /// The sizes of the checkpoint behind `weights`.
    pub(crate) fn derive(weights: &Weights<'_>, settings: &Settings) -> Result<Config, ModelError> {
        let encoder = weights.at(keys::ENCODER);
        let decoder = weights.at(keys::DECODER);
        let [hidden_dim, _, patch_size, _] = encoder.shape_like("conv.weight", [None, Some(4), None, None])?;
        encoder.shape_like("conv.weight", [None, None, None, Some(patch_size)])?;
        if hidden_dim % 64 != 0 {
            return Err(settings.wrong("hidden_dim", "a multiple of 64 (heads of 64 channels)", hidden_dim));
        }
        let [_, condition_dim] = decoder.shape_like("condition_proj.weight", [Some(hidden_dim), None])?;
        let encoder_layers = encoder.count("transformer.resblocks", "layernorm1.weight");
        let decoder_layers = decoder.count("transformer.resblocks", "self_attn_ln.weight");

        let upsampler = weights.at(keys::STATIC_UPSAMPLER);
        let mut upsampler_widths = [hidden_dim; 2];
        for stage in 0..2 {
            let from = if stage == 0 { hidden_dim } else { upsampler_widths[0] };
            let name = format!("upsampler_{stage}.residual_fc.weight");
            let [four, _] = upsampler.shape_like(&name, [None, Some(from)])?;
            upsampler_widths[stage] = four / 4;
            if four % 256 != 0 {
                return Err(ModelError::Shape {
                    file: weights.file().to_owned(),
                    tensor: upsampler.key(&name),
                    expected: format!("[4·(a multiple of 64), {from}]"),
                    found: vec![four, from],
                });
            }
        }
        if let Some(found @ 1..) = settings.size("upsampler_stages")?
            && found != 2
        {
            return Err(settings.wrong("upsampler_stages", "2", found));
        }

        // 2N rows of learned positions: the one required tensor with the number of tokens.
        let [_, rows, _] = decoder.shape_like("positional_embedding", [Some(1), None, Some(hidden_dim)])?;
        let resolution = resolution(settings, patch_size, rows)?;

        let head = weights.at(keys::STATIC_HEAD);
        let static_position = if head.shape("mix_layer.xyz_static_mean.weight").is_some() {
            StaticPosition::TruncatedNormal
        } else {
            StaticPosition::Tanh
        };
        match (settings.text("static_position")?, static_position) {
            (None, _) | (Some("tanh"), StaticPosition::Tanh) => {}
            (Some("truncated_normal"), StaticPosition::TruncatedNormal) => {}
            (Some(found), kind) => {
                let (name, key) = match kind {
                    StaticPosition::Tanh => ("tanh", "gs_layer.xyz_static"),
                    StaticPosition::TruncatedNormal => ("truncated_normal", "mix_layer.xyz_static_mean"),
                };
                let expected = format!("{name:?}, as the checkpoint has {key}");
                return Err(settings.wrong("static_position", expected, format!("{found:?}")));
            }
        }

        let ignores_depth = match settings.text("depth")? {
            None | Some("used") => false,
            Some("ignored") => true,
            Some(found) => return Err(settings.wrong("depth", r#""used" or "ignored""#, format!("{found:?}"))),
        };

        let config = Config {
            hidden_dim,
            encoder_layers,
            decoder_layers,
            resolution,
            patch_size,
            upsampler_window: settings.size("upsampler_window")?.unwrap_or(PUBLISHED_WINDOW),
            upsampler_widths,
            encoder_window: settings.size("encoder_window")?,
            use_dino: settings.flag("use_dino")?.unwrap_or(true),
            condition_dim,
            static_position,
            ignores_depth,
        };
        settings.agrees("hidden_dim", hidden_dim)?;
        settings.agrees("encoder_layers", encoder_layers)?;
        settings.agrees("decoder_layers", decoder_layers)?;
        settings.agrees("patch_size", patch_size)?;
        config.check_windows(settings)?;
        if !config.use_dino && condition_dim != hidden_dim {
            let expected = format!("true: the condition has {condition_dim} channels, an embedding {hidden_dim}");
            return Err(settings.wrong("use_dino", expected, false));
        }
        Ok(config)
    }

    /// Checks that windows cut a sequence into equal parts.
    fn check_windows(&self, settings: &Settings) -> Result<(), ModelError> {
        let n = self.tokens();
        let divides = |key: &str, window: usize, tokens: usize, what: &str| {
            if tokens.is_multiple_of(window) {
                return Ok(());
            }
            Err(settings.wrong(key, format!("a divisor of {tokens}, {what}"), window))
        };
        divides("upsampler_window", self.upsampler_window, 4 * n, "the tokens of the first upsampling stage")?;
        if let Some(window) = self.encoder_window {
            divides("encoder_window", window, n, "the tokens of a frame")?;
        }
        Ok(())
    }
}

/// The frame size, which must yield `rows` = 2N learned positions.
fn resolution(settings: &Settings, patch: usize, rows: usize) -> Result<[usize; 2], ModelError> {
    let stated = settings.pair("resolution")?;
    let [height, width] = stated.unwrap_or(PUBLISHED_RESOLUTION);
    let whole = height % patch == 0 && width % patch == 0;
    if whole && 2 * (height / patch) * (width / patch) == rows {
        return Ok([height, width]);
    }
    let expected = format!("[height, width] with {} patches of {patch}×{patch} pixels", rows / 2);
    let origin = if stated.is_some() { "" } else { " (the default; state it in the JSON file beside the checkpoint)" };
    Err(settings.wrong("resolution", expected, format!("[{height}, {width}]{origin}")))
}

impl DinoConfig {
    /// The sizes of a DINOv2 file.
    pub(crate) fn derive(weights: &Weights<'_>, settings: &Settings) -> Result<DinoConfig, ModelError> {
        let [embed_dim, _, patch_size, _] =
            weights.shape_like("patch_embed.proj.weight", [None, Some(3), None, None])?;
        weights.shape_like("patch_embed.proj.weight", [None, None, None, Some(patch_size)])?;
        if embed_dim % 64 != 0 {
            return Err(settings.wrong("embed_dim", "a multiple of 64 (heads of 64 channels)", embed_dim));
        }
        let depth = weights.count("blocks", "norm1.weight");
        let mlp_dim = match depth {
            0 => 4 * embed_dim,
            _ => weights.shape_like("blocks.0.mlp.fc1.weight", [None, Some(embed_dim)])?[0],
        };
        let register_tokens = match weights.shape("register_tokens") {
            None => 0,
            Some(_) => weights.shape_like("register_tokens", [Some(1), None, Some(embed_dim)])?[1],
        };
        let [_, positions, _] = weights.shape_like("pos_embed", [Some(1), None, Some(embed_dim)])?;
        let of_class = weights.layout().class_positions();
        let pos_embed_grid = (positions - of_class).isqrt();
        if pos_embed_grid == 0 || pos_embed_grid * pos_embed_grid + of_class != positions {
            return Err(ModelError::Shape {
                file: weights.file().to_owned(),
                tensor: weights.key("pos_embed"),
                expected: format!("[1, {of_class} + a square, {embed_dim}]"),
                found: vec![1, positions, embed_dim],
            });
        }
        let resized_to = settings.pair("resized_to")?.unwrap_or(PUBLISHED_DINO_INPUT);
        if resized_to.iter().any(|side| side % patch_size != 0 || side / patch_size > LARGEST_GRID) {
            let expected = format!(
                "[height, width], multiples of the patch size {patch_size}, at most {LARGEST_GRID} patches each"
            );
            return Err(settings.wrong("resized_to", expected, format!("{resized_to:?}")));
        }
        settings.agrees("embed_dim", embed_dim)?;
        settings.agrees("depth", depth)?;
        settings.agrees("heads", embed_dim / 64)?;
        settings.agrees("patch_size", patch_size)?;
        Ok(DinoConfig { embed_dim, depth, mlp_dim, patch_size, register_tokens, pos_embed_grid, resized_to })
    }
}
