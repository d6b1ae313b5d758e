//! The online loop.

use std::sync::Arc;

use streamsplat_kernels::Level;
use streamsplat_model::reuse::{Memory, Saving};
use streamsplat_model::{Embedding, FrameInput, LoadOptions, Sampling, Side, StaticGaussians};

use super::canonical::{Advance, CanonicalSet, Step};
use super::reconstructor::Motion;
use super::work::Stage;
use super::{DepthRange, EngineError, Frame, Interval, Reconstructor, Reuse, SamplingMode, Settings, Work, Workers};
use crate::fit::{self, Placement};

/// Turns key frames into a dynamic scene, one interval per key frame.
///
/// What it keeps between key frames is bounded and independent of the stream's length: the last frame's input, embedding,
/// tokens, condition and Gaussians, the last pair's motion, the survivors of at most `max_age` frames, and with some choices of
/// [`Reuse`] the network's [`Memory`].
pub struct Engine {
    settings: Settings,
    model: Arc<dyn Reconstructor>,
    workers: Workers,
    work: Work,
    memory: Option<Memory>,
    state: Option<State>,
}

/// What a frame's network input and output are.
pub(super) struct View {
    rgb: Vec<f32>,
    depth: Option<Vec<f32>>,
    features: Arc<Features>,
    pub(super) gaussians: Arc<StaticGaussians>,
}

/// What the dynamic decoder reads of a frame. Equal inputs share one.
struct Features {
    embedding: Embedding,
    tokens: Vec<f32>,
    condition: Option<Vec<f32>>,
}

/// The motion of a pair of frames, and which pair that was.
pub(super) struct Pair {
    frames: [Arc<Features>; 2],
    motion: Arc<[Motion; 2]>,
}

/// What is kept between key frames.
pub(super) struct State {
    pub(super) frame: u64,
    pub(super) timestamp: f64,
    pub(super) placement: Placement,
    pub(super) view: View,
    pub(super) pair: Option<Pair>,
    pub(super) set: CanonicalSet,
}

impl Engine {
    /// An engine that has seen nothing yet.
    ///
    /// # Errors
    /// When the model cannot be loaded or the threads cannot be started.
    pub fn new(settings: Settings) -> Result<Self, EngineError> {
        let workers = Workers::new(settings.level.unwrap_or_else(Level::detect), settings.threads)?;
        let options = LoadOptions {
            level: workers.level(),
            precision: settings.precision,
            compute_silent: settings.reuse == Reuse::Off,
        };
        let model = workers.install(|| settings.model.load(&options))?;
        let memory = match settings.reuse {
            Reuse::Off => None,
            Reuse::Exact => model.memory(Saving::Exact),
            Reuse::Within(tolerance) => model.memory(Saving::Within(tolerance)),
        };
        Ok(Self { settings, model, workers, work: Work::default(), memory, state: None })
    }

    /// What it was made with.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// What reconstructs its frames; other engines may share it.
    pub fn model(&self) -> &Arc<dyn Reconstructor> {
        &self.model
    }

    /// Its threads and instruction-set level.
    pub fn workers(&self) -> &Workers {
        &self.workers
    }

    /// Work done and work avoided since it was made.
    pub fn work(&self) -> &Work {
        &self.work
    }

    /// Takes the next key frame, `timestamp` seconds into the video, and gives the interval it ends. The first frame gives its static
    /// scene, an interval of no length.
    ///
    /// # Errors
    /// Frames without pixels, of another size than the first one, with buffers of the wrong length or pixels that are not
    /// finite; time stamps that are not after the one before; what the model refuses. The stream is then as it was before, but that
    /// after the model has refused something the next frame is computed in full.
    pub fn push(&mut self, frame: Frame, timestamp: f64) -> Result<Interval, EngineError> {
        let workers = self.workers.clone();
        workers.install(|| self.take(frame, timestamp))
    }

    /// [`Engine::push`] on the engine's own threads.
    fn take(&mut self, frame: Frame, timestamp: f64) -> Result<Interval, EngineError> {
        let index = self.state.as_ref().map_or(0, |s| s.frame + 1);
        let placement = self.check(&frame, index, timestamp)?;
        let interval = self.advance(frame, index, timestamp, placement);
        match &mut self.memory {
            Some(memory) if interval.is_err() => memory.forget(),
            Some(memory) => self.work.tokens(&memory.tokens()),
            None => {}
        }
        self.work.branches(self.model.silent());
        interval
    }

