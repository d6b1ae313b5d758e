//! The Gaussians of an interval at one time.

use std::ops::Range;

use rayon::prelude::*;
use streamsplat_kernels::Level;
use streamsplat_kernels::raster::ALPHA_MIN;
use streamsplat_model::motion;

use super::{DynamicGaussians, Record};
use crate::world::to_scene;

/// Gaussians per task.
const CHUNK: usize = 4096;

/// The Gaussians of an interval that can be seen at one time, in scene space (x right, y down, z forward), unrotated.
/// Units are those of the model's input or [square](Snapshot::square).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Snapshot {
    /// Their indices in the interval, ascending.
    pub index: Vec<u32>,
    /// Centres.
    pub mean: Vec<[f32; 3]>,
    /// Standard deviations along x, y and z.
    pub scale: Vec<[f32; 3]>,
    /// Opacities at the time.
    pub opacity: Vec<f32>,
    /// Colours at the time.
    pub rgb: Vec<[f32; 3]>,
    /// Gaussians left out because one of their numbers was not finite.
    pub dropped: u64,
}

impl Snapshot {
    /// Returns the Gaussians that can be seen at `t` in [0, 1] of their interval.
    ///
    /// Left out: opacities under 1/255 (they cannot be drawn), inverse depths outside [0, 1], and records with a number
    /// that is not finite, which are counted.
    ///
    /// # Panics
    /// When the arrays differ in length ([`DynamicGaussians::uneven`]).
    pub fn new(level: Level, gaussians: &DynamicGaussians, t: f32) -> Self {
        let (all, _) = Self::in_place(level, gaussians, t);
        // Opacities that are not 0 are at least 1/255.
        let kept: Vec<usize> = (0..all.index.len()).filter(|i| all.opacity[*i] > 0.0).collect();
        Self {
            index: kept.iter().map(|i| *i as u32).collect(),
            mean: kept.iter().map(|i| all.mean[*i]).collect(),
            scale: kept.iter().map(|i| all.scale[*i]).collect(),
            opacity: kept.iter().map(|i| all.opacity[*i]).collect(),
            rgb: kept.iter().map(|i| all.rgb[*i]).collect(),
            dropped: all.dropped,
        }
    }

    /// [`Snapshot::new`] with an entry for every record: those that cannot be seen are all zeros. So a record has one
    /// place at all times of its interval, and a rasteriser finds what did not change. Also returns the number of
    /// records that can be seen and are the same at all times.
    ///
    /// # Panics
    /// As [`Snapshot::new`].
    pub(crate) fn in_place(level: Level, gaussians: &DynamicGaussians, t: f32) -> (Self, usize) {
        let count = gaussians.len();
        let mut out = Self {
            index: (0..count as u32).collect(),
            mean: vec![[0.0; 3]; count],
            scale: vec![[0.0; 3]; count],
            opacity: vec![0.0; count],
            rgb: vec![[0.0; 3]; count],
            dropped: 0,
        };
        let shapes = out.mean.par_chunks_mut(CHUNK).zip(out.scale.par_chunks_mut(CHUNK));
        let looks = out.opacity.par_chunks_mut(CHUNK).zip(out.rgb.par_chunks_mut(CHUNK));
        let counts: Vec<[u64; 2]> = shapes
            .zip(looks)
            .enumerate()
            .map(|(chunk, ((mean, scale), (opacity, rgb)))| {
                let (start, mut resting) = (chunk * CHUNK, 0);
                let dropped = each_seen(level, gaussians, t, start..start + mean.len(), |i, at, seen| {
                    let (to, record) = (i - start, drawn(gaussians, i));
                    resting += u64::from(record.rests());
                    (mean[to], opacity[to]) = (at, seen);
                    (scale[to], rgb[to]) = (record.deviations(), record.rgb_at(t));
                });
                [dropped, resting]
            })
            .collect();
        let [dropped, resting] = [0, 1].map(|kind| counts.iter().map(|counts| counts[kind]).sum());
        (Self { dropped, ..out }, resting as usize)
    }
}

