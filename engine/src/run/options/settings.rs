//! From options to the library's settings: every unknown or unavailable value is wrong use.

use std::path::{Path, PathBuf};

use streamsplat_kernels::Level;

use super::{DepthScale, DepthSource, Machine, ModelOptions, RunOptions, StreamOptions, Threads};
use crate::depth::{NetworkOptions, Range, Values};
use crate::fit::Fit;
use crate::gap::Gap;
use crate::run::record::ModelRecord;
use crate::run::{Error, digest};
use crate::stream::{DepthRange, Fusion, MaxAge, ModelSource, MotionFrom, Settings, StaticRegions, Workers};

/// Source of depth.
#[derive(Clone, Debug, PartialEq)]
pub enum DepthFrom {
    /// There is none.
    None,
    /// Parallax, where the camera moves.
    Found,
    /// The same, and a guess where there is no parallax.
    Guessed,
    /// A folder of maps.
    Folder(PathBuf, Range, Values),
    /// A network.
    Network(PathBuf, NetworkOptions),
}

impl ModelOptions {
    /// The source of the model.
    pub fn source(&self) -> ModelSource {
        match &self.model {
            None => ModelSource::Embedded,
            Some(checkpoint) => ModelSource::File { checkpoint: checkpoint.clone(), dinov2: self.dinov2.clone() },
        }
    }
}

impl ModelOptions {
    /// The model's record in that of a run.
    pub fn record(&self) -> Result<ModelRecord, Error> {
        let Some(path) = &self.model else {
            let parts = [crate::stream::EMBEDDED_CHECKPOINT, crate::stream::EMBEDDED_CONFIG.as_bytes()];
            return Ok(ModelRecord { path: "embedded".into(), blake3: digest::bytes(&parts) });
        };
        let mut files = vec![path.clone()];
        files.extend(Some(path.with_extension("json")).filter(|config| config.exists()));
        files.extend(self.dinov2.clone());
        Ok(ModelRecord { path: path.display().to_string(), blake3: digest::files(&files)? })
    }
}

impl RunOptions {
    /// Returns these options with unset ones filled from presets and defaults ([`StreamOptions::resolved`]).
    ///
    /// # Errors
    /// [`Error::Usage`] for options that exclude each other, and for unknown names.
    pub fn resolved(&self) -> Result<RunOptions, Error> {
        self.check()?;
        let mut options = RunOptions { stream: self.stream.resolved(), ..self.clone() };
        options.fit = options.fit.or(options.stream.fit());
        Ok(options)
    }

    /// Returns an error for options that exclude or require each other.
    fn check(&self) -> Result<(), Error> {
        let (view, motion) = (&self.view, &self.motion);
        let moves = [("--orbit", motion.orbit.is_some()), ("--sway", motion.sway.is_some())];
        let moves = moves.into_iter().chain([("--turntable", motion.turntable.is_some())]);
        let places = moves.chain([("--camera", view.camera.is_some())]).filter(|(_, given)| *given);
        if let [(first, _), (second, _), ..] = places.collect::<Vec<_>>()[..] {
            return Err(Error::usage(format!("{second}: expected none beside {first}")));
        }
        if self.stream.like_paper && self.stream.quality.is_some() {
            return Err(Error::usage("--quality: expected none beside --like-paper"));
        }
        if view.view.is_some() && view.camera.is_none() {
            return Err(Error::usage("--view: expected --camera as well"));
        }
        if motion.eye_distance.is_some() && !motion.stereo {
            return Err(Error::usage("--eye-distance: expected --stereo as well"));
        }
        if self.stream.model.dinov2.is_some() && self.stream.model.model.is_none() {
            return Err(Error::usage("--dinov2: expected --model as well, found the embedded model, which uses none"));
        }
        Ok(())
    }

    /// Options that are given and change nothing, one line for each. A record holds the values of presets as well, so
    /// this applies to what a user wrote, before it is [`resolved`](Self::resolved).
    pub(crate) fn without_effect(&self) -> Vec<String> {
        let (given, all, motion) = (&self.stream, self.stream.resolved(), &self.motion);
        let maps = matches!(all.depth, Some(DepthSource::Folder(_) | DepthSource::Network(_)));
        let flat = matches!(all.depth, None | Some(DepthSource::None));
        let unfitted = all.refine == Some(0);
        let undrawn = self.emit.is_some_and(|emit| !emit.draws());
        let moves = motion.orbit.is_some() || motion.sway.is_some() || motion.turntable.is_some();
        let pairwise = all.fusion == Some(Fusion::Pairwise);
        let network = all.motion == Some(MotionFrom::Network);
        let guessed = all.depth == Some(DepthSource::Guess) && given.model.model.is_none() && !network;
        let kept = given.still.is_some_and(|still| still != StaticRegions::Off);
        let unused = [
            ("--depth-range", given.depth_range.is_some() && !maps, "without a folder of depth maps"),
            ("--behind", given.behind.is_some() && flat, "without depth"),
            ("--still", kept && guessed, "with --depth guess"),
            ("--max-age", given.max_age.is_some() && pairwise, "with --fusion pairwise"),
            ("--flow", given.flow.is_some() && network, "with --motion network"),
            ("--refine-every", given.refine_every.is_some() && unfitted, "with --refine 0"),
            ("--refine-to", given.refine_to.is_some() && unfitted, "with --refine 0"),
            ("--detail", given.detail.is_some_and(|detail| detail > 0) && unfitted, "with --refine 0"),
            ("--size", self.view.size.is_some() && undrawn, "as no images are drawn"),
            ("--camera", self.view.camera.is_some() && undrawn, "as no images are drawn"),
            ("--orbit, --sway, --turntable", moves && undrawn, "as no images are drawn"),
            ("--stereo", motion.stereo && undrawn, "as no images are drawn"),
        ];
        let unused = unused.into_iter().filter(|(_, unused, _)| *unused);
        unused.map(|(option, _, cause)| format!("{option} changes nothing {cause}")).collect()
    }
}

