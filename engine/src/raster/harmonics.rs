//! Colours from harmonics `[N, K, 3]`, and their gradients.

use streamsplat_kernels::Level;
use streamsplat_kernels::harmonics::{Eye, Gradients, MAX_DEGREE, adjoint, colours, rest};

use super::{RasterError, check};

/// Splits the used coefficients into the first of each Gaussian and the others.
fn split(
    coefficients: &[f32],
    count: usize,
    degree: usize,
    gaussians: usize,
) -> Result<(Vec<[f32; 3]>, Vec<f32>), RasterError> {
    if degree > MAX_DEGREE {
        return Err(RasterError::TooMany { name: "sh_degree", most: MAX_DEGREE, found: degree });
    }
    let used = rest(degree) + 1;
    if count < used {
        return Err(RasterError::Length { name: "colors", expected: 3 * used, found: 3 * count });
    }
    check::length("colors", gaussians.saturating_mul(count).saturating_mul(3), coefficients.len())?;
    let each = || coefficients.chunks_exact(3 * count);
    let mut higher = Vec::with_capacity(gaussians * 3 * rest(degree));
    each().for_each(|own| higher.extend_from_slice(&own[3..3 * used]));
    Ok((each().map(|own| [own[0], own[1], own[2]]).collect(), higher))
}

/// Computes the colours `[N, 3]` from coefficients `[N, K, 3]` up to `degree`, seen from `eye`: `max(0, ½ + Σ c·Y)`.
///
/// # Errors
/// A degree above 3, and slices of another length.
pub fn harmonic_colours(
    coefficients: &[f32],
    count: usize,
    degree: usize,
    means: &[[f32; 3]],
    eye: [f32; 3],
) -> Result<Vec<[f32; 3]>, RasterError> {
    let (base, higher) = split(coefficients, count, degree, means.len())?;
    let mut out = vec![[0.0; 3]; means.len()];
    colours(Level::detect(), degree, &base, &higher, means, Eye::At(eye), &mut out);
    Ok(out)
}

/// Gradients of a loss with respect to harmonics.
#[derive(Clone, Debug, PartialEq)]
pub struct HarmonicGradients {
    /// By coefficients, `[N, K, 3]`; zeros above the degree.
    pub coefficients: Vec<f32>,
    /// By means, `[N]`.
    pub means: Vec<[f32; 3]>,
    /// By the eye's position.
    pub eye: [f64; 3],
}

/// Computes gradients from those by the colours `out`, which [`harmonic_colours`] computed from the other arguments.
///
/// # Errors
/// As [`harmonic_colours`].
pub fn harmonic_gradients(
    coefficients: &[f32],
    count: usize,
    degree: usize,
    means: &[[f32; 3]],
    eye: [f32; 3],
    out: &[[f32; 3]],
    of: &[[f32; 3]],
) -> Result<HarmonicGradients, RasterError> {
    let n = means.len();
    let (mut base, higher) = split(coefficients, count, degree, n)?;
    check::length("colors", 3 * n, 3 * out.len())?;
    check::length("gradients of colors", 3 * n, 3 * of.len())?;
    let (mut others, mut of_means) = (vec![0.0; higher.len()], vec![[0.0; 3]; n]);
    let to = Gradients { base: &mut base, higher: &mut others, mean: &mut of_means };
    let eye = adjoint(Level::detect(), degree, &higher, means, Eye::At(eye), out, of, to);
    let mut all = vec![0.0; coefficients.len()];
    let width = 3 * rest(degree);
    for (i, own) in all.chunks_exact_mut(3 * count).enumerate() {
        own[..3].copy_from_slice(&base[i]);
        own[3..3 + width].copy_from_slice(&others[i * width..][..width]);
    }
    Ok(HarmonicGradients { coefficients: all, means: of_means, eye })
}
