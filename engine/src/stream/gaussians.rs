//! The dynamic Gaussians of one interval, one array per property: a table of the properties, and what the values mean.

use streamsplat_model::columns::{Numbers, Value};
use streamsplat_model::motion;

/// Part of an interval over which a Gaussian fades in or out at a key frame.
pub const HANDOVER: f32 = 0.125;

/// Handover of a Gaussian at an end of its interval: it leaves for another, arrives for one, or neither.
///
/// The factor on the opacity, with t in [0, 1] over the interval: `min(1, t/⅛)` for one that arrives, `min(1, (1−t)/⅛)`
/// for one that leaves. It is 0 at the key frame, so that the image there does not change when the Gaussian comes or
/// goes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Handover {
    /// Neither.
    #[default]
    None = 0,
    /// Fades in after the start.
    Arrives = 1,
    /// Fades out before the end.
    Leaves = 2,
}

impl Handover {
    /// The handover stored as `code`.
    pub const fn from_code(code: u8) -> Option<Self> {
        match code {
            0 => Some(Handover::None),
            1 => Some(Handover::Arrives),
            2 => Some(Handover::Leaves),
            _ => None,
        }
    }

    /// The factor on the opacity at `t` in [0, 1].
    pub fn factor(self, t: f32) -> f32 {
        match self {
            Handover::None => 1.0,
            Handover::Arrives => (t / HANDOVER).min(1.0),
            Handover::Leaves => ((1.0 - t) / HANDOVER).min(1.0),
        }
    }
}

/// Which end of the interval a record's own position, opacity and colour belong to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Reference {
    /// t₀ = 0: the record is seen forward in time.
    #[default]
    Start = 0,
    /// t₀ = 1: the record is seen backward in time.
    End = 1,
}

impl Reference {
    /// The reference stored as `code`.
    pub const fn from_code(code: u8) -> Option<Self> {
        match code {
            0 => Some(Reference::Start),
            1 => Some(Reference::End),
            _ => None,
        }
    }

    /// τ = t − t₀.
    pub fn tau(self, t: f32) -> f32 {
        match self {
            Reference::Start => t,
            Reference::End => t - 1.0,
        }
    }
}

/// Values that files store as the code of a choice.
macro_rules! stored_as_codes {
    ($($Choice:ident)+) => {
        $(impl Value for $Choice {
            fn numbers(values: &[Self]) -> Numbers<'_> {
                Numbers::Codes(values.iter().map(|value| *value as u8).collect())
            }

            fn from_bytes(bytes: &[u8]) -> Result<Vec<Self>, u8> {
                bytes.iter().map(|code| Self::from_code(*code).ok_or(*code)).collect()
            }
        })+
    };
}

stored_as_codes!(Handover Reference);

/// A colour after a change; the colour itself, to the bit, after none.
pub(super) fn arrived(colour: f32, change: f32) -> f32 {
    if change == 0.0 { colour } else { colour + change }
}

/// The colour near `end` at which a record from `start` arrives, to the bit, when its change is their difference.
pub(super) fn reached(start: f32, end: f32) -> f32 {
    let mut end = if end.is_finite() { end } else { start };
    for _ in 0..4 {
        let next = arrived(start, end - start);
        if next.to_bits() == end.to_bits() {
            return end;
        }
        end = next;
    }
    start
}

/// Standard deviations along x, y and z of scene space: s_x, s_z, and the mean of both times the thickness.
pub(super) fn deviations([sx, sz]: [f32; 2], thickness: f32) -> [f32; 3] {
    [sx, sz, (sx + sz) * 0.5 * thickness]
}

