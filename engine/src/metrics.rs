//! How close two pictures are: PSNR and SSIM, in f64, in one fixed order of operations.
//!
//! - `PSNR = −10 log₁₀(MSE)` over all samples of the three channels, peak 1, at most [`PSNR_CAP`], the value of
//!   identical pictures.
//! - SSIM after Wang et al. (2004) as scikit-image 0.26 computes `structural_similarity(win_size=11,
//!   gaussian_weights=True, channel_axis=2, data_range=1)`. The window is a Gaussian of σ = 1.5, cut at radius 5 and
//!   normalised; covariances are sample covariances (factor `n/(n−1)` with n = 11², its default); `C1 = 0.01²`, `C2 =
//!   0.03²`. The result is the mean over the pixels at least 5 away from every border, then over the channels. (Its
//!   reflected padding has no effect on these pixels.)

use crate::picture::Picture;

/// The PSNR of identical pictures, and of any whose mean square error is under 10⁻¹⁰, in dB.
pub const PSNR_CAP: f64 = 100.0;

const RADIUS: usize = 5;
/// Samples per side of the window of [`ssim`].
pub(crate) const WINDOW: usize = 2 * RADIUS + 1;

/// `exp(−x²/(2·1.5²))` for x = −5…5, not normalised; written out because a library's `exp` may differ between machines.
const WEIGHTS: [f64; WINDOW] = [
    0.0038659201394728076,
    0.028565500784550377,
    0.1353352832366127,
    0.41111229050718745,
    0.8007374029168081,
    1.0,
    0.8007374029168081,
    0.41111229050718745,
    0.1353352832366127,
    0.028565500784550377,
    0.0038659201394728076,
];

/// Pictures that cannot be compared.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MetricError {
    /// Different sizes.
    #[error("expected two pictures of one size, found {}×{} and {}×{}", .0.0, .0.1, .1.0, .1.1)]
    Sizes((usize, usize), (usize, usize)),
    /// Smaller than the window of SSIM.
    #[error("expected at least 11×11 pixels for SSIM, found {0}×{1}")]
    TooSmall(usize, usize),
}

/// Returns an error unless both have the same size.
pub(crate) fn check_sizes(a: &Picture, b: &Picture) -> Result<(), MetricError> {
    let size = |p: &Picture| (p.width, p.height);
    if size(a) == size(b) { Ok(()) } else { Err(MetricError::Sizes(size(a), size(b))) }
}

/// Mean square error over all samples, summed plane by plane in row-major order.
///
/// # Errors
/// Different sizes.
pub fn mean_square_error(a: &Picture, b: &Picture) -> Result<f64, MetricError> {
    check_sizes(a, b)?;
    let mut sum = 0.0;
    for (&x, &y) in a.rgb.iter().zip(&b.rgb) {
        let difference = f64::from(x) - f64::from(y);
        sum += difference * difference;
    }
    Ok(sum / a.rgb.len().max(1) as f64)
}

/// Peak signal-to-noise ratio in dB, peak 1; at most 100, and −∞ where a sample is not finite.
///
/// # Errors
/// Different sizes.
pub fn psnr(a: &Picture, b: &Picture) -> Result<f64, MetricError> {
    mean_square_error(a, b).map(psnr_of)
}

/// PSNR of a mean square error; −∞ if that is not finite.
pub fn psnr_of(error: f64) -> f64 {
    if !error.is_finite() {
        return f64::NEG_INFINITY;
    }
    if error > 1e-10 { (-10.0 * log10(error)).min(PSNR_CAP) } else { PSNR_CAP }
}

/// Structural similarity, mean over the channels.
///
/// # Errors
/// Different sizes, or fewer than 11 pixels a side.
pub fn ssim(a: &Picture, b: &Picture) -> Result<f64, MetricError> {
    check_sizes(a, b)?;
    let (width, height) = (a.width, a.height);
    if width < WINDOW || height < WINDOW {
        return Err(MetricError::TooSmall(width, height));
    }
    let plane = width * height;
    let wide = |samples: &[f32]| samples.iter().map(|&v| f64::from(v)).collect::<Vec<f64>>();
    let planes = a.rgb.chunks_exact(plane).zip(b.rgb.chunks_exact(plane));
    let sum: f64 =
        planes.map(|(x, y)| ssim_of_plane(&wide(x), &wide(y), width, height)).fold(0.0, |sum, own| sum + own);
    Ok(sum / 3.0)
}

/// Structural similarity of one channel of at least 11 samples a side.
pub(crate) fn ssim_of_plane(x: &[f64], y: &[f64], width: usize, height: usize) -> f64 {
    let total: f64 = WEIGHTS.iter().sum();
    let weights = WEIGHTS.map(|w| w / total);
    let count = (WINDOW * WINDOW) as f64;
    let covariance = count / (count - 1.0);
    let (c1, c2) = (0.01 * 0.01, 0.03 * 0.03);
    let blur = |value: &dyn Fn(f64, f64) -> f64| {
        let samples: Vec<f64> = x.iter().zip(y).map(|(&x, &y)| value(x, y)).collect();
        valid_blur(&samples, width, height, &weights)
    };
    let (ux, uy) = (blur(&|x, _| x), blur(&|_, y| y));
    let (uxx, uyy, uxy) = (blur(&|x, _| x * x), blur(&|_, y| y * y), blur(&|x, y| x * y));
    let mut sum = 0.0;
    for i in 0..ux.len() {
        let vx = covariance * (uxx[i] - ux[i] * ux[i]);
        let vy = covariance * (uyy[i] - uy[i] * uy[i]);
        let vxy = covariance * (uxy[i] - ux[i] * uy[i]);
        let numerator = (2.0 * ux[i] * uy[i] + c1) * (2.0 * vxy + c2);
        sum += numerator / ((ux[i] * ux[i] + uy[i] * uy[i] + c1) * (vx + vy + c2));
    }
    sum / ux.len() as f64
}

