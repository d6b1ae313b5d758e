//! A still scene in the page's format: 36 bytes per Gaussian, and 16 more per degree of its harmonics.
//!
//! Little-endian. A header of 16 bytes, `count` records of 32 bytes, `count` rows of harmonics of 16·degree bytes,
//! `count` numbers of four bytes.
//!
//! | header | | |
//! |---|---|---|
//! | 0 | 4 bytes | `ssst` |
//! | 4 | u32 | version, 1 |
//! | 8 | u32 | count |
//! | 12 | u16 | degree of the harmonics |
//! | 14 | u16 | 1: trained with anti-aliasing, and drawn as for [`About::antialiased`](crate::still::About::antialiased); else 0 |
//!
//! | record | | value | error at most |
//! |---|---|---|---|
//! | 0 | 3 × f32 | centre, in the file's axes and units | none |
//! | 12 | 3 × u16 | logarithm of the standard deviation: `48·q / 65535 − 24`, moved to the ends beyond | 0.04 % of the deviation |
//! | 18 | u16 | opacity·65535 | 1 / 131,070 |
//! | 20 | 3 × f16 | red, green, blue of the harmonics' first coefficients, within ±65,504 | 2⁻¹¹ of it |
//! | 26 | 3 × u16 | rotation: a unit quaternion (w, x, y, z), three components of it | 10⁻⁴ |
//!
//! The sign of the quaternion is chosen so that its largest component is positive. That component is left out: its
//! number has its low bit in the highest bit of the first word, and its high bit in that of the second. The others
//! follow in order, in 15 bits each: `√½·(q / 16383.5 − 1)`.
//!
//! A row of harmonics has the coefficients above the first, channels innermost, in i8: `step·q`, with an error of half
//! a step at most. `step`, an f16 in the row's last two bytes, is at least a 127th of the row's largest. A number is
//! the index of a Gaussian in its file.
//!
//! Omitted are Gaussians that no image shows: opacities under 1/255, and those with a
//! [`Still::defect`](crate::still::Still::defect).

use half::f16;
use rayon::prelude::*;
use streamsplat_kernels::harmonics::Y0;

use crate::still::Drawable;

/// The first bytes.
pub(super) const MAGIC: [u8; 4] = *b"ssst";
/// The version this program writes, and its page reads.
const VERSION: u32 = 1;
/// Bytes before the records.
pub(super) const HEADER: usize = 16;
/// Bytes of a record.
pub(super) const RECORD: usize = 32;
/// Bytes of harmonics per degree.
pub(super) const ROW: usize = 16;
/// Bytes of a number.
const NUMBER: usize = 4;
/// Smallest opacity that is drawn.
const VISIBLE: f32 = 1.0 / 255.0;
/// Logarithms of standard deviations are between this and its negative.
const WIDEST: f64 = 24.0;
/// Steps of 16 bits, and half of those of 15 bits.
const STEPS: f64 = 65535.0;
const HALF_STEPS: f64 = 16383.5;
/// Records of a task.
const TASK: usize = 4096;

/// Bytes of the packet of `count` Gaussians.
pub(super) fn length(count: usize, degree: usize) -> usize {
    count.saturating_mul(RECORD + degree * ROW + NUMBER).saturating_add(HEADER)
}

/// The packet of a scene, on the current rayon pool.
pub(super) fn packet(scene: &Drawable) -> Vec<u8> {
    let still = scene.still();
    let degree = still.degree;
    let seen: Vec<u32> = (0..still.len()).filter(|&i| can_be_seen(scene, i)).map(|i| i as u32).collect();
    let mut out = vec![0; length(seen.len(), degree)];
    let (header, rest) = out.split_at_mut(HEADER);
    header[..4].copy_from_slice(&MAGIC);
    let kind = degree as u32 | u32::from(still.about.antialiased) << 16;
    for (place, value) in [(4, VERSION), (8, seen.len() as u32), (12, kind)] {
        header[place..place + 4].copy_from_slice(&value.to_le_bytes());
    }
    let (records, rest) = rest.split_at_mut(seen.len() * RECORD);
    records.par_chunks_mut(TASK * RECORD).zip(seen.par_chunks(TASK)).for_each(|(records, seen)| {
        let (records, _) = records.as_chunks_mut::<RECORD>();
        records.iter_mut().zip(seen).for_each(|(out, &i)| *out = record(scene, i as usize));
    });
    let (rows, numbers) = rest.split_at_mut(seen.len() * degree * ROW);
    if degree > 0 {
        let width = 3 * still.rest();
        rows.par_chunks_mut(degree * ROW).zip(&seen).with_min_len(TASK).for_each(|(out, &i)| {
            harmonics(&still.higher[i as usize * width..][..width], out);
        });
    }
    numbers.as_chunks_mut::<NUMBER>().0.iter_mut().zip(&seen).for_each(|(out, i)| *out = i.to_le_bytes());
    out
}

