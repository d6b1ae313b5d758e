//! Evidence between two key frames: the frames in between where they are known, and optical flow. Both determine the
//! motion and the colours of the interval.

use std::borrow::Cow;
use std::ops::Range;
use std::sync::Arc;

use streamsplat_kernels::Level;
use streamsplat_kernels::flow::{self, Blend, Field, Lumas, Pyramid, Step};

use super::colours::{Pixels, Target};
use super::keep::Blocks;
use super::keyframe::KeyView;
use super::lift::{DepthMap, Link};
use super::motion::along_flow;
use super::reconstructor::Motion;
use super::work::Stage;
use super::{EngineError, FlowEffort, Frame, Work};
use crate::fit::{Placement, cut};

/// Times in an interval at which images are predicted from its key frames, where no frame in between is known.
const PREDICTED: [f32; 4] = [0.2, 0.4, 0.6, 0.8];

/// Step in pixels, along rows and columns, of the grid of places at which depths are compared.
const SPACING: usize = 4;

/// A frame prepared for optical flow.
pub(super) struct FlowView {
    pyramid: Pyramid,
}

/// A frame between two key frames.
pub(super) struct Seen {
    /// Its time in the interval.
    pub(super) t: f32,
    /// `[3, H, W]`
    pub(super) rgb: Arc<Vec<f32>>,
    flow: Option<FlowView>,
}

/// A frame that flow leaves out, and the blocks in which colours are fitted to it nevertheless.
pub(super) struct Partial {
    /// Its time in the interval.
    pub(super) t: f32,
    /// `[3, H, W]`
    pub(super) rgb: Arc<Vec<f32>>,
    blocks: Blocks,
    differs: Vec<bool>,
}

impl Partial {
    /// The frame as a target of the colour fit.
    pub(super) fn target(&self) -> Target<'_> {
        Target { t: self.t, rgb: &self.rgb, within: Some(self) }
    }

    /// Returns true if colours are fitted in the block that holds this rectangle.
    pub(super) fn counts_in(&self, [rows, columns]: &Pixels) -> bool {
        self.differs[self.blocks.holding([rows.start, columns.start])]
    }
}

/// Flow through an interval.
pub(super) struct Flows {
    /// From each frame to the next and back, first to last.
    steps: Vec<[Field; 2]>,
    /// Times of the frames, 0 and 1 among them.
    times: Vec<f32>,
}

impl FlowView {
    /// Prepares a frame `[3, H, W]`.
    pub(super) fn new(
        level: Level,
        rgb: &[f32],
        resolution: [usize; 2],
        index: u64,
        effort: FlowEffort,
    ) -> Result<Self, EngineError> {
        let luma = flow::luma(level, rgb);
        let pyramid = Pyramid::new(level, &luma, resolution, &options(effort));
        pyramid.map(|pyramid| Self { pyramid }).map_err(|e| EngineError::Flow { index, reason: e.to_string() })
    }
}

impl Seen {
    /// A frame at `t` of an interval.
    pub(super) fn new(level: Level, work: &mut Work, mut frame: Frame, t: f32, placement: Placement) -> Self {
        let rgb = work.measure(Stage::Fit, || {
            frame.rgb.iter_mut().for_each(|x| *x = x.clamp(0.0, 1.0));
            placement.fit_in(level, &frame.rgb)
        });
        Self { t, rgb: Arc::new(rgb), flow: None }
    }

    /// The frame before it is prepared for flow.
    pub(super) fn unprepared(&self) -> Self {
        Self { t: self.t, rgb: self.rgb.clone(), flow: None }
    }

    /// Prepares the frame for flow, as one of the interval that ends with key frame `index`.
    pub(super) fn prepare_flow(
        &mut self,
        level: Level,
        work: &mut Work,
        size: [usize; 2],
        index: u64,
        effort: FlowEffort,
    ) -> Result<(), EngineError> {
        self.flow = Some(work.time(Stage::Flow, || FlowView::new(level, &self.rgb, size, index, effort))?);
        Ok(())
    }
}

