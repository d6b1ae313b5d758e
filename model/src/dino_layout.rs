//! The names under which files of DINOv2 hold its tensors.
//!
//! | layout | recognised by | differences |
//! |---|---|---|
//! | official (`torch.hub`, `dinov2_vitb14_reg4_pretrain.pth`) | `patch_embed.proj.weight` | |
//! | timm (`vit_base_patch14_reg4_dinov2`) | `reg_token` | positions are those of the patches alone; that of the class token is part of `cls_token` |
//! | transformers (`facebook/dinov2-with-registers-base`) | `embeddings.patch_embeddings.projection.weight`, also after a model's name | queries, keys and values are three layers |
//! | transformers 5, `torch.save` of a model's `state_dict()` | also `attention.q_proj` | attention's layers have other names in memory than in files of `save_pretrained` |
//!
//! The rest of the crate uses the official names; [`DinoLayout::key`] is the file's name of a tensor.

use std::borrow::Cow;

use crate::checkpoint::Checkpoint;

/// Origin of a file of DINOv2.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DinoLayout {
    /// The authors.
    #[default]
    Official,
    /// timm.
    Timm,
    /// transformers, with the prefix of its names.
    Transformers(&'static str),
    /// A module of transformers 5 in memory, with the prefix of its names.
    TransformersModule(&'static str),
}

/// Prefixes of the names of transformers: none in a model's own file, the model's name inside a larger model.
const PREFIXES: [&str; 4] = ["", "dinov2_with_registers.", "dinov2.", "backbone."];

/// Names outside the blocks, official and of transformers.
const OUTSIDE: [(&str, &str); 6] = [
    ("patch_embed.proj.", "embeddings.patch_embeddings.projection."),
    ("cls_token", "embeddings.cls_token"),
    ("register_tokens", "embeddings.register_tokens"),
    ("pos_embed", "embeddings.position_embeddings"),
    ("norm.", "layernorm."),
    ("mask_token", "embeddings.mask_token"),
];

/// Names inside a block, official and of transformers. The official file holds `attn.q`, `attn.k` and `attn.v` as one
/// layer, `attn.qkv`.
const INSIDE: [(&str, &str); 6] = [
    ("attn.q.", "attention.attention.query."),
    ("attn.k.", "attention.attention.key."),
    ("attn.v.", "attention.attention.value."),
    ("attn.proj.", "attention.output.dense."),
    ("ls1.gamma", "layer_scale1.lambda1"),
    ("ls2.gamma", "layer_scale2.lambda1"),
];

/// [`INSIDE`] in a module of transformers 5.
const INSIDE_MODULE: [(&str, &str); 6] = [
    ("attn.q.", "attention.q_proj."),
    ("attn.k.", "attention.k_proj."),
    ("attn.v.", "attention.v_proj."),
    ("attn.proj.", "attention.o_proj."),
    ("ls1.gamma", "layer_scale1.lambda1"),
    ("ls2.gamma", "layer_scale2.lambda1"),
];

impl DinoLayout {
    /// The layout of a file, if it holds DINOv2.
    pub fn of(checkpoint: &Checkpoint) -> Option<DinoLayout> {
        let has = |name: &str| checkpoint.shape(name).is_some();
        if has("patch_embed.proj.weight") && has("cls_token") {
            return Some(if has("reg_token") { DinoLayout::Timm } else { DinoLayout::Official });
        }
        let prefix = PREFIXES
            .into_iter()
            .find(|prefix| has(&format!("{prefix}embeddings.patch_embeddings.projection.weight")))?;
        let module = has(&format!("{prefix}encoder.layer.0.attention.q_proj.weight"));
        Some(if module { DinoLayout::TransformersModule(prefix) } else { DinoLayout::Transformers(prefix) })
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            DinoLayout::Official => "official",
            DinoLayout::Timm => "timm",
            DinoLayout::Transformers(_) | DinoLayout::TransformersModule(_) => "transformers",
        }
    }

    /// Number of class-token positions in a file: one, or none where `cls_token` includes it.
    pub(crate) fn class_positions(self) -> usize {
        usize::from(self != DinoLayout::Timm)
    }

    /// The file's name of the tensor that has the official name `key`.
    pub(crate) fn key(self, key: &str) -> Cow<'_, str> {
        match self {
            DinoLayout::Official => Cow::Borrowed(key),
            DinoLayout::Timm => Cow::Borrowed(if key == "register_tokens" { "reg_token" } else { key }),
            DinoLayout::Transformers(prefix) => Cow::Owned(format!("{prefix}{}", in_transformers(key, &INSIDE))),
            DinoLayout::TransformersModule(prefix) => {
                Cow::Owned(format!("{prefix}{}", in_transformers(key, &INSIDE_MODULE)))
            }
        }
    }

    /// The official name of the file's tensor `key`, to the extent that the name of its part needs it.
    pub(crate) fn official(self, key: &str) -> Cow<'_, str> {
        match self {
            DinoLayout::Official => Cow::Borrowed(key),
            DinoLayout::Timm => Cow::Borrowed(if key == "reg_token" { "register_tokens" } else { key }),
            DinoLayout::Transformers(prefix) | DinoLayout::TransformersModule(prefix) => {
                let own = key.strip_prefix(prefix).unwrap_or(key);
                let outside = OUTSIDE
                    .iter()
                    .find_map(|(official, other)| Some(format!("{official}{}", own.strip_prefix(other)?)));
                Cow::Owned(match (outside, own.strip_prefix("encoder.layer.")) {
                    (Some(name), _) => name,
                    (None, Some(block)) => format!("blocks.{block}"),
                    (None, None) => key.to_owned(),
                })
            }
        }
    }
}

/// The name of transformers for an official one.
fn in_transformers(key: &str, inside: &[(&str, &str)]) -> String {
    let renamed = |table: &[(&str, &str)], key: &str| {
        table.iter().find_map(|(from, to)| Some(format!("{to}{}", key.strip_prefix(from)?)))
    };
    match key.strip_prefix("blocks.").and_then(|rest| rest.split_once('.')) {
        Some((block, name)) => {
            format!("encoder.layer.{block}.{}", renamed(inside, name).unwrap_or_else(|| name.to_owned()))
        }
        None => renamed(&OUTSIDE, key).unwrap_or_else(|| key.to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_go_to_a_file_and_back() {
        let official = [
            "cls_token",
            "pos_embed",
            "patch_embed.proj.bias",
            "register_tokens",
            "norm.weight",
            "blocks.11.norm1.weight",
        ];
        for layout in
            [DinoLayout::Official, DinoLayout::Timm, DinoLayout::Transformers(""), DinoLayout::Transformers("dinov2.")]
        {
            for key in official {
                let part = |name: &str| name.split('.').next().map(str::to_owned);
                assert_eq!(part(&layout.official(&layout.key(key))), part(key), "{layout:?}");
            }
        }
        assert_eq!(
            DinoLayout::Transformers("").key("blocks.3.attn.q.weight"),
            "encoder.layer.3.attention.attention.query.weight"
        );
        assert_eq!(
            DinoLayout::Transformers("dinov2.").key("blocks.0.ls2.gamma"),
            "dinov2.encoder.layer.0.layer_scale2.lambda1"
        );
        assert_eq!(
            DinoLayout::TransformersModule("").key("blocks.0.attn.proj.bias"),
            "encoder.layer.0.attention.o_proj.bias"
        );
        assert_eq!(DinoLayout::Timm.key("register_tokens"), "reg_token");
    }
}
