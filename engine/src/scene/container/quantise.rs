//! Records as whole numbers.
//!
//! | value | whole number |
//! |---|---|
//! | mean, velocity, offset | `x·2¹³` |
//! | γ₀ | `32·log₂(1 + γ₀)`, at most 4092 |
//! | γ₁ | `256·γ₁` |
//! | opacity | `1023·o` |
//! | scale, thickness | `64·log₂ s`, from −9664 (which comes back as 0) to 8128 |
//! | rgb | `511·c` |
//! | change of rgb | `255·c` |
//!
//! rounded to the nearest, ties to even, in binary64; magnitudes above 2⁴⁶ become 2⁴⁶.

use streamsplat_kernels::math::f64::{exp, expm1, ln, ln_1p};

use crate::stream::{Handover, Record, Reference};

const LENGTH: f64 = 8192.0;
const GAMMA0: f64 = 32.0;
const GAMMA1: f64 = 256.0;
const OPACITY: f64 = 1023.0;
const SCALE: f64 = 64.0;
const COLOUR: f64 = 511.0;
/// Coarser than colours: it is multiplied by the time from the reference, and mostly visible where its Gaussian fades.
const RATE: f64 = 255.0;
/// The largest magnitude of a whole number.
pub(super) const LIMIT: i64 = 1 << 46;
const LEAST_SCALE: i64 = -9664;
const MOST_SCALE: i64 = 8128;
const MOST_GAMMA0: i64 = 4092;

/// Numbers per record that are quantised.
pub(super) const VALUES: usize = 21;
/// Their order: mean, offset, opacity, scale, and colour as green, red − green, blue − green; then velocity, γ, and the
/// change of colour in the same three parts; then thickness.
pub(super) const MEAN: usize = 0;
pub(super) const OFFSET: usize = 3;
pub(super) const OPACITY_AT: usize = 6;
pub(super) const SCALE_AT: usize = 7;
pub(super) const COLOUR_AT: usize = 9;
pub(super) const VELOCITY: usize = 12;
pub(super) const GAMMA: usize = 15;
pub(super) const RATE_AT: usize = 17;
pub(super) const THICKNESS_AT: usize = 20;

/// A record in whole numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Quantised {
    pub(super) values: [i64; VALUES],
    pub(super) identity: u64,
    pub(super) birth: u64,
    pub(super) frame: u64,
    pub(super) reference: Reference,
    pub(super) handover: Handover,
}

fn whole(x: f64) -> i64 {
    (x.round_ties_even() as i64).clamp(-LIMIT, LIMIT)
}

/// Green, red − green, blue − green, in steps. Differences of two stay within twice the limit; values that large
/// are not colours.
fn parts(rgb: [f32; 3], steps: f64) -> [i64; 3] {
    let [red, green, blue] = rgb.map(|c| whole(f64::from(c) * steps));
    [green, red - green, blue - green].map(|c| c.clamp(-LIMIT, LIMIT))
}

/// log₂ x
fn log2(x: f64) -> f64 {
    ln(x) * std::f64::consts::LOG2_E
}

impl Quantised {
    /// Converts a sound record to whole numbers.
    pub(super) fn of(r: &Record) -> Self {
        let length = |x: f32| whole(f64::from(x) * LENGTH);
        let scale = |s: f32| match s > 0.0 {
            true => whole(SCALE * log2(f64::from(s))).clamp(LEAST_SCALE, MOST_SCALE),
            false => LEAST_SCALE,
        };
        let gamma0 = whole(GAMMA0 * (ln_1p(f64::from(r.gamma[0])) * std::f64::consts::LOG2_E)).min(MOST_GAMMA0);
        let mut values = [0; VALUES];
        for axis in 0..3 {
            values[MEAN + axis] = length(r.mean[axis]);
            values[OFFSET + axis] = length(r.offset[axis]);
            values[VELOCITY + axis] = length(r.velocity[axis]);
        }
        values[OPACITY_AT] = whole(f64::from(r.opacity) * OPACITY);
        values[SCALE_AT..COLOUR_AT].copy_from_slice(&r.scale.map(scale));
        values[COLOUR_AT..VELOCITY].copy_from_slice(&parts(r.rgb, COLOUR));
        values[RATE_AT..THICKNESS_AT].copy_from_slice(&parts(r.rgb_rate, RATE));
        values[THICKNESS_AT] = scale(r.thickness);
        values[GAMMA..RATE_AT].copy_from_slice(&[gamma0, whole(f64::from(r.gamma[1]) * GAMMA1)]);
        let Record { identity, birth, frame, reference, handover, .. } = *r;
        Self { values, identity, birth, frame, reference, handover }
    }

    /// Converts the whole numbers back to a record.
    pub(super) fn record(&self) -> Record {
        let v = |i: usize| self.values[i] as f64;
        let triple = |from: usize| std::array::from_fn(|axis| (v(from + axis) / LENGTH) as f32);
        let scale = |i: usize| exp(v(i) / SCALE * std::f64::consts::LN_2) as f32;
        let colour = |at: usize, steps: f64| {
            let green = v(at);
            [green + v(at + 1), green, green + v(at + 2)].map(|c| (c / steps) as f32)
        };
        let gamma0 = expm1(v(GAMMA) / GAMMA0 * std::f64::consts::LN_2) as f32;
        Record {
            mean: triple(MEAN),
            velocity: triple(VELOCITY),
            gamma: [gamma0, (v(GAMMA + 1) / GAMMA1) as f32],
            opacity: (v(OPACITY_AT) / OPACITY) as f32,
            scale: [scale(SCALE_AT), scale(SCALE_AT + 1)],
            thickness: scale(THICKNESS_AT),
            rgb: colour(COLOUR_AT, COLOUR),
            rgb_rate: colour(RATE_AT, RATE),
            identity: self.identity,
            birth: self.birth,
            frame: self.frame,
            offset: triple(OFFSET),
            reference: self.reference,
            handover: self.handover,
        }
    }

    /// The identity's tracked point at the interval's end.
    pub(super) fn point_at_end(&self) -> [i64; 3] {
        std::array::from_fn(|axis| {
            let moved = if self.reference == Reference::Start { self.values[VELOCITY + axis] } else { 0 };
            self.values[MEAN + axis] + self.values[OFFSET + axis] + moved
        })
    }

    /// Returns true if every whole number is a possible result of [`Quantised::of`].
    pub(super) fn is_allowed(&self) -> bool {
        let v = &self.values;
        v.iter().all(|v| v.unsigned_abs() <= LIMIT.unsigned_abs())
            && v[OPACITY_AT] >= 0
            && [v[SCALE_AT], v[SCALE_AT + 1], v[THICKNESS_AT]].iter().all(|s| (LEAST_SCALE..=MOST_SCALE).contains(s))
            && (0..=MOST_GAMMA0).contains(&v[GAMMA])
            && v[GAMMA + 1] >= 0
    }
}
