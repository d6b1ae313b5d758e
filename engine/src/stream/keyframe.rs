//! A key frame alone: its pixels go through the static half of the network, tile by tile.

use std::borrow::Cow;
use std::sync::Arc;

use streamsplat_model::{Embedding, StaticGaussians};

use super::between::FlowView;
use super::canonical::Layers;
use super::colours::{Fitter, Pixels};
use super::detail;
use super::gaussians::reached;
use super::keep::{Change, Keeps, Kept, Past, with_kept};
use super::lift::{Added, Alignment, DepthMap, Memory, lift, normalise_most};
use super::pass::Pass;
use super::tiles::{Part, Tiles};
use super::work::Stage;
use super::{Behind, DepthRange, EngineError, FlowEffort, Frame, Settings, Work};
use crate::fit::{self, Placement};
use crate::parallax::Filled;

/// y of a frame without depth.
const CARD: f32 = 0.5;
/// Factor on the model's own relief in a frame without depth. The relief is the order in which the model draws
/// neighbours. In a turned view it bends straight edges in steps of a patch. Much smaller factors would let the turn
/// change the order, which blurs the picture.
const RELIEF: f32 = 0.5;
/// Details are added after one in so many steps of the fit of colours.
const FIRST: u32 = 4;

/// A key frame at the model's size, and the model's results for it.
pub(super) struct KeyView {
    /// `[3, H, W]`
    pub(super) rgb: Vec<f32>,
    /// `[H, W]`
    pub(super) depth: Option<Vec<f32>>,
    /// `None` for tiles that were not computed, because all their Gaussians are kept.
    pub(super) tiles: Vec<Option<TileView>>,
    /// The Gaussians of all tiles, in the frame's world; lifted to the frame's depth and with colours that fit the
    /// frame where that is requested. None before [`Context::finish`].
    pub(super) gaussians: Arc<StaticGaussians>,
    /// Those that are not the model's own, last in `gaussians`.
    pub(super) added: Added,
    /// The map that they are lifted to, in the scale of the stream.
    pub(super) map: Option<AlignedMap>,
    /// Pyramid for flow, where motion is taken from frames.
    pub(super) flow: Option<FlowView>,
    /// The past of the blocks, where some are kept from the key frame before; `rgb` is then the mean in them.
    pub(super) past: Option<Past>,
    resolution: [usize; 2],
}

impl KeyView {
    /// The layers of the frame's Gaussians.
    pub(super) fn layers(&self) -> Layers {
        let Added { outline, details, moving, .. } = &self.added;
        let cells = self.gaussians.position.len() - moving.len();
        Layers { cells, outline: cells + outline, behind: cells + moving.len() - details }
    }

    /// The pixels of its details.
    fn details(&self) -> Vec<usize> {
        let first = self.gaussians.len() - self.added.details;
        detail::pixels(&self.gaussians.position[first..], self.resolution)
    }

    /// The places whose motion each Gaussian takes.
    pub(super) fn moving(&self) -> Cow<'_, [[f32; 3]]> {
        if self.added.moving.is_empty() {
            return Cow::Borrowed(&self.gaussians.position);
        }
        Cow::Owned([&self.gaussians.position[..self.layers().cells], &self.added.moving].concat())
    }

    /// Rows and columns of pixels.
    pub(super) fn resolution(&self) -> [usize; 2] {
        self.resolution
    }
}

/// A depth map without holes, and the alignment that brought it to the scale of the stream.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct AlignedMap {
    pub(super) map: DepthMap,
    pub(super) alignment: Alignment,
}

/// A tile of the frame.
#[derive(Clone)]
pub(super) struct TileView {
    pub(super) features: Arc<Features>,
    /// In the tile's own world; those that are not of `part` have no meaning.
    pub(super) gaussians: Arc<StaticGaussians>,
    /// What was computed.
    pub(super) part: Part,
}

/// The dynamic decoder's input from one tile. Equal inputs share one. Empty where no decoder follows.
pub(super) struct Features {
    pub(super) embedding: Embedding,
    pub(super) tokens: Vec<f32>,
    pub(super) condition: Option<Vec<f32>>,
}

