//! Whether the camera moves over an interval, and which blocks change.

use streamsplat_kernels::parallel::map_indexed;

use super::blocks::{Blocks, Difference};
use super::{Change, Kept, Past};

/// The share of blocks and frames whose changes are taken for noise.
const QUIET: f64 = 0.4;
/// Highest standard deviation taken for noise where it is white.
pub(super) const MOST_NOISE: f64 = 8.0 / 255.0;
/// Highest standard deviation taken for noise where it is not.
pub(super) const MOST_CHANGE: f64 = 0.5 / 255.0;
/// The ratio of the deviation of means over cells to that of pixels, below which noise is white.
pub(super) const WHITE: f64 = 0.35;
/// The greatest difference that counts as noise, in standard deviations of it.
const MARGIN: f64 = 1.35;
/// The greatest difference of means over cells that is close enough, over that of pixels.
const CLOSE_CELLS: f64 = 0.8;
/// The greatest mean of a difference that is close enough, per channel.
pub(super) const CLOSE_MEAN: f64 = 1.0 / 255.0;
/// Rounding of 8-bit frames.
const ROUNDING: f64 = 0.4 / 255.0;
/// Largest drift of a block in one interval.
const DRIFT: f64 = 16.0 / 255.0;
/// The greatest rms(d − μ) of a block that a static camera sees: codecs and steps of exposure change blocks by so much.
pub(super) const STEADY: f64 = 6.0 / 255.0;
/// The least share of such blocks among those with a texture where the camera is static. Flat blocks look static even
/// when the camera moves. (Over the intervals of 14 clips the share is 0.46 to 1 where the camera is static, and 0 to
/// 0.15 where it moves.)
pub(super) const STATIC: f64 = 0.3;
/// The least share of kept blocks among those with a texture; below it none is kept.
pub(super) const LEAST: f64 = 0.2;
/// Standard deviation of means over cells above which a block has a texture.
const TEXTURE: f64 = 4.0 / 255.0;

/// The camera over an interval.
#[derive(Debug)]
pub(in crate::stream) enum Camera {
    /// It moves, or too much of the picture does.
    Moving,
    /// It is static; what is kept, if that is enough.
    Static(Option<Kept>),
}

impl Camera {
    /// The camera from a key frame with this mean and past to the last of `frames`.
    ///
    /// `frames`: times in the interval and pictures `[3, H, W]`; the last of them is the key frame at its end. `close`:
    /// the greatest difference without its mean that is close enough where noise is that of a codec.
    pub(in crate::stream) fn over(
        blocks: Blocks,
        mean: &[f32],
        past: Option<&Past>,
        frames: &[(f32, &[f32])],
        close: f64,
    ) -> Self {
        let none;
        let past = match past {
            Some(past) => past,
            None => {
                none = Past::none(blocks, mean);
                &none
            }
        };
        let differences: Vec<Vec<Difference>> =
            map_indexed(blocks.count(), |at| frames.iter().map(|(_, rgb)| blocks.difference(at, rgb, mean)).collect());
        let changes = changes(past, frames, &differences, close);
        // Flat blocks look the same wherever the camera is.
        let textured: Vec<bool> = map_indexed(blocks.count(), |at| blocks.deviation(at, mean) > TEXTURE);
        let flat = !textured.contains(&true);
        let counted: Vec<usize> = (0..blocks.count()).filter(|at| flat || textured[*at]).collect();
        let share = |wanted: &dyn Fn(usize) -> bool| {
            counted.iter().filter(|at| wanted(**at)).count() as f64 / counted.len() as f64
        };
        let kept = share(&|at| changes[at] != Change::All);
        if kept >= LEAST {
            return Self::Static(Some(Kept::new(blocks, mean, past, frames, changes, &differences)));
        }
        let steady = |d: &Difference| d.square - d.offset() <= STEADY * STEADY;
        match share(&|at| differences[at].iter().all(steady)) < STATIC {
            true => Self::Moving,
            false => Self::Static(None),
        }
    }
}

/// What happens to each block; blocks that rest are [`Change::None`], those that drift [`Change::Colours`].
fn changes(past: &Past, frames: &[(f32, &[f32])], differences: &[Vec<Difference>], close: f64) -> Vec<Change> {
    let wider = |at: usize| 1.0 + 1.0 / f64::from(past.count[at]);
    let mut levels: Vec<[f64; 2]> = differences
        .iter()
        .enumerate()
        .flat_map(|(at, all)| all.iter().map(move |d| [d.square, d.cells].map(|square| square / wider(at))))
        .collect();
    let quiet = (levels.len() as f64 * QUIET) as usize;
    // Ties by the second value, so that the order is unique.
    let ascending = |a: &[f64; 2], b: &[f64; 2]| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1]));
    levels.sort_unstable_by(ascending);
    let [square, cells] = levels[..=quiet].iter().fold([0.0; 2], |sum, level| [sum[0] + level[0], sum[1] + level[1]]);
    let white = cells <= WHITE * WHITE * square;
    let most = if white { MOST_NOISE } else { MOST_CHANGE };
    let noise = levels[quiet][0].sqrt().min(most);
    let codec = !white || noise < ROUNDING;
    let of_block = |(at, all): (usize, &Vec<Difference>)| {
        let rms = MARGIN * noise * wider(at).sqrt() + ROUNDING;
        let structure = 0.5 * rms;
        let (rms2, structure2) = (rms * rms, structure * structure);
        let noise = |d: &Difference, offset: f64| d.square - offset <= rms2 && d.cells - offset <= structure2;
        let (close2, cells2) = (close * close, (CLOSE_CELLS * close) * (CLOSE_CELLS * close));
        let close = |d: &Difference| {
            let [square, cells] = [d.square, d.cells].map(|square| square - d.offset());
            codec && square <= close2 && cells <= cells2
        };
        let most = if codec { structure.max(CLOSE_MEAN) } else { structure };
        let level = |d: &Difference| d.mean.iter().all(|mean| mean.abs() <= most);
        let rests = |d: &Difference| noise(d, 0.0) || (close(d) && level(d));
        if all.iter().all(rests) {
            return Change::None;
        }
        let last = all.last().map_or([0.0; 3], |d| d.mean);
        let drifts = |(d, (t, _)): (&Difference, &(f32, &[f32]))| {
            let along = (0..3).all(|c| (d.mean[c] - f64::from(*t) * last[c]).abs() <= most);
            (noise(d, d.offset()) || close(d)) && along
        };
        let near = last.iter().all(|mean| mean.abs() <= DRIFT);
        if near && all.iter().zip(frames).all(drifts) { Change::Colours } else { Change::All }
    };
    differences.iter().enumerate().map(of_block).collect()
}
