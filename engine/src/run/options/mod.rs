//! Options of a run: one set of structures for Rust, the command line (feature `clap`) and the record of a run.

pub mod motion;
mod presets;
pub mod settings;
pub mod text;
mod values;

use std::fmt::Display;
use std::path::PathBuf;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::Error;
use super::outputs::Emit;
use crate::Size;
use crate::fit::Fit;
use crate::gap::Gap;
use crate::render::Backend;
use crate::stream::{
    Behind, Decibels, Fade, FlowEffort, Fusion, MotionFrom, Quality, Resolution, Reuse, SamplingMode, StaticRegions,
};
use streamsplat_model::Precision;

pub use presets::defaults;
pub use settings::DepthFrom;
pub use values::{Background, DepthModel, DepthScale, DepthSource, Fill, Isa, NamedMatrix, Swing, Threads, Times};

/// Options that are set by name from text, as on the command line.
trait Named {
    /// Sets the option `name` if that is `own` or within this structure; `None` where there is no such option.
    fn put(&mut self, own: &str, name: &str, text: &str) -> Option<Result<(), String>>;

    /// Takes unset values from `other`.
    fn fill(&mut self, other: &Self);
}

impl<T: FromStr<Err: Display> + Clone> Named for Option<T> {
    fn fill(&mut self, other: &Self) {
        if self.is_none() {
            self.clone_from(other);
        }
    }

    fn put(&mut self, own: &str, name: &str, text: &str) -> Option<Result<(), String>> {
        (own == name).then(|| text.parse().map(|value| *self = Some(value)).map_err(|e| with_found(e, text)))
    }
}

/// Appends the text to the message, unless it contains it.
fn with_found(e: impl Display, text: &str) -> String {
    let message = e.to_string();
    if message.contains(text) { message } else { format!("{message}, found {text:?}") }
}

/// An option that is a single value of its type.
macro_rules! values {
    ($($kind:ty),+) => { $(impl Named for $kind {
        fn fill(&mut self, _: &Self) {}

        fn put(&mut self, own: &str, name: &str, text: &str) -> Option<Result<(), String>> {
            (own == name).then(|| text.parse().map(|value| *self = value).map_err(|e| with_found(e, text)))
        }
    })+ };
}

values!(bool, u64, Isa, Background);

