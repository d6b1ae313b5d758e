//! The StreamSplat network as the stream's reconstructor, and the checkpoint inside the library.

use std::path::Path;
use std::sync::Arc;

use streamsplat_model::reuse::{Saving, Tokens};
use streamsplat_model::zero_output::ZeroOutput;
use streamsplat_model::{
    self as model, Dino, DinoSession, Embedding, FrameInput, LoadOptions, ModelError, Network, Sampling, Side,
    StaticGaussians, StaticPosition,
};

use super::reconstructor::{Motion, Session, Tiling};
use super::{EngineError, Reconstructor};

/// The small checkpoint that is part of the library: a safetensors file in the official layout.
pub static EMBEDDED_CHECKPOINT: &[u8] = include_bytes!("../../lite/lite.safetensors");
/// The configuration of [`EMBEDDED_CHECKPOINT`], as far as shapes do not determine it.
pub const EMBEDDED_CONFIG: &str = include_str!("../../lite/lite.json");

/// A network. If its condition is DINOv2 features, with DINOv2; if it is the other frame's embedding, without.
pub(super) struct Conditioned {
    network: Arc<Network>,
    dino: Option<Arc<Dino>>,
}

impl Conditioned {
    /// Loads the network of `source` (`None`: of the library), with DINOv2 from `dinov2` where it is required.
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
            return Ok(Self { network: Arc::new(network), dino: None });
        }
        let dino = Dino::open(dinov2.ok_or(EngineError::Condition)?, options)?;
        let (expected, found) = (network.config().condition_dim, dino.config().embed_dim);
        if expected != found {
            return Err(EngineError::ConditionChannels { expected, found });
        }
        if dino.config().register_tokens == 0 {
            return Err(EngineError::ConditionRegisters);
        }
        Ok(Self { network: Arc::new(network), dino: Some(Arc::new(dino)) })
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
        Some(Arc::new(Self { network: Arc::new(network), dino: self.dino.clone() }))
    }

    fn ignores_depth(&self) -> bool {
        self.network.config().ignores_depth
    }

    fn zero_output(&self) -> &[ZeroOutput] {
        match self.network.options().compute_zero_output {
            true => &[],
            false => self.network.zero_output(),
        }
    }

    fn session(self: Arc<Self>, saving: Option<Saving>) -> Box<dyn Session> {
        Box::new(Stages {
            network: model::Session::new(self.network.clone(), saving),
            dino: self.dino.clone().map(|dino| DinoSession::new(dino, saving)),
        })
    }
}

/// A session of the network, and one of DINOv2.
struct Stages {
    network: model::Session<Arc<Network>>,
    dino: Option<DinoSession<Arc<Dino>>>,
}

impl Session for Stages {
    fn embed(&mut self, frame: &FrameInput<'_>) -> Result<Embedding, ModelError> {
        self.network.embed(frame)
    }

    fn upsample(&mut self, embedding: &Embedding) -> Result<Vec<f32>, ModelError> {
        self.network.upsample_static(&embedding.h)
    }

    fn gaussians(&mut self, tokens: &[f32], sampling: &Sampling) -> Result<StaticGaussians, ModelError> {
        self.network.static_head(tokens, sampling)
    }

    fn computes_parts(&self) -> bool {
        self.network.computes_parts()
    }

    fn embed_part(&mut self, frame: &FrameInput<'_>, part: &[u32]) -> Result<Embedding, ModelError> {
        self.network.embed_part(frame, part)
    }

    fn upsample_part(&mut self, embedding: &Embedding, part: &[u32]) -> Result<Vec<f32>, ModelError> {
        self.network.upsample_static_part(&embedding.h, part)
    }

    fn gaussians_part(&mut self, tokens: &[f32], part: &[u32]) -> Result<StaticGaussians, ModelError> {
        self.network.static_head_part(tokens, part)
    }

    fn draws_positions(&self) -> bool {
        self.network.network().config().static_position == StaticPosition::TruncatedNormal
    }

    fn reads_condition(&self) -> bool {
        self.dino.is_some()
    }

    fn condition(&mut self, frame: &FrameInput<'_>) -> Result<Option<Vec<f32>>, ModelError> {
        let resolution = self.network.network().config().resolution;
        let features = self.dino.as_mut().map(|dino| dino.features(frame.rgb, resolution));
        Ok(features.transpose()?.map(|f| f.patch_tokens))
    }

    fn decode(&mut self, a: &Side<'_>, b: &Side<'_>) -> Result<[Vec<f32>; 2], ModelError> {
        self.network.decode(a, b)
    }

    fn upsample_motion(&mut self, place: usize, d: &[f32]) -> Result<Vec<f32>, ModelError> {
        self.network.upsample_deformation(place, d)
    }

    fn motion(&mut self, place: usize, static_tokens: &[f32], motion_tokens: &[f32]) -> Result<Motion, ModelError> {
        self.network.deformation_head(place, static_tokens, motion_tokens)
    }

    fn tokens(&self) -> Option<Vec<(&'static str, Tokens)>> {
        let mut parts = self.network.cache()?.tokens().to_vec();
        parts.extend(self.dino.as_ref().and_then(DinoSession::tokens).map(|tokens| ("dinov2", tokens)));
        Some(parts)
    }

    fn forget(&mut self) {
        self.network.forget();
        self.dino.iter_mut().for_each(DinoSession::forget);
    }

    fn release(&self) {
        self.network.network().release();
        self.dino.iter().for_each(|dino| dino.dino().release());
    }
}
