//! The Gaussians of an interval at one time.

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
        let count = seen.iter().map(|seen| seen.index.len()).sum();
        let mut out = Self {
            index: vec![0; count],
            mean: vec![[0.0; 3]; count],
            scale: vec![[0.0; 3]; count],
            opacity: vec![0.0; count],
            rgb: vec![[0.0; 3]; count],
            dropped: seen.iter().map(|seen| seen.dropped).sum(),
        };
        let (mut index, mut mean, mut scale) = (&mut out.index[..], &mut out.mean[..], &mut out.scale[..]);
        let (mut opacity, mut rgb) = (&mut out.opacity[..], &mut out.rgb[..]);
        let mut parts = Vec::with_capacity(seen.len());
        for seen in &seen {
            let len = seen.index.len();
            parts.push((
                seen,
                index.split_off_mut(..len).unwrap_or_default(),
                mean.split_off_mut(..len).unwrap_or_default(),
                scale.split_off_mut(..len).unwrap_or_default(),
                opacity.split_off_mut(..len).unwrap_or_default(),
                rgb.split_off_mut(..len).unwrap_or_default(),
            ));
        }
        for_each_chunk(&mut parts, 1, |_, part| {
            for (seen, index, mean, scale, opacity, rgb) in part {
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
    let end = gaussians.len().min(start + CHUNK);
    let mut opacity = vec![0.0; end - start];
    let mut from = start;
    for run in gaussians.reference[start..end].chunk_by(|a, b| a == b) {
        let part = from..from + run.len();
        let out = &mut opacity[part.start - start..part.end - start];
        let tau = run[0].tau(t);
        motion::opacity_at(level, &gaussians.opacity[part.clone()], &gaussians.gamma[part.clone()], tau, out);
        from = part.end;
    }
    let count = end - start;
    let (index, mean) = (Vec::with_capacity(count), Vec::with_capacity(count));
    let mut seen = Seen { index, mean, opacity: Vec::with_capacity(count), dropped: 0 };
    let sound = all_sound(gaussians, start..end);
    for (i, opacity) in (start..end).zip(opacity) {
        let record = drawn(gaussians, i);
        if !sound && !record.is_sound() {
            seen.dropped += 1;
            continue;
        }
        let opacity = opacity * record.handover.factor(t);
        if opacity < ALPHA_MIN {
            continue;
        }
        let Some(mean) = to_scene(record.position_at(t)) else { continue };
        seen.index.push(i as u32);
        seen.mean.push(mean);
        seen.opacity.push(opacity);
    }
    seen
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
fn all_sound(gaussians: &DynamicGaussians, chunk: std::ops::Range<usize>) -> bool {
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
