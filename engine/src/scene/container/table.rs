//! The columns of a chunk, in storage order. A new value of a record is a row of [`VALUES`], after the others.

use self::By::{Ahead, Grown, Last, Link, Track, Zero};
use self::Form::{Log2, Log2Plus1, Over, Steps};
use crate::stream::Record;

/// The columns before those of values.
pub(super) const LINKS: [&str; 7] = ["kind", "link_row", "link", "code", "identity", "birth", "frame"];
/// Cells of a row of the embedded model's grid. Links jump by rows, where a record continues one above or below.
pub(super) const ROW: i64 = 256;
/// The columns after them: the two records of each merge, and the identities that have no record.
pub(super) const MERGES: [&str; 3] = ["merge", "merge_into", "merge_other"];

/// A number of a record, which is stored as a whole number.
pub(super) struct Value {
    /// The column's name.
    pub(super) name: &'static str,
    /// The number's place in a record.
    pub(super) of: fn(&mut Record) -> &mut f32,
    /// How it becomes a whole number.
    pub(super) form: Form,
    /// Least and greatest whole number; others move to the nearer end.
    pub(super) range: [i64; 2],
    /// What predicts the whole number.
    pub(super) by: By,
    /// What is added to a magnitude before it is rounded down: ½ rounds to the nearest, ties to even.
    pub(super) rounding: f64,
    /// Steps of a container's whole numbers per step of a page's, which only draws. A page's steps are a quarter of a
    /// pixel of 512×288 along x and z, a 512th of inverse depth, an eighth of an octave of opacity, a quarter of an
    /// octave of scale and thickness, a 64th of a colour. A colour's divides [`GROWTH`] of its change's.
    #[cfg_attr(not(feature = "viewer"), expect(dead_code, reason = "only pages have coarser numbers"))]
    pub(super) coarseness: i64,
    /// Whether the column is empty where all its differences are 0.
    pub(super) rare: bool,
}

/// Whole numbers of a number `x`, before they are rounded to the nearest, ties to even, in binary64.
#[derive(Clone, Copy)]
pub(super) enum Form {
    /// So many steps to a unit.
    Steps(f64),
    /// Steps, minus the whole number so many columns before: colours over green.
    Over(f64, usize),
    /// `steps·log₂ x`, where 0 becomes the range's least, which comes back as 0.
    Log2(f64),
    /// `steps·log₂(1 + x)`
    Log2Plus1(f64),
}

/// Predictions of a whole number. A record is carried, kept, following or fresh ([`chunk`](super::chunk)).
#[derive(Clone, Copy)]
pub(super) enum By {
    /// The linked record's for a carried or a kept one, else that of the last record that is neither.
    Link,
    /// As `Link`, but so many whole numbers further: the width of a cell of the embedded model's grid.
    Ahead(i64),
    /// As `Link`, but a kept one's has grown by its change over the interval before.
    Grown,
    /// The linked record's for a carried or a kept one, the way to the tracked point for a following one, 0 for a fresh
    /// one.
    Track,
    /// That of the last record.
    Last,
    /// 0.
    Zero,
}

/// The largest magnitude of a whole number.
pub(super) const LIMIT: i64 = 1 << 46;
const ANY: [i64; 2] = [-LIMIT, LIMIT];
const FROM_0: [i64; 2] = [0, LIMIT];

/// Steps to a world unit. Depth decides what covers what, so its steps are the finest: where two depths become equal,
/// an image changes. Offsets concern tracked points alone. Steps of velocities and offsets are whole multiples, so that
/// tracked points are whole numbers.
const DEPTH: f64 = 16384.0;
const PLACE: f64 = DEPTH / PLACE_UNIT as f64;
const MOTION: f64 = DEPTH / VELOCITY_UNIT as f64;
const TRACK: f64 = DEPTH / TRACK_UNIT as f64;
const TRACK_DEPTH: f64 = DEPTH / TRACK_DEPTH_UNIT as f64;
/// Steps of depth in a step of a place across, of a velocity, of an offset across, and of an offset in depth.
const PLACE_UNIT: i64 = 8;
pub(super) const VELOCITY_UNIT: i64 = 16;
const TRACK_UNIT: i64 = 16;
const TRACK_DEPTH_UNIT: i64 = 128;
pub(super) const MEAN_UNITS: [i64; 3] = [PLACE_UNIT, 1, PLACE_UNIT];
pub(super) const OFFSET_UNITS: [i64; 3] = [TRACK_UNIT, TRACK_DEPTH_UNIT, TRACK_UNIT];
/// Steps to an octave of a size and of an opacity, and the whole numbers of the least binary32 and of the greatest.
const SIZE: f64 = 8.0;
const SIZES: [i64; 2] = [-1208, 1016];
const OPACITY: f64 = 16.0;
const OPACITIES: [i64; 2] = [-2416, 2032];
const COLOUR: f64 = 128.0;
/// Much coarser than colours: it is multiplied by the time from the reference, and mostly visible where its Gaussian
/// fades. It is mostly noise of the fit around 0, so it is not predicted, and rounded down below 0.65 of a step.
const RATE: f64 = 16.0;

