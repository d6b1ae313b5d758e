//! From options to the library's settings: every unknown or unavailable value is wrong use.

use std::path::PathBuf;
use std::str::FromStr;

use crate::depth::{NetworkOptions, Range, Values};
use crate::fit::Fit;
use crate::gap::Gap;
use crate::source::colour::Matrix;
use crate::stream::{
    Behind, DepthRange, Fade, FlowEffort, Fusion, MaxAge, ModelSource, MotionFrom, Quality, Resolution, Reuse,
    SamplingMode, Settings,
};
use streamsplat_model::Precision;

use crate::run::Error;
use crate::run::digest;
use crate::run::options::{Machine, ModelOptions, RunOptions, StreamOptions};
use crate::run::record::ModelRecord;

/// `text` as a `T`, or wrong use of `option`.
pub fn choice<T: FromStr>(option: &str, text: &str) -> Result<T, Error>
where
    T::Err: std::fmt::Display,
{
    text.parse().map_err(|e| Error::usage(format!("{option}: {e}")))
}

/// The same, or the default where the option is not given.
pub fn choice_or_default<T: FromStr + Default>(option: &str, text: Option<&str>) -> Result<T, Error>
where
    T::Err: std::fmt::Display,
{
    text.map_or_else(|| Ok(T::default()), |text| choice(option, text))
}

/// Where depth comes from.
#[derive(Clone, Debug, PartialEq)]
pub enum DepthFrom {
    /// There is none.
    None,
    /// Parallax, where the camera moves.
    Found,
    /// A folder of maps.
    Folder(PathBuf, Range, Values),
    /// A network.
    Network(PathBuf, NetworkOptions),
}

impl ModelOptions {
    /// The model that is meant.
    pub fn source(&self) -> ModelSource {
        match &self.model {
            None => ModelSource::Embedded,
            Some(checkpoint) => ModelSource::File { checkpoint: checkpoint.clone(), dinov2: self.dinov2.clone() },
        }
    }

    /// The arithmetic that is meant.
    pub fn precision(&self) -> Result<Precision, Error> {
        self.precision.as_deref().map_or_else(|| Ok(Precision::default()), |text| choice("--precision", text))
    }
}

impl ModelOptions {
    /// Which model it is, for the record of a run.
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

/// The matrix of this name.
pub fn matrix(name: Option<&str>) -> Result<Option<Matrix>, Error> {
    let named = |name: &str| {
        Matrix::named(name)
            .ok_or_else(|| Error::usage(format!("--matrix: expected {}, found {name:?}", Matrix::NAMES.join(", "))))
    };
    name.map(named).transpose()
}

impl RunOptions {
    /// These options, with those of presets and defaults where they are unset ([`StreamOptions::resolved`]).
    ///
    /// # Errors
    /// [`Error::Usage`] for options that exclude each other, and for unknown names.
    pub fn resolved(&self) -> Result<RunOptions, Error> {
        self.check()?;
        let mut options = RunOptions { stream: self.stream.resolved()?, ..self.clone() };
        let fit = if options.stream.like_paper { Fit::Stretch } else { Fit::default() };
        options.fit.get_or_insert_with(|| fit.name().to_owned());
        Ok(options)
    }

    /// An error for options that exclude or require each other.
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
        Ok(())
    }

    /// The matrix of the input, in place of its own.
    pub fn matrix(&self) -> Result<Option<Matrix>, Error> {
        matrix(self.matrix.as_deref())
    }
}

impl StreamOptions {
    /// These options, with those of the preset where they are unset: `--like-paper`, or the quality (`balanced` by default for the model inside the
    /// program, none for other models). Options that no preset sets have their defaults.
    pub fn resolved(&self) -> Result<StreamOptions, Error> {
        let mut stream = if self.like_paper { self.as_the_authors() } else { self.with_quality()? };
        stream.depth_range.get_or_insert_with(|| "frame".to_owned());
        stream.fusion.get_or_insert_with(|| Fusion::default().to_string());
        stream.sampling.get_or_insert_with(|| SamplingMode::default().to_string());
        Ok(stream)
    }

    /// The steps of the authors' script for whole clips.
    fn as_the_authors(&self) -> StreamOptions {
        let mut stream = self.clone();
        let values: [(&mut Option<String>, &dyn std::fmt::Display); 9] = [
            (&mut stream.gap, &Gap::Every(3)),
            (&mut stream.resolution, &Resolution::Native),
            (&mut stream.motion, &MotionFrom::Network),
            (&mut stream.fade, &Fade::Network),
            (&mut stream.depth, &"none"),
            (&mut stream.depth_range, &"keys"),
            (&mut stream.fusion, &Fusion::Pairwise),
            (&mut stream.sampling, &SamplingMode::Mean),
            (&mut stream.model.precision, &Precision::F32),
        ];
        for (option, value) in values {
            option.get_or_insert_with(|| value.to_string());
        }
        stream.refine.get_or_insert(0);
        stream
    }

