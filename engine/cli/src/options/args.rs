//! Arguments of the command line.

use std::ffi::OsString;
use std::path::PathBuf;

use clap::{Args, CommandFactory, FromArgMatches, Parser, Subcommand};
use serde::{Deserialize, Serialize};
use streamsplat::Size;
use streamsplat::fit::Fit;
use streamsplat::formats::Limits;
use streamsplat::render::Backend;
use streamsplat::run::options::{self, Machine, Motion, NamedMatrix, RunOptions, StreamOptions, Times, ViewOptions};
use streamsplat::run::outputs::Emit;
use streamsplat::still::Axes;

use crate::console::Console;
use crate::console::failure::Failure;
use crate::options::antialias::Antialias;
use crate::options::optics::Optics;

/// Ordinary video in, a dynamic 3D Gaussian scene out, on CPUs, the same to the last bit everywhere.
#[derive(Parser)]
#[command(name = "streamsplat", version = crate::console::version::version(), arg_required_else_help = true)]
pub struct Cli {
    #[command(subcommand)]
    pub command: Command,
    #[command(flatten)]
    pub console: Console,
}

impl Cli {
    /// Returns the command line, with presets' defaults in the help of their options.
    pub fn with_defaults() -> clap::Command {
        let fill = |command: clap::Command| {
            options::defaults().into_iter().fold(command, |command, (name, default)| {
                let id = name.replace('-', "_");
                if !command.get_arguments().any(|argument| *argument.get_id() == id) {
                    return command;
                }
                command.mut_arg(id, |argument| {
                    let help = argument.get_help().map(ToString::to_string).unwrap_or_default();
                    // Options with a default of their own show that one.
                    if help.contains("[default") || !argument.get_default_values().is_empty() {
                        return argument;
                    }
                    argument.help(format!("{help} [default: {default}]"))
                })
            })
        };
        ["run", "eval"].into_iter().fold(Cli::command(), |cli, name| cli.mut_subcommand(name, fill))
    }

    /// Reads a command line, whose first word is the program's name.
    pub fn read(arguments: impl IntoIterator<Item = OsString>) -> Result<Cli, clap::Error> {
        Cli::from_arg_matches(&Cli::with_defaults().try_get_matches_from(arguments)?)
    }
}

#[derive(Subcommand)]
pub enum Command {
    /// Video → scene, frames, report
    Run(Box<RunArgs>),
    /// Scene → images at chosen times and cameras
    Render(Box<RenderArgs>),
    /// Key frames in, the frames between held out: PSNR and SSIM of the scene and of simple baselines
    Eval(Box<EvalArgs>),
    /// A model or a scene: sizes, parts, digests, cost
    Inspect(InspectArgs),
    /// A scene in a format that viewers read, one file per time, or as one compressed file
    Export(ExportArgs),
    /// The identity under a pixel and its path through time
    Track(TrackArgs),
    /// A page that shows a scene in a browser
    View(ViewArgs),
    /// Measurements (runs the streamsplat-bench next to this program)
    #[command(disable_help_flag = true)]
    Bench {
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        arguments: Vec<std::ffi::OsString>,
    },
    /// Repeat what DIR/run.json describes; exit code 1 if a digest differs
    Verify(VerifyArgs),
    /// Difference of two images, videos, folders or scenes: none, or where and by how much; exit code 1 if they differ.
    /// SSIM is that of scikit-image with gaussian_weights=True, its sample covariance and data_range=1
    Compare(CompareArgs),
    /// Golden images: record a list of renders, and check them with zero tolerance
    Golden(GoldenArgs),
    /// Print the completions of a shell
    Completions {
        /// Shell to complete for
        shell: clap_complete::Shell,
    },
    /// The manual page
    Man {
        /// Write streamsplat.1 and a page per command into this folder instead of printing the first
        #[arg(long, value_name = "DIR")]
        out: Option<PathBuf>,
    },
}

