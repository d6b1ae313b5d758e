//! The online loop.

use std::sync::Arc;

use streamsplat_kernels::Level;
use streamsplat_kernels::philox::Stream;
use streamsplat_model::LoadOptions;
use streamsplat_model::reuse::{Saving, Tokens};

use super::between::{Flows, Seen, targets};
use super::canonical::{Advance, CanonicalSet, Step};
use super::colours::{Fitter, Target};
use super::keyframe::{AlignedMap, Context, KeyView};
use super::lift::{Alignment, DepthMap, align};
use super::motion::{completed, fixed};
use super::pair::Pair;
use super::tiles::Tiles;
use super::work::Stage;
use super::{EngineError, Fade, Frame, Interval, MotionFrom, Reconstructor, Reuse, Settings, Work, Workers};
use crate::fit::Placement;
use crate::parallax::{self, Evidence, Found};

/// Turns key frames into a dynamic scene, one interval per key frame.
///
/// State between key frames is bounded and independent of the stream's length: the last frame's input, embedding,
/// tokens, condition, Gaussians and found depth, the last pair's motion, the survivors of at most `max_age` frames, and with some choices of
/// [`Reuse`] the network's [`Cache`](streamsplat_model::reuse::Cache).
pub struct Engine {
    settings: Settings,
    model: Arc<dyn Reconstructor>,
    workers: Workers,
    work: Work,
    tiles: Option<Tiles>,
    fitter: Fitter,
    state: Option<State>,
}