impl Features {
    pub(super) fn none() -> Arc<Features> {
        Arc::new(Features { embedding: Embedding { h: Vec::new() }, tokens: Vec::new(), condition: None })
    }
}

/// Context in which a frame is reconstructed.
pub(super) struct Context<'a> {
    pub(super) settings: &'a Settings,
    pub(super) level: streamsplat_kernels::Level,
    pub(super) work: &'a mut Work,
    pub(super) tiles: &'a mut Tiles,
    pub(super) fitter: &'a mut Fitter,
    /// The key frame before, where results of it may be reused.
    pub(super) before: Option<&'a KeyView>,
}

impl Context<'_> {
    /// Returns a key frame at the model's size, of which nothing is computed yet, and the number of depth values that
    /// were not finite.
    pub(super) fn fitted(&mut self, frame: Frame, placement: Placement) -> (KeyView, u64) {
        let Frame { mut rgb, mut depth, .. } = frame;
        let (level, range, lifts) = (self.level, self.settings.depth_range, self.tiles.ignores_depth());
        let mut lost = 0;
        let (rgb, depth) = self.work.measure(Stage::Fit, || {
            rgb.iter_mut().for_each(|x| *x = x.clamp(0.0, 1.0));
            if let Some(depth) = &mut depth {
                lost = range.apply(depth, lifts);
            }
            (placement.fit_in(level, &rgb), depth.map(|d| placement.fit_in(level, &d)))
        });
        (KeyView::of(rgb, depth, self.tiles.resolution), lost)
    }

    /// Puts key frame `index` through its own part of the network, all tiles at the same time, except for those whose
    /// cells are all kept. It is not [finished](Self::finish) yet.
    pub(super) fn reconstruct(
        &mut self,
        view: &mut KeyView,
        kept: Option<&Keeps>,
        index: u64,
    ) -> Result<(), EngineError> {
        let wanted: Option<Vec<bool>> =
            kept.map(|kept| kept.of_own().iter().map(|change| *change == Change::All).collect());
        let depth = view.depth.as_deref().filter(|_| !self.tiles.ignores_depth());
        let pass = Pass { settings: self.settings, before: self.before, rgb: &view.rgb, depth, index };
        view.tiles = pass.tiles(self.tiles, wanted.as_deref(), self.work)?;
        Ok(())
    }

    /// Puts the Gaussians of a frame's tiles together, lifts them to `map` and fits their colours, where either is
    /// requested. `memory`: colours of surfaces that the frame's foreground hides.
    pub(super) fn finish(&mut self, view: &mut KeyView, map: Option<AlignedMap>, memory: &Memory<'_>) {
        let unchanged = |before: &&KeyView| {
            let same = |(then, now): (&Option<TileView>, &Option<TileView>)| match (then, now) {
                (Some(then), Some(now)) => Arc::ptr_eq(&then.gaussians, &now.gaussians),
                _ => false,
            };
            // Kept parts are not a function of the frame.
            before.past.is_none() && before.map == map && before.tiles.iter().zip(&view.tiles).all(same)
        };
        if let Some(before) = self.before.filter(unchanged) {
            view.gaussians = before.gaussians.clone();
            view.added = before.added.clone();
            view.map = map;
            return;
        }
        // Of a frame that gets its depth afterwards the details stay: the stream goes on with their identities.
        let details = (view.added.details > 0).then(|| view.details());
        view.gaussians = self.put_together(view, map.is_none());
        if let Some(AlignedMap { map, .. }) = &map {
            let memory = (self.settings.behind == Behind::On).then_some(memory);
            let (level, gaussians) = (self.level, Arc::make_mut(&mut view.gaussians));
            view.added = self.work.measure(Stage::Lift, || lift(level, gaussians, map, &view.rgb, memory));
            let Added { outline, moving, known, .. } = &view.added;
            self.work.count(Stage::Outline, *outline as u64, 0);
            self.work.count(Stage::Behind, (moving.len() - outline) as u64, 0);
            self.work.count(Stage::Covered, *known as u64, 0);
        }
        view.map = map;
        let held = view.added.held.clone();
        self.colour(view, held, &|_| true, |shown, share| {
            details.unwrap_or_else(|| shown.largest_errors(share, &|_| true))
        });
    }

    /// The Gaussians of a frame's tiles; with `card` those of a frame without depth. Where depth is searched, a model
    /// that ignores depth then has [`RELIEF`] of its own.
    fn put_together(&self, view: &KeyView, card: bool) -> Arc<StaticGaussians> {
        let of_tiles = view.tiles.iter().map(|tile| tile.as_ref().map(|tile| tile.gaussians.clone()));
        let mut gaussians = self.tiles.gaussians(&of_tiles.collect::<Vec<_>>());
        if card && self.settings.find_depth() && self.tiles.ignores_depth() {
            for position in &mut Arc::make_mut(&mut gaussians).position {
                position[1] = RELIEF.mul_add(position[1], (1.0 - RELIEF) * CARD);
            }
        }
        gaussians
    }

    /// [`Context::finish`] for a frame without a map that keeps cells of the frame before. Cells marked
    /// [`Change::Colours`] get colours that the kept record reaches to the bit.
    pub(super) fn finish_kept(&mut self, view: &mut KeyView, before: &KeyView, kept: &Kept, keeps: &Keeps) {
        self.work.count(Stage::Still, (kept.share()[1] - kept.share()[0]) as u64, kept.share()[0] as u64);
        view.past = Some(kept.past.clone());
        if kept.changes.iter().all(|change| *change == Change::None) {
            view.gaussians = before.gaussians.clone();
            view.added = before.added.clone();
            return;
        }
        let mut gaussians = match view.tiles.iter().any(Option::is_some) {
            true => Arc::unwrap_or_clone(self.put_together(view, true)),
            false => StaticGaussians::clone(&before.gaussians),
        };
        with_kept(&mut gaussians, &before.gaussians, keeps);
        let details = keeps.details();
        let moving = gaussians.position[gaussians.len() - details..].to_vec();
        view.added = Added { details, moving, ..Added::default() };
        view.gaussians = Arc::new(gaussians);
        let held = keeps.of_new().map(|change| if change == Change::None { 0.0 } else { 1.0 }).collect();
        let wanted = |pixels| kept.any_in(pixels, |change| change != Change::None);
        self.colour(view, held, &wanted, |shown, share| {
            shown.largest_errors(share, &|pixel| kept.at(pixel) == Change::All)
        });
        let colours = &mut Arc::make_mut(&mut view.gaussians).rgb;
        for (cell, then) in before.gaussians.rgb.iter().enumerate() {
            if let Some(now) = keeps.index(cell).filter(|_| keeps.changes[cell] == Change::Colours) {
                colours[now] = std::array::from_fn(|channel| reached(then[channel], colours[now][channel]));
            }
        }
    }

    /// Fits the colours to the frame, where fits are requested at all, and adds [details](detail) after the first
    /// steps. `held`: as for [`Fitter::key`]; `wanted`: the blocks of pixels that count; `choose`: the details' pixels.
    fn colour(
        &mut self,
        view: &mut KeyView,
        mut held: Vec<f32>,
        wanted: &dyn Fn(Pixels) -> bool,
        choose: impl FnOnce(detail::Shown<'_>, u32) -> Vec<usize>,
    ) {
        let (steps, share) = (self.settings.refine(), self.settings.detail());
        let first = if share == 0 { steps } else { steps.div_ceil(FIRST) };
        self.steps(view, &held, wanted, first);
        if first == steps {
            return;
        }
        let (cells, resolution) = (view.layers().cells, view.resolution);
        let (gaussians, frame) = (Arc::make_mut(&mut view.gaussians), &view.rgb);
        let shown = detail::Shown { frame, picture: &self.fitter.picture, resolution };
        let added = self.work.time(Stage::Detail, || {
            let pixels = choose(shown, share);
            detail::add(gaussians, cells, &pixels, frame, resolution)
        });
        self.work.count(Stage::Detail, added as u64, 0);
        view.added.details += added;
        view.added.moving.extend_from_slice(&gaussians.position[gaussians.len() - added..]);
        if !held.is_empty() {
            held.resize(gaussians.len(), 1.0);
        }
        self.steps(view, &held, wanted, steps - first);
    }

    /// Takes up to `steps` steps of the fit of colours to the frame.
    fn steps(&mut self, view: &mut KeyView, held: &[f32], wanted: &dyn Fn(Pixels) -> bool, steps: u32) {
        if steps == 0 {
            return;
        }
        let (fitter, resolution) = (&mut *self.fitter, self.tiles.resolution);
        let (gaussians, frame) = (&*view.gaussians, &view.rgb);
        let (rgb, taken) =
            self.work.time(Stage::Colours, || fitter.key(gaussians, held, frame, resolution, steps, wanted));
        self.work.count(Stage::Colours, u64::from(taken), u64::from(steps - taken));
        Arc::make_mut(&mut view.gaussians).rgb = rgb;
    }
}

