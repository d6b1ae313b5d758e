//! SPZ, version 4.

use ruzstd::encoding::{CompressionLevel, compress_to_vec};
use streamsplat_kernels::harmonics::rest;
use streamsplat_kernels::math::f64::exp;

use super::Order;
use crate::camera::Rotation;
use crate::render::Snapshot;
use crate::still::Still;

/// Coefficients per byte of colour, over 255.
pub(crate) const COLOUR: f64 = 0.15;
/// Signs of the harmonics above degree 0 when the y and z axes are negated.
pub(crate) const HARMONIC_SIGNS: [f32; 15] =
    [-1.0, -1.0, 1.0, -1.0, 1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0, -1.0, 1.0, -1.0, 1.0];
/// Bits after the point, where the scene is not too wide for them.
const FRACTIONAL_BITS: u32 = 12;
/// Bits kept of coefficients of degree 1, and of higher ones.
const KEPT: [u32; 2] = [5, 4];

/// The Gaussians of one time as an SPZ file: [`of_still`] of what [`Still::of`] makes of them.
pub fn spz(snapshot: &Snapshot) -> Vec<u8> {
    of_still(&Still::of(snapshot))
}

/// A still scene as an SPZ file, version 4: see [`import`](mod@crate::import) for what is kept of each value.
///
/// Positions have 12 bits after the point, or as many fewer as the widest needs. The harmonics' coefficients are rounded to 5 bits at degree 1 and 4 above,
/// as the format's own program does. Gaussians with a number that is not finite, or without a rotation, are left out. Each attribute is one
/// zstd frame made by pure-Rust code, so the bytes are a function of the scene alone.
///
/// # Panics
/// When the arrays differ in length ([`Still::uneven`]), or there are 2³² Gaussians.
pub fn of_still(still: &Still) -> Vec<u8> {
    let rest = 3 * rest(still.degree);
    let sound = Order::own(still).places;
    let count = u32::try_from(sound.len()).unwrap_or_else(|_| panic!("{} Gaussians in one file", sound.len()));
    let most = sound.iter().flat_map(|i| still.mean[*i]).fold(0.0, |most: f64, x| most.max(f64::from(x).abs()));
    let fits = |bits: &u32| most * f64::from(1_u32 << bits) < 8_388_607.0;
    let bits = (0..=FRACTIONAL_BITS).rev().find(fits).unwrap_or(0);
    let attributes: [Vec<u8>; 6] = [
        sound.iter().flat_map(|i| position(still.mean[*i], bits)).collect(),
        sound.iter().map(|i| byte(255.0 / (1.0 + exp(-f64::from(still.logit[*i]))))).collect(),
        sound.iter().flat_map(|i| still.base[*i].map(|c| byte((COLOUR * f64::from(c) + 0.5) * 255.0))).collect(),
        sound.iter().flat_map(|i| still.log_scale[*i].map(|s| byte((f64::from(s) + 10.0) * 16.0))).collect(),
        sound.iter().flat_map(|i| rotation(still.rotation[*i])).collect(),
        sound.iter().flat_map(|&i| (0..rest).map(move |k| coefficient(still.higher[i * rest + k], k / 3))).collect(),
    ];
    let filled = || attributes.iter().filter(|attribute| !attribute.is_empty());
    let frames: Vec<Vec<u8>> =
        filled().map(|attribute| compress_to_vec(attribute.as_slice(), CompressionLevel::Fastest)).collect();
    let mut out = b"NGSP".to_vec();
    out.extend_from_slice(&4_u32.to_le_bytes());
    out.extend_from_slice(&count.to_le_bytes());
    out.extend_from_slice(&[still.degree as u8, bits as u8, 0, frames.len() as u8]);
    out.extend_from_slice(&32_u32.to_le_bytes());
    out.extend_from_slice(&[0; 12]);
    for (attribute, frame) in filled().zip(&frames) {
        out.extend_from_slice(&(frame.len() as u64).to_le_bytes());
        out.extend_from_slice(&(attribute.len() as u64).to_le_bytes());
    }
    out.extend_from_slice(&frames.concat());
    out
}

/// The nearest byte, halves away from zero.
fn byte(x: f64) -> u8 {
    x.round().clamp(0.0, 255.0) as u8
}

fn position([x, y, z]: [f32; 3], bits: u32) -> impl Iterator<Item = u8> {
    [x, -y, -z].into_iter().flat_map(move |x| {
        let fixed = (f64::from(x) * f64::from(1_u32 << bits)).round().clamp(-8_388_608.0, 8_388_607.0) as i32;
        let [a, b, c, _] = fixed.to_le_bytes();
        [a, b, c]
    })
}

/// The smallest three of x, y, z, w; the largest, which is made positive, by its number.
fn rotation(q: [f32; 4]) -> [u8; 4] {
    let [w, x, y, z] = Rotation::from_quaternion(q.map(f64::from)).unwrap_or_default().quaternion();
    let q = [x, -y, -z, w];
    let largest = (1..4).fold(0, |best: usize, i| if q[i].abs() > q[best].abs() { i } else { best });
    let mut bits = largest as u32;
    for i in (0..4).filter(|i| *i != largest) {
        let negative = (q[i] < 0.0) != (q[largest] < 0.0);
        let magnitude = (511.0 * q[i].abs() / std::f64::consts::FRAC_1_SQRT_2 + 0.5) as u32;
        bits = bits << 10 | u32::from(negative) << 9 | magnitude.min(511);
    }
    bits.to_le_bytes()
}

/// A coefficient in SPZ's axes, rounded to the middle of a bucket of bytes; 0 is one.
fn coefficient(value: f32, k: usize) -> u8 {
    let bucket = 1 << (8 - KEPT[usize::from(k >= 3)]);
    let whole = (f64::from(value * HARMONIC_SIGNS[k]) * 128.0).round().clamp(-1e6, 1e6) as i32 + 128;
    (((whole + bucket / 2).div_euclid(bucket)) * bucket).clamp(0, 255) as u8
}
