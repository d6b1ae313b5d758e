//! Writing compressed PLY.

use streamsplat_kernels::harmonics::Y0;
use streamsplat_kernels::math::f64::exp;

use super::{BOUNDS, CHUNK, WORDS};
use crate::camera::Rotation;
use crate::formats::notes::Notes;
use crate::formats::ply::comments;
use crate::formats::{Order, Written};
use crate::still::Still;

/// Logarithms of scales are written up to this, and down to its negative.
const LARGEST: f32 = 20.0;

/// Writes a still scene as a compressed PLY file, with 16 bytes per Gaussian and one per further coefficient of its
/// harmonics.
///
/// Gaussians are sorted along a Z-order curve, so that the 256 Gaussians of a chunk are close together and their bounds
/// narrow. Gaussians that cannot be drawn ([`Still::defect`]) are left out. Logarithms of scales are clamped to ±20.
/// The header stores the anti-aliasing mark and the offset of [`About`](crate::still::About) as comments.
///
/// # Panics
/// If the arrays differ in length ([`Still::uneven`]).
pub fn write(still: &Still) -> Written {
    let kept = Order::along_curve(still);
    let mut notes = Notes::of(still, &kept);
    notes.offset(still.about.offset, "which only streamsplat reads from a compressed PLY file");
    let order = kept.places;
    let width = 3 * still.rest();
    let beyond = |i: &&usize| still.higher[**i * width..(**i + 1) * width].iter().any(|c| c.abs() > 4.02);
    notes.changed(
        order.iter().filter(beyond).count(),
        order.len(),
        "with a further coefficient beyond ±4, moved there",
    );
    let rest = still.rest();
    let mut header = "ply\nformat binary_little_endian 1.0\n".to_owned();
    comments(&still.about).iter().for_each(|line| header.push_str(line));
    header.push_str(&format!("element chunk {}\n", order.len().div_ceil(CHUNK)));
    let mut property = |kind: &str, name: &str| header.push_str(&format!("property {kind} {name}\n"));
    BOUNDS.as_flattened().as_flattened().iter().for_each(|name| property("float", name));
    header.push_str(&format!("element vertex {}\n", order.len()));
    let mut property = |kind: &str, name: &str| header.push_str(&format!("property {kind} {name}\n"));
    WORDS.iter().for_each(|name| property("uint", name));
    if rest > 0 {
        header.push_str(&format!("element sh {}\n", order.len()));
        (0..3 * rest).for_each(|i| header.push_str(&format!("property uchar f_rest_{i}\n")));
    }
    header.push_str("end_header\n");

    let (mut chunks, mut words, mut harmonics) = (Vec::new(), Vec::new(), Vec::new());
    let mut coarse = 0;
    for chunk in order.chunks(CHUNK) {
        let bounds = [
            bounds(chunk, |i| still.mean[i]),
            bounds(chunk, |i| still.log_scale[i].map(clamped)),
            bounds(chunk, |i| still.base[i].map(seen)),
        ];
        let [least, greatest] = bounds[0];
        let half_step = (0..3).map(|k| (f64::from(greatest[k]) - f64::from(least[k])) / 2046.0).fold(0.0, f64::max);
        let widest = |i: &usize| still.log_scale[*i].into_iter().fold(f32::NEG_INFINITY, f32::max);
        coarse += chunk.iter().filter(|i| half_step > exp(f64::from(clamped(widest(i))))).count();
        bounds.as_flattened().as_flattened().iter().for_each(|x| chunks.extend_from_slice(&x.to_le_bytes()));
        for &i in chunk {
            let share = |group: usize, value: [f32; 3]| -> [f64; 3] {
                let [least, greatest] = bounds[group];
                std::array::from_fn(|axis| {
                    let [at, from, to] = [value[axis], least[axis], greatest[axis]].map(f64::from);
                    if to > from { (at - from) / (to - from) } else { 0.0 }
                })
            };
            let triple = |[x, y, z]: [f64; 3]| whole(x, 11) << 21 | whole(y, 10) << 11 | whole(z, 11);
            let [red, green, blue] = share(2, still.base[i].map(seen)).map(|c| whole(c, 8));
            let opacity = whole(1.0 / (1.0 + exp(-f64::from(still.logit[i]).clamp(-200.0, 200.0))), 8);
            for word in [
                triple(share(0, still.mean[i])),
                rotation(still.rotation[i]),
                triple(share(1, still.log_scale[i].map(clamped))),
                red << 24 | green << 16 | blue << 8 | opacity,
            ] {
                words.extend_from_slice(&word.to_le_bytes());
            }
            let own = &still.higher[i * 3 * rest..][..3 * rest];
            let by_channel = (0..3).flat_map(|channel| own.iter().skip(channel).step_by(3));
            harmonics.extend(by_channel.map(|c| ((f64::from(*c) / 8.0 + 0.5) * 256.0).clamp(0.0, 255.0) as u8));
        }
    }
    let why = "placed more coarsely than they are wide, as their 256 neighbours reach far";
    notes.changed(coarse, order.len(), why);
    Written { bytes: [header.into_bytes(), chunks, words, harmonics].concat(), notes: notes.0 }
}

/// Returns least and greatest values by axis.
fn bounds(chunk: &[usize], value: impl Fn(usize) -> [f32; 3]) -> [[f32; 3]; 2] {
    chunk.iter().fold([[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]], |[least, greatest], &i| {
        let value = value(i);
        [std::array::from_fn(|k| least[k].min(value[k])), std::array::from_fn(|k| greatest[k].max(value[k]))]
    })
}

fn clamped(log_scale: f32) -> f32 {
    log_scale.clamp(-LARGEST, LARGEST)
}

/// Converts a first coefficient to a colour.
fn seen(coefficient: f32) -> f32 {
    (0.5 + f64::from(coefficient) * Y0) as f32
}

/// Quantises a number from 0 to 1 to `bits` bits, rounding halves away from zero.
fn whole(share: f64, bits: u32) -> u32 {
    let most = (1_u32 << bits) - 1;
    (share * f64::from(most)).round().clamp(0.0, f64::from(most)) as u32
}

/// Packs the three smallest of w, x, y, z, and the index of the largest, which is made positive.
fn rotation(q: [f32; 4]) -> u32 {
    let q = Rotation::from_quaternion(q.map(f64::from)).unwrap_or_default().quaternion();
    let largest = (1..4).fold(0, |best: usize, i| if q[i].abs() > q[best].abs() { i } else { best });
    let sign = if q[largest] < 0.0 { -1.0 } else { 1.0 };
    let others = (0..4).filter(|i| *i != largest).map(|i| sign * q[i] * std::f64::consts::FRAC_1_SQRT_2 + 0.5);
    others.fold(largest as u32, |word, share| word << 10 | whole(share, 10))
}
