//! The Gaussians of an interval at one time.

use streamsplat_kernels::Level;
use streamsplat_kernels::parallel::map_indexed;
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
        let parts = map_indexed(gaussians.len().div_ceil(CHUNK), |chunk| seen(level, gaussians, t, chunk));
        let mut out = Self::with_capacity(parts.iter().map(|part| part.index.len()).sum());
        for part in parts {
            out.index.extend_from_slice(&part.index);
            out.mean.extend_from_slice(&part.mean);
            out.scale.extend_from_slice(&part.scale);
            out.opacity.extend_from_slice(&part.opacity);
            out.rgb.extend_from_slice(&part.rgb);
            out.dropped += part.dropped;
        }
        out
    }

    fn with_capacity(count: usize) -> Self {
        Self {
            index: Vec::with_capacity(count),
            mean: Vec::with_capacity(count),
            scale: Vec::with_capacity(count),
            opacity: Vec::with_capacity(count),
            rgb: Vec::with_capacity(count),
            dropped: 0,
        }
    }
}

/// Visible Gaussians of one chunk, in order.
fn seen(level: Level, gaussians: &DynamicGaussians, t: f32, chunk: usize) -> Snapshot {
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
    let mut seen = Snapshot::with_capacity(end - start);
    for (i, opacity) in (start..end).zip(opacity) {
        // Only the drawn fields of a record are read.
        let record = Record {
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
        };
        if !record.is_sound() {
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
        seen.scale.push(record.deviations());
        seen.opacity.push(opacity);
        seen.rgb.push(record.rgb_at(t));
    }
    seen
}
