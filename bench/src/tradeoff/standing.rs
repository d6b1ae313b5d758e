//! Key frames of a standing camera: time and error of reuse, in every precision.
//!
//! The input is a frame of the clip at the model's size. In every other key frame the colours of a rectangle are
//! inverted, so that share of the patches changes from each key frame to the next. All choices of reuse take the same
//! key frames in turn. The first two are not timed: they fill the caches. Errors are those of the last one.

use anyhow::{Context, Result, ensure};
use serde::Serialize;
use streamsplat::source::TimedPicture;
use streamsplat_bench::timing::{Seconds, Spent, Stopwatch};
use streamsplat_kernels::Level;
use streamsplat_model::reuse::Saving;
use streamsplat_model::{
    Deformation, Dino, DinoSession, FrameInput, LoadOptions, Network, Precision, Sampling, Session, Side,
};
use streamsplat_tests::reference;

use super::stages::{fitted, widen};
use crate::model::{Model, Which};

/// Shares of the patches that change. Errors are those of the first.
const SHARES: [f64; 3] = [0.05, 0.01, 0.2];
/// Side of a patch of the StreamSplat models.
const PATCH: usize = 8;
/// Key frames before those that are timed.
const FIRST: usize = 2;

/// Reuse to measure.
pub(super) struct StandingRun<'a> {
    pub(super) which: Which<'a>,
    pub(super) precisions: &'a [Precision],
    pub(super) level: Level,
    /// Tolerances, in addition to no reuse.
    pub(super) tolerances: &'a [f32],
    pub(super) rounds: usize,
    /// Results of the stages on the last two key frames, as [`pair`] has them.
    pub(super) expected: &'a [Vec<f64>],
}

/// Key frames at a precision and a choice of reuse.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct StandingRow {
    pub(super) precision: &'static str,
    pub(super) reuse: String,
    /// Share of the patches that changed.
    pub(super) changed: f64,
    /// Times of a key frame: DINOv2, encoder, upsamplers, decoder and heads.
    pub(super) wall: Seconds,
    pub(super) processor: Option<Seconds>,
    /// The median time (of the processor, where known) relative to that without reuse.
    pub(super) cost: f64,
    /// Relative L2 error of embedding, static tokens, deformation tokens, and positions with velocities; only at the
    /// first share.
    pub(super) errors: Option<[f64; 4]>,
}

/// The last key frame and its results.
struct Way<'a> {
    session: Session<&'a Network>,
    dino: Option<DinoSession<&'a Dino>>,
    last: Option<KeyFrame>,
}

struct KeyFrame {
    h: Vec<f32>,
    static_tokens: Vec<f32>,
    condition: Option<Vec<f32>>,
    positions: Vec<f32>,
    motion: Option<[Deformation; 2]>,
}

impl Way<'_> {
    fn new(model: &Model, saving: Option<Saving>) -> Way<'_> {
        Way {
            session: Session::new(&model.network, saving),
            dino: model.dino.as_ref().map(|dino| DinoSession::new(dino, saving)),
            last: None,
        }
    }

    /// Does all work of one more key frame.
    fn push(&mut self, rgb: &[f32]) -> Result<()> {
        let resolution = self.session.network().config().resolution;
        let features = self.dino.as_mut().map(|dino| dino.features(rgb, resolution)).transpose()?;
        let embedding = self.session.embed(&FrameInput { rgb, depth: None })?;
        let still = self.session.static_gaussians(&embedding, &Sampling::Mean)?;
        let mut new = KeyFrame {
            h: embedding.h,
            static_tokens: still.tokens,
            condition: features.map(|features| features.patch_tokens),
            positions: still.gaussians.position.into_flattened(),
            motion: None,
        };
        if let Some(last) = &self.last {
            new.motion = Some(self.session.deform(last.side(), new.side())?);
        }
        self.last = Some(new);
        Ok(())
    }
}

impl KeyFrame {
    fn side(&self) -> Side<'_> {
        Side { h: &self.h, static_tokens: &self.static_tokens, condition: self.condition.as_deref() }
    }

    /// Results of the stages.
    fn results(&self) -> Result<[Vec<f32>; 4]> {
        let [a, b] = self.motion.as_ref().context("a key frame without one before it")?;
        let mut heads = self.positions.clone();
        heads.extend([a, b].iter().flat_map(|side| side.velocity.iter().flatten()));
        Ok([self.h.clone(), self.static_tokens.clone(), [a.d.as_slice(), &b.d].concat(), heads])
    }
}

/// The last two key frames at the first share, of the model's size: an even one, then an odd one.
pub(super) fn pair(clip: &[TimedPicture], size: [usize; 2], level: Level) -> Result<[Vec<f32>; 2]> {
    let [base, _] = fitted(clip, size, level)?;
    Ok([0, 1].map(|index| frame(&base, size, PATCH, SHARES[0], index)))
}

