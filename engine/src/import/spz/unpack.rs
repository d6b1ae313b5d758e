//! From SPZ's bytes to numbers.

use std::f64::consts::FRAC_1_SQRT_2;

use streamsplat_kernels::harmonics::{MAX_DEGREE, rest};
use streamsplat_kernels::math::f64::ln;

use super::{Header, Packed};
use crate::export::spz::{COLOUR, HARMONIC_SIGNS};
use crate::still::Still;

/// The scene, in scene space. Values are formed in binary64 and rounded once.
pub(super) fn unpack(packed: &Packed) -> Still {
    let Header { version, degree, fractional_bits, .. } = packed.header;
    let triples = |bytes: &[u8], value: &dyn Fn(u8) -> f32| -> Vec<[f32; 3]> {
        bytes.as_chunks::<3>().0.iter().map(|b| b.map(value)).collect()
    };
    let unit = 1.0 / f64::from(1_u32 << fractional_bits);
    let fixed = |b: &[u8; 3]| f64::from(i32::from_le_bytes([0, b[0], b[1], b[2]]) >> 8) * unit;
    let mean = packed.positions.as_chunks::<9>().0.iter().map(|b| {
        let parts = b.as_chunks::<3>().0;
        [fixed(&parts[0]) as f32, -fixed(&parts[1]) as f32, -fixed(&parts[2]) as f32]
    });
    let logit = |alpha: &u8| {
        let opacity = f64::from(*alpha).clamp(1.0, 254.0) / 255.0;
        (ln(opacity) - ln(1.0 - opacity)) as f32
    };
    let rotation = if version == 2 {
        packed.rotations.as_chunks::<3>().0.iter().map(|b| first_three(*b)).collect()
    } else {
        packed.rotations.as_chunks::<4>().0.iter().map(|b| smallest_three(u32::from_le_bytes(*b))).collect()
    };
    // Coefficients of higher degrees come last.
    let (stored, degree) = (3 * rest(degree), degree.min(MAX_DEGREE));
    let own = packed.harmonics.chunks_exact(stored.max(1)).flat_map(|own| &own[..3 * rest(degree)]);
    let signs = HARMONIC_SIGNS[..rest(degree)].iter().flat_map(|sign| [sign; 3]).cycle();
    let higher = own.zip(signs).map(|(b, sign)| (f32::from(*b) - 128.0) / 128.0 * sign);
    Still {
        mean: mean.collect(),
        log_scale: triples(&packed.scales, &|b| f32::from(b) / 16.0 - 10.0),
        rotation,
        logit: packed.alphas.iter().map(logit).collect(),
        base: triples(&packed.colours, &|b| ((f64::from(b) / 255.0 - 0.5) / COLOUR) as f32),
        degree,
        higher: higher.collect(),
    }
}

/// x, y and z of version 2.
fn first_three(bytes: [u8; 3]) -> [f32; 4] {
    let [x, y, z] = bytes.map(|b| f64::from(b) / 127.5 - 1.0);
    let w = (1.0 - (x * x + y * y + z * z)).max(0.0).sqrt();
    turned([x, y, z, w])
}

/// The three smallest components of x, y, z, w, in ascending order from the high bits, each a sign and nine bits; the number of the largest above.
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
    turned(q)
}

/// w first, and with y and z the other way.
fn turned([x, y, z, w]: [f64; 4]) -> [f32; 4] {
    [w, x, -y, -z].map(|c| c as f32)
}
