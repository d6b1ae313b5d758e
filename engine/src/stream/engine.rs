//! The online loop.

use std::borrow::Cow;
use std::sync::Arc;
use std::time::{Duration, Instant};

use streamsplat_kernels::Level;
use streamsplat_kernels::flow::Field;
use streamsplat_kernels::philox::Stream;
use streamsplat_model::LoadOptions;
use streamsplat_model::reuse::{Saving, Tokens};

use super::between::{Flows, Partial, Seen, targets};
use super::canonical::{Advance, CanonicalSet, Step};
use super::colours::{Fitter, Rates, Target};
use super::keep::{Change, Kept};
use super::keyframe::{AlignedMap, Context, KeyView};
use super::lift::{Alignment, DepthMap, Memory, Past, align, contradiction};
use super::motion::{completed, fixed};
use super::pair::Pair;
use super::still::{Keeping, Still, Taken};
use super::tiles::Tiles;
use super::work::Stage;
use super::{
    EngineError, Fade, Frame, Interval, MotionFrom, Reconstructor, ResumePoint, Reuse, Settings, Work, Workers,
};
use crate::fit::Placement;
use crate::parallax::{self, Evidence, Filled, Found, Window};

/// Turns key frames into a dynamic scene, one interval per key frame.
///
/// State between key frames is bounded and independent of the stream's length: the last frame's input, Gaussians, what
/// the next frame's network reads of it (embedding, tokens, condition), luma pyramid, depth, means of static blocks and
/// colours behind its foreground, the last pair's motion, and the survivors of at most `max_age` frames.
/// Some choices of [`Reuse`] add the network's [`Cache`](streamsplat_model::reuse::Cache).
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
    /// Where the key frame's parts were in those before, for depth found by parallax.
    pub(super) window: Window,
}

impl Engine {
    /// An engine before its first key frame.
    ///
    /// # Errors
    /// When the model cannot be loaded or the threads cannot be started.
    pub fn new(settings: Settings) -> Result<Self, EngineError> {
        let workers = Workers::new(settings.level.unwrap_or_else(Level::detect), settings.threads)?;
        let options = LoadOptions {
            level: workers.level(),
            precision: settings.precision(),
            compute_zero_output: settings.reuse == Reuse::Off,
        };
        let model = workers.install(|| settings.model.load(&options))?;
        Ok(Self::from_parts(settings, workers, model))
    }

    /// [`Engine::new`] with the loaded model of another engine, made with the same model, precision and reuse.
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

    /// Settings of the engine.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Model that reconstructs the frames; other engines may share it.
    pub fn model(&self) -> &Arc<dyn Reconstructor> {
        &self.model
    }

    /// Threads and instruction-set level.
    pub fn workers(&self) -> &Workers {
        &self.workers
    }

    /// Returns true if depth is found for frames without a map of their own: [`Settings::find_depth`] is set and the
    /// model ignores depth. The first key frame then has depth only in the interval after it.
    pub fn finds_depth(&self) -> bool {
        self.settings.find_depth() && self.model.ignores_depth()
    }

    /// A function from the width and height of a video's frames to those at which the model sees them, without a
    /// border.
    pub fn content_size(&self) -> impl Fn([usize; 2]) -> [usize; 2] + Send + use<> {
        let (resolution, fit, model) = (self.settings.resolution(), self.settings.fit, self.model.clone());
        move |[width, height]| {
            let placement = resolution.place([height, width], fit, model.as_ref());
            placement.map_or([width, height], |placement| [placement.content[1], placement.content[0]])
        }
    }

    /// Work done and work avoided since the engine was made.
    pub fn work(&self) -> &Work {
        &self.work
    }

    /// Takes the next key frame, `timestamp` seconds into the video, and returns the interval that it ends. The first
    /// frame returns its static scene, an interval of length 0; where depth is found ([`Engine::finds_depth`]), its
    /// Gaussians are lifted from the next interval on.
    ///
    /// # Errors
    /// Frames without pixels, of another size than the first one, with buffers of the wrong length or pixels that are
    /// not finite; time stamps that are not after the previous one; input that the model refuses. The stream is then as
    /// before. After an error of the model, or a panic of a [`Reconstructor`], the next frame is computed in full.
    pub fn push(&mut self, frame: Frame, timestamp: f64) -> Result<Interval, EngineError> {
        self.push_with(Vec::new(), frame, timestamp)
    }