/// Calls a macro with the properties of a Gaussian over an interval, one row for each: its meaning, name and type, and
/// the value in scenes without it if it was added later.
///
/// The name is that of the field, of the tensor in folders of scenes and of the array in Python.
#[doc(hidden)]
#[macro_export]
macro_rules! gaussian_properties {
    ($($then:tt)+) => {
        $($then)+! {
            /// Position at the reference time, world axes (x right, y normalised inverse depth, z up).
            mean: [f32; 3];
            /// World units per interval.
            velocity: [f32; 3];
            /// From `mean` to the tracked point of the identity.
            offset: [f32; 3];
            /// Standard deviations (s_x, s_z).
            scale: [f32; 2];
            /// The standard deviation along the axis of view, in scene space, over the mean of the other two; the
            /// network's is 1.
            thickness: f32 = 1.0;
            /// Opacity at the reference time.
            opacity: f32;
            /// The opacity's window in time: (γ₀, γ₁) of `motion::opacity_factor`.
            gamma: [f32; 2];
            /// Display-space colour at the reference time.
            rgb: [f32; 3];
            /// Change of colour per interval; the network's is zero.
            rgb_rate: [f32; 3] = [0.0; 3];
            /// Identity of the object that it shows: 64-bit, never reused.
            identity: u64;
            /// The key frame in which the identity was first seen.
            birth: u64;
            /// The key frame that reconstructed this record.
            frame: u64;
            /// Which end of the interval `mean`, `opacity` and `rgb` belong to: 0 its start, 1 its end.
            reference: Reference;
            /// Fade at an end of the interval: 0 none, 1 in after the start, 2 out before the end.
            handover: Handover;
        }
    };
}

/// Defines [`Record`] and [`DynamicGaussians`].
macro_rules! structures {
    ($($row:tt)+) => {
        streamsplat_model::columns! {
            /// The record of one Gaussian over one interval.
            Record;
            /// The Gaussians of an interval, in drawing order (among equals in depth): survivors, the frame at its
            /// start, the frame at its end.
            DynamicGaussians;
            $($row)+
        }
    };
}

gaussian_properties!(structures);

impl Record {
    /// Standard deviations along x, y and z of scene space.
    pub fn deviations(&self) -> [f32; 3] {
        deviations(self.scale, self.thickness)
    }

    /// Position at `t` in [0, 1].
    pub fn position_at(&self, t: f32) -> [f32; 3] {
        let tau = self.reference.tau(t);
        std::array::from_fn(|axis| self.mean[axis] + self.velocity[axis] * tau)
    }

    /// Colour at `t` in [0, 1]: product and sum are rounded one after the other. A product of zero, of either sign,
    /// leaves `rgb` unchanged to the bit.
    pub fn rgb_at(&self, t: f32) -> [f32; 3] {
        let tau = self.reference.tau(t);
        std::array::from_fn(|channel| arrived(self.rgb[channel], self.rgb_rate[channel] * tau))
    }

    /// Opacity at `t` in [0, 1].
    pub fn opacity_at(&self, t: f32) -> f32 {
        self.opacity * motion::opacity_factor(self.gamma, self.reference.tau(t)) * self.handover.factor(t)
    }

    /// Returns true if its position, colour and opacity are the same at all times.
    pub(super) fn rests(&self) -> bool {
        let fades = self.gamma[0] != 0.0 || self.handover != Handover::None;
        self.velocity == [0.0; 3] && self.rgb_rate == [0.0; 3] && !fades
    }

    /// Returns true if every number is finite, as [`motion::opacity_factor`] requires, the colour is finite throughout
    /// the interval, and no γ, scale, thickness or opacity is negative.
    pub fn is_sound(&self) -> bool {
        let ([sx, sz], [g0, g1]) = (self.scale, self.gamma);
        // Between the ends every rounded colour is between theirs.
        let undefined = self.undefined() + self.rgb_at(0.0).undefined() + self.rgb_at(1.0).undefined();
        undefined == 0.0 && [g0, g1, sx, sz, self.thickness, self.opacity].iter().all(|x| *x >= 0.0)
    }
}

