//! The whole network, loaded.

use std::path::Path;

use streamsplat_kernels::Level;
use tracing::info_span;

use crate::checkpoint::{Checkpoint, Storage, Weights};
use crate::config::{self, Settings};
use crate::decoder::Decoder;
use crate::deformation_head::DeformationHead;
use crate::encoder::Encoder;
use crate::error::check_input;
use crate::layers::{Workspace, Workspaces};
use crate::reuse::{Memory, Saving};
use crate::silent::{Silent, silent, upsamplers_are_local};
use crate::static_head::StaticHead;
use crate::upsampler::Upsampler;
use crate::{
    Config, Deformation, Embedding, FrameInput, LoadOptions, ModelError, Sampling, Side, StaticFrame, StaticGaussians,
    StaticPosition, keys,
};

/// A StreamSplat network with its weights.
///
/// Its methods run on the threads of the rayon pool they are called in; the results do not depend on how many there are.
/// Between them they recompute nothing: a frame is embedded once, and a pair costs one decoder call and two upsamplings.
pub struct Network {
    pub(crate) config: Config,
    pub(crate) options: LoadOptions,
    pub(crate) silent: Vec<Silent>,
    /// True if no block of an upsampler mixes tokens.
    pub(crate) upsamplers_are_local: bool,
    pub(crate) workspaces: Workspaces,
    pub(crate) encoder: Encoder,
    pub(crate) static_upsampler: Upsampler,
    pub(crate) static_head: StaticHead,
    pub(crate) decoder: Decoder,
    pub(crate) deformation_upsampler: Upsampler,
    pub(crate) deformation_head: DeformationHead,
}

impl std::fmt::Debug for Network {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Network").field("config", &self.config).field("options", &self.options).finish_non_exhaustive()
    }
}

impl Network {
    /// Loads the checkpoint at `path` (safetensors, official layout); what shapes cannot say stands in the JSON file of the
    /// same name beside it, or has the published values.
    ///
    /// # Errors
    /// When a file cannot be read or is malformed, when a tensor is missing, has another shape than the others need or
    /// holds values that are not finite, and when the configuration contradicts the tensors.
    pub fn open(path: impl AsRef<Path>, options: &LoadOptions) -> Result<Network, ModelError> {
        let checkpoint = Checkpoint::open(path.as_ref())?;
        let settings = Settings::beside(path.as_ref())?;
        Self::load(&checkpoint, &settings, options)
    }

    /// Loads a checkpoint in memory with the text of its JSON file.
    ///
    /// # Errors
    /// As [`Network::open`].
    pub fn from_parts(
        bytes: impl Into<Storage>,
        config_json: &str,
        options: &LoadOptions,
    ) -> Result<Network, ModelError> {
        let checkpoint = Checkpoint::from_storage(bytes, "the model in memory")?;
        let settings = Settings::parse(config_json, "the configuration in memory")?;
        Self::load(&checkpoint, &settings, options)
    }

    pub(crate) fn load(
        checkpoint: &Checkpoint,
        settings: &Settings,
        options: &LoadOptions,
    ) -> Result<Network, ModelError> {
        let _span = info_span!("load").entered();
        let mut weights = Weights::new(checkpoint, config::prefix(checkpoint)?).on(options.level);
        let config = Config::derive(&weights, settings)?;
        let silent = silent(&weights, &config);
        let upsamplers_are_local = upsamplers_are_local(&weights);
        if options.compute_silent {
            weights = weights.with_silent();
        }
        Ok(Network {
            encoder: Encoder::load(&weights.at(keys::ENCODER), &config, options.precision)?,
            static_upsampler: Upsampler::load(&weights.at(keys::STATIC_UPSAMPLER), &config, options.precision)?,
            static_head: StaticHead::load(&weights.at(keys::STATIC_HEAD), &config)?,
            decoder: Decoder::load(&weights.at(keys::DECODER), &config, options.precision)?,
            deformation_upsampler: Upsampler::load(
                &weights.at(keys::DEFORMATION_UPSAMPLER),
                &config,
                options.precision,
            )?,
            deformation_head: DeformationHead::load(&weights, &config)?,
            config,
            options: *options,
            silent,
            upsamplers_are_local,
            workspaces: Workspaces::default(),
        })
    }

    /// The network's sizes.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// Options it was loaded with.
    pub fn options(&self) -> &LoadOptions {
        &self.options
    }

    /// Its residual branches that add nothing, by part. They are left out unless [`LoadOptions::compute_silent`] says otherwise.
    pub fn silent(&self) -> &[Silent] {
        &self.silent
    }

