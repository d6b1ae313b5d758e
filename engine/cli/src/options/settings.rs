//! From options to the library's settings: every unknown or unavailable value is wrong use.

use std::path::PathBuf;
use std::str::FromStr;

use streamsplat::camera::{self, CameraFile, CameraPath};
use streamsplat::depth::{NetworkOptions, Range, Values};
use streamsplat::fit::Fit;
use streamsplat::gap::Gap;
use streamsplat::import::FormatError;
use streamsplat::render::Backend;
use streamsplat::source::colour::Matrix;
use streamsplat::stream::{
    Behind, DepthRange, Fade, FlowEffort, Fusion, MaxAge, ModelSource, MotionFrom, Quality, Resolution, Reuse,
    SamplingMode, Settings,
};
use streamsplat::{RenderOptions, Size};
use streamsplat_kernels::raster;
use streamsplat_model::Precision;

use crate::console::failure::Failure;
use crate::options::args::{EvalArgs, Machine, Model, RunOptions, Stream, ViewOptions};
use crate::options::motion::Course;
use crate::options::optics::Shutter;

/// `text` as a `T`, or wrong use of `option`.
pub fn choice<T: FromStr>(option: &str, text: &str) -> Result<T, Failure>
where
    T::Err: std::fmt::Display,
{
    text.parse().map_err(|e| Failure::usage(format!("{option}: {e}")))
}

/// The same, or the default where the option is not given.
pub fn choice_or_default<T: FromStr + Default>(option: &str, text: Option<&str>) -> Result<T, Failure>
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

impl Model {
    /// The model that is meant.
    pub fn source(&self) -> ModelSource {
        match &self.model {
            None => ModelSource::Embedded,
            Some(checkpoint) => ModelSource::File { checkpoint: checkpoint.clone(), dinov2: self.dinov2.clone() },
        }
    }

    /// The arithmetic that is meant.
    pub fn precision(&self) -> Result<Precision, Failure> {
        self.precision.as_deref().map_or_else(|| Ok(Precision::default()), |text| choice("--precision", text))
    }
}

/// The matrix of this name.
fn matrix(name: Option<&str>) -> Result<Option<Matrix>, Failure> {
    let named = |name: &str| {
        Matrix::named(name)
            .ok_or_else(|| Failure::usage(format!("--matrix: expected {}, found {name:?}", Matrix::NAMES.join(", "))))
    };
    name.map(named).transpose()
}

impl RunOptions {
    /// These options, with those of presets and defaults where they are unset ([`Stream::resolved`]).
    pub fn resolved(&self) -> Result<RunOptions, Failure> {
        let mut options = RunOptions { stream: self.stream.resolved()?, ..self.clone() };
        let fit = if options.stream.like_paper { Fit::Stretch } else { Fit::default() };
        options.fit.get_or_insert_with(|| fit.name().to_owned());
        Ok(options)
    }

    /// The matrix of the input, in place of its own.
    pub fn matrix(&self) -> Result<Option<Matrix>, Failure> {
        matrix(self.matrix.as_deref())
    }
}

impl EvalArgs {
    /// The same.
    pub fn matrix(&self) -> Result<Option<Matrix>, Failure> {
        matrix(self.matrix.as_deref())
    }
}

impl Stream {
    /// These options, with those of the preset where they are unset: `--like-paper`, or the quality (`balanced` by default for the model inside the
    /// program, none for other models). Options that no preset sets have their defaults.
    pub fn resolved(&self) -> Result<Stream, Failure> {
        let mut stream = if self.like_paper { self.as_the_authors() } else { self.with_quality()? };
        stream.depth_range.get_or_insert_with(|| "frame".to_owned());
        stream.fusion.get_or_insert_with(|| Fusion::default().to_string());
        stream.sampling.get_or_insert_with(|| SamplingMode::default().to_string());
        Ok(stream)
    }

