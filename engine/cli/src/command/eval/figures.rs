//! Measurements: sums over frames, their means, and their output.

use std::collections::BTreeMap;

use serde::Serialize;
use streamsplat::gap::Gap;
use streamsplat::lpips::Lpips;
use streamsplat::metrics::{psnr, ssim};
use streamsplat::picture::Picture;
use streamsplat::stream::Fusion;

use crate::console::failure::Failure;

/// Means over frames, and the number of frames.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub(super) struct Score {
    /// At the source's own size, of 8-bit samples, in dB; only for the scene's images.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) psnr_source_size: Option<f64>,
    /// At 256×256, like `ssim` and `lpips`.
    pub(super) psnr: Option<f64>,
    pub(super) ssim: Option<f64>,
    /// With `--lpips-model`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) lpips: Option<f64>,
    pub(super) frames: usize,
}

#[derive(Clone, Debug, Default)]
pub(super) struct Sum {
    pub(super) psnr_source_size: Option<f64>,
    pub(super) psnr: f64,
    pub(super) ssim: f64,
    pub(super) lpips: Option<f64>,
    pub(super) frames: usize,
}

impl Sum {
    pub(super) fn add(&mut self, a: &Picture, b: &Picture, lpips: Option<&mut Lpips>) -> Result<(), Failure> {
        self.psnr += psnr(a, b)?;
        self.ssim += ssim(a, b)?;
        if let Some(lpips) = lpips {
            *self.lpips.get_or_insert(0.0) += lpips.distance(a, b)?;
        }
        self.frames += 1;
        Ok(())
    }

    /// Adds a frame's PSNR at the source's own size.
    pub(super) fn add_source_size(&mut self, psnr: Option<f64>) {
        if let Some(psnr) = psnr {
            *self.psnr_source_size.get_or_insert(0.0) += psnr;
        }
    }

    pub(super) fn join(&mut self, other: &Sum) {
        self.add_source_size(other.psnr_source_size);
        self.psnr += other.psnr;
        self.ssim += other.ssim;
        if let Some(lpips) = other.lpips {
            *self.lpips.get_or_insert(0.0) += lpips;
        }
        self.frames += other.frames;
    }

    pub(super) fn score(&self) -> Score {
        let mean = |sum: f64| (self.frames > 0).then(|| sum / self.frames as f64);
        Score {
            psnr_source_size: self.psnr_source_size.and_then(mean),
            psnr: mean(self.psnr),
            ssim: mean(self.ssim),
            lpips: self.lpips.and_then(mean),
            frames: self.frames,
        }
    }
}

/// Mean absolute colour differences between images.
#[derive(Clone, Debug, Default)]
pub(super) struct Pops {
    /// At key frames, between the images from the interval before and from the one after.
    pub(super) jump: f64,
    pub(super) jumps: usize,
    /// From one frame to the next inside an interval.
    pub(super) step: f64,
    pub(super) steps: usize,
}

impl Pops {
    pub(super) fn join(&mut self, other: &Pops) {
        self.jump += other.jump;
        self.jumps += other.jumps;
        self.step += other.step;
        self.steps += other.steps;
    }

    pub(super) fn pop(&self) -> Pop {
        let mean = |sum: f64, count: usize| (count > 0).then(|| sum / count as f64);
        let (jump, step) = (mean(self.jump, self.jumps), mean(self.step, self.steps));
        let ratio = jump.zip(step).filter(|(_, step)| *step > 0.0).map(|(jump, step)| jump / step);
        Pop { jump, step, ratio }
    }
}

/// Change of the image at a key frame, compared with the change from frame to frame.
#[derive(Clone, Copy, Debug, Serialize)]
pub(super) struct Pop {
    /// Mean absolute difference between a key frame's images from the intervals before and after.
    pub(super) jump: Option<f64>,
    /// Mean absolute difference between neighbouring frames inside an interval.
    pub(super) step: Option<f64>,
    /// jump / step; 0 where nothing pops.
    pub(super) ratio: Option<f64>,
}

#[derive(Clone, Debug, Default)]
pub(super) struct Sums {
    pub(super) key: Sum,
    pub(super) middle: Sum,
    pub(super) pops: Pops,
    pub(super) crossfade: Sum,
    pub(super) nearest: Sum,
    pub(super) flow: Sum,
    pub(super) intervals: Vec<IntervalFigures>,
    /// Time in the engine.
    pub(super) seconds: f64,
    pub(super) clips: usize,
}

/// Measured PSNR of an interval's images at the source's own size, and the PSNR at which its frames are predicted from
/// its key frames.
#[derive(Clone, Debug, Serialize)]
pub(super) struct IntervalFigures {
    /// Number of frames after its first key frame.
    pub(super) frames: usize,
    /// PSNR of its last frame, the key frame, in dB.
    pub(super) key: f64,
    /// Mean PSNR of the frames in between, in dB.
    pub(super) between: Option<f64>,
    /// Mean PSNR, in dB, of predicting the frames in between from the key frames ([`streamsplat::gap::predicted`]).
    pub(super) predicted: Option<f64>,
    /// The lowest of these.
    pub(super) worst: Option<f64>,
}

/// Scores of one fusion mode.
#[derive(Serialize)]
pub(super) struct Mode {
    pub(super) key: Score,
    pub(super) middle: Score,
    pub(super) pop: Pop,
}

#[derive(Serialize)]
pub(super) struct Baselines {
    pub(super) crossfade: Score,
    pub(super) nearest: Score,
    /// The key frames blended along the optical flow between them.
    pub(super) flow: Score,
}

