//! Variants on a clip: engines that differ in precision, reuse or gap take the same frames in turn, key frame by key
//! frame. So other load on the machine disturbs all of them equally.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, ensure};
use streamsplat::folder;
use streamsplat::gap::{Auto, Gap, grouped};
use streamsplat::metrics::psnr;
use streamsplat::picture::Picture;
use streamsplat::render::Renderer;
use streamsplat::source::{self, Source, TimedPicture};
use streamsplat::stream::{Reconstructor, Reuse};
use streamsplat::{Camera, Engine, Frame, RenderOptions, Settings};
use streamsplat_model::Precision;

use crate::timing::{Spent, Stopwatch};

/// A variant of the engine on a clip.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Variant {
    pub(crate) precision: Precision,
    pub(crate) reuse: Reuse,
    pub(crate) gap: Gap,
}

/// A gap as written on the command line.
pub(crate) fn gap_name(gap: Gap) -> String {
    if gap == Gap::Auto(Auto::default()) { "auto".to_owned() } else { gap.to_string() }
}

/// Frames of a clip.
pub(crate) fn read(input: &Path, frames: Option<usize>) -> Result<Vec<TimedPicture>> {
    let mut source = Source::open(input, &source::Options::default())?;
    let mut read = Vec::new();
    while read.len() < frames.unwrap_or(usize::MAX)
        && let Some(frame) = source.next_frame()?
    {
        read.push(frame);
    }
    Ok(read)
}

/// The clip's key frames; as in a run, the last frame is one.
fn keys(gap: Gap, clip: &[TimedPicture]) -> Vec<usize> {
    let ends = grouped(gap, clip).scan(0, |end, group| {
        *end += group.frames.len();
        Some(*end - 1)
    });
    ends.collect()
}

/// Time of a key frame.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Step {
    /// [`Engine::push`].
    pub(crate) pushed: Spent,
    /// The images of its interval.
    pub(crate) drawn: Spent,
}

/// One running variant.
pub(crate) struct Runner {
    pub(crate) variant: Variant,
    pub(crate) engine: Engine,
    renderer: Renderer,
    pub(crate) keys: Vec<usize>,
    chosen: Spent,
    pub(crate) steps: Vec<Step>,
    pub(crate) images: Vec<Picture>,
}

/// Engines of one model; those of one precision share its weights.
pub(crate) struct Models {
    settings: Settings,
    /// By precision, and whether every branch is computed, as only for `off`.
    loaded: Vec<((Precision, bool), Arc<dyn Reconstructor>)>,
}

impl Models {
    /// Those of `settings`, except for precision and reuse.
    pub(crate) fn new(settings: Settings) -> Models {
        Models { settings, loaded: Vec::new() }
    }

    /// A new engine.
    fn engine(&mut self, variant: &Variant) -> Result<Engine> {
        let settings = Settings { precision: Some(variant.precision), reuse: variant.reuse, ..self.settings.clone() };
        let key = (variant.precision, variant.reuse == Reuse::Off);
        let loaded = self.loaded.iter().find(|(known, _)| *known == key);
        if let Some((_, model)) = loaded {
            return Ok(Engine::with_model(settings, Arc::clone(model))?);
        }
        let engine = Engine::new(settings)?;
        self.loaded.push((key, Arc::clone(engine.model())));
        Ok(engine)
    }

    fn runner(&mut self, variant: &Variant, clip: &[TimedPicture]) -> Result<Runner> {
        let engine = self.engine(variant)?;
        let watch = Stopwatch::start();
        let keys = keys(variant.gap, clip);
        let chosen = watch.stop();
        let renderer = Renderer::new(engine.workers());
        let variant = variant.clone();
        Ok(Runner { variant, engine, renderer, keys, chosen, steps: Vec::new(), images: Vec::new() })
    }

    /// Takes a clip through every variant.
    pub(crate) fn pass(&mut self, clip: &[TimedPicture], variants: &[Variant]) -> Result<Vec<Runner>> {
        let mut runners = Vec::new();
        for variant in variants {
            runners.push(self.runner(variant, clip)?);
        }
        for index in 0..clip.len() {
            for runner in runners.iter_mut().filter(|runner| runner.keys.contains(&index)) {
                runner.take(clip, index)?;
            }
        }
        Ok(runners)
    }
}

impl Runner {
    fn take(&mut self, clip: &[TimedPicture], index: usize) -> Result<()> {
        let Picture { width, height, rgb } = clip[index].picture.clone();
        let watch = Stopwatch::start();
        let interval = self.engine.push(Frame { width, height, rgb, depth: None }, clip[index].timestamp)?;
        let mut step = Step { pushed: watch.stop(), drawn: Spent::default() };
        for frame in &clip[self.images.len()..=index] {
            let watch = Stopwatch::start();
            let image =
                self.renderer.render(&interval, frame.timestamp, &Camera::Canonical, &RenderOptions::default())?;
            step.drawn += watch.stop();
            self.images.push(Picture { width: image.width, height: image.height, rgb: image.rgb.clone() });
        }
        self.steps.push(step);
        Ok(())
    }

    /// Keeps for every part of the work the shorter time of this run and another of the same variant.
    pub(crate) fn quicken(&mut self, other: &Runner) {
        self.chosen = self.chosen.least(other.chosen);
        for (step, other) in self.steps.iter_mut().zip(&other.steps) {
            step.pushed = step.pushed.least(other.pushed);
            step.drawn = step.drawn.least(other.drawn);
        }
    }

    /// Time of all key frames.
    pub(crate) fn pushed(&self) -> Spent {
        self.steps.iter().fold(Spent::default(), |sum, step| sum + step.pushed)
    }

    /// Time of everything but reading and writing, per input frame.
    pub(crate) fn frame(&self) -> Spent {
        let steps = self.steps.iter().fold(self.chosen, |sum, step| sum + step.pushed + step.drawn);
        steps / self.images.len() as f64
    }
}

/// The true frames of a clip in the form for comparisons with images.
pub(crate) fn truths(clip: &[TimedPicture]) -> Vec<Picture> {
    clip.iter().map(|frame| frame.picture.resized(256, 256)).collect()
}

/// PSNR of images against the [`truths`], at 256×256.
pub(crate) fn against(images: &[Picture], truths: &[Picture]) -> Result<Vec<f64>> {
    images.iter().zip(truths).map(|(image, truth)| Ok(psnr(&image.resized(256, 256), truth)?)).collect()
}

/// Mean square error of all images against others.
pub(crate) fn mean_square_error(images: &[Picture], others: &[Picture]) -> Result<f64> {
    ensure!(images.len() == others.len(), "variants of one gap drew other frames");
    let mut error = 0.0;
    for (a, b) in images.iter().zip(others) {
        error += streamsplat::metrics::mean_square_error(a, b)? / images.len() as f64;
    }
    Ok(error)
}

/// The clips of the inputs, in natural order.
pub(crate) fn clips(inputs: &[PathBuf]) -> Result<Vec<PathBuf>> {
    let mut clips = Vec::new();
    for input in inputs {
        if !input.is_dir() || folder::has_images(input) {
            clips.push(input.clone());
            continue;
        }
        let entries = std::fs::read_dir(input).with_context(|| format!("{}", input.display()))?;
        let mut inside: Vec<PathBuf> =
            entries.flatten().map(|entry| entry.path()).filter(|path| path.is_dir()).collect();
        inside.sort();
        ensure!(!inside.is_empty(), "{}: neither images nor clips", input.display());
        clips.extend(inside);
    }
    Ok(clips)
}
