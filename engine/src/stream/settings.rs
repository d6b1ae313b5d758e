//! Settings of an engine.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;
use std::sync::Arc;

use streamsplat_kernels::Level;
use streamsplat_kernels::math::f64::exp;
use streamsplat_model::{LoadOptions, Precision};

use super::network::Conditioned;
use super::{EngineError, Reconstructor, Resolution};
use crate::choice::{UnknownChoice, named};
use crate::fit::Fit;

/// Settings of an engine. [`Settings::default`] uses the model inside the library and the program's defaults.
#[derive(Clone, Debug, Default)]
pub struct Settings {
    /// The model.
    pub model: ModelSource,
    /// Fusion of a key frame with those before.
    pub fusion: Fusion,
    /// Number of key frames after which a Gaussian that nothing continues is dropped at the latest.
    pub max_age: MaxAge,
    /// How frames are brought to the model's input size.
    pub fit: Fit,
    /// The size at which the model sees frames; `None`: [`Resolution::Auto`] for the model inside the library, its own
    /// for any other.
    pub resolution: Option<Resolution>,
    /// Where motion comes from; `None`: [`MotionFrom::Between`] for the model inside the library,
    /// [`MotionFrom::Network`] for any other.
    pub motion: Option<MotionFrom>,
    /// How Gaussians fade in and out between key frames. `None`: [`Fade::Fixed`] for the model inside the library where
    /// motion is not the network's, [`Fade::Network`] otherwise.
    pub fade: Option<Fade>,
    /// Effort of optical flow from frame to frame.
    pub flow: FlowEffort,
    /// Steps of conjugate gradients that fit colours to the frames, 0 for none; `None`: [`Settings::REFINE`] for the
    /// model inside the library, 0 for any other.
    pub refine: Option<u32>,
    /// Colours are fitted to every n-th of the frames between key frames, 1 for all; `None`: 1. 0 is 1.
    pub refine_every: Option<u32>,
    /// PSNR, in dB, from which on a tile of 64×32 pixels of an image between key frames is close enough to its frame.
    /// Where all tiles of an interval's frames are, no colours are fitted. `None`: [`Settings::REFINE_TO`] for the
    /// model inside the library, [`Decibels::MOST`] for any other.
    pub refine_to: Option<Decibels>,
    /// Of each 1000 pixels of a key frame, the number that may have a Gaussian of their own where the fit of colours
    /// leaves error, 0 for none; `None`: [`Settings::DETAIL`] for the model inside the library, 0 for any other.
    pub detail: Option<u32>,
    /// True if depth is found by parallax ([`crate::parallax`]) for frames that have no map of their own. Applies where
    /// the model ignores depth ([`Reconstructor::ignores_depth`]) and motion is taken from the frames. `None`: true for
    /// the model inside the library, false for any other.
    pub find_depth: Option<bool>,
    /// True if depth is guessed where it is to be found and the camera does not move or only turns: a ground that rises
    /// to a wall or a horizon, and moving bodies upright on it ([`crate::parallax`]). Needs [`Settings::find_depth`].
    /// Static regions are then not kept. `None`: false.
    pub guess_depth: Option<bool>,
    /// How depth maps are normalised.
    pub depth_range: DepthRange,
    /// Gaussians behind the foreground, where depth maps lift it.
    pub behind: Behind,
    /// Static regions of the picture; `None`: [`StaticRegions::Keep`] for the model inside the library,
    /// [`StaticRegions::Off`] for any other.
    pub still: Option<StaticRegions>,
    /// How positions are drawn, where the model predicts a distribution.
    pub sampling: SamplingMode,
    /// The seed of everything drawn.
    pub seed: u64,
    /// Work that is left out.
    pub reuse: Reuse,
    /// The arithmetic of the large matrix products; `None`: [`Precision::Int8`] for the model inside the library,
    /// [`Precision::F32`] for any other.
    pub precision: Option<Precision>,
    /// The instruction-set level; `None` is the machine's highest. It changes no output bit.
    pub level: Option<Level>,
    /// Threads; 0 is one per processor. It changes no output bit.
    pub threads: usize,
}