impl StreamOptions {
    /// Distances between key frames.
    pub fn gap(&self) -> Gap {
        self.gap.unwrap_or(Gap::Every(1))
    }

    /// The file of the depth network, where there is one.
    pub fn depth_network(&self) -> Option<&Path> {
        match &self.depth {
            Some(DepthSource::Network(file)) => Some(file),
            _ => None,
        }
    }

    /// The source of depth.
    ///
    /// # Errors
    /// [`Error::Usage`] for options that cannot be combined, and for a folder that does not exist.
    pub fn depth_from(&self) -> Result<DepthFrom, Error> {
        let scale = self.depth_range.unwrap_or_default();
        // The key frames of an automatic gap are not known in advance.
        let range = match (scale, self.gap()) {
            (DepthScale::Frame, _) => Some(Range::Frame),
            (DepthScale::Clip, _) => Some(Range::Clip),
            (DepthScale::Keys, Gap::Every(n)) => Some(Range::Every(n)),
            (DepthScale::Keys, Gap::Auto(_)) => None,
        };
        let folder = match self.depth.as_ref().unwrap_or(&DepthSource::None) {
            DepthSource::Network(network) => {
                if range != Some(Range::Frame) {
                    let message = format!("--depth-range {scale}: expected a folder of maps, found a network");
                    return Err(Error::usage(message));
                }
                let options = self.depth_model.as_ref().map(|model| model.options().clone());
                return Ok(DepthFrom::Network(network.clone(), options.unwrap_or_default()));
            }
            DepthSource::Folder(folder) => Some(folder),
            DepthSource::None | DepthSource::Auto | DepthSource::Guess => None,
        };
        let values = match (&self.depth_model, folder) {
            (None, _) => Values::Inverse,
            (Some(model), Some(_)) if model.is_metric_alone() => Values::Depth,
            (Some(_), _) => {
                let expected = "expected a network as well (--depth onnx:FILE), or metric with a folder of depth maps";
                return Err(Error::usage(format!("--depth-model: {expected}")));
            }
        };
        let Some(folder) = folder else {
            return Ok(match self.depth {
                Some(DepthSource::Auto) => DepthFrom::Found,
                Some(DepthSource::Guess) => DepthFrom::Guessed,
                _ => DepthFrom::None,
            });
        };
        if !folder.is_dir() {
            return Err(Error::usage(format!(
                "--depth {}: expected none, auto, guess, a folder of depth maps, or onnx:FILE",
                folder.display()
            )));
        }
        let range = range.ok_or_else(|| {
            Error::usage(format!("--depth-range keys: expected a fixed gap (--gap N), found --gap {}", self.gap()))
        })?;
        Ok(DepthFrom::Folder(folder.clone(), range, values))
    }

    /// Settings of the engine for these options.
    ///
    /// # Errors
    /// As [`StreamOptions::depth_from`].
    pub fn settings(&self, fit: Fit, machine: &Machine) -> Result<Settings, Error> {
        let depth = self.depth_from()?;
        let depth_range = match depth {
            DepthFrom::Folder(_, Range::Clip | Range::Every(_), _) => DepthRange::Given,
            _ => DepthRange::Frame,
        };
        Ok(Settings {
            fusion: self.fusion.unwrap_or_default(),
            max_age: self.max_age.map_or_else(MaxAge::default, MaxAge),
            fit,
            resolution: self.resolution,
            motion: self.motion,
            fade: self.fade,
            flow: self.flow.unwrap_or_default(),
            refine_every: self.refine_every,
            refine_to: self.refine_to,
            detail: self.detail,
            refine: self.refine,
            find_depth: Some(matches!(depth, DepthFrom::Found | DepthFrom::Guessed)),
            guess_depth: Some(depth == DepthFrom::Guessed),
            depth_range,
            behind: self.behind.unwrap_or_default(),
            still: self.still,
            sampling: self.sampling.unwrap_or_default(),
            seed: self.seed,
            reuse: self.reuse.unwrap_or_default(),
            precision: self.model.precision,
            level: Some(machine.level()),
            threads: machine.threads(),
            ..Settings::with_model(self.model.source())
        })
    }
}

impl Machine {
    /// The instruction set.
    pub fn level(&self) -> Level {
        self.isa.level()
    }

    /// Threads; 0 is one per processor.
    pub fn threads(&self) -> usize {
        self.threads.map_or(0, Threads::get)
    }

    /// A pool of these threads.
    ///
    /// # Errors
    /// [`Error::Engine`] where the system cannot start the threads.
    pub fn workers(&self) -> Result<Workers, Error> {
        Ok(Workers::new(self.level(), self.threads())?)
    }
}