    /// Bytes its weights take in memory.
    pub fn bytes(&self) -> usize {
        let upsamplers = self.static_upsampler.bytes() + self.deformation_upsampler.bytes();
        let heads = self.static_head.bytes() + self.deformation_head.bytes();
        self.encoder.bytes() + upsamplers + heads + self.decoder.bytes()
    }

    fn level(&self) -> Level {
        self.options.level
    }

    /// The embedding of a frame: [`Network::tokenize`], then [`Network::encode`].
    ///
    /// # Errors
    /// When the frame is not of the model's resolution or holds values that are not finite.
    pub fn embed(&self, frame: &FrameInput<'_>) -> Result<Embedding, ModelError> {
        self.encode(&self.tokenize(frame)?)
    }

    /// The convolution of a frame's pixels and depth, `[N, D]`, before the position code.
    ///
    /// # Errors
    /// As [`Network::embed`].
    pub fn tokenize(&self, frame: &FrameInput<'_>) -> Result<Vec<f32>, ModelError> {
        let [height, width] = self.config.resolution;
        let area = height * width;
        check_input("frame", frame.rgb, 3 * area, &format!("[3, {height}, {width}]"))?;
        let zeros;
        let depth = match frame.depth {
            Some(depth) => {
                check_input("depth", depth, area, &format!("[{height}, {width}]"))?;
                depth
            }
            None => {
                zeros = vec![0.0; area];
                &zeros
            }
        };
        let _span = info_span!("tokenize").entered();
        Ok(self.encoder.tokenize(self.level(), &self.config, frame.rgb, depth))
    }

    /// The embedding of a frame's tokens.
    ///
    /// # Errors
    /// When they are not `[N, D]` finite values.
    pub fn encode(&self, tokens: &[f32]) -> Result<Embedding, ModelError> {
        self.check_tokens("tokens", tokens)?;
        let _span = info_span!("encoder").entered();
        let encode = |work: &mut Workspace| self.encoder.encode(self.level(), &self.config, tokens, work);
        Ok(Embedding { h: self.workspaces.lend(encode) })
    }

    /// The Gaussians of a frame at its own time: [`Network::upsample_static`], then [`Network::static_head`].
    ///
    /// # Errors
    /// When the embedding is not one of this network.
    pub fn static_gaussians(&self, embedding: &Embedding, sampling: &Sampling) -> Result<StaticFrame, ModelError> {
        let tokens = self.upsample_static(&embedding.h)?;
        let gaussians = self.static_head(&tokens, sampling)?;
        Ok(StaticFrame { tokens, gaussians })
    }

    /// The static upsampler: `h [N, D]` to `[16N, d]`.
    ///
    /// # Errors
    /// When `h` is not `[N, D]` finite values.
    pub fn upsample_static(&self, h: &[f32]) -> Result<Vec<f32>, ModelError> {
        self.check_tokens("h", h)?;
        let _span = info_span!("upsampler", kind = "static").entered();
        Ok(self.workspaces.lend(|work| self.static_upsampler.apply(self.level(), &self.config, h, work)))
    }

    /// The static head on upsampled tokens `[16N, d]`.
    ///
    /// # Errors
    /// When `tokens` is not of that size, or not finite.
    pub fn static_head(&self, tokens: &[f32], sampling: &Sampling) -> Result<StaticGaussians, ModelError> {
        self.check_upsampled("static tokens", tokens)?;
        let _span = info_span!("heads", kind = "static").entered();
        Ok(self.static_head.apply(self.level(), &self.config, tokens, *sampling))
    }