/// Where the model comes from.
#[derive(Clone, Default)]
#[non_exhaustive]
pub enum ModelSource {
    /// The small checkpoint inside the library.
    #[default]
    Embedded,
    /// A checkpoint in the official layout, with a JSON file of the same name next to it for the properties that shapes
    /// do not determine.
    File {
        /// The safetensors file.
        checkpoint: PathBuf,
        /// DINOv2's own weights, for models conditioned on them.
        dinov2: Option<PathBuf>,
    },
    /// Anything that reconstructs frames; several engines may share one.
    Shared(Arc<dyn Reconstructor>),
}

impl ModelSource {
    /// Loads the model.
    pub(crate) fn load(&self, options: &LoadOptions) -> Result<Arc<dyn Reconstructor>, EngineError> {
        let conditioned = match self {
            ModelSource::Shared(model) => return Ok(model.clone()),
            ModelSource::Embedded => Conditioned::load(None, None, options)?,
            ModelSource::File { checkpoint, dinov2 } => {
                Conditioned::load(Some(checkpoint), dinov2.as_deref(), options)?
            }
        };
        Ok(Arc::new(conditioned))
    }
}

impl Settings {
    /// Default number of steps that fit colours, for the model inside the library.
    pub const REFINE: u32 = 6;
    /// [`Settings::detail`] of the model inside the library.
    pub const DETAIL: u32 = 50;

    /// Default PSNR, in dB, that is close enough, for the model inside the library.
    pub const REFINE_TO: Decibels = Decibels(43.0);

    /// The program's defaults with another model.
    pub fn with_model(model: ModelSource) -> Self {
        Self { model, ..Self::default() }
    }

    /// The size at which the model sees frames.
    pub fn resolution(&self) -> Resolution {
        self.resolution.unwrap_or(match self.model {
            ModelSource::Embedded => Resolution::Auto,
            _ => Resolution::Native,
        })
    }

    /// Where motion comes from.
    pub fn motion(&self) -> MotionFrom {
        self.motion.unwrap_or(match self.model {
            ModelSource::Embedded => MotionFrom::Between,
            _ => MotionFrom::Network,
        })
    }

    /// How Gaussians fade in and out between key frames.
    pub fn fade(&self) -> Fade {
        self.fade.unwrap_or(match (&self.model, self.motion()) {
            (ModelSource::Embedded, MotionFrom::Frames | MotionFrom::Between) => Fade::Fixed,
            _ => Fade::Network,
        })
    }

    /// Colours are fitted to every n-th of the frames between key frames.
    pub fn refine_every(&self) -> u32 {
        self.refine_every.unwrap_or(1).max(1)
    }

    /// Of each 1000 pixels of a key frame, the number that may have a Gaussian of their own.
    pub fn detail(&self) -> u32 {
        self.detail.unwrap_or(match self.model {
            ModelSource::Embedded => Self::DETAIL,
            _ => 0,
        })
    }

    /// Returns true if depth is found by parallax where the model ignores depth.
    pub fn find_depth(&self) -> bool {
        let wanted = self.find_depth.unwrap_or(matches!(self.model, ModelSource::Embedded));
        wanted && self.motion() != MotionFrom::Network
    }

    /// Returns true if depth is guessed where the model ignores depth and none can be found.
    pub fn guess_depth(&self) -> bool {
        self.find_depth() && self.guess_depth.unwrap_or(false)
    }

    /// Returns true if anything is taken from the network's dynamic half; otherwise it is not computed.
    pub(crate) fn deforms(&self) -> bool {
        self.motion() == MotionFrom::Network || self.fade() == Fade::Network
    }

    /// The mean square error at which a tile of an image is close enough to its frame.
    pub(super) fn close(&self) -> f64 {
        let decibels = self.refine_to.unwrap_or(match self.model {
            ModelSource::Embedded => Self::REFINE_TO,
            _ => Decibels::MOST,
        });
        exp(-f64::from(decibels.0) / 10.0 * std::f64::consts::LN_10)
    }

