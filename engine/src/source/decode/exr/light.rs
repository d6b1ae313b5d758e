//! Conversion of linear light to display-referred sRGB.
//!
//! Curves are computed with additions, products, quotients and square roots in binary64, which every CPU rounds alike.
//! Other roots are found by Newton's method.

use std::sync::OnceLock;

use half::f16;

use crate::openexr::Chromaticities;

/// Primaries and white of sRGB and BT.709.
pub(super) const REC709: Chromaticities = [[0.64, 0.33], [0.30, 0.60], [0.15, 0.06], D65];
const D65: [f64; 2] = [0.3127, 0.3290];
const ACES_WHITE: [f64; 2] = [0.32168, 0.33767];
/// Linear light of the grey behind transparent pixels: sRGB's ½.
pub(super) const BEHIND: f64 = 0.214_041_140_482_232_55;

/// Returns the primaries and white point of a named colour space.
pub(super) fn primaries(name: &str) -> Option<Chromaticities> {
    Some(match name {
        "rec709" | "srgb" => REC709,
        "ap0" => [[0.7347, 0.2653], [0.0, 1.0], [0.0001, -0.077], ACES_WHITE],
        "ap1" => [[0.713, 0.293], [0.165, 0.830], [0.128, 0.044], ACES_WHITE],
        "p3d65" => [[0.680, 0.320], [0.265, 0.690], [0.150, 0.060], D65],
        "rec2020" => [[0.708, 0.292], [0.170, 0.797], [0.131, 0.046], D65],
        "adobergb" => [[0.64, 0.33], [0.21, 0.71], [0.15, 0.06], D65],
        "ciexyzd65" => [[1.0, 0.0], [0.0, 1.0], [0.0, 0.0], D65],
        _ => return None,
    })
}

/// Curve from samples to light.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Curve {
    /// Samples are linear light.
    Linear,
    /// sRGB's.
    Srgb,
    /// A power; its exponent in tenths.
    Gamma(u8),
}

impl Curve {
    /// Converts a sample to linear light.
    pub fn light(self, sample: f64) -> f64 {
        let power = |x: f64| match self {
            Curve::Linear => x,
            Curve::Srgb if x <= 0.04045 => x / 12.92,
            Curve::Srgb => tenths((x + 0.055) / 1.055, 24),
            Curve::Gamma(gamma) => tenths(x, gamma),
        };
        if sample < 0.0 { -power(-sample) } else { power(sample) }
    }
}

/// Converts linear light to a sample of sRGB.
pub(super) fn to_srgb(light: f64) -> f64 {
    // x^(5/12) is the cube root of x^(5/4).
    if light <= 0.003_130_8 { 12.92 * light } else { 1.055 * root(3, light * light.sqrt().sqrt()) - 0.055 }
}

/// Computes [`to_srgb`] of a binary32 number. Values that binary16 can hold, as in most files, are looked up in a
/// table.
pub(super) fn sample(light: f32) -> f32 {
    static HALVES: OnceLock<Vec<f32>> = OnceLock::new();
    let half = f16::from_f32(light);
    if half.to_f32() == light {
        let of = |bits: u16| to_srgb(f64::from(f16::from_bits(bits).to_f32())) as f32;
        return HALVES.get_or_init(|| (0..=u16::MAX).map(of).collect())[usize::from(half.to_bits())];
    }
    to_srgb(f64::from(light)) as f32
}

/// Returns `x` to the power of `power` tenths, for `x` ≥ 0.
fn tenths(x: f64, power: u8) -> f64 {
    let whole = |n: u8| (0..n).fold(1.0, |product, _| product * x);
    whole(power / 10) * root(5, whole(power % 10)).sqrt()
}

/// Returns the root of that degree of a number ≥ 0.
fn root(degree: u8, x: f64) -> f64 {
    const SMALLEST: f64 = 1e-60;
    if x < SMALLEST {
        return 0.0;
    }
    // Initial value from the exponent: within 12 % of the root.
    let ones = 1.0_f64.to_bits();
    let mut root = f64::from_bits(ones - ones / u64::from(degree) + x.to_bits() / u64::from(degree));
    let n = f64::from(degree);
    for _ in 0..6 {
        let power = (1..degree).fold(1.0, |product, _| product * root);
        root = ((n - 1.0) * root + x / power) / n;
    }
    root
}

type Matrix = [[f64; 3]; 3];

/// Returns the matrix from colours of these primaries to those of sRGB, with white mapped to white; `None` if the
/// primaries are sRGB's.
///
/// # Errors
/// Primaries that lie on a line and span no colours, or a white without luminance.
pub(super) fn to_rec709(from: Chromaticities) -> Result<Option<Matrix>, String> {
    let near = from.iter().flatten().zip(REC709.iter().flatten()).all(|(a, b)| (a - b).abs() < 0.001);
    if near {
        return Ok(None);
    }
    let wrong = || format!("expected chromaticities that span colours, found {from:?}");
    let source = to_xyz(from).ok_or_else(wrong)?;
    let target = to_xyz(REC709).and_then(inverse).ok_or_else(wrong)?;
    let adapted = adaptation(from[3], D65).ok_or_else(wrong)?;
    let matrix = product(target, product(adapted, source));
    if matrix.iter().flatten().all(|v| v.is_finite()) { Ok(Some(matrix)) } else { Err(wrong()) }
}