/// Key frame `index` of a stream in which `share` of the patches of `base` change from each to the next.
fn frame(base: &[f32], [height, width]: [usize; 2], patch: usize, share: f64, index: usize) -> Vec<f32> {
    let mut rgb = base.to_vec();
    if index % 2 == 1 {
        let [rows, columns] = rectangle([height / patch, width / patch], share);
        let [top, left] = [(height / patch - rows) / 2, (width / patch - columns) / 2];
        for plane in rgb.chunks_exact_mut(height * width) {
            for row in plane.chunks_exact_mut(width).skip(top * patch).take(rows * patch) {
                row[left * patch..][..columns * patch].iter_mut().for_each(|x| *x = 1.0 - *x);
            }
        }
    }
    rgb
}

/// Rows and columns of the smallest rectangle of the grid's shape, or a little wider, that covers at least `share` of
/// the grid.
fn rectangle([rows, columns]: [usize; 2], share: f64) -> [usize; 2] {
    let of_rows = ((share.sqrt() * rows as f64).round() as usize).clamp(1, rows);
    let wanted = share * (rows * columns) as f64 / of_rows as f64;
    [of_rows, (wanted.ceil() as usize).clamp(1, columns)]
}

pub(super) fn measure(run: &StandingRun<'_>, clip: &[TimedPicture]) -> Result<Vec<StandingRow>> {
    let mut rows = Vec::new();
    // An odd one.
    let last = (FIRST + run.rounds.max(1) - 1) | 1;
    for &precision in run.precisions {
        eprintln!("standing camera, {}", precision.name());
        let load = LoadOptions { level: run.level, precision, ..LoadOptions::default() };
        let model = Model::load(run.which, &load, &|size| pair(clip, size, run.level))?;
        let config = model.network.config();
        ensure!(config.patch_size == PATCH, "patches of {}, expected {PATCH}", config.patch_size);
        let frame = |share, index| frame(&model.rgb[0], config.resolution, PATCH, share, index);
        let mut full = f64::NAN;
        for (at, share) in SHARES.into_iter().enumerate() {
            let changed = rectangle(config.grid(), share).iter().product::<usize>() as f64 / config.tokens() as f64;
            // The full work is the same at any share.
            let off = (at == 0).then_some(None);
            let mut ways: Vec<_> = off
                .into_iter()
                .chain(run.tolerances.iter().map(|tau| Some(*tau)))
                .map(|tau| (tau, Way::new(&model, tau.map(Saving::Within)), Vec::new()))
                .collect();
            for index in 0..=last {
                let rgb = frame(share, index);
                for (_, way, spent) in &mut ways {
                    let watch = Stopwatch::start();
                    way.push(&rgb)?;
                    if index >= FIRST {
                        spent.push(watch.stop());
                    }
                }
            }
            for (tau, way, spent) in ways {
                let times = Seconds::of(spent.iter().map(Spent::seconds).collect());
                if tau.is_none() {
                    full = times.median;
                }
                let processor: Option<Vec<f64>> = spent.iter().map(Spent::processor).collect();
                rows.push(StandingRow {
                    precision: precision.name(),
                    reuse: tau.map_or_else(|| "off".to_owned(), |tau| tau.to_string()),
                    changed,
                    wall: Seconds::of(spent.iter().map(Spent::clock).collect()),
                    processor: processor.map(Seconds::of),
                    cost: times.median / full,
                    errors: (at == 0).then(|| errors(&way, run.expected)).transpose()?,
                });
            }
        }
    }
    Ok(rows)
}

fn errors(way: &Way<'_>, expected: &[Vec<f64>]) -> Result<[f64; 4]> {
    let found = way.last.as_ref().context("no key frame")?.results()?;
    let mut errors = [0.0; 4];
    for ((error, found), expected) in errors.iter_mut().zip(&found).zip(expected) {
        *error = reference::relative_l2(widen(found), expected.iter().copied());
    }
    Ok(errors)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rectangle_is_the_requested_share_of_the_patches() {
        assert_eq!(rectangle([36, 64], 0.05), [8, 15]);
        for share in SHARES {
            let [rows, columns] = rectangle([36, 64], share);
            let found = (rows * columns) as f64 / (36.0 * 64.0);
            assert!(found >= share && found < share + 0.005, "{share}: {found}");
        }
        let base = vec![0.25; 3 * 32 * 64];
        let [even, odd] = [0, 1].map(|index| frame(&base, [32, 64], 8, 0.1, index));
        assert!(
            even == base
                && odd.iter().filter(|x| **x == 0.75).count()
                    == 3 * 64 * rectangle([4, 8], 0.1).iter().product::<usize>()
        );
    }
}