/// Returns true if an image can show Gaussian `i`.
fn can_be_seen(scene: &Drawable, i: usize) -> bool {
    scene.still().defect(i).is_none() && scene.opacity()[i] >= VISIBLE
}

fn record(scene: &Drawable, i: usize) -> [u8; RECORD] {
    let still = scene.still();
    let mut out = [0; RECORD];
    for (axis, x) in still.mean[i].iter().enumerate() {
        out[4 * axis..4 * axis + 4].copy_from_slice(&x.to_le_bytes());
    }
    let width = still.log_scale[i].map(|x| unit((f64::from(x) / WIDEST + 1.0) / 2.0));
    let colour = still.base[i].map(|c| half((0.5 + f64::from(c) * Y0) as f32));
    let words = width.into_iter().chain([unit(f64::from(scene.opacity()[i]))]).chain(colour);
    for (k, word) in words.chain(turn(scene.rotation(i))).enumerate() {
        out[12 + 2 * k..14 + 2 * k].copy_from_slice(&word.to_le_bytes());
    }
    out
}

/// Three components of a unit quaternion, and the number of the omitted one.
fn turn(q: [f64; 4]) -> [u16; 3] {
    let largest = (1..4).fold(0, |best, i| if q[i].abs() > q[best].abs() { i } else { best });
    let sign = if q[largest] < 0.0 { -1.0 } else { 1.0 };
    let mut kept = (0..4).filter(|i| *i != largest).map(|i| {
        // At most √½, as another component is at least as large; the conversion saturates.
        let steps = ((sign * q[i] * std::f64::consts::SQRT_2 + 1.0) * HALF_STEPS).round() as u16;
        steps.min(0x7fff)
    });
    std::array::from_fn(|k| kept.next().unwrap_or_default() | if k < 2 { (largest as u16 >> k & 1) << 15 } else { 0 })
}

/// A row of harmonics in steps.
fn harmonics(row: &[f32], out: &mut [u8]) {
    let largest = row.iter().fold(0.0, |most: f32, c| most.max(c.abs()));
    // Rounds up to the next binary16 number, so that the largest coefficient has at most 127 steps.
    let mut step = f16::from_f32((largest / 127.0).min(f16::MAX.to_f32()));
    if f64::from(step) * 127.0 < f64::from(largest) && step < f16::MAX {
        step = f16::from_bits(step.to_bits() + 1);
    }
    let size = f32::from(step);
    if size > 0.0 {
        // The conversion saturates.
        row.iter().zip(out.iter_mut()).for_each(|(c, out)| *out = ((c / size).round() as i8).cast_unsigned());
    }
    let end = out.len() - 2;
    out[end..].copy_from_slice(&step.to_bits().to_le_bytes());
}

/// The bits of the nearest binary16 number, at most the largest finite one.
fn half(value: f32) -> u16 {
    let most = f16::MAX.to_f32();
    f16::from_f32(value.clamp(-most, most)).to_bits()
}

/// A value of [0, 1] in steps; values outside are clamped.
fn unit(value: f64) -> u16 {
    (value.clamp(0.0, 1.0) * STEPS).round() as u16
}

#[cfg(test)]
mod tests {
    use streamsplat_kernels::Level;

    use super::*;
    use crate::camera::Rotation;
    use crate::still::Still;
    use crate::stream::Workers;

    fn drawable(still: Still) -> Drawable {
        Drawable::new(still, &Workers::new(Level::scalar(), 1).expect("a thread")).expect("even arrays")
    }

    fn still(count: usize, degree: usize) -> Still {
        let value = |i: usize, k: usize| ((i * 7919 + k * 104_729) % 1009) as f32 / 504.5 - 1.0;
        let width = 3 * streamsplat_kernels::harmonics::rest(degree);
        Still {
            mean: (0..count).map(|i| std::array::from_fn(|k| 1e4 * value(i, k))).collect(),
            log_scale: (0..count).map(|i| std::array::from_fn(|k| 20.0 * value(i, 3 + k))).collect(),
            rotation: (0..count).map(|i| std::array::from_fn(|k| 3.0 * value(i, 6 + k))).collect(),
            logit: (0..count).map(|i| 4.0 * value(i, 10)).collect(),
            base: (0..count).map(|i| std::array::from_fn(|k| 9.0 * value(i, 11 + k))).collect(),
            degree,
            higher: (0..count * width).map(|i| 0.4 * value(i, 14) * value(i / width, 15)).collect(),
            ..Still::default()
        }
    }

    fn word(bytes: &[u8], at: usize) -> u16 {
        u16::from_le_bytes([bytes[at], bytes[at + 1]])
    }

    fn long(bytes: &[u8], at: usize) -> u32 {
        u32::from_le_bytes(bytes[at..at + 4].try_into().expect("four bytes"))
    }