/// Returns a field of this size that holds `field` inside a rectangle and is zero outside.
fn placed(field: &Field, size: [usize; 2], [rows, columns]: &[Range<usize>; 2]) -> Field {
    let mut whole = Field::zero(size);
    for (at, row) in rows.clone().enumerate() {
        let (to, from) = (row * size[1] + columns.start, at * columns.len());
        whole.u[to..to + columns.len()].copy_from_slice(&field.u[from..from + columns.len()]);
        whole.v[to..to + columns.len()].copy_from_slice(&field.v[from..from + columns.len()]);
    }
    whole
}

impl Flows {
    /// Flow through the frames of `between`, from key frame `a` to key frame `b`.
    pub(super) fn new(
        level: Level,
        work: &mut Work,
        [a, b]: [&KeyView; 2],
        between: &[Seen],
        effort: FlowEffort,
    ) -> Option<Self> {
        let (first, last) = (a.flow.as_ref()?, b.flow.as_ref()?);
        let mut frames = vec![(first, &a.rgb[..])];
        for seen in between {
            frames.push((seen.flow.as_ref()?, &seen.rgb[..]));
        }
        frames.push((last, &b.rgb[..]));
        let steps = frames
            .windows(2)
            .map(|pair| {
                let same = pair[0].1.iter().zip(pair[1].1).all(|(a, b)| a.to_bits() == b.to_bits());
                if same {
                    work.count(Stage::Flow, 0, 1);
                    let still = || Field::zero(a.resolution());
                    return [still(), still()];
                }
                let [one, other] = [&pair[0].0.pyramid, &pair[1].0.pyramid];
                let options = options(effort);
                work.measure(Stage::Flow, || flow::both(level, one, other, [None; 2], &options))
            })
            .collect();
        Some(Self { steps, times: times(between) })
    }

    /// The same, with flow computed inside a rectangle of pixels (rows and columns) and zero outside. `None`: zero
    /// everywhere.
    pub(super) fn within(
        level: Level,
        work: &mut Work,
        [a, b]: [&KeyView; 2],
        between: &[Seen],
        effort: FlowEffort,
        rectangle: Option<&[Range<usize>; 2]>,
        index: u64,
    ) -> Result<Self, EngineError> {
        let (size, times) = (a.resolution(), times(between));
        let Some(rectangle) = rectangle else {
            work.count(Stage::Flow, 0, times.len() as u64 - 1);
            let still = || [Field::zero(size), Field::zero(size)];
            return Ok(Self { steps: times.windows(2).map(|_| still()).collect(), times });
        };
        let part = [0, 1].map(|axis| rectangle[axis].len());
        let frames = [&a.rgb[..]].into_iter().chain(between.iter().map(|seen| &seen.rgb[..])).chain([&b.rgb[..]]);
        let views = work.time(Stage::Flow, || {
            frames
                .map(|rgb| FlowView::new(level, &cut(rgb, size, rectangle), part, index, effort))
                .collect::<Result<Vec<_>, _>>()
        })?;
        let steps = views.windows(2).map(|pair| {
            let fields = work.measure(Stage::Flow, || {
                flow::both(level, &pair[0].pyramid, &pair[1].pyramid, [None; 2], &options(effort))
            });
            fields.map(|field| placed(&field, size, rectangle))
        });
        Ok(Self { steps: steps.collect(), times })
    }

    /// The motion of the Gaussians of both key frames, the network's where flow has none.
    pub(super) fn motion(
        &self,
        level: Level,
        [a, b]: [&KeyView; 2],
        between: &[Seen],
        network: &[Arc<Motion>; 2],
    ) -> [Arc<Motion>; 2] {
        let count = self.steps.len();
        let step = |i: usize, way: usize, distance: f32| Step {
            there: &self.steps[i][way],
            back: &self.steps[i][1 - way],
            distance,
        };
        let forward: Vec<Step<'_>> = (0..count).map(|i| step(i, 0, self.times[i + 1])).collect();
        let backward: Vec<Step<'_>> = (0..count).rev().map(|i| step(i, 1, 1.0 - self.times[i])).collect();
        let [first, last] = [a, b].map(|view| flow::luma(level, &view.rgb));
        let between: Vec<Vec<f32>> = between.iter().map(|seen| flow::luma(level, &seen.rgb)).collect();
        let mut to: Vec<&[f32]> = between.iter().map(Vec::as_slice).collect();
        let onwards = along_flow(level, &a.moving(), &network[0], &forward, Lumas { from: &first, to: &to }, 1.0);
        to.reverse();
        let back = along_flow(level, &b.moving(), &network[1], &backward, Lumas { from: &last, to: &to }, -1.0);
        [onwards, back]
    }