    /// The options of the quality.
    fn with_quality(&self) -> Result<StreamOptions, Error> {
        let mut stream = self.clone();
        let quality = match (&self.quality, self.model.source()) {
            (Some(name), _) => choice("--quality", name)?,
            (None, ModelSource::Embedded) => Quality::default(),
            (None, _) => {
                stream.gap = Some(self.gap()?.to_string());
                stream.depth.get_or_insert_with(|| "none".to_owned());
                return Ok(stream);
            }
        };
        let preset = quality.preset();
        stream.quality = Some(quality.name().to_owned());
        let fill = |option: &mut Option<String>, value: &dyn std::fmt::Display| {
            option.get_or_insert_with(|| value.to_string());
        };
        fill(&mut stream.gap, &preset.gap);
        fill(&mut stream.resolution, &preset.resolution);
        fill(&mut stream.motion, &preset.motion);
        fill(&mut stream.flow, &preset.flow);
        // Who asks for the network's motion gets its fading with it.
        let network = stream.motion.as_deref() == Some(MotionFrom::Network.name());
        fill(&mut stream.fade, if network { &Fade::Network } else { &preset.fade });
        fill(&mut stream.depth, &if preset.find_depth && !network { "auto" } else { "none" });
        fill(&mut stream.model.precision, &preset.precision);
        fill(&mut stream.reuse, &preset.reuse);
        stream.refine.get_or_insert(preset.refine);
        stream.refine_every.get_or_insert(preset.refine_every);
        Ok(stream)
    }

    /// How far key frames are apart.
    pub fn gap(&self) -> Result<Gap, Error> {
        self.gap.as_deref().map_or(Ok(Gap::Every(1)), |text| choice("--gap", text))
    }

    /// The file of the depth network, where there is one.
    pub fn depth_network(&self) -> Option<&str> {
        self.depth.as_deref()?.strip_prefix("onnx:")
    }

    /// Where depth comes from.
    pub fn depth_from(&self) -> Result<DepthFrom, Error> {
        let named = self.depth_range.as_deref().unwrap_or("frame");
        // The key frames of a gap that depends on the frames are not known beforehand.
        let range = match (named, self.gap()?) {
            ("frame", _) => Some(Range::Frame),
            ("clip", _) => Some(Range::Clip),
            ("keys", Gap::Every(n)) => Some(Range::Every(n)),
            ("keys", Gap::Auto(_)) => None,
            (other, _) => return Err(Error::usage(format!("--depth-range {other}: expected frame, clip or keys"))),
        };
        let depth = self.depth.as_deref().unwrap_or("none");
        let network = depth.strip_prefix("onnx:").map(PathBuf::from);
        let values = match self.depth_model.as_deref() {
            Some("metric") if network.is_none() && !["none", "auto"].contains(&depth) => Values::Depth,
            Some(_) if network.is_none() => {
                let expected = "expected a network as well (--depth onnx:FILE), or metric with a folder of depth maps";
                return Err(Error::usage(format!("--depth-model: {expected}")));
            }
            _ => Values::Inverse,
        };
        if depth == "none" {
            return Ok(DepthFrom::None);
        }
        if depth == "auto" {
            return Ok(DepthFrom::Found);
        }
        if let Some(network) = network {
            if range != Some(Range::Frame) {
                return Err(Error::usage(format!("--depth-range {named}: expected a folder of maps, found a network")));
            }
            let options = self.depth_model.as_deref().map(|text| choice("--depth-model", text)).transpose()?;
            return Ok(DepthFrom::Network(network, options.unwrap_or_default()));
        }
        let folder = PathBuf::from(depth);
        if !folder.is_dir() {
            return Err(Error::usage(format!(
                "--depth {depth}: expected none, auto, a folder of depth maps, or onnx:FILE"
            )));
        }
        let range = range.ok_or_else(|| {
            let gap = self.gap.as_deref().unwrap_or_default();
            Error::usage(format!("--depth-range keys: expected a fixed gap (--gap N), found --gap {gap}"))
        })?;
        Ok(DepthFrom::Folder(folder, range, values))
    }

    /// Settings of the engine for these options.
    pub fn settings(&self, fit: Fit, machine: &Machine) -> Result<Settings, Error> {
        let mut settings = Settings::with_model(self.model.source());
        settings.fusion = choice_or_default("--fusion", self.fusion.as_deref())?;
        settings.max_age = self.max_age.map_or_else(MaxAge::default, MaxAge);
        settings.fit = fit;
        settings.resolution = self.resolution.as_deref().map(|text| choice("--resolution", text)).transpose()?;
        settings.motion = self.motion.as_deref().map(|text| choice("--motion", text)).transpose()?;
        settings.fade = self.fade.as_deref().map(|text| choice("--fade", text)).transpose()?;
        settings.flow =
            self.flow.as_deref().map_or_else(|| Ok(FlowEffort::default()), |text| choice("--flow", text))?;
        settings.refine_every = self.refine_every;
        settings.refine = self.refine;
        settings.find_depth = Some(self.depth_from()? == DepthFrom::Found);
        settings.depth_range = match self.depth_from()? {
            DepthFrom::Folder(_, Range::Clip | Range::Every(_), _) => DepthRange::Given,
            _ => DepthRange::Frame,
        };
        settings.behind =
            self.behind.as_deref().map_or_else(|| Ok(Behind::default()), |text| choice("--behind", text))?;
        settings.sampling = choice_or_default("--sampling", self.sampling.as_deref())?;
        settings.seed = self.seed;
        settings.reuse = self.reuse.as_deref().map_or_else(|| Ok(Reuse::default()), |text| choice("--reuse", text))?;
        settings.precision = self.model.precision()?;
        settings.level = Some(machine.level()?);
        settings.threads = machine.threads()?;
        Ok(settings)
    }
}
