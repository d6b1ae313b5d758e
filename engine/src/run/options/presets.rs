//! The table of presets: values of unset options.

use serde_json::{Map, Value};

use super::{DepthScale, DepthSource, ModelOptions, Named, RunOptions, StreamOptions};
use crate::fit::Fit;
use crate::gap::Gap;
use crate::stream::{
    Decibels, Fade, FlowEffort, Fusion, ModelSource, MotionFrom, Preset, Quality, Resolution, Reuse, SamplingMode,
    StaticRegions,
};
use streamsplat_model::Precision;

/// A column of the table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Column {
    /// A quality.
    Of(Quality),
    /// Models from files without a quality: as in the paper.
    OtherModel,
    /// The authors' script for whole clips.
    LikePaper,
}

impl Column {
    /// Its values.
    fn values(self) -> RunOptions {
        let neutral = StreamOptions {
            depth_range: Some(DepthScale::Frame),
            fusion: Some(Fusion::Persistent),
            sampling: Some(SamplingMode::Mean),
            ..StreamOptions::default()
        };
        let model = |precision| ModelOptions { precision: Some(precision), ..ModelOptions::default() };
        let networks = |gap| StreamOptions {
            model: model(Precision::F32),
            depth: Some(DepthSource::None),
            gap: Some(Gap::Every(gap)),
            resolution: Some(Resolution::Native),
            motion: Some(MotionFrom::Network),
            flow: Some(FlowEffort::Fine),
            fade: Some(Fade::Network),
            refine: Some(0),
            refine_every: Some(1),
            refine_to: Some(Decibels::MOST),
            detail: Some(0),
            reuse: Some(Reuse::Exact),
            still: Some(StaticRegions::Off),
            ..neutral.clone()
        };
        let stream = match self {
            Column::Of(quality) => {
                let Preset {
                    gap,
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
                StreamOptions {
                    model: model(precision),
                    quality: Some(quality),
                    depth: Some(if find_depth { DepthSource::Auto } else { DepthSource::None }),
                    gap: Some(gap),
                    resolution: Some(resolution),
                    motion: Some(motion),
                    flow: Some(flow),
                    fade: Some(fade),
                    refine: Some(refine),
                    refine_every: Some(refine_every),
                    refine_to: Some(refine_to),
                    detail: Some(detail),
                    reuse: Some(reuse),
                    still: Some(still),
                    ..neutral
                }
            }
            Column::OtherModel => networks(1),
            Column::LikePaper => {
                StreamOptions { depth_range: Some(DepthScale::Keys), fusion: Some(Fusion::Pairwise), ..networks(3) }
            }
        };
        let fit = if self == Column::LikePaper { Fit::Stretch } else { Fit::Letterbox };
        RunOptions { stream, fit: Some(fit), ..RunOptions::default() }
    }
}

impl StreamOptions {
    /// The column that applies to these options.
    fn column(&self) -> Column {
        match (self.like_paper, self.quality, self.model.source()) {
            (true, ..) => Column::LikePaper,
            (false, Some(quality), _) => Column::Of(quality),
            (false, None, ModelSource::Embedded) => Column::Of(Quality::default()),
            (false, None, _) => Column::OtherModel,
        }
    }

    /// Returns these options with unset ones filled from the preset: that of `--like-paper`, or of the quality
    /// (`balanced` by default for the model inside the library, none for other models).
    #[must_use]
    pub fn resolved(&self) -> StreamOptions {
        let mut stream = self.clone();
        let mut preset = self.column().values().stream;
        // Motion by the network implies its fading and excludes parallax.
        if self.motion == Some(MotionFrom::Network) {
            (preset.fade, preset.depth) = (Some(Fade::Network), Some(DepthSource::None));
        }
        stream.fill(&preset);
        stream
    }

    /// The default fit of frames.
    pub(super) fn fit(&self) -> Option<Fit> {
        self.column().values().fit
    }
}

/// Options that presets set, by their names on the command line, each with its default in words: first that of the
/// model inside the library, then those that differ from it.
pub fn defaults() -> Vec<(String, String)> {
    let texts = |column: Column| -> Map<String, Value> {
        let RunOptions { stream, fit, .. } = column.values();
        let mut all = Map::new();
        if let Ok(Value::Object(stream)) = serde_json::to_value(&stream) {
            let (groups, options): (Vec<_>, Vec<_>) = stream.into_iter().partition(|(_, value)| value.is_object());
            all.extend(groups.into_iter().flat_map(|(_, group)| group.as_object().cloned().unwrap_or_default()));
            all.extend(options);
        }
        all.extend(fit.map(|fit| ("fit".to_owned(), fit.to_string().into())));
        all
    };
    let balanced = texts(Column::Of(Quality::default()));
    let others = [
        ("realtime", texts(Column::Of(Quality::Realtime))),
        ("best", texts(Column::Of(Quality::Best))),
        ("other models", texts(Column::OtherModel)),
        ("like-paper", texts(Column::LikePaper)),
    ];
    let word = |value: &Value| value.as_str().map_or_else(|| value.to_string(), str::to_owned);
    let set = balanced.iter().filter(|(name, value)| *name != "seed" && !value.is_null());
    set.map(|(name, value)| {
        let differing = others.iter().filter(|(_, column)| name != "quality" && column.get(name) != Some(value));
        let differing = differing.filter_map(|(of, column)| Some(format!("; {of}: {}", word(column.get(name)?))));
        let text = word(value) + &differing.collect::<String>();
        (name.replace('_', "-"), if name == "quality" { text + "; other models: none" } else { text })
    })
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quality_fills_what_is_not_given() {
        let given = StreamOptions { quality: Some(Quality::Realtime), refine: Some(7), ..StreamOptions::default() };
        let stream = given.resolved();
        assert_eq!(
            (stream.gap, stream.refine, stream.model.precision),
            (Some(Gap::Every(6)), Some(7), Some(Precision::Int8))
        );
        assert_eq!(stream.depth, Some(DepthSource::None));
        assert_eq!(StreamOptions::default().resolved().quality, Some(Quality::Balanced));
    }

    #[test]
    fn motion_by_the_network_has_its_fading_and_no_parallax() {
        let given = StreamOptions { motion: Some(MotionFrom::Network), ..StreamOptions::default() };
        let stream = given.resolved();
        assert_eq!((stream.fade, stream.depth), (Some(Fade::Network), Some(DepthSource::None)));
        let fixed = StreamOptions { fade: Some(Fade::Fixed), ..given }.resolved();
        assert_eq!(fixed.fade, Some(Fade::Fixed));
    }

    #[test]
    fn defaults_in_words_are_the_table() {
        let defaults = defaults();
        let of = |name: &str| defaults.iter().find(|(option, _)| option == name).map(|(_, text)| text.as_str());
        assert_eq!(of("gap"), Some("auto:3-8:38; realtime: 6; best: 2; other models: 1; like-paper: 3"));
        assert_eq!(of("refine-every"), Some("1; realtime: 3"));
        assert_eq!(of("precision"), Some("int8; best: f32; other models: f32; like-paper: f32"));
        assert_eq!(of("fit"), Some("letterbox; like-paper: stretch"));
        assert_eq!(of("seed"), None);
    }
}
