//! The Gaussians of an interval at one time.

use std::ops::Range;

use streamsplat_kernels::Level;
use streamsplat_kernels::parallel::{for_each_chunk, map_indexed};
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
        let seen = map_indexed(gaussians.len().div_ceil(CHUNK), |chunk| seen(level, gaussians, t, chunk));
        let mut out = Self::with_len(seen.iter().map(|seen| seen.index.len()).sum());
        out.dropped = seen.iter().map(|seen| seen.dropped).sum();
        let mut parts = Vec::with_capacity(seen.len());
        let mut rest = out.as_part();
        for seen in &seen {
            parts.push((seen, rest.split_off(seen.index.len())));
        }
        for_each_chunk(&mut parts, 1, |_, part| {
            for (seen, Part { index, mean, scale, opacity, rgb }) in part {
                index.copy_from_slice(&seen.index);
                mean.copy_from_slice(&seen.mean);
                opacity.copy_from_slice(&seen.opacity);
                for (to, i) in seen.index.iter().enumerate() {
                    let record = drawn(gaussians, *i as usize);
                    scale[to] = record.deviations();
                    rgb[to] = record.rgb_at(t);
                }
            }
        });
        out
    }

    /// [`Snapshot::new`] with an entry for every record: those that cannot be seen are all zeros. So a record has one
    /// place at all times of its interval, and a rasteriser finds what did not change. Also returns the number of
    /// records that can be seen and are the same at all times.
    ///
    /// # Panics
    /// As [`Snapshot::new`].
    pub(crate) fn in_place(level: Level, gaussians: &DynamicGaussians, t: f32) -> (Self, usize) {
        let mut out = Self::with_len(gaussians.len());
        let mut parts = Vec::with_capacity(gaussians.len().div_ceil(CHUNK));
        let mut rest = out.as_part();
        for start in (0..gaussians.len()).step_by(CHUNK) {
            parts.push((start..gaussians.len().min(start + CHUNK), rest.split_off(CHUNK), [0, 0]));
        }
        for_each_chunk(&mut parts, 1, |_, part| {
            for (range, Part { index, mean, scale, opacity, rgb }, [dropped, rest]) in part {
                *dropped = each_seen(level, gaussians, t, range.clone(), |i, at, seen| {
                    let (to, record) = (i - range.start, drawn(gaussians, i));
                    *rest += u64::from(record.rests());
                    (mean[to], opacity[to]) = (at, seen);
                    (scale[to], rgb[to]) = (record.deviations(), record.rgb_at(t));
                });
                index.iter_mut().zip(range.clone()).for_each(|(index, i)| *index = i as u32);
            }
        });
        let [dropped, rest] = [0, 1].map(|kind| parts.iter().map(|(_, _, counts)| counts[kind]).sum());
        (Self { dropped, ..out }, rest as usize)
    }

    /// `len` Gaussians of zeros.
    fn with_len(len: usize) -> Self {
        Self {
            index: vec![0; len],
            mean: vec![[0.0; 3]; len],
            scale: vec![[0.0; 3]; len],
            opacity: vec![0.0; len],
            rgb: vec![[0.0; 3]; len],
            dropped: 0,
        }
    }

    fn as_part(&mut self) -> Part<'_> {
        let Self { index, mean, scale, opacity, rgb, dropped: _ } = self;
        Part { index, mean, scale, opacity, rgb }
    }
}

/// Consecutive Gaussians of a snapshot: members as of [`Snapshot`].
struct Part<'a> {
    index: &'a mut [u32],
    mean: &'a mut [[f32; 3]],
    scale: &'a mut [[f32; 3]],
    opacity: &'a mut [f32],
    rgb: &'a mut [[f32; 3]],
}

impl<'a> Part<'a> {
    /// Removes the first `len` Gaussians, or all if there are fewer, and returns them.
    fn split_off(&mut self, len: usize) -> Part<'a> {
        let len = len.min(self.index.len());
        Part {
            index: self.index.split_off_mut(..len).unwrap_or_default(),
            mean: self.mean.split_off_mut(..len).unwrap_or_default(),
            scale: self.scale.split_off_mut(..len).unwrap_or_default(),
            opacity: self.opacity.split_off_mut(..len).unwrap_or_default(),
            rgb: self.rgb.split_off_mut(..len).unwrap_or_default(),
        }
    }
}

/// The Gaussians of a chunk that can be seen: members as of [`Snapshot`].
struct Seen {
    index: Vec<u32>,
    mean: Vec<[f32; 3]>,
    opacity: Vec<f32>,
    dropped: u64,
}

/// Visible Gaussians of one chunk, in order.
fn seen(level: Level, gaussians: &DynamicGaussians, t: f32, chunk: usize) -> Seen {
    let start = chunk * CHUNK;
    let range = start..gaussians.len().min(start + CHUNK);
    let (index, mean) = (Vec::with_capacity(range.len()), Vec::with_capacity(range.len()));
    let mut seen = Seen { index, mean, opacity: Vec::with_capacity(range.len()), dropped: 0 };
    seen.dropped = each_seen(level, gaussians, t, range, |i, mean, opacity| {
        seen.index.push(i as u32);
        seen.mean.push(mean);
        seen.opacity.push(opacity);
    });
    seen
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