#[derive(Args, Clone)]
pub struct RunArgs {
    /// Folder of images, .y4m file, - (y4m on standard input), or any video file ffmpeg reads
    pub input: PathBuf,
    /// Folder for the results, or a video file (.y4m, .mp4, .webm, .mkv, .mov, .m4v, .gif, .webp, .avif), or - (y4m on
    /// standard output) [default: here, named after the input: of clip.mp4 the video clip-scene.mp4 with the scene
    /// clip-scene.ssz next to it, of images or y4m the folder clip-scene]
    #[arg(long, short, value_name = "DIR")]
    pub out: Option<PathBuf>,
    #[command(flatten)]
    pub options: RunOptions,
    #[command(flatten)]
    pub machine: Machine,
    /// Resume an interrupted run from its last whole interval; start a new one if none exists
    #[arg(long)]
    pub resume: bool,
    /// Replace finished results of another input or other options, or a video that no run wrote
    #[arg(long)]
    pub overwrite: bool,
    /// Show the stream in a browser while it is processed, and after that until Ctrl-C [default port: 8707]
    #[arg(long, value_name = "PORT", num_args = 0..=1, require_equals = true, default_missing_value = "8707")]
    pub serve: Option<u16>,
    /// Also write run.json here
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

#[derive(Args, Clone)]
pub struct RenderArgs {
    /// A scene's folder, its scene.json, the folder of a run, a container (.ssz), or a still scene (PLY, SPZ, SOG,
    /// glTF, .splat)
    pub scene: PathBuf,
    /// Folder for the images, or a video file, or - (y4m on standard output); for a single image a .png, .exr or .webp
    /// file (lossless WebP; for several images a video)
    #[arg(long, short, value_name = "DIR")]
    pub out: PathBuf,
    #[command(flatten)]
    pub options: RenderOptions,
    #[command(flatten)]
    pub machine: Machine,
    /// Also write run.json here
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// Options of a rendering that affect its output.
#[derive(Args, Clone, Debug, Default, Serialize, Deserialize)]
pub struct RenderOptions {
    #[command(flatten)]
    pub view: ViewOptions,
    #[command(flatten)]
    #[serde(flatten)]
    pub motion: Motion,
    /// Images per second of the scene, if no times are given [default: the source's frame rate]
    #[arg(long, value_name = "RATE", allow_negative_numbers = true)]
    pub fps: Option<f64>,
    /// Quality of an encoded video, as ffmpeg's -crf: lower is better; 1 to 51 for .mp4, .m4v, .mov and .mkv, 0 to 63
    /// for .webm and .avif [default: 6; 18 for .webm and .avif]
    #[arg(long, value_name = "N")]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub crf: Option<u8>,
    /// Outputs: rgb, webp (lossless colours), depth, alpha, exr (colour, depth and alpha as layers of one file)
    /// [default: rgb]
    #[arg(long, value_name = "LIST")]
    #[serde(default, with = "streamsplat::run::options::text")]
    pub emit: Option<Emit>,
    /// Dim footprints smaller than a pixel instead of enlarging them, for scenes trained with anti-aliasing
    /// (Mip-Splatting's 2D filter, "antialiased" in gsplat): on, off, or auto, if the file has a mark of such training
    /// [default: auto; on without a MODE]
    #[arg(long, value_name = "MODE", num_args = 0..=1, default_value = "auto", default_missing_value = "on", hide_default_value = true)]
    #[serde(default, skip_serializing_if = "Antialias::is_auto")]
    pub antialias: Antialias,
    #[command(flatten)]
    #[serde(flatten)]
    pub reading: Reading,
    #[command(flatten)]
    #[serde(flatten)]
    pub optics: Optics,
    #[command(flatten)]
    #[serde(flatten)]
    pub limit: Limit,
    /// True if exactly one image may be rendered.
    #[arg(skip)]
    #[serde(skip)]
    pub single: bool,
}

/// Interpretation of a still scene's numbers.
#[derive(Args, Clone, Debug, Default, Serialize, Deserialize)]
pub struct Reading {
    /// Axes of a still scene's coordinates: where x, y and z point, a letter each of Right or Left, Down or Up, Front
    /// or Back; rdf in PLY, rub by SPZ's own description [default: what the file names, else its format's]
    #[arg(long, value_name = "AXES")]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub axes: Option<String>,
}

impl Reading {
    /// Returns the axes, if some are given.
    pub fn axes(&self) -> Result<Option<Axes>, Failure> {
        let parsed = self.axes.as_deref().map(|text| text.parse().map_err(|e| Failure::usage(format!("--axes: {e}"))));
        parsed.transpose()
    }
}

/// Limits on the content of input files.
#[derive(Args, Clone, Debug, Default, Serialize, Deserialize)]
pub struct Limit {
    /// Maximum number of Gaussians of an interval or of a still scene [default: 16777216]
    #[arg(long, value_name = "N")]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub limit_gaussians: Option<usize>,
    /// Maximum bytes of a scene in memory per byte of its file; 16 MiB are always allowed [default: 256]
    #[arg(long, value_name = "N")]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub limit_ratio: Option<u64>,
    /// Level of detail of a streamed SOG scene (lod-meta.json); 0 is the finest [default: 0]
    #[arg(long, value_name = "N")]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lod: Option<usize>,
}

impl Limit {
    /// Returns the limits, with defaults where unset.
    pub fn limits(&self) -> Limits {
        let Limits { gaussians, ratio, level } = Limits::default();
        Limits {
            gaussians: self.limit_gaussians.unwrap_or(gaussians),
            ratio: self.limit_ratio.unwrap_or(ratio),
            level: self.lod.unwrap_or(level),
        }
    }
}

#[derive(Args, Clone)]
pub struct EvalArgs {
    /// A video as for run, or a folder of such videos
    pub input: PathBuf,
    #[command(flatten)]
    pub stream: StreamOptions,
    /// Also process the frames between key frames, and measure them as seen; without it they are only compared
    #[arg(long)]
    pub seen: bool,
    /// Fit of frames into the model's input: stretch or letterbox
    #[arg(long, value_name = "MODE", default_value_t = Fit::Stretch)]
    pub fit: Fit,
    /// Frames per second of the input [default: its own, or 24]
    #[arg(long, value_name = "RATE", allow_negative_numbers = true)]
    pub fps: Option<f64>,
    /// Matrix of the input's luma and chroma, as for run
    #[arg(long, value_name = "NAME")]
    pub matrix: Option<NamedMatrix>,
    /// Size of the images that are compared at 256x256: model, source or WIDTHxHEIGHT; PSNR at the source's own size is
    /// measured as well
    #[arg(long, value_name = "SIZE", default_value_t = Size::Model)]
    pub size: Size,
    /// Also measure LPIPS by this ONNX file: two images in [-1,1] in, one number out; run by ONNX Runtime
    #[arg(long, value_name = "FILE")]
    pub lpips_model: Option<PathBuf>,
    /// Renderer: cpu, or wgpu (a graphics card) [default: cpu]
    #[arg(long, value_name = "NAME")]
    pub renderer: Option<Backend>,
    #[command(flatten)]
    pub machine: Machine,
    /// Write the figures here
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

#[derive(Args, Clone)]
pub struct InspectArgs {
    /// A checkpoint, a scene (folder, container, PLY, SPZ, SOG, glTF, .splat), or an interval
    pub file: PathBuf,
    /// Write the findings here
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    #[command(flatten)]
    pub reading: Reading,
    #[command(flatten)]
    pub limit: Limit,
}

#[derive(Args, Clone)]
pub struct ExportArgs {
    /// A scene's folder, its scene.json, the folder of a run, a container (.ssz), or a still scene (PLY, SPZ, SOG,
    /// glTF, .splat)
    pub scene: PathBuf,
    /// Scenes in time that follow it, for --format ssz: all become one scene. A scene that begins before the end of the
    /// previous one starts a frame after it
    #[arg(value_name = "SCENE")]
    pub more: Vec<PathBuf>,
    /// Format: ply (the layout of 3D Gaussian splatting), compressed-ply, spz, sog, glb, splat (32-byte records), or
    /// ssz (the whole scene, compressed) [default: what the name of the output ends in]
    #[arg(long, value_name = "NAME")]
    pub format: Option<String>,
    /// Folder for 000000.ply and so on; for a single time, a file with the format's name as its ending; for ssz, a file
    #[arg(long, short, value_name = "PATH")]
    pub out: PathBuf,
    /// Times in seconds: a list (0,0.5,1.25) or START:END:COUNT [default: the input's own frame times]
    #[arg(long, value_name = "TIMES", allow_hyphen_values = true)]
    pub times: Option<Times>,
    /// Files per second of the scene, if no times are given [default: the source's frame rate]
    #[arg(long, value_name = "RATE", allow_negative_numbers = true)]
    pub fps: Option<f64>,
    /// Version of SPZ files: 3, which viewers open, or 4 [default: 3]
    #[arg(long, value_name = "N")]
    pub spz_version: Option<u32>,
    #[command(flatten)]
    pub reading: Reading,
    #[command(flatten)]
    pub limit: Limit,
    #[command(flatten)]
    pub machine: Machine,
}

#[derive(Args, Clone)]
pub struct TrackArgs {
    /// A scene's folder, its scene.json, the folder of a run, or a container (.ssz)
    pub scene: PathBuf,
    /// Time of the point, in seconds
    #[arg(long, value_name = "T", allow_negative_numbers = true)]
    pub at: f64,
    /// Column and row in the source's frame, pixel centres at whole numbers
    #[arg(long, value_name = "X,Y", allow_hyphen_values = true)]
    pub point: String,
    /// Times of the path in seconds: a list or START:END:COUNT [default: the input's own frame times, and T]
    #[arg(long, value_name = "TIMES", allow_hyphen_values = true)]
    pub times: Option<Times>,
    /// Points per second of the scene, if no times are given [default: the source's frame rate]
    #[arg(long, value_name = "RATE", allow_negative_numbers = true)]
    pub fps: Option<f64>,
    /// Write the path (CSV) here instead of to standard output
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Also write the findings here
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    #[command(flatten)]
    pub limit: Limit,
    #[command(flatten)]
    pub machine: Machine,
}

#[derive(Args, Clone)]
pub struct ViewArgs {
    /// A scene's folder, its scene.json, the folder of a run, a container (.ssz), or a still scene (PLY, SPZ, SOG,
    /// glTF, .splat), whose colours depend on the view as in the file
    pub scene: PathBuf,
    /// Port to serve on; 0 takes any free one [default: 8707]
    #[arg(long, value_name = "N")]
    pub port: Option<u16>,
    /// Address to serve on
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1")]
    pub host: std::net::IpAddr,
    /// A name that browsers may use for this machine, in addition to addresses and localhost; can be repeated
    #[arg(long, value_name = "NAME")]
    pub allow_host: Vec<String>,
    /// Serve nothing: write the page with the scene in it as this .html file, which opens by itself
    #[arg(long, value_name = "FILE", conflicts_with_all = ["port", "host", "allow_host"])]
    pub html: Option<PathBuf>,
    /// Address of the page of --html on the web, for the tags of link previews; its poster is FILE.png next to it
    #[arg(long, value_name = "URL", requires = "html")]
    pub url: Option<String>,
    #[command(flatten)]
    pub reading: Reading,
    #[command(flatten)]
    pub limit: Limit,
    #[command(flatten)]
    pub machine: Machine,
}

#[derive(Args, Clone)]
pub struct VerifyArgs {
    /// Folder of a run (or its .run.json, for a run that wrote a video)
    pub dir: PathBuf,
    #[command(flatten)]
    pub machine: Machine,
}

#[derive(Args, Clone)]
pub struct CompareArgs {
    /// An image, a video, a scene, or a folder, for example a rendering, of which every file is compared
    pub a: PathBuf,
    /// Another of the same kind
    pub b: PathBuf,
    /// Pass if no sample of any channel differs by more than N steps of 8 bits: N/255 of the range of whole numbers,
    /// N/255 for floats; parts of a step are allowed
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    pub max_abs: Option<f64>,
    /// Pass if every picture has at least this PSNR over all its channels, peak 1, in dB; with --max-abs both must hold
    #[arg(long, value_name = "DB", allow_negative_numbers = true)]
    pub psnr: Option<f64>,
    /// Write a PNG that shows where the two pictures that differ most differ
    #[arg(long, value_name = "FILE")]
    pub heat: Option<PathBuf>,
    /// Print JSON instead of text, or write it to FILE (--json=FILE) in addition to the text
    #[arg(long, value_name = "FILE", num_args = 0..=1, require_equals = true, default_missing_value = "-")]
    pub json: Option<PathBuf>,
    #[command(flatten)]
    pub limit: Limit,
    #[command(flatten)]
    pub machine: Machine,
}

#[derive(Args, Clone)]
pub struct GoldenArgs {
    #[command(subcommand)]
    pub action: GoldenAction,
}

#[derive(Subcommand, Clone)]
pub enum GoldenAction {
    /// Draw everything in FILE.toml and record digests and previews in the folder FILE.golden next to it
    Record(GoldenRecordArgs),
    /// Draw everything again and compare with the record; exit code 1 if one bit differs
    Check(GoldenCheckArgs),
}

#[derive(Args, Clone)]
pub struct GoldenRecordArgs {
    /// The list of renders (docs/golden.md)
    #[arg(value_name = "FILE.toml")]
    pub file: PathBuf,
    #[command(flatten)]
    pub limit: Limit,
    #[command(flatten)]
    pub machine: Machine,
}

#[derive(Args, Clone)]
pub struct GoldenCheckArgs {
    /// The list of renders (docs/golden.md)
    #[arg(value_name = "FILE.toml")]
    pub file: PathBuf,
    /// Folder for images that differ, with the expected ones [default: FILE.failed]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Write the results as JUnit XML
    #[arg(long, value_name = "FILE")]
    pub junit: Option<PathBuf>,
    /// Print JSON instead of the table, or write it to FILE (--json=FILE) in addition to the table
    #[arg(long, value_name = "FILE", num_args = 0..=1, require_equals = true, default_missing_value = "-")]
    pub json: Option<PathBuf>,
    #[command(flatten)]
    pub limit: Limit,
    #[command(flatten)]
    pub machine: Machine,
}
