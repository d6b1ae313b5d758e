//! How far two pictures differ, and where.
//!
//! Samples are compared in one order, and summed in binary64, so the figures are the same on every machine.
//!
//! Distances have one scale for every type ([`Samples::values`]): 1 is the full range of whole numbers (255, 65535,
//! 2³²−1), and 1 for floats and for whole numbers without a range. NaN is infinitely far from any number.

use crate::metrics;
use crate::picture::Picture;
use crate::samples::{Channel, Part, Samples};

/// A place at which two pictures differ.
#[derive(Clone, Debug, PartialEq)]
pub struct Place {
    /// Column of the sample in its channel.
    pub column: usize,
    /// Row of the sample in its channel.
    pub row: usize,
    /// The channel's name.
    pub channel: String,
    /// Both samples as they are stored.
    pub samples: [String; 2],
}

/// How far two pictures with the same channels differ.
#[derive(Clone, Debug, PartialEq)]
pub struct Difference {
    /// Greatest distance of two samples.
    pub largest: f64,
    /// The first place with that difference. `None` where all samples are equal: bit for bit if both are of one type,
    /// otherwise as numbers.
    pub place: Option<Place>,
    /// Share of pixels with a sample that differs, from 0 to 1.
    pub share: f64,
    /// Mean square of the distances of all samples.
    pub error: f64,
    /// Peak signal-to-noise ratio in dB, peak 1 ([`metrics::psnr_of`]).
    pub psnr: f64,
    /// Structural similarity ([`metrics::ssim`]), mean over the channels; `None` under 11 samples a side or if one is
    /// not finite.
    pub ssim: Option<f64>,
}

impl Difference {
    /// Compares two parts of one size with the same channels ([`crate::samples::pair`]).
    ///
    /// # Panics
    /// When numbers or sizes of the channels differ.
    pub fn between(a: &Part, b: &Part) -> Self {
        let mut differs = vec![false; a.width * a.height];
        let (mut largest, mut place, mut sum, mut count) = (-1.0, None, 0.0, 0_usize);
        let mut ssim = Some(0.0);
        assert_eq!(a.channels.len(), b.channels.len(), "the same channels");
        for (one, other) in a.channels.iter().zip(&b.channels) {
            assert_eq!((one.width, one.height), (other.width, other.height), "channels of one size");
            let (x, y) = (one.samples.values(), other.samples.values());
            for (at, (&x, &y)) in x.iter().zip(&y).enumerate() {
                let distance = one.samples.distance(&other.samples, at).unwrap_or_else(|| distance(x, y));
                let equal = one.samples.same_bits(&other.samples, at).unwrap_or(distance == 0.0);
                sum += distance * distance;
                if equal {
                    continue;
                }
                differs[pixel(a, one, at)] = true;
                if distance > largest {
                    (largest, place) = (distance, Some((one, other, at)));
                }
            }
            count += x.len();
            let own = (one.width >= metrics::WINDOW && one.height >= metrics::WINDOW)
                .then(|| metrics::ssim_of_plane(&x, &y, one.width, one.height));
            ssim = ssim.zip(own.filter(|own| own.is_finite())).map(|(sum, own)| sum + own);
        }
        let error = sum / count.max(1) as f64;
        let differing = differs.iter().filter(|d| **d).count();
        let place = place.map(|(one, other, at)| Place {
            column: at % one.width,
            row: at / one.width,
            channel: one.name.clone(),
            samples: [one.samples.text(at), other.samples.text(at)],
        });
        Difference {
            largest: f64::max(largest, 0.0),
            place,
            share: differing as f64 / differs.len().max(1) as f64,
            error,
            psnr: metrics::psnr_of(error),
            ssim: ssim.map(|sum| sum / a.channels.len().max(1) as f64),
        }
    }

    /// Returns true if all samples are equal.
    pub fn is_none(&self) -> bool {
        self.place.is_none()
    }
}

/// The pixel that contains a sample of a channel.
fn pixel(part: &Part, channel: &Channel, at: usize) -> usize {
    let (column, row) = (at % channel.width, at / channel.width);
    let scaled = |at: usize, side: usize, of: usize| (at * side / of.max(1)).min(side.saturating_sub(1));
    scaled(row, part.height, channel.height) * part.width + scaled(column, part.width, channel.width)
}

fn distance(x: f64, y: f64) -> f64 {
    // Infinities of one sign are equal numbers; so are two NaNs.
    if x == y || (x.is_nan() && y.is_nan()) {
        return 0.0;
    }
    let distance = (x - y).abs();
    if distance.is_nan() { f64::INFINITY } else { distance }
}

impl From<&Picture> for Part {
    fn from(picture: &Picture) -> Part {
        let Picture { width, height, ref rgb } = *picture;
        let plane = width * height;
        let channel = |(at, name): (usize, &str)| Channel {
            name: name.to_owned(),
            width,
            height,
            samples: Samples::F32(rgb[at * plane..(at + 1) * plane].to_vec()),
        };
        let channels = ["R", "G", "B"].into_iter().enumerate().map(channel).collect();
        Part {
            name: String::new(),
            width,
            height,
            channels,
            premultiplied: false,
            windows: None,
            shown: None,
            notes: Vec::new(),
        }
    }
}

/// Colours of the heat map, at equal steps from the least difference to the greatest.
const RAMP: [[f32; 3]; 5] =
    [[0.25, 0.05, 0.55], [0.65, 0.1, 0.55], [0.95, 0.3, 0.25], [1.0, 0.65, 0.1], [1.0, 1.0, 0.75]];
/// The difference at which the ramp ends.
const HOTTEST: f64 = 0.5;
/// Brightness of the picture under its heat map.
const UNDER: f32 = 0.3;

