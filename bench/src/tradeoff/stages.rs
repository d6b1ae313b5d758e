//! Each stage's error and time per precision, on a pair of key frames.

use anyhow::{Context, Result, ensure};
use serde::Serialize;
use streamsplat::fit::{Fit, Placement};
use streamsplat::source::TimedPicture;
use streamsplat_bench::timing::{Seconds, Spent, Stopwatch};
use streamsplat_kernels::Level;
use streamsplat_model::{LoadOptions, Precision};
use streamsplat_tests::reference::{self, Inputs, Sizes, Tensors};

use super::Yardstick;
use crate::model::{Model, Which};

/// Distance of the two compared frames, where the clip has that many.
const APART: usize = 4;
/// Values below this fraction of the largest are left out of [`StageError::worst_ulp`]: they are sums of larger terms,
/// whose rounding dominates.
const COUNTED: f64 = 0.01;
/// Stages, in the order of the computation.
const STAGES: [&str; 4] = ["encoder", "upsampler", "decoder", "heads"];

/// Stages to measure.
pub(super) struct StageRun<'a> {
    /// Two frames of the model's size.
    pub(super) frames: &'a (dyn Fn([usize; 2]) -> Result<[Vec<f32>; 2]> + Sync),
    pub(super) which: Which<'a>,
    pub(super) precisions: &'a [Precision],
    pub(super) level: Level,
    pub(super) against: Yardstick,
    pub(super) rounds: usize,
}

/// A stage at a precision. Its input is the result of the previous stages at the same precision, so that errors add up
/// as in a stream.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct StageError {
    pub(super) precision: &'static str,
    pub(super) stage: &'static str,
    /// ‖found − expected‖ / ‖expected‖
    pub(super) relative_l2: f64,
    /// max |found − expected| / max |expected|
    pub(super) worst: f64,
    /// max |found − expected| in units in the last place of f32 at `expected`, over all values of a hundredth of the
    /// largest or more. `None` for lower precisions, whose operands do not have these places, and where f32 is compared
    /// with itself.
    pub(super) worst_ulp: Option<f64>,
    /// Times of a call.
    pub(super) wall: Seconds,
    pub(super) processor: Option<Seconds>,
}

/// Measured stages.
pub(super) struct Stages {
    /// The model's resolution, width × height.
    pub(super) resolution: String,
    pub(super) rows: Vec<StageError>,
    /// Reference results of the stages.
    pub(super) expected: Vec<Vec<f64>>,
}

pub(super) fn measure(task: &StageRun<'_>) -> Result<Stages> {
    let load = |precision| {
        let options = LoadOptions { level: task.level, precision, ..LoadOptions::default() };
        Model::load(task.which, &options, task.frames)
    };
    let mut models = Vec::new();
    for &precision in task.precisions {
        eprintln!("loading {}", precision.name());
        models.push((precision, load(precision)?));
    }
    let first = &models.first().context("no precision")?.1;
    let [height, width] = first.network.config().resolution;
    let expected: Vec<Vec<f64>> = match task.against {
        Yardstick::F32 => STAGES.iter().map(|stage| Ok(widen(&first.stage(stage)?))).collect::<Result<_>>()?,
        Yardstick::F64 => {
            eprintln!("the network in binary64");
            binary64(task.which, first)?
        }
    };
    let mut spent = vec![vec![Vec::new(); STAGES.len()]; models.len()];
    for _ in 0..task.rounds.max(1) {
        for (place, stage) in STAGES.iter().enumerate() {
            for ((_, model), spent) in models.iter().zip(&mut spent) {
                let watch = Stopwatch::start();
                std::hint::black_box(model.stage(stage)?);
                spent[place].push(watch.stop());
            }
        }
    }
    let mut rows = Vec::new();
    for ((precision, model), spent) in models.iter().zip(spent) {
        for ((stage, expected), spent) in STAGES.iter().zip(&expected).zip(spent) {
            let found = model.stage(stage)?;
            let in_ulp = *precision == Precision::F32 && task.against == Yardstick::F64;
            rows.push(row((precision.name(), stage), &found, expected, in_ulp, &spent)?);
        }
    }
    Ok(Stages { resolution: format!("{width}x{height}"), rows, expected })
}

fn row(
    (precision, stage): (&'static str, &'static str),
    found: &[f32],
    expected: &[f64],
    in_ulp: bool,
    spent: &[Spent],
) -> Result<StageError> {
    ensure!(found.len() == expected.len(), "{stage}: {} values, expected {}", found.len(), expected.len());
    ensure!(found.iter().all(|x| x.is_finite()), "{stage}: a result is not finite");
    let found = widen(found);
    let largest = expected.iter().fold(0.0, |largest: f64, x| largest.max(x.abs()));
    let worst = found.iter().zip(expected).fold(0.0, |worst: f64, (a, b)| worst.max((a - b).abs()));
    let counted = found.iter().zip(expected).filter(|(_, b)| b.abs() >= COUNTED * largest);
    let worst_ulp = in_ulp.then(|| counted.fold(0.0, |worst: f64, (a, b)| worst.max(reference::ulps(*a, *b))));
    let processor: Option<Vec<f64>> = spent.iter().map(Spent::processor).collect();
    Ok(StageError {
        precision,
        stage,
        relative_l2: reference::relative_l2(found.iter().copied(), expected.iter().copied()),
        worst: worst / largest,
        worst_ulp,
        wall: Seconds::of(spent.iter().map(Spent::clock).collect()),
        processor: processor.map(Seconds::of),
    })
}

pub(super) fn widen(values: &[f32]) -> Vec<f64> {
    values.iter().map(|&x| f64::from(x)).collect()
}

/// Two frames of the clip at the model's size.
pub(super) fn fitted(clip: &[TimedPicture], size: [usize; 2], level: Level) -> Result<[Vec<f32>; 2]> {
    let fit = |index: usize| -> Result<Vec<f32>> {
        let picture = &clip[index].picture;
        let placement =
            Placement::new(Fit::Stretch, [picture.height, picture.width], size).context("an empty frame")?;
        Ok(placement.fit_in(level, &picture.rgb))
    };
    Ok([fit(0)?, fit(APART.min(clip.len() - 1))?])
}

/// Results of the stages in binary64: those of [`Model::stage`], which are the later frame's, and both frames' from the
/// decoder on. Where the network is conditioned on DINOv2, its features are those of `model`.
fn binary64(which: Which<'_>, model: &Model) -> Result<Vec<Vec<f64>>> {
    let mut tensors = None;
    which.with_checkpoint(|checkpoint| tensors = Some(Tensors::new(checkpoint)))?;
    let config = model.network.config();
    let sizes = Sizes {
        resolution: config.resolution,
        upsampler_window: config.upsampler_window,
        encoder_window: config.encoder_window,
    };
    let condition = match &model.condition {
        [Some(a), Some(b)] => Some(widen(&[a.as_slice(), b].concat())),
        _ => None,
    };
    let depths = vec![0.0; 2 * config.resolution[0] * config.resolution[1]];
    let frames = widen(&model.rgb.concat());
    let inputs = Inputs { frames: &frames, depths: &depths, condition: condition.as_deref() };
    let mut out = reference::forward(&tensors.context("no checkpoint")?, sizes, &inputs);
    let mut take = |name: &str| out.remove(name).with_context(|| format!("the reference gives no {name}"));
    let later = |values: Vec<f64>| values[values.len() / 2..].to_vec();
    let heads = [later(take("static.xyz_static")?), take("dynamic.velocity")?].concat();
    Ok(vec![later(take("h")?), later(take("static_tokens")?), take("d")?, heads])
}