    /// Pairs of values of two depth maps, those of the last and of the first key frame, at places that flow connects.
    ///
    /// Every [`SPACING`]-th pixel of the last key frame, along rows and columns, is followed back along the flow
    /// ([`flow::trace`]). Places whose path fails are left out.
    pub(super) fn links(&self, level: Level, last: &DepthMap, first: &DepthMap) -> Vec<Link> {
        let [height, width] = last.resolution;
        if first.resolution != last.resolution {
            return Vec::new();
        }
        let back = self.back();
        let places: Vec<[usize; 2]> = (SPACING / 2..height)
            .step_by(SPACING)
            .flat_map(|y| (SPACING / 2..width).step_by(SPACING).map(move |x| [x, y]))
            .collect();
        let starts: Vec<[f32; 2]> = places.iter().map(|place| place.map(|at| at as f32)).collect();
        let mut ends = vec![[0.0; 2]; starts.len()];
        flow::trace(level, &starts, &back, &mut ends);
        let kept = places.iter().zip(ends).filter(|(_, [u, _])| !u.is_nan());
        kept.map(|(&[x, y], [u, v])| {
            let (column, row) = ((u + 0.5).max(0.0) as usize, (v + 0.5).max(0.0) as usize);
            let there = row.min(height - 1) * width + column.min(width - 1);
            Link { now: last.inverse[y * width + x], then: first.inverse[there] }
        })
        .collect()
    }

    /// Steps from the last key frame to the first.
    pub(super) fn back(&self) -> Vec<Step<'_>> {
        self.steps.iter().rev().map(|[forth, back]| Step { there: back, back: forth, distance: 1.0 }).collect()
    }

    /// Flow from the first key frame to the last and back, in one step.
    pub(super) fn whole(
        &self,
        level: Level,
        work: &mut Work,
        [a, b]: [&KeyView; 2],
        effort: FlowEffort,
    ) -> Option<Cow<'_, [Field; 2]>> {
        if let [only] = &self.steps[..] {
            return Some(Cow::Borrowed(only));
        }
        let [one, other] = [&a.flow.as_ref()?.pyramid, &b.flow.as_ref()?.pyramid];
        let options = options(effort);
        Some(Cow::Owned(work.measure(Stage::Flow, || flow::both(level, one, other, [None; 2], &options))))
    }

    /// Images of the interval that flow predicts from its key frames; none where frames in between are known.
    pub(super) fn predicted(&self, level: Level, [a, b]: [&KeyView; 2]) -> Vec<(f32, Vec<f32>)> {
        let [[forward, backward]] = &self.steps[..] else { return Vec::new() };
        let blend = Blend::new(level, [&a.rgb, &b.rgb], [forward, backward]);
        PREDICTED.map(|t| (t, blend.at(t))).to_vec()
    }
}

/// Parameters of the flow.
fn options(effort: FlowEffort) -> flow::Options {
    match effort {
        FlowEffort::Fine => flow::Options::default(),
        FlowEffort::Coarse => flow::Options { finest: 2, refinement: 2, ..flow::Options::default() },
    }
}

/// Times of the frames of an interval, including its key frames.
fn times(between: &[Seen]) -> Vec<f32> {
    [0.0].into_iter().chain(between.iter().map(|seen| seen.t)).chain([1.0]).collect()
}

/// The first index of every `every`-th frame of `count`: in the middle of the first `every`.
fn first(count: usize, every: usize) -> usize {
    (every / 2).min(count.saturating_sub(1) / 2)
}

/// Fewer frames in between than this are all used: intervals are short where much moves.
const MANY: usize = 4;
/// Greatest difference of a block from the mean of the frames before and after, as a root of the mean square, up to
/// which these two suffice for its colours.
const ALIKE: f64 = 10.0 / 255.0;

/// Every second one of an interval's frames in between, where there are [`MANY`], not prepared for flow.
pub(super) fn every_second(between: &[Seen]) -> Vec<Seen> {
    let (first, step) = if between.len() < MANY { (0, 1) } else { (first(between.len(), 2), 2) };
    between.iter().skip(first).step_by(step).map(Seen::unprepared).collect()
}