    /// Takes a frame that was found good.
    fn advance(
        &mut self,
        frame: Frame,
        index: u64,
        timestamp: f64,
        placement: Placement,
    ) -> Result<Interval, EngineError> {
        let (view, lost) = self.reconstruct(frame, index, placement)?;
        let Self { settings, model, work, memory, state: before, .. } = self;
        let mut next_pair = None;
        let (set, advance) = match before {
            None => CanonicalSet::first(&view.gaussians),
            Some(state) => {
                let pair = deform(model.as_ref(), work, memory.as_mut(), state, &view, index)?;
                let motion = &next_pair.insert(pair).motion;
                let step = Step {
                    gaussians: &view.gaussians,
                    forward: &motion[0],
                    backward: &motion[1],
                    length: length(state.timestamp, timestamp),
                    image: placement.model,
                    fusion: settings.fusion,
                    max_age: settings.max_age.0,
                };
                work.measure(Stage::Fusion, || state.set.advance(&step))
            }
        };
        let start = before.as_ref().map_or(timestamp, |s| s.timestamp);
        self.state = Some(State { frame: index, timestamp, placement, view, pair: next_pair, set });
        let Advance { gaussians, merges, dropped } = advance;
        let dropped = dropped + lost;
        let workers = self.workers.clone();
        Ok(Interval { index, start, end: timestamp, gaussians, placement, merges, dropped, workers })
    }

    /// What is kept since the last key frame.
    pub(super) fn state(&self) -> Option<&State> {
        self.state.as_ref()
    }

    /// Goes on from there.
    pub(super) fn set_state(&mut self, state: State) {
        self.state = Some(state);
    }

    /// The frame through its own part of the network, as if it were the first one.
    pub(super) fn see(&mut self, frame: Frame, index: u64, timestamp: f64) -> Result<(Placement, View), EngineError> {
        let before = self.state.take();
        let seen = self.check(&frame, index, timestamp).and_then(|placement| {
            let (view, _) = self.reconstruct(frame, index, placement)?;
            Ok((placement, view))
        });
        self.state = before;
        seen
    }

    /// The frame's placement, when frame and time stamp can be taken.
    fn check(&self, frame: &Frame, index: u64, timestamp: f64) -> Result<Placement, EngineError> {
        let after = self.state.as_ref().map(|s| s.timestamp);
        if !(timestamp.is_finite() && after.is_none_or(|after| after < timestamp)) {
            return Err(EngineError::Time { index, after, found: timestamp });
        }
        let size = [frame.height, frame.width];
        let placement = match &self.state {
            Some(state) if state.placement.source != size => {
                return Err(EngineError::Size { index, expected: state.placement.source, found: size });
            }
            Some(state) => Some(state.placement),
            None => Placement::new(self.settings.fit, size, self.model.resolution()),
        };
        let pixels = frame.width.checked_mul(frame.height).filter(|n| *n <= usize::MAX / 16);
        let (Some(placement), Some(pixels)) = (placement, pixels) else {
            return Err(EngineError::Empty { index, width: frame.width, height: frame.height });
        };
        let length = |what, expected, found| match expected == found {
            true => Ok(()),
            false => Err(EngineError::Length { index, what, expected, found }),
        };
        length("rgb", 3 * pixels, frame.rgb.len())?;
        if let Some(depth) = &frame.depth {
            length("depth", pixels, depth.len())?;
        }
        match frame.rgb.iter().position(|x| !x.is_finite()) {
            Some(position) => Err(EngineError::NonFinite { index, position, value: frame.rgb[position] }),
            None => Ok(placement),
        }
    }

    /// The frame through its own part of the network, and the number of depth values that were not finite.
    fn reconstruct(&mut self, frame: Frame, index: u64, placement: Placement) -> Result<(View, u64), EngineError> {
        let Frame { mut rgb, mut depth, .. } = frame;
        let level = self.workers.level();
        let mut lost = 0;
        let (rgb, depth) = self.work.measure(Stage::Fit, || {
            rgb.iter_mut().for_each(|x| *x = x.clamp(0.0, 1.0));
            if let Some(depth) = &mut depth {
                lost = self.settings.depth_range.apply(depth);
            }
            (placement.fit_in(level, &rgb), depth.map(|d| placement.fit_in(level, &d)))
        });
        let input = FrameInput { rgb: &rgb, depth: depth.as_deref() };
        let sampling = match self.settings.sampling {
            SamplingMode::Mean => Sampling::Mean,
            SamplingMode::Sample => Sampling::Sample { seed: self.settings.seed, frame: index },
        };
        let (model, work) = (&self.model, &mut self.work);
        let mut memory = self.memory.as_mut();

        let repeated = match &self.state {
            Some(state) if self.settings.reuse != Reuse::Off => {
                same_bits(&state.view.rgb, &rgb) && same_depth(state.view.depth.as_deref(), depth.as_deref())
            }
            _ => false,
        };
        let before = self.state.as_ref().filter(|_| repeated).map(|s| &s.view);
        let features = if let Some(view) = before {
            work.count(Stage::Encoder, 0, 1);
            work.count(Stage::Upsampler, 0, 1);
            work.count(Stage::Condition, 0, 1);
            view.features.clone()
        } else {
            let embedding = work.measure(Stage::Encoder, || match memory.as_deref_mut() {
                Some(memory) => model.embed_keeping(&input, memory),
                None => model.embed(&input),
            })?;
            let tokens = work.measure(Stage::Upsampler, || match memory.as_deref_mut() {
                Some(memory) => model.upsample_keeping(&embedding, memory),
                None => model.upsample(&embedding),
            })?;
            let condition = match model.reads_condition() {
                true => work.measure(Stage::Condition, || model.condition(&input))?,
                false => {
                    work.count(Stage::Condition, 0, 1);
                    None
                }
            };
            Arc::new(Features { embedding, tokens, condition })
        };
        let gaussians = match before {
            Some(view) if sampling == Sampling::Mean || !model.draws_positions() => {
                work.count(Stage::Heads, 0, 1);
                view.gaussians.clone()
            }
            _ => {
                let tokens = &features.tokens;
                let gaussians = work.measure(Stage::Heads, || match memory {
                    Some(memory) => model.gaussians_keeping(tokens, &sampling, memory),
                    None => model.gaussians(tokens, &sampling),
                })?;
                check_records(index, gaussians.position.len(), &gaussians)?;
                Arc::new(gaussians)
            }
        };
        Ok((View { rgb, depth, features, gaussians }, lost))
    }
}