impl DynamicGaussians {
    /// The records of all `parts`, one part after the other.
    pub(crate) fn concat(parts: &[Self]) -> Self {
        let mut all = Self::with_capacity(parts.iter().map(Self::len).sum());
        parts.iter().for_each(|part| all.append(part));
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_handover_is_nothing_at_its_key_frame_and_everything_away_from_it() {
        assert_eq!(Handover::Arrives.factor(0.0), 0.0);
        assert_eq!(Handover::Arrives.factor(0.0625), 0.5);
        assert_eq!(Handover::Leaves.factor(1.0), 0.0);
        for t in [0.125, 0.2, 0.5, 0.8, 0.875] {
            for handover in [Handover::None, Handover::Arrives, Handover::Leaves] {
                assert_eq!(handover.factor(t), 1.0);
            }
        }
    }

    #[test]
    fn codes_go_both_ways() {
        for code in 0..=255u8 {
            assert!(Handover::from_code(code).is_none_or(|h| h as u8 == code));
            assert!(Reference::from_code(code).is_none_or(|r| r as u8 == code));
            assert_eq!(Handover::from_bytes(&[0, code]).err(), (code > 2).then_some(code));
        }
        assert_eq!(Handover::from_code(2), Some(Handover::Leaves));
        assert_eq!(Reference::from_code(1), Some(Reference::End));
    }

    #[test]
    fn parts_are_joined_in_order() {
        let record = Record { mean: [1.0, 2.0, 3.0], identity: 7, handover: Handover::Leaves, ..Record::default() };
        let part = |records: &[Record]| records.iter().copied().collect::<DynamicGaussians>();
        let all = DynamicGaussians::concat(&[part(&[record]), part(&[]), part(&[Record::default(), record])]);
        assert_eq!(all, part(&[record, Record::default(), record]));
        assert_eq!((all.rgb_rate.len(), all.uneven()), (3, None));
    }

    #[test]
    fn a_colour_is_its_own_at_the_reference_time_and_linear_from_there() {
        let values = [0.0, -0.0, 1.0, 0.1, -0.3, 1e-45, 7.5, f32::MAX, -f32::MAX];
        for colour in values {
            for rate in values {
                for (reference, at) in [(Reference::Start, 0.0), (Reference::End, 1.0)] {
                    let r = Record { rgb: [colour; 3], rgb_rate: [rate; 3], reference, ..Record::default() };
                    assert_eq!(r.rgb_at(at).map(f32::to_bits), r.rgb.map(f32::to_bits), "{colour} {rate}");
                    let still = Record { rgb_rate: [-0.0, 0.0, -0.0], ..r };
                    for t in [0.0, 0.3, 1.0] {
                        assert_eq!(still.rgb_at(t).map(f32::to_bits), r.rgb.map(f32::to_bits), "{colour}");
                    }
                    // A colour that is finite at both ends is so between them.
                    assert!(!r.is_sound() || (0..=64).all(|i| r.rgb_at(i as f32 / 64.0)[0].is_finite()));
                }
            }
        }
        let warmer = Record { rgb: [0.5; 3], rgb_rate: [0.25, 0.0, -0.5], ..Record::default() };
        assert_eq!(warmer.rgb_at(0.5), [0.625, 0.5, 0.25]);
        assert_eq!(Record { reference: Reference::End, ..warmer }.rgb_at(0.5), [0.375, 0.5, 0.75]);
    }

    #[test]
    fn a_record_with_a_bad_number_is_not_sound() {
        assert!(Record::default().is_sound());
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            assert!(!Record { mean: [0.0, bad, 0.0], ..Record::default() }.is_sound());
            assert!(!Record { gamma: [0.0, bad], ..Record::default() }.is_sound());
            assert!(!Record { opacity: bad, ..Record::default() }.is_sound());
            assert!(!Record { rgb_rate: [0.0, 0.0, bad], ..Record::default() }.is_sound());
        }
        assert!(!Record { scale: [-1.0, 1.0], ..Record::default() }.is_sound());
        let bright = Record { rgb: [f32::MAX; 3], rgb_rate: [f32::MAX; 3], ..Record::default() };
        assert!(!bright.is_sound());
        assert!(!Record { rgb_rate: [-f32::MAX; 3], reference: Reference::End, ..bright }.is_sound());
        assert!(Record { reference: Reference::End, ..bright }.is_sound());
    }
}
