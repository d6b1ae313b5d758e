//! The sizes of a network.

mod derive;
mod json;

pub(crate) use derive::{hint, prefix};
pub(crate) use json::Settings;

/// Layer that computes the position offset of static Gaussians.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StaticPosition {
    /// `gs_layer.xyz_static`: `tanh`.
    Tanh,
    /// `mix_layer.xyz_static_{mean,scale}`: a truncated normal.
    TruncatedNormal,
}

/// The sizes of a StreamSplat network.
///
/// Everything but `resolution`, `upsampler_window`, `encoder_window`, `use_dino` and `ignores_depth` follows from the
/// tensors' shapes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Config {
    /// Channels of a token, `D`: a multiple of 64.
    pub hidden_dim: usize,
    /// Blocks of the static encoder.
    pub encoder_layers: usize,
    /// Blocks of the dynamic decoder.
    pub decoder_layers: usize,
    /// Height and width of the input frames.
    pub resolution: [usize; 2],
    /// Side of a patch, `p`.
    pub patch_size: usize,
    /// Tokens per window in the upsamplers' attention.
    pub upsampler_window: usize,
    /// Channels after each of the two upsampling stages: multiples of 64.
    pub upsampler_widths: [usize; 2],
    /// Tokens per window in the encoder's attention and the decoder's self-attention; `None`: to all tokens.
    pub encoder_window: Option<usize>,
    /// True if frames are conditioned on the other frame's DINOv2 features; otherwise on its embedding.
    pub use_dino: bool,
    /// Channels of the condition.
    pub condition_dim: usize,
    /// Kind of the static head's position.
    pub static_position: StaticPosition,
    /// True if the weights ignore the depth channel of the input: any depth results in the same Gaussians.
    pub ignores_depth: bool,
}

impl Config {
    /// Rows and columns of the patch grid.
    pub fn grid(&self) -> [usize; 2] {
        self.resolution.map(|side| side / self.patch_size)
    }

    /// Tokens per frame, `N`.
    pub fn tokens(&self) -> usize {
        let [rows, columns] = self.grid();
        rows * columns
    }

    /// Rows and columns of the Gaussian grid: four times the patch grid.
    pub fn gaussian_grid(&self) -> [usize; 2] {
        self.grid().map(|side| 4 * side)
    }

    /// Gaussians per frame, `16 N`.
    pub fn gaussians(&self) -> usize {
        16 * self.tokens()
    }

    /// Channels of an upsampled token, `d`.
    pub fn gaussian_dim(&self) -> usize {
        self.upsampler_widths[1]
    }
}

/// The sizes of a DINOv2 vision transformer with register tokens.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DinoConfig {
    /// Channels of a token: a multiple of 64.
    pub embed_dim: usize,
    /// Number of blocks.
    pub depth: usize,
    /// Hidden channels of the feed-forward layers.
    pub mlp_dim: usize,
    /// Side of a patch.
    pub patch_size: usize,
    /// Register tokens between the class token and the patches.
    pub register_tokens: usize,
    /// Side of the stored position grid.
    pub pos_embed_grid: usize,
    /// Height and width a frame is resized to.
    pub resized_to: [usize; 2],
}

impl DinoConfig {
    /// Rows and columns of the patch grid.
    pub fn grid(&self) -> [usize; 2] {
        self.resized_to.map(|side| side / self.patch_size)
    }

    /// Patch tokens per frame.
    pub fn patches(&self) -> usize {
        let [rows, columns] = self.grid();
        rows * columns
    }
}
