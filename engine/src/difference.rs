//! How far two pictures are apart, and where.
//!
//! Samples are compared in one order, in binary64 where they are added, so the figures are the same on every machine.

use crate::metrics::{self, MetricError};
use crate::picture::Picture;

/// Names of the planes.
pub const CHANNELS: [&str; 3] = ["red", "green", "blue"];

/// How far two pictures of one size are apart.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Difference {
    /// Greatest absolute difference of two samples; 1 is from black to white. NaN counts as 1 beside a number.
    pub largest: f32,
    /// The first place that has it: column, row, and channel (0 red, 1 green, 2 blue). `None` where all samples are equal.
    pub place: Option<[usize; 3]>,
    /// Share of pixels of which a sample differs, from 0 to 1.
    pub share: f64,
    /// Peak signal-to-noise ratio in dB ([`metrics::psnr`]).
    pub psnr: f64,
    /// Structural similarity ([`metrics::ssim`]); `None` under 11 pixels a side.
    pub ssim: Option<f64>,
}

impl Difference {
    /// Compares two pictures.
    ///
    /// # Errors
    /// Different sizes.
    pub fn between(a: &Picture, b: &Picture) -> Result<Self, MetricError> {
        metrics::check_sizes(a, b)?;
        let plane = a.width * a.height;
        let mut differs = vec![false; plane];
        let (mut largest, mut place) = (0.0, None);
        for (i, (&x, &y)) in a.rgb.iter().zip(&b.rgb).enumerate() {
            let distance = distance(x, y);
            if distance > 0.0 {
                differs[i % plane] = true;
            }
            if distance > largest {
                let pixel = i % plane;
                (largest, place) = (distance, Some([pixel % a.width, pixel / a.width, i / plane]));
            }
        }
        let count = differs.iter().filter(|d| **d).count();
        Ok(Self {
            largest,
            place,
            share: count as f64 / plane.max(1) as f64,
            psnr: metrics::psnr(a, b)?,
            ssim: metrics::ssim(a, b).ok(),
        })
    }

    /// Returns true if all samples are equal.
    pub fn is_none(&self) -> bool {
        self.place.is_none()
    }
}

fn distance(x: f32, y: f32) -> f32 {
    match (x.is_nan(), y.is_nan()) {
        (true, true) => 0.0,
        (false, false) => (x - y).abs(),
        _ => 1.0,
    }
}

/// Colours of the heat map, at equal steps from the least difference to the greatest.
const RAMP: [[f32; 3]; 5] =
    [[0.25, 0.05, 0.55], [0.65, 0.1, 0.55], [0.95, 0.3, 0.25], [1.0, 0.65, 0.1], [1.0, 1.0, 0.75]];
/// The difference that has the ramp's last colour.
const HOTTEST: f32 = 0.5;
/// How bright the picture is under its heat map.
const UNDER: f32 = 0.3;

/// A picture of where two pictures differ: over the first in dark grey, from violet (the least difference) through red to
/// pale yellow (half of the range and more). The ramp follows the square root, so that one step of 8 bits can be seen.
///
/// # Errors
/// Different sizes.
pub fn heat(a: &Picture, b: &Picture) -> Result<Picture, MetricError> {
    metrics::check_sizes(a, b)?;
    let plane = a.width * a.height;
    let mut rgb = vec![0.0; 3 * plane];
    for pixel in 0..plane {
        let at = |p: &Picture, channel: usize| p.rgb[channel * plane + pixel];
        let largest = (0..3).map(|c| distance(at(a, c), at(b, c))).fold(0.0, f32::max);
        let colour = if largest > 0.0 {
            ramp((largest / HOTTEST).min(1.0).sqrt())
        } else {
            [UNDER * (at(a, 0) + at(a, 1) + at(a, 2)) / 3.0; 3]
        };
        for channel in 0..3 {
            rgb[channel * plane + pixel] = colour[channel];
        }
    }
    Ok(Picture { width: a.width, height: a.height, rgb })
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

    #[test]
    fn the_largest_difference_is_found_with_its_place_and_the_share_of_pixels() {
        let (a, mut b) = (grey(20, 15), grey(20, 15));
        assert!(Difference::between(&a, &b).expect("one size").is_none());
        b.rgb[20 * 15 + 3 * 20 + 7] = 0.75;
        b.rgb[2 * 20 * 15 + 3 * 20 + 7] = 0.4;
        b.rgb[5] = f32::from_bits(0.5_f32.to_bits() + 1);
        let found = Difference::between(&a, &b).expect("one size");
        assert_eq!((found.largest, found.place), (0.25, Some([7, 3, 1])));
        assert_eq!(found.share, 2.0 / 300.0);
        assert_eq!(found.psnr, metrics::psnr(&a, &b).expect("one size"));
        assert!(found.ssim.is_some_and(|s| s < 1.0));
        assert!(Difference::between(&a, &grey(15, 20)).is_err());
        assert_eq!(Difference::between(&grey(4, 4), &grey(4, 4)).expect("one size").ssim, None);
    }

    #[test]
    fn a_number_that_is_none_differs_from_every_number() {
        let (mut a, b) = (grey(3, 3), grey(3, 3));
        a.rgb[4] = f32::NAN;
        assert_eq!(Difference::between(&a, &b).expect("one size").place, Some([1, 1, 0]));
        assert!(Difference::between(&a, &a).expect("one size").is_none());
    }

    #[test]
    fn the_heat_map_is_dark_grey_where_nothing_differs_and_coloured_where_something_does() {
        let (a, mut b) = (grey(4, 2), grey(4, 2));
        b.rgb[1] = 0.5 + 1.0 / 255.0;
        b.rgb[2] = 1.0;
        let heat = heat(&a, &b).expect("one size");
        let at = |pixel: usize| -> [f32; 3] { std::array::from_fn(|c| heat.rgb[c * 8 + pixel]) };
        assert_eq!(at(0), [0.15; 3]);
        assert!(at(1)[2] > 0.5 && at(1)[1] < 0.1, "{:?}", at(1));
        assert_eq!(at(2), RAMP[4]);
    }
}
