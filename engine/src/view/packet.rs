//! One interval in the page's format: 34 bytes per Gaussian, 37 where colours change.
//!
//! Little-endian. A header of 96 bytes, `count` records of 32 bytes, `count` ages of two bytes; and if the step of
//! rates is not zero, `count` rates of three bytes.
//!
//! | header | | |
//! |---|---|---|
//! | 0 | 4 bytes | `sspk` |
//! | 4 | u32 | version, 1 |
//! | 8 | u64 | the key frame at the interval's end |
//! | 16 | f64, f64 | start and end in seconds |
//! | 32 | u32, u32 | count; zero |
//! | 40 | 4 × 3 f32 | `low` and `step` of positions, `low` and `step` of velocities |
//! | 88 | f32, f32 | `step` of rates; `beyond` of colours |
//!
//! | record | | value | error at most |
//! |---|---|---|---|
//! | 0 | 3 × u16 | position at the reference time: `low + step·q` | step / 2, a 131,070th of the interval's range |
//! | 6 | 3 × u16 | velocity, likewise | likewise |
//! | 12 | f16 | γ₀, at most 65,504 | 2⁻¹¹ of it |
//! | 14 | u16 | γ₁·65535 | 1 / 131,070 |
//! | 16 | 3 × u8 | red, green, blue: `(1 + 2·beyond)·q/255 − beyond` | `(1 + 2·beyond)` / 510 |
//! | 19 | u8 | opacity times 255 | 1 / 510 |
//! | 20 | 2 × f16 | standard deviations along x and z, at most 65,504 | 2⁻¹¹ of it, 2⁻²⁵ |
//! | 24 | u64 | identity in the low 56 bits; bit 56 reference; bits 57 and 58 handover | none below 2⁵⁶ |
//! | | | thickness in bits 59 to 63: 2^(q/4), q a signed number | from 2⁻⁴ to 2^(15/4) an eighth of an octave |
//!
//! A rate is the change of red, green and blue per interval, 3 × i8: `step·q·|q|`, with an error of `step·(|q| + 1)` at
//! most. The step is a 16,129th of the largest rate. Small rates, which most are, have small errors.
//!
//! Fitted colours may exceed 0 and 1, so `beyond` is the most by which a colour of the interval does, and at most ¼:
//! colours that exceed them by more are clamped.
//!
//! An age is the number of key frames from the identity's birth to the interval's end, at most 65,535. Omitted are
//! Gaussians that no image of the interval can show: opacities under 1/255, inverse depths that stay on one side
//! outside of [0, 1], and records with a number that is not finite. The order is the drawing order.

use half::f16;
use streamsplat_kernels::math::f64::ln;
use streamsplat_kernels::raster::ALPHA_MIN;

use crate::stream::{Interval, Record};

/// The first bytes.
pub const MAGIC: [u8; 4] = *b"sspk";
/// The version this program writes, and its page reads.
pub const VERSION: u32 = 1;
/// Bytes before the records.
pub const HEADER: usize = 96;
/// Bytes of a record.
pub const RECORD: usize = 32;
/// Square of the number of steps of the largest rate.
const RATE_STEPS: f32 = 127.0 * 127.0;
/// The most by which colours exceed 0 and 1.
const MOST_BEYOND: f32 = 0.25;
/// Steps of a range.
const STEPS: f64 = 65535.0;
/// The identity's part of a record's last word.
const IDENTITY: u64 = (1 << 56) - 1;