/// The values of a record.
pub(super) const VALUES: [Value; 21] = [
    value("mean_x", |r| &mut r.mean[0], Steps(PLACE), ANY, Ahead(16), 2),
    value("mean_y", |r| &mut r.mean[1], Steps(DEPTH), ANY, Link, 32),
    value("mean_z", |r| &mut r.mean[2], Steps(PLACE), ANY, Link, 4),
    value("offset_x", |r| &mut r.offset[0], Steps(TRACK), ANY, Track, 1),
    value("offset_y", |r| &mut r.offset[1], Steps(TRACK_DEPTH), ANY, Track, 1),
    value("offset_z", |r| &mut r.offset[2], Steps(TRACK), ANY, Track, 1),
    value("opacity", |r| &mut r.opacity, Log2(OPACITY), OPACITIES, Link, 2),
    value("scale_x", |r| &mut r.scale[0], Log2(SIZE), SIZES, Link, 2),
    value("scale_z", |r| &mut r.scale[1], Log2(SIZE), SIZES, Link, 2),
    value("green", |r| &mut r.rgb[1], Steps(COLOUR), ANY, Grown, 2),
    value("red", |r| &mut r.rgb[0], Over(COLOUR, 1), ANY, Grown, 3),
    value("blue", |r| &mut r.rgb[2], Over(COLOUR, 2), ANY, Grown, 3),
    value("velocity_x", |r| &mut r.velocity[0], Steps(MOTION), ANY, Last, 2),
    value("velocity_y", |r| &mut r.velocity[1], Steps(MOTION), ANY, Last, 2),
    value("velocity_z", |r| &mut r.velocity[2], Steps(MOTION), ANY, Last, 2),
    value("gamma_0", |r| &mut r.gamma[0], Log2Plus1(32.0), [0, 4092], Last, 1),
    value("gamma_1", |r| &mut r.gamma[1], Steps(256.0), FROM_0, Last, 1),
    value("green_rate", |r| &mut r.rgb_rate[1], Steps(RATE), ANY, Zero, 2).rare().down(),
    value("red_rate", |r| &mut r.rgb_rate[0], Over(RATE, 1), ANY, Zero, 3).rare().down(),
    value("blue_rate", |r| &mut r.rgb_rate[2], Over(RATE, 2), ANY, Zero, 3).rare().down(),
    value("thickness", |r| &mut r.thickness, Log2(SIZE), SIZES, Link, 2).rare(),
];
/// The first row of each of the three from which tracked points follow.
pub(super) const MEAN: usize = 0;
pub(super) const OFFSET: usize = 3;
pub(super) const VELOCITY: usize = 12;
/// Rows from a colour to its change, and whole numbers that a colour grows by for one of its change.
const TO_RATE: usize = 8;
pub(super) const GROWTH: i64 = (COLOUR / RATE) as i64;

/// The whole number of a record's colour after its change over an interval. `step`: steps of a container's whole
/// numbers per step of these.
pub(super) fn grown(values: &[i64; VALUES.len()], k: usize, step: fn(&Value) -> i64) -> i64 {
    let rate = k + TO_RATE;
    values[k] + values[rate] * (GROWTH * step(&VALUES[rate]) / step(&VALUES[k]))
}

const fn value(
    name: &'static str,
    of: fn(&mut Record) -> &mut f32,
    form: Form,
    range: [i64; 2],
    by: By,
    coarseness: i64,
) -> Value {
    Value { name, of, form, range, by, rounding: 0.5, coarseness, rare: false }
}

impl Value {
    const fn rare(self) -> Value {
        Value { rare: true, ..self }
    }

    /// With magnitudes that are rounded down below 0.65 of a step.
    const fn down(self) -> Value {
        Value { rounding: 0.35, ..self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stream::{Handover, Reference};

    #[test]
    fn every_number_of_a_record_has_a_row() {
        let mut record = Record {
            mean: [f32::NAN; 3],
            velocity: [f32::NAN; 3],
            gamma: [f32::NAN; 2],
            opacity: f32::NAN,
            scale: [f32::NAN; 2],
            thickness: f32::NAN,
            rgb: [f32::NAN; 3],
            rgb_rate: [f32::NAN; 3],
            offset: [f32::NAN; 3],
            identity: 0,
            birth: 0,
            frame: 0,
            reference: Reference::Start,
            handover: Handover::None,
        };
        VALUES.iter().for_each(|value| {
            assert!(!record.is_sound());
            *(value.of)(&mut record) = 0.5;
        });
        assert!(record.is_sound(), "{record:?}");
    }

    #[test]
    fn colours_grow_by_their_change() {
        let mut values = [0; VALUES.len()];
        let names = VALUES.map(|value| value.name);
        for (k, value) in VALUES.iter().enumerate().filter(|(_, value)| matches!(value.by, Grown)) {
            assert_eq!(names[k + TO_RATE], format!("{}_rate", value.name));
            assert_eq!(GROWTH * VALUES[k + TO_RATE].coarseness % value.coarseness, 0);
            (values[k], values[k + TO_RATE]) = (10, 3);
            assert_eq!(grown(&values, k, |_| 1), 34);
            let coarse = GROWTH * VALUES[k + TO_RATE].coarseness / value.coarseness;
            assert_eq!(grown(&values, k, |value| value.coarseness), 10 + 3 * coarse);
        }
    }
}
