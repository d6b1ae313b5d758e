//! The StreamSplat network as the stream's reconstructor, and the checkpoint inside the library.

use std::path::Path;
use std::sync::Arc;

use streamsplat_model::reuse::{Memory, Saving};
use streamsplat_model::silent::Silent;
use streamsplat_model::{
    Dino, Embedding, FrameInput, LoadOptions, ModelError, Network, Sampling, Side, StaticGaussians, StaticPosition,
};

use super::reconstructor::{Motion, Tiling};
use super::{EngineError, Reconstructor};

/// The small checkpoint that is part of the library: a safetensors file in the official layout.
pub static EMBEDDED_CHECKPOINT: &[u8] = include_bytes!("../../../fixtures/lite/lite.safetensors");
/// The configuration of [`EMBEDDED_CHECKPOINT`]: what shapes cannot say.
pub const EMBEDDED_CONFIG: &str = include_str!("../../../fixtures/lite/lite.json");

/// A network, with DINOv2 where it is conditioned on that, and without where its condition is the other frame's embedding.
pub(super) struct Conditioned {
    network: Network,
    dino: Option<Arc<Dino>>,
}

impl Conditioned {
    /// The network of `source` (`None`: of the library), with DINOv2 from `dinov2` where it needs that.
    pub(super) fn load(
        source: Option<&Path>,
        dinov2: Option<&Path>,
        options: &LoadOptions,
    ) -> Result<Self, EngineError> {
        let network = match source {
            Some(checkpoint) => Network::open(checkpoint, options)?,
            None => Network::from_parts(EMBEDDED_CHECKPOINT, EMBEDDED_CONFIG, options)?,
        };
        if !network.config().use_dino {
            return Ok(Self { network, dino: None });
        }
        let dino = Dino::open(dinov2.ok_or(EngineError::Condition)?, options)?;
        let (expected, found) = (network.config().condition_dim, dino.config().embed_dim);
        if expected != found {
            return Err(EngineError::ConditionChannels { expected, found });
        }
        Ok(Self { network, dino: Some(Arc::new(dino)) })
    }
}

impl Reconstructor for Conditioned {
    fn resolution(&self) -> [usize; 2] {
        self.network.config().resolution
    }

    fn tiling(&self) -> Option<Tiling> {
        let patch = self.network.config().patch_size;
        Some(Tiling { patch, cells: 4, partial: self.network.takes_part_of_its_grid() && self.dino.is_none() })
    }

    fn at(&self, resolution: [usize; 2]) -> Option<Arc<dyn Reconstructor>> {
        let patch = self.network.config().patch_size;
        let network = self.network.on_grid(resolution.map(|side| side / patch))?;
        Some(Arc::new(Self { network, dino: self.dino.clone() }))
    }

    fn embed(&self, frame: &FrameInput<'_>) -> Result<Embedding, ModelError> {
        self.network.embed(frame)
    }

    fn upsample(&self, embedding: &Embedding) -> Result<Vec<f32>, ModelError> {
        self.network.upsample_static(&embedding.h)
    }

    fn gaussians(&self, tokens: &[f32], sampling: &Sampling) -> Result<StaticGaussians, ModelError> {
        self.network.static_head(tokens, sampling)
    }

    fn draws_positions(&self) -> bool {
        self.network.config().static_position == StaticPosition::TruncatedNormal
    }

    fn ignores_depth(&self) -> bool {
        self.network.config().ignores_depth
    }

    fn reads_condition(&self) -> bool {
        self.dino.is_some()
    }

    fn condition(&self, frame: &FrameInput<'_>) -> Result<Option<Vec<f32>>, ModelError> {
        let features = self.dino.as_ref().map(|dino| dino.features(frame.rgb, self.resolution()));
        Ok(features.transpose()?.map(|f| f.patch_tokens))
    }

    fn decode(&self, a: &Side<'_>, b: &Side<'_>) -> Result<[Vec<f32>; 2], ModelError> {
        self.network.decode(a, b)
    }

    fn upsample_motion(&self, d: &[f32]) -> Result<Vec<f32>, ModelError> {
        self.network.upsample_deformation(d)
    }

    fn motion(&self, static_tokens: &[f32], motion_tokens: &[f32]) -> Result<Motion, ModelError> {
        self.network.deformation_head(static_tokens, motion_tokens)
    }

    fn silent(&self) -> &[Silent] {
        match self.network.options().compute_silent {
            true => &[],
            false => self.network.silent(),
        }
    }

    fn memory(&self, saving: Saving) -> Option<Memory> {
        self.network.memory(saving)
    }

    fn embed_keeping(&self, frame: &FrameInput<'_>, memory: &mut Memory) -> Result<Embedding, ModelError> {
        self.network.encode_keeping(&self.network.tokenize(frame)?, memory)
    }

    fn upsample_keeping(&self, embedding: &Embedding, memory: &mut Memory) -> Result<Vec<f32>, ModelError> {
        self.network.upsample_static_keeping(&embedding.h, memory)
    }

    fn gaussians_keeping(
        &self,
        tokens: &[f32],
        sampling: &Sampling,
        memory: &mut Memory,
    ) -> Result<StaticGaussians, ModelError> {
        self.network.static_head_keeping(tokens, sampling, memory)
    }

    fn decode_keeping(&self, a: &Side<'_>, b: &Side<'_>, memory: &mut Memory) -> Result<[Vec<f32>; 2], ModelError> {
        self.network.decode_keeping(a, b, memory)
    }

    fn upsample_motion_keeping(&self, place: usize, d: &[f32], memory: &mut Memory) -> Result<Vec<f32>, ModelError> {
        self.network.upsample_deformation_keeping(place, d, memory)
    }

    fn motion_keeping(
        &self,
        place: usize,
        static_tokens: &[f32],
        motion_tokens: &[f32],
        memory: &mut Memory,
    ) -> Result<Motion, ModelError> {
        self.network.deformation_head_keeping(place, static_tokens, motion_tokens, memory)
    }
}