    /// The steps of the authors' script for whole clips.
    fn as_the_authors(&self) -> Stream {
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
    fn with_quality(&self) -> Result<Stream, Failure> {
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
    pub fn gap(&self) -> Result<Gap, Failure> {
        self.gap.as_deref().map_or(Ok(Gap::Every(1)), |text| choice("--gap", text))
    }

    /// The file of the depth network, where there is one.
    pub fn depth_network(&self) -> Option<&str> {
        self.depth.as_deref()?.strip_prefix("onnx:")
    }

    /// Where depth comes from.
    pub fn depth_from(&self) -> Result<DepthFrom, Failure> {
        let named = self.depth_range.as_deref().unwrap_or("frame");
        // The key frames of a gap that depends on the frames are not known beforehand.
        let range = match (named, self.gap()?) {
            ("frame", _) => Some(Range::Frame),
            ("clip", _) => Some(Range::Clip),
            ("keys", Gap::Every(n)) => Some(Range::Every(n)),
            ("keys", Gap::Auto(_)) => None,
            (other, _) => return Err(Failure::usage(format!("--depth-range {other}: expected frame, clip or keys"))),
        };
        let depth = self.depth.as_deref().unwrap_or("none");
        let network = depth.strip_prefix("onnx:").map(PathBuf::from);
        let values = match self.depth_model.as_deref() {
            Some("metric") if network.is_none() && !["none", "auto"].contains(&depth) => Values::Depth,
            Some(_) if network.is_none() => {
                let expected = "expected a network as well (--depth onnx:FILE), or metric with a folder of depth maps";
                return Err(Failure::usage(format!("--depth-model: {expected}")));
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
                return Err(Failure::usage(format!(
                    "--depth-range {named}: expected a folder of maps, found a network"
                )));
            }
            let options = self.depth_model.as_deref().map(|text| choice("--depth-model", text)).transpose()?;
            return Ok(DepthFrom::Network(network, options.unwrap_or_default()));
        }
        let folder = PathBuf::from(depth);
        if !folder.is_dir() {
            return Err(Failure::usage(format!(
                "--depth {depth}: expected none, auto, a folder of depth maps, or onnx:FILE"
            )));
        }
        let range = range.ok_or_else(|| {
            let gap = self.gap.as_deref().unwrap_or_default();
            Failure::usage(format!("--depth-range keys: expected a fixed gap (--gap N), found --gap {gap}"))
        })?;
        Ok(DepthFrom::Folder(folder, range, values))
    }

    /// Settings of the engine for these options.
    pub fn settings(&self, fit: Fit, machine: &Machine) -> Result<Settings, Failure> {
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

/// Options of the images, their times and their cameras.
#[derive(Clone, Debug)]
pub struct Views {
    /// Size, background, and which planes.
    pub options: RenderOptions,
    /// The camera at any time.
    pub camera: CameraPath,
    /// Times asked for, ascending.
    pub times: Option<Vec<f64>>,
    /// Backend that renders the images.
    pub backend: Backend,
    /// Width and height of the images of a camera file of another program.
    pub own_sizes: Vec<[usize; 2]>,
    /// Images of a second where such a file is a video's; else one follows the other each second.
    pub own_rate: Option<f64>,
    /// True if the background is transparent: the scene is drawn over black, and alpha is kept.
    pub transparent: bool,
    /// Where the camera stands around the middle of a scene in time, in place of `camera`.
    pub course: Option<Course>,
    /// Distance between the eyes, where there are two.
    pub eyes: Option<f64>,
    /// The middle of a still scene; that of a scene in time follows from its first image.
    pub pivot: Option<[f64; 3]>,
    /// When the images are taken of which each is the mean.
    pub shutter: Option<Shutter>,
}

impl Views {
    /// Returns true for images of the source's frames as they were filmed: their times, their size, their view.
    pub fn is_the_sources_own(&self) -> bool {
        let own_view = self.camera == CameraPath::default() && self.course.is_none() && self.eyes.is_none();
        own_view && self.times.is_none() && self.options.size == Size::Source && !self.transparent
    }

    /// Refuses what only a rendering of a still scene has: a path through another program's cameras, and, where frames are
    /// written from a video, transparency.
    pub fn refuse_still(&self) -> Result<(), Failure> {
        self.refuse_cameras()?;
        if self.transparent {
            return Err(Failure::usage("--background transparent: expected one number or R,G,B; only render has it"));
        }
        Ok(())
    }

    /// Refuses several cameras of another program, which are no path through a scene in time.
    pub fn refuse_cameras(&self) -> Result<(), Failure> {
        match self.own_sizes.len() {
            0 | 1 => Ok(()),
            n => Err(Failure::usage(format!("--camera: expected one camera for a scene in time (--view), found {n}"))),
        }
    }
}

impl Views {
    /// The video's own, at the size at which the model sees frames.
    pub fn own() -> Views {
        Views {
            options: RenderOptions::default(),
            camera: CameraPath::default(),
            times: None,
            backend: Backend::Cpu,
            own_sizes: Vec::new(),
            own_rate: None,
            transparent: false,
            course: None,
            eyes: None,
            pivot: None,
            shutter: None,
        }
    }
}

/// The cameras of a file.
#[derive(Default)]
struct Cameras {
    path: CameraPath,
    /// Width and height of each one's image, where the file is another program's.
    sizes: Vec<[usize; 2]>,
    /// Images of a second, where they are a video's.
    rate: Option<f64>,
}

impl ViewOptions {
    /// Checks everything that can be checked before work is spent.
    pub fn resolve(&self) -> Result<Views, Failure> {
        let transparent = self.background == "transparent";
        let background = if transparent { [0.0; 3] } else { self.background()? };
        let size = self.size()?;
        let Cameras { path: camera, sizes: own_sizes, rate: own_rate } = self.cameras(size)?;
        let options = RenderOptions { size, background, ..RenderOptions::default() };
        let times = self.times.as_deref().map(times).transpose()?;
        let backend = self.backend()?;
        Ok(Views { options, camera, times, backend, own_sizes, own_rate, transparent, ..Views::own() })
    }

    /// The camera's path, with the image sizes and rate of another program's file.
    fn cameras(&self, size: Size) -> Result<Cameras, Failure> {
        let Some(file) = &self.camera else { return Ok(Cameras::default()) };
        let size = match size {
            Size::Exact { width, height } => Some([width, height]),
            _ => None,
        };
        let set = match (camera::set::open(file, size)?, &self.view) {
            (CameraFile::Own(path), None) => return Ok(Cameras { path, ..Cameras::default() }),
            (CameraFile::Own(_), Some(view)) => {
                let file = file.display();
                let found = format!("{file}, which is this program's own: give --times");
                return Err(Failure::usage(format!(
                    "--view {view}: expected a camera file of another program, found {found}"
                )));
            }
            (CameraFile::Set(set), _) => set,
        };
        let drawable = set.cameras.iter().find(|named| named.camera.is_ok()).map(|named| named.name.clone());
        let chosen = match &self.view {
            None => set,
            Some(text) => {
                let camera =
                    set.find(text).map_err(|e| Failure::usage(format!("--view: {}: {e}", file.display())))?.clone();
                camera::CameraSet { cameras: vec![camera], aside: Vec::new(), rate: None, ..set }
            }
        };
        let refused = |e: FormatError| {
            let others = drawable.as_ref().filter(|_| self.view.is_none());
            let others = others.map_or_else(String::new, |name| {
                format!("; others can be drawn, each by its name or number: --view {name}")
            });
            Failure::work(format!("{}: {e}{others}", file.display()))
        };
        let sizes = chosen.usable().map_err(refused)?.iter().map(|sized| sized.size).collect();
        Ok(Cameras { path: chosen.path().map_err(refused)?, sizes, rate: chosen.rate })
    }

    fn backend(&self) -> Result<Backend, Failure> {
        let Some(name) = &self.renderer else { return Ok(Backend::Cpu) };
        let backend: Backend = choice("--renderer", name)?;
        if !backend.is_built_in() {
            return Err(Failure::usage(format!(
                "--renderer {name}: expected a program built with the cargo feature {name} (cargo build --release --features {name}), found one without"
            )));
        }
        Ok(backend)
    }

    fn size(&self) -> Result<Size, Failure> {
        let text = self.size.as_deref().unwrap_or("model");
        match text {
            "model" => return Ok(Size::Model),
            "source" => return Ok(Size::Source),
            _ => {}
        }
        let side = |text: &str| text.parse().ok().filter(|side| (1..=raster::MAX_SIDE).contains(side));
        let sides = text.split_once('x').and_then(|(w, h)| side(w).zip(side(h)));
        sides.map(|(width, height)| Size::Exact { width, height }).ok_or_else(|| {
            let most = raster::MAX_SIDE;
            Failure::usage(format!("--size {text}: expected model, source or WIDTHxHEIGHT up to {most} a side"))
        })
    }

    fn background(&self) -> Result<[f32; 3], Failure> {
        let parts: Option<Vec<f32>> = self.background.split(',').map(|part| part.trim().parse().ok()).collect();
        let inside = |v: &[f32]| v.iter().all(|c| (0.0..=1.0).contains(c));
        match parts.as_deref() {
            Some([grey]) if inside(&[*grey]) => Ok([*grey; 3]),
            Some([r, g, b]) if inside(&[*r, *g, *b]) => Ok([*r, *g, *b]),
            _ => Err(Failure::usage(format!(
                "--background {}: expected one number or R,G,B, each from 0 to 1",
                self.background
            ))),
        }
    }
}

/// `a,b,c` or `start:end:count`, ascending seconds.
pub fn times(text: &str) -> Result<Vec<f64>, Failure> {
    let wrong = |what: &str| Failure::usage(format!("--times {text}: expected {what}"));
    let number = |part: &str| part.trim().parse::<f64>().ok().filter(|t| t.is_finite());
    if text.contains(':') {
        let parts: Vec<&str> = text.split(':').collect();
        let [start, end, count] = parts[..] else { return Err(wrong("START:END:COUNT")) };
        let count: Option<usize> = count.trim().parse().ok().filter(|n| (1..=1_000_000).contains(n));
        return match (number(start), number(end), count) {
            (Some(start), Some(end), Some(1)) if start <= end => Ok(vec![start]),
            (Some(start), Some(end), Some(n)) if start <= end => {
                let step =
                    |i: usize| if i + 1 == n { end } else { start + (end - start) * (i as f64 / (n - 1) as f64) };
                Ok((0..n).map(step).collect())
            }
            _ => Err(wrong("START:END:COUNT with START ≤ END in seconds and COUNT from 1 to 1000000")),
        };
    }
    let times: Option<Vec<f64>> = text.split(',').map(number).collect();
    match times {
        Some(times) if times.windows(2).all(|pair| pair[0] <= pair[1]) => Ok(times),
        Some(_) => Err(wrong("ascending times")),
        None => Err(wrong("seconds separated by commas, or START:END:COUNT")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_lists_or_ranges() {
        assert_eq!(times("0,0.5,2").ok(), Some(vec![0.0, 0.5, 2.0]));
        assert_eq!(times("0:1:3").ok(), Some(vec![0.0, 0.5, 1.0]));
        assert_eq!(times("0:0.3:1").ok(), Some(vec![0.0]));
        for wrong in ["", "1,0", "nan", "0:1", "1:0:4", "0:1:0", "0;1"] {
            assert!(matches!(times(wrong), Err(Failure::Usage(_))), "{wrong}");
        }
    }

    #[test]
    fn sizes_and_backgrounds_outside_their_range_are_wrong_use() {
        let view = |size: &str, background: &str| ViewOptions {
            size: Some(size.into()),
            background: background.into(),
            ..ViewOptions::default()
        };
        let views = view("640x360", "0,0.5,1").resolve().expect("valid");
        assert_eq!(views.options.size, Size::Exact { width: 640, height: 360 });
        assert_eq!(views.options.background, [0.0, 0.5, 1.0]);
        for (size, background) in
            [("0x4", "0"), ("big", "0"), ("4x", "0"), ("4x99999999", "0"), ("model", "2"), ("model", "0,1")]
        {
            assert!(matches!(view(size, background).resolve(), Err(Failure::Usage(_))), "{size} {background}");
        }
    }
}
