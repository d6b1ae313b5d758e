//! DINOv2 with register tokens. Its features of a frame are the condition of the frame's partner.
//!
//! ```text
//! resized = bilinear(frame)                                    252×448, values in [0, 1]
//! x = [cls + position₀ ; registers ; conv(resized) + positions] conv: p×p stride p, with bias
//! per block: x += γ₁·attention(norm₁(x)),  x += γ₂·fc2(gelu(fc1(norm₂(x))))
//! out = norm(x)
//! ```
//!
//! Positions are stored on a square grid; it is resized to the patch grid bicubically with antialiasing, once at load.
//!
//! Source: "DINOv2" (TMLR 2024) and "Vision Transformers Need Registers" (ICLR 2024).

use std::path::Path;

use streamsplat_kernels::attention::{Shape, Windows};
use streamsplat_kernels::feed_forward::FeedForward;
use streamsplat_kernels::gemm::Precision;
use streamsplat_kernels::patches::patches;
use streamsplat_kernels::{Level, resize};
use tracing::info_span;

use crate::checkpoint::{Checkpoint, Weights};
use crate::config::{self, Settings};
use crate::error::check_input;
use crate::layers::{Bias, HEAD, LayerNorm, Linear, Workspace, Workspaces, add, attend_kept, sized};
use crate::reuse::{BlockCache, PartCache, Pass, Rows};
use crate::{DinoConfig, DinoFeatures, DinoLayout, LoadOptions, ModelError};

/// DINOv2 with its weights.
pub struct Dino {
    config: DinoConfig,
    options: LoadOptions,
    patch_embed: Linear,
    /// Class token with its position, then the registers, which have no position.
    first: Vec<f32>,
    /// Positions of the patches, `[M, C]`.
    position: Vec<f32>,
    blocks: Vec<DinoBlock>,
    norm: LayerNorm,
    workspaces: Workspaces,
}

struct DinoBlock {
    norm1: LayerNorm,
    qkv: Linear,
    proj: Linear,
    ls1: Vec<f32>,
    norm2: LayerNorm,
    fc1: Linear,
    fc2: Linear,
    ls2: Vec<f32>,
}

impl std::fmt::Debug for Dino {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Dino").field("config", &self.config).field("options", &self.options).finish_non_exhaustive()
    }
}

impl Dino {
    /// Loads a file of DINOv2 in any [`DinoLayout`], from safetensors or `torch.save`. A JSON file of the same name may
    /// state another input size (`resized_to`).
    ///
    /// # Errors
    /// As [`crate::Network::open`].
    pub fn open(path: impl AsRef<Path>, options: &LoadOptions) -> Result<Dino, ModelError> {
        let checkpoint = Checkpoint::open(path.as_ref())?;
        let settings = Settings::beside(path.as_ref())?;
        Self::load(&checkpoint, &settings, options)
    }

    fn load(checkpoint: &Checkpoint, settings: &Settings, options: &LoadOptions) -> Result<Dino, ModelError> {
        let _span = info_span!("load").entered();
        let layout = DinoLayout::of(checkpoint).ok_or_else(|| not_dino(checkpoint))?;
        let weights = &Weights::new(checkpoint, "").on(options.level).laid_out(layout);
        let config = DinoConfig::derive(weights, settings)?;
        let (d, p, side) = (config.embed_dim, config.patch_size, config.pos_embed_grid);
        let of_class = layout.class_positions();
        let positions = weights.vector("pos_embed", &[1, of_class + side * side, d])?;
        let (class_position, grid) = positions.split_at(of_class * d);
        let mut first = weights.vector("cls_token", &[1, 1, d])?;
        if !class_position.is_empty() {
            add(&mut first, class_position);
        }
        if config.register_tokens > 0 {
            first.extend_from_slice(&weights.read("register_tokens", &[1, config.register_tokens, d])?);
        }
        let kernel = weights.read("patch_embed.proj.weight", &[d, 3, p, p])?;
        let bias = weights.vector("patch_embed.proj.bias", &[d])?;
        let [rows, columns] = config.grid();
        let mut position = vec![0.0; rows * columns * d];
        resize::bicubic_antialiased(options.level, grid, side, side, d, rows, columns, &mut position);
        let inner = weights.held_in(options.precision.of_blocks());
        let blocks = (0..config.depth)
            .map(|i| DinoBlock::load(&inner.at(format_args!("blocks.{i}")), &config))
            .collect::<Result<_, _>>()?;
        Ok(Dino {
            patch_embed: Linear::new(options.level, Precision::F32, &kernel, Some(bias), d, 3 * p * p),
            first,
            position,
            blocks,
            norm: LayerNorm::load(weights, "norm", d)?,
            workspaces: Workspaces::default(),
            config,
            options: *options,
        })
    }

    /// The network's sizes.
    pub fn config(&self) -> &DinoConfig {
        &self.config
    }

    /// Bytes its weights take in memory.
    pub fn bytes(&self) -> usize {
        let tables = 4 * (self.first.len() + self.position.len());
        let blocks: usize = self.blocks.iter().map(DinoBlock::bytes).sum();
        self.patch_embed.bytes() + tables + blocks + self.norm.bytes()
    }

    /// Frees the memory that is kept for intermediate results of the next call. No result depends on it.
    pub fn release(&self) {
        self.workspaces.release();
    }