/// Multiplies `matrix` by a colour.
pub(super) fn applied(matrix: &Matrix, colour: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|row| (0..3).map(|k| matrix[row][k] * colour[k]).sum())
}

fn product(a: Matrix, b: Matrix) -> Matrix {
    [0, 1, 2].map(|row| [0, 1, 2].map(|column| (0..3).map(|k| a[row][k] * b[k][column]).sum()))
}

fn inverse(m: Matrix) -> Option<Matrix> {
    let minor = |r: usize, c: usize| {
        let (r1, r2, c1, c2) = ((r + 1) % 3, (r + 2) % 3, (c + 1) % 3, (c + 2) % 3);
        m[r1][c1] * m[r2][c2] - m[r1][c2] * m[r2][c1]
    };
    let determinant: f64 = (0..3).map(|c| m[0][c] * minor(0, c)).sum();
    (determinant.abs() > 1e-9).then(|| [0, 1, 2].map(|row| [0, 1, 2].map(|column| minor(column, row) / determinant)))
}

/// Returns XYZ at luminance 1 of a chromaticity.
fn xyz([x, y]: [f64; 2]) -> Option<[f64; 3]> {
    (y.abs() > 1e-9).then(|| [x / y, 1.0, (1.0 - x - y) / y])
}

/// Returns the matrix from RGB to XYZ, with white at luminance 1.
fn to_xyz([red, green, blue, white]: Chromaticities) -> Option<Matrix> {
    let columns = [red, green, blue].map(|[x, y]| [x, y, 1.0 - x - y]);
    let primaries: Matrix = [0, 1, 2].map(|row| [0, 1, 2].map(|column| columns[column][row]));
    let scale = applied(&inverse(primaries)?, xyz(white)?);
    Some([0, 1, 2].map(|row| [0, 1, 2].map(|column| primaries[row][column] * scale[column])))
}

/// Returns Bradford's adaptation from one white to another.
fn adaptation(from: [f64; 2], to: [f64; 2]) -> Option<Matrix> {
    const CONES: Matrix = [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]];
    let (from, to) = (applied(&CONES, xyz(from)?), applied(&CONES, xyz(to)?));
    let mut scaled = CONES;
    for ((row, from), to) in scaled.iter_mut().zip(from).zip(to) {
        row.iter_mut().for_each(|v| *v *= to / from);
    }
    Some(product(inverse(CONES)?, scaled))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curves_are_those_of_their_standards() {
        assert_eq!(sample(0.5), 0.735_356_99_f32);
        assert_eq!([sample(0.0), sample(1.0)], [0.0, 1.0]);
        for i in 1..4000 {
            let light = f64::from(i) / 1000.0;
            let expected = if light <= 0.003_130_8 { 12.92 * light } else { 1.055 * light.powf(1.0 / 2.4) - 0.055 };
            assert!((to_srgb(light) - expected).abs() < 1e-12, "{light}");
            assert!((Curve::Srgb.light(to_srgb(light)) - light).abs() < 1e-6, "{light}");
            for gamma in [18, 22, 25, 26] {
                let expected = light.powf(f64::from(gamma) / 10.0);
                assert!((Curve::Gamma(gamma).light(light) / expected - 1.0).abs() < 1e-12, "{light}, {gamma}");
            }
        }
        assert_eq!(Curve::Gamma(22).light(0.0), 0.0);
        assert!((to_srgb(BEHIND) - 0.5).abs() < 1e-12);
    }

    #[test]
    fn samples_of_binary16_are_the_same_looked_up() {
        for light in [1e-5_f32, 0.25, 0.1, 0.333, 0.9, 1.5, 60_000.0] {
            let half = f16::from_f32(light).to_f32();
            assert_eq!(sample(half).to_bits(), (to_srgb(f64::from(half)) as f32).to_bits(), "{light}");
        }
    }

    #[test]
    fn primaries_become_srgbs_and_white_stays_white() {
        assert_eq!(to_rec709(REC709), Ok(None));
        let of = |name: &str, colour: [f64; 3]| {
            let found = to_rec709(primaries(name).expect("a name")).expect("they span colours");
            applied(&found.expect("others"), colour)
        };
        for name in ["ap0", "ap1", "p3d65", "rec2020", "adobergb"] {
            assert!(of(name, [1.0; 3]).iter().all(|v| (v - 1.0).abs() < 1e-3), "{name}: {:?}", of(name, [1.0; 3]));
        }
        // From the tables of ITU-R BT.2087 and of ACEScg's reference implementation.
        let near = |found: [f64; 3], expected: [f64; 3]| {
            assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 2e-3), "{found:?} {expected:?}");
        };
        near(of("rec2020", [1.0, 0.0, 0.0]), [1.6605, -0.1246, -0.0182]);
        near(of("ap1", [1.0, 0.0, 0.0]), [1.7051, -0.1302, -0.0240]);
        near(of("p3d65", [0.0, 1.0, 0.0]), [-0.2249, 1.0421, -0.0786]);
        assert!(to_rec709([[0.3, 0.3]; 4]).is_err());
    }
}