/// The motion between the frame before and this one.
fn deform(
    model: &dyn Reconstructor,
    work: &mut Work,
    mut memory: Option<&mut Memory>,
    state: &State,
    view: &View,
    index: u64,
) -> Result<Pair, EngineError> {
    let frames = [state.view.features.clone(), view.features.clone()];
    if let Some(last) = &state.pair
        && frames.iter().zip(&last.frames).all(|(now, then)| Arc::ptr_eq(now, then))
    {
        work.count(Stage::Decoder, 0, 1);
        work.count(Stage::Upsampler, 0, 2);
        work.count(Stage::Heads, 0, 2);
        return Ok(Pair { frames, motion: last.motion.clone() });
    }
    let sides = [&frames[0], &frames[1]].map(|f| Side {
        h: &f.embedding.h,
        static_tokens: &f.tokens,
        condition: f.condition.as_deref(),
    });
    let decoded = work.measure(Stage::Decoder, || match memory.as_deref_mut() {
        Some(memory) => model.decode_keeping(&sides[0], &sides[1], memory),
        None => model.decode(&sides[0], &sides[1]),
    })?;
    let mut motion: [Motion; 2] = Default::default();
    let gaussians = [&state.view.gaussians, &view.gaussians];
    for (side, d) in decoded.iter().enumerate() {
        let tokens = work.measure(Stage::Upsampler, || match memory.as_deref_mut() {
            Some(memory) => model.upsample_motion_keeping(side, d, memory),
            None => model.upsample_motion(d),
        })?;
        let static_tokens = sides[side].static_tokens;
        motion[side] = work.measure(Stage::Heads, || match memory.as_deref_mut() {
            Some(memory) => model.motion_keeping(side, static_tokens, &tokens, memory),
            None => model.motion(static_tokens, &tokens),
        })?;
        let expected = gaussians[side].position.len();
        for (what, found) in [("velocity", motion[side].0.len()), ("gamma", motion[side].1.len())] {
            if found != expected {
                return Err(EngineError::Records { index, what, expected, found });
            }
        }
    }
    Ok(Pair { frames, motion: Arc::new(motion) })
}

impl DepthRange {
    /// Brings a depth map into [0, 1]; gives the number of values that were not finite.
    fn apply(self, depth: &mut [f32]) -> u64 {
        match self {
            DepthRange::Frame => fit::normalise_depth(depth),
            DepthRange::Given => {
                let mut lost = 0;
                for d in depth {
                    lost += u64::from(!d.is_finite());
                    *d = if d.is_finite() { d.clamp(0.0, 1.0) } else { 0.0 };
                }
                lost
            }
        }
    }
}

/// Seconds from one time stamp to a later one: positive and finite.
fn length(start: f64, end: f64) -> f64 {
    (end - start).clamp(f64::MIN_POSITIVE, f64::MAX)
}

/// An error unless every array has one record per Gaussian.
fn check_records(index: u64, expected: usize, g: &StaticGaussians) -> Result<(), EngineError> {
    for (what, found) in [("scale", g.scale.len()), ("opacity", g.opacity.len()), ("rgb", g.rgb.len())] {
        if found != expected {
            return Err(EngineError::Records { index, what, expected, found });
        }
    }
    Ok(())
}

fn same_bits(a: &[f32], b: &[f32]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| a.to_bits() == b.to_bits())
}

fn same_depth(a: Option<&[f32]>, b: Option<&[f32]>) -> bool {
    match (a, b) {
        (None, None) => true,
        (Some(a), Some(b)) => same_bits(a, b),
        _ => false,
    }
}
