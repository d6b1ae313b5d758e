//! Variants on a clip: engines that differ in precision, reuse or gap take the same frames in turn, key frame by key
//! frame. So other load on the machine disturbs all of them equally.

use std::path::Path;
use std::sync::Arc;

use anyhow::{Result, ensure};
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
pub struct Variant {
    /// Operands of products.
    pub precision: Precision,
    /// Skipped work.
    pub reuse: Reuse,
    /// Frames from one key frame to the next.
    pub gap: Gap,
}

/// A gap as written on the command line.
pub fn gap_name(gap: Gap) -> String {
    if gap == Gap::Auto(Auto::default()) { "auto".to_owned() } else { gap.to_string() }
}

/// Frames of a clip.
pub fn read(input: &Path, frames: Option<usize>) -> Result<Vec<TimedPicture>> {
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
pub struct Step {
    /// [`Engine::push`].
    pub pushed: Spent,
    /// The images of its interval.
    pub drawn: Spent,
}

/// One running variant.
pub struct Runner {
    /// Its choices.
    pub variant: Variant,
    /// Its engine.
    pub engine: Engine,
    renderer: Renderer,
    /// Indices of key frames.
    pub keys: Vec<usize>,
    chosen: Spent,
    /// Times, one per key frame.
    pub steps: Vec<Step>,
    /// Images, one per frame.
    pub images: Vec<Picture>,
}

/// Engines of one model; those of one precision share its weights.
pub struct Models {
    settings: Settings,
    /// By precision, and whether every branch is computed, as only for `off`.
    loaded: Vec<((Precision, bool), Arc<dyn Reconstructor>)>,
}

impl Models {
    /// Those of `settings`, except for precision and reuse.
    pub fn new(settings: Settings) -> Models {
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
    pub fn pass(&mut self, clip: &[TimedPicture], variants: &[Variant]) -> Result<Vec<Runner>> {
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
    pub fn quicken(&mut self, other: &Runner) {
        self.chosen = self.chosen.least(other.chosen);
        for (step, other) in self.steps.iter_mut().zip(&other.steps) {
            step.pushed = step.pushed.least(other.pushed);
            step.drawn = step.drawn.least(other.drawn);
        }
    }

    /// Time of all key frames.
    pub fn pushed(&self) -> Spent {
        self.steps.iter().fold(Spent::default(), |sum, step| sum + step.pushed)
    }

    /// Time of everything but reading and writing, per input frame.
    pub fn frame(&self) -> Spent {
        let steps = self.steps.iter().fold(self.chosen, |sum, step| sum + step.pushed + step.drawn);
        steps / self.images.len() as f64
    }
}

/// The true frames of a clip in the form for comparisons with images.
pub fn truths(clip: &[TimedPicture]) -> Vec<Picture> {
    clip.iter().map(|frame| frame.picture.resized(256, 256)).collect()
}

/// PSNR of images against the [`truths`], at 256×256.
pub fn against(images: &[Picture], truths: &[Picture]) -> Result<Vec<f64>> {
    images.iter().zip(truths).map(|(image, truth)| Ok(psnr(&image.resized(256, 256), truth)?)).collect()
}

/// Mean square error of all images against others.
pub fn mean_square_error(images: &[Picture], others: &[Picture]) -> Result<f64> {
    ensure!(images.len() == others.len(), "variants of one gap drew other frames");
    let mut error = 0.0;
    for (a, b) in images.iter().zip(others) {
        error += streamsplat::metrics::mean_square_error(a, b)? / images.len() as f64;
    }
    Ok(error)
}

/// The values in their order, each once; `first` before them.
pub fn once_each<T: Copy + PartialEq>(first: T, others: &[T]) -> Vec<T> {
    let mut all = vec![first];
    for &other in others {
        if !all.contains(&other) {
            all.push(other);
        }
    }
    all
}
