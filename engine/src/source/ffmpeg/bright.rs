//! Brightness of high-dynamic-range video. It decides which light level becomes white in standard range.

use std::path::Path;

use super::program;

/// Up to one sample in this many may be brighter than white.
const RARE: usize = 500;
/// Number of frames inspected, one per second, and their size in samples.
const LOOKED_AT: (usize, usize) = (20, 64 * 36);

/// Returns the HLG sample, 0 to 1, that a display of 1000 cd/m² shows as grey of `light` cd/m².
pub(super) fn hlg(light: f64) -> f64 {
    let scene = (light / 1000.0).powf(1.0 / 1.2);
    if scene <= 1.0 / 12.0 {
        (3.0 * scene).sqrt()
    } else {
        0.178_832_77 * (12.0 * scene - 0.284_668_92).ln() + 0.559_910_73
    }
}

/// Returns the PQ sample, 0 to 1, of `light` cd/m².
pub(super) fn pq(light: f64) -> f64 {
    let y = (light / 10_000.0).powf(2610.0 / 16384.0);
    let (c1, c2, c3) = (3424.0 / 4096.0, 2413.0 / 128.0, 2392.0 / 128.0);
    ((c1 + c2 * y) / (1.0 + c3 * y)).powf(2523.0 / 32.0)
}

/// Returns true if more than one luma sample in [`RARE`] is above `white`, which is 0 to 1 of the limited range.
pub(super) fn looks_brighter(path: &Path, stream: &str, white: f64) -> bool {
    let (frames, size) = LOOKED_AT;
    // A conversion to a grey format would change the range.
    let filter = "fps=1:round=up,scale=64:36:flags=area:in_range=tv:out_range=tv,format=yuv444p16le,extractplanes=y";
    let samples = program::samples(path, stream, filter, frames, 2 * size * frames);
    // Limited range, 16 to 235 of 255, three hundredths above white for rounding and ringing.
    let threshold = (16.0 + 219.0 * (1.03 * white)) * 256.0;
    let (words, _) = samples.as_chunks::<2>();
    let bright = words.iter().filter(|word| f64::from(u16::from_le_bytes(**word)) > threshold).count();
    bright * RARE > words.len()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curves_of_high_dynamic_range_have_the_values_of_their_standards() {
        // ITU-R BT.2408, table 1: white of 203 cd/m² is 75 % of HLG and 58 % of PQ.
        assert!((hlg(203.0) - 0.75).abs() < 0.005 && (pq(203.0) - 0.58).abs() < 0.005, "{} {}", hlg(203.0), pq(203.0));
        assert!((hlg(1000.0) - 1.0).abs() < 1e-6 && (pq(10_000.0) - 1.0).abs() < 1e-6);
    }
}