/// Draws where two pictures differ: over the first in dark grey, from violet (the least difference) through red to pale
/// yellow (half of the range and more). The ramp follows the square root, so that one step of 8 bits is visible.
///
/// # Panics
/// When numbers or sizes of the channels differ.
pub fn heat(a: &Part, b: &Part) -> Picture {
    let (width, height) = (a.width, a.height);
    let plane = width * height;
    let mut apart: Vec<Option<f64>> = vec![None; plane];
    let mut under = vec![0.0_f64; plane];
    let mut colours = 0.0;
    for (one, other) in a.channels.iter().zip(&b.channels) {
        let (x, y) = (one.samples.values(), other.samples.values());
        for (at, (&x, &y)) in x.iter().zip(&y).enumerate() {
            let far = distance(x, y);
            if !one.samples.same_bits(&other.samples, at).unwrap_or(far == 0.0) {
                let apart = &mut apart[pixel(a, one, at)];
                *apart = Some(apart.map_or(far, |before| before.max(far)));
            }
        }
        if one.name != "A" && x.len() == plane && colours < 3.0 {
            under
                .iter_mut()
                .zip(&x)
                .for_each(|(sum, value)| *sum += if value.is_finite() { value.clamp(0.0, 1.0) } else { 0.0 });
            colours += 1.0;
        }
    }
    let mut rgb = vec![0.0; 3 * plane];
    for (at, (apart, under)) in apart.iter().zip(&under).enumerate() {
        let colour = match apart {
            Some(far) => ramp((far / HOTTEST).min(1.0).sqrt() as f32),
            None => [UNDER * (under / f64::max(colours, 1.0)) as f32; 3],
        };
        for (channel, value) in colour.into_iter().enumerate() {
            rgb[channel * plane + at] = value;
        }
    }
    Picture { width, height, rgb }
}

fn ramp(t: f32) -> [f32; 3] {
    let at = t * (RAMP.len() - 1) as f32;
    let below = (at as usize).min(RAMP.len() - 2);
    let part = at - below as f32;
    std::array::from_fn(|c| RAMP[below][c] * (1.0 - part) + RAMP[below + 1][c] * part)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grey(width: usize, height: usize) -> Picture {
        Picture { width, height, rgb: vec![0.5; 3 * width * height] }
    }

    fn between(a: &Picture, b: &Picture) -> Difference {
        Difference::between(&a.into(), &b.into())
    }

    fn floats(values: &[f32]) -> Part {
        Part {
            channels: vec![Channel {
                name: "Z".to_owned(),
                width: values.len(),
                height: 1,
                samples: Samples::F32(values.to_vec()),
            }],
            ..Part::from(&grey(values.len(), 1))
        }
    }

    #[test]
    fn the_largest_difference_is_found_with_its_place_and_the_share_of_pixels() {
        let (a, mut b) = (grey(20, 15), grey(20, 15));
        assert!(between(&a, &b).is_none());
        b.rgb[20 * 15 + 3 * 20 + 7] = 0.75;
        b.rgb[2 * 20 * 15 + 3 * 20 + 7] = 0.4;
        b.rgb[5] = f32::from_bits(0.5_f32.to_bits() + 1);
        let found = between(&a, &b);
        let place = found.place.expect("a difference");
        assert_eq!((found.largest, place.column, place.row, place.channel.as_str()), (0.25, 7, 3, "G"));
        assert_eq!(place.samples, ["0.5", "0.75"]);
        assert_eq!(found.share, 2.0 / 300.0);
        assert_eq!(found.psnr, metrics::psnr(&a, &b).expect("one size"));
        assert_eq!(found.ssim, metrics::ssim(&a, &b).ok());
        assert!(found.ssim.is_some_and(|s| s < 1.0));
        assert_eq!(between(&grey(4, 4), &grey(4, 4)).ssim, None);
    }

    #[test]
    fn nothing_is_clamped_and_one_bit_is_a_difference() {
        let found = Difference::between(&floats(&[0.5, 2.0]), &floats(&[0.5, 7.0]));
        assert_eq!((found.largest, found.share), (5.0, 0.5));
        let next = f32::from_bits(2.0_f32.to_bits() + 1);
        assert!(!Difference::between(&floats(&[2.0]), &floats(&[next])).is_none());
        // Zeros of either sign are different bits and equal numbers.
        let found = Difference::between(&floats(&[0.0]), &floats(&[-0.0]));
        assert_eq!((found.largest, found.share, found.is_none()), (0.0, 1.0, false));
    }

    #[test]
    fn a_number_that_is_none_differs_from_every_number() {
        let (a, b) = (floats(&[1.0, f32::NAN, 3.0]), floats(&[1.0, 2.0, 3.0]));
        let found = Difference::between(&a, &b);
        assert_eq!((found.largest, found.psnr), (f64::INFINITY, f64::NEG_INFINITY));
        assert_eq!(found.place.map(|place| place.column), Some(1));
        assert!(Difference::between(&a, &a).is_none());
        assert!(Difference::between(&floats(&[f32::INFINITY]), &floats(&[f32::INFINITY])).is_none());
    }

    #[test]
    fn the_heat_map_is_dark_grey_where_nothing_differs_and_coloured_where_something_does() {
        let (a, mut b) = (grey(4, 2), grey(4, 2));
        b.rgb[1] = 0.5 + 1.0 / 255.0;
        b.rgb[2] = 1.0;
        let heat = heat(&(&a).into(), &(&b).into());
        let at = |pixel: usize| -> [f32; 3] { std::array::from_fn(|c| heat.rgb[c * 8 + pixel]) };
        assert_eq!(at(0), [0.15; 3]);
        assert!(at(1)[2] > 0.5 && at(1)[1] < 0.1, "{:?}", at(1));
        assert_eq!(at(2), RAMP[4]);
    }
}