impl KeyView {
    /// Prepares the frame for flow in the interval that ends with key frame `index`, unless it is prepared already.
    pub(super) fn prepare_flow(
        &mut self,
        level: streamsplat_kernels::Level,
        work: &mut Work,
        effort: FlowEffort,
        index: u64,
    ) -> Result<(), EngineError> {
        if self.flow.is_none() {
            let (rgb, size) = (&self.rgb, self.resolution);
            self.flow = Some(work.time(Stage::Flow, || FlowView::new(level, rgb, size, index, effort))?);
        }
        Ok(())
    }

    /// A picture of which nothing is computed yet.
    pub(super) fn of(rgb: Vec<f32>, depth: Option<Vec<f32>>, resolution: [usize; 2]) -> Self {
        let (gaussians, added) = (Arc::default(), Added::default());
        KeyView { rgb, depth, tiles: Vec::new(), gaussians, added, map: None, flow: None, past: None, resolution }
    }

    /// Returns true if the frame has a depth map of its own.
    pub(super) fn has_depth(&self) -> bool {
        self.depth.is_some()
    }

    /// The map of the frame by `found`, which has one scale in the whole stream; `None` where no two of its values
    /// differ.
    pub(super) fn found_map(&self, level: streamsplat_kernels::Level, found: &Filled) -> Option<AlignedMap> {
        let inverse = found.map(level, self.resolution);
        let map = DepthMap { inverse, confidence: None, resolution: self.resolution }.filled()?;
        Some(AlignedMap { map, alignment: Alignment::default() })
    }