/// Calls `visit` with the index, the centre and the opacity of each record of the range that can be seen. Returns the
/// number of records with a number that is not finite.
#[inline(always)]
fn each_seen(
    level: Level,
    gaussians: &DynamicGaussians,
    t: f32,
    range: Range<usize>,
    mut visit: impl FnMut(usize, [f32; 3], f32),
) -> u64 {
    let mut opacity = vec![0.0; range.len()];
    let mut from = range.start;
    for run in gaussians.reference[range.clone()].chunk_by(|a, b| a == b) {
        let part = from..from + run.len();
        let out = &mut opacity[part.start - range.start..part.end - range.start];
        let tau = run[0].tau(t);
        motion::opacity_at(level, &gaussians.opacity[part.clone()], &gaussians.gamma[part.clone()], tau, out);
        from = part.end;
    }
    let (sound, mut dropped) = (all_sound(gaussians, range.clone()), 0);
    for (i, opacity) in range.zip(opacity) {
        let record = drawn(gaussians, i);
        if !sound && !record.is_sound() {
            dropped += 1;
            continue;
        }
        let opacity = opacity * record.handover.factor(t);
        if opacity < ALPHA_MIN {
            continue;
        }
        let Some(mean) = to_scene(record.position_at(t)) else { continue };
        visit(i, mean, opacity);
    }
    dropped
}

/// Record `i` with the fields that are drawn; the others have their defaults.
#[inline]
fn drawn(gaussians: &DynamicGaussians, i: usize) -> Record {
    Record {
        mean: gaussians.mean[i],
        velocity: gaussians.velocity[i],
        gamma: gaussians.gamma[i],
        opacity: gaussians.opacity[i],
        scale: gaussians.scale[i],
        thickness: gaussians.thickness[i],
        rgb: gaussians.rgb[i],
        rgb_rate: gaussians.rgb_rate[i],
        offset: gaussians.offset[i],
        reference: gaussians.reference[i],
        handover: gaussians.handover[i],
        ..Record::default()
    }
}

/// Returns true if all these records are [sound](Record::is_sound) and their numbers are below 2¹²⁶, so that no sum of
/// two of them is infinite. A chunk for which this is false is tested record by record.
fn all_sound(gaussians: &DynamicGaussians, chunk: Range<usize>) -> bool {
    const SIGN: u32 = 1 << 31;
    /// 2¹²⁶
    const LARGE: u32 = 253 << 23;
    // Subtraction sets the sign bit where the magnitude is smaller.
    let small = |numbers: &[f32]| {
        numbers.iter().fold(SIGN, |all, x| all & ((x.to_bits() & !SIGN).wrapping_sub(LARGE))) & SIGN != 0
    };
    // -0 counts as negative here.
    let positive = |numbers: &[f32]| numbers.iter().fold(0, |any, x| any | x.to_bits()) & SIGN == 0;
    let DynamicGaussians {
        mean,
        velocity,
        offset,
        scale,
        thickness,
        opacity,
        gamma,
        rgb,
        rgb_rate,
        identity: _,
        birth: _,
        frame: _,
        reference: _,
        handover: _,
    } = gaussians;
    let signed = [mean, velocity, offset, rgb, rgb_rate];
    let unsigned = [scale[chunk.clone()].as_flattened(), gamma[chunk.clone()].as_flattened()];
    let single = [&thickness[chunk.clone()], &opacity[chunk.clone()]];
    signed.iter().all(|numbers| small(numbers[chunk.clone()].as_flattened()))
        && unsigned.iter().chain(&single).all(|numbers| small(numbers) && positive(numbers))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_that_are_tested_together_are_left_out_as_one_by_one() {
        let good = Record { opacity: 0.5, scale: [0.1; 2], mean: [0.0, 0.5, 0.0], ..Record::default() };
        let bad = [
            Record { mean: [0.0, f32::NAN, 0.0], ..good },
            Record { velocity: [f32::INFINITY, 0.0, 0.0], ..good },
            Record { offset: [0.0, 0.0, f32::NEG_INFINITY], ..good },
            Record { scale: [0.1, -0.1], ..good },
            Record { thickness: f32::NAN, ..good },
            Record { opacity: -0.5, ..good },
            Record { gamma: [-1.0, 0.0], ..good },
            Record { rgb: [f32::MAX; 3], rgb_rate: [f32::MAX; 3], ..good },
            Record { rgb_rate: [0.0, f32::NAN, 0.0], ..good },
            // Sound, with numbers for which chunks are tested one by one.
            Record { rgb: [2e38, 0.5, 0.5], gamma: [-0.0, 0.0], ..good },
        ];
        for odd in [good].iter().chain(&bad) {
            let all: DynamicGaussians = [good, *odd, good].into_iter().collect();
            assert!(all_sound(&all, 0..1));
            assert_eq!(all_sound(&all, 0..3), *odd == good, "{odd:?}");
            let seen = Snapshot::new(Level::scalar(), &all, 0.5);
            assert_eq!(seen.dropped, u64::from(!odd.is_sound()), "{odd:?}");
            assert_eq!(seen.index.len(), 2 + usize::from(odd.is_sound()), "{odd:?}");
        }
    }
}
