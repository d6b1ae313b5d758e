//! Sessions: frames pass through the network stage by stage.

use std::borrow::Borrow;

use tracing::info_span;

use crate::error::check_input;
use crate::reuse::{Cache, Saving};
use crate::upsampler::cells;
use crate::{
    Deformation, Embedding, FrameInput, ModelError, Network, Sampling, Side, StaticFrame, StaticGaussian,
    StaticGaussians, StaticPosition,
};

/// A session of a network, for single frames or, with a [`Cache`], for the frames of one stream in order.
///
/// Its methods run on the threads of the current rayon pool; the results do not depend on their number. No stage
/// repeats the work of another: a frame is embedded once, and a pair costs one decoder call and two upsamplings.
#[derive(Debug)]
pub struct Session<N> {
    network: N,
    cache: Option<Cache>,
}

impl<N: Borrow<Network>> Session<N> {
    /// Returns a session of `network` with an empty cache. There is no cache without `saving`, nor where this network
    /// has nothing to keep: where every token attends to all others, no result is exactly as before.
    pub fn new(network: N, saving: Option<Saving>) -> Session<N> {
        let cache = saving.and_then(|saving| Cache::new(saving, &network.borrow().config));
        Session { network, cache }
    }

    /// The network.
    pub fn network(&self) -> &Network {
        self.network.borrow()
    }

    /// The kept results, if there is a cache.
    pub fn cache(&self) -> Option<&Cache> {
        self.cache.as_ref()
    }

    /// Forgets everything but the counts: the next call is computed in full.
    pub fn forget(&mut self) {
        let network = self.network.borrow();
        self.cache = self.cache.take().and_then(|cache| cache.emptied(&network.config));
    }

    /// The embedding of a frame: [`Session::tokenize`], then [`Session::encode`].
    ///
    /// # Errors
    /// When the frame is not of the model's resolution or holds values that are not finite.
    pub fn embed(&mut self, frame: &FrameInput<'_>) -> Result<Embedding, ModelError> {
        let tokens = self.tokenize(frame)?;
        self.encode(&tokens)
    }

    /// The convolution of a frame's pixels and depth, `[N, D]`, before the position code.
    ///
    /// # Errors
    /// As [`Session::embed`].
    pub fn tokenize(&self, frame: &FrameInput<'_>) -> Result<Vec<f32>, ModelError> {
        let Network { config, options, encoder, .. } = self.network();
        let [height, width] = config.resolution;
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
        Ok(encoder.tokenize(options.level, config, frame.rgb, depth))
    }

    /// The embedding of a frame's tokens.
    ///
    /// # Errors
    /// When they are not `[N, D]` finite values.
    pub fn encode(&mut self, tokens: &[f32]) -> Result<Embedding, ModelError> {
        self.check_tokens("tokens", tokens)?;
        let _span = info_span!("encoder").entered();
        let Network { config, options, encoder, workspaces, .. } = self.network.borrow();
        let cache = self.cache.as_mut().map(|cache| &mut cache.encoder);
        Ok(Embedding { h: workspaces.lend(|work| encoder.encode(options.level, config, tokens, cache, work)) })
    }

    /// Returns true if [`Session::embed_part`] and what follows it compute nothing but a part: without a cache, and
    /// where nothing after the encoder mixes tokens. Otherwise they compute everything.
    pub fn computes_parts(&self) -> bool {
        let Network { upsamplers_are_local, options, .. } = self.network();
        self.cache.is_none() && *upsamplers_are_local && !options.compute_zero_output
    }

    /// The embedding of the patches `part` (ascending, row by row) of a frame: the bits that [`Session::embed`] has
    /// for them. If [`Session::computes_parts`], only these rows, `[part, D]`, otherwise those of all patches.
    ///
    /// # Errors
    /// As [`Session::embed`], and when there is no patch, or one that is not of the grid.
    pub fn embed_part(&mut self, frame: &FrameInput<'_>, part: &[u32]) -> Result<Embedding, ModelError> {
        if !self.computes_parts() {
            return self.embed(frame);
        }
        self.check_part(part)?;
        let tokens = self.tokenize(frame)?;
        let _span = info_span!("encoder").entered();
        let Network { config, options, encoder, workspaces, .. } = self.network();
        Ok(Embedding { h: workspaces.lend(|work| encoder.encode_part(options.level, config, &tokens, part, work)) })
    }

    /// [`Session::upsample_static`] of a result of [`Session::embed_part`] of the same patches.
    ///
    /// # Errors
    /// When `h` is not such a result.
    pub fn upsample_static_part(&mut self, h: &[f32], part: &[u32]) -> Result<Vec<f32>, ModelError> {
        if !self.computes_parts() {
            return self.upsample_static(h);
        }
        self.check_part(part)?;
        let Network { config, options, static_upsampler, workspaces, .. } = self.network();
        let (n, d) = (part.len(), config.hidden_dim);
        check_input("h", h, n * d, &format!("[{n}, {d}]"))?;
        let _span = info_span!("upsampler", kind = "static").entered();
        Ok(workspaces.lend(|work| static_upsampler.apply_part(options.level, config, h, part, work)))
    }

