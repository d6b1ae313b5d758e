//! Chunks for a page that only draws: coarser numbers, and only the columns that images require.

use super::ALONE_EVERY;
use super::chunk::encode_for_images;
use super::quantise::Quantised;
use super::table::{By, VALUES, Value};
use crate::stream::{Interval, Workers};

/// Steps of a container's whole numbers per step of a page's, in the order of the columns from `mean_x` on.
pub(crate) fn coarseness() -> Vec<i64> {
    VALUES.iter().map(|value| value.coarseness).collect()
}

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

/// In a page's steps, rounded to the nearest, halves towards zero: changes of colour of one step either way are alike.
fn coarser(mut record: Quantised) -> Quantised {
    for (value, Value { coarseness, by, .. }) in record.values.iter_mut().zip(&VALUES) {
        // Tracked points, which no column holds, must not predict anything.
        *value = if let By::Track = by { 0 } else { nearest(*value, *coarseness) };
    }
    record
}

/// x/step, rounded to the nearest, halves towards zero.
fn nearest(x: i64, step: i64) -> i64 {
    x.signum() * ((2 * x.abs() + step - 1) / (2 * step))
}

#[cfg(test)]
mod tests {
    use super::nearest;

    #[test]
    fn halves_go_towards_zero() {
        let rounded = |step| (-5..6).map(|x| nearest(x, step)).collect::<Vec<_>>();
        assert_eq!(rounded(1), (-5..6).collect::<Vec<_>>());
        assert_eq!(rounded(2), [-2, -2, -1, -1, 0, 0, 0, 1, 1, 2, 2]);
        assert_eq!(rounded(3), [-2, -1, -1, -1, 0, 0, 0, 1, 1, 1, 2]);
    }
}
