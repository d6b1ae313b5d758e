//! The whole network, loaded.

use std::path::Path;

use tracing::info_span;

use crate::checkpoint::{Checkpoint, Storage, Weights};
use crate::config::{self, Settings};
use crate::decoder::Decoder;
use crate::deformation_head::DeformationHead;
use crate::encoder::Encoder;
use crate::layers::Workspaces;
use crate::reuse::Saving;
use crate::static_head::StaticHead;
use crate::upsampler::Upsampler;
use crate::zero_output::{ZeroOutput, upsamplers_are_local, zero_output};
use crate::{Config, LoadOptions, ModelError, Session, keys};

/// A StreamSplat network with its weights.
///
/// A [`Session`] takes frames through it: [`Network::session`].
pub struct Network {
    pub(crate) config: Config,
    pub(crate) options: LoadOptions,
    pub(crate) zero_output: Vec<ZeroOutput>,
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
    /// Loads the checkpoint at `path` (safetensors, official layout). Settings that shapes do not determine come from
    /// the JSON file of the same name in the same folder, or have the published values.
    ///
    /// # Errors
    /// When a file cannot be read or is malformed, or when the configuration contradicts the tensors. When a tensor is
    /// missing, has another shape than the others need, or holds values that are not finite.
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

    fn load(checkpoint: &Checkpoint, settings: &Settings, options: &LoadOptions) -> Result<Network, ModelError> {
        let _span = info_span!("load").entered();
        let mut weights = Weights::new(checkpoint, config::prefix(checkpoint)?).on(options.level);
        let config = Config::derive(&weights, settings)?;
        let zero_output = zero_output(&weights, &config);
        let upsamplers_are_local = upsamplers_are_local(&weights);
        if options.compute_zero_output {
            weights = weights.with_zero_output();
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
            zero_output,
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

    /// Its residual branches that add nothing, by part. They are left out without [`LoadOptions::compute_zero_output`].
    pub fn zero_output(&self) -> &[ZeroOutput] {
        &self.zero_output
    }

    /// Bytes of its weights in memory.
    pub fn bytes(&self) -> usize {
        let upsamplers = self.static_upsampler.bytes() + self.deformation_upsampler.bytes();
        let heads = self.static_head.bytes() + self.deformation_head.bytes();
        self.encoder.bytes() + upsamplers + heads + self.decoder.bytes()
    }

    /// Frees the memory that is kept for intermediate results of the next call. No result depends on it.
    pub fn release(&self) {
        self.workspaces.release();
    }

    /// Returns a session. With `saving` it keeps results for the next frame of a stream: see [`crate::reuse`].
    pub fn session(&self, saving: Option<Saving>) -> Session<&Network> {
        Session::new(self, saving)
    }
}
