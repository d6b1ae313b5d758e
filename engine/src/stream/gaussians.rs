//! The dynamic Gaussians of one interval, one array per property.

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

/// The record of one Gaussian over one interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Record {
    /// Position at the reference time, world axes (x right, y normalised inverse depth, z up).
    pub mean: [f32; 3],
    /// World units per interval.
    pub velocity: [f32; 3],
    /// (γ₀, γ₁) of [`motion::opacity_factor`].
    pub gamma: [f32; 2],
    /// Opacity at the reference time.
    pub opacity: f32,
    /// Standard deviations (s_x, s_z).
    pub scale: [f32; 2],
    /// The standard deviation along the axis of view, in scene space, over the mean of the other two; the network's is
    /// 1.
    pub thickness: f32,
    /// Display-space colour at the reference time.
    pub rgb: [f32; 3],
    /// Change of colour per interval; the network's is zero.
    pub rgb_rate: [f32; 3],
    /// Identity of the object that it shows: 64-bit, never reused.
    pub identity: u64,
    /// The key frame in which the identity was first seen.
    pub birth: u64,
    /// The key frame that reconstructed this record.
    pub frame: u64,
    /// From `mean` to the tracked point of the identity.
    pub offset: [f32; 3],
    /// Which end of the interval `mean`, `opacity` and `rgb` belong to.
    pub reference: Reference,
    /// Fade in or out at an end of the interval.
    pub handover: Handover,
}

impl Default for Record {
    /// A record of zeros, except for the network's thickness.
    fn default() -> Self {
        Self {
            mean: [0.0; 3],
            velocity: [0.0; 3],
            gamma: [0.0; 2],
            opacity: 0.0,
            scale: [0.0; 2],
            thickness: 1.0,
            rgb: [0.0; 3],
            rgb_rate: [0.0; 3],
            identity: 0,
            birth: 0,
            frame: 0,
            offset: [0.0; 3],
            reference: Reference::default(),
            handover: Handover::default(),
        }
    }
}

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

    /// Returns true if every number is finite, as [`motion::opacity_factor`] requires, the colour is finite throughout
    /// the interval, and no γ, scale, thickness or opacity is negative.
    pub fn is_sound(&self) -> bool {
        // Between the ends every rounded colour is between theirs.
        let any_sign =
            [self.mean, self.velocity, self.rgb, self.rgb_rate, self.rgb_at(0.0), self.rgb_at(1.0), self.offset];
        let [sx, sz] = self.scale;
        let not_negative = [self.gamma[0], self.gamma[1], sx, sz, self.thickness, self.opacity];
        // 0·x is 0 for finite numbers and NaN for others; no branch for each number.
        let undefined: f32 = any_sign.as_flattened().iter().chain(&not_negative).map(|x| 0.0 * x).sum();
        undefined == 0.0 && not_negative.iter().all(|x| *x >= 0.0)
    }
}

/// The Gaussians of an interval, in drawing order (among equals in depth): survivors, the frame at its start, the frame
/// at its end.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DynamicGaussians {
    /// See [`Record::mean`].
    pub mean: Vec<[f32; 3]>,
    /// See [`Record::velocity`].
    pub velocity: Vec<[f32; 3]>,
    /// See [`Record::gamma`].
    pub gamma: Vec<[f32; 2]>,
    /// See [`Record::opacity`].
    pub opacity: Vec<f32>,
    /// See [`Record::scale`].
    pub scale: Vec<[f32; 2]>,
    /// See [`Record::thickness`].
    pub thickness: Vec<f32>,
    /// See [`Record::rgb`].
    pub rgb: Vec<[f32; 3]>,
    /// See [`Record::rgb_rate`].
    pub rgb_rate: Vec<[f32; 3]>,
    /// See [`Record::identity`].
    pub identity: Vec<u64>,
    /// See [`Record::birth`].
    pub birth: Vec<u64>,
    /// See [`Record::frame`].
    pub frame: Vec<u64>,
    /// See [`Record::offset`].
    pub offset: Vec<[f32; 3]>,
    /// See [`Record::reference`].
    pub reference: Vec<Reference>,
    /// See [`Record::handover`].
    pub handover: Vec<Handover>,
}

impl DynamicGaussians {
    /// Room for `count` records.
    pub fn with_capacity(count: usize) -> Self {
        Self {
            mean: Vec::with_capacity(count),
            velocity: Vec::with_capacity(count),
            gamma: Vec::with_capacity(count),
            opacity: Vec::with_capacity(count),
            scale: Vec::with_capacity(count),
            thickness: Vec::with_capacity(count),
            rgb: Vec::with_capacity(count),
            rgb_rate: Vec::with_capacity(count),
            identity: Vec::with_capacity(count),
            birth: Vec::with_capacity(count),
            frame: Vec::with_capacity(count),
            offset: Vec::with_capacity(count),
            reference: Vec::with_capacity(count),
            handover: Vec::with_capacity(count),
        }
    }