    fn number(bytes: &[u8], at: usize) -> f64 {
        f16::from_bits(word(bytes, at)).to_f64()
    }

    #[test]
    fn every_value_comes_back_within_its_stated_error() {
        for degree in 0..=3 {
            let scene = drawable(still(509, degree));
            let (still, bytes) = (scene.still(), packet(&scene));
            let count = long(&bytes, 8) as usize;
            assert_eq!((&bytes[..4], long(&bytes, 4), long(&bytes, 12)), (&MAGIC[..], VERSION, degree as u32));
            assert!(count > 400 && bytes.len() == length(count, degree));
            for place in 0..count {
                let i = long(&bytes, bytes.len() - 4 * (count - place)) as usize;
                let at = HEADER + place * RECORD;
                for axis in 0..3 {
                    assert_eq!(long(&bytes, at + 4 * axis), still.mean[i][axis].to_bits());
                    let log = 48.0 * f64::from(word(&bytes, at + 12 + 2 * axis)) / 65535.0 - 24.0;
                    assert!((log - f64::from(still.log_scale[i][axis])).abs() <= 3.7e-4, "{i} {axis}: {log}");
                    let (found, base) = (number(&bytes, at + 20 + 2 * axis), f64::from(still.base[i][axis]));
                    let expected = 0.5 + Y0 * base;
                    assert!(
                        (found - expected).abs() <= expected.abs() / 2048.0 + 1e-7,
                        "{i} {axis}: {found} {expected}"
                    );
                }
                let opacity = f64::from(word(&bytes, at + 18)) / 65535.0;
                assert!((opacity - f64::from(scene.opacity()[i])).abs() <= 0.5001 / 65535.0);
                check_rotation(std::array::from_fn(|k| word(&bytes, at + 26 + 2 * k)), still.rotation[i]);
                let row = HEADER + count * RECORD + place * degree * ROW;
                let width = 3 * still.rest();
                if degree > 0 {
                    let step = number(&bytes, row + degree * ROW - 2);
                    for (k, expected) in still.higher[i * width..(i + 1) * width].iter().enumerate() {
                        let found = step * f64::from(bytes[row + k].cast_signed());
                        assert!((found - f64::from(*expected)).abs() <= 0.50001 * step, "{i} {k}: {found} {expected}");
                    }
                }
            }
        }
    }

    /// Decodes like still.vert.
    fn check_rotation(words: [u16; 3], expected: [f32; 4]) {
        let left_out = usize::from(words[0] >> 15 | words[1] >> 15 << 1);
        let kept = words.map(|w| (f64::from(w & 0x7fff) / 16383.5 - 1.0) * std::f64::consts::FRAC_1_SQRT_2);
        let mut rest = kept.iter();
        let largest = (1.0 - kept.iter().map(|c| c * c).sum::<f64>()).max(0.0).sqrt();
        let found: [f64; 4] =
            std::array::from_fn(|i| if i == left_out { largest } else { *rest.next().expect("three components") });
        let expected = Rotation::from_quaternion(expected.map(f64::from)).expect("a length").quaternion();
        let sign = expected[left_out].signum();
        assert!(found.iter().zip(expected).all(|(f, e)| (f - sign * e).abs() < 1e-4), "{found:?} {expected:?}");
    }

    #[test]
    fn the_mark_of_anti_aliased_training_is_kept() {
        let mut scene = still(5, 2);
        scene.about.antialiased = true;
        let bytes = packet(&drawable(scene));
        assert_eq!((word(&bytes, 12), word(&bytes, 14)), (2, 1));
    }

    #[test]
    fn what_no_image_shows_is_left_out() {
        let mut still = still(9, 1);
        still.logit.fill(1.0);
        still.rotation.fill([1.0, 0.0, 0.0, 0.0]);
        still.mean[1][2] = f32::NAN;
        still.log_scale[2][0] = 100.0;
        still.rotation[3] = [0.0; 4];
        still.logit[4] = -6.0;
        still.base[5][1] = f32::INFINITY;
        still.higher[6 * 9 + 8] = f32::NAN;
        let bytes = packet(&drawable(still));
        let numbers: Vec<u32> = (0..3).map(|k| long(&bytes, bytes.len() - 12 + 4 * k)).collect();
        assert_eq!((bytes.len(), numbers), (length(3, 1), vec![0, 7, 8]));
    }

    #[test]
    fn the_least_and_the_largest_harmonics_are_no_hazard() {
        for (largest, expected) in [(0.0, 0), (1e-45, 0), (f32::MAX, i8::MAX), (-f32::MAX, i8::MIN)] {
            let mut row = [0.0; 9];
            row[2] = largest;
            let mut out = [0; ROW];
            harmonics(&row, &mut out);
            assert_eq!(out[2].cast_signed(), expected);
            assert!(f16::from_bits(word(&out, ROW - 2)).is_finite());
        }
    }
}