/// The packet of an interval.
///
/// # Panics
/// When the interval's arrays differ in length ([`DynamicGaussians::uneven`](crate::stream::DynamicGaussians::uneven)).
pub fn packet(interval: &Interval) -> Vec<u8> {
    let shown: Vec<Record> = interval.gaussians.iter().filter(can_be_seen).collect();
    let position = Grid::over(shown.iter().map(|r| r.mean));
    let velocity = Grid::over(shown.iter().map(|r| r.velocity));
    let rate = shown.iter().flat_map(|r| r.rgb_rate).fold(0.0, |most: f32, rate| most.max(rate.abs())) / RATE_STEPS;
    let mut out = Vec::with_capacity(HEADER + shown.len() * (RECORD + 5));
    out.extend_from_slice(&MAGIC);
    out.extend_from_slice(&VERSION.to_le_bytes());
    out.extend_from_slice(&interval.index.to_le_bytes());
    out.extend_from_slice(&interval.start.to_le_bytes());
    out.extend_from_slice(&interval.end.to_le_bytes());
    out.extend_from_slice(&(shown.len() as u64).to_le_bytes());
    for values in [position.low, position.step, velocity.low, velocity.step] {
        values.iter().for_each(|v| out.extend_from_slice(&v.to_le_bytes()));
    }
    let beyond = shown.iter().flat_map(|r| r.rgb).fold(0.0, |most: f32, value| most.max((value - 1.0).max(-value)));
    let beyond = beyond.min(MOST_BEYOND);
    out.extend_from_slice(&rate.to_le_bytes());
    out.extend_from_slice(&beyond.to_le_bytes());
    debug_assert_eq!(out.len(), HEADER);
    for r in &shown {
        let words = position.steps(r.mean).into_iter().chain(velocity.steps(r.velocity));
        let words = words.chain([half(r.gamma[0]), unit(r.gamma[1], STEPS) as u16]);
        words.for_each(|w| out.extend_from_slice(&w.to_le_bytes()));
        out.extend(r.rgb.map(|value| within(value, beyond)));
        out.push(unit(r.opacity, 255.0) as u8);
        r.scale.iter().for_each(|s| out.extend_from_slice(&half(*s).to_le_bytes()));
        let flags = r.reference as u64 | (r.handover as u64) << 1 | thickness(r.thickness) << 3;
        out.extend_from_slice(&(r.identity & IDENTITY | flags << 56).to_le_bytes());
    }
    for r in &shown {
        let age = interval.index.saturating_sub(r.birth).min(u64::from(u16::MAX)) as u16;
        out.extend_from_slice(&age.to_le_bytes());
    }
    if rate > 0.0 {
        // The conversion saturates.
        let steps = |change: f32| {
            let steps = (f64::from(change.abs()) / f64::from(rate)).sqrt().round() as i8;
            if change < 0.0 { -steps } else { steps }
        };
        out.extend(shown.iter().flat_map(|r| r.rgb_rate).flat_map(|change| steps(change).to_le_bytes()));
    }
    out
}

/// Returns true if the record can be visible in an image of the interval.
fn can_be_seen(r: &Record) -> bool {
    let (y, other) = (r.position_at(0.0)[1], r.position_at(1.0)[1]);
    r.is_sound() && r.opacity >= ALPHA_MIN && y.max(other) >= 0.0 && y.min(other) <= 1.0
}

/// Evenly spaced values over a range, per axis.
struct Grid {
    low: [f32; 3],
    step: [f32; 3],
}

impl Grid {
    /// A grid over finite values; 0 if there are none.
    fn over(values: impl Iterator<Item = [f32; 3]>) -> Grid {
        let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
        for v in values {
            for axis in 0..3 {
                low[axis] = low[axis].min(v[axis]);
                high[axis] = high[axis].max(v[axis]);
            }
        }
        if low[0] > high[0] {
            return Grid { low: [0.0; 3], step: [0.0; 3] };
        }
        let step = std::array::from_fn(|axis| ((f64::from(high[axis]) - f64::from(low[axis])) / STEPS) as f32);
        Grid { low, step }
    }

    /// The nearest steps.
    fn steps(&self, v: [f32; 3]) -> [u16; 3] {
        std::array::from_fn(|axis| {
            let step = f64::from(self.step[axis]);
            let above = f64::from(v[axis]) - f64::from(self.low[axis]);
            // The conversion saturates: 65535 at most.
            if step > 0.0 { (above / step).round() as u16 } else { 0 }
        })
    }
}

/// The bits of the nearest binary16 number, at most the largest finite one.
fn half(value: f32) -> u16 {
    f16::from_f32(value.min(f16::MAX.to_f32())).to_bits()
}