    /// Features of a frame `rgb [3, height, width]` in [0, 1], of any size.
    ///
    /// # Errors
    /// When the frame has no pixels, has another number of values than its size, or holds values that are not finite.
    pub fn features(&self, rgb: &[f32], size: [usize; 2]) -> Result<DinoFeatures, ModelError> {
        self.compute(rgb, size, None)
    }

    /// [`Dino::features`] for some tokens, where a cache holds the others.
    pub(crate) fn compute(
        &self,
        rgb: &[f32],
        [height, width]: [usize; 2],
        cache: Option<&mut PartCache>,
    ) -> Result<DinoFeatures, ModelError> {
        let area = height.saturating_mul(width);
        if area == 0 {
            return Err(ModelError::Input {
                input: "frame".to_owned(),
                expected: "at least one pixel".to_owned(),
                found: format!("{height}×{width}"),
            });
        }
        check_input("frame", rgb, area.saturating_mul(3), &format!("[3, {height}, {width}]"))?;
        let _span = info_span!("dinov2").entered();
        let (level, d, p) = (self.options.level, self.config.embed_dim, self.config.patch_size);
        let [to_height, to_width] = self.config.resized_to;
        let to_area = to_height * to_width;
        let mut resized = vec![0.0; 3 * to_area];
        resize::bilinear(level, rgb, 3, height, width, to_height, to_width, &mut resized);

        let planes = [&resized[..to_area], &resized[to_area..2 * to_area], &resized[2 * to_area..]];
        let mut rows = vec![0.0; 3 * to_area];
        patches(&planes, to_height, to_width, p, &mut rows);
        let mut x = self.first.clone();
        let start = x.len();
        x.resize(start + self.position.len(), 0.0);
        self.patch_embed.apply(level, &rows, &mut x[start..]);
        add(&mut x[start..], &self.position);

        let mut out = self.workspaces.lend(|work| {
            let (mut pass, mut rows) = Pass::begin(level, cache, false, &x, std::mem::take(&mut work.tokens));
            for (i, block) in self.blocks.iter().enumerate() {
                let kept = pass.admit(i, Some(Windows::Full), &mut rows);
                block.apply(level, &mut rows, kept, work);
            }
            let mut normed = vec![0.0; rows.x.len()];
            self.norm.apply(level, &rows.x, &mut normed);
            work.tokens = rows.x;
            pass.finish(rows.at, normed)
        });
        Ok(DinoFeatures { resized, patch_tokens: out.split_off(start), cls_token: out[..d].to_vec() })
    }
}

/// The error of a file that is not DINOv2.
fn not_dino(checkpoint: &Checkpoint) -> ModelError {
    ModelError::Format {
        file: checkpoint.file().to_owned(),
        reason: format!(
            "not DINOv2: expected patch_embed.proj.weight and cls_token (official, timm) or embeddings.patch_embeddings.projection.weight \
             (transformers){}",
            config::hint(checkpoint)
        ),
    }
}

impl DinoBlock {
    fn load(weights: &Weights<'_>, config: &DinoConfig) -> Result<DinoBlock, ModelError> {
        let (d, hidden) = (config.embed_dim, config.mlp_dim);
        Ok(DinoBlock {
            norm1: LayerNorm::load(weights, "norm1", d)?,
            qkv: match weights.layout() {
                DinoLayout::Transformers(_) | DinoLayout::TransformersModule(_) => {
                    Linear::load_joined(weights, &["attn.q", "attn.k", "attn.v"], d, d)?
                }
                DinoLayout::Official | DinoLayout::Timm => Linear::load(weights, "attn.qkv", 3 * d, d, Bias::Yes)?,
            },
            proj: Linear::load(weights, "attn.proj", d, d, Bias::Yes)?,
            ls1: weights.vector("ls1.gamma", &[d])?,
            norm2: LayerNorm::load(weights, "norm2", d)?,
            fc1: Linear::load(weights, "mlp.fc1", hidden, d, Bias::Yes)?,
            fc2: Linear::load(weights, "mlp.fc2", d, hidden, Bias::Yes)?,
            ls2: weights.vector("ls2.gamma", &[d])?,
        })
    }

    /// Applies the block to `rows`. `kept` is the block's cache, where there is one.
    fn apply(&self, level: Level, rows: &mut Rows, kept: Option<&mut BlockCache>, work: &mut Workspace) {
        let (d, x) = (self.proj.n(), &mut rows.x[..]);
        let qkv = sized(&mut work.projected, 3 * x.len());
        self.qkv.heads_of_normed(level, self.norm1.norm(), x, qkv);
        let mixed = sized(&mut work.mixed, x.len());
        let shape = Shape { heads: d / HEAD, width: HEAD, windows: Windows::Full };
        attend_kept(
            self.proj.precision(),
            level,
            shape,
            rows.at.as_deref(),
            qkv,
            kept.map(|kept| &mut kept.own),
            mixed,
        );
        self.proj.accumulate_scaled(level, mixed, &self.ls1, x);

        let mlp = FeedForward {
            norm: self.norm2.norm(),
            expand: self.fc1.weights(),
            hidden: self.fc1.epilogue().gelu(),
            contract: self.fc2.weights(),
            residual: self.fc2.epilogue().gamma(&self.ls2).residual(),
        };
        mlp.accumulate(level, x);
    }

    fn bytes(&self) -> usize {
        let layers = self.qkv.bytes() + self.proj.bytes() + self.fc1.bytes() + self.fc2.bytes();
        layers + self.norm1.bytes() + self.norm2.bytes() + 4 * (self.ls1.len() + self.ls2.len())
    }
}