/// State between key frames.
pub(super) struct State {
    pub(super) frame: u64,
    pub(super) timestamp: f64,
    pub(super) placement: Placement,
    pub(super) view: KeyView,
    pub(super) pair: Option<Pair>,
    pub(super) set: CanonicalSet,
    /// Depth found by parallax.
    pub(super) found: Option<Found>,
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
            compute_zero_output: settings.reuse == Reuse::Off,
        };
        let model = workers.install(|| settings.model.load(&options))?;
        Ok(Self::from_parts(settings, workers, model))
    }

    /// [`Engine::new`] with the model of another engine that was made with the same model, precision and reuse, and has loaded it.
    ///
    /// # Errors
    /// When the threads cannot be started.
    pub fn with_model(settings: Settings, model: Arc<dyn Reconstructor>) -> Result<Self, EngineError> {
        let workers = Workers::new(settings.level.unwrap_or_else(Level::detect), settings.threads)?;
        Ok(Self::from_parts(settings, workers, model))
    }

    fn from_parts(settings: Settings, workers: Workers, model: Arc<dyn Reconstructor>) -> Self {
        let fitter = Fitter::new(workers.level());
        Self { settings, model, workers, work: Work::default(), tiles: None, fitter, state: None }
    }

    /// Settings it was made with.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Model that reconstructs its frames; other engines may share it.
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
        self.push_with(Vec::new(), frame, timestamp)
    }

    /// [`Engine::push`] of a key frame together with the frames since the key frame before, with their times, ascending. They are looked at where motion is taken from them
    /// ([`MotionFrom::Between`]) and ignored otherwise, as they are before the first key frame. Depth of theirs is not used.
    ///
    /// # Errors
    /// As [`Engine::push`]; and times that do not ascend from one key frame to the other.
    pub fn push_with(
        &mut self,
        between: Vec<(Frame, f64)>,
        frame: Frame,
        timestamp: f64,
    ) -> Result<Interval, EngineError> {
        let workers = self.workers.clone();
        workers.install(|| self.take(between, frame, timestamp))
    }

    /// [`Engine::push_with`] on the engine's own threads.
    fn take(&mut self, between: Vec<(Frame, f64)>, frame: Frame, timestamp: f64) -> Result<Interval, EngineError> {
        let index = self.state.as_ref().map_or(0, |s| s.frame + 1);
        let placement = self.check(&frame, index, timestamp)?;
        let between = match self.settings.motion() {
            MotionFrom::Between if self.state.is_some() => between,
            _ => Vec::new(),
        };
        let mut after = self.state.as_ref().map(|state| state.timestamp);
        for (seen, time) in &between {
            if !(time.is_finite() && after.is_none_or(|after| after < *time) && *time < timestamp) {
                return Err(EngineError::Between { index, after, before: timestamp, found: *time });
            }
            self.check(seen, index, *time)?;
            after = Some(*time);
        }
        let mut tiles = self.tiles(placement)?;
        let interval = self.advance(&mut tiles, between, frame, index, timestamp, placement);
        if interval.is_err() {
            tiles.tiles.iter_mut().for_each(|tile| tile.session.forget());
        }
        self.work.tokens(&tokens(&tiles));
        self.work.branches(self.model.zero_output());
        self.tiles = Some(tiles);
        interval
    }

    /// Takes a frame that was found good.
    fn advance(
        &mut self,
        tiles: &mut Tiles,
        between: Vec<(Frame, f64)>,
        frame: Frame,
        index: u64,
        timestamp: f64,
        placement: Placement,
    ) -> Result<Interval, EngineError> {
        let (mut view, lost) = self.reconstruct(tiles, frame, index, placement)?;
        let seen = self.seen(between, index, timestamp, placement)?;
        let level = self.workers.level();
        let flows = match &self.state {
            None => None,
            Some(state) => Flows::new(level, &mut self.work, [&state.view, &view], &seen, self.settings.flow),
        };
        let found = self.found(tiles, &view, flows.as_ref(), index);
        let own = view.own_map(tiles);
        let own = own.map(|map| aligned(level, map, &view, self.state.as_ref(), flows.as_ref()));
        // What is found has one scale already.
        let map = own.or_else(|| {
            let map = view.found_map(level, found.as_ref()?)?;
            Some(AlignedMap { map, alignment: Alignment::default() })
        });
        self.context(tiles).finish(&mut view, map);
        let Self { settings, work, fitter, state: before, .. } = self;
        let mut next_pair = None;
        let (set, advance) = match before {
            None => CanonicalSet::first(&view.gaussians, view.layers()),
            Some(state) => {
                let views = [&state.view, &view];
                let mut network = fixed(views.map(|view| view.gaussians.position.len()));
                if settings.deforms() {
                    let pair = next_pair.insert(Pair::new(tiles, work, state.pair.as_ref(), views, index)?);
                    match settings.fade() {
                        Fade::Network => network = pair.motion.clone(),
                        Fade::Fixed => {
                            let of = &pair.motion;
                            network = [0, 1].map(|side| {
                                let gamma = network[side].1[..of[side].0.len()].to_vec();
                                Arc::new((of[side].0.clone(), gamma))
                            });
                        }
                    }
                    let [a, b] = network;
                    network = [
                        completed(a, views[0].gaussians.position.len()),
                        completed(b, views[1].gaussians.position.len()),
                    ];
                } else {
                    Pair::leave_out(tiles, work);
                }
                let length = length(state.timestamp, timestamp);
                let motion = match &flows {
                    Some(flows) => work.time(Stage::Flow, || flows.motion(level, views, &network)),
                    None => network,
                };
                let step = Step {
                    gaussians: &view.gaussians,
                    layers: view.layers(),
                    forward: &motion[0],
                    backward: &motion[1],
                    length,
                    lifted: state.view.map.is_some() || view.map.is_some(),
                    image: placement.model,
                    fusion: settings.fusion,
                    max_age: settings.max_age.0,
                };
                let (mut set, mut advance) = work.measure(Stage::Fusion, || state.set.advance(&step));
                let steps = settings.refine();
                if let Some(flows) = flows.filter(|_| steps > 0) {
                    let predicted = work.time(Stage::Flow, || flows.predicted(level, views));
                    let mut targets = targets(&seen, settings.refine_every() as usize);
                    targets.extend(predicted.iter().map(|(t, rgb)| Target { t: *t, rgb }));
                    let (rates, taken) = work.time(Stage::Colours, || {
                        fitter.rates(&advance.gaussians, &targets, placement.model, step.lifted, steps)
                    });
                    work.count(Stage::Colours, u64::from(taken), u64::from(steps - taken));
                    advance.gaussians.rgb_rate = rates;
                    set.recolour_survivors(&advance.gaussians);
                }
                (set, advance)
            }
        };
        let start = before.as_ref().map_or(timestamp, |s| s.timestamp);
        self.state = Some(State { frame: index, timestamp, placement, view, pair: next_pair, set, found });
        let Advance { gaussians, merges, dropped } = advance;
        let dropped = dropped + lost;
        Ok(Interval { index, start, end: timestamp, gaussians, placement, merges, dropped })
    }

    /// The frames in between as flow sees them.
    fn seen(
        &mut self,
        between: Vec<(Frame, f64)>,
        index: u64,
        timestamp: f64,
        placement: Placement,
    ) -> Result<Vec<Seen>, EngineError> {
        let Some(state) = &self.state else { return Ok(Vec::new()) };
        let (level, work, effort) = (self.workers.level(), &mut self.work, self.settings.flow);
        let length = length(state.timestamp, timestamp);
        let relative = |time: f64| ((time - state.timestamp) / length) as f32;
        between
            .into_iter()
            .map(|(frame, time)| Seen::new(level, work, frame, relative(time), placement, index, effort))
            .collect()
    }

    /// Depth found by parallax for key frame `index`, where that is asked for and the frame has no map of its own.
    fn found(&mut self, tiles: &Tiles, view: &KeyView, flows: Option<&Flows>, index: u64) -> Option<Found> {
        let Self { settings, work, workers, state, .. } = self;
        let wanted = settings.find_depth && tiles.ignores_depth() && !view.has_depth();
        let (state, flows) = (state.as_ref().filter(|_| wanted)?, flows?);
        if view.repeats(&state.view) {
            work.count(Stage::Parallax, 0, 1);
            return state.found.clone();
        }
        let level = workers.level();
        let flow = flows.whole(level, work, [&state.view, view], settings.flow)?;
        // From the key frame before and back.
        let [back, there] = &*flow;
        let evidence = Evidence { rgb: &view.rgb, there, back };
        let stream = Stream { seed: settings.seed, frame: index };
        work.measure(Stage::Parallax, || parallax::find(level, evidence, state.found.as_ref(), stream))
    }

    /// State since the last key frame.
    pub(super) fn state(&self) -> Option<&State> {
        self.state.as_ref()
    }

    /// Goes on from there.
    pub(super) fn set_state(&mut self, state: State) {
        self.state = Some(state);
    }

    /// The frame through its own part of the network, as if it were the first one, but for the `alignment` of its depth and the depth that was `found` for it.
    pub(super) fn see(
        &mut self,
        frame: Frame,
        index: u64,
        timestamp: f64,
        alignment: Alignment,
        found: Option<&Found>,
    ) -> Result<(Placement, KeyView), EngineError> {
        let before = self.state.take();
        let seen = self.check(&frame, index, timestamp).and_then(|placement| {
            let mut tiles = self.tiles(placement)?;
            let view = self.reconstruct(&mut tiles, frame, index, placement).map(|(mut view, _)| {
                let level = self.workers.level();
                let found = found.filter(|found| found.contradiction(placement.model).is_none());
                let map = view.own_map(&tiles).or_else(|| found.and_then(|found| view.found_map(level, found)));
                let map = map.map(|map| AlignedMap { map: alignment.apply(map), alignment });
                self.context(&mut tiles).finish(&mut view, map);
                view
            });
            self.tiles = Some(tiles);
            view.map(|view| (placement, view))
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
            None => self.settings.resolution().place(size, self.settings.fit, self.model.as_ref()),
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

    /// The tiles of frames of this placement, taken out of the engine or laid anew.
    fn tiles(&mut self, placement: Placement) -> Result<Tiles, EngineError> {
        let found = placement.model;
        if let Some(tiles) = self.tiles.take().filter(|tiles| tiles.resolution == found) {
            return Ok(tiles);
        }
        let saving = match self.settings.reuse {
            Reuse::Off => None,
            Reuse::Exact => Some(Saving::Exact),
            Reuse::Within(tolerance) => Some(Saving::Within(tolerance)),
        };
        Tiles::new(&self.model, found, saving).ok_or_else(|| {
            let own = self.model.resolution();
            let expected = match self.model.tiling() {
                None => format!("{}x{}, the only one that the model takes", own[0], own[1]),
                Some(tiling) if tiling.partial => format!("multiples of {0}", tiling.patch),
                Some(tiling) => format!("multiples of {}, at least {}x{}", tiling.patch, own[0], own[1]),
            };
            EngineError::Resolution { expected, found }
        })
    }

    /// A frame through its own part of the network.
    fn reconstruct(
        &mut self,
        tiles: &mut Tiles,
        frame: Frame,
        index: u64,
        placement: Placement,
    ) -> Result<(KeyView, u64), EngineError> {
        self.context(tiles).reconstruct(frame, index, placement)
    }

    /// Context in which the next frame is reconstructed.
    fn context<'a>(&'a mut self, tiles: &'a mut Tiles) -> Context<'a> {
        let Self { settings, workers, work, fitter, state, .. } = self;
        let before = state.as_ref().filter(|_| settings.reuse != Reuse::Off).map(|state| &state.view);
        Context { settings, level: workers.level(), work, tiles, fitter, before }
    }
}

/// The map of a frame in the scale of the frame before, along the flow from it.
fn aligned(level: Level, map: DepthMap, view: &KeyView, state: Option<&State>, flows: Option<&Flows>) -> AlignedMap {
    let before = state.and_then(|state| state.view.map.as_ref().map(|map| (&state.view, map)));
    let alignment = match before {
        None => Alignment::default(),
        Some((before, then)) if view.repeats(before) => then.alignment,
        Some((_, then)) => {
            let links = flows.map_or_else(Vec::new, |flows| flows.links(level, &map, &then.map));
            align(&links, then.alignment)
        }
    };
    AlignedMap { map: alignment.apply(map), alignment }
}

/// The tokens computed and kept by all tiles, part by part; nothing where no tile keeps any.
fn tokens(tiles: &Tiles) -> Vec<(&'static str, Tokens)> {
    let mut sums: Vec<(&'static str, Tokens)> = Vec::new();
    for part in tiles.tiles.iter().filter_map(|tile| tile.session.tokens()).flatten() {
        match sums.iter_mut().find(|sum| sum.0 == part.0) {
            Some(sum) => sum.1 = sum.1 + part.1,
            None => sums.push(part),
        }
    }
    sums
}

/// Seconds from one time stamp to a later one: positive and finite.
fn length(start: f64, end: f64) -> f64 {
    (end - start).clamp(f64::MIN_POSITIVE, f64::MAX)
}
