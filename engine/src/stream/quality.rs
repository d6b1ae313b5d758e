//! Presets that trade error for time.

use super::{Decibels, Fade, FlowEffort, MotionFrom, Resolution, Reuse, Settings, StaticRegions};
use crate::choice::named;
use crate::gap::{Auto, Gap};
use streamsplat_model::Precision;

named! {
    /// A trade of error for time: a preset of other settings ([`Quality::preset`]). It never depends on a clock or a
    /// CPU, so that results stay a function of model, input and settings.
    Quality: "quality" {
        /// The least time per frame at which motion and colours still follow the frames.
        Realtime = "realtime",
        /// The defaults of the model inside the library.
        #[default]
        Balanced = "balanced",
        /// The least error.
        Best = "best",
    }
}

/// Settings of a [`Quality`].
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Preset {
    /// Which frames are key frames.
    pub gap: Gap,
    /// [`Settings::resolution`]
    pub resolution: Resolution,
    /// [`Settings::motion`]
    pub motion: MotionFrom,
    /// [`Settings::flow`]
    pub flow: FlowEffort,
    /// [`Settings::fade`]
    pub fade: Fade,
    /// [`Settings::find_depth`]
    pub find_depth: bool,
    /// [`Settings::refine`]
    pub refine: u32,
    /// [`Settings::refine_every`]
    pub refine_every: u32,
    /// [`Settings::refine_to`]
    pub refine_to: Decibels,
    /// [`Settings::detail`]
    pub detail: u32,
    /// [`Settings::precision`]
    pub precision: Precision,
    /// [`Settings::reuse`]
    pub reuse: Reuse,
    /// [`Settings::still`]
    pub still: StaticRegions,
}

impl Quality {
    /// Returns its settings. `docs/choosing.md` has them in a table.
    pub fn preset(self) -> Preset {
        let balanced = Preset {
            gap: Gap::Auto(Auto { least: 3, most: 8, decibels: 38.0 }),
            resolution: Resolution::Auto,
            motion: MotionFrom::Between,
            flow: FlowEffort::Fine,
            fade: Fade::Fixed,
            find_depth: true,
            refine: Settings::REFINE,
            refine_every: 1,
            refine_to: Settings::REFINE_TO,
            detail: Settings::DETAIL,
            precision: Precision::Int8,
            reuse: Reuse::Exact,
            still: StaticRegions::Keep,
        };
        match self {
            Quality::Realtime => Preset {
                gap: Gap::Every(6),
                flow: FlowEffort::Coarse,
                find_depth: false,
                refine: 3,
                refine_every: 3,
                detail: 0,
                still: StaticRegions::Loose,
                ..balanced
            },
            Quality::Balanced => balanced,
            Quality::Best => Preset {
                gap: Gap::Every(2),
                refine: 64,
                refine_to: Decibels::MOST,
                detail: 250,
                precision: Precision::F32,
                still: StaticRegions::Off,
                ..balanced
            },
        }
    }
}

impl Settings {
    /// The settings of a [`Quality`] for the model inside the library. They do not include the choice of key frames,
    /// which is [`Preset::gap`].
    pub fn of_quality(quality: Quality) -> Self {
        let Preset {
            gap: _,
            resolution,
            motion,
            flow,
            fade,
            find_depth,
            refine,
            refine_every,
            refine_to,
            detail,
            precision,
            reuse,
            still,
        } = quality.preset();
        Self {
            resolution: Some(resolution),
            motion: Some(motion),
            flow,
            fade: Some(fade),
            find_depth: Some(find_depth),
            refine: Some(refine),
            refine_every: Some(refine_every),
            refine_to: Some(refine_to),
            detail: Some(detail),
            precision: Some(precision),
            reuse,
            still: Some(still),
            ..Self::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn balanced_is_what_the_defaults_are() {
        let (balanced, default) = (Settings::of_quality(Quality::default()), Settings::default());
        assert_eq!(balanced.resolution(), default.resolution());
        assert_eq!(balanced.motion(), default.motion());
        assert_eq!(balanced.flow, default.flow);
        assert_eq!(balanced.fade(), default.fade());
        assert_eq!(balanced.find_depth(), default.find_depth());
        assert_eq!(balanced.refine(), default.refine());
        assert_eq!(balanced.refine_every(), default.refine_every());
        assert_eq!(balanced.close(), default.close());
        assert_eq!(balanced.detail(), default.detail());
        assert_eq!(balanced.precision(), default.precision());
        assert_eq!(balanced.reuse, default.reuse);
        assert_eq!(balanced.still(), default.still());
    }
}
