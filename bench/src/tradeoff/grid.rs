//! Configurations on a clip.

use std::collections::BTreeMap;

use anyhow::{Context, Result, ensure};
use serde::Serialize;
use streamsplat::Settings;
use streamsplat::gap::Gap;
use streamsplat::metrics::PSNR_CAP;
use streamsplat::picture::Picture;
use streamsplat::source::TimedPicture;
use streamsplat::stream::Reuse;
use streamsplat_bench::passage::{Models, Variant, against, gap_name, mean_square_error, truths};
use streamsplat_bench::timing::{Seconds, Spent};
use streamsplat_model::Precision;

use super::Clock;
use super::front::front;

/// Frames of the check before anything is timed.
const CHECKED: usize = 3;

/// Values to combine.
pub(super) struct Choices<'a> {
    pub(super) precisions: &'a [Precision],
    pub(super) reuse: &'a [Reuse],
    pub(super) gaps: &'a [Gap],
}

/// A configuration on the clip.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct GridPoint {
    pub(super) precision: &'static str,
    pub(super) reuse: String,
    pub(super) gap: String,
    /// Width × height of the model's input.
    pub(super) resolution: String,
    pub(super) keys: usize,
    /// Median of everything but reading and writing, per input frame, by the requested clock.
    pub(super) seconds_per_frame: f64,
    /// Times of the rounds, by either clock.
    pub(super) wall: Seconds,
    pub(super) processor: Option<Seconds>,
    /// Error of all images against those of f32 without reuse at the same gap: ‖a − b‖ / ‖b‖.
    pub(super) relative_l2: f64,
    /// Largest difference of a sample from those images.
    pub(super) worst: f64,
    /// PSNR against those images; 100 where equal.
    pub(super) psnr_vs_f32: f64,
    /// Mean over all frames, against the true ones at 256×256.
    pub(super) psnr_vs_truth: f64,
    /// True if no configuration is faster and at least as close to the true frames, or as fast and closer.
    pub(super) pareto: bool,
}

impl Choices<'_> {
    fn variants(&self) -> Vec<Variant> {
        let mut variants = Vec::new();
        for &precision in self.precisions {
            for &reuse in self.reuse {
                variants.extend(self.gaps.iter().map(|&gap| Variant { precision, reuse, gap }));
            }
        }
        variants
    }
}

fn bits(images: &[Picture]) -> impl Iterator<Item = u32> + '_ {
    images.iter().flat_map(|image| image.rgb.iter().map(|x| x.to_bits()))
}

/// Checks that f32 computes the same bits on another number of threads, and exact reuse the same as no reuse.
fn check(precisions: &[Precision], clip: &[TimedPicture], settings: &Settings) -> Result<()> {
    let clip = &clip[..clip.len().min(CHECKED)];
    let variant = |precision, reuse| Variant { precision, reuse, gap: Gap::Every(1) };
    let mut other = Models::new(Settings { threads: 3, ..settings.clone() });
    let mut models = Models::new(settings.clone());
    for &precision in precisions {
        let runners = models.pass(clip, &[Reuse::Off, Reuse::Exact].map(|reuse| variant(precision, reuse)))?;
        ensure!(
            bits(&runners[0].images).eq(bits(&runners[1].images)),
            "{}: exact reuse gives other bits than none",
            precision.name()
        );
        if precision == Precision::F32 {
            let again = other.pass(clip, &[variant(precision, Reuse::Off)])?;
            ensure!(
                bits(&runners[0].images).eq(bits(&again[0].images)),
                "f32: another number of threads gives other bits"
            );
        }
    }
    Ok(())
}

/// Result of a configuration.
struct Outcome {
    variant: Variant,
    keys: usize,
    images: Vec<Picture>,
    resolution: [usize; 2],
    spent: Vec<Spent>,
}

/// Takes the clip through every configuration, `rounds` times.
pub(super) fn measure(
    choices: &Choices<'_>,
    clip: &[TimedPicture],
    settings: Settings,
    rounds: usize,
    clock: Clock,
) -> Result<Vec<GridPoint>> {
    check(choices.precisions, clip, &settings)?;
    let variants = choices.variants();
    let mut models = Models::new(settings);
    let mut outcomes: Vec<Outcome> = Vec::new();
    for round in 0..rounds {
        eprintln!("round {} of {rounds}: {} configurations", round + 1, variants.len());
        for (place, runner) in models.pass(clip, &variants)?.into_iter().enumerate() {
            let spent = runner.frame();
            if let Some(outcome) = outcomes.get_mut(place) {
                ensure!(bits(&outcome.images).eq(bits(&runner.images)), "{:?}: other bits again", runner.variant);
                outcome.spent.push(spent);
                continue;
            }
            let resolution = runner.engine.model().resolution();
            let keys = runner.keys.len();
            outcomes.push(Outcome {
                variant: runner.variant,
                keys,
                images: runner.images,
                resolution,
                spent: vec![spent],
            });
        }
    }
    rows(&outcomes, clip, clock)
}

fn rows(outcomes: &[Outcome], clip: &[TimedPicture], clock: Clock) -> Result<Vec<GridPoint>> {
    let truths = truths(clip);
    let mut bases: BTreeMap<String, &Outcome> = BTreeMap::new();
    let mut rows = Vec::new();
    for outcome in outcomes {
        // The first of its gap is f32 without reuse.
        let gap = gap_name(outcome.variant.gap);
        let base = *bases.entry(gap.clone()).or_insert(outcome);
        let error = mean_square_error(&outcome.images, &base.images)?;
        let samples = |outcome: &Outcome| {
            let images: Vec<f32> = outcome.images.iter().flat_map(|image| image.rgb.iter().copied()).collect();
            images
        };
        let (found, expected) = (samples(outcome), samples(base));
        let norm = expected.iter().map(|&x| f64::from(x) * f64::from(x)).sum::<f64>() / expected.len() as f64;
        let worst = found.iter().zip(&expected).map(|(a, b)| f64::from((a - b).abs())).fold(0.0, f64::max);
        let wall = Seconds::of(outcome.spent.iter().map(Spent::clock).collect());
        let processor: Option<Vec<f64>> = outcome.spent.iter().map(Spent::processor).collect();
        let processor = processor.map(Seconds::of);
        let seconds_per_frame = match clock {
            Clock::Wall => wall.median,
            Clock::Processor => processor.context("this system does not tell processor time; use --clock wall")?.median,
        };
        let [height, width] = outcome.resolution;
        let psnr = against(&outcome.images, &truths)?;
        rows.push(GridPoint {
            precision: outcome.variant.precision.name(),
            reuse: outcome.variant.reuse.to_string(),
            gap,
            resolution: format!("{width}x{height}"),
            keys: outcome.keys,
            seconds_per_frame,
            wall,
            processor,
            relative_l2: (error / norm).sqrt(),
            worst,
            psnr_vs_f32: if error > 1e-10 { (-10.0 * error.log10()).min(PSNR_CAP) } else { PSNR_CAP },
            psnr_vs_truth: psnr.iter().sum::<f64>() / psnr.len() as f64,
            pareto: false,
        });
    }
    let points: Vec<(f64, f64)> = rows.iter().map(|row| (row.seconds_per_frame, row.psnr_vs_truth)).collect();
    for (row, pareto) in rows.iter_mut().zip(front(&points)) {
        row.pareto = pareto;
    }
    Ok(rows)
}
