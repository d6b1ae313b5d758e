//! Inputs and outputs of the network, per frame and per pair of frames.

/// One key frame at the model's resolution.
#[derive(Clone, Copy, Debug)]
pub struct FrameInput<'a> {
    /// `[3, H, W]`, display-space RGB in [0, 1].
    pub rgb: &'a [f32],
    /// `[H, W]` inverse depth normalised to [0, 1] by its own minimum and maximum; zeros when absent.
    pub depth: Option<&'a [f32]>,
}

/// A frame's embedding.
#[derive(Clone, Debug, PartialEq)]
pub struct Embedding {
    /// `[N, D]`, one row per patch.
    pub h: Vec<f32>,
}

/// How the position offset of static Gaussians is drawn when the checkpoint parametrises it as a truncated normal.
///
/// Checkpoints with a plain `tanh` position have nothing to draw: both variants return the same.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Sampling {
    /// The distribution's mean parameter.
    #[default]
    Mean,
    /// One draw per Gaussian and axis, a function of (seed, frame, element index) alone.
    Sample {
        /// The run's seed.
        seed: u64,
        /// The key frame's index in the stream.
        frame: u64,
    },
}

crate::columns! {
    /// A Gaussian of one frame at the frame's own time. It has no rotation.
    StaticGaussian;
    /// Gaussians of one frame at the frame's own time, one per 2×2 pixels, row by row.
    StaticGaussians;
    /// World position (x, y, z): x in [−1, 1] left to right, y normalised inverse depth, z in [1, −1] top to bottom.
    position: [f32; 3];
    /// Standard deviations (s_x, s_z).
    scale: [f32; 2];
    /// Standard deviation along y over the mean of the other two: 1 in the model's output.
    thickness: f32 = 1.0;
    /// In [0.05, 1].
    opacity: f32;
    /// In [0, 1].
    rgb: [f32; 3];
}

/// Static reconstruction of one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct StaticFrame {
    /// `[16N, d]`: the upsampled embedding, kept because deformation reads it.
    pub tokens: Vec<f32>,
    /// The frame's Gaussians, one per token.
    pub gaussians: StaticGaussians,
}

/// One frame of a pair, as input of the dynamic decoder.
#[derive(Clone, Copy, Debug)]
pub struct Side<'a> {
    /// [`Embedding::h`] of the frame.
    pub h: &'a [f32],
    /// [`StaticFrame::tokens`] of the frame.
    pub static_tokens: &'a [f32],
    /// `[M, C]` features of *this* frame (DINOv2 patch tokens) where the model is conditioned on them, else `None`. The
    /// network passes each frame's features to the other frame.
    pub condition: Option<&'a [f32]>,
}

/// Motion of one frame's Gaussians over the pair's interval.
#[derive(Clone, Debug, PartialEq)]
pub struct Deformation {
    /// `[N, D]`: the decoder's output for this frame.
    pub d: Vec<f32>,
    /// `[16N, d]`: its upsampling.
    pub tokens: Vec<f32>,
    /// World units per interval.
    pub velocity: Vec<[f32; 3]>,
    /// (γ₀ ≥ 0, γ₁ in [0, 1]) of [`crate::motion::opacity_at`].
    pub gamma: Vec<[f32; 2]>,
}

/// DINOv2's features of a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct DinoFeatures {
    /// `[3, h, w]`: the frame at DINOv2's own resolution.
    pub resized: Vec<f32>,
    /// `[M, C]`: patch tokens after the final norm.
    pub patch_tokens: Vec<f32>,
    /// `[C]`: the class token after the final norm.
    pub cls_token: Vec<f32>,
}
