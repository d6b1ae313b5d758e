//! The 32-byte records of web viewers (`.splat`), which have no header.
//!
//! | bytes | value |
//! |---|---|
//! | 12 | centre: three binary32, little-endian |
//! | 12 | standard deviations, likewise |
//! | 4 | red, green, blue and opacity, over 255 |
//! | 4 | rotation, w first: `(b − 128) / 128` |
//!
//! Colours become `(c − ½) / Y₀`. Opacities of 0 and 1 become values within 10⁻¹² of them, and standard deviations are
//! at least 10⁻¹².
//!
//! Source: antimatter15's viewer, where the format comes from.

mod write;

use std::path::Path;

use streamsplat_kernels::harmonics::Y0;
use streamsplat_kernels::math::f64::ln;

use super::{FormatError, Limits};
use crate::still::{LEAST, Still};
pub use write::{of_snapshot, write};

/// Bytes of a record.
const RECORD: usize = 32;

/// Reads the Gaussians of a whole `.splat` file.
///
/// # Errors
/// A length that is not a multiple of 32 bytes, or a negative scale: signs of a file of another format.
pub fn read(bytes: &[u8]) -> Result<Still, FormatError> {
    within(bytes, &Limits::default())
}

/// Returns true if a file with this name and these first bytes has the format.
pub(super) fn is(path: &Path, _head: &[u8]) -> bool {
    path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("splat"))
}

/// Reads a file as [`read`] does, within other limits.
pub(super) fn within(bytes: &[u8], limits: &Limits) -> Result<Still, FormatError> {
    let (records, rest) = bytes.as_chunks::<RECORD>();
    if !rest.is_empty() {
        return Err(FormatError::new("file", format!("records of {RECORD} bytes"), format!("{} bytes", bytes.len())));
    }
    limits.check_still("records", records.len(), 0, bytes.len() as u64)?;
    let mut still = Still::with_room(records.len(), 0);
    for (i, record) in records.iter().enumerate() {
        let float = |k: usize| record[4 * k..].first_chunk().map_or(f32::NAN, |b| f32::from_le_bytes(*b));
        let scale: [f32; 3] = std::array::from_fn(|axis| float(3 + axis));
        if scale.iter().any(|s| *s < 0.0) {
            let found = format!("{scale:?}");
            return Err(FormatError::new(format!("record {i}"), "standard deviations of 0 or more", found));
        }
        still.mean.push(std::array::from_fn(float));
        still.log_scale.push(scale.map(deviation));
        let (base, logit) = colour(std::array::from_fn(|k| record[24 + k]));
        still.base.push(base);
        still.logit.push(logit);
        still.rotation.push(std::array::from_fn(|k| (f32::from(record[28 + k]) - 128.0) / 128.0));
    }
    Ok(still)
}

/// Returns the logarithm of a standard deviation. NaN stays NaN; drawing leaves that Gaussian out.
pub(super) fn deviation(scale: f32) -> f32 {
    if scale.is_nan() { scale } else { ln(f64::from(scale).max(LEAST)) as f32 }
}

/// Converts red, green, blue and opacity, each over 255, to the harmonics' first coefficients and the opacity's logit.
pub(super) fn colour(rgba: [u8; 4]) -> ([f32; 3], f32) {
    let [red, green, blue, alpha] = rgba.map(|byte| f64::from(byte) / 255.0);
    let opacity = alpha.clamp(LEAST, 1.0 - LEAST);
    ([red, green, blue].map(|c| ((c - 0.5) / Y0) as f32), (ln(opacity) - ln(1.0 - opacity)) as f32)
}

#[cfg(test)]
mod tests {
    use streamsplat_kernels::Level;

    use super::*;
    use crate::camera::Rotation;
    use crate::formats;
    use crate::still::Drawable;
    use crate::stream::Workers;