/// Separable Gaussian filter where the whole window is inside: `[height − 10, width − 10]`, along the columns first.
fn valid_blur(samples: &[f64], width: usize, height: usize, weights: &[f64; WINDOW]) -> Vec<f64> {
    let (rows, columns) = (height - 2 * RADIUS, width - 2 * RADIUS);
    let mut tall = vec![0.0; rows * width];
    for row in 0..rows {
        for (tap, &weight) in weights.iter().enumerate() {
            let source = &samples[(row + tap) * width..][..width];
            for (out, &value) in tall[row * width..][..width].iter_mut().zip(source) {
                *out += weight * value;
            }
        }
    }
    let mut blurred = vec![0.0; rows * columns];
    for row in 0..rows {
        let source = &tall[row * width..][..width];
        for (column, out) in blurred[row * columns..][..columns].iter_mut().enumerate() {
            for (tap, &weight) in weights.iter().enumerate() {
                *out += weight * source[column + tap];
            }
        }
    }
    blurred
}

/// Base-10 logarithm of a positive, normal number, by +, −, ×, ÷ only (error under 1e-14): the same on every machine.
fn log10(value: f64) -> f64 {
    let bits = value.to_bits();
    let mut exponent = ((bits >> 52) as i64 - 1023) as f64;
    let mut mantissa = f64::from_bits((bits & ((1 << 52) - 1)) | (1023 << 52));
    if mantissa > std::f64::consts::SQRT_2 {
        mantissa /= 2.0;
        exponent += 1.0;
    }
    // ln m = 2 atanh((m − 1)/(m + 1)); the argument is at most 0.172.
    let z = (mantissa - 1.0) / (mantissa + 1.0);
    let square = z * z;
    let mut series = 0.0;
    for k in (0..12).rev() {
        series = series * square + 1.0 / f64::from(2 * k + 1);
    }
    (exponent * std::f64::consts::LN_2 + 2.0 * z * series) / std::f64::consts::LN_10
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The pair of pictures the figures below were computed for.
    fn pair(width: usize, height: usize) -> (Picture, Picture) {
        let sample = |c: usize, y: usize, x: usize| ((x * 7 + y * 13 + c * 29 + x * y) % 64) as f32 / 63.0;
        let mut a = Vec::new();
        let mut b = Vec::new();
        for c in 0..3 {
            for y in 0..height {
                for x in 0..width {
                    let value = sample(c, y, x);
                    a.push(value);
                    b.push(0.8 * value + 0.1 * sample(c, x, y) + 0.02);
                }
            }
        }
        (Picture { width, height, rgb: a }, Picture { width, height, rgb: b })
    }

    #[test]
    fn psnr_and_ssim_are_those_of_scikit_image() {
        // skimage.metrics 0.26: peak_signal_noise_ratio(a, b, data_range=1) and structural_similarity(a, b,
        // win_size=11, gaussian_weights=True, channel_axis=2, data_range=1) of these pictures in float64.
        for (width, height, psnr_expected, ssim_expected) in SKIMAGE {
            let (a, b) = pair(width, height);
            let (p, s) = (psnr(&a, &b).expect("one size"), ssim(&a, &b).expect("large enough"));
            assert!((p - psnr_expected).abs() < 1e-6, "{width}×{height}: PSNR {p}, expected {psnr_expected}");
            assert!((s - ssim_expected).abs() < 1e-6, "{width}×{height}: SSIM {s}, expected {ssim_expected}");
        }
    }

    const SKIMAGE: [(usize, usize, f64, f64); 3] = [
        (40, 30, 22.811395972132132, 0.9676941424081328),
        (11, 11, 22.992703301288245, 0.9789725399890367),
        (65, 17, 22.853782828081528, 0.9676813477302222),
    ];

    #[test]
    fn identical_pictures_have_100_decibels_and_similarity_one() {
        let (a, _) = pair(24, 16);
        assert_eq!(psnr(&a, &a), Ok(100.0));
        assert!((ssim(&a, &a).expect("large enough") - 1.0).abs() < 1e-12);
    }

    #[test]
    fn pictures_that_cannot_be_compared_are_errors() {
        let (a, _) = pair(24, 16);
        let (b, _) = pair(16, 24);
        assert_eq!(psnr(&a, &b), Err(MetricError::Sizes((24, 16), (16, 24))));
        let (c, d) = pair(24, 10);
        assert_eq!(ssim(&c, &d), Err(MetricError::TooSmall(24, 10)));
    }

    #[test]
    fn the_logarithm_is_that_of_the_library() {
        for exponent in -320..300 {
            let value = 1.2345 * 2f64.powi(exponent);
            assert!((log10(value) - value.log10()).abs() < 1e-13 * value.log10().abs().max(1.0), "{value}");
        }
    }
}
