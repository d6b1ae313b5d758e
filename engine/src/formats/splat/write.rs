//! Writing the 32-byte records of web viewers.

use streamsplat_kernels::harmonics::Y0;

use crate::camera::Rotation;
use crate::formats::notes::Notes;
use crate::formats::{Order, Written};
use crate::picture::to_u8;
use crate::still::Drawable;
use crate::stream::Snapshot;

/// The identity rotation, w first: each component times 128, plus 128, at most 255.
const UNTURNED: [u8; 4] = [255, 128, 128, 128];

/// Writes the Gaussians of one time as `.splat` records, without a header.
///
/// Each record has the position (three f32, little-endian; scene space, x right, y down, z forward) and the standard
/// deviations (three f32, scene units). Then follow red, green, blue and opacity (bytes: [0, 1] times 255, rounded half
/// up) and the rotation (four bytes: a quaternion, w first, `128·q + 128`; the identity). Records are in drawing order.
pub fn of_snapshot(snapshot: &Snapshot) -> Vec<u8> {
    let records = (0..snapshot.mean.len())
        .map(|i| (snapshot.mean[i], snapshot.scale[i], snapshot.rgb[i], snapshot.opacity[i], UNTURNED));
    records_of(records)
}

/// Writes a still scene as `.splat` records, in the layout of [`of_snapshot`]. Higher coefficients of the harmonics are
/// dropped, as are Gaussians that cannot be drawn ([`Still::defect`](crate::still::Still::defect)).
pub fn write(scene: &Drawable) -> Written {
    let still = scene.still();
    let order = Order::own(still);
    let mut notes = Notes::of(still, &order);
    notes.without_mark(still, ".splat");
    notes.offset(still.about.offset, "for which a .splat file has no place");
    if still.degree > 0 {
        notes.0.push(format!(".splat has no harmonics: those of degree 1 to {} left out", still.degree));
    }
    let colour = |base: [f32; 3]| base.map(|c| (0.5 + f64::from(c) * Y0) as f32);
    let byte = |c: f64| (128.0 * c + 128.0).round_ties_even().clamp(0.0, 255.0) as u8;
    let beyond = |i: &&usize| colour(still.base[**i]).iter().any(|c| *c < -0.5 / 255.0 || *c > 1.0 + 0.5 / 255.0);
    notes.changed(
        order.places.iter().filter(beyond).count(),
        still.len(),
        "with a colour outside of 0 to 1, moved there",
    );
    let records = order.places.iter().map(|&i| {
        let turn = Rotation::from_quaternion(still.rotation[i].map(f64::from));
        let turn = turn.map_or(UNTURNED, |turn| turn.quaternion().map(byte));
        (still.mean[i], scene.scale()[i], colour(still.base[i]), scene.opacity()[i], turn)
    });
    Written { bytes: records_of(records), notes: notes.0 }
}

type Record = ([f32; 3], [f32; 3], [f32; 3], f32, [u8; 4]);

fn records_of(records: impl ExactSizeIterator<Item = Record>) -> Vec<u8> {
    let mut out = Vec::with_capacity(records.len() * 32);
    for (mean, scale, rgb, opacity, rotation) in records {
        mean.iter().chain(&scale).for_each(|x| out.extend_from_slice(&x.to_le_bytes()));
        out.extend_from_slice(&rgb.map(to_u8));
        out.push(to_u8(opacity));
        out.extend_from_slice(&rotation);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_hold_what_went_in() {
        let snapshot = Snapshot {
            index: vec![0, 5],
            mean: vec![[0.25, -0.5, 1.5], [1.0, 2.0, 3.0]],
            scale: vec![[0.01, 0.02, 0.015], [0.0, 1e3, 1.0]],
            opacity: vec![0.5, 1.0],
            rgb: vec![[0.0, 0.2, 1.0], [-3.0, 7.0, 0.4]],
            dropped: 0,
        };
        let file = of_snapshot(&snapshot);
        let (records, rest) = file.as_chunks::<32>();
        assert_eq!((records.len(), rest.len()), (2, 0));
        for (i, record) in records.iter().enumerate() {
            let floats: Vec<f32> = record[..24].as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
            assert_eq!(floats, [snapshot.mean[i], snapshot.scale[i]].concat());
            assert_eq!(record[28..], [255, 128, 128, 128]);
        }
        assert_eq!(records[0][24..28], [0, 51, 255, 128]);
        assert_eq!(records[1][24..28], [0, 255, 102, 255]);
    }
}