    /// The motion of the Gaussians of frames `a` (the earlier) and `b` over the interval between them:
    /// [`Network::decode`], then for each [`Network::upsample_deformation`] and [`Network::deformation_head`].
    ///
    /// # Errors
    /// When a side is not of this network, or lacks features that the network is conditioned on.
    pub fn deform(&self, a: Side<'_>, b: Side<'_>) -> Result<[Deformation; 2], ModelError> {
        let [d_a, d_b] = self.decode(&a, &b)?;
        let side = |side: Side<'_>, d: Vec<f32>| -> Result<Deformation, ModelError> {
            let tokens = self.upsample_deformation(&d)?;
            let (velocity, gamma) = self.deformation_head(side.static_tokens, &tokens)?;
            Ok(Deformation { d, tokens, velocity, gamma })
        };
        Ok([side(a, d_a)?, side(b, d_b)?])
    }

    /// The decoder: `d_a` and `d_b`, each `[N, D]`. Static tokens are not looked at.
    ///
    /// # Errors
    /// As [`Network::deform`].
    pub fn decode(&self, a: &Side<'_>, b: &Side<'_>) -> Result<[Vec<f32>; 2], ModelError> {
        self.check_tokens("h of the first frame", a.h)?;
        self.check_tokens("h of the second frame", b.h)?;
        let features = [self.features(a, "first")?, self.features(b, "second")?];
        let _span = info_span!("decoder").entered();
        Ok(self.workspaces.lend(|work| self.decoder.apply(self.level(), &self.config, [a.h, b.h], features, work)))
    }

    /// The deformation upsampler: `d [N, D]` of one frame to `[16N, d]`.
    ///
    /// # Errors
    /// When `d` is not `[N, D]` finite values.
    pub fn upsample_deformation(&self, d: &[f32]) -> Result<Vec<f32>, ModelError> {
        self.check_tokens("d", d)?;
        let _span = info_span!("upsampler", kind = "deformation").entered();
        Ok(self.workspaces.lend(|work| self.deformation_upsampler.apply(self.level(), &self.config, d, work)))
    }

    /// The deformation head on a frame's static and deformation tokens, both `[16N, d]`: velocity and γ.
    ///
    /// # Errors
    /// When one is not of that size, or not finite.
    pub fn deformation_head(
        &self,
        static_tokens: &[f32],
        tokens: &[f32],
    ) -> Result<(Vec<[f32; 3]>, Vec<[f32; 2]>), ModelError> {
        self.check_upsampled("static tokens", static_tokens)?;
        self.check_upsampled("deformation tokens", tokens)?;
        let _span = info_span!("heads", kind = "deformation").entered();
        Ok(self.deformation_head.apply(self.level(), static_tokens, tokens))
    }

    /// A memory for the `*_keeping` methods; `None` when this network has nothing to keep: where every token sees all others, no
    /// part of a frame is exactly as it was.
    pub fn memory(&self, saving: Saving) -> Option<Memory> {
        Memory::new(saving, &self.config)
    }

    /// [`Network::encode`], leaving out what `memory` still holds. See [`crate::reuse`].
    ///
    /// # Errors
    /// As [`Network::encode`].
    pub fn encode_keeping(&self, tokens: &[f32], memory: &mut Memory) -> Result<Embedding, ModelError> {
        self.check_tokens("tokens", tokens)?;
        memory.begin();
        let _span = info_span!("encoder").entered();
        let (level, saving) = (self.level(), memory.saving);
        let (encoder, config, kept) = (&self.encoder, &self.config, &mut memory.encoder);
        Ok(Embedding {
            h: self.workspaces.lend(|work| encoder.encode_keeping(level, config, tokens, saving, kept, work)),
        })
    }

    /// [`Network::upsample_static`], leaving out what `memory` still holds.
    ///
    /// # Errors
    /// As [`Network::upsample_static`].
    pub fn upsample_static_keeping(&self, h: &[f32], memory: &mut Memory) -> Result<Vec<f32>, ModelError> {
        self.check_tokens("h", h)?;
        memory.begin();
        let _span = info_span!("upsampler", kind = "static").entered();
        let (level, saving) = (self.level(), (memory.saving, memory.encoder.moves()));
        let (upsampler, config, kept) = (&self.static_upsampler, &self.config, &mut memory.static_upsampler);
        Ok(self.workspaces.lend(|work| upsampler.apply_keeping(level, config, h, saving, kept, work)))
    }

    /// [`Network::static_head`] of `tokens`, the result of the last call of [`Network::upsample_static_keeping`] with this memory, leaving
    /// out what it still holds. Positions that are drawn are all drawn anew.
    ///
    /// # Errors
    /// As [`Network::static_head`].
    pub fn static_head_keeping(
        &self,
        tokens: &[f32],
        sampling: &Sampling,
        memory: &mut Memory,
    ) -> Result<StaticGaussians, ModelError> {
        let draws = self.config.static_position == StaticPosition::TruncatedNormal;
        if draws && *sampling != Sampling::Mean {
            memory.begin();
            return self.static_head(tokens, sampling);
        }
        self.check_upsampled("static tokens", tokens)?;
        memory.begin();
        let _span = info_span!("heads", kind = "static").entered();
        let (upsampler, head) = (&memory.static_upsampler, &mut memory.static_head);
        Ok(self.static_head.apply_keeping(self.level(), &self.config, tokens, upsampler, head))
    }

    /// [`Network::decode`], leaving out what `memory` still holds.
    ///
    /// # Errors
    /// As [`Network::decode`].
    pub fn decode_keeping(&self, a: &Side<'_>, b: &Side<'_>, memory: &mut Memory) -> Result<[Vec<f32>; 2], ModelError> {
        self.check_tokens("h of the first frame", a.h)?;
        self.check_tokens("h of the second frame", b.h)?;
        let features = [self.features(a, "first")?, self.features(b, "second")?];
        memory.begin();
        let _span = info_span!("decoder").entered();
        let (level, pair) = (self.level(), ([a.h, b.h], features));
        let saving = (memory.saving.of_motion(), memory.encoder.moves());
        let (decoder, config, kept) = (&self.decoder, &self.config, &mut memory.decoder);
        Ok(self.workspaces.lend(|work| decoder.apply_keeping(level, config, pair, saving, kept, work)))
    }

    /// [`Network::upsample_deformation`] of the earlier (0) or the later (1) frame of the pair, leaving out what `memory` still holds.
    ///
    /// # Errors
    /// As [`Network::upsample_deformation`].
    ///
    /// # Panics
    /// When `place` is neither 0 nor 1.
    pub fn upsample_deformation_keeping(
        &self,
        place: usize,
        d: &[f32],
        memory: &mut Memory,
    ) -> Result<Vec<f32>, ModelError> {
        self.check_tokens("d", d)?;
        memory.begin();
        let _span = info_span!("upsampler", kind = "deformation").entered();
        let saving = (memory.saving.of_motion(), memory.encoder.moves());
        let (level, (kept, _)) = (self.level(), &mut memory.deformation[place]);
        let (upsampler, config) = (&self.deformation_upsampler, &self.config);
        Ok(self.workspaces.lend(|work| upsampler.apply_keeping(level, config, d, saving, kept, work)))
    }

    /// [`Network::deformation_head`] of `tokens`, the result of the last call of [`Network::upsample_deformation_keeping`] for that place
    /// with this memory, leaving out what it still holds.
    ///
    /// # Errors
    /// As [`Network::deformation_head`].
    ///
    /// # Panics
    /// When `place` is neither 0 nor 1.
    pub fn deformation_head_keeping(
        &self,
        place: usize,
        static_tokens: &[f32],
        tokens: &[f32],
        memory: &mut Memory,
    ) -> Result<(Vec<[f32; 3]>, Vec<[f32; 2]>), ModelError> {
        self.check_upsampled("static tokens", static_tokens)?;
        self.check_upsampled("deformation tokens", tokens)?;
        memory.begin();
        let _span = info_span!("heads", kind = "deformation").entered();
        let (upsampler, head) = &mut memory.deformation[place];
        let level = self.level();
        Ok(self.deformation_head.apply_keeping(level, static_tokens, tokens, upsampler, head))
    }

    /// Features that the other frame is conditioned on.
    fn features<'a>(&self, side: &Side<'a>, which: &str) -> Result<&'a [f32], ModelError> {
        if !self.config.use_dino {
            return Ok(side.h);
        }
        let channels = self.config.condition_dim;
        let name = format!("condition of the {which} frame");
        let Some(features) = side.condition else {
            return Err(ModelError::Input {
                input: name,
                expected: format!("features [M, {channels}]: this model is conditioned on DINOv2"),
                found: "none".to_owned(),
            });
        };
        let most = self.decoder.longest_condition(self.config.hidden_dim);
        let rows = features.len() / channels;
        if rows == 0 || features.len() % channels != 0 || most.is_some_and(|most| rows > most) {
            let bound = most.map_or(String::new(), |most| format!(", M at most {most}"));
            return Err(ModelError::Input {
                input: name,
                expected: format!("features [M, {channels}]{bound}"),
                found: format!("{} values", features.len()),
            });
        }
        check_input(&name, features, features.len(), "")?;
        Ok(features)
    }

    fn check_tokens(&self, name: &str, values: &[f32]) -> Result<(), ModelError> {
        let (n, d) = (self.config.tokens(), self.config.hidden_dim);
        check_input(name, values, n * d, &format!("[{n}, {d}]"))
    }

    fn check_upsampled(&self, name: &str, values: &[f32]) -> Result<(), ModelError> {
        let (n, d) = (self.config.gaussians(), self.config.gaussian_dim());
        check_input(name, values, n * d, &format!("[{n}, {d}]"))
    }
}