/// Thickness in quarters of an octave, the lowest five bits of a signed number.
fn thickness(thickness: f32) -> u64 {
    let octaves = ln(f64::from(thickness)) * std::f64::consts::LOG2_E;
    // The conversion saturates.
    ((4.0 * octaves).round() as i64).clamp(-16, 15).cast_unsigned() & 31
}

/// A value of [0, 1] in steps, rounded half up; values outside are clamped.
fn unit(value: f32, steps: f64) -> u32 {
    (f64::from(value.clamp(0.0, 1.0)) * steps + 0.5) as u32
}

/// The nearest 255th of the range from `−beyond` to `1 + beyond`.
fn within(value: f32, beyond: f32) -> u8 {
    let (value, beyond) = (f64::from(value), f64::from(beyond));
    ((value + beyond) / (1.0 + 2.0 * beyond) * 255.0 + 0.5).clamp(0.0, 255.0) as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::{Fit, Placement};
    use crate::stream::{DynamicGaussians, Handover, Reference};

    fn interval(gaussians: DynamicGaussians) -> Interval {
        let placement = Placement::new(Fit::Letterbox, [24, 40], [24, 40]).expect("sizes");
        Interval { index: 70_000, start: 0.25, end: 0.5, gaussians, placement, merges: Vec::new(), dropped: 0 }
    }

    fn records() -> Vec<Record> {
        (0..257)
            .map(|i| {
                let grain = (i * 7919 % 1013) as f32 / 1013.0;
                Record {
                    mean: [2.0 * grain - 1.0, grain, 0.1 - grain],
                    velocity: [0.3 - grain, 0.01 * grain, 0.2],
                    gamma: [1e6 * grain * grain * grain, grain],
                    opacity: 0.004 + 0.99 * grain,
                    scale: [1e-3 + grain, 0.07 * grain],
                    thickness: 12.0 * grain * grain,
                    rgb: [1.3 * grain - 0.1, 1.0 - grain, 0.5],
                    rgb_rate: [0.3 * grain, -0.2, grain * grain - 0.5],
                    identity: (1 << 40) + i as u64,
                    birth: i as u64 * 271,
                    reference: Reference::from_code((i % 2) as u8).expect("a code"),
                    handover: Handover::from_code((i % 3) as u8).expect("a code"),
                    ..Record::default()
                }
            })
            .collect()
    }

    fn float(bytes: &[u8], at: usize) -> f32 {
        f32::from_le_bytes(bytes[at..at + 4].try_into().expect("four bytes"))
    }

    fn word(bytes: &[u8], at: usize) -> u16 {
        u16::from_le_bytes([bytes[at], bytes[at + 1]])
    }

    #[test]
    fn every_value_comes_back_within_its_stated_error() {
        let records = records();
        let bytes = packet(&interval(records.iter().copied().collect()));
        assert_eq!(bytes.len(), HEADER + records.len() * 37);
        assert_eq!((&bytes[..4], bytes[4], word(&bytes, 32)), (&MAGIC[..], VERSION as u8, 257));
        assert_eq!(f64::from_le_bytes(bytes[24..32].try_into().expect("eight bytes")), 0.5);
        for (i, r) in records.iter().enumerate() {
            let at = HEADER + i * RECORD;
            for axis in 0..3 {
                for (value, low, q) in [(r.mean[axis], 40, 0), (r.velocity[axis], 64, 6)] {
                    let (low, step) = (float(&bytes, low + 4 * axis), float(&bytes, low + 12 + 4 * axis));
                    let found = low + step * f32::from(word(&bytes, at + q + 2 * axis));
                    assert!((found - value).abs() <= 0.5 * step + 2e-7, "{i} {axis}: {found} {value}");
                }
            }
            let half = |offset: usize| f16::from_bits(word(&bytes, at + offset)).to_f32();
            for (found, value) in [(half(12), r.gamma[0].min(65504.0)), (half(20), r.scale[0]), (half(22), r.scale[1])]
            {
                assert!((found - value).abs() <= value / 2048.0 + 3e-8, "{i}: {found} {value}");
            }
            assert!((f32::from(word(&bytes, at + 14)) / 65535.0 - r.gamma[1]).abs() <= 1.0 / 131_000.0);
            let beyond = float(&bytes, 92);
            assert!((0.19..0.2).contains(&beyond), "{beyond}");
            let range = 1.0 + 2.0 * beyond;
            for (k, value) in r.rgb.into_iter().enumerate() {
                let found = range * f32::from(bytes[at + 16 + k]) / 255.0 - beyond;
                assert!((found - value).abs() <= range / 509.0, "{i} {k}: {found} {value}");
            }
            assert!((f32::from(bytes[at + 19]) / 255.0 - r.opacity).abs() <= 1.0 / 509.0);
            let last = u64::from_le_bytes(bytes[at + 24..at + 32].try_into().expect("eight bytes"));
            assert_eq!(last & IDENTITY, r.identity);
            assert_eq!(last >> 56 & 7, r.reference as u64 + 2 * r.handover as u64);
            let quarters = (last.cast_signed() >> 59) as f32;
            assert!((quarters / 4.0 - r.thickness.log2().max(-4.0)).abs() <= 0.125001, "{i}: {quarters}");
            let step = float(&bytes, 88);
            for channel in 0..3 {
                let q = f32::from(bytes[HEADER + records.len() * 34 + 3 * i + channel].cast_signed());
                let found = step * q * q.abs();
                assert!((found - r.rgb_rate[channel]).abs() <= step * (q.abs() + 1.0), "{i} {channel}: {found}");
            }
            let age = word(&bytes, HEADER + records.len() * RECORD + 2 * i);
            assert_eq!(u64::from(age), (70_000 - r.birth).min(65_535));
        }
    }

    #[test]
    fn colours_that_stay_take_no_bytes_and_the_least_rate_is_no_hazard() {
        let still = Record { opacity: 0.5, mean: [0.0, 0.5, 0.0], ..Record::default() };
        let bytes = packet(&interval([still].into_iter().collect()));
        assert_eq!((bytes.len(), float(&bytes, 88)), (HEADER + 34, 0.0));
        // A 16,129th of it is no number.
        let hardly = Record { rgb_rate: [1e-45, 0.0, 0.0], ..still };
        assert_eq!(packet(&interval([hardly].into_iter().collect())).len(), HEADER + 34);
        let most = Record { rgb_rate: [f32::MAX, -f32::MAX, 0.0], ..still };
        let bytes = packet(&interval([still, most].into_iter().collect()));
        assert_eq!(bytes[HEADER + 2 * 34..], [0, 0, 0, 127, 129, 0]);
    }

    #[test]
    fn what_cannot_be_seen_is_left_out() {
        let sound = Record { opacity: 0.5, mean: [0.0, 0.5, 0.0], ..Record::default() };
        let hidden = [
            Record { opacity: 0.003, ..sound },
            Record { mean: [0.0, 1.5, 0.0], ..sound },
            Record { mean: [f32::NAN, 0.5, 0.0], ..sound },
            Record { gamma: [f32::INFINITY, 0.0], ..sound },
        ];
        assert_eq!(packet(&interval(hidden.into_iter().collect())).len(), HEADER);
        let comes = Record { mean: [0.0, 1.5, 0.0], velocity: [0.0, -0.6, 0.0], ..sound };
        assert_eq!(packet(&interval([sound, comes].into_iter().collect())).len(), HEADER + 68);
    }

    #[test]
    fn the_widest_finite_numbers_make_no_infinite_step() {
        let far = |x: f32| Record { opacity: 0.5, mean: [x, 0.5, -x], scale: [x.abs(); 2], ..Record::default() };
        let bytes = packet(&interval([far(f32::MAX), far(f32::MIN)].into_iter().collect()));
        assert!((0..12).all(|k| float(&bytes, 40 + 4 * k).is_finite()));
        assert_eq!((word(&bytes, HEADER), word(&bytes, HEADER + RECORD)), (65535, 0));
    }
}
