//! Checks of the arguments.

use streamsplat_kernels::raster::MAX_SIDE;

use super::{CameraMatrix, Gaussians, MAX_CHANNELS, MAX_GAUSSIANS, Options, RasterError, ViewMatrix};

/// Values tested in one block, so that the test is vectorised.
const TOGETHER: usize = 1 << 12;
/// Minimum determinant of an invertible matrix, relative to the product of its rows' lengths.
const LEAST_VOLUME: f64 = 1e-9;

/// Fails unless there are `expected` values.
pub(super) fn length(name: &'static str, expected: usize, found: usize) -> Result<(), RasterError> {
    if expected == found { Ok(()) } else { Err(RasterError::Length { name, expected, found }) }
}

/// Fails unless `found` is at least 1 and at most `most`.
pub(super) fn some(name: &'static str, most: usize, found: usize) -> Result<(), RasterError> {
    match found {
        0 => Err(RasterError::Empty { name }),
        _ if found > most => Err(RasterError::TooMany { name, most, found }),
        _ => Ok(()),
    }
}

/// Fails where a value is NaN or infinite.
pub(super) fn finite(name: &'static str, values: &[f32]) -> Result<(), RasterError> {
    const EXPONENT: u32 = 0x7f80_0000;
    let sound = |part: &[f32]| !part.iter().fold(false, |bad, v| bad | (v.to_bits() & EXPONENT == EXPONENT));
    for (index, part) in values.chunks(TOGETHER).enumerate() {
        if !sound(part) {
            let at = part.iter().position(|v| !v.is_finite()).unwrap_or(0);
            return Err(RasterError::NotFinite { name, at: index * TOGETHER + at, value: part[at] });
        }
    }
    Ok(())
}

/// Fails if Gaussians cannot be drawn; returns their number.
pub(super) fn gaussians(gaussians: &Gaussians<'_>) -> Result<usize, RasterError> {
    let Gaussians { means, quats, scales, opacities } = gaussians;
    let n = means.len();
    some("means", MAX_GAUSSIANS, n)?;
    length("quats", n * 4, quats.len() * 4)?;
    length("scales", n * 3, scales.len() * 3)?;
    length("opacities", n, opacities.len())?;
    finite("means", means.as_flattened())?;
    finite("quats", quats.as_flattened())?;
    finite("scales", scales.as_flattened())?;
    finite("opacities", opacities)?;
    Ok(n)
}

/// Fails if images cannot be drawn with these options.
pub(super) fn options(options: &Options<'_>) -> Result<(), RasterError> {
    some("width", MAX_SIDE, options.width)?;
    some("height", MAX_SIDE, options.height)?;
    let range = |name, expected, fits: bool, found: f32| {
        if fits { Ok(()) } else { Err(RasterError::Range { name, expected, found: found.into() }) }
    };
    let Options { near_plane: near, far_plane: far, radius_clip: clip, eps2d, largest_alpha: most, .. } = *options;
    range("near_plane", "a number from 0 on", near >= 0.0, near)?;
    range("far_plane", "a number above near_plane", far > near, far)?;
    range("largest_alpha", "a number above 0 and below 1", most > 0.0 && most < 1.0, most)?;
    range("radius_clip", "a number", !clip.is_nan(), clip)?;
    range("eps2d", "a finite number from 0 on", eps2d >= 0.0 && eps2d.is_finite(), eps2d)
}

/// Allocates values of images of `[width, height]` pixels, all 0, or returns an error if memory does not suffice.
pub(super) fn zeros(len: usize, [width, height]: [usize; 2]) -> Result<Vec<f32>, RasterError> {
    let mut values = Vec::new();
    let bytes = len.saturating_mul(size_of::<f32>());
    values.try_reserve_exact(len).map_err(|_| RasterError::Memory { width, height, bytes })?;
    values.resize(len, 0.0);
    Ok(values)
}

/// Fails if there are too many channels.
pub(super) fn channels(found: usize) -> Result<(), RasterError> {
    some("channels", MAX_CHANNELS, found)
}

/// Returns the eye's position, `−V⁻¹·t` in binary64, and V⁻¹.
pub(super) fn eye(matrix: &ViewMatrix) -> Result<([f64; 3], [[f64; 3]; 3]), RasterError> {
    let singular = Err(RasterError::Singular { found: *matrix });
    if matrix.as_flattened().iter().any(|v| !v.is_finite()) || matrix[3] != [0.0, 0.0, 0.0, 1.0] {
        return singular;
    }
    let v: [[f64; 3]; 3] = std::array::from_fn(|row| std::array::from_fn(|column| f64::from(matrix[row][column])));
    let cross =
        |a: [f64; 3], b: [f64; 3]| [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let columns = [cross(v[1], v[2]), cross(v[2], v[0]), cross(v[0], v[1])];
    let volume = dot(v[0], columns[0]);
    let lengths = v.map(|row| dot(row, row).sqrt());
    if volume.abs() <= LEAST_VOLUME * lengths[0] * lengths[1] * lengths[2] {
        return singular;
    }
    let inverse: [[f64; 3]; 3] = std::array::from_fn(|row| std::array::from_fn(|column| columns[column][row] / volume));
    let t: [f64; 3] = std::array::from_fn(|row| f64::from(matrix[row][3]));
    Ok((inverse.map(|row| -dot(row, t)), inverse))
}

/// Returns focal lengths and centre of a camera matrix.
pub(super) fn camera(k: &CameraMatrix) -> Result<([f32; 2], [f32; 2]), RasterError> {
    let [[fx, skew, cx], [zero, fy, cy], last] = *k;
    let finite = k.as_flattened().iter().all(|v| v.is_finite());
    if !finite || fx <= 0.0 || fy <= 0.0 || [skew, zero] != [0.0; 2] || last != [0.0, 0.0, 1.0] {
        return Err(RasterError::Camera { found: *k });
    }
    Ok(([fx, fy], [cx, cy]))
}
