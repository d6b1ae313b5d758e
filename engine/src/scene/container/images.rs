//! Chunks for a page that only draws: coarser numbers, and only the columns that images require.

use super::ALONE_EVERY;
use super::chunk::encode_for_images;
use super::quantise::{OFFSET, Quantised, VALUES};
use crate::stream::{Interval, Workers};

/// Steps of a container's whole numbers per step of a page's, in the order of the columns from `mean_x` on. A page's
/// steps are a sixteenth of a pixel of 512×288 along x and z, a 512th of inverse depth, a sixteenth of an opacity, a
/// quarter of an octave of scale and thickness, a 64th of a colour.
pub(crate) const COARSENESS: [i64; VALUES] =
    [8, 16, 16, 1, 1, 1, 64, 16, 16, 8, 12, 12, 16, 16, 16, 1, 1, 24, 32, 32, 16];

/// Chunks of intervals one after another.
#[derive(Debug, Default)]
pub(crate) struct ImageChunks {
    count: usize,
    before: Vec<Quantised>,
}

impl ImageChunks {
    /// Encodes the chunk of the next interval with `workers`; also returns whether it is independent.
    pub(crate) fn next(&mut self, interval: &Interval, workers: &Workers) -> (Vec<u8>, bool) {
        let sound = interval.gaussians.iter().filter(|record| record.is_sound());
        let records: Vec<Quantised> = sound.map(|record| coarser(Quantised::of(&record))).collect();
        let alone = self.count.is_multiple_of(ALONE_EVERY);
        let before = if alone { &[] } else { self.before.as_slice() };
        let bytes = workers.install(|| encode_for_images(before, &records));
        self.count += 1;
        self.before = records;
        (bytes, alone)
    }
}

/// In a page's steps, rounded half up.
fn coarser(mut record: Quantised) -> Quantised {
    for (value, step) in record.values.iter_mut().zip(COARSENESS) {
        *value = (2 * *value + step).div_euclid(2 * step);
    }
    // Tracked points, which no column holds, must not predict anything.
    record.values[OFFSET..OFFSET + 3].fill(0);
    record
}