    /// The records of all `parts`, one part after the other.
    pub(crate) fn concat(parts: &[Self]) -> Self {
        fn all<'a, T: Copy + 'a>(
            parts: &'a [DynamicGaussians],
            array: impl Fn(&'a DynamicGaussians) -> &'a Vec<T>,
        ) -> Vec<T> {
            let mut out = Vec::with_capacity(parts.iter().map(|part| array(part).len()).sum());
            parts.iter().for_each(|part| out.extend_from_slice(array(part)));
            out
        }
        Self {
            mean: all(parts, |part| &part.mean),
            velocity: all(parts, |part| &part.velocity),
            gamma: all(parts, |part| &part.gamma),
            opacity: all(parts, |part| &part.opacity),
            scale: all(parts, |part| &part.scale),
            thickness: all(parts, |part| &part.thickness),
            rgb: all(parts, |part| &part.rgb),
            rgb_rate: all(parts, |part| &part.rgb_rate),
            identity: all(parts, |part| &part.identity),
            birth: all(parts, |part| &part.birth),
            frame: all(parts, |part| &part.frame),
            offset: all(parts, |part| &part.offset),
            reference: all(parts, |part| &part.reference),
            handover: all(parts, |part| &part.handover),
        }
    }

    /// Number of records.
    pub fn len(&self) -> usize {
        self.mean.len()
    }

    /// Returns true if there is none.
    pub fn is_empty(&self) -> bool {
        self.mean.is_empty()
    }

    /// Appends a record.
    pub fn push(&mut self, r: Record) {
        self.mean.push(r.mean);
        self.velocity.push(r.velocity);
        self.gamma.push(r.gamma);
        self.opacity.push(r.opacity);
        self.scale.push(r.scale);
        self.thickness.push(r.thickness);
        self.rgb.push(r.rgb);
        self.rgb_rate.push(r.rgb_rate);
        self.identity.push(r.identity);
        self.birth.push(r.birth);
        self.frame.push(r.frame);
        self.offset.push(r.offset);
        self.reference.push(r.reference);
        self.handover.push(r.handover);
    }

    /// Returns record `i`. Panics when there are fewer, or when an array is shorter than `mean`.
    pub fn get(&self, i: usize) -> Record {
        Record {
            mean: self.mean[i],
            velocity: self.velocity[i],
            gamma: self.gamma[i],
            opacity: self.opacity[i],
            scale: self.scale[i],
            thickness: self.thickness[i],
            rgb: self.rgb[i],
            rgb_rate: self.rgb_rate[i],
            identity: self.identity[i],
            birth: self.birth[i],
            frame: self.frame[i],
            offset: self.offset[i],
            reference: self.reference[i],
            handover: self.handover[i],
        }
    }

    /// The records in order.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = Record> + '_ {
        (0..self.len()).map(|i| self.get(i))
    }

    /// The name and length of an array that has another length than `mean`, if any.
    pub fn uneven(&self) -> Option<(&'static str, usize)> {
        let lengths = [
            ("velocity", self.velocity.len()),
            ("gamma", self.gamma.len()),
            ("opacity", self.opacity.len()),
            ("scale", self.scale.len()),
            ("thickness", self.thickness.len()),
            ("rgb", self.rgb.len()),
            ("rgb_rate", self.rgb_rate.len()),
            ("identity", self.identity.len()),
            ("birth", self.birth.len()),
            ("frame", self.frame.len()),
            ("offset", self.offset.len()),
            ("reference", self.reference.len()),
            ("handover", self.handover.len()),
        ];
        lengths.into_iter().find(|(_, len)| *len != self.len())
    }
}

impl FromIterator<Record> for DynamicGaussians {
    fn from_iter<I: IntoIterator<Item = Record>>(records: I) -> Self {
        let records = records.into_iter();
        let mut out = Self::with_capacity(records.size_hint().0);
        records.for_each(|r| out.push(r));
        out
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
        }
        assert_eq!(Handover::from_code(2), Some(Handover::Leaves));
        assert_eq!(Reference::from_code(1), Some(Reference::End));
    }

    #[test]
    fn records_come_back_as_they_went_in() {
        let record = Record { mean: [1.0, 2.0, 3.0], identity: 7, handover: Handover::Leaves, ..Record::default() };
        let all: DynamicGaussians = [Record::default(), record].into_iter().collect();
        assert_eq!(all.get(1), record);
        assert_eq!(all.uneven(), None);
        let mut short = all;
        short.rgb.pop();
        assert_eq!(short.uneven(), Some(("rgb", 1)));
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