    /// [`Session::static_head`] at the mean of a result of [`Session::upsample_static_part`] of the same patches: all
    /// Gaussians of the frame. If [`Session::computes_parts`], those of other patches are the default.
    ///
    /// # Errors
    /// When `tokens` are not such a result.
    pub fn static_head_part(&mut self, tokens: &[f32], part: &[u32]) -> Result<StaticGaussians, ModelError> {
        if !self.computes_parts() {
            return self.static_head(tokens, &Sampling::Mean);
        }
        self.check_part(part)?;
        let Network { config, options, static_head, .. } = self.network();
        let (n, d) = (16 * part.len(), config.gaussian_dim());
        check_input("static tokens", tokens, n * d, &format!("[{n}, {d}]"))?;
        let _span = info_span!("heads", kind = "static").entered();
        let cells = cells(part, config.grid()[1]);
        let some = static_head.apply(options.level, config, tokens, Some(&cells), Sampling::Mean);
        let mut all: StaticGaussians = std::iter::repeat_n(StaticGaussian::default(), config.gaussians()).collect();
        cells.iter().zip(some.iter()).for_each(|(cell, gaussian)| all.set(*cell as usize, gaussian));
        Ok(all)
    }

    /// The Gaussians of a frame at its own time: [`Session::upsample_static`], then [`Session::static_head`].
    ///
    /// # Errors
    /// When the embedding is not one of this network.
    pub fn static_gaussians(&mut self, embedding: &Embedding, sampling: &Sampling) -> Result<StaticFrame, ModelError> {
        let tokens = self.upsample_static(&embedding.h)?;
        let gaussians = self.static_head(&tokens, sampling)?;
        Ok(StaticFrame { tokens, gaussians })
    }

    /// The static upsampler: `h [N, D]` to `[16N, d]`.
    ///
    /// # Errors
    /// When `h` is not `[N, D]` finite values.
    pub fn upsample_static(&mut self, h: &[f32]) -> Result<Vec<f32>, ModelError> {
        self.check_tokens("h", h)?;
        let _span = info_span!("upsampler", kind = "static").entered();
        let Network { config, options, static_upsampler, workspaces, .. } = self.network.borrow();
        let moves = self.moves();
        let cache = self.cache.as_mut().map(|cache| &mut cache.static_upsampler);
        Ok(workspaces.lend(|work| static_upsampler.apply(options.level, config, h, (cache, moves), work)))
    }

    /// The static head on upsampled tokens `[16N, d]`. With a cache they must be the result of the last call of
    /// [`Session::upsample_static`]. Sampled positions are all drawn again.
    ///
    /// # Errors
    /// When `tokens` is not of that size, or not finite.
    pub fn static_head(&mut self, tokens: &[f32], sampling: &Sampling) -> Result<StaticGaussians, ModelError> {
        self.check_upsampled("static tokens", tokens)?;
        let _span = info_span!("heads", kind = "static").entered();
        let Network { config, options, static_head, .. } = self.network.borrow();
        let draws = config.static_position == StaticPosition::TruncatedNormal && *sampling != Sampling::Mean;
        let head = |tokens: &[f32], at: Option<&[u32]>| static_head.apply(options.level, config, tokens, at, *sampling);
        Ok(match self.cache.as_mut().filter(|_| !draws) {
            Some(cache) => cache.static_head.renew(config.gaussians(), tokens, &cache.static_upsampler, head),
            None => head(tokens, None),
        })
    }