    /// Handling of static regions of the picture.
    pub fn still(&self) -> StaticRegions {
        self.still.unwrap_or(match self.model {
            ModelSource::Embedded => StaticRegions::Keep,
            _ => StaticRegions::Off,
        })
    }

    /// The arithmetic of the large matrix products.
    pub fn precision(&self) -> Precision {
        self.precision.unwrap_or(match self.model {
            ModelSource::Embedded => Precision::Int8,
            _ => Precision::F32,
        })
    }

    /// Steps that fit colours to the frames.
    pub fn refine(&self) -> u32 {
        self.refine.unwrap_or(match self.model {
            ModelSource::Embedded => Self::REFINE,
            _ => 0,
        })
    }
}

impl fmt::Debug for ModelSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            ModelSource::Embedded => f.write_str("Embedded"),
            ModelSource::File { checkpoint, dinov2 } => {
                f.debug_struct("File").field("checkpoint", checkpoint).field("dinov2", dinov2).finish()
            }
            ModelSource::Shared(_) => f.write_str("Shared"),
        }
    }
}

named! {
    /// Fusion of a key frame with those before.
    Fusion: "fusion" {
        /// Gaussians keep their identity from key frame to key frame; those that no frame continues persist and fade;
        /// crossing a key frame changes no bit of the image.
        #[default]
        Persistent = "persistent",
        /// Two frames at a time, without memory: the model's own definition of an interval.
        Pairwise = "pairwise",
    }
}

named! {
    /// Where the motion of Gaussians between two key frames comes from.
    MotionFrom: "motion" {
        /// The network's deformation field.
        #[default]
        Network = "network",
        /// Optical flow from either key frame to the other, read at each Gaussian's centre.
        Frames = "frames",
        /// Optical flow from frame to frame, followed through the frames between the two key frames; the velocity is a
        /// least-squares line through the places. Where there is no frame in between, as [`MotionFrom::Frames`].
        Between = "between",
    }
}

named! {
    /// How Gaussians fade in and out between two key frames.
    Fade: "fade" {
        /// By the network, for each of them.
        #[default]
        Network = "network",
        /// All alike, with the network's average. Where motion is not the network's either, its dynamic half is not
        /// computed: a Gaussian that flow does not follow then does not move.
        Fixed = "fixed",
    }
}

named! {
    /// Effort of optical flow through the frames between key frames ([`MotionFrom::Between`]).
    FlowEffort: "flow" {
        /// Half of the resolution, smoothed in five iterations.
        #[default]
        Fine = "fine",
        /// A quarter of the resolution, smoothed in two.
        Coarse = "coarse",
    }
}

named! {
    /// Normalisation of depth maps to [0, 1].
    DepthRange: "depth range" {
        /// Normalises each map by its own minimum and maximum.
        #[default]
        Frame = "frame",
        /// Takes the maps as given: they are in [0, 1] already.
        Given = "given",
    }
}

named! {
    /// Gaussians behind the foreground, where depth maps lift it.
    Behind: "behind" {
        /// Adds Gaussians behind the edges of the foreground, for views that look past them.
        #[default]
        On = "on",
        /// Adds none: a turned view shows holes at the edges of the foreground.
        Off = "off",
    }
}

named! {
    /// Static regions of the picture.
    StaticRegions: "still" {
        /// Their Gaussians are kept while the frames differ by no more than the camera's noise. Applies where motion is
        /// not the network's, fusion is persistent, positions are means, and neither a depth map nor a guess lifts the
        /// frames.
        Keep = "keep",
        /// As [`StaticRegions::Keep`], and with a codec's noise also while a region stays within 3/255 (38.6 dB) of its
        /// mean, in place of 2/255 (42.1 dB).
        Loose = "loose",
        /// They are computed for each key frame, like all others.
        #[default]
        Off = "off",
    }
}