/// The frames that [`every_second`] leaves out between key frames `[a, b]`, with the blocks where they are not
/// [`ALIKE`] the mean of their neighbours, weighted by time: `a + w·(b − a)` in binary32. Frames without such blocks
/// are not returned. `changes`: the blocks that are looked at.
pub(super) fn left_out(
    blocks: Blocks,
    [a, b]: [&[f32]; 2],
    between: &[Seen],
    changes: impl Fn(usize) -> bool + Sync,
) -> Vec<Partial> {
    if between.len() < MANY || !blocks.indices().any(&changes) {
        return Vec::new();
    }
    let picture = |i: Option<usize>| match i.map(|i| between.get(i)) {
        None => (0.0, a),
        Some(None) => (1.0, b),
        Some(Some(seen)) => (seen.t, &seen.rgb[..]),
    };
    let partial = |(i, seen): (usize, &Seen)| {
        let [(start, one), (end, other)] = [i.checked_sub(1), Some(i + 1)].map(picture);
        let part = if start < end { (seen.t - start) / (end - start) } else { 0.5 };
        let mean: Vec<f32> = one.iter().zip(other).map(|(x, y)| x + part * (y - x)).collect();
        let differs = blocks.differing(&seen.rgb, &mean, ALIKE, &changes);
        differs.contains(&true).then(|| Partial { t: seen.t, rgb: seen.rgb.clone(), blocks, differs })
    };
    between.iter().enumerate().step_by(2).filter_map(partial).collect()
}

/// Every `every`-th frame in between as a target of the colour fit.
pub(super) fn targets(between: &[Seen], every: usize) -> Vec<Target<'_>> {
    let first = first(between.len(), every);
    between.iter().skip(first).step_by(every).map(|seen| Target { t: seen.t, rgb: &seen.rgb, within: None }).collect()
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::{Blocks, Seen, every_second, left_out};

    #[test]
    fn every_second_frame_is_used_of_many() {
        let of = |count: usize| -> Vec<usize> {
            let seen = |t| Seen { t: t as f32, rgb: Arc::default(), flow: None };
            every_second(&(1..=count).map(seen).collect::<Vec<_>>()).iter().map(|seen| seen.t as usize).collect()
        };
        assert_eq!([of(0), of(1), of(3)], [vec![], vec![1], vec![1, 2, 3]]);
        assert_eq!([of(4), of(5), of(7)], [vec![2, 4], vec![2, 4], vec![2, 4, 6]]);
    }

    #[test]
    fn frames_left_out_count_where_their_neighbours_do_not_show_them() {
        let size = [32, 48];
        let plane = size[0] * size[1];
        // All becomes brighter in even steps. In the third of five frames one block is white.
        let picture = |k: usize| -> Vec<f32> {
            let white = |i: usize| k == 3 && i % plane / size[1] >= 16 && (16..32).contains(&(i % size[1]));
            (0..3 * plane).map(|i| if white(i) { 1.0 } else { 0.1 * k as f32 }).collect()
        };
        let seen = |k: usize| Seen { t: k as f32 / 6.0, rgb: Arc::new(picture(k)), flow: None };
        let between: Vec<Seen> = (1..6).map(seen).collect();
        let (first, last) = (picture(0), picture(6));
        let blocks = Blocks::of(size).expect("whole cells");
        let found = left_out(blocks, [&first, &last], &between, |_| true);
        assert_eq!(found.iter().map(|partial| partial.t).collect::<Vec<_>>(), [0.5]);
        assert_eq!(found[0].differs, [false, false, false, false, true, false]);
        assert!(found[0].counts_in(&[16..20, 28..32]) && !found[0].counts_in(&[12..16, 28..32]));
        // Kept blocks are not looked at.
        assert!(left_out(blocks, [&first, &last], &between, |at| at != 4).is_empty());
        // Short intervals use all frames.
        assert!(left_out(blocks, [&first, &last], &between[1..4], |_| true).is_empty());
        // Two frames at one time have their middle for a mean.
        let same = |k: usize| Seen { t: 0.0, ..seen(k) };
        let found = left_out(blocks, [&first, &last], &(1..6).map(same).collect::<Vec<_>>(), |_| true);
        assert!(found.iter().any(|partial| partial.differs[4]), "{}", found.len());
    }
}