    #[test]
    fn a_record_says_all_of_a_gaussian() {
        let mut record: Vec<u8> =
            [1.0_f32, -2.0, 3.0, 0.5, 1.0, 0.0].iter().flat_map(|x: &f32| x.to_le_bytes()).collect();
        record.extend([0, 128, 255, 255, 255, 128, 64, 0]);
        let found = read(&record).expect("a record");
        assert_eq!((found.mean[0], found.rotation[0]), ([1.0, -2.0, 3.0], [0.992_187_5, 0.0, -0.5, -1.0]));
        assert!((found.log_scale[0][0] - 0.5_f32.ln()).abs() < 1e-7 && found.log_scale[0][1] == 0.0);
        assert!(found.log_scale[0][2] < -27.0 && found.logit[0] > 27.0 && found.logit[0].is_finite());
        let seen = found.base[0].map(|c| 255.0 * (0.5 + f64::from(c) * Y0));
        assert!(seen.iter().zip([0.0, 128.0, 255.0]).all(|(a, b)| (a - b).abs() < 1e-3));
        assert_eq!(read(&[]), Ok(Still::default()));
    }

    #[test]
    fn a_scene_comes_back_within_its_precision() {
        let value = |i: usize, k: usize| ((i * 7919 + k * 104_729) % 1009) as f32 / 504.5 - 1.0;
        let count = 300;
        let still = Still {
            mean: (0..count).map(|i| std::array::from_fn(|k| 100.0 * value(i, k))).collect(),
            log_scale: (0..count).map(|i| std::array::from_fn(|k| -3.0 + 4.0 * value(i, 3 + k))).collect(),
            rotation: (0..count).map(|i| std::array::from_fn(|k| 3.0 * value(i, 6 + k))).collect(),
            logit: (0..count).map(|i| 5.0 * value(i, 10)).collect(),
            base: (0..count).map(|i| std::array::from_fn(|k| 1.7 * value(i, 11 + k))).collect(),
            degree: 1,
            higher: vec![0.1; count * 9],
            ..Still::default()
        };
        let workers = Workers::new(Level::scalar(), 1).expect("a thread");
        let drawable = |still: &Still| Drawable::new(still.clone(), &workers).expect("even arrays");
        let (whole, file) = (drawable(&still), formats::splat::write(&drawable(&still)).bytes);
        let found = read(&file).expect("just written");
        assert_eq!((found.len(), found.degree, found.uneven()), (count, 0, None));
        let again = drawable(&found);
        assert!(found.mean == still.mean, "positions are exact");
        for i in 0..count {
            for axis in 0..3 {
                // Sizes are exact in the file; their logarithms are rounded once.
                let (log, expected) = (found.log_scale[i][axis], still.log_scale[i][axis]);
                assert!((log - expected).abs() <= 4.0 * f32::EPSILON * expected.abs().max(1.0), "{log} {expected}");
                let colour = |still: &Still| 0.5 + still.base[i][axis] * Y0 as f32;
                assert!((colour(&found) - colour(&still)).abs() <= 0.501 / 255.0);
            }
            assert!((again.opacity()[i] - whole.opacity()[i]).abs() <= 0.501 / 255.0);
            let turn = |q: [f32; 4]| Rotation::from_quaternion(q.map(f64::from)).expect("a length").quaternion();
            let (a, b) = (turn(found.rotation[i]), turn(still.rotation[i]));
            let cosine: f64 = a.iter().zip(b).map(|(a, b)| a * b).sum();
            assert!(cosine.abs() > 1.0 - 1e-4, "{cosine}");
        }
        // Writing the scene again returns the same bytes.
        assert!(formats::splat::write(&again).bytes[..28] == file[..28]);
    }

    #[test]
    fn other_lengths_negative_scales_and_too_many_are_refused() {
        for length in [1, 31, 33] {
            let error = read(&vec![0; length]).expect_err("uneven").to_string();
            assert_eq!(error, format!("file: expected records of 32 bytes, found {length} bytes"));
        }
        let mut negative = vec![0; 64];
        negative[32 + 12..32 + 16].copy_from_slice(&(-1.0_f32).to_le_bytes());
        assert!(
            read(&negative).expect_err("negative").to_string().starts_with("record 1: expected standard deviations")
        );
        let error = within(&[0; 96], &Limits { gaussians: 2, ..Limits::default() }).expect_err("too many").to_string();
        assert!(error.starts_with("records: expected at most 2 Gaussians") && error.ends_with("found 3"), "{error}");
    }
}
