//! An interval before a static camera: what it keeps of the key frame before, and which frames in between it uses.

use std::sync::Arc;

use super::between::{Partial, Seen, every_second, left_out};
use super::keep::{Blocks, Camera, Change, Keeps, Kept, Lattice};
use super::keyframe::KeyView;
use super::{Fusion, MotionFrom, SamplingMode, Settings};

/// The kept part of an interval.
pub(super) struct Keeping {
    pub(super) kept: Kept,
    /// What happens to each Gaussian of the key frame before.
    pub(super) keeps: Keeps,
}

/// How an interval is treated while the camera is static; nothing where it moves.
#[derive(Default)]
pub(super) struct Still {
    /// What it keeps from the key frame before, if that is enough.
    pub(super) keeping: Option<Keeping>,
    /// The frames left out of flow that colours are fitted to in parts.
    pub(super) partial: Vec<Partial>,
    /// The frames as they came, where one is changed or left out and depth is searched.
    pub(super) taken: Option<Taken>,
}

/// An interval's frames as they came.
pub(super) struct Taken {
    /// The key frame at its end.
    pub(super) rgb: Vec<f32>,
    pub(super) between: Vec<Seen>,
}

impl Still {
    /// The interval from key frame `before` to `view`. If the camera is static, `seen` is then every second frame of
    /// many, and kept blocks of all frames are replaced by their mean.
    pub(super) fn of(settings: &Settings, before: &KeyView, view: &mut KeyView, seen: &mut Vec<Seen>) -> Self {
        let Some(blocks) = Blocks::of(view.resolution()) else { return Self::default() };
        let Some((Camera::Static(kept), cells)) = camera(settings, blocks, before, view, seen) else {
            return Self::default();
        };
        let keeping = kept.map(|kept| {
            let keeps = kept.of_cells(&cells, &before.added.moving);
            Keeping { kept, keeps }
        });
        let used = every_second(seen);
        let mut partial = match settings.refine_every() {
            1 => {
                let kept = keeping.as_ref().map(|keeping| &keeping.kept);
                let changes = |at: usize| kept.is_none_or(|kept| kept.changes[at] == Change::All);
                left_out(blocks, [&before.rgb, &view.rgb], seen, changes)
            }
            _ => Vec::new(),
        };
        let replaced = keeping.is_some() || used.len() < seen.len();
        let searched = settings.find_depth() && keeping.as_ref().is_none_or(|keeping| !keeping.kept.mostly());
        let between = std::mem::replace(seen, used);
        let taken = (replaced && searched).then(|| Taken { rgb: view.rgb.clone(), between });
        if let Some(Keeping { kept, .. }) = &keeping {
            let partial = partial.iter_mut().map(|Partial { t, rgb, .. }| (*t, rgb));
            for (t, rgb) in seen.iter_mut().map(|Seen { t, rgb, .. }| (*t, rgb)).chain(partial) {
                kept.show(&before.rgb, t, Arc::<Vec<f32>>::make_mut(rgb));
            }
            kept.show(&before.rgb, 1.0, &mut view.rgb);
        }
        Self { keeping, partial, taken }
    }
}

/// The camera over the interval, and the model's own Gaussians; `None` where static regions are not looked for.
fn camera(
    settings: &Settings,
    blocks: Blocks,
    before: &KeyView,
    view: &KeyView,
    seen: &[Seen],
) -> Option<(Camera, Lattice)> {
    let close = settings.still().close()?;
    let wanted = settings.motion() != MotionFrom::Network
        && !settings.deforms()
        && settings.fusion == Fusion::Persistent
        && settings.sampling == SamplingMode::Mean
        && settings.refine() > 0;
    if !wanted || view.has_depth() || before.map.is_some() {
        return None;
    }
    let cells = Lattice::of(before.layers().cells, view.resolution())?;
    let frames: Vec<(f32, &[f32])> =
        seen.iter().map(|seen| (seen.t, &seen.rgb[..])).chain([(1.0, &view.rgb[..])]).collect();
    Some((Camera::over(blocks, &before.rgb, before.past.as_ref(), &frames, close), cells))
}
