//! A picture in memory: three planes of display-referred colour.

use streamsplat_kernels::Level;

use crate::fit::{Fit, Placement};

/// Maximum width or height of a picture, in pixels.
pub const MAX_SIDE: usize = 32_768;

/// Maximum number of pixels of a picture (a 16:9 picture of 10,922 × 6,144); its three f32 planes take 768 MiB.
pub const MAX_PIXELS: usize = 1 << 26;

/// RGB in display (gamma) space, nominally in `[0, 1]`, as three planes `[3, height, width]`, row-major.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `3 · height · width` samples: the red plane, then green, then blue.
    pub rgb: Vec<f32>,
}

/// Returns true if a picture of this size may be decoded: at least one pixel, within [`MAX_SIDE`] and [`MAX_PIXELS`].
///
/// Checked before memory for the samples is allocated.
pub fn size_is_allowed(width: usize, height: usize) -> bool {
    (1..=MAX_SIDE).contains(&width) && (1..=MAX_SIDE).contains(&height) && width * height <= MAX_PIXELS
}

impl AsRef<Picture> for Picture {
    fn as_ref(&self) -> &Picture {
        self
    }
}

impl Picture {
    /// Returns a picture of these planes; `None` unless `rgb` holds `3 · width · height` samples.
    pub fn new(width: usize, height: usize, rgb: Vec<f32>) -> Option<Picture> {
        let samples = width.checked_mul(height)?.checked_mul(3)?;
        (rgb.len() == samples).then_some(Picture { width, height, rgb })
    }

    /// Resizes the picture bilinearly.
    ///
    /// # Panics
    /// If a side is zero.
    pub fn resized(&self, width: usize, height: usize) -> Picture {
        if (self.width, self.height) == (width, height) {
            return self.clone();
        }
        let rgb = resize_planes(&self.rgb, [self.height, self.width], [height, width]);
        Picture { width, height, rgb }
    }

    /// Converts to interleaved 8-bit samples: each clamped to `[0, 1]`, times 255, rounded half up. NaN becomes 0.
    pub fn to_rgb8(&self) -> Vec<u8> {
        let plane = self.width * self.height;
        let mut bytes = vec![0u8; 3 * plane];
        for (channel, samples) in self.rgb.chunks_exact(plane.max(1)).enumerate() {
            for (pixel, &value) in samples.iter().enumerate() {
                bytes[3 * pixel + channel] = to_u8(value);
            }
        }
        bytes
    }

    /// Converts interleaved 8-bit samples, each divided by 255, to a picture.
    pub fn from_rgb8(width: usize, height: usize, bytes: &[u8]) -> Option<Picture> {
        let plane = width.checked_mul(height)?;
        if bytes.len() != plane.checked_mul(3)? {
            return None;
        }
        let mut rgb = vec![0.0; 3 * plane];
        for (pixel, samples) in bytes.chunks_exact(3).enumerate() {
            for channel in 0..3 {
                rgb[channel * plane + pixel] = f32::from(samples[channel]) / 255.0;
            }
        }
        Some(Picture { width, height, rgb })
    }
}

/// Resizes planes of `[height, width]` bilinearly (half-pixel centres), as frames are resized to a model's size.
///
/// # Panics
/// If a side is zero or `planes` does not hold whole planes.
pub fn resize_planes(planes: &[f32], from: [usize; 2], to: [usize; 2]) -> Vec<f32> {
    match Placement::new(Fit::Stretch, from, to) {
        Some(placement) => placement.fit_in(Level::detect(), planes),
        None => panic!("expected sides of at least one pixel, found {from:?} and {to:?}"),
    }
}

/// Returns `value` clamped to `[0, 1]`, times 255, rounded half up; NaN becomes 0.
pub fn to_u8(value: f32) -> u8 {
    // `as` saturates and maps NaN to 0.
    (value.clamp(0.0, 1.0) * 255.0 + 0.5) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eight_bit_samples_survive_the_way_through_f32() {
        let bytes: Vec<u8> = (0..=255).flat_map(|v| [v, 255 - v, v ^ 0x55]).collect();
        let picture = Picture::from_rgb8(16, 16, &bytes).expect("256 pixels");
        assert_eq!(picture.to_rgb8(), bytes);
    }

    #[test]
    fn values_outside_the_unit_interval_are_clamped_and_nan_is_black() {
        assert_eq!([-1.0, 2.0, f32::NAN, f32::INFINITY, 0.5].map(to_u8), [0, 255, 0, 255, 128]);
    }

    #[test]
    fn hostile_sizes_are_refused_before_memory_is_taken() {
        assert!(size_is_allowed(1, 1) && size_is_allowed(3840, 2160));
        assert!(!size_is_allowed(0, 7) && !size_is_allowed(MAX_SIDE, MAX_SIDE) && !size_is_allowed(usize::MAX, 2));
    }
}
