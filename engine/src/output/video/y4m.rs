//! The y4m writer: 4:4:4, 8 bits, full range, with the matrix by which [`crate::source::y4m`] reads pictures of their
//! size.

use crate::picture::Picture;
use crate::source::y4m::convert::Matrix;

/// The line before the first frame.
pub(super) fn header(width: usize, height: usize, fps: f64) -> String {
    let (numerator, denominator) = fraction(fps);
    format!("YUV4MPEG2 W{width} H{height} F{numerator}:{denominator} Ip A1:1 C444 XCOLORRANGE=FULL\n")
}

/// `FRAME` and the three planes.
pub(super) fn frame(picture: &Picture) -> Vec<u8> {
    let plane = picture.width * picture.height;
    let matrix = Matrix::of_size(picture.width, picture.height);
    let mut bytes = b"FRAME\n".to_vec();
    let start = bytes.len();
    bytes.resize(start + 3 * plane, 0);
    let planes = &mut bytes[start..];
    for i in 0..plane {
        let [y, b, r] = matrix.ycbcr([0, 1, 2].map(|c| picture.rgb[c * plane + i].clamp(0.0, 1.0)));
        // `as` saturates.
        planes[i] = (255.0 * y + 0.5) as u8;
        planes[plane + i] = (255.0 * b + 128.5) as u8;
        planes[2 * plane + i] = (255.0 * r + 128.5) as u8;
    }
    bytes
}

/// A frame rate as a fraction: exact where it is whole or n·1000/1001, else in millionths.
pub(super) fn fraction(fps: f64) -> (u64, u64) {
    for denominator in [1u64, 1001] {
        let numerator = fps * denominator as f64;
        let whole = numerator.round();
        if (1.0..4e9).contains(&whole) && (numerator - whole).abs() < 1e-6 * whole {
            return (whole as u64, denominator);
        }
    }
    ((fps.min(4000.0) * 1e6).round().max(1.0) as u64, 1_000_000)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_become_fractions() {
        assert_eq!(fraction(24.0), (24, 1));
        assert_eq!(fraction(30000.0 / 1001.0), (30000, 1001));
        assert_eq!(fraction(12.5), (12_500_000, 1_000_000));
    }
}
