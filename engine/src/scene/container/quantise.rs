//! Records as whole numbers, each value as its row of [`VALUES`] states.

use std::f64::consts::{LN_2, LOG2_E};

use streamsplat_kernels::math::f64::{exp, expm1, ln, ln_1p};

use super::table::{Form, LIMIT, MEAN, MEAN_UNITS, OFFSET, OFFSET_UNITS, VALUES, VELOCITY, VELOCITY_UNIT};
use crate::stream::{Handover, Record, Reference};

/// A record in whole numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Quantised {
    pub(super) values: [i64; VALUES.len()],
    pub(super) identity: u64,
    pub(super) birth: u64,
    pub(super) frame: u64,
    pub(super) reference: Reference,
    pub(super) handover: Handover,
}

fn whole(x: f64) -> i64 {
    (x.round_ties_even() as i64).clamp(-LIMIT, LIMIT)
}

/// `x` to a whole number, as a value's row states.
fn rounded(x: f64, rounding: f64) -> i64 {
    if rounding == 0.5 { whole(x) } else { whole((x.abs() + rounding).floor().copysign(x)) }
}

impl Quantised {
    /// Converts a sound record to whole numbers.
    pub(super) fn of(r: &Record) -> Self {
        let mut record = *r;
        let mut values = [0; VALUES.len()];
        for (i, row) in VALUES.iter().enumerate() {
            let x = f64::from(*(row.of)(&mut record));
            let [least, most] = row.range;
            let q = match row.form {
                Form::Steps(steps) => rounded(x * steps, row.rounding),
                // Values so large that the difference passes the limit are not colours.
                Form::Over(steps, back) if row.rounding == 0.5 => whole(x * steps) - values[i - back],
                Form::Over(steps, back) => rounded(x * steps - values[i - back] as f64, row.rounding),
                Form::Log2(steps) if x > 0.0 => whole(steps * (ln(x) * LOG2_E)),
                Form::Log2(_) => least,
                Form::Log2Plus1(steps) => whole(steps * (ln_1p(x) * LOG2_E)),
            };
            values[i] = q.clamp(least, most);
        }
        let Record { identity, birth, frame, reference, handover, .. } = *r;
        Self { values, identity, birth, frame, reference, handover }
    }

    /// Converts the whole numbers back to a record.
    pub(super) fn record(&self) -> Record {
        let Self { identity, birth, frame, reference, handover, .. } = *self;
        let mut record = Record { identity, birth, frame, reference, handover, ..Record::default() };
        let v = |i: usize| self.values[i] as f64;
        for (i, row) in VALUES.iter().enumerate() {
            *(row.of)(&mut record) = match row.form {
                Form::Steps(steps) => v(i) / steps,
                Form::Over(steps, back) => (v(i) + v(i - back)) / steps,
                Form::Log2(steps) => exp(v(i) / steps * LN_2),
                Form::Log2Plus1(steps) => expm1(v(i) / steps * LN_2),
            } as f32;
        }
        record
    }

    /// The identity's tracked point at the interval's end, in steps of depth.
    pub(super) fn point_at_end(&self) -> [i64; 3] {
        std::array::from_fn(|axis| {
            let moved = if self.reference == Reference::Start { self.values[VELOCITY + axis] } else { 0 };
            self.mean(axis) + self.values[OFFSET + axis] * OFFSET_UNITS[axis] + moved * VELOCITY_UNIT
        })
    }

    /// The mean along an axis, in steps of depth.
    pub(super) fn mean(&self, axis: usize) -> i64 {
        self.values[MEAN + axis] * MEAN_UNITS[axis]
    }
}