    /// The motion of the Gaussians of frames `a` (the earlier) and `b` over the interval between them:
    /// [`Session::decode`], then for each [`Session::upsample_deformation`] and [`Session::deformation_head`].
    ///
    /// # Errors
    /// When a side is not of this network, or lacks features that the network is conditioned on.
    pub fn deform(&mut self, a: Side<'_>, b: Side<'_>) -> Result<[Deformation; 2], ModelError> {
        let [d_a, d_b] = self.decode(&a, &b)?;
        let mut side = |place: usize, side: Side<'_>, d: Vec<f32>| -> Result<Deformation, ModelError> {
            let tokens = self.upsample_deformation(place, &d)?;
            let (velocity, gamma) = self.deformation_head(place, side.static_tokens, &tokens)?;
            Ok(Deformation { d, tokens, velocity, gamma })
        };
        Ok([side(0, a, d_a)?, side(1, b, d_b)?])
    }

    /// The decoder: `d_a` and `d_b`, each `[N, D]`. Static tokens are ignored.
    ///
    /// # Errors
    /// As [`Session::deform`].
    pub fn decode(&mut self, a: &Side<'_>, b: &Side<'_>) -> Result<[Vec<f32>; 2], ModelError> {
        self.check_tokens("h of the first frame", a.h)?;
        self.check_tokens("h of the second frame", b.h)?;
        let pair = ([a.h, b.h], [self.features(a, "first")?, self.features(b, "second")?]);
        let _span = info_span!("decoder").entered();
        let Network { config, options, decoder, workspaces, .. } = self.network.borrow();
        let moves = self.moves();
        let cache = self.cache.as_mut().map(|cache| &mut cache.decoder);
        Ok(workspaces.lend(|work| decoder.apply(options.level, config, pair, (cache, moves), work)))
    }

    /// The deformation upsampler: `d [N, D]` of the earlier (0) or the later (1) frame of the pair to `[16N, d]`.
    ///
    /// # Errors
    /// When `d` is not `[N, D]` finite values.
    ///
    /// # Panics
    /// When `place` is neither 0 nor 1.
    pub fn upsample_deformation(&mut self, place: usize, d: &[f32]) -> Result<Vec<f32>, ModelError> {
        self.check_tokens("d", d)?;
        let _span = info_span!("upsampler", kind = "deformation").entered();
        let Network { config, options, deformation_upsampler, workspaces, .. } = self.network.borrow();
        let moves = self.moves();
        let cache = self.cache.as_mut().map(|cache| &mut cache.deformation[place].0);
        Ok(workspaces.lend(|work| deformation_upsampler.apply(options.level, config, d, (cache, moves), work)))
    }

    /// The deformation head on static and deformation tokens of the earlier (0) or the later (1) frame, both `[16N,
    /// d]`: velocity and γ. With a cache, `tokens` must be the result of the last call of
    /// [`Session::upsample_deformation`] for that place.
    ///
    /// # Errors
    /// When one is not of that size, or not finite.
    ///
    /// # Panics
    /// When `place` is neither 0 nor 1.
    pub fn deformation_head(
        &mut self,
        place: usize,
        static_tokens: &[f32],
        tokens: &[f32],
    ) -> Result<(Vec<[f32; 3]>, Vec<[f32; 2]>), ModelError> {
        self.check_upsampled("static tokens", static_tokens)?;
        self.check_upsampled("deformation tokens", tokens)?;
        let _span = info_span!("heads", kind = "deformation").entered();
        let Network { options, deformation_head, .. } = self.network.borrow();
        let head = |still: &[f32], moving: &[f32]| deformation_head.apply(options.level, still, moving);
        Ok(match self.cache.as_mut().map(|cache| &mut cache.deformation[place]) {
            Some((upsampler, cache)) => cache.renew(options.level, static_tokens, tokens, upsampler, head),
            None => head(static_tokens, tokens),
        })
    }

    /// Returns true if most of the picture is known to have changed since the previous frame.
    fn moves(&self) -> bool {
        self.cache.as_ref().is_some_and(|cache| cache.encoder.moves())
    }

    /// Features that the other frame is conditioned on.
    fn features<'a>(&self, side: &Side<'a>, which: &str) -> Result<&'a [f32], ModelError> {
        let Network { config, decoder, .. } = self.network();
        if !config.use_dino {
            return Ok(side.h);
        }
        let channels = config.condition_dim;
        let name = format!("condition of the {which} frame");
        let Some(features) = side.condition else {
            return Err(ModelError::Input {
                input: name,
                expected: format!("features [M, {channels}]: this model is conditioned on DINOv2"),
                found: "none".to_owned(),
            });
        };
        let most = decoder.longest_condition(config.hidden_dim);
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

    fn check_part(&self, part: &[u32]) -> Result<(), ModelError> {
        let n = self.network().config.tokens();
        let ascends = part.is_sorted_by(|a, b| a < b) && part.last().is_some_and(|last| (*last as usize) < n);
        match ascends {
            true => Ok(()),
            false => Err(ModelError::Input {
                input: "part".to_owned(),
                expected: format!("at least one of {n} patches, ascending"),
                found: format!("{} up to {:?}", part.len(), part.iter().max()),
            }),
        }
    }

    fn check_tokens(&self, name: &str, values: &[f32]) -> Result<(), ModelError> {
        let config = &self.network().config;
        let (n, d) = (config.tokens(), config.hidden_dim);
        check_input(name, values, n * d, &format!("[{n}, {d}]"))
    }

    fn check_upsampled(&self, name: &str, values: &[f32]) -> Result<(), ModelError> {
        let config = &self.network().config;
        let (n, d) = (config.gaussians(), config.gaussian_dim());
        check_input(name, values, n * d, &format!("[{n}, {d}]"))
    }
}