/// Structures of options whose fields can be set by name.
macro_rules! options {
    ($(#[$meta:meta])* pub struct $name:ident { $($(#[$field_meta:meta])* pub $field:ident: $kind:ty,)+ }) => {
        $(#[$meta])*
        pub struct $name { $($(#[$field_meta])* pub $field: $kind,)+ }

        impl Named for $name {
            fn fill(&mut self, other: &Self) {
                $(self.$field.fill(&other.$field);)+
            }

            fn put(&mut self, _: &str, name: &str, text: &str) -> Option<Result<(), String>> {
                $(if let Some(done) = self.$field.put(stringify!($field), name, text) {
                    return Some(done);
                })+
                None
            }
        }

        impl $name {
            /// Sets the option of this name (`refine_every` or `refine-every`) from its text on the command line;
            /// returns false for an unknown name.
            ///
            /// # Errors
            /// [`Error::Usage`] for a text that is not a value of the option.
            pub fn set(&mut self, name: &str, text: &str) -> Result<bool, Error> {
                match Named::put(self, "", &name.replace('-', "_"), text) {
                    Some(Ok(())) => Ok(true),
                    Some(Err(e)) => Err(Error::usage(format!("--{}: {e}", name.replace('_', "-")))),
                    None => Ok(false),
                }
            }
        }
    };
}

options! {
    /// Threads and instruction set. They change no output bit.
    #[derive(Clone, Debug, Default)]
    #[cfg_attr(feature = "clap", derive(clap::Args))]
    pub struct Machine {
        /// Threads [default: one per processor]
        #[cfg_attr(feature = "clap", arg(long, value_name = "N"))]
        pub threads: Option<Threads>,
        /// Instruction set: scalar, avx2, avx512, avx512vnni, avx512bf16, neon or auto
        #[cfg_attr(feature = "clap", arg(long, value_name = "NAME", default_value_t))]
        pub isa: Isa,
    }
}

options! {
    /// The model and its arithmetic.
    #[derive(Clone, Debug, Default, Serialize, Deserialize)]
    #[cfg_attr(feature = "clap", derive(clap::Args))]
    pub struct ModelOptions {
        /// Checkpoint (safetensors, official layout; FILE.json next to it for what shapes cannot say) [default: the
        /// small embedded one]
        #[cfg_attr(feature = "clap", arg(long, value_name = "FILE"))]
        pub model: Option<PathBuf>,
        /// Weights of DINOv2 with registers, for models conditioned on them: dinov2_vitb14_reg4_pretrain.pth, or the
        /// file of transformers or timm
        #[cfg_attr(feature = "clap", arg(long, value_name = "FILE"))]
        pub dinov2: Option<PathBuf>,
        /// Arithmetic of the large matrix products: f32, bf16 or int8
        #[cfg_attr(feature = "clap", arg(long, value_name = "MODE"))]
        #[serde(default, skip_serializing_if = "Option::is_none", with = "text")]
        pub precision: Option<Precision>,
    }
}

options! {
    /// Options of the way from a video to a scene.
    #[derive(Clone, Debug, Default, Serialize, Deserialize)]
    #[cfg_attr(feature = "clap", derive(clap::Args))]
    pub struct StreamOptions {
        /// The model.
        #[cfg_attr(feature = "clap", command(flatten))]
        pub model: ModelOptions,
        /// Trade-off of error and time: realtime, balanced or best; sets depth, gap, resolution, motion, flow, fade,
        /// refine, refine-every, refine-to, detail, precision, reuse and still where they are not given
        #[cfg_attr(feature = "clap", arg(long, value_name = "NAME"))]
        #[serde(default, skip_serializing_if = "Option::is_none", with = "text")]
        pub quality: Option<Quality>,
        /// The steps of the authors' own script for whole clips: the default of each option names its value there, and
        /// images have the model's size
        #[cfg_attr(feature = "clap", arg(long, conflicts_with = "quality"))]
        #[serde(default, skip_serializing_if = "std::ops::Not::not")]
        pub like_paper: bool,
        /// Inverse depth: none, auto (found by parallax where the camera moves, for models that ignore depth), guess
        /// (auto, and without parallax a ground with moving bodies upright on it; static regions are not kept), a
        /// folder of EXR, TIFF, 16-bit PNG or NPY files, one per frame, or onnx:FILE, a network that ONNX Runtime runs
        #[cfg_attr(feature = "clap", arg(long, value_name = "SOURCE"))]
        #[serde(default, skip_serializing_if = "Option::is_none", with = "text")]
        pub depth: Option<DepthSource>,
        /// Properties of the depth network that are not in its file: size=N or WxH, multiple=N, mean=R/G/B,
        /// std=R/G/B, metric, output=NAME, separated by commas; with a folder metric alone: its files hold depth, not
        /// inverse depth, and 0, infinity or no number where there is none [default: size=518,multiple=14 and
        /// ImageNet's mean and std]
        #[cfg_attr(feature = "clap", arg(long, value_name = "LIST"))]
        #[serde(default, skip_serializing_if = "Option::is_none", with = "text")]
        pub depth_model: Option<DepthModel>,
        /// Depth is normalised by each frame's own range (frame), the range of all maps (clip), or that of the key
        /// frames' maps (keys, with a fixed gap)
        #[cfg_attr(feature = "clap", arg(long, value_name = "RANGE"))]
        #[serde(default, with = "text")]
        pub depth_range: Option<DepthScale>,
        /// Gaussians behind foreground objects, where depth maps lift Gaussians: on adds them, off leaves holes
        /// there [default: on]
        #[cfg_attr(feature = "clap", arg(long, value_name = "on|off"))]
        #[serde(default, skip_serializing_if = "Option::is_none", with = "text")]
        pub behind: Option<Behind>,
        /// Every N-th frame is a key frame; or auto, auto:MOST, auto:LEAST-MOST or auto:LEAST-MOST:DB: as few as
        /// each interval's images need for a mean PSNR of DB decibels, LEAST to MOST frames apart; frames wait for at
        /// most MOST-1 later ones; auto alone is auto:3-12:38
        #[cfg_attr(feature = "clap", arg(long, value_name = "N"))]
        #[serde(default, skip_serializing_if = "Option::is_none", with = "text")]
        pub gap: Option<Gap>,
        /// Size at which the model sees frames: HEIGHTxWIDTH in whole patches (8 pixels), native (the model's own), or
        /// auto (four times its area in the source's shape, never more than the source)
        #[cfg_attr(feature = "clap", arg(long, value_name = "SIZE"))]
        #[serde(default, skip_serializing_if = "Option::is_none", with = "text")]
        pub resolution: Option<Resolution>,
        /// Motion between key frames: network (as the model predicts it), frames (optical flow between the key frames)
        /// or between (optical flow through the frames in between); with network given, fade is network and depth none
        /// by default
        #[cfg_attr(feature = "clap", arg(long, value_name = "FROM"))]
        #[serde(default, skip_serializing_if = "Option::is_none", with = "text")]
        pub motion: Option<MotionFrom>,
        /// Effort of optical flow: fine or coarse (a quarter of the resolution)
        #[cfg_attr(feature = "clap", arg(long, value_name = "EFFORT"))]
        #[serde(default, skip_serializing_if = "Option::is_none", with = "text")]
        pub flow: Option<FlowEffort>,
        /// Fading of Gaussians between key frames: network (each as the model predicts it) or fixed (all alike; where
        /// motion is not the model's either, nothing of its prediction between key frames is computed)
        #[cfg_attr(feature = "clap", arg(long, value_name = "HOW"))]
        #[serde(default, skip_serializing_if = "Option::is_none", with = "text")]
        pub fade: Option<Fade>,
        /// Steps of conjugate gradients that fit colours to the frames; 0: the colours of the model
        #[cfg_attr(feature = "clap", arg(long, value_name = "N", allow_negative_numbers = true))]
        #[serde(default, skip_serializing_if = "Option::is_none")]
        pub refine: Option<u32>,
        /// Fit colours to every K-th of the frames between key frames
        #[cfg_attr(feature = "clap", arg(long, value_name = "K", value_parser = clap::value_parser!(u32).range(1..)))]
        #[serde(default, skip_serializing_if = "Option::is_none")]
        pub refine_every: Option<u32>,
        /// PSNR, in dB, from which on a part of the images between key frames is close enough to its frames: no colours
        /// are fitted there; 20 to 100
        #[cfg_attr(feature = "clap", arg(long, value_name = "DB", allow_negative_numbers = true))]
        #[serde(default, skip_serializing_if = "Option::is_none", with = "text")]
        pub refine_to: Option<Decibels>,
        /// Gaussians of a pixel's size where the fit of colours leaves error, at most N for each 1000 pixels of a key
        /// frame; 0 for none. Only where colours are fitted
        #[cfg_attr(feature = "clap", arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=1000)))]
        #[serde(default, skip_serializing_if = "Option::is_none")]
        pub detail: Option<u32>,
        /// Gaussians carried over a key frame: persistent (identities go on and survivors fade) or pairwise (each
        /// interval by itself)
        #[cfg_attr(feature = "clap", arg(long, value_name = "MODE"))]
        #[serde(default, with = "text")]
        pub fusion: Option<Fusion>,
        /// Key frames after which a Gaussian that nothing continues is dropped at the latest [default: 8]
        #[cfg_attr(feature = "clap", arg(long, value_name = "N"))]
        pub max_age: Option<u32>,
        /// Positions of models that predict distributions: mean or sample
        #[cfg_attr(feature = "clap", arg(long, value_name = "MODE"))]
        #[serde(default, with = "text")]
        pub sampling: Option<SamplingMode>,
        /// Static regions of the picture: keep (their Gaussians are kept while frames differ by no more than the
        /// camera's noise, and a static camera's motion and colours come from every second of four or more frames in
        /// between, colours that are fitted to all frames also from what differs in the others; where no depth lifts
        /// the frames), loose (they are also kept within 38.6 dB in place of 42.1 dB where a codec changes them) or off
        /// (every frame counts, and every region is computed for each key frame)
        #[cfg_attr(feature = "clap", arg(long, value_name = "keep|loose|off"))]
        #[serde(default, skip_serializing_if = "Option::is_none", with = "text")]
        pub still: Option<StaticRegions>,
        /// Seed of everything drawn at random
        #[cfg_attr(feature = "clap", arg(long, value_name = "N", default_value_t = 0))]
        pub seed: u64,
        /// Work left out: off, exact (what was computed from the same bits before or adds nothing; no output bit
        /// changes), or a tolerance from 0 to 1: tokens that moved by less than this fraction keep what was computed
        /// for them
        #[cfg_attr(feature = "clap", arg(long, value_name = "MODE", allow_negative_numbers = true))]
        #[serde(default, skip_serializing_if = "Option::is_none", with = "text")]
        pub reuse: Option<Reuse>,
    }
}

options! {
    /// Everything of a run that reaches its output.
    #[derive(Clone, Debug, Default, Serialize, Deserialize)]
    #[cfg_attr(feature = "clap", derive(clap::Args))]
    pub struct RunOptions {
        /// The way from the video to the scene.
        #[cfg_attr(feature = "clap", command(flatten))]
        pub stream: StreamOptions,
        /// Fit of frames into the model's input: letterbox or stretch
        #[cfg_attr(feature = "clap", arg(long, value_name = "MODE"))]
        #[serde(default, with = "text")]
        pub fit: Option<Fit>,
        /// Frames per second of the input [default: its own, or 24]
        #[cfg_attr(feature = "clap", arg(long, value_name = "RATE", allow_negative_numbers = true))]
        pub fps: Option<f64>,
        /// Matrix of the input's luma and chroma: bt709, bt601, bt2020, fcc or smpte240m [default: what the file names,
        /// else bt709 above 1024x576, bt601 below]
        #[cfg_attr(feature = "clap", arg(long, value_name = "NAME"))]
        #[serde(default, skip_serializing_if = "Option::is_none", with = "text")]
        pub matrix: Option<NamedMatrix>,
        /// The images.
        #[cfg_attr(feature = "clap", command(flatten))]
        pub view: ViewOptions,
        /// The camera's motion.
        #[cfg_attr(feature = "clap", command(flatten))]
        #[serde(flatten)]
        pub motion: Motion,
        /// Outputs: rgb, depth, alpha, exr (these three as layers of one file), scene, ply, tracks [default: rgb,scene]
        #[cfg_attr(feature = "clap", arg(long, value_name = "LIST"))]
        #[serde(default, with = "text")]
        pub emit: Option<Emit>,
        /// Stop after this many input frames
        #[cfg_attr(feature = "clap", arg(long, value_name = "N"))]
        pub frames: Option<usize>,
        /// Quality of an encoded video, as ffmpeg's -crf: less is better; 1 to 51 for .mp4, .m4v, .mov and .mkv, 0 to
        /// 63 for .webm and .avif [default: 6; 18 for .webm and .avif]
        #[cfg_attr(feature = "clap", arg(long, value_name = "N"))]
        #[serde(default, skip_serializing_if = "Option::is_none")]
        pub crf: Option<u8>,
        /// Leave the input's sound out of an encoded video; it is taken along otherwise, but not with --times or --fps
        #[cfg_attr(feature = "clap", arg(long))]
        #[serde(default, skip_serializing_if = "std::ops::Not::not")]
        pub no_audio: bool,
    }
}

options! {
    /// Options of the images: times, size, camera, background and renderer.
    #[derive(Clone, Debug, Default, Serialize, Deserialize)]
    #[cfg_attr(feature = "clap", derive(clap::Args))]
    pub struct ViewOptions {
        /// Times in seconds: a list (0,0.5,1.25) or START:END:COUNT [default: the input's own frame times]
        #[cfg_attr(feature = "clap", arg(long, value_name = "TIMES", allow_hyphen_values = true))]
        #[serde(default, with = "text")]
        pub times: Option<Times>,
        /// Size of the images: model, source or WIDTHxHEIGHT [default: model; source where `run` writes a video; of
        /// still scenes the camera's own, or 1280x720]
        #[cfg_attr(feature = "clap", arg(long, value_name = "SIZE"))]
        #[serde(default, with = "text")]
        pub size: Option<Size>,
        /// Camera or camera path (JSON); for still scenes also cameras.json of 3D Gaussian splatting, transforms.json,
        /// or the folder of a COLMAP model [default: the source's own view; for a still scene one from which it is seen
        /// whole]
        #[cfg_attr(feature = "clap", arg(long, value_name = "FILE"))]
        pub camera: Option<PathBuf>,
        /// Camera of another program's file: its number from 0, or its image's name [default: all, one a second from 0]
        #[cfg_attr(feature = "clap", arg(long, value_name = "N|NAME", requires = "camera"))]
        #[serde(default, skip_serializing_if = "Option::is_none")]
        pub view: Option<String>,
        /// Colour behind everything: grey level or R,G,B, from 0 to 1; for render also transparent (PNG and EXR with
        /// alpha)
        #[cfg_attr(feature = "clap", arg(long, value_name = "COLOUR", default_value_t, allow_hyphen_values = true))]
        #[serde(with = "text::one")]
        pub background: Background,
        /// Renderer: cpu, or wgpu (a graphics card; images are then outside of the bit contract) [default: cpu]
        #[cfg_attr(feature = "clap", arg(long, value_name = "NAME"))]
        #[serde(default, skip_serializing_if = "Option::is_none", with = "text")]
        pub renderer: Option<Backend>,
    }
}

options! {
    /// A camera that moves around the middle of a scene, and its eyes.
    #[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
    #[cfg_attr(feature = "clap", derive(clap::Args))]
    pub struct Motion {
        /// Move the camera around the scene by DEGREES, from left to right, in SECONDS; in a scene in time it then
        /// swings back, and so on [default: 4 seconds; render of a scene in time: once in all of it]
        #[cfg_attr(
            feature = "clap",
            arg(long, value_name = "DEGREES[:SECONDS]", conflicts_with = "camera", allow_hyphen_values = true)
        )]
        #[serde(default, skip_serializing_if = "Option::is_none", with = "text")]
        pub orbit: Option<Swing>,
        /// Move the camera on a circle, DEGREES from the middle, once in SECONDS (loops) [default: 4 degrees, 4
        /// seconds; render of a scene in time: about 4 seconds, so that whole circles fit]
        #[cfg_attr(feature = "clap", arg(long, value_name = "DEGREES[:SECONDS]", conflicts_with_all = ["camera", "orbit"], num_args = 0..=1, require_equals = true, default_missing_value = Motion::SWAY))]
        #[serde(default, skip_serializing_if = "Option::is_none", with = "text")]
        pub sway: Option<Swing>,
        /// Turn once around the scene in SECONDS (loops)
        #[cfg_attr(feature = "clap", arg(long, value_name = "SECONDS", conflicts_with_all = ["camera", "orbit", "sway"], allow_negative_numbers = true))]
        #[serde(default, skip_serializing_if = "Option::is_none")]
        pub turntable: Option<f64>,
        /// How images of a moved camera fill what was never filmed, in a scene in time: extend (continue the colours
        /// around it), crop (for render: magnify until the picture's edges are outside, then extend) or none (show the
        /// background) [default: extend]
        #[cfg_attr(feature = "clap", arg(long, value_name = "WAY"))]
        #[serde(default, skip_serializing_if = "Option::is_none", with = "text")]
        pub fill: Option<Fill>,
        /// The views of a left and a right eye side by side, in images twice as wide
        #[cfg_attr(feature = "clap", arg(long))]
        #[serde(default, skip_serializing_if = "std::ops::Not::not")]
        pub stereo: bool,
        /// Distance between the eyes, as a part of their distance from the scene's middle [default: 0.06]
        #[cfg_attr(feature = "clap", arg(long, value_name = "PART", requires = "stereo", allow_negative_numbers = true))]
        #[serde(default, skip_serializing_if = "Option::is_none")]
        pub eye_distance: Option<f64>,
    }
}