/// Input frames from one key frame to the next.
#[derive(Clone, Copy, Serialize)]
#[serde(untagged)]
pub(super) enum Spacing {
    Every(usize),
    /// Mean gap, if gaps were chosen.
    Mean(f64),
}

/// The figures of one clip, or of the mean.
#[derive(Serialize)]
pub(super) struct ClipFigures {
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) name: Option<String>,
    pub(super) gap: Spacing,
    pub(super) key: Score,
    pub(super) middle: Score,
    /// Time in the engine per input frame, without drawing and comparison.
    pub(super) seconds_per_frame: f64,
    pub(super) baselines: Baselines,
    /// Figures of each interval; only for clips.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) intervals: Vec<IntervalFigures>,
    /// The same scores under the fusion mode's name, with the change of the image at key frames.
    pub(super) fusion: BTreeMap<&'static str, Mode>,
    /// Means over the clips whose cross-fade is under [`MOVING`] dB; only in the mean.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) moving: Option<Group>,
    /// Means over the other clips.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) still: Option<Group>,
}

/// Means over some clips, each with the same weight.
#[derive(Debug, Serialize)]
pub(super) struct Group {
    pub(super) clips: usize,
    pub(super) middle: GroupScore,
    /// Decibels by which middle frames are better than the cross-fade.
    pub(super) over_crossfade: Option<f64>,
    /// The lowest of these.
    pub(super) worst_over_crossfade: Option<f64>,
}

#[derive(Debug, Serialize)]
pub(super) struct GroupScore {
    pub(super) psnr: Option<f64>,
}

/// PSNR of the cross-fade, in dB, from which a clip belongs to the group `still`: its neighbouring frames are alike.
/// Clips from hand-held cameras may be in this group.
pub(super) const MOVING: f64 = 26.0;

impl Group {
    /// Computes the group of the moving or of the still `clips`.
    pub(super) fn of(clips: &[ClipFigures], moving: bool) -> Group {
        let figures = clips.iter().filter_map(|row| row.middle.psnr.zip(row.baselines.crossfade.psnr));
        let figures: Vec<_> = figures.filter(|(_, fade)| (*fade < MOVING) == moving).collect();
        let mean = |sum: f64| (!figures.is_empty()).then(|| sum / figures.len() as f64);
        let over = figures.iter().map(|(ours, fade)| ours - fade);
        Group {
            clips: figures.len(),
            middle: GroupScore { psnr: mean(figures.iter().map(|(ours, _)| ours).sum()) },
            over_crossfade: mean(over.clone().sum()),
            worst_over_crossfade: over.min_by(f64::total_cmp),
        }
    }
}

impl Sums {
    /// Returns the gap, or the mean of the chosen gaps.
    pub(super) fn spacing(&self, gap: Gap) -> Spacing {
        match gap {
            Gap::Every(n) => Spacing::Every(n),
            Gap::Auto(_) => {
                let (keys, middles) = (self.key.frames, self.middle.frames);
                // The first key frame of a clip ends no gap.
                let ended = keys.saturating_sub(self.clips);
                Spacing::Mean((ended + middles) as f64 / ended.max(1) as f64)
            }
        }
    }

    pub(super) fn row(&self, name: Option<String>, gap: Gap, chosen: Fusion) -> ClipFigures {
        let baselines =
            Baselines { crossfade: self.crossfade.score(), nearest: self.nearest.score(), flow: self.flow.score() };
        let (key, middle) = (self.key.score(), self.middle.score());
        let fusion = BTreeMap::from([(chosen.name(), Mode { key, middle, pop: self.pops.pop() })]);
        let seconds_per_frame = self.seconds / (self.key.frames + self.middle.frames).max(1) as f64;
        let gap = self.spacing(gap);
        let intervals = self.intervals.clone();
        ClipFigures {
            name,
            gap,
            key,
            middle,
            seconds_per_frame,
            baselines,
            intervals,
            fusion,
            moving: None,
            still: None,
        }
    }

    pub(super) fn join(&mut self, other: &Sums) {
        self.clips += other.clips;
        self.key.join(&other.key);
        self.middle.join(&other.middle);
        self.crossfade.join(&other.crossfade);
        self.nearest.join(&other.nearest);
        self.flow.join(&other.flow);
        self.seconds += other.seconds;
        self.pops.join(&other.pops);
    }
}

/// Names of [`line`]'s columns; LPIPS follows SSIM where it is measured.
pub(super) const HEADING: &str = "                             own size (dB):   at 256×256 (dB / SSIM):\n\
    clip                             key   middle       key / SSIM      middle / SSIM   cross-fade / SSIM  nearest / SSIM     flow / SSIM";

pub(super) fn line(row: &ClipFigures) -> String {
    let show = |score: &Score| match (score.psnr, score.ssim) {
        (Some(psnr), Some(ssim)) => {
            let lpips = score.lpips.map(|lpips| format!(" / {lpips:.4}")).unwrap_or_default();
            format!("{psnr:7.3} / {ssim:.4}{lpips}")
        }
        _ => "      – /      –".to_owned(),
    };
    let own = |score: &Score| score.psnr_source_size.map_or("      –".to_owned(), |psnr| format!("{psnr:7.3}"));
    format!(
        "{:28} {}  {}   {}   {}   {}   {}   {}",
        row.name.as_deref().unwrap_or("mean over frames"),
        own(&row.key),
        own(&row.middle),
        show(&row.key),
        show(&row.middle),
        show(&row.baselines.crossfade),
        show(&row.baselines.nearest),
        show(&row.baselines.flow)
    )
}