    /// [`Engine::push`] with the frames since the last key frame and their times, ascending. They are used where motion
    /// is taken from them ([`MotionFrom::Between`]), and ignored otherwise and before the first key frame. Their depth
    /// is not used.
    ///
    /// # Errors
    /// As [`Engine::push`]; and times that do not ascend between the two key frames.
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
        let placement = self.check(self.state.as_ref(), &frame, index, timestamp)?;
        let between = match self.settings.motion() {
            MotionFrom::Between if self.state.is_some() => between,
            _ => Vec::new(),
        };
        let mut after = self.state.as_ref().map(|state| state.timestamp);
        for (seen, time) in &between {
            if !(time.is_finite() && after.is_none_or(|after| after < *time) && *time < timestamp) {
                return Err(EngineError::Between { index, after, before: timestamp, found: *time });
            }
            self.check(self.state.as_ref(), seen, index, *time)?;
            after = Some(*time);
        }
        let mut tiles = self.tiles(placement)?;
        let advanced = self.advance(&mut tiles, between, frame, index, timestamp, placement);
        if advanced.is_err() {
            tiles.tiles.iter_mut().for_each(|tile| tile.session.forget());
        }
        self.work.tokens(&tokens(&tiles));
        self.work.branches(self.model.zero_output());
        self.tiles = Some(tiles);
        // No call to the reconstructor follows: after a panic of it the stream is as before, and the next frame is
        // computed in full.
        let (state, interval) = advanced?;
        self.state = Some(state);
        Ok(interval)
    }

    /// Processes a frame that passed the checks; returns the state after it.
    fn advance(
        &mut self,
        tiles: &mut Tiles,
        between: Vec<(Frame, f64)>,
        frame: Frame,
        index: u64,
        timestamp: f64,
        placement: Placement,
    ) -> Result<(State, Interval), EngineError> {
        let Self { settings, workers, work, fitter, state, .. } = self;
        let mut context = Context::new(settings, workers, work, fitter, tiles, state.as_ref());
        let (mut view, lost) = context.fitted(frame, placement);
        let mut seen = self.seen(between, timestamp, placement);
        let level = self.workers.level();
        let all = seen.len();
        let guessed = self.settings.guess_depth() && self.model.ignores_depth();
        let Still { mut keeping, mut partial, taken } = match &self.state {
            // With a guess key frames are lifted, and lifted Gaussians are not kept.
            Some(state) if !guessed => Still::of(&self.settings, &state.view, &mut view, &mut seen),
            _ => Still::default(),
        };
        let mut flows = match &keeping {
            Some(Keeping { kept, .. }) => self.flows_within(kept, &view, &seen, index)?,
            None => self.flows(&mut view, &mut seen, index)?,
        };
        let computed = keeping.is_none();
        let depths = match &keeping {
            Some(Keeping { kept, .. }) if kept.mostly() => Depths::default(),
            Some(_) => {
                let search = self.search(tiles, &mut view, flows.as_ref(), index)?;
                let found = found(&self.settings, level, self.state.as_ref(), search, &view.rgb, index);
                found.counted(&mut self.work)
            }
            // The network does not depend on the depth.
            None => {
                let search = self.search(tiles, &mut view, flows.as_ref(), index)?;
                self.reconstruct_and_find(tiles, &mut view, search, index)?
            }
        };
        if depths.found.is_some()
            && let Some(Taken { rgb, between }) = taken
        {
            // The camera moves after all: lifted Gaussians are not kept, and all frames are used as they came.
            (keeping, partial) = (None, Vec::new());
            (view.rgb, view.flow, seen) = (rgb, None, between);
            flows = self.flows(&mut view, &mut seen, index)?;
        }
        if !computed {
            let keeps = keeping.as_ref().map(|keeping| &keeping.keeps);
            let Self { settings, workers, work, fitter, state, .. } = self;
            Context::new(settings, workers, work, fitter, tiles, state.as_ref())
                .reconstruct(&mut view, keeps, index)?;
        }
        let every = self.settings.refine_every() as usize;
        let every = if seen.len() < all { (every / 2).max(1) } else { every };
        // All steps that can fail come before the state changes.
        let next_pair = match &self.state {
            Some(state) if self.settings.deforms() => {
                let views = [&state.view, &view];
                Some(Pair::new(tiles, &mut self.work, state.pair.as_ref(), views, index)?)
            }
            Some(_) => {
                Pair::leave_out(tiles, &mut self.work);
                None
            }
            None => None,
        };
        // The colours' maps can have the memory of the network's intermediate results.
        tiles.tiles.iter().for_each(|tile| tile.session.release());
        let Depths { found, first, window } = depths;
        if let Some(first) = first {
            self.lift_first(tiles, first);
        }
        let own = view.own_map(tiles);
        let own = own.map(|map| aligned(level, map, &view, self.state.as_ref(), flows.as_ref()));
        let map = own.or_else(|| view.found_map(level, found.as_ref()?));
        let Self { settings, workers, work, fitter, state: before, .. } = self;
        let past = before.as_ref().zip(flows.as_ref()).and_then(|(state, flows)| {
            let KeyView { rgb, added, .. } = &state.view;
            let map = &state.view.map.as_ref()?.map;
            Some(Past { level, map, rgb, covered: &added.covered, back: flows.back() })
        });
        let mut context = Context::new(settings, workers, work, fitter, tiles, before.as_ref());
        match (&keeping, before.as_ref()) {
            (Some(Keeping { kept, keeps, .. }), Some(state)) => {
                context.finish_kept(&mut view, &state.view, kept, keeps)
            }
            _ => context.finish(&mut view, map, &past.map_or(Memory::None, Memory::Past)),
        }
        let (set, advance) = match before {
            None => CanonicalSet::first(&view.gaussians, view.layers()),
            Some(state) => {
                let views = [&state.view, &view];
                let mut network = fixed(views.map(|view| view.gaussians.position.len()));
                if let Some(pair) = &next_pair {
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
                }
                let length = length(state.timestamp, timestamp);
                let motion = match &flows {
                    Some(flows) => work.time(Stage::Flow, || flows.motion(level, views, &seen, &network)),
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
                    kept: keeping.as_ref().map(|keeping| &keeping.keeps),
                };
                let (mut set, mut advance) = work.measure(Stage::Fusion, || state.set.advance(&step));
                let steps = settings.refine();
                if let Some(flows) = flows.filter(|_| steps > 0) {
                    let predicted = work.time(Stage::Flow, || flows.predicted(level, views));
                    let mut targets = targets(&seen, every);
                    targets.extend(partial.iter().map(Partial::target));
                    targets.extend(predicted.iter().map(|(t, rgb)| Target { t: *t, rgb, within: None }));
                    let changing = keeping.as_ref().is_none_or(|keeping| keeping.kept.changing().is_some());
                    let (rates, taken) = work.time(Stage::Colours, || {
                        let fit = Rates {
                            gaussians: &advance.gaussians,
                            kept: advance.kept.clone(),
                            targets: if changing { &targets } else { &[] },
                            lifted: step.lifted,
                            close: settings.close(),
                            wanted: &|pixels| {
                                keeping.as_ref().is_none_or(|k| k.kept.any_in(pixels, |change| change == Change::All))
                            },
                        };
                        fitter.rates(fit, placement.model, steps)
                    });
                    work.count(Stage::Colours, u64::from(taken), u64::from(steps - taken));
                    advance.gaussians.rgb_rate = rates;
                    set.recolour_survivors(&advance.gaussians);
                }
                (set, advance)
            }
        };
        let start = before.as_ref().map_or(timestamp, |s| s.timestamp);
        let found = found.map(|filled| filled.found);
        let state = State { frame: index, timestamp, placement, view, pair: next_pair, set, found, window };
        let Advance { gaussians, merges, dropped, .. } = advance;
        let dropped = dropped + lost;
        Ok((state, Interval { index, start, end: timestamp, gaussians, placement, merges, dropped }))
    }

    /// The frames in between at the model's size.
    fn seen(&mut self, between: Vec<(Frame, f64)>, timestamp: f64, placement: Placement) -> Vec<Seen> {
        let Some(state) = &self.state else { return Vec::new() };
        let (level, work) = (self.workers.level(), &mut self.work);
        let length = length(state.timestamp, timestamp);
        let relative = |time: f64| ((time - state.timestamp) / length) as f32;
        between.into_iter().map(|(frame, time)| Seen::new(level, work, frame, relative(time), placement)).collect()
    }

    /// Flow through the interval; none where motion is the network's.
    fn flows(&mut self, view: &mut KeyView, seen: &mut [Seen], index: u64) -> Result<Option<Flows>, EngineError> {
        if self.settings.motion() == MotionFrom::Network {
            return Ok(None);
        }
        let (level, effort, size) = (self.workers.level(), self.settings.flow, view.resolution());
        let Self { work, state, .. } = self;
        view.prepare_flow(level, work, effort, index)?;
        let Some(state) = state else { return Ok(None) };
        state.view.prepare_flow(level, work, effort, index)?;
        for seen in &mut *seen {
            seen.prepare_flow(level, work, size, index, effort)?;
        }
        Ok(Flows::new(level, work, [&state.view, view], seen, effort))
    }

    /// Flow through the changing part of the picture.
    fn flows_within(
        &mut self,
        kept: &Kept,
        view: &KeyView,
        seen: &[Seen],
        index: u64,
    ) -> Result<Option<Flows>, EngineError> {
        let (level, effort, rectangle) = (self.workers.level(), self.settings.flow, kept.changing());
        let Some(state) = &self.state else { return Ok(None) };
        let views = [&state.view, view];
        Flows::within(level, &mut self.work, views, seen, effort, rectangle.as_ref(), index).map(Some)
    }

    /// Puts key frame `index` through its own part of the network and finds its depth at the same time: the search runs
    /// on one thread.
    fn reconstruct_and_find(
        &mut self,
        tiles: &mut Tiles,
        view: &mut KeyView,
        search: Search<'_>,
        index: u64,
    ) -> Result<Depths, EngineError> {
        let rgb = view.rgb.clone();
        let Self { settings, workers, work, state, fitter, .. } = self;
        let (found, reconstructed) = rayon::join(
            || found(settings, workers.level(), state.as_ref(), search, &rgb, index),
            || Context::new(settings, workers, work, fitter, tiles, state.as_ref()).reconstruct(view, None, index),
        );
        reconstructed?;
        Ok(found.counted(&mut self.work))
    }

    /// Prepares the search for the depth of key frame `index`, where it is requested and the frame has no map of its
    /// own.
    fn search<'a>(
        &mut self,
        tiles: &Tiles,
        view: &mut KeyView,
        flows: Option<&'a Flows>,
        index: u64,
    ) -> Result<Search<'a>, EngineError> {
        let Self { settings, work, workers, state, .. } = self;
        let wanted = settings.find_depth() && tiles.ignores_depth() && !view.has_depth();
        let Some((state, flows)) = state.as_mut().filter(|_| wanted).zip(flows) else { return Ok(Search::None) };
        if view.repeats(&state.view) {
            return Ok(Search::Repeated);
        }
        let level = workers.level();
        for view in [&mut state.view, &mut *view] {
            view.prepare_flow(level, work, settings.flow, index)?;
        }
        Ok(flows.whole(level, work, [&state.view, view], settings.flow).map_or(Search::None, Search::Along))
    }

    /// Lifts the stream's first key frame, which had no depth when it came.
    fn lift_first(&mut self, tiles: &mut Tiles, found: Filled) {
        let Self { settings, workers, work, fitter, state, .. } = self;
        let Some(state) = state else { return };
        if let Some(map) = state.view.found_map(workers.level(), &found) {
            let mut context = Context::new(settings, workers, work, fitter, tiles, None);
            context.finish(&mut state.view, Some(map), &Memory::None);
            state.set = state.set.lifted(&state.view.gaussians, state.view.layers());
            state.found = Some(found.found);
        }
    }

    /// State since the last key frame.
    pub(super) fn state(&self) -> Option<&State> {
        self.state.as_ref()
    }

    /// Resumes from `state`.
    pub(super) fn set_state(&mut self, state: State) {
        self.state = Some(state);
    }

    /// Puts the frame of `point` through its own part of the network, as if it were the first one. Its depth is that of
    /// `point`.
    pub(super) fn see(&mut self, frame: Frame, point: &ResumePoint) -> Result<(Placement, KeyView), EngineError> {
        let placement = self.check(None, &frame, point.frame, point.timestamp)?;
        let mut tiles = self.tiles(placement)?;
        let Self { settings, workers, work, fitter, .. } = self;
        let mut context = Context::new(settings, workers, work, fitter, &mut tiles, None);
        let (mut view, _) = context.fitted(frame, placement);
        if let Some(kept) = &point.kept {
            kept.restore(&mut view);
            self.tiles = Some(tiles);
            return Ok((placement, view));
        }
        let view = context.reconstruct(&mut view, None, point.frame).map(|()| {
            let level = workers.level();
            let alignment = Alignment::from(point.depth);
            let found = point.found.as_ref().filter(|found| found.contradiction(placement.model).is_none());
            let own = view.own_map(context.tiles).map(|map| AlignedMap { map: alignment.apply(map), alignment });
            let found = found.cloned().map(|found| found.filled(level, &view.rgb, placement.model));
            let map = own.or_else(|| view.found_map(level, found.as_ref()?));
            let sound = contradiction(&point.covered, placement.model).is_none();
            let covered = if sound { &point.covered[..] } else { &[] };
            context.finish(&mut view, map, &Memory::Known(covered));
            view
        });
        self.tiles = Some(tiles);
        view.map(|view| (placement, view))
    }

    /// Returns the frame's placement, or why frame or time stamp are refused.
    fn check(
        &self,
        state: Option<&State>,
        frame: &Frame,
        index: u64,
        timestamp: f64,
    ) -> Result<Placement, EngineError> {
        let after = state.map(|s| s.timestamp);
        if !(timestamp.is_finite() && after.is_none_or(|after| after < timestamp)) {
            return Err(EngineError::Time { index, after, found: timestamp });
        }
        let size = [frame.height, frame.width];
        let placement = match state {
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

    /// The tiles of frames of this placement: the engine's own, taken out of it, or new ones.
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
}

impl<'a> Context<'a> {
    /// Context in which the frame after `before` is reconstructed.
    fn new(
        settings: &'a Settings,
        workers: &Workers,
        work: &'a mut Work,
        fitter: &'a mut Fitter,
        tiles: &'a mut Tiles,
        before: Option<&'a State>,
    ) -> Self {
        let before = before.filter(|_| settings.reuse != Reuse::Off).map(|state| &state.view);
        Context { settings, level: workers.level(), work, tiles, fitter, before }
    }
}

/// What a key frame's depth is found from.
#[derive(Default)]
enum Search<'a> {
    /// No depth is searched.
    #[default]
    None,
    /// The key frame repeats the one before.
    Repeated,
    /// The flow from the key frame before to this one, and back.
    Along(Cow<'a, [Field; 2]>),
}

/// Depth found by parallax.
#[derive(Default)]
struct Depths {
    /// For the key frame.
    found: Option<Filled>,
    /// For the stream's first key frame, where this is the second.
    first: Option<Filled>,
    window: Window,
}

/// [`Depths`], the searches done and left out, and the time that they took.
#[derive(Default)]
struct Measured {
    depths: Depths,
    searches: [u64; 2],
    /// Intervals without parallax that added a guess.
    guessed: u64,
    time: Duration,
}

impl Measured {
    /// The result, entered in the account.
    fn counted(self, work: &mut Work) -> Depths {
        let Self { depths, searches: [done, avoided], guessed, time } = self;
        work.count(Stage::Parallax, done, avoided);
        work.count(Stage::Guess, guessed, 0);
        work.spent(Stage::Parallax, time);
        depths
    }
}

/// Finds depth by parallax for key frame `index`, `[3, H, W]`, the one after `state`.
fn found(
    settings: &Settings,
    level: Level,
    state: Option<&State>,
    search: Search<'_>,
    rgb: &[f32],
    index: u64,
) -> Measured {
    let Some(state) = state else { return Measured::default() };
    let _span = Stage::Parallax.span().entered();
    let start = Instant::now();
    let (guess, size) = (settings.guess_depth(), state.view.resolution());
    let flow = match search {
        Search::None => return Measured::default(),
        // A camera that does not move, of whose stream nothing is guessed yet.
        Search::Repeated if guess && state.found.is_none() => Cow::Owned(std::array::from_fn(|_| Field::zero(size))),
        Search::Repeated => {
            let found = state.found.clone().map(|found| found.filled(level, rgb, size));
            let depths = Depths { found, first: None, window: state.window.clone() };
            return Measured { depths, searches: [0, 1], guessed: 0, time: start.elapsed() };
        }
        Search::Along(flow) => flow,
    };
    let [forth, back] = &*flow;
    let evidence = Evidence { rgb, there: back, back: forth };
    let stream = |frame: u64| Stream { seed: settings.seed, frame };
    let search = parallax::search(level, evidence, state.found.as_ref(), &state.window, stream(index), guess);
    let parallax::Search { filled: found, guessed, window } = search;
    let mut searches = 1;
    let first = found.as_ref().filter(|_| index == 1 && state.view.map.is_none()).and_then(|filled| {
        let evidence = Evidence { rgb: &state.view.rgb, there: forth, back };
        searches = 2;
        parallax::search(level, evidence, Some(&filled.found), &Window::default(), stream(0), guess).filled
    });
    let depths = Depths { found, first, window };
    Measured { depths, searches: [searches, 0], guessed: u64::from(guessed), time: start.elapsed() }
}

/// Aligns the map of a frame with the scale of the frame before, along the flow from it.
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

/// Sums of the tokens computed and kept over all tiles, part by part; empty where no tile keeps any.
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