    /// The frame's own depth map without holes, for a model that ignores depth; `None` where it has none or no two of
    /// its values differ.
    pub(super) fn own_map(&self, tiles: &Tiles) -> Option<DepthMap> {
        let inverse = self.depth.as_ref().filter(|_| tiles.ignores_depth())?.clone();
        DepthMap { inverse, confidence: None, resolution: self.resolution }.filled()
    }

    /// Returns true if both show the same pixels and have the same depth map, to the bit.
    pub(super) fn repeats(&self, before: &KeyView) -> bool {
        let same =
            |a: &[f32], b: &[f32]| a.len() == b.len() && a.iter().zip(b).all(|(a, b)| a.to_bits() == b.to_bits());
        same(&self.rgb, &before.rgb)
            && match (&self.depth, &before.depth) {
                (None, None) => true,
                (Some(a), Some(b)) => same(a, b),
                _ => false,
            }
    }
}

impl DepthRange {
    /// Brings a depth map into [0, 1]; returns the number of values that were not finite. With `holes` these become NaN
    /// and are not counted.
    fn apply(self, depth: &mut [f32], holes: bool) -> u64 {
        if holes {
            let found: Vec<usize> = (0..depth.len()).filter(|&i| !depth[i].is_finite()).collect();
            match self {
                DepthRange::Frame => normalise_most(depth),
                DepthRange::Given => drop(self.apply(depth, false)),
            }
            found.into_iter().for_each(|i| depth[i] = f32::NAN);
            return 0;
        }
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
