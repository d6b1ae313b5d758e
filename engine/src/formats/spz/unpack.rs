//! Conversion of SPZ's bytes to numbers.

use std::f64::consts::FRAC_1_SQRT_2;

use streamsplat_kernels::harmonics::{MAX_DEGREE, rest};
use streamsplat_kernels::math::f64::ln;

use super::COLOUR;
use super::{Header, Packed};
use crate::still::{LEAST, Still};

/// Unpacks the scene, along the file's own axes. Values are computed in binary64 and rounded once.
pub(super) fn unpack(packed: &Packed) -> Still {
    let Header { version, degree, fractional_bits, position, .. } = packed.header;
    let triples = |bytes: &[u8], value: &dyn Fn(u8) -> f32| -> Vec<[f32; 3]> {
        bytes.as_chunks::<3>().0.iter().map(|b| b.map(value)).collect()
    };
    let unit = 1.0 / f64::from(1_u32 << fractional_bits);
    let fixed = |b: &[u8]| (f64::from(i32::from_le_bytes([0, b[0], b[1], b[2]]) >> 8) * unit) as f32;
    let half = |b: &[u8]| half::f16::from_le_bytes([b[0], b[1]]).to_f32();
    let places = |width: usize, value: &dyn Fn(&[u8]) -> f32| -> Vec<[f32; 3]> {
        let place = |b: &[u8]| std::array::from_fn(|axis| value(&b[axis * width..]));
        packed.positions.chunks_exact(3 * width).map(place).collect()
    };
    let logit = |alpha: &u8| {
        let opacity = (f64::from(*alpha) / 255.0).clamp(LEAST, 1.0 - LEAST);
        (ln(opacity) - ln(1.0 - opacity)) as f32
    };
    let rotation = if version < 3 {
        packed.rotations.as_chunks::<3>().0.iter().map(|b| first_three(*b)).collect()
    } else {
        packed.rotations.as_chunks::<4>().0.iter().map(|b| smallest_three(u32::from_le_bytes(*b))).collect()
    };
    // Coefficients of higher degrees come last.
    let (stored, degree) = (3 * rest(degree), degree.min(MAX_DEGREE));
    let own = packed.harmonics.chunks_exact(stored.max(1)).flat_map(|own| &own[..3 * rest(degree)]);
    Still {
        mean: if position == super::HALVES { places(2, &half) } else { places(3, &fixed) },
        log_scale: triples(&packed.scales, &|b| f32::from(b) / 16.0 - 10.0),
        rotation,
        logit: packed.alphas.iter().map(logit).collect(),
        base: triples(&packed.colours, &|b| ((f64::from(b) / 255.0 - 0.5) / COLOUR) as f32),
        degree,
        higher: own.map(|b| (f32::from(*b) - 128.0) / 128.0).collect(),
        ..Still::default()
    }
}

/// Unpacks x, y and z of versions 1 and 2.
fn first_three(bytes: [u8; 3]) -> [f32; 4] {
    let [x, y, z] = bytes.map(|b| f64::from(b) / 127.5 - 1.0);
    let w = (1.0 - (x * x + y * y + z * z)).max(0.0).sqrt();
    [w, x, y, z].map(|c| c as f32)
}

/// Unpacks the three smallest components of x, y, z, w: in ascending order from the high bits, each a sign and nine
/// bits. The index of the largest is above them.
fn smallest_three(mut bits: u32) -> [f32; 4] {
    let largest = (bits >> 30) as usize;
    let (mut q, mut squares) = ([0.0; 4], 0.0);
    for i in (0..4).rev().filter(|i| *i != largest) {
        let magnitude = FRAC_1_SQRT_2 * f64::from(bits & 511) / 511.0;
        q[i] = if bits & 512 == 0 { magnitude } else { -magnitude };
        squares += magnitude * magnitude;
        bits >>= 10;
    }
    q[largest] = (1.0_f64 - squares).max(0.0).sqrt();
    let [x, y, z, w] = q;
    [w, x, y, z].map(|c| c as f32)
}
