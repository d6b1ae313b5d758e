//! The StreamSplat network as the stream's reconstructor, and the checkpoint inside the library.

use streamsplat_model::{Embedding, FrameInput, ModelError, Network, Sampling, Side, StaticGaussians, StaticPosition};

use super::Reconstructor;
use super::reconstructor::Motion;

/// The small checkpoint that is part of the library: a safetensors file in the official layout.
pub static EMBEDDED_CHECKPOINT: &[u8] = include_bytes!("../../../fixtures/lite/lite.safetensors");
/// The configuration of [`EMBEDDED_CHECKPOINT`]: what shapes cannot say.
pub const EMBEDDED_CONFIG: &str = include_str!("../../../fixtures/lite/lite.json");

/// A network whose condition is the other frame's embedding.
#[derive(Debug)]
pub(super) struct SelfConditioned(pub(super) Network);

impl Reconstructor for SelfConditioned {
    fn resolution(&self) -> [usize; 2] {
        self.0.config().resolution
    }

    fn embed(&self, frame: &FrameInput<'_>) -> Result<Embedding, ModelError> {
        self.0.embed(frame)
    }

    fn upsample(&self, embedding: &Embedding) -> Result<Vec<f32>, ModelError> {
        self.0.upsample_static(&embedding.h)
    }

    fn gaussians(&self, tokens: &[f32], sampling: &Sampling) -> Result<StaticGaussians, ModelError> {
        self.0.static_head(tokens, sampling)
    }

    fn draws_positions(&self) -> bool {
        self.0.config().static_position == StaticPosition::TruncatedNormal
    }

    fn reads_condition(&self) -> bool {
        false
    }

    fn condition(&self, _: &FrameInput<'_>) -> Result<Option<Vec<f32>>, ModelError> {
        Ok(None)
    }

    fn decode(&self, a: &Side<'_>, b: &Side<'_>) -> Result<[Vec<f32>; 2], ModelError> {
        self.0.decode(a, b)
    }

    fn upsample_motion(&self, d: &[f32]) -> Result<Vec<f32>, ModelError> {
        self.0.upsample_deformation(d)
    }

    fn motion(&self, static_tokens: &[f32], motion_tokens: &[f32]) -> Result<Motion, ModelError> {
        self.0.deformation_head(static_tokens, motion_tokens)
    }
}