impl StaticRegions {
    /// The root mean square of a block's difference from its mean, without the mean of that, up to which the block is
    /// kept where the noise is a codec's; `None` where none is kept.
    pub(super) fn close(self) -> Option<f64> {
        match self {
            StaticRegions::Keep => Some(2.0 / 255.0),
            StaticRegions::Loose => Some(3.0 / 255.0),
            StaticRegions::Off => None,
        }
    }
}

named! {
    /// How positions are drawn, where the model predicts a distribution.
    SamplingMode: "sampling" {
        /// The distribution's mean.
        #[default]
        Mean = "mean",
        /// One draw per Gaussian, a function of seed, key frame and index alone.
        Sample = "sample",
    }
}

/// Work that is left out.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Reuse {
    /// None.
    Off,
    /// Results of the same input bits as before, and branches that add zero ([`streamsplat_model::zero_output`]). No
    /// output bit changes.
    #[default]
    Exact,
    /// Also results of tokens that moved by no more than this fraction of their length, from 0 to 1. See
    /// [`streamsplat_model::reuse`].
    Within(f32),
}

impl fmt::Display for Reuse {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Reuse::Off => f.write_str("off"),
            Reuse::Exact => f.write_str("exact"),
            Reuse::Within(tolerance) => write!(f, "{tolerance}"),
        }
    }
}

impl FromStr for Reuse {
    type Err = UnknownChoice;

    /// `off`, `exact`, or a tolerance.
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match (text, text.parse::<f32>()) {
            ("off", _) => Ok(Reuse::Off),
            ("exact", _) => Ok(Reuse::Exact),
            (_, Ok(tolerance)) if (0.0..=1.0).contains(&tolerance) => Ok(Reuse::Within(tolerance)),
            _ => Err(UnknownChoice {
                what: "reuse",
                expected: "off, exact, a tolerance from 0 to 1".to_owned(),
                found: text.to_owned(),
            }),
        }
    }
}

/// A peak signal-to-noise ratio, in dB, from 20 to 100.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
pub struct Decibels(f32);

impl Decibels {
    /// 100 dB, above any image.
    pub const MOST: Decibels = Decibels(100.0);

    /// Returns `decibels`; `None` unless it is from 20 to 100.
    pub fn new(decibels: f32) -> Option<Self> {
        (20.0..=100.0).contains(&decibels).then_some(Self(decibels))
    }

    /// The value in dB.
    pub fn get(self) -> f32 {
        self.0
    }
}

impl fmt::Display for Decibels {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl FromStr for Decibels {
    type Err = UnknownChoice;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let found = text.parse().ok().and_then(Self::new);
        found.ok_or_else(|| UnknownChoice {
            what: "ratio",
            expected: "20 to 100 dB".to_owned(),
            found: text.to_owned(),
        })
    }
}

/// Number of key frames after which a Gaussian that nothing continues is dropped at the latest.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct MaxAge(pub u32);

impl Default for MaxAge {
    /// Eight: a survivor's opacity halves in every interval, so that little of it is left then.
    fn default() -> Self {
        Self(8)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn choices_are_found_by_their_names_and_others_are_refused() {
        for fusion in Fusion::ALL {
            assert_eq!(fusion.name().parse(), Ok(*fusion));
        }
        let error = "both".parse::<Fusion>().unwrap_err();
        assert_eq!(error.to_string(), r#"unknown fusion "both": expected one of persistent, pairwise"#);
        for reuse in [Reuse::Off, Reuse::Exact, Reuse::Within(0.0), Reuse::Within(0.03)] {
            assert_eq!(reuse.to_string().parse(), Ok(reuse));
        }
        for wrong in ["some", "-0.1", "1.5", "nan", "inf", ""] {
            assert!(wrong.parse::<Reuse>().is_err(), "{wrong}");
        }
        assert_eq!("sample".parse(), Ok(SamplingMode::Sample));
        assert_eq!("given".parse(), Ok(DepthRange::Given));
    }
}
